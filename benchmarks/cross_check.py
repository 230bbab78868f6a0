# SPDX-License-Identifier: Apache-2.0
"""Generated joint states with faults, assessed by kernel and monitor; prints what differs, exit 1 if anything does."""

from __future__ import annotations

import argparse
import runpy
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any

import numpy as np
from rich.console import Console
from scara_effmass.analysis.archive import many_at_once, slow_reason

from scara_effmass.analysis.assessment import ClockSkew, Time, assess_joint_states, one_by_one
from scara_effmass.analysis.cross_check import differences
from scara_effmass.bags.files import open_bag
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share

RECORDINGS: Any = SimpleNamespace(
    **runpy.run_path(str(Path(__file__).parents[1] / "test" / "analysis" / "faulty_recordings.py"))
)
ROBOTS = {"SCARA": "", "UR10, six axes": "ur10_robot.urdf", "Panda, seven axes": "panda.urdf"}
RECORDING, FAULTS_EACH = 6_000, 3
"""Joint states of a recording, and faults in it."""
NORMALS, RELEASES = ("worst", "worst", "velocity", "0 0 1"), (0.2, 0.0)
TOPIC = "/joint_states"
show = Console(soft_wrap=True, highlight=False, markup=False).print


def compare(file: str, number: int, seed: int) -> tuple[int, int, list[str]]:
    """Return the joint states of at least `number` generated ones, the refused ones, and the differences in words."""
    rng, assessed, refused = np.random.default_rng(seed), 0, 0
    found: list[str] = []
    path = str(share("config", "robots", file)) if file else ""
    while assessed < number:
        normal, release = NORMALS[rng.integers(len(NORMALS))], RELEASES[rng.integers(len(RELEASES))]
        settings = MonitorSettings(robot=path, contact_normal=normal, release_time=release)
        dynamics = RobotDynamics(load_robot(Path(path) if path else None, settings))
        faults = [(str(rng.choice(RECORDINGS.FAULTS)), int(rng.integers(RECORDING))) for _ in range(FAULTS_EACH)]
        kind, own_seed = list(Time)[rng.integers(len(Time))], int(rng.integers(2**32))
        with TemporaryDirectory() as folder:
            bag_path = RECORDINGS.write(
                Path(folder, "bag.mcap"), RECORDINGS.messages(dynamics, RECORDING, own_seed, faults)
            )
            with open_bag(bag_path) as bag, open_bag(bag_path) as again:
                monitor = Monitor(dynamics, settings)
                if slow := slow_reason(monitor, None):
                    raise RuntimeError(slow)
                states = many_at_once(bag, TOPIC, monitor, ClockSkew(), kind)
                decisions = assess_joint_states(again, TOPIC, Monitor(dynamics, settings), kind)
                for own, other in zip(states, one_by_one(decisions, ClockSkew()), strict=True):
                    where = f"seed {own_seed}, {kind.value}, {settings.contact_normal}"
                    found += [f"{where}, at {own.log_time_ns[row]} ns: {text}" for row, text in differences(own, other)]
                    assessed, refused = assessed + len(own), refused + int(own.refused.sum())
    return assessed, refused, found


def main() -> int:
    """Compare the robots one after the other and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--number", type=int, default=700_000, help="joint states per robot")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    count = 0
    for robot, file in ROBOTS.items():
        started = time.monotonic()
        assessed, refused, found = compare(file, args.number, args.seed)
        seconds = time.monotonic() - started
        show(f"{robot}: {assessed} joint states, {refused} refused, {len(found)} differences, {seconds:.0f} s")
        show("\n".join(found[:20]))
        count += len(found)
    return 1 if count else 0


if __name__ == "__main__":
    sys.exit(main())
