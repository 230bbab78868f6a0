"""What the models of the effective mass say of paired impacts, one by one and as a series."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from scara_effmass.impacts.agreement import SAME, agreement, is_conservative
from scara_effmass.impacts.criterion import compare
from scara_effmass.impacts.robot_track import MODELS
from scara_effmass.iso15066 import force_per_root_stiffness, peak_force, reduced_mass
from scara_effmass.settings import MassModel
from scara_effmass.values import Prediction

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from scara_effmass.impacts.agreement import Agreement
    from scara_effmass.impacts.criterion import Comparison
    from scara_effmass.impacts.pairing import Paired


def mass(model: str, pair: Paired) -> float:
    """Return the effective mass at the onset [kg]; NaN, or 0, where the model has none."""
    masses = dict(zip(MODELS, pair.state.masses, strict=True))
    if model == MassModel.LARGEST.value:
        # NaN where one of the two has no mass: the larger of them is then not known.
        return float(np.maximum(masses["lumped"], masses["full"]))
    return masses[model]


def reduced_mass_of(model: str, pair: Paired) -> float:
    """Return (1 / m_n + 1 / m_H)^-1 [kg]."""
    return reduced_mass(mass(model, pair), pair.run.obstacle_mass)


def predicted(model: str, pair: Paired, stiffness: float) -> Prediction:
    """Return the peak force that `model`, which has a mass, predicts with `stiffness` [N/m]: F = v sqrt(mu k)."""
    mu, measured = reduced_mass_of(model, pair), pair.impact.peak_force
    force = peak_force(pair.state.speed, mu, stiffness)
    spreads = dict(zip(MODELS, pair.state.mass_spreads, strict=True))
    return Prediction(
        model=model,
        effective_mass=mass(model, pair),
        mass_spread=spreads.get(model, max(spreads["lumped"], spreads["full"])),
        reduced_mass=mu,
        stiffness=stiffness,
        predicted_force=force,
        relative_error=(force - measured) / measured,
        conservative=is_conservative(force, measured),
    )


def has_mass(model: str, pair: Paired) -> bool:
    """Return whether `model` has a mass at the onset."""
    return 0.0 < mass(model, pair) < math.inf


def agreement_of(
    model: str, pairs: Iterable[Paired], stiffness: float = 0.0, shortfall_tolerance: float = 0.1
) -> Agreement:
    """Return the agreement of `model` over those of `pairs` for which it has a mass; as `agreement`."""
    usable = [pair for pair in pairs if has_mass(model, pair)]
    x = np.array([force_per_root_stiffness(pair.state.speed, reduced_mass_of(model, pair)) for pair in usable])
    force = np.array([pair.impact.peak_force for pair in usable])
    return agreement(x, force, stiffness, shortfall_tolerance)


def comparison_of(models: Iterable[str], pairs: Sequence[Paired]) -> Comparison:
    """Compare those of `models` that have any mass at all, on the impacts for which they all have one."""
    present = [model for model in models if any(has_mass(model, pair) for pair in pairs)]
    common = [pair for pair in pairs if all(has_mass(model, pair) for model in present)]
    masses = [np.array([reduced_mass_of(model, pair) for pair in common]) for model in present]
    same_mass = bool(common) and all(np.ptp(mu) <= SAME * mu.max() for mu in masses)
    return compare({model: agreement_of(model, common) for model in present}, same_mass=same_mass)
