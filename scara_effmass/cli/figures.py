"""`scara-effmass figures`."""

import argparse
from collections.abc import Iterator
from pathlib import Path

from scara_effmass.cli.console import print_result, progress_bar
from scara_effmass.cli.settings import load_dynamics
from scara_effmass.paper.campaign_runs import campaign_runs
from scara_effmass.paper.claim import Outcome
from scara_effmass.paper.figure_set import STEPS, FigureSet, make_figure_set
from scara_effmass.paper.figure_specs import FigureInputs
from scara_effmass.paper.motion import tool_motion
from scara_effmass.paper.protocol import POINT_OF_FIG_17, SHOWN_OBSTACLE_KG
from scara_effmass.paper.scara import scara_of
from scara_effmass.settings import DetectionSettings, MonitorSettings
from scara_effmass.share import share

PATH_ONLY = "straight_300_200"
"""Shipped recording of the path through the paper's impact point, without an impact."""


def run(args: argparse.Namespace) -> int:
    """Write figures and claims, and print a summary."""
    with progress_bar() as progress:
        task = progress.add_task("figures", total=STEPS)
        inputs = _inputs(args.campaign or share("bags", "campaign"))
        figure_set = make_figure_set(inputs, args.output, overwrite=args.force, advance=lambda: progress.advance(task))
    result = {"output": str(args.output), **figure_set.as_dict()}
    print_result(result, _lines(figure_set, args.output), as_json=args.json)
    return 0


def _inputs(campaign: Path) -> FigureInputs:
    """Return the shipped robot, the impacts in the folder `campaign`, and the tool motion of one of them."""
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
