# SPDX-License-Identifier: Apache-2.0
"""Start and end of the monitor: one error line and exit code 2 for invalid input, 0 after a signal."""

import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from scara_effmass.errors import SettingsError
from scara_effmass.nodes.monitor_node import MonitorNode
from scara_effmass.nodes.ros import ClientNode
from scara_effmass.share import share
from test.nodes.conftest import MONITOR_NODE, NodeHarness

PARAMS = "/**:\n  ros__parameters:\n    {}\n"


@pytest.fixture
def paths(tmp_path: Path) -> dict[str, Path]:
    """Return the paths of a missing file, one with a misspelt parameter, and one that is not valid YAML."""
    files = {name: tmp_path / f"{name}.yaml" for name in ("missing", "typo", "broken", "cell")}
    files["typo"].write_text(PARAMS.format("time_out: 1.0"), encoding="utf-8")
    files["broken"].write_text("/**: [1\n", encoding="utf-8")
    files["cell"].write_text(PARAMS.format("timeout: 1.0").replace("/**", "/cell/monitor"), encoding="utf-8")
    return files


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ("--ros-args --params-file {typo}", "monitor: no parameter 'time_out': must be timeout"),
        ("--ros-args -p payload:=5.0", "monitor: no parameter 'payload': must be payload_"),
        ("--ros-args -p monitor:nonsense:=1", "monitor: no parameter 'nonsense': must be robot,"),
        ("--ros-args -p robot:={missing}", "{missing}: cannot be read: No such file or directory"),
        (
            "--ros-args --params-file {cell}",
            "{cell}: /cell/monitor: must be /monitor or /**/monitor, or start the node",
        ),
        ("--ros-args -r __ns:=/other --params-file {cell}", "{cell}: /cell/monitor: must be /other/monitor or /**/"),
        ("--ros-args -r __ns:=/cell --params-file {cell} -p latch:=1", "monitor: latch = 1: must be BOOL"),
        ("--ros-args --params-file {missing}", "ROS arguments: "),
        ("--ros-args --params-file {broken}", "ROS arguments: "),
        ("--ros-args -p timeout=0.1", "-p timeout=0.1: must be NAME:=VALUE: write timeout:=0.1"),
        ("--ros-args -r joint_states", "-r joint_states: must be NAME:=VALUE"),
        ("--ros-args --no-such-option", "ROS arguments: ['--no-such-option']"),
        ("timeout:=0.1", "'timeout:=0.1': unknown argument; ROS arguments must follow --ros-args"),
    ],
)
def test_invalid_argument_gives_one_line_and_exit_code_2(
    new_harness: Callable[..., NodeHarness], paths: dict[str, Path], arguments: str, line: str
) -> None:
    process = new_harness(*arguments.format(**paths).split()).process
    assert process is not None
    output, errors = process.communicate()
    assert process.returncode == 2
    assert output == ""
    (error,) = errors.splitlines()
    assert error.startswith(line.format(**paths))


