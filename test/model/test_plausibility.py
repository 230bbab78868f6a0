# SPDX-License-Identifier: Apache-2.0
"""Descriptions that are not in SI units are recognised and named; published robots raise no false alarm."""

import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from scara_effmass.errors import RobotError
from scara_effmass.model.load import load_robot
from scara_effmass.model.robot import Robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings

PUBLISHED = (
    "ur5_robot.urdf",
    "ur10_robot.urdf",
    "panda.urdf",
    "tm5-700-nominal.urdf",
    "tm12-nominal.urdf",
    "wx200.urdf",
)
WITH_INERTIAS = PUBLISHED[:3]
DEGREES = 57.29577951308232
MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")

FACTORS: dict[str, list[tuple[str, tuple[str, ...], float]]] = {
    "millimetres": [(".//origin", ("xyz",), 1e3)],
    "millimetres in centres of mass": [(".//inertial/origin", ("xyz",), 1e3)],
    "centimetres": [("joint/origin", ("xyz",), 1e2)],
    "grams": [(".//mass", ("value",), 1e3)],
    "tonnes": [(".//mass", ("value",), 1e-3)],
    "degrees": [("joint[@type='revolute']/limit", ("lower", "upper"), DEGREES)],
    "degrees of frames": [("joint/origin", ("rpy",), DEGREES)],
    "kg mm2": [(".//inertia", MOMENTS, 1e6)],
    "g m2": [(".//inertia", MOMENTS, 1e-3)],
    "t m2": [(".//inertia", MOMENTS, 1e-6)],
    "N mm": [("joint/limit", ("effort",), 1e3)],
}
"""XPath, attributes and factor of a unit."""


def path_of(name: str) -> Path:
    root = Path(__file__).resolve().parents[2]
    return next(path for path in (root / "test/robots" / name, root / "config/robots" / name) if path.exists())


@pytest.fixture
def in_units(tmp_path: Path) -> Callable[[str, str], Robot]:
    """Load a published robot whose file is converted to other units."""

    def load(name: str, units: str) -> Robot:
        root = ET.parse(path_of(name)).getroot()  # noqa: S314 - files of the tree
        for place, keys, factor in FACTORS[units]:
            for element in root.findall(place):
                for key in set(keys) & set(element.attrib):
                    element.set(key, " ".join(repr(float(word) * factor) for word in element.attrib[key].split()))
        path = tmp_path / name
        path.write_text(ET.tostring(root, encoding="unicode"), encoding="utf-8")
        return load_robot(path)

    return load


def doubts(robot: Robot) -> list[str]:
    return [note for note in robot.notes if note.startswith("check ")]


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_robot_raises_no_alarm(load_urdf_file: Callable[..., Robot], name: str) -> None:
    robot = load_urdf_file(name)
    assert robot.units_reason == ""
    assert doubts(robot) == []


def test_shipped_robot_raises_no_alarm_and_has_its_reach() -> None:
    robot = load_robot()
    assert (robot.units_reason, doubts(robot)) == ("", [])
    assert robot.reach == pytest.approx((0.55**2 + 0.45**2) ** 0.5, rel=0.05)


@pytest.mark.parametrize(("name", "reach"), [("ur5_robot.urdf", 0.93), ("ur10_robot.urdf", 1.32), ("panda.urdf", 0.94)])
def test_reach_is_that_of_the_flange(load_urdf_file: Callable[..., Robot], name: str, reach: float) -> None:
    assert load_urdf_file(name).reach == pytest.approx(reach, rel=0.05)


@pytest.mark.parametrize("name", PUBLISHED)
@pytest.mark.parametrize(
    ("units", "text"),
    [
        ("millimetres", "m long: must be in metres, not in millimetres"),
        ("grams", "must be in kilograms, not in grams"),
        ("tonnes", "must be in kilograms, not in tonnes"),
        ("degrees", "rad: must be in radians, not in degrees"),
    ],
)
def test_wrong_unit_is_named(in_units: Callable[[str, str], Robot], name: str, units: str, text: str) -> None:
    assert text in in_units(name, units).units_reason


