"""Deviation of the estimates from the ground truth of simulated recordings."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator

    from scara_effmass.analysis.validation import ValidatedRecording, Validation
    from scara_effmass.values import ValidatedImpact

LINEAR = 1.0
"""Exponent of a linear spring."""


class Deviation(NamedTuple):
    """Estimate / true value - 1 of one quantity: mean over the `impacts`, and the value farthest from zero."""

    quantity: str
    impacts: int
    mean: float
    farthest: float


def deviations(validation: Validation) -> list[Deviation]:
    """Return the deviations over all recordings of a single impact that state the true values."""
    by_quantity: dict[str, list[float]] = {}
    for recording in validation.recordings:
        for quantity, deviation in _recording_deviations(recording):
            by_quantity.setdefault(quantity, []).append(deviation)
    return [
        Deviation(quantity, len(values), sum(values) / len(values), max(values, key=abs))
        for quantity, values in by_quantity.items()
    ]


def stated_stiffness(validation: Validation) -> float | None:
    """Return the stiffness [N/m] of the simulated contact; None if unknown, not unique, or not a linear spring."""
    infos = [info for recording in validation.recordings for info in recording.infos]
    contacts = {(info.contact_stiffness, info.contact_exponent) for info in infos}
    ((stiffness, exponent),) = contacts if len(contacts) == 1 else ((0.0, 0.0),)
    return stiffness if exponent == LINEAR and 0.0 < stiffness < math.inf else None


def _recording_deviations(recording: ValidatedRecording) -> Iterator[tuple[str, float]]:
    if len(recording.impacts) != 1 or len(recording.infos) != 1:
        return
    info = recording.infos[0]
    truth = (info.true_speed, info.true_effective_mass, info.true_peak_force)
    if all(0.0 < value < math.inf for value in truth):
        yield from _impact_deviations(recording.impacts[0], *truth)


def _impact_deviations(
    impact: ValidatedImpact, speed: float, effective_mass: float, peak_force: float
) -> Iterator[tuple[str, float]]:
    yield "speed at the onset", impact.speed / speed - 1.0
    yield "peak force", impact.measured_force / peak_force - 1.0
    for prediction in impact.predictions:
        yield f"effective mass, {prediction.model}", prediction.effective_mass / effective_mass - 1.0
