# SPDX-License-Identifier: Apache-2.0
"""(e) The recorder: its rate compared with the writer of `mcap`, and a live recording at 1 kHz with force blocks."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import rclpy
from mcap.writer import Writer
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from rclpy.task import Future
from scara_effmass_msgs.msg import ForceBlock
from sensor_msgs.msg import JointState as JointStateMessage
from usage import cpu_s, resident_mb

from scara_effmass.bags.definitions import known_types
from scara_effmass.bags.files import open_bag
from scara_effmass.bags.recorder import BagRecorder, RecorderOptions
from scara_effmass.values import JointState
from scara_effmass.wire.joint_state import joint_state_message
from scara_effmass.wire.message_types import JOINT_STATE

MESSAGES = 200_000
ROUNDS = 3
NAMES = ("joint1", "joint2", "joint3", "joint4")
START_NS, STEP_NS = 1_700_000_000_000_000_000, 1_000_000
RUN_S = 20.0
WARM_UP_S = 2.0
SETTLE_S = 1.0
DISCOVERY_S = 20.0
JOINT_PERIOD_S, FORCE_PERIOD_S = 0.001, 0.1
BLOCK = 1280


class Run(NamedTuple):
    """Result of a live recording: message counts, CPU [share of a core], memory [MB]."""

    sent: int
    recorded: int
    counted_lost: int
    cpu: float
    memory_mb: float


def measure() -> tuple[float, float]:
    """Return the median rates [messages/s] of the recorder and of the writer of `mcap`, both with zstd."""
    random = np.random.default_rng(1)
    values = random.normal(size=(MESSAGES, 8))
    messages = [joint_state_message(JointState(START_NS, NAMES, row[:4], row[4:])) for row in values]
    recorder_rates, writer_rates = [], []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(ROUNDS):
            recorder_rates.append(MESSAGES / _record(Path(folder) / f"bag{number}", messages))
            writer_rates.append(MESSAGES / _write(Path(folder) / f"bag{number}.mcap", messages))
    return float(np.median(recorder_rates)), float(np.median(writer_rates))


def _record(folder: Path, messages: list[bytes]) -> float:
    """Return the time [s] until all messages are on the disk."""
    options = RecorderOptions(queue_messages=MESSAGES, queue_bytes=1 << 30)
    start = time.perf_counter()
    with BagRecorder(folder, options) as recorder:
        topic = recorder.add_topic("/joint_states", JOINT_STATE)
        for number, data in enumerate(messages):
            recorder.write(topic, START_NS + number * STEP_NS, data)
    seconds = time.perf_counter() - start
    if (saved := recorder.report().saved) != MESSAGES:
        raise RuntimeError(f"{saved} of {MESSAGES} messages were recorded")
    return seconds


def _write(path: Path, messages: list[bytes]) -> float:
    """Return the time [s] to write the messages with `mcap`."""
    definition, _ = known_types().generate_msgdef(JOINT_STATE, ros_version=2)
    start = time.perf_counter()
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        schema = writer.register_schema(JOINT_STATE, "ros2msg", definition.encode())
        channel = writer.register_channel("/joint_states", "cdr", schema)
        for number, data in enumerate(messages):
            time_ns = START_NS + number * STEP_NS
            writer.add_message(channel, time_ns, data, time_ns, number)
        writer.finish()
    return time.perf_counter() - start


class Sender(Node):
    """Publishes joint states at 1 kHz and force blocks of 1280 samples at 10 Hz."""

    def __init__(self) -> None:
        super().__init__("sender")
        random = np.random.default_rng(2)
        self._joint_states = self.create_publisher(JointStateMessage, "joint_states", QoSProfile(depth=1000))
        self._force = self.create_publisher(ForceBlock, "force", QoSProfile(depth=100))
        self._states = [
            joint_state_message(JointState(START_NS, NAMES, row[:4], row[4:])) for row in random.normal(size=(997, 8))
        ]
        blocks = (ForceBlock(sample_rate=12800.0, force=random.normal(size=BLOCK)) for _ in range(97))
        self._blocks = [bytes(serialize_message(block)) for block in blocks]
        self.sent = 0
        self._timers = [
            self.create_timer(JOINT_PERIOD_S, self._send_joint_state),
            self.create_timer(FORCE_PERIOD_S, self._send_force),
        ]
        for timer in self._timers:
            timer.cancel()

    def is_connected(self) -> bool:
        """Whether both topics have a subscription."""
        return all(publisher.get_subscription_count() for publisher in (self._joint_states, self._force))

    def start(self) -> None:
        """Start publishing."""
        for timer in self._timers:
            timer.reset()

    def stop(self) -> None:
        """Stop publishing."""
        for timer in self._timers:
            timer.cancel()

    def _send_joint_state(self) -> None:
        self._joint_states.publish(self._states[self.sent % len(self._states)])
        self.sent += 1

    def _send_force(self) -> None:
        self._force.publish(self._blocks[self.sent % len(self._blocks)])
        self.sent += 1


def measure_live() -> Run:
    """Record 20 s of live messages."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bag"
        command = [str(Path(sys.executable).with_name("scara-effmass")), "record", "-o", str(path), "--json"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE)  # noqa: S603 - fixed command
        rclpy.init()
        sender = Sender()
        executor = EventsExecutor()
        executor.add_node(sender)
        try:
            deadline = time.monotonic() + DISCOVERY_S
            while not sender.is_connected():
                _spin(executor, 0.1)
                if time.monotonic() > deadline or process.poll() is not None:
                    raise RuntimeError("the recorder did not subscribe")
            sender.start()
            _spin(executor, WARM_UP_S)
            start_cpu_s, start_s = cpu_s(process.pid), time.monotonic()
            _spin(executor, RUN_S)
            cpu = (cpu_s(process.pid) - start_cpu_s) / (time.monotonic() - start_s)
            memory_mb = resident_mb(process.pid)
            sender.stop()
            _spin(executor, SETTLE_S)
        finally:
            sent = sender.sent
            sender.destroy_node()
            rclpy.shutdown()
            process.send_signal(signal.SIGINT)
            output, _ = process.communicate(timeout=20)
        with open_bag(path) as bag:
            recorded = sum(1 for _ in bag.messages())
        return Run(sent, recorded, int(json.loads(output)["lost"]), cpu, memory_mb)


def _spin(executor: EventsExecutor, seconds: float) -> None:
    executor.spin_until_future_complete(Future(), timeout_sec=seconds)


if __name__ == "__main__":
    rate, writer_rate = measure()
    live = measure_live()
    sys.stdout.write(f"{rate:,.0f} messages/s, mcap writer {writer_rate:,.0f}, ratio {rate / writer_rate:.2f}\n")
    sys.stdout.write(f"{live}\n")
