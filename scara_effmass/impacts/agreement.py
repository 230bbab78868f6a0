"""Agreement of predicted and measured peak forces over a series of impacts, and the criterion to accept it.

The model is F = x sqrt(k), x = v sqrt(mu) (ISO/TS 15066, Annex A: E = mu v^2 / 2 = F^2 / (2 k)). Every call recomputes
the whole series, with exactly rounded sums (`math.fsum`).
"""

import hashlib
import json
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit  # scipy.stats takes a second to import

from scara_effmass.settings import CriterionSettings
from scara_effmass.values import FloatArray

CONFIDENCE = 0.95
LIMITS = 1.96
"""Half-width of the 95 % limits of agreement, in standard deviations (Bland and Altman 1986)."""
MIN_RELATIVE_RANGE = 0.05
"""Minimum relative range of x for a correlation; speeds of repeated impacts alone scatter by +-2 %."""
ROUNDING = 1e-12
"""Relative tolerance for rounding: a single impact fits its own stiffness exactly."""


class Interval(NamedTuple):
    """Closed interval."""

    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Agreement:
    """Agreement of predicted and measured forces of `count` impacts. Forces in [N], stiffness in [N/m].

    `correlation` is Pearson's r of F and x; 0 if undefined, then `correlation_reason` is set. `fitted_stiffness` is k
    of the least-squares line F = sqrt(k) x through the origin, 0 below two impacts; `stiffness` is the one used for
    the predictions. `exponent` is p of the log-log fit F = c (mu v^2)^p: 0.5 for a linear spring, 0.6 for a Hertz
    contact. Intervals are at 95 % and assume independent, normal residuals. `bias` and `rmse` are of predicted -
    measured, `relative_rmse` is relative to the mean measured force, `limits` are bias +- 1.96 standard deviations
    (n - 1). `non_conservative` counts predictions below the measured force, `shortfalls` those below it by more than
    the tolerance; `largest_shortfall` is relative, 0 without shortfall. None: too few impacts or no correlation.
    """

    count: int
    correlation: float
    correlation_reason: str
    correlation_interval: Interval | None
    fitted_stiffness: float
    stiffness_interval: Interval | None
    stiffness: float
    exponent: float | None
    exponent_interval: Interval | None
    mean_force: float
    bias: float
    rmse: float
    relative_rmse: float
    limits: Interval | None
    non_conservative: int
    shortfalls: int
    largest_shortfall: float


def agreement(x: FloatArray, force: FloatArray, stiffness: float = 0.0, shortfall_tolerance: float = 0.1) -> Agreement:
    """Return the agreement of measured `force` (n,) [N] with F = x sqrt(k), `x` (n,) = v sqrt(mu) [m/s sqrt(kg)].

    Both must be positive. `stiffness` [N/m] is used for the predictions; 0: the fitted stiffness.
    """
    n = x.size
    slope = math.fsum(x * force) / math.fsum(x * x) if n else 0.0
    difference = (math.sqrt(stiffness) if stiffness else slope) * x - force
    mean_force = _mean(force)
    bias, rmse = _mean(difference), math.sqrt(_mean(difference**2))
    deviation = math.sqrt(math.fsum((difference - bias) ** 2) / (n - 1)) if n > 1 else 0.0
    shortfall = -difference / force
    reason = _correlation_reason(x, force)
    line = None if reason else _LinearFit(x, force)
    power = None if reason else _LinearFit(2.0 * np.log(x), np.log(force))  # x^2 = mu v^2
    return Agreement(
        count=n,
        correlation=line.correlation if line else 0.0,
        correlation_reason=reason,
        correlation_interval=line.correlation_interval if line else None,
        fitted_stiffness=slope**2 if n > 1 else 0.0,
        stiffness_interval=_stiffness_interval(x, force, slope),
        stiffness=stiffness or slope**2,
        exponent=power.slope if power else None,
        exponent_interval=power.slope_interval if power else None,
        mean_force=mean_force,
        bias=bias,
        rmse=rmse,
        relative_rmse=rmse / mean_force if n else 0.0,
        limits=Interval(bias - LIMITS * deviation, bias + LIMITS * deviation) if n > 1 else None,
        non_conservative=int(np.count_nonzero(shortfall > ROUNDING)),
        shortfalls=int(np.count_nonzero(shortfall > shortfall_tolerance + ROUNDING)),
        largest_shortfall=max((float(s) for s in shortfall if s > ROUNDING), default=0.0),
    )


