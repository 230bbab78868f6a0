"""`scara-effmass demo`."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from scara_effmass.cli.options import (
    add_force,
    add_json,
    add_params,
    add_robot,
    add_topic,
    load_dynamics,
    number,
    settings_from,
)
from scara_effmass.cli.processes import RECORDING
from scara_effmass.errors import SettingsError
from scara_effmass.settings import MassModel, MonitorSettings

if TYPE_CHECKING:
    from scara_effmass.model.dynamics import RobotDynamics

EXAMPLES = """\
Without --bag: a simulated robot drives into simulated carts. The monitor, force and validator nodes watch it over DDS,
the recorder records it, and a report compares predicted with simulated forces. This takes about a minute.

With --bag: the recording is replayed to the monitor, the force node plays its force if it has any, the run is recorded,
and a report shows verdicts, speeds and masses over time.

All nodes run as separate processes in a ROS domain of their own on this machine.

examples:
  scara-effmass demo
  scara-effmass demo --bag bags/tour --rate 2 --duration 10 --out out/tour
  scara-effmass demo --bag recording.bag --robot arm.urdf --topic /arm/joint_states --out out/arm
"""


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = EXAMPLES
    parser.add_argument("--bag", type=Path, metavar="BAG", help="recording to replay (default: run the simulated cell)")
    add_topic(parser)
    add_robot(parser)
    add_params(parser)
    parser.add_argument(
        "--rate",
        type=number(minimum=0.0),
        default=1.0,
        help="replay speed; 0: as fast as the monitor answers (default: 1)",
    )
    parser.add_argument(
        "--duration",
        type=number(above=0.0, finite=False, unit="s"),
        default=math.inf,
        metavar="S",
        help="duration of the replay or simulation [s] (default: all)",
    )
    parser.add_argument(
        "--out", type=Path, default=Path("out/demo"), metavar="DIR", help="output folder (default: out/demo)"
    )
    add_force(parser)
    add_json(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the simulated cell or a replay live, and write the report."""
    from scara_effmass.bags.rosbag2 import check_output  # noqa: PLC0415 - not needed for --help
    from scara_effmass.cli.demo_bag import run_bag  # noqa: PLC0415
    from scara_effmass.cli.demo_sim import run_sim  # noqa: PLC0415

    check_output(args.out / RECORDING, overwrite=args.force)
    settings, dynamics, note = _choose_mass_model(args)
    if args.bag is None:
        if args.robot or settings.robot:
            raise SettingsError("demo: --robot: the simulated cell has its own robot, an i4-550L; --robot needs --bag")
        if args.topic:
            raise SettingsError(f"demo: --topic = {args.topic}: the simulated cell has its own topic; it needs --bag")
    return run_bag(args, dynamics, settings, note) if args.bag else run_sim(args, dynamics, settings)


def _choose_mass_model(args: argparse.Namespace) -> tuple[MonitorSettings, RobotDynamics, str]:
    """Return settings, robot, and a note if another model replaces a lumped mass that does not exist."""
    settings = settings_from(args)
    dynamics = load_dynamics(settings)
    if args.effective_mass_model or settings.effective_mass_model is not MassModel.LUMPED or not dynamics.lumped_reason:
        return settings, dynamics, ""
    model = MassModel.ISO if dynamics.full_reason else MassModel.FULL
    note = f"{model.value}, because the lumped mass does not exist: {dynamics.lumped_reason}"
    return settings_from(args, effective_mass_model=model), dynamics, note
