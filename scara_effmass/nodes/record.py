# SPDX-License-Identifier: Apache-2.0
"""Record live topics, as serialized bytes, into a bag that survives a crash.

The log time of a message is its receive time on the node's clock: system time, or /clock with `use_sim_time`.
"""

import math
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, final

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from scara_effmass.bags.definitions import known_types, published_types
from scara_effmass.bags.recorder import BagRecorder, MessageSink, RecorderOptions, RecordingReport
from scara_effmass.bags.writer import qos_yaml
from scara_effmass.errors import BagError, SettingsError
from scara_effmass.nodes import parameters
from scara_effmass.nodes.hang_guard import HangGuard
from scara_effmass.nodes.ros import ClientNode, SequenceGaps, one_line, qos_profile, spin_for, with_info
from scara_effmass.settings.loading import FrozenSettings
from scara_effmass.wire.message_types import message_class, message_definition
from scara_effmass.wire.topics import FORCE_OUTPUTS, RECORDED, STREAM_QOS

_PERIOD_S = 0.1
"""Period of topic discovery and of the check for a stop signal."""
_DRAIN_TIMEOUT_S = 10.0
"""Maximum time to record the messages that have arrived before the end."""
_REPEAT_S = 3.5
"""Time in which a reliable publisher of Fast DDS repeats a lost message, which holds back all later ones."""
_RATE_S = 1.0
"""Time of messages from which a topic has a mean interval."""
_LATE_INTERVALS = 10
"""Mean intervals of a topic after which its next message is late."""
_CLOCK_WARNING_AFTER = 20
"""Discoveries without /clock before a warning."""
HANG_S = 30.0
"""Time without progress after which the recorder is ended."""
QUEUE_DEPTH = 5_000
"""Messages of a topic that may wait while the recorder stands still, at most what Fast DDS holds."""


@dataclass(frozen=True, slots=True)
class RecordReport:
    """Result of a recording."""

    recording: RecordingReport
    seconds: float
    simulated_time: bool
    """Whether log times are from /clock."""
    refused: Mapping[str, str]
    """Topics that could not be recorded, and why."""
    unpublished: tuple[str, ...]
    """Topics without a publisher."""


def record(
    folder: Path,
    topics: Sequence[str] = RECORDED,
    options: RecorderOptions | None = None,
    *,
    duration_s: float = math.inf,
    overwrite: bool = False,
    ros_arguments: Sequence[str] = (),
    progress: Callable[[RecordingReport, float], None] = lambda *_: None,
    warn: Callable[[str], None] = lambda _: None,
    hang_timeout_s: float = HANG_S,
) -> RecordReport:
    """Record until SIGINT, SIGTERM or the end of `duration_s`, in a ROS context of its own.

    Without `topics`, record all except hidden ones, which have a token that begins with an underscore. `progress` is
    called about ten times a second with the report and the elapsed time [s]; `warn` is called with warnings, also from
    another thread. A process that stands still for `hang_timeout_s` is killed, after a line on stderr: at that time
    neither threads nor signals can complete the bag. Raises SettingsError or OutputError.
    """
    known_types()  # slow on the first call: before messages arrive
    rest = f"what it has saved is complete after: record --repair {folder}"
    line = f"{folder}: the recorder has stood still for {hang_timeout_s:g} s and is killed; {rest}"
    # The guard comes last: ROS may hang as well while it ends.
    with HangGuard(hang_timeout_s, line) as guard, ClientNode("recorder", arguments=ros_arguments) as client:
        node, context = client.node, client.context
        parameters.declare(node, FrozenSettings)  # only the parameters of every node
        names = [resolve_topic(node, topic) for topic in topics]
        parents = [resolve_topic(node, topic) for topic in FORCE_OUTPUTS if topics is RECORDED]
        seconds = 0.0
        start = last_tick_s = time.monotonic()

        def beat() -> None:  # in the writing thread: it and the executor must go on; what is closed is only written
            if time.monotonic() - last_tick_s < hang_timeout_s or not recorder.is_running:
                guard.beat()

        recorder = BagRecorder(folder, options, overwrite=overwrite, warn=warn, progress=beat)
        with recorder:
            topic_recorder = TopicRecorder(node, recorder, names, warn, parents, recorder.count_lost_by_middleware)
            while not client.signals and context.ok() and recorder.is_running and seconds < duration_s:
                last_tick_s = time.monotonic()
                topic_recorder.discover()
                client.spin_for(min(duration_s - seconds, _PERIOD_S))
                seconds = time.monotonic() - start
                progress(recorder.report(), seconds)
            if context.ok():
                end_ns = time.time_ns()
                # This task runs after the messages that have already arrived.
                arrived = client.executor.create_task(lambda: None)
                spin_for(client.executor, _DRAIN_TIMEOUT_S, arrived.done)
                spin_for(client.executor, _REPEAT_S, lambda: not topic_recorder.late_topics(end_ns))
            report = recorder.close()
        return RecordReport(
            recording=report,
            seconds=seconds,
            simulated_time=bool(node.get_parameter("use_sim_time").value),
            refused=topic_recorder.refused,
            unpublished=tuple(sorted(set(names) - set(topic_recorder.recorded) - topic_recorder.refused.keys())),
        )


