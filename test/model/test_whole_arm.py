# SPDX-License-Identifier: Apache-2.0
"""`contact_points: whole_arm` on a URDF: which links are watched, under which names, and what is refused."""

import re
from pathlib import Path

import numpy as np
import pytest

from scara_effmass.codes import Assumption
from scara_effmass.errors import LimitError, RobotError, SettingsError
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.safety.assumptions import assumptions_of, scope
from scara_effmass.settings import MonitorSettings, checked
from scara_effmass.share import share

LINK = """<link name="{name}"><inertial><mass value="2"/><origin xyz="0.15 0 0"/>
<inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>{shapes}</link>"""
BOX = '<{kind}><origin xyz="{at}"/><geometry><box size="{size}"/></geometry></{kind}>'
JOINT = """<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="{at} 0 0"/>
<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="50" velocity="3"/></joint>"""


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    """A planar arm: a forearm with a housing that sticks out behind, a flange, and a camera that is only visible."""
    housing = BOX.format(kind="collision", at="0.1 0 0", size="0.5 0.1 0.1")
    links = [
        '<link name="base"/>',
        LINK.format(name="upper_arm", shapes=BOX.format(kind="collision", at="0.15 0 0", size="0.3 0.1 0.1")),
        LINK.format(name="forearm", shapes=housing),
        '<link name="flange"/>',
        f'<link name="camera">{BOX.format(kind="visual", at="0 0 0", size="0.05 0.05 0.05")}</link>',
    ]
    joints = [
        JOINT.format(name="joint1", kind="revolute", parent="base", child="upper_arm", at=0.0),
        JOINT.format(name="joint2", kind="revolute", parent="upper_arm", child="forearm", at=0.3),
        JOINT.format(name="flange_joint", kind="fixed", parent="forearm", child="flange", at=0.35),
        JOINT.format(name="camera_joint", kind="fixed", parent="forearm", child="camera", at=0.2),
    ]
    path = tmp_path / "arm.urdf"
    path.write_text(f'<robot name="arm">{"".join([*links, *joints])}</robot>', encoding="utf-8")
    return path


def test_every_link_with_geometry_is_a_contact(arm: Path) -> None:
    settings = MonitorSettings(contact_points=("whole_arm", "flange"))
    dynamics = RobotDynamics(load_robot(arm, settings))
    assert dynamics.contact_points == ("flange", "upper_arm", "forearm", "camera")
    assert "by their visual geometry, without another: camera" in dynamics.robot.notes
    assert "slower than the allowable speed at flange, upper_arm, forearm, camera" in scope(dynamics.robot, settings)
    left_out = load_robot(arm, MonitorSettings(contact_points=("whole_arm",), contact_links=("*arm",)))
    assert RobotDynamics(left_out).contact_points == ("flange", "upper_arm", "forearm")
    assert "links that contact_links leaves out: camera" in left_out.notes


@pytest.mark.parametrize(
    ("size", "points", "unwatched"),
    [
        ("0.3 0.1 0.1", (), ()),
        ("", (), ("upper_arm",)),
        ("3e-4 1e-4 1e-4", (), ("the link behind joint1",)),
        ("3e-4 1e-4 1e-4", ("flange", "whole_arm"), ("the link behind joint1",)),
        ("", ("flange", "upper_arm", "whole_arm"), ()),
    ],
    ids=["whole", "without", "in mm", "stated", "named"],
)
def test_contact_points_are_stated_only_if_each_link_with_mass_or_length_is_watched(
    arm: Path, size: str, points: tuple[str, ...], unwatched: tuple[str, ...]
) -> None:
    box = BOX.format(kind="collision", at="0.15 0 0", size="0.3 0.1 0.1")
    text = arm.read_text(encoding="utf-8")
    arm.write_text(text.replace(box, BOX.format(kind="collision", at="0.15 0 0", size=size) if size else ""))
    values = {"contact_points": points} if points else {}
    settings = MonitorSettings.model_validate(values)
    robot = load_robot(arm, settings)
    assert robot.unwatched == unwatched
    assert any(f"not watched for lack of geometry: {', '.join(unwatched)}: add" in n for n in robot.notes) == any(
        unwatched
    )
    assert (Assumption.CONTACT_POINTS in assumptions_of(robot, settings).assumed) == any(unwatched)
    chosen = settings.model_copy(update={"contact_links": ("forearm", "camera")})
    assert load_robot(arm, chosen).unwatched == ()


