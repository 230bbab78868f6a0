# SPDX-License-Identifier: Apache-2.0
"""Grippers at the end of an arm, whatever the names of their joints: a free finger decides neither point nor mass."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from scara_effmass.errors import RobotError
from scara_effmass.model.load import build_robot
from scara_effmass.model.robot import Robot
from scara_effmass.model.urdf import parse_urdf
from scara_effmass.reference import RobotDynamics
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
SLIDES = [*PALM, part("a", 0.1), part("b", 0.12)]
SLIDES += [moved("left", "palm", "a", kind="prismatic"), moved("right", "palm", "b", kind="prismatic")]


@pytest.mark.parametrize("gripper", [TWO, MIMIC, DRIVEN, HAND, SLIDES], ids=["two", "mimic", "one", "hand", "slides"])
def test_arm_ends_at_its_gripper_and_says_so(gripper: list[str]) -> None:
    robot = ur5_with(gripper)
    assert list(robot.contact_frames) == ["palm"]
    assert robot.joint_names[-1] == WRIST
    joints = {entry.split('"')[1] for entry in gripper if entry.startswith("<joint") and "fixed" not in entry}
    assert {joint.name for joint in robot.held} == joints
    assert not any(joint.is_harmless for joint in robot.held)
    (note,) = (note for note in robot.notes if note.startswith("the arm ends at its gripper"))
    assert note.endswith(", ".join(sorted(joints)))


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


def test_joints_of_a_gripper_that_locked_joints_name_are_harmless() -> None:
    robot = ur5_with(TWO, locked_joints=("[pqrs]",))
    assert [joint.is_harmless for joint in robot.held] == [True] * 4
    assert not any("gripper" in note for note in robot.notes)


def test_jaw_without_a_second_one_counts_as_locked_in_the_mass_and_moves() -> None:
    jaw = [part("clip", 0.08), moved("drive", "tool0", "clip"), part("clip_tip", 0.01)]
    jaw.append(moved("end", "clip", "clip_tip", "0.08 0 0.02", kind="fixed"))
    robot, beside = ur5_with(jaw), ur5_with(jaw, contact_points=("clip=clip_tip",))
    assert robot.joint_names[-1] == "drive"
    (note,) = (note for note in robot.notes if "counts as locked" in note)
    assert note.startswith("drive counts as locked in the masses, not in the motion: free it would make clip_tip light")
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
        "contact point left2: the tip of the longest chain (set contact_points for another): left_1, left_2",
        "chains of as many joints end at right2: left2 comes first by length and name",
        "held fixed in the model: right_1, right_2",
    )


def test_ordinary_arms_change_no_bit(load_urdf_file: Callable[..., Robot]) -> None:
    for name in ("ur5_robot.urdf", "ur10_robot.urdf", "panda.urdf", "xarm7.urdf", "scara_icube_tutorial.urdf"):
        robot = load_urdf_file(name)
        assert not any("counts as locked" in note or "gripper," in note for note in robot.notes)
        assert not pin.Model(robot.model).armature.any()
