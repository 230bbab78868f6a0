# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass demo`."""

import argparse

from scara_effmass.bags.rosbag2 import check_output
from scara_effmass.cli.demo_bag import run_bag
from scara_effmass.cli.demo_sim import run_sim
from scara_effmass.cli.processes import RECORDING
from scara_effmass.cli.settings import load_dynamics, monitor_settings
from scara_effmass.errors import SettingsError


def run(args: argparse.Namespace) -> int:
    """Run the simulated cell or a replay live, and write the report."""
    check_output(args.out / RECORDING, overwrite=args.force)
    settings = monitor_settings(args)
    dynamics = load_dynamics(settings)
    if args.bag:
        return run_bag(args, dynamics, settings)
    if settings.robot:
        raise SettingsError("demo: --robot: the simulated cell has its own robot, an i4-550L; --robot needs --bag")
    if args.topic:
        raise SettingsError(f"demo: --topic = {args.topic}: the simulated cell has its own topic; it needs --bag")
    if settings.payload_mass or settings.payload_topic:
        raise SettingsError("demo: payload: the simulated robot carries none; it needs --bag")
    return run_sim(args, dynamics, settings)
