# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass figures`."""

import argparse
from collections.abc import Iterator
from pathlib import Path

from scara_effmass.analysis.workspace_map import AS_SAMPLED
from scara_effmass.cli.console import print_result, shown_progress
from scara_effmass.cli.options import load_dynamics, monitor_settings
from scara_effmass.errors import SettingsError
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share
from scara_effmass.studies.claims import Outcome
from scara_effmass.studies.figures import PAGE, STEPS, FigureSet, make_figure_set
from scara_effmass.studies.other_robot import SAMPLES, make_figures
from scara_effmass.studies.runs import read_inputs


def run(args: argparse.Namespace) -> int:
    """Write figures and claims, and print a summary."""
    if args.robot:
        return _other_robot(args)
    with shown_progress("figures", STEPS) as advance:
        inputs = read_inputs(load_dynamics(MonitorSettings()), args.campaign or share("bags", "campaign"))
        figure_set = make_figure_set(inputs, args.output, overwrite=args.force, advance=advance)
    result = {"output": str(args.output), **figure_set.as_dict()}
    print_result(result, _lines(figure_set, args.output), as_json=args.json)
    return 0


def _other_robot(args: argparse.Namespace) -> int:
    """Draw the paper's figures of masses for the robot of --robot."""
    if args.campaign:
        raise SettingsError(f"--campaign = {args.campaign}: must belong to the paper's robot, so without --robot")
    settings = monitor_settings(args, **AS_SAMPLED)
    monitor = Monitor(load_dynamics(settings), settings)
    with shown_progress("configurations", SAMPLES) as advance:
        summary = make_figures(monitor, args.output, overwrite=args.force, advance=advance)
    lines = [("figures", ", ".join(summary["figures"])), ("model", summary["model"])]
    lines += [("left out", f"{part}: {reason}") for part, reason in summary["left_out"].items()]
    print_result(summary, [*lines, ("written", args.output / PAGE)], as_json=args.json)
    return 0


def _lines(figure_set: FigureSet, output: Path) -> Iterator[tuple[str, str]]:
    yield "figures", str(len(figure_set.figures))
    yield "claims", ", ".join(f"{count} {outcome}" for outcome, count in figure_set.counts.items())
    for claim in figure_set.claims:
        if claim.outcome is Outcome.NO_MATCH:
            yield "no match", f"{claim.where}: {claim.paper}; here {claim.ours} ({claim.rule})"
    agreement = figure_set.agreement
    differences = f"{agreement.full_relative_difference:.1e} and {agreement.lumped_relative_difference:.1e}"
    yield "check", f"Eqs. 27 and 28 against {agreement.poses} mass matrices: max. relative differences {differences}"
    yield "written", str(output / PAGE)
