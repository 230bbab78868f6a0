# SPDX-License-Identifier: Apache-2.0
"""Client of all topics of one cell, for displays: polled, so that it costs little beside nodes at 1 kHz."""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import Any, final

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from scara_effmass_msgs.msg import ContactState, ForceBlock, Impact, ImpactValidation, RunInfo
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from scara_effmass.errors import DecodeError
from scara_effmass.nodes.client import ClientNode
from scara_effmass.nodes.qos import qos_profile
from scara_effmass.safety.cell_status import DEFAULT_TIMEOUT_NS, CellStatus, Diagnostic, Validation
from scara_effmass.wire import topics
from scara_effmass.wire.cdr import NS
from scara_effmass.wire.contact_state import contact_from, glance
from scara_effmass.wire.force import decode_force_block, decode_impact
from scara_effmass.wire.joint_state import JointStateDecoder
from scara_effmass.wire.run_info import decode_run_info

_GRAPH_PERIOD_NS = 250_000_000
_STREAM = topics.STREAM_QOS._replace(reliable=False)
_LATEST = topics.Qos(1, reliable=False)
_RARE = topics.Qos(200)
_MAX_DEADLINE_NS = 3_600_000_000_000

Take = Callable[[Any, int], None]


@final
class ContactStateReader:
    """Passes serialized contact states to `status`, and decodes only those completely that may change its verdict.

    Call `finish` after each batch of messages, so that `status` has the latest state of each contact point.
    """

    def __init__(self, status: CellStatus) -> None:
        self.status = status
        self._last_number = 0
        self._latest: dict[str, tuple[bytes, int]] = {}

    def take(self, data: bytes, sequence_number: int, at_ns: int) -> None:
        """Take a message with the number that its publisher gave it (0: unknown). Raises DecodeError."""
        # The graph lists a killed monitor for 20 s beside its successor. One publisher's numbers increase.
        if 0 < sequence_number <= self._last_number:
            self.status.take_other_monitor(at_ns)
        self._last_number = sequence_number
        point, speed, allowable_speed, verdict = glance(data)
        known = self.status.contacts.get(point)
        is_finite = math.isfinite(speed) and math.isfinite(allowable_speed)
        if known is not None and known.verdict == verdict and is_finite:
            self.status.take_speed(point, speed, allowable_speed, at_ns)
        else:
            self._take_contact(data, at_ns)
        self._latest[point] = data, at_ns

    def finish(self) -> None:
        """Decode the latest state of each contact point that the monitor still has."""
        for point, (data, at_ns) in self._latest.items():
            if point in self.status.contacts:
                self._take_contact(data, at_ns)
        self._latest.clear()

    def _take_contact(self, data: bytes, at_ns: int) -> None:
        self.status.take_contact(contact_from(deserialize_message(data, ContactState)), at_ns)


