"""(e) The recorder: messages per second beside the bare writer of mcap, and live at 1 kHz with force blocks."""

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
    """A live recording: messages sent and recorded, CPU [share of a core], memory [MB]."""

    sent: int
    recorded: int
    counted_lost: int
    cpu: float
    memory_mb: float


def measure() -> tuple[float, float]:
    """Return the median rate [messages/s] without loss of our recording and of the bare writer, both in zstd."""
    random = np.random.default_rng(1)
    values = random.normal(size=(MESSAGES, 8))
    messages = [joint_state_message(JointState(START_NS, NAMES, row[:4], row[4:])) for row in values]
    ours, theirs = [], []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(ROUNDS):
            ours.append(MESSAGES / _record(Path(folder) / f"ours{number}", messages))
            theirs.append(MESSAGES / _write(Path(folder) / f"theirs{number}.mcap", messages))
    return float(np.median(ours)), float(np.median(theirs))


def _record(folder: Path, messages: list[bytes]) -> float:
    """Return how long it takes until everything is on the disk [s]."""
    options = RecorderOptions(queue_messages=MESSAGES, queue_bytes=1 << 30)
    started = time.perf_counter()
    with BagRecorder(folder, options) as recording:
        topic = recording.add_topic("/joint_states", JOINT_STATE)
        for number, data in enumerate(messages):
            recording.write(topic, START_NS + number * STEP_NS, data)
    seconds = time.perf_counter() - started
    if (saved := recording.report().saved) != MESSAGES:
        raise RuntimeError(f"{saved} of {MESSAGES} messages were recorded")
    return seconds


def _write(path: Path, messages: list[bytes]) -> float:
    definition, _ = known_types().generate_msgdef(JOINT_STATE, ros_version=2)
    started = time.perf_counter()
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        schema = writer.register_schema(JOINT_STATE, "ros2msg", definition.encode())
        channel = writer.register_channel("/joint_states", "cdr", schema)
        for number, data in enumerate(messages):
            time_ns = START_NS + number * STEP_NS
            writer.add_message(channel, time_ns, data, time_ns, number)
        writer.finish()
    return time.perf_counter() - started


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

    def connected(self) -> bool:
        """Return whether the recorder listens to both."""
        return all(publisher.get_subscription_count() for publisher in (self._joint_states, self._force))

    def start(self) -> None:
        """Send."""
        for timer in self._timers:
            timer.reset()

    def stop(self) -> None:
        """Send no more."""
        for timer in self._timers:
            timer.cancel()

    def _send_joint_state(self) -> None:
        self._joint_states.publish(self._states[self.sent % len(self._states)])
        self.sent += 1

    def _send_force(self) -> None:
        self._force.publish(self._blocks[self.sent % len(self._blocks)])
        self.sent += 1


def measure_live() -> Run:
    """Return what the recorder makes of 20 s."""
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        command = [str(Path(sys.executable).with_name("scara-effmass")), "record", "-o", str(bag), "--json"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE)  # noqa: S603 - our own
        rclpy.init()
        sender = Sender()
        executor = EventsExecutor()
        executor.add_node(sender)
        try:
            deadline = time.monotonic() + DISCOVERY_S
            while not sender.connected():
                _spin(executor, 0.1)
                if time.monotonic() > deadline or process.poll() is not None:
                    raise RuntimeError("the recorder did not come up")
            sender.start()
            _spin(executor, WARM_UP_S)
            used, started = cpu_s(process.pid), time.monotonic()
            _spin(executor, RUN_S)
            cpu = (cpu_s(process.pid) - used) / (time.monotonic() - started)
            memory_mb = resident_mb(process.pid)
            sender.stop()
            _spin(executor, SETTLE_S)
        finally:
            sent = sender.sent
            sender.destroy_node()
            rclpy.shutdown()
            process.send_signal(signal.SIGINT)
            output, _ = process.communicate(timeout=20)
        with open_bag(bag) as recording:
            recorded = sum(1 for _ in recording.messages())
        return Run(sent, recorded, int(json.loads(output)["lost"]), cpu, memory_mb)


def _spin(executor: EventsExecutor, seconds: float) -> None:
    executor.spin_until_future_complete(Future(), timeout_sec=seconds)


if __name__ == "__main__":
    rate, bare = measure()
    live = measure_live()
    sys.stdout.write(f"{rate:,.0f} messages/s, bare writer {bare:,.0f}, ratio {rate / bare:.2f}\n")
    sys.stdout.write(f"{live}\n")
