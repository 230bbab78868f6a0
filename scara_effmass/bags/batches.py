"""Messages as every kind of recording hands them on: many at a time, in log-time order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator

    from rosbags.typesys.store import Typestore

IntArray = NDArray[np.int64]

LATEST_NS = 2**63 - 1
"""The end of time as ROS counts it."""


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a recording. `type_hash` is the REP 2011 hash or the ROS 1 MD5 sum, empty where none is stored.

    `offered_qos` is what its publishers offered, in rosbag2's YAML, known to whoever writes a recording.
    """

    name: str
    type: str
    count: int
    type_hash: str = ""
    offered_qos: str = ""


class Source(Protocol):
    """A recording of one format: its files, open. Time is log time, in [ns]."""

    topics: tuple[Topic, ...]
    start_ns: int
    end_ns: int

    @property
    def types(self) -> Typestore:
        """The message types: those defined in the recording, else the known ones."""

    def batches(self, topics: Collection[int], start_ns: int, stop_ns: int) -> Iterator[MessageBatch]:
        """Yield the messages of these indices of `topics`, from `start_ns` up to but without `stop_ns`, in order."""

    def close(self) -> None:
        """Close the files."""


class Losses:
    """What could not be read, one line each, however often it was tried."""

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}

    def add(self, line: str, count: int = 1) -> None:
        """Note what `line` says; `count` is how often it has happened in this reading so far."""
        self._counts[line] = max(count, self._counts.get(line, 0))

    def __iter__(self) -> Iterator[str]:
        return (line if count == 1 else f"{line} ({count} times)" for line, count in self._counts.items())


class MessageBatch(NamedTuple):
    """Some messages (m,) of one recording, all in one buffer.

    `data[start[i]:stop[i]]` are the CDR bytes of message i, `topic[i]` is its index in the topics of the source.
    """

    data: bytes
    topic: IntArray
    log_time_ns: IntArray
    start: IntArray
    stop: IntArray

    def pick(self, which: IntArray | NDArray[np.bool_] | slice) -> MessageBatch:
        """Return the messages that a numpy index picks, over the same buffer."""
        return MessageBatch(self.data, self.topic[which], self.log_time_ns[which], self.start[which], self.stop[which])

    def followed_by(self, other: MessageBatch) -> MessageBatch:
        """Return both batches in one; the buffer of this one is cut down to what its messages need."""
        if not len(self.topic):
            return other
        messages = [self.data[first:last] for first, last in zip(self.start, self.stop, strict=True)]
        mine = batch_of(self.topic, self.log_time_ns, messages)
        shift = len(mine.data)
        return MessageBatch(
            mine.data + other.data,
            np.concatenate((mine.topic, other.topic)),
            np.concatenate((mine.log_time_ns, other.log_time_ns)),
            np.concatenate((mine.start, other.start + shift)),
            np.concatenate((mine.stop, other.stop + shift)),
        )


def batch_of(topic: Iterable[int], log_time_ns: Iterable[int], messages: list[bytes]) -> MessageBatch:
    """Return single messages as a batch."""
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
    """Put the messages of `batches` into log-time order; equal times keep their order.

    Each batch comes with a time that no message of a later batch lies before; what is later than that is held
    back. So the memory this takes depends on how far the batches overlap, not on how many there are.
    """
    held = NO_MESSAGES
    for fresh, horizon_ns in batches:
        batch = held.followed_by(fresh)
        if np.any(np.diff(batch.log_time_ns) < 0):
            batch = batch.pick(np.argsort(batch.log_time_ns, kind="stable"))
        ready = int(np.searchsorted(batch.log_time_ns, horizon_ns, side="right"))
        if ready:
            yield batch.pick(slice(None, ready))
        held = batch.pick(slice(ready, None))
    if len(held.topic):
        yield held
