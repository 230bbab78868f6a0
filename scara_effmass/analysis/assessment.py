# SPDX-License-Identifier: Apache-2.0
"""Assess every joint state of a recording; its log time replaces the clock of the live node."""

from __future__ import annotations

import math
import os
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import Enum
from itertools import accumulate, chain, groupby, pairwise, zip_longest
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from scara_effmass.bags.bag import Bag, first_run_info
from scara_effmass.bags.batches import IntArray, JointStateBlock
from scara_effmass.bags.files import open_bag
from scara_effmass.codes import Reason
from scara_effmass.errors import BagError, CrossCheckError, SettingsError
from scara_effmass.safety import Assessments, Monitor
from scara_effmass.safety.assessments import joined
from scara_effmass.safety.monitor import Pending
from scara_effmass.settings import MonitorSettings, VelocitySource
from scara_effmass.values import Decision, FloatArray, JointState, Payload
from scara_effmass.wire.message_types import INERTIA, JOINT_STATE
from scara_effmass.wire.payload import decode_payload
from scara_effmass.wire.topics import JOINT_COMMANDS, ROBOT_DESCRIPTION

Names = tuple[str, ...]
ROWS = 49_152
"""Contacts in one batch: smaller batches cost time, larger ones memory."""
MAX_THREADS = 4
"""Threads that compute: one reads, and one writes, as fast as four of them."""
TOLERANCE = 1e-10
"""Largest difference of two numbers in a cross-check, relative for numbers above 1."""

_NO_PAYLOAD = (math.inf, "")
_NO_VELOCITY = np.empty(0)


class Time(str, Enum):
    """Clocks of an offline assessment."""

    LIVE = "live"
    """Header stamps, judged at the log times, as the live node judges them at their arrival."""
    HEADER = "header"
    """Header stamps alone."""
    LOG = "log"
    """Log times in place of header stamps."""


class AssessedState(NamedTuple):
    """One recorded joint state and its decision; `state` is None for an undecodable message."""

    log_time_ns: int
    state: JointState | None
    decision: Decision


class Source(NamedTuple):
    """Where rows come from: those from number `first` on are those of `block` from `block_row` on, if there is one."""

    first: int
    block: JointStateBlock | None
    block_row: int


@dataclass(frozen=True, slots=True)
class AssessedStates:
    """Joint states (m,) of one robot in order, and their assessments; `log_time_ns` (m,) is when they arrived.

    `names_of` gives the robot's names of recorded ones.
    """

    log_time_ns: IntArray
    assessments: Assessments
    sources: Sequence[Source]
    names_of: Callable[[Names], Names]

    def __len__(self) -> int:
        return len(self.log_time_ns)

    def state(self, row: int) -> JointState | None:
        """Return the joint state in `row` as recorded, with the robot's names; None for an undecodable message."""
        source = self.sources[bisect_right(self.sources, row, key=lambda source: source.first) - 1]
        block, index = source.block, source.block_row + row - source.first
        if block is None:
            return None
        names = self.names_of(block.names)
        rows = block.position[index], block.velocity[index], block.effort[index]
        return JointState(int(block.stamp_ns[index]), names, *rows)

    def positions(self, row: int) -> dict[str, float]:
        """Return the finite joint positions in `row` by name [rad, m]."""
        state = self.state(row)
        positions = () if state is None else zip(state.names, state.position.tolist(), strict=False)
        return {name: position for name, position in positions if math.isfinite(position)}

    def rows(self, contacts: Sequence[int] | None = None) -> Iterator[AssessedState]:
        """Yield the joint states and decisions one by one, with the `contacts` of these numbers, by default all."""
        for row, (log_time_ns, decision) in enumerate(
            zip(self.log_time_ns.tolist(), self.assessments.decisions(contacts), strict=True)
        ):
            yield AssessedState(log_time_ns, self.state(row), decision)


def joint_state_topic(bag: Bag, requested: str | None) -> str:
    """Return the topic to assess: the requested one, else as `Bag.find_topic`, which raises BagError."""
    return bag.find_topic(requested or "", (JOINT_STATE,), "--topic").name


