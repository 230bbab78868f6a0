# SPDX-License-Identifier: Apache-2.0
"""(d) `assess` end to end, from a bag to a table of verdicts, against rosbags decoding the same file."""

from __future__ import annotations

import contextlib
import io
import tempfile
import time
from pathlib import Path

import numpy as np
from core import smooth_motion
from rosbags.highlevel import AnyReader

from scara_effmass import cli
from scara_effmass.bags.writer import BagWriter

ROUNDS = 3
TOPIC = "/joint_states"


def measure() -> tuple[float, float]:
    """Return the median rates [joint states/s] of `assess` and of rosbags, timed in turn on one zstd MCAP."""
    states = smooth_motion()
    ours, theirs = [], []
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        with BagWriter(bag) as writer:
            writer.write_joint_states(TOPIC, states)
        for _ in range(ROUNDS):
            ours.append(len(states) / _assess(bag))
            theirs.append(len(states) / _decode(bag, len(states)))
    return float(np.median(ours)), float(np.median(theirs))


def _assess(bag: Path) -> float:
    output = bag.with_name("verdicts.parquet")
    started = time.perf_counter()
    with contextlib.redirect_stdout(io.StringIO()):
        code = cli.main(["assess", str(bag), "-o", str(output), "--force"])
    duration_s = time.perf_counter() - started
    if code != 0:
        raise RuntimeError(f"assess ended with {code}")
    return duration_s


def _decode(bag: Path, count: int) -> float:
    started = time.perf_counter()
    with AnyReader([bag]) as reader:
        decoded = sum(
            len(reader.deserialize(data, connection.msgtype).position) == 4
            for connection, _, data in reader.messages(reader.connections)
        )
    duration_s = time.perf_counter() - started
    if decoded != count:
        raise RuntimeError(f"rosbags decoded {decoded} of {count} joint states")
    return duration_s
