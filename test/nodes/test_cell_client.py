# SPDX-License-Identifier: Apache-2.0
"""CellClient: the status of a cell over DDS, from real messages and a monitor that is killed."""

import os
import signal
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from scara_effmass_msgs.msg import (
    ContactStates,
    ForceBlock,
    Impact,
    ImpactValidation,
    PayloadEstimate,
    RunInfo,
    SeriesStatistics,
)

from scara_effmass.cell.status import CellStatus
from scara_effmass.nodes.cell_client import CellClient
from scara_effmass.nodes.ros import qos_profile
from scara_effmass.safety import unknown_contact
from scara_effmass.values import Decision, Verdict
from scara_effmass.wire import topics
from scara_effmass.wire.contact_states import ContactStatesEncoder
from test.decisions import assessments_of, decision_on
from test.nodes.conftest import TIMEOUT_S, NodeHarness, joint_state, ros_node

NAMESPACE = ("--ros-args", "-r", "__ns:=/cell")
DEADLINE_S = 1.0
MS = 1_000_000


OK = decision_on(unknown_contact("tool", "")._replace(verdict=Verdict.OK, allowable_speed=0.5, margin=0.5))


def poll_until(client: CellClient, done: Callable[[CellStatus], object], repeat: Callable[[], object] = bool) -> None:
    end = time.monotonic() + TIMEOUT_S
    while not done(client.poll()):
        assert time.monotonic() < end, client.status.reason
        repeat()
        time.sleep(0.005)


@pytest.fixture
def node(own_domain: int) -> Iterator[Node]:  # noqa: ARG001
    with ros_node("monitor", "/cell") as node:
        yield node


def publisher(node: Node, kind: type, topic: str, deadline_s: float = DEADLINE_S) -> Any:  # noqa: ANN401
    qos = topics.verdict_qos(deadline_s / 2) if topic == topics.CONTACT_STATES else topics.INFO_QOS
    return node.create_publisher(kind, topic, qos_profile(qos))


def test_load_from_before_the_client_is_shown_with_its_age(node: Node) -> None:
    estimates = publisher(node, PayloadEstimate, topics.PAYLOAD_ESTIMATE)
    numbers = {"mass": 0.5, "mass_lower": 0.4, "mass_upper": 0.6, "stated_mass": 0.25}
    published_ns = time.monotonic_ns()
    estimates.publish(PayloadEstimate(**numbers, is_observable=True, text="0.50 kg"))
    time.sleep(0.5)
    with CellClient("display", NAMESPACE) as client:
        poll_until(client, lambda status: status.loads)
        at_ns, *values = client.status.loads[-1]
        assert values == [*numbers.values(), True, "0.50 kg"]
        assert abs(at_ns - published_ns) < 0.4e9
        assert client.status.load_text(at_ns + 3_000_000_000) == "0.50 kg; 3 s ago"


