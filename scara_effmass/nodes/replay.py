# SPDX-License-Identifier: Apache-2.0
"""Replay a bag to the live nodes, with `/clock`.

The clock shows the start until every node that consumes the replay is ready. Then it is set before each message and
at least every 10 ms of recorded time. Clock and messages travel on different topics, so a message may overtake its
clock and then seems up to 10 ms newer than the clock; the monitor's `future_tolerance` covers this.
"""

import math
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, islice
from pathlib import Path
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Inertia
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, QoSPublisherMatchedInfo
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from scara_effmass.bags.bag import Bag, RawMessage
from scara_effmass.bags.batches import MAX_TIME_NS
from scara_effmass.bags.files import open_bag
from scara_effmass.errors import BagError, EffmassError, SettingsError
from scara_effmass.nodes.diagnostics import several_publishers
from scara_effmass.nodes.readiness import ReadinessReports
from scara_effmass.nodes.ros import ClientNode, qos_profile
from scara_effmass.wire import topics as wire_topics
from scara_effmass.wire.cdr import NS
from scara_effmass.wire.message_types import message_class
from scara_effmass.wire.topics import CLOCK, STREAM_QOS

CLOCK_STEP_NS = 10_000_000
"""Maximum recorded time between two clock messages."""
LATE_NS = 10_000_000
SETTLING_NS = 300_000_000
MAX_SETTLING_NS = 3_000_000_000
"""Limits of the wait for subscribers that do not report their readiness. Between them it lasts as long as discovery."""
_ACKNOWLEDGEMENT_NS = 10_000_000_000
_ACKNOWLEDGEMENT_STEP_NS = 100_000_000
_HANDSHAKE_STEP_NS = 50_000_000
_PROGRESS_NS = 100_000_000
JOINT_STATES = f"/{wire_topics.JOINT_STATES}"
NODE_OUTPUTS = {
    *wire_topics.MONITOR_OUTPUTS,
    *wire_topics.FORCE_OUTPUTS,
    wire_topics.IMPACT_VALIDATION,
    wire_topics.DIAGNOSTICS.removeprefix("/"),
}
"""Outputs of the live nodes, in any namespace, which are replayed only on request. `daq_node` plays recorded force."""
SHARED = {"/tf", "/tf_static", wire_topics.DIAGNOSTICS}
"""Topics that keep their names in every namespace."""
LATCHED = {"tf_static", wire_topics.ROBOT_DESCRIPTION, wire_topics.RUN_INFO}
"""Topics whose last message late subscribers receive, as with all payloads."""


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """Options of a replay."""

    bag: Path
    rate: float = 1.0
    """Speed relative to the recording, independent of the nodes."""
    start_s: float = 0.0
    """Start in the recording [s]."""
    duration_s: float = math.inf
    """Recorded time to replay [s]."""
    passes: int = 1
    """Number of passes; 0: until interrupted. The clock jumps back between two passes."""
    topics: tuple[str, ...] = ()
    """Topics to replay; empty: all but the clock and the outputs of the live nodes."""
    joint_state_topic: str = ""
    """Topic that is published as joint_states; empty: every topic keeps its name."""
    ros_arguments: tuple[str, ...] = ()
    """A namespace that they state is put in front of every topic."""
    subscribers: int = 1
    """Minimum number of subscribers of the joint states, or of any topic without joint states, before the start."""
    ready_timeout_s: float = 30.0
    """Maximum wait for the nodes [s]. DDS forgets a killed node after 20 s."""


OnProgress = Callable[[int, float, float], None]
"""Called with the number of the pass, the recorded time since its start [s], and that of a whole pass [s]."""


@dataclass(slots=True)
class ReplayReport:
    """Result of a replay."""

    sent: Mapping[str, int] = field(default_factory=dict)
    """Messages per published topic, without the clock."""
    skipped: Mapping[str, str] = field(default_factory=dict)
    """Topics of the recording that were not replayed, and the reason."""
    unheard: tuple[str, ...] = ()
    """Topics without any subscriber."""
    unacknowledged: tuple[str, ...] = ()
    """Topics of which a reliable subscriber had not received everything at the end."""
    passes: int = 0
    """Passes started."""
    replayed_s: float = 0.0
    """Recorded time that was replayed."""
    wall_s: float = 0.0
    late: int = 0
    """Messages sent more than 10 ms late."""
    worst_lateness_s: float = 0.0
    interrupted: bool = False
    warnings: tuple[str, ...] = ()

    @property
    def achieved_rate(self) -> float:
        """Recorded time per wall time."""
        return self.replayed_s / self.wall_s if self.wall_s > 0.0 else 0.0


