"""`scara-effmass campaign`."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scara_effmass.cli.console import print_json, print_lines, progress_bar
from scara_effmass.cli.options import add_force, add_json

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from scara_effmass.sim.campaign import Campaign, CampaignStep

EXAMPLES = """\
Nothing is measured: robot, cart and force sensor are simulated (MuJoCo), and every bag says so. DIR gets one bag per
run, with joint states, force and what was set, as the nodes would have recorded it. A bag of the same run that
is there already is kept, so a campaign that was interrupted goes on.

examples:
  scara-effmass campaign -o out/campaign
  scara-effmass campaign -o out/light --configuration 300_200 --mass 0.5 --mass 2.39 --repetitions 1
  scara-effmass campaign -o out/hertz --hertz --stiffness 3400 --seed 1 --json
"""
HERTZ_STIFFNESS = 3400.0
"""Of the tip unless it is given [N/mm^1.5]: about the forces that the linear spring gives."""
MM_PER_M = 1e3


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = EXAMPLES
    parser.add_argument("-o", "--output", required=True, type=Path, metavar="DIR", help="folder for the bags")
    parser.add_argument("--repetitions", type=_count, default=3, metavar="N", help="of each case (default: 3)")
    parser.add_argument("--seed", type=_seed, help="of how runs differ, and of the noise")
    for option, name, what in (
        ("--configuration", "NAME", "where the robot hits, as 300_200 for (300, 200) mm"),
        ("--mass", "KG", "mass of the cart"),
    ):
        parser.add_argument(
            option,
            action="append",
            type=_mass if option == "--mass" else str,
            metavar=name,
            help=f"{what}; may be given several times (default: the paper's experiment)",
        )
    parser.add_argument(
        "--stiffness",
        type=_positive,
        metavar="N_PER_MM",
        help=f"of the tip [N/mm] (default: 2000), with --hertz [N/mm^1.5] (default: {HERTZ_STIFFNESS:g})",
    )
    parser.add_argument("--damping", type=_number, default=0.0, metavar="N_S_PER_M", help="of the tip (default: 0)")
    parser.add_argument(
        "--friction", type=_number, default=0.0, metavar="COEFFICIENT", help="between tip and plate (default: 0)"
    )
    parser.add_argument("--hertz", action="store_true", help="a Hertz contact, F = k d^1.5, not a linear spring")
    add_force(parser)
    add_json(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Simulate and record what is not there yet, and print what was done."""
    from scara_effmass.sim.campaign import run_campaign  # noqa: PLC0415 - MuJoCo, not needed for --help
    from scara_effmass.sim.experiment import build_sim  # noqa: PLC0415

    campaign = _campaign(args)
    for each in campaign.runs:
        build_sim(each.setup)  # refuses a contact that cannot be simulated before anything is written
    steps: list[CampaignStep] = []
    with progress_bar() as progress:
        task = progress.add_task("simulated impacts", total=len(campaign.runs))
        for step in run_campaign(args.output, campaign, overwrite=args.force):
            steps.append(step)
            progress.update(task, completed=step.number, description=f"simulated {step.path.name}")
    if args.json:
        print_json(_as_dict(args.output, campaign, steps))
    else:
        print_lines(_lines(args.output, campaign, steps))
    return 0


def _campaign(args: argparse.Namespace) -> Campaign:
    from scara_effmass.errors import SettingsError  # noqa: PLC0415
    from scara_effmass.sim.campaign import Campaign  # noqa: PLC0415
    from scara_effmass.sim.impact_setup import CONFIGURATIONS, OBSTACLE_MASSES  # noqa: PLC0415
    from scara_effmass.sim.recordings import SEED  # noqa: PLC0415
    from scara_effmass.sim.spring_contact import HERTZ, LINEAR, POLYETHYLENE, SpringContact  # noqa: PLC0415

    known = {each.name: each for each in CONFIGURATIONS}
    for name in args.configuration or ():
        if name not in known:
            raise SettingsError(f"--configuration {name}: one of {', '.join(known)} would be right")
    masses = tuple(dict.fromkeys(args.mass or OBSTACLE_MASSES))
    if len({round(MM_PER_M * mass) for mass in masses}) < len(masses):
        raise SettingsError(f"--mass {' and '.join(map(str, masses))}: masses that differ by a gram would be right")
    exponent = HERTZ if args.hertz else LINEAR
    given = args.stiffness or (HERTZ_STIFFNESS if args.hertz else POLYETHYLENE.stiffness / MM_PER_M)
    return Campaign(
        configurations=tuple(known[name] for name in dict.fromkeys(args.configuration or known)),
        obstacle_masses=masses,
        repetitions=args.repetitions,
        contact=SpringContact(
            stiffness=given * MM_PER_M**exponent, exponent=exponent, damping=args.damping, friction=args.friction
        ),
        seed=SEED if args.seed is None else args.seed,
    )


def _as_dict(output: Path, campaign: Campaign, steps: Sequence[CampaignStep]) -> dict[str, Any]:
    contact = campaign.contact
    return {
        "output": str(output),
        "simulated": True,
        "seed": campaign.seed,
        "stiffness": contact.stiffness,
        "exponent": contact.exponent,
        "damping": contact.damping,
        "friction": contact.friction,
        "made": sum(not step.kept for step in steps),
        "kept": sum(step.kept for step in steps),
        "runs": [
            {
                "bag": str(step.path),
                "kept": step.kept,
                "configuration": each.setup.configuration.name,
                "obstacle_mass_kg": each.setup.obstacle_mass,
                "repetition": each.repetition,
            }
            for each, step in zip(campaign.runs, steps, strict=True)
        ],
    }


def _lines(output: Path, campaign: Campaign, steps: Sequence[CampaignStep]) -> list[tuple[str, str]]:
    contact = campaign.contact
    kept = sum(step.kept for step in steps)
    cases = f"{len(campaign.configurations)} configurations, {len(campaign.obstacle_masses)} obstacle masses"
    often = "once" if campaign.repetitions == 1 else f"{campaign.repetitions} times"
    unit, law = ("N/mm", "linear spring") if contact.exponent == 1.0 else ("N/mm^1.5", "Hertz contact")
    stiffness = f"{contact.stiffness / MM_PER_M**contact.exponent:g} {unit}"
    lines = [
        ("simulated", f"{len(steps)} impacts on the simulated cell (MuJoCo); nothing was measured"),
        ("cases", f"{cases}, {often} each"),
        ("tip", f"{law} {stiffness}, damping {contact.damping:g} N s/m, friction {contact.friction:g}"),
        ("made", f"{len(steps) - kept}"),
    ]
    if kept:
        lines.append(("kept", f"{kept}, which were there already; --force makes them anew"))
    return [*lines, ("written", str(output))]


def _number(text: str) -> float:
    return _checked(float, text, lambda value: value >= 0.0, "a number from 0 up")


def _mass(text: str) -> float:
    return _checked(float, text, lambda value: 0.0 < value <= 1e3, "a number above 0 and at most 1000")


def _positive(text: str) -> float:
    return _checked(float, text, lambda value: value > 0.0, "a number above 0")


def _count(text: str) -> int:
    return int(_checked(int, text, lambda value: value >= 1, "a whole number from 1 up"))


def _seed(text: str) -> int:
    return int(_checked(int, text, lambda value: value >= 0, "a whole number from 0 up"))


def _checked(kind: type[float], text: str, allows: Callable[[float], bool], right: str) -> float:
    try:
        value = kind(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and allows(value)):
        raise argparse.ArgumentTypeError(f"{text}: {right} would be right")
    return value
