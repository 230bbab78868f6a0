# SPDX-License-Identifier: Apache-2.0
"""DH files: values are read as stated, and every wrong value is named in one line."""

import copy
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from scara_effmass.errors import RobotError
from scara_effmass.model.load import load_robot
from scara_effmass.model.robot import Robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import MonitorSettings

OMRON = Path(__file__).resolve().parents[2] / "config" / "omron_i4_550l.yaml"


def put(rows: dict[str, Any], key: str, value: object) -> None:
    """Set the dotted `key` of nested rows; `...` deletes it."""
    *path, last = [int(part) if part.isdigit() else part for part in key.split(".")]
    place: Any = rows
    for part in path:
        place = place[part]
    if value is ...:
        del place[last]
    else:
        place[last] = value


def test_shipped_file(omron: Robot) -> None:
    assert omron.name == "omron_i4_550l"
    assert omron.base_frame == "base_link"
    assert omron.joint_names == ("joint1", "joint2", "joint3", "joint4")
    assert omron.revolute == (True, True, False, True)
    assert list(omron.contact_frames) == ["tool"]
    assert (omron.masses_reason, omron.coms_reason, omron.inertias_reason) == ("", "", "")
    np.testing.assert_allclose(np.degrees(omron.model.upperPositionLimit[:2]), [136.0, 148.0], atol=0.01)
    assert omron.model.velocityLimit.tolist() == [12.6, 12.6, 3.0, 50.0]


def test_limits_by_option_replace_those_of_the_file(omron_rows: dict[str, Any], tmp_path: Path) -> None:
    put(omron_rows, "joints.0.lower", ...)
    put(omron_rows, "joints.1.upper", -9.0)
    path = tmp_path / "robot.yaml"
    path.write_text(yaml.safe_dump(omron_rows), encoding="utf-8")
    robot = load_robot(path, MonitorSettings(joint_limits=("joint1=-1 2", "joint2=-0.5 0.5")))
    assert robot.model.lowerPositionLimit.tolist()[:2] == [-1.0, -0.5]
    assert robot.model.upperPositionLimit.tolist()[:2] == [2.0, 0.5]
    with pytest.raises(RobotError, match="joint_limits = 'joint2=-90 90': must be in radians, not in degrees"):
        load_robot(OMRON, MonitorSettings(joint_limits=("joint2=-90 90",)))
    with pytest.raises(RobotError, match="joint_limits = 'joint5': must be joint"):
        load_robot(OMRON, MonitorSettings(joint_limits=("joint5=-1 2",)))


def test_samples_cover_the_joint_limits(omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]) -> None:
    for joint, (lower, upper) in enumerate(((4.0, 6.0), (-6.0, -4.5), (5.0, 5.3), (-100.0, 100.0))):
        omron_rows["joints"][joint].update(lower=lower, upper=upper)
    robot = load_rows(omron_rows)
    samples = robot.sample_configurations()
    assert np.all(samples >= robot.model.lowerPositionLimit)
    assert np.all(samples <= robot.model.upperPositionLimit)
    span = np.minimum(robot.model.upperPositionLimit - robot.model.lowerPositionLimit, 2.0 * np.pi)
    assert np.all(np.ptp(samples, axis=0) > 0.8 * span)
    assert np.array_equal(samples, robot.sample_configurations())


def test_contact_points_can_be_selected(omron_rows: dict[str, Any], tmp_path: Path) -> None:
    omron_rows["contact_points"] = {"tool": [0, 0, 0], "edge": [0.1, 0, 0], "corner": [0.1, 0.1, 0]}
    path = tmp_path / "robot.yaml"
    path.write_text(yaml.safe_dump(omron_rows))
    assert list(load_robot(path, MonitorSettings(contact_points=("edge", "tool", "edge"))).contact_frames) == [
        "edge",
        "tool",
    ]
    with pytest.raises(RobotError, match=r"robot\.yaml: contact_points = 'elbow': must be one of"):
        load_robot(path, MonitorSettings(contact_points=("elbow",)))


