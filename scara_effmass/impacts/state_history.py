# SPDX-License-Identifier: Apache-2.0
"""Recent contact states, the robot state at the onset of an impact, and the offset between the clocks.

From the onset on, the contact changes the robot's velocity. A state after the onset is therefore used only if it
continues the motion before the onset. The kink in the velocity shows the offset of its clock from that of the force.
"""

import math
from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from scara_effmass.impacts.segment import median_and_deviation
from scara_effmass.settings import MassModel, ValidatorSettings
from scara_effmass.values import ContactAssessment, FloatArray, Mobility6, Vector3, Verdict, mobility_matrix

WINDOW = 0.05
"""The kink is searched within this time before and after the onset of the force [s]."""
LONGEST_CONTACT_S = 0.01
"""Longest contact [s] whose kink is found with joint states at 100 Hz; most of the window must be without contact."""
MIN_STATES = 8
MIN_LOSS = 0.02
"""Minimum relative loss of speed at a kink."""
EARLIER_SHARE = 0.25
"""The kink is the first loss above this share of the largest one; a rebound may take more speed than the impact."""
MIN_RIVAL_LOSS = 0.1
"""Sudden losses of speed below this share of the largest one do not vote for the offset of a recording."""
MAX_RIVAL = 0.9
"""No offset is found if another one has more than this share of its votes."""
MAX_BEYOND_SHARE = 0.2
"""Maximum share of impacts whose clock offset exceeds the tolerance: a rebound can hide the kink."""
MAX_VOTERS = 500
"""Maximum number of impacts, and of kinks, that vote: the strongest ones."""
MAX_STEP = 1.5
"""Maximum distance of the states at a kink, in their periods; within a gap the time of the loss is not known."""
NOISE_FACTOR = 6.0
"""A kink exceeds this multiple of the robust standard deviation of all changes of speed in the window."""

NANOSECONDS = 1e9
MODELS = ("lumped", "full", "iso")
AUTO_SHARE = 0.9
"""The model auto does not use a lumped mass below this share of the full one; compare model_margin of the monitor."""
TREND_STATES = 5
"""Maximum number of states before the impact that form the trend."""
MIN_DIRECTION_LENGTH = 0.5
"""Minimum length of an interpolated direction; the mean of two unit vectors 120 degrees apart has this length."""
_SPEED, _DIRECTION, _MASSES, _LUMPED, _FULL = 0, slice(1, 4), slice(4, 7), slice(7, 13), slice(13, 19)


class ClockOffset(NamedTuple):
    """Offset of the joint clock from the force clock [s] over `impacts` that show a kink.

    Positive: the force is stamped earlier than the joint states. `offset` is the median, NaN if the impacts disagree,
    `low` and `high` are the extremes, `resolution` is half of the longest period of the states. `beyond` impacts exceed
    the tolerance.
    """

    impacts: int
    offset: float
    low: float
    high: float
    resolution: float
    beyond: int

    @property
    def extremes(self) -> str:
        """The smallest and the largest offset as text."""
        return f"{1e3 * self.low:+.1f} to {1e3 * self.high:+.1f} ms"


class Kink(NamedTuple):
    """Delay of the kink in the velocity after the onset of the force, and half the period of the states [s]."""

    delay: float
    resolution: float


