# SPDX-License-Identifier: Apache-2.0
"""Grippers at the end of an arm, whatever the names of their joints: a free finger decides neither point nor mass."""

import re
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from scara_effmass import JointState, Monitor
from scara_effmass.errors import RobotError
from scara_effmass.model.load import build_robot
from scara_effmass.model.robot import Robot
from scara_effmass.model.urdf import parse_urdf
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety.assumptions import scope
from scara_effmass.settings import MonitorSettings

UR5 = Path(__file__).resolve().parents[2] / "config" / "robots" / "ur5_robot.urdf"
WRIST = "wrist_3_joint"


def part(name: str, mass: float) -> str:
    return (
        f'<link name="{name}"><inertial><origin xyz="0.02 0 0.02"/><mass value="{mass}"/>'
        f'<inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def moved(
    name: str, parent: str, child: str, place: str = "0.03 0 0.05", mimic: str = "", kind: str = "revolute"
) -> str:
    follows = f'<mimic joint="{mimic}"/>' if mimic else ""
    limit = '<limit lower="0" upper="0.8" effort="50" velocity="0.5"/>' if kind != "fixed" else ""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{place}"/><axis xyz="0 1 0"/>{limit}{follows}</joint>'
    )


def ur5_with(parts: Sequence[str], **options: object) -> Robot:
    settings = MonitorSettings.model_validate({"locked_joints": (), **options})
    text = UR5.read_text(encoding="utf-8").replace("</robot>", "".join(parts) + "</robot>")
    return build_robot(parse_urdf(text, "ur5.urdf", settings), settings)


PALM = [part("palm", 0.6), moved("mount", "tool0", "palm", "0 0 0", kind="fixed")]
TWO = [
    *PALM,
    *(part("a1", 0.05), part("a2", 0.05), part("b1", 0.05), part("b2", 0.05)),
    *(moved("p", "palm", "a1"), moved("q", "a1", "a2"), moved("r", "palm", "b1"), moved("s", "b1", "b2")),
]
MIMIC = [
    *PALM,
    *(part("a1", 0.05), part("a2", 0.05), part("b1", 0.02)),
    *(moved("p", "palm", "a1"), moved("q", "a1", "a2", mimic="p"), moved("r", "palm", "b1", mimic="p")),
]
DRIVEN = [*PALM, part("a1", 0.05), moved("p", "palm", "a1"), part("a2", 0.02), moved("q", "a1", "a2", mimic="p")]
HAND = [
    *PALM,
    *(part(f"{finger}{i}", 0.04) for finger in "abc" for i in range(3)),
    *(moved(f"{finger}-0", "palm", f"{finger}0") for finger in "abc"),
    *(moved(f"{finger}-{i}", f"{finger}{i - 1}", f"{finger}{i}") for finger in "abc" for i in (1, 2)),
]
THUMB = [*HAND, part("a3", 0.01), moved("a-3", "a2", "a3")]  # one joint more than the fingers
MOTORS = [*HAND, part("m", 0.05), moved("motor", "palm", "m", kind="continuous")]
SLIDES = [*PALM, part("a", 0.1), part("b", 0.12)]
SLIDES += [moved("left", "palm", "a", kind="prismatic"), moved("right", "palm", "b", kind="prismatic")]


@pytest.mark.parametrize(
    ("gripper", "is_harmless"),
    [(TWO, True), (MIMIC, True), (DRIVEN, False), (HAND, True), (THUMB, True), (MOTORS, True), (SLIDES, True)],
    ids=["two", "mimic", "one", "hand", "thumb", "motors", "slides"],
)
def test_arm_ends_at_its_gripper_and_says_so(gripper: list[str], is_harmless: bool) -> None:  # noqa: FBT001
    """One finger alone might be a wrist: its motion counts."""
    robot = ur5_with(gripper)
    assert list(robot.contact_frames) == ["palm"]
    assert robot.joint_names[-1] == WRIST
    joints = {entry.split('"')[1] for entry in gripper if entry.startswith("<joint") and "fixed" not in entry}
    assert {joint.name for joint in robot.held} == joints
    assert {joint.is_harmless for joint in robot.held} == {is_harmless}
    assert ("motion does not count of" in scope(robot, MonitorSettings())) == is_harmless
    (note,) = (note for note in robot.notes if note.startswith("the arm ends at its gripper"))
    assert note.endswith(", ".join(sorted(joints)))


