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

from scara_effmass.codes import ModelCode, NoLumpedMass
from scara_effmass.errors import RobotError
from scara_effmass.reference import RobotDynamics
from scara_effmass.reference.mobility import worst_mass
from scara_effmass.studies.scara import scara_lumped_mass

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from scara_effmass.model.robot import Robot
    from scara_effmass.reference import ContactState
    from scara_effmass.values import FloatArray

RNG_SEED = 13482
CAP = 1e6
"""Largest mass [kg] that can ever be published: what lies above it only has to stay above it."""


def mass_matrix(model: pin.Model, q: FloatArray) -> FloatArray:
    return np.asarray(pin.crba(model, model.createData(), q).copy())


def frame_of(dynamics: RobotDynamics) -> int:
    return dynamics.contacts[0].frame


def jacobian_at(dynamics: RobotDynamics, q: FloatArray, contact: int = 0) -> FloatArray:
    return dynamics.at(q).contacts[contact].jacobian


def unit_vectors(count: int) -> FloatArray:
    vectors = np.random.default_rng(RNG_SEED).normal(size=(count, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def robots(omron_dynamics: RobotDynamics, load_urdf_file: Callable[..., Robot]) -> list[RobotDynamics]:
    return [
        omron_dynamics,
        *(RobotDynamics(load_urdf_file(name)) for name in ("ur5_robot.urdf", "panda.urdf", "wx200.urdf")),
    ]


def test_impulse_changes_the_speed_like_that_of_a_free_mass(
    omron_dynamics: RobotDynamics, load_urdf_file: Callable[..., Robot], along: Callable[..., ContactState]
) -> None:
    impulse = 0.7
    for dynamics in robots(omron_dynamics, load_urdf_file):
        for q, n in zip(dynamics.robot.sample_configurations(), unit_vectors(64), strict=True):
            jacobian = jacobian_at(dynamics, q)
            if np.linalg.svd(jacobian, compute_uv=False)[-1] < 1e-3:
                continue
            jump = np.linalg.solve(mass_matrix(dynamics.robot.model, q), jacobian.T @ n * impulse)
            assert along(dynamics, q, n).full == pytest.approx(impulse / (n @ jacobian @ jump), rel=1e-6)


def test_minimum_kinetic_energy_is_that_of_the_effective_mass(
    omron_dynamics: RobotDynamics, along: Callable[..., ContactState]
) -> None:
    # Khatib's duality: of all joint motions that move the point at speed 1 along n, whatever it does across n,
    # the one with the least kinetic energy has the energy of m_n.
    rng = np.random.default_rng(RNG_SEED)
    for q, n in zip(omron_dynamics.robot.sample_configurations(), unit_vectors(64), strict=True):
        jacobian = jacobian_at(omron_dynamics, q)
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
    omron_dynamics: RobotDynamics, load_urdf_file: Callable[..., Robot], along: Callable[..., ContactState]
) -> None:
    for dynamics in robots(omron_dynamics, load_urdf_file):
        for q in dynamics.robot.sample_configurations()[:12]:
            jacobian = jacobian_at(dynamics, q)
            mobility = jacobian @ np.linalg.inv(mass_matrix(dynamics.robot.model, q)) @ jacobian.T
            values, vectors = np.linalg.eigh(mobility)
            masses = along(dynamics, q, vectors[:, 0])
            assert masses.effective_mass(ModelCode.FULL, None) == pytest.approx(1.0 / values[0], rel=1e-6)
            assert masses.full == pytest.approx(masses.effective_mass(ModelCode.FULL, None), rel=1e-6)
            for n in unit_vectors(16):
                assert 1.0 / (n @ mobility @ n) <= masses.effective_mass(ModelCode.FULL, None) * (1.0 + 1e-9)


def test_smallest_singular_value(omron_dynamics: RobotDynamics, load_urdf_file: Callable[..., Robot]) -> None:
    for dynamics in robots(omron_dynamics, load_urdf_file):
        for q in dynamics.robot.sample_configurations():
            (masses,) = dynamics.at(q, np.ones(len(q))).contacts
            values = np.linalg.svd(jacobian_at(dynamics, q), compute_uv=False)
            assert masses.smallest_singular_value == pytest.approx(values[-1], rel=1e-6, abs=1e-6)


def test_speed_and_direction_are_those_of_the_contact_point(omron_dynamics: RobotDynamics) -> None:
    rng = np.random.default_rng(RNG_SEED)
    for q in omron_dynamics.robot.sample_configurations():
        qd = rng.uniform(-2.0, 2.0, 4)
        velocity = jacobian_at(omron_dynamics, q) @ qd
        (masses,) = omron_dynamics.at(q, qd).contacts
        assert masses.speed == pytest.approx(np.linalg.norm(velocity), rel=1e-12)
        np.testing.assert_allclose(np.array(masses.direction) * masses.speed, velocity, atol=1e-12)


def test_rest_has_no_direction_and_the_masses_of_the_worst_one(omron_dynamics: RobotDynamics) -> None:
    (contact,) = omron_dynamics.at(np.array([0.3, 1.1, 0.1, 0.2])).contacts
    assert (contact.speed, contact.direction) == (0.0, None)
    assert contact.lumped == contact.effective_mass(ModelCode.LUMPED, None)
    assert contact.full == contact.effective_mass(ModelCode.FULL, None)


@given(q2=st.floats(-1e-3, 1e-3), q1=st.floats(-2.0, 2.0))
def test_nearly_stretched_scara_has_finite_mass_across(omron_dynamics: RobotDynamics, q1: float, q2: float) -> None:
    across = np.array([1.0, 0.0, 0.0, 0.0])
    (masses,) = omron_dynamics.at(np.array([q1, q2, 0.1, 0.0]), across).contacts
    assert masses.lumped == pytest.approx(0.97, rel=0.01)
    assert 0.5 < masses.full < 2.0
    for worst in (masses.effective_mass(ModelCode.LUMPED, None), masses.effective_mass(ModelCode.FULL, None)):
        assert worst > 0.97 + 2.0 / 1e-6
    assert masses.smallest_singular_value < 2e-4


def test_stretched_scara_gives_no_nan(omron_dynamics: RobotDynamics) -> None:
    for qd in (np.zeros(4), np.array([0.5, 0.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.1, 3.0])):
        (masses,) = omron_dynamics.at(np.array([0.4, 0.0, 0.1, 0.0]), qd).contacts
        assert masses.effective_mass(ModelCode.LUMPED, None) > CAP
        assert masses.effective_mass(ModelCode.FULL, None) > CAP
        assert masses.lumped > 0.0
        assert masses.full > 0.0
        assert masses.no_lumped_mass(masses.direction) is None


def test_singular_poses_of_a_six_axis_arm_give_no_nan(load_urdf_file: Callable[..., Robot]) -> None:
    dynamics = RobotDynamics(load_urdf_file("ur5_robot.urdf"))
    rng = np.random.default_rng(RNG_SEED)
    wrist = [np.array([0.3, -1.0, 1.2, 0.4, q5, 0.1]) for q5 in (0.0, math.pi, -math.pi)]
    elbow = [np.array([0.3, -1.0, q3, 0.4, 1.0, 0.1]) for q3 in (0.0, math.pi)]
    for q in (*wrist, *elbow, np.zeros(6)):
        for qd in (np.zeros(6), *rng.normal(size=(4, 6))):
            (masses,) = dynamics.at(q, qd).contacts
            assert masses.full > 0.0
            assert masses.effective_mass(ModelCode.FULL, None) >= masses.full * (1.0 - 1e-9)
            assert masses.smallest_singular_value >= 0.0
            assert math.isnan(masses.lumped)
            assert masses.no_lumped_mass(masses.direction) == NoLumpedMass.MASSLESS_JOINT + 4


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
            (masses,) = dynamics.at(q, np.zeros(2)).contacts
            assert masses.effective_mass(ModelCode.LUMPED, None) == pytest.approx(
                scara_lumped_mass(q[0], q[1], phi, m2, m3).max(), rel=1e-4
            )
            assert math.isfinite(masses.effective_mass(ModelCode.FULL, None))

    def test_stretched_planar_arm_exceeds_the_cap(self, dynamics: RobotDynamics) -> None:
        (masses,) = dynamics.at(np.array([0.7, 0.0]), np.zeros(2)).contacts
        assert masses.effective_mass(ModelCode.LUMPED, None) > CAP
        assert masses.effective_mass(ModelCode.FULL, None) > CAP


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
        (masses,) = dynamics.at(np.array([0.4]), np.array([1.0])).contacts
        about_axis = 2.74 * 0.08029**2 + 0.02952 + 0.25 * 0.275**2 + 0.0002
        assert masses.full == pytest.approx(about_axis / 0.275**2, rel=1e-12)
        assert masses.effective_mass(ModelCode.FULL, None) == pytest.approx(masses.full, rel=1e-12)
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
    tool, corner = dynamics.at(q, qd).contacts
    (expected,) = omron_dynamics.at(q, qd).contacts
    assert (tool.speed, tool.lumped, tool.full) == (expected.speed, expected.lumped, expected.full)
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
        self, omron_dynamics: RobotDynamics, along: Callable[..., ContactState], q1: float, q2: float, q4: float
    ) -> None:
        dynamics = self.built(omron_dynamics)
        phi = q1 + q2 - q4  # Eq. 24
        n = [math.cos(phi), math.sin(phi), 0.0]
        at_edge, on_axis = (along(which, [q1, q2, 0.1, q4], n) for which in (dynamics, omron_dynamics))
        assert at_edge.no_lumped_mass(at_edge.direction) is None
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
        np.testing.assert_allclose(jacobian_at(dynamics, q), jacobian_at(other, q), atol=1e-15)
        assert dynamics.at(q, qd).contacts[0].full == pytest.approx(other.at(q, qd).contacts[0].full)

    @pytest.mark.parametrize("tilt", [0.01, 0.5, math.pi / 2.0])
    def test_lumped_mass_is_undefined_across_x4(
        self, dynamics: RobotDynamics, along: Callable[..., ContactState], tilt: float
    ) -> None:
        q = [0.3, 1.1, 0.1, 0.2]
        phi = q[0] + q[1] - q[3] + tilt
        masses = along(dynamics, q, [math.cos(phi), math.sin(phi), 0.0])
        assert math.isnan(masses.lumped)
        assert masses.no_lumped_mass(masses.direction) == NoLumpedMass.MASSLESS_JOINT + 3
        assert math.isfinite(masses.full)
        assert math.isfinite(masses.effective_mass(ModelCode.FULL, None))

    def test_lumped_mass_is_undefined_for_the_worst_direction(self, dynamics: RobotDynamics) -> None:
        (masses,) = dynamics.at(np.array([0.3, 1.1, 0.1, 0.2]), np.zeros(4)).contacts
        assert math.isnan(masses.lumped)
        assert math.isnan(masses.effective_mass(ModelCode.LUMPED, None))
        assert masses.no_lumped_mass(masses.direction) == NoLumpedMass.MASSLESS_JOINT + 3
        assert math.isfinite(masses.full)

    def test_armature_at_joint_4_defines_the_lumped_mass(
        self, omron_rows: dict[str, Any], load_rows: Callable[[object], Robot], along: Callable[..., ContactState]
    ) -> None:
        omron_rows["contact_points"] = {"edge": [self.R_X, 0.0, 0.0]}
        omron_rows["joints"][3]["armature"] = 1e-3
        masses = along(RobotDynamics(load_rows(omron_rows)), [0.3, 1.1, 0.1, 0.2], [1.0, 0.0, 0.0])
        assert math.isfinite(masses.lumped)
        assert math.isfinite(masses.effective_mass(ModelCode.LUMPED, None))


