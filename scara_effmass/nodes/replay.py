"""A recording into the live nodes: its messages on their topics, and its time as `/clock`.

The clock stands at the start until there are listeners. Then it is set before each message and at least every 10 ms
of the recording's time. The two travel on different topics, so a message may overtake its clock; then it seems at most
those 10 ms newer than the clock, which the monitor's `future_tolerance` covers.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from itertools import chain, islice
from typing import TYPE_CHECKING

from builtin_interfaces.msg import Time
from rosgraph_msgs.msg import Clock

from scara_effmass.bags.batches import LATEST_NS
from scara_effmass.bags.files import open_bag
from scara_effmass.errors import EffmassError, SettingsError
from scara_effmass.nodes.lockstep import Lockstep
from scara_effmass.nodes.readiness import ReadinessReports
from scara_effmass.nodes.replay_node import Interruption, ReplayNode, settling_time_ns
from scara_effmass.nodes.replay_publisher import JOINT_STATES, clock_publisher, replay_publishers
from scara_effmass.nodes.replay_stamps import StampCheck
from scara_effmass.nodes.replay_timeline import timeline

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from scara_effmass.bags.bag import Bag, RawMessage

LATE_NS = 10_000_000
_PROGRESS_NS = 100_000_000
_HANDSHAKE_STEP_NS = 50_000_000
_NS = 1_000_000_000
_DAY_S = 86400.0


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """What is replayed, and how. Raises SettingsError for a value that cannot be used."""

    bag: Path
    rate: float = 1.0
    """Times the original speed, whether or not the nodes keep up; 0: as fast as the monitor answers."""
    start_s: float = 0.0
    """Where in the recording to begin."""
    duration_s: float = math.inf
    """How much of it to replay."""
    passes: int = 1
    """How often; 0: until it is stopped. The clock jumps back in between."""
    topics: tuple[str, ...] = ()
    """Topics to replay; empty: all but the clock and what the live nodes publish themselves."""
    joint_states: str = ""
    """The topic that is published as /joint_states; empty: each keeps its name."""
    subscribers: int = 1
    """Minimum number of subscribers of the joint states, or of any topic without joint states, before the start."""
    subscriber_timeout_s: float = 30.0
    """Maximum wait for the nodes to get ready. DDS forgets a node that was killed after 20 s."""
    answer_timeout_s: float = 1.0
    """How long an answer may take at rate 0."""

    def __post_init__(self) -> None:
        for key, value, good, right in (
            ("rate", self.rate, 0.0 <= self.rate < math.inf, "0 or more"),
            ("start_s", self.start_s, 0.0 <= self.start_s < math.inf, "0 or more"),
            ("duration_s", self.duration_s, self.duration_s > 0.0, "more than 0"),
            ("passes", self.passes, self.passes >= 0, "0 (until stopped) or more"),
            ("subscribers", self.subscribers, self.subscribers >= 1, "1 or more"),
            (
                "subscriber_timeout_s",
                self.subscriber_timeout_s,
                0.0 <= self.subscriber_timeout_s <= _DAY_S,
                "0 to 86400",
            ),
            ("answer_timeout_s", self.answer_timeout_s, 0.0 < self.answer_timeout_s <= _DAY_S, "up to 86400"),
        ):
            if not good:
                raise SettingsError(f"replay: {key.removesuffix('_s')} = {value}: {right} would be right")


@dataclass(frozen=True, slots=True)
class ReplayProgress:
    """How far a replay has come."""

    pass_number: int
    time_s: float
    """Of the recording, since the start of the pass."""
    span_s: float
    """How long one pass takes in time of the recording."""
    sent: int
    unanswered: int


@dataclass(frozen=True, slots=True)
class ReplayReport:
    """What a replay did."""

    sent: Mapping[str, int]
    """Messages per topic, as named where they were published; the clock is not among them."""
    skipped: Mapping[str, str]
    """Topics of the recording that were not replayed, and why."""
    unheard: tuple[str, ...]
    """Topics that nobody subscribed to."""
    unacknowledged: tuple[str, ...]
    """Topics of which a reliable subscriber had not received everything at the end."""
    answered: int
    """Joint states that the monitor answered; counted at rate 0 only, as are the next two."""
    unanswered: int
    """Joint states for whose answer it waited in vain."""
    not_awaited: int
    """Joint states sent on without waiting, because their kind had never been answered."""
    passes: int
    """Passes begun."""
    replayed_s: float
    """Time of the recording that went by."""
    wall_s: float
    late: int
    """Messages sent more than 10 ms after they were due; at rate 0 nothing is due."""
    worst_lateness_s: float
    interrupted: bool
    warnings: tuple[str, ...]

    @property
    def achieved_rate(self) -> float:
        """Time of the recording per time on the wall."""
        return self.replayed_s / self.wall_s if self.wall_s > 0.0 else 0.0


def replay(options: ReplayOptions, progress: Callable[[ReplayProgress], None] | None = None) -> ReplayReport:
    """Replay a recording into the live nodes and return what was done; `progress` is called about ten times a second.

    SIGINT and SIGTERM end it early, with a report that says so. It runs in a ROS context of its own.
    Raises BagError for a recording that cannot be read, EffmassError when nobody listens or answers.
    """
    with open_bag(options.bag) as bag, Interruption() as interruption, ReplayNode() as stage:
        player = _Player(options, bag, stage, progress or (lambda _: None))
        try:
            with interruption.allowed():
                player.play()
        except KeyboardInterrupt:
            player.interrupted = True
        return player.report()


class _Player:
    """One replay: where it stands, and the endpoints it plays to."""

    def __init__(
        self, options: ReplayOptions, bag: Bag, stage: ReplayNode, progress: Callable[[ReplayProgress], None]
    ) -> None:
        self._options = options
        self._bag = bag
        self._stage = stage
        self._progress = progress
        self._start_ns = bag.start_ns + round(options.start_s * _NS)
        if self._start_ns > bag.end_ns:
            length_s = bag.duration_ns / _NS
            raise SettingsError(f"{bag.path}: start = {options.start_s} s: the recording is {length_s:.3f} s long")
        longest_s = (LATEST_NS - self._start_ns) / _NS
        self._stop_ns = LATEST_NS
        if options.duration_s < longest_s:
            self._stop_ns = self._start_ns + round(options.duration_s * _NS)
        self._end_ns = min(self._stop_ns, bag.end_ns)
        self._outlets, self._skipped = replay_publishers(bag, stage.node, options.topics, options.joint_states)
        self._clock = clock_publisher(stage.node)
        self._joint_states = next((o for o in self._outlets.values() if o.name == JOINT_STATES), None)
        if options.rate == 0.0 and self._joint_states is None:
            raise SettingsError(
                f"{bag.path}: rate = 0: nothing is published as {JOINT_STATES}, whose answers set the pace; "
                "name the topic that is to be, or a rate"
            )
        self._answers = Lockstep(stage.node, options.answer_timeout_s) if options.rate == 0.0 else None
        self._readiness = ReadinessReports(stage.node)  # after all other endpoints
        self._stamps = StampCheck()
        self._unacknowledged: list[str] = []
        self._passes = 0
        self._now_ns = self._start_ns
        self._replayed_ns = 0
        self._wall_ns = 0
        self._late = 0
        self._worst_lateness_ns = 0
        self._shown_ns = 0
        self.interrupted = False

    def play(self) -> None:
        """Wait for listeners, play all passes, and wait until everything has arrived."""
        self._wait_until_ready()
        # What was published before the start, for those who come later, is there for them.
        latched = [name for name, outlet in self._outlets.items() if outlet.latched]
        if latched and self._start_ns > self._bag.start_ns:
            for message in self._bag.messages(latched, None, self._start_ns):
                self._outlets[message.topic].send(message.data)
        while not self._options.passes or self._passes < self._options.passes:
            self._passes += 1
            # Whoever reads a recording first opens its files and unpacks a first part: not on the clock.
            messages = self._bag.messages(self._outlets.keys(), self._start_ns, self._stop_ns)
            messages = chain(list(islice(messages, 1)), messages)
            self._now_ns = self._start_ns
            began_ns = time.monotonic_ns()
            try:
                self._play_once(messages, began_ns)
            finally:
                self._wall_ns += time.monotonic_ns() - began_ns
                self._replayed_ns += self._now_ns - self._start_ns
        self._stage.settle()
        self._unacknowledged = self._stage.wait_acknowledged(self._outlets.values())

    def report(self) -> ReplayReport:
        """Return what has been done so far."""
        answers = self._answers
        return ReplayReport(
            sent={outlet.name: outlet.sent for outlet in self._outlets.values()},
            skipped=self._skipped,
            unheard=tuple(outlet.name for outlet in self._outlets.values() if not outlet.heard),
            unacknowledged=tuple(self._unacknowledged),
            answered=answers.answered if answers else 0,
            unanswered=answers.unanswered if answers else 0,
            not_awaited=answers.not_awaited if answers else 0,
            passes=self._passes,
            replayed_s=self._replayed_ns / _NS,
            wall_s=self._wall_ns / _NS,
            late=self._late,
            worst_lateness_s=self._worst_lateness_ns / _NS,
            interrupted=self.interrupted,
            warnings=(*self._bag.losses, *self._stamps.warnings()),
        )

    def _wait_until_ready(self) -> None:
        """Return when every node that consumes the replay or runs on its clock has been ready for the settling time.

        The clock shows the start meanwhile: some nodes do nothing before they have a time. Raises EffmassError.
        """
        timeout_s = self._options.subscriber_timeout_s
        start_ns = ready_since_ns = time.monotonic_ns()
        while True:
            self._set_clock(self._start_ns)
            self._stage.spin_until(time.monotonic_ns() + _HANDSHAKE_STEP_NS)
            now_ns = time.monotonic_ns()
            if unready := self._unready():
                ready_since_ns = now_ns
                if now_ns - start_ns > timeout_s * _NS:
                    raise EffmassError(f"not ready within {timeout_s:g} s: {unready}")
            elif now_ns - ready_since_ns >= settling_time_ns(ready_since_ns - start_ns):
                return

    def _unready(self) -> str:
        """Return what the replay still has to wait for, empty if nothing."""
        inputs = [self._joint_states] if self._joint_states else list(self._outlets.values())
        expected = self._options.subscribers
        if not any(outlet.subscribers >= expected for outlet in inputs):
            topics = ", ".join(outlet.name for outlet in inputs)
            return f"{topics}: expected {expected} subscribers, found {max(outlet.subscribers for outlet in inputs)}"
        if self._answers and not self._answers.publishers:
            return f"{self._answers.topic}: no publisher; rate 0 needs a monitor that answers"
        unready = self._readiness.unready(self._start_ns, [outlet.name for outlet in self._outlets.values()])
        return "; ".join(f"{name} {reason}" for name, reason in sorted(unready.items()))

    def _play_once(self, messages: Iterator[RawMessage], began_ns: int) -> None:
        rate = self._options.rate
        clock_ns = -1
        for time_ns, message in timeline(messages, self._start_ns, self._end_ns):
            if rate:
                due_ns = began_ns + round((time_ns - self._start_ns) / rate)
                self._stage.spin_until(due_ns)
                lateness_ns = time.monotonic_ns() - due_ns
                self._late += lateness_ns > LATE_NS
                self._worst_lateness_ns = max(self._worst_lateness_ns, lateness_ns)
            self._now_ns = time_ns
            if time_ns != clock_ns:
                clock_ns = time_ns
                self._set_clock(time_ns)
            if message is not None:
                self._send(message)
            self._show()

    def _set_clock(self, time_ns: int) -> None:
        sec, nanosec = divmod(time_ns, _NS)
        self._clock.send(Clock(clock=Time(sec=sec, nanosec=nanosec)))

    def _send(self, message: RawMessage) -> None:
        outlet = self._outlets[message.topic]
        if outlet is self._joint_states:
            self._stamps.see(message.data, message.log_time_ns)
            if self._answers:
                names = self._answers.expect(message.data)
                outlet.send(message.data)
                self._answers.wait(names, self._stage.spin_until)
                return
        outlet.send(message.data)

    def _show(self) -> None:
        now_ns = time.monotonic_ns()
        if now_ns - self._shown_ns < _PROGRESS_NS:
            return
        self._shown_ns = now_ns
        self._progress(
            ReplayProgress(
                pass_number=self._passes,
                time_s=(self._now_ns - self._start_ns) / _NS,
                span_s=(self._end_ns - self._start_ns) / _NS,
                sent=sum(outlet.sent for outlet in self._outlets.values()),
                unanswered=self._answers.unanswered if self._answers else 0,
            )
        )
