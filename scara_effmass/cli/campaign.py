"""`scara-effmass campaign`."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scara_effmass.cli.console import print_json, print_lines, progress_bar
from scara_effmass.cli.options import add_force, add_json

if TYPE_CHECKING:
    from scara_effmass.sim.campaign import Campaign, CampaignStep

EXAMPLES = """\
Robot, cart and force sensor are simulated (MuJoCo); nothing is measured, and every bag says so. DIR receives one bag
per run with joint states, force and run information, as the nodes would record them. Existing bags of the same run
are kept, so an interrupted campaign can be resumed.

examples:
  scara-effmass campaign -o out/campaign
  scara-effmass campaign -o out/light --configuration 300_200 --mass 0.5 --mass 2.39 --repetitions 1
  scara-effmass campaign -o out/hertz --hertz --stiffness 3400 --seed 1 --json
"""
HERTZ_STIFFNESS = 3400.0
"""Default of --hertz [N/mm^1.5]: about the peak forces of the default linear spring."""
MM_PER_M = 1e3


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = EXAMPLES
    parser.add_argument("-o", "--output", required=True, type=Path, metavar="DIR", help="folder for the bags")
    count = _number(int, 1, math.inf)
    parser.add_argument("--repetitions", type=count, default=3, metavar="N", help="runs of each case (default: 3)")
    parser.add_argument("--seed", type=_number(int, 0, math.inf), help="random seed of variations and noise")
    for option, metavar, kind, text in (
        ("--configuration", "NAME", str, "impact point, as 300_200 for (300, 200) mm"),
        ("--mass", "KG", _number(float, 1e-3, 1e3), "mass of the cart"),
    ):
        help_text = f"{text}; may be repeated (default: the paper's experiment)"
        parser.add_argument(option, action="append", type=kind, metavar=metavar, help=help_text)
    parser.add_argument(
        "--stiffness",
        type=float,
        metavar="N_PER_MM",
        help=f"of the tip [N/mm] (default: 2000), with --hertz [N/mm^1.5] (default: {HERTZ_STIFFNESS:g})",
    )
    parser.add_argument("--damping", type=float, default=0.0, metavar="N_S_PER_M", help="of the tip (default: 0)")
    parser.add_argument(
        "--friction", type=float, default=0.0, metavar="COEFFICIENT", help="between tip and plate (default: 0)"
    )
    parser.add_argument("--hertz", action="store_true", help="use a Hertz contact, F = k d^1.5, not a linear spring")
    add_force(parser)
    add_json(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Simulate and record all missing runs, and print a summary."""
    from scara_effmass.sim.campaign import run_campaign  # noqa: PLC0415 - MuJoCo, not needed for --help
    from scara_effmass.sim.experiment import build_sim  # noqa: PLC0415

    campaign = _campaign(args)
    for campaign_run in campaign.runs:
        build_sim(campaign_run.setup)  # refuses impossible contacts before anything is written
    steps: list[CampaignStep] = []
    with progress_bar() as progress:
        task = progress.add_task("simulated impacts", total=len(campaign.runs))
        for step in run_campaign(args.output, campaign, overwrite=args.force):
            steps.append(step)
            progress.update(task, completed=len(steps), description=f"simulated {step.path.name}")
    if args.json:
        print_json(_as_dict(args.output, campaign, steps))
    else:
        print_lines(_lines(args.output, campaign, steps))
    return 0


def _campaign(args: argparse.Namespace) -> Campaign:
    from scara_effmass.errors import SettingsError  # noqa: PLC0415
    from scara_effmass.sim.campaign import Campaign  # noqa: PLC0415
    from scara_effmass.sim.cart import HERTZ, LINEAR, POLYETHYLENE, SpringContact  # noqa: PLC0415
    from scara_effmass.sim.experiment import CONFIGURATIONS, OBSTACLE_MASSES  # noqa: PLC0415
    from scara_effmass.sim.recordings import SEED  # noqa: PLC0415

    by_name = {configuration.name: configuration for configuration in CONFIGURATIONS}
    names = tuple(dict.fromkeys(args.configuration or by_name))
    for name in names:
        if name not in by_name:
            raise SettingsError(f"--configuration {name}: must be one of {', '.join(by_name)}")
    masses = tuple(dict.fromkeys(args.mass or OBSTACLE_MASSES))
    if len({round(MM_PER_M * mass) for mass in masses}) < len(masses):
        raise SettingsError(f"--mass {' and '.join(map(str, masses))}: must differ by a gram")
    exponent = HERTZ if args.hertz else LINEAR
    stiffness = HERTZ_STIFFNESS if args.hertz else POLYETHYLENE.stiffness / MM_PER_M
    if args.stiffness is not None:
        stiffness = args.stiffness
    return Campaign(
        configurations=tuple(by_name[name] for name in names),
        obstacle_masses=masses,
        repetitions=args.repetitions,
        contact=SpringContact(stiffness * MM_PER_M**exponent, exponent, args.damping, args.friction),
        seed=SEED if args.seed is None else args.seed,
    )


def _as_dict(output: Path, campaign: Campaign, steps: Sequence[CampaignStep]) -> dict[str, Any]:
    return {
        "output": str(output),
        "simulated": True,
        "seed": campaign.seed,
        **asdict(campaign.contact),
        "made": sum(not step.kept for step in steps),
        "kept": sum(step.kept for step in steps),
        "runs": [
            {
                "bag": str(step.path),
                "kept": step.kept,
                "configuration": campaign_run.setup.configuration.name,
                "obstacle_mass_kg": campaign_run.setup.obstacle_mass,
                "repetition": campaign_run.repetition,
            }
            for campaign_run, step in zip(campaign.runs, steps, strict=True)
        ],
    }


def _lines(output: Path, campaign: Campaign, steps: Sequence[CampaignStep]) -> list[tuple[str, str]]:
    contact = campaign.contact
    kept = sum(step.kept for step in steps)
    cases = f"{len(campaign.configurations)} configurations, {len(campaign.obstacle_masses)} obstacle masses"
    times = "once" if campaign.repetitions == 1 else f"{campaign.repetitions} times"
    unit, law = ("N/mm", "linear spring") if contact.exponent == 1.0 else ("N/mm^1.5", "Hertz contact")
    stiffness = f"{contact.stiffness / MM_PER_M**contact.exponent:g} {unit}"
    lines = [
        ("simulated", f"{len(steps)} impacts in the simulated cell (MuJoCo); nothing was measured"),
        ("cases", f"{cases}, {times} each"),
        ("tip", f"{law} {stiffness}, damping {contact.damping:g} N s/m, friction {contact.friction:g}"),
        ("recorded", str(len(steps) - kept)),
    ]
    if kept:
        lines.append(("kept", f"{kept} existing recordings; --force replaces them"))
    return [*lines, ("written", str(output))]


def _number(kind: type[float], minimum: float, maximum: float) -> Callable[[str], float]:
    """Return an argparse type for finite numbers from `minimum` to `maximum`."""
    noun = "a whole number" if issubclass(kind, int) else "a number"

    def parse(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and minimum <= value <= maximum):
            raise argparse.ArgumentTypeError(f"{text}: must be {noun} from {minimum:g} to {maximum:g}")
        return value

    return parse
