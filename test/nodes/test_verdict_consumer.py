# SPDX-License-Identifier: Apache-2.0
"""The example of a consumer stops for every reason that docs/consuming.md names."""

import math
import os
import runpy
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from scara_effmass_msgs.msg import ContactState, ContactStates

from scara_effmass.nodes.ros import qos_profile
from scara_effmass.wire import topics
from test.nodes.conftest import TIMEOUT_S, NodeHarness, Q, joint_state

EXAMPLE = Path(__file__).parents[2] / "examples" / "verdict_consumer.py"
TIMEOUT = 1.0
"""Of the monitor [s]."""
FAULTY_MONITOR = """
from scara_effmass.nodes import monitor_node
class FaultyDecoder(monitor_node.JointStateDecoder):
    def decode(self, data):
        state = super().decode(data)
        if state.position[0] > 1.0:
            raise ValueError("surprise")
        return state
monitor_node.JointStateDecoder = FaultyDecoder
raise SystemExit(monitor_node.main())
"""


@pytest.mark.parametrize(
    ("fault", "reasons"),
    [
        ("deactivate", {"the monitor was deactivated"}),
        ("no input", {"no valid joint state for"}),
        ("old stamp", {"the joint state is"}),
        ("SIGTERM", {"the node shuts down"}),
        ("SIGKILL", {"liveliness lost", "deadline missed"}),
        ("SIGABRT", {"liveliness lost", "deadline missed"}),
        ("SIGSTOP", {"liveliness lost", "deadline missed"}),
        ("exception", {"the node ends: ValueError('surprise')"}),
    ],
)
def test_consumer_stops(new_harness: Callable[..., NodeHarness], fault: str, reasons: set[str]) -> None:
    arguments = ("--ros-args", "-p", f"timeout:={TIMEOUT}", "-p", "release_time:=0.0")
    harness = new_harness()
    process = harness.start(*arguments, command=(sys.executable, "-c", FAULTY_MONITOR))
    changes: list[tuple[float, str]] = []
    rclpy.init(domain_id=harness.domain, signal_handler_options=SignalHandlerOptions.NO)
    try:
        example = runpy.run_path(str(EXAMPLE))
        consumer: Any = example["VerdictConsumer"](TIMEOUT, lambda *change: changes.append(change), 0.5 * TIMEOUT)
        executor = SingleThreadedExecutor()
        executor.add_node(consumer)
        delay_ns = 0
        position = Q

        def spin_until(done: Callable[[], object], *, sending: bool = True) -> None:
            end = time.monotonic() + TIMEOUT_S
            while not done():
                assert time.monotonic() < end, changes
                if sending:
                    harness.send(joint_state(time.time_ns() - delay_ns, position=position, velocity=(0.0,) * 4))
                executor.spin_once(timeout_sec=0.05)

        assert changes == [(0.0, "no contact states yet")]
        spin_until(lambda: changes[-1][0] > 0.0)
        changes.clear()
        sending = fault != "no input"
        if fault == "deactivate":
            client = consumer.create_client(ChangeState, "monitor/change_state")
            spin_until(client.service_is_ready)
            client.call_async(ChangeState.Request(transition=Transition(id=Transition.TRANSITION_DEACTIVATE)))
        elif fault == "old stamp":
            delay_ns = round(0.7e9 * TIMEOUT)
        elif fault == "exception":
            position = (1.2, *Q[1:])
        elif fault.startswith("SIG"):
            os.kill(process.pid, getattr(signal, fault))
        spin_until(lambda: any(reason.startswith(tuple(reasons)) for _, reason in changes), sending=sending)
        assert next(speed for speed, reason in changes if reason) == 0.0
        executor.shutdown()
        consumer.destroy_node()
        if fault == "exception":
            _, errors = process.communicate(timeout=TIMEOUT_S)
            assert "ValueError: surprise" in errors
            assert process.returncode == 1
    finally:
        rclpy.try_shutdown()
        if fault == "SIGSTOP":
            process.kill()


