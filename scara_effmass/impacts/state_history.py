"""Recent contact states, and the robot state at the onset of an impact.

The contact changes the robot's velocity from the onset on. A state after the onset is used only if it continues the
motion before the onset.
"""

import math
from array import array
from bisect import bisect_left, bisect_right
from typing import NamedTuple

import numpy as np

from scara_effmass.settings import ValidatorSettings
from scara_effmass.values import BoolArray, ContactAssessment, FloatArray, Vector3, Verdict

NANOSECONDS = 1e9
MODELS = ("lumped", "full", "iso")
SPEED, DIRECTION, MASSES = 0, slice(1, 4), slice(4, 7)
COLUMNS = 7
TREND_STATES = 5
"""Maximum number of states before the impact in the trend."""
MIN_DIRECTION_LENGTH = 0.5
"""Minimum length of an interpolated direction: two unit vectors 120 degrees apart have a mean of this length."""


class OnsetState(NamedTuple):
    """Contact point at the onset: `speed` [m/s], unit `direction`, `masses` [kg] in the order of MODELS.

    A mass is NaN if the model has none. Spreads cover onset +- clock uncertainty. `from_trend`: extrapolated from the
    states before the onset, because the contact had already slowed the robot.
    """

    speed: float
    direction: Vector3
    masses: tuple[float, ...]
    speed_spread: float
    mass_spreads: tuple[float, ...]
    from_trend: bool


class Rejection(NamedTuple):
    """Why an impact is not in the series: a category, and the details of this impact."""

    reason: str
    detail: str = ""


