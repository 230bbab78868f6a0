# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass evidence`."""

import argparse
import os
from collections.abc import Iterator
from pathlib import Path

from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn

from scara_effmass.analysis.evidence import (
    DRIVES,
    FIGURE,
    PAGE,
    SUMMARY,
    TABLE,
    Evidence,
    write_evidence,
)
from scara_effmass.analysis.output import check_output_files
from scara_effmass.analysis.report import figure_files
from scara_effmass.cli.console import print_result, progress_bar
from scara_effmass.sim.impact_table import extend_table


def run(args: argparse.Namespace) -> int:
    """Simulate the impacts that the table lacks, write the report, and print a summary."""
    table = args.output / TABLE
    if args.force:
        table.unlink(missing_ok=True)
    elif not table.exists():
        check_output_files(args.output, [PAGE, SUMMARY, *figure_files([FIGURE])], overwrite=False)
    jobs = args.jobs or len(os.sched_getaffinity(0))
    columns = TextColumn("simulated impacts"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with progress_bar(*columns) as progress:
        task = progress.add_task("", total=args.impacts)
        for count in extend_table(table, args.seed, args.impacts, jobs):
            progress.update(task, completed=count)
    evidence = write_evidence(args.output, args.seed, overwrite=True)
    result = {"output": str(args.output), "seed": args.seed, **evidence.as_dict()}
    print_result(result, _lines(evidence, args.output), as_json=args.json)
    return 0


def _lines(evidence: Evidence, output: Path) -> Iterator[tuple[str, str]]:
    robots = ", ".join(evidence.robots)
    yield "simulated", f"{evidence.impacts} random impacts of {robots} (MuJoCo); nothing was measured"
    yield "", "at the worst plate normal:"
    for group in evidence.groups(("worst",)):
        text = f"{group.share:.2%} above the limit, worst {group.worst:.3f}, median {group.median:.3f}"
        yield group.setting, f"{DRIVES[group.drives]}: {text}"
    for subject, text, met in evidence.goals():
        yield "goal met" if met else "goal missed", f"{subject}: {text}"
    yield "written", str(output / PAGE)
