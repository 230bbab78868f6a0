# SPDX-License-Identifier: Apache-2.0
"""URDF: the test robots, and every wrong value is named in one line."""

import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scara_effmass.errors import RobotError
from scara_effmass.model.load import build_robot
from scara_effmass.model.lumping import is_scara
from scara_effmass.model.robot import Robot
from scara_effmass.model.urdf import load_urdf, parse_urdf
from scara_effmass.reference import ContactState, RobotDynamics
from scara_effmass.settings import MonitorSettings
from scara_effmass.studies.scara import ScaraInertia, scara_full_mass


def link(name: str, mass: float, com: str = "0.1 0 0", moments: str = "0.001 0.02 0.02") -> str:
    ixx, iyy, izz = moments.split()
    return (
        f'<link name="{name}"><inertial><origin xyz="{com}"/><mass value="{mass}"/>'
        f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def joint(name: str, parent: str, child: str, kind: str = "revolute", origin: str = "0 0 0", inside: str = "") -> str:
    limit = '<limit lower="-2" upper="2" effort="1" velocity="3"/>' if kind in {"revolute", "prismatic"} else ""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{origin}"/><axis xyz="0 0 1"/>{inside or limit}</joint>'
    )


PARTS = (
    '<link name="base"/>',
    link("upper", 2.74, "0.08029 0 0", "0.02 0.02 0.02952"),
    link("fore", 2.0, "0.05775 0 0", "0.02 0.02 0.02272"),
    link("slide", 0.2, "0 0 0", "0.0001 0.0001 0.0001"),
    link("tool", 0.1, "0 0 0", "0.0002 0.0002 0.0002"),
    '<link name="tip"/>',
    joint("j1", "base", "upper"),
    joint("j2", "upper", "fore", origin="0.275 0 0"),
    joint("j3", "fore", "slide", "prismatic", origin="0.275 0 0"),
    joint("j4", "slide", "tool", "continuous"),
    joint("weld", "tool", "tip", "fixed"),
)
SCARA = f'<robot name="scara">{"".join(PARTS)}</robot>'


def parse(text: str = SCARA, **options: object) -> Robot:
    """Parse a URDF with the monitor settings `options`."""
    settings = MonitorSettings.model_validate(options)
    return build_robot(parse_urdf(text, "scara.urdf", settings), settings)


def with_more(*parts: str) -> str:
    return SCARA.replace("</robot>", "".join(parts) + "</robot>")


class TestRobotFiles:
    @pytest.mark.parametrize(
        ("name", "joints", "moving_mass", "doubt"),
        [
            ("ur5_robot.urdf", 6, 16.9939, ""),
            ("ur10_robot.urdf", 6, 28.7, ""),
            ("panda.urdf", 7, 16.822132, ""),
            ("wx200.urdf", 5, 1.834 - 0.540, ""),
            ("tm5-700-nominal.urdf", 6, 18.674, "centre of mass"),
            ("tm12-nominal.urdf", 6, 28.7836, "centre of mass"),
            ("scara_denso_hsr065a1_n32.urdf", 4, 4.0, "mass 1 and identity inertia"),
            ("scara_icube_tutorial.urdf", 3, 2.7, "inertia tensor"),
        ],
    )
    def test_masses_and_plausibility(
        self, load_urdf_file: Callable[..., Robot], name: str, joints: int, moving_mass: float, doubt: str
    ) -> None:
        robot = load_urdf_file(name)
        assert len(robot.joint_names) == joints
        assert robot.moving_mass == pytest.approx(moving_mass, abs=5e-4)
        assert robot.iso_mass == pytest.approx(moving_mass / 2.0, abs=5e-4)
        assert ("placeholders" in robot.inertias_reason) == bool(doubt)
        assert doubt in robot.inertias_reason
        dynamics = RobotDynamics(robot)
        masses, *_ = dynamics.at(robot.sample_configurations()[5], np.ones(joints)).contacts
        assert np.isnan(masses.full) == bool(doubt)

    def test_wx200_gripper_is_fixed_and_placeholders_are_noted(self, load_urdf_file: Callable[..., Robot]) -> None:
        robot = load_urdf_file("wx200.urdf")
        assert robot.joint_names == ("waist", "shoulder", "elbow", "wrist_angle", "wrist_rotate")
        assert "held fixed in the model: gripper, left_finger, right_finger" in robot.notes
        assert any("placeholder inertia" in note and "ee_arm_link" in note for note in robot.notes)

    def test_denso_masses_stay_implausible_with_a_payload(self, load_urdf_file: Callable[..., Robot]) -> None:
        robot = load_urdf_file("scara_denso_hsr065a1_n32.urdf", payload_mass=1.5)
        assert robot.masses_reason
        assert robot.iso_mass == pytest.approx(4.0 / 2.0 + 1.5)

    def test_finger_that_mimics_is_held(self, load_urdf_file: Callable[..., Robot]) -> None:
        robot = load_urdf_file("panda.urdf", locked_joints=(), contact_points=("panda_rightfinger",))
        assert robot.joint_names[-1] == "panda_joint7"


