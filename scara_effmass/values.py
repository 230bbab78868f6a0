# SPDX-License-Identifier: Apache-2.0
"""Values that cross rooms: immutable, SI units, float64, time in integer nanoseconds.

Most are named tuples: they are built in every cycle, and a dataclass takes three times as long.
"""

import math
from dataclasses import dataclass
from decimal import ROUND_FLOOR, ROUND_UP, Decimal
from enum import IntEnum
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scara_effmass.codes import Assumption, Reason

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Vector3 = tuple[float, float, float]
Mobility6 = tuple[float, float, float, float, float, float]
"""Entries xx, xy, xz, yy, yz, zz of a mobility A = J_v M^-1 J_v^T [1/kg] in base axes; all 0 without the model."""

NAN = float("nan")
NO_MOBILITY: Mobility6 = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
RANGE_TOLERANCE = 1e-3
"""A sample this close to the end of the range, as a share of it, is saturated: the converter's codes end just below."""
MAX_DIGITS = 6
"""Largest number of decimals of a speed."""
MAX_LOST_SAMPLES = 2**32 - 1
"""Largest value of `ForceBlock.lost_samples`."""
MAX_VERTICES = 16
"""Largest number of vertices of the hull of a link: those of ten planes that meet in threes."""
ZERO_VECTOR: Vector3 = (0.0, 0.0, 0.0)
NONE_SATURATED: NDArray[np.uint32] = np.empty(0, np.uint32)
NONE_SATURATED.flags.writeable = False


def mobility_matrix(entries: Mobility6) -> FloatArray:
    """Return the symmetric (3, 3) matrix of a mobility [1/kg]."""
    xx, xy, xz, yy, yz, zz = entries
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def true_runs(mask: BoolArray) -> NDArray[np.intp]:
    """Return start and stop (k, 2) of each run of True in `mask` (n,)."""
    return np.flatnonzero(np.diff(mask, prepend=False, append=False)).reshape(-1, 2)


def limit_share(speed: float, allowable_speed: float) -> float:
    """Return speed over allowable speed; infinite where nothing is allowed."""
    return speed / allowable_speed if allowable_speed > 0.0 else math.inf


def at_most(value: float, digits: int) -> str:
    """Return an allowed value as text, rounded down to `digits` decimals: the text allows no more than the number."""
    return _rounded(value, digits, ROUND_FLOOR)


def at_least(value: float, digits: int) -> str:
    """Return an actual value as text, its size rounded up to `digits` decimals: the text shows no less."""
    return _rounded(value, digits, ROUND_UP)


def speed_texts(speed: float, allowable_speed: float, digits: int = 3) -> tuple[str, str]:
    """Return a speed and its allowable speed as text, with more digits where an allowed speed would look too high."""
    texts = at_least(speed, digits), at_most(allowable_speed, digits)
    is_crossed = speed <= allowable_speed and float(texts[0]) > float(texts[1])
    return speed_texts(speed, allowable_speed, digits + 1) if is_crossed and digits < MAX_DIGITS else texts


def _rounded(value: float, digits: int, rounding: str) -> str:
    if not abs(value) < 1e12:  # nor is NaN
        return f"{value:.{digits}f}"
    exact = Decimal(f"{value:.12g}")  # without the noise of the last bits, which would add a digit to 0.25
    return f"{exact.quantize(Decimal(1).scaleb(-digits), rounding) + 0:f}"


NO_VALUES: FloatArray = np.empty(0)
NO_VALUES.flags.writeable = False


class Payload(NamedTuple):
    """Load on the last link, unchecked: `mass` [kg], centre of mass `com` [m] and `inertia` about it [kg m2].

    `inertia` is ixx, iyy, izz, ixy, ixz, iyz. `com` and `inertia` are in the frame of the first contact point on the
    last link.
    """

    mass: float
    com: Vector3
    inertia: tuple[float, float, float, float, float, float]


class JointState(NamedTuple):
    """One `sensor_msgs/JointState` as received, unchecked.

    `position` and `velocity` are read-only, in [rad] or [m] and per second, `effort` in [N m] or [N] or in units of
    the driver; each may be empty.
    """

    stamp_ns: int
    names: tuple[str, ...]
    position: FloatArray
    velocity: FloatArray
    effort: FloatArray = NO_VALUES


