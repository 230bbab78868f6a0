"""Readings that wait to be taken: not without bounds, and none lost without a trace."""

from __future__ import annotations

import threading
from collections import deque
from typing import TYPE_CHECKING, final

if TYPE_CHECKING:
    from scara_effmass.daq.source import Reading


@final
class SampleQueue:
    """A queue between two threads. What finds no room is dropped, and counted as lost in the next reading that does.

    With `patient`, `put` waits for room instead, until there is some or the queue is closed.
    """

    def __init__(self, *, patient: bool) -> None:
        self._patient = patient
        self._changed = threading.Condition()
        self._readings: deque[Reading] = deque()
        self._unreported = 0
        self._closed = False
        self.samples = 0
        """How many wait, per channel."""
        self.dropped_samples = 0
        self.dropped_readings = 0

    def put(self, reading: Reading, room: float) -> None:
        """Add a reading, if then no more than `room` samples wait, or none did; otherwise it is dropped."""
        count = reading.samples.shape[1]
        with self._changed:
            while self._patient and not self._closed and self._is_full(count, room):
                self._changed.wait()
            if self._is_full(count, room):
                self.dropped_readings += 1
                self.dropped_samples += count
                self._unreported += reading.lost + count
            else:
                self._readings.append(reading._replace(lost=reading.lost + self._unreported))
                self._unreported = 0
                self.samples += count

    def take(self) -> list[Reading]:
        """Return all that wait, and make room."""
        with self._changed:
            readings = list(self._readings)
            self._readings.clear()
            self.samples = 0
            self._changed.notify_all()
        return readings

    def close(self) -> None:
        """End the waiting for room."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _is_full(self, count: int, room: float) -> bool:
        return bool(self._readings) and self.samples + count > room
