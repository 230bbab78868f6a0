# SPDX-License-Identifier: Apache-2.0
"""Effective masses agree with physics: impulses, kinetic energy, worst direction, singular poses."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.errors import RobotError
from scara_effmass.model.dynamics import RobotDynamics, smallest_eigenvalue
from scara_effmass.studies.scara import scara_lumped_mass

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from scara_effmass.model.dynamics import EffectiveMasses
    from scara_effmass.model.robot import Robot
    from scara_effmass.values import FloatArray

RNG_SEED = 13482
CAP = 1e6
"""Largest mass [kg] that can ever be published: what lies above it only has to stay above it."""


def mass_matrix(model: pin.Model, q: FloatArray) -> FloatArray:
    return np.asarray(pin.crba(model, model.createData(), q).copy())


def frame_of(dynamics: RobotDynamics) -> int:
    return next(iter(dynamics.robot.contact_frames.values()))


def unit_vectors(count: int) -> FloatArray:
    vectors = np.random.default_rng(RNG_SEED).normal(size=(count, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def robots(omron_dynamics: RobotDynamics, load_urdf_file: Callable[..., Robot]) -> list[RobotDynamics]:
    return [
        omron_dynamics,
        *(RobotDynamics(load_urdf_file(name)) for name in ("ur5_robot.urdf", "panda.urdf", "wx200.urdf")),
    ]


def test_impulse_changes_the_speed_like_that_of_a_free_mass(
    omron_dynamics: RobotDynamics, load_urdf_file: Callable[..., Robot], along: Callable[..., EffectiveMasses]
) -> None:
    impulse = 0.7
    for dynamics in robots(omron_dynamics, load_urdf_file):
        for q, n in zip(dynamics.robot.sample_configurations(), unit_vectors(64), strict=True):
            jacobian = dynamics.jacobian(q, frame_of(dynamics))
            if np.linalg.svd(jacobian, compute_uv=False)[-1] < 1e-3:
                continue
            jump = np.linalg.solve(mass_matrix(dynamics.robot.model, q), jacobian.T @ n * impulse)
            assert along(dynamics, q, n).full == pytest.approx(impulse / (n @ jacobian @ jump), rel=1e-6)


def test_minimum_kinetic_energy_is_that_of_the_effective_mass(
    omron_dynamics: RobotDynamics, along: Callable[..., EffectiveMasses]
) -> None:
    # Khatib's duality: of all joint motions that move the point at speed 1 along n, whatever it does across n,
    # the one with the least kinetic energy has the energy of m_n.
    rng = np.random.default_rng(RNG_SEED)
    for q, n in zip(omron_dynamics.robot.sample_configurations(), unit_vectors(64), strict=True):
        jacobian = omron_dynamics.jacobian(q, frame_of(omron_dynamics))
        matrix = mass_matrix(omron_dynamics.robot.model, q)
        row = n @ jacobian
        kkt = np.block([[matrix, row[:, None]], [row[None, :], np.zeros((1, 1))]])
        motion = np.linalg.solve(kkt, [0.0, 0.0, 0.0, 0.0, 1.0])[:4]
        mass = along(omron_dynamics, q, n).full
        assert mass == pytest.approx(motion @ matrix @ motion, rel=1e-6)
        other = motion + rng.normal(size=4)
        other /= row @ other
        assert other @ matrix @ other >= mass * (1.0 - 1e-9)


def test_worst_direction_is_the_maximum_over_directions(
    omron_dynamics: RobotDynamics, load_urdf_file: Callable[..., Robot], along: Callable[..., EffectiveMasses]
) -> None:
    for dynamics in robots(omron_dynamics, load_urdf_file):
        for q in dynamics.robot.sample_configurations()[:12]:
            jacobian = dynamics.jacobian(q, frame_of(dynamics))
            mobility = jacobian @ np.linalg.inv(mass_matrix(dynamics.robot.model, q)) @ jacobian.T
            values, vectors = np.linalg.eigh(mobility)
            masses = along(dynamics, q, vectors[:, 0])
            assert masses.worst_full == pytest.approx(1.0 / values[0], rel=1e-6)
            assert masses.full == pytest.approx(masses.worst_full, rel=1e-6)
            for n in unit_vectors(16):
                assert 1.0 / (n @ mobility @ n) <= masses.worst_full * (1.0 + 1e-9)


def test_smallest_singular_value(omron_dynamics: RobotDynamics, load_urdf_file: Callable[..., Robot]) -> None:
    for dynamics in robots(omron_dynamics, load_urdf_file):
        for q in dynamics.robot.sample_configurations():
            (masses,) = dynamics.effective_masses(q, np.ones(len(q)), 0.005)
            values = np.linalg.svd(dynamics.jacobian(q, frame_of(dynamics)), compute_uv=False)
            assert masses.smallest_singular_value == pytest.approx(values[-1], rel=1e-6, abs=1e-6)


def test_speed_and_direction_are_those_of_the_contact_point(omron_dynamics: RobotDynamics) -> None:
    rng = np.random.default_rng(RNG_SEED)
    for q in omron_dynamics.robot.sample_configurations():
        qd = rng.uniform(-2.0, 2.0, 4)
        velocity = omron_dynamics.jacobian(q, frame_of(omron_dynamics)) @ qd
        (masses,) = omron_dynamics.effective_masses(q, qd, 0.005)
        assert masses.speed == pytest.approx(np.linalg.norm(velocity), rel=1e-12)
        np.testing.assert_allclose(np.array(masses.direction) * masses.speed, velocity, atol=1e-12)


def test_speed_below_the_threshold_gives_the_worst_direction(omron_dynamics: RobotDynamics) -> None:
    q = np.array([0.3, 1.1, 0.1, 0.2])
    (slow,) = omron_dynamics.effective_masses(q, np.full(4, 1e-4), 0.005)
    (still,) = omron_dynamics.effective_masses(q, np.zeros(4), 0.005)
    for masses in (slow, still):
        assert masses.direction == (0.0, 0.0, 0.0)
        assert (masses.lumped, masses.full) == (
            masses.worst_lumped,
            masses.worst_full,
        )
    assert still.speed == 0.0


def test_rest_with_zero_threshold_has_no_direction(omron_dynamics: RobotDynamics) -> None:
    (masses,) = omron_dynamics.effective_masses(np.array([0.3, 1.1, 0.1, 0.2]), np.zeros(4), 0.0)
    assert masses.direction == (0.0, 0.0, 0.0)
    assert masses.full == masses.worst_full


@given(q2=st.floats(-1e-3, 1e-3), q1=st.floats(-2.0, 2.0))
def test_nearly_stretched_scara_has_finite_mass_across(omron_dynamics: RobotDynamics, q1: float, q2: float) -> None:
    across = np.array([1.0, 0.0, 0.0, 0.0])
    (masses,) = omron_dynamics.effective_masses(np.array([q1, q2, 0.1, 0.0]), across, 0.0)
    assert masses.lumped == pytest.approx(0.97, rel=0.01)
    assert 0.5 < masses.full < 2.0
    for worst in (masses.worst_lumped, masses.worst_full):
        assert worst > 0.97 + 2.0 / 1e-6
    assert masses.smallest_singular_value < 2e-4


def test_stretched_scara_gives_no_nan(omron_dynamics: RobotDynamics) -> None:
    for qd in (np.zeros(4), np.array([0.5, 0.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.1, 3.0])):
        (masses,) = omron_dynamics.effective_masses(np.array([0.4, 0.0, 0.1, 0.0]), qd, 0.005)
        assert masses.worst_lumped > CAP
        assert masses.worst_full > CAP
        assert masses.lumped > 0.0
        assert masses.full > 0.0
        assert masses.lumped_reason == ""


def test_singular_poses_of_a_six_axis_arm_give_no_nan(load_urdf_file: Callable[..., Robot]) -> None:
    dynamics = RobotDynamics(load_urdf_file("ur5_robot.urdf"))
    rng = np.random.default_rng(RNG_SEED)
    wrist = [np.array([0.3, -1.0, 1.2, 0.4, q5, 0.1]) for q5 in (0.0, math.pi, -math.pi)]
    elbow = [np.array([0.3, -1.0, q3, 0.4, 1.0, 0.1]) for q3 in (0.0, math.pi)]
    for q in (*wrist, *elbow, np.zeros(6)):
        for qd in (np.zeros(6), *rng.normal(size=(4, 6))):
            (masses,) = dynamics.effective_masses(q, qd, 0.005)
            assert masses.full > 0.0
            assert masses.worst_full >= masses.full * (1.0 - 1e-9)
            assert masses.smallest_singular_value >= 0.0
            assert math.isnan(masses.lumped)
            assert "wrist_2_joint moves the contact point" in masses.lumped_reason


class TestPlanarArm:
    """Two revolute joints: the contact point reaches a plane, and only directions in it count."""

    @pytest.fixture
    def dynamics(self, omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]) -> RobotDynamics:
        omron_rows["joints"] = omron_rows["joints"][:2]
        omron_rows["links"] = omron_rows["links"][:2]
        omron_rows["payload"]["mass"] = 0.55
        return RobotDynamics(load_rows(omron_rows))

    def test_worst_direction_lies_in_the_plane(self, dynamics: RobotDynamics) -> None:
        assert dynamics.lumped is not None
        assert dynamics.lumped.massless_joints == ()
        # The payload sits on the distal axis of link 2, the elbow's share on the other: M2 and M3 of Eq. 28.
        _, m2, m3 = dynamics.lumped.aggregated
        phi = np.linspace(0.0, np.pi, 20001)
        for q in dynamics.robot.sample_configurations():
            (masses,) = dynamics.effective_masses(q, np.zeros(2), 0.005)
            assert masses.worst_lumped == pytest.approx(scara_lumped_mass(q[0], q[1], phi, m2, m3).max(), rel=1e-4)
            assert math.isfinite(masses.worst_full)

    def test_stretched_planar_arm_exceeds_the_cap(self, dynamics: RobotDynamics) -> None:
        (masses,) = dynamics.effective_masses(np.array([0.7, 0.0]), np.zeros(2), 0.005)
        assert masses.worst_lumped > CAP
        assert masses.worst_full > CAP


class TestOneJoint:
    @pytest.fixture
    def rows(self, omron_rows: dict[str, Any]) -> dict[str, Any]:
        omron_rows["joints"] = omron_rows["joints"][:1]
        omron_rows["links"] = omron_rows["links"][:1]
        return omron_rows

    def test_masses_are_moment_of_inertia_over_lever_squared(
        self, rows: dict[str, Any], load_rows: Callable[[object], Robot]
    ) -> None:
        dynamics = RobotDynamics(load_rows(rows))
        (masses,) = dynamics.effective_masses(np.array([0.4]), np.array([1.0]), 0.005)
        about_axis = 2.74 * 0.08029**2 + 0.02952 + 0.25 * 0.275**2 + 0.0002
        assert masses.full == pytest.approx(about_axis / 0.275**2, rel=1e-12)
        assert masses.worst_full == pytest.approx(masses.full, rel=1e-12)
        assert masses.lumped == pytest.approx(2.74 * 0.08029 / 0.275 + 0.25, rel=1e-12)
        assert masses.speed == pytest.approx(0.275)
        assert masses.smallest_singular_value == pytest.approx(0.275)

    def test_contact_point_on_the_axis_raises(self, rows: dict[str, Any], load_rows: Callable[[object], Robot]) -> None:
        rows["contact_points"] = {"flange": [-0.275, 0.0, 0.3]}
        robot = load_rows(rows)
        with pytest.raises(RobotError, match=r"robot\.yaml: contact point flange: .* axis"):
            RobotDynamics(robot)


def test_each_contact_point_has_its_own_masses(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot], omron_dynamics: RobotDynamics
) -> None:
    omron_rows["contact_points"] = {"tool": [0.0, 0.0, 0.0], "corner": [0.1, 0.0, 0.0]}
    dynamics = RobotDynamics(load_rows(omron_rows))
    assert dynamics.contact_points == ("tool", "corner")
    q, qd = np.array([0.3, 1.1, 0.1, 0.2]), np.array([0.3, 0.2, 0.0, -0.5])
    tool, corner = dynamics.effective_masses(q, qd, 0.005)
    assert tool == omron_dynamics.effective_masses(q, qd, 0.005)[0]
    assert corner.speed != tool.speed


class TestOffsetContactPoint:
    """The impact point of Eq. 23, at R_x along x4 from the tool axis."""

    R_X = 0.12

    @pytest.fixture
    def dynamics(self, omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]) -> RobotDynamics:
        omron_rows["contact_points"] = {"edge": [self.R_X, 0.0, 0.0]}
        return RobotDynamics(load_rows(omron_rows))

    @given(q1=st.floats(-2.3, 2.3), q2=st.floats(0.1, 2.5), q4=st.floats(-6.0, 6.0))
    def test_offset_has_no_effect_along_x4(
        self, omron_dynamics: RobotDynamics, along: Callable[..., EffectiveMasses], q1: float, q2: float, q4: float
    ) -> None:
        dynamics = self.built(omron_dynamics)
        phi = q1 + q2 - q4  # Eq. 24
        n = [math.cos(phi), math.sin(phi), 0.0]
        at_edge, on_axis = (along(which, [q1, q2, 0.1, q4], n) for which in (dynamics, omron_dynamics))
        assert at_edge.lumped_reason == ""
        assert at_edge.lumped == pytest.approx(on_axis.lumped, rel=1e-6)
        assert at_edge.full == pytest.approx(on_axis.full, rel=1e-6)

    def built(self, omron_dynamics: RobotDynamics) -> RobotDynamics:
        """Return the same robot with the contact point moved along x4."""
        model = omron_dynamics.robot.model.copy()
        tool = model.frames[frame_of(omron_dynamics)]
        pose = tool.placement * pin.SE3(np.eye(3), np.array([self.R_X, 0.0, 0.0]))
        frame = model.addFrame(pin.Frame("edge", tool.parentJoint, 0, pose, pin.FrameType.OP_FRAME))
        return RobotDynamics(replace(omron_dynamics.robot, model=model, contact_frames={"edge": frame}))

    def test_offset_robot_agrees_with_the_file(self, dynamics: RobotDynamics, omron_dynamics: RobotDynamics) -> None:
        q, qd = np.array([0.3, 1.1, 0.1, 0.2]), np.array([0.3, 0.2, 0.0, 0.5])
        other = self.built(omron_dynamics)
        np.testing.assert_allclose(
            dynamics.jacobian(q, frame_of(dynamics)), other.jacobian(q, frame_of(other)), atol=1e-15
        )
        assert dynamics.effective_masses(q, qd, 0.005)[0].full == pytest.approx(
            other.effective_masses(q, qd, 0.005)[0].full
        )

    @pytest.mark.parametrize("tilt", [0.01, 0.5, math.pi / 2.0])
    def test_lumped_mass_is_undefined_across_x4(
        self, dynamics: RobotDynamics, along: Callable[..., EffectiveMasses], tilt: float
    ) -> None:
        q = [0.3, 1.1, 0.1, 0.2]
        phi = q[0] + q[1] - q[3] + tilt
        masses = along(dynamics, q, [math.cos(phi), math.sin(phi), 0.0])
        assert math.isnan(masses.lumped)
        assert "joint4" in masses.lumped_reason
        assert math.isfinite(masses.full)
        assert math.isfinite(masses.worst_full)

    def test_lumped_mass_is_undefined_for_the_worst_direction(self, dynamics: RobotDynamics) -> None:
        (masses,) = dynamics.effective_masses(np.array([0.3, 1.1, 0.1, 0.2]), np.zeros(4), 0.005)
        assert math.isnan(masses.lumped)
        assert math.isnan(masses.worst_lumped)
        assert "joint4" in masses.lumped_reason
        assert math.isfinite(masses.full)

    def test_armature_at_joint_4_defines_the_lumped_mass(
        self, omron_rows: dict[str, Any], load_rows: Callable[[object], Robot], along: Callable[..., EffectiveMasses]
    ) -> None:
        omron_rows["contact_points"] = {"edge": [self.R_X, 0.0, 0.0]}
        omron_rows["joints"][3]["armature"] = 1e-3
        masses = along(RobotDynamics(load_rows(omron_rows)), [0.3, 1.1, 0.1, 0.2], [1.0, 0.0, 0.0])
        assert math.isfinite(masses.lumped)
        assert math.isfinite(masses.worst_lumped)


@given(q1=st.floats(-2.3, 2.3), q2=st.floats(0.1, 2.5), phi=st.floats(-3.0, 3.0), rise=st.floats(-1.5, 1.5))
def test_inclined_normal_combines_planar_and_vertical_mass(
    omron: Robot,
    omron_dynamics: RobotDynamics,
    along: Callable[..., EffectiveMasses],
    q1: float,
    q2: float,
    phi: float,
    rise: float,
) -> None:
    assert omron_dynamics.lumped is not None
    planar = float(scara_lumped_mass(q1, q2, phi, *omron_dynamics.lumped.planar_masses(omron)))
    vertical = 0.2 + 0.1 + 0.25  # what joint 3 moves
    n = [math.cos(rise) * math.cos(phi), math.cos(rise) * math.sin(phi), math.sin(rise)]
    expected = 1.0 / (math.cos(rise) ** 2 / planar + math.sin(rise) ** 2 / vertical)
    assert along(omron_dynamics, [q1, q2, 0.1, 0.0], n).lumped == pytest.approx(expected, rel=1e-6)


@given(
    q1=st.floats(-2.3, 2.3),
    q2=st.floats(-2.5, -0.1),
    phi=st.floats(-3.0, 3.0),
    q3=st.floats(0.0, 0.45),
    q4=st.floats(-6.0, 6.0),
)
def test_quill_and_tool_angle_have_no_effect(
    omron_dynamics: RobotDynamics,
    along: Callable[..., EffectiveMasses],
    q1: float,
    q2: float,
    phi: float,
    q3: float,
    q4: float,
) -> None:
    n = [math.cos(phi), math.sin(phi), 0.0]
    here, there = along(omron_dynamics, [q1, q2, 0.0, 0.0], n), along(omron_dynamics, [q1, q2, q3, q4], n)
    assert there.lumped == pytest.approx(here.lumped, rel=1e-6)
    assert there.full == pytest.approx(here.full, rel=1e-6)


def test_link_lengths_have_no_effect_on_the_lumped_mass(
    omron_rows: dict[str, Any],
    load_rows: Callable[[object], Robot],
    omron_dynamics: RobotDynamics,
    along: Callable[..., EffectiveMasses],
) -> None:
    for row, link, length in zip(omron_rows["joints"][:2], omron_rows["links"][:2], (0.4, 0.15), strict=True):
        link["com"][0] *= length / row["a"]  # the same kappa
        row["a"] = length
    other = RobotDynamics(load_rows(omron_rows))
    for q, n in zip(omron_dynamics.robot.sample_configurations(), unit_vectors(64), strict=True):
        assert along(other, q, n).lumped == pytest.approx(along(omron_dynamics, q, n).lumped, rel=1e-6)


class TestSmallestEigenvalue:
    @given(
        exponents=st.tuples(*[st.floats(-9.0, 0.0)] * 3),
        twin=st.sampled_from(["none", "lower", "upper", "all"]),
        scale=st.floats(-6.0, 6.0),
        seed=st.integers(0, 2**32 - 1),
    )
    def test_agrees_with_lapack(self, exponents: tuple[float, ...], twin: str, scale: float, seed: int) -> None:
        values = np.sort(10.0 ** np.array(exponents))
        if twin in {"lower", "all"}:
            values[1] = values[0]
        if twin in {"upper", "all"}:
            values[1:] = values[2] if twin == "upper" else values[0]
        matrix = rotated(values * 10.0**scale, seed)
        error = abs(smallest_eigenvalue(matrix.tolist(), 3) - np.linalg.eigvalsh(matrix)[0])
        assert error <= 1e-7 * values[2] * 10.0**scale

    @given(small=st.floats(1e-7, 1e-1), middle=st.floats(0.2, 1.0), seed=st.integers(0, 2**32 - 1))
    def test_is_accurate_near_a_singular_pose(self, small: float, middle: float, seed: int) -> None:
        # Near an ordinary singular pose two directions stay mobile, and the mass along the third stays good.
        matrix = rotated(np.array([small, middle, 1.0]), seed)
        assert smallest_eigenvalue(matrix.tolist(), 3) == pytest.approx(np.linalg.eigvalsh(matrix)[0], rel=1e-6)

    @given(small=st.floats(1e-7, 1.0), seed=st.integers(0, 2**32 - 1))
    def test_ignores_unreachable_directions(self, small: float, seed: int) -> None:
        assert smallest_eigenvalue(rotated(np.array([0.0, small, 1.0]), seed).tolist(), 2) == pytest.approx(
            small, rel=1e-6
        )
        assert smallest_eigenvalue(rotated(np.array([0.0, 0.0, small]), seed).tolist(), 1) == pytest.approx(small)

    @pytest.mark.parametrize("rank", [1, 2, 3])
    @pytest.mark.parametrize("size", [0.0, 1e-120, 1e-30, 1.0, 1e30])
    def test_isotropic_and_vanishing_matrices(self, rank: int, size: float) -> None:
        matrix = np.diag([size if axis < rank else 0.0 for axis in range(3)])
        assert smallest_eigenvalue(matrix.tolist(), rank) == pytest.approx(size, rel=1e-7, abs=0.0)


def rotated(values: FloatArray, seed: int) -> FloatArray:
    rotation, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    matrix = rotation @ np.diag(values) @ rotation.T
    return np.asarray((matrix + matrix.T) / 2.0)


class TestMasslessJoint:
    """Joint 4 of the shipped SCARA moves no lumped mass; beside its axis it moves the contact point."""

    Q, ALONG_X4 = np.array([0.3, 1.1, 0.1, 0.0]), 0.3 + 1.1

    @pytest.fixture
    def with_offset(
        self, omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
    ) -> Callable[[float], RobotDynamics]:
        def build(offset: float) -> RobotDynamics:
            omron_rows["contact_points"] = {"edge": [offset, 0.0, 0.0]}
            return RobotDynamics(load_rows(omron_rows))

        return build

    @pytest.mark.parametrize(("offset", "defined"), [(0.9e-9, True), (1.1e-9, False)])
    def test_lever_decides_whether_the_worst_lumped_mass_is_defined(
        self, with_offset: Callable[[float], RobotDynamics], offset: float, *, defined: bool
    ) -> None:
        (masses,) = with_offset(offset).effective_masses(self.Q, np.zeros(4), 0.005)
        assert math.isfinite(masses.lumped) == math.isfinite(masses.worst_lumped) == defined
        assert bool(masses.lumped_reason) != defined

    @pytest.mark.parametrize(("tilt", "defined"), [(0.9e-8, True), (1.1e-8, False)])
    def test_lever_along_the_direction_decides_whether_the_lumped_mass_is_defined(
        self,
        with_offset: Callable[[float], RobotDynamics],
        along: Callable[..., EffectiveMasses],
        tilt: float,
        *,
        defined: bool,
    ) -> None:
        """At 0.1 m from the axis, a direction tilted by 1e-8 rad from x4 has a lever of 1e-9 m."""
        phi = self.ALONG_X4 + tilt
        masses = along(with_offset(0.1), self.Q, [math.cos(phi), math.sin(phi), 0.0])
        assert math.isfinite(masses.lumped) == defined
        assert math.isnan(masses.worst_lumped)


def test_joint_that_moves_no_inertia_has_no_full_model(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
) -> None:
    for body in (omron_rows["links"][2], omron_rows["links"][3], omron_rows["payload"]):
        body["inertia"] = [1e-4, 1e-4, 0.0, 0.0, 0.0, 0.0]
    dynamics = RobotDynamics(load_rows(omron_rows))
    assert dynamics.full_reason.startswith("joint4 moves no inertia")
    omron_rows["joints"][3]["armature"] = 1e-6
    assert RobotDynamics(load_rows(omron_rows)).full_reason == ""


@given(
    st.tuples(*[st.floats(-1.5, 1.5)] * 4),
    st.tuples(*[st.floats(0.0, 0.1)] * 4),
    st.tuples(*[st.floats(-1.0, 1.0)] * 4),
)
def test_speed_tolerance_bounds_the_error_of_the_speed(
    omron_dynamics: RobotDynamics, q: tuple[float, ...], tolerance: tuple[float, ...], error: tuple[float, ...]
) -> None:
    qd = np.array([0.5, -0.3, 0.1, 0.2])
    actual = qd + np.array(error) * tolerance
    (measured,) = omron_dynamics.effective_masses(np.array(q), qd, 0.0, tolerance)
    (true,) = omron_dynamics.effective_masses(np.array(q), actual, 0.0)
    assert abs(true.speed - measured.speed) <= measured.speed_tolerance + 1e-12
    assert true.speed_tolerance == 0.0


def test_change_of_pose_is_the_derivative_along_the_motion(
    omron_dynamics: RobotDynamics, load_urdf_file: Callable[..., Robot]
) -> None:
    """Free joints follow forward dynamics without gravity; held joints keep their velocity."""
    step = 1e-6
    for dynamics in robots(omron_dynamics, load_urdf_file):
        frame, rng = frame_of(dynamics), np.random.default_rng(RNG_SEED)
        for q in dynamics.robot.sample_configurations()[:16]:
            qd = rng.normal(size=q.size)
            names = ("lumped", "full") if dynamics.lumped else ("full",)
            (masses,) = dynamics.effective_masses(q, qd, 0.005, changes=names)[:1]
            for name in names:
                change = masses.lumped_change if name == "lumped" else masses.full_change
                model = dynamics.lumped.model if dynamics.lumped and name == "lumped" else dynamics.robot.model
                model = model.copy()
                model.gravity.setZero()
                free = pin.aba(model, model.createData(), q, qd, np.zeros(q.size))

                def velocity(t: float, joints: FloatArray, q: FloatArray = q, qd: FloatArray = qd) -> FloatArray:
                    jacobian = dynamics.jacobian(q + qd * t + joints * t * t / 2.0, frame)  # noqa: B023
                    return np.asarray(jacobian @ (qd + joints * t))

                def mobility(t: float, q: FloatArray = q, qd: FloatArray = qd, model: pin.Model = model) -> FloatArray:
                    jacobian = dynamics.jacobian(q + qd * t, frame)  # noqa: B023
                    return np.asarray(jacobian @ np.linalg.solve(mass_matrix(model, q + qd * t), jacobian.T))

                assert change is not None
                assert change.direction == masses.direction
                for joints, acceleration in zip((free, np.zeros(q.size)), change.accelerations, strict=True):
                    expected = (velocity(step, joints) - velocity(-step, joints)) / (2.0 * step)
                    np.testing.assert_allclose(acceleration, expected, rtol=1e-5, atol=1e-6 * np.abs(qd).max() ** 2)
                rate = np.array(change.mobility_rate)
                expected = (mobility(step) - mobility(-step)) / (2.0 * step)
                np.testing.assert_allclose(rate + rate.T, expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max())


def test_composite_mass_is_that_of_joints_that_share_nothing(
    omron_dynamics: RobotDynamics, load_urdf_file: Callable[..., Robot]
) -> None:
    """J_v diag(M)^-1 J_v^T, and its derivative along the motion; at rest the worst direction."""
    step = 1e-6
    for dynamics in robots(omron_dynamics, load_urdf_file):
        frame, rng = frame_of(dynamics), np.random.default_rng(RNG_SEED)
        for q in dynamics.robot.sample_configurations()[:8]:
            qd = rng.normal(size=q.size)

            def mobility(t: float, q: FloatArray = q, qd: FloatArray = qd) -> FloatArray:
                jacobian = dynamics.jacobian(q + qd * t, frame)  # noqa: B023
                inertia = np.diagonal(mass_matrix(dynamics.robot.model, q + qd * t))  # noqa: B023
                return np.asarray(jacobian @ (jacobian.T / inertia[:, None]))

            masses = dynamics.effective_masses(q, qd, 0.005)[0]
            held = dynamics.composite_mass(q, qd, 0, "full", masses)
            n = np.array(masses.direction)
            assert held.change is not None
            assert held.mass == pytest.approx(1.0 / (n @ mobility(0.0) @ n))
            np.testing.assert_allclose(held.mobility, mobility(0.0), rtol=1e-9, atol=1e-12)
            rate, expected = np.array(held.change.mobility_rate), (mobility(step) - mobility(-step)) / (2.0 * step)
            np.testing.assert_allclose(rate + rate.T, expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max())
            full = dynamics.effective_masses(q, qd, 0.005, changes=("full",))[0].full_change
            assert full is not None
            # Held joints keep their velocities.
            assert (held.change.direction, held.change.speed) == (full.direction, full.speed)
            assert np.array(held.change.accelerations) == pytest.approx(np.array(full.accelerations[1:]))
            still = dynamics.composite_mass(q, 0.0 * qd, 0, "full", dynamics.effective_masses(q, 0.0 * qd, 0.005)[0])
            assert still.change is None
            assert still.mass == still.worst_mass == held.worst_mass


def test_composite_mass_of_each_contact_point_and_model(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
) -> None:
    """Also after another joint state."""
    omron_rows["contact_points"] = {"edge": [0.1, 0.0, 0.0], "tool": [0.0, 0.0, 0.0]}
    dynamics = RobotDynamics(load_rows(omron_rows))
    q, qd = np.array([0.3, 1.1, 0.1, 0.2]), np.array([0.3, 0.2, 0.0, -0.5])
    masses = dynamics.effective_masses(q, qd, 0.005)
    assert dynamics.lumped is not None
    for name, model in (("lumped", dynamics.lumped.model), ("full", dynamics.robot.model)):
        for contact, frame in enumerate(dynamics.robot.contact_frames.values()):
            jacobian, n = dynamics.jacobian(q, frame), np.array(masses[contact].direction)
            mobility = jacobian @ (jacobian.T / np.diagonal(mass_matrix(model, q))[:, None])
            dynamics.effective_masses(-q, -qd, 0.005)
            mass = dynamics.composite_mass(q, qd, contact, name, masses[contact]).mass
            assert mass == pytest.approx(1.0 / (n @ mobility @ n))


def test_change_of_pose_is_that_of_the_models_there_are(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot], load_urdf_file: Callable[..., Robot]
) -> None:
    for body in (*omron_rows["links"], omron_rows["payload"]):
        body.pop("inertia", None)
    for robot, there in ((load_rows(omron_rows), "lumped"), (load_urdf_file("panda.urdf"), "full")):
        q = robot.sample_configurations()[0]
        dynamics, qd, models = RobotDynamics(robot), np.ones(q.size), ("lumped", "full")
        for margin in (None, 0.1):
            (masses, *_) = dynamics.effective_masses(q, qd, 0.005, changes=models, margin=margin)
            assert (masses.lumped_change is None, masses.full_change is None) == (there == "full", there == "lumped")
        assert not masses.lumped_is_heavy_enough(0.1)


def test_change_of_pose_is_computed_on_demand(omron_dynamics: RobotDynamics) -> None:
    q, qd = np.array([0.3, 0.8, 0.1, 0.0]), np.array([0.5, -0.4, 0.0, 0.2])
    assert omron_dynamics.effective_masses(q, qd, 0.005)[0].lumped_change is None
    lumped = omron_dynamics.effective_masses(q, qd, 0.005, changes=("lumped",))[0]
    assert lumped.lumped_change is not None
    assert lumped.full_change is None
    assert omron_dynamics.effective_masses(q, 0.0 * qd, 0.005, changes=("lumped",))[0].lumped_change is None


class TestEffortLimits:
    """Contact points at the elbow, which joints 3 and 4 do not move, and beside the tool axis."""

    LIMITS = np.array([50.0, 30.0, 500.0, 10.0])

    @pytest.fixture
    def dynamics(self, omron_file: Path, load_rows: Callable[[object], Robot]) -> RobotDynamics:
        rows = yaml.safe_load(omron_file.read_text())
        for joint, limit in zip(rows["joints"], self.LIMITS.tolist(), strict=True):
            joint["max_effort"] = limit
        rows["contact_points"]["tool"] = [0.1, 0.0, 0.0]
        return RobotDynamics(load_rows(rows))

    def test_clamping_force_loads_one_joint_to_its_limit(self, dynamics: RobotDynamics) -> None:
        model = dynamics.robot.model
        for q, n in zip(dynamics.robot.sample_configurations()[:16], unit_vectors(16), strict=True):
            gravity = pin.computeGeneralizedGravity(model, model.createData(), q)
            for contact, frame in enumerate(dynamics.robot.contact_frames.values()):
                directions = tuple(n.tolist()), tuple((-n).tolist())
                forces = [dynamics.clamping_force(q, contact, direction) for direction in directions]
                for direction, force in zip(directions, forces, strict=True):
                    effort = dynamics.jacobian(q, frame).T @ direction * force + gravity
                    assert np.max(np.abs(effort) / self.LIMITS) == pytest.approx(1.0)
                assert dynamics.clamping_force(q, contact, *directions) == max(forces)

    def test_no_joint_clamps_along_a_direction_that_none_moves(self, dynamics: RobotDynamics) -> None:
        elbow = dynamics.contact_points.index("elbow")
        assert dynamics.clamping_force(np.array([0.3, 1.1, 0.1, 0.2]), elbow, (0.0, 0.0, 1.0)) == 0.0

    def test_drive_acceleration_is_that_of_the_model_that_gives_more(self, dynamics: RobotDynamics) -> None:
        assert dynamics.lumped is not None
        model = dynamics.robot.model
        for q in dynamics.robot.sample_configurations()[:8]:
            effort = self.LIMITS + np.abs(pin.computeGeneralizedGravity(model, model.createData(), q))
            for contact, frame in enumerate(dynamics.robot.contact_frames.values()):
                sums = [
                    sum(np.linalg.norm(column) for column in (dynamics.jacobian(q, frame) @ inverse * effort).T)
                    for inverse in (np.linalg.inv(mass_matrix(m, q)) for m in (model, dynamics.lumped.model))
                ]
                assert dynamics.drive_acceleration(q, contact) == pytest.approx(max(sums))

    @pytest.mark.parametrize("share", [1.001, 0.999])
    def test_joint_that_could_not_carry_the_arm_has_no_known_limit(self, dynamics: RobotDynamics, share: float) -> None:
        q, up = np.array([0.3, 1.1, 0.1, 0.2]), (0.0, 0.0, 1.0)
        weight = pin.computeGeneralizedGravity(dynamics.robot.model, dynamics.robot.model.createData(), q)[2]
        dynamics.robot.model.effortLimit = np.array([50.0, 30.0, share * abs(weight), 10.0])
        assert (dynamics.clamping_force(q, 0, up) < math.inf) == (share > 1.0)
        assert (dynamics.clamping_force(q, 0, (1.0, 0.0, 0.0)) < math.inf) == (share > 1.0)

    def test_unknown_effort_limit_bounds_nothing(self, omron_dynamics: RobotDynamics) -> None:
        q = np.array([0.3, 1.1, 0.1, 0.2])
        assert omron_dynamics.drive_acceleration(q, 0) == math.inf
        assert omron_dynamics.clamping_force(q, 0, (1.0, 0.0, 0.0)) == math.inf