def require_stated_robot(bag: Bag, settings: MonitorSettings) -> None:
    """Raise BagError if `settings` leave the robot to the default, but `bag` describes one."""
    for topic in bag.topics if not settings.robot else ():
        if topic.name.endswith(ROBOT_DESCRIPTION) and topic.count:
            raise BagError(f"{bag.path}: {topic.name} describes its robot: give the file of that one (--robot)")


def assess_joint_states(
    bag: Bag,
    topic: str,
    monitor: Monitor,
    time: Time = Time.LIVE,
    velocities: RecordedVelocities | None = None,
    skew: ClockSkew | None = None,
    advance: Callable[[float], object] = lambda _: None,
) -> Iterator[AssessedStates]:
    """Yield the assessments of the joint states on `topic` by `monitor`, as the live node assesses them, in batches.

    The joint states have the robot's names, the stamps of `time`, and, if given, the `velocities` of another recording;
    their clocks are counted in `skew`. `advance` takes the share of the messages since the last call. An undecodable
    message gives UNKNOWN and debounces the following verdicts.
    Payloads that were recorded on the `payload_topic` of the settings count from their log times on. Threads compute,
    while this one admits and settles, in order. Raises BagError, at first if the settings name no robot but the bag
    describes one, and at the end if no joint state names a joint of the robot.
    """
    threads = min(len(os.sched_getaffinity(0)), MAX_THREADS)
    total = max(next(stored.count for stored in bag.topics if stored.name == topic), 1)  # metadata can be wrong
    waiting: deque[Future[tuple[list[_Part], FloatArray]]] = deque()

    def settled() -> AssessedStates:
        states = _settled(monitor, *waiting.popleft().result())
        advance(len(states) / total)
        return states

    with ThreadPoolExecutor(threads) as pool:
        for batch in _admitted(bag, topic, monitor, time, velocities, skew or ClockSkew()):
            for _, parts in groupby(batch, lambda part: part.pending.texts):  # a payload changes the texts
                waiting.append(pool.submit(_compute, monitor, [*parts]))
                if len(waiting) > threads:
                    yield settled()
        while waiting:
            yield settled()


def assessed_rows(
    bag: Bag,
    topic: str,
    monitor: Monitor,
    time: Time = Time.LIVE,
    contacts: Sequence[int] | None = None,
    advance: Callable[[float], object] = lambda _: None,
) -> Iterator[AssessedState]:
    """Yield what `assess_joint_states` does, one joint state after another, as `AssessedStates.rows`."""
    batches = assess_joint_states(bag, topic, monitor, time, advance=advance)
    return chain.from_iterable(states.rows(contacts) for states in batches)


class _Part(NamedTuple):
    """Joint states that were admitted together, those of `block` from `row` on, if there is one."""

    pending: Pending
    log_time_ns: IntArray
    block: JointStateBlock | None
    row: int


def _compute(monitor: Monitor, parts: Sequence[_Part]) -> tuple[list[_Part], FloatArray]:
    """Compute the contacts of `parts`; return these with their numbers in one array, and that."""
    firsts = list(accumulate((len(part.log_time_ns) for part in parts), initial=0))
    numbers = np.empty((firsts[-1], *parts[0].pending.numbers.shape[1:]))
    computed = [
        part._replace(pending=replace(part.pending, numbers=numbers[first:stop]))
        for part, (first, stop) in zip(parts, pairwise(firsts), strict=True)
    ]
    for part in computed:
        monitor.compute(part.pending)
    return computed, numbers


def _settled(monitor: Monitor, parts: Sequence[_Part], numbers: FloatArray) -> AssessedStates:
    """Return the assessments of `parts`, whose numbers lie together in `numbers`."""
    firsts = accumulate((len(part.log_time_ns) for part in parts), initial=0)
    sources = [Source(first, part.block, part.row) for first, part in zip(firsts, parts, strict=False)]
    assessments = joined([monitor.settle(part.pending) for part in parts], numbers)
    times = np.concatenate([part.log_time_ns for part in parts])
    return AssessedStates(times, assessments, sources, monitor.names_of)


