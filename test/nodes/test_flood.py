# SPDX-License-Identifier: Apache-2.0
"""Another process floods `joint_states`: the verdicts go on, and none that permits a speed is old."""

import os
import subprocess
import sys
from collections.abc import Callable
from itertools import pairwise
from typing import Any, NamedTuple

import pytest
from rclpy.qos import QoSProfile
from scara_effmass_msgs.msg import ContactState, ContactStates

from test.nodes.conftest import NodeHarness, stamp_ns

TIMEOUT_NS = 1_000_000_000
"""Of the monitor."""
MAX_AGE_NS = 1.25 * TIMEOUT_NS
"""Of a permissive state when it is published: the timeout, and the time of its assessment on a busy machine."""
FLOODER = """
import struct, sys, time
import rclpy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
names, numbers, count, rate = map(int, sys.argv[1:])
rclpy.init()
node = rclpy.create_node("flooder")
publisher = node.create_publisher(JointState, "joint_states", 10)
message = JointState(name=["joint1", "joint2", "joint3", "joint4", *(f"n{i}" for i in range(names))])
message.position = [0.3, 1.2, 0.1, -0.4, *[0.0] * numbers]
message.velocity = [0.01, -0.01, 0.003, 0.01]
data = bytearray(serialize_message(message))
while not publisher.get_subscription_count():
    time.sleep(0.01)
start = time.monotonic()
for i in range(count):
    struct.pack_into("<iI", data, 4, *divmod(time.time_ns(), 10**9))
    publisher.publish(bytes(data))
    if i % 10 == 9:
        time.sleep(max(0.0, start + (i + 1) / rate - time.monotonic()))
time.sleep(0.1)
"""


class Published(NamedTuple):
    time_ns: int
    age_ns: int
    verdict: int
    reason: str


@pytest.mark.parametrize(
    ("names", "numbers", "count", "rate", "reason"),
    [
        pytest.param(0, 0, 20_000, 10_000, "", id="10 kHz"),
        pytest.param(200_000, 200_000, 100, 100, "JointState: name has length 200004", id="200 000 names"),
        pytest.param(0, 300_000, 100, 100, "300004 positions for 4 names", id="300 000 numbers"),
    ],
)
def test_flood_leaves_no_old_permission(
    new_harness: Callable[..., NodeHarness], names: int, numbers: int, count: int, rate: int, reason: str
) -> None:
    harness = new_harness("--ros-args", "-p", f"timeout:={TIMEOUT_NS / 1e9}", "-p", "release_time:=0.0")
    published: list[Published] = []

    def receive(state: ContactStates, info: dict[str, Any]) -> None:
        time_ns = info["source_timestamp"]
        published.append(Published(time_ns, time_ns - stamp_ns(state), state.verdict, state.reason))

    harness.node.create_subscription(ContactStates, "contact_states", receive, QoSProfile(depth=100))  # type: ignore[arg-type]
    harness.subscribe()
    harness.send_until_ok()
    harness.stop_sending()
    published.clear()
    arguments = map(str, (names, numbers, count, rate))
    environment = {**os.environ, "ROS_DOMAIN_ID": str(harness.domain)}
    with subprocess.Popen([sys.executable, "-c", FLOODER, *arguments], env=environment) as flooder:
        harness.spin_until(lambda: flooder.poll() is not None)
    assert flooder.returncode == 0
    harness.spin_until(lambda: published[-1].reason.startswith("no valid joint state for"))
    permissive = [state for state in published if state.verdict in {ContactState.OK, ContactState.WARN}]
    times = [state.time_ns for state in published]
    assert max(later - earlier for earlier, later in pairwise(times)) < 2 * TIMEOUT_NS
    assert max((state.age_ns for state in permissive), default=0) <= MAX_AGE_NS
    assert permissive or reason
    assert any(state.reason.startswith(reason) for state in published)
    assert published[-1].verdict == ContactState.UNKNOWN
