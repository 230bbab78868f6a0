# SPDX-License-Identifier: Apache-2.0
"""Recordings with the topics of the live suite, which do not depend on the day they are generated."""

from collections.abc import Iterable
from operator import itemgetter
from pathlib import Path

from scara_effmass.bags.writer import BagWriter
from scara_effmass.values import ForceBlock, JointState, RunInfo
from scara_effmass.wire import topics
from scara_effmass.wire.force import force_block_message
from scara_effmass.wire.joint_state import joint_state_message
from scara_effmass.wire.message_types import FORCE_BLOCK, JOINT_STATE, RUN_INFO
from scara_effmass.wire.run_info import run_info_message

JOINTS = ("joint1", "joint2", "joint3", "joint4")
EPOCH_NS = 1_767_225_600_000_000_000
"""Fictitious start, 2026-01-01 00:00:00 UTC."""
SEED = 550
FORCE_TOPIC = f"/{topics.FORCE}"


def write_recording(
    path: Path,
    info: RunInfo,
    joint_states: Iterable[JointState],
    force_blocks: Iterable[tuple[int, ForceBlock]],
    *,
    overwrite: bool,
) -> None:
    """Write a bag with the live suite's topics; force blocks come with their log time [ns]. Raises OutputError."""
    states_topic = f"/{topics.JOINT_STATES}"
    messages = [(state.stamp_ns, states_topic, JOINT_STATE, joint_state_message(state)) for state in joint_states]
    messages += [(time_ns, FORCE_TOPIC, FORCE_BLOCK, force_block_message(block)) for time_ns, block in force_blocks]
    with BagWriter(path, overwrite=overwrite) as bag:
        bag.write(f"/{topics.RUN_INFO}", RUN_INFO, info.stamp_ns, run_info_message(info))
        for time_ns, topic, message_type, data in sorted(messages, key=itemgetter(0)):
            bag.write(topic, message_type, time_ns, data)
