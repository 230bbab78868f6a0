# SPDX-License-Identifier: Apache-2.0
"""Publishers of a replay: which topics of a bag are replayed, under which name, and why others are not."""

from collections.abc import Collection, Sequence
from typing import Any

from geometry_msgs.msg import Inertia
from rclpy.event_handler import PublisherEventCallbacks, QoSPublisherMatchedInfo
from rclpy.node import Node

from scara_effmass.bags.bag import Bag
from scara_effmass.errors import BagError, SettingsError
from scara_effmass.nodes.ros import qos_profile
from scara_effmass.wire import topics as wire_topics
from scara_effmass.wire.message_types import message_class
from scara_effmass.wire.topics import CLOCK, STREAM_QOS

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
