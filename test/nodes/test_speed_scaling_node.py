# SPDX-License-Identifier: Apache-2.0
"""`speed_scaling_node` beside a live monitor: what the joint trajectory controller receives."""

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from control_msgs.msg import SpeedScalingFactor
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import Transition
from rcl_interfaces.msg import Log
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from scara_effmass_msgs.msg import ContactState, ContactStates

from scara_effmass.cell.scaled_trajectory import ScaledTrajectory
from scara_effmass.nodes.ros import qos_profile
from scara_effmass.sim.motion import sample_moves
from scara_effmass.studies.shipped_bags import tour_moves
from scara_effmass.wire.joint_state import joint_state_message
from scara_effmass.wire.topics import SPEED_SCALING_INPUT, verdict_qos
from test.nodes.conftest import DEEP_QOS, JOINTS, TIMEOUT_S, Answer, NodeHarness, joint_state, stamp_ns

NODE = Path(sys.executable).with_name("speed_scaling_node")
CONTROLLER_QOS = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""That of the joint trajectory controller: a volatile publisher does not match."""
ALLOWED: dict[str, Any] = {"verdict": ContactState.OK, "allowable_speed": 1.0, "speed_scaling": 1.0}
"""What the message says of contacts that allow a speed."""
Start = Callable[..., tuple[NodeHarness, NodeHarness, list[float]]]


def received_factors(node: NodeHarness) -> list[float]:
    """Return the list to which the factors that a controller gets are added."""
    factors: list[float] = []

    def on_factor(message: SpeedScalingFactor) -> None:
        factors.append(message.factor)

    node.node.create_subscription(SpeedScalingFactor, SPEED_SCALING_INPUT, on_factor, CONTROLLER_QOS)
    return factors


@pytest.fixture
def cell(new_harness: Callable[..., NodeHarness], tmp_path: Path) -> Iterator[Start]:
    """Return a function that starts a monitor and the node, and gives both with the factors that a controller gets."""

    def start(*arguments: str) -> tuple[NodeHarness, NodeHarness, list[float]]:
        monitor = new_harness(
            "--ros-args", "-p", "release_time:=0.0", "-p", "timeout:=1.0", "-p", "contact_points:=[tool]"
        )
        node = stack.enter_context(closing(NodeHarness(monitor.domain, tmp_path, "speed_scaling")))
        node.start("--ros-args", "-p", "timeout:=1.0", *arguments, command=(str(NODE),))
        factors = received_factors(node)
        return monitor, node, factors

    with ExitStack() as stack:
        yield start


def rises_to_1(monitor: NodeHarness, node: NodeHarness, factors: list[float]) -> None:
    node.spin_until(lambda: factors and factors[-1] == 1.0, repeat=lambda: monitor.send(joint_state()))


def test_two_monitors_hold_the_factor_at_0_until_one_is_left(new_harness: Callable[..., NodeHarness]) -> None:
    node = new_harness(name="speed_scaling")
    node.start("--ros-args", "-p", "timeout:=0.5", "-p", "rise_rate:=20.0", command=(str(NODE),))
    factors = received_factors(node)
    first, second = (
        node.node.create_publisher(ContactStates, "contact_states", qos_profile(verdict_qos(0.5))) for _ in range(2)
    )

    numbers = {first: 0, second: 100}

    def send(*publishers: Any) -> None:  # noqa: ANN401
        contact = ContactState(contact_point="tool", verdict=ContactState.OK, allowable_speed=1.0)
        for publisher in publishers:
            numbers[publisher] += 1
            message = ContactStates(contacts=[contact], sequence_number=numbers[publisher], **ALLOWED)
            message.header.stamp = node.node.get_clock().now().to_msg()
            publisher.publish(message)

    node.spin_until(lambda: factors and factors[-1] == 1.0, repeat=lambda: send(first))
    node.spin_until(lambda: factors[-1] == 0.0, repeat=lambda: send(first, second))
    received = len(factors)
    node.spin_until(lambda: len(factors) > received + 100, repeat=lambda: send(first, second))
    assert set(factors[received:]) == {0.0}
    node.spin_until(lambda: factors[-1] == 1.0, repeat=lambda: send(first))


def test_node_that_falls_behind_takes_the_newest_contact_states(new_harness: Callable[..., NodeHarness]) -> None:
    node = new_harness(name="speed_scaling")
    process = node.start("--ros-args", "-p", "timeout:=0.5", "-p", "rise_rate:=20.0", command=(str(NODE),))
    factors = received_factors(node)
    node.node.create_subscription(DiagnosticArray, "/diagnostics", node.diagnostics.append, DEEP_QOS)
    publisher = node.node.create_publisher(ContactStates, "contact_states", qos_profile(verdict_qos(0.5)))
    number = 0

    def send(age_s: float = 0.0) -> None:
        nonlocal number
        number += 1
        contact = ContactState(contact_point="tool", verdict=ContactState.OK, allowable_speed=1.0)
        message = ContactStates(contacts=[contact], sequence_number=number, **ALLOWED)
        message.header.stamp = (node.node.get_clock().now() - Duration(seconds=age_s)).to_msg()
        publisher.publish(message)

    node.spin_until(lambda: factors and factors[-1] == 1.0, repeat=send)
    os.kill(process.pid, signal.SIGSTOP)
    for _ in range(50):
        send(age_s=1.0)
    os.kill(process.pid, signal.SIGCONT)
    node.diagnostic("speed scaling", "skipped contact states", lambda count: int(count) > 0)
    node.spin_until(lambda: factors[-1] == 1.0, repeat=send)
    assert node.diagnostic("speed scaling", "lost contact states", bool).endswith("| 0")
    number += 7
    send()
    node.diagnostic("speed scaling", "lost contact states", lambda count: count == "7")


def test_contact_states_that_cannot_be_decoded_stop_the_robot_until_the_next_ones(
    new_harness: Callable[..., NodeHarness],
) -> None:
    """Long before their silence would."""
    node = new_harness(name="speed_scaling")
    node.start("--ros-args", "-p", "timeout:=60.0", "-p", "rise_rate:=20.0", command=(str(NODE),))
    factors = received_factors(node)
    publisher = node.node.create_publisher(ContactStates, "contact_states", qos_profile(verdict_qos(60.0)))
    number = 0

    def send(*, is_cut: bool = False) -> None:
        nonlocal number
        number += 1
        contact = ContactState(contact_point="tool", verdict=ContactState.OK, allowable_speed=1.0)
        message = ContactStates(contacts=[contact], sequence_number=number, **ALLOWED)
        message.header.stamp = node.node.get_clock().now().to_msg()
        publisher.publish(serialize_message(message)[:-40] if is_cut else message)

    node.spin_until(lambda: factors and factors[-1] == 1.0, repeat=send)
    send(is_cut=True)
    node.spin_until(lambda: factors[-1] == 0.0)
    node.spin_until(lambda: factors[-1] == 1.0, repeat=send)


LATENCY_S = 0.03
"""From a factor to its effect on the joint states, cycles of 10 ms."""
FAST = ("-p", "rise_rate:=20.0")


@pytest.mark.parametrize("fault", ["SIGKILL", "SIGSTOP", "SIGTERM", "no input"])
def test_factor_is_0_without_a_monitor_rises_and_falls_with_it(cell: Start, fault: str) -> None:
    monitor, node, factors = cell()
    node.spin_until(lambda: factors)
    assert set(factors) == {0.0}
    rises_to_1(monitor, node, factors)
    assert np.diff(factors).max() <= 0.5  # by 1 in a second; this process or the node may stand for a while
    assert monitor.process is not None
    if fault.startswith("SIG"):
        monitor.process_may_end = True
        os.kill(monitor.process.pid, getattr(signal, fault))
    try:
        node.spin_until(lambda: factors[-1] == 0.0)
    finally:
        if fault == "SIGSTOP":
            os.kill(monitor.process.pid, signal.SIGKILL)
    assert factors[factors.index(1.0) :].count(0.0) >= 1
    # The node outlives the monitor, and its heartbeat goes on.
    received = len(factors)
    node.spin_until(lambda: len(factors) > received + 10)
    assert set(factors[received:]) == {0.0}


def test_last_message_is_0_and_late_controllers_receive_it(cell: Start) -> None:
    monitor, node, factors = cell(*FAST, "-p", "rate:=1.0")
    rises_to_1(monitor, node, factors)
    late: list[SpeedScalingFactor] = []
    node.node.create_subscription(SpeedScalingFactor, SPEED_SCALING_INPUT, late.append, CONTROLLER_QOS)
    node.spin_until(lambda: late, repeat=lambda: monitor.send(joint_state()))
    assert node.process is not None
    node.process_may_end = True
    node.process.terminate()
    node.spin_until(lambda: factors[-1] == late[-1].factor == 0.0, repeat=lambda: monitor.send(joint_state()))
    assert node.process.wait(TIMEOUT_S) == 0


def test_deactivated_node_leaves_0(cell: Start) -> None:
    monitor, node, factors = cell(*FAST)
    rises_to_1(monitor, node, factors)
    assert node.change_state(Transition.TRANSITION_DEACTIVATE)
    node.spin_until(lambda: factors[-1] == 0.0)
    assert node.change_state(Transition.TRANSITION_ACTIVATE)
    rises_to_1(monitor, node, factors)


def follow(
    monitor: NodeHarness, node: NodeHarness, factors: list[float], states: list[Answer]
) -> tuple[float, dict[int, float]]:
    """Follow the fastest part of the tour in real time; motion and controller are simulated.

    Return how old the newest contact state, or the last cycle, was at most in motion [s], and the factors by stamp
    [ns]. End where it is older than LATENCY_S.
    """
    q, qd = sample_moves(tour_moves(), 100)
    trajectory = ScaledTrajectory(JOINTS, np.arange(300) / 100, q[1950:2250], qd[1950:2250])
    in_force: dict[int, float] = {}

    def stand() -> None:
        monitor.send(joint_state_message(trajectory.advance(0.0, 0.0, time.time_ns())))

    begin = time.time_ns()
    node.spin_until(lambda: states and stamp_ns(states[-1]) > begin and states[-1].verdict, repeat=stand)
    last_ns, seen, delay_ns = time.time_ns(), len(factors), 0

    def cycle() -> bool:
        """Advance by the time that has passed, at the last received factor; wait for one where the node is late."""
        nonlocal last_ns, seen, delay_ns
        node.spin_until(lambda: time.time_ns() > last_ns + 8_000_000 and len(factors) > seen)
        seen = len(factors)
        now_ns = time.time_ns()
        if factors[-1] > 0.0:
            delay_ns = max(delay_ns, now_ns - min(stamp_ns(states[-1]), last_ns))
        monitor.send(joint_state_message(trajectory.advance(factors[-1], (now_ns - last_ns) / 1e9, now_ns)))
        in_force[now_ns], last_ns = factors[-1], now_ns
        return trajectory.ended or delay_ns >= LATENCY_S * 1e9

    while not cycle():
        pass
    node.spin_until(lambda: stamp_ns(states[-1]) == last_ns)
    return delay_ns / 1e9, in_force


def test_simulated_controller_obeys_over_dds(cell: Start) -> None:
    """Judge a run without hold-ups of the machine, which no controller could obey through."""
    monitor, node, factors = cell("-p", "rise_rate:=1.0", "-p", f"latency:={LATENCY_S}", "-p", "rate:=100.0")
    received: list[Answer] = []

    def on_states(message: ContactStates) -> None:
        received.append(Answer(message))

    node.node.create_subscription(ContactStates, "contact_states", on_states, DEEP_QOS)
    end, delay_s = time.monotonic() + TIMEOUT_S, LATENCY_S
    while delay_s >= LATENCY_S and time.monotonic() < end:
        delay_s, in_force = follow(monitor, node, factors, received)
    assert delay_s < LATENCY_S
    states = [state for state in received if stamp_ns(state) in in_force and state.verdict]
    stamps = np.array([stamp_ns(state) for state in states]) / 1e9
    speed = np.array([state.speed for state in states])
    allowable_speed = np.array([state.allowable_speed for state in states])
    factor = np.array([in_force[stamp_ns(state)] for state in states])
    moving = speed > 0.01
    stamps, speed, allowable_speed, factor = (values[moving] for values in (stamps, speed, allowable_speed, factor))
    programmed = speed / factor
    uncontrolled_excess = (programmed - allowable_speed).max()
    assert uncontrolled_excess > 0.3
    assert (speed - allowable_speed).max() < 0.5 * uncontrolled_excess
    allowed = allowable_speed / programmed
    lag_s = 3.0 * LATENCY_S + delay_s
    for k in np.flatnonzero(speed > allowable_speed):
        recent = (stamps <= stamps[k]) & (stamps > stamps[k] - lag_s)
        assert factor[k] <= allowed[recent].max() * (1.0 + 1e-6)


def test_status_warns_of_stops_and_of_a_controller_that_does_not_obey_in_few_lines(
    new_harness: Callable[..., NodeHarness],
) -> None:
    node = new_harness(name="speed_scaling")
    logged: list[str] = []

    def on_log(message: Log) -> None:
        logged.append(message.msg)

    node.node.create_subscription(Log, "/rosout", on_log, CONTROLLER_QOS)
    node.node.create_subscription(DiagnosticArray, "/diagnostics", node.diagnostics.append, DEEP_QOS)
    node.start("--ros-args", "-p", "timeout:=0.5", "-p", "rise_rate:=20.0", command=(str(NODE),))
    publisher = node.node.create_publisher(ContactStates, "contact_states", qos_profile(verdict_qos(0.5)))
    number = 0

    def send(speed: float = 0.0, age: str = "", *, allowed: float = 1.0) -> None:
        nonlocal number
        number += 1
        verdict = ContactState.UNKNOWN if age else ContactState.OK
        contact = ContactState(contact_point="tool", verdict=verdict, allowable_speed=allowed, speed=speed, reason=age)
        message = ContactStates(contacts=[contact], sequence_number=number, **ALLOWED)
        message.header.stamp = node.node.get_clock().now().to_msg()
        publisher.publish(message)

    def told(text: str) -> bool:
        statuses = [status for array in node.diagnostics for status in array.status]
        return any(text in status.message and status.level == DiagnosticStatus.WARN for status in statuses)

    node.spin_until(lambda: told("no controller subscribes to /joint_trajectory_controller/speed_scaling_input"))
    factors = received_factors(node)
    node.spin_until(lambda: factors and factors[-1] == 1.0, repeat=send)
    # A reason whose number changes with each message.
    begin, first = time.monotonic(), len(logged)

    def many() -> None:
        for _ in range(5):
            send(age=f"the joint state is {time.monotonic():.6f} s old")

    node.spin_until(lambda: time.monotonic() > begin + 4.0, repeat=many)
    assert told("stopped: tool: the joint state is ")
    lines = [line for line in logged[first:] if "the joint state is" in line]
    assert 1 <= len(lines) <= 2, lines  # one of the change, and one of the status
    assert factors[-1] == 0.0
    node.diagnostics.clear()
    node.spin_until(lambda: told(": nothing obeys it"), repeat=lambda: send(speed=0.3))
    assert factors[-1] == 0.0
    node.spin_until(lambda: factors[-1] == 1.0, repeat=send)
    node.diagnostics.clear()
    send(age="for a moment")
    node.spin_until(lambda: told("for a moment"), repeat=send)


def test_second_sender_of_factors_is_a_warning_and_one_on_standby_is_none(
    new_harness: Callable[..., NodeHarness], tmp_path: Path
) -> None:
    node = new_harness(name="speed_scaling")
    node.start("--ros-args", command=(str(NODE),))
    node.node.create_subscription(DiagnosticArray, "/diagnostics", node.diagnostics.append, DEEP_QOS)
    received_factors(node)
    with ExitStack() as stack:
        for name in ("standby", "of_another_cell"):
            assert "nodes send factors" not in node.diagnostic("/speed_scaling: speed scaling", "senders", bool)
            other = stack.enter_context(closing(NodeHarness(node.domain, tmp_path, name)))
            standby = str(name == "standby").lower()
            other.start("--ros-args", "-r", f"__node:={name}", "-p", f"standby:={standby}", command=(str(NODE),))
            node.diagnostic(f"/{name}: speed scaling", "controllers", lambda value: value == "1")
        text = node.diagnostic("/speed_scaling: speed scaling", "senders", lambda value: value == "2")
        assert "2 nodes send factors on /joint_trajectory_controller/speed_scaling_input: must be one" in text
    node.diagnostic("/speed_scaling: speed scaling", "senders", lambda value: value == "1")


@pytest.mark.parametrize("fault", ["SIGSTOP", "SIGKILL"])
def test_node_on_standby_sends_0_while_the_other_one_hangs(cell: Start, tmp_path: Path, fault: str) -> None:
    monitor, node, factors = cell(*FAST)
    standby = NodeHarness(monitor.domain, tmp_path, "speed_scaling_standby")
    standby.node.create_subscription(DiagnosticArray, "/diagnostics", standby.diagnostics.append, DEEP_QOS)
    with closing(standby):
        name = ("-r", "__node:=speed_scaling_standby")
        standby.start("--ros-args", *name, "-p", "timeout:=0.5", "-p", "standby:=true", command=(str(NODE),))
        rises_to_1(monitor, node, factors)
        standby.diagnostic("speed_scaling_standby: speed scaling", "controllers", lambda value: value == "1")
        received = len(factors)
        node.spin_until(lambda: len(factors) > received + 100, repeat=lambda: monitor.send(joint_state()))
        stops = standby.diagnostic("speed_scaling_standby: speed scaling", "stops", bool)  # of a busy machine
        assert standby.process is not None
        assert node.process is not None
        node.process_may_end = True
        os.kill(node.process.pid, getattr(signal, fault))
        node.spin_until(lambda: factors[-1] == 0.0, repeat=lambda: monitor.send(joint_state()))
        text = standby.diagnostic(
            "speed_scaling_standby: speed scaling", "stops", lambda n: not stops.endswith(f"| {n}")
        )
        assert "no factor of another node for" in text
        if fault == "SIGSTOP":
            os.kill(node.process.pid, signal.SIGCONT)
            rises_to_1(monitor, node, factors)
            # It may answer one state before it notices the gap, and then falls once more.
            node.spin_until(lambda: factors[-30:] == [1.0] * 30, repeat=lambda: monitor.send(joint_state()))
            standby.process_may_end = True
            standby.process.terminate()
            received = len(factors)
            ended = standby.process.poll
            node.spin_until(lambda: ended() is not None, repeat=lambda: monitor.send(joint_state()))
            node.spin_until(lambda: len(factors) > received + 20, repeat=lambda: monitor.send(joint_state()))
            assert ended() == 0
            assert 0.0 not in factors[received:]