def test_urdf_agrees_with_eq_27(along: Callable[..., ContactState]) -> None:
    robot = parse(payload_mass=0.25)
    assert is_scara(robot)
    dynamics = RobotDynamics(robot)
    scara = ScaraInertia(0.275, 0.275, 2.74, 2.0, 0.2, 0.35, 0.08029, 0.05775, 0.02952, 0.02272, 1e-4, 2e-4)
    for q in robot.sample_configurations():
        n = [np.cos(0.7), np.sin(0.7), 0.0]
        assert along(dynamics, q, n).full == pytest.approx(float(scara_full_mass(q[0], q[1], 0.7, scara)), rel=1e-6)
    assert dynamics.lumped is not None
    assert dynamics.lumped.planar_masses(robot) == pytest.approx((2.38, 0.97), abs=1e-3)


def test_iso_mass_with_a_payload() -> None:
    robot = parse(payload_mass=0.25)
    assert robot.moving_mass == pytest.approx(5.04)
    assert robot.iso_mass == pytest.approx(2.77)
    assert parse().iso_mass == pytest.approx(2.52)


def test_default_contact_point_is_the_tip_with_a_note() -> None:
    robot = parse()
    assert list(robot.contact_frames) == ["tip"]
    assert any("contact point tip: the end of the longest chain" in note for note in robot.notes)


@pytest.mark.parametrize(
    ("branch", "tip"),
    [
        (joint("a", "slide", "probe", "continuous"), "tip"),  # as many moving joints, fewer joints
        (joint("a", "tip", "probe", "fixed"), "probe"),
        (joint("a", "base", "mid", "fixed") + '<link name="mid"/>' + joint("b", "mid", "probe", "fixed"), "tip"),
    ],
)
def test_longest_chain_has_most_moving_joints_then_most_joints(branch: str, tip: str) -> None:
    robot = parse(with_more('<link name="probe"/>', branch))
    assert list(robot.contact_frames) == [tip]


@pytest.mark.parametrize("locked", [(), ("tool",), ("j1",)])
def test_joint_may_have_the_name_of_a_link(locked: tuple[str, ...]) -> None:
    text = SCARA.replace('joint name="j4"', 'joint name="tool"').replace('joint name="weld"', 'joint name="tip"')
    robot = parse(text, contact_points=("tool", "tip"), locked_joints=locked)
    other = parse(contact_points=("tool", "tip"), locked_joints=[name.replace("tool", "j4") for name in locked])
    assert robot.joint_names == tuple(name.replace("j4", "tool") for name in other.joint_names)
    assert [held.name for held in robot.held] == [*locked]
    q, qd = np.full(robot.model.nv, 0.3), np.ones(robot.model.nv)
    contacts, others = (RobotDynamics(each).at(q, qd).contacts for each in (robot, other))
    assert [contact.full for contact in contacts] == [contact.full for contact in others]


def test_continuous_joint_keeps_one_coordinate_up_to_a_million_radians() -> None:
    robot = parse()
    assert robot.model.nq == robot.model.nv == 4
    assert robot.model.upperPositionLimit[3] == -robot.model.lowerPositionLimit[3] == 1e6