class StateHistory:
    """Contact states of one contact point over at least the last `settings.history`, in stamp order.

    States that arrive out of order are dropped and counted in `late`. `first_ns` is the stamp of the first state,
    `last_arrival_ns` the latest arrival time; 0: unknown.
    """

    def __init__(self, settings: ValidatorSettings) -> None:
        self._settings = settings
        self._tolerance = settings.state_tolerance
        self._history_ns = round(settings.history * NANOSECONDS)
        self.late = 0
        self.clear()

    def clear(self) -> None:
        """Drop all states."""
        self._stamps = array("q")
        self._received = array("q")
        self._rows = array("d")
        self._reasons: list[str] = []
        self.first_ns = 0
        self.last_arrival_ns = 0

    def __len__(self) -> int:
        return len(self._stamps)

    @property
    def last_ns(self) -> int:
        """Stamp of the latest state; 0 without states."""
        return self._stamps[-1] if self._stamps else 0

    @property
    def lag_ns(self) -> float | None:
        """Median of arrival - stamp over the history; None if arrival times are unknown."""
        if not self._received or not self._received[-1]:
            return None
        return float(np.median(np.subtract(self._received, self._stamps)))

    def is_clock_reset(self, stamp_ns: int) -> bool:
        """Return whether `stamp_ns` is older than the history: the clock jumped back or a new recording began."""
        return bool(self._stamps) and 0 < stamp_ns < self.last_ns - self._history_ns

    def add(self, contact: ContactAssessment, received_ns: int) -> None:
        """Add a state that arrived at `received_ns` (0: unknown)."""
        self.last_arrival_ns = max(received_ns, self.last_arrival_ns)
        if contact.stamp_ns <= self.last_ns:
            # The monitor repeats the last stamp when joint states stop; that is not out of order.
            self.late += contact.stamp_ns < self.last_ns
            return
        self.first_ns = self.first_ns or contact.stamp_ns
        self._stamps.append(contact.stamp_ns)
        self._received.append(self.last_arrival_ns)
        self._rows.extend((contact.speed, *contact.direction, contact.lumped_mass, contact.full_mass, contact.iso_mass))
        no_motion = contact.verdict is Verdict.UNKNOWN and contact.direction == (0.0, 0.0, 0.0)
        self._reasons.append(contact.reason if no_motion else "")
        if self._stamps[0] < self.last_ns - 2 * self._history_ns:
            expired = bisect_left(self._stamps, self.last_ns - self._history_ns)
            del self._stamps[:expired], self._received[:expired]
            del self._rows[: expired * COLUMNS], self._reasons[:expired]

    def lag_at(self, onset_ns: int, deadline_ns: int) -> int | None:
        """Return arrival - stamp of the last state up to the onset, or of the first state if all are later.

        Uses the states that arrived by `deadline_ns` (0: all). None without states.
        """
        if not (known := self._received_count(deadline_ns)):
            return None
        i = max(bisect_right(self._stamps, onset_ns, 0, known) - 1, 0)
        return self._received[i] - self._stamps[i]

    def at(self, onset_ns: int, uncertainty_ns: int, deadline_ns: int = 0) -> OnsetState | Rejection:
        """Return the robot state at `onset_ns`, from the states that arrived by `deadline_ns` (0: all)."""
        known = self._received_count(deadline_ns)
        before = bisect_right(self._stamps, onset_ns, 0, known) - 1
        after = bisect_left(self._stamps, onset_ns, 0, known)
        tolerance = f"{self._tolerance * 1e3:g} ms"
        for i, side in ((before, "before"), (after, "after")):
            gap_s = abs(self._stamps[i] - onset_ns) / NANOSECONDS if 0 <= i < known else math.inf
            if gap_s > self._tolerance:
                detail = f"the nearest is {gap_s * 1e3:.0f} ms away" if gap_s < math.inf else "there is none"
                return Rejection(f"no contact state within {tolerance} {side} the onset", detail)
        # Copy only the states within the clock uncertainty and the trend before them.
        low = max(0, min(before, bisect_right(self._stamps, onset_ns - uncertainty_ns, 0, known) - 1) - TREND_STATES)
        high = min(known, max(after, bisect_left(self._stamps, onset_ns + uncertainty_ns, 0, known)) + 1)
        rows = np.array(self._rows[low * COLUMNS : high * COLUMNS]).reshape(-1, COLUMNS)
        seconds = np.array([(stamp - onset_ns) / NANOSECONDS for stamp in self._stamps[low:high]])
        for i in (before, after):
            if self._reasons[i]:
                return Rejection("the contact state at the onset is UNKNOWN", self._reasons[i])
        moving = np.isfinite(rows[:, :4]).all(axis=1) & (rows[:, SPEED] >= self._settings.speed_threshold)
        moving &= rows[:, DIRECTION].any(axis=1)
        before, after = before - low, after - low
        if not moving[before]:
            return Rejection("the robot stands still at the onset", f"{rows[before, SPEED]:.4f} m/s")
        state, from_trend = self._interpolate(seconds, rows, moving, before, after, uncertainty_ns / NANOSECONDS)
        length = float(np.linalg.norm(state[DIRECTION]))
        if not moving[after] and not from_trend:
            return Rejection("the robot stands still at the onset", f"{rows[after, SPEED]:.4f} m/s after it")
        if not length >= MIN_DIRECTION_LENGTH or not state[SPEED] >= self._settings.speed_threshold:
            return Rejection("the direction of motion turns over at the onset")
        x, y, z = (state[DIRECTION] / length).tolist()
        speed_spread, *mass_spreads = _spreads(state, seconds[moving], rows[moving], uncertainty_ns / NANOSECONDS)
        masses = tuple(state[MASSES].tolist())
        return OnsetState(float(state[SPEED]), (x, y, z), masses, speed_spread, tuple(mass_spreads), from_trend)

    def _received_count(self, deadline_ns: int) -> int:
        """Return the number of states that arrived by `deadline_ns` (0: all)."""
        return bisect_right(self._received, deadline_ns) if deadline_ns else len(self._stamps)

    def _interpolate(
        self, seconds: FloatArray, rows: FloatArray, moving: BoolArray, before: int, after: int, uncertainty: float
    ) -> tuple[FloatArray, bool]:
        """Return the row at second 0 and whether it is from the trend instead of the rows `before` and `after`."""
        usable = np.flatnonzero(moving[: before + 1] & (seconds[: before + 1] <= -uncertainty))
        usable = usable[seconds[usable] >= -uncertainty - 2.0 * self._tolerance][-TREND_STATES:]
        if usable.size >= 2:
            times = seconds[usable]
            for i in (before, after):
                if not moving[i] or self._slowed(rows[i], _trend(times, rows[usable], seconds[i])):
                    return _trend(times, rows[usable], 0.0), True
        if before == after:
            return rows[before], False
        weight = seconds[before] / (seconds[before] - seconds[after])
        return (1.0 - weight) * rows[before] + weight * rows[after], False

    def _slowed(self, row: FloatArray, expected: FloatArray) -> bool:
        """Return whether `row` is slower along the `expected` direction than expected."""
        length = float(np.linalg.norm(expected[DIRECTION]))
        along = row[SPEED] * float(row[DIRECTION] @ expected[DIRECTION]) / length if length else 0.0
        return bool(along < (1.0 - self._settings.slowing) * expected[SPEED])


def _trend(seconds: FloatArray, rows: FloatArray, at: float) -> FloatArray:
    """Evaluate the least-squares line through each column of `rows` at the time `at`."""
    centre = seconds - seconds.mean()
    slopes = centre @ (rows - rows.mean(axis=0)) / (centre @ centre)
    values: FloatArray = rows.mean(axis=0) + slopes * (at - seconds.mean())
    return values


def _spreads(state: FloatArray, seconds: FloatArray, rows: FloatArray, uncertainty: float) -> list[float]:
    """Return max - min of the speed and of each mass over +-uncertainty, including `state`."""
    inside = seconds[np.abs(seconds) < uncertainty]
    times = np.concatenate([[-uncertainty, uncertainty], inside])
    columns = (SPEED, *range(COLUMNS)[MASSES])
    return [float(np.ptp([state[c], *np.interp(times, seconds, rows[:, c])])) for c in columns]
