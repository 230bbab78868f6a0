# SPDX-License-Identifier: Apache-2.0
"""Decision on a series: accepted, rejected with value and limit, or not decidable with the next measurement."""

from __future__ import annotations

import hashlib
import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from scara_effmass.errors import SettingsError
from scara_effmass.impacts.agreement import NO_FIT, Agreement, Interval, agreement, compare, fit_masses
from scara_effmass.impacts.criterion import Acceptance, Series, criterion_hash, decide
from scara_effmass.impacts.state_history import ClockOffset
from scara_effmass.settings import CriterionSettings, ValidatorSettings, checked

if TYPE_CHECKING:
    from scara_effmass.impacts.agreement import MassFit
    from scara_effmass.values import FloatArray

X = np.linspace(0.15, 0.35, 20)
GOOD = agreement(X, 450.0 * X)
MASSES = np.repeat([1.0, 2.0, 3.0], 4)
OBSTACLES = np.tile([0.5, 2.39, 3.72, 7.35], 3)
POSES = np.repeat(["a", "b", "c"], 4).tolist()
CLOCK = ClockOffset(impacts=20, offset=0.0004, low=0.0, high=0.001, resolution=0.0005, beyond=0)


def fit_of(masses: FloatArray = MASSES, gain: float = 1.0, exponent: float = 0.5, true: FloatArray = MASSES) -> MassFit:
    """Return the fit of exact impacts of a robot with `true` masses at 0.25 m/s."""
    mu = 1.0 / (1.0 / true + 1.0 / OBSTACLES)
    return fit_masses(gain * 0.25 * mu, np.full(12, 0.25), 400.0 * mu**exponent, masses, OBSTACLES, POSES)


SERIES = Series(GOOD, fit_of(), CLOCK, MASSES, OBSTACLES, one_pose=False, gain_tolerance=0.05)
FEW, NOTHING = replace(GOOD, count=5), agreement(X[:0], X[:0])


