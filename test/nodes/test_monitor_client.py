"""The watch: what a monitor published comes out again, cycle by cycle."""

from __future__ import annotations

import os
import signal
from typing import TYPE_CHECKING

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from scara_effmass_msgs.msg import ContactState
from std_msgs.msg import Float64

from scara_effmass.nodes.monitor_client import MonitorClient
from scara_effmass.safety import unknown_contact
from scara_effmass.values import ContactAssessment, Verdict
from scara_effmass.wire.contact_state import ContactStateEncoder, contact_from

if TYPE_CHECKING:
    from collections.abc import Iterator

PATIENCE_S = 120.0
NS = 1_000_000_000
DEEP = QoSProfile(depth=1000)

Cycle = tuple[tuple[ContactAssessment, ...], int]


class FakeMonitor:
    """Publishes what a test tells it to, on the monitor's topics and on /clock."""

    def __init__(self, context: Context) -> None:
        self.node = Node("monitor", context=context)
        self._contact_state = self.node.create_publisher(ContactState, "contact_state", DEEP)
        self._numbers = [
            self.node.create_publisher(Float64, name, DEEP) for name in ("allowable_speed", "speed_scaling")
        ]
        self._clock = self.node.create_publisher(Clock, "/clock", DEEP)

    def say(self, *contacts: ContactAssessment, numbers: tuple[float, float] = (0.5, 0.25)) -> None:
        for contact in contacts:
            self._contact_state.publish(ContactStateEncoder(contact.contact_point, "").encode(contact))
        for publisher, number in zip(self._numbers, numbers, strict=True):
            publisher.publish(Float64(data=number))

    def tick(self, seconds: int) -> None:
        clock = Clock()
        clock.clock.sec = seconds
        self._clock.publish(clock)

    @property
    def is_heard(self) -> bool:
        """Whether it has found the watch, on every topic: the watch may have found it before."""
        return all(end.get_subscription_count() for end in (self._contact_state, *self._numbers, self._clock))


def contact(stamp_ns: int, point: str = "tool", age: float = 0.001) -> ContactAssessment:
    known = unknown_contact(point, "", stamp_ns, age)._replace(
        verdict=Verdict.OK, speed=0.25, effective_mass=2.0, iso_mass=2.77
    )
    return known._replace(lumped_mass=2.0, full_mass=1.9, direction=(0.6, 0.0, -0.8), margin=0.5, criterion="force")


def silence(reason: str, stamp_ns: int, age: float) -> ContactAssessment:
    return unknown_contact("tool", reason, stamp_ns, age)._replace(watchdog=True)


@pytest.fixture
def monitor(own_domain: int) -> Iterator[FakeMonitor]:  # noqa: ARG001 - where it publishes
    context = Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    fake = FakeMonitor(context)
    yield fake
    fake.node.destroy_node()
    context.try_shutdown()


def test_a_message_says_what_was_assessed() -> None:
    said = contact(1_767_225_600_123_456_789)
    message = deserialize_message(ContactStateEncoder("tool", "base_link").encode(said), ContactState)
    assert contact_from(message) == said


def test_cycles_of_several_contact_points_come_whole(monitor: FakeMonitor) -> None:
    cycles: list[Cycle] = []
    with MonitorClient(("elbow", "tool"), lambda contacts, at_ns: cycles.append((contacts, at_ns))) as watch:
        assert watch.spin(PATIENCE_S, lambda: watch.connected and monitor.is_heard)
        first = contact(5 * NS, "elbow"), contact(5 * NS, "tool")
        torn = (contact(6 * NS, "elbow"),)
        last = contact(7 * NS, "elbow", 0.5), contact(7 * NS, "tool", 0.5)
        for contacts in (first, torn, last):
            monitor.say(*contacts)
        assert watch.spin(PATIENCE_S, lambda: len(cycles) == 3)
        assert [contacts for contacts, _ in cycles] == [first, torn, last]
        assert [at_ns for _, at_ns in cycles] == [5_001_000_000, 6_001_000_000, 7_500_000_000]
        assert watch.cycles == 3
        assert watch.spin(PATIENCE_S, lambda: (watch.allowable_speed, watch.speed_scaling) == (0.5, 0.25))


def test_the_watchdog_answers_no_joint_state(monitor: FakeMonitor) -> None:
    cycles: list[Cycle] = []
    with MonitorClient(("tool",), lambda contacts, at_ns: cycles.append((contacts, at_ns))) as watch:
        assert watch.spin(PATIENCE_S, lambda: watch.connected and monitor.is_heard)
        monitor.say(silence("no joint state yet", 0, 0.3), contact(NS))
        monitor.say(silence("no joint state for 0.25 s", NS, 0.25), contact(2 * NS))
        assert watch.spin(PATIENCE_S, lambda: len(cycles) == 2)
        assert (watch.cycles, watch.silences) == (2, 2)


def test_a_joint_state_without_a_stamp_is_placed_on_the_clock_of_the_replay(monitor: FakeMonitor) -> None:
    cycles: list[Cycle] = []
    with MonitorClient(("tool",), lambda contacts, at_ns: cycles.append((contacts, at_ns))) as watch:
        assert watch.spin(PATIENCE_S, lambda: watch.connected and monitor.is_heard)

        def said_until_the_clock_has_come() -> bool:
            monitor.tick(1000)
            monitor.say(unknown_contact("tool", "the header stamp is zero", 0, 0.0))
            return bool(cycles) and cycles[-1][1] == 1000 * NS

        assert watch.spin(PATIENCE_S, said_until_the_clock_has_come)


def test_an_interrupt_within_a_callback_ends_the_spinning_without_a_word(
    monitor: FakeMonitor, capfd: pytest.CaptureFixture[str]
) -> None:
    cycles: list[int] = []

    def interrupted(_: tuple[ContactAssessment, ...], at_ns: int) -> None:
        cycles.append(at_ns)
        os.kill(os.getpid(), signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    with MonitorClient(("tool",), interrupted) as watch:
        assert watch.spin(PATIENCE_S, lambda: watch.connected and monitor.is_heard)
        monitor.say(contact(NS))
        with pytest.raises(KeyboardInterrupt):
            watch.spin(PATIENCE_S, lambda: False)
    assert len(cycles) == 1
    assert signal.getsignal(signal.SIGINT) is before
    assert capfd.readouterr().err == ""