@pytest.mark.parametrize("mount", ["palm", "tool0"])
@pytest.mark.parametrize("gripper", [TWO, MIMIC, HAND], ids=["two", "mimic", "hand"])
def test_camera_beside_the_fingers_does_not_become_the_contact_point(gripper: list[str], mount: str) -> None:
    """It is farther from the last joint, where the wrist yields: the mass would be a third smaller."""
    camera = [part("camera", 0.05), moved("bracket", mount, "camera", "0 0.1 0.02", kind="fixed")]
    assert list(ur5_with([*gripper, *camera]).contact_frames) == ["palm"]
    point = [part("tcp", 0), moved("tcp_mount", "palm", "tcp", "0.06 0 0.1", kind="fixed")]
    assert list(ur5_with([*gripper, *camera, *point]).contact_frames) == ["tcp"]


def masses(robot: Robot) -> float:
    """Return the median of the lightest full mass [kg] at the first contact point over the poses."""
    dynamics = RobotDynamics(robot)
    found = [
        1.0 / float(np.linalg.eigvalsh(next(iter(dynamics.at(q).contacts[0].mobilities.values())))[-1])
        for q in robot.sample_configurations()
    ]
    return float(np.median(found))


def test_point_on_a_finger_has_the_mass_of_the_closed_gripper() -> None:
    """Free, the finger alone would weigh 0.1 kg."""
    held = ur5_with(TWO, contact_points=("a2",))
    locked = ur5_with(TWO, contact_points=("a2",), locked_joints=("p", "q", "r", "s"))
    assert held.joint_names == locked.joint_names
    assert held.joint_names[-1] == WRIST
    assert masses(held) == masses(locked) > 1.0


@pytest.mark.parametrize(
    ("locked", "points", "harmless"),
    [
        (("[pqrs]",), (), {"p", "q", "r", "s"}),
        ((WRIST,), (), set()),  # no joint of the model carries the gripper
        ((), ("a2",), {"r", "s"}),  # the motion of p and q is that of the contact point
        ((WRIST,), ("forearm_link",), set()),
    ],
)
def test_only_fingers_without_a_contact_point_are_harmless(
    locked: tuple[str, ...], points: tuple[str, ...], harmless: set[str]
) -> None:
    robot = ur5_with(TWO, locked_joints=locked, contact_points=points)
    assert {joint.name for joint in robot.held if joint.is_harmless} >= harmless
    assert WRIST not in {joint.name for joint in robot.held if joint.is_harmless}


@pytest.mark.parametrize("locked", [(), ("*gripper*",)])
def test_name_makes_no_gripper_of_a_wrist(locked: tuple[str, ...]) -> None:
    text = UR5.read_text(encoding="utf-8").replace(WRIST, "gripper_rotation")
    settings = MonitorSettings(locked_joints=locked)
    robot = build_robot(parse_urdf(text, "ur5.urdf", settings), settings)
    assert robot.joint_names[5:] == (() if locked else ("gripper_rotation",))
    assert [joint.is_harmless for joint in robot.held] == [False] * len(locked)


def test_jaw_without_a_second_one_counts_as_locked_in_the_mass_and_moves() -> None:
    jaw = [part("clip", 0.08), moved("drive", "tool0", "clip"), part("clip_tip", 0.01)]
    jaw.append(moved("end", "clip", "clip_tip", "0.08 0 0.02", kind="fixed"))
    robot, beside = ur5_with(jaw), ur5_with(jaw, contact_points=("clip=clip_tip",))
    assert robot.joint_names[-1] == "drive"
    (note,) = (note for note in robot.notes if "counts as locked" in note)
    assert note.startswith("counts as locked in the masses, not in the motion: drive: free, clip_tip would be light")
    without = range(6)
    for q in robot.sample_configurations():
        mobility = next(iter(RobotDynamics(robot).at(q).contacts[0].mobilities.values()))
        jacobian = pin.computeFrameJacobian(
            robot.model,
            robot.model.createData(),
            q,
            robot.contact_frames["clip_tip"],
            pin.LOCAL_WORLD_ALIGNED,
        )[:3, :6]
        matrix = robot.mass_matrix(robot.model, robot.model.createData(), q)[np.ix_(without, without)]
        expected = jacobian @ np.linalg.solve(matrix, jacobian.T)
        np.testing.assert_allclose(mobility, expected, atol=0.01 * np.trace(expected))
    assert masses(beside) < 0.1 * masses(robot)
    stated = ur5_with(jaw, contact_points=("clip_tip",))  # as `init` does
    assert masses(stated) == masses(robot)
    free = RobotDynamics(robot).at(np.full(7, 0.3), np.array([0.0] * 6 + [1.0])).contacts[0]
    assert float(np.linalg.norm(free.velocity)) == pytest.approx(float(np.hypot(0.08, 0.02)), rel=1e-6)