def test_true_series_is_accepted_without_a_reason() -> None:
    assert decide(CriterionSettings(), SERIES) == Acceptance(accepted=True, decidable=True, reason="")


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"agreement": replace(GOOD, correlation=0.94321)}, "correlation 0.9432 is below 0.95"),
        ({"agreement": replace(GOOD, relative_rmse=0.12345)}, "relative RMSE 0.1235 is above 0.1"),
        (
            {"agreement": replace(GOOD, shortfalls=2)},
            "2 of 20 impacts predicted more than 10% too low, at most 5% may be",
        ),
        ({"fit": fit_of(gain=1.2)}, "gain of the force 1.200 (1.190 to 1.210): must be within 5% of 1"),
        ({"fit": fit_of(gain=0.9)}, "gain of the force 0.900 (0.892 to 0.908): must be within 5% of 1"),
        (
            {"fit": fit_of(masses=0.8 * MASSES)},
            "the robot has 1.250 (1.233 to 1.268) times its model's mass, at most 10% off is tolerated",
        ),
        (
            {"fit": fit_of(masses=1.25 * MASSES)},
            "the robot has 0.800 (0.789 to 0.811) times its model's mass, at most 10% off is tolerated",
        ),
        (
            {"fit": fit_of(exponent=0.6)},
            "exponent 0.600 (0.594 to 0.606) does not cover 0.500 of the declared contact law",
        ),
        (
            {"clock": CLOCK._replace(offset=0.02, beyond=20)},
            "the joint states are +20.0 ms behind the force (median): 20 of 20 impacts exceed 5 ms",
        ),
        (
            {"clock": CLOCK._replace(offset=math.nan, low=-0.0439, high=0.045, beyond=20)},
            "the joint states and the force are apart by an unknown time, -43.9 to +45.0 ms by single impacts: 20",
        ),
        (
            {"agreement": replace(GOOD, correlation=0.0938), "clock": CLOCK._replace(offset=-0.0039)},
            "correlation 0.0938 is below 0.95; the joint states are -3.9 ms behind the force (median), which may be",
        ),
        ({"clock": CLOCK._replace(beyond=5)}, "the joint states are +0.4 ms behind the force (median): 5 of 20"),
        ({"fit": fit_of(masses=np.roll(MASSES, 4))}, "impulses scatter by 49.4%, at most 5% may be; largest for m_H"),
    ],
)
def test_wrong_series_is_rejected(changes: dict[str, Any], reason: str) -> None:
    decision = decide(CriterionSettings(), SERIES._replace(**changes))
    assert (decision.accepted, decision.decidable) == (False, True)
    assert decision.reason.startswith(reason)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"agreement": NOTHING}, "no impacts, at least 6 are required"),
        (
            {"agreement": NOTHING, "left_out": 12, "left_out_reason": "obstacle_mass is not given"},
            "no impacts, at least 6 are required; 12 left out: obstacle_mass is not given",
        ),
        ({"agreement": FEW}, "5 impacts, at least 6 are required"),
        (
            {"left_out": 21, "left_out_reason": "no contact state"},
            "20 impacts of 41 paired with the robot, at least 50% must be: no contact state",
        ),
        ({"fit": NO_FIT}, "the impacts do not state the impulse up to the peak; next: "),
        (
            {"obstacle_masses": np.full(12, 2.39)},
            "one obstacle mass (2.39 kg) cannot separate the robot's mass from the gain; next: an obstacle of m_H =",
        ),
        (
            {"obstacle_masses": np.full(12, np.inf)},
            "one obstacle mass (inf kg) cannot separate the robot's mass from the gain; next: an obstacle of m_H =",
        ),
        (
            {"one_pose": True},
            "one pose cannot show that the mass follows the pose; next: every obstacle in a second pose",
        ),
        (
            {"agreement": agreement(np.full(6, 0.3), np.full(6, 90.0))},
            "correlation undefined: all impacts are at the same v sqrt(mu); next: ",
        ),
        (
            {"clock": CLOCK._replace(impacts=9)},
            "the velocity shows the impact in 9 of 20 impacts: clock offset unknown; next: impacts at constant",
        ),
        (
            {"clock": CLOCK._replace(resolution=0.0051)},
            "the joint states resolve a clock offset of 5.1 ms only; next: joint states at 100 Hz",
        ),
        (
            {"fit": fit_of()._replace(detectable_mass_error=0.15)},
            "a mass error below 15% would not have been found; next: 27 combinations of pose and obstacle in place of",
        ),
        (
            {"fit": fit_of()._replace(mass_scale=1.08, mass_scale_interval=Interval(1.04, 1.12))},
            "mass scale 1.080 (1.040 to 1.120) is not clearly within 10% of 1; next: ",
        ),
        ({"fit": fit_of(gain=1.048)}, "gain of the force 1.048 (1.039 to 1.057) is not clearly within 5% of 1"),
        (
            {"fit": fit_of()._replace(exponent_interval=Interval(0.44, 0.55))},
            "exponent 0.500 (0.440 to 0.550) cannot tell contact laws apart; next: ",
        ),
    ],
)
def test_weak_series_is_not_decidable_and_says_what_to_measure(changes: dict[str, Any], reason: str) -> None:
    decision = decide(CriterionSettings(), SERIES._replace(**changes))
    assert (decision.accepted, decision.decidable) == (False, False)
    assert decision.reason.startswith(reason)


def test_a_problem_rejects_at_once() -> None:
    assert decide(CriterionSettings(), SERIES, "negative") == Acceptance(
        accepted=False, decidable=True, reason="negative"
    )


def test_limits_are_inclusive() -> None:
    series = replace(GOOD, correlation=0.95, relative_rmse=0.1, shortfalls=1)
    clock = CLOCK._replace(beyond=4, resolution=0.005)
    assert decide(CriterionSettings(), SERIES._replace(agreement=series, clock=clock, left_out=20)).accepted