class Verdict(IntEnum):
    """Verdict on a contact point; the numbers are the constants of `ContactState.msg`."""

    UNKNOWN = 0
    OK = 1
    WARN = 2
    VIOLATION = 3


def severity(verdict: int) -> int:
    """Return 0 for OK to 3 for UNKNOWN, under which nothing is allowed."""
    return 3 if verdict == Verdict.UNKNOWN else verdict - Verdict.OK


VERDICT_COLORS = {
    Verdict.OK: "#009E73",
    Verdict.WARN: "#F0E442",
    Verdict.VIOLATION: "#D55E00",
    Verdict.UNKNOWN: "#DDDDDD",
}
"""Palette of Okabe and Ito, which colour-blind people can tell apart; the verdict is always also written out."""


class ContactAssessment(NamedTuple):
    """Assessment of one contact point at one joint state: `ContactState.msg`, field by field, with units.

    `lumped_mass` and `full_mass` [kg] are NaN if the robot has no such model. Under UNKNOWN, what could not be computed
    is 0. Masses and `predicted_force` [N] are nominal; `force_bound` [N], `allowable_speed` and `margin` [m/s] include
    drives and uncertainty margins, on the safe side. `body_mass` [kg] is that of the body part, 0 if it is clamped.
    `mass_model_reason` states why `mass_model` decides; `reason_code` is the code of `reason`. `position` [m] is where
    the contact counts, in the base: for a link as a whole its worst place, `position_in_link` in its own frame.
    """

    position: Annotated[Vector3, "m"]
    position_in_link: Annotated[Vector3, "m"]
    direction: Vector3
    speed: Annotated[float, "m_s"]
    effective_mass: Annotated[float, "kg"]
    lumped_mass: Annotated[float, "kg"]
    full_mass: Annotated[float, "kg"]
    iso_mass: Annotated[float, "kg"]
    worst_direction_mass: Annotated[float, "kg"]
    body_mass: Annotated[float, "kg"]
    reduced_mass: Annotated[float, "kg"]
    stiffness: Annotated[float, "n_m"]
    predicted_force: Annotated[float, "n"]
    contact_energy: Annotated[float, "j"]
    allowable_speed: Annotated[float, "m_s"]
    margin: Annotated[float, "m_s"]
    smallest_singular_value: float
    worst_normal_reduced_mass: Annotated[float, "kg"]
    force_bound: Annotated[float, "n"]
    clamping_force: Annotated[float, "n"]
    lumped_mobility: Annotated[Mobility6, "1_kg"]
    full_mobility: Annotated[Mobility6, "1_kg"]
    test_direction: Vector3
    test_effective_mass: Annotated[float, "kg"]
    worst_direction_used: bool
    mass_capped: bool
    verdict: Verdict
    reason_code: Reason
    contact_point: str
    body_region: str
    criterion: str
    mass_model: str
    mass_model_reason: str
    reason: str

    @property
    def limit_share(self) -> float:
        """Speed over allowable speed; infinite where nothing is allowed."""
        return limit_share(self.speed, self.allowable_speed)

    @property
    def speed_text(self) -> str:
        """Speed of allowable speed as text."""
        return "{} of {} m/s".format(*speed_texts(self.speed, self.allowable_speed))

    @property
    def mass_model_text(self) -> str:
        """The deciding model and the reason, such as "full: no lumped mass"; empty if none decides."""
        return f"{self.mass_model}: {self.mass_model_reason}" if self.mass_model else ""

    @property
    def mobility(self) -> Mobility6:
        """Mobility of the deciding model; that of ISO/TS 15066 is the same in every direction."""
        if self.mass_model == "iso" and self.iso_mass > 0.0:
            return 1.0 / self.iso_mass, 0.0, 0.0, 1.0 / self.iso_mass, 0.0, 1.0 / self.iso_mass
        return {"lumped": self.lumped_mobility, "full": self.full_mobility}.get(self.mass_model, NO_MOBILITY)