@pytest.mark.parametrize(
    ("at", "mass", "com", "points", "unwatched"),
    [
        (0.3, 0.0, 0.0, (), ()),
        (0.3, 0.01, 0.15, (), ("tool",)),
        (0.45, 0.0, 0.0, (), ()),  # the tip
        (0.45, 0.0, 0.0, ("tool2", "whole_arm"), ()),
        (-0.25, 0.0, 0.0, (), ("tool",)),
    ],
)
def test_link_without_geometry_far_outside_that_of_its_joint_is_not_watched(
    arm: Path, at: float, mass: float, com: float, points: tuple[str, ...], unwatched: tuple[str, ...]
) -> None:
    inertia = '<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/>'
    inertial = f'<inertial><mass value="{mass}"/><origin xyz="0 0 {com}"/>{inertia}</inertial>' if mass else ""
    parts = f'<link name="tool">{inertial}</link><link name="tool2"/>'
    parts += JOINT.format(name="mount", kind="fixed", parent="forearm", child="tool", at=at)
    parts += JOINT.format(name="mount2", kind="fixed", parent="tool", child="tool2", at=0.0)
    arm.write_text(arm.read_text(encoding="utf-8").replace("</robot>", f"{parts}</robot>"), encoding="utf-8")
    settings = MonitorSettings(contact_points=points)
    robot = load_robot(arm, settings)
    assert set(unwatched) <= set(robot.unwatched)
    assert bool(robot.unwatched) == bool(unwatched)


def test_hulls_of_fingers_contain_them_over_their_range(arm: Path) -> None:
    box = BOX.format(kind="collision", at="0 0 0", size="0.02 0.02 0.02")
    fingers = "".join(f'<link name="{name}"><inertial>{{}}</inertial>{box}</link>' for name in ("left", "right"))
    inertial = '<mass value="0.02"/><inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/>'
    joints = JOINT.format(name="drive", kind="prismatic", parent="flange", child="left", at=0.05)
    mimic = '<mimic joint="drive" multiplier="-2" offset="0.01"/></joint>'
    turn = JOINT.format(name="turn", kind="prismatic", parent="flange", child="right", at=0.05)
    joints = (joints + turn.replace("</joint>", mimic)).replace('"0 0 1"', '"0 1 0"')
    joints = joints.replace('lower="-3" upper="3"', 'lower="0" upper="0.04"')
    text = arm.read_text(encoding="utf-8")
    arm.write_text(text.replace("</robot>", fingers.format(inertial, inertial) + joints + "</robot>"))
    robot = load_robot(arm)
    assert [joint.is_harmless for joint in robot.held] == [True, True]
    spans = {name: (robot.hulls[name].min(axis=0)[1], robot.hulls[name].max(axis=0)[1]) for name in ("left", "right")}
    assert spans["left"] == pytest.approx((-0.01, 0.05), abs=1e-5)
    assert spans["right"] == pytest.approx((-0.08, 0.02), abs=1e-5)
    assert np.ptp(robot.hulls["upper_arm"], axis=0) == pytest.approx([0.3, 0.1, 0.1])


@pytest.mark.parametrize(("length", "is_short"), [(0.2, True), (0.4, False)])
def test_rod_that_follows_a_joint_of_the_arm_is_watched_only_if_it_is_short(
    arm: Path, length: float, *, is_short: bool
) -> None:
    box = BOX.format(kind="collision", at=f"{0.5 * length} 0 0", size=f"{length} 0.02 0.02")
    joint = JOINT.format(name="rod_joint", kind="revolute", parent="upper_arm", child="rod", at=0.0)
    follows = joint.replace("</joint>", '<mimic joint="joint2"/></joint>')
    parts = f'<link name="rod">{box}</link>{follows}'
    arm.write_text(arm.read_text(encoding="utf-8").replace("</robot>", f"{parts}</robot>"), encoding="utf-8")
    if is_short:
        assert "rod" in load_robot(arm).hulls
        return
    text = "joint rod_joint: must not mimic joint2, which moves: if rod, 0.4 m long, cannot touch a person"
    with pytest.raises(RobotError, match=text):
        load_robot(arm)
    assert "rod" not in load_robot(arm, MonitorSettings(contact_links=("*arm",))).hulls


