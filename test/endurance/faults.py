# SPDX-License-Identifier: Apache-2.0
"""`make faults`: inject faults into live nodes one by one and measure what follows. Pytest runs it only when named.

Each entry of a table is one fault: what is injected, and what must happen. A node gets valid input, then the fault,
then valid input again. Counted are permissive outputs that follow from bad input, the time until the node and until a
subscriber know, the recovery without a restart, and messages that the recorder lost. docs/measured.md gets the table.
"""

import math
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, suppress
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, final

import pytest
from control_msgs.msg import SpeedScalingFactor
from geometry_msgs.msg import Inertia, Vector3
from lifecycle_msgs.msg import Transition
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from scara_effmass_msgs.msg import ContactState, ContactStates, ForceBlock, Impact, ImpactValidation, RunInfo
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from benchmarks.measured_page import write_section
from scara_effmass.analysis.properties import check_recording
from scara_effmass.bags.files import open_bag
from scara_effmass.bags.repair import repair
from scara_effmass.errors import DecodeError
from scara_effmass.nodes.cell_client import CellClient
from scara_effmass.nodes.ros import qos_profile
from scara_effmass.safety import unknown_contact
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import Impact as ImpactValue
from scara_effmass.values import Verdict
from scara_effmass.wire import topics
from scara_effmass.wire.contact_states import ContactStatesEncoder
from scara_effmass.wire.force import impact_message
from test.decisions import assessments_of, decision_on
from test.nodes.conftest import (
    JOINTS,
    NodeHarness,
    Q,
    joint_state,
    localhost_only,  # noqa: F401 - a fixture
    ros_node,
    stamp_ns,
)
from test.nodes.test_flood import FLOODER
from test.nodes.test_monitor_end import ONE_LINK
from test.nodes.test_monitor_input import INVALID

PERIOD_S = 0.01
TIMEOUT_S = 0.5
"""`timeout` of the monitor."""
WATCHDOG_S = TIMEOUT_S / 4
SCHEDULING_S = 0.1
"""Allowance for other programs on the machine."""
BOUND_S = TIMEOUT_S + WATCHDOG_S + PERIOD_S + SCHEDULING_S
MAX_AGE_S = TIMEOUT_S + SCHEDULING_S
"""Of a permissive state when it is published."""
LOST_S = 2 * TIMEOUT_S + PERIOD_S + SCHEDULING_S
"""Deadline and lease, by which a subscriber notices a monitor that is gone."""
HOLD_S = 0.4
RECOVERY_S = 20.0
S = 1_000_000_000
NAN = float("nan")
PERMISSIVE = {ContactState.OK, ContactState.WARN}
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
DEEP = QoSProfile(depth=20_000)
BIN = Path(sys.executable).parent
EXAMPLE = Path(__file__).parents[2] / "examples" / "verdict_consumer.py"
DEADLINE_PROPERTY = "a verdict comes at least every deadline while active"

Messages = list[JointState | bytes]
Inject = Callable[["Cell"], AbstractContextManager[object]]


MUST = {
    "UNKNOWN": "UNKNOWN, of speed_scaling 0",
    "lost": "the subscriber misses the deadline, or the lease ends",
    "continues": "the output continues",
    "by the deadline": "0 at the latest when the deadline of 2 time-outs has passed",
    "recovers": "recovers when the fault is over",
    "fresh": "the output continues; nothing permissive is older than the time-out",
    "silent": "no output",
}


IMMEDIATE = ("UNKNOWN", "lost", "by the deadline")
"""Something must come, and in time."""


class Fault(NamedTuple):
    """A fault, and what must happen (MUST)."""

    on: str
    injected: str
    must: str
    inject: Inject
    bad_input: bool = True
    """All input is bad while the fault lasts: nothing permissive may come."""


class Result(NamedTuple):
    fault: Fault
    permissive: int
    said_s: float
    known_s: float
    recovery_s: float
    lost: int
    failure: str


class Output(NamedTuple):
    time_s: float
    source_s: float
    is_permissive: bool
    stamp_ns: int
    key: object

    @property
    def age_s(self) -> float:
        return self.source_s - self.stamp_ns / 1e9


def _key(message: ContactStates) -> object:
    """Return what a recording must hold of `message`."""
    return stamp_ns(message), tuple((c.contact_point, c.verdict, c.reason) for c in message.contacts)


RESULTS: list[Result] = []
PROPERTIES: list[str] = []
RECORD = (sys.executable, "-m", "scara_effmass", "record")


