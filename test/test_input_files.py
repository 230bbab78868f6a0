# SPDX-License-Identifier: Apache-2.0
"""Any content of a parameter or robot file gives settings, a robot, or a one-line error with the place."""

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from scara_effmass.errors import EffmassError, RobotError, SettingsError
from scara_effmass.input_files import MAX_TEXT_BYTES, MAX_YAML_BYTES, read_text, read_yaml
from scara_effmass.model.load import load_robot
from scara_effmass.settings import DaqSettings, MonitorSettings, load_settings
from scara_effmass.settings.loading import applies
from scara_effmass.share import share

OMRON = share("config", "omron_i4_550l.yaml").read_text(encoding="utf-8")
UR5 = share("config", "robots", "ur5_robot.urdf").read_text(encoding="utf-8")
PARAMETERS = share("config", "daq.yaml").read_text(encoding="utf-8")
DIGITS = "1" * 5000
SNIPPETS = (
    *("2001-99-99", "!!int abc", "!!int ''", "!!float ''", "!!bool x", "!!timestamp x", "!!binary x", "!!set x"),
    *(DIGITS, f"0x{DIGITS}", f"-{DIGITS}.5", "1e308", "-1e308", "1e5000", ".nan", ".inf", "1:30", "0o17", "~", "yes"),
    *("[" * 500, "[" * 500 + "]" * 500, "{a: " * 500, "&a [*a]", "*b", "<<: 1", "? [1]", "!!python/name:os.system"),
    *("'", '"', "\t", "\x00", "\ud7ff", "\u2028", "%YAML 9.9", "---\n---", "|\n x", "1, 2: 3", "\n- 1", ": : :"),
)
"""Values that a typing error or a broken disk may put into a YAML file."""
XML_SNIPPETS = (
    *("<", ">", "&", "&bomb;", '"', "<link/>", "<joint/>", "<a>" * 2000, "<a>" * 2000 + "</a>" * 2000, "1e308", "nan"),
    *("-1e999", DIGITS, "", " ", "1 2", "1 2 3 4", "\x00", "base_link", "fixed", "floating", "mimic", "<!DOCTYPE x>"),
)


def one_line(error: EffmassError, path: Path) -> None:
    """Require one line that begins with the file."""
    text = str(error)
    assert text.startswith((f"{path}: ", "contact_points"))
    assert "\n" not in text
    assert len(text) <= 2000


def spoilt(text: str, place: float, length: int, snippet: str) -> str:
    """Return `text` with `snippet` in place of `length` characters."""
    start = int(place * len(text))
    return text[:start] + snippet + text[start + length :]


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("files")


places = st.floats(0.0, 1.0)
lengths = st.integers(0, 40)
yaml_snippets = st.sampled_from(SNIPPETS) | st.text(max_size=8)


@pytest.mark.parametrize(
    "damage",
    [
        *(f"robot: {snippet}" for snippet in SNIPPETS),
        *(f"robot: x\njoints: {snippet}" for snippet in SNIPPETS),
    ],
)
def test_each_damage_gives_one_line(folder: Path, damage: str) -> None:
    path = folder / "robot.yaml"
    path.write_text(damage, encoding="utf-8", newline="")
    with pytest.raises(RobotError) as error:
        load_robot(path)
    one_line(error.value, path)


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=places, length=lengths, snippet=yaml_snippets)
@example(place=0.19, length=9, snippet=": 2001-99-99\n")
@example(place=0.999, length=0, snippet="\nrobot: x")
def test_damaged_dh_file_gives_a_robot_or_one_line(folder: Path, place: float, length: int, snippet: str) -> None:
    path = folder / "robot.yaml"
    path.write_text(spoilt(OMRON, place, length, snippet), encoding="utf-8", newline="")
    try:
        load_robot(path)
    except RobotError as error:
        one_line(error, path)


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=places, length=lengths, snippet=yaml_snippets)
@example(place=1.0, length=0, snippet="    filter: 5\n    filter.cutoff: {x: 1}\n")
def test_damaged_parameter_file_gives_settings_or_one_line(
    folder: Path, place: float, length: int, snippet: str
) -> None:
    path = folder / "cell.yaml"
    path.write_text(spoilt(PARAMETERS, place, length, snippet), encoding="utf-8", newline="")
    try:
        load_settings(DaqSettings, path, "daq")
    except SettingsError as error:
        one_line(error, path)


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=places, length=lengths, snippet=st.sampled_from(XML_SNIPPETS) | st.text(max_size=8))
def test_damaged_urdf_gives_a_robot_or_one_line(folder: Path, place: float, length: int, snippet: str) -> None:
    path = folder / "robot.urdf"
    path.write_text(spoilt(UR5, place, length, snippet), encoding="utf-8", newline="")
    try:
        load_robot(path)
    except RobotError as error:
        one_line(error, path)


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=st.binary(max_size=60), name=st.sampled_from(["robot.yaml", "robot.urdf", "robot"]))
def test_random_bytes_give_one_line(folder: Path, content: bytes, name: str) -> None:
    path = folder / name
    path.write_bytes(content)
    with pytest.raises(RobotError) as error:
        load_robot(path)
    one_line(error.value, path)
    with pytest.raises(SettingsError) as refusal:
        load_settings(MonitorSettings, path, "monitor")
    one_line(refusal.value, path)


