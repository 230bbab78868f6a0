"""The robot's recent states, and its state at the onset of an impact.

A contact changes speed and direction of the robot from its first instant on, so a state after the onset may be used
only where it goes on as the states before it did.
"""

from __future__ import annotations

import math
from array import array
from bisect import bisect_left, bisect_right
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from scara_effmass.values import Verdict

if TYPE_CHECKING:
    from scara_effmass.settings import ValidatorSettings
    from scara_effmass.values import BoolArray, ContactAssessment, FloatArray, Vector3

NANOSECONDS = 1e9
MODELS = ("lumped", "full", "iso")
SPEED, DIRECTION, MASSES = 0, slice(1, 4), slice(4, 7)
COLUMNS = 7
TREND = 5
"""Number of states before the impact that its trend is drawn from."""
LEAST_UNITY = 0.5
"""Length of the mean of two unit vectors that are 120 degrees apart: beyond it there is no direction between them."""


class OnsetState(NamedTuple):
    """The contact point at the onset: `speed` [m/s], unit `direction`, and `masses` [kg] in the order of MODELS.

    A mass is NaN where that model has none. The spreads are over onset +- clock uncertainty. `from_trend`: continued
    from the states before the onset, because the contact had slowed the state after it.
    """

    speed: float
    direction: Vector3
    masses: tuple[float, ...]
    speed_spread: float
    mass_spreads: tuple[float, ...]
    from_trend: bool


class Unusable(NamedTuple):
    """Why there is no state at an onset: one of few reasons, and what it was this time."""

    reason: str
    detail: str = ""


