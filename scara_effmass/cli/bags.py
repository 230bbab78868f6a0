# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass record`, `replay` and `import`."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, TextColumn
from rich.status import Status

from scara_effmass.bags.recorder import RecorderOptions, RecordingReport, TopicReport
from scara_effmass.bags.repair import RepairReport, repair
from scara_effmass.cli.console import live_file, print_result, progress_bar
from scara_effmass.errors import SettingsError
from scara_effmass.importers.force import ImportedTopic, write_force_bag
from scara_effmass.importers.force_file import refuse_settings
from scara_effmass.importers.joint_states import write_joint_state_bag
from scara_effmass.settings import ImportSettings, checked
from scara_effmass.settings.loading import flat_fields
from scara_effmass.wire.topics import RECORDED

if TYPE_CHECKING:
    from scara_effmass.nodes.replay import ReplayReport

MB = 1_000_000
NS = 1_000_000_000
MAX_LIMIT = 2.0**62
"""Largest size [B] and duration [ns] of a file."""


def run_record(args: argparse.Namespace) -> int:
    """Record or repair, and print the result."""
    if args.repair:
        return _repair(args)
    from scara_effmass.nodes.record import record  # noqa: PLC0415 - rclpy, not needed for --repair

    if args.all and args.topics:
        raise SettingsError(f"record: topics = {args.topics[0]!r}: must be empty with --all")
    options = RecorderOptions(
        compress=not args.no_compression,
        max_file_bytes=math.ceil(min(args.max_size * MB, MAX_LIMIT)),
        max_file_ns=math.ceil(min(args.max_duration * NS, MAX_LIMIT)),
    )
    console = Console(file=live_file(sys.stderr), highlight=False, markup=False, soft_wrap=True)
    status = Status("waiting for messages", console=console)

    def show(current: RecordingReport, seconds: float) -> None:
        lost = f", {current.lost} lost" if current.lost else ""
        status.update(f"{seconds:.0f} s: {current.recorded} messages{lost}, {current.size_bytes / MB:.1f} MB")

    with status if console.is_terminal else nullcontext():
        report = record(
            args.output,
            () if args.all else args.topics or RECORDED,
            options,
            duration_s=args.duration,
            overwrite=args.force,
            ros_arguments=args.ros_arguments,
            progress=show,
            warn=console.print,
        )
    recording = report.recording
    fields = asdict(recording)
    result = {
        "bag": fields.pop("folder"),
        "messages": recording.recorded,
        "lost": recording.lost,
        **fields,
        "seconds": report.seconds,
        "simulated_time": report.simulated_time,
        "refused": dict(report.refused),
        "unheard": report.unpublished,
    }
    absent = [(name, "no publisher") for name in report.unpublished if args.topics]
    lines = _lines(recording, [*report.refused.items(), *absent], report.seconds)
    print_result(result, lines, as_json=args.json)
    if recording.lost:
        lost = ", ".join(f"{name}: {_causes(topic)}" for name, topic in recording.topics.items() if topic.lost.total)
        console.print(f"record: {recording.lost} of {recording.lost + recording.recorded} messages were lost: {lost}")
    return 1 if recording.lost or recording.stopped_by_disk else 0


def _lines(
    recording: RecordingReport, not_recorded: list[tuple[str, str]], seconds: float
) -> Iterator[tuple[str, str]]:
    for name, topic in recording.topics.items():
        lost = f", lost {_causes(topic)}" if topic.lost.total else ""
        yield "recorded", f"{name}: {topic.recorded} messages{lost}"
    for name, reason in not_recorded:
        yield "not recorded", f"{name}: {reason}"
    for name in recording.unindexed:
        yield "without index", f"{name}: free disk space, then record --repair"
    total = f"{recording.recorded} messages, {recording.lost} lost, {recording.size_bytes / MB:.1f} MB"
    files = f"{len(recording.files)} file{'s' if len(recording.files) != 1 else ''}"
    yield "total", f"{total} in {files}, {seconds:.1f} s: {recording.folder}"


def _causes(topic: TopicReport) -> str:
    return ", ".join(f"{count} by the {cause}" for cause, count in asdict(topic.lost).items() if count)


def _repair(args: argparse.Namespace) -> int:
    if args.ros_arguments:
        raise SettingsError(f"{args.ros_arguments[0]}: must be left out with --repair, which starts no node")
    report = repair(args.repair)
    print_result({**asdict(report), "intact": report.intact}, _repair_lines(report), as_json=args.json)
    return 1 if report.failed else 0