NUMBERED = UR5.replace('value="3.7"', 'value="{number}"', 1)


@pytest.mark.parametrize("number", ["1e308", "1e999", "nan", DIGITS, "3,7", ""])
def test_number_of_a_urdf_that_would_overflow_is_named(folder: Path, number: str) -> None:
    path = folder / "ur5.urdf"
    assert "{number}" in NUMBERED
    path.write_text(NUMBERED.replace("{number}", number), encoding="utf-8")
    with pytest.raises(RobotError, match=r"ur5\.urdf: link shoulder_link: <mass value> = ") as error:
        load_robot(path)
    one_line(error.value, path)


def test_entities_and_deep_elements_of_a_urdf_are_refused(folder: Path) -> None:
    path = folder / "bomb.urdf"
    for text, rule in (
        ('<!DOCTYPE r [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]><robot name="&b;"/>', "must not define XML entities"),
        (UR5.replace("</robot>", "<a>" * 5000 + "</a>" * 5000 + "</robot>"), "cannot read it"),
        (UR5.replace("</robot>", '<joint name="x" type="fixed"/>' * 600 + "</robot>"), "joints: must be at most 500"),
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(RobotError, match=rule) as error:
            load_robot(path)
        one_line(error.value, path)


def test_only_regular_files_are_read(folder: Path) -> None:
    fifo = folder / "fifo.yaml"
    os.mkfifo(fifo)
    for path in (fifo, folder, Path("/dev/zero")):
        for load in (
            lambda path=path: load_robot(path),
            lambda path=path: load_settings(MonitorSettings, path, "monitor"),
        ):
            with pytest.raises(EffmassError, match="cannot be read: must be a regular file"):
                load()


def test_parameter_file_may_not_name_a_device_as_the_robot(folder: Path) -> None:
    path = folder / "device.yaml"
    path.write_text("/**:\n  ros__parameters:\n    robot: /dev/zero\n", encoding="utf-8")
    parameters = load_settings(MonitorSettings, path, "monitor")
    with pytest.raises(RobotError, match=r"^/dev/zero: cannot be read: must be a regular file$"):
        load_robot(settings=parameters)


def test_size_is_bounded(folder: Path) -> None:
    path = folder / "large"
    with path.open("wb") as file:
        file.truncate(1 << 40)  # a sparse file of 1 TB
    with pytest.raises(RobotError, match=f"large: must not be larger than {MAX_TEXT_BYTES / 1e6:g} MB"):
        read_text(path, RobotError)
    with pytest.raises(SettingsError, match=f"large: must not be larger than {MAX_YAML_BYTES / 1e6:g} MB"):
        read_yaml(path, SettingsError)


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("a: 1\nb: !!int abc", "line 2, column 4: 'abc': must be a valid int"),
        (f"a: 1\nb: {DIGITS}", "line 2, column 4: "),
        ("a: &x [*x]", "line 1, column 8: must not use an alias inside of an anchored value"),
        ("a: &x [1, 2]\nb: &y [*x]", "line 2, column 8: must not use an alias inside of an anchored value"),
        ("a: &x [" + "1," * 5000 + "]\nb: [*x, *x, *x]\nc: *x", "line 2, column 13: must hold at most 20000 values"),
        ("a: 1\na: 2", "line 2, column 1: must state a once"),
        ("a:\n  b: [1, 2\nc: 3", "line 3, column 2: "),
        ("a: " + "[" * 30, "line 1, column 2.: must nest at most 20 levels"),
    ],
)
def test_place_in_a_yaml_file_is_named(folder: Path, text: str, place: str) -> None:
    path = folder / "file.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SettingsError, match=f"file.yaml: not YAML: {place}"):
        read_yaml(path, SettingsError)


def test_bytes_that_are_not_utf8_are_named_with_their_line(folder: Path) -> None:
    path = folder / "latin.yaml"
    path.write_bytes("a: 1\n# Gr\u00f6\u00dfe\n".encode("latin-1"))
    with pytest.raises(SettingsError, match=r"latin\.yaml: line 2: must be UTF-8 text"):
        read_yaml(path, SettingsError)