@pytest.mark.parametrize("name", WITH_INERTIAS)
def test_wrong_unit_of_centres_of_mass_and_inertias_is_named(in_units: Callable[[str, str], Robot], name: str) -> None:
    assert "the centre of mass of" in in_units(name, "millimetres in centres of mass").units_reason
    assert "must be in kg m2, not kg mm2" in in_units(name, "kg mm2").units_reason


def test_other_wrong_units(in_units: Callable[[str, str], Robot]) -> None:
    assert "must be in metres, not in centimetres" in in_units("ur5_robot.urdf", "centimetres").units_reason
    with pytest.raises(RobotError, match=r"joint shoulder_lift_joint: <origin rpy> = .*: must be in radians"):
        in_units("ur5_robot.urdf", "degrees of frames")
    for units, text in (("g m2", "check the inertias: "), ("N mm", "check the effort limit of ")):
        robot = in_units("ur5_robot.urdf", units)
        assert robot.units_reason == ""
        assert any(text in note for note in doubts(robot))


@pytest.mark.parametrize("name", WITH_INERTIAS)
def test_inertia_tensors_far_too_small_for_the_arm_do_not_count(
    in_units: Callable[[str, str], Robot], name: str
) -> None:
    dynamics = RobotDynamics(in_units(name, "t m2"))
    assert dynamics.full_reason.startswith("the largest radius of gyration of a link is 0.000")
    assert dynamics.full_reason.endswith("correct the inertias, in kg m2")
    assert dynamics.robot.masses_reason == dynamics.robot.coms_reason == ""


def millimetres_grams_degrees(rows: dict[str, Any]) -> None:
    """Convert the DH rows of the shipped robot."""
    for joint in rows["joints"]:
        factor = DEGREES if joint["type"] == "revolute" else 1e3
        joint.update(a=joint["a"] * 1e3, lower=joint["lower"] * factor, upper=joint["upper"] * factor)
    for link in rows["links"]:
        link.update(mass=link["mass"] * 1e3, com=[1e3 * x for x in link["com"]])


def test_every_wrong_unit_of_a_file_is_named_and_the_monitor_refuses_it(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
) -> None:
    millimetres_grams_degrees(omron_rows)
    robot = load_rows(omron_rows)
    for text in (
        "the link from joint1 to joint2 is 275 m long: must be in metres, not in millimetres",
        "5040 kg move at a reach of 0.55 m: must be in kilograms, not in grams",
        "joint4 has a range of 720 rad: must be in radians, not in degrees",
    ):
        assert text in robot.units_reason
    with pytest.raises(RobotError, match=r"robot\.yaml: the link from joint1 to joint2 is 275 m long") as error:
        Monitor(RobotDynamics(robot), MonitorSettings())
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("key", ["alpha", "theta"])
def test_angle_of_a_dh_row_in_degrees_raises(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot], key: str
) -> None:
    omron_rows["joints"][1][key] = 180
    with pytest.raises(RobotError, match=rf"joints 2 .*: {key} = 180: must be in radians: 180 degrees are 3.14159265"):
        load_rows(omron_rows)


@pytest.mark.parametrize(
    ("change", "note"),
    [
        ({"joints.0.lower": -10.0, "joints.0.upper": 10.0}, "check the limits of joint1: 20 rad are more than three"),
        ({"joints.2.upper": 450.0}, "check the limits of joint3: it travels more than 10 m"),
        ({"joints.0.a": 3.1}, "check the lengths: reach "),
        ({"links.0.com": [1.5, 0.0, 0.0]}, "check the centre of mass of joint1: 1.5 m from its joint, reach 0.69"),
        ({"joints.2.max_effort": 0.5}, "check the effort limit of joint3: 0.5 N m or N, where gravity takes up to 5.4"),
        ({f"joints.{i}.armature": 900.0 for i in range(3)}, "check masses and inertias: the effective mass is "),
        ({"links.0.mass": 300.0}, "check the masses: 302 kg move at a reach of 0.69"),
    ],
)
def test_doubt_is_a_note_and_does_not_stop_the_monitor(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot], change: dict[str, Any], note: str
) -> None:
    for key, value in change.items():
        group, index, name = key.split(".")
        omron_rows[group][int(index)][name] = value
    robot = load_rows(omron_rows)
    assert any(note in doubt for doubt in doubts(robot)), doubts(robot)
    Monitor(RobotDynamics(robot), MonitorSettings())


