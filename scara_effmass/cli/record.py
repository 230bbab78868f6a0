# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass record`."""

import argparse
import math
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import asdict

from rich.console import Console
from rich.status import Status

from scara_effmass.bags.recording_report import RecordingReport, TopicReport
from scara_effmass.bags.repair import RepairReport, repair
from scara_effmass.bags.split_writer import RecorderOptions
from scara_effmass.cli.console import print_result
from scara_effmass.errors import SettingsError
from scara_effmass.wire.topics import RECORDED

MB = 1_000_000
NS = 1_000_000_000


def run(args: argparse.Namespace) -> int:
    """Record or repair, and print the result."""
    return _repair(args) if args.repair else _record(args)


def _record(args: argparse.Namespace) -> int:
    from scara_effmass.nodes.record import record  # noqa: PLC0415 - rclpy, not needed for --repair

    if args.all and args.topics:
        raise SettingsError(f"record: topics = {args.topics[0]!r}: must be empty with --all")
    options = RecorderOptions(
        compress=not args.no_compression,
        max_file_bytes=math.ceil(args.max_size * MB),
        max_file_ns=math.ceil(args.max_duration * NS),
    )
    console = Console(stderr=True, highlight=False, markup=False, soft_wrap=True)
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
    if args.topics:
        raise SettingsError(f"record: topics = {args.topics[0]!r}: must be empty with --repair")
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