@pytest.mark.parametrize("drives", ["free", "servo"])
def test_jaw_without_a_frame_at_its_end_allows_no_more_than_one_that_cannot_move(drives: str) -> None:
    box = '<collision><origin xyz="0 0 0.05"/><geometry><box size="0.02 0.02 0.1"/></geometry></collision></link>'
    text = re.sub(r"<(visual|collision)\b.*?</\1>", "", UR5.read_text(encoding="utf-8"), flags=re.DOTALL)
    settings = MonitorSettings(drives=drives)

    def allowed(kind: str) -> list[float]:
        jaw = part("clip", 0.08).replace("</link>", box) + moved("drive", "tool0", "clip", kind=kind)
        robot = build_robot(parse_urdf(text.replace("</robot>", f"{jaw}</robot>"), "ur5.urdf", settings), settings)
        dynamics, speeds = RobotDynamics(robot), []
        for velocity in np.vstack([np.eye(6), np.full(6, 0.4)]) * 0.2 + 1e-6:
            names, rest = robot.joint_names, robot.model.nv - 6
            position = np.append([0.3, -1.2, 1.0, 0.4, 0.9, 0.2], np.zeros(rest))
            state = JointState(1_000_000_000, names, position, np.append(velocity, np.full(rest, 1e-7)))
            decision = Monitor(dynamics, settings).assess(state, now_ns=state.stamp_ns)
            assert decision is not None
            speeds += [contact.allowable_speed for contact in decision.contacts if contact.contact_point == "clip"]
        return speeds

    np.testing.assert_allclose(allowed("revolute"), allowed("fixed"), rtol=0.05)
    assert min(allowed("fixed")) > 0.0


def test_jaw_on_a_light_joint_counts_as_locked_with_it() -> None:
    parts = [part("mount", 0.05), part("jaw", 0.05)]

    def ending(mount: str, jaw: str) -> Robot:
        first = moved("pan", "tool0", "mount", "0 0 0.05", kind=mount)
        return ur5_with([*parts, first, moved("clip", "mount", "jaw", "0 0 0.1", kind=jaw)])

    both, neither = ending("revolute", "revolute"), ending("fixed", "fixed")
    (note,) = (note for note in both.notes if "counts as locked" in note)
    assert note.startswith("counts as locked in the masses, not in the motion: pan, clip: free, jaw would be light")
    assert both.joint_names[-2:] == ("pan", "clip")
    free, locked = map(float, re.findall(r"typically (\S+) in place of (\S+) kg", note)[0])
    assert (free < 0.1, locked > 1.0) == (True, True)
    assert masses(both) > 0.5 * masses(neither)


@pytest.mark.parametrize(("mass", "is_locked"), [(0.17, True), (0.23, False)])
def test_end_counts_as_locked_where_its_free_joint_would_halve_the_mass(mass: float, *, is_locked: bool) -> None:
    end = [part("clip", mass), moved("drive", "tool0", "clip"), part("clip_tip", 0.01)]
    robot = ur5_with([*end, moved("end", "clip", "clip_tip", "0 0 0.01", kind="fixed")])
    notes = [note for note in robot.notes if "counts as locked in the masses, not in the motion: drive:" in note]
    assert len(notes) == is_locked
    for note in notes:
        free, locked = map(float, re.findall(r"typically (\S+) in place of (\S+) kg", note)[0])
        assert 2.0 <= locked / free < 2.3


@pytest.mark.parametrize(
    ("parts", "points", "joints"),
    [
        ([part("lens", 0.2), moved("pan", "forearm_link", "lens")], (), 6),  # a camera, unlike the wrist
        ([part("lens", 0.2), moved("pan", "forearm_link", "lens")], ("ee_link", "lens"), 7),
        ([part("arm2", 3.0), moved("other", "base_link", "arm2", "0 0.5 0")], (), 6),
        ([part("tool", 0.5), moved("bolt", "tool0", "tool", "0 0 0.1", kind="fixed")], (), 6),
    ],
    ids=["camera", "watched camera", "second arm", "tool"],
)
def test_other_branches_end_no_arm(parts: list[str], points: tuple[str, ...], joints: int) -> None:
    robot = ur5_with(parts, contact_points=points)
    assert len(robot.joint_names) == joints
    assert not any("gripper" in note or "counts as locked" in note for note in robot.notes)