@pytest.mark.parametrize(
    ("key", "value", "named"),
    [
        ("robot", ..., "robot: must be present"),
        ("base_frame", "", "base_frame = .*: "),
        ("joints.1.name", "", r"joints 2.*name = '': must not be empty"),
        ("joints.1.a", ..., r"joints 2 \(joint2\): a: must be present"),
        ("joints.1.a", "long", r"joints 2 \(joint2\): a = .*: .* number"),
        ("joints.1.a", True, r"joints 2 \(joint2\): a = .*: .* number"),
        ("joints.1.a", float("nan"), r"joints 2 \(joint2\): a = .*: .* finite"),
        ("joints.1.a", float("inf"), r"joints 2 \(joint2\): a = .*: .* finite"),
        ("joints.1.a", 1e300, r"joints 2 \(joint2\): a = .*: "),
        ("joints.1.a", [1.0], r"joints 2 \(joint2\): a = .*: "),
        ("joints.2.type", "spherical", r"joints 3 \(joint3\): type = .*: .*'revolute' or 'prismatic'"),
        ("joints.0.lower", 3.0, r"joints 1 \(joint1\): lower = 3.0: must be < upper = 2.3736"),
        ("joints.0.lower", 2.3736, r"joints 1 \(joint1\): lower = 2.3736: must be <"),
        ("joints.0.max_speed", 0.0, r"joints 1 \(joint1\): max_speed = .*: .*greater than 0"),
        ("joints.0.armature", -0.1, r"joints 1 \(joint1\): armature = .*: .*greater than or equal to 0"),
        ("joints.0.armatur", 0.1, r"joints 1 \(joint1\): armatur: unknown: must be armature"),
        ("joints.3.name", "joint1", "file: joint names .* must differ"),
        ("joints.3", ..., "file: 4 links for 3 joints"),
        ("joints", [], "joints = .*: "),
        ("joints", {"name": "joint1"}, "joints: "),
        ("links.0.name", "", r"links 1.*name = '': must not be empty"),
        ("joints", [], r"joints = \[\]: must not be empty"),
        ("links.0.mass", -2.74, r"links 1 \(link1\): mass = .*: .*greater than or equal to 0"),
        ("links.0.mass", float("nan"), r"links 1 \(link1\): mass = .*: .* finite"),
        ("links.0.mass", ..., r"links 1 \(link1\): mass: must be present"),
        ("links.0.com", [0.1, 0.0], r"links 1 \(link1\): com"),
        ("links.0.com", [0.1, 0.0, float("nan")], r"links 1 \(link1\): com 3 = .*: .* finite"),
        ("links.0.com", ..., r"links 1 \(link1\): com: must be present"),
        ("links.1.inertia", -0.02, r"links 2 \(link2\): inertia = .*: .*must not be negative"),
        ("links.1.inertia", [1.0, 1.0, 1.0, 2.0, 0.0, 0.0], r"links 2 \(link2\): inertia = .*: .*must not be negative"),
        ("links.1.inertia", [1.0, 1.0, 1.0], r"links 2 \(link2\): inertia"),
        ("joints.0.alpha", 1.5, "file: inertia of link1 = 0.02952: must be six numbers"),
        ("payload.mass", ..., "payload.mass: must be present"),
        ("payload.inertia", -1.0, "payload.inertia = .*: .*must not be negative"),
        ("contact_points", {}, "contact_points: "),
        ("contact_points.tool", [0.0, 0.0], "contact_points.tool"),
        ("contact_points.tool", None, "contact_points.tool"),
        ("contact_points.tool", {"link": 1}, "contact_points.tool.at: must be present"),
        ("contact_points.tool", {"link": True, "at": [0, 0, 0]}, r"contact_points\.tool\.link"),
        (
            "contact_points.tool",
            {"link": 5, "at": [0, 0, 0]},
            "file: contact_points.tool: link = 5: must be 1 to 4, or",
        ),
        (
            "contact_points.tool",
            {"link": 0, "at": [0, 0, 0]},
            "file: contact_points.tool: link = 0: must be 1 to 4, or",
        ),
        ("contact_points.tool", {"link": "arm", "at": [0, 0, 0]}, "file: contact_points.tool: link = 'arm': must be 1"),
    ],
)
def test_wrong_value_is_named(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot], key: str, value: object, named: str
) -> None:
    put(omron_rows, key, value)
    with pytest.raises(RobotError, match=rf"robot\.yaml: {named}") as error:
        load_rows(omron_rows)
    assert "\n" not in str(error.value)


