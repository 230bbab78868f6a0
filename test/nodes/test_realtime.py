# SPDX-License-Identifier: Apache-2.0
"""`thread_priority`: real-time scheduling and locked memory, or one line that says why not; latency in diagnostics."""

import os
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from scara_effmass.nodes.monitor_health import Latencies
from test.nodes.conftest import MONITOR_NODE, NodeHarness

MS = 1_000_000
WITHOUT = ("setpriv", "--bounding-set", "-sys_nice,-ipc_lock,-sys_resource")


def input_values(harness: NodeHarness) -> dict[str, str]:
    status = harness.diagnostics[-1].status[0]
    return {pair.key: pair.value for pair in status.values}


def test_latencies_count_in_a_histogram_and_late_answers() -> None:
    latencies = Latencies()
    for i in range(1, 101):
        latencies.add(i * MS // 10, i * MS)
    assert latencies.report() == {"p50": 5100.0, "p99": 9900.0, "p99.9": 10000.0, "max": 10000.0}
    counts = "<=125: 1, <=250: 1, <=500: 3, <=1000: 5, <=2000: 10, <=4000: 20, <=8000: 40, <=16000: 20, >16000: 0"
    assert latencies.histogram == counts
    assert latencies.missed == 90
    assert latencies.report() == {}
    assert latencies.histogram == counts


def test_latencies_keep_bounded_memory_and_count_no_repeated_stamp_as_late() -> None:
    latencies = Latencies()
    for _ in range(20_000):
        latencies.add(MS // 2, MS)
    latencies.report()
    assert "<=500: 10000," in latencies.histogram
    assert latencies.missed == 0


@pytest.mark.live
def test_realtime_where_permitted(new_harness: Callable[..., NodeHarness]) -> None:
    harness = new_harness()
    process = harness.start("--ros-args", "-p", "thread_priority:=3")
    harness.subscribe_until_ok()
    harness.spin_until(lambda: harness.diagnostics and "latency p50 [us]" in input_values(harness))
    values = input_values(harness)
    assert 0 < int(values["latency max [us]"]) < 1_000_000  # from the arrival, on one clock
    assert "missed deadlines" in values
    policies = {os.sched_getscheduler(int(task.name)) for task in Path(f"/proc/{process.pid}/task").iterdir()}
    locked = int(re.findall(r"VmLck:\s+(\d+)", Path(f"/proc/{process.pid}/status").read_text(encoding="ascii"))[0])
    process.terminate()
    log = process.communicate(timeout=60)[1]
    if os.geteuid() == 0:
        assert policies == {os.SCHED_FIFO}
        assert locked > 0
        assert "SCHED_FIFO at priority 3, memory locked" in log
    else:
        assert "thread_priority = 3" in log or policies == {os.SCHED_FIFO}


@pytest.mark.live
def test_realtime_where_not_permitted(new_harness: Callable[..., NodeHarness]) -> None:
    harness = new_harness()
    command = (*WITHOUT, str(MONITOR_NODE)) if os.geteuid() == 0 else (str(MONITOR_NODE),)
    process = harness.start("--ros-args", "-p", "thread_priority:=99", command=command)
    harness.subscribe_until_ok()
    process.terminate()
    log = process.communicate(timeout=60)[1]
    refusals = [
        line for line in log.splitlines() if "thread_priority = 99: not permitted: SCHED_FIFO needs rtprio 99" in line
    ]
    assert len(refusals) == 1
    assert refusals[0].endswith("locked memory needs memlock unlimited in /etc/security/limits.conf; goes on without")