def velocity_kink(seconds: FloatArray, velocity: FloatArray, duration: float) -> Kink | None:
    """Return the first large sudden loss of speed in `velocity` (n, 3) [m/s] at the `seconds` (n,) after the onset.

    Half of the loss has occurred in the middle of a contact of `duration` [s]. None if there are too few states, no
    loss of at least MIN_LOSS that stands out from the noise, or a gap between the states at the loss.
    """
    if len(seconds) < MIN_STATES:
        return None
    speeds = np.linalg.norm(velocity, axis=1)
    fastest = int(np.argmax(speeds))
    if not speeds[fastest] > 0.0:
        return None
    along = velocity @ velocity[fastest] / speeds[fastest]
    period = float(np.median(np.diff(seconds)))
    width = duration + period
    begins = seconds[seconds + width <= seconds[-1]]
    if not begins.size:
        return None
    before = along[: begins.size]
    loss = before - np.interp(begins + width, seconds, along)
    middle, noise = median_and_deviation(loss)
    threshold = middle + max(NOISE_FACTOR * noise, MIN_LOSS * speeds[fastest])
    large = loss > max(threshold, EARLIER_SHARE * loss.max())
    if not large.any():
        return None
    first = int(np.argmax(large))
    k = first + int(np.argmax(loss[first : int(np.searchsorted(begins, begins[first] + width))]))
    end = int(np.searchsorted(seconds, begins[k] + width))
    if np.diff(seconds[k : end + 1]).max() > MAX_STEP * period:
        return None
    half = float(before[k] - 0.5 * loss[k])
    inside = seconds[(seconds > begins[k]) & (seconds < begins[k] + width)]
    times = np.array([begins[k], *inside, begins[k] + width])
    values = np.interp(times, seconds, along)
    i = int(np.argmax(values[1:] <= half))
    share = (values[i] - half) / (values[i] - values[i + 1])
    return Kink(float(times[i] + share * (times[i + 1] - times[i]) - 0.5 * duration), 0.5 * period)


def recording_offset(
    onsets: FloatArray, impulses: FloatArray, durations: FloatArray, seconds: FloatArray, velocity: FloatArray
) -> Kink | None:
    """Return the offset of the clock of `velocity` (n, 3) [m/s] at `seconds` (n,) from that of m impacts.

    The impacts have `onsets` (m,) [s], `impulses` (m,) [N s] and `durations` (m,) [s]. Each pair of an impact and a
    sudden loss of speed votes for an offset with the product of impulse and loss; kinks near the best offset refine it.
    None if no loss stands out, or if another offset has more than MAX_RIVAL of the votes of the best one.
    """
    if not len(onsets) or len(seconds) < MIN_STATES:
        return None
    period = float(np.median(np.diff(seconds)))
    width = float(np.median(durations)) + period
    speeds = np.linalg.norm(velocity, axis=1)
    after = np.column_stack([np.interp(seconds + width, seconds, component) for component in velocity.T])
    loss = speeds - np.einsum("ij,ij->i", after, velocity) / np.maximum(speeds, np.finfo(float).tiny)
    sudden = loss - np.interp(seconds - width, seconds, loss)  # braking is just as strong before
    begins = np.flatnonzero(sudden > max(MIN_RIVAL_LOSS * sudden.max(), MIN_LOSS * speeds.max()))
    if not begins.size:
        return None
    runs = np.split(begins, np.flatnonzero(np.diff(seconds[begins]) > width) + 1)
    kinks = np.array([run[np.argmax(sudden[run])] for run in runs])
    strongest = np.argsort(-impulses, kind="stable")[:MAX_VOTERS]
    kinks = kinks[np.argsort(-sudden[kinks], kind="stable")[:MAX_VOTERS]]
    offsets = np.subtract.outer(seconds[kinks], onsets[strongest]).ravel()
    votes = np.multiply.outer(sudden[kinks], impulses[strongest]).ravel()
    order = np.argsort(offsets)
    offsets, total = offsets[order], np.concatenate([[0.0], np.cumsum(votes[order])])
    sums = total[np.searchsorted(offsets, offsets + width, side="right")] - total[:-1]
    best = int(np.argmax(sums))
    rivals = np.abs(offsets - offsets[best]) > WINDOW
    if rivals.any() and sums[rivals].max() > MAX_RIVAL * sums[best]:
        return None
    near: list[Kink] = []
    for onset, duration in zip(onsets + offsets[best], durations, strict=True):
        window = slice(*np.searchsorted(seconds, [onset - WINDOW, onset + WINDOW]))
        if kink := velocity_kink(seconds[window] - onset, velocity[window], float(duration)):
            near.append(kink)
    if not near:
        return None
    return Kink(float(offsets[best] + np.median([kink.delay for kink in near])), max(k.resolution for k in near))