def test_contact_point_on_one_of_two_links_of_the_same_name_needs_its_number(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
) -> None:
    omron_rows["links"][1]["name"] = omron_rows["links"][0]["name"]
    omron_rows["contact_points"] = {"elbow": {"link": "link1", "at": [0.0, 0.0, 0.0]}}
    with pytest.raises(RobotError, match=r"contact_points.elbow: link = 'link1': must be a number, because several"):
        load_rows(omron_rows)
    omron_rows["contact_points"]["elbow"]["link"] = 2
    robot = load_rows(omron_rows)
    assert robot.model.frames[robot.contact_frames["elbow"]].parentJoint == 2


def test_name_of_one_letter_is_valid(omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]) -> None:
    robot = load_rows(omron_rows | {"robot": "r", "base_frame": "b"})
    assert (robot.name, robot.base_frame) == ("r", "b")


def test_parameters_beside_another_key_are_no_robot(tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text("version: 1\nmonitor: {ros__parameters: {robot: arm.urdf}}\n")
    with pytest.raises(RobotError, match=r"cell\.yaml: holds parameters of version, monitor: must be a robot"):
        load_robot(path)


@pytest.mark.parametrize(
    "content", [b"", b"just words", b"- 1", b"a: [", b"\xff\xfe\x00", b"\x00", b"a: !!python/none x"]
)
def test_file_that_is_not_a_robot_raises(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "robot.yaml"
    path.write_bytes(content)
    with pytest.raises(RobotError, match=r"robot\.yaml: ") as error:
        load_robot(path)
    assert "\n" not in str(error.value)


def test_missing_file_and_folder_raise(tmp_path: Path) -> None:
    for path in (tmp_path / "none.yaml", tmp_path):
        with pytest.raises(RobotError, match="cannot be read"):
            load_robot(path)


def test_robot_without_mass_raises(omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]) -> None:
    for body in (*omron_rows["links"], omron_rows["payload"]):
        body["mass"] = 0.0
    with pytest.raises(RobotError, match=r"robot\.yaml: the moving links have no mass"):
        load_rows(omron_rows)


def test_link_without_mass_leaves_no_model(omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]) -> None:
    omron_rows["links"][1]["mass"] = 0.0
    dynamics = RobotDynamics(load_rows(omron_rows))
    for reason in (dynamics.robot.masses_reason, dynamics.lumped_reason, dynamics.full_reason):
        assert reason.startswith("no mass behind joint2")


def test_impossible_inertia_leaves_the_lumped_model(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
) -> None:
    omron_rows["links"][1]["inertia"] = [0.001, 0.001, 0.0227, 0.0, 0.0, 0.0]
    dynamics = RobotDynamics(load_rows(omron_rows))
    assert "the inertia of link2 is impossible" in dynamics.full_reason
    assert dynamics.lumped is not None


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e3])
def test_single_inertia_satisfies_the_triangle_inequality(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot], scale: float
) -> None:
    for link in omron_rows["links"]:
        link["inertia"] *= scale
    assert "cannot belong" not in load_rows(omron_rows).inertias_reason


def test_payload_without_a_centre_of_mass_is_at_the_last_frame(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
) -> None:
    omron_rows["payload"]["com"] = [0.0, 0.0, 0.0]
    stated = load_rows(omron_rows)
    del omron_rows["payload"]["com"]
    assert load_rows(omron_rows).model.inertias[4].isApprox(stated.model.inertias[4])


def test_payload_inertia_alone_gives_no_full_model(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
) -> None:
    for link in omron_rows["links"]:
        del link["inertia"]
    assert load_rows(omron_rows).inertias_reason == "the file gives no inertia tensors"


