# SPDX-License-Identifier: Apache-2.0
"""Client of all topics of one cell: polled, so that it costs little beside nodes at 1 kHz."""

import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, final

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from scara_effmass_msgs.msg import ContactStates, ForceBlock, Impact, ImpactValidation, PayloadEstimate, RunInfo
from sensor_msgs.msg import JointState

from scara_effmass.cell.status import DEFAULT_TIMEOUT_NS, CellStatus, Diagnostic, LoadSample, Validation
from scara_effmass.errors import DecodeError
from scara_effmass.nodes.ros import ClientNode, qos_profile
from scara_effmass.values import Decision
from scara_effmass.wire import topics
from scara_effmass.wire.cdr import NS
from scara_effmass.wire.contact_states import decode_contact_states
from scara_effmass.wire.force import decode_force_block, decode_impact
from scara_effmass.wire.impact_validation import series_from
from scara_effmass.wire.joint_state import JointStateDecoder
from scara_effmass.wire.run_info import decode_run_info

_POLL_PERIOD_S = 0.01
_GRAPH_PERIOD_NS = 250_000_000
_TAKE_NS = 200_000_000
"""Longest time of taking messages of one topic in a poll: more would hold it, less cut short what waited for it."""
_LATEST = topics.Qos(1, reliable=False)
_RARE = topics.Qos(200)
_MAX_DEADLINE_NS = 3_600_000_000_000
_VALIDATION = tuple(name for name in Validation.__slots__ if name not in {"stamp_ns", "series"})
"""Fields of the impact, but for the stamp and the series."""

Decode = Callable[[bytes], Any]
Take = Callable[[Any, int], None]
OnDecision = Callable[[Decision], None]
OnValidation = Callable[[Validation], None]


