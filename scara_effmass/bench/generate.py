"""Recordings as files: rosbag2 folders that say of themselves that they were generated."""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING

from scara_effmass.bag_io.definitions import RECORDING_INFO
from scara_effmass.bag_io.messages import serialized
from scara_effmass.bag_io.writer import BagWriter
from scara_effmass.bench.recordings import EPOCH_NS, RECORDINGS, REVISION, SEED
from scara_effmass.errors import OutputError

if TYPE_CHECKING:
    from pathlib import Path

    from scara_effmass.bench.recordings import Recording

JOINT_STATES_TOPIC = "/joint_states"
TEXT = "std_msgs/msg/String"
CHECKSUMS = "SHA256SUMS"


def generate(folder: Path, *, overwrite: bool = False) -> tuple[Path, ...]:
    """Write every reference recording into `folder`, with the checksums of their files; return the paths.

    No clock goes into them: the same versions of the libraries give the same bytes. Raises OutputError.
    """
    sums = folder / CHECKSUMS
    if sums.exists() and not overwrite:
        raise OutputError(f"{sums}: exists already; it is replaced only when that is asked for")
    bags = tuple(_write(folder, recording, overwrite=overwrite) for recording in RECORDINGS)
    files = sorted(file for bag in bags for file in bag.iterdir())
    lines = [f"{hashlib.sha256(f.read_bytes()).hexdigest()}  {f.relative_to(folder).as_posix()}\n" for f in files]
    try:
        sums.write_text("".join(lines), encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{sums}: cannot be written: {error.strerror}") from None
    return (*bags, sums)


def about(recording: Recording) -> str:
    """Return what a recording says of itself, as JSON."""
    facts = {
        "generated": True,
        "description": recording.description,
        "generator": "python -m scara_effmass.bench",
        "revision": REVISION,
        "seed": SEED,
    }
    return json.dumps(facts)


def _write(folder: Path, recording: Recording, *, overwrite: bool) -> Path:
    path = folder / recording.name
    with BagWriter(path, overwrite=overwrite) as bag:
        bag.write(RECORDING_INFO, TEXT, EPOCH_NS, serialized(TEXT, {"data": about(recording)}))
        bag.write_joint_states(JOINT_STATES_TOPIC, recording.states())
    return path
