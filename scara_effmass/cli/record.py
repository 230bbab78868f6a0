"""`scara-effmass record`."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.status import Status

from scara_effmass.bags.recording_report import RecordingReport
from scara_effmass.cli.console import print_json, print_lines
from scara_effmass.cli.options import add_force, add_json
from scara_effmass.errors import SettingsError
from scara_effmass.wire.topics import RECORDED

if TYPE_CHECKING:
    from scara_effmass.bags.repair import RepairReport
    from scara_effmass.nodes.record import RecordReport

MB = 1_000_000
NS = 1_000_000_000

EXAMPLES = f"""\
Default topics: {", ".join(RECORDED)}.
Recording ends on Ctrl-C or SIGTERM. All messages older than one second are on the disk and can be read; if the recorder
is killed, its last file has no index until record --repair adds one. ROS arguments follow --.

examples:
  scara-effmass record -o run1
  scara-effmass record -o run2 joint_states force /camera/info --max-size 500
  scara-effmass record -o all --all --duration 60 -- -p use_sim_time:=true
  scara-effmass record --repair run1
"""


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = EXAMPLES
    parser.add_argument(
        "topics", nargs="*", metavar="TOPIC", help="topics to record (default: the topics of the suite)"
    )
    task = parser.add_mutually_exclusive_group(required=True)
    task.add_argument("-o", "--output", type=Path, metavar="BAG", help="output folder")
    task.add_argument(
        "--repair", type=Path, metavar="BAG", help="complete a bag of a killed recorder: folder or MCAP file"
    )
    parser.add_argument("--all", action="store_true", help="record all topics except hidden ones")
    parser.add_argument("--max-size", type=float, default=0.0, metavar="MB", help="start a new file at this size [MB]")
    parser.add_argument(
        "--max-duration", type=float, default=0.0, metavar="S", help="start a new file after this time [s]"
    )
    parser.add_argument("--duration", type=float, default=math.inf, metavar="S", help="duration of the recording [s]")
    parser.add_argument("--no-compression", action="store_true", help="do not compress (default: zstd)")
    add_force(parser)
    add_json(parser)
    parser.set_defaults(run=run, ros_arguments=[])


def run(args: argparse.Namespace) -> int:
    """Record or repair, and print the result."""
    return _repair(args) if args.repair else _record(args)


def _record(args: argparse.Namespace) -> int:
    from scara_effmass.bags.recorder import RecorderOptions  # noqa: PLC0415 - slow import
    from scara_effmass.nodes.record import RecordOptions, record  # noqa: PLC0415 - rclpy

    for option, value in (("--max-size", args.max_size), ("--max-duration", args.max_duration)):
        if not 0.0 <= value < math.inf:
            raise SettingsError(f"record: {option} = {value}: must be >= 0 (0: never)")
    options = RecordOptions(
        folder=args.output,
        topics=tuple(args.topics),
        all_topics=args.all,
        duration_s=args.duration,
        overwrite=args.force,
        recorder=RecorderOptions(
            compress=not args.no_compression,
            max_file_bytes=math.ceil(args.max_size * MB),
            max_file_ns=math.ceil(args.max_duration * NS),
        ),
        ros_arguments=tuple(args.ros_arguments),
    )
    console = Console(stderr=True, highlight=False, markup=False, soft_wrap=True)
    if console.is_terminal:
        with Status("waiting for messages", console=console) as status:

            def show(current: RecordingReport, seconds: float) -> None:
                lost = f", {current.lost} lost" if current.lost else ""
                size_mb = current.size_bytes / MB
                status.update(f"{seconds:.0f} s: {current.recorded} messages{lost}, {size_mb:.1f} MB")

            report = record(options, show, console.print)
    else:
        report = record(options, warn=console.print)
    if args.json:
        print_json(_json_report(report))
    else:
        print_lines(_lines(report, named=bool(args.topics)))
    return 1 if report.recording.lost or report.recording.stopped_by_disk else 0


def _json_report(report: RecordReport) -> dict[str, object]:
    recording = asdict(report.recording)
    return {
        "bag": str(recording.pop("folder")),
        "messages": report.recording.recorded,
        "lost": report.recording.lost,
        **recording,
        "seconds": report.seconds,
        "simulated_time": report.simulated_time,
        "refused": dict(report.refused),
        "unheard": report.unpublished,
    }


def _lines(report: RecordReport, *, named: bool) -> Iterator[tuple[str, str]]:
    recording = report.recording
    for name, topic in recording.topics.items():
        causes = ", ".join(f"{count} by the {cause}" for cause, count in asdict(topic.lost).items() if count)
        lost = f", lost {causes}" if causes else ""
        yield "recorded", f"{name}: {topic.recorded} messages{lost}"
    for name, reason in report.refused.items():
        yield "not recorded", f"{name}: {reason}"
    for name in report.unpublished if named else ():
        yield "not recorded", f"{name}: no publisher"
    for name in recording.unindexed:
        yield "without index", f"{name}: free disk space, then record --repair"
    total = f"{recording.recorded} messages, {recording.lost} lost, {recording.size_bytes / MB:.1f} MB"
    files = f"{len(recording.files)} file{'s' if len(recording.files) != 1 else ''}"
    yield "total", f"{total} in {files}, {report.seconds:.1f} s: {recording.folder}"


def _repair(args: argparse.Namespace) -> int:
    from scara_effmass.bags.repair import repair  # noqa: PLC0415 - slow import

    if args.topics:
        raise SettingsError(f"record: topics = {args.topics[0]!r}: must be empty with --repair")
    report = repair(args.repair)
    if args.json:
        print_json({**asdict(report), "intact": report.intact})
    else:
        print_lines(_repair_lines(report))
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
