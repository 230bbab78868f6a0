# SPDX-License-Identifier: Apache-2.0
"""The statistics of a series agree with scipy, numpy and closed forms; forces of a device become those of a region."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy import optimize, stats

from scara_effmass.impacts.agreement import NO_REGION, Agreement, RegionForce, agreement, region_force, static_force
from scara_effmass.iso15066 import limits_for, peak_force, reduced_mass
from scara_effmass.settings import MonitorSettings

if TYPE_CHECKING:
    from random import Random

    from scara_effmass.values import FloatArray

SERIES = st.lists(
    st.tuples(st.floats(0.05, 2.0), st.floats(0.7, 1.4)).map(lambda pair: (pair[0], 400.0 * pair[0] * pair[1])),
    min_size=3,
    max_size=20,
)


def arrays(series: list[tuple[float, float]]) -> tuple[FloatArray, FloatArray]:
    x, force = np.array(series).T
    assume(np.ptp(x) > 0.05 * x.max())
    assume(np.ptp(force) > 0.05 * force.max())
    return x, force


def paper_like(seed: int, noise: float, count: int = 36) -> tuple[FloatArray, FloatArray, float]:
    """Return x, forces of a spring of 200 N/mm with relative `noise`, and that stiffness [N/m]."""
    rng = np.random.default_rng(seed)
    x = 0.25 * np.sqrt(rng.uniform(0.3, 2.0, count))
    return x, x * math.sqrt(2e5) * (1.0 + rng.normal(0.0, noise, count)), 2e5


def test_a_linear_spring_is_found_exactly() -> None:
    x, force, k = paper_like(0, 0.0)
    result = agreement(x, force)
    assert result.count == x.size
    assert result.correlation == pytest.approx(1.0, abs=1e-12)
    assert result.fitted_stiffness == pytest.approx(k, rel=1e-12)
    assert result.stiffness_interval == pytest.approx((k, k), rel=1e-9)
    assert result.bias == pytest.approx(0.0, abs=1e-9)
    assert result.rmse == pytest.approx(0.0, abs=1e-9)
    assert (result.non_conservative, result.shortfalls, result.largest_shortfall) == (0, 0, 0.0)


@given(SERIES)
def test_equals_scipy_and_numpy(series: list[tuple[float, float]]) -> None:
    x, force = arrays(series)
    result = agreement(x, force)
    assert result.correlation == pytest.approx(np.corrcoef(x, force)[0, 1], abs=1e-9)
    slope = np.linalg.lstsq(x[:, None], force, rcond=None)[0][0]
    assert result.fitted_stiffness == pytest.approx(slope**2, rel=1e-9)
    difference = slope * x - force
    assert result.bias == pytest.approx(difference.mean(), abs=1e-9 * force.max())
    assert result.rmse == pytest.approx(np.sqrt(np.mean(difference**2)), rel=1e-7, abs=1e-9 * force.max())
    assert result.relative_rmse == pytest.approx(result.rmse / force.mean(), rel=1e-9)
    spread = 1.96 * difference.std(ddof=1)
    assert result.limits == pytest.approx(
        (difference.mean() - spread, difference.mean() + spread), rel=1e-7, abs=1e-9 * force.max()
    )


def test_the_stiffness_interval_by_hand() -> None:
    """Two impacts, x = 1 and 2, F = 11 and 18: all sums are small whole numbers.

    slope = (11 + 36) / 5 = 9.4, residuals 1.6 and -0.8, s^2 = 3.2 over one degree of freedom, error sqrt(3.2 / 5) =
    0.8, and t at 0.975 with one degree of freedom is tan(0.475 pi) = 12.706.
    """
    result = agreement(np.array([1.0, 2.0]), np.array([11.0, 18.0]))
    half = 0.8 * math.tan(0.475 * math.pi)
    assert result.fitted_stiffness == pytest.approx(9.4**2)
    assert result.stiffness_interval == pytest.approx((max(0.0, 9.4 - half) ** 2, (9.4 + half) ** 2))
    assert result.correlation == pytest.approx(1.0)
    assert result.correlation_interval is None
    # Predictions 9.4 and 18.8: differences -1.6 and 0.8, mean -0.4, standard deviation 2.4 / sqrt(2).
    assert result.bias == pytest.approx(-0.4)
    assert result.rmse == pytest.approx(math.sqrt(1.6))
    assert result.limits == pytest.approx((-0.4 - 1.96 * 2.4 / math.sqrt(2), -0.4 + 1.96 * 2.4 / math.sqrt(2)))
    assert (result.non_conservative, result.shortfalls) == (1, 1)
    assert result.largest_shortfall == pytest.approx(1.6 / 11)


def test_the_intervals_by_another_way() -> None:
    """On a noisy series, they equal the fit of scipy's general optimizer and the textbook's sums."""
    x, force, _ = paper_like(2, 0.03)
    result = agreement(x, force)
    (slope,), ((variance,),) = optimize.curve_fit(lambda x, s: s * x, x, force, p0=[400.0])
    half = stats.t.isf(0.025, x.size - 1) * math.sqrt(variance)
    assert result.stiffness_interval == pytest.approx(((slope - half) ** 2, (slope + half) ** 2), rel=1e-5)
    z, half = math.atanh(result.correlation), stats.norm.isf(0.025) / math.sqrt(x.size - 3)
    assert result.correlation_interval == pytest.approx((math.tanh(z - half), math.tanh(z + half)), abs=1e-9)


@pytest.mark.parametrize(("count", "half"), [(3, None), (4, 1.959964), (5, 1.959964 / math.sqrt(2.0))])
def test_correlation_has_an_interval_from_four_impacts_on(count: int, half: float | None) -> None:
    """Fisher: z = atanh(r), standard deviation 1 / sqrt(n - 3), Phi^-1(0.975) = 1.959964."""
    x, force, _ = paper_like(2, 0.03, count)
    result = agreement(x, force)
    z = math.atanh(result.correlation)
    expected = None if half is None else pytest.approx((math.tanh(z - half), math.tanh(z + half)), abs=1e-6)
    assert result.correlation_interval == expected


def test_exact_correlation_has_an_interval_without_width() -> None:
    result = agreement(np.array([1.0, 2.0, 3.0, 4.0]), np.array([1.0, 2.0, 3.0, 4.0]))
    assert (result.correlation, result.correlation_interval) == (1.0, (1.0, 1.0))


def test_the_interval_holds_the_stiffness_as_often_as_it_says() -> None:
    """With additive normal errors of the force, about 380 of 400 intervals contain the stiffness."""
    rng = np.random.default_rng(3)
    hits = 0
    for _ in range(400):
        x = 0.25 * np.sqrt(rng.uniform(0.3, 2.0, 12))
        interval = agreement(x, x * math.sqrt(2e5) + rng.normal(0.0, 3.0, x.size)).stiffness_interval
        assert interval is not None
        hits += interval.low <= 2e5 <= interval.high
    assert abs(hits - 380) < 4 * math.sqrt(400 * 0.05 * 0.95)


@given(SERIES, st.sampled_from([0.5, 2.0, 16.0]))
def test_forces_times_s_are_stiffness_times_s_squared(series: list[tuple[float, float]], s: float) -> None:
    x, force = arrays(series)
    plain, scaled = agreement(x, force), agreement(x, s * force)
    assert scaled.fitted_stiffness == s**2 * plain.fitted_stiffness  # powers of two scale without rounding
    assert scaled.correlation == pytest.approx(plain.correlation, abs=1e-12)
    assert (scaled.bias, scaled.rmse) == pytest.approx((s * plain.bias, s * plain.rmse), rel=1e-12)
    assert scaled.relative_rmse == pytest.approx(plain.relative_rmse, rel=1e-12)
    assert scaled.non_conservative == plain.non_conservative


@given(SERIES, st.randoms())
def test_the_order_of_impacts_does_not_matter(series: list[tuple[float, float]], random: Random) -> None:
    shuffled = list(series)
    random.shuffle(shuffled)
    result, reordered = agreement(*arrays(series)), agreement(*arrays(shuffled))
    assert (result.fitted_stiffness, result.bias, result.rmse) == (
        reordered.fitted_stiffness,
        reordered.bias,
        reordered.rmse,
    )
    assert result.correlation == pytest.approx(reordered.correlation, abs=1e-12)


@given(SERIES, st.floats(1e4, 1e6))
def test_a_given_stiffness_is_used_and_the_fitted_one_still_said(series: list[tuple[float, float]], k: float) -> None:
    x, force = arrays(series)
    result, fitted = agreement(x, force, k), agreement(x, force)
    assert result.stiffness == k
    assert result.fitted_stiffness == fitted.fitted_stiffness
    assert result.bias == pytest.approx(np.mean(math.sqrt(k) * x - force), abs=1e-9 * force.max())
    assert result.non_conservative == sum(math.sqrt(k) * x < force)
    assert result.shortfalls == sum(1.0 - math.sqrt(k) * x / force > 0.1)
    assert result.rmse >= fitted.rmse * (1.0 - 1e-9)  # the fitted one is the least-squares one


def test_nothing_of_no_impacts() -> None:
    result = agreement(np.array([]), np.array([]))
    assert result == Agreement(
        0, 0.0, "fewer than two impacts", None, 0.0, None, 0.0, 0.0, 0.0, 0.0, 0.0, None, 0, 0, 0.0
    )


def test_one_impact_fits_itself_and_says_nothing() -> None:
    result = agreement(np.array([0.3]), np.array([123.4]))
    assert result.stiffness == pytest.approx((123.4 / 0.3) ** 2)
    assert (result.count, result.correlation, result.fitted_stiffness) == (1, 0.0, 0.0)
    assert result.correlation_reason == "fewer than two impacts"
    assert (result.stiffness_interval, result.limits) == (None, None)
    assert result.non_conservative == 0


@given(st.floats(0.05, 2.0), st.floats(10.0, 1000.0), st.integers(1, 30))
def test_impacts_that_fit_exactly_are_conservative(x: float, force: float, count: int) -> None:
    result = agreement(np.full(count, x), np.full(count, force))
    assert (result.non_conservative, result.largest_shortfall) == (0, 0.0)


@pytest.mark.parametrize("spread", [0.0, 1e-15, 0.009, 0.04])
def test_no_correlation_at_one_reduced_mass(spread: float) -> None:
    """Repetitions, whose speeds scatter by up to 4 %, are not a trend, even if their noise is correlated."""
    x = 0.3 * np.linspace(1.0 - spread, 1.0, 5)
    result = agreement(x, 400.0 * x + np.linspace(0.0, 1.0, 5))
    assert result.correlation == 0.0
    assert result.correlation_reason == "all impacts are at the same v sqrt(mu)"
    assert result.correlation_interval is None
    assert result.fitted_stiffness > 0.0
    assert result.stiffness_interval is not None


def test_no_correlation_of_equal_forces() -> None:
    result = agreement(np.array([0.1, 0.2, 0.3]), np.full(3, 50.0))
    assert (result.correlation, result.correlation_reason) == (0.0, "all impacts have the same measured force")


HAND = limits_for(MonitorSettings(body_regions=("hand_fingers",)))
ALL = limits_for(MonitorSettings())
MASS = st.floats(0.5, 20.0)


@given(MASS, MASS, st.floats(1e4, 2e6), st.floats(0.05, 2.0))
def test_a_free_device_gives_the_force_of_the_law(robot: float, device: float, stiffness: float, speed: float) -> None:
    measured = peak_force(speed, reduced_mass(robot, device), stiffness)
    result = region_force(HAND, measured, [robot], device, stiffness)
    assert result.force == pytest.approx(peak_force(speed, reduced_mass(robot, 0.6), 75e3))
    assert (result.region, result.limit, result.criterion) == ("hand_fingers", 280.0, "force")
    assert result.exceeds == (result.force > 280.0)


def test_a_device_like_the_region_converts_nothing() -> None:
    assert region_force(HAND, 123.0, [3.0], 0.6, 75e3).force == pytest.approx(123.0)


def test_a_fixed_device_of_the_stiffness_of_the_hand_reads_too_much() -> None:
    """Mass 3 kg on a fixed 75 N/mm: mu is 3 kg instead of 0.5 kg, so the hand feels sqrt(1/6) of the force."""
    assert region_force(HAND, 400.0, [3.0], math.inf, 75e3).force == pytest.approx(400.0 / math.sqrt(6.0))


def test_clamped_region_has_an_infinite_mass() -> None:
    clamped = limits_for(MonitorSettings(body_regions=("hand_fingers",), contact="quasi_static"))
    result = region_force(clamped, 100.0, [3.0], math.inf, 75e3)
    assert (result.force, result.limit) == pytest.approx((100.0, 140.0))


@pytest.mark.parametrize(("regions", "closest"), [((), "lower_leg"), (("thigh_knee", "chest"), "chest")])
def test_the_region_closest_to_its_limit_is_returned(regions: tuple[str, ...], closest: str) -> None:
    """The force on the thigh is larger than that on the chest, and so is its limit."""
    limits = limits_for(MonitorSettings(body_regions=regions))
    result = region_force(limits, 400.0, [3.0], 5.0, 1e5)
    others = [region_force([limit], 400.0, [3.0], 5.0, 1e5) for limit in limits]
    assert result.force / result.limit == max(other.force / other.limit for other in others)
    assert (result.region, result.exceeds) == (closest, True)


def test_a_static_force_has_the_smallest_limit() -> None:
    assert static_force(ALL, 230.0)[:3] == ("abdomen", 230.0, 220.0)
    assert static_force(ALL, 0.0) == NO_REGION


def test_nothing_without_stiffness() -> None:
    assert region_force(HAND, 100.0, [3.0], 5.0, 0.0) == NO_REGION


def test_nothing_where_neither_robot_nor_device_gives_way() -> None:
    assert region_force(HAND, 100.0, [math.inf], math.inf, 1e5) == NO_REGION


def test_force_at_the_limit_does_not_exceed_it() -> None:
    assert not RegionForce("hand_fingers", 280.0, 280.0, "force").exceeds


@pytest.mark.parametrize("masses", [(1.0, 4.0), (4.0, 1.0), (4.0, 0.0, 1.0)])
def test_the_mass_with_the_largest_force_over_its_limit_counts(masses: tuple[float, ...]) -> None:
    """The order does not matter; 0 is an unknown mass."""
    light, heavy = (region_force(ALL, 100.0, [mass], 40.0, 1e5) for mass in (1.0, 4.0))
    assert heavy.force / heavy.limit > light.force / light.limit
    assert region_force(ALL, 100.0, masses, 40.0, 1e5) == heavy


def test_no_known_mass_or_device_gives_no_region() -> None:
    assert region_force(ALL, 100.0, [0.0, 0.0], 5.0, 1e5) == region_force(ALL, 100.0, [3.0], 5.0, 0.0) == NO_REGION
