# SPDX-License-Identifier: Apache-2.0
"""`monitor`, `replay` and `demo --bag`: real nodes over DDS, in a ROS domain of the test."""

import json
import os
import signal
import socket
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock
from xml.etree import ElementTree as ET

import pytest
from geometry_msgs.msg import Inertia
from rclpy.serialization import serialize_message

from scara_effmass.bags.files import open_bag
from scara_effmass.bags.writer import BagWriter
from scara_effmass.cli import main
from scara_effmass.cli.nodes import node_arguments
from scara_effmass.cli.processes import isolate_ros_domain
from scara_effmass.share import share
from scara_effmass.wire.message_types import INERTIA
from test.cli.conftest import Cli

Start = Callable[..., subprocess.Popen[str]]

PNG = b"\x89PNG\r\n\x1a\n"


def test_options_of_a_node_become_ros_arguments(tmp_path: Path) -> None:
    file = tmp_path / "cell.yaml"
    file.write_text("/**:\n  ros__parameters:\n    timeout: 0.1\n", encoding="utf-8")
    ros_arguments = ["--ros-args", "-p", "timeout:=0.3"]
    words = node_arguments(file, {"robot": "1e5", "effective_mass_model": "iso", "other": None}, ros_arguments)
    options = ["-p", 'robot:="1e5"', "-p", 'effective_mass_model:="iso"', "--"]
    assert words == ["--ros-args", "--params-file", str(file), *options, *ros_arguments]