def test_values_are_read_as_ros_reads_them(folder: Path) -> None:
    path = folder / "values.yaml"
    path.write_text("[1e-3, 2E5, .5e1, 1.5, 7, 2001-12-31, 'x', true]", encoding="utf-8")
    assert read_yaml(path, SettingsError) == [1e-3, 2e5, 5.0, 1.5, 7, "2001-12-31", "x", True]
    path.write_text("a: &com [0, 1]\nb: *com", encoding="utf-8")  # as yaml.safe_dump writes a list that occurs twice
    assert read_yaml(path, SettingsError) == {"a": [0, 1], "b": [0, 1]}


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("contact_area_m2: 10", "contact_area_m2 = 10: must be DOUBLE, is INTEGER: write 10.0"),
        ("timeout: '0.1'", "timeout = '0.1': must be DOUBLE, is STRING: write 0.1"),
        ("timeout: 0,1", "timeout = '0,1': must be DOUBLE, is STRING: write 0.1"),
        ("timeout: fast", "timeout = 'fast': must be DOUBLE, is STRING"),
        ("latch: 1", "latch = 1: must be BOOL, is INTEGER"),
        (
            "body_regions: hand_fingers",
            r"body_regions = 'hand_fingers': must be STRING_ARRAY, is STRING: write \[hand_f",
        ),
        (
            "payload_com: [0, 0, 1]",
            r"payload_com = .*: must be DOUBLE_ARRAY, is INTEGER_ARRAY: write \[0.0, 0.0, 1.0\]",
        ),
        (
            "payload_com: [0.1, 0, 1]",
            r"payload_com = .*: must be DOUBLE_ARRAY, is a mixed list: write \[0.1, 0.0, 1.0\]",
        ),
        ("payload_com: [0.1, x, 1]", "payload_com = .*: must be DOUBLE_ARRAY, is a mixed list$"),
        ("servo: {damping: 1}", "servo.damping = 1: must be DOUBLE, is INTEGER: write 1.0"),
        ("robot: 12", "robot = 12: must be STRING, is INTEGER: YAML needs quotes"),
        ("person_speeds: 1.0", "person_speeds: unknown: must be person_speed"),
        ("contact_area_m2: 0.0", "contact_area_m2 = 0.0: must be greater than 0"),
        ("contact_area: 2.0", "contact_area: unknown: must be contact_area_m2 or contact_areas$"),
        ("contact_area_m2: 2.0", r"contact_area_m2 = 2.0: must be less than or equal to 0\.1$"),
        ("speed_threshold: 0.03", r"speed_threshold = 0.03: must be less than or equal to 0\.02$"),
    ],
)
def test_parameter_file_of_a_command_obeys_the_types_of_ros(folder: Path, line: str, message: str) -> None:
    path = folder / "types.yaml"
    path.write_text(f"/**:\n  ros__parameters:\n    {line}\n", encoding="utf-8")
    with pytest.raises(SettingsError, match=rf"types\.yaml: {message}") as error:
        load_settings(MonitorSettings, path, "monitor")
    one_line(error.value, path)


def test_parameters_of_other_nodes_under_all_nodes_are_ignored(folder: Path) -> None:
    path = folder / "shared.yaml"
    shared = "/**:\n  ros__parameters: {controller_rate: 500, sensor: {sensitivity: 2.0}, timeout: 0.1}\n"
    path.write_text(shared, encoding="utf-8")
    assert load_settings(MonitorSettings, path, "monitor") == MonitorSettings(timeout=0.1)
    path.write_text("monitor:\n  ros__parameters: {controller_rate: 500}\n", encoding="utf-8")
    with pytest.raises(SettingsError, match="controller_rate: unknown: must be"):
        load_settings(MonitorSettings, path, "monitor")


def test_former_name_of_the_body_mass_is_refused(folder: Path) -> None:
    path = folder / "former.yaml"
    path.write_text("monitor:\n  ros__parameters: {obstacle_mass: 2.0}\n", encoding="utf-8")
    with pytest.raises(SettingsError, match=r"obstacle_mass: unknown: must be robot,.*, body_mass,") as error:
        load_settings(MonitorSettings, path, "monitor")
    one_line(error.value, path)


def test_list_may_be_empty_and_a_number_may_have_an_exponent(folder: Path) -> None:
    path = folder / "types.yaml"
    path.write_text("/**:\n  ros__parameters: {body_regions: [], timeout: 1e-1}\n", encoding="utf-8")
    assert load_settings(MonitorSettings, path, "monitor").timeout == 0.1


