"""The acceptance criterion, and which model explains the forces best."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from scipy.special import fdtri

from scara_effmass.impacts.agreement import CONFIDENCE

if TYPE_CHECKING:
    from collections.abc import Mapping

    from scara_effmass.impacts.agreement import Agreement
    from scara_effmass.settings import CriterionSettings


def criterion_hash(criterion: CriterionSettings) -> str:
    """Return 16 hexadecimal digits of the SHA-256 of the criterion as canonical JSON (sorted keys, no blanks)."""
    text = json.dumps(criterion.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def shortcoming(criterion: CriterionSettings, found: Agreement, unpaired: int) -> str:
    """Return the first figure that fails, with its value and its limit; empty when the series is accepted."""
    count, total = found.count, found.count + unpaired
    too_low = (
        f"{found.shortfalls} of {_impacts(count)} predicted more than {criterion.shortfall_tolerance:.0%} too low, "
        f"at most {criterion.largest_shortfall_share:.0%} may be"
    )
    checks = (
        (count < criterion.least_count, f"{_impacts(count)}, at least {criterion.least_count} are required"),
        (
            count < criterion.least_paired_share * total,
            f"{_impacts(count)} of {total} paired with the robot, at least {criterion.least_paired_share:.0%} must be",
        ),
        (bool(found.correlation_reason), f"correlation undefined: {found.correlation_reason}"),
        (
            found.correlation < criterion.least_correlation,
            f"correlation {found.correlation:.4f} is below {criterion.least_correlation:g}",
        ),
        (
            found.relative_rmse > criterion.largest_relative_rmse,
            f"relative RMSE {found.relative_rmse:.4f} is above {criterion.largest_relative_rmse:g}",
        ),
        (found.shortfalls > criterion.largest_shortfall_share * count, too_low),
    )
    return next((reason for fails, reason in checks if fails), "")


class Fit(NamedTuple):
    """How well one model explains the measured forces, with the stiffness that suits it best."""

    model: str
    relative_rmse: float
    correlation: float
    stiffness: float


@dataclass(frozen=True, slots=True)
class Comparison:
    """The models on the same `count` impacts, the best one first, and that in words."""

    count: int
    order: tuple[Fit, ...]
    text: str


def compare(found: Mapping[str, Agreement], *, same_mass: bool) -> Comparison:
    """Return the order of the models by RMSE over the mean force.

    `found`, by model, is on the same impacts, each model with the stiffness that fits it best. `same_mass`: no model's
    reduced mass varies over the series.
    """
    fits = [Fit(model, a.relative_rmse, a.correlation, a.stiffness) for model, a in found.items()]
    order = tuple(sorted(fits, key=lambda fit: fit.relative_rmse))
    count = min((a.count for a in found.values()), default=0)
    numbers = ", ".join(f"{fit.model} {fit.relative_rmse:.4f} (r {fit.correlation:.4f})" for fit in order)
    if count < 2 or len(order) < 2:
        text = "no two models on at least two same impacts: nothing to compare"
    elif same_mass:
        text = f"all impacts at the same reduced mass: the models cannot be told apart; relative RMSE {numbers}"
    else:
        best = [fit.model for fit in order if fit.relative_rmse <= _by_chance(count) * order[0].relative_rmse]
        if len(best) == 1:
            text = f"{best[0]} explains the forces best; relative RMSE {numbers}"
        else:
            equally = f"equally well, as far as {count} impacts tell"
            text = f"{' and '.join(best)} explain the forces {equally}; relative RMSE {numbers}"
    return Comparison(count, order, text)


def _by_chance(count: int) -> float:
    """Return the ratio of two RMSE, of errors of one size, that 95 % of series of `count` impacts stay below.

    By Snedecor's F, for independent errors; those of models on the same impacts are alike, and differ less.
    """
    return math.sqrt(fdtri(count - 1, count - 1, (1.0 + CONFIDENCE) / 2.0))


def _impacts(count: int) -> str:
    return "1 impact" if count == 1 else f"{count} impacts" if count else "no impacts"