def test_payload_far_above_the_moving_mass_is_a_note() -> None:
    robot = load_robot(settings=MonitorSettings(payload_mass=500.0))
    assert robot.units_reason == ""
    assert any("check the payload: 500.2 kg on 5.04 kg" in note for note in doubts(robot))


@pytest.mark.parametrize(("share", "is_doubtful"), [(1.0 - 1e-9, False), (1.0 + 1e-9, True)])
def test_payload_of_three_times_the_moving_mass_is_possible(share: float, is_doubtful: bool) -> None:  # noqa: FBT001
    bare = load_robot()
    robot = load_robot(settings=MonitorSettings(payload_mass=share * 3.0 * bare.moving_mass - bare.payload_mass))
    assert any("check the payload" in note for note in doubts(robot)) is is_doubtful


def test_too_many_joints_are_refused_before_their_dynamics_are_built(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
) -> None:
    joint, link = omron_rows["joints"][0], omron_rows["links"][0]
    for key, row in (("joints", joint), ("links", link)):
        omron_rows[key] = [{**row, "name": f"{key}{number}"} for number in range(65)]
    with pytest.raises(RobotError, match=r"65 joints move: must be at most 64"):
        load_rows(omron_rows)


def one_joint(**changes: object) -> dict[str, Any]:
    """Return DH rows of one revolute joint: reach 1 m, 1 kg at the joint, radius of gyration 0.5 m; with `changes`.

    A change is one of a row: of the joint, of the link, or of the file.
    """
    joint = {"name": "j1", "type": "revolute", "a": 1.0, "alpha": 0.0, "lower": -1.0, "upper": 1.0, "max_speed": 1.0}
    joint["max_effort"] = 0.0
    link = {"name": "l1", "mass": 1.0, "com": [0.0, 0.0, 0.0], "inertia": [0.25, 0.25, 0.25, 0.0, 0.0, 0.0]}
    rows: dict[str, Any] = {"robot": "arm", "base_frame": "base", "joints": [joint], "links": [link]}
    rows |= {"contact_points": {"tool": [0.0, 0.0, 0.0]}}
    for key, value in changes.items():
        next((row for row in (joint, link) if key in row), rows)[key] = value
    return rows


def sphere(radius: float, mass: float = 1.0) -> list[float]:
    """Return the inertia of a body with one radius of gyration [m] about all axes."""
    return [mass * radius**2] * 3 + [0.0] * 3


WRONG: list[tuple[str, dict[str, object], dict[str, object]]] = [
    ("m long: must be in metres, not in centimetres", {"a": 10.0}, {"a": 10.1}),
    ("m long: must be in metres, not in millimetres", {"a": 50.0}, {"a": 50.1}),
    ("25 kg move at a reach of 0.2 m: .* not in grams", {"a": 20.0, "mass": 23.9}, {"a": 20.0, "mass": 25.0}),
    ("101 kg move at a reach of 0.3 m: .* not in grams", {"a": 300.0, "mass": 80.9}, {"a": 300.0, "mass": 101.0}),
    ("not in grams", {"a": 0.5, "mass": 374.98}, {"a": 0.5, "mass": 375.02}),
    ("not in grams", {"a": 0.01, "mass": 0.37}, {"a": 0.01, "mass": 0.38}),
    ("not in tonnes", {"mass": 0.101}, {"mass": 0.099}),
    ("not in tonnes", {"mass": 0.06, "payload": {"mass": 0.06}}, {"mass": 0.06, "payload": {"mass": 0.03}}),
    ("the centre of mass of j1 is .* m away", {"com": [5.0, 0.0, 0.0]}, {"com": [5.1, 0.0, 0.0]}),
    (
        "the centre of mass of j1 is .* m away",
        {"a": 2.0, "mass": 8.0, "com": [6.0, 0.0, 0.0]},
        {"a": 2.0, "mass": 8.0, "com": [6.1, 0.0, 0.0]},
    ),
    ("1 kg at 10.* m: must be in kg m2", {"inertia": sphere(9.99)}, {"inertia": sphere(10.1)}),
    (
        "the inertia of j1 is that of 1 kg",
        {"inertia": [1.0, 1.0, 900.0, 0.0, 0.0, 0.0]},  # impossible, so not used
        {"inertia": [449.9, 450.2, 900.0, 0.0, 0.0, 0.0]},
    ),
    ("range of 50.* rad: .* not in degrees", {"lower": -25.0, "upper": 25.0}, {"lower": -25.1, "upper": 25.1}),
    ("range of 1500.* rad: .* not in degrees", {"lower": 0.0, "upper": 1500.5}, {"lower": 0.0, "upper": 1500.0}),
]
"""Part of the text, a robot without it and one with it, just within and beyond the bound."""