def timeline(messages: Iterable[RawMessage], start_ns: int, end_ns: int) -> Iterator[tuple[int, RawMessage | None]]:
    """Yield the recorded times at which to set the clock, each with the message to send then, if there is one.

    There is a time at the start, at each message and every 10 ms in the gaps, in order.
    """

    def gap(until_ns: int) -> Iterator[tuple[int, None]]:
        return ((time_ns, None) for time_ns in range(now_ns + CLOCK_STEP_NS, until_ns, CLOCK_STEP_NS))

    now_ns = start_ns
    yield now_ns, None
    for message in messages:
        yield from gap(message.log_time_ns)
        now_ns = max(now_ns, message.log_time_ns)
        yield now_ns, message
    yield from gap(end_ns)


def replay(options: ReplayOptions, on_progress: OnProgress = lambda *_: None) -> ReplayReport:
    """Replay a bag to the live nodes; call `on_progress` about ten times a second.

    SIGINT and SIGTERM end the replay early. It runs in its own ROS context. Raises BagError for an unreadable bag,
    EffmassError if nodes are not ready in time.
    """
    with ClientNode("replay", arguments=options.ros_arguments) as client, open_bag(options.bag) as bag:
        player = _Player(options, bag, client, on_progress)
        report = player.report
        try:
            player.play()
        except KeyboardInterrupt:
            report.interrupted = True
        publishers = player.publishers.values()
        report.sent = {publisher.name: publisher.sent for publisher in publishers}
        report.unheard = tuple(publisher.name for publisher in publishers if not publisher.had_subscriber)
        report.warnings = (*bag.losses, *player.other_publishers.values())
        return report