def test_inertial_without_origin_is_at_the_origin_of_its_link() -> None:
    text = re.sub('<inertial><origin xyz="[^"]*"/>', "<inertial>", SCARA)
    assert parse(text).coms_reason == "every centre of mass lies at its link's origin: placeholders, not data"


@pytest.mark.parametrize("rpy", ["0 0", "a b c", "0 0 1_0"])
def test_inertial_that_pinocchio_would_leave_out_is_refused(rpy: str) -> None:
    """Without it the robot would be lighter."""
    text = SCARA.replace('<origin xyz="0.05775 0 0"/>', f'<origin xyz="0.05775 0 0" rpy="{rpy}"/>')
    with pytest.raises(RobotError, match=rf"scara.urdf: link fore: <origin rpy> = '{rpy}': must be 3 finite numbers"):
        parse(text)


@pytest.mark.parametrize("number", ["2_0", "\uff12", "2.0.", "0x2", "2 2"])
def test_number_that_pinocchio_reads_otherwise_is_refused(number: str) -> None:
    with pytest.raises(RobotError, match=r"scara.urdf: link fore: <mass value> = .*: must be 1 finite number"):
        parse(SCARA.replace('<mass value="2.0"/>', f'<mass value="{number}"/>'))


class TestBranches:
    """A torso, j1, with the rest of the SCARA as an arm and, named to come last in the model, a head."""

    HEAD = link("head", 1.0, "0.05 0 0", "0.001 0.002 0.002"), joint("neck", "upper", "head", origin="0 0 0.3")

    @pytest.mark.parametrize(("points", "carrier"), [(("tip", "head"), "j4"), (("head", "tip"), "neck")])
    def test_payload_moves_with_the_point_named_first(self, points: tuple[str, ...], carrier: str) -> None:
        robot, bare = (parse(with_more(*self.HEAD), contact_points=points, payload_mass=m) for m in (5.0, 0.0))
        index = robot.model.getJointId(carrier)
        assert list(robot.joint_names) == ["j1", "j2", "j3", "j4", "neck"]
        assert robot.model.inertias[index].mass == pytest.approx(bare.model.inertias[index].mass + 5.0)
        assert f"the payload moves with {carrier}: name the point that carries it first" in robot.notes
        assert not any("the payload moves" in note for note in (*bare.notes, *parse(payload_mass=5.0).notes))

    def test_payload_is_no_load_of_a_joint_with_others_beyond(self) -> None:
        points = ("elbow=upper: 0.2 0 0", "tip", "head")
        robot = parse(with_more(*self.HEAD), contact_points=points, payload_mass=5.0)
        assert robot.model.inertias[robot.model.getJointId("j4")].mass == pytest.approx(5.1)