@given(q1=st.floats(-2.3, 2.3), q2=st.floats(0.1, 2.5), phi=st.floats(-3.0, 3.0), rise=st.floats(-1.5, 1.5))
def test_inclined_normal_combines_planar_and_vertical_mass(
    omron: Robot,
    omron_dynamics: RobotDynamics,
    along: Callable[..., ContactState],
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
    along: Callable[..., ContactState],
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
    along: Callable[..., ContactState],
) -> None:
    for row, link, length in zip(omron_rows["joints"][:2], omron_rows["links"][:2], (0.4, 0.15), strict=True):
        link["com"][0] *= length / row["a"]  # the same kappa
        row["a"] = length
    other = RobotDynamics(load_rows(omron_rows))
    for q, n in zip(omron_dynamics.robot.sample_configurations(), unit_vectors(64), strict=True):
        assert along(other, q, n).lumped == pytest.approx(along(omron_dynamics, q, n).lumped, rel=1e-6)


class TestWorstMass:
    @given(values=st.tuples(*[st.floats(1e-7, 1.0)] * 3), rank=st.integers(1, 3), seed=st.integers(0, 2**32 - 1))
    def test_is_that_of_the_smallest_eigenvalue_in_reach(self, values: tuple[float, ...], rank: int, seed: int) -> None:
        reachable = np.array([value if axis < rank else 0.0 for axis, value in enumerate(values)])
        rotation, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
        mobility = rotation @ np.diag(reachable) @ rotation.T
        assert worst_mass(mobility, rank) == pytest.approx(1.0 / min(reachable[:rank]), rel=1e-6)

    @pytest.mark.parametrize("rank", [1, 2, 3])
    def test_of_a_point_that_cannot_move_is_infinite(self, rank: int) -> None:
        assert worst_mass(np.zeros((3, 3)), rank) == math.inf


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
        (masses,) = with_offset(offset).at(self.Q, np.zeros(4)).contacts
        assert math.isfinite(masses.lumped) == math.isfinite(masses.effective_mass(ModelCode.LUMPED, None)) == defined
        assert (masses.no_lumped_mass(None) is None) == defined

    @pytest.mark.parametrize(("tilt", "defined"), [(0.9e-8, True), (1.1e-8, False)])
    def test_lever_along_the_direction_decides_whether_the_lumped_mass_is_defined(
        self,
        with_offset: Callable[[float], RobotDynamics],
        along: Callable[..., ContactState],
        tilt: float,
        *,
        defined: bool,
    ) -> None:
        """At 0.1 m from the axis, a direction tilted by 1e-8 rad from x4 has a lever of 1e-9 m."""
        phi = self.ALONG_X4 + tilt
        masses = along(with_offset(0.1), self.Q, [math.cos(phi), math.sin(phi), 0.0])
        assert math.isfinite(masses.lumped) == defined
        assert math.isnan(masses.effective_mass(ModelCode.LUMPED, None))


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
    (measured,) = omron_dynamics.at(np.array(q), qd).contacts
    (true,) = omron_dynamics.at(np.array(q), actual).contacts
    assert abs(true.speed - measured.speed) <= measured.speed_tolerance(tolerance) + 1e-12
    assert true.speed_tolerance(()) == 0.0


