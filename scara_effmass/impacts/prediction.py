"""Predicted peak force of matched impacts, and the comparison of the effective-mass models."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtri

from scara_effmass.impacts.agreement import CONFIDENCE, MIN_RELATIVE_RANGE, Agreement, agreement, is_conservative
from scara_effmass.impacts.impact_matcher import MatchedImpact
from scara_effmass.iso15066 import force_per_root_stiffness, peak_force
from scara_effmass.values import Prediction


@dataclass(frozen=True, slots=True)
class Comparison:
    """Relative RMSE of the models on the same `count` impacts, best first; `text` states the result."""

    count: int
    relative_rmse: Mapping[str, float]
    text: str


def predict(model: str, match: MatchedImpact, stiffness: float) -> Prediction:
    """Return the prediction F = v sqrt(mu k) with `stiffness` [N/m]; `model` must have a mass."""
    mu, measured = match.reduced_mass(model), match.impact.peak_force
    force = peak_force(match.state.speed, mu, stiffness)
    return Prediction(
        model=model,
        effective_mass=match.state.masses[model],
        reduced_mass=mu,
        stiffness=stiffness,
        predicted_force=force,
        relative_error=(force - measured) / measured,
        conservative=is_conservative(force, measured),
    )


def model_agreement(model: str, matches: Iterable[MatchedImpact], *options: float) -> Agreement:
    """Return `agreement` of `model`, with its `options`, over the matches for which it has a mass."""
    usable = [match for match in matches if match.has_mass(model)]
    x = np.array([force_per_root_stiffness(match.state.speed, match.reduced_mass(model)) for match in usable])
    return agreement(x, np.array([match.impact.peak_force for match in usable]), *options)


def compare_models(models: Iterable[str], matches: Sequence[MatchedImpact]) -> Comparison:
    """Rank the models that have a mass by relative RMSE, on the impacts for which all of them have one.

    Each model has its own fitted stiffness. Models are not told apart if no reduced mass varies over the series.
    """
    present = [model for model in models if any(match.has_mass(model) for match in matches)]
    common = [match for match in matches if all(match.has_mass(model) for model in present)]
    masses = [np.array([match.reduced_mass(model) for match in common]) for model in present]
    same_mass = bool(common) and all(np.ptp(mu) <= MIN_RELATIVE_RANGE * mu.max() for mu in masses)
    return compare({model: model_agreement(model, common) for model in present}, same_mass=same_mass)


def compare(agreements: Mapping[str, Agreement], *, same_mass: bool) -> Comparison:
    """Rank the models by relative RMSE.

    `agreements` by model must be on the same impacts, each with the fitted stiffness. `same_mass`: no model's reduced
    mass varies over the series.
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


def _max_rmse_ratio(count: int) -> float:
    """Return the 95 % limit of the ratio of two RMSE over `count` impacts with equal error variance.

    Snedecor's F assumes independent errors; errors on the same impacts correlate, so their ratio is smaller.
    """
    return math.sqrt(fdtri(count - 1, count - 1, (1.0 + CONFIDENCE) / 2.0))
