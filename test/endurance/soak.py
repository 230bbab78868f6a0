# SPDX-License-Identifier: Apache-2.0
"""`make soak`: run all nodes, the recorder and the dashboard at 1 kHz for a while.

Prints a table of memory, CPU, latency and losses, and writes it into docs/measured.md with --write. Exit status 1 for a
lost joint state, contact state or sample, a process that ended, memory that grows, or a violated property of the
recording. Latency is not judged: it depends on what else the machine does.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

sys.path += [str(Path(__file__).parents[2]), str(Path(__file__).parents[2] / "benchmarks")]

import numpy as np
import rclpy
from live import DISCOVERY_S, Sender
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.task import Future
from usage import cpu_s, resident_mb

from benchmarks.measured_page import write_section
from scara_effmass.analysis.properties import check_recording
from scara_effmass.bags.files import open_bag
from scara_effmass.settings import MonitorSettings

BIN = Path(sys.executable).parent
WARM_UP_S = 10.0
SETTLE_S = 2.0
SAMPLES = 60
FILE_S = 600.0
"""Duration of a file of the recording: the recorder keeps the index of a file in memory, 14 MB in an hour."""
MAX_SLOPE_MB_H = 10.0
DEADLINE = "a verdict comes at least every deadline while active"
"""Stated only, as the latency: a busy machine misses it."""
MIN_GROWTH_MB = 5.0
"""Growth in the second half that is noise in a short run: buffers and Python's heap settle."""
NODES: dict[str, list[Path | str]] = {
    "monitor": [BIN / "monitor_node", "--ros-args", "-p", "contact_points:=['tool']"],
    "daq": [BIN / "daq_node", "--ros-args", "-p", "source:=sim"],
    "validator": [BIN / "validator_node", "--ros-args", "-p", "obstacle_mass:=3.0"],
    "speed_scaling": [BIN / "speed_scaling_node"],
    "visualization": [BIN / "visualization_node"],
    "dashboard": [BIN / "scara-effmass", "dashboard", "--port", "0"],
}


