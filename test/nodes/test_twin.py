"""Compare a bag replayed to the live monitor with its offline assessment, bit for bit."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from rclpy.serialization import deserialize_message
from scara_effmass_msgs.msg import ContactState

from scara_effmass.bags.files import open_bag
from scara_effmass.share import share

if TYPE_CHECKING:
    from collections.abc import Callable

    from test.nodes.conftest import NodeHarness

COMMAND = str(Path(sys.executable).with_name("scara-effmass"))
JOINT_STATES = 1900


def exact_text(contact: ContactState) -> str:
    """Return all fields but the age as text; `repr` is exact for floats."""
    contact.input_age = 0.0
    return repr(contact)


def responses(harness: NodeHarness) -> list[ContactState]:
    """Return the responses to joint states, without those of the watchdog."""
    return [contact for contact in harness.contact_states if not contact.watchdog]


def test_replay_and_assess_agree_on_every_joint_state(new_harness: Callable[[], NodeHarness], tmp_path: Path) -> None:
    recording = str(share("bags", "straight_300_200"))
    harness = new_harness()
    harness.start("--ros-args", "-p", "use_sim_time:=true")
    harness.subscribe()
    harness.spin_until(lambda: harness.contact_states)  # the subscription has matched
    environment = {**os.environ, "ROS_DOMAIN_ID": str(harness.domain)}
    with subprocess.Popen([COMMAND, "replay", recording, "--rate", "0"], env=environment) as replay:
        harness.spin_until(lambda: replay.poll() is not None)
    assert replay.returncode == 0
    live = harness.spin_until(lambda: r if len(r := responses(harness)) >= JOINT_STATES else None)

    assessed = tmp_path / "assessed.mcap"
    subprocess.run([COMMAND, "assess", recording, "-o", str(assessed)], check=True, stdout=subprocess.DEVNULL)
    with open_bag(assessed) as bag:
        offline = [deserialize_message(message.data, ContactState) for message in bag.messages(["/contact_state"])]
    assert len(live) == len(offline) == JOINT_STATES
    for live_contact, offline_contact in zip(live, offline, strict=True):
        assert exact_text(live_contact) == exact_text(offline_contact)
