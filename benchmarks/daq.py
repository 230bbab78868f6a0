"""(d) The force node on simulated force, three channels, against a bare loop that reads the same source."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.qos import QoSProfile
from rclpy.task import Future
from scara_effmass_msgs.msg import ForceBlock
from usage import cpu_s, resident_mb

from scara_effmass.daq.source import make_source
from scara_effmass.settings import DaqSettings, ForceSourceKind, SimSettings
from scara_effmass.wire.force import decode_force_block

if TYPE_CHECKING:
    from collections.abc import Sequence

CHANNELS = 3
RATES_HZ = (12_800.0, 128_000.0)
RUN_S = 60.0
WARM_UP_S = 10.0
DISCOVERY_S = 20.0


class Run(NamedTuple):
    """One minute of force: samples that came and that are missing, CPU [share of a core], memory [MB]."""

    samples: int
    lost: int
    cpu: float
    memory_before_mb: float
    memory_after_mb: float


def measure() -> dict[float, tuple[Run, Run]]:
    """Return the node's and the bare loop's run at each rate."""
    return {rate: (_node(rate), _started([sys.executable, __file__, str(rate)])) for rate in RATES_HZ}


def _node(rate: float) -> Run:
    settings = {"source": "sim", "sim.channels": CHANNELS, "sim.sample_rate": rate}
    words = [word for name, value in settings.items() for word in ("-p", f"{name}:={value}")]
    executable = str(Path(sys.executable).with_name("daq_node"))
    process = subprocess.Popen([executable, "--ros-args", *words], stderr=subprocess.DEVNULL)  # noqa: S603 - our own
    rclpy.init()
    node = rclpy.create_node("listener")
    counts = [_Count() for _ in range(CHANNELS)]
    for number, count in enumerate(counts):
        topic = f"force/sim{number}" if number else "force"
        node.create_subscription(ForceBlock, topic, count.add, QoSProfile(depth=1000), raw=True)
    executor = EventsExecutor()
    executor.add_node(node)
    try:
        deadline = time.monotonic() + DISCOVERY_S
        while not all(count.samples for count in counts):
            executor.spin_until_future_complete(Future(), timeout_sec=0.1)
            if time.monotonic() > deadline or process.poll() is not None:
                raise RuntimeError("daq_node did not come up")
        executor.spin_until_future_complete(Future(), timeout_sec=WARM_UP_S)
        before, used, began = resident_mb(process.pid), cpu_s(process.pid), time.monotonic()
        for count in counts:
            count.samples = count.lost = 0
        executor.spin_until_future_complete(Future(), timeout_sec=RUN_S)
        cpu = (cpu_s(process.pid) - used) / (time.monotonic() - began)
        samples, lost = (sum(getattr(count, name) for count in counts) for name in ("samples", "lost"))
        return Run(samples, lost, cpu, before, resident_mb(process.pid))
    finally:
        node.destroy_node()
        rclpy.shutdown()
        process.send_signal(signal.SIGINT)
        process.wait(timeout=10)


class _Count:
    """Counts the samples of one channel, and those that its numbering shows to be missing."""

    def __init__(self) -> None:
        self.samples = self.lost = 0
        self._next: int | None = None

    def add(self, data: bytes) -> None:
        block = decode_force_block(data)
        if self._next is not None:
            self.lost += block.first_sample - self._next
        self.samples += len(block.force)
        self._next = block.first_sample + len(block.force)


def _started(command: Sequence[str]) -> Run:
    done = subprocess.run(command, capture_output=True, text=True, check=True)  # noqa: S603 - this file
    samples, lost, *rest = (float(word) for word in done.stdout.split())
    return Run(int(samples), int(lost), *rest)


def bare_loop(rate: float) -> Run:
    """Read the source for a minute and do nothing with what comes."""
    sim = SimSettings(channels=CHANNELS, sample_rate=rate)
    source = make_source(DaqSettings(source=ForceSourceKind.SIM, sim=sim), time.time_ns)
    source.start()
    samples = lost = 0
    used, began, before = 0.0, 0.0, 0.0
    ends = time.monotonic() + WARM_UP_S + RUN_S
    while (now := time.monotonic()) < ends:
        if not began and now > ends - RUN_S:
            samples = lost = 0
            used, began, before = cpu_s(os.getpid()), now, resident_mb(os.getpid())
        reading = source.read(1.0)
        if reading is not None:
            samples += reading.samples.size
            lost += reading.lost
    cpu = (cpu_s(os.getpid()) - used) / (time.monotonic() - began)
    source.close()
    return Run(samples, lost, cpu, before, resident_mb(os.getpid()))


if __name__ == "__main__":
    print(*bare_loop(float(sys.argv[1])))  # noqa: T201 - read by `measure`
