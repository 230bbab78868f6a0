# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass replay`."""

import argparse
from collections.abc import Iterator
from dataclasses import asdict

from rich.progress import BarColumn, TextColumn

from scara_effmass.cli.console import print_result, progress_bar
from scara_effmass.nodes.replay import ReplayOptions, ReplayReport, replay


def run(args: argparse.Namespace) -> int:
    """Replay and print the report."""
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
        task = progress.add_task("replay", total=None)

        def on_progress(pass_number: int, time_s: float, span_s: float) -> None:
            name = f"pass {pass_number}" if args.loop else args.bag.name
            progress.update(task, description=name, completed=time_s, total=span_s)

        report = replay(options, on_progress)
    print_result({**asdict(report), "achieved_rate": report.achieved_rate}, _lines(report), as_json=args.json)
    return 130 if report.interrupted else 0


def _lines(report: ReplayReport) -> Iterator[tuple[str, str]]:
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
