# SPDX-License-Identifier: Apache-2.0
"""Predicted peak forces, and their agreement with measured ones over a series.

The model is F = x sqrt(k) with x = v sqrt(mu) (ISO/TS 15066, Annex A: E = mu v^2 / 2 = F^2 / (2 k)). Every call
recomputes the whole series. Sums are exactly rounded (`math.fsum`), so the order of the impacts does not matter.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # loads scipy.special on first use; importing scipy.stats would take a second

from scara_effmass.impacts.impact_matcher import MatchedImpact
from scara_effmass.impacts.mass_fit import CONFIDENCE, Interval, MassFit, fit_masses
from scara_effmass.iso15066 import force_per_root_stiffness, peak_force
from scara_effmass.values import FloatArray, Prediction

LIMITS = 1.96
"""Half-width of the 95 % limits of agreement, in standard deviations (Bland and Altman 1986)."""
MIN_RELATIVE_RANGE = 0.05
"""Minimum relative range of x for a correlation: the speeds of repeated impacts scatter by +-2 % anyway."""
ROUNDING = 1e-12
"""Relative tolerance for rounding errors: a single impact fits its own stiffness exactly."""


@dataclass(frozen=True, slots=True)
class Agreement:
    """Agreement of predicted and measured forces of `count` impacts. Forces in [N], stiffness in [N/m].

    `correlation` is Pearson's r of F and x; if it is undefined, it is 0 and `correlation_reason` states why.
    `fitted_stiffness` is k of the least-squares line F = sqrt(k) x through the origin, 0 below two impacts; `stiffness`
    is the one used for the predictions. Intervals are at 95 %, for independent and normal residuals; they are None if
    there are too few impacts, or no correlation. `bias` and `rmse` are those of predicted - measured; `relative_rmse`
    is relative to the mean measured force; `limits` are bias +- 1.96 standard deviations (n - 1). `non_conservative`
    counts predictions below the measured force, `shortfalls` those below it by more than the tolerance.
    `largest_shortfall` is relative, and 0 if there is none.
    """

    count: int
    correlation: float
    correlation_reason: str
    correlation_interval: Interval | None
    fitted_stiffness: float
    stiffness_interval: Interval | None
    stiffness: float
    mean_force: float
    bias: float
    rmse: float
    relative_rmse: float
    limits: Interval | None
    non_conservative: int
    shortfalls: int
    largest_shortfall: float


@dataclass(frozen=True, slots=True)
class Comparison:
    """Relative RMSE of the models on the same `count` impacts, best model first; `text` states the result."""

    count: int
    relative_rmse: Mapping[str, float]
    text: str


def agreement(x: FloatArray, force: FloatArray, stiffness: float = 0.0, shortfall_tolerance: float = 0.1) -> Agreement:
    """Return the agreement of measured `force` (n,) [N] with F = x sqrt(k), `x` (n,) = v sqrt(mu) [m/s sqrt(kg)].

    Both must be positive. The predictions use `stiffness` [N/m]; 0: the fitted stiffness.
    """
    n = x.size
    slope = math.fsum(x * force) / math.fsum(x * x) if n else 0.0
    difference = (math.sqrt(stiffness) if stiffness else slope) * x - force
    mean_force = _mean(force)
    bias, rmse = _mean(difference), math.sqrt(_mean(difference**2))
    deviation = math.sqrt(math.fsum((difference - bias) ** 2) / (n - 1)) if n > 1 else 0.0
    shortfall = -difference / force
    ends = _slope_interval(slope, x, force, n - 1)
    reason = _correlation_reason(x, force)
    r = 0.0 if reason else _correlation(x, force)
    return Agreement(
        count=n,
        correlation=r,
        correlation_reason=reason,
        correlation_interval=None if reason else _correlation_interval(r, n),
        fitted_stiffness=slope * slope if n > 1 else 0.0,
        stiffness_interval=ends and Interval(max(0.0, ends.low) ** 2, ends.high**2),
        stiffness=stiffness or slope * slope,
        mean_force=mean_force,
        bias=bias,
        rmse=rmse,
        relative_rmse=rmse / mean_force if n else 0.0,
        limits=Interval(bias - LIMITS * deviation, bias + LIMITS * deviation) if n > 1 else None,
        non_conservative=int(np.count_nonzero(shortfall > ROUNDING)),
        shortfalls=int(np.count_nonzero(shortfall > shortfall_tolerance + ROUNDING)),
        largest_shortfall=max((float(s) for s in shortfall if s > ROUNDING), default=0.0),
    )


def predict(model: str, match: MatchedImpact, stiffness: float) -> Prediction:
    """Return the prediction v sqrt(mu k) for the sensor with `stiffness` [N/m]; `model` must have a mass."""
    mu, measured = match.reduced_mass(model), match.impact.peak_force
    force = peak_force(match.state.speed, mu, stiffness) * match.force_share
    return Prediction(
        model=model,
        effective_mass=match.state.masses[model],
        reduced_mass=mu,
        stiffness=stiffness,
        predicted_force=force,
        relative_error=(force - measured) / measured,
        conservative=measured - force <= ROUNDING * measured,
    )


def model_agreement(model: str, matches: Iterable[MatchedImpact], *options: float) -> Agreement:
    """Return `agreement` (with its `options`) of `model` over the matches for which the model has a mass."""
    usable = [match for match in matches if match.has_mass(model)]
    x = np.array([root_force(match, model) for match in usable])
    return agreement(x, np.array([match.impact.peak_force for match in usable]), *options)


def root_force(match: MatchedImpact, model: str) -> float:
    """Return the predicted force divided by sqrt(k): v sqrt(mu) [m/s sqrt(kg)] along the axis of the sensor."""
    return force_per_root_stiffness(match.state.speed, match.reduced_mass(model)) * match.force_share


def model_fit(model: str, matches: Iterable[MatchedImpact]) -> MassFit:
    """Return `fit_masses` of `model` over the matches with a known impulse for which the model has a mass."""
    usable = [match for match in matches if match.has_mass(model) and match.impulse > 0.0]

    def values(quantity: Callable[[MatchedImpact], float]) -> FloatArray:
        return np.array([quantity(match) for match in usable])

    return fit_masses(
        values(lambda match: match.impulse),
        values(lambda match: match.state.speed),
        values(lambda match: match.impact.peak_force / match.force_share),
        values(lambda match: match.state.masses[model]),
        values(lambda match: match.obstacle_mass),
        [match.run.configuration for match in usable],
    )


def compare_models(models: Iterable[str], matches: Sequence[MatchedImpact]) -> Comparison:
    """Rank the models that have a mass by relative RMSE, on the impacts for which all of them have one.

    Each model has its own fitted stiffness. If no reduced mass varies over the series, the models cannot be told apart.
    """
    present = [model for model in models if any(match.has_mass(model) for match in matches)]
    common = [match for match in matches if all(match.has_mass(model) for model in present)]
    masses = [np.array([match.reduced_mass(model) for match in common]) for model in present]
    same_mass = bool(common) and all(np.ptp(mu) <= MIN_RELATIVE_RANGE * mu.max() for mu in masses)
    return compare({model: model_agreement(model, common) for model in present}, same_mass=same_mass)


def compare(agreements: Mapping[str, Agreement], *, same_mass: bool) -> Comparison:
    """Rank the models by relative RMSE.

    `agreements`, by model, must be of the same impacts, each with the fitted stiffness. `same_mass`: the reduced mass
    does not vary over the series in any model.
    """
    order = dict(sorted(agreements.items(), key=lambda item: item[1].relative_rmse))
    errors = {model: agreement.relative_rmse for model, agreement in order.items()}
    count = min((agreement.count for agreement in order.values()), default=0)
    numbers = ", ".join(f"{model} {a.relative_rmse:.4f} (r {a.correlation:.4f})" for model, a in order.items())
    if count < 2 or len(order) < 2:
        text = "no two models on at least two same impacts: nothing to compare"
    elif same_mass:
        text = f"all impacts at the same reduced mass: the models cannot be told apart; relative RMSE {numbers}"
    else:
        best = [model for model, error in errors.items() if error <= _max_rmse_ratio(count) * min(errors.values())]
        if len(best) == 1:
            text = f"{best[0]} explains the forces best; relative RMSE {numbers}"
        else:
            equally = f"equally well, as far as {count} impacts tell"
            text = f"{' and '.join(best)} explain the forces {equally}; relative RMSE {numbers}"
    return Comparison(count, errors, text)


def _correlation(x: FloatArray, y: FloatArray) -> float:
    """Return Pearson's r of x and y, neither of which may be constant."""
    dx, dy = x - _mean(x), y - _mean(y)
    xx, xy, yy = math.fsum(dx * dx), math.fsum(dx * dy), math.fsum(dy * dy)
    return min(1.0, max(-1.0, xy / math.sqrt(xx * yy)))


