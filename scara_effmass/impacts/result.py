"""Result of a validation series."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

from scara_effmass.values import RefusedImpact, ValidatedImpact

if TYPE_CHECKING:
    from scara_effmass.impacts.agreement import Agreement
    from scara_effmass.impacts.criterion import Comparison


class ModelResult(NamedTuple):
    """Agreement of one effective-mass model with the series, overall and by group.

    Group predictions use the stiffness of the whole series. `reason` states why the model is not accepted.
    """

    model: str
    overall: Agreement
    by_configuration: Mapping[str, Agreement]
    by_obstacle_mass: Mapping[float, Agreement]
    accepted: bool
    reason: str


class Result(NamedTuple):
    """Whole series; `seen` = number of `impacts` + sums of `excluded` and `unpaired` + `waiting`.

    `model` is the selected effective-mass model; `accepted` and `reason` refer to it. `models` are lumped, full, iso,
    and largest if selected. Predictions in `impacts` use the stiffness of the whole series. `excluded` and `unpaired`
    count by reason, `refused` lists each impact. `clock` and `force_sign` describe a problem with the clocks or the
    sign of the force; empty: none detected.
    """

    model: str
    contact_point: str
    models: tuple[ModelResult, ...]
    comparison: Comparison
    impacts: tuple[ValidatedImpact, ...]
    refused: tuple[RefusedImpact, ...]
    seen: int
    waiting: int
    simulated: int
    excluded: Mapping[str, int]
    unpaired: Mapping[str, int]
    other_contact_points: tuple[str, ...]
    late_states: int
    clock: str
    force_sign: str
    accepted: bool
    reason: str
    criterion_hash: str