def test_geometry_in_millimetres_is_refused(arm: Path) -> None:
    arm.write_text(arm.read_text(encoding="utf-8").replace('size="0.5 0.1 0.1"', 'size="500 100 100"'))
    assert (
        load_robot(arm).units_reason == "the geometry of forearm is 500 m long: must be in metres, not in millimetres"
    )


@pytest.mark.parametrize(("x", "distance"), [("0.55", ""), ("-0.75", "0.5")])
def test_geometry_far_from_its_link_is_doubted(arm: Path, x: str, distance: str) -> None:
    arm.write_text(arm.read_text(encoding="utf-8").replace('xyz="0.1 0 0"', f'xyz="{x} 0 0"'))
    doubts = [note for note in load_robot(arm).notes if note.startswith("check the geometry")]
    text = f"check the geometry of forearm: {distance} m from the frame of the link, reach 0.65 m"
    assert doubts == ([text] if distance else [])


def test_contact_links_choose_among_the_boxes_of_a_dh_file() -> None:
    robot = load_robot(settings=MonitorSettings(contact_links=("link[24]",)))
    assert {*robot.hulls} == {"link2", "link4"}
    assert "links that contact_links leaves out: link1, link3" in robot.notes


@pytest.mark.parametrize("is_urdf", [False, True])
def test_contact_links_without_a_link_are_refused(arm: Path, is_urdf: bool) -> None:  # noqa: FBT001
    links = "upper_arm, forearm, camera" if is_urdf else "link1, link2, link3, link4"
    rule = f"contact_links = 'elbow*': must match a link with geometry: {links}"
    with pytest.raises(RobotError, match=re.escape(rule)):
        load_robot(arm if is_urdf else None, MonitorSettings(contact_links=("*", "elbow*")))


def test_a_urdf_is_watched_as_a_whole_unless_points_or_a_normal_are_stated(arm: Path) -> None:
    settings = MonitorSettings()
    robot = load_robot(arm, settings)
    assert RobotDynamics(robot).contact_points == ("flange", "upper_arm", "forearm", "camera")
    assert {*robot.hulls} == {"camera", "upper_arm", "forearm"}
    assert Assumption.CONTACT_POINTS not in assumptions_of(robot, settings).assumed
    assert not load_robot(arm, MonitorSettings(contact_points=("flange",))).hulls
    settings = MonitorSettings(contact_normal="0 0 1")
    robot = load_robot(arm, settings)
    assert not robot.hulls
    assert Assumption.CONTACT_POINTS in assumptions_of(robot, settings).assumed


def test_a_known_normal_cannot_be_set_while_links_are_watched_as_a_whole(arm: Path) -> None:
    settings = MonitorSettings()
    monitor = Monitor(RobotDynamics(load_robot(arm, settings)), settings)
    with pytest.raises(RobotError, match="contact_normal = 'velocity': must be worst where links are"):
        monitor.apply(MonitorSettings(contact_normal="velocity"))
    assert monitor.settings == settings


def test_folder_of_packages_that_is_none_is_refused(arm: Path, tmp_path: Path) -> None:
    for missing in (tmp_path / "missing", arm):
        with pytest.raises(RobotError, match=re.escape(f"package_dirs = {missing}: must be a folder")):
            load_robot(arm, MonitorSettings(package_dirs=(str(tmp_path), str(missing))))