class _Player:
    """State and endpoints of one replay."""

    def __init__(self, options: ReplayOptions, bag: Bag, client: ClientNode, on_progress: OnProgress) -> None:
        self._options = options
        self._bag = bag
        self._client = client
        self._on_progress = on_progress
        self._start_ns = bag.start_ns + round(min(options.start_s * NS, float(MAX_TIME_NS)))
        if self._start_ns > bag.end_ns:
            rule = f"must be within the {bag.duration_ns / NS:.3f} s recorded"
            raise SettingsError(f"{bag.path}: start = {options.start_s} s: {rule}")
        self._stop_ns = MAX_TIME_NS
        if options.duration_s < (MAX_TIME_NS - self._start_ns) / NS:
            self._stop_ns = self._start_ns + round(options.duration_s * NS)
        self._end_ns = min(self._stop_ns, bag.end_ns)
        self.report = ReplayReport()
        self.publishers, self.report.skipped = replay_publishers(
            bag, client.node, options.topics, options.joint_state_topic
        )
        self._joint_states = next(
            (p for p in self.publishers.values() if p.name == in_namespace(client.node, JOINT_STATES)), None
        )
        self._clock = ReplayPublisher(client.node, CLOCK, Clock)  # after all other publishers
        self._readiness = ReadinessReports(client.node)  # after all other subscriptions
        self._now_ns = self._start_ns
        self._progress_ns = 0
        self.other_publishers: dict[str, str] = {}
        """Warning of each topic that others publish, too, by name; receivers then mix their messages."""

    def play(self) -> None:
        """Wait for the nodes, play all passes, and wait until every subscriber has received everything."""
        self._wait_until_ready()
        latched = [name for name, publisher in self.publishers.items() if publisher.latched]
        if latched and self._start_ns > self._bag.start_ns:
            for message in self._bag.messages(latched, stop_ns=self._start_ns):
                self.publishers[message.topic].send(message.data)
        report = self.report
        while not self._options.passes or report.passes < self._options.passes:
            report.passes += 1
            messages = self._bag.messages(self.publishers.keys(), self._start_ns, self._stop_ns)
            messages = chain(list(islice(messages, 1)), messages)  # opens the files before the time is taken
            self._now_ns = self._start_ns
            pass_start_ns = time.monotonic_ns()
            try:
                self._play_pass(messages, pass_start_ns)
            finally:
                report.wall_s += (time.monotonic_ns() - pass_start_ns) / NS
                report.replayed_s += (self._now_ns - self._start_ns) / NS
        report.unacknowledged = self._wait_acknowledged()

    def _wait_until_ready(self) -> None:
        """Hold the clock at the start until all nodes have been ready for the settling time. Raises EffmassError."""
        timeout_s = self._options.ready_timeout_s
        start_ns = ready_since_ns = time.monotonic_ns()
        while True:
            self._set_clock(self._start_ns)
            self._spin_until(time.monotonic_ns() + _HANDSHAKE_STEP_NS)
            now_ns = time.monotonic_ns()
            if unready := self._unready():
                ready_since_ns = now_ns
                if now_ns - start_ns > timeout_s * NS:
                    raise EffmassError(f"not ready within {timeout_s:g} s: {unready}")
            elif now_ns - ready_since_ns >= min(max(SETTLING_NS, ready_since_ns - start_ns), MAX_SETTLING_NS):
                return

    def _unready(self) -> str:
        """Return what is not ready yet, empty if nothing."""
        inputs = [self._joint_states] if self._joint_states else list(self.publishers.values())
        expected, count = self._options.subscribers, max(publisher.subscribers for publisher in inputs)
        if count < expected:
            topics = ", ".join(publisher.name for publisher in inputs)
            return f"{topics}: expected {expected} subscribers, found {count}"
        unready = self._readiness.unready(self._start_ns, [publisher.name for publisher in self.publishers.values()])
        return "; ".join(f"{name} {reason}" for name, reason in sorted(unready.items()))

    def _play_pass(self, messages: Iterator[RawMessage], pass_start_ns: int) -> None:
        clock_ns = -1
        for time_ns, message in timeline(messages, self._start_ns, self._end_ns):
            due_ns = pass_start_ns + round((time_ns - self._start_ns) / self._options.rate)
            self._spin_until(due_ns)
            lateness_ns = time.monotonic_ns() - due_ns
            self.report.late += lateness_ns > LATE_NS
            self.report.worst_lateness_s = max(self.report.worst_lateness_s, lateness_ns / NS)
            self._now_ns = time_ns
            if time_ns != clock_ns:
                clock_ns = time_ns
                self._set_clock(time_ns)
            if message is not None:
                self.publishers[message.topic].send(message.data)
            self._report_progress()

    def _set_clock(self, time_ns: int) -> None:
        sec, nanosec = divmod(time_ns, NS)
        self._clock.send(Clock(clock=Time(sec=sec, nanosec=nanosec)))

    def _spin_until(self, deadline_ns: int) -> None:
        """Handle events until the monotonic clock shows `deadline_ns`; a signal interrupts."""
        self._client.spin_for((deadline_ns - time.monotonic_ns()) / NS)
        if self._client.signals:
            raise KeyboardInterrupt

    def _wait_acknowledged(self) -> tuple[str, ...]:
        """Wait until the subscribers have received everything; return the topics not acknowledged within 10 s.

        Best-effort subscribers acknowledge nothing and get 0.3 s. Fast DDS asks reliable ones every 3 s.
        """
        self._spin_until(time.monotonic_ns() + SETTLING_NS)
        deadline_ns = time.monotonic_ns() + _ACKNOWLEDGEMENT_NS
        pending = list(self.publishers.values())
        while pending and time.monotonic_ns() < deadline_ns:
            self._spin_until(0)
            if pending[0].publisher.wait_for_all_acked(Duration(nanoseconds=_ACKNOWLEDGEMENT_STEP_NS)):
                del pending[0]
        return tuple(publisher.name for publisher in pending)

    def _report_progress(self) -> None:
        now_ns = time.monotonic_ns()
        if now_ns - self._progress_ns < _PROGRESS_NS:
            return
        self._progress_ns = now_ns
        for name in {CLOCK, *(publisher.name for publisher in self.publishers.values())} - SHARED:
            if warning := several_publishers(self._client.node, name):
                self.other_publishers[name] = warning
        self._on_progress(
            self.report.passes,
            (self._now_ns - self._start_ns) / NS,
            (self._end_ns - self._start_ns) / NS,
        )


def in_namespace(node: Node, topic: str) -> str:
    """Return the name under which `node` publishes a recorded `topic`: in its namespace, unless all cells share it."""
    namespace = node.get_namespace().rstrip("/")
    is_there = topic in SHARED or topic.startswith(f"{namespace}/")
    return str(node.resolve_topic_name(topic if is_there else namespace + topic))


