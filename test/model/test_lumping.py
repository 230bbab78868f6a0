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

from scara_effmass.errors import RobotError
from scara_effmass.model.dynamics import EffectiveMasses, RobotDynamics
from scara_effmass.model.lumping import LumpedModel, is_scara, lump
from scara_effmass.model.robot import Robot
from scara_effmass.model.scara_closed_form import scara_lumped_mass

shared_fixture_settings = settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])


def centres_of_mass_agree(lumped: LumpedModel, robot: Robot) -> bool:
    return all(
        np.allclose(link.kappa1 * np.array(link.point1) + link.kappa2 * np.array(link.point2), body.lever, atol=1e-4)
        for link, body in zip(lumped.links, list(robot.model.inertias)[1:], strict=True)
    )


def test_structure_of_table_2(omron_dynamics: RobotDynamics) -> None:
    lumped = omron_dynamics.lumped
    assert lumped is not None
    assert [link.kappa2 for link in lumped.links] == pytest.approx([0.08029 / 0.275, 0.05775 / 0.275, 0.5, 0.5])
    assert all(link.on_axes for link in lumped.links)
    assert lumped.massless_joints == (3,)
    assert is_scara(omron_dynamics.robot)


@pytest.mark.parametrize("end", [0, 1])
def test_heights_are_measured_along_each_axis(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot], end: int
) -> None:
    omron_rows["links"][end]["com"][2] = 0.05
    link = lump(load_rows(omron_rows)).links[end]
    # The axis after link 2 points the other way (alpha = pi), as the paper's q3 does.
    assert (link.height1, link.height2) == pytest.approx((0.05, -0.05 if end else 0.05))


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
        (masses,) = dynamics.effective_masses(np.array([0.2, 0.0, 0.1, 0.0]), np.ones(4), 0.005)
        assert math.isnan(masses.lumped)
        assert masses.full > 0.0

    def test_negative_mass_on_the_forearm_adds_to_the_coaxial_tool(
        self, omron_rows: dict[str, Any], load_rows: Callable[[object], Robot], along: Callable[..., EffectiveMasses]
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

    def test_of_a_coaxial_tool_raises(self, omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]) -> None:
        omron_rows["payload"]["com"] = [0.05, 0.0, 0.0]
        with pytest.raises(RobotError, match=r"behind joint4: .* 35\.7 mm off the plane"):
            lump(load_rows(omron_rows))

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


@pytest.mark.parametrize("alpha", [0.01, -1.5707963, 3.0])
def test_axes_that_are_not_parallel_raise(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot], alpha: float
) -> None:
    omron_rows["joints"][0]["alpha"] = alpha
    for body in (*omron_rows["links"], omron_rows["payload"]):
        body["inertia"] = [body["inertia"]] * 3 + [0.0] * 3
    robot = load_rows(omron_rows)
    with pytest.raises(RobotError, match="behind joint1: its axes are not parallel"):
        lump(robot)
    assert not is_scara(robot)


def test_pi_written_as_3_14_is_parallel(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot], omron_dynamics: RobotDynamics
) -> None:
    omron_rows["joints"][1]["alpha"] = 3.14
    sloppy = RobotDynamics(load_rows(omron_rows))
    for q in sloppy.robot.sample_configurations():
        (exact,), (rough,) = (
            dynamics.effective_masses(q, np.array([1.0, 0.3, 0.0, 0.0]), 0.0) for dynamics in (omron_dynamics, sloppy)
        )
        assert rough.lumped == pytest.approx(exact.lumped, rel=0.01)


def test_urdf_with_pi_written_as_3_14_has_a_lumped_model(load_urdf_file: Callable[..., Robot]) -> None:
    robot = load_urdf_file("scara_icube_tutorial.urdf")
    assert lump(robot).aggregated == pytest.approx((0.75, 1.0, 0.85, 0.1), abs=1e-3)


def test_six_axis_arm_has_no_lumped_model(load_urdf_file: Callable[..., Robot]) -> None:
    dynamics = RobotDynamics(load_urdf_file("ur5_robot.urdf"))
    assert dynamics.lumped is None
    assert "shoulder_pan_joint: its axes are not parallel" in dynamics.lumped_reason
    assert dynamics.full_reason == ""


def test_base_pose_has_no_effect(omron_dynamics: RobotDynamics, along: Callable[..., EffectiveMasses]) -> None:
    q, n = np.array([0.4, 1.2, 0.1, 0.3]), np.array([0.6, 0.8, 0.0])
    model = omron_dynamics.robot.model.copy()
    base = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.2, 0.9), np.array([1.0, 2.0, 3.0]))
    model.jointPlacements[1] = base * model.jointPlacements[1]
    moved = RobotDynamics(replace(omron_dynamics.robot, model=model))
    here, there = along(omron_dynamics, q, n), along(moved, q, base.rotation @ n)
    assert there.lumped == pytest.approx(here.lumped, rel=1e-9)
    assert there.full == pytest.approx(here.full, rel=1e-9)
    assert there.worst_lumped == pytest.approx(here.worst_lumped, rel=1e-9)


@shared_fixture_settings
@given(
    first=st.floats(0.05, 0.6), second=st.floats(0.05, 0.6), share1=st.floats(0.01, 0.99), share2=st.floats(0.01, 0.99)
)
def test_lumped_mass_of_any_scara_is_eq_28(
    omron_rows: dict[str, Any],
    load_rows: Callable[[object], Robot],
    along: Callable[..., EffectiveMasses],
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
    (masses,) = dynamics.effective_masses(np.array([0.4, 1.2, 0.1, 0.3]), np.ones(4), 0.005)
    assert math.isnan(masses.full)
    assert math.isnan(masses.worst_full)
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
    assert bool(RobotDynamics(robot).lumped_reason) != parallel