@pytest.mark.parametrize(
    ("points", "locked", "refusal"),
    [
        ((), (), "must not mimic shoulder_lift_joint, which moves"),
        ((), ("elbow_joint",), "must not mimic shoulder_lift_joint, which moves"),
        (("ee_link",), ("elbow_joint",), "must not mimic shoulder_lift_joint, which moves"),
        (("ee_link",), ("shoulder_lift_joint",), "must not mimic another joint: fix it"),
        (("ee_link",), ("elbow_joint", "shoulder_lift_joint"), ""),
    ],
)
def test_mimic_joint_of_the_arm_is_refused_unless_its_master_rests(
    points: tuple[str, ...], locked: tuple[str, ...], refusal: str
) -> None:
    """One that carries more than a tool is no finger; locked, it would not follow."""
    text = UR5.read_text(encoding="utf-8").replace(
        '<joint name="elbow_joint" type="revolute">',
        '<joint name="elbow_joint" type="revolute"><mimic joint="shoulder_lift_joint"/>',
    )
    settings = MonitorSettings(contact_points=points, locked_joints=locked)
    if refusal:
        with pytest.raises(RobotError, match=f"joint elbow_joint: {refusal}"):
            parse_urdf(text, "ur5.urdf", settings)
    else:
        assert parse_urdf(text, "ur5.urdf", settings).model.nv == 4


@pytest.mark.parametrize(
    ("mass", "parent", "place", "master", "refusal"),
    [
        (0.1, "wrist_2_link", "0 0 0.02", WRIST, ""),  # a cable guide
        (0.1, "wrist_3_link", "0 0 0.02", WRIST, ""),
        (0.1, "base_link", "0 0 0.02", "elbow_joint", ""),
        (9.0, "base_link", "0 0 0.02", "elbow_joint", "elbow_joint"),  # a second drive
        (0.1, "base_link", "0 0 0.5", "elbow_joint", "elbow_joint"),  # a long pole
        (9.0, "base_link", "0 0 0.02", "other", "elbow_joint"),
    ],
)
def test_part_beside_the_arm_may_mimic_it_if_it_is_small(
    mass: float, parent: str, place: str, master: str, refusal: str
) -> None:
    parts = [part("guide", mass), moved("guide_joint", parent, "guide", mimic=master), part("end", 0.01)]
    parts += [moved("end_joint", "guide", "end", place, kind="fixed"), part("more", 0.01)]
    parts.append(moved("other", "base_link", "more", mimic="elbow_joint"))
    if refusal:
        with pytest.raises(RobotError, match=rf"guide_joint: must not mimic {refusal}, which moves: hang it on a link"):
            ur5_with(parts)
        return
    robot = ur5_with(parts)
    assert (robot.joint_names[-1], next(iter(robot.contact_frames))) == (WRIST, "ee_link")
    assert not any(joint.is_harmless for joint in robot.held)


@pytest.mark.parametrize(("place", "tip"), [("0 0 0.45", "tcp"), ("0 0 0.02", "lens3")])
def test_of_ends_with_equally_many_joints_the_farthest_is_the_tip(place: str, tip: str) -> None:
    frames = ['<link name="tcp"/>', moved("t", "tool0", "tcp", place, kind="fixed")]
    frames += [f'<link name="lens{i}"/>' for i in range(1, 4)]
    for name, (parent, child) in enumerate(pairwise(("tool0", "lens1", "lens2", "lens3"))):
        frames.append(moved(f"l{name}", parent, child, "0.02 0 0", kind="fixed"))
    assert list(ur5_with(frames).contact_frames) == [tip]


def test_arms_of_equal_length_are_named() -> None:
    limbs = [
        text
        for side in ("left", "right")
        for text in (
            part(f"{side}1", 3.0),
            part(f"{side}2", 2.0),
            moved(f"{side}_1", "torso", f"{side}1"),
            moved(f"{side}_2", f"{side}1", f"{side}2", "0 0 0.4"),
        )
    ]
    text = f'<robot name="two">{part("torso", 20.0)}{"".join(limbs)}</robot>'
    robot = build_robot(parse_urdf(text, "two.urdf", MonitorSettings()), MonitorSettings())
    assert robot.notes[:3] == (
        "contact point left2: the end of the longest chain (set contact_points for another): left_1, left_2",
        "chains of as many joints end at right2: left2 comes first by length and name",
        "held fixed in the model: right_1, right_2",
    )


def test_ordinary_arms_change_no_bit(load_urdf_file: Callable[..., Robot]) -> None:
    for name in ("ur5_robot.urdf", "ur10_robot.urdf", "panda.urdf", "xarm7.urdf", "scara_icube_tutorial.urdf"):
        robot = load_urdf_file(name)
        assert not any("counts as locked" in note for note in robot.notes)
        assert not pin.Model(robot.model).armature.any()