@final
class Cell:
    """A node with a publisher of its input each `PERIOD_S`, and a subscriber that notes its output and its loss."""

    def __init__(self, harness: NodeHarness, command: tuple[str, ...], kind: type, topic: str, qos: QoSProfile) -> None:
        self.harness, self.node = harness, harness.node
        self.command = command
        self.outputs: list[Output] = []
        self.lost_s: list[float] = []
        self.bad_stamps: set[int] = set()
        self.sources: dict[str, Any] = {}
        """What additional publishers send."""
        self.on_sources: Callable[[], None] = lambda: None
        self.begin_s = 0.0
        self.min_outputs = 10
        self.has_age = kind is ContactStates
        self.healthy: Callable[[], Messages] = lambda: [joint_state()]
        self.messages = self._healthy
        self.is_permissive: Callable[[Any], bool] = lambda message: message.verdict in PERMISSIVE
        self.send: Callable[[Any], None] = harness.send
        self.node.create_timer(PERIOD_S, self._tick)
        patience = Duration(seconds=2 * TIMEOUT_S)
        events = SubscriptionEventCallbacks(
            deadline=lambda _: self.lost_s.append(time.time()),
            liveliness=self._on_liveliness,
        )
        if kind is ContactStates:
            qos = QoSProfile(
                depth=20_000,
                deadline=patience,
                liveliness=LivelinessPolicy.AUTOMATIC,
                liveliness_lease_duration=patience,
            )
        self.node.create_subscription(
            kind,
            topic,
            self._receive,  # type: ignore[arg-type]
            qos,
            event_callbacks=events if kind is ContactStates else None,
        )

    def _on_liveliness(self, event: Any) -> None:  # noqa: ANN401
        if event.alive_count == 0:
            self.lost_s.append(time.time())

    def _healthy(self) -> Messages:
        return self.healthy()

    def _tick(self) -> None:
        for message in self.messages():
            self.send(message)

    def _receive(self, message: Any, info: dict[str, Any]) -> None:  # noqa: ANN401
        stamp = stamp_ns(message) if hasattr(message, "header") else 0
        key = _key(message) if isinstance(message, ContactStates) else None
        source_s = info["source_timestamp"] / 1e9
        self.outputs.append(Output(time.time(), source_s, self.is_permissive(message), stamp, key))

    def start(self) -> None:
        """Start the node, or start it again."""
        self.harness.process_may_end = False
        self.harness.start(*self.command[1:], command=self.command[:1])

    def restart(self) -> None:
        """Kill the node and start it again."""
        assert self.harness.process is not None
        self.harness.process.kill()
        self.harness.process.communicate()
        self.start()

    def spin(self, seconds: float) -> None:
        """Send and receive for some time."""
        end = time.monotonic() + seconds
        self.harness.spin_until(lambda: time.monotonic() >= end)

    def until_permissive(self, since_s: float) -> Output:
        """Return the first permissive output on an input that was sent after `since_s`."""

        def last() -> Output | None:  # not all of them: thousands wait to be received after a flood
            out = self.outputs[-1] if self.outputs else None
            time_s = (out.stamp_ns / 1e9 if self.has_age else out.source_s) if out else 0.0
            return out if out and out.is_permissive and time_s > since_s else None

        output: Output = self.harness.spin_until(last, timeout_s=30.0)
        return output

    @contextmanager
    def sends(self, messages: Callable[[], Messages]) -> Iterator[None]:
        """Send `messages` in place of the healthy ones."""
        self.messages = messages
        try:
            yield
        finally:
            self.messages = self._healthy

    def run(self, fault: Fault) -> Result:
        """Inject a fault and measure."""
        self.until_permissive(time.time())
        with self.sends(list):  # nothing on its way
            self.spin(0.05)
        self.bad_stamps.clear()
        self.begin()
        with fault.inject(self):
            if fault.must not in IMMEDIATE:
                self.spin(1.0)
            else:
                self.harness.spin_until(
                    lambda: self.lost_s or any(not o.is_permissive and o.source_s > self.begin_s for o in self.outputs),
                    timeout_s=10.0,
                )
                self.spin(HOLD_S)
            end_s = time.time()
        recovered = self.until_permissive(end_s)
        during = [out for out in self.outputs if self.begin_s < out.source_s <= end_s]
        return self._result(fault, end_s, during, recovered.time_s - end_s)

    def begin(self) -> None:
        """Let the fault begin now."""
        self.outputs.clear()
        self.lost_s.clear()
        self.begin_s = time.time()

    def _result(self, fault: Fault, end_s: float, during: list[Output], recovery_s: float) -> Result:
        begin_s = self.begin_s
        bad = [
            out
            for out in during
            if out.is_permissive
            and (fault.bad_input or out.stamp_ns in self.bad_stamps or (self.has_age and out.age_s > MAX_AGE_S))
        ]
        unknown = next((out for out in during if not out.is_permissive), None)
        lost = [at_s for at_s in self.lost_s if at_s <= end_s]
        said_s = unknown.source_s - begin_s if unknown else NAN
        known = [unknown.time_s, *lost[:1]] if unknown else lost[:1]
        known_s = min(known) - begin_s if known else NAN
        failures = [f"{len(bad)} permissive"] * bool(bad)
        if fault.must == "silent":
            failures += [f"{len(during)} outputs"] * (len(during) > 1)  # one may have been on its way
        elif fault.must == "recovers":
            pass
        elif fault.must == "fresh":
            failures += ["not continued"] * (len(during) < self.min_outputs)
        elif fault.must == "continues":
            failures += ["not continued"] * (unknown is not None or len(during) < self.min_outputs)
        else:
            limit_s = BOUND_S if fault.must == "UNKNOWN" else LOST_S
            failures += [f"known after {known_s:.3f} s, not {limit_s:.3f} s"] * (not known_s <= limit_s)
            failures += ["no UNKNOWN"] * (fault.must != "lost" and unknown is None)
        failures += [f"recovered after {recovery_s:.1f} s"] * (recovery_s > RECOVERY_S)
        is_bound = fault.must in IMMEDIATE
        nan = NAN
        return Result(
            fault,
            len(bad),
            said_s if is_bound else nan,
            known_s if is_bound else nan,
            recovery_s,
            0,
            "; ".join(failures),
        )


# Faults of the joint states


def streams(**fields: Any) -> Inject:  # noqa: ANN401
    """Send only joint states with `fields`, or those that a function returns."""
    return lambda cell: cell.sends(lambda: [joint_state(**fields)])


def sends(messages: Callable[[], Messages]) -> Inject:
    return lambda cell: cell.sends(messages)


def shifted(shift_ns: int) -> Inject:
    """Send joint states with stamps that are wrong by `shift_ns`."""
    return sends(lambda: [joint_state(time.time_ns() + shift_ns)])


def raw(change: Callable[[bytearray], bytes | bytearray]) -> Inject:
    """Send changed bytes of joint states."""
    return sends(lambda: [bytes(change(bytearray(serialize_message(joint_state()))))])


def noise(_: bytearray) -> bytes:
    return b"\x00\x01\x00\x00" + random.randbytes(random.randrange(200))  # noqa: S311


def frozen_stamp(cell: Cell) -> AbstractContextManager[None]:
    now = time.time_ns()
    return cell.sends(lambda: [joint_state(now)])


def duplicated(cell: Cell) -> AbstractContextManager[None]:
    def twice() -> Messages:
        message = joint_state()
        return [message, message]

    return cell.sends(twice)


def reordered(cell: Cell) -> AbstractContextManager[None]:
    def swapped() -> Messages:
        now = time.time_ns()
        cell.bad_stamps.add(now - 5_000_000)
        return [joint_state(now), joint_state(now - 5_000_000)]

    return cell.sends(swapped)


def dropped(cell: Cell) -> AbstractContextManager[None]:
    draw = random.Random(1)  # noqa: S311
    return cell.sends(lambda: [joint_state()] * (draw.random() < 0.5))


@contextmanager
def beside(cell: Cell, kind: type, topic: str, message: Any, qos: QoSProfile = DEEP) -> Iterator[None]:  # noqa: ANN401
    """Send `message` each period from another publisher, beside the healthy input."""
    with ros_node("other", domain=cell.harness.domain) as other:
        cell.begin()
        publisher = other.create_publisher(kind, topic, qos)

        def send() -> None:
            publisher.publish(message() if callable(message) else message)

        def is_discovered() -> bool:
            if all(out.is_permissive for out in cell.outputs):
                cell.begin()  # the discovery is no part of the fault
            return publisher.wait_for_all_acked(Duration())

        if kind is not String or topic != JOINT_STATES:  # which nothing subscribes to
            cell.harness.spin_until(publisher.get_subscription_count)
            send()  # acknowledged by those that have discovered the publisher
            cell.harness.spin_until(is_discovered)
        timer = cell.node.create_timer(PERIOD_S, send)
        try:
            yield
        finally:
            cell.node.destroy_timer(timer)
            other.destroy_publisher(publisher)
            cell.on_sources()