def _correlation_reason(x: FloatArray, force: FloatArray) -> str:
    """Return why the correlation of `force` and `x` is undefined; empty if it is defined."""
    if x.size < 2:
        return "fewer than two impacts"
    if np.ptp(x) <= MIN_RELATIVE_RANGE * x.max():
        return "all impacts are at the same v sqrt(mu)"
    if np.ptp(force) <= ROUNDING * force.max():
        return "all impacts have the same measured force"
    return ""


def _slope_interval(slope: float, x: FloatArray, y: FloatArray, degrees: int) -> Interval | None:
    """Return the interval of the `slope` in y = slope x (Student's t with `degrees` of freedom)."""
    if degrees < 1:
        return None
    half = _quantile(degrees) * math.sqrt(math.fsum((y - slope * x) ** 2) / math.fsum(x * x) / degrees)
    return Interval(slope - half, slope + half)


def _correlation_interval(r: float, count: int) -> Interval | None:
    """Return the interval of a correlation (Fisher's z, standard deviation (n - 3)^-1/2)."""
    if count < 4:
        return None
    if abs(r) == 1.0:
        return Interval(r, r)
    z, half = math.atanh(r), _quantile(math.inf) / math.sqrt(count - 3)
    return Interval(math.tanh(z - half), math.tanh(z + half))


def _quantile(degrees: float) -> float:
    """Return the two-sided CONFIDENCE quantile of Student's t; infinite `degrees`: of the normal distribution."""
    return float(scipy.special.stdtrit(degrees, 0.5 + CONFIDENCE / 2.0))


def _mean(values: FloatArray) -> float:
    return math.fsum(values) / values.size if values.size else 0.0


def _max_rmse_ratio(count: int) -> float:
    """Return the 95 % limit of the ratio of two RMSE over `count` impacts with equal error variance.

    Snedecor's F assumes independent errors; errors on the same impacts are correlated, so their ratio is smaller.
    """
    return math.sqrt(scipy.special.fdtri(count - 1, count - 1, (1.0 + CONFIDENCE) / 2.0))
