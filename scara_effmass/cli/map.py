# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass map`."""

import argparse
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

from scara_effmass.analysis.output import check_output_files
from scara_effmass.analysis.report import ReportFigure, figure_files, report_figure, write_report_files
from scara_effmass.analysis.summary import shares
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
from scara_effmass.cli.console import print_result
from scara_effmass.cli.options import load_dynamics, monitor_settings, require_no_payload_topic
from scara_effmass.cli.tasks import Advance, open_run, sound
from scara_effmass.errors import EffmassError, SettingsError
from scara_effmass.safety import Monitor
from scara_effmass.safety.assumptions import assumptions_of
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import at_most

NAME, SUMMARY = "map", "map.json"
TABLES = "map.csv", "map.parquet"
SMALL_SAMPLES = 200_000
"""Number of configurations of all maps below which the start of local processes takes longer than they save."""
ALONG_X = (1.0, 0.0, 0.0)


class _MapTask(NamedTuple):
    """A map to make: `settings` of one robot, and where its files go."""

    settings: MonitorSettings
    plane: Plane
    samples: int
    table: str
    folder: Path

    def __str__(self) -> str:
        return str(self.settings.robot)


class _MapResult(NamedTuple):
    """Files, figure and summary of one map."""

    files: dict[str, bytes | dict[str, Any]]
    figure: ReportFigure
    summary: dict[str, Any]
    where: str


def run(args: argparse.Namespace) -> int:
    """Sample the workspace of each robot, write figure, table and summary, and print the summaries."""
    tasks = list(_tasks(args))
    maps: list[tuple[_MapTask, _MapResult]] = []
    errors: list[str] = []
    with open_run(args, "maps", is_small=len(tasks) * args.samples < SMALL_SAMPLES) as run_tasks:
        for task, made in sound(tasks, run_tasks(_make_map, tasks), errors, EffmassError):
            write_report_files(task.folder, made.files, [made.figure], overwrite=args.force, former=TABLES)
            maps.append((task, made))
    lines = [line for task, made in maps for line in _lines(task, made)]
    results = [{"output": str(task.folder), **made.summary} for task, made in maps]
    result = results[0] if len(tasks) == 1 else {"output": str(args.output), "maps": results, "not_mapped": errors}
    print_result(result, [*lines, *(("not mapped", error) for error in errors)], as_json=args.json)
    return 1 if errors else 0


def _tasks(args: argparse.Namespace) -> Iterator[_MapTask]:
    """Yield a task for each robot. Raises SettingsError, and OutputError for files that must not be replaced."""
    robots = args.robot or [None]
    folders = [args.output / Path(robot or "").stem if len(robots) > 1 else args.output for robot in robots]
    for robot, folder in zip(robots, folders, strict=True):
        if folders.count(folder) > 1:
            raise SettingsError(f"{robot}: must have a file name of its own: it names the folder of its map")
        settings = monitor_settings(args, robot=robot, **AS_SAMPLED)
        require_no_payload_topic(settings, "a map")
        if args.test_direction and settings.fixed_test_direction is None:
            raise SettingsError("--direction = 0 0 0: must not be 0")
        check_output_files(folder, [*figure_files([NAME]), *TABLES, SUMMARY], overwrite=args.force)
        yield _MapTask(settings, Plane(*args.plane), args.samples, args.table, folder)


def _make_map(task: _MapTask, advance: Advance) -> _MapResult:
    """Return the map of one robot. Raises EffmassError."""
    settings, share = task.settings, 1.0 / task.samples
    dynamics = load_dynamics(settings)
    direction, frame = settings.fixed_test_direction, settings.test_direction_frame
    sampled = Monitor(dynamics, settings), direction or ALONG_X, frame, task.plane, task.samples
    sample = sample_workspace(*sampled, lambda count: advance(count * share))
    robot, point, cells = dynamics.robot, dynamics.contact_points[0], Cells(sample)
    table, origin = map_table(cells, robot.joint_names), provenance(settings, robot.origin, [])
    axes = " ".join(f"{component:.3g}" for component in sample.direction)
    where = f"n = [{axes}]{' of ' * bool(frame)}{frame}, {task.plane}"
    title = f"{robot.name}, contact point {point}, {settings.effective_mass_model.value} mass, {where}"
    caption = f"Each cell shows the worst of the sampled configurations that reach it. {title}"
    figure = report_figure(NAME, title, caption, draw_map(cells, table, title, robot.iso_mass))
    summary = {"robot": robot.origin, "contact_point": point, "frame": frame, **summarize(cells, table, robot.iso_mass)}
    summary["assumptions"] = assumptions_of(robot, settings).as_dict()
    file = BytesIO()
    with open_table(file, f".{task.table}", table.schema, origin) as writer:
        writer.write_table(table)
    files: dict[str, bytes | dict[str, Any]] = {
        f"{NAME}.{task.table}": file.getvalue(),
        SUMMARY: {**summary, "provenance": origin},
    }
    return _MapResult(files, figure, summary, where)


def _lines(task: _MapTask, made: _MapResult) -> Iterator[tuple[str, object]]:
    summary = made.summary
    yield "robot", f"{summary['robot']}, contact point {summary['contact_point']}"
    yield "map", made.where
    yield "sample", f"{summary['configurations']} configurations; {summary['left_out']} left out: cannot move along n"
    if summary["unknown"]:
        yield "UNKNOWN", f"{summary['unknown']} configurations; their cells allow 0 m/s"
    for model, count in summary["mass_models"]:
        yield "mass model", f"{model} ({count / summary['configurations']:.1%})"
    yield "cells", f"{summary['cells']} of {1e3 * summary['cell_m']:g} mm, each with its worst configuration"
    deciding = summary["deciding_contacts"]
    subjects = {f"{name}_kg": name.removesuffix("_reduced_mass").replace("_", " ") for name in MASSES}
    subjects["allowable_speed_m_s"] = "allowable speed"
    if len(deciding) > 1:
        subjects["allowable_speed_all_contacts_m_s"] = "of all contacts"
    for name, subject in subjects.items():
        is_speed = name.endswith("_m_s")
        numbers = summary[name].items()
        values = ", ".join(f"{key} {at_most(value, 3) if is_speed else f'{value:.3g}'}" for key, value in numbers)
        yield subject, f"{values} {'m/s' if is_speed else 'kg'}"
    if len(deciding) > 1:
        yield "decided by", f"{shares(deciding)} of the cells"
    text = "its halves reached no cell in common: give more --samples"
    if rise := summary["rise_by_second_half"]:
        text = "its second half raised the bound by {p50:.1%} (median), {p95:.1%} (P95) in the".format(**rise)
        text += f" {summary['shared_cells']} cells that both halves reached"
    yield "completeness", text
    for kind, texts in summary["assumptions"].items():
        yield from ((kind, text) for text in texts.values())
    yield "written", task.folder / f"{NAME}.png"
