# SPDX-License-Identifier: Apache-2.0
"""sim_node: the simulated cell waits for those who listen to it."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from scara_effmass.nodes.sim_node import SimNode
from test.nodes.conftest import DEEP_QOS, NodeHarness, ros_node

SIM_NODE = Path(sys.executable).with_name("sim_node")


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


def test_simulated_cell_does_not_catch_up_with_years(refusal_of: Callable[..., str]) -> None:
    assert refusal_of(SimNode, "start:=1.0") == "sim: start = 1.0: must be at most 60 s ago"
