# SPDX-License-Identifier: Apache-2.0
"""Assess every joint state of a recording; its log time replaces the clock of the live node."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import NamedTuple

import numpy as np

from scara_effmass.analysis.assessed_states import AssessedStates, states_of
from scara_effmass.bags.bag import Bag, first_run_info
from scara_effmass.bags.batches import IntArray
from scara_effmass.bags.files import open_bag
from scara_effmass.errors import BagError, SettingsError
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings, VelocitySource
from scara_effmass.values import Decision, FloatArray, JointState
from scara_effmass.wire.message_types import INERTIA
from scara_effmass.wire.payload import decode_payload

Names = tuple[str, ...]
MANY = 10_000
"""Joint states from which on the kernel saves more time than the start of numba takes."""

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
    """One recorded joint state and its decision.

    `state` is None for an undecodable message, `decision` for a joint state without a joint of the robot.
    """

    log_time_ns: int
    state: JointState | None
    decision: Decision | None


def joint_state_topic(bag: Bag, requested: str | None) -> str:
    """Return the topic to assess: the requested one, else `joint_states`, else the only one with joint states.

    Raises BagError, which lists the candidates, if no topic or several topics match.
    """
    topics = bag.joint_state_topics
    if requested is not None:
        names = [requested]
    elif "/joint_states" in topics:
        names = ["/joint_states"]
    else:
        names = list(topics)
    # ROS 1 recorders omit the leading slash, and so do users.
    matches = [topic for topic in topics if topic.lstrip("/") in {name.lstrip("/") for name in names}]
    if len(matches) == 1:
        return matches[0]
    if not topics:
        raise BagError(f"{bag.path}: no topic holds joint states (sensor_msgs/JointState)")
    problem = "several topics hold joint states" if requested is None else f"no joint states on {requested}"
    raise BagError(f"{bag.path}: {problem}; --topic must be one of {', '.join(topics)}")


def assess_joint_states(
    bag: Bag, topic: str, monitor: Monitor, time: Time = Time.LIVE, velocities: RecordedVelocities | None = None
) -> Iterator[AssessedState]:
    """Yield the decision of `monitor` for each joint state on `topic`, decoded as the live node decodes it.

    The joint states have the robot's names, the stamps of `time`, and, if given, the `velocities` of another recording.
    An undecodable message gives UNKNOWN and debounces the following verdicts, as in the live node. Payloads that were
    recorded on the `payload_topic` of the settings count from their log times on.
    Raises BagError, at the end also if no joint state names a joint of the robot.
    """
    count = clock_ns = 0
    loads = payload_topics(bag, monitor.settings.payload_topic)
    messages = bag.messages(loads) if loads else iter(())
    payloads = ((message.log_time_ns, decode_payload(message.data)) for message in messages)
    payload_ns, payload = next(payloads, _NO_PAYLOAD)
    for block in bag.joint_state_blocks(topic):
        for log_time_ns, reason in block.decode_failures:
            count += 1
            yield AssessedState(log_time_ns, None, monitor.reject(reason))
        names = monitor.names_of(block.names)
        for log_time_ns, recorded in zip(block.log_time_ns.tolist(), block.states(), strict=True):
            count += 1
            while payload_ns <= log_time_ns:
                monitor.take_payload(payload)
                payload_ns, payload = next(payloads, _NO_PAYLOAD)
            state, now_ns = recorded, log_time_ns
            if velocities is not None:
                state = state._replace(velocity=velocities.at(log_time_ns, names, monitor.names_of))
            if time is Time.LOG:
                state = state._replace(stamp_ns=log_time_ns)
            elif time is Time.HEADER:
                now_ns = clock_ns = max(clock_ns, state.stamp_ns)  # a stamp that goes back is refused, as live
            decision = monitor.assess(state, now_ns)
            yield AssessedState(log_time_ns, recorded._replace(names=names), decision)
    require_own_joints(bag, topic, monitor, count)


def require_own_joints(bag: Bag, topic: str, monitor: Monitor, count: int) -> None:
    """Raise BagError if `monitor` ignored all of `count` joint states on `topic` as those of other devices."""
    if monitor.ignored == count > 0:
        joints = ", ".join(monitor.dynamics.robot.joint_names)
        problem = f"none of its joint states names a joint of the robot ({joints})"
        raise BagError(f"{bag.path}: {topic}: {problem}{monitor.joint_map_hint}")


class RecordedVelocities:
    """Velocities of another recording, interpolated linearly at log times that do not decrease."""

    def __init__(self, bag: Bag, topic: str, max_gap_ns: int) -> None:
        """Read `topic` of `bag`, whose gaps are longer than `max_gap_ns`."""
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
    """Yield subject and text of each difference of the assessed joint states from the recorded ones."""
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
    if time is not Time.LIVE:
        yield "time", "header stamps alone" if time is Time.HEADER else "log times in place of header stamps"


def payload_topics(bag: Bag, name: str) -> list[str]:
    """Return the topic `name` of the payload as `bag` writes it; empty if it has none."""
    topics = (topic.name for topic in bag.topics if topic.type == INERTIA)
    return [topic for topic in topics if name and topic.lstrip("/") == name.lstrip("/")]


def generated_description(bag: Bag) -> str:
    """Return the description of a generated motion; empty if `bag` has no run information or was measured."""
    info = first_run_info(bag)
    return info.note.partition("\n")[0] if info is not None and info.simulated else ""


def one_by_one(assessed: Iterator[AssessedState], skew: ClockSkew, size: int = 4_096) -> Iterator[AssessedStates]:
    """Yield the decisions of a monitor in batches of `size` joint states, as columns; count the clocks in `skew`."""
    items: list[AssessedState] = []
    count = 0
    for item in assessed:
        items.append(item)
        count += item.decision is not None
        if count == size:
            yield from _as_columns(items, skew)
            items, count = [], 0
    yield from _as_columns(items, skew)


def _as_columns(items: list[AssessedState], skew: ClockSkew) -> Iterator[AssessedStates]:
    stamps = [(item.state.stamp_ns, item.log_time_ns) for item in items if item.state is not None]
    skew.add(*np.array(stamps, np.int64).reshape(-1, 2).T)
    rows = [(item, item.decision.contacts) for item in items if item.decision is not None]
    if rows:

        def positions(row: int) -> dict[str, float]:
            state = rows[row][0].state
            return {} if state is None else dict(zip(state.names, state.position.tolist(), strict=False))

        yield states_of([item.log_time_ns for item, _ in rows], [contacts for _, contacts in rows], positions)