def test_change_of_pose_is_the_derivative_along_the_motion(
    omron_dynamics: RobotDynamics, load_urdf_file: Callable[..., Robot]
) -> None:
    """Free joints follow forward dynamics without gravity; held joints keep their velocity."""
    step = 1e-6
    for dynamics in robots(omron_dynamics, load_urdf_file):
        rng = np.random.default_rng(RNG_SEED)
        for q in dynamics.robot.sample_configurations()[:16]:
            qd = rng.normal(size=q.size)
            contact = dynamics.at(q, qd).contacts[0]
            for code, of_code in dynamics.models.items():
                model = of_code.copy()
                model.gravity.setZero()
                free = pin.aba(model, model.createData(), q, qd, np.zeros(q.size))

                def velocity(t: float, joints: FloatArray, q: FloatArray = q, qd: FloatArray = qd) -> FloatArray:
                    jacobian = jacobian_at(dynamics, q + qd * t + joints * t * t / 2.0)  # noqa: B023
                    return np.asarray(jacobian @ (qd + joints * t))

                def mobility(t: float, q: FloatArray = q, qd: FloatArray = qd, model: pin.Model = model) -> FloatArray:
                    jacobian = jacobian_at(dynamics, q + qd * t)  # noqa: B023
                    return np.asarray(jacobian @ np.linalg.solve(mass_matrix(model, q + qd * t), jacobian.T))

                moving = contact.mobility(code, contact.direction)
                assert moving.direction is contact.direction
                change = moving.change
                assert change is not None
                assert change.speed == contact.speed
                for joints, acceleration in zip((free, np.zeros(q.size)), change.accelerations, strict=True):
                    expected = (velocity(step, joints) - velocity(-step, joints)) / (2.0 * step)
                    np.testing.assert_allclose(acceleration, expected, rtol=1e-5, atol=1e-6 * np.abs(qd).max() ** 2)
                expected = (mobility(step) - mobility(-step)) / (2.0 * step)
                np.testing.assert_allclose(
                    change.mobility_rate, expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max()
                )
                assert contact.mobility(code, None).change is None


