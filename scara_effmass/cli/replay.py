"""`scara-effmass replay`."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from rich.progress import BarColumn, TextColumn

from scara_effmass.cli.console import print_json, print_lines, progress_bar
from scara_effmass.cli.options import add_json

if TYPE_CHECKING:
    from scara_effmass.nodes.replay import ReplayProgress, ReplayReport

EXAMPLES = """\
The time of the recording is published on /clock: run the nodes with use_sim_time, or the monitor answers UNKNOWN to
old joint states. The replay starts when every node of the suite that runs on /clock, or subscribes to a replayed topic,
is active, has received the clock and has discovered the others. If that takes longer than --wait, it fails and names
the nodes that are not ready.

examples:
  scara-effmass monitor -- -p use_sim_time:=true
  scara-effmass replay bags/tour
  scara-effmass replay bags/tour --start 10 --duration 5 --rate 0.5 --loop
  scara-effmass replay recording.bag --topic /wx200/joint_states --rate 0
"""


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = EXAMPLES
    parser.add_argument("bag", type=Path, metavar="BAG", help="bag to replay")
    parser.add_argument(
        "--rate", type=float, default=1.0, help="speed relative to the recording; 0: as fast as a monitor answers"
    )
    parser.add_argument("--start", type=float, default=0.0, metavar="S", help="start in the recording [s]")
    parser.add_argument("--duration", type=float, default=math.inf, metavar="S", help="recorded time to replay [s]")
    parser.add_argument("--loop", action="store_true", help="repeat until interrupted")
    parser.add_argument("--topic", help="topic to publish as /joint_states (default: every topic keeps its name)")
    parser.add_argument(
        "--topics",
        nargs="+",
        default=(),
        metavar="TOPIC",
        help="topics to replay (default: all but node outputs)",
    )
    parser.add_argument(
        "--subscribers",
        type=int,
        default=1,
        metavar="N",
        help="minimum number of subscribers of the joint states before the start (default: 1)",
    )
    parser.add_argument(
        "--wait",
        type=float,
        default=30.0,
        metavar="S",
        help="maximum wait for the nodes [s] (default: 30)",
    )
    add_json(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Replay and print the report."""
    from scara_effmass.nodes.replay import ReplayOptions, replay  # noqa: PLC0415 - loads rclpy

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
    )
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed:.1f} of {task.total:.1f} s"))
    with progress_bar(*columns) as progress:
        task = progress.add_task("replay", total=None)

        def on_progress(state: ReplayProgress) -> None:
            name = f"pass {state.pass_number}" if args.loop else args.bag.name
            progress.update(task, description=name, completed=state.time_s, total=state.span_s)

        report = replay(options, on_progress)
    if args.json:
        print_json({**asdict(report), "achieved_rate": report.achieved_rate})
    else:
        print_lines(_lines(report))
    return 130 if report.interrupted else 0


def _lines(report: ReplayReport) -> Iterator[tuple[str, str]]:
    for topic, count in report.sent.items():
        note = ", no subscriber" if topic in report.unheard else ""
        yield "sent", f"{topic}: {count} messages{note}"
    for topic, reason in report.skipped.items():
        yield "not replayed", f"{topic}: {reason}"
    yield "played", f"{report.replayed_s:.2f} s in {report.wall_s:.2f} s, {report.achieved_rate:.2f} times real time"
    if report.answered or report.unanswered or report.not_awaited:
        not_awaited = f", {report.not_awaited} not awaited" if report.not_awaited else ""
        yield "answered", f"{report.answered} joint states, {report.unanswered} unanswered{not_awaited}"
    if report.late:
        yield "late", f"{report.late} messages by more than 10 ms, at worst {1e3 * report.worst_lateness_s:.0f} ms"
    for topic in report.unacknowledged:
        yield "not received", f"{topic}: a subscriber has not acknowledged every message"
    for warning in report.warnings:
        yield "warning", warning