class TestFixedJoints:
    GRIPPER = (
        link("jaw", 0.3, "0.02 0 0", "0.0001 0.0001 0.0001"),
        joint("gripper_slide", "tool", "jaw", "prismatic"),
    )

    def test_locked_joints_add_mass_but_no_motion(self) -> None:
        robot = parse(with_more(*self.GRIPPER), locked_joints=("GRIPPER*",))
        assert robot.joint_names == ("j1", "j2", "j3", "j4")
        assert robot.moving_mass == pytest.approx(5.34)

    @pytest.mark.parametrize("kind", ["revolute", "prismatic", "floating", "planar"])
    def test_joints_beside_the_chain_are_fixed(self, kind: str) -> None:
        robot = parse(with_more(link("flap", 0.3), joint("side", "fore", "flap", kind)))
        assert robot.joint_names == ("j1", "j2", "j3", "j4")
        assert robot.model.nq == 4
        assert robot.moving_mass == pytest.approx(5.34)
        assert "held fixed in the model: side" in robot.notes

    def test_joints_beyond_a_link_fixed_to_the_arm_move(self) -> None:
        """Held, the joints beyond would change the mass at the cover several-fold."""
        cover = joint("screws", "upper", "shell", "fixed") + joint("glue", "shell", "cover", "fixed", "0.2 0 0")
        by_link = parse(with_more('<link name="shell"/><link name="cover"/>', cover), contact_points=("cover",))
        by_place = parse(contact_points=("cover=upper: 0.2 0 0",))
        assert by_link.joint_names == by_place.joint_names == ("j1", "j2", "j3", "j4")
        q, qd = np.array([0.3, 1.2, 0.1, 0.0]), np.ones(4)
        masses = [RobotDynamics(robot).at(q, qd).contacts[0].full for robot in (by_link, by_place)]
        assert masses[0] == pytest.approx(masses[1])

    @pytest.mark.parametrize(("jaw", "joints"), [(0.3, 4), (0.7, 5)])
    def test_gripper_beyond_a_fixed_link_is_held_if_its_jaws_are_light(self, jaw: float, joints: int) -> None:
        slide = joint("clamp", "tool", "jaw", "prismatic")
        robot = parse(with_more(link("jaw", jaw, "0.02 0 0", "0.0001 0.0001 0.0001"), slide), contact_points=("tip",))
        assert len(robot.joint_names) == joints

    def test_locked_joint_below_a_contact_point_is_held(self) -> None:
        robot = parse(contact_points=("tip",), locked_joints=("j2",))
        assert robot.joint_names == ("j1", "j3", "j4")
        assert "held fixed in the model: j2" in robot.notes

    @pytest.mark.parametrize("limit", ["", '<limit effort="1" velocity="3"/>', '<limit lower="0" upper="0"/>'])
    def test_locked_joints_need_no_limits(self, limit: str) -> None:
        text = with_more(link("jaw", 0.3), joint("gripper", "tool", "jaw", inside=limit or " "))
        robot = parse(text, locked_joints=("gripper",))
        assert robot.joint_names == ("j1", "j2", "j3", "j4")
        with pytest.raises(
            RobotError, match=r'joint gripper: .*, in the file or as joint_limits "gripper=LOWER UPPER"'
        ):
            parse(text, locked_joints=())
        beside = text.replace('parent link="tool"/><child link="jaw"', 'parent link="base"/><child link="jaw"')
        assert parse(beside, locked_joints=()).joint_names == ("j1", "j2", "j3", "j4")

    def test_limit_of_a_held_joint_is_a_number(self) -> None:
        text = with_more(link("jaw", 0.3), joint("gripper", "tool", "jaw", inside='<limit upper="nan"/>'))
        with pytest.raises(RobotError, match="joint gripper: <limit upper> = 'nan': must be 1 finite number"):
            parse(text)

    @pytest.mark.parametrize("limit", ["", '<limit lower="0" upper="0" effort="1" velocity="3"/>', "<limit/>"])
    def test_limits_by_option(self, limit: str) -> None:
        stated = '<limit lower="-2" upper="2" effort="1" velocity="3"/>'
        robot = parse(SCARA.replace(stated, limit, 1), joint_limits=("j1=-0.5 0.7", "j4=-1 1"))
        assert robot.model.lowerPositionLimit.tolist() == [-0.5, -2.0, -2.0, -1.0]
        assert robot.model.upperPositionLimit.tolist() == [0.7, 2.0, 2.0, 1.0]
        with pytest.raises(
            RobotError, match=r"scara.urdf: joint_limits = 'j5': must be one of j1, j2, j3, j4|must be j"
        ):
            parse(joint_limits=("j5=-1 1",))

    def test_joints_beyond_a_contact_point_move(self) -> None:
        # The masses at the elbow depend on the pose of the forearm, so q2 must stay in the model.
        robot = parse(contact_points=("fore",), payload_mass=0.25)
        assert robot.joint_names == ("j1", "j2", "j3", "j4")
        dynamics = RobotDynamics(robot)
        stretched, folded = (
            dynamics.at(np.array([0.3, q2, 0.1, 0.0]), np.array([1.0, 0.0, 0.0, 0.0])).contacts[0] for q2 in (0.0, 1.5)
        )
        assert stretched.full != pytest.approx(folded.full, rel=0.05)
        assert dynamics.lumped is not None
        assert dynamics.lumped.planar_masses(robot) == pytest.approx((2.38, 0.97), abs=1e-3)

    def test_payload_is_at_the_tip_for_any_contact_points(self) -> None:
        masses = [
            [body.mass for body in list(parse(contact_points=points, payload_mass=0.25).model.inertias)[1:]]
            for points in (("tip",), ("fore", "tip"), ("tip", "fore"), ("upper",))
        ]
        assert masses == [[2.74, 2.0, 0.2, pytest.approx(0.35)]] * 4

    @pytest.mark.parametrize("points", [("tip",), ("upper",), ("upper", "fore")])
    def test_payload_has_its_centre_of_mass_at_the_tip(self, points: tuple[str, ...]) -> None:
        weld = joint("weld", "tool", "tip", "fixed")
        text = SCARA.replace(weld, joint("weld", "tool", "tip", "fixed", origin="0 0 0.3"))
        body = list(parse(text, contact_points=points, payload_mass=0.25).model.inertias)[-1]
        assert body.lever == pytest.approx((0.0, 0.0, 0.25 * 0.3 / 0.35))

    def test_contact_point_on_the_base_raises(self) -> None:
        for points in (("base",), ("tip", "base")):
            with pytest.raises(
                RobotError, match=r"scara\.urdf: contact_points = 'base': must not be fixed to the base"
            ):
                parse(contact_points=points)

    def test_all_joints_locked_raises(self) -> None:
        with pytest.raises(RobotError, match=r"scara\.urdf: contact_points = 'tip': must not be fixed to the base"):
            parse(locked_joints=("*",))

    def test_fixed_joint_is_at_zero_or_its_nearest_limit(self) -> None:
        limit = '<limit lower="0.5" upper="0.9" effort="1" velocity="3"/>'
        text = with_more(link("flap", 0.3, "0 0 0"), joint("side", "fore", "flap", "prismatic", inside=limit))
        body = parse(text).model.inertias[2]
        assert body.lever[2] == pytest.approx(0.3 * 0.5 / 2.3)


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("</robot>", "", "not XML"),
        ("<robot", "\x00<robot", "not XML"),
        ("robot", "sdf", "root element = <sdf>: must be <robot>; this is SDF: use the robot's URDF, or convert"),
        ("robot", "mujoco", "root element = <mujoco>: must be <robot>; this is MJCF: use the robot's URDF, or convert"),
        ("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ', None),
        ("</robot>", '<x:macro xmlns:x="http://www.ros.org/wiki/xacro" name="m"/></robot>', "xacro"),
        ("</robot>", '<xacro:property name="a" value="1"/></robot>', "must not contain xacro macros"),
        ('name="j2"', 'name="j1"', "joint 'j1': must have a unique name"),
        ('<joint name="j2"', "<joint", "joint '': must have a unique name"),
        ('<link name="fore"', '<link name="upper"', "link 'upper': must have a unique name"),
        ('<child link="fore"/>', "", "joint j2: child = '': must be a link"),
        ('<child link="fore"/>', '<child link="for"/>', "joint j2: child = 'for': must be a link"),
        ('<parent link="upper"/>', '<parent link="tip"/>', "must not form a loop"),
        ('<child link="upper"/>', '<child link="fore"/>', "link fore: must have one joint above it, not j1 and j2"),
        ('<parent link="base"/>', '<parent link="tip"/>', "link upper: the joints above it must not form a loop"),
        (
            '<link name="tip"/>',
            '<link name="tip"/><link name="loose"/>',
            "links without parent: base, loose",
        ),
        ('lower="-2"', 'lower="2"', "joint j1: limit lower = 2: must be < upper = 2"),
        ('lower="-2"', 'lower="2.0"', "joint j1: limit lower = 2: must be < upper = 2"),
        ('lower="-2"', 'lower="4"', "joint j1: limit lower = 4: must be < upper = 2"),
        ('lower="-2"', 'lower="nan"', "joint j1: <limit lower> = 'nan': must be 1 finite number"),
        ('velocity="3"', 'velocity="-3"', "joint j1: limit velocity = '-3': must not be negative"),
        ('velocity="3"', "", "joint j1: <limit velocity> = '': must be 1 finite number"),
        ('effort="1"', 'effort="-1"', "joint j1: limit effort = '-1': must not be negative"),
        ('effort="1"', 'effort="inf"', "joint j1: <limit effort> = 'inf': must be 1 finite number"),
        (
            '<axis xyz="0 0 1"/>',
            '<dynamics damping="x"/>',
            "joint j1: <dynamics damping> = 'x': must be 1 finite number",
        ),
        (
            '<axis xyz="0 0 1"/>',
            '<dynamics friction="1 N"/>',
            "joint j1: <dynamics friction> = '1 N': must be 1 finite",
        ),
        ('<limit lower="-2" upper="2" effort="1" velocity="3"/>', "", "joint j1: must have <limit>"),
        ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 0"/>', "joint j1: axis = '0 0 0': must have a direction"),
        ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 9e-10"/>', "joint j1: axis = '0 0 9e-10': must have a direction"),
        ('<axis xyz="0 0 1"/>', '<axis xyz="0 1"/>', "joint j1: <axis xyz> = '0 1': must be 3 finite numbers"),
        ('type="revolute"', 'type="floating"', "joint j1: type = 'floating': must be"),
        ('type="revolute"', 'type="ball"', "joint j1: type = 'ball': must be"),
        ('<axis xyz="0 0 1"/>', '<mimic joint="j3"/>', "joint j1: must not mimic j3, which moves: remove <mimic>, and"),
        ("upper", "universe", "link universe: must have another name"),
        ('<parent link="tool"/>', '<parent link="tool"/><mimic joint="j1"/>', None),  # of a fixed joint
        ('mass value="2.0"', 'mass value="1000000"', None),
        (
            'mass value="2.0"',
            'mass value="1000000.5"',
            r"link fore: <mass value> = '1000000.5': must be at most 1e\+06",
        ),
        ('mass value="2.0"', 'mass value="-2.0"', "link fore: mass = -2: must not be negative"),
        ('mass value="2.0"', 'mass value="nan"', "link fore: <mass value> = 'nan': must be 1 finite number"),
        ('mass value="2.0"', 'mass value="heavy"', "link fore: <mass value> = 'heavy'"),
        ('<mass value="2.0"/>', "", "link fore: <inertial> must have <mass> and <inertia>"),
        ('izz="0.02272"', 'izz="inf"', "link fore: <inertia izz> = 'inf'"),
        ('ixx="0.02" iyy="0.02" izz="0.02272"', 'ixx="0" iyy="0" izz="-2e-35"', None),  # rounding
        ('izz="0.02272"', 'izz="-0.02272"', "link fore: inertia: principal moments .*must not be negative"),
        (
            'xyz="0.05775 0 0"',
            'xyz="0.05775 0 0" rpy="0 90 0"',
            "link fore: <origin rpy> = '0 90 0': must be in",
        ),
        ('ixx="0.02"', "", "link upper: <inertia ixx> = '': must be 1 finite number"),
        ('xyz="0.05775 0 0"', 'xyz="0.05775 0"', "link fore: <origin xyz> = '0.05775 0': must be 3 finite numbers"),
        ('<origin xyz="0.275 0 0"/>', '<origin xyz="0.275 zero 0"/>', "joint j2: <origin xyz> = '0.275 zero 0'"),
        ('<origin xyz="0.275 0 0"/>', '<origin xyz="0 0 0" rpy="nan 0 0"/>', "joint j2: <origin rpy> = 'nan 0 0'"),
        ('<origin xyz="0.275 0 0"/>', '<origin xyz="0.275 0 0" rpy="0 0 -7"/>', None),
        ('<origin xyz="0.275 0 0"/>', '<origin xyz="0 0 0" rpy="0 0 -7.1"/>', "joint j2: <origin rpy> = '0 0 -7.1'"),
    ],
)
def test_wrong_value_is_named(old: str, new: str, named: str | None) -> None:
    text = SCARA.replace(old, new) if old == "robot" else SCARA.replace(old, new, 1)
    assert text != SCARA
    if named is None:
        assert parse(text).joint_names == ("j1", "j2", "j3", "j4")
        return
    with pytest.raises(RobotError, match=rf"scara\.urdf: .*{named}") as error:
        parse(text)
    assert "\n" not in str(error.value)


