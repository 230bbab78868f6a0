# SPDX-License-Identifier: Apache-2.0
"""What the nodes log, on the terminal and on /rosout."""

import os
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState

from scara_effmass.nodes.diagnostics import CHANGES, NodeLog, status
from test.nodes.conftest import MONITOR_NODE, NodeHarness, joint_state

ROSOUT_QOS = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
COMMAND = (sys.executable, "-m", "scara_effmass")
LOST_DEVICE = """
import sys
from scara_effmass.daq.sim_source import HalfSineSource
from scara_effmass.errors import DeviceLostError
from scara_effmass.nodes.daq_node import main

read = HalfSineSource.read
reads = 0

def failing_read(source, timeout_s):
    global reads
    reads += 1
    if reads in (5, 12):
        raise DeviceLostError("the cable is out")
    return read(source, timeout_s)

HalfSineSource.read = failing_read
sys.exit(main())
"""


class Rosout:
    """Log lines of the node on /rosout."""

    def __init__(self, harness: NodeHarness) -> None:
        self.logs: list[Log] = []
        harness.node.create_subscription(Log, "/rosout", self.logs.append, ROSOUT_QOS)
        self._harness = harness

    def line(self, level: int, *parts: str, repeat: Callable[[], object] | None = None) -> Log:
        """Return the first line of `level` that has all `parts`, and forget it and those before."""

        def matching() -> int:
            lines = ((n, log.msg) for n, log in enumerate(self.logs, 1) if log.level == level)
            return next((n for n, text in lines if all(part in text for part in parts)), 0)

        count = self._harness.spin_until(matching, repeat)
        log = self.logs[count - 1]
        del self.logs[:count]
        return log


def test_monitor_logs_verdicts_remedies_and_its_input(new_harness: Callable[..., NodeHarness]) -> None:
    harness = new_harness()
    rosout = Rosout(harness)
    words = ["-p", "release_time:=0.0", "-p", "timeout:=1.0", "-p", "contact_points:=[tool]"]
    others = ("joint_a", "joint_b", "joint_c", "joint_d")
    words += ["-p", "status_period:=0.5", "-p", f"ignored_joints:=[{', '.join(others)}]"]  # silent later
    elsewhere = harness.node.create_publisher(JointState, "/arm/joint_states", 10)
    process = harness.start("monitor", "--", *words, command=COMMAND)
    rosout.line(Log.ERROR, "contact tool: UNKNOWN: no joint state yet; remedy: check the driver")
    rosout.line(Log.WARN, "no publisher of /joint_states; /arm/joint_states has one: remap with -r")
    harness.node.destroy_publisher(elsewhere)
    sender = harness.node.create_publisher(JointState, "joint_states", 10)
    rosout.line(
        Log.ERROR,
        "UNKNOWN: no joint state yet (",
        "named none of the robot's joints); they name joint_a",
        "; remedy: give the",
        repeat=lambda: sender.publish(joint_state(names=others, velocity=(0.0,) * 4)),
    )
    old = lambda: sender.publish(joint_state(time.time_ns() - 5_000_000_000))  # noqa: E731
    rosout.line(Log.ERROR, "UNKNOWN: the joint state is 5.0", "; remedy: synchronize the clocks", repeat=old)
    fresh = lambda: sender.publish(joint_state())  # noqa: E731
    rosout.line(Log.INFO, "contact tool: OK, 0.0", " of ", " m/s, ", repeat=fresh)
    rosout.line(Log.INFO, "input: ", "; contact tool: OK, 0.0", repeat=fresh)
    assert harness.set_parameters(person_speed=10.0) == ""
    violation = rosout.line(Log.ERROR, "contact tool: VIOLATION, 0.0", " m/s, ", " limit of ", repeat=fresh)
    assert harness.set_parameters(person_speed=0.0) == ""
    rosout.line(Log.INFO, "contact tool: OK", repeat=fresh)
    harness.node.destroy_publisher(sender)
    rosout.line(Log.WARN, "lost the publisher of /joint_states")
    rosout.line(Log.ERROR, "contact tool: UNKNOWN: no valid joint state for ")
    sender = harness.node.create_publisher(JointState, "joint_states", 10)
    rosout.line(Log.INFO, "reconnected: /joint_states has a publisher again")
    process.terminate()
    _, errors = process.communicate()
    for text in ("[ERROR]", "remedy: synchronize the clocks", violation.msg):
        assert text in errors


def test_chattering_verdict_gives_a_line_a_second_with_the_number_of_changes(
    new_harness: Callable[..., NodeHarness],
) -> None:
    harness = new_harness()
    rosout = Rosout(harness)
    harness.start("--ros-args", "-p", "release_time:=0.0", "-p", "timeout:=60.0", "-p", "contact_points:=[tool]")
    harness.subscribe_until_ok()
    rosout.line(Log.INFO, "contact tool: OK", repeat=lambda: harness.send(joint_state()))
    harness.synchronize()
    end = time.monotonic() + 3.5
    while time.monotonic() < end:
        harness.response_to(joint_state(names=()))
        harness.response_to(joint_state())
    counted = int(harness.diagnostic("contact tool", CHANGES, bool).rpartition(" ")[2])
    lines = [log.msg for log in rosout.logs if "contact tool" in log.msg]
    assert counted > 20
    assert 3 <= len(lines) <= 6
    assert any(f"{CHANGES} since the last line" in line for line in lines)
    assert "UNKNOWN: the joint state has no names" in lines[0]


