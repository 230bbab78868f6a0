"""Acceptance criterion: the first unmet condition is reported with its value and limit."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from scara_effmass.errors import SettingsError
from scara_effmass.impacts.agreement import Agreement, agreement, compare, criterion_hash, unmet_criterion
from scara_effmass.settings import CriterionSettings, ValidatorSettings, checked

if TYPE_CHECKING:
    from scara_effmass.impacts.agreement import Agreement

X = np.linspace(0.15, 0.35, 20)
GOOD = agreement(X, 450.0 * X)


def test_accepted_without_a_reason() -> None:
    assert unmet_criterion(CriterionSettings(), GOOD, 0) == ""


@pytest.mark.parametrize(
    ("series", "unpaired", "reason"),
    [
        (agreement(X[:0], X[:0]), 0, "no impacts, at least 3 are required"),
        (agreement(X[:1], 450.0 * X[:1]), 0, "1 impact, at least 3 are required"),
        (agreement(X[:2], 450.0 * X[:2]), 9, "2 impacts, at least 3 are required"),
        (GOOD, 21, "20 impacts of 41 paired with the robot, at least 50% must be"),
        (
            agreement(np.full(5, 0.3), np.full(5, 90.0)),
            0,
            "correlation undefined: all impacts are at the same v sqrt(mu)",
        ),
        (replace(GOOD, correlation=0.94321), 0, "correlation 0.9432 is below 0.95"),
        (replace(GOOD, relative_rmse=0.12345), 0, "relative RMSE 0.1235 is above 0.1"),
        (replace(GOOD, shortfalls=2), 0, "2 of 20 impacts predicted more than 10% too low, at most 5% may be"),
    ],
)
def test_first_unmet_condition_is_reported(series: Agreement, unpaired: int, reason: str) -> None:
    assert unmet_criterion(CriterionSettings(), series, unpaired) == reason


def test_limits_are_inclusive() -> None:
    series = replace(GOOD, correlation=0.95, relative_rmse=0.1, shortfalls=1)
    assert unmet_criterion(CriterionSettings(), series, 20) == ""


def test_too_small_stiffness_fails_by_shortfalls() -> None:
    """15 % too little force everywhere: the correlation cannot see it."""
    series = agreement(X, 450.0 * X, (0.85 * 450.0) ** 2)
    assert series.correlation == pytest.approx(1.0)
    lenient = CriterionSettings(largest_relative_rmse=0.2)
    assert unmet_criterion(lenient, series, 0) == "20 of 20 impacts predicted more than 10% too low, at most 5% may be"


def test_non_conservative_half_of_a_fitted_series_is_accepted() -> None:
    rng = np.random.default_rng(0)
    series = agreement(X, 450.0 * X * (1.0 + rng.normal(0.0, 0.01, X.size)))
    assert series.non_conservative >= 5
    assert unmet_criterion(CriterionSettings(), series, 0) == ""


def test_hash_is_of_the_canonical_json() -> None:
    text = (
        '{"largest_relative_rmse":0.1,"largest_shortfall_share":0.05,"least_correlation":0.95,"least_count":3,'
        '"least_paired_share":0.5,"shortfall_tolerance":0.1}'
    )
    assert criterion_hash(CriterionSettings()) == hashlib.sha256(text.encode()).hexdigest()[:16]
    assert criterion_hash(CriterionSettings(least_count=4)) != criterion_hash(CriterionSettings())


def test_settings_in_groups_are_checked() -> None:
    settings = checked(ValidatorSettings, {"criterion.least_count": 12, "stiffness": 200.0}, "params.yaml")
    assert (settings.criterion.least_count, settings.stiffness) == (12, 200.0)
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
    """Two models with independent errors of one size: one of 20 series may tell them apart."""
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
