# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass advise`."""

import argparse
import csv
from collections.abc import Iterator, Sequence
from io import StringIO
from typing import Any

import numpy as np

from scara_effmass.analysis.advice import Advice, Motion, advise, draw_advice
from scara_effmass.analysis.assessment import Time, assessed_rows, joint_state_topic
from scara_effmass.analysis.output import check_output_files
from scara_effmass.analysis.report import figure_files, report_figure, write_report_files
from scara_effmass.analysis.tables import provenance
from scara_effmass.bags.files import open_bag
from scara_effmass.cli.console import print_result, progress_bar, tracked
from scara_effmass.cli.settings import load_dynamics, monitor_settings, require_no_payload_topic
from scara_effmass.errors import BagError, SettingsError
from scara_effmass.safety import Monitor
from scara_effmass.settings import VelocitySource
from scara_effmass.sim.recordings import write_recording
from scara_effmass.values import Decision, JointState, RunInfo, Verdict

NAME, TABLE, SUMMARY, BAG = "advice", "segments.csv", "advice.json", "advised.mcap"


def run(args: argparse.Namespace) -> int:
    """Assess the recording, write factors, figure and re-timed motion, and print them."""
    settings = monitor_settings(args, latch=False, release_time=0.0)  # each state by itself
    require_no_payload_topic(settings, "advice")
    if settings.velocity_source is not VelocitySource.REPORTED or settings.velocity_window:
        raise SettingsError("velocity_source: must be reported, with velocity_window 0, for a motion to re-time")
    check_output_files(args.output, [*figure_files([NAME]), TABLE, SUMMARY, BAG], overwrite=args.force)
    dynamics = load_dynamics(settings)
    with progress_bar() as progress, open_bag(args.bag) as bag:
        topic = joint_state_topic(bag, args.topic)
        assessed = assessed_rows(bag, topic, Monitor(dynamics, settings), Time.HEADER)
        items = list(tracked(progress, bag, topic, assessed))
    states, recorded = [item.state for item in items if item.state], [item.decision for item in items]
    if len(states) < max(len(items), 2):
        raise BagError(f"{args.bag}: {topic}: must hold two joint states or more, all of them decodable")
    motion = Motion(states, f"{args.bag}: {topic}")

    def decide(states: Sequence[JointState]) -> Iterator[Decision]:
        monitor = Monitor(dynamics, settings)
        return (decision for state in states if (decision := monitor.assess(state, state.stamp_ns)))

    share = settings.warn_ratio if args.verdict == "ok" else 1.0
    advice = advise(motion, recorded, decide, args.segments, settings.speed_threshold, share)
    rows, (before, after) = list(_rows(motion, advice)), advice.times(motion)
    missing = [row for row in rows if row["factor"] is None]
    unknown = sum(any(contact.verdict is Verdict.UNKNOWN for contact in decision.contacts) for decision in recorded)
    cycle = {"recorded_s": float(before.sum()), "advised_s": None if missing else float(after.sum())}
    result = {"output": str(args.output), "verdict": args.verdict, "cycle_time": cycle, "unknown": unknown}
    origin = provenance(settings, dynamics.robot.origin, [args.bag])
    table = StringIO()
    writer = csv.DictWriter(table, rows[0], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    title = f"{dynamics.robot.name}: {args.bag.name}, advised speed"
    figure = report_figure(NAME, title, "", draw_advice(motion, advice, title))
    summary = {**result, "segments": rows, "provenance": origin}
    write_report_files(args.output, {TABLE: table.getvalue(), SUMMARY: summary}, [figure], overwrite=args.force)
    if missing:
        (args.output / BAG).unlink(missing_ok=True)  # of an earlier run
    else:
        note = f"generated: the motion of {args.bag}, re-timed by advise; no robot moved so"
        info = RunInfo(stamp_ns=states[0].stamp_ns, simulated=True, note=note)
        write_recording(args.output / BAG, info, advice.states, (), overwrite=args.force)
    lines = [("joint states", f"{len(states)}, {unknown} of them UNKNOWN"), ("segments", len(rows))]
    lines += [("no speed", f"from {row['start_s']:.3f} s: {row['decides']}") for row in missing[:10]]
    ends = "no advised motion: some segments have no speed" if missing else f"{after.sum():.2f} s"
    lines += [("cycle time", f"{before.sum():.2f} s recorded, {ends}")]
    print_result({**result, "segments": rows}, [*lines, ("written", args.output / f"{NAME}.png")], as_json=args.json)
    return 1 if missing else 0


def _rows(motion: Motion, advice: Advice) -> Iterator[dict[str, Any]]:
    """Yield the row of each segment; a missing number is None."""
    starts_s = motion.time[np.searchsorted(advice.segment, np.arange(len(advice.factors)))]
    columns = zip(starts_s, *advice.times(motion), advice.factors, strict=True)
    for number, (values, reason) in enumerate(zip(columns, advice.reasons, strict=True)):
        start, recorded, advised, factor = (None if np.isnan(value) else float(value) for value in values)
        times = {"start_s": start, "recorded_s": recorded, "advised_s": advised}
        yield {"segment": number, **times, "factor": factor, "decides": reason}
