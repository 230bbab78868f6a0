# SPDX-License-Identifier: Apache-2.0
"""Fit the sample numbers of a device to ROS time."""

import math
from collections import deque
from statistics import median
from typing import NamedTuple, final

import numpy as np

BIN_S = 1.0
"""Width of a bin; each bin keeps its earliest read."""
BINS = 30
"""Bins that determine the rate: enough for a few ppm, and few enough to follow a clock that is being slewed."""
MIN_SLOPE_BINS = 8
"""Two bins may be late (JUMP_TIME_S); with fewer bins in total, they would affect more than half of the slopes."""
OFFSET_BINS = 5
"""Latest bins that determine the offset; with more, an error of the rate would have a larger effect on it."""
SETTLED_READS = 10
"""That all of ten reads are later than their mean delay happens once in 22 000 times (e^-10)."""
START_UNCERTAINTY_S = 10e-3
"""Possible delay of a single read."""
JUMP_S = 5e-3
"""A larger deviation from the fit means that one of the two clocks has jumped."""
JUMP_TIME_S = 2.0
"""Reads that are late by the same amount, within JUMP_S, for this time show a jump."""


class _Point(NamedTuple):
    """A read: `x`, nominal time since the origin [s]; `y`, ROS time since the origin minus `x` [s]."""

    x: float
    y: float


@final
class ClockFit:
    """Fit the sample numbers of a device to ROS time while it runs.

    A read follows its last sample after a delay that is often small, sometimes large and never negative. The fit
    therefore uses the earliest reads and not their mean. The rate is the median of the slopes between the earliest
    reads of each second (Theil-Sen estimator) over the last 30 s. The offset puts the line through the earliest read
    of the last 5 s. The smallest delay cannot be observed; stamps are late by it.

    Times are integers in nanoseconds, and floats hold only differences: nanoseconds since 1970 in a float would be too
    coarse. The stamp of a sample depends on its number alone, so no error accumulates.

    From the tenth read on, the fit moves back by at most one sample per read, so that stamps ascend; the rest follows
    with later reads and is part of `residual`. A clock has jumped when a read is 5 ms earlier than the fit, or when the
    reads of 2 s are late by the same amount of at least 5 ms. The fit then restarts, and stamps may step. Reads that
    queued up during a stall are less and less late, which is no jump.
    """

    def __init__(self, nominal_rate: float) -> None:
        """Expect about `nominal_rate` [Hz]."""
        self._nominal_rate = nominal_rate
        self.sample_rate = nominal_rate
        """Measured against ROS time [Hz]; nominal during the first seconds."""
        self.residual = START_UNCERTAINTY_S
        """Uncertainty of a stamp [s]: in nine of ten seconds, the earliest read deviates from the fit by less.

        At first it is at least 10 ms divided by the number of reads, and at least the median delay of the reads.
        After a jump it starts at the size of the jump and falls by a factor of e per read. While consecutive reads are
        late by the same amount, as after a jump ahead, it is at least this amount. The part by which the fit must still
        move back is added.
        """
        self.restarts = 0
        """How often a settled fit restarted because a clock had jumped."""
        self._reads = 0
        self._anchor = 0
        self._anchor_ns = 0

    @property
    def settled(self) -> bool:
        """Whether there were enough reads for one of them to be early."""
        return self._reads > SETTLED_READS

    def stamp_ns(self, sample: int) -> int:
        """Return the ROS time of the sample with this number. Raises RuntimeError before the first read."""
        if not self._reads:
            raise RuntimeError("the time of a sample is not known before the first read")
        return self._anchor_ns + round((sample - self._anchor) / self.sample_rate * 1e9)

    def update(self, sample_count: int, host_ns: int) -> None:
        """Add a read: `sample_count` samples, lost ones included, existed at the ROS time `host_ns`."""
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
        self._add_point(_Point(x, (host_ns - self._origin_ns) / 1e9 - x))
        self._move_line(last, x)

    def reset(self) -> None:
        """Discard all reads, as after a restart of the device."""
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
        self._late_s = 0.0
        self._late_time_s = 0.0

    def _jumped(self, last: int, late_s: float) -> bool:
        if late_s <= JUMP_S:
            self._late_reads = 0
            return late_s < -JUMP_S
        if not self._late_reads or late_s < self._late_s - JUMP_S:
            # The reads before were later than this one.
            self._late_reads, self._late_s, self._late_time_s = 1, late_s, 0.0
        elif late_s <= self._late_s + JUMP_S:
            # A constant delay: the time of the host advances with that of the device.
            self._late_reads += 1
            self._late_time_s += (last - self._anchor) / self._nominal_rate
        return self._late_reads >= SETTLED_READS and self._late_time_s >= JUMP_TIME_S

    def _add_point(self, point: _Point) -> None:
        host_s = sum(point)
        if len(self._bins) < OFFSET_BINS:
            self._first_y.append(point.y)
        # Bins are in host time, so that reads which queued up during a stall share one bin.
        if host_s < self._bin_end:
            self._earliest = min(self._earliest, point, key=self._intercept)
            return
        self._bins.append(self._earliest)
        self._earliest = point
        self._bin_end = host_s + BIN_S
        if len(self._bins) >= MIN_SLOPE_BINS:
            self._slope = _median_slope(self._bins)
            self.sample_rate = self._nominal_rate / (1.0 + self._slope)
        offset = self._offset()
        distances = sorted(abs(self._intercept(earliest) - offset) for earliest in self._bins)
        self._scatter = distances[len(distances) * 9 // 10]

    def _intercept(self, point: _Point) -> float:
        return point.y - self._slope * point.x

    def _offset(self) -> float:
        return min(map(self._intercept, (*list(self._bins)[-OFFSET_BINS:], self._earliest)))

    def _move_line(self, last: int, x: float) -> None:
        """Put the line through the earliest reads, but so that no sample is stamped before its predecessor."""
        fit_ns = self._origin_ns + round((x + self._slope * x + self._offset()) * 1e9)
        behind_ns = 0
        if self.settled:
            first_new_ns = fit_ns - round((last - self._anchor - 1) / self.sample_rate * 1e9)
            behind_ns = max(0, self._anchor_ns - first_new_ns)
        self._anchor, self._anchor_ns = last, fit_ns + behind_ns
        unsettled_s = max(START_UNCERTAINTY_S / self._reads, self._jump_s * math.exp(1 - self._reads))
        if len(self._bins) < OFFSET_BINS:
            unsettled_s = max(unsettled_s, median(self._first_y) - self._offset())
        if self._late_reads > 1:  # a jump, or a host that has become slow: not known before JUMP_TIME_S
            unsettled_s = max(unsettled_s, self._late_s)
        self.residual = max(self._scatter, unsettled_s) + behind_ns / 1e9


def _median_slope(points: deque[_Point]) -> float:
    """Return the median of the slopes between all pairs of points; up to a quarter of the points may be outliers."""
    x, y = np.array(points).T
    i, j = np.triu_indices(len(points), 1)
    return float(np.median((y[j] - y[i]) / (x[j] - x[i])))
