"""Predicted peak force of matched impacts, and agreement of each effective-mass model over a series."""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from scara_effmass.impacts.agreement import MIN_RELATIVE_RANGE, Agreement, agreement, is_conservative
from scara_effmass.impacts.criterion import Comparison, compare
from scara_effmass.impacts.impact_matcher import MatchedImpact
from scara_effmass.impacts.state_history import MODELS
from scara_effmass.iso15066 import force_per_root_stiffness, peak_force, reduced_mass
from scara_effmass.settings import MassModel
from scara_effmass.values import Prediction


def effective_mass(model: str, match: MatchedImpact) -> float:
    """Return the effective mass at the onset [kg]; NaN or 0 if the model has none."""
    masses = dict(zip(MODELS, match.state.masses, strict=True))
    if model == MassModel.LARGEST.value:
        # NaN if either has no mass: the maximum is then unknown.
        return float(np.maximum(masses["lumped"], masses["full"]))
    return masses[model]


def model_reduced_mass(model: str, match: MatchedImpact) -> float:
    """Return (1 / m_n + 1 / m_H)^-1 [kg]."""
    return reduced_mass(effective_mass(model, match), match.run.obstacle_mass)


def predict(model: str, match: MatchedImpact, stiffness: float) -> Prediction:
    """Return the prediction F = v sqrt(mu k) with `stiffness` [N/m]; `model` must have a mass."""
    mu, measured = model_reduced_mass(model, match), match.impact.peak_force
    force = peak_force(match.state.speed, mu, stiffness)
    spreads = dict(zip(MODELS, match.state.mass_spreads, strict=True))
    return Prediction(
        model=model,
        effective_mass=effective_mass(model, match),
        mass_spread=spreads.get(model, max(spreads["lumped"], spreads["full"])),
        reduced_mass=mu,
        stiffness=stiffness,
        predicted_force=force,
        relative_error=(force - measured) / measured,
        conservative=is_conservative(force, measured),
    )


def has_mass(model: str, match: MatchedImpact) -> bool:
    """Return whether `model` has a mass at the onset."""
    return 0.0 < effective_mass(model, match) < math.inf


def model_agreement(
    model: str, matches: Iterable[MatchedImpact], stiffness: float = 0.0, shortfall_tolerance: float = 0.1
) -> Agreement:
    """Return `agreement` of `model` over the matches for which it has a mass."""
    usable = [match for match in matches if has_mass(model, match)]
    x = np.array([force_per_root_stiffness(match.state.speed, model_reduced_mass(model, match)) for match in usable])
    force = np.array([match.impact.peak_force for match in usable])
    return agreement(x, force, stiffness, shortfall_tolerance)


def compare_models(models: Iterable[str], matches: Sequence[MatchedImpact]) -> Comparison:
    """Compare the models that have a mass, on the impacts for which all of them have one."""
    present = [model for model in models if any(has_mass(model, match) for match in matches)]
    common = [match for match in matches if all(has_mass(model, match) for model in present)]
    masses = [np.array([model_reduced_mass(model, match) for match in common]) for model in present]
    same_mass = bool(common) and all(np.ptp(mu) <= MIN_RELATIVE_RANGE * mu.max() for mu in masses)
    return compare({model: model_agreement(model, common) for model in present}, same_mass=same_mass)