class ReplayPublisher:
    """Reliable publisher of one topic, deep enough for subscribers that fall behind for a while."""

    def __init__(self, node: Node, name: str, message_class: type) -> None:
        """Publish on `name`; a match updates `subscribers` and wakes the executor."""
        self.sent = 0
        self.subscribers = 0
        self.had_subscriber = False
        self.latched = name.rpartition("/")[2] in LATCHED or message_class is Inertia
        self.publisher = node.create_publisher(
            message_class,
            name,
            qos_profile(STREAM_QOS._replace(latched=self.latched)),
            event_callbacks=PublisherEventCallbacks(matched=self._on_matched),
        )

    @property
    def name(self) -> str:
        """The fully qualified topic name."""
        return str(self.publisher.topic_name)

    def send(self, message: Any) -> None:  # noqa: ANN401 - a message of any class, or its bytes
        """Publish one message."""
        self.publisher.publish(message)
        self.sent += 1

    def _on_matched(self, info: QoSPublisherMatchedInfo) -> None:
        self.subscribers = info.current_count
        self.had_subscriber = self.had_subscriber or info.current_count > 0


def replay_publishers(
    bag: Bag, node: Node, topics: Collection[str], joint_state_topic: str
) -> tuple[dict[str, ReplayPublisher], dict[str, str]]:
    """Return a publisher for each replayed topic of `bag`, and the reason for each topic that is not replayed.

    `topics` selects topics; if empty, all but the clock and the outputs of live nodes. `joint_state_topic` is
    published as joint_states. Raises BagError for a topic that the bag does not have, SettingsError if nothing is
    left to replay.
    """
    names = [topic.name for topic in bag.topics]
    for name in (*topics, *filter(None, (joint_state_topic,))):
        if name not in names:
            raise BagError(f"{bag.path}: no topic {name}; expected one of {', '.join(names)}")
    if joint_state_topic and joint_state_topic not in bag.joint_state_topics:
        candidates = ", ".join(bag.joint_state_topics) or "none here"
        raise BagError(f"{bag.path}: {joint_state_topic} holds no joint states; topics that do: {candidates}")
    publishers: dict[str, ReplayPublisher] = {}
    skipped: dict[str, str] = {}
    for topic in bag.topics:
        is_joint_states = topic.name == joint_state_topic
        reason = "" if is_joint_states else _reason_to_skip(topic.name, names, topics, joint_state_topic)
        installed_class = message_class(topic.type)
        if reason or installed_class is None:
            skipped[topic.name] = reason or f"its type {topic.type or '(none)'} is not installed"
            continue
        publisher = ReplayPublisher(
            node, in_namespace(node, JOINT_STATES if is_joint_states else topic.name), installed_class
        )
        if reason := _definition_mismatch(bag, node, publisher, topic.type):
            node.destroy_publisher(publisher.publisher)
            skipped[topic.name] = reason
        else:
            publishers[topic.name] = publisher
    if not publishers:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in skipped.items())
        raise SettingsError(f"{bag.path}: nothing to replay: {reasons}")
    return publishers, skipped


def _reason_to_skip(name: str, names: Sequence[str], topics: Collection[str], joint_state_topic: str) -> str:
    if name == CLOCK:
        return "the replay publishes its own clock"
    if joint_state_topic and name == JOINT_STATES:
        return f"{joint_state_topic} is published in its place"
    if topics and name not in topics:
        return "not selected"
    if not topics and name.rpartition("/")[2] in NODE_OUTPUTS:
        return "the live nodes publish it"
    return "it holds messages of more than one type" if names.count(name) > 1 else ""


def _definition_mismatch(bag: Bag, node: Node, publisher: ReplayPublisher, message_type: str) -> str:
    """Return why subscribers would misread the recorded bytes, empty if they would not."""
    try:
        recorded_hash = bag.types.hash_rihs01(message_type)
    except (LookupError, TypeError):
        return f"the recording does not define {message_type}"
    endpoints = node.get_publishers_info_by_topic(publisher.name)
    own = (info for info in endpoints if info.node_name == node.get_name() and info.topic_type == message_type)
    if recorded_hash in {str(info.topic_type_hash) for info in own}:
        return ""
    return f"its definition of {message_type} is not the installed one"
