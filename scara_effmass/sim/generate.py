"""Recordings as files: rosbag2 folders that say of themselves that they were generated."""

from __future__ import annotations

import hashlib
import heapq
from operator import itemgetter
from typing import TYPE_CHECKING

from scara_effmass.bags.writer import BagWriter
from scara_effmass.errors import OutputError
from scara_effmass.sim.campaign import Campaign, run_campaign
from scara_effmass.sim.recordings import EPOCH_NS, RECORDINGS, REVISION, SEED
from scara_effmass.sim.synthetic_force import BLOCK_NS
from scara_effmass.sim.topics import FORCE_TOPIC, JOINT_STATES_TOPIC, RUN_INFO_TOPIC
from scara_effmass.values import RunInfo
from scara_effmass.wire.force import force_block_message
from scara_effmass.wire.joint_state import joint_state_message
from scara_effmass.wire.message_types import FORCE_BLOCK, JOINT_STATE, RUN_INFO
from scara_effmass.wire.run_info import run_info_message

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from scara_effmass.sim.recordings import ReferenceRecording

CHECKSUMS = "SHA256SUMS"
CAMPAIGN = Campaign(repetitions=1)
"""The one that is shipped, in the folder of this name:"""
CAMPAIGN_FOLDER = "campaign"


def generate(folder: Path, *, overwrite: bool = False) -> tuple[Path, ...]:
    """Write every reference recording and the campaign into `folder`, with checksums; return the paths.

    No clock goes into them: the same versions of the libraries give the same bytes. Raises OutputError.
    """
    sums = folder / CHECKSUMS
    if sums.exists() and not overwrite:
        raise OutputError(f"{sums}: exists already; --force replaces it")
    bags = [_write(folder, recording, overwrite=overwrite) for recording in RECORDINGS]
    bags += [step.path for step in run_campaign(folder / CAMPAIGN_FOLDER, CAMPAIGN, overwrite=overwrite)]
    files = sorted(file for bag in bags for file in bag.iterdir())
    lines = [f"{hashlib.sha256(f.read_bytes()).hexdigest()}  {f.relative_to(folder).as_posix()}\n" for f in files]
    try:
        sums.write_text("".join(lines), encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{sums}: cannot be written: {error.strerror}") from None
    return (*bags, sums)


def run_info(recording: ReferenceRecording) -> RunInfo:
    """Return the run information of a recording: generated, how, and which contacts its force holds."""
    lines = [
        recording.description,
        f"generator = python -m scara_effmass.sim, revision = {REVISION}, seed = {SEED}",
        *(
            f"contact at {pulse.onset_s} s: peak {pulse.peak_force} N, duration {pulse.duration} s, "
            f"impulse {pulse.impulse} N s, rebound {pulse.rebound}"
            for pulse in recording.pulses
        ),
    ]
    return RunInfo(stamp_ns=EPOCH_NS, simulated=True, note="\n".join(lines))


def _write(folder: Path, recording: ReferenceRecording, *, overwrite: bool) -> Path:
    path = folder / recording.name
    with BagWriter(path, overwrite=overwrite) as bag:
        bag.write(RUN_INFO_TOPIC, RUN_INFO, EPOCH_NS, run_info_message(run_info(recording)))
        for log_time_ns, topic, kind, data in _messages(recording):
            bag.write(topic, kind, log_time_ns, data)
    return path


def _messages(recording: ReferenceRecording) -> Iterator[tuple[int, str, str, bytes]]:
    """Yield all messages as they would have come: a block of force is there when its last sample is."""
    states = ((s.stamp_ns, JOINT_STATES_TOPIC, JOINT_STATE, joint_state_message(s)) for s in recording.states())
    blocks = (
        (b.stamp_ns + BLOCK_NS, FORCE_TOPIC, FORCE_BLOCK, force_block_message(b)) for b in recording.force_blocks()
    )
    return heapq.merge(states, blocks, key=itemgetter(0))
