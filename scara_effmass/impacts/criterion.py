# SPDX-License-Identifier: Apache-2.0
"""Acceptance of a series: accepted, rejected, or not decidable, with the next measurement to make."""

import hashlib
import json
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from scara_effmass.impacts.agreement import MIN_RELATIVE_RANGE, Agreement, Interval, MassFit
from scara_effmass.impacts.state_history import LONGEST_CONTACT_S, MAX_BEYOND_SHARE, ClockOffset
from scara_effmass.settings import CriterionSettings
from scara_effmass.values import FloatArray

MIN_KINK_SHARE = 0.5
"""Minimum share of impacts with a kink in the velocity."""
MAX_EXPONENT_HALF_WIDTH = 0.05
"""Half the difference between the exponents of a linear spring (0.5) and a Hertz contact (0.6)."""
LIGHT, HEAVY = 0.25, 3.0
"""m_H / m_n of the obstacles that determine the gain and the mass; their mu / m_n is 0.2 and 0.75."""


class Acceptance(NamedTuple):
    """Outcome for one model; `reason` is empty if accepted, and names the next measurement if not decidable."""

    accepted: bool
    decidable: bool
    reason: str


class Series(NamedTuple):
    """Inputs of a decision. `masses` and `obstacle_masses` (n,) [kg] are along the normals of the plates.

    `left_out` impacts could not be paired with the robot; `left_out_reason` is the most frequent reason. `one_pose`:
    the effective mass hardly varies in any model. `gain_tolerance` is relative.
    """

    agreement: Agreement
    fit: MassFit
    clock: ClockOffset
    masses: FloatArray
    obstacle_masses: FloatArray
    one_pose: bool
    gain_tolerance: float
    left_out: int = 0
    left_out_reason: str = ""


