# SPDX-License-Identifier: Apache-2.0
"""Predicted peak forces, their agreement with measured ones, and masses and gain fitted to the impulses of a series.

The model is F = x sqrt(k) with x = v sqrt(mu) (ISO/TS 15066, Annex A: E = mu v^2 / 2 = F^2 / (2 k)). Every call
recomputes the whole series. Sums are exactly rounded (`math.fsum`), so the order of the impacts does not matter.

`fit_masses` uses the impulses up to the peaks. Without damping, the impulse J from the onset to the peak is the
relative momentum mu v_n of robot and obstacle, whatever the stiffness and the contact law. With a sensor of gain g and
a robot of s times the mass of its model,

    J = g v_n mu,  mu = 1 / (1 / (s m_n) + 1 / m_H)

Light obstacles (mu near m_H) determine g, heavy ones s. The contact law F = K d^n gives F ~ (J v_n)^p, p = n / (n + 1).
"""

import math
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy  # loads scipy.optimize and scipy.special on first use; importing scipy.stats would take a second

from scara_effmass.impacts.impact_matcher import MatchedImpact
from scara_effmass.iso15066 import Limit, force_per_root_stiffness, peak_force, reduced_mass
from scara_effmass.values import FloatArray, Prediction, at_least, at_most

LIMITS = 1.96
"""Half-width of the 95 % limits of agreement, in standard deviations (Bland and Altman 1986)."""
MIN_RELATIVE_RANGE = 0.05
"""Minimum relative range of x for a correlation: the speeds of repeated impacts scatter by +-2 % anyway."""
ROUNDING = 1e-12
"""Relative tolerance for rounding errors: a single impact fits its own stiffness exactly."""
CONFIDENCE = 0.95
MIN_IMPULSE_ERROR = 0.005
"""Minimum relative error of an impulse or peak: that of ideal impacts, see docs/validity.md."""
SAME_MASS = 0.02
"""Effective masses of one configuration that differ by less than this share belong to one pose."""
MIN_SHARE_RANGE = 0.05
"""Minimum range of mu / m_n, the sensitivity to s, at which s can be told from g."""
MIN_LOG_RANGE = 0.05
"""Minimum range of log(J v_n) at which the contact law shows."""
_LOG_BOUND = math.log(1e3)


class Interval(NamedTuple):
    """Closed interval."""

    low: float
    high: float

    def around(self, value: float) -> str:
        """Return `value` and the interval as text."""
        return f"{value:.3f} ({self.low:.3f} to {self.high:.3f})"


UNKNOWN_SCALE = Interval(0.0, math.inf)


class MassFit(NamedTuple):
    """Gain g and mass scale s of one model over `impacts`, with their intervals at 95 %.

    Impacts of one pose and obstacle share the errors of model and obstacle, so their mean counts as one of `cells`.
    `detectable_mass_error` is the smallest relative error of the masses that the series shows with a probability of
    95 %; infinite if it cannot tell g and s apart. `scatter` is the relative standard deviation of the cells about the
    fit. `worst_obstacle` [kg] is the obstacle whose impulses deviate most from the fit on average, by
    `worst_deviation`. `exponent` is p of F ~ (J v_n)^p; NaN if J v_n does not vary.
    """

    impacts: int
    cells: int
    gain: float
    gain_interval: Interval
    mass_scale: float
    mass_scale_interval: Interval
    detectable_mass_error: float
    scatter: float
    worst_obstacle: float
    worst_deviation: float
    exponent: float
    exponent_interval: Interval


NO_FIT = MassFit(
    0, 0, 1.0, UNKNOWN_SCALE, 1.0, UNKNOWN_SCALE, math.inf, 0.0, 0.0, 0.0, math.nan, Interval(-math.inf, math.inf)
)


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
    values = [
        (m.impulse, m.state.speed, m.impact.peak_force / m.force_share, m.state.masses[model], m.obstacle_mass)
        for m in usable
    ]
    impulses, speeds, peaks, masses, obstacle_masses = np.array(values).reshape(-1, 5).T
    configurations = [match.run.configuration for match in usable]
    return fit_masses(impulses, speeds, peaks, masses, obstacle_masses, configurations)


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


