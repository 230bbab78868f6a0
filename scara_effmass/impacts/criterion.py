"""Acceptance criterion, and comparison of the effective-mass models."""

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from scipy.special import fdtri

from scara_effmass.impacts.agreement import CONFIDENCE, Agreement
from scara_effmass.settings import CriterionSettings


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


class Fit(NamedTuple):
    """Agreement of one model with the measured forces, with its own fitted stiffness [N/m]."""

    model: str
    relative_rmse: float
    correlation: float
    stiffness: float


@dataclass(frozen=True, slots=True)
class Comparison:
    """Models on the same `count` impacts, best first; `text` states the result."""

    count: int
    order: tuple[Fit, ...]
    text: str


def compare(agreements: Mapping[str, Agreement], *, same_mass: bool) -> Comparison:
    """Rank the models by relative RMSE.

    `agreements` by model must be on the same impacts, each with the fitted stiffness. `same_mass`: no model's reduced
    mass varies over the series.
    """
    fits = [Fit(model, a.relative_rmse, a.correlation, a.stiffness) for model, a in agreements.items()]
    order = tuple(sorted(fits, key=lambda fit: fit.relative_rmse))
    count = min((a.count for a in agreements.values()), default=0)
    numbers = ", ".join(f"{fit.model} {fit.relative_rmse:.4f} (r {fit.correlation:.4f})" for fit in order)
    if count < 2 or len(order) < 2:
        text = "no two models on at least two same impacts: nothing to compare"
    elif same_mass:
        text = f"all impacts at the same reduced mass: the models cannot be told apart; relative RMSE {numbers}"
    else:
        best = [fit.model for fit in order if fit.relative_rmse <= _max_rmse_ratio(count) * order[0].relative_rmse]
        if len(best) == 1:
            text = f"{best[0]} explains the forces best; relative RMSE {numbers}"
        else:
            equally = f"equally well, as far as {count} impacts tell"
            text = f"{' and '.join(best)} explain the forces {equally}; relative RMSE {numbers}"
    return Comparison(count, order, text)


def _max_rmse_ratio(count: int) -> float:
    """Return the 95 % limit of the ratio of two RMSE over `count` impacts with equal error variance.

    Snedecor's F assumes independent errors; errors on the same impacts correlate, so their ratio is smaller.
    """
    return math.sqrt(fdtri(count - 1, count - 1, (1.0 + CONFIDENCE) / 2.0))


def _impacts(count: int) -> str:
    return "1 impact" if count == 1 else f"{count} impacts" if count else "no impacts"