def test_material_without_colour_is_no_news(capfd: pytest.CaptureFixture[str]) -> None:
    parse(with_more('<material name="grey"/>'))
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("more", "problem"), [(495, "joint '': must have a unique name"), (496, "501 joints: must be")]
)
def test_file_has_at_most_500_joints(more: int, problem: str) -> None:
    with pytest.raises(RobotError, match=rf"scara\.urdf: {problem}"):
        parse(with_more(*["<joint/>"] * more))


def test_unknown_contact_point_names_the_links() -> None:
    with pytest.raises(RobotError, match=r"scara\.urdf: contact_points = 'nose': must be one of .*base, fore"):
        parse(contact_points=("nose",))


def test_loop_beside_the_chain_raises() -> None:
    loop = ('<link name="a"/><link name="b"/>', joint("ab", "a", "b", "fixed"), joint("ba", "b", "a", "fixed"))
    with pytest.raises(RobotError, match="must not form a loop"):
        parse(with_more(*loop))


def test_no_masses_and_no_joints_raise() -> None:
    bare = SCARA
    for part in PARTS[1:5]:
        bare = bare.replace(part, f'<link name="{ET.fromstring(part).get("name")}"/>')  # noqa: S314  written above
    with pytest.raises(RobotError, match=r"scara\.urdf: the moving links have no mass"):
        parse(bare)
    with pytest.raises(RobotError, match=r"scara\.urdf: "):
        parse('<robot name="rock"><link name="rock"/></robot>')


