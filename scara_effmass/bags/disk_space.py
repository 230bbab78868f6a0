"""Free space on the disk of a recording."""

import math
from collections.abc import Callable
from typing import final

NS = 1_000_000_000
MIN_RATE_SPAN_NS = 2 * NS
RATE_SPAN_NS = 10 * NS
"""Period over which the write rate is averaged."""
RESUME_FACTOR = 2
"""Free space, as a multiple of the reserve, at which a stopped recording resumes."""
CLEAR_FACTOR = 1.25
"""Multiple of the limits at which a warning is cleared, so that a varying rate does not repeat it."""


@final
class DiskSpace:
    """Watches free space while a recording grows. Times are of a steady clock [ns], sizes in bytes."""

    def __init__(self, free: Callable[[], int], reserve: int, warn_below: int, warn_before_s: float) -> None:
        """Keep `reserve` free; warn below `warn_below`, or if the reserve is reached within `warn_before_s`."""
        self.reserve = reserve
        self._free = free
        self._warn_below = warn_below
        self._warn_before_s = warn_before_s
        self._sizes: list[tuple[int, int]] = []
        self._last_warning_left = math.inf

    def is_exhausted(self) -> bool:
        """Whether the recording must stop. Raises OSError."""
        return self._free() < self.reserve

    def can_resume(self) -> bool:
        """Whether a stopped recording may resume. Raises OSError."""
        return self._free() >= RESUME_FACTOR * self.reserve

    def warning(self, now_ns: int, written: int) -> str:
        """Return a warning about the space left after `written` bytes, "" if none is due.

        A warning is repeated each time the space left has halved. Raises OSError.
        """
        self._sizes = [size for size in self._sizes if now_ns - size[0] <= RATE_SPAN_NS] + [(now_ns, written)]
        start_ns, start_bytes = self._sizes[0]
        span_ns = now_ns - start_ns
        bytes_per_s = (written - start_bytes) * NS / span_ns if span_ns >= MIN_RATE_SPAN_NS else 0.0
        free = self._free()
        left = max(free - self.reserve, 0)
        left_s = left / bytes_per_s if bytes_per_s > 0.0 else math.inf
        if free >= CLEAR_FACTOR * self._warn_below and left_s >= CLEAR_FACTOR * self._warn_before_s:
            self._last_warning_left = math.inf
        is_low = free < self._warn_below or left_s < self._warn_before_s
        if not is_low or left > self._last_warning_left / 2:
            return ""
        self._last_warning_left = left
        end = f"; at {bytes_per_s / 1e6:.2f} MB/s recording stops in {left_s:.0f} s" if bytes_per_s > 0.0 else ""
        return f"the disk has {free / 1e6:.0f} MB left, of which {self.reserve / 1e6:.0f} MB stay free{end}"
