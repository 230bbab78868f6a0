"""Write a simulated run as a bag, with the topics that the live suite would record."""

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

JOINT_STATES_TOPIC = f"/{topics.JOINT_STATES}"
FORCE_TOPIC = f"/{topics.FORCE}"
RUN_INFO_TOPIC = f"/{topics.RUN_INFO}"


def write_recording(
    path: Path,
    info: RunInfo,
    joint_states: Iterable[JointState],
    force_blocks: Iterable[tuple[int, ForceBlock]],
    *,
    overwrite: bool,
) -> None:
    """Write a bag at `path`; force blocks come with their log time [ns]. Raises OutputError."""
    messages = [(state.stamp_ns, JOINT_STATES_TOPIC, JOINT_STATE, joint_state_message(state)) for state in joint_states]
    messages += [(time_ns, FORCE_TOPIC, FORCE_BLOCK, force_block_message(block)) for time_ns, block in force_blocks]
    with BagWriter(path, overwrite=overwrite) as bag:
        bag.write(RUN_INFO_TOPIC, RUN_INFO, info.stamp_ns, run_info_message(info))
        for time_ns, topic, message_type, data in sorted(messages, key=itemgetter(0)):
            bag.write(topic, message_type, time_ns, data)