def criterion_hash(criterion: CriterionSettings) -> str:
    """Return 16 hexadecimal digits of the SHA-256 of the criterion as canonical JSON (sorted keys, no blanks)."""
    text = json.dumps(criterion.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def decide(criterion: CriterionSettings, series: Series, problem: str = "") -> Acceptance:
    """Return the decision. A `problem` with the clocks or with the sign of the force rejects the series.

    A series of too few impacts is not decidable. Any other series is rejected if it violates a condition, and not
    decidable if it violates none but could not have shown an error.
    """
    if problem:
        return Acceptance(accepted=False, decidable=True, reason=problem)
    for reason in _too_few(criterion, series):
        return Acceptance(accepted=False, decidable=False, reason=reason)
    for reason in _rejections(criterion, series):
        return Acceptance(accepted=False, decidable=True, reason=f"{reason}{_clock_cause(series.clock)}")
    for reason in _doubts(criterion, series):
        return Acceptance(accepted=False, decidable=False, reason=f"{reason}; next: {_next(criterion, series)}")
    return Acceptance(accepted=True, decidable=True, reason="")


def _too_few(criterion: CriterionSettings, series: Series) -> Iterator[str]:
    count = series.agreement.count
    total = count + series.left_out
    if count < criterion.least_count:
        left_out = f"; {series.left_out} left out: {series.left_out_reason}" if series.left_out else ""
        yield f"{impact_count(count)}, at least {criterion.least_count} are required{left_out}"
    if count < criterion.least_paired_share * total:
        share = f"at least {criterion.least_paired_share:.0%} must be: {series.left_out_reason}"
        yield f"{impact_count(count)} of {total} paired with the robot, {share}"


def _rejections(criterion: CriterionSettings, series: Series) -> Iterator[str]:
    agreement, fit, clock, exponent = series.agreement, series.fit, series.clock, _law(criterion)
    if _is_apart(clock):
        offset = f"the joint states and the force are apart by an unknown time, {clock.extremes} by single impacts"
        if not math.isnan(clock.offset):
            offset = _median_offset(clock)
        limit = f"{clock.beyond} of {impact_count(clock.impacts)} exceed {1e3 * criterion.largest_clock_offset:g} ms"
        yield f"{offset}: {limit}"
    if not agreement.correlation_reason and agreement.correlation < criterion.least_correlation:
        yield f"correlation {agreement.correlation:.4f} is below {criterion.least_correlation:g}"
    if agreement.relative_rmse > criterion.largest_relative_rmse:
        yield f"relative RMSE {agreement.relative_rmse:.4f} is above {criterion.largest_relative_rmse:g}"
    if agreement.shortfalls > criterion.largest_shortfall_share * agreement.count:
        yield (
            f"{agreement.shortfalls} of {impact_count(agreement.count)} predicted more than "
            f"{criterion.shortfall_tolerance:.0%} too low, at most {criterion.largest_shortfall_share:.0%} may be"
        )
    if _is_outside(fit.gain_interval, series.gain_tolerance):
        limit = f"must be within {_percent(series.gain_tolerance)} of 1"
        yield f"gain of the force {fit.gain_interval.around(fit.gain)}: {limit}"
    if _is_outside(fit.mass_scale_interval, criterion.mass_tolerance):
        limit = f"times its model's mass, at most {criterion.mass_tolerance:.0%} off is tolerated"
        yield f"the robot has {fit.mass_scale_interval.around(fit.mass_scale)} {limit}"
    if not fit.exponent_interval.low <= exponent <= fit.exponent_interval.high:
        law = f"does not cover {exponent:.3f} of the declared contact law"
        yield f"exponent {fit.exponent_interval.around(fit.exponent)} {law}"
    if fit.scatter > criterion.largest_scatter:
        worst = f"largest for m_H = {series.fit.worst_obstacle:g} kg ({fit.worst_deviation:+.1%})"
        yield f"impulses scatter by {fit.scatter:.1%}, at most {criterion.largest_scatter:.0%} may be; {worst}"


def _doubts(criterion: CriterionSettings, series: Series) -> Iterator[str]:
    agreement, fit, clock, tolerance = series.agreement, series.fit, series.clock, criterion.mass_tolerance
    mass, gain, exponent = fit.mass_scale_interval, fit.gain_interval, fit.exponent_interval
    gain_tolerance = _percent(series.gain_tolerance)
    checks = (
        (not fit.impacts, "the impacts do not state the impulse up to the peak"),
        (
            _one_obstacle(series),
            f"one obstacle mass ({series.obstacle_masses[0]:.3g} kg) cannot separate the robot's mass from the gain",
        ),
        (series.one_pose, "one pose cannot show that the mass follows the pose"),
        (bool(agreement.correlation_reason), f"correlation undefined: {agreement.correlation_reason}"),
        (
            clock.impacts < MIN_KINK_SHARE * agreement.count,
            (
                f"the velocity shows the impact in {clock.impacts} of {impact_count(agreement.count)}: "
                "clock offset unknown"
            ),
        ),
        (
            clock.resolution > criterion.largest_clock_offset,
            f"the joint states resolve a clock offset of {1e3 * clock.resolution:.1f} ms only",
        ),
        (
            fit.detectable_mass_error > tolerance,
            f"a mass error below {fit.detectable_mass_error:.0%} would not have been found",
        ),
        (
            not _is_inside(mass, tolerance),
            f"mass scale {mass.around(fit.mass_scale)} is not clearly within {tolerance:.0%} of 1",
        ),
        (
            not _is_inside(gain, series.gain_tolerance),
            f"gain of the force {gain.around(fit.gain)} is not clearly within {gain_tolerance} of 1",
        ),
        (
            not exponent.high - exponent.low <= 2.0 * MAX_EXPONENT_HALF_WIDTH,
            f"exponent {exponent.around(fit.exponent)} cannot tell contact laws apart",
        ),
    )
    return (reason for applies, reason in checks if applies)


def _next(criterion: CriterionSettings, series: Series) -> str:
    """Return what to measure next."""
    fit, clock, steps = series.fit, series.clock, []
    light, heavy = LIGHT * float(series.masses.min()), HEAVY * float(series.masses.max())
    obstacles = series.obstacle_masses
    if obstacles.min() > 2.0 * light or _one_obstacle(series):
        steps.append(f"an obstacle of m_H = {light:.2g} kg or less, which fixes the gain")
    if obstacles.max() < 0.5 * heavy:
        steps.append(f"one of {heavy:.2g} kg or more, which shows the mass")
    if series.one_pose:
        steps.append("every obstacle in a second pose, whose effective mass differs by 20 % or more")
    if clock.resolution > criterion.largest_clock_offset:
        steps.append(f"joint states at {0.5 / criterion.largest_clock_offset:.0f} Hz or more")
    if clock.impacts < series.agreement.count:
        steps.append(f"impacts at constant speed, in contacts of {1e3 * LONGEST_CONTACT_S:g} ms or less")
    if not steps:
        gain = fit.gain_interval
        mass_ratio = fit.detectable_mass_error / criterion.mass_tolerance
        gain_ratio = 0.5 * (gain.high - gain.low) / series.gain_tolerance
        ratio = min(max(mass_ratio, gain_ratio, 1.5), 3.0)
        count = math.ceil(max(fit.cells, 4) * ratio**2)
        steps.append(f"{count} combinations of pose and obstacle in place of {fit.cells}")
    return ", ".join(steps)


def _is_apart(clock: ClockOffset) -> bool:
    return clock.beyond > MAX_BEYOND_SHARE * clock.impacts


def _clock_cause(clock: ClockOffset) -> str:
    """Return that the clocks can be the cause of a rejection: states a few ms late have been slowed by the impact."""
    if _is_apart(clock) or not abs(clock.offset) > 2.0 * clock.resolution:
        return ""
    return f"; {_median_offset(clock)}, which may be the cause"


def _median_offset(clock: ClockOffset) -> str:
    return f"the joint states are {1e3 * clock.offset:+.1f} ms behind the force (median)"


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g}%"


def _one_obstacle(series: Series) -> bool:
    mobility = 1.0 / series.obstacle_masses
    return bool(np.ptp(mobility) <= MIN_RELATIVE_RANGE * mobility.max())


def _law(criterion: CriterionSettings) -> float:
    """Return p of F ~ (mu v^2)^p for the declared law F ~ d^n: n / (n + 1)."""
    return criterion.contact_exponent / (criterion.contact_exponent + 1.0)


def _is_inside(interval: Interval, tolerance: float) -> bool:
    return 1.0 / (1.0 + tolerance) <= interval.low and interval.high <= 1.0 + tolerance


def _is_outside(interval: Interval, tolerance: float) -> bool:
    return interval.high < 1.0 / (1.0 + tolerance) or 1.0 + tolerance < interval.low


def impact_count(count: int) -> str:
    """Return a number of impacts in words."""
    return "1 impact" if count == 1 else f"{count} impacts" if count else "no impacts"