class Decision(NamedTuple):
    """Output of the monitor for one joint state, or of its watchdog: `ContactStates.msg`.

    `stamp_ns` is that of the joint state, `input_age` its age [s] and `velocity_delay` that of its velocity [s].
    `contact_normal` is empty where nothing was computed. `watchdog`: it answers no joint state, because none came in
    time or the monitor ended. There is at least one contact, without a name if there is no robot. `allowable_speed`
    [m/s] and `speed_scaling` [0-1] are the minima over the contacts, 0 if one is UNKNOWN. `sequence_number` counts the
    messages of one monitor; 0: not published. `assumptions` are those that nothing states, except for those that the
    settings accept. `scope` says what an OK covers.
    """

    stamp_ns: int
    input_age: float
    velocity_delay: float
    contact_normal: str
    watchdog: bool
    contacts: tuple[ContactAssessment, ...]
    allowable_speed: float
    speed_scaling: float
    sequence_number: int = 0
    assumptions: tuple[Assumption, ...] = ()
    accepted_assumptions: tuple[Assumption, ...] = ()
    scope: str = ""

    @property
    def worst(self) -> ContactAssessment:
        """The contact with the largest share of its allowable speed among those with the worst verdict."""
        if len(self.contacts) == 1:
            return self.contacts[0]
        return max(self.contacts, key=lambda contact: (severity(contact.verdict), contact.limit_share, -contact.margin))

    @property
    def assessed_ns(self) -> int:
        """Time of the assessment on the monitor's clock [ns]."""
        return self.stamp_ns + round(self.input_age * 1e9)

    @property
    def verdict(self) -> Verdict:
        """The verdict of the worst contact."""
        return self.worst.verdict

    @property
    def reason(self) -> str:
        """The reason of the worst contact, empty if it is OK."""
        return self.worst.reason

    @property
    def reason_code(self) -> Reason:
        """The code of that reason."""
        return self.worst.reason_code


class ForceBlock(NamedTuple):
    """Consecutive samples of one force channel: `ForceBlock.msg`, field by field.

    `force` (n,) is read-only, in [N], compression positive, tare subtracted; `saturated_samples` are its indices
    whose force is not known: at the end of the measuring range, or with an open or shorted sensor.
    """

    stamp_ns: int
    frame_id: str
    first_sample: int
    sample_rate: float
    force: FloatArray
    lost_samples: int = 0
    saturated_samples: NDArray[np.uint32] = NONE_SATURATED
    clock_residual: float = 0.0
    filter_delay: float = 0.0
    source: str = ""
    simulated: bool = False
    tare: float = 0.0
    tare_stamp_ns: int = 0
    relative_uncertainty: float = 0.0

    @property
    def is_unknown(self) -> bool:
        """Whether the force of no sample is known."""
        return 0 < len(self.force) == len(self.saturated_samples)

    def lost_since(self, before: "ForceBlock | None") -> int:
        """Return the number of samples lost between the block `before` and this one.

        None: there is none, and the first block may count samples that were lost before the recording began. If the
        sample numbers restart, only the stamps show what is missing; it is at least one.
        """
        if before is None:
            return 0
        missing = self.first_sample - before.first_sample - len(before.force)
        if missing < 0:
            gap_s = (self.stamp_ns - before.stamp_ns) / 1e9 - len(before.force) / before.sample_rate
            missing = max(1, round(gap_s * before.sample_rate))
        return max(self.lost_samples, missing)


class Impact(NamedTuple):
    """One contact detected in the force signal, its peak and what stayed: `Impact.msg`, field by field."""

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
    compression_impulse: float = 0.0
    held_force: float = 0.0
    load_force: float = 0.0

    @property
    def reported_ns(self) -> int:
        """Earliest time of the report: a contact that stays is known only at its end."""
        return self.stamp_ns + (round(self.duration * 1e9) if self.held_force else 0)

    @property
    def is_press(self) -> bool:
        """Whether the force stayed, and rose more slowly than in an impact or stayed near its peak."""
        return self.held_force > 0.0 and not self.compression_impulse


class LeftOut(NamedTuple):
    """Force above the threshold that is in no impact, by `reason`: how often, the largest one [N], and its time.

    `peak_force` includes the `load_force` of an earlier contact; 0: not known.
    """

    reason: str
    occurrences: int
    peak_force: float
    stamp_ns: int
    load_force: float = 0.0

    @property
    def size_text(self) -> str:
        """The largest force."""
        return f"up to {self.peak_force:.1f} N" if self.peak_force else "force not known"