def clock_offset(kinks: Iterable[Kink], tolerance: float) -> ClockOffset:
    """Return the offset of a series; without kinks, its resolution is infinite.

    Impacts disagree if more than MAX_BEYOND_SHARE of them are farther than twice the `tolerance` [s] from the median.
    """
    kinks = list(kinks)
    if not kinks:
        return ClockOffset(0, math.nan, math.nan, math.nan, math.inf, 0)
    delays = np.array([kink.delay for kink in kinks])
    median = float(np.median(delays))
    agrees = np.mean(np.abs(delays - median) > 2.0 * tolerance) <= MAX_BEYOND_SHARE
    return ClockOffset(
        impacts=len(kinks),
        offset=median if agrees else math.nan,
        low=float(delays.min()),
        high=float(delays.max()),
        resolution=max(kink.resolution for kink in kinks),
        beyond=int(np.count_nonzero(np.abs(delays) > tolerance)),
    )


class OnsetState(NamedTuple):
    """Contact point at the onset: `speed` [m/s], unit `direction`, `masses` [kg] by model.

    A mass is NaN if the model has none. `from_trend`: extrapolated from the states before the onset, because the
    contact had already slowed the robot. `mobilities` are those of the lumped and of the full model, as in
    `ContactAssessment`.
    """

    speed: float
    direction: Vector3
    masses: Mapping[str, float]
    from_trend: bool
    mobilities: tuple[Mobility6, Mobility6]

    def along(self, normal: Vector3) -> "OnsetState":
        """Return the state with speed and masses along the plate's unit vector `normal`, of either sign."""
        lumped, full = (_mass_along(mobility, normal) for mobility in self.mobilities)
        speed = self.speed * abs(dot(normal, self.direction))
        return self._replace(speed=speed, masses=_by_model(lumped, full, self.masses["iso"]))


class Rejection(NamedTuple):
    """Why an impact is left out of the series: a category, and details of this impact."""

    reason: str
    detail: str = ""

    def with_clock(self, kink: Kink | None) -> "Rejection":
        """Return the rejection with the offset of the clocks that `kink` shows, which may be its cause."""
        if kink is None or not abs(kink.delay) > 2.0 * kink.resolution:
            return self
        offset = f"the joint states are {1e3 * kink.delay:+.1f} ms behind the force"
        return self._replace(detail="; ".join(filter(None, [self.detail, offset])))


class _State(NamedTuple):
    """A received contact state. `row`: speed, direction, masses and mobilities; `unknown`: why it has no motion."""

    stamp_ns: int
    received_ns: int
    row: tuple[float, ...]
    moving: bool
    unknown: str


