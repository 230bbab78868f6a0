"""Queue of readings between the acquisition thread and its consumer."""

import threading
from collections import deque
from typing import final

from scara_effmass.daq.source import Reading


@final
class SampleQueue:
    """Bounded queue between two threads.

    A reading that does not fit is dropped, and counted as lost in the next one that fits. With `block`, `put` waits
    until it fits or the queue is closed.
    """

    def __init__(self, *, block: bool) -> None:
        self._block = block
        self._changed = threading.Condition()
        self._readings: deque[Reading] = deque()
        self._unreported = 0
        self._closed = False
        self.samples = 0
        """Samples per channel in the queue."""
        self.dropped_samples = 0
        self.dropped_readings = 0

    def put(self, reading: Reading, max_samples: float) -> None:
        """Add a reading if the queue is empty or then holds at most `max_samples`; otherwise drop it or wait."""
        count = reading.samples.shape[1]
        with self._changed:
            while self._block and not self._closed and not self._fits(count, max_samples):
                self._changed.wait()
            if self._fits(count, max_samples):
                self._readings.append(reading._replace(lost=reading.lost + self._unreported))
                self._unreported = 0
                self.samples += count
            else:
                self.dropped_readings += 1
                self.dropped_samples += count
                self._unreported += reading.lost + count

    def take(self) -> list[Reading]:
        """Return all readings and empty the queue."""
        with self._changed:
            readings = list(self._readings)
            self._readings.clear()
            self.samples = 0
            self._changed.notify_all()
        return readings

    def close(self) -> None:
        """End a `put` that waits."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _fits(self, count: int, max_samples: float) -> bool:
        return not self._readings or self.samples + count <= max_samples