class Prediction(NamedTuple):
    """Prediction of one impact by one model of the effective mass.

    `model` is "lumped", "full", "iso" or "largest". `predicted_force` = v sqrt(mu k) [N] with mu = `reduced_mass` [kg]
    and k = `stiffness` [N/m]; `relative_error` = (predicted - measured) / measured, and `conservative` means not below
    the measured force.
    """

    model: str
    effective_mass: float
    reduced_mass: float
    stiffness: float
    predicted_force: float
    relative_error: float
    conservative: bool


@dataclass(frozen=True, slots=True)
class SeriesStatistics:
    """Agreement of a series of impacts with one model, and the decision on it: `SeriesStatistics.msg`."""

    count: int
    correlation: float
    fitted_stiffness: float
    bias: float
    rmse: float
    non_conservative: int
    gain: float
    gain_interval: tuple[float, float]
    mass_scale: float
    mass_scale_interval: tuple[float, float]
    detectable_mass_error: float
    exponent: float
    exponent_interval: tuple[float, float]
    clock_offset: float
    exceedances: int
    accepted: bool
    decidable: bool
    reason: str


@dataclass(frozen=True, slots=True)
class ValidatedImpact:
    """Comparison of one impact with its prediction: `ImpactValidation.msg`, and its inputs.

    `series` describes the selected model over the series. `predictions` are those of every model that has a mass at
    the onset; `obstacle_mass` m_H [kg] and `configuration` are those of the run. `from_trend`: the robot state was
    extrapolated from before the impact, because the contact had already slowed the robot in the next one.
    `force_share` is the component of the plate's normal along the axis of the sensor. `measured_force` is above the
    `load_force` of an earlier contact.
    """

    stamp_ns: int
    frame_id: str
    predicted_force: float
    measured_force: float
    relative_error: float
    effective_mass: float
    reduced_mass: float
    speed: float
    stiffness: float
    conservative: bool
    compression_impulse: float
    measured_reduced_mass: float
    measured_effective_mass: float
    measured_stiffness: float
    clock_offset: float
    body_region: str
    region_force: float
    limit_force: float
    exceeds_limit: bool
    series: SeriesStatistics
    predictions: tuple[Prediction, ...]
    contact_point: str
    direction: Vector3
    obstacle_mass: float
    configuration: str
    from_trend: bool
    force_share: float
    simulated: bool
    held_force: float = 0.0
    held_limit: float = 0.0
    held_region: str = ""
    load_force: float = 0.0


class RefusedImpact(NamedTuple):
    """One impact left out of the series.

    `excluded`: because of the impact itself; otherwise it could not be matched with the robot's state. `reason` is the
    category by which such impacts are counted, `detail` describes this one and may be empty. `speed` [m/s] is that of a
    press at its onset, 0 if it is not known. `peak_force` is that above the `load_force` of an earlier contact, which
    `held_force` includes; all are as measured, `force_share` times those along the normal of the plate, which are
    `total_peak` with the load, and `total_held`.
    """

    stamp_ns: int
    peak_force: float
    excluded: bool
    reason: str
    detail: str
    held_force: float = 0.0
    speed: float = 0.0
    simulated: bool = False
    load_force: float = 0.0
    force_share: float = 1.0

    @property
    def total_peak(self) -> float:
        """Peak force with the load, along the normal of the plate [N]."""
        return (self.peak_force + self.load_force) / self.force_share

    @property
    def total_held(self) -> float:
        """What stayed, along the normal of the plate [N]; 0: nothing."""
        return self.held_force / self.force_share


class RunInfo(NamedTuple):
    """Information about the run of a recording or a simulation: `RunInfo.msg`, field by field, unchecked.

    It holds from `stamp_ns` on; 0: from the arrival of the message on. A number or vector of 0 and an empty
    `configuration` mean "not stated". `impacts.impact_matcher` checks the values.
    """

    stamp_ns: int = 0
    frame_id: str = ""
    configuration: str = ""
    obstacle_mass: float = 0.0
    impact_position: Vector3 = (0.0, 0.0, 0.0)
    plate_normal: Vector3 = (0.0, 0.0, 0.0)
    guide_direction: Vector3 = (0.0, 0.0, 0.0)
    simulated: bool = False
    note: str = ""
    contact_stiffness: float = 0.0
    contact_exponent: float = 0.0
    true_onset_ns: int = 0
    true_speed: float = 0.0
    true_effective_mass: float = 0.0
    true_peak_force: float = 0.0
    true_duration: float = 0.0
    true_impulse: float = 0.0