def test_massless_links_need_no_inertia(omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]) -> None:
    for link in omron_rows["links"]:
        del link["inertia"]
    omron_rows["links"][3]["mass"] = 0.0
    assert load_rows(omron_rows).masses_reason == ""


def test_placeholders_are_recognised(omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]) -> None:
    for link in omron_rows["links"]:
        link.update(mass=1.0, inertia=[1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    robot = load_rows(omron_rows)
    assert "placeholders" in robot.masses_reason
    assert robot.coms_reason
    assert robot.inertias_reason
    assert RobotDynamics(robot).lumped is None


def test_centres_of_mass_at_the_origins_are_placeholders(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
) -> None:
    for link in omron_rows["links"]:
        link["com"] = [0.0, 0.0, 0.0]
    dynamics = RobotDynamics(load_rows(omron_rows))
    assert "placeholders" in dynamics.lumped_reason
    assert "placeholders" in dynamics.full_reason
    assert dynamics.robot.masses_reason == ""


scalars = st.none() | st.booleans() | st.text(max_size=3) | st.integers(-5, 5) | st.floats()
values = scalars | st.lists(scalars, max_size=6) | st.dictionaries(st.text(max_size=3), scalars, max_size=2)


def leaves(node: object, path: str = "") -> list[str]:
    """Dotted keys of everything in the rows, branches included."""
    children = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    keys = [f"{path}{key}" for key, _ in children]
    children = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    return keys + [key for name, child in children for key in leaves(child, f"{path}{name}.")]


ROWS = yaml.safe_load(OMRON.read_text())


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(changes=st.lists(st.tuples(st.sampled_from(leaves(ROWS)), values | st.just(...)), min_size=1, max_size=2))
def test_mutated_file_raises_or_gives_finite_masses(
    load_rows: Callable[[object], Robot],
    assert_raises_or_finite: Callable[[Callable[[], Robot]], None],
    changes: list[tuple[str, object]],
) -> None:
    rows = copy.deepcopy(ROWS)
    for key, value in changes:
        with suppress(KeyError, IndexError, TypeError):  # the first change may take away where the second would go
            put(rows, key, value)
    assert_raises_or_finite(lambda: load_rows(rows))


def test_inertias_of_some_links_give_no_full_model(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
) -> None:
    del omron_rows["links"][1]["inertia"]
    dynamics = RobotDynamics(load_rows(omron_rows))
    assert dynamics.full_reason == "no inertia tensor for link2, while other links have one"
    assert not dynamics.lumped_reason


@pytest.mark.parametrize(("excess", "possible"), [(0.9e-3, True), (1.1e-3, False)])
def test_triangle_inequality_has_a_tolerance_of_a_thousandth(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot], excess: float, *, possible: bool
) -> None:
    omron_rows["links"][1]["inertia"] = [0.01, 0.01, 0.02 * (1.0 + excess), 0.0, 0.0, 0.0]
    assert (load_rows(omron_rows).inertias_reason == "") == possible


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_numbers_up_to_a_million_are_valid(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot], sign: float
) -> None:
    omron_rows["joints"][1]["d"] = sign * 1e6
    load_rows(omron_rows)
    omron_rows["joints"][1]["d"] = sign * 1.01e6
    with pytest.raises(RobotError, match=r"joints 2 \(joint2\): d = "):
        load_rows(omron_rows)


def test_single_inertia_of_zero_is_valid_for_any_axes(
    omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]
) -> None:
    omron_rows["joints"][0]["alpha"] = 1.1
    for body in (*omron_rows["links"], omron_rows["payload"]):
        body["inertia"] = 0.0
    assert load_rows(omron_rows).inertias_reason == "the file gives no inertia tensors"


def test_very_light_robot_has_a_lumped_model(omron_rows: dict[str, Any], load_rows: Callable[[object], Robot]) -> None:
    for body in (*omron_rows["links"], omron_rows["payload"]):
        body["mass"] *= 1e-9
    assert RobotDynamics(load_rows(omron_rows)).lumped_reason == ""
