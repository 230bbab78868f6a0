# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass advise` and `coverage`: what a recorded motion allows, and what it covers."""

import argparse
import csv
import json
from collections.abc import Iterator, Sequence
from functools import partial
from io import StringIO
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from scara_effmass.analysis.advice import Advice, Motion, advise, draw_advice
from scara_effmass.analysis.assessment import Time, assessed_rows, joint_state_topic
from scara_effmass.analysis.coverage import Coverage
from scara_effmass.analysis.output import check_output_files, check_output_path
from scara_effmass.analysis.report import figure_files, report_figure, write_report_files
from scara_effmass.analysis.summary import REASONS_SHOWN
from scara_effmass.analysis.tables import provenance
from scara_effmass.bags.files import bag_bytes, find_bags, open_bag
from scara_effmass.cli.console import print_result, shown_progress
from scara_effmass.cli.options import load_dynamics, monitor_settings, require_no_payload_topic, robot_line
from scara_effmass.cli.tasks import SMALL_BYTES, Advance, open_run, sound
from scara_effmass.errors import BagError, SettingsError
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.safety.assumptions import assumptions_of
from scara_effmass.settings import MonitorSettings, VelocitySource
from scara_effmass.sim.recordings import write_recording
from scara_effmass.values import Decision, JointState, RunInfo, Verdict, at_most

ADVICE, TABLE, SUMMARY, BAG = "advice", "segments.csv", "advice.json", "advised.mcap"
MAX_LINES = 10
"""Largest number of segments without a factor that are printed."""
COVERAGE, COUNTS = "coverage", "coverage.json"


