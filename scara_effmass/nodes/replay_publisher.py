"""The topics of a recording as publishers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rclpy.event_handler import PublisherEventCallbacks
from rosgraph_msgs.msg import Clock

from scara_effmass.errors import BagError, SettingsError
from scara_effmass.nodes.qos import qos_profile
from scara_effmass.wire import topics as wire_topics
from scara_effmass.wire.message_types import message_class
from scara_effmass.wire.topics import (
    CLOCK,
    FORCE_OUTPUTS,
    IMPACT_VALIDATION,
    MONITOR_OUTPUTS,
    ROBOT_DESCRIPTION,
    STREAM_QOS,
)

if TYPE_CHECKING:
    from collections.abc import Collection

    from rclpy.event_handler import QoSPublisherMatchedInfo
    from rclpy.node import Node

    from scara_effmass.bags.bag import Bag

JOINT_STATES = f"/{wire_topics.JOINT_STATES}"
COMPUTED = (
    *MONITOR_OUTPUTS,
    *FORCE_OUTPUTS,
    *(IMPACT_VALIDATION, "diagnostics"),
)
"""What the live nodes publish themselves: not replayed unless asked for by name. Force is played by daq_node."""
LATCHED = (ROBOT_DESCRIPTION, "tf_static", wire_topics.RUN_INFO, "recording_info")
"""What is published once and kept for those who come later."""


class ReplayPublisher:
    """One topic that is published: reliably, and deep enough for readers that fall behind for a while."""

    def __init__(self, node: Node, name: str, message_class: type) -> None:
        """Publish on `name`; `subscribers` then follows the matches, which also wake the executor."""
        self.sent = 0
        self.subscribers = 0
        self.heard = False
        self.latched = name.rsplit("/", 1)[-1] in LATCHED
        # A publisher that keeps messages for late readers also fits readers that do not want them.
        self.publisher = node.create_publisher(
            message_class,
            name,
            qos_profile(STREAM_QOS._replace(latched=self.latched)),
            event_callbacks=PublisherEventCallbacks(matched=self._on_matched),
        )

    @property
    def name(self) -> str:
        """The topic, with its namespace."""
        return str(self.publisher.topic_name)

    def send(self, message: Any) -> None:  # noqa: ANN401 - a message of any class, or its bytes
        """Publish one message."""
        self.sent += 1  # first: a signal may break in between, and what somebody has heard was sent
        self.publisher.publish(message)

    def _on_matched(self, info: QoSPublisherMatchedInfo) -> None:
        self.subscribers = info.current_count
        self.heard = self.heard or info.current_count > 0


def clock_publisher(node: Node) -> ReplayPublisher:
    """Return the publisher of the clock."""
    return ReplayPublisher(node, CLOCK, Clock)


def replay_publishers(
    bag: Bag, node: Node, topics: Collection[str], joint_states: str
) -> tuple[dict[str, ReplayPublisher], dict[str, str]]:
    """Return a publisher for each topic of `bag` that is replayed, and why each of the others is not.

    `topics` are those asked for, none: all but the clock and what live nodes compute. The topic `joint_states` is
    published as /joint_states. Raises BagError when a topic asked for is not there, SettingsError when nothing is
    left to be replayed.
    """
    _check_asked_for(bag, topics, joint_states)
    names = [topic.name for topic in bag.topics]
    outlets: dict[str, ReplayPublisher] = {}
    skipped: dict[str, str] = {}
    for topic in bag.topics:
        as_joint_states = topic.name == joint_states
        reason = "" if as_joint_states else _not_wanted(topic.name, topics, joint_states)
        if not reason and names.count(topic.name) > 1:
            reason = "it holds messages of more than one type"
        installed = None if reason else message_class(topic.type)
        if not reason and installed is None:
            reason = f"its type {topic.type or '(none)'} is not installed"
        if installed is not None:
            outlet = ReplayPublisher(node, JOINT_STATES if as_joint_states else topic.name, installed)
            reason = _other_definition(bag, node, outlet, topic.type)
            if reason:
                node.destroy_publisher(outlet.publisher)
            else:
                outlets[topic.name] = outlet
        if reason:
            skipped[topic.name] = reason
    if not outlets:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in skipped.items())
        raise SettingsError(f"{bag.path}: nothing to replay: {reasons}")
    return outlets, skipped


def _check_asked_for(bag: Bag, topics: Collection[str], joint_states: str) -> None:
    known = [topic.name for topic in bag.topics]
    for name in (*topics, *filter(None, (joint_states,))):
        if name not in known:
            raise BagError(f"{bag.path}: no topic {name}; there are {', '.join(known)}")
    if joint_states and joint_states not in bag.joint_state_topics:
        right = ", ".join(bag.joint_state_topics) or "none here"
        raise BagError(f"{bag.path}: {joint_states} holds no joint states; those that do: {right}")


def _not_wanted(name: str, topics: Collection[str], joint_states: str) -> str:
    if name == CLOCK:
        return "the replay makes the clock itself"
    if joint_states and name == JOINT_STATES:
        return f"{joint_states} is published in its place"
    if topics:
        return "" if name in topics else "not asked for"
    if name.rsplit("/", 1)[-1] in COMPUTED:
        return "the live nodes publish it themselves"
    return ""


def _other_definition(bag: Bag, node: Node, outlet: ReplayPublisher, kind: str) -> str:
    """Return why bytes as recorded would be misread by the installed type, if they would."""
    try:
        recorded = bag.types.hash_rihs01(kind)
    except (LookupError, TypeError):
        return f"the recording does not define {kind}"
    infos = node.get_publishers_info_by_topic(outlet.name)
    mine = (info for info in infos if info.node_name == node.get_name() and info.topic_type == kind)
    own = next((str(info.topic_type_hash) for info in mine), "")
    return "" if recorded == own else f"its definition of {kind} is not the installed one"
