# SPDX-License-Identifier: Apache-2.0
"""`make scale`: assess recordings with 1 and 2 worker processes, one killed midway, one out of memory; a table."""

from __future__ import annotations

import argparse
import hashlib
import logging
import math
import os
import signal
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from distributed import Client, LocalCluster
from measured_page import write_section

from scara_effmass.analysis.dataset import BagTask, assess_part
from scara_effmass.bags.writer import BagWriter
from scara_effmass.cli.tasks import Advance, open_run
from scara_effmass.errors import EffmassError
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import JointState

WORKERS, MEMORY_GB = 2, 1.5
HOG = Path("a recording that needs more memory")
NAMES = tuple(f"joint{number}" for number in range(1, 5))


def write_bag(path: Path, start_ns: int, states: int) -> None:
    """Write joint states of the shipped SCARA at 1 kHz."""
    rates, sizes = np.linspace(0.28, 0.52, 4), np.array([0.5, 0.5, 0.03, 0.5])
    middle = np.array([0.0, 1.0, 0.1, 0.0])
    stamps = start_ns + 1_000_000 * np.arange(states)
    phases = np.outer(np.arange(states) / 1000.0, rates)
    rows = zip(stamps.tolist(), middle + sizes * np.sin(phases), sizes * rates * np.cos(phases), strict=True)
    with BagWriter(path) as bag:
        bag.write_joint_states("/joint_states", (JointState(stamp, NAMES, q, qd) for stamp, q, qd in rows))


def assess(folder: Path, path: Path, _advance: Advance) -> int:
    """Assess a recording into the dataset `folder`; return the number of joint states."""
    hog = b""
    while path == HOG:  # until the end of the process
        hog += bytes(50_000_000)
        time.sleep(0.01)
    task = BagTask(MonitorSettings())
    return assess_part(folder, task, path, lambda *_: None, cell="A7", overwrite=False).counts["joint_states"]


def peak_mb() -> float:
    """Return the peak memory of this process [MB]."""
    text = Path("/proc/self/status").read_text(encoding="ascii")
    return float(text.split("VmHWM:")[1].split()[0]) / 1e3


def run(workers: int, bags: list[Path], warm: Path, *, kills: bool = False) -> dict[str, Any]:
    """Return time [s], counts, memory [MB] and a hash of the dataset of `bags`, by `workers` processes.

    `kills`: the process of one worker is killed after the first result.
    """
    local: dict[str, Any] = {"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0", "silence_logs": logging.CRITICAL}
    local |= {"n_workers": workers, "threads_per_worker": 1, "memory_limit": round(MEMORY_GB * 1e9)}
    with (
        tempfile.TemporaryDirectory() as folder,
        LocalCluster(**local) as cluster,  # type: ignore[no-untyped-call]
        Client(cluster) as client,  # type: ignore[no-untyped-call]
        open_run(argparse.Namespace(scheduler=cluster.scheduler_address, jobs=None), "recordings") as run_tasks,
    ):
        pids = [*client.run(os.getpid).values()]
        client.run(assess, Path(folder) / "warm", warm, None)  # loads modules and kernel
        cpu = time.process_time() + sum(client.run(time.process_time).values())
        started = time.perf_counter()
        outcomes: list[int | EffmassError] = []
        for outcome in run_tasks(partial(assess, Path(folder) / "all"), bags):
            outcomes.append(outcome)
            if kills and len(outcomes) == 1:
                os.kill(pids[0], signal.SIGKILL)
        seconds = time.perf_counter() - started
        cores = peak = math.nan  # of processes that ended nothing is known
        if not kills and HOG not in bags:
            cores = (time.process_time() + sum(client.run(time.process_time).values()) - cpu) / seconds
            peak = max(client.run(peak_mb).values())
        files = sorted((Path(folder) / "all").rglob("*.parquet"))
        return {
            "seconds": seconds,
            "cores": cores,
            "states": sum(outcome for outcome in outcomes if isinstance(outcome, int)),
            "errors": [outcome for outcome in outcomes if isinstance(outcome, EffmassError)],
            "peak_mb": peak,
            "dataset": hashlib.sha256(b"".join(path.name.encode() + path.read_bytes() for path in files)).hexdigest(),
        }


def table(number: int, states: int) -> str:
    """Write `number` recordings with as many `states`, run all cases, and return the table."""
    with tempfile.TemporaryDirectory() as folder:
        bags = [Path(folder) / f"{index}" for index in range(number + 1)]
        for index, bag in enumerate(bags):
            write_bag(bag, 10**18 + 10**14 * index, states)
        warm = bags.pop()
        cases = {
            "1": run(1, bags, warm),
            f"{WORKERS}": run(WORKERS, bags, warm),
            f"{WORKERS}, one killed midway": run(WORKERS, bags, warm, kills=True),
            f"{WORKERS}, a task needs more than their {MEMORY_GB} GB": run(WORKERS, [HOG, *bags], warm),
        }
    load = ", ".join(f"{mean:.1f}" for mean in os.getloadavg())
    lines = [
        f"{number} recordings of {states:,} joint states, {os.cpu_count()} cores, load average {load} at the end:",
        "",
        "| worker processes | time | joint states/s | speed-up | cores used | peak memory each | dataset | bad |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name, case in cases.items():
        same = "the same" if case["dataset"] == cases["1"]["dataset"] else "DIFFERENT"
        rate, faster = case["states"] / case["seconds"], cases["1"]["seconds"] / case["seconds"]
        known = not math.isnan(case["cores"])
        cores, peak = (f"{case['cores']:.1f}", f"{case['peak_mb']:.0f} MB") if known else ("", "")
        bad = "; ".join(str(error).split(": must")[0] for error in case["errors"]) or "none"
        lines.append(
            f"| {name} | {case['seconds']:.1f} s | {rate:,.0f} | {faster:.2f} | {cores} | {peak} | {same} | {bad} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Print the table; with --write, also into docs/measured.md."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bags", type=int, default=16)
    parser.add_argument("--states", type=int, default=300_000, help="joint states of each (default: five minutes)")
    parser.add_argument("--write", action="store_true", help="write the table into docs/measured.md")
    args = parser.parse_args()
    text = table(args.bags, args.states)
    sys.stdout.write(f"{text}\n")
    if args.write:
        write_section("make scale", text)


if __name__ == "__main__":
    main()
