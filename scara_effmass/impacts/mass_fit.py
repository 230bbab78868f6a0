# SPDX-License-Identifier: Apache-2.0
"""Robot mass, force gain and contact law of a series, from the impulses up to the peaks.

Without damping, the impulse J from the onset to the peak is the relative momentum mu v_n of robot and obstacle,
whatever the stiffness and the contact law. With a sensor of gain g and a robot of s times the mass of its model,

    J = g v_n mu,  mu = 1 / (1 / (s m_n) + 1 / m_H)

Light obstacles (mu near m_H) determine g, heavy ones s. The contact law F = K d^n gives F ~ (J v_n)^p, p = n / (n + 1).
"""

import math
from collections.abc import Hashable, Sequence
from typing import NamedTuple

import numpy as np
import scipy  # loads scipy.optimize and scipy.special on first use

from scara_effmass.values import FloatArray

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
    quantile = float(scipy.special.stdtrit(degrees, (1.0 + CONFIDENCE) / 2.0))
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
    half = float(scipy.special.stdtrit(degrees, (1.0 + CONFIDENCE) / 2.0)) * error
    return slope, Interval(slope - half, slope + half)


def _scaled(value: float, log_half: float) -> Interval:
    """Return the interval of `value` whose logarithm has the half-width `log_half`."""
    if not log_half < _LOG_BOUND:
        return UNKNOWN_SCALE
    return Interval(value * math.exp(-log_half), value * math.exp(log_half))
