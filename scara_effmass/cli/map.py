# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass map`."""

import argparse
import json
from collections.abc import Iterator
from io import BytesIO
from typing import Any

from scara_effmass.analysis.output import check_output_files
from scara_effmass.analysis.report import figure_files, report_figure, write_report_files
from scara_effmass.analysis.tables import open_table, provenance
from scara_effmass.analysis.workspace_map import (
    AS_SAMPLED,
    MASSES,
    Cells,
    Plane,
    draw_map,
    map_table,
    sample_workspace,
    summarize,
)
from scara_effmass.cli.console import print_result, progress_bar
from scara_effmass.cli.settings import load_dynamics, monitor_settings
from scara_effmass.errors import SettingsError
from scara_effmass.safety import Monitor

NAME, SUMMARY = "map", "map.json"
ALONG_X = (1.0, 0.0, 0.0)


def run(args: argparse.Namespace) -> int:
    """Sample the workspace, write figure, table and summary, and print the summary."""
    settings = monitor_settings(args, **AS_SAMPLED)
    if settings.payload_topic:
        raise SettingsError(
            f"payload_topic = {settings.payload_topic!r}: must be empty for a map: give --payload-topic ''"
        )
    if args.test_direction and settings.fixed_test_direction is None:
        raise SettingsError("--direction = 0 0 0: must not be 0")
    table_name = f"{NAME}.{args.table}"
    check_output_files(args.output, [*figure_files([NAME]), table_name, SUMMARY], overwrite=args.force)
    dynamics = load_dynamics(settings)
    monitor = Monitor(dynamics, settings)
    direction, frame = settings.fixed_test_direction, settings.test_direction_frame
    with progress_bar() as progress:
        task = progress.add_task("configurations", total=args.samples)
        plane, advance = Plane(*args.plane), lambda: progress.advance(task)
        sample = sample_workspace(monitor, direction or ALONG_X, frame, plane, args.samples, advance)
    robot, point, cells = dynamics.robot, dynamics.contact_points[0], Cells(sample)
    table, origin = map_table(cells, robot.joint_names), provenance(settings, robot.origin, [])
    axes = " ".join(f"{component:.3g}" for component in sample.direction)
    where = f"n = [{axes}]{' of ' * bool(frame)}{frame}, {plane}"
    title = f"{robot.name}, contact point {point}, {settings.effective_mass_model.value} mass, {where}"
    caption = f"Each cell shows the worst of the sampled configurations that reach it. {title}"
    figure = report_figure(NAME, title, caption, draw_map(cells, table, title, robot.iso_mass))
    summary = {"robot": robot.origin, "contact_point": point, "frame": frame, **summarize(cells, table, robot.iso_mass)}
    file = BytesIO()
    with open_table(file, f".{args.table}", table.schema, origin) as writer:
        writer.write_table(table)
    text = json.dumps({**summary, "provenance": origin}, indent=2, allow_nan=False)
    texts: dict[str, str | bytes] = {table_name: file.getvalue(), SUMMARY: f"{text}\n"}
    write_report_files(args.output, texts, [figure], overwrite=args.force)
    result = {"output": str(args.output), **summary}
    lines = [("robot", f"{robot.origin}, contact point {point}"), ("map", where), *_lines(summary)]
    print_result(result, [*lines, ("written", args.output / f"{NAME}.png")], as_json=args.json)
    return 0


def _lines(summary: dict[str, Any]) -> Iterator[tuple[str, str]]:
    yield "sample", f"{summary['configurations']} configurations; {summary['left_out']} left out: cannot move along n"
    if summary["unknown"]:
        yield "UNKNOWN", f"{summary['unknown']} configurations; their cells allow 0 m/s"
    for model, count in summary["mass_models"]:
        yield "mass model", f"{model} ({count / summary['configurations']:.1%})"
    yield "cells", f"{summary['cells']} of {1e3 * summary['cell_m']:g} mm, each with its worst configuration"
    for name, unit in (dict.fromkeys(MASSES, "kg") | {"allowable_speed": "m_s"}).items():
        values = ", ".join(f"{key} {value:.3g}" for key, value in summary[f"{name}_{unit}"].items())
        yield name.removesuffix("_reduced_mass").replace("_", " "), f"{values} {unit.replace('_', '/')}"
    rise = "{p50:.1%} (median), {p95:.1%} (P95)".format(**summary["rise_by_second_half"])
    yield "completeness", f"its second half raised the bound of a cell by {rise}"
