# SPDX-License-Identifier: Apache-2.0
"""CellClient: the status of a cell over DDS, from real messages and a monitor that is killed."""

import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from hypothesis import given
from hypothesis import strategies as st
from rclpy.node import Node
from scara_effmass_msgs.msg import ContactState, ForceBlock, Impact, ImpactValidation, RunInfo

from scara_effmass.cell.status import CellStatus
from scara_effmass.nodes.cell_client import CellClient, ContactStateReader
from scara_effmass.nodes.qos import qos_profile
from scara_effmass.safety import unknown_contact
from scara_effmass.values import Verdict
from scara_effmass.wire import topics
from test.nodes.conftest import TIMEOUT_S, NodeHarness, joint_state, ros_node

NAMESPACE = ("--ros-args", "-r", "__ns:=/cell")
DEADLINE_S = 1.0
MS = 1_000_000


def message(point: str, verdict: Verdict = Verdict.OK, speed: float = 0.1, reason: str = "") -> bytes:
    contact = unknown_contact(point, reason, 1, 0.0)._replace(verdict=verdict, speed=speed, allowable_speed=0.5)
    return ContactStateEncoder(point, "base_link").encode(contact)


def reader_after(*messages: bytes, numbers: Sequence[int] = ()) -> ContactStateReader:
    """Return a reader that got `messages` in one batch, a millisecond apart."""
    reader = ContactStateReader(CellStatus(0))
    for index, data in enumerate(messages):
        reader.take(data, numbers[index] if numbers else index + 1, (index + 1) * MS)
    reader.finish()
    return reader


POINTS = ("tool", "elbow", "rim")


@given(st.lists(st.tuples(st.sampled_from(POINTS), st.sampled_from(Verdict), st.booleans()), min_size=1))
def test_worst_of_the_last_states_decides_however_they_interleave(states: list[tuple[str, Verdict, bool]]) -> None:
    reader, last = ContactStateReader(CellStatus(0)), dict[str, Verdict]()
    for index, (point, verdict, ends_batch) in enumerate(states):
        reader.take(message(point, verdict, reason=point), index + 1, (index + 1) * MS)
        last[point] = verdict
        worst = max(map(severity, last.values()))
        assert severity(reader.status.verdict) == worst
        if ends_batch:
            reader.finish()
        assert severity(reader.status.verdict) == worst
        assert severity(last[reader.status.contact_point]) == worst
        assert reader.status.reason == reader.status.contact_point


def test_two_monitors_that_publish_in_step_are_unknown() -> None:
    """Both started at once and answer the same joint states, so that each number comes twice."""
    status = reader_after(*[message("tool")] * 6, numbers=(1, 1, 2, 2, 3, 3)).status
    assert (status.verdict, status.reason) == (Verdict.UNKNOWN, "two monitors publish contact_state: must be one")


def test_middleware_without_numbers_is_no_second_monitor() -> None:
    assert reader_after(*[message("tool")] * 6, numbers=(0,) * 6).status.verdict is Verdict.OK


def test_states_before_the_robot_was_lost_do_not_come_back() -> None:
    lost = message("", Verdict.UNKNOWN, 0.0, "no robot_description yet")
    status = reader_after(message("tool"), message("elbow"), lost).status
    assert list(status.contacts) == [""]
    assert [episode.verdict for episode in status.episodes] == [Verdict.UNKNOWN] * 2
    status = reader_after(message("tool"), lost, message("flange", Verdict.WARN)).status
    assert (status.verdict, list(status.contacts)) == (Verdict.WARN, ["flange"])


def test_verdict_of_a_successor_counts_although_the_earlier_monitor_had_the_same() -> None:
    """Else the OK of the other contact point would end the episode."""
    reader = reader_after(message("tool", Verdict.VIOLATION), message("elbow", Verdict.WARN))
    for number, data in enumerate((message("tool", Verdict.VIOLATION), message("elbow"))):
        reader.take(data, number + 1, 10_000 * MS + number)
    assert (reader.status.verdict, reader.status.contact_point) == (Verdict.VIOLATION, "tool")


def test_contact_points_of_an_earlier_monitor_in_the_same_batch_are_gone() -> None:
    reader = ContactStateReader(CellStatus(0))
    reader.take(message("tool"), 7, MS)
    reader.take(message("flange"), 1, 10_000 * MS)
    reader.finish()
    assert list(reader.status.contacts) == ["flange"]


def test_speed_that_is_no_number_is_noticed_though_the_next_state_has_one() -> None:
    status = reader_after(message("tool"), message("tool", speed=float("nan")), message("tool")).status
    assert status.verdict is Verdict.OK
    assert status.episodes[-1].cause == "the contact state has a speed that is not a number"


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
    qos = topics.verdict_qos(deadline_s / 2) if topic == topics.CONTACT_STATE else topics.INFO_QOS
    return node.create_publisher(kind, topic, qos_profile(qos))


def test_a_verdict_of_one_message_is_not_missed_and_silence_is_unknown(node: Node) -> None:
    states = publisher(node, ContactState, topics.CONTACT_STATE)

    def send(verdict: Verdict, speed: float, reason: str = "") -> None:
        contact = unknown_contact("tool", reason, 1, 0.0)
        contact = contact._replace(verdict=verdict, speed=speed, allowable_speed=0.5)
        states.publish(ContactStateEncoder("tool", "base_link").encode(contact))

    with CellClient("display", NAMESPACE) as client:
        poll_until(client, lambda s: s.verdict is Verdict.OK, lambda: send(Verdict.OK, 0.1))
        assert client.status.timeout_ns == DEADLINE_S * 1e9
        for verdict, speed, reason in ((Verdict.OK, 0.3, ""), (Verdict.WARN, 0.45, "close"), (Verdict.OK, 0.2, "")):
            send(verdict, speed, reason)
        poll_until(client, lambda s: s.episodes[-1].cause == "close" and s.verdict is Verdict.OK)
        assert max(sample.speed for sample in client.status.speeds) == 0.45
        poll_until(client, lambda s: s.verdict is Verdict.UNKNOWN)
        silence = "the monitor is silent: no contact state for "
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
            states, first = publisher(other, ContactState, topics.CONTACT_STATE, 20.0), states

            def send_both() -> None:
                nonlocal states, first
                states, first = first, states
                send(Verdict.OK, 0.1)

            poll_until(client, lambda s: s.reason.startswith("two monitors"), send_both)
            # Its longer deadline must not cover the silence of the first one.
            end = time.monotonic() + 0.5
            poll_until(client, lambda _: time.monotonic() > end, send_both)
            assert client.status.timeout_ns == DEADLINE_S * 1e9
            poll_until(client, lambda s: s.verdict is Verdict.OK, lambda: send(Verdict.OK, 0.1))
        node.destroy_publisher(next(p for p in node.publishers if p.topic_name == "/cell/contact_state"))
        poll_until(client, lambda s: s.reason == "no monitor: contact_state has no publisher")


def test_every_topic_of_the_cell_arrives(node: Node) -> None:
    impact = Impact(peak_force=100.0, duration=0.01, simulated=True)
    validation = ImpactValidation(predicted_force=110.0, measured_force=100.0, count=1)
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