@pytest.mark.parametrize("exponent_interval", [Interval(0.4, 0.5), Interval(0.5, 0.6)])
def test_limits_of_the_fit_are_inclusive(exponent_interval: Interval) -> None:
    limits = fit_of()._replace(
        scatter=0.05,
        detectable_mass_error=0.1,
        gain_interval=Interval(1.0 / 1.05, 1.05),
        mass_scale_interval=Interval(1.0 / 1.1, 1.1),
        exponent_interval=exponent_interval,
    )
    assert decide(CriterionSettings(), SERIES._replace(fit=limits)).accepted


@pytest.mark.parametrize("interval", [Interval(0.9, 1.0 / 1.05), Interval(1.05, 1.1)])
def test_gain_that_touches_the_tolerance_is_not_decidable(interval: Interval) -> None:
    decision = decide(CriterionSettings(), SERIES._replace(fit=fit_of()._replace(gain_interval=interval)))
    assert (decision.accepted, decision.decidable) == (False, False)


def test_a_single_light_obstacle_needs_another_light_one() -> None:
    """Half the lightest mass of the robot is light enough, but one obstacle cannot tell gain from mass."""
    decision = decide(CriterionSettings(), SERIES._replace(obstacle_masses=np.full(12, 0.5)))
    assert not decision.decidable
    assert "next: an obstacle of m_H = 0.25 kg or less, which fixes the gain, one of 9 kg or more" in decision.reason


@pytest.mark.parametrize(
    ("changes", "error", "steps"),
    [
        ({}, 0.11, "27 combinations of pose and obstacle in place of 12"),
        ({}, 0.2, "48 combinations of pose and obstacle in place of 12"),
        ({}, 0.9, "108 combinations of pose and obstacle in place of 12"),
        ({"fit": fit_of()._replace(cells=3)}, 0.2, "16 combinations of pose and obstacle in place of 3"),
        ({"obstacle_masses": 1.01 * OBSTACLES}, 0.2, "an obstacle of m_H = 0.25 kg or less, which fixes the gain"),
        (
            {"obstacle_masses": np.minimum(4.5, OBSTACLES)},
            0.2,
            "48 combinations of pose and obstacle in place of 12",
        ),
        ({"obstacle_masses": np.minimum(4.4, OBSTACLES)}, 0.2, "one of 9 kg or more, which shows the mass"),
        (
            {"clock": CLOCK._replace(impacts=19)},
            0.2,
            "impacts at constant speed, in contacts of 10 ms or less",
        ),
        (
            {"obstacle_masses": 2.0 * OBSTACLES, "clock": CLOCK._replace(impacts=19)},
            0.2,
            (
                "an obstacle of m_H = 0.25 kg or less, which fixes the gain, "
                "impacts at constant speed, in contacts of 10 ms or less"
            ),
        ),
    ],
)
def test_next_measurement_is_what_the_series_lacks(changes: dict[str, Any], error: float, steps: str) -> None:
    """Obstacles from half the lightest to 1.5 times the heaviest mass, and a kink in every impact, are enough."""
    series = SERIES._replace(**changes)
    decision = decide(CriterionSettings(), series._replace(fit=series.fit._replace(detectable_mass_error=error)))
    assert decision.reason == f"a mass error below {error:.0%} would not have been found; next: {steps}"


def test_stated_uncertainty_of_the_sensor_replaces_the_tolerance_of_the_gain() -> None:
    series = SERIES._replace(fit=fit_of(gain=1.1))
    assert not decide(CriterionSettings(), series).accepted
    assert decide(CriterionSettings(), series._replace(gain_tolerance=0.15)).accepted


def test_declared_contact_law_counts() -> None:
    hertz = SERIES._replace(fit=fit_of(exponent=0.6))
    assert decide(CriterionSettings(contact_exponent=1.5), hertz).accepted
    assert not decide(CriterionSettings(contact_exponent=1.5), SERIES).accepted


