"""ROS side of a replay: its node, a publisher per replayed topic, and interruption by signals."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Any, final

from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, QoSPublisherMatchedInfo
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions, get_current_signal_handlers_options

from scara_effmass.errors import BagError, SettingsError
from scara_effmass.nodes.client import ClientNode
from scara_effmass.nodes.qos import qos_profile
from scara_effmass.wire import topics as wire_topics
from scara_effmass.wire.message_types import message_class
from scara_effmass.wire.topics import (
    CLOCK,
    DIAGNOSTICS,
    FORCE_OUTPUTS,
    IMPACT_VALIDATION,
    MONITOR_OUTPUTS,
    ROBOT_DESCRIPTION,
    RUN_INFO,
    STREAM_QOS,
)

if TYPE_CHECKING:
    from scara_effmass.bags.bag import Bag

JOINT_STATES = f"/{wire_topics.JOINT_STATES}"
NODE_OUTPUTS = {name.rpartition("/")[2] for name in (*MONITOR_OUTPUTS, *FORCE_OUTPUTS, IMPACT_VALIDATION, DIAGNOSTICS)}
"""Outputs of the live nodes, in any namespace, which are replayed only on request. `daq_node` plays recorded force."""
LATCHED = {"recording_info", *(name.rpartition("/")[2] for name in (ROBOT_DESCRIPTION, "/tf_static", RUN_INFO))}
"""Topics whose last messages a late subscriber receives; recording_info is the RunInfo of old bags."""
SETTLING_NS = 300_000_000
MAX_SETTLING_NS = 3_000_000_000
_ACKNOWLEDGEMENT_NS = 10_000_000_000
_ACKNOWLEDGEMENT_STEP_NS = 100_000_000


def settling_time_ns(discovery_ns: int) -> int:
    """Return how long to wait for nodes that do not report their readiness, after a discovery that took so long."""
    return min(max(SETTLING_NS, discovery_ns), MAX_SETTLING_NS)


class ReplayPublisher:
    """Reliable publisher of one topic, deep enough for subscribers that fall behind for a while."""

    def __init__(self, node: Node, name: str, message_class: type) -> None:
        """Publish on `name`; a match updates `subscribers` and wakes the executor."""
        self.sent = 0
        self.subscribers = 0
        self.had_subscriber = False
        self.latched = name.rpartition("/")[2] in LATCHED
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
        self.sent += 1  # before publishing: a signal may interrupt in between
        self.publisher.publish(message)

    def _on_matched(self, info: QoSPublisherMatchedInfo) -> None:
        self.subscribers = info.current_count
        self.had_subscriber = self.had_subscriber or info.current_count > 0


def replay_publishers(
    bag: Bag, node: Node, topics: Collection[str], joint_state_topic: str
) -> tuple[dict[str, ReplayPublisher], dict[str, str]]:
    """Return a publisher for each replayed topic of `bag`, and the reason for each topic that is not replayed.

    `topics` selects topics; if empty, all but the clock and the outputs of live nodes. `joint_state_topic` is
    published as /joint_states. Raises BagError for a topic that the bag does not have, SettingsError if nothing is
    left to replay.
    """
    names = [topic.name for topic in bag.topics]
    _check_topics(bag, names, topics, joint_state_topic)
    publishers: dict[str, ReplayPublisher] = {}
    skipped: dict[str, str] = {}
    for topic in bag.topics:
        is_joint_states = topic.name == joint_state_topic
        reason = "" if is_joint_states else _reason_to_skip(topic.name, topics, joint_state_topic)
        if not reason and names.count(topic.name) > 1:
            reason = "it holds messages of more than one type"
        installed_class = None if reason else message_class(topic.type)
        if not reason and installed_class is None:
            reason = f"its type {topic.type or '(none)'} is not installed"
        if installed_class is not None:
            publisher = ReplayPublisher(node, JOINT_STATES if is_joint_states else topic.name, installed_class)
            reason = _definition_mismatch(bag, node, publisher, topic.type)
            if reason:
                node.destroy_publisher(publisher.publisher)
            else:
                publishers[topic.name] = publisher
        if reason:
            skipped[topic.name] = reason
    if not publishers:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in skipped.items())
        raise SettingsError(f"{bag.path}: nothing to replay: {reasons}")
    return publishers, skipped


def _check_topics(bag: Bag, names: Collection[str], topics: Collection[str], joint_state_topic: str) -> None:
    for name in (*topics, *filter(None, (joint_state_topic,))):
        if name not in names:
            raise BagError(f"{bag.path}: no topic {name}; expected one of {', '.join(names)}")
    if joint_state_topic and joint_state_topic not in bag.joint_state_topics:
        candidates = ", ".join(bag.joint_state_topics) or "none here"
        raise BagError(f"{bag.path}: {joint_state_topic} holds no joint states; topics that do: {candidates}")


def _reason_to_skip(name: str, topics: Collection[str], joint_state_topic: str) -> str:
    if name == CLOCK:
        return "the replay publishes its own clock"
    if joint_state_topic and name == JOINT_STATES:
        return f"{joint_state_topic} is published in its place"
    if topics:
        return "" if name in topics else "not selected"
    return "the live nodes publish it" if name.rpartition("/")[2] in NODE_OUTPUTS else ""


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


@final
class ReplayNode(ClientNode):
    """Node of a replay, which publishes the topics of the recording only."""

    def __init__(self) -> None:
        """Create the node."""
        super().__init__("replay")

    def spin_until(self, deadline_ns: int, done: Callable[[], bool] = bool) -> None:
        """Handle events until `done` or until the monotonic clock shows `deadline_ns`."""
        self.spin_for((deadline_ns - time.monotonic_ns()) / 1e9, done)

    def wait_acknowledged(self, publishers: Collection[ReplayPublisher]) -> list[str]:
        """Wait until the subscribers have received everything; return the topics not acknowledged within 10 s.

        Best-effort subscribers acknowledge nothing and get 0.3 s. Fast DDS asks reliable ones every 3 s.
        """
        self.spin_until(time.monotonic_ns() + SETTLING_NS)
        deadline_ns = time.monotonic_ns() + _ACKNOWLEDGEMENT_NS
        pending = list(publishers)
        while pending and time.monotonic_ns() < deadline_ns:
            if pending[0].publisher.wait_for_all_acked(Duration(nanoseconds=_ACKNOWLEDGEMENT_STEP_NS)):
                del pending[0]
        return [publisher.name for publisher in pending]


@final
class Interruption:
    """Turns the first SIGINT or SIGTERM into a KeyboardInterrupt, inside `allowed` only.

    It does nothing outside the main thread, and where rclpy handles the signals of the process.
    """

    def __init__(self) -> None:
        self._requested = False
        self._allowed = False
        self._handlers: dict[signal.Signals, Any] = {}
        in_main_thread = threading.current_thread() is threading.main_thread()
        if in_main_thread and get_current_signal_handlers_options() == SignalHandlerOptions.NO:
            self._handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    @contextmanager
    def allowed(self) -> Iterator[None]:
        """Let a signal, also an earlier one, raise KeyboardInterrupt in this `with`."""
        self._allowed = True
        try:
            if self._requested:
                raise KeyboardInterrupt
            yield
        finally:
            self._allowed = False

    def __enter__(self) -> Interruption:
        for number in self._handlers:
            signal.signal(number, self._on_signal)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        self._requested = True
        if self._allowed:
            # A launcher sends SIGINT twice: the second one must not interrupt the clean-up.
            self._allowed = False
            raise KeyboardInterrupt
