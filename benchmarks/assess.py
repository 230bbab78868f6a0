# SPDX-License-Identifier: Apache-2.0
"""(d) `assess` end to end, from a bag to a table of verdicts, against rosbags decoding the same file."""

from __future__ import annotations

import contextlib
import io
import tempfile
import time
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np

from bags import read_with_rosbags
from scara_effmass import cli
from scara_effmass.bags.writer import BagWriter
from scara_effmass.model.load import load_robot
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share
from scara_effmass.values import JointState

ROUNDS = 3
COUNT = 600_000
"""Ten minutes at 1 kHz."""
TOPIC = "/joint_states"
POINTS = ("tool", "elbow")
ROBOTS: dict[str, tuple[str, tuple[str, ...], float]] = {
    "SCARA, 2 contact points": ("", POINTS, 5.0),
    "SCARA, 2 contact points and 4 links": ("", (), 1.0),
    "UR10, six axes": ("ur10_robot.urdf", (), 5.5),
    "Panda, seven axes": ("panda.urdf", (), 6.0),
}
"""Robot file, contact points, and the smallest rate over that of rosbags."""


def measure(robot: str, points: tuple[str, ...]) -> tuple[float, float]:
    """Return the median rates [joint states/s] of `assess` and of rosbags, timed in turn on one zstd MCAP.

    `robot` is a file in config/robots, empty for the shipped SCARA, `points` are its contact points, empty: all.
    """
    path = str(share("config", "robots", robot)) if robot else ""
    options = [*(["--robot", path] if robot else []), *chain(*(("--contact-point", point) for point in points))]
    ours, theirs = [], []
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        with BagWriter(bag) as writer:
            writer.write_joint_states(TOPIC, _motion(path))
        for _ in range(ROUNDS):
            ours.append(COUNT / _assess(bag, options))
            theirs.append(COUNT / read_with_rosbags(bag, COUNT))
    return float(np.median(ours)), float(np.median(theirs))


def _motion(robot: str) -> Iterator[JointState]:
    """Yield joint states at 1 kHz of a smooth motion about the middle of the ranges, at collaborative speeds."""
    loaded = load_robot(Path(robot) if robot else None, MonitorSettings(robot=robot))
    lower, upper = (
        np.clip(limits, -3.0, 3.0) for limits in (loaded.model.lowerPositionLimit, loaded.model.upperPositionLimit)
    )
    rates = np.linspace(0.28, 0.52, loaded.model.nv)
    middle, sizes = 0.5 * (lower + upper), np.minimum(0.2 * (upper - lower), 0.5)
    for number in range(COUNT):
        phases = rates * (number / 1000.0)
        stamp_ns = 1_000_000_000 + 1_000_000 * number
        yield JointState(stamp_ns, loaded.joint_names, middle + sizes * np.sin(phases), sizes * rates * np.cos(phases))


def _assess(bag: Path, options: list[str]) -> float:
    output = bag.with_name("verdicts.parquet")
    output.unlink(missing_ok=True)  # to replace a file is to delete one, too
    started = time.perf_counter()
    with contextlib.redirect_stdout(io.StringIO()):
        code = cli.main(["assess", str(bag), "-o", str(output), *options])
    duration_s = time.perf_counter() - started
    if code != 0:
        raise RuntimeError(f"assess ended with {code}")
    return duration_s
