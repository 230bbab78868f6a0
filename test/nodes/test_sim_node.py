# SPDX-License-Identifier: Apache-2.0
"""sim_node: the simulated cell waits for those who listen to it."""

import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from scara_effmass.nodes import sim_node
from scara_effmass.nodes.ros import spin_for
from scara_effmass.nodes.sim_node import SimNode
from test.nodes.conftest import DEEP_QOS, TIMEOUT_S, NodeHarness, ros_node, stamp_ns

SIM_NODE = Path(sys.executable).with_name("sim_node")
STOPPED_NS = 12_000_000_000
"""Time for which a process stands still."""


@pytest.mark.live
def test_time_stands_still_until_every_listener_has_subscribed(own_domain: int, tmp_path: Path) -> None:
    harness = NodeHarness(own_domain, tmp_path, "sim")
    clock: list[Clock] = []
    states: list[JointState] = []
    try:
        harness.node.create_subscription(Clock, "/clock", clock.append, DEEP_QOS)
        harness.node.create_subscription(JointState, "joint_states", states.append, DEEP_QOS)
        command = ("--ros-args", "-p", "clock:=true", "-p", "start:=100.0", "-p", 'listeners:=["tester", "recorder"]')
        harness.start(*command, command=[str(SIM_NODE)])
        harness.spin_until(lambda: len(clock) > 3)
        assert {message.clock.sec for message in clock} == {100}
        assert {message.clock.nanosec for message in clock} == {0}
        assert not states
        with ros_node("recorder", domain=own_domain) as recorder:
            recorder.create_subscription(JointState, "joint_states", lambda _: None, DEEP_QOS)
            harness.spin_until(lambda: states)
        states.clear()
        harness.spin_until(lambda: states)  # it does not wait again
    finally:
        harness.close()


@pytest.mark.usefixtures("default_context")
@pytest.mark.parametrize("clock", [False, True])
def test_cell_that_stood_still_goes_on_in_short_steps(
    own_domain: int, monkeypatch: pytest.MonkeyPatch, *, clock: bool
) -> None:
    """Each between two events, among which are signals."""
    node, executor = SimNode(), EventsExecutor()
    node.set_parameters([Parameter("clock", value=clock)])
    executor.add_node(node)
    states: list[JointState] = []
    with ros_node("tester", domain=own_domain) as tester:
        receiver = SingleThreadedExecutor(context=tester.context)
        receiver.add_node(tester)
        tester.create_subscription(JointState, "joint_states", states.append, DEEP_QOS)

        def has_moved_by(time_ns: int) -> bool:
            for _ in range(200):
                receiver.spin_once(timeout_sec=0.0)
            return bool(states) and stamp_ns(states[-1]) - stamp_ns(states[0]) > time_ns

        node.bring_up()
        spin_for(executor, TIMEOUT_S, lambda: has_moved_by(0))
        last_ns = stamp_ns(states[-1])
        ros_ns, steady_ns = node.now_ns, time.monotonic_ns
        monkeypatch.setattr(node, "now_ns", lambda: ros_ns() + STOPPED_NS)
        monkeypatch.setattr(sim_node, "time", SimpleNamespace(monotonic_ns=lambda: steady_ns() + STOPPED_NS))
        spin_for(executor, TIMEOUT_S, lambda: has_moved_by(50_000_000 + last_ns - stamp_ns(states[0])))
        count = 0
        while count != (count := len(states)):
            receiver.spin_once(timeout_sec=0.5)
        assert stamp_ns(states[-1]) - last_ns < STOPPED_NS / 4
        receiver.shutdown()
    executor.shutdown()
    node.destroy_node()


@pytest.mark.usefixtures("default_context")
def test_simulated_time_stands_still_while_the_steady_clock_does(
    own_domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    node, executor = SimNode(), EventsExecutor()
    node.set_parameters([Parameter("clock", value=True)])
    executor.add_node(node)
    clock: list[Clock] = []
    states: list[JointState] = []
    with ros_node("tester", domain=own_domain) as tester:
        receiver = SingleThreadedExecutor(context=tester.context)
        receiver.add_node(tester)
        tester.create_subscription(JointState, "joint_states", states.append, DEEP_QOS)
        tester.create_subscription(Clock, "/clock", clock.append, DEEP_QOS)

        def has_published(count: int) -> bool:
            for _ in range(5):
                receiver.spin_once(timeout_sec=0.0)
            return len(clock) >= count and bool(states)

        node.bring_up()
        spin_for(executor, TIMEOUT_S, lambda: has_published(1))
        steady_ns = time.monotonic_ns()
        monkeypatch.setattr(sim_node, "time", SimpleNamespace(monotonic_ns=lambda: steady_ns))
        count = len(clock)
        spin_for(executor, TIMEOUT_S, lambda: has_published(count + 50))
        assert clock[-1] == clock[-20]
        receiver.shutdown()
    executor.shutdown()
    node.destroy_node()


def test_simulated_cell_does_not_catch_up_with_years(refusal_of: Callable[..., str]) -> None:
    assert refusal_of(SimNode, "start:=1.0") == "sim: start = 1.0: must be at most 60 s ago"
