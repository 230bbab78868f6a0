# SPDX-License-Identifier: Apache-2.0
"""`make bench`: every speed claim as a ratio of two measurements taken in turn in the same run."""

from __future__ import annotations

import os

import numpy as np

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
os.environ.setdefault("ROS_DOMAIN_ID", "71")

import assess
import core
import daq
import live
import recorder
import workspace_map

import bags


def main() -> None:
    """Run every benchmark and print each row when it is measured: all take 10 minutes."""
    show("what", "ours", "compared with", "theirs", "ratio", "goal")

    def row(what: str, ours: float, against: str, theirs: float, unit: str, goal: str) -> None:
        show(what, f"{ours:,.1f} {unit}", against, f"{theirs:,.1f} {unit}", f"{ours / theirs:.2f}", goal)

    pinocchio = "CRBA + J + solve, one mass"
    row(f"core, one cycle ({core.kind()})", *_around(pinocchio, core.measure()), "us", "<= 0.6")
    first, _ = times = core.measure_chain(4)
    row("core, 4 joints", *_around(pinocchio, times), "us", "")
    for joints in (6, 7, 14):
        linear = f"<= {first * joints / 4.0:,.0f} us"  # growth no worse than linear
        row(f"core, {joints} joints", *_around(pinocchio, core.measure_chain(joints)), "us", linear)
    for points in (4, 16):
        times = core.measure_chain(4, points)
        row(
            f"core, 4 joints, {points} contact points",
            *_around("one mass each", times),
            "us",
            f"<= {first * points:,.0f} us",
        )
    times_us = core.measure_contact_points()
    for points, goal in core.CONTACTS.items():
        what = f"{points} contact points" if points else "2 contact points and 4 links"
        row(f"core, {what}", times_us[points], "1 contact point", times_us[1], "us", f"<= {goal:g}")
    row("core, joint states with effort", *_around("without", core.measure_effort()), "us", "")
    row("bag, joint states", *_around("rosbags", bags.measure()), "1/s", ">= 10")
    for robot, (file, points, goal) in assess.ROBOTS.items():
        what = f"bag -> verdicts, {robot}"
        row(what, *_around("rosbags decoding alone", assess.measure(file, points)), "1/s", f">= {goal:g}")
    row("workspace map, SCARA, a pose", *_around("closed form, masses alone", workspace_map.measure()), "ns", "")
    runs = live.measure()
    monitor, bare = runs["monitor"], runs["bare"]
    whole_arm = "monitor, 2 contact points and 4 links"
    a, b = (float(np.median([100.0 * run.cpu for run in side])) for side in (runs[whole_arm], monitor))
    row("CPU at 1 kHz, 2 contact points and 4 links", a, "1 contact point", b, "%", "<= 2")
    for node in ("bare", "bare, verdict QoS"):
        sides = monitor, runs[node]
        for label, q in (("p50", 50), ("p99", 99), ("p99.9", 99.9)):
            a, b = (float(np.median([np.percentile(run.latency_us, q) for run in side])) for side in sides)
            row(f"latency {label} at 1 kHz", a, f"{node} node", b, "us", "<= 1.3")
        a, b = (float(np.median([100.0 * run.cpu for run in side])) for side in sides)
        row("CPU at 1 kHz", a, f"{node} node", b, "%", "<= 1.2")
    a, b = (float(np.median([run.resident_mb for run in side])) for side in (monitor, bare))
    row("resident memory", a, "bare node", b, "MB", "<= 1.6")
    lost, bare_lost = (sum(run.sent - run.answered for run in side) for side in (monitor, bare))
    sent = sum(run.sent for run in monitor)
    show("joint states lost", f"{lost} of {sent}", "bare node", str(bare_lost), "", "0")
    for rate, (node, loop) in daq.measure().items():
        what = f"{daq.CHANNELS} force channels at {rate / 1e3:g} kS/s"
        row(f"CPU, {what}", 100.0 * node.cpu, "bare loop", 100.0 * loop.cpu, "%", "<= 2")
        row(f"memory after a minute, {what}", node.memory_after_mb, "before", node.memory_before_mb, "MB", "1.0")
        show(f"samples lost, {what}", f"{node.lost} of {node.samples}", "bare loop", str(loop.lost), "", "0")
    row("recorder, joint states", *_around("mcap's writer", recorder.measure()), "1/s", "")
    run = recorder.measure_live()
    lost = run.sent - run.recorded
    show("recorder, live: lost", f"{lost} of {run.sent}", "", "", "", "0")
    show("recorder, live: CPU", f"{100.0 * run.cpu:.1f} %", "a core", "100 %", f"{run.cpu:.2f}", "<= 0.5")


def show(what: str, ours: str, against: str, theirs: str, ratio: str, goal: str) -> None:
    """Print one row of the table."""
    print(f"{what:<56} {ours:>14}  {against:<27} {theirs:>13} {ratio:>6}  {goal}", flush=True)  # noqa: T201


def _around(against: str, pair: tuple[float, float]) -> tuple[float, str, float]:
    ours, theirs = pair
    return ours, against, theirs


if __name__ == "__main__":
    main()
