# SPDX-License-Identifier: Apache-2.0
"""Compare a bag replayed to the live monitor with its offline assessment, bit for bit."""

import os
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message
from scara_effmass_msgs.msg import ContactStates
from sensor_msgs.msg import JointState as JointStateMessage

from scara_effmass.bags.files import open_bag
from scara_effmass.cli import main
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share
from scara_effmass.values import JointState
from scara_effmass.wire.contact_states import decode_contact_states
from test.forked import Forked
from test.nodes.conftest import Answer, NodeHarness
from test.nodes.test_monitor_input import bits

COMMAND = str(Path(sys.executable).with_name("scara-effmass"))
JOINT_STATES = 1900


def exact_text(message: ContactStates) -> str:
    """Return all fields but age and number as text; `repr` is exact for floats."""
    message.input_age, message.sequence_number = 0.0, 0
    return repr(message)


def responses(contacts: list[Answer]) -> list[Answer]:
    """Return the responses to joint states, without those of the watchdog."""
    return [contact for contact in contacts if not contact.watchdog]


def responses_when_complete(contacts: list[Answer]) -> list[Answer]:
    is_long = len(contacts) >= JOINT_STATES  # asked after each message: it must be quick
    return found if is_long and len(found := responses(contacts)) >= JOINT_STATES else []


def test_replay_and_assess_agree_on_every_joint_state(new_harness: Callable[[], NodeHarness], tmp_path: Path) -> None:
    """The kernel computes on both sides.

    The acceleration counts for the age, which is 0 unless the machine is busy: a monitor of that age must agree.
    """
    recording = str(share("bags", "straight_300_200"))
    harness = new_harness()
    harness.start("--ros-args", "-p", "use_sim_time:=true", "-p", "timeout:=10.0")
    harness.subscribe()
    harness.spin_until(lambda: harness.contact_states)  # the subscription has matched
    harness.diagnostic("model", "core", lambda core: core.startswith("compiled kernel"))
    environment = {**os.environ, "ROS_DOMAIN_ID": str(harness.domain)}
    with Forked([COMMAND, "replay", recording, "--rate", "0.25"], env=environment) as replay:
        harness.spin_until(lambda: replay.poll() is not None)
    assert replay.returncode == 0
    live = harness.spin_until(partial(responses_when_complete, harness.contact_states))

    assessed, params = tmp_path / "assessed.mcap", tmp_path / "params.yaml"
    params.write_text("monitor: {ros__parameters: {timeout: 10.0}}", encoding="utf-8")  # the machine may be busy
    assert main(["assess", recording, "-o", str(assessed), "--params", str(params)]) == 0
    with open_bag(assessed) as bag:
        offline = [deserialize_message(message.data, ContactStates) for message in bag.messages(["/contact_states"])]
    assert len(live) == len(offline) == JOINT_STATES
    settings = MonitorSettings(timeout=10.0)
    monitors = [Monitor(RobotDynamics(load_robot(settings=settings)), settings) for _ in range(2)]
    with open_bag(Path(recording)) as bag:
        sent = [deserialize_message(message.data, JointStateMessage) for message in bag.messages(["/joint_states"])]
    for state, answer, of_bag in zip(sent, live, offline, strict=True):
        stamp_ns = state.header.stamp.sec * 10**9 + state.header.stamp.nanosec
        joint_state = JointState(stamp_ns, tuple(state.name), np.array(state.position), np.array(state.velocity))
        for monitor, message in zip(monitors, (answer.message, of_bag), strict=True):
            decision = monitor.assess(joint_state, stamp_ns + round(message.input_age * 1e9))
            decoded = decode_contact_states(bytes(serialize_message(message)))
            assert decision is not None
            assert [*map(bits, decoded.contacts)] == [*map(bits, decision.contacts)]
        if answer.message.input_age == of_bag.input_age:
            assert exact_text(answer.message) == exact_text(of_bag)