def pose_cells(configurations: Sequence[Hashable], masses: FloatArray, obstacle_masses: FloatArray) -> list[int]:
    """Return the cell number of each impact; a cell has one configuration, one obstacle, and close effective masses.

    `masses` and `obstacle_masses` (n,) are in [kg].
    """
    order = sorted(range(len(masses)), key=lambda i: (str(configurations[i]), obstacle_masses[i], masses[i]))
    cells, number, previous = [0] * len(masses), -1, None
    for i in order:
        label = configurations[i], obstacle_masses[i]
        if previous is None or label != previous[0] or masses[i] > (1.0 + SAME_MASS) * previous[1]:
            number += 1
        previous, cells[i] = (label, masses[i]), number
    return cells


def fit_masses(
    impulses: FloatArray,
    speeds: FloatArray,
    peaks: FloatArray,
    masses: FloatArray,
    obstacle_masses: FloatArray,
    configurations: Sequence[Hashable],
) -> MassFit:
    """Fit g, s and p to n impacts, all quantities (n,), positive and along the normal of the contact.

    `impulses` are J [N s], `speeds` v_n [m/s], `peaks` F [N], `masses` m_n and `obstacle_masses` m_H [kg], which may be
    infinite; `configurations` are names of poses. The method is least squares of log(J / v_n) over the cells, with
    intervals by Student's t.
    """
    if not impulses.size:
        return NO_FIT
    cell = np.array(pose_cells(configurations, masses, obstacle_masses))
    counts = np.bincount(cell)

    def means(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(cell, values) / counts)

    y, m, energy, force = (means(np.log(values)) for values in (impulses / speeds, masses, impulses * speeds, peaks))
    mobility = means(1.0 / obstacle_masses)
    m = np.exp(m)
    exponent, exponent_interval = _exponent(energy, force)
    fit = NO_FIT._replace(
        impacts=impulses.size, cells=counts.size, exponent=exponent, exponent_interval=exponent_interval
    )
    shares = 1.0 / (1.0 + m * mobility)
    degrees = counts.size - 2
    if degrees < 1 or np.ptp(shares) < MIN_SHARE_RANGE:
        return fit

    def residuals(parameters: FloatArray) -> FloatArray:
        log_gain, log_scale = parameters
        return np.asarray(y - log_gain + np.log(np.exp(-log_scale) / m + mobility))

    solution = scipy.optimize.least_squares(residuals, (0.0, 0.0), bounds=(-_LOG_BOUND, _LOG_BOUND))
    log_gain, log_scale = solution.x.tolist()
    gain, scale = math.exp(log_gain), math.exp(log_scale)
    rest = -solution.fun
    scatter = math.sqrt(float(rest @ rest) / degrees)
    shares = 1.0 / (1.0 + scale * m * mobility)
    share, spread = float(shares.mean()), float(np.sum((shares - shares.mean()) ** 2))
    error = max(scatter, MIN_IMPULSE_ERROR)
    scale_error = error / math.sqrt(spread) if spread > 0.0 else math.inf
    gain_error = error * math.sqrt(1.0 / counts.size + (share**2 / spread if spread > 0.0 else math.inf))
    quantile = _quantile(degrees)
    detectable = (quantile + float(scipy.special.stdtrit(degrees, CONFIDENCE))) * scale_error
    deviations = {float(k): float(solution.fun[mobility == k].mean()) for k in np.unique(mobility)}
    worst = max(deviations, key=lambda k: abs(deviations[k]))
    return fit._replace(
        gain=gain,
        gain_interval=_scaled(gain, quantile * gain_error),
        mass_scale=scale,
        mass_scale_interval=_scaled(scale, quantile * scale_error),
        detectable_mass_error=math.expm1(detectable) if detectable < _LOG_BOUND else math.inf,
        scatter=scatter,
        worst_obstacle=1.0 / worst if worst else math.inf,
        worst_deviation=math.expm1(deviations[worst]),
    )