def test_held_mobility_is_that_of_joints_that_share_nothing(
    omron_dynamics: RobotDynamics, load_urdf_file: Callable[..., Robot]
) -> None:
    """J_v diag(M)^-1 J_v^T of each model, and its derivative along the motion."""
    step = 1e-6
    for dynamics in robots(omron_dynamics, load_urdf_file):
        rng = np.random.default_rng(RNG_SEED)
        for q in dynamics.robot.sample_configurations()[:8]:
            qd = rng.normal(size=q.size)
            contact = dynamics.at(q, qd).contacts[0]
            for code, model in dynamics.models.items():

                def mobility(t: float, q: FloatArray = q, qd: FloatArray = qd, model: pin.Model = model) -> FloatArray:
                    jacobian = jacobian_at(dynamics, q + qd * t)  # noqa: B023
                    inertia = np.diagonal(mass_matrix(model, q + qd * t))
                    return np.asarray(jacobian @ (jacobian.T / inertia[:, None]))

                held, n = contact.held_mobility(code, contact.direction), contact.direction
                assert n is not None
                assert held.change is not None
                assert held.effective_mass(n) == pytest.approx(1.0 / (n @ mobility(0.0) @ n))
                np.testing.assert_allclose(
                    held.axes * held.values @ held.axes.T, mobility(0.0), rtol=1e-9, atol=1e-9 * held.trace
                )
                expected = (mobility(step) - mobility(-step)) / (2.0 * step)
                np.testing.assert_allclose(
                    held.change.mobility_rate, expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max()
                )
                # Held joints keep their velocities.
                free = contact.mobility(code, n).change
                assert free is not None
                assert held.change.speed == free.speed
                np.testing.assert_array_equal(held.change.accelerations, free.accelerations[1:])
                assert contact.held_mobility(code, None).worst_mass == held.worst_mass


