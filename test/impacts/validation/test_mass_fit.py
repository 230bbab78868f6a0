# SPDX-License-Identifier: Apache-2.0
"""Mass scale, gain and exponent are exact for exact impacts, have correct intervals, or are stated as unknown."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import optimize, stats

from scara_effmass.impacts.agreement import MIN_IMPULSE_ERROR, NO_FIT, MassFit, fit_masses, model_fit, pose_cells
from scara_effmass.impacts.impact_matcher import MatchedImpact, Run
from scara_effmass.impacts.state_history import OnsetState
from scara_effmass.values import NO_MOBILITY

if TYPE_CHECKING:
    from scara_effmass.values import FloatArray
    from test.impacts.validation.conftest import MakeImpact

POSES = np.array([0.981, 1.247, 2.891])
CARTS = np.array([0.50, 2.39, 3.72, 7.35])
MASSES, OBSTACLES = np.repeat(POSES, 4), np.tile(CARTS, 3)
NAMES = np.repeat(["a", "b", "c"], 4).tolist()


def reduced(masses: FloatArray, obstacles: FloatArray = OBSTACLES) -> FloatArray:
    return np.asarray(1.0 / (1.0 / masses + 1.0 / obstacles))


def fit(noise: FloatArray | float = 0.0, scale: float = 1.0, gain: float = 1.0, exponent: float = 0.5) -> MassFit:
    """Fit the paper's design with relative errors of the impulses; only `scale` and `gain` of the model are wrong."""
    mu = reduced(scale * MASSES)
    speeds = np.linspace(0.2, 0.3, 12)
    peaks = 500.0 * gain * (mu * speeds**2) ** exponent
    return fit_masses(gain * mu * speeds * np.exp(noise), speeds, peaks, MASSES, OBSTACLES, NAMES)


@given(st.floats(0.5, 2.0), st.floats(0.7, 1.4), st.floats(0.4, 0.7))
def test_scale_gain_and_exponent_are_found_exactly(scale: float, gain: float, exponent: float) -> None:
    result = fit(scale=scale, gain=gain, exponent=exponent)
    assert result.mass_scale == pytest.approx(scale, rel=1e-5)
    assert result.gain == pytest.approx(gain, rel=1e-5)
    assert result.exponent == pytest.approx(exponent, abs=1e-9)
    assert result.scatter == pytest.approx(0.0, abs=1e-5)
    assert (result.impacts, result.cells) == (12, 12)


@pytest.mark.parametrize("heaviest", [0.135, 0.17])
def test_obstacles_too_much_alike_give_neither_gain_nor_scale(heaviest: float) -> None:
    """Shares of 0.09 to 0.12 and, for the second, 0.145 of a robot of 1 kg; they must differ by 0.05."""
    obstacles = np.array([0.1, 0.11, 0.12, heaviest])
    masses = np.ones(4)
    mu = reduced(masses, obstacles)
    speeds = np.full(4, 0.25)
    result = fit_masses(mu * speeds, speeds, 500.0 * np.sqrt(mu), masses, obstacles, list("aaaa"))
    shares = obstacles / (1.0 + obstacles)
    assert (result.gain_interval == NO_FIT.gain_interval) == (np.ptp(shares) < 0.05)


def test_fit_leaves_out_impacts_without_an_impulse_or_without_the_mass_of_the_model(make_impact: MakeImpact) -> None:
    matches = [
        MatchedImpact(
            make_impact(0, compression_impulse=impulse),
            OnsetState(0.25, (1.0, 0.0, 0.0), {"full": mass}, False, (NO_MOBILITY, NO_MOBILITY)),  # noqa: FBT003
            Run(0, 2.39, "a"),
        )
        for impulse, mass in ((0.2, 1.0), (0.0, 1.0), (0.2, math.nan), (0.2, 1.1))
    ]
    assert model_fit("full", matches).impacts == 2


def test_intervals_of_a_noisy_series_are_those_of_the_general_optimiser() -> None:
    noise = np.random.default_rng(0).normal(0.0, 0.03, 12)
    result = fit(noise)
    y = np.log(reduced(MASSES)) + noise

    def law(masses: FloatArray, log_gain: float, log_scale: float) -> FloatArray:
        return np.asarray(log_gain + np.log(reduced(math.exp(log_scale) * masses)))

    (log_gain, log_scale), covariance = optimize.curve_fit(law, MASSES, y, p0=(0.0, 0.0))
    halves = stats.t.isf(0.025, 10) * np.sqrt(np.diag(covariance))
    assert result.gain_interval == pytest.approx(np.exp(log_gain + halves[0] * np.array([-1, 1])), rel=1e-4)
    assert result.mass_scale_interval == pytest.approx(np.exp(log_scale + halves[1] * np.array([-1, 1])), rel=1e-4)
    power = (stats.t.isf(0.025, 10) + stats.t.isf(0.05, 10)) * math.sqrt(covariance[1, 1])
    assert result.detectable_mass_error == pytest.approx(math.expm1(power), rel=1e-4)


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    """About 380 of 400 intervals contain the truth, and about 380 series find an error of the detectable size."""
    rng = np.random.default_rng(1)
    hits = np.zeros(3)
    for _ in range(400):
        noise = rng.normal(0.0, 0.02, 12)
        result = fit(noise)
        wrong = fit(noise, scale=1.0 + typical_power())
        hits += (
            result.gain_interval.low <= 1.0 <= result.gain_interval.high,
            result.mass_scale_interval.low <= 1.0 <= result.mass_scale_interval.high,
            not wrong.mass_scale_interval.low <= 1.0 <= wrong.mass_scale_interval.high,
        )
    assert (abs(hits - 380) < 4 * math.sqrt(400 * 0.05 * 0.95)).all()


