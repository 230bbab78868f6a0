"""`scara-effmass figures`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from scara_effmass.cli.console import print_json, print_lines, progress_bar
from scara_effmass.cli.options import add_force, add_json, load_dynamics
from scara_effmass.settings import DetectionSettings, MonitorSettings
from scara_effmass.share import share

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from scara_effmass.paper.figure_set import FigureSet
    from scara_effmass.paper.figure_specs import Material

EXAMPLES = """\
DIR gets every figure as PNG and SVG, index.html with the paper's claims beside what comes out here, and the
same claims as claims.json. The robot is the shipped Omron i4-550L. A claim that does not match is no error.
Forces are those of the shipped campaign, which is simulated, unless --campaign names another one.

examples:
  scara-effmass figures -o out/figures
  scara-effmass figures -o out/figures --campaign out/campaign --force --json
"""


PATH_ONLY = "straight_300_200"
"""The shipped recording of the path through the paper's point; nothing is hit in it."""


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
    """Draw, compare, write, and print what matches."""
    from scara_effmass.paper.figure_set import STEPS, make_figure_set  # noqa: PLC0415 - not needed for --help

    with progress_bar() as progress:
        task = progress.add_task("figures", total=STEPS)
        material = _material(args.campaign or share("bags", "campaign"))
        album = make_figure_set(material, args.output, overwrite=args.force, advance=lambda: progress.advance(task))
    if args.json:
        print_json({"output": str(args.output), **album.as_dict()})
    else:
        print_lines(_lines(album, args.output))
    return 0


def _material(campaign: Path) -> Material:
    """Return the shipped robot and the impacts in the folder `campaign`; one of them shows the tool's motion."""
    from scara_effmass.paper.campaign_runs import campaign_runs  # noqa: PLC0415
    from scara_effmass.paper.figure_specs import Material  # noqa: PLC0415
    from scara_effmass.paper.motion import tool_motion  # noqa: PLC0415
    from scara_effmass.paper.protocol import POINT_OF_FIG_17, SHOWN_OBSTACLE_KG  # noqa: PLC0415
    from scara_effmass.paper.scara import closed_form_of  # noqa: PLC0415

    arm = load_dynamics(MonitorSettings())
    scara = closed_form_of(arm)
    joints = arm.robot.joint_names[0], arm.robot.joint_names[1]
    runs = campaign_runs(campaign, scara, joints, DetectionSettings())
    fitting = [run for run in runs if run.impact.point == POINT_OF_FIG_17]
    if fitting:
        motion = min(fitting, key=lambda run: run.impact.obstacle_mass_kg != SHOWN_OBSTACLE_KG).motion
    else:
        path = share("bags", PATH_ONLY)
        motion = tool_motion(path, scara, joints, f"generated recording {PATH_ONLY}", contact_x=POINT_OF_FIG_17[0])
    return Material(arm, scara, motion, tuple(run.impact for run in runs))


def _lines(album: FigureSet, output: Path) -> Iterator[tuple[str, str]]:
    from scara_effmass.paper.claim import Outcome  # noqa: PLC0415

    yield "figures", str(len(album.figures))
    for line in album.left_out:
        yield "left out", line
    counted = ", ".join(f"{count} {outcome}" for outcome, count in album.counts.items())
    yield "claims", counted
    for claim in album.claims:
        if claim.outcome is Outcome.NO_MATCH:
            yield "no match", f"{claim.where}: {claim.paper}; here {claim.ours} ({claim.rule})"
    check = album.agreement
    differences = f"{check.full:.1e} and {check.lumped:.1e}"
    yield "check", f"Eqs. 27 and 28 against {check.poses} mass matrices: max. relative differences {differences}"
    yield "written", str(output / "index.html")
