"""Samples that each bear a stamp, as drivers and files have them, put on the even times at which they were taken.

A sensor measures at a constant rate; what writes the stamps does not. They come late and in bursts, and samples are
missing. A late sample makes its own stamp late, a missing one makes all that follow late: that tells them apart. How
late the stamps of a stretch are is therefore judged by the least late of them.
"""

from __future__ import annotations

from itertools import chain, islice
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from scara_effmass.daq.force_file import NS, RecordedBlock

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from scara_effmass.values import FloatArray

    IntArray = NDArray[np.int64]

HEAD = 4096
"""Of so many samples the rate is taken."""
CHUNK = 4096
REACH = 64
"""Samples in a stretch."""
LAGS = (1, 4, 16, 64, 256, 1024)
ALIKE, MOST = 0.25, 0.75
"""Where most steps are alike to within this fraction of a period, stamps come one by one and not in bursts."""
NOISE = 2.0
"""So many times the usual lateness, the least one of a stretch differs from that of another by chance only rarely."""
ROUNDS = 4
LARGEST_LOSS = 0.5


class _Rhythm(NamedTuple):
    """The period, and by how much a stretch must be later than the one before to show that samples are missing, [ns].

    In a short stretch, as at the end, there may be no sample that is not late.
    """

    period_ns: float
    threshold_ns: float
    short_threshold_ns: float


class EvenBlocks:
    """Cuts stamped samples into blocks of equal periods, each with the time of its first sample.

    That time is the median over the block of what its stamps say; the root mean square of what they are off it is
    the block's `clock_residual`.
    """

    def __init__(self, samples: Iterable[tuple[int, float]], block_time: float, scale: float) -> None:
        """Take `samples`, pairs of a stamp [ns] and a value, in the order of their stamps.

        Values are multiplied by `scale`. Raises ValueError, with what is wrong, when they have no constant rate.
        """
        rest = iter(samples)
        head = list(islice(rest, HEAD))
        if len(head) < 2:
            raise ValueError(f"holds {len(head)} samples; at least 2 would be right")
        stamps_ns = np.array([stamp_ns for stamp_ns, _ in head], np.int64)
        self._samples = chain(head, rest)
        self._rhythm = _rhythm(stamps_ns)
        self._period_ns = self._rhythm.period_ns
        self._scale = scale
        self.start_ns = int(stamps_ns[0])
        self.sample_rate = NS / self._period_ns
        self._size = max(1, round(block_time * self.sample_rate))

    def __iter__(self) -> Iterator[RecordedBlock]:
        numbering = _Numbering(self.start_ns, self._rhythm)
        ahead: list[tuple[int, float]] = []
        kept = np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0)
        end = 0
        while True:
            ahead += islice(self._samples, CHUNK + REACH - len(ahead))
            last = len(ahead) < CHUNK + REACH
            count = len(ahead) if last else CHUNK
            stamps_ns = np.fromiter((stamp_ns for stamp_ns, _ in ahead), np.int64, len(ahead))
            values = np.fromiter((value for _, value in ahead[:count]), np.float64, count)
            with np.errstate(over="ignore"):  # infinite, then, which is no force
                values *= self._scale
            fresh = numbering.numbers(stamps_ns, count), stamps_ns[:count], values
            numbers, stamps_ns, values = (np.concatenate(pair) for pair in zip(kept, fresh, strict=True))
            ahead = ahead[count:]
            first = 0
            for stop in self._stops(numbers, last=last):
                lost = int(numbers[first]) - end
                end = int(numbers[stop - 1]) + 1
                yield self._block(stamps_ns[first:stop], values[first:stop], lost)
                first = stop
            if last:
                return
            kept = numbers[first:], stamps_ns[first:], values[first:]

    def _stops(self, numbers: IntArray, *, last: bool) -> Iterator[int]:
        """Yield where blocks end: when they are full, and before gaps."""
        first = 0
        for gap in [*(np.flatnonzero(np.diff(numbers) > 1) + 1).tolist(), len(numbers)]:
            yield from range(first + self._size, gap, self._size)
            full = (gap - first) % self._size == 0
            if gap > first and (gap < len(numbers) or last or full):
                yield gap
            first = gap

    def _block(self, stamps_ns: IntArray, values: FloatArray, lost: int) -> RecordedBlock:
        off_ns = (stamps_ns - stamps_ns[0]) - np.arange(len(stamps_ns)) * self._period_ns
        shift_ns = float(np.median(off_ns))
        residual_ns = float(np.sqrt(np.mean((off_ns - shift_ns) ** 2)))
        return RecordedBlock(int(stamps_ns[0]) + round(shift_ns), values, lost, residual_ns / NS)


