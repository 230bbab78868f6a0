# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass lump`."""

import argparse
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from scara_effmass.analysis.lumped_model import ModelComparison, compare_models
from scara_effmass.analysis.output import check_output_files
from scara_effmass.cli.console import print_json, print_table, printer
from scara_effmass.cli.options import load_dynamics, monitor_settings, override
from scara_effmass.model.lumping import LumpedLink, lumped_links
from scara_effmass.model.robot import Robot

NAME, RESULT = "lumped_masses", "lump.json"


def run(args: argparse.Namespace) -> int:
    """Print the lumped model and its comparison with the full one; return 1 without a lumped model."""
    settings = monitor_settings(args)
    chosen = {name: value for name in ("policy", "free_parameters") if (value := getattr(args, name))}
    settings = override(settings, {"lumping": {**settings.lumping.model_dump(), **chosen}})
    if args.output:
        from scara_effmass.analysis import report  # noqa: PLC0415 - matplotlib too
        from scara_effmass.analysis.robot_figures import draw_masses  # noqa: PLC0415 - matplotlib, an extra

        names = [RESULT, *report.figure_files([NAME])]
        check_output_files(args.output, names, overwrite=args.force)
    dynamics = load_dynamics(settings)
    robot, lumped = dynamics.robot, dynamics.lumped
    links = lumped.links if lumped else () if robot.coms_reason else lumped_links(robot)
    comparisons, missing = compare_models(dynamics, settings.model_margin, args.poses, args.seed)
    result: dict[str, Any] = {
        "robot": robot.origin,
        "lumping": settings.lumping.model_dump(mode="json"),
        "links": [asdict(link) for link in links],
        "no_lumped_model": dynamics.lumped_reason,
        "no_full_model": dynamics.full_reason,
        "masses": [mass._asdict() for mass in lumped.masses] if lumped else [],
        "masses_by_axis_kg": list(lumped.aggregated) if lumped else [],
        "poses": args.poses,
        "seed": args.seed,
        "without_lumped_mass": dict(zip(dynamics.contact_points, missing, strict=True)),
        "lumped_over_full_minus_1": [comparison._asdict() for comparison in comparisons],
    }
    if args.output:
        figures = []
        if lumped:
            figures.append(report.report_figure(NAME, "Lumped masses", robot.name, draw_masses(robot, lumped)))
        report.write_report_files(args.output, {RESULT: result}, figures, overwrite=args.force, former=names)
    if args.json:
        print_json(result)
        return 0 if lumped else 1
    _print_links(links)
    if lumped:
        _print_masses(robot, result, comparisons)
    else:
        printer().print(f"no lumped model: {dynamics.lumped_reason}")
    if args.output:
        names = names if lumped else [RESULT]
        printer().print(f"written: {', '.join(str(args.output / name) for name in names)}")
    return 0 if lumped else 1


def _print_links(links: Sequence[LumpedLink]) -> None:
    rows = []
    for link in links:
        found = "two masses" if link.on_axes else "two masses, an axis shifted through the centre of mass"
        found = f"{link.problem}: {link.answer or 'refused'}" if link.problem else found
        lengths = 1e3 * link.height1 + 0.0, 1e3 * link.height2 + 0.0  # prints -0 as 0
        rows.append((link.joint, link.axes, link.mass, link.kappa1, link.kappa2, *lengths, found))
    if rows:
        headings = ("link behind", "axes", "m [kg]", "kappa1", "kappa2", "L1 [mm]", "L2 [mm]", "feasibility")
        print_table("Lumped parameters of the links (Table II of the paper)", headings, rows)


def _print_masses(robot: Robot, result: dict[str, Any], comparisons: Sequence[ModelComparison]) -> None:
    by_axis = ", ".join(f"{mass:.4g}" for mass in result["masses_by_axis_kg"])
    count, joints = len(result["masses"]), len(result["links"])
    printer().print(f"masses by axis, base to tip: {by_axis} kg{'; the first does not move' * robot.revolute[0]}")
    printer().print(f"{count} masses remain for {joints} joints after adding up those at one place")
    if result["no_full_model"]:
        printer().print(f"no comparison: there is no full model: {result['no_full_model']}")
        return
    for point, share in result["without_lumped_mass"].items():
        if share:
            printer().print(f"{point}: at {share:.1%} of the poses no lumped mass along every direction")
    if comparisons:
        title = f"Lumped over full mass - 1 [%], {result['poses']} random poses and directions, seed {result['seed']}"
        shares = ("lighter [% of cases]", "lighter by more than the margin")
        rows = [(*comparison[:2], *(100.0 * value for value in comparison[2:])) for comparison in comparisons]
        print_table(title, ("contact point", "quantity", "P5", "P50", "P95", "worst", *shares), rows)
