# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass evidence`."""

import argparse
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from scara_effmass.analysis.output import check_output_files, check_output_path
from scara_effmass.analysis.report import figure_files
from scara_effmass.cli.console import print_result
from scara_effmass.cli.tasks import Advance, Run, open_run, raised
from scara_effmass.studies.evidence import (
    DRIVES,
    FIGURE,
    PAGE,
    SUMMARY,
    TABLE,
    WORST,
    Evidence,
    Row,
    Simulate,
    extend_table,
    write_evidence,
)


def run(args: argparse.Namespace) -> int:
    """Simulate the impacts that the table lacks, write the report, and print a summary."""
    table = args.output / TABLE
    check_output_path(table, overwrite=True, mark=b"index," * args.force)  # what exists is continued
    reports = [PAGE, SUMMARY, *figure_files([FIGURE])]
    check_output_files(args.output, reports, overwrite=args.force or table.exists())
    if args.force:
        table.unlink(missing_ok=True)
    with open_run(args, "simulated impacts") as run_tasks:
        extend_table(table, args.seed, args.impacts, partial(_rows, run_tasks))
    evidence = write_evidence(args.output, args.seed)
    result = {"output": str(args.output), "seed": args.seed, **evidence.as_dict()}
    print_result(result, _lines(evidence, args.output), as_json=args.json)
    return 0


def _rows(run_tasks: Run, simulate: Simulate, indices: Sequence[int]) -> Iterator[list[Row]]:
    return map(raised, run_tasks(partial(_impact, simulate), indices))


def _impact(simulate: Simulate, index: int, advance: Advance) -> list[Row]:
    rows = simulate(index)
    advance(1.0)
    return rows


def _lines(evidence: Evidence, output: Path) -> Iterator[tuple[str, str]]:
    robots = ", ".join(evidence.robots)
    yield "simulated", f"{evidence.impacts} random impacts of {robots} (MuJoCo); nothing was measured"
    yield "result", evidence.sentence
    yield "", "at the worst place of the link and the worst plate normal:"
    for group in evidence.groups(place=(WORST,), plate=(WORST,)):
        text = f"{group.share:.2%} above the limit, worst {group.worst:.3f}, median {group.median:.3f}"
        yield group.setting, f"{DRIVES[group.drives]}: {text}"
    for subject, text, met in evidence.goals():
        yield "goal met" if met else "goal not met", f"{subject}: {text}"
    yield "written", str(output / PAGE)