def run_advise(args: argparse.Namespace) -> int:
    """Assess the recording, write factors, figure and re-timed motion, and print them."""
    settings = monitor_settings(args, latch=False, release_time=0.0)  # each state by itself
    require_no_payload_topic(settings, "advice")
    if settings.velocity_window:
        raise SettingsError(f"velocity_window = {settings.velocity_window:g}: must be 0 for a motion to re-time")
    check_output_files(args.output, [*figure_files([ADVICE]), TABLE, SUMMARY, BAG], overwrite=args.force)
    dynamics = load_dynamics(settings)
    assumptions = assumptions_of(dynamics.robot, settings)
    if args.verdict == "ok" and assumptions.limiting:
        raise SettingsError(f"--verdict = ok: must be warn while no verdict can be OK: {assumptions.reason}")
    motion, recorded, losses = _recorded_motion(args, dynamics, settings)
    if (args.segments or 0) > len(motion.states):
        raise SettingsError(f"--segments = {args.segments}: must be at most {len(motion.states)}, the joint states")
    decide = partial(_decide, dynamics, settings)
    worst = Verdict.OK if args.verdict == "ok" else Verdict.WARN
    advice = advise(motion, recorded, decide, args.segments, settings, worst)
    rows, (before, after) = list(_segments(motion, advice)), advice.times(motion)
    missing = [row for row in rows if row["factor"] is None]
    unknown = sum(any(contact.verdict is Verdict.UNKNOWN for contact in decision.contacts) for decision in recorded)
    cycle = {"recorded_s": float(before.sum()), "advised_s": None if missing else float(after.sum())}
    result = {"output": str(args.output), "verdict": args.verdict, "cycle_time": cycle, "unknown": unknown}
    result |= {"assumptions": assumptions.as_dict(), "losses": losses}
    origin = provenance(settings, dynamics.robot.origin, [args.bag])
    table = StringIO()
    writer = csv.DictWriter(table, rows[0], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    title = f"{dynamics.robot.name}: {args.bag.name}, advised speed"
    figure = report_figure(ADVICE, title, "", draw_advice(motion, advice, title))
    summary = {**result, "segments": rows, "provenance": origin}
    write_report_files(args.output, {TABLE: table.getvalue(), SUMMARY: summary}, [figure], overwrite=args.force)
    if missing:
        check_output_path(args.output / BAG, overwrite=True)
        (args.output / BAG).unlink(missing_ok=True)  # of an earlier run
    else:
        note = f"generated: the motion of {args.bag}, re-timed by advise; no robot moved so"
        info = RunInfo(stamp_ns=motion.states[0].stamp_ns, simulated=True, note=note)
        write_recording(args.output / BAG, info, advice.states, (), overwrite=args.force)
    lines = [robot_line(dynamics.robot, settings)]
    lines += [("joint states", f"{len(motion.states)}, {unknown} of them UNKNOWN"), ("segments", str(len(rows)))]
    slowest = sorted((row for row in rows if row["factor"]), key=itemgetter("factor"))[:1]
    lines += [
        ("slowest", f"factor {at_most(row['factor'], 3)} from {row['start_s']:.3f} s: {row['decides']}")
        for row in slowest
    ]
    lines += [("no speed", f"from {row['start_s']:.3f} s: {row['decides']}") for row in missing[:MAX_LINES]]
    if len(missing) > MAX_LINES:
        lines += [("no speed", f"of {len(missing) - MAX_LINES} more segments: see {TABLE}")]
    ends = "no advised motion: some segments have no speed" if missing else f"{after.sum():.2f} s"
    lines += [("assumed", text) for _, text in assumptions.lines]
    lines += [("not read", loss) for loss in losses]
    lines += [("cycle time", f"{before.sum():.2f} s recorded, {ends}")]
    print_result({**result, "segments": rows}, [*lines, ("written", args.output / f"{ADVICE}.png")], as_json=args.json)
    return 1 if missing else 0


def _recorded_motion(
    args: argparse.Namespace, dynamics: RobotDynamics, settings: MonitorSettings
) -> tuple[Motion, list[Decision], list[str]]:
    """Return the recorded motion, the decisions on it, and what could not be read. Raises BagError."""
    with open_bag(args.bag) as bag, shown_progress(bag.path.name) as advance:
        topic = joint_state_topic(bag, args.topic)
        items = list(assessed_rows(bag, topic, Monitor(dynamics, settings), Time.HEADER, advance=advance))
        losses = list(bag.losses)
    states = [item.state for item in items if item.state]
    if len(states) < max(len(items), 2):
        raise BagError(f"{args.bag}: {topic}: must hold two joint states or more, all of them decodable")
    turns = dynamics.robot.turns
    if settings.velocity_source is VelocitySource.REPORTED:
        return Motion(states, f"{args.bag}: {topic}", turns), [item.decision for item in items], losses
    motion = Motion(states, f"{args.bag}: {topic}", turns, from_positions=True)
    return motion, list(_decide(dynamics, settings, motion.states)), losses


def _decide(dynamics: RobotDynamics, settings: MonitorSettings, states: Sequence[JointState]) -> Iterator[Decision]:
    """Yield the decisions of a fresh monitor on the `states` of a motion, with their velocities."""
    monitor = Monitor(dynamics, settings.model_copy(update={"velocity_source": VelocitySource.REPORTED}))
    return (decision for state in states if (decision := monitor.assess(state, state.stamp_ns)))


def _segments(motion: Motion, advice: Advice) -> Iterator[dict[str, Any]]:
    """Yield the row of each segment; a missing number is None."""
    starts_s = motion.time[np.searchsorted(advice.segment, np.arange(len(advice.factors)))]
    columns = zip(starts_s, *advice.times(motion), advice.factors, strict=True)
    for number, (values, reason) in enumerate(zip(columns, advice.reasons, strict=True)):
        start, recorded, advised, factor = (None if np.isnan(value) else float(value) for value in values)
        times = {"start_s": start, "recorded_s": recorded, "advised_s": advised}
        yield {"segment": number, **times, "factor": factor, "decides": reason}


def run_coverage(args: argparse.Namespace) -> int:
    """Count the joint states of the recordings and of earlier files, write figure and counts, and print the shares."""
    settings = monitor_settings(args)
    check_output_files(args.output, [COUNTS, *figure_files([COVERAGE])], overwrite=args.force)
    dynamics = load_dynamics(settings)
    coverage = Coverage.of_robot(dynamics.robot)
    earlier = [path for path in args.bags if path.suffix == ".json"]
    for path in earlier:
        coverage.merge(path)
    paths = [bag for folder in args.bags if folder not in earlier for bag in find_bags(folder)]
    unreadable: list[str] = []
    with open_run(args, "recordings", is_small=sum(map(bag_bytes, paths)) < SMALL_BYTES) as run_tasks:
        count = partial(_counted, settings, args.topic, Time(args.time))
        for path, counted in sound(paths, run_tasks(count, paths), unreadable):
            coverage.extend(counted, path)
    shares = coverage.shares()
    result = {"output": str(args.output), "joint_states": coverage.joint_states, "covered": shares}
    result |= {"invalid": dict(coverage.invalid.most_common())}
    result |= {"unreadable": unreadable, "losses": coverage.losses}
    text = json.dumps({**result, "coverage": coverage.model_dump(mode="json")}, allow_nan=False)
    figure = report_figure(COVERAGE, f"Coverage of {coverage.robot}", "", coverage.figure())
    write_report_files(args.output, {COUNTS: f"{text}\n"}, [figure], overwrite=args.force)
    lines = [robot_line(dynamics.robot, settings), ("recordings", str(len(coverage.recordings)))]
    lines += [("joint states", f"{coverage.joint_states} valid ones")]
    lines += [("not valid", f"{count}: {reason}") for reason, count in coverage.invalid.most_common(REASONS_SHOWN)]
    if len(coverage.invalid) > REASONS_SHOWN:
        lines += [("not valid", f"for {len(coverage.invalid) - REASONS_SHOWN} other reasons (--json lists them)")]
    lines += [(name, f"{share:.1%} of its bins") for name, share in shares.items() if isinstance(share, float)]
    lines += [(name, f"fastest from {speed:g} m/s on") for name, speed in shares["fastest_bin_from_m_s"].items()]
    lines += [("not read", loss) for loss in coverage.losses]
    lines += [("not counted", error) for error in unreadable]
    print_result(result, [*lines, ("written", args.output / COUNTS)], as_json=args.json)
    return 1 if unreadable else 0


def _counted(settings: MonitorSettings, topic: str | None, time: Time, path: Path, advance: Advance) -> Coverage:
    """Return the coverage of the recording at `path`. Raises BagError."""
    dynamics = load_dynamics(settings)
    coverage = Coverage.of_robot(dynamics.robot)
    with open_bag(path) as bag:
        topic = joint_state_topic(bag, topic)
        coverage.begin(f"{bag.path.name}, {bag.start_ns} ns")  # also after it was moved
        for _, state, decision in assessed_rows(bag, topic, Monitor(dynamics, settings), time, advance=advance):
            if state is not None:
                coverage.add(state, decision.contacts)
        coverage.losses += bag.losses
    return coverage