def main() -> int:
    """Run and report."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--duration", type=float, default=3600.0, help="[s]")
    parser.add_argument("--write", action="store_true", help="write the tables into docs/measured.md")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        page, failures = soak(args.duration, Path(folder) / "bag")
    print(page)  # noqa: T201
    if args.write:
        write_section("make soak", page)
    for failure in failures:
        print(f"soak: {failure}", file=sys.stderr)  # noqa: T201
    return 1 if failures else 0


def soak(duration_s: float, bag: Path) -> tuple[str, list[str]]:  # noqa: PLR0915
    """Return the text of the section and what failed."""
    failures: list[str] = []
    rclpy.init()
    sender, executor = Sender(), EventsExecutor()
    sender.stop()  # until all are there: the recorder counts what it misses while it starts
    executor.add_node(sender)

    def spin(seconds: float) -> None:
        executor.spin_until_future_complete(Future(), timeout_sec=seconds)

    processes: dict[str, subprocess.Popen[Any]] = {
        name: subprocess.Popen([*map(str, words)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        for name, words in NODES.items()
    }
    recorder = subprocess.Popen(
        [str(BIN / "scara-effmass"), "record", "-o", str(bag), "--max-duration", str(FILE_S), "--json"],
        stdout=subprocess.PIPE,
        text=True,
    )
    processes["recorder"] = recorder
    try:
        deadline = time.monotonic() + DISCOVERY_S
        while not sender.connected() and time.monotonic() < deadline:
            spin(0.1)
        spin(WARM_UP_S)
        sender.start()
        spin(WARM_UP_S)
        sender.count_from_now()
        first_ns, started = time.time_ns(), time.monotonic()
        used = {name: cpu_s(process.pid) for name, process in processes.items()}
        rows: list[list[float]] = []
        latencies: list[np.ndarray] = []
        answered = 0
        while (elapsed := time.monotonic() - started) < duration_s:
            spin(min(duration_s / SAMPLES, duration_s - elapsed))
            taken, sender.latencies_ns = sender.latencies_ns, []
            answered += len(taken)
            latencies.append(np.array(taken or [0]) / 1e3)
            if ended := [name for name, process in processes.items() if process.poll() is not None]:
                failures.append(f"ended: {', '.join(ended)}")
                break
            rows.append([time.monotonic() - started, *(resident_mb(p.pid) for p in processes.values())])
        seconds = time.monotonic() - started
        cpu = {n: (cpu_s(p.pid) - used[n]) / seconds for n, p in processes.items() if p.poll() is None}
        sender.stop()
        last_ns = time.time_ns()
        spin(SETTLE_S)
        answered += len(sender.latencies_ns)
    finally:
        sender.destroy_node()  # type: ignore[no-untyped-call]
        rclpy.shutdown()
        for process in processes.values():
            process.send_signal(signal.SIGINT)
        report = json.loads(recorder.communicate()[0] or "{}")
        for process in processes.values():
            process.wait(timeout=30)
    lost = {"contact states": sender.sent - answered, **losses(bag, sender.sent, first_ns, last_ns)}
    lost["messages by the recorder's count"] = report.get("lost", -1)
    failures += [f"{count} {name} lost" for name, count in lost.items() if count]
    checks = check_recording(bag, MonitorSettings())
    failures += [str(check) for check in checks if check.violations and check.text != DEADLINE]
    table = np.array(rows)
    half = table[len(table) // 2 :]
    lines = []
    for column, name in enumerate(processes, 1):
        slope_mb_h = 3600.0 * np.polyfit(half[:, 0], half[:, column], 1)[0]
        growth_mb = slope_mb_h * (half[-1, 0] - half[0, 0]) / 3600.0
        if slope_mb_h > MAX_SLOPE_MB_H and growth_mb > MIN_GROWTH_MB:
            failures.append(f"{name}: memory grows by {slope_mb_h:.1f} MB/h")
        begin, end = table[0, column], table[-1, column]
        share = 100.0 * cpu.get(name, np.nan)
        lines.append(f"| {name} | {begin:.1f} | {end:.1f} | {slope_mb_h:+.1f} | {share:.1f} |")
    tenth = max(1, len(latencies) // 10)
    parts = [("first", np.concatenate(latencies[:tenth])), ("last", np.concatenate(latencies[-tenth:]))]
    latency = [f"| {name} tenth | {np.median(x):.0f} | {np.percentile(x, 99):.0f} |" for name, x in parts]
    holding = sum(not check.violations for check in checks)
    git = ["git", "rev-parse", "--short", "HEAD"]
    commit = subprocess.run(git, capture_output=True, text=True, check=False).stdout.strip()
    page = f"""`make soak DURATION={duration_s:.0f}` on {datetime.now(timezone.utc):%Y-%m-%d} at commit {commit}:
all nodes, the recorder (a new file every {FILE_S / 60:.0f} minutes) and the dashboard (without a browser) at 1 kHz,
{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}.
{"Failed: " + "; ".join(failures) if failures else "Passed."}

| process | memory at the start [MB] | at the end [MB] | slope of the second half [MB/h] | CPU [% of a core] |
|---|---|---|---|---|
{chr(10).join(lines)}

| latency from stamp to verdict | p50 [us] | p99 [us] |
|---|---|---|
{chr(10).join(latency)}

| of {sender.sent} joint states | lost |
|---|---|
{chr(10).join(f"| {name} | {count} |" for name, count in lost.items())}

Properties of the recorded verdicts (`assess --properties`): {holding} of {len(checks)} hold.
"""
    return page, failures


def losses(bag: Path, sent: int, first_ns: int, last_ns: int) -> dict[str, int]:
    """Return how many joint states and verdicts the recording lacks, and how many samples the force node lost."""
    stamps: dict[str, set[int]] = {topic: set() for topic in ("/joint_states", "/contact_states")}
    samples = 0
    with open_bag(bag) as opened:
        for raw in opened.messages(["/joint_states", "/contact_states"]):
            stamp_ns = int.from_bytes(raw.data[4:8], "little") * 10**9 + int.from_bytes(raw.data[8:12], "little")
            if first_ns <= stamp_ns <= last_ns:
                stamps[raw.topic].add(stamp_ns)
        samples = sum(block.lost_samples for block in opened.force_blocks("/force"))
    return {
        "joint states in the recording": sent - len(stamps["/joint_states"]),
        "verdicts in the recording": len(stamps["/joint_states"] - stamps["/contact_states"]),
        "force samples": samples,
    }


if __name__ == "__main__":
    sys.exit(main())
