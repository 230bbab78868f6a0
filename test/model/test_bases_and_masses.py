# SPDX-License-Identifier: Apache-2.0
"""Robots on bases that move in x, y and yaw, files without masses, and masses that no arm has."""

from pathlib import Path

import numpy as np
import pytest

from scara_effmass.errors import RobotError
from scara_effmass.model.load import build_robot, load_robot
from scara_effmass.model.robot import Robot
from scara_effmass.model.urdf import parse_urdf
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.safety.assumptions import assumptions_of
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import JointState, Verdict

INERTIA = '<inertia ixx="0.2" iyy="0.2" izz="0.2" ixy="0" ixz="0" iyz="0"/>'
UR5 = Path(__file__).resolve().parents[2] / "config" / "robots" / "ur5_robot.urdf"


def link(name: str, mass: float) -> str:
    if not mass:
        return f'<link name="{name}"/>'
    return f'<link name="{name}"><inertial><origin xyz="0 0 0.15"/><mass value="{mass}"/>{INERTIA}</inertial></link>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", axis: str = "0 0 1", place: str = "0 0 0") -> str:
    limit = '<limit lower="-2.9" upper="2.9" effort="500" velocity="2"/>'
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{place}"/><axis xyz="{axis}"/>{limit}</joint>'
    )


ARM = (
    *(link("l1", 4), link("l2", 3), link("l3", 2), link("tool", 0)),
    joint("j1", "chassis", "l1", place="0 0 0.5"),
    joint("j2", "l1", "l2", axis="0 1 0", place="0 0 0.3"),
    joint("j3", "l2", "l3", axis="0 1 0", place="0 0 0.3"),
    joint("mount", "l3", "tool", "fixed", place="0 0 0.3"),
)
WHEELS = (
    *(link("left", 1), link("right", 1)),
    joint("left_wheel", "chassis", "left", "continuous", "0 1 0", "0 0.3 0"),
    joint("right_wheel", "chassis", "right", "continuous", "0 1 0", "0 -0.3 0"),
)


def robot_of(*parts: str, **settings: object) -> Robot:
    chosen = MonitorSettings.model_validate(settings)
    return build_robot(parse_urdf(f'<robot name="r">{"".join(parts)}</robot>', "r.urdf", chosen), chosen)


def on_axes(step: str, mass: float = 0.0) -> Robot:
    """Return the arm on a base whose axes are `step` apart."""
    base = (
        *(link("odom", 0), link("bx", mass), link("by", mass), link("chassis", 60)),
        joint("base_x", "odom", "bx", "prismatic", "1 0 0"),
        joint("base_y", "bx", "by", "prismatic", "0 1 0", step),
        joint("base_yaw", "by", "chassis", "continuous", place=step),
    )
    return robot_of(*base, *WHEELS, *ARM)


@pytest.mark.parametrize("step", ["0 0 0", "0 0 0.03"])
def test_links_without_mass_between_the_axes_of_a_base_are_ordinary(step: str) -> None:
    robot = on_axes(step)
    assert robot.joint_names == ("base_x", "base_y", "base_yaw", "j1", "j2", "j3")
    assert (robot.masses_reason, robot.units_reason, robot.moving_mass) == ("", "", 71.0)
    assert "links without mass, which only join two joints: behind base_x, base_y" in robot.notes
    assert not any("gripper" in note or "counts as locked" in note for note in robot.notes)
    dynamics = RobotDynamics(robot)
    assert dynamics.full_reason == ""
    heavier = RobotDynamics(on_axes(step, 1e-6))
    q, qd = np.full(6, 0.2), np.array([0.3, -0.2, 0.5, 0.4, 0.3, 0.2])
    masses = [entry.at(q, qd).contacts[0].full for entry in (dynamics, heavier)]
    assert masses[0] == pytest.approx(masses[1], rel=1e-6)
    speed = dynamics.at(q, np.array([0.7, 0, 0, 0, 0, 0])).contacts[0].speed
    assert speed == pytest.approx(0.7)


def test_long_link_without_mass_lacks_its_mass() -> None:
    assert on_axes("0 0 0.04").masses_reason.startswith("no mass behind base_x, base_y: ")


@pytest.mark.parametrize("kind", ["planar", "floating"])
def test_planar_base_is_refused_by_name_or_held(kind: str) -> None:
    base = link("odom", 0), link("chassis", 60), joint("base_move", "odom", "chassis", kind)
    with pytest.raises(RobotError, match=rf"joint base_move: type = '{kind}': .*prismatic and continuous joints"):
        robot_of(*base, *WHEELS, *ARM)
    robot = robot_of(*base, *WHEELS, *ARM, locked_joints=("base_move",))
    assert robot.joint_names == ("j1", "j2", "j3")
    assert [held.name for held in robot.held] == ["base_move", "left_wheel", "right_wheel"]
    assert not any(held.is_harmless for held in robot.held)