def test_one_link_without_mass_leaves_no_model() -> None:
    robot = parse(SCARA.replace(PARTS[2], '<link name="fore"/>'))
    assert robot.masses_reason.startswith("no mass behind j2")
    assert robot.inertias_reason == robot.masses_reason


def test_axis_need_not_be_a_unit_vector() -> None:
    text = SCARA.replace('<axis xyz="0 0 1"/>', '<axis xyz="0 0 -2.5"/>', 1)
    robot, plain = parse(text), parse()
    np.testing.assert_allclose(robot.axis_in_joint_frame(1), [0.0, 0.0, -1.0], atol=1e-12)
    q = np.array([0.3, 0.4, 0.1, 0.2])
    (turned,) = RobotDynamics(robot).at(q * [-1.0, 1.0, 1.0, 1.0], np.array([-1.0, 0.5, 0.0, 0.0])).contacts
    (straight,) = RobotDynamics(plain).at(q, np.array([1.0, 0.5, 0.0, 0.0])).contacts
    assert turned.full == pytest.approx(straight.full)
    assert turned.lumped == pytest.approx(straight.lumped)


@settings(max_examples=150)
@given(data=st.data())
def test_mutated_urdf_raises_or_gives_finite_masses(
    assert_raises_or_finite: Callable[[Callable[[], Robot]], None], data: st.DataObject
) -> None:
    root = ET.fromstring(SCARA)  # noqa: S314  written above
    for _ in range(data.draw(st.integers(1, 3))):
        elements = [(parent, child) for parent in root.iter() for child in parent]
        if not elements:
            break
        parent, child = data.draw(st.sampled_from(elements))
        key = data.draw(st.sampled_from(["remove", "double", *child.attrib]))
        if key == "remove":
            parent.remove(child)
        elif key == "double":
            parent.append(child)
        else:
            words = st.sampled_from(
                ["", "nan", "-1", "0", "1e-300", "1e300", "base", "tip", "fixed", "planar", "0 0 1", "ü"]
            )
            child.set(key, data.draw(words | st.text(st.characters(codec="utf-8", categories=["L", "N"]), max_size=4)))
    assert_raises_or_finite(lambda: parse(ET.tostring(root, encoding="unicode")))