@pytest.mark.parametrize(("text", "within", "beyond"), WRONG)
def test_bounds_of_what_is_certainly_not_in_si_units(
    load_rows: Callable[[object], Robot], text: str, within: dict[str, object], beyond: dict[str, object]
) -> None:
    pattern = re.compile(text)
    assert not pattern.search(load_rows(one_joint(**within)).units_reason)
    assert pattern.search(load_rows(one_joint(**beyond)).units_reason)


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize(
    ("changes", "text"), [({"inertia": sphere(20.0)}, "inertia"), ({"com": [9.0, 0, 0]}, "centre")]
)
def test_one_body_out_of_proportion_is_named(
    load_rows: Callable[[object], Robot], number: int, changes: dict[str, object], text: str
) -> None:
    rows = one_joint(a=0.5, com=[0.1, 0.0, 0.0])
    for key in ("joints", "links"):
        rows[key].append({**rows[key][0], "name": f"{key}2"})
    rows["links"][number] |= changes
    joint = rows["joints"][number]["name"]
    assert re.search(rf"the {text}.* of {joint} is ", load_rows(rows).units_reason)


SLIDE = {"type": "prismatic", "upper": 1.0, "lower": 0.0}
LIGHT_SLIDE = SLIDE | {"a": 0.06, "upper": 0.01, "inertia": 0.0, "max_effort": 1e-5}

DOUBTS: list[tuple[str, dict[str, object], dict[str, object]]] = [
    ("check the lengths", {"a": 3.0, "mass": 30.0}, {"a": 3.01, "mass": 30.0}),
    (
        "check the lengths: reach 0.049 m, the link from j1 to the tip is 0.049 m long",
        {"a": 0.0501, "mass": 0.01},
        {"a": 0.049, "mass": 0.01},
    ),
    ("check the masses", {"a": 0.5, "mass": 74.98}, {"a": 0.5, "mass": 75.05}),
    ("check the masses", {"a": 0.5, "mass": 0.503}, {"a": 0.5, "mass": 0.497}),
    ("check the masses", {"a": 0.01, "mass": 0.074}, {"a": 0.01, "mass": 0.076}),
    ("check the centre of mass of j1", {"com": [0.99, 0.0, 0.0]}, {"com": [1.01, 0.0, 0.0]}),
    ("check the inertias: the largest radius", {"inertia": sphere(0.031)}, {"inertia": sphere(0.029)}),
    ("check the inertias: the largest radius", {"inertia": sphere(2.99)}, {"inertia": sphere(3.01)}),
    (
        "check the inertias: the largest radius",
        {"a": 2.0, "mass": 8.0, "inertia": [150.0, 150.0, 286.0, 0.0, 0.0, 0.0]},
        {"a": 2.0, "mass": 8.0, "inertia": [150.0, 150.0, 290.0, 0.0, 0.0, 0.0]},
    ),
    ("check the inertias: the largest radius", {"inertia": 0.0}, {"inertia": sphere(3.01)}),
    # Along one direction of three, the mass counts threefold: 3 I / a^2.
    ("check masses and inertias", {"inertia": sphere(0.99)}, {"inertia": sphere(1.01)}),
    ("check masses and inertias", {"inertia": sphere(0.0184)}, {"inertia": sphere(0.0182)}),
    (
        "check masses and inertias",
        {"inertia": sphere(0.6), "payload": {"mass": 1.0}},
        {"inertia": sphere(1.4), "payload": {"mass": 1.0}},
    ),
    (
        "typically 3.3 of the moving mass",
        {"mass": 10.0, "inertia": sphere(0.95, 10.0)},
        {"mass": 10.0, "inertia": sphere(1.05, 10.0)},
    ),
    ("check the payload", {"payload": {"mass": 2.99}}, {"payload": {"mass": 3.01}}),
    ("more than three turns", {"lower": 0.0, "upper": 18.857}, {"lower": 0.0, "upper": 18.862}),
    ("more than three turns", {"lower": 0.0, "upper": 1e5}, {"lower": 0.0, "upper": 99999.0}),
    ("travels more than 10 m", SLIDE | {"upper": 10.0}, SLIDE | {"upper": 10.1}),
    ("travels more than 10 m", SLIDE | {"upper": 1e5}, SLIDE | {"upper": 99999.0}),
    ("check the effort limit of j1", SLIDE | {"max_effort": 4.91}, SLIDE | {"max_effort": 4.90}),
    ("check the effort limit of j1", SLIDE | {"max_effort": 9809.0}, SLIDE | {"max_effort": 9811.0}),
    (
        "check the effort limit of j1",
        LIGHT_SLIDE | {"mass": 0.99e-4},  # a load below 1 mN is none
        LIGHT_SLIDE | {"mass": 1.05e-4},
    ),
]


