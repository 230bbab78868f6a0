"""(c) Joint states out of a recording: this project's blocks against rosbags' messages, from the same file."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader

from scara_effmass.bags.files import open_bag
from scara_effmass.bags.writer import BagWriter
from scara_effmass.values import JointState

MESSAGES = 200_000
ROUNDS = 3
TOPIC = "/joint_states"


def measure() -> tuple[float, float]:
    """Return the median rate [messages/s] of both on a zstd MCAP of joint states at 1 kHz."""
    ours, theirs = [], []
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        _write(bag)
        for _ in range(ROUNDS):
            ours.append(MESSAGES / _read_blocks(bag))
            theirs.append(MESSAGES / _read_messages(bag))
    return float(np.median(ours)), float(np.median(theirs))


def _write(bag: Path) -> None:
    names = ("joint1", "joint2", "joint3", "joint4")
    random = np.random.default_rng(1)
    values = random.normal(size=(MESSAGES, 8))
    with BagWriter(bag) as writer:
        writer.write_joint_states(
            TOPIC, (JointState(1_000_000_000 + i * 1_000_000, names, row[:4], row[4:]) for i, row in enumerate(values))
        )


def _read_blocks(bag: Path) -> float:
    started = time.perf_counter()
    with open_bag(bag) as recording:
        count = sum(len(block.stamp_ns) for block in recording.joint_state_blocks(TOPIC))
    _require(count)
    return time.perf_counter() - started


def _read_messages(bag: Path) -> float:
    started = time.perf_counter()
    with AnyReader([bag]) as reader:
        count = sum(
            len(reader.deserialize(data, connection.msgtype).position) == 4
            for connection, _, data in reader.messages(reader.connections)
        )
    _require(count)
    return time.perf_counter() - started


def _require(count: int) -> None:
    if count != MESSAGES:
        raise RuntimeError(f"{count} of {MESSAGES} joint states were read")
