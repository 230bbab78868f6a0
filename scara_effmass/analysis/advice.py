# SPDX-License-Identifier: Apache-2.0
"""Advise a speed factor for each segment of a recorded path, such that no state exceeds its allowable speed.

A factor scales all joint velocities, so directions and masses along the path stay the same. The allowable speed still
depends on the speed, through accelerations, the change of pose and the tolerance of the velocities. The factors are
therefore iterated, and the re-timed motion is assessed as the monitor does it. Between segments the factor changes no
faster than the largest recorded acceleration of each joint allows: for the factor s and x = s^2 over the path time t,
q'' = x q''_rec + x' q'_rec / 2.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from scara_effmass.analysis.report import CYCLE, figure_text, new_figure, styled
from scara_effmass.cell.scaled_trajectory import ScaledTrajectory
from scara_effmass.codes import Reason
from scara_effmass.errors import BagError
from scara_effmass.kernel.admission import METRES_PER_RADIAN
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import BoolArray, ContactAssessment, Decision, FloatArray, JointState, Verdict, true_runs

ITERATIONS = 60
PRECISION = 0.99
"""Minimum ratio of an accepted factor to the smallest factor that is known to be too large."""
MIN_FACTOR = 0.02
"""Minimum factor; a segment that needs a smaller one gets none."""
MAX_STEP_S = 0.02
"""Longest time between two states of the re-timed motion, unless the recorded ones are further apart."""
MAX_ADDED = 1000
"""Largest number of states between two recorded ones; with fewer than it takes, the next ones are UNKNOWN."""
SLOWER = 0.8
"""Next factor of a state that is WARN for another reason than its speed."""
MAX_SHARE = 3.0
"""Largest ratio of speed to allowable speed that an advice holds."""
FROM_POSITIONS = "; --velocity from-positions takes those of the positions"
FROM_REST = "; begin the recording while all joints rest"
BY_VELOCITY = dict.fromkeys((Reason.VELOCITY_MISMATCH, Reason.UNCONFIRMED_ZERO), FROM_POSITIONS)
"""Remedies for reasons that lie in the reported velocities."""
IntArray = NDArray[np.intp]


class Motion:
    """Joint states of one path in order: times (m,) [s] since the first one, positions and velocities (m, n)."""

    def __init__(
        self, states: Sequence[JointState], origin: str, turns: Mapping[str, float], *, from_positions: bool = False
    ) -> None:
        """Take the `states` recorded in `origin`, with the velocities `from_positions` or the reported ones.

        Positions are unwrapped by the period of their joint in `turns`. Raises BagError if they cannot be re-timed.
        """
        names, kinds = states[0].names, ("position",) if from_positions else ("position", "velocity")
        if other := next((state.names for state in states if state.names != names), None):
            rule = "must have the same joints in the same order in all joint states"
            raise BagError(f"{origin}: {rule}, not {', '.join(names)} and {', '.join(other)}")
        if not all(len(getattr(state, kind)) == len(names) for state in states for kind in kinds):
            raise BagError(f"{origin}: must have positions and velocities in all joint states{FROM_POSITIONS}")
        stamps = [state.stamp_ns for state in states]
        values = [np.array([getattr(state, kind) for state in states]) for kind in kinds]
        if not np.isfinite(values).all():
            raise BagError(f"{origin}: must have finite values in all joint states")
        repeated = np.flatnonzero(np.diff(stamps) <= 0)
        if len(repeated):
            rule = "must have increasing header stamps in all joint states"
            raise BagError(f"{origin}: {rule}: {len(repeated)} of {len(stamps)} are not later than the one before")
        self.time = np.array([stamp_ns - stamps[0] for stamp_ns in stamps]) / 1e9
        self.q = values[0]
        for column, name in zip(self.q.T, names, strict=True):
            if turn := turns.get(name):
                column[:] = np.unwrap(column, period=turn)
        self.qd = np.gradient(self.q, self.time, axis=0) if from_positions else values[1]
        rows = zip(states, self.q, self.qd, strict=True)
        self.states = [state._replace(position=q, velocity=qd) for state, q, qd in rows]

    def segments(self, count: int | None, moves: BoolArray) -> IntArray:
        """Return the number of the segment of each state (m,).

        `count` segments last equally long. With 0 every state is a segment; with None each motion and each standstill
        is one, by whether each state `moves` (m,).
        """
        if count is None:
            changes = np.concatenate(([False], moves[1:] != moves[:-1]))
            return np.cumsum(changes, dtype=np.intp)
        if count == 0:
            return np.arange(len(self.time))
        return np.asarray(np.minimum(self.time / self.time[-1] * count, count - 1), np.intp)

    def at_factors(self, factors: FloatArray) -> tuple[list[JointState], FloatArray]:
        """Return the states of the motion re-timed by the `factors` (m,) of its states, and their path times [s].

        States are added where they would be further apart than 0.02 s and than the recorded ones usually are.
        """
        s = self._ramped(factors)
        step = np.diff(self.time)
        time = np.concatenate(([0.0], np.cumsum(2.0 * step / (s[1:] + s[:-1]))))
        counts = np.ceil(np.diff(time) / max(np.median(step), MAX_STEP_S) - 1e-6)
        counts = np.clip(counts, 1.0, MAX_ADDED).astype(np.intp)  # a pause may last for hours
        steps = zip(time[:-1], time[1:], counts, strict=True)
        pieces = [np.linspace(start, end, count, endpoint=False) for start, end, count in steps]
        times = np.concatenate([*pieces, time[-1:]])
        path_time = CubicHermiteSpline(time, self.time, s)(times)  # exact: s changes linearly in time
        first = self.states[0]
        q, qd = ScaledTrajectory(first.names, self.time, self.q, self.qd).at(path_time, np.interp(times, time, s))
        stamps_ns = first.stamp_ns + np.round(times * 1e9).astype(np.int64)
        rows = zip(stamps_ns.tolist(), q, qd, strict=True)
        return [JointState(stamp_ns, first.names, *row) for stamp_ns, *row in rows], path_time

    def _ramped(self, factors: FloatArray) -> FloatArray:
        """Return the largest factors up to `factors` with which no joint exceeds its largest recorded acceleration."""
        step = np.diff(self.time)[:, np.newaxis]
        acceleration = np.diff(self.qd, axis=0) / step
        largest = np.abs(acceleration).max(axis=0)
        c = self.qd[:-1] / (2.0 * step)
        a, c = acceleration * np.sign(c), np.abs(c) + 1e-12
        ends = np.concatenate((factors[:1], factors, factors[-1:]))
        x = np.minimum(factors, np.minimum(ends[:-2], ends[2:])) ** 2  # at a border the smaller factor of both segments
        for i in range(len(step) - 1, -1, -1):  # backwards, so that the motion slows down in time
            slope = c[i] - a[i]
            bounds = np.where(slope > 0.0, (largest + c[i] * x[i + 1]) / np.maximum(slope, 1e-12), np.inf)
            x[i] = min(x[i], bounds.min())
        for i in range(len(step)):
            x[i + 1] = min(x[i + 1], (x[i] + (largest - a[i] * x[i]) / c[i]).min())
        return np.asarray(np.sqrt(x))


class Advice(NamedTuple):
    """Factors (k,) of the segments, NaN where no speed can be advised, and the reason of each factor.

    `segment` is that of each recorded state (m,). `states` are the re-timed motion, each at a `path_time` [s] of the
    recording; they are empty if a factor is missing. `recorded` (m,) and `advised` are ratios of speed to allowable
    speed, at most MAX_SHARE.
    """

    segment: IntArray
    factors: FloatArray
    reasons: list[str]
    states: list[JointState]
    path_time: FloatArray
    recorded: FloatArray
    advised: FloatArray

    def times(self, motion: Motion) -> tuple[FloatArray, FloatArray]:
        """Return the recorded and the advised duration of each segment (k,) [s]; the latter NaN without states."""
        advised = np.full(len(motion.time), np.nan)
        if self.states:
            stamps = np.array([state.stamp_ns - self.states[0].stamp_ns for state in self.states]) / 1e9
            advised = np.interp(motion.time, self.path_time, stamps)
        before, after = (
            np.bincount(self.segment[:-1], np.diff(time), len(self.factors)).astype(float)
            for time in (motion.time, advised)
        )
        return before, after


def advise(
    motion: Motion,
    recorded: Iterable[Decision],
    decide: Callable[[Sequence[JointState]], Iterable[Decision]],
    count: int | None,
    settings: MonitorSettings,
    worst: Verdict = Verdict.WARN,
) -> Advice:
    """Return the largest factors, at most 1, with which no verdict is worse than `worst`, OK or WARN.

    `recorded` are the decisions on the recorded motion; `decide` returns those of a fresh monitor on a re-timed one,
    both by `settings`. `count` is that of `Motion.segments`; a standstill has no contact faster than `speed_threshold`.
    A segment that is UNKNOWN somewhere or holds no state has no factor, nor one with a step longer than `timeout`. A
    velocity of zero needs no confirmation while the positions stand still, because there is no speed to scale.
    """
    recorded = list(recorded)
    first = last = _allowed_factors(recorded, motion.states, settings, worst)
    step = np.diff(motion.time)
    for row in np.flatnonzero(step > settings.timeout):
        first.factors[row] = -1.0
        first.reasons[row] = f"UNKNOWN: no joint state for {step[row]:.3f} s from {motion.time[row]:.3f} s on"
    speeds = np.array([max(contact.speed for contact in decision.contacts) for decision in recorded])
    segment = motion.segments(count, (speeds > settings.speed_threshold) | (first.factors < 0.0))
    factors, states, path_time = np.ones(int(segment[-1]) + 1), list(motion.states), motion.time
    good, bad = np.zeros(len(factors)), np.full(len(factors), np.inf)
    is_lost = np.bincount(segment) == 0
    reasons = ["holds no joint state: state fewer segments" if lost else "" for lost in is_lost]
    for _ in range(ITERATIONS):
        before = np.clip(np.searchsorted(motion.time, path_time + 1e-9, "right") - 1, 0, len(segment) - 1)
        after = np.clip(np.searchsorted(motion.time, path_time - 1e-9), 0, len(segment) - 1)
        # Between two segments the smaller factor decides, or the segment without one.
        rank = np.where(is_lost, 0.0, factors)
        owner = np.where(rank[segment[before]] <= rank[segment[after]], segment[before], segment[after])
        change, why = _smallest(last, owner, len(factors))
        fits = change >= 1.0
        good, bad = np.where(fits, factors, np.where(good < factors, good, 0.0)), np.where(fits, bad, factors)
        reasons = [old if keep and old else new for keep, old, new in zip(fits | is_lost, reasons, why, strict=True)]
        is_found = (good >= np.minimum(bad * PRECISION, 1.0)) & (good > 0.0)
        if np.all(fits & is_found | is_lost):
            break
        # The next factor follows from the allowable speed if it lies between the bounds, else it is their mean.
        guess = factors * change * (1.0 - 1e-4)
        least = np.maximum(good, 0.2 * bad)  # a slower motion accelerates less, which allows more speed
        mean = np.sqrt(least * np.minimum(bad, 1.0))
        factors = np.where(is_found, good, np.where((guess > least) & (guess < PRECISION * bad), guess, mean))
        is_lost |= (change < 0.0) | (factors < MIN_FACTOR)
        if is_lost.all():
            break
        factors = np.where(is_lost, 1.0, np.minimum(factors, 1.0))
        states, path_time = motion.at_factors(factors[segment])
        last = _allowed_factors(decide(states), states, settings, worst)
    is_open = ~(fits & is_found | is_lost)
    for number in np.flatnonzero(is_open):
        reasons[number] = f"not found within {ITERATIONS} steps: state fewer segments"
    recorded_share, advised_share = (
        np.where(allowed < 0.0, np.nan, 1.0 / np.maximum(allowed, 1.0 / MAX_SHARE)) for allowed, _ in (first, last)
    )
    is_missing = is_open | is_lost
    factors, states = np.where(is_missing, np.nan, good), [] if is_missing.any() else states
    return Advice(segment, factors, reasons, states, path_time, recorded_share, advised_share)


class _Allowed(NamedTuple):
    """Factor (m,) that each state still allows, 0 if it allows no speed, -1 if UNKNOWN, and the reasons."""

    factors: FloatArray
    reasons: list[str]


def _allowed_factors(
    decisions: Iterable[Decision], states: Sequence[JointState], settings: MonitorSettings, worst: Verdict
) -> _Allowed:
    decisions = list(decisions)
    share = settings.warn_ratio if worst is Verdict.OK else 1.0
    remedies = {Reason.UNCONFIRMED_ZERO: FROM_REST} if settings.filters_velocity else BY_VELOCITY
    rows = [min(_allowed(contact, share, worst, remedies) for contact in decision.contacts) for decision in decisions]
    factors = np.array([factor for factor, _ in rows])
    tolerance = METRES_PER_RADIAN * settings.position_tolerance  # of any joint: the smaller one
    for start, stop in true_runs(np.array([d.reason_code is Reason.UNCONFIRMED_ZERO for d in decisions])):
        if np.ptp([state.position for state in states[start:stop]], axis=0).max() <= tolerance:
            factors[start:stop] = np.inf
    return _Allowed(factors, [text for _, text in rows])


def _allowed(
    contact: ContactAssessment, share: float, worst: Verdict, remedies: Mapping[Reason, str]
) -> tuple[float, str]:
    if contact.verdict is Verdict.UNKNOWN:
        return -1.0, f"UNKNOWN: {contact.contact_point}: {contact.reason}{remedies.get(contact.reason_code, '')}"
    if contact.allowable_speed <= 0.0:
        return 0.0, f"no speed is allowed: {contact.contact_point}: {contact.reason}"
    factor = share * contact.allowable_speed / max(contact.speed, 1e-9)
    if factor >= 1.0 and contact.verdict > worst:
        return SLOWER, f"{contact.verdict.name}: {contact.contact_point}: {contact.reason}"
    return factor, f"{contact.contact_point}: {contact.criterion} limit of {contact.body_region}"


def _smallest(allowed: _Allowed, owner: IntArray, count: int) -> tuple[FloatArray, list[str]]:
    """Return the smallest factor of each of `count` segments and its reason; `owner` is the segment of each state."""
    factors, texts = allowed
    smallest, reasons = np.full(count, np.inf), [""] * count
    np.minimum.at(smallest, owner, factors)
    for index in np.flatnonzero(factors <= smallest[owner])[::-1]:
        reasons[owner[index]] = texts[index]
    return smallest, reasons


@styled
def draw_advice(motion: Motion, advice: Advice, title: str) -> Figure:
    """Return the figure: speed over allowable speed of both motions, and the factors, over the recorded time."""
    figure = new_figure(9.0, 5.5, figure_text(title))
    used, factor = figure.subplots(2, 1, sharex=True)
    used.plot(motion.time, advice.recorded, color=CYCLE[1], label="as recorded")
    if advice.states:
        used.plot(advice.path_time, advice.advised, color=CYCLE[0], label="as advised")
    used.axhline(1.0, color="0.3", linestyle="--", label="allowable speed")
    used.set(ylabel=f"speed / allowable speed\n(at most {MAX_SHARE:g})", ylim=(0.0, None))
    used.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)
    factor.step(motion.time, advice.factors[advice.segment], where="post", color=CYCLE[0])
    factor.set(xlabel="recorded time [s]", ylabel="factor", ylim=(0.0, 1.05))
    return figure