@pytest.mark.parametrize(("text", "within", "beyond"), DOUBTS)
def test_bounds_of_what_is_worth_a_note(
    load_rows: Callable[[object], Robot], text: str, within: dict[str, object], beyond: dict[str, object]
) -> None:
    for changes, noted in ((within, False), (beyond, True)):
        robot = load_rows(one_joint(**changes))
        assert robot.units_reason == ""
        assert any(text in doubt for doubt in doubts(robot)) == noted, doubts(robot)


@pytest.mark.parametrize(("limit", "noted"), [(100.0, False), (1e6, True)])
def test_effort_limits_a_thousand_times_the_load_of_every_joint_are_a_note(
    load_rows: Callable[[object], Robot], limit: float, *, noted: bool
) -> None:
    """Two slides along gravity: one alone may have a high limit."""
    rows = one_joint(**SLIDE, max_effort=1e6)
    for key in ("joints", "links"):
        rows[key].append({**rows[key][0], "name": f"{key}2"})
    rows["joints"][1]["max_effort"] = limit
    assert any("check the effort limit" in doubt for doubt in doubts(load_rows(rows))) == noted


def test_reach_and_longest_link_count_contact_points(load_rows: Callable[[object], Robot]) -> None:
    robot = load_rows(one_joint(mass=64.0, contact_points={"near": [-0.5, 0.0, 0.0], "far": [3.0, 0.0, 0.0]}))
    assert robot.reach == pytest.approx(4.0)
    assert any("the link from j1 to far is 4 m long" in doubt for doubt in doubts(robot))


def test_height_of_the_first_joint_is_no_link(tmp_path: Path) -> None:
    root = ET.parse(path_of("ur5_robot.urdf")).getroot()  # noqa: S314 - file of the tree
    joint = next(joint for joint in root.iter("joint") if joint.get("name") == "shoulder_pan_joint")
    origin = joint.find("origin")
    assert origin is not None
    origin.set("xyz", "0 0 12")
    path = tmp_path / "tower.urdf"
    path.write_text(ET.tostring(root, encoding="unicode"), encoding="utf-8")
    robot = load_robot(path)
    assert (robot.units_reason, doubts(robot)) == ("", [])
    assert robot.reach == pytest.approx(0.93, rel=0.05)


def test_one_joint_in_radians_shows_that_all_are(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
) -> None:
    omron_rows["joints"][0].update(lower=-50.0, upper=50.0)
    assert load_rows(omron_rows).units_reason == ""


def test_joints_without_limits_are_not_in_degrees(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
) -> None:
    for joint in omron_rows["joints"]:
        if joint["type"] == "revolute":
            joint.update(lower=-1e6, upper=1e6)
    robot = load_rows(omron_rows)
    assert (robot.units_reason, doubts(robot)) == ("", [])


def test_placeholder_masses_are_not_judged(omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]) -> None:
    for joint in omron_rows["joints"][:2]:
        joint["a"] = 1.5
    for link in omron_rows["links"]:
        link.update(mass=1.0, inertia=sphere(1.0))
    robot = load_rows(omron_rows)
    assert robot.masses_reason
    assert doubts(robot) == []
