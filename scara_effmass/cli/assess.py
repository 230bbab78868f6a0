# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass assess`."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

from scara_effmass.analysis.assessment import Time, input_lines
from scara_effmass.analysis.dataset import (
    BagResult,
    BagTask,
    assess_bag,
    assess_part,
    remove_unfinished,
    without_copies,
)
from scara_effmass.analysis.output import check_output_path
from scara_effmass.analysis.summary import MAX_UNKNOWN_SHARE, Summary
from scara_effmass.analysis.tables import MARKS, open_writer, provenance
from scara_effmass.bags.files import bag_bytes, find_bags
from scara_effmass.cli.console import print_result
from scara_effmass.cli.options import load_dynamics, monitor_settings, robot_line
from scara_effmass.cli.tasks import SMALL_BYTES, Advance, Run, open_run, sound
from scara_effmass.codes import Reason
from scara_effmass.errors import CrossCheckError, EffmassError, SettingsError
from scara_effmass.model.robot import Robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.safety.assumptions import assumptions_of, scope
from scara_effmass.settings import MonitorSettings
from scara_effmass.url import Url

if TYPE_CHECKING:
    from scara_effmass.analysis.run_report import RunReport


def run(args: argparse.Namespace) -> int:
    """Assess the recordings, write table and report, and print the summary."""
    try:
        assessment = assess(args)
    except CrossCheckError as error:
        print(error, file=sys.stderr)  # noqa: T201 - a negative result, not invalid input
        return 1
    print_result(assessment.result, assessment.lines, as_json=args.json)
    return assessment.code


class Assessment(NamedTuple):
    """Result of a command: for JSON, as lines of subject and text, and the exit code."""

    result: dict[str, Any]
    lines: list[tuple[str, object]]
    code: int


def assess(
    args: argparse.Namespace,
    name: str = "",
    supplement: Callable[[Mapping[str, int]], tuple[Sequence[tuple[str, str]], dict[str, Any]]] = lambda _: ((), {}),
) -> Assessment:
    """Assess the recordings and write table and report.

    The report calls the recording `name`, which defaults to that of its file. `supplement` gets the counts of joint
    states and returns further lines and results. Raises CrossCheckError if --cross-check finds a difference.
    """
    properties = import_module("scara_effmass.analysis.properties") if args.properties else None
    settings = monitor_settings(args)
    robot = (dynamics := load_dynamics(settings)).robot
    Monitor(dynamics, settings)  # raises for missing limits before any file is written
    paths, copies = _recordings(args)
    task = BagTask(settings, Time(args.time), args.topic, args.velocity_bag, bool(args.report), args.cross_check)
    summary = Summary(round(settings.timeout * 1e9))
    counts = dict.fromkeys(("joint_states", "foreign", "refused"), 0)
    losses, unreadable, unmodelled = list[str](), list[str](), list[str]()
    input_notes = [*copies, *input_lines(settings, task.time, args.velocity_bag)]
    report = _open_report(args, settings, len(paths) * len(dynamics.contact_points)) if args.report else None
    with ExitStack() as stack:
        origin = provenance(settings, robot.origin, paths) | {"input": json.dumps(input_notes)}
        stack.callback(remove_unfinished, args.output, paths)
        is_small = sum(map(bag_bytes, paths)) < SMALL_BYTES
        run_tasks = stack.enter_context(open_run(args, "recordings", is_small=is_small))
        if not args.output.suffix:
            folder = args.output if isinstance(args.output, Url) else args.output.absolute()
            outcomes = run_tasks(partial(assess_part, folder, task, cell=args.cell, overwrite=args.force), paths)
        else:
            outcomes = stack.enter_context(_into_file(args, task, dynamics, origin, paths, run_tasks))
        for path, result in sound(paths, outcomes, unreadable):
            summary.merge(result.summary)
            counts = {name: count + result.counts[name] for name, count in counts.items()}
            losses += result.losses
            unmodelled += [joint for joint in result.unmodelled if joint not in unmodelled]
            input_notes += [note for note in result.notes if note not in input_notes]
            if report and result.drawable:
                drawable, title = result.drawable, f"{robot.name}: {name or path.name}"
                for point, series in drawable.series.items():
                    report.add(series, point, title, generated=drawable.generated, forces=drawable.force)
        notes, results = supplement(counts)
        lines = [*notes, *_lines(counts, input_notes, summary, robot, settings, losses, unreadable, unmodelled)]
        printed = {"output": str(args.output), **results, **counts, **summary.as_dict()}
        printed |= {
            "robot": {"name": robot.name, "file": robot.origin, "is_default": not settings.robot},
            "robot_notes": list(robot.notes),
            "ignored_joints": list(settings.ignored_joints),
            "scope": scope(robot, settings),
            "assumptions": assumptions_of(robot, settings).as_dict(),
        }
        printed |= {"unmodelled_joints": unmodelled, "losses": losses, "unreadable": unreadable, "input": input_notes}
        if report:
            others = f" + {len(paths) - 1}" if len(paths) > 1 else ""
            printed = report.write(f"{robot.name}: {name or paths[0].name}{others}", lines, printed, paths)
    checks = properties.check_assessment(args.output, paths, settings) if properties else []
    lines += [("property", str(check)) for check in checks]
    printed["properties"] = [check._asdict() for check in checks]
    written = [("written", args.output), *([("open", args.report / "report.html")] if report else [])]
    is_bad = unreadable or summary.only_unknown or any(check.violations for check in checks)
    is_bad = is_bad or _share_beyond_limits(summary, settings) > 0.0
    return Assessment(printed, [*lines, *written], int(bool(is_bad)))


