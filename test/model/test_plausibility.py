# SPDX-License-Identifier: Apache-2.0
"""Descriptions that are not in SI units are recognised and named; published robots raise no false alarm."""

import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from scara_effmass.errors import RobotError
from scara_effmass.model.dynamics import RobotDynamics
from scara_effmass.model.load import load_robot
from scara_effmass.model.robot import Robot
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


def test_too_many_joints_are_refused_before_their_dynamics_are_built(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
) -> None:
    joint, link = omron_rows["joints"][0], omron_rows["links"][0]
    for key, row in (("joints", joint), ("links", link)):
        omron_rows[key] = [{**row, "name": f"{key}{number}"} for number in range(65)]
    with pytest.raises(RobotError, match=r"65 joints move: must be at most 64"):
        load_rows(omron_rows)
