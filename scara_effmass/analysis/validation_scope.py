"""Scope and limits of validity of a validation, in words."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from scara_effmass.impacts.result import Result
from scara_effmass.settings import CriterionSettings

if TYPE_CHECKING:
    from scara_effmass.analysis.validation import Validation, ValidationSettings
    from scara_effmass.model.robot import Robot

NO_PROOF = (
    "This report compares a model of the collision force with the impacts below. It is not a certified safety function "
    "and does not prove that a cell conforms to a standard."
)
LAW = (
    "F = v √(μ k) is valid for a free, linear, undamped contact. Damping, friction, the reaction of the drives and a "
    "wrong mass all cause deviations. The exponent and the stiffness of each group show the size of the deviation, not "
    "its cause. A clamped contact is not covered."
)
FITTED = (
    "The stiffness of each model is fitted to these impacts. The statistics therefore test how the force varies with "
    "speed and mass, not its level, and the bias is near zero by construction. Use a stiffness measured beforehand "
    "(--stiffness) to test the level as well."
)
INTERVALS = "Intervals are at 95 % and assume independent impacts and normal residuals."
ROTORS = (
    "The masses do not include the reflected inertia of rotors and gears: neither the robot file nor the setting "
    "armature states it. A real robot that is pushed back during the contact has a larger effective mass."
)


def origin(result: Result) -> str:
    """Return the origin of the forces."""
    if not result.impacts:
        return "nothing: no impact could be paired with the robot"
    if not result.simulated:
        return "measured impacts"
    if result.simulated == len(result.impacts):
        return "simulated impacts; nothing was measured on a robot"
    return f"{result.simulated} simulated and {len(result.impacts) - result.simulated} measured impacts"


def demands(criterion: CriterionSettings) -> list[str]:
    """Return the acceptance criterion in words."""
    tolerance = _percent(criterion.shortfall_tolerance)
    return [
        f"at least {criterion.least_count} impacts",
        f"correlation of force and v √μ at least {criterion.least_correlation:g}",
        f"RMSE at most {_percent(criterion.largest_relative_rmse)} of the mean force",
        f"at most {_percent(criterion.largest_shortfall_share)} of the predictions more than {tolerance} too low",
        f"at least {_percent(criterion.least_paired_share)} of the impacts paired with the robot",
    ]


def limits(validation: Validation, settings: ValidationSettings, robot: Robot) -> Iterator[str]:
    """Yield the limits of validity, a sentence or two each."""
    result = validation.result
    if result.simulated:
        which = "All" if result.simulated == len(result.impacts) else f"{result.simulated} of the"
        yield (
            f"{which} {len(result.impacts)} impacts are simulated. Agreement with them verifies the mechanics of a "
            "model, not the parameters of a real robot, sensor or contact."
        )
    yield NO_PROOF
    yield LAW
    stiffness = settings.validator.stiffness
    yield FITTED if not stiffness else f"All models use the specified stiffness of {stiffness:g} N/mm."
    yield INTERVALS
    if result.impacts:
        yield _tested_ranges(result)
    yield from _force_uncertainty(validation)
    if not np.any(robot.model.armature):
        yield ROTORS
    yield from (f"Robot file: {note}" for note in robot.notes)


def _tested_ranges(result: Result) -> str:
    impacts = result.impacts
    speeds = _span((1e3 * impact.speed for impact in impacts), "mm/s")
    obstacles = _span((impact.obstacle_mass for impact in impacts), "kg")
    masses = _span((impact.effective_mass for impact in impacts), "kg")
    configurations = len({impact.configuration for impact in impacts})
    forces = _span((impact.measured_force for impact in impacts), "N")
    return (
        f"Valid only for the tested ranges: speeds of {speeds}, obstacles of {obstacles}, effective masses "
        f"of {masses}, forces of {forces}, {_counted(configurations, 'configuration')}."
    )


def _force_uncertainty(validation: Validation) -> Iterator[str]:
    stated = max((recording.relative_uncertainty for recording in validation.recordings), default=0.0)
    if stated:
        yield (
            f"The calibration uncertainty of the force is ±{_percent(stated)}. The fitted stiffness has twice that "
            "uncertainty; correlation and exponent are not affected."
        )
    elif validation.result.simulated < len(validation.result.impacts):
        yield "The recordings do not state the calibration uncertainty of the force sensor."


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def _percent(share: float) -> str:
    return f"{100.0 * share:g} %"


def _span(values: Iterable[float], unit: str) -> str:
    ordered = sorted(values)
    low, high = f"{ordered[0]:.3g}", f"{ordered[-1]:.3g}"
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"