@contextmanager
def flood(cell: Cell, names: int = 0, numbers: int = 0, rate: int = 10_000) -> Iterator[None]:
    """Flood with another process; the healthy input pauses."""
    environment = {**os.environ, "ROS_DOMAIN_ID": str(cell.harness.domain)}
    arguments = map(str, (names, numbers, 3 * rate, rate))
    with cell.sends(list), subprocess.Popen([sys.executable, "-c", FLOODER, *arguments], env=environment) as flooder:
        start_ns = time.time_ns()
        cell.harness.spin_until(lambda: any(out.stamp_ns > start_ns for out in cell.outputs))
        cell.begin()
        yield
        flooder.kill()


def no_input(cell: Cell) -> AbstractContextManager[None]:
    return cell.sends(list)


JOINT_STATES = "joint_states"
OTHER: dict[str, Any] = {"names": ("left_finger", "right_finger"), "position": (0.0, 0.0), "velocity": ()}
INPUT_FAULTS = (
    *(Fault(JOINT_STATES, name, "UNKNOWN", streams(**fields)) for name, (fields, _) in INVALID.items()),
    Fault(JOINT_STATES, "none (all dropped)", "UNKNOWN", no_input),
    Fault(JOINT_STATES, "half of them dropped at random", "continues", dropped, bad_input=False),
    Fault(JOINT_STATES, "each twice", "UNKNOWN", duplicated, bad_input=False),
    Fault(JOINT_STATES, "neighbours swapped", "UNKNOWN", reordered, bad_input=False),
    Fault(JOINT_STATES, "the same stamp again and again", "UNKNOWN", frozen_stamp, bad_input=False),
    Fault(JOINT_STATES, "stamps 1 h ahead", "UNKNOWN", shifted(3600 * S)),
    Fault(JOINT_STATES, "stamps 0.3 s ahead", "UNKNOWN", shifted(3 * S // 10)),
    Fault(JOINT_STATES, "stamps 0.6 s old", "UNKNOWN", shifted(-6 * S // 10)),
    Fault(JOINT_STATES, "stamps 200 s old", "UNKNOWN", shifted(-200 * S)),
    Fault(JOINT_STATES, "empty messages", "UNKNOWN", raw(lambda _: b"\x00\x01\x00\x00")),
    Fault(JOINT_STATES, "messages cut in half", "UNKNOWN", raw(lambda data: data[: len(data) // 2])),
    Fault(JOINT_STATES, "random bytes", "UNKNOWN", raw(noise)),
    Fault(JOINT_STATES, "the other byte order", "UNKNOWN", raw(lambda data: b"\x00\x00" + data[2:])),
    Fault(
        JOINT_STATES,
        "a name of 4 GB announced",
        "UNKNOWN",
        raw(lambda data: data[:12] + b"\xff\xff\xff\xff" + data[16:]),
    ),
    Fault(JOINT_STATES, "10 kHz of valid ones", "fresh", flood, bad_input=False),
    Fault(
        JOINT_STATES, "100 Hz with 200 000 names", "UNKNOWN", partial(flood, names=200_000, numbers=200_000, rate=100)
    ),
    Fault(JOINT_STATES, "100 Hz with 300 000 numbers", "UNKNOWN", partial(flood, numbers=300_000, rate=100)),
    Fault(
        JOINT_STATES,
        "another device beside the robot",
        "continues",
        lambda cell: beside(cell, JointState, JOINT_STATES, lambda: joint_state(**OTHER)),
        bad_input=False,
    ),
    Fault(
        JOINT_STATES,
        "a second robot beside the first",
        "UNKNOWN",
        lambda cell: beside(cell, JointState, JOINT_STATES, lambda: joint_state(position=(1.3, *Q[1:]))),
        bad_input=False,
    ),
    Fault(
        JOINT_STATES,
        "another message type on the topic",
        "continues",
        lambda cell: beside(cell, String, JOINT_STATES, String(data="joint1")),
        bad_input=False,
    ),
    Fault(
        JOINT_STATES, "moving at 1 rad/s with velocity 0", "UNKNOWN", lambda cell: cell.sends(lying), bad_input=False
    ),
)


def lying() -> Messages:
    now = time.time_ns()
    return [joint_state(now, position=(0.3 + now / 1e9 % 1.0, *Q[1:]), velocity=(0.0,) * 4)]


# Parameter abuse


def parameter(**values: Any) -> Inject:  # noqa: ANN401
    """Set parameters that must be refused, again and again."""

    @contextmanager
    def inject(cell: Cell) -> Iterator[None]:
        for _ in range(3):
            assert cell.harness.set_parameters(**values) != ""
        yield

    return inject


@contextmanager
def parameter_storm(cell: Cell) -> Iterator[None]:
    for number in range(100):
        assert cell.harness.set_parameters(person_speed=0.01 * (number % 5)) == ""
    yield
    assert cell.harness.set_parameters(person_speed=0.0) == ""


PARAMETER = "parameters of the monitor"
PARAMETER_FAULTS = tuple(
    Fault(PARAMETER, name, "continues", inject, bad_input=False)
    for name, inject in {
        "timeout = -1": parameter(timeout=-1.0),
        "timeout = NaN": parameter(timeout=NAN),
        "timeout = 1e300": parameter(timeout=1e300),
        "warn_ratio of the wrong type": parameter(warn_ratio="much"),
        "body_regions = face (no contact permitted)": parameter(body_regions=["face"]),
        "max_force above the standard's": parameter(max_force=1e5),
        "payload_mass = infinity": parameter(payload_mass=float("inf")),
        "robot changed while active": parameter(robot="other.urdf"),
        "an unknown parameter": parameter(nonsense=1.0),
        "100 valid changes at once": parameter_storm,
    }.items()
)


# Processes


def signalled(name: str, *, restart: bool = False) -> Inject:
    """Send a signal to the node; continue or restart it at the end of the fault."""

    @contextmanager
    def inject(cell: Cell) -> Iterator[None]:
        cell.harness.process_may_end = True
        process = cell.harness.process
        assert process is not None
        cell.begin()
        process.send_signal(getattr(signal, name))
        yield
        if restart:
            process.communicate(timeout=60.0)
            cell.start()
        else:
            process.send_signal(signal.SIGCONT)
            cell.harness.process_may_end = False

    return inject


@contextmanager
def deactivated(cell: Cell, *more: int) -> Iterator[None]:
    back = (Transition.TRANSITION_CONFIGURE,) if more else ()
    cell.begin()
    assert cell.harness.change_state(Transition.TRANSITION_DEACTIVATE, *more)
    yield
    assert cell.harness.change_state(*back, Transition.TRANSITION_ACTIVATE)


@contextmanager
def silenced(cell: Cell) -> Iterator[None]:
    """Deactivate; what came before the answer does not count."""
    with deactivated(cell):
        cell.begin()
        yield


def deactivated_and(transition: int, cell: Cell) -> AbstractContextManager[None]:
    return deactivated(cell, transition)


SENDER = """
import time, rclpy
from sensor_msgs.msg import JointState
rclpy.init()
node = rclpy.create_node("driver")
publisher = node.create_publisher(JointState, "joint_states", 10)
message = JointState(name=["joint1", "joint2", "joint3", "joint4"], position=[0.3, 1.2, 0.1, -0.4])
message.velocity = [0.01, -0.01, 0.003, 0.01]
while True:
    message.header.stamp = node.get_clock().now().to_msg()
    publisher.publish(message)
    time.sleep(0.01)
"""


def driver_gets(name: str) -> Inject:
    """Let a process publish the joint states, and send it a signal."""

    @contextmanager
    def inject(cell: Cell) -> Iterator[None]:
        environment = {**os.environ, "ROS_DOMAIN_ID": str(cell.harness.domain)}
        with cell.sends(list), subprocess.Popen([sys.executable, "-c", SENDER], env=environment) as driver:
            try:
                cell.until_permissive(time.time())
                cell.spin(0.5)
                cell.begin()
                driver.send_signal(getattr(signal, name))
                yield
            finally:
                driver.send_signal(signal.SIGCONT)
                driver.kill()

    return inject


PROCESS_FAULTS = (
    Fault("monitor", "deactivated", "UNKNOWN", deactivated, bad_input=False),
    Fault("monitor", "cleaned up", "UNKNOWN", partial(deactivated_and, Transition.TRANSITION_CLEANUP), bad_input=False),
    Fault("monitor", "SIGSTOP, SIGCONT", "lost", signalled("SIGSTOP"), bad_input=False),
    Fault("monitor", "SIGKILL, started again", "lost", signalled("SIGKILL", restart=True), bad_input=False),
    Fault("monitor", "SIGABRT, started again", "lost", signalled("SIGABRT", restart=True), bad_input=False),
    Fault("monitor", "SIGTERM, started again", "UNKNOWN", signalled("SIGTERM", restart=True), bad_input=False),
    Fault("monitor", "SIGINT, started again", "UNKNOWN", signalled("SIGINT", restart=True), bad_input=False),
    Fault("publisher", "SIGSTOP", "UNKNOWN", driver_gets("SIGSTOP"), bad_input=False),
    Fault("publisher", "SIGKILL, another one follows", "UNKNOWN", driver_gets("SIGKILL"), bad_input=False),
)


# Other inputs of the monitor


@contextmanager
def instead(cell: Cell, **sources: Any) -> Iterator[None]:  # noqa: ANN401
    """Change what the additional publishers of a set-up send."""
    before = dict(cell.sources)
    cell.begin()
    cell.sources.update(sources)
    cell.on_sources()
    yield
    cell.sources.update(before)
    cell.on_sources()


def source(**sources: Any) -> Inject:  # noqa: ANN401
    return lambda cell: instead(cell, **sources)


def command(**fields: Any) -> JointState:  # noqa: ANN401
    return joint_state(**{"velocity": (), **fields})


COMMAND_FAULTS = tuple(
    Fault("joint_commands", name, "UNKNOWN", source(command=message), bad_input=False)
    for name, message in {
        "none": lambda: None,
        "0.2 rad off": lambda: command(position=(Q[0] + 0.2, *Q[1:])),
        "NaN": lambda: command(position=(NAN, *Q[1:])),
        "a joint is missing": lambda: command(names=JOINTS[1:], position=Q[1:]),
        "damaged messages": lambda: b"\x00\x01\x00\x00damaged",
    }.items()
)
PAYLOAD_FAULTS = (
    *(
        Fault("payload", name, "UNKNOWN", source(payload=message), bad_input=False)
        for name, message in {
            "mass -1 kg": Inertia(m=-1.0),
            "mass NaN": Inertia(m=NAN),
            "impossible inertia": Inertia(m=1.0, ixx=1.0, iyy=0.1, izz=0.1),
            "damaged message": b"\x00\x01\x00\x00",
        }.items()
    ),
    Fault(
        "payload",
        "a second publisher",
        "UNKNOWN",
        lambda cell: beside(cell, Inertia, "payload", Inertia(m=0.1), LATCHED),
        bad_input=False,
    ),
)
DESCRIPTION_FAULTS = tuple(
    Fault("robot_description", name, "UNKNOWN", source(description=String(data=text)), bad_input=False)
    for name, text in {
        "broken XML": "<robot>",
        "empty": "",
        "a robot without joints": '<robot name="r"><link name="base"/></robot>',
        "10 MB of text": "x" * 10_000_000,
    }.items()
)
CLOCK_FAULTS = tuple(
    Fault("/clock", name, must, source(shift_s=shift), bad_input=False)
    for name, must, shift in (
        ("jumps 1 h ahead of the joint states", "UNKNOWN", 3600.0),
        ("jumps 1 h back, the joint states stay", "UNKNOWN", -3600.0),
        ("stops", "UNKNOWN", None),
    )
)


# Set-ups of the monitor

SetUp = Callable[[NodeHarness], Cell]

GRIPPER = ("-p", 'ignored_joints:=["*_finger"]')  # of another device, whose silence gives UNKNOWN otherwise
MONITOR = (str(BIN / "monitor_node"), "--ros-args", "-p", f"timeout:={TIMEOUT_S}", "-p", "release_time:=0.2", *GRIPPER)


def monitor(harness: NodeHarness, *arguments: str) -> Cell:
    cell = Cell(harness, (*MONITOR, *arguments), ContactStates, "contact_states", DEEP)
    cell.start()
    return cell


def processes(harness: NodeHarness) -> Cell:
    return monitor(harness)


def with_commands(harness: NodeHarness) -> Cell:
    cell = monitor(harness, "-p", "command_tolerance:=0.1")
    commands = cell.node.create_publisher(JointState, "joint_commands", 10)
    cell.sources["command"] = command

    def send() -> None:
        if (message := cell.sources["command"]()) is not None:
            commands.publish(message)

    cell.node.create_timer(PERIOD_S, send)
    return cell


def with_payload(harness: NodeHarness) -> Cell:
    cell = monitor(harness, "-p", "payload_topic:=payload")
    publisher = cell.node.create_publisher(Inertia, "payload", LATCHED)
    cell.sources["payload"] = Inertia(m=2.0, com=Vector3(z=0.1))
    cell.node.create_timer(0.1, lambda: publisher.publish(cell.sources["payload"]))
    return cell


def with_description(harness: NodeHarness) -> Cell:
    cell = monitor(harness, "-p", "await_robot_description:=true", "-p", "effective_mass_model:=full")
    publisher = cell.node.create_publisher(String, "robot_description", LATCHED)
    cell.healthy = lambda: [joint_state(names=("hinge",), position=(0.3,), velocity=(0.01,))]
    cell.sources["description"] = String(data=ONE_LINK)
    cell.on_sources = lambda: publisher.publish(cell.sources["description"])
    cell.on_sources()
    return cell


def with_clock(harness: NodeHarness) -> Cell:
    cell = monitor(harness, "-p", "use_sim_time:=true")
    publisher = cell.node.create_publisher(Clock, "/clock", 10)
    cell.sources["shift_s"] = 0.0

    def send() -> None:
        if cell.sources["shift_s"] is not None:
            clock = Clock()
            now_ns = time.time_ns() + round(1e9 * cell.sources["shift_s"])
            clock.clock.sec, clock.clock.nanosec = divmod(now_ns, S)
            publisher.publish(clock)

    cell.node.create_timer(PERIOD_S, send)
    return cell


# speed_scaling_node

ENCODER = ContactStatesEncoder("base_link")


def verdict(**fields: Any) -> bytes:  # noqa: ANN401
    """Return valid ContactStates of now with changed fields of the contact."""
    stamp_ns = time.time_ns() + fields.pop("shift_ns", 0)
    good = {"verdict": Verdict.OK, "direction": (1.0, 0.0, 0.0), "speed": 0.25, "allowable_speed": 1.0, "margin": 0.75}
    masses = dict.fromkeys(("effective_mass", "lumped_mass", "full_mass", "iso_mass"), 2.0)
    contact = unknown_contact("tool", "")._replace(**{**good, **masses, **fields})
    return ENCODER.encode(assessments_of(decision_on(contact, stamp_ns=stamp_ns, input_age=0.001)))


def with_verdict(data: bytes, value: int) -> bytes:
    """Return ContactStates with another verdict number of the contact."""
    message = deserialize_message(data, ContactStates)
    message.verdict = message.contacts[0].verdict = value
    return serialize_message(message)


def verdicts(harness: NodeHarness, cell: Cell) -> None:
    """Send ContactStates as input of `cell`."""
    qos = qos_profile(topics.verdict_qos(TIMEOUT_S))
    publisher = harness.node.create_publisher(ContactStates, "contact_states", qos)
    cell.send = publisher.publish
    cell.healthy = lambda: [verdict()]


def speed_scaling(harness: NodeHarness) -> Cell:
    command = (str(BIN / "speed_scaling_node"), "--ros-args", "-p", f"timeout:={TIMEOUT_S}", "-p", "rise_rate:=20.0")
    qos = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    cell = Cell(harness, command, SpeedScalingFactor, topics.SPEED_SCALING_INPUT, qos)
    cell.is_permissive = lambda message: not message.factor <= 0.0
    verdicts(harness, cell)
    cell.healthy = lambda: [verdict(speed=0.0)]  # at rest the factor may rise
    cell.start()
    return cell


SCALING_MUST = dict.fromkeys(("none", "messages cut in half", "random bytes"), "by the deadline")
SCALING_FAULTS = (
    *(
        Fault(
            "contact_states of speed_scaling", name, SCALING_MUST.get(name, "UNKNOWN"), sends(message), bad_input=False
        )
        for name, message in {
            "none": list,
            "UNKNOWN": lambda: [verdict(verdict=Verdict.UNKNOWN, allowable_speed=0.0)],
            "allowable speed NaN": lambda: [verdict(allowable_speed=NAN)],
            "allowable speed -1": lambda: [verdict(allowable_speed=-1.0)],
            "allowable speed infinite": lambda: [verdict(allowable_speed=float("inf"))],
            "speed NaN": lambda: [verdict(speed=NAN)],
            "stamps 0.6 s old": lambda: [verdict(shift_ns=-6 * S // 10)],
            "verdict 99": lambda: [with_verdict(verdict(), 99)],
            "messages cut in half": lambda: [verdict()[:100]],
            "random bytes": lambda: [noise(bytearray())],
        }.items()
    ),
    Fault("speed_scaling", "SIGTERM, started again", "UNKNOWN", signalled("SIGTERM", restart=True), bad_input=False),
    Fault("speed_scaling", "deactivated", "UNKNOWN", deactivated, bad_input=False),
)


# validator_node


def validator(harness: NodeHarness) -> Cell:
    command = (str(BIN / "validator_node"), "--ros-args", "-p", "obstacle_mass:=3.0")
    cell = Cell(harness, command, ImpactValidation, "impact_validation", DEEP)
    cell.is_permissive = lambda message: message.measured_force > 0.0 and message.predicted_force > 0.0
    cell.min_outputs = 2
    verdicts(harness, cell)
    impacts = harness.node.create_publisher(Impact, "impact", DEEP)
    cell.sources["impact"] = lambda: impact_message(an_impact())
    harness.node.create_timer(0.2, lambda: impacts.publish(cell.sources["impact"]()))
    cell.start()
    return cell


def an_impact(**fields: Any) -> ImpactValue:  # noqa: ANN401
    numbers = (False, False, 0, 0.0, 0.1, 1e-4, "test", True)
    impact = ImpactValue(time.time_ns() - S // 10, "cell", 200.0, 2e-3, 0.3, 0.0, *numbers, 0.2)
    return impact._replace(**fields)


def also(kind: type, topic: str, message: Callable[[], object], cell: Cell) -> AbstractContextManager[None]:
    return beside(cell, kind, topic, message)


VALIDATOR_FAULTS = (
    *(
        Fault(
            "contact_states of the validator",
            name,
            "recovers" if name in {"1 h ahead", "NaN in every number", "verdict 99"} else "continues",
            partial(also, ContactStates, "contact_states", message),
            bad_input=False,
        )
        for name, message in {
            "cut in half": lambda: verdict()[:100],
            "random bytes": lambda: noise(bytearray()),
            "verdict 99": lambda: with_verdict(verdict(), 99),
            "NaN in every number": lambda: verdict(speed=NAN, effective_mass=NAN, lumped_mass=NAN, full_mass=NAN),
            "1 h ahead": lambda: verdict(shift_ns=3600 * S),
        }.items()
    ),
    *(
        Fault(
            topic,
            name,
            "recovers" if "8 MB" in name else "continues",
            partial(also, kind, topic, message),
            bad_input=False,
        )
        for topic, kind, name, message in (
            ("impact", Impact, "random bytes", lambda: noise(bytearray())),
            ("impact", Impact, "NaN peak", lambda: impact_message(an_impact(peak_force=NAN))),
            ("force", ForceBlock, "random bytes", lambda: noise(bytearray())),
            ("force", ForceBlock, "NaN samples", lambda: ForceBlock(sample_rate=12800.0, force=[NAN] * 1280)),
            ("force", ForceBlock, "8 MB of samples", lambda: ForceBlock(sample_rate=12800.0, force=[0.0] * 1_000_000)),
            ("run_info", RunInfo, "random bytes, then valid again", lambda: noise(bytearray())),
        )
    ),
    Fault("validator", "SIGSTOP, SIGCONT", "silent", signalled("SIGSTOP"), bad_input=False),
    Fault("validator", "SIGKILL, started again", "silent", signalled("SIGKILL", restart=True), bad_input=False),
)


# daq_node: the simulated source fails as the drivers do

DAQ = """
import os, sys
import numpy as np
from scara_effmass import errors
from scara_effmass.daq.sim_source import HalfSineSource
from scara_effmass.nodes.daq_node import main
read, start = HalfSineSource.read, HalfSineSource.start
def fail(error):
    raise error
def expression(line):
    path = os.environ["FAULT"]
    return open(path).read().splitlines()[line] if os.path.exists(path) else ""
def faulty_read(source, timeout_s):
    reading = read(source, timeout_s)
    fault = expression(0)
    return eval(fault) if reading is not None and fault else reading
def faulty_start(source):
    fault = expression(1)
    return eval(fault) if fault else start(source)
HalfSineSource.read, HalfSineSource.start = faulty_read, faulty_start
sys.exit(main())
"""


def daq(harness: NodeHarness) -> Cell:
    words = ("--ros-args", "-p", "source:=sim", "-p", "ni9230.retry_time:=0.1", "-p", "backlog:=60.0")
    cell = Cell(harness, (sys.executable, "-c", DAQ, *words), ForceBlock, "force", DEEP)
    os.environ["FAULT"] = str(harness.directory / "fault")
    cell.is_permissive = lambda block: len(block.force) > 0 and all(abs(force) < 1e6 for force in block.force)
    cell.min_outputs = 5
    cell.messages = list
    cell.healthy = list
    cell.start()
    return cell


def reads(expression: str, on_start: str = "") -> Inject:
    """Let the force source return or raise what `expression` says, and `on_start` when it is started again."""

    @contextmanager
    def inject(cell: Cell) -> Iterator[None]:
        path = cell.harness.directory / "fault"
        path.with_suffix(".new").write_text(f"{expression}\n{on_start}\n")
        path.with_suffix(".new").rename(path)
        cell.spin(0.3)
        cell.begin()
        yield
        path.unlink()

    return inject


LOST = "fail(errors.DeviceLostError('unplugged'))"
DAQ_FAULTS = (
    *(
        Fault("force source", name, must, reads(*expressions), bad_input=must == "silent")
        for name, must, *expressions in (
            ("the device is unplugged", "silent", LOST, "fail(errors.DeviceLostError('unplugged'))"),
            ("the device is missing", "silent", LOST, "fail(errors.DeviceMissingError('missing'))"),
            ("the device is reserved", "silent", LOST, "fail(errors.DeviceReservedError('reserved'))"),
            ("samples are overwritten (overrun)", "silent", "fail(errors.OverrunError('overrun'))"),
            ("no samples in time", "silent", "None"),
            ("samples are lost", "continues", "reading._replace(lost=100)"),
            ("NaN samples", "silent", "reading._replace(samples=reading.samples * np.nan)"),
            ("saturated samples", "continues", "reading._replace(saturated=np.ones(reading.samples.shape, bool))"),
            (
                "the host's clock jumps 1 h ahead",
                "continues",
                "reading._replace(read_ns=reading.read_ns + 3600 * 10**9)",
            ),
            (
                "the host's clock jumps 1 h back",
                "continues",
                "reading._replace(read_ns=reading.read_ns - 3600 * 10**9)",
            ),
        )
    ),
    Fault("daq", "SIGSTOP, SIGCONT", "silent", signalled("SIGSTOP"), bad_input=False),
    Fault("daq", "SIGKILL, started again", "silent", signalled("SIGKILL", restart=True), bad_input=False),
    Fault("daq", "deactivated", "silent", silenced, bad_input=False),
)

# The campaign

GROUPS: dict[SetUp, tuple[str, tuple[Fault, ...]]] = {
    monitor: ("monitor", INPUT_FAULTS + PARAMETER_FAULTS),
    processes: ("monitor", PROCESS_FAULTS),
    with_commands: ("monitor", COMMAND_FAULTS),
    with_payload: ("monitor", PAYLOAD_FAULTS),
    with_description: ("monitor", DESCRIPTION_FAULTS),
    with_clock: ("monitor", CLOCK_FAULTS),
    speed_scaling: ("speed_scaling", SCALING_FAULTS),
    validator: ("validator", VALIDATOR_FAULTS),
    daq: ("daq", DAQ_FAULTS),
}


ALL = [(make, fault) for make, (_, faults) in GROUPS.items() for fault in faults]


@final
class Recording:
    """`scara-effmass record` beside a cell; at the end it must hold every output that was received."""

    def __init__(self, domain: int, bag: Path) -> None:
        self.bag = bag
        self.received: list[tuple[int, Counter[object]]] = []
        """Index in RESULTS, and what was received during the fault."""
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
        self._process = subprocess.Popen([*RECORD, "-o", str(bag)], env=environment, stdout=subprocess.PIPE)

    def close(self) -> None:
        """End the recorder and compare."""
        self._process.send_signal(signal.SIGINT)
        output, _ = self._process.communicate(timeout=60.0)
        states: list[Any] = []
        with open_bag(self.bag) as bag, suppress(DecodeError):  # of damaged messages
            topics_of = {topic.name for topic in bag.topics if topic.name == "/contact_states"}
            states += [bag.deserialize(raw) for raw in bag.messages(topics_of)] if topics_of else []
        held: Counter[object] = Counter(_key(s) for s in states)
        for index, received in self.received:
            lost = sum((received - held).values())
            RESULTS[index] = RESULTS[index]._replace(lost=lost)
        assert self._process.returncode in {0, 1}, output  # 1: a message was lost, of whatever topic


def check_properties(make: SetUp, bag: Path) -> None:
    """Require that the recorded verdicts have all properties, but for the silence of a monitor that was stopped."""
    results = check_recording(bag, MonitorSettings(timeout=TIMEOUT_S))
    violated = {result.text for result in results if result.violations}
    expected = {DEADLINE_PROPERTY} if make is processes else set()
    if make is with_clock:  # a clock that goes back discards the history, and with it what is held
        violated = {text for text in violated if "release time" not in text}
    PROPERTIES.append(
        f"| {make.__name__.replace('_', ' ')} | {results[0].evaluated} | {'; '.join(sorted(violated)) or 'none'} |"
    )
    assert violated == expected, "\n".join(map(str, results))


@pytest.fixture(scope="module")
def cell_of(
    localhost_only: None,  # noqa: ARG001, F811
    reserve_domain: Callable[[], AbstractContextManager[int]],
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Callable[[SetUp], tuple[Cell, Recording]]]:
    """Return a function that gives the cell of a set-up, and ends the one before."""
    cells: dict[SetUp, tuple[Cell, Recording]] = {}
    with ExitStack() as stack:

        def get(make: SetUp) -> tuple[Cell, Recording]:
            if make not in cells:
                stack.close()
                cells.clear()
                folder = tmp_path_factory.mktemp("cell")
                if GROUPS[make][0] == "monitor":
                    stack.callback(check_properties, make, folder / "bag")
                domain = stack.enter_context(reserve_domain())
                recording = stack.enter_context(closing(Recording(domain, folder / "bag")))
                harness = stack.enter_context(closing(NodeHarness(domain, folder, GROUPS[make][0])))
                cells[make] = make(harness), recording
                if GROUPS[make][0] == "monitor":
                    harness.spin_until(lambda: harness.node.count_subscribers("contact_states") > 1)  # the recorder
            return cells[make]

        yield get


@pytest.mark.parametrize(("make", "fault"), ALL, ids=[f"{fault.on}: {fault.injected}" for _, fault in ALL])
def test_fault(make: SetUp, fault: Fault, cell_of: Callable[[SetUp], tuple[Cell, Recording]]) -> None:
    cell, recording = cell_of(make)
    try:
        result = cell.run(fault)
    except AssertionError as error:
        result = Result(fault, 0, NAN, NAN, float("inf"), 0, str(error).partition("\n")[0][-200:])
        cell.restart()  # so that the next fault meets a live node
    received = Counter(out.key for out in cell.outputs if out.key is not None)
    recording.received.append((len(RESULTS), received))
    RESULTS.append(result)
    assert result.failure == ""


# Two monitors, the recorder, and the network


def fault_result(
    fault: Fault, known_s: float, recovery_s: float, *failures: str, permissive: int = 0, lost: int = 0
) -> None:
    """Note and judge the result of a fault with a procedure of its own."""
    result = Result(fault, permissive, NAN, known_s, recovery_s, lost, "; ".join(filter(None, failures)))
    RESULTS.append(result)
    assert result.failure == ""


def test_two_monitors(own_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(own_domain))
    fault = Fault("contact_states of a display", "a second monitor by mistake", "UNKNOWN", no_input)
    with closing(NodeHarness(own_domain, tmp_path)) as harness, CellClient("display", ()) as client:
        cell = monitor(harness)

        def shows(verdict: Verdict) -> bool:
            return client.poll().verdict is verdict

        harness.spin_until(lambda: shows(Verdict.OK))
        with closing(NodeHarness(own_domain, tmp_path, "second")) as second:
            second.start(*MONITOR[1:], command=MONITOR[:1])
            harness.spin_until(lambda: harness.node.count_publishers("contact_states") > 1)
            begin_s = time.time()
            harness.spin_until(lambda: shows(Verdict.UNKNOWN))
            known_s, reason = time.time() - begin_s, client.status.reason
            permissive = 0
            for _ in range(20):
                cell.spin(0.02)
                permissive += client.poll().verdict in {Verdict.OK, Verdict.WARN}
        end_s = time.time()
        harness.spin_until(lambda: shows(Verdict.OK))
        wrong = "" if reason.startswith("two monitors") else reason
        late = (
            "" if known_s <= BOUND_S + LOST_S else f"known after {known_s:.3f} s"
        )  # its first verdict takes a time-out
        fault_result(fault, known_s, time.time() - end_s, wrong, late, permissive=permissive)


RECORDER_FAULTS = {
    "SIGKILL, repaired": "kill -9 $pid",
    "SIGSTOP for 2 s, SIGCONT": "kill -STOP $pid; sleep 2; kill -CONT $pid",
    "another program fills the disk (tmpfs)": "head -c 300m /dev/zero > fill 2> fill.log",
    "the disk fills up to the reserve (tmpfs)": ":",
    "files of at most 512 kB (RLIMIT_FSIZE)": ":",
    "a read-only file system at the start": ":",
}


@pytest.mark.parametrize("name", RECORDER_FAULTS)
def test_recorder(name: str, own_domain: int, tmp_path: Path) -> None:
    """Record 3 s of joint states in a mount namespace of its own; what was saved must be readable."""
    fault = Fault("recorder", name, "what was saved is readable", no_input)
    disk, copy = tmp_path / "disk", tmp_path / "copy"
    disk.mkdir()
    size = "66200k" if "reserve" in name else "200m"  # 64 MiB are the reserve
    limit = "ulimit -f 1024;" if "RLIMIT" in name else ""
    read_only = f"mount -o remount,ro {disk};" if "read-only" in name else ""
    record = " ".join(map(str, (*RECORD, "-o", disk / "bag", "joint_states", "--duration", "8", "--no-compression")))
    script = (
        f"mount -t tmpfs -o size={size} tmpfs {disk}; {read_only} ({limit} exec {record}) & pid=$!; sleep 5; cd {disk};"
        f"{RECORDER_FAULTS[name]}; wait $pid; status=$?; rm -f fill; cp -r {disk} {copy}; exit $status"
    )
    with ros_node("driver", domain=own_domain) as node:
        publisher = node.create_publisher(JointState, "joint_states", DEEP)
        process = subprocess.Popen(["unshare", "-m", "sh", "-c", script], stderr=subprocess.PIPE, text=True)
        sent = 0
        while process.poll() is None:
            if publisher.get_subscription_count():
                publisher.publish(joint_state())
                sent += 1
            time.sleep(1e-3)
    _, errors = process.communicate()
    bag, failures, readable = copy / "bag", [], 0
    if "read-only" in name:
        failures += [f"exit status {process.returncode}: {errors}"] * (
            process.returncode != 2 or errors.count("\n") != 1
        )
    else:
        if process.returncode == 137:
            report = repair(bag)
            failures += [f"{report}"] * bool(report.failed)
        with open_bag(bag) as opened:
            readable = sum(1 for _ in opened.messages())
        failures += [f"{readable} readable"] * (readable < 100)
        is_full = "fill" in name or "RLIMIT" in name
        failures += [f"exit status {process.returncode}"] * (is_full and process.returncode != 1)
        failures += [f"{readable} of {sent}"] * ("STOP" in name and process.returncode != 0)
    fault_result(fault, NAN, NAN, *failures)


WRONG_MAC = "ip neigh replace 10.99.0.{} lladdr 02:00:00:00:00:99 dev veth{} nud permanent"
RIGHT_MAC = "ip neigh del 10.99.0.{} dev veth{}"
PARTITIONS = {
    "the cable is unplugged, and plugged in again": (0, "ip link set veth0 down", "ip link set veth0 up"),
    "nothing arrives at the monitor": (0, WRONG_MAC.format(2, 0), RIGHT_MAC.format(2, 0)),
    "nothing arrives at the consumer": (1, WRONG_MAC.format(1, 1), RIGHT_MAC.format(1, 1)),
}


@pytest.mark.parametrize("name", PARTITIONS)
def test_network(name: str, tmp_path: Path) -> None:  # noqa: PLR0915
    """The driver and a consumer on one host, the monitor on another: network namespaces joined by a veth pair."""
    fault = Fault("network", name, "lost", no_input, bad_input=False)
    host, cut, join = PARTITIONS[name]
    environment = {
        **os.environ,
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
        "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",  # shared memory would pass the partition
        "ROS_LOG_DIR": str(tmp_path),
    }
    with ExitStack() as stack:

        def start(*words: object, **options: Any) -> subprocess.Popen[str]:  # noqa: ANN401
            process = subprocess.Popen([*map(str, words)], env=environment, text=True, **options)
            stack.callback(process.wait)
            stack.callback(process.kill)
            return process

        hosts = [start("unshare", "-n", "sleep", "600") for _ in range(2)]

        def inside(number: int, command: str) -> None:
            subprocess.run(["nsenter", "-t", str(hosts[number].pid), "-n", "sh", "-c", command], check=True)

        own = Path("/proc/self/ns/net").readlink()
        while any(Path(f"/proc/{each.pid}/ns/net").readlink() == own for each in hosts):
            time.sleep(0.01)
        inside(0, f"ip link add veth0 type veth peer name veth1 netns {hosts[1].pid}")
        for n in range(2):
            address = f"ip addr add 10.99.0.{n + 1}/24 dev veth{n}; ip link set veth{n} up; ip link set lo up"
            inside(n, f"{address}; ip route add 224.0.0.0/4 dev veth{n}")
        enter = [("nsenter", "-t", each.pid, "-n") for each in hosts]
        start(*enter[1], *MONITOR, stderr=subprocess.DEVNULL)
        start(*enter[0], sys.executable, "-c", SENDER)
        consumer = start(*enter[0], sys.executable, EXAMPLE, "--timeout", TIMEOUT_S, stdout=subprocess.PIPE)
        assert consumer.stdout is not None
        consumer_fd = consumer.stdout.fileno()
        os.set_blocking(consumer_fd, False)
        stack.callback(consumer.stdout.close)
        lines: list[tuple[float, bool]] = []
        text = ""

        def until(condition: Callable[[], object], seconds: float = 60.0) -> None:
            nonlocal text
            end = time.monotonic() + seconds
            while not condition():
                assert time.monotonic() < end, lines[-5:]
                time.sleep(0.01)
                with suppress(BlockingIOError):
                    *complete, text = (text + os.read(consumer_fd, 65536).decode()).split("\n")
                    lines.extend((float(line.split()[0]), "m/s" in line) for line in complete)

        def is_moving() -> bool:
            stopped_s = max((at_s for at_s, moves in lines if not moves), default=0.0)
            return bool(lines) and lines[-1][1] and stopped_s < time.time() - 0.5

        until(is_moving)
        begin_s = time.time()
        inside(host, cut)
        pause = time.monotonic() + 4.0
        until(lambda: time.monotonic() > pause)
        end_s = time.time()
        stops = [at_s for at_s, moves in lines if at_s > begin_s and not moves]
        known_s = stops[0] - begin_s if stops else NAN
        permissive = sum(moves and at_s > begin_s + LOST_S for at_s, moves in lines)
        inside(host, join)
        until(lambda: lines[-1][1])
        late = "" if known_s <= LOST_S else f"known after {known_s:.3f} s"
        fault_result(fault, known_s, max(0.0, lines[-1][0] - end_s), late, permissive=permissive)


@pytest.fixture(scope="module", autouse=True)
def write_table() -> Iterator[None]:
    """Write the table of the whole campaign."""
    start_s = time.monotonic()
    yield
    write_section("make faults", page(time.monotonic() - start_s))


PAGE = """`make faults` wrote this section on {date} at commit {commit}, in {minutes:.0f} min,
with {cores} cores and a load average of {load:.0f}. It injects each fault into live nodes over DDS, beside or in place
of valid input at 100 Hz, and ends it. Monitors compute with the compiled core.

The `timeout` of the monitor is {timeout} s. A subscriber must know within {bound:.3f} s (the time-out, a quarter of it
for the watchdog, a period of {period} s, and {machine} s for the machine), and within {lost:.3f} s of a monitor that is
gone (deadline and lease, two time-outs). The system time cannot be set here without all other programs: clocks jump on
`/clock`, in stamps and in the force source. The network has no packet scheduler here: no delay and no random loss.

| faults | failed | permissive on bad input | not recovered without restart | not recorded | slowest until known |
|---|---|---|---|---|---|
| {faults} | {failed} | {permissive} | {stuck} | {unrecorded} | {slowest:.3f} s |

*Permissive*: OK or WARN, a factor above 0, or a result from the bad input. *Said*: until the node publishes it.
*Known*: until a subscriber knows, by a message, its deadline or the lease. *Recovery*: from the end of the fault, with
a restart where the fault says so. *Lost*: contact states that the subscriber has and the recorder beside it has not.
Times with an additional publisher begin when the node has discovered it, which may take the middleware some seconds.

| on | injected | must | permissive | said [s] | known [s] | recovery [s] | lost | |
|---|---|---|---|---|---|---|---|---|
{rows}

### Properties of the recordings

`assess --properties` on the verdicts that the recorder beside the monitor took. A monitor that is stopped or killed
breaks its deadline: that must be found in the set-up `processes`, and in no other.

| set-up | verdicts | violated properties |
|---|---|---|
{properties}
"""


def page(duration_s: float) -> str:
    """Return the section of docs/measured.md."""

    def seconds(value: float) -> str:
        return "" if math.isnan(value) else f"{value:.3f}"

    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False).stdout
    rows = [
        (
            *(r.fault.on, r.fault.injected, MUST.get(r.fault.must, r.fault.must), r.permissive),
            *(seconds(r.said_s), seconds(r.known_s), seconds(r.recovery_s), r.lost, r.failure or "passed"),
        )
        for r in RESULTS
    ]
    return PAGE.format(
        date=f"{datetime.now(timezone.utc):%Y-%m-%d}",
        commit=commit.strip(),
        minutes=duration_s / 60.0,
        cores=os.cpu_count(),
        load=os.getloadavg()[0],
        timeout=TIMEOUT_S,
        bound=BOUND_S,
        period=PERIOD_S,
        machine=SCHEDULING_S,
        lost=LOST_S,
        faults=len(RESULTS),
        failed=sum(bool(r.failure) for r in RESULTS),
        permissive=sum(r.permissive for r in RESULTS),
        stuck=sum(r.recovery_s > RECOVERY_S for r in RESULTS),
        unrecorded=sum(r.lost for r in RESULTS),
        slowest=max((r.known_s for r in RESULTS if not math.isnan(r.known_s)), default=NAN),
        rows="\n".join(f"| {' | '.join(map(str, row))} |" for row in rows),
        properties="\n".join(PROPERTIES),
    )
