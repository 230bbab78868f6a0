# SPDX-License-Identifier: Apache-2.0
"""Lumped model: supported robots, and reasons for the others."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from scara_effmass.codes import ModelCode, NoLumpedMass
from scara_effmass.errors import RobotError
from scara_effmass.model.lumping import LumpedModel, is_scara, lump, lumped_links
from scara_effmass.model.robot import Robot
from scara_effmass.reference import ContactState, RobotDynamics
from scara_effmass.settings import FreeParameters, LumpingPolicy, LumpingSettings
from scara_effmass.studies.scara import scara_lumped_mass
from scara_effmass.values import FloatArray

shared_fixture_settings = settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])


def centres_of_mass_agree(lumped: LumpedModel, robot: Robot) -> bool:
    return all(
        np.allclose(link.kappa1 * np.array(link.point1) + link.kappa2 * np.array(link.point2), body.lever, atol=1e-4)
        for link, body in zip(lumped.links, list(robot.model.inertias)[1:], strict=True)
    )


def fitted(robot: Robot, policy: LumpingPolicy = LumpingPolicy.REFUSE) -> Robot:
    return replace(robot, lumping=LumpingSettings(policy=policy, free_parameters=FreeParameters.FIT_INERTIA))


def test_structure_of_table_2(omron_dynamics: RobotDynamics) -> None:
    lumped = omron_dynamics.lumped
    assert lumped is not None
    assert [link.kappa2 for link in lumped.links] == pytest.approx([0.08029 / 0.275, 0.05775 / 0.275, 1.0, 0.5])
    assert all(link.on_axes for link in lumped.links)
    assert [link.axes for link in lumped.links] == ["parallel", "parallel", "coincident", "coincident"]
    assert lumped.massless_joints == (3,)
    assert [mass.mass for mass in lumped.masses] == pytest.approx(lumped.aggregated)
    assert len(lumped.masses) == 5
    # M33 of the paper: the quill moves m_l4 and m_l5 alone.
    q = np.array([0.4, 1.2, 0.1, 0.3])
    assert pin.crba(lumped.model, lumped.model.createData(), q)[2, 2] == pytest.approx(sum(lumped.aggregated[3:]))
    assert is_scara(omron_dynamics.robot)


@pytest.mark.parametrize("end", [0, 1, 2])
def test_heights_are_measured_along_each_axis(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot], end: int
) -> None:
    omron_rows["links"][end]["com"][2] = 0.05
    link = lump(load_rows(omron_rows)).links[end]
    # The axis after link 2 points the other way (alpha = pi), as the paper's q3 does.
    assert (link.height1, link.height2) == pytest.approx((0.05, -0.05 if end == 1 else 0.05))


class TestCentreOfMassOutsideTheSlab:
    """A counterweight behind the joint: kappa2 < 0, or a mass beyond the next axis: kappa1 < 0."""

    @shared_fixture_settings
    @given(x1=st.floats(-0.1, 0.5), x2=st.floats(-0.3, 0.5), mass=st.floats(0.1, 5.0))
    def test_mass_matrix_is_positive_definite_or_lump_raises(
        self, omron_rows: dict[str, Any], load_rows: Callable[[object], Robot], x1: float, x2: float, mass: float
    ) -> None:
        assume(max(abs(x1), abs(x2)) > 1e-6)  # else every centre of mass is a placeholder
        omron_rows["links"][0]["com"][0], omron_rows["links"][1]["com"][0] = x1, x2
        omron_rows["links"][1]["mass"] = mass
        robot = load_rows(omron_rows)
        m2 = 2.74 * x1 / 0.275 + mass * (1.0 - x2 / 0.275)
        m3 = 0.55 + mass * x2 / 0.275
        if min(m2, m3) < 0.0:
            with pytest.raises(RobotError, match="slab"):
                lump(robot)
            return
        assume(min(m2, m3) > 1e-6)
        lumped = lump(robot)
        assert lumped.planar_masses(robot) == pytest.approx((m2, m3), abs=1e-9)
        assert centres_of_mass_agree(lumped, robot)
        data = lumped.model.createData()
        for q2 in (0.0, 1e-3, 0.3, 1.5):
            matrix = pin.crba(lumped.model, data, np.array([0.2, q2, 0.1, 0.0]))
            assert np.linalg.eigvalsh(matrix)[0] > -1e-12

    def test_indefinite_mass_matrix_between_samples_raises(
        self, omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
    ) -> None:
        # M2 = -1e-4 kg: M(q) is indefinite only for |q2| below half a degree, where no sample lies.
        omron_rows["links"][0]["com"][0] = -(2.0 * (1.0 - 0.05775 / 0.275) + 1e-4) * 0.275 / 2.74
        dynamics = RobotDynamics(load_rows(omron_rows))
        assert dynamics.lumped is None
        assert "axis 2 is -0.0001 kg: must not be negative: the centre of mass lies outside" in dynamics.lumped_reason
        assert "joint1" in dynamics.lumped_reason
        (masses,) = dynamics.at(np.array([0.2, 0.0, 0.1, 0.0]), np.ones(4)).contacts
        assert math.isnan(masses.lumped)
        assert masses.full > 0.0

    def test_negative_mass_on_the_forearm_adds_to_the_coaxial_tool(
        self, omron_rows: dict[str, Any], load_rows: Callable[[object], Robot], along: Callable[..., ContactState]
    ) -> None:
        omron_rows["links"][1]["com"][0] = -0.03
        robot = load_rows(omron_rows)
        dynamics = RobotDynamics(robot)
        assert dynamics.lumped is not None
        assert dynamics.lumped.aggregated[2] < 0.0
        m2, m3 = dynamics.lumped.planar_masses(robot)
        masses = along(dynamics, [0.4, 1.2, 0.1, 0.0], [0.6, 0.8, 0.0])
        assert masses.lumped == pytest.approx(
            float(scara_lumped_mass(0.4, 1.2, math.atan2(0.8, 0.6), m2, m3)), rel=1e-9
        )


class TestCentreOfMassBesideThePlaneOfTheAxes:
    def test_of_two_revolute_joints_raises_with_the_distance(
        self, omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
    ) -> None:
        omron_rows["links"][0]["com"][1] = 0.0123
        with pytest.raises(RobotError, match=r"behind joint1: .* 12\.3 mm off the plane"):
            lump(load_rows(omron_rows))

    def test_of_a_coaxial_tool_shifts_its_far_axis(
        self, omron_rows: dict[str, Any], load_rows: Callable[[object], Robot], along: Callable[..., ContactState]
    ) -> None:
        omron_rows["payload"]["com"] = [0.05, 0.0, 0.0]
        omron_rows["contact_points"] = {"edge": [0.08, 0.0, 0.0]}
        dynamics = RobotDynamics(load_rows(omron_rows))
        lumped = dynamics.lumped
        assert lumped is not None
        assert centres_of_mass_agree(lumped, dynamics.robot)
        assert [link.on_axes for link in lumped.links] == [True, True, True, False]
        assert lumped.massless_joints == ()
        inertia = pin.crba(lumped.model, lumped.model.createData(), np.zeros(4))[3, 3]
        assert inertia == pytest.approx(0.35 * (0.25 * 0.05 / 0.35) ** 2)
        # The paper's contact beside the axis, along x4 and across it.
        q, phi = [0.3, 1.1, 0.1, 0.2], 0.3 + 1.1 - 0.2
        for angle in (phi, phi + 0.7):
            masses = along(dynamics, q, [math.cos(angle), math.sin(angle), 0.0])
            assert 0.0 < masses.lumped < masses.effective_mass(ModelCode.LUMPED, None) < math.inf
        with pytest.raises(RobotError, match=r"robot\.yaml: .*off the plane"):
            lumped.planar_masses(dynamics.robot)

    def test_of_a_coaxial_tool_can_reproduce_its_moment_of_inertia(
        self, omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
    ) -> None:
        omron_rows["payload"]["com"] = [0.05, 0.0, 0.0]
        robot = fitted(load_rows(omron_rows))
        lumped = lump(robot)
        inertia = [pin.crba(model, model.createData(), np.zeros(4))[3, 3] for model in (lumped.model, robot.model)]
        assert inertia[0] == pytest.approx(inertia[1])
        assert centres_of_mass_agree(lumped, robot)

    @pytest.mark.parametrize("link", [1, 2], ids=["before the slide", "on the slide"])
    def test_of_a_prismatic_joint_shifts_that_axis(
        self, omron_rows: dict[str, Any], load_rows: Callable[[object], Robot], link: int
    ) -> None:
        omron_rows["links"][link]["com"][1] = 0.02
        robot = load_rows(omron_rows)
        lumped = lump(robot)
        assert [entry.on_axes for entry in lumped.links].index(False) == link
        assert centres_of_mass_agree(lumped, robot)
        with pytest.raises(RobotError, match=r"robot\.yaml: .*off the plane"):
            lumped.planar_masses(robot)

    def test_prismatic_axis_through_the_centre_of_mass_gives_one_mass(
        self, omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
    ) -> None:
        omron_rows["links"][2]["com"] = [0.03, 0.02, 0.1]
        link = lump(load_rows(omron_rows)).links[2]
        assert (link.kappa1, link.kappa2) == (1.0, 0.0)
        assert link.point1 == pytest.approx((0.03, 0.02, 0.1))

    def test_prismatic_axis_is_not_shifted_without_need(self, omron_dynamics: RobotDynamics) -> None:
        assert omron_dynamics.lumped is not None
        assert omron_dynamics.lumped.links[1].point2 == pytest.approx((0.275, 0.0, 0.0))


def test_pi_written_as_3_14_is_parallel(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot], omron_dynamics: RobotDynamics
) -> None:
    omron_rows["joints"][1]["alpha"] = 3.14
    sloppy = RobotDynamics(load_rows(omron_rows))
    for q in sloppy.robot.sample_configurations():
        (exact,), (rough,) = (
            dynamics.at(q, np.array([1.0, 0.3, 0.0, 0.0])).contacts for dynamics in (omron_dynamics, sloppy)
        )
        assert rough.lumped == pytest.approx(exact.lumped, rel=0.01)


def test_urdf_with_pi_written_as_3_14_has_a_lumped_model(load_urdf_file: Callable[..., Robot]) -> None:
    robot = load_urdf_file("scara_icube_tutorial.urdf")
    assert lump(robot).aggregated == pytest.approx((0.75, 1.0, 0.75, 0.2), abs=1e-3)


def test_base_pose_has_no_effect(omron_dynamics: RobotDynamics, along: Callable[..., ContactState]) -> None:
    q, n = np.array([0.4, 1.2, 0.1, 0.3]), np.array([0.6, 0.8, 0.0])
    model = omron_dynamics.robot.model.copy()
    base = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.2, 0.9), np.array([1.0, 2.0, 3.0]))
    model.jointPlacements[1] = base * model.jointPlacements[1]
    moved = RobotDynamics(replace(omron_dynamics.robot, model=model))
    here, there = along(omron_dynamics, q, n), along(moved, q, base.rotation @ n)
    assert there.lumped == pytest.approx(here.lumped, rel=1e-9)
    assert there.full == pytest.approx(here.full, rel=1e-9)
    assert there.effective_mass(ModelCode.LUMPED, None) == pytest.approx(
        here.effective_mass(ModelCode.LUMPED, None), rel=1e-9
    )


@shared_fixture_settings
@given(
    first=st.floats(0.05, 0.6), second=st.floats(0.05, 0.6), share1=st.floats(0.01, 0.99), share2=st.floats(0.01, 0.99)
)
def test_lumped_mass_of_any_scara_is_eq_28(
    omron_rows: dict[str, Any],
    load_rows: Callable[[object], Robot],
    along: Callable[..., ContactState],
    first: float,
    second: float,
    share1: float,
    share2: float,
) -> None:
    for row, link, length, share in zip(
        omron_rows["joints"][:2], omron_rows["links"][:2], (first, second), (share1, share2), strict=True
    ):
        row["a"], link["com"][0] = length, share * length
    robot = load_rows(omron_rows)
    dynamics = RobotDynamics(robot)
    assert dynamics.lumped is not None
    m2, m3 = dynamics.lumped.planar_masses(robot)
    assert m2 == pytest.approx(2.74 * share1 + 2.0 * (1.0 - share2))
    assert m3 == pytest.approx(2.0 * share2 + 0.55)
    q1, q2, phi = 0.4, 1.2, 0.9
    assume(abs(math.sin(q2)) > 0.1)
    masses = along(dynamics, [q1, q2, 0.1, 0.0], [math.cos(phi), math.sin(phi), 0.0])
    assert masses.lumped == pytest.approx(float(scara_lumped_mass(q1, q2, phi, m2, m3)), rel=1e-6)


def test_other_robot_than_a_scara_has_no_planar_masses(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
) -> None:
    omron_rows["joints"], omron_rows["links"] = omron_rows["joints"][:3], omron_rows["links"][:3]
    robot = load_rows(omron_rows)
    assert not is_scara(robot)
    with pytest.raises(RobotError, match=r"robot\.yaml: omron_i4_550l is not a SCARA"):
        lump(robot).planar_masses(robot)


def test_lumped_model_needs_no_inertias(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot], omron_dynamics: RobotDynamics
) -> None:
    for body in (*omron_rows["links"], omron_rows["payload"]):
        del body["inertia"]
    dynamics = RobotDynamics(load_rows(omron_rows))
    assert dynamics.full_reason == "the file gives no inertia tensors"
    assert omron_dynamics.lumped is not None
    assert dynamics.lumped is not None
    assert dynamics.lumped.aggregated == omron_dynamics.lumped.aggregated
    (masses,) = dynamics.at(np.array([0.4, 1.2, 0.1, 0.3]), np.ones(4)).contacts
    assert math.isnan(masses.full)
    assert math.isnan(masses.effective_mass(ModelCode.FULL, None))
    assert math.isfinite(masses.lumped)


@pytest.mark.parametrize(("offset", "on_axes"), [(0.9e-4, True), (1.1e-4, False)])
def test_tolerance_of_the_plane_of_the_axes_is_a_tenth_of_a_millimetre(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot], offset: float, *, on_axes: bool
) -> None:
    omron_rows["links"][1]["com"][1] = offset
    assert lump(load_rows(omron_rows)).links[1].on_axes == on_axes


@pytest.mark.parametrize(("alpha", "parallel"), [(1.9e-3, True), (2.1e-3, False)])
def test_axes_within_two_milliradians_are_parallel(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot], alpha: float, *, parallel: bool
) -> None:
    omron_rows["joints"][0]["alpha"] = alpha
    for body in (*omron_rows["links"], omron_rows["payload"]):
        body["inertia"] = [body["inertia"]] * 3 + [0.0] * 3
    robot = load_rows(omron_rows)
    assert is_scara(robot) == parallel
    assert (lump(robot).links[0].axes == "parallel") == parallel


class TestCrossedAxes:
    """Two joints whose axes are neither parallel nor coincident: DH rows of the first one."""

    @pytest.fixture
    def elbow(self, omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]) -> Callable[..., Robot]:
        def build(a: float, alpha: float, com: tuple[float, ...], second: float = 0.1, **lumping: str) -> Robot:
            omron_rows["joints"], omron_rows["links"] = omron_rows["joints"][:2], omron_rows["links"][:2]
            omron_rows["joints"][0] |= {"a": a, "alpha": alpha}
            omron_rows["joints"][1] |= {"alpha": 0.0}
            tensor = [0.03, 0.02, 0.025, 0.001, -0.002, 0.003]
            omron_rows["links"][0] |= {"mass": 2.0, "com": list(com), "inertia": tensor}
            omron_rows["links"][1] |= {"mass": 1.0, "com": [second, 0.0, 0.05], "inertia": tensor}
            omron_rows["payload"]["inertia"] = [1e-4, 1e-4, 1e-4, 0.0, 0.0, 0.0]
            settings_ = LumpingSettings.model_validate(lumping)
            return replace(load_rows(omron_rows), lumping=settings_)

        return build

    @shared_fixture_settings
    @given(
        a=st.floats(0.05, 0.6),
        alpha=st.floats(0.2, 2.9),
        share=st.floats(0.15, 0.85),
        cy=st.floats(-0.1, 0.1),
        cz=st.floats(-0.2, 0.2),
    )
    def test_masses_of_skew_axes_are_those_of_the_closed_form(
        self, elbow: Callable[..., Robot], a: float, alpha: float, share: float, cy: float, cz: float
    ) -> None:
        cx = share * a
        robot = elbow(a, alpha, (cx, cy, cz), policy="mass_at_com")
        link = lump(robot).links[0]
        assert (link.axes, link.problem) == ("skew", "")
        assert link.kappa2 == pytest.approx(cx / a)
        assert link.height2 == pytest.approx(-a * cy / (cx * math.sin(alpha)), abs=1e-9)
        assert link.height1 == pytest.approx((cz + cy / math.tan(alpha)) / (1.0 - cx / a), abs=1e-9)
        distal = np.array([0.0, -math.sin(alpha), math.cos(alpha)])
        assert link.point1 == pytest.approx((0.0, 0.0, link.height1), abs=1e-9)
        assert link.point2 == pytest.approx(np.array([a, 0.0, 0.0]) + link.height2 * distal, abs=1e-9)
        np.testing.assert_allclose(
            link.kappa1 * np.array(link.point1) + link.kappa2 * np.array(link.point2), (cx, cy, cz), atol=1e-9
        )

    @shared_fixture_settings
    @given(alpha=st.floats(0.3, 2.8), cy=st.floats(-0.2, 0.2), cz=st.floats(-0.2, 0.2))
    def test_free_parameter_of_intersecting_axes_is_the_best(
        self, elbow: Callable[..., Robot], alpha: float, cy: float, cz: float
    ) -> None:
        com = np.array([0.0, cy, cz])
        distal = np.array([0.0, -math.sin(alpha), math.cos(alpha)])
        second = -cy / math.sin(alpha)
        first = cz - second * math.cos(alpha)
        assume(min(abs(first), abs(second)) > 1e-3)

        def spread(masses: tuple[FloatArray, FloatArray]) -> float:
            arms, shares = masses
            return float(shares @ (arms**2).sum(axis=1))

        def error(masses: tuple[FloatArray, FloatArray]) -> float:
            tensor = sum(2.0 * s * ((r @ r) * np.eye(3) - np.outer(r, r)) for r, s in zip(*masses, strict=True))
            return float(np.linalg.norm(tensor - robot.model.inertias[1].inertia))

        others, within_reach = [], []
        for kappa2 in np.linspace(0.02, 0.98, 97).tolist():
            heights = first / (1.0 - kappa2), second / kappa2
            points = np.array([[0.0, 0.0, heights[0]], heights[1] * distal])
            others.append((points - com, np.array([1.0 - kappa2, kappa2])))
            if max(map(abs, heights)) < abs(first) + abs(second) + 0.33:
                within_reach.append(others[-1])
        for rule in FreeParameters:
            robot = elbow(0.0, alpha, tuple(com.tolist()), free_parameters=rule.value)
            link = lump(robot).links[0]
            chosen = np.array([link.point1, link.point2]) - com, np.array([link.kappa1, link.kappa2])
            assert link.axes == "intersecting"
            assert chosen[1] @ chosen[0] == pytest.approx(np.zeros(3), abs=1e-9)
            if rule is FreeParameters.MINIMUM_SPREAD:
                assert spread(chosen) <= min(map(spread, others)) + 1e-12
            else:
                assert error(chosen) <= min(map(error, within_reach)) + 1e-12

    @pytest.mark.parametrize(
        ("a", "com", "problem"),
        [
            (0.0, (0.0031, 0.02, 0.05), "its centre of mass lies 3.1 mm off the plane of its two axes"),
            (0.2, (0.0002, 0.02, 0.05), "a mass lies 20 m from the common normal: kappa2 = 0.001"),
            (0.2, (0.0, 0.02, 0.05), "a mass lies inf m from the common normal: kappa2 = 0"),
            (0.2, (0.2, 0.02, 0.05), "a mass lies inf m from the common normal: kappa2 = 1"),
        ],
        ids=["off the plane", "running to infinity", "no mass beside its axis", "no mass beside the other axis"],
    )
    def test_link_without_two_masses_is_answered_by_the_policy(
        self, elbow: Callable[..., Robot], a: float, com: tuple[float, ...], problem: str
    ) -> None:
        with pytest.raises(RobotError, match=f"^link behind joint1: {problem} .lumping.policy project_com and mass"):
            lump(elbow(a, math.pi / 2.0, com))
        at_com = lump(elbow(a, math.pi / 2.0, com, policy="mass_at_com")).links[0]
        assert at_com.point1 == at_com.point2 == pytest.approx(com)
        assert at_com.kappa1 == at_com.kappa2 == 0.5
        assert (at_com.problem, at_com.answer, at_com.on_axes) == (problem, "one mass at its centre of mass", False)
        link = lump(elbow(a, math.pi / 2.0, com, policy="project_com")).links[0]
        projected = link.kappa1 * np.array(link.point1) + link.kappa2 * np.array(link.point2)
        moved = np.linalg.norm(projected - np.array(com))
        assert 1e-4 < moved < 0.2
        assert link.answer == f"its centre of mass moved by {1e3 * moved:.1f} mm"
        assert max(abs(link.height1), abs(link.height2)) < 0.2
        assert sum(lump(elbow(a, math.pi / 2.0, com, policy="project_com")).aggregated) == pytest.approx(3.25)

    @pytest.mark.parametrize("com", [(0.0, 0.0, 0.05), (0.2, 0.03, 0.0)])
    def test_centre_of_mass_on_an_axis_has_all_mass_there(
        self, elbow: Callable[..., Robot], com: tuple[float, ...]
    ) -> None:
        link = lump(elbow(0.2, math.pi / 2.0, com, policy="mass_at_com")).links[0]
        assert link.problem == ""
        assert link.kappa1 * np.array(link.point1) + link.kappa2 * np.array(link.point2) == pytest.approx(com)

    def test_every_link_without_two_masses_is_named(self, load_urdf_file: Callable[..., Robot]) -> None:
        reason = RobotDynamics(load_urdf_file("panda.urdf")).lumped_reason
        for joint, distance in ((1, 3.9), (2, 3.1), (5, 12.0)):
            assert f"link behind panda_joint{joint}: its centre of mass lies {distance} mm off the plane" in reason

    def test_indefinite_mass_matrix_is_refused_or_answered(self, elbow: Callable[..., Robot]) -> None:
        """A counterweight far beyond the first axis."""
        com = (-0.4, 0.0, 0.0)
        with pytest.raises(RobotError, match=r"kg: must not be negative: the centre of mass lies outside the slab"):
            lump(elbow(0.2, math.pi / 2.0, com))
        link = lump(elbow(0.2, math.pi / 2.0, com, policy="project_com")).links[0]
        assert (
            link.problem == "its centre of mass lies outside the slab between its axes: kappa2 = -2 makes M indefinite"
        )
        assert link.answer == "its centre of mass moved by 500.0 mm"
        assert lump(elbow(0.2, math.pi / 2.0, com, policy="mass_at_com")).links[0].point1 == pytest.approx(com)

    def test_centre_of_mass_beyond_the_distal_axis_is_moved_if_another_link_makes_the_matrix_indefinite(
        self, elbow: Callable[..., Robot]
    ) -> None:
        link = lump(elbow(0.2, math.pi / 2.0, (0.3, 0.0, 0.0), second=-0.3, policy="project_com")).links[0]
        assert (
            link.problem == "its centre of mass lies outside the slab between its axes: kappa2 = 1.5 makes M indefinite"
        )

    def test_only_parallel_axes_give_a_definite_matrix_by_its_form(
        self, elbow: Callable[..., Robot], omron: Robot
    ) -> None:
        assert lump(omron).is_regular
        assert not lump(elbow(0.2, math.pi / 2.0, (0.05, 0.02, 0.05))).is_regular

    def test_tilted_slide_is_shifted_through_the_centre_of_mass(
        self, omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
    ) -> None:
        for body in (*omron_rows["links"], omron_rows["payload"]):
            body["inertia"] = [body["inertia"]] * 3 + [0.0] * 3
        omron_rows["joints"][1]["alpha"], omron_rows["joints"][1]["a"] = 2.0, 0.0
        omron_rows["links"][1]["com"] = [0.05, 0.01, 0.02]
        robot = load_rows(omron_rows)
        for rule in FreeParameters:
            link = lump(replace(robot, lumping=LumpingSettings(free_parameters=rule))).links[1]
            assert link.point2 == pytest.approx((0.05, 0.01, 0.02))
            assert (link.kappa2, link.on_axes, link.problem) == (1.0, False, "")
            assert (link.height1, link.height2) == (0.0, 0.0)

    @pytest.mark.parametrize(("far", "runs_away"), [(2.69, False), (2.71, True)])
    @pytest.mark.parametrize("end", ["proximal", "distal"])
    def test_mass_runs_to_infinity_beyond_ten_times_the_size_of_the_link(
        self, elbow: Callable[..., Robot], end: str, far: float, *, runs_away: bool
    ) -> None:
        """The size is 0.02 m and 0.05 m along the axes and 0.2 m between them."""
        share = 1.0 - 0.05 / far if end == "proximal" else 0.02 / far
        link = lumped_links(elbow(0.2, math.pi / 2.0, (0.2 * share, 0.02, 0.05)))[0]
        assert link.problem == (
            f"a mass lies {far} m from the common normal: kappa2 = {share:.2g}" if runs_away else ""
        )
        assert link.kappa2 == pytest.approx(0.02 / 0.07 if runs_away else share)

    @pytest.mark.parametrize(("x", "z", "kappa2"), [(0.0, 0.05, 0.0), (0.2, 0.0, 1.0)])
    def test_mass_on_one_of_two_skew_axes_stays_there(
        self, elbow: Callable[..., Robot], x: float, z: float, kappa2: float
    ) -> None:
        robot = elbow(0.2, math.pi / 2.0, (x, 0.0, z))
        for within_slab in (False, True):
            link = lumped_links(robot, within_slab=within_slab)[0]
            assert (link.problem, link.kappa2) == ("", kappa2)
            assert (link.height1, link.height2) == pytest.approx((z, 0.0))

    @pytest.mark.parametrize(("gap", "axes"), [(0.9e-4, "intersecting"), (1.1e-4, "skew")])
    def test_axes_a_tenth_of_a_millimetre_apart_are_skew(
        self, elbow: Callable[..., Robot], gap: float, axes: str
    ) -> None:
        assert lumped_links(elbow(gap, math.pi / 2.0, (gap / 2.0, 0.02, 0.05)))[0].axes == axes

    @pytest.mark.parametrize(("offset", "on_plane"), [(0.9e-4, True), (1.1e-4, False)])
    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_tolerance_of_the_plane_of_intersecting_axes(
        self, elbow: Callable[..., Robot], offset: float, sign: float, *, on_plane: bool
    ) -> None:
        link = lumped_links(elbow(0.0, math.pi / 2.0, (sign * offset, 0.02, 0.05)))[0]
        assert (link.problem == "") == on_plane

    @pytest.mark.parametrize("rule", FreeParameters)
    def test_mass_where_the_axes_meet_is_halved(self, elbow: Callable[..., Robot], rule: FreeParameters) -> None:
        link = lumped_links(elbow(0.0, math.pi / 2.0, (0.0, 0.0, 0.0), free_parameters=rule.value))[0]
        assert (link.problem, link.kappa1, link.kappa2) == ("", 0.5, 0.5)
        assert (link.point1, link.point2) == ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

    @pytest.mark.parametrize(("moments", "is_proximal"), [([0.03, 0.03, 0.01], True), ([0.03, 0.01, 0.03], False)])
    def test_fit_reaches_no_further_than_three_radii_of_gyration(
        self, elbow: Callable[..., Robot], moments: list[float], *, is_proximal: bool
    ) -> None:
        """A mass near the crossing has too short a lever to reproduce the inertia of the link."""
        first, second = 0.001, 0.0015
        robot = elbow(0.0, math.pi / 2.0, (0.0, -second, first), free_parameters="fit_inertia")
        robot.model.inertias[1].inertia = np.diag(moments)
        link = lumped_links(robot)[0]
        reach = first + second + 3.0 * math.sqrt(0.07 / (3.0 * 2.0))
        assert link.kappa2 / link.kappa1 == pytest.approx(reach / first if is_proximal else second / reach)


def test_counterweight_on_parallel_axes_is_moved_to_the_proximal_one(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
) -> None:
    """It makes M indefinite; the second link stays as it is."""
    omron_rows["links"][0]["com"] = [-0.6, 0.0, 0.0]
    robot = load_rows(omron_rows)
    with pytest.raises(RobotError, match="must not be negative: the centre of mass lies outside the slab"):
        lump(robot)
    links = lump(replace(robot, lumping=LumpingSettings(policy=LumpingPolicy.PROJECT_COM))).links
    assert (links[0].kappa2, links[0].answer) == (0.0, "its centre of mass moved by 600.0 mm")
    assert links[0].problem.startswith("its centre of mass lies outside the slab between its axes: kappa2 = -2.18")
    assert links[1].problem == links[1].answer == ""


def test_centre_of_mass_beyond_the_distal_axis_is_moved_onto_it(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
) -> None:
    """The counterweight of the second link makes M indefinite."""
    omron_rows["links"][0]["com"] = [1.5 * 0.275, 0.0, 0.0]
    omron_rows["links"][1]["com"] = [-0.2, 0.0, 0.0]
    robot = load_rows(omron_rows)
    with pytest.raises(RobotError, match=r"lies outside the slab between the axes behind joint1, joint2$"):
        lump(robot)
    link = lump(replace(robot, lumping=LumpingSettings(policy=LumpingPolicy.PROJECT_COM))).links[0]
    assert (link.kappa2, link.answer) == (1.0, "its centre of mass moved by 137.5 mm")
    assert link.problem == "its centre of mass lies outside the slab between its axes: kappa2 = 1.5 makes M indefinite"


def test_wrist_without_mass_beside_its_axes_has_no_lumped_mass(load_urdf_file: Callable[..., Robot]) -> None:
    """Joint 5 of this UR5 moves the tool but no lumped mass: a mass of zero along n would be wrong."""
    dynamics = RobotDynamics(load_urdf_file("ur5_robot.urdf"))
    assert dynamics.lumped is not None
    assert dynamics.lumped.massless_joints == (4, 5)
    (masses,) = dynamics.at(np.array([0.3, -1.0, 1.2, 0.4, 0.8, 0.1]), np.full(6, 0.1)).contacts
    assert math.isnan(masses.lumped)
    assert masses.no_lumped_mass(masses.direction) == NoLumpedMass.MASSLESS_JOINT + 4


def test_slide_with_an_offset_or_a_tilt_is_no_scara(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
) -> None:
    for body in (*omron_rows["links"], omron_rows["payload"]):
        body["inertia"] = [body["inertia"]] * 3 + [0.0] * 3
    slide = omron_rows["joints"][2]
    for changes, expected in (
        ({"d": 0.1}, True),
        ({"a": 0.9e-4}, True),
        ({"a": 1.1e-4}, False),
        ({"a": 0.0, "alpha": 0.1}, False),
    ):
        slide.update(changes)
        assert is_scara(load_rows(omron_rows)) == expected


def test_arm_without_any_lumped_inertia_has_no_lumped_masses(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
) -> None:
    """A turntable: its only joint goes through the centre of mass."""
    del omron_rows["joints"][1:], omron_rows["links"][1:], omron_rows["payload"]
    omron_rows["joints"][0]["a"] = 0.0
    omron_rows["links"][0]["com"] = [0.0, 0.0, 0.0]
    omron_rows["contact_points"] = {"rim": [0.2, 0.0, 0.0]}
    with pytest.raises(RobotError, match="the lumped mass matrix is singular: joint1 moves no lumped mass"):
        lump(load_rows(omron_rows))


@pytest.mark.parametrize(
    ("theta", "lower", "upper", "turn"),
    [(0.0, -0.5, 2.0, "1.571"), (0.0, -2.0, 0.5, "-1.571"), (math.pi / 2.0, -0.5, 1.0, "0.0")],
)
def test_arm_that_can_lie_along_its_first_axis_has_no_lumped_masses(
    omron_rows: dict[str, Any],
    load_rows: Callable[[object], Robot],
    theta: float,
    lower: float,
    upper: float,
    turn: str,
) -> None:
    """Only where it does, joint 1 moves no lumped mass: no sample of the configurations is there."""
    tensor = [0.03, 0.02, 0.025, 0.0, 0.0, 0.0]
    del omron_rows["joints"][2:], omron_rows["links"][2:], omron_rows["payload"]
    omron_rows["joints"][0] |= {"a": 0.0, "alpha": math.pi / 2.0}
    omron_rows["joints"][1] |= {"alpha": 0.0, "theta": theta, "lower": lower, "upper": upper}
    omron_rows["links"][0] |= {"com": [0.0, 0.0, 0.05], "inertia": tensor}
    omron_rows["links"][1] |= {"com": [0.1, 0.0, 0.0], "inertia": tensor}
    with pytest.raises(RobotError, match=rf"singular: joint1 moves no lumped mass at q = \[0.0, {turn}\]"):
        lump(load_rows(omron_rows))


def test_joints_that_move_the_same_masses_alike_have_no_lumped_masses(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
) -> None:
    """Two joints on one axis: each moves lumped mass, but M is singular."""
    del omron_rows["joints"][2:], omron_rows["links"][2:], omron_rows["payload"]
    omron_rows["joints"][0] |= {"a": 0.0, "alpha": 0.0}
    omron_rows["links"][0]["com"] = [0.0, 0.0, 0.05]
    with pytest.raises(RobotError, match=r"^the lumped mass matrix is not positive definite at q = "):
        lump(load_rows(omron_rows))


def test_negative_mass_is_not_regular_by_its_form(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
) -> None:
    for x, regular in ((0.05775, True), (0.275, True), (-0.03, False)):
        omron_rows["links"][1]["com"][0] = x
        assert lump(load_rows(omron_rows)).is_regular == regular
    omron_rows["links"][0]["com"][0], omron_rows["links"][1]["com"][0] = 0.275, 0.05775
    lumped = lump(load_rows(omron_rows))
    assert lumped.masses[0].mass == 0.0
    assert lumped.is_regular


class TestParallelAxes:
    """Two parallel joints; the inertia and the centre of mass of the first link vary."""

    @pytest.fixture
    def arm(self, omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]) -> Callable[..., Robot]:
        def build(com: tuple[float, float, float], inertia: list[float], **lumping: str) -> Robot:
            omron_rows["joints"], omron_rows["links"] = omron_rows["joints"][:2], omron_rows["links"][:2]
            omron_rows["links"][0] |= {"com": list(com), "inertia": inertia}
            return replace(load_rows(omron_rows), lumping=LumpingSettings.model_validate(lumping))

        return build

    @pytest.mark.parametrize("x", [0.0, 0.275])
    def test_mass_on_an_axis_is_within_the_slab(self, arm: Callable[..., Robot], x: float) -> None:
        (link, _) = lumped_links(arm((x, 0.0, 0.0), [0.02, 0.02, 0.03, 0.0, 0.0, 0.0]), within_slab=True)
        assert (link.problem, link.kappa2) == ("", x / 0.275)

    @pytest.mark.parametrize("ixz", [0.01, -0.01, 0.0])
    @pytest.mark.parametrize("x", [0.08, 0.2])
    def test_fit_has_the_nearest_tensor_of_all_spreads(self, arm: Callable[..., Robot], ixz: float, x: float) -> None:
        robot = arm((x, 0.0, 0.02), [0.05, 0.06, 0.02, 0.0, ixz, 0.0], free_parameters="fit_inertia")
        link, body = lump(robot).links[0], robot.model.inertias[1]
        spread = link.height2 - link.height1
        assert link.kappa1 * link.height1 + link.kappa2 * link.height2 == pytest.approx(0.02)

        def error(spread: float) -> float:
            r = np.array([0.275, 0.0, spread])
            share = body.mass * link.kappa1 * link.kappa2
            return float(np.linalg.norm(share * (r @ r * np.eye(3) - np.outer(r, r)) - body.inertia))

        assert abs(spread) > 0.05
        assert error(spread) <= min(map(error, np.linspace(-1.0, 1.0, 2001).tolist())) + 1e-12

    def test_fit_spreads_no_further_than_three_radii_of_gyration_beyond_the_axes(
        self, arm: Callable[..., Robot]
    ) -> None:
        """A mass near one axis has too small a share to reproduce a large inertia."""
        robot = arm((0.001, 0.0, 0.0), [2.0, 2.0, 0.03, 0.0, -0.1, 0.0], free_parameters="fit_inertia")
        link = lump(robot).links[0]
        assert abs(link.height2 - link.height1) == pytest.approx(0.275 + 3.0 * math.sqrt(4.03 / (3.0 * 2.74)))

    def test_unknown_inertia_is_not_fitted(self, arm: Callable[..., Robot], omron_rows: dict[str, Any]) -> None:
        omron_rows["payload"]["inertia"] = 0.0
        for body in omron_rows["links"]:
            body["inertia"] = 0.0
        robot = arm((0.08, 0.0, 0.02), [0.0] * 6, free_parameters="fit_inertia")
        assert robot.inertias_reason
        assert lump(robot).links[0].height1 == lump(robot).links[0].height2 == pytest.approx(0.02)
