"""Live topics into a recording: found as they appear, subscribed to as their publishers offer them."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, final

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.exceptions import InvalidTopicNameException
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

from scara_effmass.bags.installed_types import types_for
from scara_effmass.bags.rosbag2 import OfferedQos, qos_text
from scara_effmass.errors import BagError, SettingsError
from scara_effmass.nodes.qos import qos_profile
from scara_effmass.wire.message_types import message_class, message_definition
from scara_effmass.wire.topics import STREAM_QOS

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence

    from rclpy.event_handler import QoSMessageLostInfo
    from rclpy.node import Node
    from rclpy.topic_endpoint_info import TopicEndpointInfo

    from scara_effmass.bags.recording import BagRecorder


_LOOKS_BEFORE_A_WORD = 20


def resolved(node: Node, topic: str) -> str:
    """Return a name in full, remapped and with its namespace. Raises SettingsError for one that is none."""
    try:
        return str(node.resolve_topic_name(topic))
    except (InvalidTopicNameException, RuntimeError, ValueError) as error:
        reason = " ".join(str(error).split()).partition(", at /")[0]
        raise SettingsError(f"record: topic {topic!r}: {reason}") from None


@final
class TopicRecorder:
    """The subscriptions of a recorder."""

    def __init__(
        self,
        node: Node,
        recording: BagRecorder,
        topics: Collection[str],
        say: Callable[[str], None],
        below: Collection[str] = (),
    ) -> None:
        """Record `topics`, and what stands below the names `below`, all in full; no topics: all that are not hidden.

        `say` is told what cannot be recorded.
        """
        self.refused: dict[str, str] = {}
        """Topics that cannot be recorded, or not all of what is published there, and why."""
        self._node = node
        self._clock = node.get_clock()
        self._recording = recording
        self._topics = frozenset(topics)
        self._below = tuple(f"{name}/" for name in below)
        self._say = say
        self._numbers: dict[str, int] = {}
        self._kinds: dict[str, str] = {}
        self._subscriptions: dict[str, Any] = {}
        self._unfit: set[str] = set()
        self._looks_in_vain = 0

    @property
    def found(self) -> Collection[str]:
        """The topics that are being recorded."""
        return self._numbers.keys()

    def look(self) -> None:
        """Subscribe to what has appeared since the last time, and anew where a publisher does not fit."""
        # On simulated time nothing has a time before the first /clock.
        if not self._clock.now().nanoseconds:
            self._looks_in_vain += 1
            if self._looks_in_vain == _LOOKS_BEFORE_A_WORD:
                self._say("waiting for the first /clock: use_sim_time is set")
            return
        for name, kinds in self._node.get_topic_names_and_types():
            if self._is_wanted(name):
                self._add(name, kinds)
            elif len(kinds) > 1 and name in self._kinds and name not in self.refused:
                self._look_at_types(name)
        for name in self._unfit & self._subscriptions.keys():
            self._say(f"{name}: a publisher offers less than the others: subscribed anew, messages may be missing")
            self._node.destroy_subscription(self._subscriptions.pop(name))
        self._unfit.clear()

    def _is_wanted(self, name: str) -> bool:
        if name in self._subscriptions or name in self.refused:
            return False
        if self._topics:
            return name in self._topics or name.startswith(self._below)
        return not any(token.startswith("_") for token in name.split("/"))

    def _add(self, name: str, kinds: Sequence[str]) -> None:
        publishers = self._node.get_publishers_info_by_topic(name)
        if not publishers:
            return  # what they offer is not known yet
        (kind, *others) = sorted({publisher.topic_type for publisher in publishers} or kinds)
        found = message_class(kind)
        if others:
            reason = f"it has publishers of several types: {', '.join((kind, *others))}"
        elif found is None:
            reason = f"its type {kind} is not installed; install {kind.partition('/')[0]}"
        else:
            try:
                self._subscribe(name, kind, found, publishers)
            except BagError as error:
                reason = str(error)
            else:
                return
        self.refused[name] = reason
        self._say(f"{name}: not recorded: {reason}")

    def _look_at_types(self, name: str) -> None:
        """Say so if a publisher has come whose type is not that which is being recorded."""
        kind = self._kinds[name]
        others = {publisher.topic_type for publisher in self._node.get_publishers_info_by_topic(name)} - {kind}
        if others:
            self.refused[name] = f"it is published as {', '.join(sorted(others))}, too; only {kind} is recorded"
            self._say(f"{name}: {self.refused[name]}")

    def _subscribe(self, name: str, kind: str, found: type, publishers: Sequence[TopicEndpointInfo]) -> None:
        """Subscribe with what all publishers offer. Raises BagError for a definition that is not theirs."""
        if name not in self._numbers:
            types = types_for(kind, str(publishers[0].topic_type_hash), message_definition)
            offered = qos_text(_offered(publisher) for publisher in publishers)
            self._numbers[name] = self._recording.add_topic(name, kind, offered_qos=offered, types=types)
        number, self._kinds[name] = self._numbers[name], kind
        reliable = all(p.qos_profile.reliability == ReliabilityPolicy.RELIABLE for p in publishers)
        latched = all(p.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in publishers)
        self._subscriptions[name] = self._node.create_subscription(
            found,
            name,
            partial(self._on_message, number),
            qos_profile(STREAM_QOS._replace(reliable=reliable, latched=latched)),
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(
                message_lost=partial(self._on_lost, number),
                incompatible_qos=lambda _: self._unfit.add(name),
            ),
        )

    def _on_message(self, number: int, data: bytes) -> None:
        self._recording.put(number, self._clock.now().nanoseconds, data)

    def _on_lost(self, number: int, lost: QoSMessageLostInfo) -> None:
        self._recording.add_lost_by_middleware(number, lost.total_count_change)


def _offered(publisher: TopicEndpointInfo) -> OfferedQos:
    qos = publisher.qos_profile
    return OfferedQos(
        history=qos.history.name.lower(),
        depth=qos.depth,
        reliability=qos.reliability.name.lower(),
        durability=qos.durability.name.lower(),
        deadline_ns=qos.deadline.nanoseconds,
        lifespan_ns=qos.lifespan.nanoseconds,
        liveliness=qos.liveliness.name.lower(),
        liveliness_lease_duration_ns=qos.liveliness_lease_duration.nanoseconds,
    )