@pytest.mark.parametrize("words", [["--", "-p", "timeout:=0.3"], ["--ros-args", "-p", "timeout:=0.3"]], ids=" ".join)
def test_ros_arguments_reach_the_node(words: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    node_main = Mock(return_value=7)
    monkeypatch.setattr("scara_effmass.nodes.monitor_node.main", node_main)
    assert main(["monitor", *words]) == 7
    node_main.assert_called_once_with(["--ros-args", "--", "--ros-args", "-p", "timeout:=0.3"])


def test_options_of_the_cell_become_parameters(monkeypatch: pytest.MonkeyPatch) -> None:
    """The demo passes them to its monitor in the same form."""
    node_main = Mock(return_value=0)
    monkeypatch.setattr("scara_effmass.nodes.monitor_node.main", node_main)
    cell = (
        "--payload",
        "2",
        "--payload-com",
        "-0.1",
        "0",
        "0.1",
        "--contact-point",
        "a=link4: 0 0 0",
        "--person-speed",
        "1",
    )
    assert main(["monitor", *cell]) == 0
    expected = [
        *("--ros-args", "-p", 'contact_points:=["a=link4: 0 0 0"]', "-p", "payload_mass:=2.0"),
        *("-p", "payload_com:=[-0.1, 0.0, 0.1]", "-p", "person_speed:=1.0", "--"),
    ]
    node_main.assert_called_once_with(expected)


def test_unknown_node_parameter_gives_one_line(cli_process: Cli) -> None:
    done = cli_process("monitor", "--", "-p", "monitor:no_such_parameter:=1")
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("monitor: no parameter 'no_such_parameter'")
    assert "Traceback" not in done.stderr


def is_up(monitor: subprocess.Popen[str]) -> bool:
    """Wait for the monitor to start; return False if it ends instead."""
    assert monitor.stderr is not None
    return any("monitoring omron_i4_550l" in line for line in monitor.stderr)


def test_replay_reports_sent_joint_states(swing_bag: Path, cli_process: Cli, start: Start) -> None:
    monitor = start("monitor", "--", "-p", "use_sim_time:=true")
    assert is_up(monitor)
    done = cli_process("replay", swing_bag, "--rate", "2", "--start", "0.5", "--duration", "1", "--json")
    printed = cli_process("replay", swing_bag, "--duration", "0.1", "--topics", "/joint_states")
    monitor.send_signal(signal.SIGINT)
    monitor.communicate()
    assert (done.returncode, done.stderr) == (0, "")
    report = json.loads(done.stdout)
    assert report["sent"] == {"/joint_states": 500}
    assert "sent            /joint_states: 50 messages\n" in printed.stdout


def demo_result(folder: Path) -> dict[str, Any]:
    result: dict[str, Any] = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    return result


def test_demo_with_a_bag_gives_the_result_of_assess(
    swing_bag: Path, cli: Cli, cli_process: Cli, tmp_path: Path
) -> None:
    done = cli_process("demo", "--bag", swing_bag, "--out", tmp_path / "out")
    assert (done.returncode, done.stderr) == (0, "")
    result = demo_result(tmp_path / "out")
    assert (result["sent"], result["received"], result["lost"]) == (1000, 1000, 0)
    offline = json.loads(cli("assess", swing_bag, "-o", tmp_path / "a.csv", "--json").stdout)
    for key in ("cycles_by_verdict", "seconds_by_verdict", "unknown_reasons", "gaps"):
        assert result[key] == offline[key], key
    assert {**result["tightest"], "bag": ""} == {**offline["tightest"], "bag": ""}
    assert "1000 joint states sent, 0 of other devices, 1000 answered, 0 lost" in done.stdout
    assert "VIOLATION" in done.stdout
    assert str(tmp_path / "out" / "report.html") in done.stdout
    runs = ("run", *(f"run_{number}" for number in range(2, 7)))  # two points, four links
    figures = {f"{name}.{suffix}" for name in runs for suffix in ("png", "svg")}
    for name in runs:
        assert (tmp_path / "out" / f"{name}.png").read_bytes().startswith(PNG)
        assert ET.parse(tmp_path / "out" / f"{name}.svg").getroot().tag.endswith("svg")  # noqa: S314 - our own file
    files = {path.name for path in (tmp_path / "out").iterdir()}
    assert files == {"assessed.parquet", "recording", "report.html", "summary.json", *figures}
    # The scalars live 2 s: on a busy machine the recorder can be later than that.
    lost = {name for name, topic in result["recording"]["topics"].items() if any(topic["lost"].values())}
    assert lost <= {"/allowable_speed", "/speed_scaling"}
    with open_bag(swing_bag) as sent, open_bag(tmp_path / "out" / "recording") as recorded:
        pairs = zip(sent.messages(["/joint_states"]), recorded.messages(["/joint_states"]), strict=True)
        assert all(a.data == b.data for a, b in pairs)

    again = cli("demo", "--bag", swing_bag, "--out", tmp_path / "out")
    assert again.returncode == 2
    assert again.stderr == f"{tmp_path / 'out' / 'recording'}: already exists; use --force to replace it\n"


def test_demo_marks_the_shipped_recording_as_generated_and_uses_the_options(cli_process: Cli, tmp_path: Path) -> None:
    """The tour, with other devices, another topic and a payload."""
    with open_bag(share("bags", "tour")) as bag, BagWriter(tmp_path / "cell.mcap") as cell:
        cell.write("/cell/load", INERTIA, bag.start_ns, bytes(serialize_message(Inertia(m=2.0))))
        number = 0
        for message in bag.messages(stop_ns=bag.start_ns + 2_000_000_000):
            topic, data = message.topic, message.data
            if topic == "/joint_states":
                topic, number = "/cell/states", number + 1
                data = data.replace(b"joint", b"wheel") if number % 10 == 0 else data
            cell.write(topic, message.type, message.log_time_ns, data)
    words = ("--bag", tmp_path / "cell.mcap", "--topic", "cell/states", "--duration", "1", "--json")
    done = cli_process("demo", *words, "--payload-topic", "/cell/load", "--person-speed", "9")
    assert (done.returncode, done.stderr) == (0, "")
    result = json.loads(done.stdout)
    assert result == {**demo_result(tmp_path / "out" / "demo"), "properties": []}
    page = (tmp_path / "out" / "demo" / "report.html").read_text(encoding="utf-8")
    assert "generated, no real robot" in page
    assert (result["sent"], result["foreign"], result["received"], result["lost"]) == (250, 25, 225, 0)
    assert result["force"]["simulated"] is True
    assert result["force"]["lost_samples"] == 0
    assert result["recording"]["topics"]["/joint_states"]["recorded"] == 250
    assert result["cycles_by_verdict"]["VIOLATION"] > 0  # the payload has arrived, and the person is too fast
    assert not any("payload" in reason for reason in result["unknown_reasons"])


def test_interrupted_demo_ends_its_child_processes(start: Start, tmp_path: Path) -> None:
    process = start("demo", "--out", tmp_path, "--bag", share("bags", "tour"))
    assert process.stdout is not None
    line = next(line for line in process.stdout if " scaling " in line)
    assert "tool: " in line
    child_pids = children_of(process.pid)
    assert len(child_pids) == 5  # monitor, visualization, force, recorder, replay
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate()
    assert (process.returncode, errors) == (130, "interrupted\n")
    assert not [pid for pid in child_pids if Path(f"/proc/{pid}").exists()]
    assert list(tmp_path.iterdir()) == []


def children_of(pid: int) -> list[int]:
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return [int(child) for task in tasks for child in (task / "children").read_text(encoding="utf-8").split()]


def test_demo_uses_a_free_ros_domain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "")
    isolate_ros_domain()
    first = os.environ["ROS_DOMAIN_ID"]
    with socket.socket(type=socket.SOCK_DGRAM) as other_process:
        other_process.bind(("", 7400 + 250 * int(first) + 10))
        isolate_ros_domain()
        second = os.environ["ROS_DOMAIN_ID"]
    assert first != second
    assert 1 <= int(second) <= 101
    assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
