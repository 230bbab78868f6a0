# SPDX-License-Identifier: Apache-2.0
"""MonitorClient collects the contact states of a monitor in cycles."""

import signal
from collections.abc import Iterator

import pytest
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from scara_effmass.nodes.monitor_client import MonitorClient
from scara_effmass.wire.contact_state import ContactStateEncoder, contact_from
from scara_effmass_msgs.msg import ContactState
from std_msgs.msg import Float64

from scara_effmass.safety import unknown_contact
from scara_effmass.values import ContactAssessment, Verdict
from test.nodes.conftest import TIMEOUT_S, ros_node

NS = 1_000_000_000
DEEP = QoSProfile(depth=1000)

Cycle = tuple[tuple[ContactAssessment, ...], int]


class FakeMonitor:
    """Publishes on the monitor's topics and on /clock on request."""

    def __init__(self, node: Node) -> None:
        self._contact_state = node.create_publisher(ContactState, "contact_state", DEEP)
        self._scalars = [node.create_publisher(Float64, name, DEEP) for name in ("allowable_speed", "speed_scaling")]
        self._clock = node.create_publisher(Clock, "/clock", DEEP)

    def publish(self, *contacts: ContactAssessment, scalars: tuple[float, float] = (0.5, 0.25)) -> None:
        for contact in contacts:
            self._contact_state.publish(ContactStateEncoder(contact.contact_point, "").encode(contact))
        for publisher, value in zip(self._scalars, scalars, strict=True):
            publisher.publish(Float64(data=value))

    def set_clock(self, seconds: int) -> None:
        clock = Clock()
        clock.clock.sec = seconds
        self._clock.publish(clock)

    @property
    def connected(self) -> bool:
        """Whether every publisher has matched the client, which may have matched earlier."""
        return all(p.get_subscription_count() for p in (self._contact_state, *self._scalars, self._clock))


def contact(stamp_ns: int, point: str = "tool", age: float = 0.001) -> ContactAssessment:
    return unknown_contact(point, "", stamp_ns, age)._replace(
        verdict=Verdict.OK,
        speed=0.25,
        effective_mass=2.0,
        lumped_mass=2.0,
        full_mass=1.9,
        iso_mass=2.77,
        direction=(0.6, 0.0, -0.8),
        margin=0.5,
        criterion="force",
    )


def watchdog_contact(reason: str, stamp_ns: int, age: float) -> ContactAssessment:
    return unknown_contact("tool", reason, stamp_ns, age)._replace(watchdog=True)


@pytest.fixture
def monitor(own_domain: int) -> Iterator[FakeMonitor]:  # noqa: ARG001
    with ros_node("monitor") as node:
        yield FakeMonitor(node)


def test_contact_state_message_is_decoded_unchanged() -> None:
    original = contact(1_767_225_600_123_456_789)
    message = deserialize_message(ContactStateEncoder("tool", "base_link").encode(original), ContactState)
    assert contact_from(message) == original


def test_contact_points_of_one_joint_state_form_a_cycle(monitor: FakeMonitor) -> None:
    cycles: list[Cycle] = []
    with MonitorClient(("elbow", "tool"), lambda contacts, at_ns: cycles.append((contacts, at_ns))) as client:
        assert client.spin(TIMEOUT_S, lambda: client.connected and monitor.connected)
        first = contact(5 * NS, "elbow"), contact(5 * NS, "tool")
        incomplete = (contact(6 * NS, "elbow"),)
        last = contact(7 * NS, "elbow", 0.5), contact(7 * NS, "tool", 0.5)
        for contacts in (first, incomplete, last):
            monitor.publish(*contacts)
        assert client.spin(TIMEOUT_S, lambda: len(cycles) == 2)
        assert [contacts for contacts, _ in cycles] == [first, last]
        assert [at_ns for _, at_ns in cycles] == [5_001_000_000, 7_500_000_000]
        assert client.cycles == 2
        # Both answers to a repeated stamp, the first one without its last contact point; then one without its first.
        for contacts in ((last[0],), last, (contact(8 * NS, "tool"),), (contact(9 * NS, "elbow"), contact(9 * NS))):
            monitor.publish(*contacts)
        assert client.spin(TIMEOUT_S, lambda: len(cycles) == 4)
        assert {tuple(c.contact_point for c in contacts) for contacts, _ in cycles} == {("elbow", "tool")}
        assert client.spin(TIMEOUT_S, lambda: (client.allowable_speed, client.speed_scaling) == (0.5, 0.25))


def test_watchdog_decisions_are_not_cycles(monitor: FakeMonitor) -> None:
    cycles: list[Cycle] = []
    silent: list[str] = []
    with MonitorClient(
        ("tool",),
        lambda contacts, at_ns: cycles.append((contacts, at_ns)),
        on_watchdog=lambda contacts: silent.append(contacts[0].reason),
    ) as client:
        assert client.spin(TIMEOUT_S, lambda: client.connected and monitor.connected)
        monitor.publish(watchdog_contact("no joint state yet", 0, 0.3), contact(NS))
        monitor.publish(watchdog_contact("no joint state for 0.25 s", NS, 0.25), contact(2 * NS))
        assert client.spin(TIMEOUT_S, lambda: len(cycles) == 2)
        assert (client.cycles, client.watchdog_decisions) == (2, 2)
        assert silent == ["no joint state yet", "no joint state for 0.25 s"]


def test_joint_state_without_a_stamp_gets_the_time_of_the_clock(monitor: FakeMonitor) -> None:
    cycles: list[Cycle] = []
    with MonitorClient(("tool",), lambda contacts, at_ns: cycles.append((contacts, at_ns))) as client:
        assert client.spin(TIMEOUT_S, lambda: client.connected and monitor.connected)

        def has_clock_time() -> bool:
            monitor.set_clock(1000)
            monitor.publish(unknown_contact("tool", "the header stamp is zero", 0, 0.0))
            return bool(cycles) and cycles[-1][1] == 1000 * NS

        assert client.spin(TIMEOUT_S, has_clock_time)


def test_interrupt_in_a_callback_ends_spinning_without_output(
    monitor: FakeMonitor, capfd: pytest.CaptureFixture[str]
) -> None:
    cycles: list[int] = []

    def interrupt(_: tuple[ContactAssessment, ...], at_ns: int) -> None:
        cycles.append(at_ns)
        signal.raise_signal(signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    with MonitorClient(("tool",), interrupt) as client:
        assert client.spin(TIMEOUT_S, lambda: client.connected and monitor.connected)
        monitor.publish(contact(NS))
        with pytest.raises(KeyboardInterrupt):
            client.spin(TIMEOUT_S, lambda: False)
    assert len(cycles) == 1
    assert signal.getsignal(signal.SIGINT) is before
    assert capfd.readouterr().err == ""
