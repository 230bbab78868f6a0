# SPDX-License-Identifier: Apache-2.0
"""Replay a bag to the live nodes, with `/clock`.

The clock shows the start until every node that consumes the replay is ready. Then it is set before each message and
at least every 10 ms of recorded time. Clock and messages travel on different topics, so a message may overtake its
clock and then seems up to 10 ms newer than the clock; the monitor's `future_tolerance` covers this.
"""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import chain, islice
from pathlib import Path

from builtin_interfaces.msg import Time
from rclpy.duration import Duration
from rosgraph_msgs.msg import Clock

from scara_effmass.bags.bag import Bag, RawMessage
from scara_effmass.bags.batches import MAX_TIME_NS
from scara_effmass.bags.files import open_bag
from scara_effmass.errors import EffmassError, SettingsError
from scara_effmass.nodes.readiness import ReadinessReports
from scara_effmass.nodes.replay_topics import JOINT_STATES, ReplayPublisher, in_namespace, replay_publishers
from scara_effmass.nodes.ros import ClientNode
from scara_effmass.wire.topics import CLOCK

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
_NS = 1_000_000_000


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
        report.warnings = tuple(bag.losses)
        return report


class _Player:
    """State and endpoints of one replay."""

    def __init__(self, options: ReplayOptions, bag: Bag, client: ClientNode, on_progress: OnProgress) -> None:
        self._options = options
        self._bag = bag
        self._client = client
        self._on_progress = on_progress
        self._start_ns = bag.start_ns + round(min(options.start_s * _NS, float(MAX_TIME_NS)))
        if self._start_ns > bag.end_ns:
            rule = f"must be within the {bag.duration_ns / _NS:.3f} s recorded"
            raise SettingsError(f"{bag.path}: start = {options.start_s} s: {rule}")
        self._stop_ns = MAX_TIME_NS
        if options.duration_s < (MAX_TIME_NS - self._start_ns) / _NS:
            self._stop_ns = self._start_ns + round(options.duration_s * _NS)
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
                report.wall_s += (time.monotonic_ns() - pass_start_ns) / _NS
                report.replayed_s += (self._now_ns - self._start_ns) / _NS
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
                if now_ns - start_ns > timeout_s * _NS:
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
            self.report.worst_lateness_s = max(self.report.worst_lateness_s, lateness_ns / _NS)
            self._now_ns = time_ns
            if time_ns != clock_ns:
                clock_ns = time_ns
                self._set_clock(time_ns)
            if message is not None:
                self.publishers[message.topic].send(message.data)
            self._report_progress()

    def _set_clock(self, time_ns: int) -> None:
        sec, nanosec = divmod(time_ns, _NS)
        self._clock.send(Clock(clock=Time(sec=sec, nanosec=nanosec)))

    def _spin_until(self, deadline_ns: int) -> None:
        """Handle events until the monotonic clock shows `deadline_ns`; a signal interrupts."""
        self._client.spin_for((deadline_ns - time.monotonic_ns()) / _NS)
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
        self._on_progress(
            self.report.passes,
            (self._now_ns - self._start_ns) / _NS,
            (self._end_ns - self._start_ns) / _NS,
        )
