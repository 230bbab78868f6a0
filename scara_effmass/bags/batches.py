# SPDX-License-Identifier: Apache-2.0
"""Batches of messages in log-time order, for all bag formats, and joint states decoded from them in bulk."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from scara_effmass.errors import DecodeError
from scara_effmass.values import FloatArray, JointState
from scara_effmass.wire.cdr import NS, STAMP_AT
from scara_effmass.wire.joint_state import JointStateLayout, joint_state_layout

IntArray = NDArray[np.int64]

MAX_TIME_NS = 2**63 - 1
MIN_WINDOW = 64
WINDOW_GROWTH = 4


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a bag. `type_hash` is the REP 2011 hash or the ROS 1 MD5 sum, empty if the bag stores none.

    `offered_qos` is the QoS of its publishers in rosbag2's YAML, empty if unknown.
    """

    name: str
    type: str
    count: int
    type_hash: str = ""
    offered_qos: str = ""


def merged_topics(topics: Iterable[Topic]) -> list[Topic]:
    """Merge equal topics of several files and add up their counts; keep the order in which they first appear."""
    merged: dict[tuple[str, str], Topic] = {}
    for topic in topics:
        first = merged.get((topic.name, topic.type), replace(topic, count=0))
        merged[topic.name, topic.type] = replace(first, count=first.count + topic.count)
    return list(merged.values())


class LossLog:
    """Lines about data that could not be read. Reading the same data again adds no line."""

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}

    def add(self, line: str, count: int = 1) -> None:
        """Add `line`, or increase its count to `count`, the number of occurrences in the current reading."""
        self._counts[line] = max(count, self._counts.get(line, 0))

    def counter(self) -> Callable[[str], None]:
        """Return a function that adds a line, or counts it once more, for one reading of the data."""
        counts: Counter[str] = Counter()

        def add(line: str) -> None:
            counts[line] += 1
            self.add(line, counts[line])

        return add

    def extend(self, lines: Iterable[str]) -> None:
        """Add the `lines` of another log."""
        for line in lines:
            self.add(line)

    def __iter__(self) -> Iterator[str]:
        return (line if count == 1 else f"{line} ({count} times)" for line, count in self._counts.items())


class MessageBatch(NamedTuple):
    """Messages (m,) of one bag in one buffer.

    `data[start[i]:stop[i]]` are the CDR bytes of message i, `topic[i]` is the index of its topic in the source.
    """

    data: bytes
    topic: IntArray
    log_time_ns: IntArray
    start: IntArray
    stop: IntArray

    def select(self, index: IntArray | NDArray[np.bool_] | slice) -> MessageBatch:
        """Return the messages that a numpy index selects, in the same buffer."""
        return MessageBatch(self.data, self.topic[index], self.log_time_ns[index], self.start[index], self.stop[index])

    def joined_with(self, other: MessageBatch) -> MessageBatch:
        """Return both batches as one; of this one, only the messages are copied and not the whole buffer."""
        if not len(self.topic):
            return other
        messages = [self.data[first:last] for first, last in zip(self.start, self.stop, strict=True)]
        head = batch_of(self.topic, self.log_time_ns, messages)
        shift = len(head.data)
        return MessageBatch(
            head.data + other.data,
            np.concatenate((head.topic, other.topic)),
            np.concatenate((head.log_time_ns, other.log_time_ns)),
            np.concatenate((head.start, other.start + shift)),
            np.concatenate((head.stop, other.stop + shift)),
        )


def batch_of(topic: Iterable[int], log_time_ns: Iterable[int], messages: list[bytes]) -> MessageBatch:
    """Return messages as a batch."""
    stop = np.cumsum(np.fromiter(map(len, messages), np.int64, len(messages)))
    return MessageBatch(
        b"".join(messages),
        np.fromiter(topic, np.int64, len(messages)),
        np.fromiter(log_time_ns, np.int64, len(messages)),
        np.concatenate((np.zeros(1, np.int64), stop[:-1])),
        stop,
    )


NO_MESSAGES = MessageBatch(b"", *(np.empty(0, np.int64) for _ in range(4)))


def in_log_time_order(batches: Iterable[tuple[MessageBatch, int]]) -> Iterator[MessageBatch]:
    """Yield the messages of `batches` in log-time order; equal times keep their order.

    Each batch comes with a lower bound of the log times of all later batches. Messages after that bound are held back,
    so the memory depends on how far the batches overlap and not on their number.
    """
    held = NO_MESSAGES
    for batch, horizon_ns in batches:
        joined = held.joined_with(batch)
        if np.any(np.diff(joined.log_time_ns) < 0):
            joined = joined.select(np.argsort(joined.log_time_ns, kind="stable"))
        ready = int(np.searchsorted(joined.log_time_ns, horizon_ns, side="right"))
        if ready:
            yield joined.select(slice(None, ready))
        held = joined.select(slice(ready, None))
    if len(held.topic):
        yield held