@final
class CellClient(ClientNode):
    """Keeps the `status` of the cell in its namespace: call `poll` several times a second. Use it in a `with`.

    Streams are subscribed best effort and taken in batches; only what changes a verdict, and the latest state, is
    decoded completely. Time that a message spent in the queue counts as silence.
    """

    def __init__(self, name: str, arguments: Sequence[str] = ()) -> None:
        """Subscribe as node `name`; ROS `arguments` state the namespace. Raises SettingsError for invalid ones."""
        super().__init__(name, arguments=arguments)
        self.executor.remove_node(self.node)  # which would queue an event for every message
        self._polled_ns = time.monotonic_ns()
        self.status = CellStatus(self._polled_ns)
        self._graph_ns = 0
        self._sequence_number = 0
        self._contact_states = ContactStateReader(self.status)
        self._joint_states = JointStateDecoder()
        self._subscriptions: list[tuple[Subscription, Take]] = []
        status = self.status
        for kind, topic, qos, raw, take in (
            (ContactState, topics.CONTACT_STATE, _STREAM, True, self._take_contact_state),
            (Float64, topics.ALLOWABLE_SPEED, _LATEST, False, self._scalar_taker(topics.ALLOWABLE_SPEED)),
            (Float64, topics.SPEED_SCALING, _LATEST, False, self._scalar_taker(topics.SPEED_SCALING)),
            (JointState, topics.JOINT_STATES, _LATEST, True, self._take_joint_state),
            (RunInfo, topics.RUN_INFO, topics.INFO_QOS, True, self._take_run_info),
            (ForceBlock, topics.FORCE, topics.FORCE_QOS._replace(reliable=False), True, self._take_force),
            (Impact, topics.IMPACT, _RARE, True, lambda data, at: status.take_impact(decode_impact(data), at)),
            (ImpactValidation, topics.IMPACT_VALIDATION, _RARE, False, self._take_validation),
            (DiagnosticArray, topics.DIAGNOSTICS, _RARE, False, self._take_diagnostics),
        ):
            subscription = self.node.create_subscription(kind, topic, lambda _: None, qos_profile(qos), raw=raw)
            self._subscriptions.append((subscription, take))

    def wall_ns(self, at_ns: int) -> int:
        """Return the time since 1970 [ns] of a time of arrival in `status`."""
        return time.time_ns() - time.monotonic_ns() + at_ns

    def poll(self) -> CellStatus:
        """Take all messages that have arrived; return `status` as of now. Does not wait."""
        now_ns = time.monotonic_ns()
        if now_ns - self._graph_ns > _GRAPH_PERIOD_NS:
            self._graph_ns = now_ns
            self._look_at_graph()
        for subscription, take in self._subscriptions:
            for message, at_ns in self._taken(subscription):
                with suppress(DecodeError):  # no news, as silence
                    take(message, at_ns)
        self._contact_states.finish()
        self._polled_ns = now_ns
        self.status.update(time.monotonic_ns())
        return self.status

    def _taken(self, subscription: Subscription) -> Iterator[tuple[Any, int]]:
        """Yield each message that has arrived, with the time of its publication, at least that of the last poll.

        So a message that waited while this process stood still is old, and a sender's clock changes little.
        """
        to_monotonic_ns = time.monotonic_ns() - time.time_ns()
        with subscription.handle:
            while (taken := subscription.handle.take_message(subscription.msg_type, subscription.raw)) is not None:
                message, info = taken
                self._sequence_number = info["publication_sequence_number"] or 0
                at_ns = info["source_timestamp"] + to_monotonic_ns
                yield message, min(max(at_ns, self._polled_ns), time.monotonic_ns())

    def _look_at_graph(self) -> None:
        """Look for a monitor, and take its deadline as the longest silence; of several, the shortest deadline."""
        publishers = self.node.get_publishers_info_by_topic(topics.CONTACT_STATE)
        deadlines_ns = [publisher.qos_profile.deadline.nanoseconds for publisher in publishers]
        limits_ns = [deadline_ns for deadline_ns in deadlines_ns if 0 < deadline_ns < _MAX_DEADLINE_NS]
        self.status.take_publisher(min(limits_ns, default=DEFAULT_TIMEOUT_NS), exists=bool(publishers))
        if not self.node.count_publishers(topics.RUN_INFO):
            self.status.run_info = None

    def _take_contact_state(self, data: bytes, at_ns: int) -> None:
        self._contact_states.take(data, self._sequence_number, at_ns)

    def _scalar_taker(self, topic: str) -> Take:
        return lambda message, at_ns: self.status.take_scalar(topic, message.data, at_ns)

    def _take_joint_state(self, data: bytes, at_ns: int) -> None:
        self.status.take_joint_state(self._joint_states.decode(data), at_ns)

    def _take_run_info(self, data: bytes, _: int) -> None:
        self.status.run_info = decode_run_info(data)

    def _take_force(self, data: bytes, _: int) -> None:
        self.status.take_force(decode_force_block(data))

    def _take_validation(self, message: Any, _: int) -> None:  # noqa: ANN401
        stamp = message.header.stamp
        values = [getattr(message, name) for name in Validation.__slots__[1:]]
        self.status.take_validation(Validation(stamp.sec * NS + stamp.nanosec, *values))

    def _take_diagnostics(self, message: Any, at_ns: int) -> None:  # noqa: ANN401
        """Keep the diagnostics of the nodes in the namespace of this client."""
        for status in message.status:
            node, _, name = status.name.partition(": ")
            if name and (node.rpartition("/")[0] or "/") == self.node.get_namespace():
                values = {pair.key: pair.value for pair in status.values}
                level = int.from_bytes(status.level, "little")
                self.status.diagnostics[status.name] = Diagnostic(status.name, level, status.message, values, at_ns)
