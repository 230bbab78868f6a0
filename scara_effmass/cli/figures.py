"""`scara-effmass figures`."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from scara_effmass.cli.console import print_json, print_lines, progress_bar
from scara_effmass.cli.options import add_force, add_json, load_dynamics
from scara_effmass.settings import DetectionSettings, MonitorSettings
from scara_effmass.share import share

if TYPE_CHECKING:
    from scara_effmass.paper.figure_set import FigureSet
    from scara_effmass.paper.figure_specs import FigureInputs

EXAMPLES = """\
DIR receives every figure as PNG and SVG, and the paper's claims beside this project's results in index.html and
claims.json. The robot is the shipped Omron i4-550L. Forces are those of the shipped campaign, which is simulated,
or of --campaign. A claim that does not match is not an error.

examples:
  scara-effmass figures -o out/figures
  scara-effmass figures -o out/figures --campaign out/campaign --force --json
"""
PATH_ONLY = "straight_300_200"
"""Shipped recording of the path through the paper's impact point, without an impact."""


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = EXAMPLES
    parser.add_argument("-o", "--output", required=True, type=Path, metavar="DIR", help="folder for figures and page")
    parser.add_argument(
        "--campaign", type=Path, metavar="DIR", help="recorded impacts, one bag per run (default: the shipped ones)"
    )
    add_force(parser)
    add_json(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write figures and claims, and print a summary."""
    from scara_effmass.paper.figure_set import STEPS, make_figure_set  # noqa: PLC0415 - not needed for --help

    with progress_bar() as progress:
        task = progress.add_task("figures", total=STEPS)
        inputs = _inputs(args.campaign or share("bags", "campaign"))
        figure_set = make_figure_set(inputs, args.output, overwrite=args.force, advance=lambda: progress.advance(task))
    if args.json:
        print_json({"output": str(args.output), **figure_set.as_dict()})
    else:
        print_lines(_lines(figure_set, args.output))
    return 0


def _inputs(campaign: Path) -> FigureInputs:
    """Return the shipped robot, the impacts in the folder `campaign`, and the tool motion of one of them."""
    from scara_effmass.paper.campaign_runs import campaign_runs  # noqa: PLC0415
    from scara_effmass.paper.figure_specs import FigureInputs  # noqa: PLC0415
    from scara_effmass.paper.motion import tool_motion  # noqa: PLC0415
    from scara_effmass.paper.protocol import POINT_OF_FIG_17, SHOWN_OBSTACLE_KG  # noqa: PLC0415
    from scara_effmass.paper.scara import scara_of  # noqa: PLC0415

    dynamics = load_dynamics(MonitorSettings())
    scara = scara_of(dynamics)
    joints = dynamics.robot.joint_names[0], dynamics.robot.joint_names[1]
    runs = campaign_runs(campaign, scara, joints, DetectionSettings())
    at_point = [run for run in runs if run.impact.point == POINT_OF_FIG_17]
    if at_point:
        motion = min(at_point, key=lambda run: run.impact.obstacle_mass_kg != SHOWN_OBSTACLE_KG).motion
    else:
        path, source = share("bags", PATH_ONLY), f"generated recording {PATH_ONLY}"
        motion = tool_motion(path, scara, joints, source, contact_x=POINT_OF_FIG_17[0])
    return FigureInputs(dynamics, scara, motion, tuple(run.impact for run in runs))


def _lines(figure_set: FigureSet, output: Path) -> Iterator[tuple[str, str]]:
    from scara_effmass.paper.claim import Outcome  # noqa: PLC0415

    yield "figures", str(len(figure_set.figures))
    for line in figure_set.left_out:
        yield "left out", line
    yield "claims", ", ".join(f"{count} {outcome}" for outcome, count in figure_set.counts.items())
    for claim in figure_set.claims:
        if claim.outcome is Outcome.NO_MATCH:
            yield "no match", f"{claim.where}: {claim.paper}; here {claim.ours} ({claim.rule})"
    agreement = figure_set.agreement
    differences = f"{agreement.full:.1e} and {agreement.lumped:.1e}"
    yield "check", f"Eqs. 27 and 28 against {agreement.poses} mass matrices: max. relative differences {differences}"
    yield "written", str(output / "index.html")