class StateHistory:
    """Contact states of one contact point over at least the last `settings.history`, in stamp order.

    States that arrive out of order are dropped and counted in `late`. `first_ns` is the stamp of the first state,
    `last_arrival_ns` is the latest arrival time; 0: unknown.
    """

    def __init__(self, settings: ValidatorSettings) -> None:
        self._settings = settings
        self._tolerance = settings.state_tolerance
        self._history_ns = round(settings.history * NANOSECONDS)
        self._reset_ns = min(self._history_ns, round(settings.clock_tolerance * NANOSECONDS))
        self.late = 0
        self.clear()

    def clear(self) -> None:
        """Discard all states."""
        self._states: list[_State] = []
        self.first_ns = 0
        self.last_arrival_ns = 0

    def __len__(self) -> int:
        return len(self._states)

    @property
    def last_ns(self) -> int:
        """Stamp of the latest state; 0 without states."""
        return self._states[-1].stamp_ns if self._states else 0

    @property
    def lag_ns(self) -> float | None:
        """Median of arrival - stamp over the history; None if arrival times are unknown."""
        if not self._states or not self._states[-1].received_ns:
            return None
        return float(np.median([state.received_ns - state.stamp_ns for state in self._states]))

    def is_clock_reset(self, stamp_ns: int) -> bool:
        """Return whether the clock jumped back, or a new recording began: the states so far are of another time."""
        return bool(self._states) and 0 < stamp_ns < self.last_ns - self._reset_ns

    def add(self, stamp_ns: int, contact: ContactAssessment, received_ns: int) -> None:
        """Add the state at `stamp_ns` that arrived at `received_ns` (0: unknown)."""
        self.last_arrival_ns = max(received_ns, self.last_arrival_ns)
        if stamp_ns <= self.last_ns:
            # When joint states stop, the monitor repeats the last stamp, which is not out of order.
            self.late += stamp_ns < self.last_ns
            return
        self.first_ns = self.first_ns or stamp_ns
        speed, direction = contact.speed, contact.direction
        is_finite = math.isfinite(speed) and all(map(math.isfinite, direction))
        moving = is_finite and any(direction) and speed >= self._settings.speed_threshold
        unknown = contact.reason if contact.verdict is Verdict.UNKNOWN and direction == (0.0, 0.0, 0.0) else ""
        masses = (contact.lumped_mass, contact.full_mass, contact.iso_mass)
        row = (speed, *direction, *masses, *contact.lumped_mobility, *contact.full_mobility)
        self._states.append(_State(stamp_ns, self.last_arrival_ns, row, moving, unknown))
        if self._states[0].stamp_ns < self.last_ns - 2 * self._history_ns:
            del self._states[: self._count(self.last_ns - self._history_ns - 1, len(self))]

    def lag_at(self, onset_ns: int, deadline_ns: int) -> int | None:
        """Return arrival - stamp of the last state up to the onset, or of the first state if all are later.

        Only states that arrived by `deadline_ns` (0: all) count. None if there are none.
        """
        if not (known := self._received_count(deadline_ns)):
            return None
        state = self._states[max(self._count(onset_ns, known) - 1, 0)]
        return state.received_ns - state.stamp_ns

    def at(
        self, onset_ns: int, uncertainty_ns: int, deadline_ns: int = 0, normal: Vector3 | None = None
    ) -> OnsetState | Rejection:
        """Return the robot state at `onset_ns`, from the states that arrived by `deadline_ns` (0: all).

        The contact slows the robot along `normal`, of either sign; None: along its motion.
        """
        known = self._received_count(deadline_ns)
        before, after = self._count(onset_ns, known) - 1, self._count(onset_ns - 1, known)
        for i, side in ((before, "before"), (after, "after")):
            gap_s = abs(self._states[i].stamp_ns - onset_ns) / NANOSECONDS if 0 <= i < known else math.inf
            if gap_s > self._tolerance:
                detail = f"the nearest is {gap_s * 1e3:.0f} ms away" if gap_s < math.inf else "there is none"
                return Rejection(f"no contact state within {self._tolerance * 1e3:g} ms {side} the onset", detail)
        for i in (before, after):
            if self._states[i].unknown:
                return Rejection("the contact state at the onset is UNKNOWN", self._states[i].unknown)
        if not self._states[before].moving:
            return Rejection("the robot stands still at the onset", f"{self._states[before].row[_SPEED]:.4f} m/s")
        row, from_trend = self._interpolate(onset_ns, uncertainty_ns, before, after, normal)
        length = float(np.linalg.norm(row[_DIRECTION]))
        if not self._states[after].moving and not from_trend:
            speed = self._states[after].row[_SPEED]
            return Rejection("the robot stands still at the onset", f"{speed:.4f} m/s after it")
        if not length >= MIN_DIRECTION_LENGTH or not row[_SPEED] >= self._settings.speed_threshold:
            return Rejection("the direction of motion reverses at the onset")
        x, y, z = (row[_DIRECTION] / length).tolist()
        mobilities = tuple(row[_LUMPED].tolist()), tuple(row[_FULL].tolist())
        return OnsetState(float(row[_SPEED]), (x, y, z), _by_model(*row[_MASSES].tolist()), from_trend, mobilities)

    def kink(self, onset_ns: int, duration: float, deadline_ns: int = 0) -> Kink | None:
        """Return the kink in the velocity near `onset_ns` from a contact of `duration` [s]; see `at`."""
        known = self._received_count(deadline_ns)
        window_ns = round(WINDOW * NANOSECONDS)
        states = self._states[self._count(onset_ns - window_ns, known) : self._count(onset_ns + window_ns, known)]
        states = [state for state in states if not state.unknown]
        if not states:
            return None
        seconds, rows = _arrays(states, onset_ns)
        return velocity_kink(seconds, rows[:, [_SPEED]] * rows[:, _DIRECTION], duration)

    def _count(self, stamp_ns: int, known: int) -> int:
        """Return the number of states up to `stamp_ns` among the first `known`."""
        return bisect_right(self._states, stamp_ns, 0, known, key=attrgetter("stamp_ns"))

    def _received_count(self, deadline_ns: int) -> int:
        """Return the number of states that arrived by `deadline_ns` (0: all)."""
        return bisect_right(self._states, deadline_ns, key=attrgetter("received_ns")) if deadline_ns else len(self)

    def _interpolate(
        self, onset_ns: int, uncertainty_ns: int, before: int, after: int, normal: Vector3 | None
    ) -> tuple[FloatArray, bool]:
        """Return the row at the onset, and whether it is from the trend, not from the states `before` and `after`."""
        latest_ns = onset_ns - uncertainty_ns
        earliest_ns = latest_ns - round(2.0 * self._tolerance * NANOSECONDS)
        stop = self._count(latest_ns, before + 1)
        recent = self._states[max(stop - TREND_STATES - 1, 0) : stop]
        trend = [state for state in recent if state.moving and state.stamp_ns >= earliest_ns][-TREND_STATES:]
        ends = self._states[before], self._states[after]
        if len(trend) >= 2:
            seconds, rows = _arrays(trend, onset_ns)
            for at, row, state in zip(*_arrays(ends, onset_ns), ends, strict=True):
                if not state.moving or self._slowed(row, _trend(seconds, rows, at), normal):
                    return _trend(seconds, rows, 0.0), True
        (start, end), (first, last) = _arrays(ends, onset_ns)
        if before == after:
            return first, False
        weight = start / (start - end)
        return (1.0 - weight) * first + weight * last, False

    def _slowed(self, row: FloatArray, expected: FloatArray, normal: Vector3 | None) -> bool:
        """Return whether `row` is slower than `expected`, along `normal` or else the expected direction."""
        direction = expected[_DIRECTION] / (float(np.linalg.norm(expected[_DIRECTION])) or 1.0)
        axis = direction if normal is None else np.array(normal)
        speed, along = expected[_SPEED] * float(direction @ axis), row[_SPEED] * float(row[_DIRECTION] @ axis)
        return bool(along * np.sign(speed) < (1.0 - self._settings.slowing) * abs(speed))