def _admitted(
    bag: Bag, topic: str, monitor: Monitor, time: Time, velocities: RecordedVelocities | None, skew: ClockSkew
) -> Iterator[list[_Part]]:
    """Yield the joint states of the robot in batches, those that are refused included."""
    require_stated_robot(bag, monitor.settings)
    size, total, clock_ns = max(ROWS // len(monitor.dynamics.contact_points), 1), 0, 0
    batch: list[_Part] = []
    count, payloads = 0, _Payloads(bag, monitor)
    for block in bag.joint_state_blocks(topic):
        total += len(block) + len(block.decode_failures)
        for log_time_ns, reason in block.decode_failures:
            pending = monitor.refuse(Reason.UNDECODABLE, reason, log_time_ns)
            batch.append(_Part(pending, np.array([log_time_ns]), None, 0))
            count += 1
        if not len(block):
            continue
        skew.add(block.stamp_ns, block.log_time_ns)
        stamps = block.log_time_ns if time is Time.LOG else block.stamp_ns
        clocks, velocity = block.log_time_ns, block.velocity
        if time is Time.HEADER:  # a stamp that goes back is refused, as live
            clocks = np.maximum.accumulate(np.maximum(stamps, clock_ns))
            clock_ns = int(clocks[-1])
        row = 0
        while row < len(block):
            stop = payloads.take(block.log_time_ns, row, min(len(block), row + size - count % size))
            rows = slice(row, stop)
            for part, measured in _parts(block, rows, velocity, velocities, monitor):
                admitted = monitor.admit(
                    block.names, stamps[part], clocks[part], block.position[part], measured, block.effort[part]
                )
                if admitted is not None:
                    batch.append(_Part(admitted, block.log_time_ns[part], block, part.start))
                    count += part.stop - part.start
            row = stop
            if count >= size:
                yield batch
                batch, count = [], 0
    if batch:
        yield batch
    _require_own_joints(bag, topic, monitor, total)


def _require_own_joints(bag: Bag, topic: str, monitor: Monitor, count: int) -> None:
    """Raise BagError if `monitor` ignored all of `count` joint states on `topic` as those of other devices."""
    if monitor.ignored == count > 0:
        joints = ", ".join(monitor.dynamics.robot.joint_names)
        problem = f"none of its joint states names a joint of the robot ({joints})"
        remedy = "if it is another arm, give its robot file (--robot)"
        raise BagError(f"{bag.path}: {topic}: {problem}{monitor.joint_map_hint}; {remedy}")


def _parts(
    block: JointStateBlock, rows: slice, velocity: FloatArray, velocities: RecordedVelocities | None, monitor: Monitor
) -> Iterator[tuple[slice, FloatArray]]:
    """Yield `rows` of `block` in parts with equally many velocities, those of another recording if given."""
    if velocities is None:
        yield rows, velocity[rows]
        return
    names = monitor.names_of(block.names)
    found = [velocities.at(log_time_ns, names, monitor.names_of) for log_time_ns in block.log_time_ns[rows].tolist()]
    first = rows.start
    for size, group in groupby(found, len):
        part = list(group)
        yield slice(first, first + len(part)), np.array(part).reshape(len(part), size)
        first += len(part)


class _Payloads:
    """Hands the recorded payloads to a monitor."""

    def __init__(self, bag: Bag, monitor: Monitor) -> None:
        loads = payload_topics(bag, monitor.settings.payload_topic)
        messages = bag.messages(loads) if loads else iter(())
        self._monitor = monitor
        self._payloads = ((message.log_time_ns, decode_payload(message.data)) for message in messages)
        self._next_ns: float
        self._payload: Payload | str
        self._next_ns, self._payload = next(self._payloads, _NO_PAYLOAD)

    def take(self, log_time_ns: IntArray, row: int, stop: int) -> int:
        """Take the payloads that came up to `row`; return the row before `stop` up to which they count."""
        while self._next_ns <= log_time_ns[row]:
            self._monitor.take_payload(self._payload)
            self._next_ns, self._payload = next(self._payloads, _NO_PAYLOAD)
        later = np.flatnonzero(log_time_ns[row:stop] >= self._next_ns)
        return row + int(later[0]) if len(later) else stop


class RecordedVelocities:
    """Velocities of another recording, interpolated linearly at log times that do not decrease."""

    def __init__(self, bag: Bag, topic: str, max_gap_ns: int) -> None:
        """Read `topic` of `bag`, whose gaps are longer than `max_gap_ns`."""
        self.bag = bag
        self._states = (
            (log_time_ns, block.names, velocity)
            for block in bag.joint_state_blocks(topic)
            for log_time_ns, velocity in zip(block.log_time_ns.tolist(), block.velocity, strict=True)
        )
        self._max_gap_ns = max_gap_ns
        self._last = self._next = next(self._states, (0, (), _NO_VELOCITY))

    def at(self, log_time_ns: int, names: tuple[str, ...], names_of: Callable[[Names], Names]) -> FloatArray:
        """Return the velocities of `names` (n,), empty outside of the recording, in its gaps and without all names.

        `names_of` gives the robot's names of recorded ones.
        """
        while self._next[0] < log_time_ns:
            self._last, self._next = self._next, next(self._states, (np.iinfo(np.int64).max, (), _NO_VELOCITY))
        (start_ns, start_names, start), (stop_ns, stop_names, stop) = self._last, self._next
        if start_names != stop_names or not start_ns <= log_time_ns or stop_ns - start_ns > self._max_gap_ns:
            return _NO_VELOCITY
        recorded = names_of(start_names)
        if not len(start) == len(stop) == len(recorded) or not set(names) <= set(recorded):
            return _NO_VELOCITY
        share = (log_time_ns - start_ns) / max(stop_ns - start_ns, 1)
        order = [recorded.index(name) for name in names]
        return np.asarray((start + share * (stop - start))[order])


@contextmanager
def open_velocities(
    path: Path | None, topic: str | None, settings: MonitorSettings
) -> Iterator[RecordedVelocities | None]:
    """Give the velocities of the recording at `path`, None without one, to be used in a `with`.

    `topic` is that of the positions; the recording may have another one. Raises BagError, SettingsError.
    """
    if path is None:
        yield None
        return
    if settings.velocity_source is VelocitySource.FROM_POSITIONS:
        raise SettingsError(f"{path}: velocity_source = from_positions: must be reported with a bag of velocities")
    with open_bag(path) as bag:
        has_topic = topic is not None and topic.lstrip("/") in {name.lstrip("/") for name in bag.joint_state_topics}
        topic = joint_state_topic(bag, topic if has_topic else None)
        yield RecordedVelocities(bag, topic, round(settings.timeout * 1e9))


class ClockSkew:
    """Lead of the header stamps over the log times of a recording [s]."""

    def __init__(self) -> None:
        self.min_s, self.max_s = np.inf, -np.inf

    def add(self, stamp_ns: IntArray, log_time_ns: IntArray) -> None:
        """Count joint states (m,), but those without a stamp."""
        lead_s = (stamp_ns - log_time_ns)[stamp_ns > 0] / 1e9
        if len(lead_s):
            self.min_s, self.max_s = min(self.min_s, float(lead_s.min())), max(self.max_s, float(lead_s.max()))

    def lines(self, settings: MonitorSettings, time: Time) -> Iterator[tuple[str, str]]:
        """Yield the lead with `Time.HEADER`, or if no header stamp is valid at its log time."""
        is_valid = self.min_s <= settings.future_tolerance and self.max_s >= -settings.timeout
        if self.min_s <= self.max_s and (time is Time.HEADER or (time is Time.LIVE and not is_valid)):
            hint = "" if time is Time.HEADER else ": --time header assesses them on their own clock"
            yield "clock skew", f"header stamps lead the log times by {self.min_s:.3f} to {self.max_s:.3f} s{hint}"


def input_lines(
    settings: MonitorSettings, time: Time = Time.LIVE, velocities: Path | None = None
) -> Iterator[tuple[str, str]]:
    """Yield subject and text of each difference from the recorded joint states, and of settings without effect."""
    if settings.joint_map:
        yield "joint names", f"mapped by joint_map: {', '.join(settings.joint_map)}"
    if settings.joint_names:
        yield "joint names", f"of joint states without names, by joint_names: {', '.join(settings.joint_names)}"
    if settings.joint_limits:
        yield "joint limits", f"by joint_limits: {', '.join(settings.joint_limits)}"
    window_s, from_positions = settings.velocity_window, settings.velocity_source is VelocitySource.FROM_POSITIONS
    delay = f"over {window_s:g} s, {0.5 * window_s:g} s late"
    if velocities:
        yield "velocity", f"from {velocities}, interpolated at the log times of the positions"
    if from_positions:
        line = f"slope of the least-squares line {delay}" if window_s else "between two, half their distance late"
        yield "velocity", f"computed from positions: {line}"
    elif window_s:
        yield "velocity", f"filtered: mean {delay}"
    yield from (("no effect", line) for line in settings.without_effect())
    if time is not Time.LIVE:
        yield "time", "header stamps alone" if time is Time.HEADER else "log times in place of header stamps"


def other_topic_lines(bag: Bag, topic: str, monitor: Monitor) -> Iterator[tuple[str, str]]:
    """Yield subject and text of each topic with joint states other than `topic`, which `monitor` has assessed.

    The text names the joints outside the model that moved there. The live monitor takes a single topic, too.
    """
    for other in bag.joint_state_topics:
        if other == topic or other.endswith(JOINT_COMMANDS):
            continue
        watching = Monitor(monitor.dynamics, monitor.settings)
        for block in bag.joint_state_blocks(other):
            watching.watch_others(block.names, block.log_time_ns, block.position, block.velocity)
        moved = ", ".join(watching.unmodelled_joints)
        yield "other topic", f"{other} is not assessed{f', but joints outside the model moved: {moved}' * bool(moved)}"


def unapplied_lines(bag: Bag, settings: MonitorSettings) -> Iterator[tuple[str, str]]:
    """Yield subject and text of each topic of `bag` with a payload that `settings` do not apply."""
    for topic in bag.topics:
        name = topic.name.lstrip("/")
        if topic.type == INERTIA and topic.count and name != settings.payload_topic.lstrip("/"):
            text = f"payload, which is not applied: --payload-topic {name} applies it"
            yield "other topic", f"{topic.name} states a {text}"


def payload_topics(bag: Bag, name: str) -> list[str]:
    """Return the topic `name` of the payload as `bag` writes it; empty if it has none."""
    topics = (topic.name for topic in bag.topics if topic.type == INERTIA)
    return [topic for topic in topics if name and topic.lstrip("/") == name.lstrip("/")]


def generated_description(bag: Bag) -> str:
    """Return the description of a generated motion; empty if `bag` has no run information or was measured."""
    info = first_run_info(bag)
    return info.note.partition("\n")[0] if info is not None and info.simulated else ""


def cross_checked(
    source: str, states: Iterator[AssessedStates], reference: Iterator[AssessedStates]
) -> Iterator[AssessedStates]:
    """Yield the batches of `states`, from the recording `source`, while they agree with those of `reference`.

    Raises CrossCheckError, which names the first difference.
    """
    count = 0
    for own, other in zip_longest(states, reference):
        if own is None or other is None or len(own) != len(other):
            raise CrossCheckError(f"{source}: cross-check: the number of joint states differs from the monitor's")
        for row, expected in zip(own.rows(), other.rows(), strict=True):
            count += 1
            for (name, value), (_, reference_value) in zip(_values(row), _values(expected), strict=True):
                if _differs(value, reference_value):
                    where = f"joint state {count} at {row.log_time_ns} ns"
                    text = f"{name} = {value!r}, but {reference_value!r} by the monitor"
                    raise CrossCheckError(f"{source}: cross-check: {where}: {text}")
        yield own


def _values(row: AssessedState) -> Iterator[tuple[str, Any]]:
    """Yield name and value of all that was assessed at a joint state."""
    yield "log_time_ns", row.log_time_ns
    yield from ((name, value) for name, value in row.decision._asdict().items() if name != "contacts")
    for contact in row.decision.contacts:
        yield from ((f"{contact.contact_point}: {name}", value) for name, value in contact._asdict().items())


def _differs(own: Any, other: Any) -> bool:  # noqa: ANN401 - any value of a decision
    """Return whether two values differ; numbers by more than TOLERANCE."""
    if isinstance(own, tuple) and len(own) == len(other):
        return any(map(_differs, own, other))
    if isinstance(own, float) and own != other:
        is_nan = math.isnan(own) and math.isnan(other)
        return not (is_nan or abs(own - other) <= TOLERANCE * max(1.0, abs(other)))
    return bool(own != other)
