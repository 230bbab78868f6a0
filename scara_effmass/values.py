"""The values that cross rooms: immutable, SI units, float64, time in integer nanoseconds.

Named tuples, not dataclasses, because one of each is made per cycle and they cost a third.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Vector3 = tuple[float, float, float]

NAN = float("nan")


class JointState(NamedTuple):
    """One `sensor_msgs/JointState`, as it was received: nothing about it has been checked.

    `position` and `velocity` are read-only, in [rad] or [m] and per second; a sender may leave either empty.
    """

    stamp_ns: int
    names: tuple[str, ...]
    position: FloatArray
    velocity: FloatArray


class Verdict(IntEnum):
    """What is said of a contact point; the numbers are the constants of `ContactState.msg`."""

    UNKNOWN = 0
    OK = 1
    WARN = 2
    VIOLATION = 3


class ContactAssessment(NamedTuple):
    """One contact point at one joint state: `ContactState.msg`, field by field.

    `lumped_mass` and `full_mass` [kg] are NaN when that model does not exist for the robot. Under UNKNOWN,
    what could not be computed is 0. Masses and `predicted_force` [N] are nominal; `allowable_speed` [m/s]
    and `margin` [m/s] include the uncertainty margins, on the safe side.
    """

    stamp_ns: int
    contact_point: str
    direction: Vector3
    speed: float
    effective_mass: float
    lumped_mass: float
    full_mass: float
    iso_mass: float
    worst_direction_mass: float
    obstacle_mass: float
    reduced_mass: float
    stiffness: float
    predicted_force: float
    allowable_speed: float
    margin: float
    body_region: str
    criterion: str
    verdict: Verdict
    reason: str
    input_age: float
    worst_direction_used: bool
    mass_capped: bool
    smallest_singular_value: float


class Decision(NamedTuple):
    """What the monitor publishes for one joint state, or for the lack of one.

    `allowable_speed` [m/s] and `speed_scaling` [0-1] are those of the tightest contact point, and 0 when
    any contact point is UNKNOWN.
    """

    contacts: tuple[ContactAssessment, ...]
    allowable_speed: float
    speed_scaling: float


class ForceBlock(NamedTuple):
    """Consecutive samples of one force channel: `ForceBlock.msg`, field by field.

    `force` (n,) is read-only, in [N], compression positive, tare subtracted; `saturated_samples` are the indices
    into it of the samples at the end of the measuring range.
    """

    stamp_ns: int
    frame_id: str
    first_sample: int
    sample_rate: float
    force: FloatArray
    lost_samples: int
    saturated_samples: NDArray[np.uint32]
    clock_residual: float
    filter_delay: float
    source: str
    simulated: bool
    tare: float
    tare_stamp_ns: int
    relative_uncertainty: float


class Impact(NamedTuple):
    """One impact found in the force signal: `Impact.msg`, field by field."""

    stamp_ns: int
    frame_id: str
    peak_force: float
    duration: float
    impulse: float
    onset_sample: float
    clipped: bool
    incomplete: bool
    rebound: int
    baseline: float
    noise: float
    clock_residual: float
    source: str
    simulated: bool
