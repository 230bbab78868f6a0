"""`scara-effmass record`."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.status import Status

from scara_effmass.cli.console import print_json, print_lines
from scara_effmass.cli.options import add_force, add_json
from scara_effmass.errors import SettingsError

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from scara_effmass.bags.recording_report import RecordingReport
    from scara_effmass.bags.repair import RepairReport
    from scara_effmass.nodes.record import RecordReport

MB = 1_000_000
NS = 1_000_000_000

EXAMPLES = """\
Without topics it records those of the suite: joint_states, contact_state, allowable_speed, speed_scaling, force,
impact, wrench, impact_validation, robot_description, /diagnostics, /tf, /tf_static, run_info,
/scara_effmass/recording_info.
It ends on Ctrl-C or SIGTERM. At any moment, what is more than a second old is on the disk and can be read; a recorder
that was killed leaves its last file without an index, which --repair makes. ROS arguments stand behind --.

examples:
  scara-effmass record -o run1
  scara-effmass record -o run2 joint_states force /camera/info --max-size 500
  scara-effmass record -o all --all --duration 60 -- -p use_sim_time:=true
  scara-effmass record --repair run1
"""


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = EXAMPLES
    parser.add_argument("topics", nargs="*", metavar="TOPIC", help="topics to record (default: those of the suite)")
    task = parser.add_mutually_exclusive_group(required=True)
    task.add_argument("-o", "--output", type=Path, metavar="BAG", help="folder to record into")
    task.add_argument("--repair", type=Path, metavar="BAG", help="complete a recording: an MCAP file, or its folder")
    parser.add_argument("--all", action="store_true", help="record every topic that is not hidden")
    parser.add_argument("--max-size", type=float, default=0.0, metavar="MB", help="begin a new file at this size [MB]")
    parser.add_argument(
        "--max-duration", type=float, default=0.0, metavar="S", help="begin a new file after this time [s]"
    )
    parser.add_argument("--duration", type=float, default=math.inf, metavar="S", help="how long to record [s]")
    parser.add_argument("--no-compression", action="store_true", help="leave messages as they are (default: zstd)")
    add_force(parser)
    add_json(parser)
    parser.set_defaults(run=run, ros_arguments=[])


def run(args: argparse.Namespace) -> int:
    """Record, or repair, and print what became of it."""
    return _repair(args) if args.repair else _record(args)


def _record(args: argparse.Namespace) -> int:
    from scara_effmass.bags.recording_options import RecordingOptions  # noqa: PLC0415 - only when it runs
    from scara_effmass.nodes.record import RecordOptions, record  # noqa: PLC0415 - rclpy

    for option, value in (("--max-size", args.max_size), ("--max-duration", args.max_duration)):
        if not 0.0 <= value < math.inf:
            raise SettingsError(f"record: {option} = {value}: 0 (never) or more would be right")
    options = RecordOptions(
        folder=args.output,
        topics=tuple(args.topics),
        everything=args.all,
        duration_s=args.duration,
        overwrite=args.force,
        recording=RecordingOptions(
            compress=not args.no_compression,
            part_bytes=math.ceil(args.max_size * MB),
            part_ns=math.ceil(args.max_duration * NS),
        ),
        ros_arguments=tuple(args.ros_arguments),
    )
    console = Console(stderr=True, highlight=False, markup=False, soft_wrap=True)
    if console.is_terminal:
        with Status("waiting for messages", console=console) as status:

            def show(now: RecordingReport, seconds: float) -> None:
                lost = f", {now.lost} lost" if now.lost else ""
                status.update(f"{seconds:.0f} s: {now.recorded} messages{lost}, {now.size_bytes / MB:.1f} MB")

            report = record(options, show, console.print)
    else:
        report = record(options, say=console.print)
    if args.json:
        print_json(_plain(report))
    else:
        print_lines(_lines(report, named=bool(args.topics)))
    return 1 if report.recording.lost or report.recording.stopped_by_disk else 0


def _plain(report: RecordReport) -> dict[str, object]:
    recording = asdict(report.recording)
    return {
        "bag": str(recording.pop("folder")),
        "messages": report.recording.recorded,
        "lost": report.recording.lost,
        **recording,
        "seconds": report.seconds,
        "simulated_time": report.simulated_time,
        "refused": dict(report.refused),
        "unheard": report.unheard,
    }


def _lines(report: RecordReport, *, named: bool) -> Iterator[tuple[str, str]]:
    recording = report.recording
    for name, topic in recording.topics.items():
        causes = ", ".join(f"{count} by the {cause}" for cause, count in asdict(topic.lost).items() if count)
        lost = f", lost {causes}" if causes else ""
        yield "recorded", f"{name}: {topic.recorded} messages{lost}"
    for name, reason in report.refused.items():
        yield "not recorded", f"{name}: {reason}"
    for name in report.unheard if named else ():
        yield "not recorded", f"{name}: nobody published it"
    for name in recording.unindexed:
        yield "without index", f"{name}: make room on the disk, then --repair"
    total = f"{recording.recorded} messages, {recording.lost} lost, {recording.size_bytes / MB:.1f} MB"
    files = f"{len(recording.files)} file{'s' if len(recording.files) != 1 else ''}"
    yield "in all", f"{total} in {files}, {report.seconds:.1f} s: {recording.folder}"


def _repair(args: argparse.Namespace) -> int:
    from scara_effmass.bags.repair import repair  # noqa: PLC0415 - only when it runs

    if args.topics:
        raise SettingsError(f"record: {args.topics[0]}: --repair takes no topics, it keeps all of them")
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
            yield "kept", f"{file.kept_original}: the file as it was"
    for line in report.failed:
        yield "not repaired", line
    if report.metadata_rewritten:
        yield "repaired", str(report.files[0].path.with_name("metadata.yaml"))
