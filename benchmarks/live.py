# SPDX-License-Identifier: Apache-2.0
"""(b) The live monitor at 1 kHz against a bare node that publishes the same message types.

As a program: the same at the rates given [Hz], to see where each of them breaks.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from array import array
from pathlib import Path
from typing import NamedTuple

import numpy as np
import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future
from rich.console import Console
from rich.table import Table
from scara_effmass_msgs.msg import ContactStates
from sensor_msgs.msg import JointState
from usage import cpu_s, resident_mb

RATE_HZ = 1000.0
WARM_UP_S = 5.0  # the monitor loads its kernel meanwhile
RUN_S = 10.0
SETTLE_S = 0.5
ROUNDS = 5
DISCOVERY_S = 20.0
MONITOR = str(Path(sys.executable).with_name("monitor_node"))
TARGETS = {
    # One contact point: one answer to each joint state, as of the bare node.
    "monitor": [MONITOR, "--ros-args", "-p", "contact_points:=['tool']"],
    "monitor, 2 contact points and 4 links": [MONITOR],
    "bare": [sys.executable, str(Path(__file__).with_name("echo_node.py"))],
    "bare, verdict QoS": [sys.executable, str(Path(__file__).with_name("echo_node.py")), "verdict_qos"],
}


class Run(NamedTuple):
    """One run: message counts, latency from stamp to answer [us], CPU [share of a core], memory [MB]."""

    sent: int
    answered: int
    latency_us: np.ndarray
    cpu: float
    resident_mb: float


def measure(rate_hz: float = RATE_HZ) -> dict[str, list[Run]]:
    """Return the runs of all targets at `rate_hz`, taken in turn."""
    runs: dict[str, list[Run]] = {name: [] for name in TARGETS}
    for _ in range(ROUNDS):
        for name, command in TARGETS.items():
            runs[name].append(_run(command, rate_hz))
    return runs


class Sender(Node):
    """Publish joint states of a sweeping arm and measure the time to each answer."""

    def __init__(self, rate_hz: float = RATE_HZ) -> None:
        super().__init__("sender")
        self._publisher = self.create_publisher(JointState, "joint_states", QoSProfile(depth=200))
        self._state = JointState(name=["joint1", "joint2", "joint3", "joint4"])
        self._motion = _motion(1.0 / rate_hz)
        self._step = 0
        self.sent = 0
        self.latencies_ns: list[int] = []
        self._first_ns = 0
        self.create_subscription(ContactStates, "contact_states", self._on_answer, QoSProfile(depth=200))
        self._timer = self.create_timer(1.0 / rate_hz, self._send)

    def connected(self) -> bool:
        """Return whether the target has subscribed to the joint states and publishes contact states."""
        return self._publisher.get_subscription_count() > 0 and self.count_publishers("contact_states") > 0

    def count_from_now(self) -> None:
        """Discard the counts of the warm-up."""
        self.sent = 0
        self.latencies_ns = []
        self._first_ns = time.time_ns()

    def stop(self) -> None:
        """Stop sending; answers that arrive later still count."""
        self._timer.cancel()

    def start(self) -> None:
        """Send again."""
        self._timer.reset()

    def _send(self) -> None:
        self._step = (self._step + 1) % len(self._motion)
        self._state.position, self._state.velocity = self._motion[self._step]
        stamp_ns = time.time_ns()
        self._state.header.stamp.sec, self._state.header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
        self._publisher.publish(self._state)
        self.sent += 1

    def _on_answer(self, answer: ContactStates) -> None:
        now_ns = time.time_ns()
        stamp_ns = answer.header.stamp.sec * 1_000_000_000 + answer.header.stamp.nanosec
        # Contact states from the watchdog answer no joint state.
        if stamp_ns >= self._first_ns and not answer.watchdog:
            self.latencies_ns.append(now_ns - stamp_ns)


def _motion(period_s: float) -> list[tuple[array[float], array[float]]]:
    """Return the positions and velocities of one sweep, `period_s` apart."""
    t = np.arange(0.0, 2.0 * np.pi, period_s)
    still, slow = np.full_like(t, 0.2), np.full_like(t, 1e-6)
    q = np.column_stack([np.sin(t), 1.0 + 0.8 * np.sin(t), still, np.sin(t)])
    qd = np.column_stack([np.cos(t), 0.8 * np.cos(t), slow, np.cos(t)])
    return [(array("d", a), array("d", b)) for a, b in zip(q, qd, strict=True)]


def _run(command: list[str], rate_hz: float) -> Run:
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen(command, **quiet)  # noqa: S603 - a fixed command
    rclpy.init()
    sender = Sender(rate_hz)
    executor = EventsExecutor()
    executor.add_node(sender)
    try:
        deadline = time.monotonic() + DISCOVERY_S
        while not sender.connected():
            _spin(executor, 0.1)
            if time.monotonic() > deadline or process.poll() is not None:
                raise RuntimeError(f"{command[-1]} did not come up")
        _spin(executor, WARM_UP_S)
        sender.count_from_now()
        used, started = cpu_s(process.pid), time.monotonic()
        _spin(executor, RUN_S)
        cpu = (cpu_s(process.pid) - used) / (time.monotonic() - started)
        sender.stop()
        _spin(executor, SETTLE_S)
        return Run(
            sender.sent, len(sender.latencies_ns), np.array(sender.latencies_ns) / 1e3, cpu, resident_mb(process.pid)
        )
    finally:
        sender.destroy_node()
        rclpy.shutdown()
        process.send_signal(signal.SIGINT)
        process.wait(timeout=10)


def _spin(executor: EventsExecutor, seconds: float) -> None:
    executor.spin_until_future_complete(Future(), timeout_sec=seconds)


def main(rates_hz: list[float]) -> None:
    """Print a table of what each target answers at `rates_hz`, medians of ROUNDS runs."""
    table = Table(title=f"live at {', '.join(f'{rate:g}' for rate in rates_hz)} Hz")
    for column in ("rate [Hz]", "node", "sent [1/s]", "lost", "CPU [%]", "p50 [us]", "p99 [us]", "p99.9 [us]"):
        table.add_column(column, justify="left" if column == "node" else "right")
    for rate in rates_hz:
        for name, of in measure(rate).items():
            lost, sent = (
                np.median([value(run) for run in of]) for value in (lambda r: r.sent - r.answered, lambda r: r.sent)
            )
            latencies = np.median([np.percentile(run.latency_us, (50, 99, 99.9)) for run in of], axis=0)
            cpu = 100.0 * np.median([run.cpu for run in of])
            table.add_row(
                f"{rate:g}", name, f"{sent / RUN_S:.0f}", f"{lost:.0f}", f"{cpu:.1f}", *(f"{x:.0f}" for x in latencies)
            )
    Console(width=100).print(table)


if __name__ == "__main__":
    main([float(rate) for rate in sys.argv[1:]] or [RATE_HZ])
