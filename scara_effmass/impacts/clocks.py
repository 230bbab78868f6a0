"""Detect force and contact states on different clocks.

Both carry ROS time and arrive soon after, so their lags (arrival - stamp) may differ only by a bounded delay. Without
arrival times, only stamps without any overlap show different clocks.
"""

from collections import deque
from statistics import median
from typing import NamedTuple

from scara_effmass.impacts.state_history import NANOSECONDS, StateHistory
from scara_effmass.settings import ValidatorSettings
from scara_effmass.values import ForceBlock, Impact

MAX_LAGS = 1000
"""Maximum number of lags kept, for force blocks and impacts each."""


class StampRange(NamedTuple):
    """First and last stamp."""

    first_ns: int
    last_ns: int


class ForceClock:
    """Compare the lags of force blocks and impacts with the lags of the contact states."""

    def __init__(self, settings: ValidatorSettings) -> None:
        self._tolerance_ns = settings.clock_tolerance * NANOSECONDS
        self._delay_ns = settings.impact_delay * NANOSECONDS
        self.clear()

    def clear(self) -> None:
        """Drop all lags."""
        self._block_lags: deque[float] = deque(maxlen=MAX_LAGS)
        self._impact_lags: deque[float] = deque(maxlen=MAX_LAGS)
        self._range: StampRange | None = None

    def add_block(self, block: ForceBlock, received_ns: int) -> None:
        """Add the lag of a force block, which is complete at its last sample."""
        if received_ns and block.sample_rate > 0.0:
            self._block_lags.append(received_ns - block.stamp_ns - block.force.size / block.sample_rate * NANOSECONDS)

    def add_impact(self, impact: Impact, received_ns: int) -> None:
        """Add the lag of an impact, which arrives up to `settings.impact_delay` after its onset."""
        stamp_ns = impact.stamp_ns
        first_ns, last_ns = self._range or (stamp_ns, stamp_ns)
        self._range = StampRange(min(first_ns, stamp_ns), max(last_ns, stamp_ns))
        if received_ns:
            self._impact_lags.append(received_ns - stamp_ns)

    def offset_ns(self, impact: Impact, received_ns: int, state_lag_ns: int | None) -> int:
        """Return the clock offset of `impact` to a state with that lag; 0: within tolerance or unknown."""
        if state_lag_ns is None or not received_ns:
            return 0
        offset = received_ns - impact.stamp_ns - state_lag_ns
        return 0 if -self._tolerance_ns <= offset <= self._delay_ns else offset

    def problem(self, states: StateHistory) -> str:
        """Return the clock problem in one sentence; empty if none is detected."""
        lag = states.lag_ns
        if lag is not None and (self._block_lags or self._impact_lags):
            # Impacts arrive with an unknown delay, blocks do not.
            offset = median(self._block_lags or self._impact_lags) - lag
            max_delay_ns = self._tolerance_ns if self._block_lags else self._delay_ns
            if not -self._tolerance_ns <= offset <= max_delay_ns:
                return f"force and contact states are {abs(offset) / NANOSECONDS:.2f} s apart: their clocks differ"
        if self._range and len(states):
            gap = max(states.first_ns - self._range.last_ns, self._range.first_ns - states.last_ns)
            if gap > self._tolerance_ns + self._delay_ns:
                return (
                    f"impacts and contact states are at least {gap / NANOSECONDS:.2f} s apart: "
                    "their clocks differ, or they were not recorded together"
                )
        return ""