def is_conservative(predicted: float, measured: float) -> bool:
    """Return whether `predicted` is at least `measured`, within rounding."""
    return measured - predicted <= ROUNDING * measured


def criterion_hash(criterion: CriterionSettings) -> str:
    """Return 16 hexadecimal digits of the SHA-256 of the criterion as canonical JSON (sorted keys, no blanks)."""
    text = json.dumps(criterion.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def unmet_criterion(criterion: CriterionSettings, agreement: Agreement, unmatched: int) -> str:
    """Return the first unmet condition with value and limit; empty if the series is accepted."""
    count, total = agreement.count, agreement.count + unmatched
    too_low = (
        f"{agreement.shortfalls} of {_impacts(count)} predicted more than {criterion.shortfall_tolerance:.0%} too low, "
        f"at most {criterion.largest_shortfall_share:.0%} may be"
    )
    checks = (
        (count < criterion.least_count, f"{_impacts(count)}, at least {criterion.least_count} are required"),
        (
            count < criterion.least_paired_share * total,
            f"{_impacts(count)} of {total} paired with the robot, at least {criterion.least_paired_share:.0%} must be",
        ),
        (bool(agreement.correlation_reason), f"correlation undefined: {agreement.correlation_reason}"),
        (
            agreement.correlation < criterion.least_correlation,
            f"correlation {agreement.correlation:.4f} is below {criterion.least_correlation:g}",
        ),
        (
            agreement.relative_rmse > criterion.largest_relative_rmse,
            f"relative RMSE {agreement.relative_rmse:.4f} is above {criterion.largest_relative_rmse:g}",
        ),
        (agreement.shortfalls > criterion.largest_shortfall_share * count, too_low),
    )
    return next((reason for fails, reason in checks if fails), "")


class _LinearFit:
    """Least-squares line through points (x, y), and their correlation. x and y must vary."""

    def __init__(self, x: FloatArray, y: FloatArray) -> None:
        self.n = x.size
        dx, dy = x - _mean(x), y - _mean(y)
        xx, xy, yy = math.fsum(dx * dx), math.fsum(dx * dy), math.fsum(dy * dy)
        self.slope = xy / xx
        self.correlation = min(1.0, max(-1.0, xy / math.sqrt(xx * yy)))
        self._errors = math.fsum((dy - self.slope * dx) ** 2) / xx

    @property
    def slope_interval(self) -> Interval | None:
        """Confidence interval of the slope (Student's t, n - 2 degrees of freedom)."""
        if self.n < 3:
            return None
        half = _quantile(self.n - 2) * math.sqrt(self._errors / (self.n - 2))
        return Interval(self.slope - half, self.slope + half)

    @property
    def correlation_interval(self) -> Interval | None:
        """Confidence interval of r (Fisher's z, standard deviation (n - 3)^-1/2)."""
        r = self.correlation
        if self.n < 4:
            return None
        if abs(r) == 1.0:
            return Interval(r, r)
        z, half = math.atanh(r), _quantile(math.inf) / math.sqrt(self.n - 3)
        return Interval(math.tanh(z - half), math.tanh(z + half))


def _correlation_reason(x: FloatArray, force: FloatArray) -> str:
    """Return why the correlation of `force` and `x` is undefined; empty if it is defined."""
    if x.size < 2:
        return "fewer than two impacts"
    if np.ptp(x) <= MIN_RELATIVE_RANGE * x.max():
        return "all impacts are at the same v sqrt(mu)"
    if np.ptp(force) <= ROUNDING * force.max():
        return "all impacts have the same measured force"
    return ""


def _stiffness_interval(x: FloatArray, force: FloatArray, slope: float) -> Interval | None:
    """Return the interval of k = slope^2: the squared ends of the slope's interval (t, n - 1 degrees of freedom)."""
    n = x.size
    if n < 2:
        return None
    residual = force - slope * x
    error = math.sqrt(math.fsum(residual * residual) / (n - 1) / math.fsum(x * x))
    half = _quantile(n - 1) * error
    return Interval(max(0.0, slope - half) ** 2, (slope + half) ** 2)


def _quantile(degrees: float) -> float:
    """Return the two-sided CONFIDENCE quantile of Student's t; infinite `degrees`: of the normal distribution."""
    return float(stdtrit(degrees, 0.5 + CONFIDENCE / 2.0))


def _mean(values: FloatArray) -> float:
    return math.fsum(values) / values.size if values.size else 0.0


def _impacts(count: int) -> str:
    return "1 impact" if count == 1 else f"{count} impacts" if count else "no impacts"
