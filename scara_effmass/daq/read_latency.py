"""Latency of reads, measured on the steady clock of the host."""

from collections import deque
from statistics import median
from typing import final

NS = 1_000_000_000
WINDOW_S = 10.0
"""Reads that count; the clocks of host and device, 100 ppm apart, drift by a millisecond in this time."""


@final
class ReadLatency:
    """Estimate when a sample can be read at the earliest, and how much later each read was.

    A read can be late but never early, so the earliest reads of the last WINDOW_S mark when a sample can be read.
    """

    def __init__(self, sample_rate: float) -> None:
        self._sample_rate = sample_rate
        self._earliest: deque[tuple[int, int]] = deque()  # (time of the read, time of sample 0), both ascending
        self._latencies: deque[tuple[int, float]] = deque()

    def add(self, end: int, read_ns: int) -> None:
        """Add a read: all samples before number `end` had been read at the steady time `read_ns`."""
        origin_ns = read_ns - self._span_ns(end)
        expired_ns = read_ns - round(WINDOW_S * NS)
        while self._earliest and self._earliest[-1][1] >= origin_ns:
            self._earliest.pop()
        self._earliest.append((read_ns, origin_ns))
        while self._earliest[0][0] < expired_ns:
            self._earliest.popleft()
        self._latencies.append((read_ns, (origin_ns - self._earliest[0][1]) / NS))
        while self._latencies[0][0] < expired_ns:
            self._latencies.popleft()

    def time_ns(self, number: int) -> int:
        """Return the steady time at which sample `number` can be read at the earliest; needs a read before."""
        return self._earliest[0][1] + self._span_ns(number)

    def latencies(self) -> tuple[float, float]:
        """Return the median and the maximum latency [s]; NaN before the first read."""
        if not self._latencies:
            return float("nan"), float("nan")
        values = [latency for _, latency in self._latencies]
        return median(values), max(values)

    def _span_ns(self, samples: int) -> int:
        return round(samples * NS / self._sample_rate)