def test_too_small_stiffness_fails_by_shortfalls() -> None:
    """All forces are 15 % too small, which the correlation does not show."""
    series = agreement(X, 450.0 * X, (0.85 * 450.0) ** 2)
    assert series.correlation == pytest.approx(1.0)
    lenient = CriterionSettings(largest_relative_rmse=0.2)
    decision = decide(lenient, SERIES._replace(agreement=series))
    assert decision.reason == "20 of 20 impacts predicted more than 10% too low, at most 5% may be"


def test_non_conservative_half_of_a_fitted_series_is_accepted() -> None:
    rng = np.random.default_rng(0)
    series = agreement(X, 450.0 * X * (1.0 + rng.normal(0.0, 0.01, X.size)))
    assert series.non_conservative >= 5
    assert decide(CriterionSettings(), SERIES._replace(agreement=series)).accepted


def test_hash_is_of_the_canonical_json() -> None:
    text = (
        '{"contact_exponent":1.0,"gain_tolerance":0.05,"largest_clock_offset":0.005,"largest_relative_rmse":0.1,'
        '"largest_scatter":0.05,"largest_shortfall_share":0.05,"least_correlation":0.95,"least_count":6,'
        '"least_paired_share":0.5,"mass_tolerance":0.1,"shortfall_tolerance":0.1}'
    )
    assert criterion_hash(CriterionSettings()) == hashlib.sha256(text.encode()).hexdigest()[:16]
    assert criterion_hash(CriterionSettings(least_count=5)) != criterion_hash(CriterionSettings())


def test_settings_in_groups_are_checked() -> None:
    settings = checked(ValidatorSettings, {"criterion.least_count": 12, "stiffness_n_m": 200e3}, "params.yaml")
    assert (settings.criterion.least_count, settings.stiffness_n_m) == (12, 200e3)
    with pytest.raises(SettingsError, match=r"params.yaml: criterion.least_correlation = 2.0: .* less than or equal"):
        checked(ValidatorSettings, {"criterion.least_correlation": 2.0}, "params.yaml")


def test_best_model_is_first() -> None:
    wrong = agreement(X, 450.0 * X[::-1])
    comparison = compare({"iso": wrong, "lumped": GOOD}, same_mass=False)
    assert list(comparison.relative_rmse) == ["lumped", "iso"]
    assert comparison.text.startswith("lumped explains the forces best; relative RMSE lumped 0.0000 (r 1.0000), iso 0.")
    assert comparison.count == 20


def test_equally_good_models_are_both_named() -> None:
    rng = np.random.default_rng(0)
    full = agreement(X, 450.0 * X * (1.0 + rng.normal(0.0, 0.02, X.size)))
    both = compare({"lumped": replace(full, relative_rmse=full.relative_rmse * 1.05), "full": full}, same_mass=False)
    assert list(both.relative_rmse) == ["full", "lumped"]
    assert both.text.startswith("full and lumped explain the forces equally well, as far as 20 impacts tell; ")


@pytest.mark.parametrize("count", [3, 12, 36])
def test_random_errors_rarely_prefer_a_model(count: int) -> None:
    """For two models with independent errors of equal size, one of 20 series may prefer one of them."""
    rng = np.random.default_rng(count)
    x = np.linspace(0.1, 0.4, count)

    def scattered() -> Agreement:
        return agreement(x, 450.0 * x + rng.normal(0.0, 1.0, count))

    texts = [compare({"lumped": scattered(), "full": scattered()}, same_mass=False).text for _ in range(400)]
    assert sum("explains the forces best" in text for text in texts) < 0.09 * len(texts)


def test_nothing_to_compare() -> None:
    assert compare({"lumped": GOOD}, same_mass=False).text.endswith("nothing to compare")
    assert compare({}, same_mass=False).count == 0
    single = agreement(X[:1], X[:1])
    assert compare({"lumped": single, "iso": single}, same_mass=False).text.endswith("nothing to compare")
    same = compare({"lumped": GOOD, "iso": GOOD}, same_mass=True)
    assert "the models cannot be told apart" in same.text