def test_terminal_that_stands_still_does_not_stop_the_monitor(
    new_harness: Callable[..., NodeHarness], tmp_path: Path
) -> None:
    fifo = tmp_path / "terminal"
    os.mkfifo(fifo)
    terminal = os.open(fifo, os.O_RDWR | os.O_NONBLOCK)
    with suppress(BlockingIOError):
        while os.write(terminal, bytes(4096)):
            pass
    harness = new_harness()
    shell = ("/bin/sh", "-c", f'exec "$0" "$@" 2>{fifo}', str(MONITOR_NODE))
    harness.start("--ros-args", "-p", "timeout:=60.0", command=shell)
    harness.subscribe_until_ok()
    os.close(terminal)


def test_validator_quiet_logs_warnings_only(new_harness: Callable[..., NodeHarness]) -> None:
    harness = new_harness(name="validator")
    rosout = Rosout(harness)
    harness.start("validator", "--quiet", command=COMMAND)
    rosout.line(Log.WARN, "series: no publisher of /contact_states")
    assert all(log.level >= Log.WARN for log in rosout.logs)


def test_daq_logs_lost_devices_and_impacts(new_harness: Callable[..., NodeHarness]) -> None:
    harness = new_harness(name="daq")
    rosout = Rosout(harness)
    words = ("-p", "source:=sim", "-p", "sim.impact_period:=0.7", "-p", "sim.seed:=7", "-p", "ni9230.retry_time:=0.1")
    harness.start("--ros-args", *words, "-p", "status_period:=0.5", command=(sys.executable, "-c", LOST_DEVICE))
    for reconnects in (0, 1):
        rosout.line(Log.WARN, "simulated force", f"waiting for samples, {reconnects} reconnects", "the cable is out")
        rosout.line(Log.WARN, "simulated force", f"running, {reconnects + 1} reconnects")
    rosout.line(Log.INFO, "simulated impact on force_sensor: peak ", " N, ", " ms, ", " N s")
    rosout.line(Log.INFO, "source, channel sim0: ", " samples lost")


def test_sim_logs_carts_and_a_status_line(new_harness: Callable[..., NodeHarness]) -> None:
    harness = new_harness(name="sim")
    rosout = Rosout(harness)
    harness.start("sim", "-v", command=COMMAND)
    rosout.line(Log.INFO, "simulated cart of ", " kg in place: ")
    rosout.line(Log.INFO, "simulated ", " s, 0 subscribers of joint_states")


class Logger:
    def __init__(self) -> None:
        self.lines: list[str] = []
        self.info = self.warning = self.error = self.lines.append

    def get_logger(self) -> "Logger":
        return self


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr("scara_effmass.nodes.diagnostics.time.monotonic", lambda: now[0])
    return now


def test_events_beyond_ten_a_second_are_counted(clock: list[float]) -> None:
    node: Any = Logger()
    log = NodeLog(node)
    for number in range(25):
        log.event(f"impact {number}")
    assert node.lines == [f"impact {number}" for number in range(10)]
    clock[0] += 1.0
    log.update([])
    assert node.lines[10:] == ["15 more events were left out"]


def test_status_that_flaps_gives_a_line_a_second_and_a_worse_verdict_one_at_once(clock: list[float]) -> None:
    node: Any = Logger()
    log = NodeLog(node)
    for turn in range(100):
        problem = f"{turn} samples lost" if turn % 3 else ""
        verdict = (DiagnosticStatus.ERROR, "VIOLATION") if turn % 2 else (DiagnosticStatus.OK, "OK")
        statuses = [
            status("/n: source", "running", {}, problem=problem),
            status("/n: contact tool", verdict[1], {CHANGES: turn + 1}, level=verdict[0]),
        ]
        log.update(statuses)
        clock[0] += 0.1
    source = [line for line in node.lines if line.startswith("source")]
    contact = [line for line in node.lines if line.startswith("contact")]
    assert 4 <= len(source) <= 10
    assert contact[:2] == ["contact tool: OK", "contact tool: VIOLATION"]
    assert len(contact) <= 21
    shown = sum(int(line.partition("(")[2].partition(" ")[0] or 1) for line in contact)
    assert shown >= 90


def test_contact_points_with_different_verdicts_have_lines_of_their_own(clock: list[float]) -> None:
    node: Any = Logger()
    log = NodeLog(node)
    levels = {"OK": DiagnosticStatus.OK, "WARN": DiagnosticStatus.WARN, "UNKNOWN": DiagnosticStatus.ERROR}

    def statuses(number: int, **verdicts: str) -> list[DiagnosticStatus]:
        return [
            status(f"/n: contact {name}", verdict, {CHANGES: number}, level=levels[verdict])
            for name, verdict in verdicts.items()
        ]

    log.update(statuses(1, elbow="OK", tool="WARN", rim="OK"))
    assert node.lines == ["contact elbow, contact rim: OK", "contact tool: WARN"]
    clock[0] += 0.1
    log.update([*statuses(2, elbow="UNKNOWN"), *statuses(1, tool="WARN", rim="OK")])
    assert node.lines[2:] == ["contact elbow: UNKNOWN"]
    log.status_line(statuses(2, elbow="OK", tool="WARN", rim="OK"))
    assert node.lines[3:] == ["contact elbow, contact rim: OK; contact tool: WARN"]