def test_without_a_mesh_only_the_tip_is_watched_which_is_an_assumption(arm: Path) -> None:
    text = arm.read_text(encoding="utf-8").replace('<box size="0.3 0.1 0.1"/>', '<mesh filename="package://p/a.stl"/>')
    arm.write_text(text, encoding="utf-8")
    settings = MonitorSettings()
    robot = load_robot(arm, settings)
    assert RobotDynamics(robot).contact_points == ("flange",)
    assert not robot.hulls
    rule = (
        "must be a file that can be read: name the folder of its package, or one above, by package_dirs (--package-dir)"
    )
    note = f"link upper_arm: collision: mesh = 'package://p/a.stl': {rule}"
    assert f"only the tip is watched, not whole_arm: {note}" in robot.notes
    assert Assumption.CONTACT_POINTS in assumptions_of(robot, settings).assumed
    with pytest.raises(RobotError, match=re.escape(note)):
        load_robot(arm, MonitorSettings(contact_points=("whole_arm",)))


def test_the_worst_place_of_a_link_is_reported_where_it_is(arm: Path) -> None:
    """The housing behind the elbow moves fastest while the arm turns back on itself."""
    settings = MonitorSettings(contact_points=("whole_arm", "flange"))
    monitor = Monitor(RobotDynamics(load_robot(arm, settings)), settings)
    contacts = monitor.assess_configurations(np.array([[0.0, 2.9]]), np.array([[1.0, 0.5]])).contacts[0]
    flange, upper_arm, forearm, _ = contacts
    assert forearm["position_in_link"][0] == pytest.approx(-0.15, abs=1e-6)
    assert abs(forearm["position_in_link"][1]) == pytest.approx(0.05, abs=1e-6)
    angle = 2.9
    turned = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    assert forearm["position"][:2] == pytest.approx([0.3, 0.0] + turned @ forearm["position_in_link"][:2])
    assert forearm["speed"] > 2.0 * flange["speed"]
    assert forearm["force_bound"] > upper_arm["force_bound"] > 0.0
    assert not flange["position_in_link"].any()


def test_a_robot_without_geometry_keeps_its_points_and_says_so(arm: Path) -> None:
    text = arm.read_text(encoding="utf-8")
    for kind in ("collision", "visual"):
        text = text.replace(f"<{kind}>", "<!--").replace(f"</{kind}>", "-->")
    arm.write_text(text, encoding="utf-8")
    robot = load_robot(arm, MonitorSettings(contact_points=("whole_arm",)))
    assert RobotDynamics(robot).contact_points == ("flange",)
    assert "no link has geometry: only the contact points are watched" in robot.notes


def test_boxes_of_a_dh_file_are_links_as_a_whole(tmp_path: Path) -> None:
    settings = MonitorSettings(contact_points=("whole_arm",))
    dynamics = RobotDynamics(load_robot(share("config", "omron_i4_550l.yaml"), settings))
    assert dynamics.contact_points == ("tool", "elbow", "link1", "link2", "link3", "link4")
    link2 = dynamics.robot.hulls["link2"]
    assert np.ptp(link2, axis=0) == pytest.approx([0.425, 0.15, 0.2], abs=1e-3)
    path = tmp_path / "bare.yaml"
    text = share("config", "omron_i4_550l.yaml").read_text(encoding="utf-8")
    path.write_text(re.sub(r", boxes: \[.*\]}", "}", text), encoding="utf-8")
    with pytest.raises(RobotError, match="contact_points = 'whole_arm': no link has boxes: state them, or name"):
        load_robot(path, settings)


def test_boxes_of_the_payload_of_a_dh_file_are_a_link(tmp_path: Path) -> None:
    text = share("config", "omron_i4_550l.yaml").read_text(encoding="utf-8")
    boxes = "payload:\n  boxes: [{center: [0.0, 0.0, 0.1], size: [0.2, 0.1, 0.04]}]\n  "
    path = tmp_path / "gripper.yaml"
    path.write_text(text.replace("payload:              #", f"{boxes}#"), encoding="utf-8")
    robot = load_robot(path, MonitorSettings(contact_points=("whole_arm",)))
    tool = robot.model.frames[robot.contact_frames["tool"]].placement
    corners = np.unique((robot.hulls["payload"] @ tool.rotation).round(6), axis=0)
    assert [*robot.contact_frames][-1] == "payload"
    assert np.ptp(corners, axis=0) == pytest.approx([0.2, 0.1, 0.04], abs=1e-5)
    assert corners.mean(axis=0) == pytest.approx([0.0, 0.0, 0.1], abs=1e-5)