class DecodeFailure(NamedTuple):
    """A message that is not a valid JointState, and the reason."""

    log_time_ns: int
    reason: str


@dataclass(frozen=True, slots=True)
class JointStateBlock:
    """Consecutive JointStates (m,) of one topic with the same names; arrays are read-only.

    `position` (m, n) is in [rad] or [m], `velocity` (m, k) per second, `effort` (m, l) in [N m] or [N], as received; n,
    k and l may be 0 and may differ from the number of names. `log_time_ns` (m,) is the receive time, `stamp_ns` (m,)
    the header stamp. `decode_failures` precede the first state; a block may consist of failures alone.
    """

    log_time_ns: IntArray
    stamp_ns: IntArray
    names: tuple[str, ...]
    position: FloatArray
    velocity: FloatArray
    effort: FloatArray
    decode_failures: tuple[DecodeFailure, ...] = ()

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def states(self) -> Iterator[JointState]:
        """Yield the states one by one, bit-identical to the output of `JointStateDecoder`."""
        names = self.names
        rows = zip(self.stamp_ns.tolist(), self.position, self.velocity, self.effort, strict=True)
        for stamp_ns, position, velocity, effort in rows:
            yield JointState(stamp_ns, names, position, velocity, effort)


class BlockDecoder:
    """Decodes batches of JointState messages and lists the invalid ones in `losses`."""

    def __init__(self, origin: str, losses: LossLog) -> None:
        self._origin = origin
        self._add_loss = losses.counter()
        self._window = MIN_WINDOW

    def blocks(self, batch: MessageBatch) -> Iterator[JointStateBlock]:
        """Yield the JointStates of `batch`, which must all be of one topic, in order."""
        size = batch.stop - batch.start
        buffer = np.frombuffer(batch.data, np.uint8)
        failures: list[DecodeFailure] = []
        first = 0
        while first < len(size):
            try:
                layout = joint_state_layout(batch.data[batch.start[first] : batch.stop[first]])
            except DecodeError as error:
                self._add_loss(f"{self._origin}: left out: {error}")
                failures.append(DecodeFailure(int(batch.log_time_ns[first]), str(error)))
                first += 1
                continue
            # How many messages share the layout is unknown: the window grows as long as all messages in it match.
            window = slice(first, first + self._window)
            count = leading(size[window] == layout.size)
            rows = sliding_window_view(buffer, layout.size)[batch.start[first : first + count]]
            fixed = np.concatenate([np.arange(*span) for span in layout.fixed])
            count = leading((rows[:, fixed] == rows[0, fixed]).all(axis=1))
            self._window = self._window * WINDOW_GROWTH if count == len(size[window]) else max(count, 1)
            block = _block(rows[:count], batch.log_time_ns[first : first + count], layout)
            yield replace(block, decode_failures=tuple(failures))
            failures.clear()
            first += count
        if failures:
            empty = np.empty((0, 0))
            no_times = batch.log_time_ns[:0]
            yield JointStateBlock(no_times, no_times, (), empty, empty, empty, tuple(failures))


def leading(flags: NDArray[np.bool_]) -> int:
    """Return the number of true flags before the first false one."""
    return len(flags) if flags.all() else int(flags.argmin())


def _columns(rows: NDArray[np.uint8], start: int, size: int, dtype: str) -> NDArray[np.generic]:
    columns: NDArray[np.generic] = rows[:, start : start + size].copy().view(dtype)
    return columns


def _block(rows: NDArray[np.uint8], log_time_ns: IntArray, layout: JointStateLayout) -> JointStateBlock:
    order = layout.byte_order
    sec = _columns(rows, STAMP_AT, 4, f"{order}i4")[:, 0].astype(np.int64)
    nanosec = _columns(rows, STAMP_AT + 4, 4, f"{order}u4")[:, 0].astype(np.int64)
    position, velocity, effort = (
        _columns(rows, numbers.at, 8 * numbers.length, f"{order}f8").astype(np.float64)
        for numbers in (layout.position, layout.velocity, layout.effort)
    )
    block = JointStateBlock(log_time_ns.copy(), sec * NS + nanosec, layout.names, position, velocity, effort)
    for array in (block.log_time_ns, block.stamp_ns, position, velocity, effort):
        array.flags.writeable = False
    return block