def _repair_lines(report: RepairReport) -> Iterator[tuple[str, str]]:
    for file in report.files:
        yield "intact" if file.intact else "repaired", f"{file.path}: {file.messages} messages"
        for line in file.lost:
            yield "lost", line
        if file.kept_original:
            yield "kept", f"{file.kept_original}: the original"
    for line in report.failed:
        yield "not repaired", line
    if report.metadata_rewritten:
        yield "repaired", str(report.files[0].path.with_name("metadata.yaml"))


def run_replay(args: argparse.Namespace) -> int:
    """Replay a recording, and print the result."""
    from scara_effmass.nodes.replay import ReplayOptions, replay  # noqa: PLC0415 - rclpy

    options = ReplayOptions(
        bag=args.bag,
        rate=args.rate,
        start_s=args.start,
        duration_s=args.duration,
        passes=0 if args.loop else 1,
        topics=tuple(args.topics),
        joint_state_topic=args.topic or "",
        subscribers=args.subscribers,
        ready_timeout_s=args.wait,
        ros_arguments=tuple(args.ros_arguments),
    )
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed:.1f} of {task.total:.1f} s"))
    with progress_bar(*columns) as progress:
        task = progress.add_task("replay", total=0.0)

        def on_progress(pass_number: int, time_s: float, span_s: float) -> None:
            name = f"pass {pass_number}" if args.loop else args.bag.name
            progress.update(task, description=name, completed=time_s, total=span_s)

        report = replay(options, on_progress)
    print_result({**asdict(report), "achieved_rate": report.achieved_rate}, _replay_lines(report), as_json=args.json)
    return 130 if report.interrupted else 0


def _replay_lines(report: ReplayReport) -> Iterator[tuple[str, str]]:
    for topic, count in report.sent.items():
        note = ", no subscriber" if topic in report.unheard else ""
        yield "sent", f"{topic}: {count} messages{note}"
    for topic, reason in report.skipped.items():
        yield "not replayed", f"{topic}: {reason}"
    yield "played", f"{report.replayed_s:.2f} s in {report.wall_s:.2f} s, {report.achieved_rate:.2f} times real time"
    if report.late:
        yield "late", f"{report.late} messages by more than 10 ms, at worst {1e3 * report.worst_lateness_s:.0f} ms"
    for topic in report.unacknowledged:
        yield "not received", f"{topic}: a subscriber has not acknowledged every message"
    for warning in report.warnings:
        yield "warning", warning


def run_import(args: argparse.Namespace) -> int:
    """Import force or joint states, and print the result."""
    names = flat_fields(ImportSettings)
    stated = {name: value for name, value in vars(args).items() if name in names and value is not None}
    settings = checked(ImportSettings, stated, "options")
    if args.joints:
        of_force = [name for name in names if name not in {"rate", "header"}]
        refuse_settings(settings, of_force, f"--joints = {args.joints}", "the mapping names columns and units")
        return _import_joint_states(args, settings)
    topics = write_force_bag(args.files, args.output, settings, overwrite=args.force)
    result = {"output": str(args.output), "topics": [asdict(topic) for topic in topics]}
    print_result(result, _import_lines(topics, args.output), as_json=args.json)
    return 0


def _import_joint_states(args: argparse.Namespace, settings: ImportSettings) -> int:
    if len(args.files) > 1:
        raise SettingsError(f"--joints = {args.joints}: must belong to one file, not to {len(args.files)}")
    (path,) = args.files
    imported = write_joint_state_bag(
        path, args.joints, args.output, rate=settings.rate, header=settings.header, overwrite=args.force
    )
    span = f"{imported.first_stamp_s:.3f} to {imported.last_stamp_s:.3f} s"
    velocity = "with velocities" if imported.has_velocity else "without velocities (assess --velocity from-positions)"
    lines = [("/joint_states", f"{path.name}: {imported.joint_states} joint states, {span}, {velocity}")]
    if imported.rows_without_values:
        lines.append(("left out", f"{imported.rows_without_values} rows without joint values"))
    if imported.shift_s:
        lines.append(("time", f"{imported.shift_s:.3f} s later than in the file, which begins at 0 or before"))
    result = {"output": str(args.output), **imported._asdict()}
    print_result(result, [*lines, ("written", args.output)], as_json=args.json)
    return 0


def _import_lines(topics: Sequence[ImportedTopic], output: Path) -> Iterator[tuple[str, str]]:
    for topic in topics:
        counts = f"{topic.samples} samples at {topic.sample_rate_hz:.9g} Hz, {topic.lost_samples} lost"
        yield topic.topic, f"{topic.source}: {counts}, {topic.saturated_samples} saturated"
        for loss in topic.losses:
            yield "not read", loss
    yield "written", str(output)