def test_a_verdict_of_one_message_is_not_missed_and_silence_is_unknown(node: Node) -> None:
    states, encoder = publisher(node, ContactStates, topics.CONTACT_STATES), ContactStatesEncoder("base_link")

    def send(verdict: Verdict, speed: float, reason: str = "") -> None:
        contact = unknown_contact("tool", reason)
        contact = contact._replace(verdict=verdict, speed=speed, allowable_speed=0.5, margin=0.5 - speed)
        states.publish(encoder.encode(assessments_of(decision_on(contact))))

    with CellClient("display", NAMESPACE) as client:
        poll_until(client, lambda s: s.verdict is Verdict.OK, lambda: send(Verdict.OK, 0.1))
        assert client.status.timeout_ns == DEADLINE_S * 1e9
        for verdict, speed, reason in ((Verdict.OK, 0.3, ""), (Verdict.WARN, 0.45, "close"), (Verdict.OK, 0.2, "")):
            send(verdict, speed, reason)
        poll_until(client, lambda s: s.episodes[-1].cause == "close" and s.verdict is Verdict.OK)
        assert max(sample.speed for sample in client.status.speeds) == 0.45
        poll_until(client, lambda s: s.verdict is Verdict.UNKNOWN)
        silence = "the monitor is silent: no contact states for "
        assert client.status.reason.startswith(silence)
        assert 1.0 <= float(client.status.reason.removeprefix(silence).removesuffix(" s")) < 5.0
        send(Verdict.OK, 0.1)
        poll_until(client, lambda s: s.verdict is Verdict.OK)
        # What waited while nobody polled is as old as it is.
        send(Verdict.OK, 0.1)
        time.sleep(1.1 * DEADLINE_S)
        assert client.poll().verdict is Verdict.UNKNOWN
        # A second monitor beside the first.
        with ros_node("second", "/cell") as other:
            states, first = publisher(other, ContactStates, topics.CONTACT_STATES, 20.0), states
            encoder, first_encoder = ContactStatesEncoder("base_link"), encoder

            def first_sends(publisher: Any) -> None:  # noqa: ANN401 - the second one is known before it has sent anything
                publisher.publish(first_encoder.encode(assessments_of(OK)))

            def send_both() -> None:
                nonlocal states, first, encoder, first_encoder
                states, first, encoder, first_encoder = first, states, first_encoder, encoder
                send(Verdict.OK, 0.1)

            poll_until(client, lambda s: s.reason.startswith("two monitors"), lambda: first_sends(first))
            poll_until(client, lambda s: s.reason.startswith("two monitors"), send_both)
            # Its longer deadline must not cover the silence of the first one.
            end = time.monotonic() + 0.5
            poll_until(client, lambda _: time.monotonic() > end, send_both)
            assert client.status.timeout_ns == DEADLINE_S * 1e9
            poll_until(client, lambda s: s.verdict is Verdict.OK, lambda: send(Verdict.OK, 0.1))
        node.destroy_publisher(next(p for p in node.publishers if p.topic_name == "/cell/contact_states"))
        poll_until(client, lambda s: s.reason == "no monitor: contact_states has no publisher")


def test_decisions_of_the_watchdog_arrive_as_such(node: Node) -> None:
    states, encoder = publisher(node, ContactStates, topics.CONTACT_STATES), ContactStatesEncoder("base_link")
    received: list[tuple[bool, str]] = []
    take = lambda decision: received.append((decision.watchdog, decision.reason))  # noqa: E731
    with CellClient("display", NAMESPACE, on_decision=take) as client:
        assert client.spin(TIMEOUT_S, lambda: client.connected and states.get_subscription_count() > 0)
        silent = decision_on(unknown_contact("tool", "no joint state yet"), watchdog=True)
        answer = decision_on(unknown_contact("tool", "")._replace(verdict=Verdict.OK))
        for decision in (silent, answer):
            states.publish(encoder.encode(assessments_of(decision)))
        assert client.spin(TIMEOUT_S, lambda: len(received) == 2)
    assert received == [(True, "no joint state yet"), (False, "")]


def test_a_stream_faster_than_its_client_does_not_hold_a_poll(node: Node) -> None:
    """What is left of it does not become younger."""
    states = publisher(node, ContactStates, topics.CONTACT_STATES, deadline_s=0.2)
    encoder = ContactStatesEncoder("base_link")
    end = time.monotonic() + TIMEOUT_S
    polls = taken = 0

    def send_two_more(_decision: Decision) -> None:
        nonlocal taken
        taken += 1
        if time.monotonic() < end:
            for _ in range(2):
                states.publish(encoder.encode(assessments_of(OK)))

    def polled() -> bool:
        nonlocal polls
        polls += 1
        return polls > 2 and client.status.reason.startswith("the monitor is silent")

    with CellClient("display", NAMESPACE, on_decision=send_two_more) as client:
        poll_until(client, lambda _: client.connected and states.get_subscription_count())
        send_two_more(OK)
        assert client.spin(TIMEOUT_S / 2, polled)
        assert taken > polls


