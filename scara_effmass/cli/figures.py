"""`scara-effmass figures`."""

import argparse
from collections.abc import Iterator
from pathlib import Path

from scara_effmass.cli.console import print_result, progress_bar
from scara_effmass.cli.settings import load_dynamics
from scara_effmass.paper.claims import Outcome
from scara_effmass.paper.figure_set import STEPS, FigureSet, make_figure_set
from scara_effmass.paper.runs import read_inputs
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share


def run(args: argparse.Namespace) -> int:
    """Write figures and claims, and print a summary."""
    with progress_bar() as progress:
        task = progress.add_task("figures", total=STEPS)
        inputs = read_inputs(load_dynamics(MonitorSettings()), args.campaign or share("bags", "campaign"))
        figure_set = make_figure_set(inputs, args.output, overwrite=args.force, advance=lambda: progress.advance(task))
    result = {"output": str(args.output), **figure_set.as_dict()}
    print_result(result, _lines(figure_set, args.output), as_json=args.json)
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
    yield "written", str(output / "index.html")