def resolve_topic(node: Node, topic: str) -> str:
    """Return the full name of a topic, remapped and with its namespace. Raises SettingsError if invalid."""
    try:
        return str(node.resolve_topic_name(topic))
    except (InvalidTopicNameException, RuntimeError, ValueError) as error:
        raise SettingsError(f"record: topic {topic!r}: {one_line(error)}") from None


@final
class TopicRecorder:
    """Subscribes to topics and passes their messages to a `BagRecorder` or another sink."""

    def __init__(
        self,
        node: Node,
        recorder: MessageSink,
        topics: Collection[str],
        warn: Callable[[str], None],
        parents: Collection[str] = (),
        count_lost: Callable[[int, int], None] | None = None,
    ) -> None:
        """Record `topics` and all topics below `parents`, by their full names; without topics, all that are not hidden.

        `count_lost` gets the index of a topic and the number of messages that are missing before one that arrives.
        """
        self.refused: dict[str, str] = {}
        """Topics that are not recorded, or not from all publishers, and why."""
        self._node = node
        self._clock = node.get_clock()
        self._recorder = recorder
        self._topics = frozenset(topics)
        self._parents = tuple(f"{name}/" for name in parents)
        self._warn = warn
        self._count_lost = count_lost
        self._indices: dict[str, int] = {}
        self._types: dict[str, str] = {}
        self._subscriptions: dict[str, Any] = {}
        self._published: dict[str, tuple[int, int, int]] = {}
        """Messages of each topic, and when the first and the last were published [ns]."""
        self._incompatible: set[str] = set()
        self._discoveries_without_clock = 0

    @property
    def recorded(self) -> Collection[str]:
        """The topics that are recorded."""
        return self._indices.keys()

    def late_topics(self, now_ns: int) -> list[str]:
        """Return the topics whose publishers have published since the last message, but the middleware holds it back.

        That is a guess by their mean interval at the system time `now_ns`; a topic that has long been silent has ended.
        """
        late = []
        for name, (count, first_ns, last_ns) in self._published.items():
            has_rate = last_ns - first_ns > _RATE_S * 1e9
            is_late = (now_ns - last_ns) * (count - 1) > _LATE_INTERVALS * (last_ns - first_ns)
            is_recent = time.time_ns() - last_ns < _REPEAT_S * 1e9
            if has_rate and is_late and is_recent and self._node.count_publishers(name):
                late.append(name)
        return late

    def discover(self) -> None:
        """Subscribe to new topics, and again to topics with an incompatible publisher."""
        # With simulated time, messages have no log time before the first /clock.
        if not self._clock.now().nanoseconds:
            self._discoveries_without_clock += 1
            if self._discoveries_without_clock == _CLOCK_WARNING_AFTER:
                self._warn("waiting for /clock: use_sim_time is set")
            return
        for name, types in self._node.get_topic_names_and_types():
            if self._is_selected(name):
                self._add(name, types)
            elif len(types) > 1 and name in self._types and name not in self.refused:
                self._check_types(name)
        for name in self._incompatible & self._subscriptions.keys():
            self._warn(f"{name}: a publisher has an incompatible QoS: subscribing again, messages may be missing")
            self._node.destroy_subscription(self._subscriptions.pop(name))
        self._incompatible.clear()

    def _is_selected(self, name: str) -> bool:
        if name in self._subscriptions or name in self.refused:
            return False
        if self._topics:
            return name in self._topics or name.startswith(self._parents)
        return not any(token.startswith("_") for token in name.split("/"))

    def _add(self, name: str, types: Sequence[str]) -> None:
        publishers = self._node.get_publishers_info_by_topic(name)
        if not publishers:
            return  # their QoS is not known yet
        try:
            self._subscribe(name, sorted({publisher.topic_type for publisher in publishers} or types), publishers)
        except BagError as error:
            self.refused[name] = str(error)
            self._warn(f"{name}: not recorded: {error}")

    def _check_types(self, name: str) -> None:
        """Warn about new publishers of another type than the recorded one."""
        recorded_type = self._types[name]
        types = {publisher.topic_type for publisher in self._node.get_publishers_info_by_topic(name)}
        if others := types - {recorded_type}:
            self.refused[name] = (
                f"it is also published as {', '.join(sorted(others))}; only {recorded_type} is recorded"
            )
            self._warn(f"{name}: {self.refused[name]}")

    def _subscribe(self, name: str, types: Sequence[str], publishers: Sequence[TopicEndpointInfo]) -> None:
        """Subscribe with a QoS compatible with all publishers.

        Raises BagError for several types, a type that is not installed, and a definition that is not the publishers'.
        """
        message_type, *others = types
        if others:
            raise BagError(f"it has publishers of several types: {', '.join(types)}")
        installed_class = message_class(message_type)
        if installed_class is None:
            raise BagError(f"its type {message_type} is not installed; install {message_type.partition('/')[0]}")
        if name not in self._indices:
            definitions = published_types(message_type, str(publishers[0].topic_type_hash), message_definition)
            offered = qos_yaml(_rosbag2_qos(publisher) for publisher in publishers)
            self._indices[name] = self._recorder.add_topic(name, message_type, offered_qos=offered, types=definitions)
        index, self._types[name] = self._indices[name], message_type
        qos = STREAM_QOS._replace(
            depth=QUEUE_DEPTH,
            reliable=all(p.qos_profile.reliability == ReliabilityPolicy.RELIABLE for p in publishers),
            latched=all(p.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in publishers),
        )
        self._subscriptions[name] = self._node.create_subscription(
            installed_class,
            name,
            with_info(partial(self._on_message, name, index, SequenceGaps(partial(self._node.count_publishers, name)))),
            qos_profile(qos),
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(incompatible_qos=lambda _: self._incompatible.add(name)),
        )

    def _on_message(self, name: str, index: int, gaps: SequenceGaps, data: bytes, info: Mapping[str, Any]) -> None:
        if self._count_lost and (lost := gaps.lost_before(info["publication_sequence_number"])):
            self._count_lost(index, lost)
        published_ns = info["source_timestamp"]
        count, first_ns, _ = self._published.get(name, (0, published_ns, 0))
        self._published[name] = count + 1, first_ns, published_ns
        self._recorder.write(index, self._clock.now().nanoseconds, data)


def _rosbag2_qos(publisher: TopicEndpointInfo) -> dict[str, object]:
    """Return the QoS of a publisher with rosbag2's keys."""
    qos = publisher.qos_profile
    values: dict[str, object] = {"depth": qos.depth, "avoid_ros_namespace_conventions": False}
    for policy in ("history", "reliability", "durability", "liveliness"):
        values[policy] = getattr(qos, policy).name.lower()
    for duration in ("deadline", "lifespan", "liveliness_lease_duration"):
        sec, nsec = divmod(getattr(qos, duration).nanoseconds, 1_000_000_000)
        values[duration] = {"sec": sec, "nsec": nsec}
    return values
