# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass record` as a process: stopped by signals, killed, and repaired."""

import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from rclpy.qos import QoSProfile
from std_msgs.msg import String

from scara_effmass.bags.files import open_bag
from scara_effmass.bags.recorder import BagRecorder
from scara_effmass.nodes.record import RecordReport
from test.cli.conftest import Cli, Refused
from test.forked import Forked
from test.nodes.conftest import TIMEOUT_S, ros_node

pytestmark = pytest.mark.usefixtures("own_domain")

RECORD = (sys.executable, "-m", "scara_effmass", "record")


def wait_until(condition: Callable[[], Any], process: subprocess.Popen[str]) -> None:
    deadline = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < deadline
        assert process.poll() is None, process.communicate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(0.01)


def saved(bag: Path) -> int:
    """Return the number of messages on the disk while the recorder runs."""
    try:
        with open_bag(bag) as opened:
            return sum(1 for _ in opened.messages())
    except Exception:  # noqa: BLE001 - not created yet
        return 0


@contextmanager
def recording(bag: Path, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """Record ten notes; they are on the disk inside the `with`."""
    command = [*RECORD, "-o", str(bag), *arguments]
    with ros_node("notes") as node:
        publisher = node.create_publisher(String, "notes", QoSProfile(depth=100))
        process = Forked(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        try:
            wait_until(publisher.get_subscription_count, process)
            for number in range(10):
                publisher.publish(String(data=str(number)))
            wait_until(lambda: saved(bag) == 10, process)
            yield process
        finally:
            process.kill()
            process.communicate()


@pytest.mark.live
def test_errors_of_the_middleware_do_not_mix_with_the_report(
    cli_process: Cli, tmp_path: Path, domain: dict[str, str]
) -> None:
    """Fast DDS prints them on stdout."""
    (tmp_path / "profiles.xml").write_text("<damaged", encoding="utf-8")
    for name in ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"):
        domain[name] = str(tmp_path / "profiles.xml")
    done = cli_process("record", "notes", "--duration", "0.2", "-o", tmp_path / "bag", "--json")
    assert json.loads(done.stdout)["messages"] == 0
    assert "Error parsing" in done.stderr


@pytest.mark.parametrize("stop_signal", [signal.SIGINT, signal.SIGTERM])
def test_signal_completes_the_bag_and_prints_the_report(tmp_path: Path, stop_signal: signal.Signals) -> None:
    bag = tmp_path / "bag"
    with recording(bag, "notes", "never", "--json") as process:
        process.send_signal(stop_signal)
        output, errors = process.communicate(timeout=TIMEOUT_S)
    assert (process.returncode, errors) == (0, "")
    report = json.loads(output)
    assert (report["bag"], report["messages"], report["lost"]) == (str(bag), 10, 0)
    assert report["topics"]["/notes"] == {
        "type": "std_msgs/msg/String",
        "received": 10,
        "recorded": 10,
        "lost": {"queue": 0, "disk": 0, "middleware": 0},
    }
    assert report["unheard"] == ["/never"]
    assert report["files"] == ["bag_0.mcap"]
    with open_bag(bag) as opened:
        assert [opened.deserialize(raw).data for raw in opened.messages()] == [str(i) for i in range(10)]
        assert opened.losses == ()


def test_text_output(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    with recording(bag, "notes", "never", "--no-compression", "--max-size", "0.0001") as process:
        process.send_signal(signal.SIGINT)
        output, errors = process.communicate(timeout=TIMEOUT_S)
    assert (process.returncode, errors) == (0, "")
    lines = output.splitlines()
    assert lines[0] == "recorded        /notes: 10 messages"
    assert lines[1] == "not recorded    /never: no publisher"
    assert lines[2].startswith("total           10 messages, 0 lost, 0.0 MB in ")
    assert lines[2].endswith(f" s: {bag}")
    assert len(list(bag.glob("bag_*.mcap"))) > 1


def test_repair_completes_the_bag_of_a_killed_recorder(tmp_path: Path, cli: Cli) -> None:
    bag = tmp_path / "bag"
    with recording(bag, "notes") as process:
        process.kill()
        process.wait()
    assert not (bag / "metadata.yaml").exists()
    result = cli("record", "--repair", bag)
    assert (result.returncode, result.stderr) == (0, "")
    assert (
        result.stdout == f"repaired        {bag / 'bag_0.mcap'}: 10 messages\nrepaired        {bag / 'metadata.yaml'}\n"
    )
    with open_bag(bag) as opened:
        assert len(list(opened.messages())) == 10
        assert opened.losses == ()
    result = cli("record", "--repair", bag, "--json")
    assert result.returncode == 0
    report = json.loads(result.stdout)
    assert report["intact"] is True
    assert [file["messages"] for file in report["files"]] == [10]


REFUSALS = {
    "no task": (["record"], "one of the arguments -o/--output --repair is required"),
    "two tasks": (["record", "-o", "a", "--repair", "b"], "not allowed with argument"),
    "file as output": (["record", "-o", "a.mcap"], "a.mcap: must be a folder name without .mcap"),
    "negative size": (["record", "-o", "a", "--max-size", "-1"], "--max-size: -1: must be a number >= 0"),
    "zero duration": (["record", "-o", "a", "--duration", "0"], "--duration: 0: must be a number > 0"),
    "topics with --all": (["record", "-o", "a", "b", "--all"], "topics = 'b': must be empty with --all"),
    "invalid topic": (["record", "-o", "a", "b c"], "record: topic 'b c': "),
    "unwritable": (["record", "-o", "/proc/none/a"], "/proc/none/a: cannot be written"),
    "repair of a missing bag": (["record", "--repair", "a"], "a: does not exist"),
    "repair with topics": (["record", "--repair", "a", "b"], "TOPIC = b: must come with --output"),
    "repair with a limit": (["record", "--repair", "a", "--max-size", "5"], "--max-size = 5.0: must come with --out"),
    "repair of all": (["record", "--repair", "a", "--all"], "--all: must come with --output"),
    "repair with ROS arguments": (["record", "--repair", "a", "--", "-r", "a:=b"], "must be left out with --repair"),
    "unknown ROS parameter": (["record", "-o", "a", "--", "-p", "b:=1"], "recorder: no parameter 'b'"),
}


@pytest.mark.parametrize(("arguments", "message"), REFUSALS.values(), ids=REFUSALS)
def test_invalid_input_gives_one_line_and_exit_code_2(arguments: list[str], message: str, refused: Refused) -> None:
    assert message in refused(*arguments)


def test_existing_bag_is_replaced_only_with_force(cli_process: Cli, swing_bag: Path, tmp_path: Path) -> None:
    bag = tmp_path / "swing"
    bag.mkdir()
    for path in swing_bag.iterdir():
        (bag / path.name).write_bytes(path.read_bytes())
    process = cli_process("record", "-o", bag, "--duration", "0.1")
    assert process.returncode == 2
    assert f"{bag}: already exists" in process.stderr
    assert saved(bag) == 1000
    process = cli_process("record", "-o", bag, "--duration", "0.1", "--force")
    assert (process.returncode, process.stderr) == (0, "")
    assert re.match(r"total           0 messages, 0 lost, 0\.0 MB in 1 file, \d+\.\d s: ", process.stdout)
    assert sorted(path.name for path in bag.iterdir()) == ["metadata.yaml", "swing_0.mcap"]


def test_lost_messages_are_told_and_give_exit_code_1(cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with BagRecorder(tmp_path / "bag") as recorder:
        recorder.count_lost_by_middleware(recorder.add_topic("/notes", "std_msgs/msg/String"), 3)
    report = RecordReport(recorder.report(), 1.0, simulated_time=False, refused={}, unpublished=())
    monkeypatch.setattr("scara_effmass.nodes.record.record", lambda *_, **__: report)
    done = cli("record", "-o", tmp_path / "bag")
    assert (done.returncode, done.stderr) == (1, "record: 3 of 3 messages were lost: /notes: 3 by the middleware\n")
    assert "0 messages, 3 lost" in done.stdout


def test_file_that_cannot_be_repaired_gives_exit_code_1(cli_process: Cli, swing_bag: Path, tmp_path: Path) -> None:
    bag = tmp_path / "swing"
    bag.mkdir()
    (bag / "swing_0.mcap").write_bytes((swing_bag / "swing_0.mcap").read_bytes())
    (bag / "swing_1.mcap").write_bytes(b"")
    process = cli_process("record", "--repair", bag)
    assert process.returncode == 1
    assert process.stdout.splitlines()[:2] == [
        f"intact          {bag / 'swing_0.mcap'}: 1000 messages",
        f"not repaired    {bag / 'swing_1.mcap'}: is empty",
    ]
