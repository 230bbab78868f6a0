# SPDX-License-Identifier: Apache-2.0
"""Measure daq_node on three channels of simulated force, beside a bare loop that reads the same source."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.qos import QoSProfile
from rclpy.task import Future
from scara_effmass_msgs.msg import ForceBlock
from usage import cpu_s, resident_mb

from scara_effmass.daq import make_source
from scara_effmass.settings import DaqSettings, SimSettings
from scara_effmass.wire.force import decode_force_block

CHANNELS = 3
RATES_HZ = (12_800.0, 128_000.0)
RUN_S = 60.0
WARM_UP_S = 10.0
DISCOVERY_S = 20.0


class Run(NamedTuple):
    """One minute of force: received and lost samples, CPU [share of a core], memory [MB]."""

    samples: int
    lost: int
    cpu: float
    memory_before_mb: float
    memory_after_mb: float


def measure() -> dict[float, tuple[Run, Run]]:
    """Return the run of the node and that of the bare loop at each rate [Hz]."""
    return {rate: (_run_node(rate), _run_bare_loop(rate)) for rate in RATES_HZ}


def _run_node(rate: float) -> Run:
    settings = {"source": "sim", "sim.channels": CHANNELS, "sim.sample_rate": rate}
    arguments = [argument for name, value in settings.items() for argument in ("-p", f"{name}:={value}")]
    executable = str(Path(sys.executable).with_name("daq_node"))
    process = subprocess.Popen([executable, "--ros-args", *arguments], stderr=subprocess.DEVNULL)  # noqa: S603 - fixed command
    rclpy.init()
    node = rclpy.create_node("listener")
    counters = [_SampleCounter() for _ in range(CHANNELS)]
    for number, counter in enumerate(counters):
        topic = f"force/sim{number}" if number else "force"
        node.create_subscription(ForceBlock, topic, counter.add, QoSProfile(depth=1000), raw=True)
    executor = EventsExecutor()
    executor.add_node(node)
    try:
        deadline = time.monotonic() + DISCOVERY_S
        while not all(counter.samples for counter in counters):
            executor.spin_until_future_complete(Future(), timeout_sec=0.1)
            if time.monotonic() > deadline or process.poll() is not None:
                raise RuntimeError(f"daq_node published nothing within {DISCOVERY_S:g} s")
        executor.spin_until_future_complete(Future(), timeout_sec=WARM_UP_S)
        before_mb, start_cpu_s, start_s = resident_mb(process.pid), cpu_s(process.pid), time.monotonic()
        for counter in counters:
            counter.samples = counter.lost = 0
        executor.spin_until_future_complete(Future(), timeout_sec=RUN_S)
        cpu = (cpu_s(process.pid) - start_cpu_s) / (time.monotonic() - start_s)
        samples, lost = (sum(getattr(counter, name) for counter in counters) for name in ("samples", "lost"))
        return Run(samples, lost, cpu, before_mb, resident_mb(process.pid))
    finally:
        node.destroy_node()
        rclpy.shutdown()
        process.send_signal(signal.SIGINT)
        process.wait(timeout=10)


class _SampleCounter:
    """Counts the samples of one channel, and gaps in their numbers."""

    def __init__(self) -> None:
        self.samples = self.lost = 0
        self._next: int | None = None

    def add(self, data: bytes) -> None:
        block = decode_force_block(data)
        if self._next is not None:
            self.lost += block.first_sample - self._next
        self.samples += len(block.force)
        self._next = block.first_sample + len(block.force)


def _run_bare_loop(rate: float) -> Run:
    """Run `bare_loop` in a process of its own."""
    command = [sys.executable, __file__, str(rate)]
    result = subprocess.run(command, capture_output=True, text=True, check=True)  # noqa: S603 - this file
    samples, lost, *rest = (float(number) for number in result.stdout.split())
    return Run(int(samples), int(lost), *rest)


def bare_loop(rate: float) -> Run:
    """Read the source for a minute and discard the samples."""
    sim = SimSettings(channels=CHANNELS, sample_rate=rate)
    source = make_source(DaqSettings(source="sim", sim=sim), time.time_ns)
    source.start()
    samples = lost = 0
    start_cpu_s = start_s = before_mb = 0.0
    end_s = time.monotonic() + WARM_UP_S + RUN_S
    while (now := time.monotonic()) < end_s:
        if not start_s and now > end_s - RUN_S:
            samples = lost = 0
            start_cpu_s, start_s, before_mb = cpu_s(os.getpid()), now, resident_mb(os.getpid())
        reading = source.read(1.0)
        if reading is not None:
            samples += reading.samples.size
            lost += reading.lost
    cpu = (cpu_s(os.getpid()) - start_cpu_s) / (time.monotonic() - start_s)
    source.close()
    return Run(samples, lost, cpu, before_mb, resident_mb(os.getpid()))


if __name__ == "__main__":
    print(*bare_loop(float(sys.argv[1])))  # noqa: T201 - read by `measure`