def test_each_contact_point_has_mobilities_of_its_own(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
) -> None:
    omron_rows["contact_points"] = {"edge": [0.1, 0.0, 0.0], "tool": [0.0, 0.0, 0.0]}
    dynamics = RobotDynamics(load_rows(omron_rows))
    q, qd = np.array([0.3, 1.1, 0.1, 0.2]), np.array([0.3, 0.2, 0.0, -0.5])
    for code, model in dynamics.models.items():
        for contact in dynamics.at(q, qd).contacts:
            n = contact.direction
            assert n is not None
            mobility = contact.jacobian @ np.linalg.solve(mass_matrix(model, q), contact.jacobian.T)
            held = contact.jacobian @ (contact.jacobian.T / np.diagonal(mass_matrix(model, q))[:, None])
            assert contact.mobility(code, n).effective_mass(n) == pytest.approx(1.0 / (n @ mobility @ n))
            assert contact.held_mobility(code, n).effective_mass(n) == pytest.approx(1.0 / (n @ held @ n))


def test_models_are_those_there_are(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot], load_urdf_file: Callable[..., Robot]
) -> None:
    for body in (*omron_rows["links"], omron_rows["payload"]):
        body.pop("inertia", None)
    for robot, code in ((load_rows(omron_rows), ModelCode.LUMPED), (load_urdf_file("panda.urdf"), ModelCode.FULL)):
        state = RobotDynamics(robot).at(robot.sample_configurations()[0], np.ones(robot.model.nv))
        (contact, *_) = state.contacts
        assert list(contact.mobilities) == list(state.mass_matrix) == [code]
        assert math.isnan(contact.full) == (code is ModelCode.LUMPED)
        assert math.isnan(contact.lumped) == (code is ModelCode.FULL)
        assert (contact.no_lumped_mass(None) == NoLumpedMass.NOT_THERE) == (code is ModelCode.FULL)


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
            for contact in dynamics.at(q).contacts:
                forces = [contact.clamping_force([direction]) for direction in (n, -n)]
                for direction, force in zip((n, -n), forces, strict=True):
                    effort = contact.jacobian.T @ direction * force + gravity
                    assert np.max(np.abs(effort) / self.LIMITS) == pytest.approx(1.0)
                assert contact.clamping_force([n, -n]) == max(forces)
                assert contact.holding_force([n, -n]) == min(forces)

    def test_no_joint_clamps_along_a_direction_that_none_moves(self, dynamics: RobotDynamics) -> None:
        elbow = dynamics.contact_points.index("elbow")
        contact = dynamics.at(np.array([0.3, 1.1, 0.1, 0.2])).contacts[elbow]
        assert contact.clamping_force([np.array([0.0, 0.0, 1.0])]) == 0.0
        assert contact.holding_force([np.array([0.0, 0.0, 1.0])]) == math.inf

    def test_largest_clamping_force_loads_joints_to_their_limits(self, dynamics: RobotDynamics) -> None:
        """No direction in which the point moves gives more. In others, a wedge, no force is the largest."""
        for q in dynamics.robot.sample_configurations()[:8]:
            for contact in dynamics.at(q).contacts:
                moved = (contact.jacobian @ np.linalg.pinv(contact.jacobian) @ unit_vectors(2000).T).T
                forces = [contact.clamping_force([n / np.linalg.norm(n)]) for n in moved]
                largest = contact.largest_clamping_force()
                assert 0.9 * largest < max(forces) <= largest * (1.0 + 1e-9)

    def test_drive_acceleration_is_that_of_the_model_that_gives_more(self, dynamics: RobotDynamics) -> None:
        assert dynamics.lumped is not None
        model = dynamics.robot.model
        for q in dynamics.robot.sample_configurations()[:8]:
            effort = self.LIMITS + np.abs(pin.computeGeneralizedGravity(model, model.createData(), q))
            for contact in dynamics.at(q).contacts:
                sums = [
                    sum(np.linalg.norm(column) for column in (contact.jacobian @ inverse * effort).T)
                    for inverse in (np.linalg.inv(mass_matrix(m, q)) for m in (model, dynamics.lumped.model))
                ]
                assert contact.drive_acceleration() == pytest.approx(max(sums))

    @pytest.mark.parametrize("share", [1.001, 0.999])
    def test_joint_that_could_not_carry_the_arm_has_no_known_limit(self, dynamics: RobotDynamics, share: float) -> None:
        q = np.array([0.3, 1.1, 0.1, 0.2])
        weight = pin.computeGeneralizedGravity(dynamics.robot.model, dynamics.robot.model.createData(), q)[2]
        dynamics.robot.model.effortLimit = np.array([50.0, 30.0, share * abs(weight), 10.0])
        for n in (np.eye(3)[0], np.eye(3)[2]):
            assert (dynamics.at(q).contacts[0].clamping_force([n]) < math.inf) == (share > 1.0)
        assert (dynamics.at(q).contacts[0].drive_acceleration() < math.inf) == (share > 1.0)

    def test_unknown_effort_limit_bounds_nothing(self, omron_dynamics: RobotDynamics) -> None:
        (contact,) = omron_dynamics.at(np.array([0.3, 1.1, 0.1, 0.2])).contacts
        assert contact.drive_acceleration() == math.inf
        assert contact.clamping_force([np.eye(3)[0]]) == math.inf
        assert contact.largest_clamping_force() == math.inf
