# SPDX-License-Identifier: Apache-2.0
"""Batches of messages in log-time order, for all bag formats."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]

MAX_TIME_NS = 2**63 - 1


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