@pytest.mark.parametrize(
    ("argument", "line"),
    [
        ("nonsense:=1", "monitor: no parameter 'nonsense': must be robot,"),
        ("timeout:=1", "monitor: timeout = 1: must be DOUBLE, is INTEGER: write 1.0"),
        ("timeout:=.nan", "monitor: timeout = nan: must be a finite number"),
        ("timeout:=61.0", "monitor: timeout = 61.0: must be less than or equal to 60"),
        ("accept_assumptions:=[drive]", "monitor: accept_assumptions = ('drive',): 'drive': must be drives"),
        ("speed_threshold:=0.0", "monitor: speed_threshold = 0.0: must be greater than"),
        ("timeout:='0.1'", "monitor: timeout = '0.1': must be DOUBLE, is STRING: write 0.1"),
        ("contact_area_m2:=10", "monitor: contact_area_m2 = 10: must be DOUBLE, is INTEGER: write 10.0"),
        (
            "payload_com:=[0,0,1]",
            "monitor: payload_com = (0, 0, 1): must be DOUBLE_ARRAY, is INTEGER_ARRAY: write [0.0,",
        ),
        ("body_regions:=chest", "monitor: body_regions = 'chest': must be STRING_ARRAY, is STRING: write [chest]"),
        ("robot:=/dev/zero", "/dev/zero: cannot be read: must be a regular file"),
        ("latch:=1", "monitor: latch = 1: must be BOOL, is INTEGER"),
        ("contact_points:=tool", "monitor: contact_points = 'tool': must be STRING_ARRAY, is STRING"),
        ("contact:=never", "monitor: contact = 'never': must be 'transient' or 'quasi_static'"),
        ("body_regions:=[face]", "body_regions = 'face': the standard permits no contact"),
        ("max_force:=1000.0", "max_force = 1000 N: must be at most the standard's"),
        ("robot:={typo}", "{typo}: holds parameters of /**: must be a robot"),
        ("contact_points:=[nose]", "{shipped}: contact_points = 'nose': must be one of tool"),
        (
            "qos_overrides./joint_states.subscription.reliability:=often",
            "monitor: qos_overrides: Unexpected QoS override",
        ),
        ("qos_overrides./joint_states.subscription.depth:=deep", "monitor: Trying to set parameter 'qos_overrides."),
        (
            "use_sim_time:=maybe",
            "monitor: Trying to set parameter 'use_sim_time' to 'maybe' of type 'STRING', expecting",
        ),
        ("payload_topic:=the load", "monitor: Invalid topic name: topic name must not contain characters other than"),
    ],
)
def test_invalid_parameter_is_named(
    refusal_of: Callable[..., str], paths: dict[str, Path], argument: str, line: str
) -> None:
    paths["shipped"] = share("config", "omron_i4_550l.yaml")
    assert refusal_of(MonitorNode, argument.format(**paths)).startswith(line.format(**paths))


def test_help_is_printed_without_ros(new_harness: Callable[..., NodeHarness]) -> None:
    process = new_harness("--help").process
    assert process is not None
    output, errors = process.communicate()
    assert (process.returncode, errors) == (0, "")
    assert output.startswith("usage: monitor_node [--ros-args ...]")


@pytest.mark.parametrize(
    ("command", "signals"),
    [
        ([str(MONITOR_NODE)], [signal.SIGINT, signal.SIGINT]),
        ([str(MONITOR_NODE)], [signal.SIGTERM]),
        ([sys.executable, "-m", "scara_effmass", "monitor"], [signal.SIGINT]),
        ([sys.executable, "-m", "scara_effmass", "monitor"], [signal.SIGTERM]),
    ],
    ids=["node, SIGINT twice", "node, SIGTERM", "command line, SIGINT", "command line, SIGTERM"],
)
def test_signal_ends_the_node_with_exit_code_0(
    new_harness: Callable[..., NodeHarness], command: list[str], signals: list[signal.Signals]
) -> None:
    harness = new_harness()
    process = harness.start(command=command)
    harness.subscribe()
    harness.spin_until(lambda: harness.contact_states)  # the watchdog's first message, after 0.2 s
    for number in signals:
        process.send_signal(number)
    output, errors = process.communicate()
    assert process.returncode == 0
    assert "Traceback" not in output + errors
    assert "Exception ignored" not in output + errors


def test_signal_during_start_ends_the_node_with_exit_code_0(new_harness: Callable[..., NodeHarness]) -> None:
    """Send the signal between the first and the last log line of the start, while endpoints are created."""
    process = new_harness("--ros-args", "-p", "autostart:=true").process
    assert process is not None
    assert process.stderr is not None
    assert any("monitoring omron_i4_550l" in line for line in process.stderr)
    process.send_signal(signal.SIGINT)
    errors = process.stderr.read()
    assert process.wait() == 0
    assert "Traceback" not in errors


@pytest.mark.live
def test_import_does_not_start_ros() -> None:
    check = "import scara_effmass.nodes.monitor_node, rclpy; raise SystemExit(rclpy.ok())"
    assert subprocess.run([sys.executable, "-c", check], check=False).returncode == 0