def test_position_of_a_held_joint_counts_that_shapes_the_arm() -> None:
    """Neither do wheels, nor a slide below the arm; a joint in the arm, a second arm on it and a leaning base do."""
    other = link("arm", 2), joint("other", "l1", "arm", axis="0 1 0")
    base = (
        *(link("odom", 0), link("lift", 5), link("chassis", 60)),
        joint("rise", "odom", "lift", "prismatic").replace("-2.9", "0.2"),
        joint("lean", "lift", "chassis", axis="0 1 0").replace("-2.9", "0.1"),
    )
    robot = robot_of(*base, *WHEELS, *ARM, *other, contact_points=("tool",), locked_joints=("rise", "lean", "j2"))
    positions = {held.name: held.position for held in robot.held}
    nan = pytest.approx(float("nan"), nan_ok=True)
    assert positions == {"rise": nan, "lean": 0.1, "j2": 0.0, "other": 0.0, "left_wheel": nan, "right_wheel": nan}
    assert [held.name for held in robot.held if held.is_expected] == ["other"]  # locked_joints state the others


def test_wheels_must_be_reported_where_the_model_does_not_move_the_base() -> None:
    """Unseen, the base may drive. A steered caster, a turning scanner and one below x, y, yaw joints need not be."""
    others = (
        *(link("caster", 1), link("caster_wheel", 1), link("scanner", 1)),
        joint("swivel", "chassis", "caster", "continuous"),
        joint("caster_turn", "caster", "caster_wheel", "continuous", "0 1 0"),
        joint("scan", "chassis", "scanner", "continuous"),
    )
    roller = (link("roller", 0.1), joint("rolling", "left", "roller", "continuous", "1 0 0"))
    wheels = [
        joint.name for joint in robot_of(link("chassis", 60), *WHEELS, *roller, *others, *ARM).held if joint.is_expected
    ]
    assert wheels == ["left_wheel", "right_wheel"]
    assert not any(joint.is_expected for joint in on_axes("0 0 0").held)
    swerve = [joint.name for joint in robot_of(link("chassis", 60), *others, *ARM).held if joint.is_expected]
    assert swerve == ["caster_turn"]  # without other wheels, a steered one drives
    parked = robot_of(link("chassis", 60), *WHEELS, *ARM, locked_joints=("*_wheel",))
    assert not any(joint.is_expected for joint in parked.held)


def test_mimic_of_a_joint_that_does_not_exist_is_noted() -> None:
    wheels = "".join(WHEELS).replace("<axis", '<mimic joint="motor"/><axis', 1)
    robot = robot_of(link("chassis", 60), wheels, *ARM, contact_points=("tool",))
    assert "mimic a joint that does not exist: left_wheel" in robot.notes


def with_masses(*masses: float) -> Robot:
    scaled = (link(f"l{i}", mass).replace('"0.2"', f'"{0.02 * mass}"') for i, mass in enumerate(masses, 1))
    return robot_of(link("chassis", 60), *scaled, link("tool", 0), *ARM[4:], contact_points=("tool",))


@pytest.mark.parametrize(("masses", "light"), [((4, 3, 2), ""), ((4, 0.02, 2), "j2"), ((4, 3, 1e-6), "j3")])
def test_link_of_an_arm_without_its_mass_gives_no_masses(masses: tuple[float, ...], light: str) -> None:
    reason = with_masses(*masses).masses_reason
    assert reason.startswith(
        f"{min(masses):.3g} kg in the 0.3 m long link behind {light}, less than" if light else reason
    )
    assert bool(reason) == bool(light)


@pytest.mark.parametrize(("place", "equal"), [("0 0 0.3", False), ("0 0 0.1", True)])
def test_equal_inertias_of_three_unequal_links_are_placeholders(place: str, equal: bool) -> None:  # noqa: FBT001
    links = (link(f"l{i}", 3) for i in (1, 2, 3))
    joints = *ARM[4:6], joint("j3", "l2", "l3", axis="0 1 0", place=place), ARM[7]
    robot = robot_of(link("chassis", 60), *links, link("tool", 0), *joints, contact_points=("tool",))
    remedy = "placeholders, not data: correct the masses, or state moving_mass"
    text = f"equal masses and inertias of unequal links, behind j1, j2, j3: {remedy}" if equal else ""
    assert (robot.masses_reason, robot.coms_reason, robot.inertias_reason) == (text, text, text)


def test_last_of_equal_modules_needs_no_frame_at_its_end() -> None:
    modules = [link(f"l{i}", 3) for i in range(1, 5)]
    joints = (joint(f"j{i}", f"l{i - 1}", f"l{i}", axis="0 1 0", place="0 0 0.3") for i in (2, 3, 4))
    assert robot_of(link("chassis", 60), *modules, ARM[4], *joints).masses_reason == ""


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_one_axis_without_a_frame_at_its_end_is_not_taken_for_one_in_grams(kind: str) -> None:
    robot = robot_of(link("rail", 0), link("table", 5), joint("axis", "rail", "table", kind))
    assert robot.units_reason == ""
    assert any(note.startswith("check the lengths: reach 0 m") for note in robot.notes)