class Example(NamedTuple):
    """The consumer, what it has announced, and a publisher of contact states."""

    consumer: Any
    changes: list[tuple[float, str]]
    publisher: Any
    executor: SingleThreadedExecutor


@pytest.fixture
def example(own_domain: int) -> Iterator[Example]:
    changes: list[tuple[float, str]] = []
    rclpy.init(domain_id=own_domain, signal_handler_options=SignalHandlerOptions.NO)
    try:
        consumer: Any = runpy.run_path(str(EXAMPLE))["VerdictConsumer"](TIMEOUT, lambda *change: changes.append(change))
        publisher = consumer.create_publisher(ContactStates, "contact_states", qos_profile(topics.verdict_qos(TIMEOUT)))
        executor = SingleThreadedExecutor()
        executor.add_node(consumer)
        yield Example(consumer, changes, publisher, executor)
        executor.shutdown()
        consumer.destroy_node()
    finally:
        rclpy.try_shutdown()


def test_consumer_moves_only_while_the_last_message_allows_it(example: Example) -> None:
    consumer, changes, publisher, executor = example
    numbers = count(1)

    def spin_until(change: tuple[float, str], verdict: int | None = None, speed: float = 0.0) -> set[float]:
        """Publish until the consumer announces `change`; return all announced speeds."""
        changes.clear()
        end = time.monotonic() + TIMEOUT_S
        while changes[-1:] != [change]:
            assert time.monotonic() < end, changes
            if verdict is not None:
                message = ContactStates(verdict=verdict, allowable_speed=speed, reason="why")
                message.sequence_number = next(numbers)
                message.header.stamp = consumer.get_clock().now().to_msg()
                publisher.publish(message)
            executor.spin_once(timeout_sec=0.05)
        return {speed for speed, _ in changes}

    spin_until((0.2, ""), ContactState.OK, 0.2)
    assert spin_until((0.0, "why"), ContactState.UNKNOWN, 0.1) == {0.0}
    spin_until((0.4, ""), ContactState.WARN, 0.4)
    assert spin_until((0.0, "why"), ContactState.VIOLATION, 0.3) == {0.0}
    spin_until((0.3, ""), ContactState.OK, 0.3)
    spin_until((0.0, "deadline missed"))
    spin_until((0.3, ""), ContactState.OK, 0.3)
    spin_until((0.0, "why"), ContactState.OK, math.nan)
    spin_until((0.3, ""), ContactState.OK, 0.3)
    spin_until((0.0, "why"), 9, 0.3)
    spin_until((0.3, ""), ContactState.OK, 0.3)
    # A second monitor may have another verdict.
    second = consumer.create_publisher(ContactStates, "contact_states", qos_profile(topics.verdict_qos(TIMEOUT)))
    spin_until((0.0, "two monitors"), ContactState.OK, 0.3)
    consumer.destroy_publisher(second)
    for _ in range(2):
        # One that is left alone, and one that counts anew, must have published alone for a while.
        alone_from = time.monotonic()
        spin_until((0.3, ""), ContactState.OK, 0.3)
        assert time.monotonic() - alone_from >= 1.9 * TIMEOUT
        numbers = count(1)


def test_consumer_takes_arguments_of_ros(own_domain: int) -> None:
    """As --ros-args -p use_sim_time:=true beside a replay."""
    command = [sys.executable, str(EXAMPLE), "--timeout", "0.3", "--ros-args", "-r", "__node:=follower"]
    process = subprocess.Popen(command, env=os.environ | {"ROS_DOMAIN_ID": str(own_domain)})
    rclpy.init(domain_id=own_domain, signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = rclpy.create_node("observer")
        end = time.monotonic() + TIMEOUT_S
        while "follower" not in node.get_node_names():
            assert time.monotonic() < end
            assert process.poll() is None
            rclpy.spin_once(node, timeout_sec=0.05)
        node.destroy_node()
    finally:
        rclpy.try_shutdown()
        process.send_signal(signal.SIGINT)
        assert process.wait(TIMEOUT_S) == 0