def test_armature_of_a_urdf_adds_to_the_mass_matrix() -> None:
    bare = parse().model
    heavy = parse(armature=("j1=0.5", "j3=2")).model
    q = np.array([0.3, 0.7, 0.1, -0.2])
    difference = pin.crba(heavy, heavy.createData(), q) - pin.crba(bare, bare.createData(), q)
    np.testing.assert_allclose(difference, np.diag([0.5, 0.0, 2.0, 0.0]), atol=1e-12)


@pytest.mark.parametrize("entry", ["j1", "j1=", "=1", "j1=-1", "j1=nan", "j1=inf", "j1=heavy", "j9=1"])
def test_invalid_armature_raises(entry: str) -> None:
    with pytest.raises(RobotError, match="armature"):
        parse(armature=(entry,))


def test_repeated_armature_raises() -> None:
    with pytest.raises(RobotError, match="each joint once"):
        parse(armature=("j1=1", "j1=2"))


def test_link_before_a_locked_joint_is_the_tip() -> None:
    """Locked finger joints end the chain before the gripper; a camera on the first link must not become the tip."""
    text = with_more(
        '<link name="camera"/>',
        joint("bracket", "upper", "camera", "fixed"),
        link("finger", 0.01),
        joint("finger_joint", "tip", "finger"),
    )
    robot = parse(text, locked_joints=("*finger*",))
    assert list(robot.contact_frames) == ["tip"]
    assert robot.joint_names == ("j1", "j2", "j3", "j4")