def test_inertia_of_a_link_that_does_not_move_may_be_impossible() -> None:
    base = link("chassis", 60).replace('ixx="0.2"', 'ixx="-0.2"')
    assert robot_of(base, *ARM, contact_points=("tool",)).masses_reason == ""


@pytest.mark.parametrize(("globs", "names"), [(("j9",), "j9"), (("J1",), "")])
def test_locked_joints_that_match_none_are_refused(globs: tuple[str, ...], names: str) -> None:
    parts = (link("chassis", 60), *ARM)
    if not names:
        assert robot_of(*parts, contact_points=("tool",), locked_joints=globs).joint_names == ("j2", "j3")
        return
    with pytest.raises(RobotError, match=f"r.urdf: locked_joints = '{names}': must match a joint: j1, j2, j3"):
        robot_of(*parts, contact_points=("tool",), locked_joints=globs)


BARE = [link(f"l{i}", 0) for i in range(4)]
BARE += [joint(f"a{i}", f"l{i}", f"l{i + 1}", axis="0 1 0", place="0 0 0.3") for i in range(3)]
BARE += [link("flange", 0), joint("end", "l3", "flange", "fixed", place="0.3 0 0")]


def test_file_without_masses_needs_a_stated_one() -> None:
    with pytest.raises(RobotError, match=r"r\.urdf: the moving links have no mass: .*or state moving_mass"):
        robot_of(*BARE)


@pytest.mark.parametrize("model", ["auto", "iso"])
def test_stated_mass_gives_the_mass_of_iso(model: str) -> None:
    settings = MonitorSettings.model_validate(
        {
            "moving_mass": 20.0,
            "payload_mass": 2.0,
            "effective_mass_model": model,
            "accept_assumptions": ("rotor_inertia", "contact_area", "person_speed", "contact_points", "acceleration"),
            "contact_damping": 0.0,
            "contact_friction": 0.0,
        }
    )
    robot = build_robot(parse_urdf(f'<robot name="r">{"".join(BARE)}</robot>', "r.urdf", settings), settings)
    assert (robot.masses_reason, robot.moving_mass, robot.iso_mass) == ("", 20.0, 12.0)
    assert robot.coms_reason == "moving_mass is stated, so ISO's mass counts"
    assert np.isinf(robot.effort_limits).all()
    dynamics = RobotDynamics(robot)
    assert [point.name for point in assumptions_of(robot, settings).limiting] == ["MASSES"]
    monitor = Monitor(dynamics, settings, use_reference=True)
    now = 10**15
    decision = monitor.assess(JointState(now, robot.joint_names, np.full(3, 0.3), np.full(3, 0.01)), now)
    assert decision is not None
    (contact,) = decision.contacts
    assert (contact.verdict, contact.effective_mass) == (Verdict.WARN, 12.0)
    accepted = settings.model_copy(update={"accept_assumptions": (*settings.accept_assumptions, "masses")})
    monitor = Monitor(dynamics, accepted, use_reference=True)
    decision = monitor.assess(JointState(now, robot.joint_names, np.full(3, 0.3), np.full(3, 0.01)), now)
    assert decision is not None
    assert decision.contacts[0].verdict is Verdict.OK


def test_stated_mass_replaces_those_of_the_file() -> None:
    robot = load_robot(UR5, MonitorSettings(moving_mass=25.0))
    assert (robot.moving_mass, robot.iso_mass) == (25.0, 12.5)
    assert RobotDynamics(robot).full_reason


def scaled_ur5(factor: float, **settings: object) -> Robot:
    chosen, text = MonitorSettings.model_validate(settings), UR5.read_text(encoding="utf-8")
    parts = text.split('<mass value="')
    for i, part in enumerate(parts[1:], start=1):
        number, _, rest = part.partition('"')
        parts[i] = f'{float(number) * factor}"{rest}'
    return build_robot(parse_urdf('<mass value="'.join(parts), "ur5.urdf", chosen), chosen)


def test_mass_that_no_arm_of_that_reach_has_does_not_count() -> None:
    """0.66 kg for six axes of 0.94 m reach; the lightest of 50 arms has 4 kg per cubic metre."""
    robot = scaled_ur5(0.66 / 17.0)
    assert robot.masses_reason.startswith("0.66 kg move at a reach of 0.9")
    assert robot.masses_reason == robot.coms_reason == robot.inertias_reason
    assert RobotDynamics(robot).full_reason == robot.masses_reason
    assert scaled_ur5(0.66 / 17.0, moving_mass=18.0).masses_reason == ""
    assert scaled_ur5(0.2).masses_reason == ""