def test_interrupt_in_a_callback_ends_spinning_without_output(node: Node, capfd: pytest.CaptureFixture[str]) -> None:
    states, encoder = publisher(node, ContactStates, topics.CONTACT_STATES), ContactStatesEncoder("base_link")
    received: list[int] = []

    def interrupt(decision: Decision) -> None:
        received.append(decision.stamp_ns)
        signal.raise_signal(signal.SIGINT)

    inherited = signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background ignores it
    try:
        with CellClient("display", NAMESPACE, on_decision=interrupt) as client:
            assert client.spin(TIMEOUT_S, lambda: client.connected and states.get_subscription_count() > 0)
            states.publish(encoder.encode(assessments_of(decision_on(unknown_contact("tool", "")))))
            with pytest.raises(KeyboardInterrupt):
                client.spin(TIMEOUT_S, lambda: False)
        assert received == [1]
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, inherited)
    assert capfd.readouterr().err == ""


def test_every_topic_of_the_cell_arrives(node: Node) -> None:
    impact = Impact(peak_force=100.0, duration=0.01, simulated=True)
    validation = ImpactValidation(predicted_force=110.0, measured_force=100.0, series=SeriesStatistics(count=1))
    diagnostics = [
        DiagnosticStatus(name=f"{name}: input", level=DiagnosticStatus.WARN, values=[KeyValue(key="lost", value="3")])
        for name in ("/cell/monitor", "/other/monitor")
    ]
    messages = {
        topics.JOINT_STATES: joint_state(7),
        topics.FORCE: ForceBlock(sample_rate=1000.0, force=[1.0] * 100, simulated=True),
        topics.IMPACT: impact,
        topics.IMPACT_VALIDATION: validation,
        topics.RUN_INFO: RunInfo(simulated=True),
        topics.DIAGNOSTICS: DiagnosticArray(status=diagnostics),
    }
    senders = [(publisher(node, type(message), topic), message) for topic, message in messages.items()]

    def repeat() -> None:
        for sender, message in senders:
            sender.publish(message)

    with CellClient("display", NAMESPACE) as client:
        status = client.status
        poll_until(
            client,
            lambda s: s.impacts and s.validations and s.diagnostics and s.joint_state and len(s.simulated) == 2,
            repeat,
        )
        poll_until(client, lambda s: any(r.validation and len(r.force) for r in s.impacts), repeat)
        assert status.joint_state is not None
        assert status.joint_state.stamp_ns == 7
        assert list(status.diagnostics) == ["/cell/monitor: input"]
        assert status.diagnostics["/cell/monitor: input"][1:4] == (1, "", {"lost": "3"})


def test_a_killed_monitor_is_unknown_within_its_deadline_and_comes_back(
    new_harness: Callable[..., NodeHarness], monkeypatch: pytest.MonkeyPatch
) -> None:
    harness = new_harness("--ros-args", "-p", "timeout:=0.5")
    harness.process_may_end = True
    monkeypatch.setenv("ROS_DOMAIN_ID", str(harness.domain))
    with CellClient("display") as client:
        poll_until(client, lambda s: s.verdict is Verdict.OK, lambda: harness.send(joint_state()))
        assert harness.process is not None
        os.kill(harness.process.pid, signal.SIGKILL)
        start_ns = time.monotonic_ns()
        poll_until(client, lambda s: s.verdict is Verdict.UNKNOWN)
        assert time.monotonic_ns() - start_ns < 5e9  # by the deadline: DDS itself gives up after 20 s
        harness.process.communicate()
        harness.start("--ros-args", "-p", "timeout:=0.5")
        poll_until(client, lambda s: s.verdict is Verdict.OK, lambda: harness.send(joint_state()))