def test_contact_point_is_before_locked_end_joints() -> None:
    robot = parse(locked_joints=("j3", "j4"))
    assert list(robot.contact_frames) == ["fore"]
    assert robot.joint_names == ("j1", "j2")


def test_locked_joints_are_named_in_the_error() -> None:
    with pytest.raises(RobotError, match=r"fixed to the base \(locked: j1, j2, j3, j4\)"):
        parse(locked_joints=("j*",))


def test_inertias_of_some_links_give_no_full_model() -> None:
    text = SCARA.replace('izz="0.02272"', 'izz="0"').replace('ixx="0.02" iyy="0.02" izz="0"', 'ixx="0" iyy="0" izz="0"')
    assert text != SCARA
    assert RobotDynamics(parse(text)).full_reason == "no inertia tensor for fore, while other links have one"


@pytest.mark.parametrize(("mass", "has_full"), [(1e-9, True), (1e-3, True), (0.1, False)])
def test_a_part_of_a_link_needs_inertia_from_a_hundredth_of_the_mass_on(mass: float, *, has_full: bool) -> None:
    """The frame of a tool often has a tiny mass and no tensor, which a simulator asks for."""
    text = with_more(link("frame", mass, moments="0 0 0"), joint("mark", "tool", "frame", "fixed"))
    reason = "" if has_full else "no inertia tensor for frame, while other links have one"
    assert RobotDynamics(parse(text)).full_reason == reason


def test_a_tiny_part_does_not_make_placeholders_data() -> None:
    text = re.sub(r'i([xyz]{2})="[^"]*"', lambda entry: f'i{entry[1]}="{int(entry[1] in ("xx", "yy", "zz"))}"', SCARA)
    text = re.sub(r'<mass value="[^"]*"/>', '<mass value="1"/>', text)
    frame = link("frame", 1e-3, moments="0 0 0") + joint("mark", "tool", "frame", "fixed")
    for part in ("", frame):
        robot = parse(text.replace("</robot>", f"{part}</robot>"))
        assert robot.masses_reason.startswith("every link has mass 1 and identity inertia: placeholders")


def test_branching_robot_has_no_lumped_model() -> None:
    text = with_more(link("camera", 0.3), joint("pan", "fore", "camera"))
    dynamics = RobotDynamics(parse(text, contact_points=("tip", "camera")))
    assert dynamics.lumped_reason == "the joints must form a single chain"
    assert dynamics.full_reason == ""


def test_missing_or_binary_file_raises(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    with pytest.raises(RobotError, match=r"robot\.urdf: cannot be read"):
        load_urdf(path, MonitorSettings())
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(RobotError, match=r"robot\.urdf: line 1: must be UTF-8 text"):
        load_urdf(path, MonitorSettings())