@pytest.mark.parametrize("points", [(), ("flange",)])
def test_the_shape_of_the_payload_is_a_contact(arm: Path, points: tuple[str, ...]) -> None:
    """In the frame of the payload, which carries it; a box, and a rod along z."""
    shapes = ("box 0.2 0.1 0.04 at 0.1 0 0", "cylinder 0.01 0.3")
    settings = MonitorSettings(contact_points=points, payload_shape=shapes, payload_mass=1.0)
    robot = load_robot(arm, settings)
    hull = robot.hulls["payload"]
    placed = robot.model.frames[robot.contact_frames["payload"]].placement
    assert placed == robot.model.frames[next(iter(robot.contact_frames.values()))].placement
    local = hull - placed.translation
    beyond = np.concatenate([local.max(axis=0) - [0.2, 0.05, 0.15], [-0.01, -0.05, -0.15] - local.min(axis=0)])
    assert (beyond > -1e-9).all()
    assert (beyond < 0.02).all()
    monitor = Monitor(RobotDynamics(robot), settings)
    contacts = monitor.assess_configurations(np.array([[0.0, 0.5]]), np.array([[1.0, 0.5]])).contacts[0]
    assert np.abs(contacts["position_in_link"][-1]).max() > 0.04


def test_what_no_payload_shape_can_be_is_refused(arm: Path) -> None:
    for entry in ("box 0.1 0.1", "cone 1 1", "sphere -1", "sphere nan", "sphere 0.1 at 1 2", "sphere 11"):
        with pytest.raises(SettingsError, match=r"payload_shape.*: must be box X Y Z, sphere RADIUS, cylinder"):
            checked(MonitorSettings, {"payload_shape": [entry]}, "monitor")
    values = {"payload_shape": ["sphere 0.1"], "contact_normal": "0 0 1"}
    with pytest.raises(SettingsError, match=r"contact_normal.*must be worst with payload_shape = sphere 0.1"):
        checked(MonitorSettings, values, "monitor")
    with pytest.raises(RobotError, match="payload_shape: another contact has the name payload: rename it"):
        load_robot(arm, MonitorSettings(contact_points=("payload=forearm",), payload_shape=("sphere 0.1",)))


def test_contact_areas_are_those_of_contacts_that_exist(arm: Path) -> None:
    settings = MonitorSettings(contact_points=("whole_arm", "flange"))
    dynamics = RobotDynamics(load_robot(arm, settings))
    monitor = Monitor(dynamics, settings)
    motion = np.array([[0.0, 0.5]]), np.array([[1.0, 0.5]])
    before = monitor.assess_configurations(*motion).contacts[0]["allowable_speed"]
    monitor.apply(settings.model_copy(update={"contact_areas": ("*arm=2e-5",)}))
    after = monitor.assess_configurations(*motion).contacts[0]["allowable_speed"]
    assert (after < before).tolist() == [False, True, True, False]
    with pytest.raises(LimitError, match="contact_areas = 'hand': must match one of the contacts flange, upper_arm, "):
        monitor.apply(settings.model_copy(update={"contact_areas": ("hand=2e-5",)}))


@pytest.mark.parametrize("entry", ["arm", "arm=", "=1e-4", "arm=0", "arm=-1e-4", "arm=0.2", "arm=nan", "arm=x"])
def test_what_no_contact_area_can_be_is_refused(entry: str) -> None:
    with pytest.raises(SettingsError, match=r'contact_areas.*: must be "contact=area", above 0 and at most 0.1 m2'):
        checked(MonitorSettings, {"contact_areas": [entry]}, "monitor")
    with pytest.raises(SettingsError, match="must state the area of arm once"):
        checked(MonitorSettings, {"contact_areas": ["arm=1e-4", "arm=2e-4"]}, "monitor")


def test_a_known_contact_normal_is_refused() -> None:
    values = {"contact_points": ["whole_arm"], "contact_normal": "velocity"}
    with pytest.raises(SettingsError, match=r"contact_normal.*must be worst with contact_points = whole_arm"):
        checked(MonitorSettings, values, "monitor")
