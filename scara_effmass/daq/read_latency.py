"""How late samples are read, on the host's steady clock."""

from __future__ import annotations

from collections import deque
from statistics import median
from typing import final

NS = 1_000_000_000
WINDOW_S = 10.0
"""What is remembered. The clocks of host and device, 100 ppm apart, move by a millisecond in it."""


@final
class ReadLatency:
    """When a sample should be there, judged by the reads of the last WINDOW_S that came soonest.

    Nobody tells when a sample was taken. But a read can only be late, never early, so the earliest of them, sample
    number against time, mark when a read can be there; how much later one was is its latency.
    """

    def __init__(self, sample_rate: float) -> None:
        self._rate = sample_rate
        self._earliest: deque[tuple[int, int]] = deque()  # (when read, when sample 0 was then), both growing
        self._latencies: deque[tuple[int, float]] = deque()

    def add(self, end: int, read_ns: int) -> None:
        """Take note that all samples before number `end` had been read at `read_ns` (steady)."""
        origin_ns = read_ns - self._span_ns(end)
        forget_ns = read_ns - round(WINDOW_S * NS)
        while self._earliest and self._earliest[-1][1] >= origin_ns:
            self._earliest.pop()
        self._earliest.append((read_ns, origin_ns))
        while self._earliest[0][0] < forget_ns:
            self._earliest.popleft()
        self._latencies.append((read_ns, (origin_ns - self._earliest[0][1]) / NS))
        while self._latencies[0][0] < forget_ns:
            self._latencies.popleft()

    def time_ns(self, number: int) -> int:
        """Return the steady time at which sample `number` can first be read; something must have been read."""
        return self._earliest[0][1] + self._span_ns(number)

    def latencies(self) -> tuple[float, float]:
        """Return the median and the largest latency [s] of the last WINDOW_S; NaN where nothing was read."""
        if not self._latencies:
            return float("nan"), float("nan")
        late = [latency for _, latency in self._latencies]
        return median(late), max(late)

    def _span_ns(self, samples: int) -> int:
        return round(samples * NS / self._rate)
