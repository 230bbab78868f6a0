"""Whether force and contact states are on one clock, judged by when they arrive.

Both are stamped in ROS time and arrive soon after, so arrival - stamp of the one is that of the other plus a delay
within known limits. Where arrivals are not known, only stamps that do not overlap at all can tell.
"""

from __future__ import annotations

from collections import deque
from statistics import median
from typing import TYPE_CHECKING, NamedTuple

from scara_effmass.impacts.robot_track import NANOSECONDS

if TYPE_CHECKING:
    from scara_effmass.impacts.robot_track import RobotTrack
    from scara_effmass.settings import ValidatorSettings
    from scara_effmass.values import ForceBlock, Impact

KEPT = 1000
"""Number of force blocks, and of impacts, whose lag is kept: the latest ones."""


class Span(NamedTuple):
    """Stamps from `first_ns` to `last_ns`."""

    first_ns: int
    last_ns: int


class ForceClock:
    """The lags of force blocks and impacts, against those of the contact states."""

    def __init__(self, settings: ValidatorSettings) -> None:
        self._tolerance_ns = settings.clock_tolerance * NANOSECONDS
        self._delay_ns = settings.impact_delay * NANOSECONDS
        self.forget()

    def forget(self) -> None:
        """Begin a new recording."""
        self._blocks: deque[float] = deque(maxlen=KEPT)
        self._impacts: deque[float] = deque(maxlen=KEPT)
        self._span: Span | None = None

    def add_block(self, block: ForceBlock, received_ns: int) -> None:
        """Take a block: it arrives when its last sample has been taken."""
        if received_ns and block.sample_rate > 0.0:
            self._blocks.append(received_ns - block.stamp_ns - block.force.size / block.sample_rate * NANOSECONDS)

    def add_impact(self, impact: Impact, received_ns: int) -> None:
        """Take an impact: it arrives after its onset, at most `settings.impact_delay` later."""
        stamp_ns = impact.stamp_ns
        first_ns, last_ns = self._span or (stamp_ns, stamp_ns)
        self._span = Span(min(first_ns, stamp_ns), max(last_ns, stamp_ns))
        if received_ns:
            self._impacts.append(received_ns - stamp_ns)

    def apart_ns(self, impact: Impact, received_ns: int, state_lag_ns: int | None) -> int:
        """Return how far `impact` and the state with that lag are apart; 0: as far as they may be, or not known."""
        if state_lag_ns is None or not received_ns:
            return 0
        apart = received_ns - impact.stamp_ns - state_lag_ns
        return 0 if -self._tolerance_ns <= apart <= self._delay_ns else apart

    def text(self, track: RobotTrack) -> str:
        """Return what is wrong with the clocks in one sentence; empty when nothing is known to be."""
        lag = track.lag_ns
        if lag is not None and (self._blocks or self._impacts):
            # Impacts are reported late, by a time that is not known; blocks are not.
            apart = median(self._blocks or self._impacts) - lag
            latest = self._tolerance_ns if self._blocks else self._delay_ns
            if not -self._tolerance_ns <= apart <= latest:
                return f"force and contact states are {abs(apart) / NANOSECONDS:.2f} s apart: their clocks differ"
        if self._span and len(track):
            gap = max(track.first_ns - self._span.last_ns, self._span.first_ns - track.last_ns)
            if gap > self._tolerance_ns + self._delay_ns:
                return (
                    f"impacts and contact states are at least {gap / NANOSECONDS:.2f} s apart: "
                    "their clocks differ, or they were not recorded together"
                )
        return ""