def _exponent(energy: FloatArray, force: FloatArray) -> tuple[float, Interval]:
    """Return the slope of log `force` (n,) over log `energy` (n,), and its interval."""
    degrees = energy.size - 2
    if degrees < 1 or np.ptp(energy) < MIN_LOG_RANGE:
        return NO_FIT.exponent, NO_FIT.exponent_interval
    x, y = energy - energy.mean(), force - force.mean()
    spread = float(x @ x)
    slope = float(x @ y) / spread
    rest = y - slope * x
    error = max(math.sqrt(float(rest @ rest) / degrees), MIN_IMPULSE_ERROR) / math.sqrt(spread)
    half = _quantile(degrees) * error
    return slope, Interval(slope - half, slope + half)


def _scaled(value: float, log_half: float) -> Interval:
    """Return the interval of `value` whose logarithm has the half-width `log_half`."""
    if not log_half < _LOG_BOUND:
        return UNKNOWN_SCALE
    return Interval(value * math.exp(-log_half), value * math.exp(log_half))


class RegionForce(NamedTuple):
    """Force [N] that an impact would exert on a body `region`, and the `limit` [N] of that region by `criterion`."""

    region: str
    force: float
    limit: float
    criterion: str

    @property
    def exceeds(self) -> bool:
        """Whether the force exceeds the limit."""
        return self.force > self.limit


NO_REGION = RegionForce("", 0.0, 0.0, "")


def static_force(limits: Sequence[Limit], force: float) -> RegionForce:
    """Return a `force` [N] that acts on a body as on the sensor, with the smallest of `limits`; none if it is 0."""
    weakest = min(limits, key=lambda limit: limit.permissible_force_n)
    if not force > 0.0:
        return NO_REGION
    return RegionForce(weakest.region, force, weakest.permissible_force_n, weakest.criterion)


def region_force(
    limits: Sequence[Limit],
    peak: float,
    robot_masses: Iterable[float],
    device_mass: float,
    stiffness: float,
    load: float = 0.0,
) -> RegionForce:
    """Return the region whose force is closest to its limit or exceeds it most, for any of `robot_masses` [kg].

    A mass of 0 is unknown. The measuring device, of `device_mass` [kg] (infinite: fixed) and `stiffness` [N/m],
    measured the `peak` [N]. The energy mu v^2 / 2 = F^2 / (2 k) of ISO/TS 15066, Annex A, at the same speed v gives the
    force on a region, F_region = F sqrt(mu_region k_region / (mu_device k_device)), where mu = 1 / (1/m_robot + 1/m).
    A static `load` [N] beneath the peak is added.
    """
    forces = []
    for mass in filter(None, robot_masses):
        device = reduced_mass(mass, device_mass) * stiffness
        for limit in limits if 0.0 < device < math.inf else ():
            force = peak * math.sqrt(reduced_mass(mass, limit.body_mass_kg) * limit.stiffness_n_m / device)
            forces.append(RegionForce(limit.region, force + load, limit.permissible_force_n, limit.criterion))
    return max(forces, key=lambda region: region.force / region.limit, default=NO_REGION)


def comparison_text(impact: Any) -> str:  # noqa: ANN401 - ValidatedImpact, or what displays keep of its message
    """Return the force on a body region, converted from the measured peak, and what stayed, each with its limit."""

    def compared(force: float, region: str, limit: float) -> str:
        side = "ABOVE" if force > limit else "below"
        return f"{at_least(force, 1)} N on {region}, {side} its limit of {at_most(limit, 1)} N"

    if not impact.body_region:
        return "not converted to a body region"
    text = f"converted {compared(impact.region_force, impact.body_region, impact.limit_force)}"
    if impact.held_force:
        text += f"; held {compared(impact.held_force, impact.held_region, impact.held_limit)}"
    return text
