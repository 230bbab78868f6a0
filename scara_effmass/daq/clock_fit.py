"""When a sample was taken: the running fit of a device's sample numbers to ROS time."""

from __future__ import annotations

import math
from collections import deque
from statistics import median
from typing import NamedTuple

import numpy as np

BIN_S = 1.0
"""The earliest read of so long stands for all of them."""
BINS = 30
"""So many bins tell the rate: long enough for a few ppm, short enough to follow a clock that is being slewed."""
LEAST_BINS = 8
"""With fewer, two late bins, as many as LATE_S makes, would spoil more than half of the slopes."""
OFFSET_BINS = 5
"""So many of the latest bins tell the offset, so that a wrong rate has little time to do harm. With fewer, they say
little about each other; how late reads usually are tells more."""
SETTLED_READS = 10
"""By then at least one was early: all of ten are late by more than their mean delay once in 22 000 times (e^-10)."""
START_UNCERTAINTY_S = 10e-3
"""How late one read alone may be; shared out among the reads there are."""
JUMP_S = 5e-3
"""A fit that is off by more is no fit any more: one of the two clocks has jumped."""
LATE_S = 2.0
"""For so long reads have to be late, all by the same to within JUMP_S, to be taken for a jump."""


class _Point(NamedTuple):
    """A read: seconds of nominal time since the origin, and how much later than that it was in ROS time [s]."""

    x: float
    y: float