@pytest.mark.parametrize(
    "text",
    [
        "/cell/monitor:\n  ros__parameters: {timeout: 0.1}\n",
        "/cell:\n  monitor:\n    ros__parameters: {timeout: 0.1}\n",
        "/**/monitor:\n  ros__parameters: {timeout: 0.1}\n/cell/daq:\n  ros__parameters: {timeout: 5}\n",
        "/cell/*:\n  ros__parameters: {timeout: 0.1}\n/cell/monitor:\n  ros__parameters: {}\n",
    ],
    ids=["ros2 param dump", "levels", "any namespace", "one level"],
)
def test_parameters_of_a_node_in_a_namespace_count(folder: Path, text: str) -> None:
    path = folder / "cell.yaml"
    path.write_text(text, encoding="utf-8")
    assert load_settings(MonitorSettings, path, "monitor") == MonitorSettings(timeout=0.1)


BELOW = "must be below ros__parameters, or a section with it"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("/*/monitor:\n  ros__parameters: {timeout: 0.1}\n", r"/\*/monitor: must be /monitor or /\*\*/monitor"),
        ("/a/**:\n  ros__parameters: {timeout: 0.1}\n", r"/a/\*\*: must be /monitor or /\*\*/monitor"),
        (
            "/a/monitor:\n  ros__parameters: {}\n/b/*:\n  ros__parameters: {timeout: 0.1}\n",
            r"/b/\*: must be /a/monitor or /\*\*/monitor",
        ),
        (
            "monitor:\n  ros__parameters: {servo.bandwidth: 9.0, servo: {bandwidth: 3.0}}\n",
            "monitor: servo.bandwidth: must be stated once",
        ),
        (
            "a:\n  monitor:\n    ros__parameters: {timeout: 0.1}\na/monitor:\n  ros__parameters: {timeout: 0.2}\n",
            "a/monitor: must be stated once",
        ),
        ("monitor:\n  ros__parameters: {timeout: 0.1}\n  person_speed: 1.6\n", f"monitor: person_speed: {BELOW}"),
        (
            "/**:\n  person_speed: 1.6\n  monitor:\n    ros__parameters: {timeout: 0.1}\n",
            rf"/\*\*/person_speed: {BELOW}",
        ),
        (
            "/**:\n  ros__parameters: {timeout: 0.1}\n  monitor:\n    ros__parameters: {person_speed: 1.6}\n",
            rf"/\*\*: monitor: {BELOW}",
        ),
        (
            "/**:\n  ros__parameters:\n    ros__parameters: {person_speed: 1.6}\n",
            r"/\*\*: ros__parameters: must be stated once",
        ),
    ],
)
def test_parameters_that_ros_would_take_otherwise_are_refused(folder: Path, text: str, problem: str) -> None:
    path = folder / "cell.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SettingsError, match=rf"^{path}: {problem}$"):
        load_settings(MonitorSettings, path, "monitor")


def test_whole_arm_without_links_is_refused(folder: Path) -> None:
    """An empty list states nothing: it left every link out, and counted as a statement of what is watched."""
    path = folder / "cell.yaml"
    path.write_text("monitor:\n  ros__parameters: {contact_points: [whole_arm], contact_links: []}\n", encoding="utf-8")
    with pytest.raises(SettingsError, match=rf"^{path}: contact_links = \[\]: must not be empty$"):
        load_settings(MonitorSettings, path, "monitor")


def test_parameters_of_the_node_in_several_namespaces_are_refused(folder: Path) -> None:
    path = folder / "cells.yaml"
    section = "/{}/monitor:\n  ros__parameters: {{timeout: {}}}\n"
    path.write_text(section.format("a", 0.1) + section.format("b", 0.2), encoding="utf-8")
    with pytest.raises(
        SettingsError, match=r"holds /a/monitor, /b/monitor: must hold monitor once, or in /\*\*"
    ) as error:
        load_settings(MonitorSettings, path, "monitor")
    one_line(error.value, path)


@pytest.mark.parametrize(
    ("section", "root", "cell"),
    [
        ("monitor", True, False),
        ("/monitor", True, False),
        ("cell/monitor", False, True),
        ("/cell/monitor", False, True),
        ("/other/monitor", False, False),
        ("/**/monitor", True, True),
        ("/*/monitor", False, True),
        ("/cell/*", False, True),
        ("/cell/**/monitor", False, True),
        ("/**", True, True),
        ("/**/daq", False, False),
    ],
)
def test_section_applies_as_in_ros(section: str, *, root: bool, cell: bool) -> None:
    """As rclpy 7 gave the parameters to two nodes."""
    assert (applies(section, "/monitor"), applies(section, "/cell/monitor")) == (root, cell)