def _recordings(args: argparse.Namespace) -> tuple[list[Path], list[tuple[str, str]]]:
    """Return the recordings without copies, and a line about each copy.

    Raises BagError, and SettingsError for options that do not go together.
    """
    if not args.output.suffix and (args.report or args.properties):
        raise SettingsError(f"--report, --properties: must be left out for a dataset, {args.output}")
    if args.output.suffix and args.cell:
        raise SettingsError(f"--cell = {args.cell}: must be for a dataset, not for {args.output}")
    paths = [path for folder in args.bags for path in find_bags(folder)]
    if args.velocity_bag and len(paths) > 1:
        raise SettingsError(f"--velocity-bag = {args.velocity_bag}: must belong to one recording, not to {len(paths)}")
    return without_copies(paths, str(args.output) if args.output.suffix else args.cell)


class _Part(NamedTuple):
    """A recording, and the file for its states."""

    path: Path
    file: Path

    def __str__(self) -> str:
        return str(self.path)


def _assess_file(task: BagTask, origin: Mapping[str, str], part: _Part, advance: Advance) -> BagResult:
    """Assess a recording into a file of its own."""
    dynamics = load_dynamics(task.settings)
    with open_writer(part.file, origin, dynamics.robot.base_frame, overwrite=False) as table:
        return assess_bag(part.path, task, dynamics, table, advance)


@contextmanager
def _into_file(
    args: argparse.Namespace,
    task: BagTask,
    dynamics: RobotDynamics,
    origin: Mapping[str, str],
    paths: Sequence[Path],
    run_tasks: Run,
) -> Iterator[Iterator[BagResult | EffmassError]]:
    """Give the results of the recordings. Several are assessed into files of their own, which are joined in order."""
    if mark := MARKS.get(args.output.suffix):
        check_output_path(args.output, overwrite=args.force, mark=mark)
    with ExitStack() as stack:
        table = stack.enter_context(open_writer(args.output, origin, dynamics.robot.base_frame, overwrite=args.force))
        if len(paths) == 1 and args.scheduler is None:
            yield run_tasks(lambda path, advance: assess_bag(path, task, dynamics, table, advance), paths)
            return
        beside = None if isinstance(args.output, Url) else args.output.absolute().parent
        folder = stack.enter_context(TemporaryDirectory(prefix=".", dir=beside))
        suffix = ".mcap" if args.output.suffix == ".mcap" else ".parquet"
        parts = [_Part(path, Path(folder) / f"{number}{suffix}") for number, path in enumerate(paths)]
        single = dict(origin) | {"bags": json.dumps([""])}

        def extended() -> Iterator[BagResult | EffmassError]:
            for part, outcome in zip(parts, run_tasks(partial(_assess_file, task, single), parts), strict=True):
                if not isinstance(outcome, EffmassError):
                    table.extend(str(part.path), part.file)
                    part.file.unlink()
                yield outcome

        yield extended()


def _open_report(args: argparse.Namespace, settings: MonitorSettings, figures: int) -> RunReport:
    """Return the report with this number of figures. Raises OutputError for existing files."""
    from scara_effmass.analysis.report import PageOptions  # noqa: PLC0415 - loads jinja2
    from scara_effmass.analysis.run_report import RunReport  # noqa: PLC0415 - loads matplotlib

    page = PageOptions(args.language, args.pdf)
    return RunReport(args.report, figures, settings, page, overwrite=args.force)


def _share_beyond_limits(summary: Summary, settings: MonitorSettings) -> float:
    """Return the share of joint states beyond the limits of the default robot; 0 for a stated one, or up to a few."""
    beyond = sum(n for text, n in summary.reasons.items() if summary.codes[text] is Reason.POSITION_LIMIT)
    share = beyond / (summary.cycles.total() or 1)
    return 0.0 if settings.robot or share <= MAX_UNKNOWN_SHARE else share


def _lines(
    counts: Mapping[str, int],
    input_notes: Sequence[tuple[str, str]],
    summary: Summary,
    robot: Robot,
    settings: MonitorSettings,
    losses: Sequence[str],
    unreadable: Sequence[str],
    unmodelled: Sequence[str],
) -> Iterator[tuple[str, str]]:
    yield robot_line(robot, settings)
    foreign = f", {counts['foreign']} of other devices ignored" if counts["foreign"] else ""
    yield "joint states", f"{counts['joint_states']}{foreign}"
    yield from input_notes
    yield from summary.lines()
    if summary.only_unknown:
        problem = "every joint state is UNKNOWN: the reasons say why; `scara-effmass doctor` checks the robot"
        yield "no verdict", problem if counts["joint_states"] else "there was no joint state to read"
    if unmodelled:
        yield "not modelled", f"{', '.join(unmodelled)}: these joints moved, but are not in the model"
    if share := _share_beyond_limits(summary, settings):
        hint = f"joint states of another arm than {robot.name}? Give its robot file by --robot"
        yield "another arm", f"{share:.0%} of the positions lie outside the limits: {hint}"
    if counts["refused"]:
        yield "rejected", f"{counts['refused']} joint states (UNKNOWN)"
    if robot.rotors.warning:
        yield "rotors", robot.rotors.warning
    yield "an OK covers", scope(robot, settings)
    for _, text in assumptions_of(robot, settings).lines:
        yield "assumed", text
    for loss in losses:
        yield "not read", loss
    for error in unreadable:
        yield "not assessed", error