class RobotTrack:
    """The contact states of one contact point over the last `settings.history` at least, in the order of their stamps.

    States that come out of order are left out and counted in `late`. `first_ns` is the stamp of the first state,
    `heard_ns` the time at which anything arrived last; 0: not known.
    """

    def __init__(self, settings: ValidatorSettings) -> None:
        self._settings = settings
        self._tolerance = settings.state_tolerance
        self._history_ns = round(settings.history * NANOSECONDS)
        self.late = 0
        self.forget()

    def forget(self) -> None:
        """Begin a new recording."""
        self._stamps = array("q")
        self._received = array("q")
        self._rows = array("d")
        self._reasons: list[str] = []
        self.first_ns = 0
        self.heard_ns = 0

    def __len__(self) -> int:
        return len(self._stamps)

    @property
    def last_ns(self) -> int:
        """Stamp of the latest state; 0 without one."""
        return self._stamps[-1] if self._stamps else 0

    @property
    def lag_ns(self) -> float | None:
        """Median of arrival - stamp of the states kept; None where arrivals are not known."""
        if not self._received or not self._received[-1]:
            return None
        return float(np.median(np.subtract(self._received, self._stamps)))

    def went_back(self, stamp_ns: int) -> bool:
        """Return whether `stamp_ns` is so early that the clock has gone back, or another recording has begun."""
        return bool(self._stamps) and 0 < stamp_ns < self.last_ns - self._history_ns

    def add(self, contact: ContactAssessment, received_ns: int) -> None:
        """Take the next state, which arrived at `received_ns` (0: not known)."""
        self.heard_ns = max(received_ns, self.heard_ns)
        if contact.stamp_ns <= self.last_ns:
            # The monitor repeats the last stamp when joint states stop: the gap that follows says as much.
            self.late += contact.stamp_ns < self.last_ns
            return
        self.first_ns = self.first_ns or contact.stamp_ns
        self._stamps.append(contact.stamp_ns)
        self._received.append(self.heard_ns)
        self._rows.extend((contact.speed, *contact.direction, contact.lumped_mass, contact.full_mass, contact.iso_mass))
        blank = contact.verdict is Verdict.UNKNOWN and contact.direction == (0.0, 0.0, 0.0)
        self._reasons.append(contact.reason if blank else "")
        if self._stamps[0] < self.last_ns - 2 * self._history_ns:
            old = bisect_left(self._stamps, self.last_ns - self._history_ns)
            del self._stamps[:old], self._received[:old], self._rows[: old * COLUMNS], self._reasons[:old]

    def lag_at(self, onset_ns: int, received_by_ns: int) -> int | None:
        """Return arrival - stamp of the last state up to the onset among those that had arrived by `received_by_ns`.

        Of the first state, where none is that early; None without states. 0: all that are here.
        """
        if not (known := self._arrived(received_by_ns)):
            return None
        i = max(bisect_right(self._stamps, onset_ns, 0, known) - 1, 0)
        return self._received[i] - self._stamps[i]

    def at(self, onset_ns: int, uncertainty_ns: int, received_by_ns: int = 0) -> OnsetState | Unusable:
        """Return the state at `onset_ns` from states that had arrived by `received_by_ns` (0: all that are here)."""
        known = self._arrived(received_by_ns)
        before = bisect_right(self._stamps, onset_ns, 0, known) - 1
        after = bisect_left(self._stamps, onset_ns, 0, known)
        tolerance = f"{self._tolerance * 1e3:g} ms"
        for i, side in ((before, "before"), (after, "after")):
            away = abs(self._stamps[i] - onset_ns) / NANOSECONDS if 0 <= i < known else math.inf
            if away > self._tolerance:
                detail = f"the nearest is {away * 1e3:.0f} ms away" if away < math.inf else "there is none"
                return Unusable(f"no contact state within {tolerance} {side} the onset", detail)
        # Only what can matter becomes an array: the uncertainty around the onset, and the trend before it.
        low = max(0, min(before, bisect_right(self._stamps, onset_ns - uncertainty_ns, 0, known) - 1) - TREND)
        high = min(known, max(after, bisect_left(self._stamps, onset_ns + uncertainty_ns, 0, known)) + 1)
        rows = np.array(self._rows[low * COLUMNS : high * COLUMNS]).reshape(-1, COLUMNS)
        seconds = np.array([(stamp - onset_ns) / NANOSECONDS for stamp in self._stamps[low:high]])
        for i in (before, after):
            if self._reasons[i]:
                return Unusable("the contact state at the onset is UNKNOWN", self._reasons[i])
        moving = np.isfinite(rows[:, :4]).all(axis=1) & (rows[:, SPEED] >= self._settings.speed_threshold)
        moving &= rows[:, DIRECTION].any(axis=1)
        before, after = before - low, after - low
        if not moving[before]:
            return Unusable("the robot stands still at the onset", f"{rows[before, SPEED]:.4f} m/s")
        state, from_trend = self._state(seconds, rows, moving, before, after, uncertainty_ns / NANOSECONDS)
        length = float(np.linalg.norm(state[DIRECTION]))
        if not moving[after] and not from_trend:
            return Unusable("the robot stands still at the onset", f"{rows[after, SPEED]:.4f} m/s after it")
        if not length >= LEAST_UNITY or not state[SPEED] >= self._settings.speed_threshold:
            return Unusable("the direction of motion turns over at the onset")
        x, y, z = (state[DIRECTION] / length).tolist()
        speed_spread, *mass_spreads = _spreads(state, seconds[moving], rows[moving], uncertainty_ns / NANOSECONDS)
        masses = tuple(state[MASSES].tolist())
        return OnsetState(float(state[SPEED]), (x, y, z), masses, speed_spread, tuple(mass_spreads), from_trend)

    def _arrived(self, by_ns: int) -> int:
        """Return how many of the states had arrived by then."""
        return bisect_right(self._received, by_ns) if by_ns else len(self._stamps)

    def _state(
        self, seconds: FloatArray, rows: FloatArray, moving: BoolArray, before: int, after: int, uncertainty: float
    ) -> tuple[FloatArray, bool]:
        """Return the row at second 0, between the rows `before` and `after` or on the trend, and whether the latter."""
        usable = np.flatnonzero(moving[: before + 1] & (seconds[: before + 1] <= -uncertainty))
        usable = usable[seconds[usable] >= -uncertainty - 2.0 * self._tolerance][-TREND:]
        if usable.size >= 2:
            at = seconds[usable]
            for i in (before, after):
                if not moving[i] or self._slowed(rows[i], _line(at, rows[usable], seconds[i])):
                    return _line(at, rows[usable], 0.0), True
        if before == after:
            return rows[before], False
        share = seconds[before] / (seconds[before] - seconds[after])
        return (1.0 - share) * rows[before] + share * rows[after], False

    def _slowed(self, row: FloatArray, expected: FloatArray) -> bool:
        """Return whether `row` has lost speed along its `expected` direction."""
        length = float(np.linalg.norm(expected[DIRECTION]))
        along = row[SPEED] * float(row[DIRECTION] @ expected[DIRECTION]) / length if length else 0.0
        return bool(along < (1.0 - self._settings.slowing) * expected[SPEED])


def _line(seconds: FloatArray, rows: FloatArray, at: float) -> FloatArray:
    """Return the least-squares lines through the columns of `rows` over `seconds`, at one time."""
    centre = seconds - seconds.mean()
    slopes = centre @ (rows - rows.mean(axis=0)) / (centre @ centre)
    values: FloatArray = rows.mean(axis=0) + slopes * (at - seconds.mean())
    return values


def _spreads(state: FloatArray, seconds: FloatArray, rows: FloatArray, uncertainty: float) -> list[float]:
    """Return largest - least of the speed and of each mass from -uncertainty to +uncertainty, and in `state`."""
    inside = seconds[np.abs(seconds) < uncertainty]
    times = np.concatenate([[-uncertainty, uncertainty], inside])
    columns = (SPEED, *range(COLUMNS)[MASSES])
    return [float(np.ptp([state[c], *np.interp(times, seconds, rows[:, c])])) for c in columns]
