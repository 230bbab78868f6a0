"""What a whole series of impacts has shown."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Mapping

    from scara_effmass.impacts.agreement import Agreement
    from scara_effmass.impacts.criterion import Comparison
    from scara_effmass.values import RefusedImpact, ValidatedImpact


class ModelResult(NamedTuple):
    """How one model of the effective mass agrees with the series, over all and by group.

    The groups are predicted with the stiffness of the whole series. `reason` is why the model is not accepted.
    """

    model: str
    overall: Agreement
    by_configuration: Mapping[str, Agreement]
    by_obstacle_mass: Mapping[float, Agreement]
    accepted: bool
    reason: str


class Result(NamedTuple):
    """A whole series. `seen` = the number of `impacts` + the sums over `excluded` and `unpaired` + `waiting`.

    `models` are lumped, full, iso, and largest where that is judged. `impacts` are predicted with the stiffness of the
    whole series. `excluded` and `unpaired` count by reason, `refused` has them one by one. `clock` and `force_sign` say
    what is wrong with the clocks and with the sign of the force, empty when nothing is known to be. `accepted` and
    `reason` are of `model`, the judged one.
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