@final
class CellClient(ClientNode):
    """Keeps the `status` of the cell in its namespace: `poll` several times a second, or `spin`. Use it in a `with`.

    Messages are taken in batches; time that a message spent in the queue counts as silence. The end of the `with` hands
    a signal that arrived to its handler from before.
    """

    def __init__(
        self,
        name: str,
        arguments: Sequence[str] = (),
        *,
        on_decision: OnDecision | None = None,
        on_validation: OnValidation = lambda _: None,
    ) -> None:
        """Subscribe as node `name`; ROS `arguments` state the namespace. Raises SettingsError for invalid ones.

        `on_decision` gets every decision, which the monitor then sends reliably; without it, it does not wait for
        this client. `on_validation` gets every validation of an impact.
        """
        super().__init__(name, arguments=arguments)
        self.executor.remove_node(self.node)  # which would queue an event for every message
        self._polled_ns = time.monotonic_ns()
        """Start of the last poll that took all messages: those of the next one arrived later."""
        self._has_left = False
        self.status = CellStatus(self._polled_ns)
        self._graph_ns = self._monitors = 0
        self._has_joined = False
        """Whether a monitor has joined another one at the last look at the graph."""
        self._on_decision, self._on_validation = on_decision or (lambda _: None), on_validation
        stream, status = topics.STREAM_QOS._replace(reliable=on_decision is not None), self.status
        self._subscriptions: list[tuple[Subscription, Decode, Take, bool]] = []
        """Subscriptions, what decodes and takes their messages, and whether these may be older than this client."""
        for kind, topic, qos, decode, take in (
            (ContactStates, topics.CONTACT_STATES, stream, decode_contact_states, self._take_decision),
            (JointState, topics.JOINT_STATES, _LATEST, JointStateDecoder().decode, status.take_joint_state),
            (RunInfo, topics.RUN_INFO, topics.INFO_QOS, decode_run_info, status.take_run_info),
            (
                ForceBlock,
                topics.FORCE,
                topics.FORCE_QOS._replace(reliable=False),
                decode_force_block,
                status.take_force,
            ),
            (Impact, topics.IMPACT, _RARE, decode_impact, status.take_impact),
            (ImpactValidation, topics.IMPACT_VALIDATION, _RARE, None, self._take_validation),
            (DiagnosticArray, topics.DIAGNOSTICS, _RARE, None, self._take_diagnostics),
            (PayloadEstimate, topics.PAYLOAD_ESTIMATE, topics.DESCRIPTION_QOS, None, self._take_load),
        ):
            subscription = self.node.create_subscription(kind, topic, lambda _: None, qos_profile(qos), raw=True)
            deserialize = partial(deserialize_message, message_type=kind)
            self._subscriptions.append((subscription, decode or deserialize, take, qos.latched))

    @property
    def connected(self) -> bool:
        """Whether a monitor is connected to this client."""
        return self._subscriptions[0][0].get_publisher_count() > 0

    def has_peers(self, topic: str, publishers: int, subscribers: int) -> bool:
        """Return whether `topic` has at least so many publishers and subscribers, this client included."""
        node = self.node
        return node.count_publishers(topic) >= publishers and node.count_subscribers(topic) >= subscribers

    def wall_ns(self, at_ns: int) -> int:
        """Return the time since 1970 [ns] of a time of arrival in `status`."""
        return time.time_ns() - time.monotonic_ns() + at_ns

    def poll(self) -> CellStatus:
        """Take the messages that have arrived; return `status` as of now. Does not wait.

        Those for which the time does not suffice are left to the next poll.
        """
        now_ns, self._has_left = time.monotonic_ns(), False
        if now_ns - self._graph_ns > _GRAPH_PERIOD_NS:
            self._graph_ns = now_ns
            self._look_at_graph()
        for subscription, decode, take, is_latched in self._subscriptions:
            for message, at_ns in self._taken(subscription, 0 if is_latched else self._polled_ns):
                with suppress(DecodeError):  # no news, as silence
                    take(decode(message), at_ns)
        if not self._has_left:
            self._polled_ns = now_ns
        if self._has_joined:  # known before its first message; the messages of the other one show whether it is alive
            self.status.take_second_publisher(time.monotonic_ns())
            self._has_joined = False
        self.status.update(time.monotonic_ns())
        return self.status

    def spin(self, seconds: float, done: Callable[[], bool] = bool) -> bool:
        """Poll for `seconds` or until `done`; return the result of `done`.

        A signal that arrives meanwhile is handed to its handler from before the `with`.
        """
        end_s = time.monotonic() + seconds
        while not (done() or self.signals) and time.monotonic() < end_s:
            self.poll()
            if not done():
                time.sleep(_POLL_PERIOD_S)
        self._hand_over_signal()
        return done()

    def __exit__(self, *_: object) -> None:
        super().__exit__()
        self._hand_over_signal()

    def _hand_over_signal(self) -> None:
        for number in self.signals[:1]:
            self.signals.clear()
            deferring = signal.signal(number, self.handlers[number])
            try:
                signal.raise_signal(number)
            finally:
                signal.signal(number, deferring)

    def _taken(self, subscription: Subscription, earliest_ns: int) -> Iterator[tuple[bytes, int]]:
        """Yield each message that has arrived, with the time of its publication, at least `earliest_ns`.

        So a message that waited while this process stood still is old, and a sender's clock changes little.
        """
        start_ns = time.monotonic_ns()
        to_monotonic_ns = start_ns - time.time_ns()
        with subscription.handle:
            while (taken := subscription.handle.take_message(subscription.msg_type, subscription.raw)) is not None:
                message, info = taken
                at_ns = info["source_timestamp"] + to_monotonic_ns
                yield message, min(max(at_ns, earliest_ns), time.monotonic_ns())
                if time.monotonic_ns() - start_ns > _TAKE_NS:
                    self._has_left = True
                    return

    def _look_at_graph(self) -> None:
        """Look for a monitor, and take its deadline as the longest silence; of several, the shortest deadline."""
        publishers = self.node.get_publishers_info_by_topic(topics.CONTACT_STATES)
        deadlines_ns = [publisher.qos_profile.deadline.nanoseconds for publisher in publishers]
        limits_ns = [deadline_ns for deadline_ns in deadlines_ns if 0 < deadline_ns < _MAX_DEADLINE_NS]
        self.status.take_publisher(min(limits_ns, default=DEFAULT_TIMEOUT_NS), exists=bool(publishers))
        self._has_joined, self._monitors = len(publishers) > self._monitors > 0, len(publishers)
        if not self.node.count_publishers(topics.RUN_INFO):
            self.status.run_info = None

    def _take_decision(self, decision: Decision, at_ns: int) -> None:
        self.status.take_decision(decision, at_ns)
        self._on_decision(decision)

    def _take_validation(self, message: Any, _: int) -> None:  # noqa: ANN401 - the messages of rclpy have no types
        stamp = message.header.stamp
        values = {name: getattr(message, name) for name in _VALIDATION}
        stamp_ns, series = stamp.sec * NS + stamp.nanosec, series_from(message.series)
        validation = Validation(stamp_ns=stamp_ns, series=series, **values)
        self.status.take_validation(validation)
        self._on_validation(validation)

    def _take_load(self, message: Any, at_ns: int) -> None:  # noqa: ANN401
        values = {name: getattr(message, name) for name in LoadSample._fields[1:]}
        self.status.loads.append(LoadSample(at_ns=at_ns, **values))

    def _take_diagnostics(self, message: Any, at_ns: int) -> None:  # noqa: ANN401
        """Keep the diagnostics of the nodes in the namespace of this client."""
        for status in message.status:
            node, _, name = status.name.partition(": ")
            if name and (node.rpartition("/")[0] or "/") == self.node.get_namespace():
                values = {pair.key: pair.value for pair in status.values}
                level = int.from_bytes(status.level, "little")
                self.status.take_diagnostic(Diagnostic(status.name, level, status.message, values, at_ns))
