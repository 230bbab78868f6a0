"""Wrenches and plain numbers of a bag, one sample per message, put into the order of their stamps."""

from __future__ import annotations

import heapq
from itertools import chain, islice
from statistics import median_low
from typing import TYPE_CHECKING, Any, NamedTuple

from scara_effmass.errors import BagError, DecodeError
from scara_effmass.wire.cdr import NS
from scara_effmass.wire.message_types import FLOAT64, WRENCH, WRENCH_STAMPED

if TYPE_CHECKING:
    from collections.abc import Iterator

    from scara_effmass.bags.bag import Bag
    from scara_effmass.bags.batches import Topic

HEAD = 1000
"""Of so many messages it is seen by how much stamps differ from the times of recording."""

LARGEST_DELAY_NS = 5 * NS
"""A stamp that is off the usual difference by more is no stamp of this message."""

ODD_IN_A_ROW = 100
"""So many odd stamps one after the other are a clock that was set."""


class StampedSample(NamedTuple):
    """A message with one sample, and when it was recorded."""

    log_time_ns: int
    stamp_ns: int
    value: float


class StampedSamples(NamedTuple):
    """The `samples` of a topic, pairs of stamp [ns] and value in the order of the stamps, and what they are."""

    samples: Iterator[tuple[int, float]]
    description: str


def stamped_samples(bag: Bag, topic: Topic, axis: str) -> StampedSamples:
    """Return the force along `axis` of a topic of wrenches, or the numbers of one of Float64.

    The times are the header's. Where there is none, or nobody has filled it in, they are those of recording. Raises
    BagError, also from the iterator.
    """
    messages = _decoded(bag, topic, axis)
    head = list(islice(messages, HEAD))
    component = "" if topic.type == FLOAT64 else f" force.{axis}"
    if topic.type != WRENCH_STAMPED or not any(sample.stamp_ns for sample in head):
        samples = ((sample.log_time_ns, sample.value) for sample in chain(head, messages))
        return StampedSamples(samples, f"{component}, at the times of recording")
    usual_ns = median_low(sample.stamp_ns - sample.log_time_ns for sample in head)
    ordered = _in_order(chain(head, messages), usual_ns, f"{bag.path}: {topic.name}")
    return StampedSamples(ordered, component)


def _decoded(bag: Bag, topic: Topic, axis: str) -> Iterator[StampedSample]:
    """Yield the messages that can be decoded; what is left out is missing from the sequence of times."""
    reason, good = "", False
    for message in bag.messages([topic.name]):
        if message.type != topic.type:
            continue
        try:
            stamp_ns, value = _sample(bag.deserialize(message), topic.type, axis)
        except (DecodeError, AttributeError, TypeError, ValueError) as error:
            reason = str(error)
            continue
        good = True
        yield StampedSample(message.log_time_ns, stamp_ns, value)
    if reason and not good:
        raise BagError(f"{bag.path}: {topic.name}: no message can be decoded: {reason}")


def _sample(message: Any, kind: str, axis: str) -> tuple[int, float]:  # noqa: ANN401 - of a class that the recording defines
    if kind == FLOAT64:
        return 0, float(message.data)
    if kind == WRENCH:
        return 0, float(getattr(message.force, axis))
    stamp = message.header.stamp
    return int(stamp.sec) * NS + int(stamp.nanosec), float(getattr(message.wrench.force, axis))


def _in_order(samples: Iterator[StampedSample], usual_ns: int, origin: str) -> Iterator[tuple[int, float]]:
    """Yield stamps and values in the order of the stamps, without those whose stamp is not their own.

    Messages come in the order of recording; as no stamp is off that by more than the largest delay, none can come
    before what has been handed on.
    """
    waiting: list[tuple[int, int, float]] = []
    odd = 0
    for count, sample in enumerate(samples):
        expected_ns = sample.log_time_ns + usual_ns
        if abs(sample.stamp_ns - expected_ns) > LARGEST_DELAY_NS:
            odd += 1
            if odd == ODD_IN_A_ROW:
                off = f"{(sample.stamp_ns - expected_ns) / NS:.3f} s off from {sample.log_time_ns / NS:.6f} s on"
                raise BagError(f"{origin}: its stamps are {off}; a clock that is not set would be right")
            continue
        odd = 0
        heapq.heappush(waiting, (sample.stamp_ns, count, sample.value))
        while waiting[0][0] < expected_ns - LARGEST_DELAY_NS:
            yield heapq.heappop(waiting)[::2]
    while waiting:
        yield heapq.heappop(waiting)[::2]