class ClockFit:
    """Running fit of a device's sample numbers to ROS time, the same for all channels of the device.

    A read comes later than its last sample was taken, by a delay that is often small, sometimes huge and never
    negative. So a mean would be late; the earliest reads tell the time. The rate is the median of the slopes between
    the earliest reads of each second (Theil and Sen), over the last 30 s; the offset puts the line through the earliest
    read of the last 5 s. What every read is late by, nobody can see: stamps are late by the smallest delay there is.

    Times are integer nanoseconds, and floats only ever hold differences, so no stamp is rounded to what a float of
    nanoseconds since 1970 can hold. The stamp of a sample follows from its index alone; nothing is accumulated.

    After the tenth read, the fit moves backwards by no more than one sample from read to read, so that no sample
    comes before the previous one; the rest is made up for later and is part of `residual`. When a read is 5 ms earlier
    than the fit, or 2 s of samples are all later by the same, at least 5 ms, a clock has jumped: the fit begins anew,
    and stamps may leap. After a stall, what has piled up comes later by less and less, which is no jump.
    """

    def __init__(self, nominal_rate: float) -> None:
        """Expect about `nominal_rate` samples per second."""
        self._nominal_rate = nominal_rate
        self.sample_rate = nominal_rate
        """Measured against ROS time [Hz]; nominal during the first seconds."""
        self.residual = START_UNCERTAINTY_S
        """What a stamp may be off [s]: nine of ten seconds have their earliest read within so much of the fit; at first
        no less than 10 ms over the number of reads, nor than what half of the reads are late by; after a jump no less
        than that, by a factor e less with each read; and on top, how much of a backward move is yet to be made up."""
        self.restarts = 0
        """How often a fit that had settled was given up because a clock had jumped."""
        self._reads = 0
        self._anchor = 0
        self._anchor_ns = 0

    @property
    def settled(self) -> bool:
        """Whether there were more reads than it takes for one of them to have been early."""
        return self._reads > SETTLED_READS

    def stamp_ns(self, sample: int) -> int:
        """Return the ROS time at which the sample with this index was taken. Raises RuntimeError before any read."""
        if not self._reads:
            raise RuntimeError("the time of a sample is not known before the first read")
        return self._anchor_ns + round((sample - self._anchor) / self.sample_rate * 1e9)

    def update(self, sample_count: int, host_ns: int) -> None:
        """Take in a read: `sample_count` samples, lost ones included, existed by the ROS time `host_ns`."""
        last = sample_count - 1
        if not self._reads:
            self._start(last, host_ns)
        elif last < self._anchor:
            self.restarts += self.settled
            self._start(last, host_ns)
        elif self._jumped(last, late_s := (host_ns - self.stamp_ns(last)) / 1e9):
            jump_s = abs(late_s) if self.settled else 0.0
            self.restarts += self.settled
            self._start(last, host_ns)
            self._jump_s = jump_s
        self._reads += 1
        x = (last - self._origin) / self._nominal_rate
        self._sort_in(_Point(x, (host_ns - self._origin_ns) / 1e9 - x))
        self._draw(last, x)

    def reset(self) -> None:
        """Forget all reads, as when the device was started again: the next one is a first one."""
        self._reads = 0
        self.sample_rate = self._nominal_rate
        self.residual = START_UNCERTAINTY_S

    def _start(self, last: int, host_ns: int) -> None:
        self.reset()
        self._origin = self._anchor = last
        self._origin_ns = self._anchor_ns = host_ns
        self._slope = 0.0
        self._scatter = 0.0
        self._bins: deque[_Point] = deque(maxlen=BINS)
        self._earliest = _Point(0.0, 0.0)
        self._bin_end = BIN_S
        self._first_y: list[float] = []
        self._jump_s = 0.0
        self._late_reads = 0
        self._late_by_s = 0.0
        self._late_for_s = 0.0

    def _jumped(self, last: int, late_s: float) -> bool:
        if late_s <= JUMP_S:
            self._late_reads = 0
            return late_s < -JUMP_S
        if not self._late_reads or late_s < self._late_by_s - JUMP_S:
            # The ones before were merely delayed.
            self._late_reads, self._late_by_s, self._late_for_s = 1, late_s, 0.0
        elif late_s <= self._late_by_s + JUMP_S:
            # Late by the same, so as much host time has passed as samples have come.
            self._late_reads += 1
            self._late_for_s += (last - self._anchor) / self._nominal_rate
        return self._late_reads >= SETTLED_READS and self._late_for_s >= LATE_S

    def _sort_in(self, point: _Point) -> None:
        host_s = sum(point)
        if len(self._bins) < OFFSET_BINS:
            self._first_y.append(point.y)
        # By host time: when reads have been held up for long, all that come at once are one bin.
        if host_s < self._bin_end:
            self._earliest = min(self._earliest, point, key=self._above)
            return
        self._bins.append(self._earliest)
        self._earliest = point
        self._bin_end = host_s + BIN_S
        if len(self._bins) >= LEAST_BINS:
            self._slope = _median_slope(self._bins)
            self.sample_rate = self._nominal_rate / (1.0 + self._slope)
        offset = self._offset()
        distances = sorted(abs(self._above(other) - offset) for other in self._bins)
        self._scatter = distances[len(distances) * 9 // 10]

    def _above(self, point: _Point) -> float:
        return point.y - self._slope * point.x

    def _offset(self) -> float:
        return min(map(self._above, (*list(self._bins)[-OFFSET_BINS:], self._earliest)))

    def _draw(self, last: int, x: float) -> None:
        """Put the line through the envelope, but no sample before the one that precedes it."""
        fit_ns = self._origin_ns + round((x + self._slope * x + self._offset()) * 1e9)
        behind_ns = 0
        if self.settled:
            first_new_ns = fit_ns - round((last - self._anchor - 1) / self.sample_rate * 1e9)
            behind_ns = max(0, self._anchor_ns - first_new_ns)
        self._anchor, self._anchor_ns = last, fit_ns + behind_ns
        unsettled_s = max(START_UNCERTAINTY_S / self._reads, self._jump_s * math.exp(1 - self._reads))
        if len(self._bins) < OFFSET_BINS:
            unsettled_s = max(unsettled_s, median(self._first_y) - self._offset())
        self.residual = max(self._scatter, unsettled_s) + behind_ns / 1e9


def _median_slope(points: deque[_Point]) -> float:
    """Return the median of the slopes between all pairs of points, which a quarter of bad ones do not spoil."""
    x, y = np.array(points).T
    i, j = np.triu_indices(len(points), 1)
    return float(np.median((y[j] - y[i]) / (x[j] - x[i])))