def test_parameters_of_other_nodes_under_all_nodes_are_ignored_with_a_warning(
    new_harness: Callable[..., NodeHarness], tmp_path: Path
) -> None:
    params = tmp_path / "robot.yaml"
    shared = "/**:\n  ros__parameters: {controller_rate: 500, sensor: {sensitivity: 2.0}, release_time: 0.0}\n"
    parent = ("-p", "use_gripper:=true", "-p", "robot_description:=<robot/>")  # SetParameter of a parent launch file
    idle = ("-p", "person_direction:=[1.0, 0.0, 0.0]")
    params.write_text(f"{shared}planner:\n  ros__parameters: {{horizon: 2}}\n", encoding="utf-8")
    harness = new_harness("--ros-args", *parent, *idle, "--params-file", str(params))
    harness.subscribe_until_ok()
    assert harness.process is not None
    harness.process_may_end = True
    harness.process.terminate()
    _, errors = harness.process.communicate()
    for name in ("controller_rate", "sensor.sensitivity", "use_gripper", "robot_description"):
        assert f"parameter '{name}' of /** is not of this node: ignored" in errors
    assert "person_direction = (1.0, 0.0, 0.0) has no effect without person_speed" in errors
    assert "horizon" not in errors


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (
            "/**/monitor:\n  ros__parameters: {controller_rate: 500}\n",
            "monitor: no parameter 'controller_rate': must be",
        ),
        ("/**:\n  ros__parameters: {payload_mas: 5.0}\n", "monitor: no parameter 'payload_mas': must be payload_mass"),
        ("/**:\n  ros__parameters: {servo: {stiff: 5.0}}\n", "monitor: no parameter 'servo.stiff': must be"),
    ],
)
def test_misspelt_parameters_of_the_node_are_refused(
    new_harness: Callable[..., NodeHarness], tmp_path: Path, text: str, line: str
) -> None:
    params = tmp_path / "cell.yaml"
    params.write_text(text, encoding="utf-8")
    process = new_harness("--ros-args", "--params-file", str(params)).process
    assert process is not None
    assert process.communicate()[1].startswith(line)
    assert process.returncode == 2


def test_first_lines_say_what_is_assumed_and_which_options_state_it(new_harness: Callable[..., NodeHarness]) -> None:
    robot = share("config", "robots", "ur5_robot.urdf")
    process = new_harness("--ros-args", "-p", f"robot:={robot}", "-p", "accept_assumptions:=[person_speed]").process
    assert process is not None
    assert process.stderr is not None
    lines = [process.stderr.readline() for _ in range(5)]
    (assumed,) = (line for line in lines if "no verdict is OK while these are assumed: " in line)
    for option in ("--payload 0", "--armature", "--drives", "--contact-area-m2", "--contact-point"):
        assert option in assumed
    assert "--person-speed" not in assumed
    assert any("accepted assumptions: person_speed" in line for line in lines)
    assert any("deciding mass: lumped from masses" in line for line in lines)


@pytest.mark.parametrize(
    ("variable", "line"),
    [
        ("ROS_LOG_DIR=/proc/nobody", "ROS_LOG_DIR: failed to initialize logging: "),
        ("ROS_DOMAIN_ID=233", "ROS_DOMAIN_ID = '233': must be a whole number from 0 to 232"),
        ("ROS_DOMAIN_ID=abc", "ROS_DOMAIN_ID = 'abc': must be a whole number from 0 to 232"),
    ],
)
def test_unusable_variable_is_named(
    new_harness: Callable[..., NodeHarness], monkeypatch: pytest.MonkeyPatch, variable: str, line: str
) -> None:
    process = new_harness().start(command=("env", variable, str(MONITOR_NODE)))
    errors = process.communicate()[1].splitlines()
    assert errors[-1].startswith(line)
    assert process.returncode == 2
    if "DOMAIN" in variable:
        assert len(errors) == 1
        name, _, value = variable.partition("=")
        monkeypatch.setenv(name, value)
        with pytest.raises(SettingsError, match=line):
            ClientNode("client")
