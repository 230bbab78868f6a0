# SPDX-License-Identifier: Apache-2.0
"""Compare a bag replayed to the live monitor with its offline assessment, bit for bit."""

import os
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

from rclpy.serialization import deserialize_message
from scara_effmass_msgs.msg import ContactStates

from scara_effmass.bags.files import open_bag
from scara_effmass.share import share
from test.nodes.conftest import Answer, NodeHarness

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
    return found if len(found := responses(contacts)) >= JOINT_STATES else []


def test_replay_and_assess_agree_on_every_joint_state(new_harness: Callable[[], NodeHarness], tmp_path: Path) -> None:
    """The kernel computes on both sides. The acceleration counts for the age, which is 0 unless the machine is busy."""
    recording = str(share("bags", "straight_300_200"))
    harness = new_harness()
    harness.start("--ros-args", "-p", "use_sim_time:=true", "-p", "timeout:=10.0")
    harness.subscribe()
    harness.spin_until(lambda: harness.contact_states)  # the subscription has matched
    harness.diagnostic("model", "core", lambda core: core.startswith("compiled kernel"))
    environment = {**os.environ, "ROS_DOMAIN_ID": str(harness.domain)}
    with subprocess.Popen([COMMAND, "replay", recording], env=environment) as replay:
        harness.spin_until(lambda: replay.poll() is not None)
    assert replay.returncode == 0
    live = harness.spin_until(partial(responses_when_complete, harness.contact_states))

    assessed, params = tmp_path / "assessed.mcap", tmp_path / "params.yaml"
    params.write_text("monitor: {ros__parameters: {timeout: 10.0}}", encoding="utf-8")  # the machine may be busy
    assess = [COMMAND, "assess", recording, "-o", str(assessed), "--params", str(params)]
    subprocess.run(assess, check=True, stdout=subprocess.DEVNULL)
    with open_bag(assessed) as bag:
        offline = [deserialize_message(message.data, ContactStates) for message in bag.messages(["/contact_states"])]
    assert len(live) == len(offline) == JOINT_STATES
    on_time = 0
    for answer, of_bag in zip(live, offline, strict=True):
        if answer.message.input_age == of_bag.input_age:
            on_time += 1
            assert exact_text(answer.message) == exact_text(of_bag)
        else:
            assert answer.message.input_age > of_bag.input_age
            assert answer.message.allowable_speed <= of_bag.allowable_speed
    assert on_time > JOINT_STATES // 2