class _Numbering:
    """Numbers samples from the first on, missing ones included."""

    def __init__(self, start_ns: int, rhythm: _Rhythm) -> None:
        self._start_ns = start_ns
        self._rhythm = rhythm
        self._next = 0
        self._before = np.empty(0)
        """How late the last samples were [ns]."""

    def numbers(self, stamps_ns: IntArray, count: int) -> IntArray:
        """Return the numbers of the first `count` samples; those behind show which of them are only late."""
        period_ns, threshold_ns, short_threshold_ns = self._rhythm
        numbers = self._next + np.arange(len(stamps_ns))
        late_ns = np.concatenate((self._before, (stamps_ns - self._start_ns) - numbers * period_ns))
        at = known = len(self._before)
        thresholds = np.full(len(late_ns), threshold_ns)
        thresholds[-REACH // 2 :] = short_threshold_ns
        while len(found := np.flatnonzero((_steps(late_ns) > thresholds)[at : known + count])):
            at += int(found[0])
            lost = round(_steps(late_ns)[at] / period_ns)
            numbers[at - known :] += lost
            late_ns[at:] -= lost * period_ns
            at += 1
        self._before = late_ns[max(0, known + count - REACH) : known + count]
        self._next = int(numbers[count - 1]) + 1 if count else self._next
        return numbers[:count]


def _steps(late_ns: FloatArray) -> FloatArray:
    """Return how much later the stretch from each sample on is than the one before it."""
    infinite = np.full(REACH, np.inf)
    least = sliding_window_view(np.concatenate((infinite, late_ns, infinite)), REACH).min(axis=1)
    steps: FloatArray = least[REACH : REACH + len(late_ns)] - least[: len(late_ns)]
    return steps


def _rhythm(stamps_ns: IntArray) -> _Rhythm:
    """Return the rhythm of samples of which most are there."""
    period_ns = _period_ns(stamps_ns)
    if period_ns <= 0.0:
        raise ValueError("its times do not advance; times at a constant rate would be right")
    late_ns = _stretches(_late_ns(stamps_ns, period_ns), max(2, min(REACH, len(stamps_ns)) // 4))
    least_ns = late_ns.min(axis=1)
    usual_ns = float(np.median(np.median(late_ns, axis=1) - least_ns))
    most_ns = float(np.median(late_ns.max(axis=1) - least_ns))
    threshold_ns = max(0.5 * (period_ns + usual_ns), NOISE * usual_ns)
    rhythm = _Rhythm(period_ns, threshold_ns, 0.5 * period_ns + NOISE * most_ns)
    numbers = _Numbering(int(stamps_ns[0]), rhythm).numbers(stamps_ns, len(stamps_ns))
    total = int(numbers[-1]) + 1
    half = len(stamps_ns) // 2
    period_ns = float(np.mean(stamps_ns[half:] - stamps_ns[:-half]) / np.mean(numbers[half:] - numbers[:-half]))
    if total - len(stamps_ns) > LARGEST_LOSS * total:
        missing = f"of {total} samples at {NS / period_ns:.6g} Hz, {total - len(stamps_ns)} are missing"
        raise ValueError(f"is not sampled at a constant rate: {missing}")
    return rhythm._replace(period_ns=period_ns)


def _period_ns(stamps_ns: IntArray) -> float:
    """Return the time from sample to sample, good enough to tell missing ones."""
    steps = np.diff(stamps_ns)
    period_ns = float(np.median(steps))
    half = len(stamps_ns) // 2
    if period_ns > 0.0 and np.mean(np.abs(steps - period_ns) <= ALIKE * period_ns) >= MOST:
        # the number of periods in a span is known from that in shorter ones, whatever is missing there
        for lag in (lag for lag in LAGS if lag <= half):
            spans = stamps_ns[lag:] - stamps_ns[:-lag]
            period_ns = float(spans.sum() / np.round(spans / period_ns).sum())
        return period_ns
    # bursts: the time from the least late sample of a stretch to that of the next
    lag = min(REACH, half)
    period_ns = float(np.median(stamps_ns[lag:] - stamps_ns[:-lag])) / lag
    for _ in range(ROUNDS if half >= REACH else 0):
        least = _stretches(_late_ns(stamps_ns, period_ns), REACH).argmin(axis=1)
        least += np.arange(len(least)) * REACH
        period_ns = float(np.median(np.diff(stamps_ns[least]) / np.diff(least)))
    return period_ns


def _late_ns(stamps_ns: IntArray, period_ns: float) -> FloatArray:
    """Return how late samples are if none is missing."""
    late_ns: FloatArray = (stamps_ns - stamps_ns[0]) - np.arange(len(stamps_ns)) * period_ns
    return late_ns


def _stretches(late_ns: FloatArray, size: int) -> FloatArray:
    """Return stretches (k, size), without what is left over at the end."""
    return late_ns[: len(late_ns) // size * size].reshape(-1, size)