def typical_power() -> float:
    """Return the detectable mass error of a series whose scatter is 2 %."""
    exact = fit()
    return math.expm1(math.log1p(exact.detectable_mass_error) * 0.02 / MIN_IMPULSE_ERROR)


def test_exact_series_claim_no_more_than_the_method_can() -> None:
    result = fit()
    low, high = result.mass_scale_interval
    assert 0.005 < high - low < 0.05
    assert result.detectable_mass_error == pytest.approx(0.026, abs=0.003)


def test_repetitions_share_the_errors_of_pose_and_cart() -> None:
    """Errors of 3 % per combination do not average out over 20 repetitions."""
    noise = np.random.default_rng(2).normal(0.0, 0.03, 12)
    again = np.tile(np.arange(12), 20)
    mu = reduced(MASSES) * np.exp(noise)
    speeds = np.full(12, 0.25)
    single = fit_masses(mu * speeds, speeds, mu, MASSES, OBSTACLES, NAMES)
    names = [NAMES[i] for i in again]
    many = fit_masses((mu * speeds)[again], speeds[again], mu[again], MASSES[again], OBSTACLES[again], names)
    assert (many.impacts, many.cells) == (240, 12)
    assert many.mass_scale_interval == pytest.approx(single.mass_scale_interval, rel=1e-6)


def test_gain_and_mass_cannot_be_told_apart_without_several_ratios() -> None:
    """With one cart, or carts in proportion to the masses, mu / m_n is the same everywhere."""
    for obstacles in (np.full(12, np.inf), 2.0 * MASSES):
        mu = reduced(MASSES, obstacles)
        result = fit_masses(0.25 * mu, np.full(12, 0.25), mu, MASSES, obstacles, NAMES)
        assert result.mass_scale_interval == (0.0, math.inf)
        assert result.detectable_mass_error == math.inf


def test_a_fixed_obstacle_shows_the_mass_and_a_light_one_the_gain() -> None:
    obstacles = np.tile([0.3, np.inf], 6)
    mu = reduced(1.3 * MASSES, obstacles)
    result = fit_masses(0.9 * 0.25 * mu, np.full(12, 0.25), np.sqrt(mu), MASSES, obstacles, NAMES)
    assert (result.mass_scale, result.gain) == pytest.approx((1.3, 0.9), rel=1e-5)


def test_the_worst_obstacle_is_named() -> None:
    declared = np.where(OBSTACLES == 3.72, 2.39, OBSTACLES)
    mu = reduced(MASSES)
    result = fit_masses(
        0.25 * mu, np.full(12, 0.25), np.sqrt(mu), MASSES, declared * np.where(OBSTACLES == 3.72, 1.0001, 1.0), NAMES
    )
    assert result.worst_obstacle == pytest.approx(2.39, rel=1e-3)
    assert result.scatter > 0.02


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_the_worst_deviation_is_that_of_the_measured_impulses(factor: float) -> None:
    mu = reduced(MASSES)
    impulses = 0.25 * mu * np.where(OBSTACLES == 2.39, factor, 1.0)
    result = fit_masses(impulses, np.full(12, 0.25), np.sqrt(mu), MASSES, OBSTACLES, NAMES)
    assert result.worst_obstacle == pytest.approx(2.39)
    assert 0.3 * (factor - 1.0) / result.worst_deviation < 1.0
    assert result.worst_deviation * (factor - 1.0) > 0.0


@given(st.permutations(range(12)))
def test_the_order_of_impacts_does_not_matter(order: list[int]) -> None:
    noise = np.random.default_rng(3).normal(0.0, 0.02, 12)
    mu, speeds = reduced(MASSES) * np.exp(noise), np.linspace(0.2, 0.3, 12)
    results = [
        fit_masses((mu * speeds)[i], speeds[i], mu[i], MASSES[i], OBSTACLES[i], [NAMES[k] for k in i])
        for i in (list(range(12)), order)
    ]
    assert np.ravel([results[1].mass_scale, results[1].gain, results[1].exponent]) == pytest.approx(
        [results[0].mass_scale, results[0].gain, results[0].exponent], rel=1e-6
    )


def test_nothing_of_no_impacts() -> None:
    empty = np.array([])
    assert fit_masses(empty, empty, empty, empty, empty, []) == NO_FIT


def test_cells_are_poses_with_an_obstacle() -> None:
    masses = np.array([1.0, 1.015, 1.03, 1.2, 1.0, 1.0])
    cells = pose_cells(["a", "a", "a", "a", "b", "a"], masses, np.array([2.0, 2.0, 2.0, 2.0, 2.0, 3.0]))
    assert len({*cells[:3]}) == 1
    assert len({*cells}) == 4
