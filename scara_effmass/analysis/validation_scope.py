"""What a validation may be taken for, and what not."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from scara_effmass.analysis.validation import Validation, ValidationSettings
    from scara_effmass.impacts.result import Result
    from scara_effmass.model.robot import Robot
    from scara_effmass.settings import CriterionSettings

NO_PROOF = (
    "This judges a model of the collision force by the impacts below. It is no certified safety function and no proof "
    "that a cell conforms to a standard."
)
LAW = (
    "F = v √(μ k) holds for a free, linear, undamped contact. Damping, friction, and the reaction of the drives bend "
    "it, and a mass that is off looks the same: the exponent and each group's own stiffness show by how much, not "
    "which of them it is. A clamped contact is another case."
)
FITTED = (
    "Each model's stiffness is fitted to these very impacts. So the figures judge how the force varies with speed and "
    "mass, not how large it is, and the bias is near zero by construction. With a stiffness measured beforehand "
    "(--stiffness) the level is judged as well."
)
INTERVALS = "Intervals are at 95 % and take the impacts for independent and their residuals for normal."
ROTORS = (
    "The masses leave out what rotors and gears reflect to the joints: neither the robot file nor the setting armature "
    "states it. A real robot that is pushed back during the contact feels heavier."
)


def origin(result: Result) -> str:
    """Return in a few words where the forces come from."""
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
            f"{which} {len(result.impacts)} impacts are simulated. That a model agrees with them shows that its "
            "mechanics are right, not that its numbers are those of a real robot, sensor or contact."
        )
    yield NO_PROOF
    yield LAW
    given = settings.validator.stiffness
    yield FITTED if not given else f"All models predict with the given stiffness of {given:g} N/mm."
    yield INTERVALS
    if result.impacts:
        yield _covered(result)
    yield from _force_uncertainty(validation)
    if not np.any(robot.model.armature):
        yield ROTORS
    yield from (f"Robot file: {note}" for note in robot.notes)


def _covered(result: Result) -> str:
    impacts = result.impacts
    speeds = _span((1e3 * impact.speed for impact in impacts), "mm/s")
    obstacles = _span((impact.obstacle_mass for impact in impacts), "kg")
    masses = _span((impact.effective_mass for impact in impacts), "kg")
    configurations = len({impact.configuration for impact in impacts})
    forces = _span((impact.measured_force for impact in impacts), "N")
    return (
        f"Nothing is said outside of what was covered: speeds of {speeds}, obstacles of {obstacles}, effective masses "
        f"of {masses}, forces of {forces}, {_counted(configurations, 'configuration')}."
    )


def _force_uncertainty(validation: Validation) -> Iterator[str]:
    stated = max((recording.relative_uncertainty for recording in validation.recordings), default=0.0)
    if stated:
        yield (
            f"The force is known to ±{_percent(stated)} (calibration of the sensor). That goes into the fitted "
            "stiffness, twice as large, and leaves correlation and exponent alone."
        )
    elif validation.result.simulated < len(validation.result.impacts):
        yield "The recordings do not say how well the force sensor is calibrated."


def _counted(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def _percent(share: float) -> str:
    return f"{100.0 * share:g} %"


def _span(values: Iterable[float], unit: str) -> str:
    found = sorted(values)
    low, high = f"{found[0]:.3g}", f"{found[-1]:.3g}"
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"
