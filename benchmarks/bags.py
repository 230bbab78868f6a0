# SPDX-License-Identifier: Apache-2.0
"""(c) Reading joint states from a bag: blocks of this package, compared with messages of rosbags."""

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
    """Return the median rates [messages/s] of this package and of rosbags, for a zstd MCAP of joint states."""
    block_rates, message_rates = [], []
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        _write(bag)
        for _ in range(ROUNDS):
            block_rates.append(MESSAGES / _read_blocks(bag))
            message_rates.append(MESSAGES / read_with_rosbags(bag, MESSAGES))
    return float(np.median(block_rates)), float(np.median(message_rates))


def _write(path: Path) -> None:
    names = ("joint1", "joint2", "joint3", "joint4")
    random = np.random.default_rng(1)
    values = random.normal(size=(MESSAGES, 8))
    with BagWriter(path) as writer:
        writer.write_joint_states(
            TOPIC, (JointState(1_000_000_000 + i * 1_000_000, names, row[:4], row[4:]) for i, row in enumerate(values))
        )


def _read_blocks(path: Path) -> float:
    """Return the time [s] to read all blocks."""
    start = time.perf_counter()
    with open_bag(path) as bag:
        count = sum(map(len, bag.joint_state_blocks(TOPIC)))
    duration_s = time.perf_counter() - start
    if count != MESSAGES:
        raise RuntimeError(f"{count} of {MESSAGES} joint states were read; expected all")
    return duration_s


def read_with_rosbags(path: Path, expected: int) -> float:
    """Return the time [s] to decode the `expected` joint states of a bag with rosbags."""
    start = time.perf_counter()
    with AnyReader([path]) as reader:
        count = sum(
            len(reader.deserialize(data, connection.msgtype).position) > 0
            for connection, _, data in reader.messages(reader.connections)
        )
    duration_s = time.perf_counter() - start
    if count != expected:
        raise RuntimeError(f"rosbags decoded {count} of {expected} joint states")
    return duration_s
