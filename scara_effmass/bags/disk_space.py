"""Whether the disk has room for a recording, and for how long it will."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, final

if TYPE_CHECKING:
    from collections.abc import Callable

NS = 1_000_000_000
RATE_FROM_NS, RATE_OVER_NS = 2 * NS, 10 * NS
"""How long it has to know sizes before it knows a rate, and over how long at most it takes one."""
RESUME_FACTOR = 2
"""Times the reserve that must be free before a stopped recording goes on, so that it does not stop at once again."""
CLEAR = 1.25
"""Times the limits at which a warning is over, so that a rate that goes up and down does not repeat it."""


@final
class DiskSpace:
    """Watches free space while a recording grows. Times are of a steady clock [ns], sizes in bytes."""

    def __init__(self, free: Callable[[], int], reserve: int, warn_below: int, warn_before_s: float) -> None:
        """Keep `reserve` free; warn below `warn_below`, or when the reserve is reached within `warn_before_s`."""
        self.reserve = reserve
        self._free = free
        self._warn_below = warn_below
        self._warn_before_s = warn_before_s
        self._written: deque[tuple[int, int]] = deque()
        self._warned_at = math.inf

    def free(self) -> int:
        """Return what is free. Raises OSError."""
        return self._free()

    def is_used_up(self) -> bool:
        """Whether a recording has to stop. Raises OSError."""
        return self.free() < self.reserve

    def has_room_again(self) -> bool:
        """Whether one that has stopped may go on. Raises OSError."""
        return self.free() >= RESUME_FACTOR * self.reserve

    def warning(self, now_ns: int, written: int) -> str:
        """Return what to tell of the room left after `written` bytes, "" if nothing; again each time it has halved.

        Raises OSError.
        """
        self._written.append((now_ns, written))
        while now_ns - self._written[0][0] > RATE_OVER_NS:
            self._written.popleft()
        since_ns, before = self._written[0]
        span_ns = now_ns - since_ns
        per_s = (written - before) * NS / span_ns if span_ns >= RATE_FROM_NS else 0.0
        free = self.free()
        left = max(free - self.reserve, 0)
        left_s = left / per_s if per_s > 0.0 else math.inf
        if free >= CLEAR * self._warn_below and left_s >= CLEAR * self._warn_before_s:
            self._warned_at = math.inf
        low = free < self._warn_below or left_s < self._warn_before_s
        if not low or left > self._warned_at / 2:
            return ""
        self._warned_at = left
        lasts = f"; at {per_s / 1e6:.2f} MB/s recording stops in {left_s:.0f} s" if per_s > 0.0 else ""
        return f"the disk has {free / 1e6:.0f} MB left, of which {self.reserve / 1e6:.0f} MB stay free{lasts}"
