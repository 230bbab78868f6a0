# SPDX-License-Identifier: Apache-2.0
"""Assessment of the contact points at one joint state: which model decides, numbers, allowable speed and verdict.

No history: debouncing and latch are in `safety`. The kernel computes the same; this is what is meant.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from scara_effmass.codes import CriterionCode, ModelCode, ModelReason, NoLumpedMass, Reason
from scara_effmass.iso15066.allowable_speed import (
    MIN_EFFECTIVE_MASS,
    ContactCase,
    SpeedLimit,
    contact_cases,
    weakest_case,
)
from scara_effmass.iso15066.contact import MAX_TURN, peak_force, reduced_mass, transferred_energy, turn_until_peak
from scara_effmass.iso15066.limits import Limit
from scara_effmass.model.lumping import is_scara, lumped_suffices
from scara_effmass.reference.dynamics import X_AXIS, ContactState, RobotDynamics
from scara_effmass.reference.hull import hull_mobility
from scara_effmass.reference.mobility import Acceleration, Mobility, is_bounded
from scara_effmass.reference.person import MIN_PERSON_SPEED, MovingPerson
from scara_effmass.reference.speed_limit import DrivePush, speed_limit
from scara_effmass.settings import ContactType, Drives, MassModel, MonitorSettings
from scara_effmass.values import NO_MOBILITY, ZERO_VECTOR, FloatArray, Mobility6, Vector3, Verdict

MIN_NORMAL_COMPONENT = 0.1
"""Smallest share of the speed that counts along a fixed normal: its direction is known to about 6 degrees."""
_CHOICES = {
    MassModel.LUMPED: (ModelCode.LUMPED,),
    MassModel.FULL: (ModelCode.FULL,),
    MassModel.ISO: (ModelCode.ISO,),
    MassModel.LARGEST: (ModelCode.LUMPED, ModelCode.FULL, ModelCode.ISO),
}


@dataclass
class ContactResult:
    """Assessment of one contact point: numbers of `ContactState.msg`, and codes of `scara_effmass.codes`.

    `body_region` is 1 + the index of the governing limit, 0 for none. `reason_values` are the numbers of `reason`.
    """

    position: Vector3
    position_in_link: Vector3
    direction: Vector3
    speed: float
    lumped_mass: float
    full_mass: float
    iso_mass: float
    smallest_singular_value: float
    lumped_mobility: Mobility6
    full_mobility: Mobility6
    worst_direction_used: bool
    effective_mass: float = 0.0
    worst_direction_mass: float = 0.0
    body_mass: float = 0.0
    reduced_mass: float = 0.0
    stiffness: float = 0.0
    predicted_force: float = 0.0
    contact_energy: float = 0.0
    allowable_speed: float = 0.0
    worst_normal_reduced_mass: float = 0.0
    force_bound: float = 0.0
    clamping_force: float = 0.0
    test_direction: Vector3 = ZERO_VECTOR
    test_effective_mass: float = 0.0
    mass_capped: bool = False
    verdict: Verdict = Verdict.UNKNOWN
    body_region: int = 0
    criterion: CriterionCode = CriterionCode.NONE
    mass_model: ModelCode = ModelCode.NONE
    mass_model_reason: int = 0
    reason: Reason = Reason.NONE
    reason_joint: int = 0
    reason_values: tuple[float, ...] = ()

    @property
    def margin(self) -> float:
        """Allowable speed minus speed [m/s]."""
        return self.allowable_speed - self.speed


def assess(
    dynamics: RobotDynamics,
    settings: MonitorSettings,
    limits: Sequence[Sequence[Limit]],
    q: FloatArray,
    qd: FloatArray,
    velocity_tolerance: Sequence[float] = (),
    acceleration: JointAcceleration | None = None,
    chosen: slice = slice(None),
) -> list[ContactResult]:
    """Return the assessment of each of the `chosen` contact points at `q` (n,) [rad, m] and `qd` (n,), finite numbers.

    `limits` are those of every contact point, see `iso15066.limits_of`. `velocity_tolerance` (n,) bounds the errors of
    `qd`; empty: no errors. None as `acceleration` is a robot that does not accelerate.
    """
    none = np.zeros_like(qd)
    acceleration = acceleration or JointAcceleration(none, none, none)
    results = []
    for contact, own in zip(dynamics.at(q, qd).contacts[chosen], limits[chosen], strict=True):
        cases = contact_cases(own, settings)
        worst = contact.at_worst_vertex(hull_mobility(cases), settings.speed_threshold)
        tolerance = worst.speed_tolerance(velocity_tolerance)
        results.append(ContactAssessor(worst, settings, tuple(own), cases, tolerance, acceleration).result())
    return results


class JointAcceleration(NamedTuple):
    """Joint accelerations (n,) [rad/s2, m/s2], bounds of their errors (n,), and `age` [s] of the joint state.

    `shown` (n,) are those of the joint states, also where a stated one counts in their place.
    """

    qdd: FloatArray
    errors: FloatArray
    shown: FloatArray
    age: float = 0.0


@dataclass(frozen=True)
class DecidingModel:
    """A model behind the verdict: its mass along the velocity and along the worst direction [kg].

    ISO's mass is the same in every direction; its mobility is that of the mass alone.
    """

    code: ModelCode
    mass: float
    worst_mass: float
    mobility: Mobility

    def along(self, n: FloatArray) -> float:
        """Return the mass [kg] along the unit vector n."""
        return self.mass if self.code is ModelCode.ISO else self.mobility.effective_mass(n)


@dataclass
class ContactAssessor:
    """Assesses one contact point at one joint state."""

    contact: ContactState
    settings: MonitorSettings
    limits: tuple[Limit, ...]
    cases: tuple[ContactCase, ...]
    speed_tolerance: float
    joint_acceleration: JointAcceleration
    models: list[DecidingModel] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Take the direction of the velocity; None below the speed threshold, where the worst direction counts."""
        contact = self.contact
        self.state, self.dynamics = contact.state, contact.state.dynamics
        self.direction = contact.direction if contact.speed >= self.settings.speed_threshold else None
        self.iso_mass = 0.0 if self.dynamics.robot.masses_reason else self.dynamics.robot.iso_mass
        codes = (ModelCode.LUMPED, ModelCode.FULL)
        self.masses = {code: contact.effective_mass(code, self.direction) for code in codes}
        self.masses[ModelCode.ISO] = self.iso_mass
        time = max(0.0, self.joint_acceleration.age) + self.settings.reaction_time  # a stamp may lead the clock
        self.speed_tolerance += time * self._speed_rate

    @cached_property
    def _accelerations(self) -> tuple[FloatArray, FloatArray, float]:
        """Accelerations (3,) by J_v qdd and by dJ_v/dt qd, and a bound of the error of the former [m/s2]."""
        qdd, errors, *_ = self.joint_acceleration
        error = self.contact.speed_tolerance(errors.tolist())
        return self.contact.jacobian @ qdd, self.contact.jacobian_rate @ self.state.qd, error

    @property
    def _speed_rate(self) -> float:
        """The largest d/dt of the speed [m/s2] that the joint states show or the settings state."""
        shown, held, error = self._accelerations
        total = shown + held
        rate = float(np.linalg.norm(total)) if self.direction is None else max(0.0, float(self.direction @ total))
        return max(rate + error, self.settings.max_acceleration)

    def _acceleration(self, code: ModelCode) -> Acceleration:
        """Return the acceleration that the contact goes on with, in the mass model `code`.

        A stated limit that is larger than what the joint states show counts in its place, in any direction. Beside one
        that is smaller, the arm may speed up as fast as the limit: it could brake.
        """
        shown, held, error = self._accelerations
        limit, size, none = self.settings.max_acceleration, float(np.linalg.norm(shown)), np.zeros(3)
        if limit >= size + error:
            return Acceleration(none, none, limit, math.inf)
        if self.direction is None:
            return Acceleration(none, none, size + error, math.inf)
        error, root = max(error, limit - max(0.0, float(self.direction @ shown))), math.inf
        if code in self.state.mass_matrix and not limit:
            root = float(np.sqrt(np.diagonal(self.state.mass_matrix[code])) @ self.joint_acceleration.errors)
        return Acceleration(shown, held, error, root)

    def result(self) -> ContactResult:
        """Return the numbers, and the verdict on this joint state alone."""
        contact, cap = self.contact, self.settings.mass_cap
        lumped = None if contact.massless_joints else contact.mobilities.get(ModelCode.LUMPED)
        result = ContactResult(
            position=_vector(contact.position),
            position_in_link=_vector(contact.position_in_link),
            direction=ZERO_VECTOR if self.direction is None else _vector(self.direction),
            speed=contact.speed,
            lumped_mass=min(self.masses[ModelCode.LUMPED], cap),  # a NaN stays
            full_mass=min(self.masses[ModelCode.FULL], cap),
            iso_mass=self.iso_mass,
            smallest_singular_value=contact.smallest_singular_value,
            lumped_mobility=_entries(lumped),
            full_mobility=_entries(contact.mobilities.get(ModelCode.FULL)),
            worst_direction_used=self.direction is None,
        )
        codes, why = self._choice()
        result.reason, result.reason_values = self._take(codes)
        if self.settings.fixed_test_direction is not None:
            result.test_direction, result.test_effective_mass = self._along_test_direction()
        if self.settings.contact is ContactType.QUASI_STATIC:
            directions = self._directions()
            force = contact.clamping_force(directions) if directions else contact.largest_clamping_force()
            result.clamping_force = min(force, self.settings.external_force_limit or math.inf)
            if result.clamping_force == math.inf and self.settings.drives is not Drives.SERVO:
                result.reason = result.reason or Reason.NO_CLAMPING_FORCE
        if not result.reason:
            result.mass_model_reason = why
            self._limit_speed(result)
        if result.clamping_force == math.inf:
            result.clamping_force = 0.0
        return result

    # -- which model decides ---------------------------------------------------------------------------------------

    def _choice(self) -> tuple[tuple[ModelCode, ...], int]:
        """Return the models that decide by the settings, without those that are missing, and why these."""
        choice, missing = self.settings.effective_mass_model, self.contact.no_lumped_mass(self.direction)
        if choice is not MassModel.AUTO:
            chosen = _CHOICES[choice]
            return tuple(code for code in chosen if not math.isnan(self.masses[code])), ModelReason.SETTING
        if self._lumped_is_heavy_enough:
            # The change of pose can differ more than the mass: but for a SCARA, the full model bounds the speed, too.
            # It is compared at one place, so for a link both count as well.
            both = (ModelCode.LUMPED, ModelCode.FULL)
            is_enough = is_scara(self.dynamics.robot) and self.contact.vertex is None
            return both[:1] if is_enough else both, ModelReason.HEAVY_ENOUGH
        if missing is None and self.contact.massless_joints:
            missing = NoLumpedMass.MASSLESS  # there is one along this direction, but not along every normal
        if not self.dynamics.full_reason:
            return (ModelCode.FULL,), ModelReason.LIGHTER if missing is None else ModelReason.NO_LUMPED + missing
        if missing is not None:
            return (ModelCode.ISO,), ModelReason.only_iso(missing, len(self.state.q))
        suffices = lumped_suffices(self.dynamics.robot)
        return (ModelCode.LUMPED,) if suffices else (ModelCode.LUMPED, ModelCode.ISO), ModelReason.LARGEST

    @cached_property
    def _lumped_is_heavy_enough(self) -> bool:
        """Whether both models exist and, along every normal, lumped mass >= (1 - margin) full mass.

        Then it holds for the worst direction, and for the reduced mass with any body part along the worst normal.
        """
        mobilities = self.contact.mobilities
        if len(mobilities) < 2 or self.contact.massless_joints:
            return False
        margin = self.settings.model_margin
        return is_bounded(mobilities[ModelCode.LUMPED], mobilities[ModelCode.FULL], 1.0 - margin)

    def _take(self, codes: Sequence[ModelCode]) -> tuple[Reason, tuple[float, ...]]:
        """Let the models `codes` decide. Return why they cannot, with its numbers; NONE if they can."""
        if self.dynamics.robot.masses_reason:
            return Reason.NO_MASSES, ()
        if not codes:
            missing = self.contact.no_lumped_mass(self.direction)
            is_full = self.settings.effective_mass_model is MassModel.FULL
            return (Reason.NO_FULL_MASS, ()) if is_full else (Reason.NO_LUMPED_MASS, (missing or 0,))
        models = []
        for code in codes:
            mass = self.masses[code]
            worst = mass if code is ModelCode.ISO else self.contact.effective_mass(code, None)
            if mass < MIN_EFFECTIVE_MASS:
                return Reason.TOO_LIGHT, (code, mass)
            if math.isnan(worst) and self.settings.contact_normal != "velocity":
                return Reason.NO_WORST_MASS, (code,)
            if code is ModelCode.ISO:
                mobility = self.contact.uniform_mobility(mass, self.direction)
            else:
                mobility = self.contact.mobility(code, self.direction)
            mobility = replace(mobility, acceleration=self._acceleration(code))
            models.append(DecidingModel(code, mass, worst, mobility))
        self.models = models
        return Reason.NONE, ()

    # -- directions ------------------------------------------------------------------------------------------------

    def _along_test_direction(self) -> tuple[Vector3, float]:
        """Return the test direction in base axes, and the largest mass along it [kg]; 0 if a model has none."""
        settings = self.settings
        vector = settings.fixed_test_direction or ZERO_VECTOR
        n = self.state.in_base(vector, settings.test_direction_frame, "test_direction_frame")
        if self.contact.massless_joints and any(model.code is ModelCode.LUMPED for model in self.models):
            return _vector(n), 0.0
        return _vector(n), min(max((model.along(n) for model in self.models), default=0.0), settings.mass_cap)

    @cached_property
    def _fixed_normal(self) -> FloatArray | None:
        """The contact normal of the settings in base axes; None for the worst one and for that of the velocity."""
        normal = self.settings.fixed_normal
        return None if normal is None else self.state.in_base(normal, self.settings.contact_normal_frame)

    @cached_property
    def _share(self) -> float:
        """Share of the speed along a fixed normal."""
        if self._fixed_normal is None or self.direction is None:
            return 1.0
        return max(abs(float(self._fixed_normal @ self.direction)), MIN_NORMAL_COMPONENT)

    def _directions(self) -> list[FloatArray]:
        """Return a fixed normal and its opposite, else the direction of the velocity; at rest none is known."""
        if self._fixed_normal is not None:
            return [self._fixed_normal, -self._fixed_normal]
        return [] if self.direction is None else [self.direction]

    # -- speed -----------------------------------------------------------------------------------------------------

    def _any_normal(self, model: DecidingModel) -> Mobility:
        """Return the mobility of `model` for any contact normal: at rest that of the worst direction."""
        if self.direction is not None:
            return model.mobility
        return Mobility.of_mass(self._worst_mass_at_rest(model.mobility), X_AXIS)

    def _worst_mass_at_rest(self, mobility: Mobility) -> float:
        """Return the largest mass [kg] over all directions, and of a link over all its points.

        Where a link cannot move in every direction, its points have no largest mass. Against a clamped body part the
        bound is too far above it. Both count at the vertex.
        """
        is_bounded = self.contact.rank == len(X_AXIS) and self.settings.contact is not ContactType.QUASI_STATIC
        if mobility.hull is None or not is_bounded:
            return mobility.worst_mass
        return max(mobility.worst_mass, mobility.hull.worst_mass(hull_mobility(self.cases)))

    def _at_normal(self, mobility: Mobility) -> Mobility:
        """Return `mobility` for the contact normal of the settings."""
        if self._fixed_normal is not None:
            min_speed, either_way = self._share * self.contact.speed, self._share == MIN_NORMAL_COMPONENT
            return mobility.along(self._fixed_normal, min_speed, either_way=either_way)
        if self.direction is None:
            is_anywhere = len(mobility.values) == len(X_AXIS)
            mass = self._worst_mass_at_rest(mobility)
            found = (Mobility.of_any_direction if is_anywhere else Mobility.of_mass)(mass, X_AXIS)
        elif self.settings.contact_normal == "velocity":  # of the first touch, as in the paper and the standard
            found = Mobility.of_mass(mobility.effective_mass(self.direction), self.direction)
        else:
            return mobility
        return replace(found, acceleration=mobility.acceleration)

    def _mobilities(self) -> list[Mobility]:
        """Return the mobilities for the contact normal of the settings, also those of joints that are held."""
        free = [self._at_normal(m.mobility) for m in self.models]
        if self.settings.drives is not Drives.SERVO or self.settings.servo.computed_torque:
            return free
        codes = (model.code for model in self.models if model.code is not ModelCode.ISO)
        held = (
            replace(self.contact.held_mobility(code, self.direction), acceleration=self._acceleration(code))
            for code in codes
        )
        return free + [self._at_normal(mobility) for mobility in held]

    def _holding_force(self) -> float:
        """Return the contact force [N] up to which no joint reaches its effort limit.

        Above it, computed torque no longer holds: saturated joints yield, the others push on, and the arm can hit
        again, faster. The force acts along `_directions`, and with any normal also along the worst one; at rest, and on
        a person who moves, along any vector.
        """
        is_known = self._fixed_normal is not None or self.direction is not None
        if self.settings.counts_person_velocity or not is_known:
            return self.contact.least_holding_force
        normals = self._directions()
        if self.settings.contact_normal == "worst":
            alpha = min(case.obstacle_mobility for case in self.cases)
            normals += [m.mobility.worst_normal(alpha) for m in self.models if m.code is not ModelCode.ISO]
        return self.contact.holding_force(normals)

    @cached_property
    def _person(self) -> MovingPerson | None:
        """The person whose velocity counts as a vector; None if no person moves, or the contact normal is known."""
        settings, direction = self.settings, self._person_direction
        if not settings.counts_person_velocity:
            return None
        person_speed = max(settings.person_speed, MIN_PERSON_SPEED)
        return MovingPerson(person_speed, None if self.direction is None else direction)

    @property
    def _person_direction(self) -> FloatArray | None:
        """The direction to the person in base axes; None for any."""
        settings = self.settings
        direction = settings.fixed_person_direction
        if direction is None:
            return None
        return self.state.in_base(direction, settings.person_direction_frame, "person_direction_frame")

    @cached_property
    def _person_share(self) -> float:
        """Share of the person's speed that adds to the robot's along a known contact normal, either way."""
        if self.settings.counts_person_velocity:
            return 0.0
        normal = self.direction if self._fixed_normal is None else self._fixed_normal
        if normal is None or self._person_direction is None:
            return 1.0
        return max(abs(float(normal @ self._person_direction)), MIN_NORMAL_COMPONENT)

    def _max_speed(self, worst_mass: float) -> SpeedLimit:
        """Return the speed limit with drives; the uncertainty of the mass makes every mass larger."""
        settings, factor = self.settings, 1.0 + self.settings.mass_uncertainty
        push, max_force, person = None, math.inf, self._person
        if settings.drives is Drives.SERVO:
            clamping_limit = settings.external_force_limit or math.inf
            push = DrivePush(self.contact.drive_acceleration(), 1.0 / worst_mass / factor, clamping_limit)
            if settings.servo.computed_torque:
                max_force = self._holding_force()
        if person is not None and self.contact.rank < len(X_AXIS):
            push = None  # where the point does not move, the drives have no least mobility
        mobilities = [mobility.with_masses(factor) for mobility in self._mobilities()]
        return speed_limit(self.cases, mobilities, push, max_force, person)

    def _limit_speed(self, result: ContactResult) -> None:
        """Add masses, forces, allowable speed and verdict to `result`."""
        settings, cap, speed = self.settings, self.settings.mass_cap, self.contact.speed
        worst_mass = max(model.worst_mass for model in self.models)
        decides = self.models[0]
        if not self._lumped_is_heavy_enough or settings.effective_mass_model is not MassModel.AUTO:
            for model in self.models[1:]:
                decides = model if min(model.mass, cap) > decides.mass else decides
        mass = decides.mass
        found = self._max_speed(worst_mass)
        limit, m_h = found.limit, found.limit.body_mass_kg
        mu = min(reduced_mass(mass, m_h), cap)  # Eq. 16
        person_speed = settings.person_speed * self._person_share
        closing_speed = person_speed + settings.speed_uncertainty + self.speed_tolerance
        nominal_speed = (found.allowable_speed - closing_speed) / self._share  # below 0 if the person is too fast
        result.effective_mass, result.mass_capped, result.mass_model = min(mass, cap), mass > cap, decides.code
        result.worst_direction_mass = min(cap, worst_mass)  # the cap for NaN: the safe side
        result.body_region = 1 + self.limits.index(limit)
        result.criterion = CriterionCode[limit.criterion.upper()]
        result.stiffness, result.body_mass = limit.stiffness_n_m, 0.0 if math.isinf(m_h) else m_h
        result.reduced_mass = mu
        worst_mus = (self._any_normal(model).reduced_mass(1.0 / m_h) for model in self.models)
        result.worst_normal_reduced_mass = min(max(worst_mus), cap)
        result.predicted_force = peak_force(speed + settings.person_speed, mu, limit.stiffness_n_m)
        result.contact_energy = transferred_energy(speed + settings.person_speed, mu)  # Eqs. 31-33
        result.force_bound = self.cases[0].amplification * found.force(speed * self._share + closing_speed, cap)
        result.allowable_speed = max(0.0, nominal_speed)
        self._judge(result, mass, nominal_speed, found.allowable_speed)
        if settings.drives is Drives.SERVO:  # it pushes no further than its reference moves on
            result.clamping_force = min(result.clamping_force, result.force_bound)
        elif result.clamping_force > (weakest := weakest_case(self.cases)).force:
            result.allowable_speed, result.verdict = 0.0, Verdict.VIOLATION
            region = 1 + self.limits.index(weakest.limit)
            values = (result.clamping_force, weakest.limit.permissible_force_n, region)
            result.reason, result.reason_joint, result.reason_values = Reason.CLAMPED, 0, values

    def _judge(self, result: ContactResult, mass: float, nominal_speed: float, limit_speed: float) -> None:
        """Add the verdict on this joint state alone, and why it is not OK."""
        settings, speed = self.settings, self.contact.speed
        result.verdict = Verdict.OK
        if speed > nominal_speed:
            result.verdict, result.reason = Verdict.VIOLATION, Reason.TOO_FAST
        elif speed > settings.warn_ratio * nominal_speed:
            result.verdict, result.reason = Verdict.WARN, Reason.NEAR_LIMIT
        accelerations = np.abs(self.joint_acceleration.shown) * self.contact.is_moved_by
        mass_on_spring = result.body_mass or result.worst_normal_reduced_mass
        turn = turn_until_peak(float(np.max(accelerations)), mass_on_spring, result.stiffness)
        if not result.reason and turn > MAX_TURN:
            result.verdict, result.reason = Verdict.WARN, Reason.TURNS
        best = ModelCode.LUMPED if math.isnan(self.masses[ModelCode.FULL]) else ModelCode.FULL
        best_mass = min(self.masses[best], settings.mass_cap)  # near a singular pose both masses exceed the cap
        is_light = mass < best_mass * (1.0 - settings.model_margin)
        if is_light:
            result.verdict = max(result.verdict, Verdict.WARN)
            result.reason = result.reason or Reason.LIGHT_MODEL
        if result.reason is Reason.TURNS:
            result.reason_joint, result.reason_values = int(np.argmax(accelerations)), (turn,)
        elif result.reason:
            masses = (result.effective_mass, best_mass) if is_light else ()
            speeds, share, person_speed = (speed, result.allowable_speed), self._person_share, settings.person_speed
            if result.reason is Reason.TOO_FAST and person_speed > 0.0 and limit_speed <= person_speed * share:
                result.reason = Reason.PERSON_TOO_FAST
                rest = limit_speed / share if share else limit_speed + person_speed
                speeds = person_speed, max(0.0, rest)
            result.reason_values = (*speeds, result.criterion, result.body_region, *masses)


def _vector(vector: FloatArray) -> Vector3:
    x, y, z = vector.tolist()
    return x, y, z


def _entries(mobility: FloatArray | None) -> Mobility6:
    """Return the entries xx, xy, xz, yy, yz, zz of a mobility, zeros for None."""
    if mobility is None:
        return NO_MOBILITY
    a, b, c, d, e, f = mobility[np.triu_indices(3)].tolist()
    return a, b, c, d, e, f
