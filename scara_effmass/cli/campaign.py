# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass campaign`."""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from scara_effmass.cli.console import print_result, progress_bar
from scara_effmass.errors import SettingsError
from scara_effmass.sim.collision_sim import HERTZ, LINEAR, POLYETHYLENE, SpringContact
from scara_effmass.sim.experiment import CONFIGURATIONS, OBSTACLE_MASSES, build_sim
from scara_effmass.sim.recordings import SEED
from scara_effmass.studies.campaign import Campaign, CampaignStep, run_campaign

MM_PER_M = 1e3
HERTZ_STIFFNESS = 3400.0 * MM_PER_M**HERTZ
"""Default of --hertz [N/m^1.5]: about the peak forces of the default linear spring."""


def run(args: argparse.Namespace) -> int:
    """Simulate and record all missing runs, and print a summary."""
    campaign = _campaign(args)
    for campaign_run in campaign.runs:
        build_sim(campaign_run.setup)  # refuses impossible contacts before anything is written
    steps: list[CampaignStep] = []
    with progress_bar() as progress:
        task = progress.add_task("simulated impacts", total=len(campaign.runs))
        for step in run_campaign(args.output, campaign, overwrite=args.force):
            steps.append(step)
            progress.update(task, completed=len(steps), description=f"simulated {step.path.name}")
    result = _as_dict(args.output, campaign, steps)
    print_result(result, _lines(args.output, campaign, result["made"], result["kept"]), as_json=args.json)
    return 0


def _campaign(args: argparse.Namespace) -> Campaign:
    by_name = {configuration.name: configuration for configuration in CONFIGURATIONS}
    names = tuple(dict.fromkeys(args.configuration or by_name))
    for name in names:
        if name not in by_name:
            raise SettingsError(f"--configuration {name}: must be one of {', '.join(by_name)}")
    masses = tuple(dict.fromkeys(args.mass or OBSTACLE_MASSES))
    if len({round(MM_PER_M * mass) for mass in masses}) < len(masses):
        raise SettingsError(f"--mass {' and '.join(map(str, masses))}: must differ by a gram")
    exponent = HERTZ if args.hertz else LINEAR
    stiffness = HERTZ_STIFFNESS if args.hertz else POLYETHYLENE.stiffness
    if args.tip_stiffness is not None:
        stiffness = args.tip_stiffness
    return Campaign(
        configurations=tuple(by_name[name] for name in names),
        obstacle_masses=masses,
        repetitions=args.repetitions,
        contact=SpringContact(stiffness, exponent, args.damping, args.friction),
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


def _lines(output: Path, campaign: Campaign, made: int, kept: int) -> Iterator[tuple[str, str]]:
    contact = campaign.contact
    cases = f"{len(campaign.configurations)} configurations, {len(campaign.obstacle_masses)} obstacle masses"
    times = "once" if campaign.repetitions == 1 else f"{campaign.repetitions} times"
    unit, law = ("N/m", "linear spring") if contact.exponent == LINEAR else ("N/m^1.5", "Hertz contact")
    yield "simulated", f"{made + kept} impacts in the simulated cell (MuJoCo); nothing was measured"
    yield "cases", f"{cases}, {times} each"
    tip = f"{law} {contact.stiffness:.4g} {unit}"
    yield "tip", f"{tip}, damping {contact.damping:g} N s/m, friction {contact.friction:g}"
    yield "recorded", str(made)
    if kept:
        yield "kept", f"{kept} existing recordings; --force replaces them"
    yield "written", str(output)