def dot(a: Vector3, b: Vector3) -> float:
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _by_model(lumped: float, full: float, iso: float) -> dict[str, float]:
    """Return the masses by name; "largest" is the largest of those that exist, as in the monitor."""
    masses = dict(zip(MODELS, (lumped, full, iso), strict=True))
    known = full if math.isnan(lumped) or lumped < AUTO_SHARE * full else lumped
    auto = iso if math.isnan(known) else known
    return masses | {MassModel.LARGEST.value: float(np.fmax(np.fmax(lumped, full), iso)), MassModel.AUTO.value: auto}


def _mass_along(mobility: Mobility6, normal: Vector3) -> float:
    """Return 1 / (n^T A n) [kg]; NaN if no joint moves the point along n, or if there is no model."""
    inverse = float(normal @ mobility_matrix(mobility) @ np.array(normal))
    return 1.0 / inverse if inverse > 0.0 else math.nan


def _arrays(states: Sequence[_State], onset_ns: int) -> tuple[FloatArray, FloatArray]:
    """Return the times of `states` after the onset (n,) [s], and their rows (n, 19)."""
    seconds = np.array([(state.stamp_ns - onset_ns) / NANOSECONDS for state in states])
    return seconds, np.array([state.row for state in states])


def _trend(seconds: FloatArray, rows: FloatArray, at: float) -> FloatArray:
    """Evaluate the least-squares line through each column of `rows` at the time `at`."""
    centre = seconds - seconds.mean()
    slopes = centre @ (rows - rows.mean(axis=0)) / (centre @ centre)
    values: FloatArray = rows.mean(axis=0) + slopes * (at - seconds.mean())
    return values
