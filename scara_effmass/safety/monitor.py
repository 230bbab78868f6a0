"""Assess joint states: the verdict and the allowable speed of each contact point."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from scara_effmass.iso15066 import MIN_EFFECTIVE_MASS, SpeedLimit, SpeedLimits, limits_for, peak_force, reduced_mass
from scara_effmass.safety.debounce import VerdictDebouncer, severity
from scara_effmass.safety.joint_state_validator import NANOSECONDS, JointStateValidator, OtherDevice
from scara_effmass.settings import MassModel, MonitorSettings
from scara_effmass.values import NAN, ZERO_VECTOR, ContactAssessment, Decision, JointState, Verdict

if TYPE_CHECKING:
    from scara_effmass.model.dynamics import EffectiveMasses, RobotDynamics


class Cause(NamedTuple):
    """The first VIOLATION or UNKNOWN after the first valid joint state, or after the last reset."""

    stamp_ns: int
    contact_point: str
    verdict: Verdict
    reason: str


class Monitor:
    """Assesses joint states one by one. The same joint states give the same decisions, live and offline.

    `rejected` counts invalid joint states, `ignored` those of other devices. `first_cause` is what `latch` holds.
    """

    def __init__(self, dynamics: RobotDynamics, settings: MonitorSettings) -> None:
        """Watch the robot of `dynamics`. Raises LimitError for `settings` that loosen a limit of the standard."""
        self.dynamics = dynamics
        self._validator = JointStateValidator(dynamics.robot)
        self._iso_mass = 0.0 if dynamics.robot.masses_reason else dynamics.robot.iso_mass
        self._debouncers = {name: VerdictDebouncer() for name in dynamics.contact_points}
        self.first_cause: Cause | None = None
        self._had_valid_input = False
        self._counts = [0] * len(Verdict)
        self.rejected = 0
        self.ignored = 0
        self.apply(settings)

    def apply(self, settings: MonitorSettings) -> None:
        """Apply changed settings, except those of the robot. Raises LimitError, and then changes nothing."""
        limits = SpeedLimits(limits_for(settings))
        self.settings = settings
        self._limits = limits
        self._validator.apply(settings)
        self._mass_factor = 1.0 + settings.mass_uncertainty
        self._stiffness_factor = 1.0 + settings.stiffness_uncertainty
        self._closing_speed = settings.person_speed + settings.speed_uncertainty
        for debouncer in self._debouncers.values():
            debouncer.release_ns = round(settings.release_time * NANOSECONDS)

    @property
    def verdicts(self) -> dict[Verdict, int]:
        """Number of contact assessments per verdict, those of the watchdog included."""
        return {verdict: self._counts[verdict] for verdict in Verdict}

    def reset(self) -> None:
        """Clear the first cause, and with it a latched verdict."""
        self.first_cause = None
        for debouncer in self._debouncers.values():
            debouncer.clear()

    def clear_history(self) -> None:
        """Discard earlier joint states: the node's clock jumped back, and the stamps follow."""
        self._validator.reset()
        for debouncer in self._debouncers.values():
            debouncer.clear()

    def assess(self, state: JointState, now_ns: int) -> Decision | None:
        """Return the decision on `state`, received at `now_ns` on the node's clock.

        None for a joint state that names none of the robot's joints: it belongs to another device.
        """
        validator = self._validator
        previous_ns = validator.last_stamp_ns
        if previous_ns > now_ns + validator.future_tolerance_ns:
            # System time was set back, which raises no jump callback.
            self.clear_history()
            previous_ns = 0
        motion = validator.validate(state, now_ns)
        if isinstance(motion, OtherDevice):
            self.ignored += 1
            return None
        age = (now_ns - state.stamp_ns) / 1e9 if state.stamp_ns > 0 else 0.0
        if isinstance(motion, str):
            return self.reject(motion, state.stamp_ns, age)
        if previous_ns and state.stamp_ns - previous_ns > validator.timeout_ns:
            for debouncer in self._debouncers.values():
                debouncer.mark_stale(f"no joint state for {(state.stamp_ns - previous_ns) / 1e9:.3f} s")
        effective_masses = self.dynamics.effective_masses(motion.q, motion.qd, self.settings.speed_threshold)
        contacts = [
            self._assess_contact(name, debouncer, masses, state.stamp_ns, age)
            for (name, debouncer), masses in zip(self._debouncers.items(), effective_masses, strict=True)
        ]
        return self._decision(tuple(contacts))

    def reject(self, reason: str, stamp_ns: int = 0, age: float = 0.0) -> Decision:
        """Return the decision on a joint state that is invalid for `reason`, such as undecodable bytes."""
        self.rejected += 1
        for debouncer in self._debouncers.values():
            debouncer.mark_stale(reason)
        return self._decision(tuple(self._unknown(name, reason, stamp_ns, age) for name in self._debouncers))

    def watchdog_decision(self, elapsed_ns: int) -> Decision:
        """Return the decision when no joint state has come for `elapsed_ns` of steady time.

        It does not affect later verdicts: those depend on the gap between header stamps alone.
        """
        last_ns, seconds = self._validator.last_stamp_ns, elapsed_ns / 1e9
        reason = f"no joint state for {seconds:.2f} s" if last_ns else "no joint state yet"
        if self.ignored:
            reason += f" ({self.ignored} named none of the robot's joints)"
        contacts = [self._unknown(name, reason, last_ns, seconds) for name in self._debouncers]
        return self._decision(tuple(contact._replace(watchdog=True) for contact in contacts))

    def _decision(self, contacts: tuple[ContactAssessment, ...]) -> Decision:
        """Return the decision on all contact points, latched if so set; note the first cause."""
        for contact in contacts:
            verdict = contact.verdict
            self._counts[verdict] += 1
            if verdict is not Verdict.UNKNOWN:
                self._had_valid_input = True
                if verdict is not Verdict.VIOLATION:
                    continue
            if self._had_valid_input and self.first_cause is None:
                self.first_cause = Cause(contact.stamp_ns, contact.contact_point, verdict, contact.reason)
        cause = self.first_cause
        if cause is not None and self.settings.latch:
            return Decision(tuple(_latched(contact, cause) for contact in contacts), 0.0, 0.0)
        allowable_speed = min([contact.allowable_speed for contact in contacts])
        return Decision(contacts, allowable_speed, min([self._scaling(contact) for contact in contacts]))

    def _scaling(self, contact: ContactAssessment) -> float:
        """Return the factor (0-1) that brings the reference speed down to the allowable speed."""
        reference_speed = self.settings.reference_speed or contact.speed
        allowable_speed = contact.allowable_speed
        if contact.verdict is Verdict.UNKNOWN or allowable_speed <= 0.0:
            return 0.0
        return 1.0 if reference_speed <= allowable_speed else allowable_speed / reference_speed

    def _assess_contact(
        self, name: str, debouncer: VerdictDebouncer, masses: EffectiveMasses, stamp_ns: int, age: float
    ) -> ContactAssessment:
        settings = self.settings
        mass, worst_mass, error = self._verdict_mass(masses)
        if error:
            obstacle_mass = stiffness = mu = force = allowable_speed = 0.0
            region = criterion = ""
            verdict, reason = Verdict.UNKNOWN, error
        else:
            speed_limit = self._limits.speed_limit(mass * self._mass_factor, self._stiffness_factor)
            limit, criterion = speed_limit.limit, speed_limit.criterion
            region, stiffness, obstacle_mass = limit.region, limit.stiffness_n_m, limit.obstacle_mass_kg
            mu = min(reduced_mass(mass, obstacle_mass), settings.mass_cap)
            if obstacle_mass == math.inf:
                obstacle_mass = 0.0
            force = peak_force(masses.speed + settings.person_speed, mu, stiffness)
            allowable_speed = max(0.0, speed_limit.allowable_speed - self._closing_speed)
            verdict, reason = self._verdict(masses, mass, speed_limit, allowable_speed)
        verdict, reason = debouncer.update(verdict, reason, stamp_ns)
        if verdict is Verdict.UNKNOWN:
            allowable_speed = 0.0
        cap = settings.mass_cap
        # By position, because keywords double the time of this call in the hot path.
        return ContactAssessment(
            stamp_ns,
            name,
            masses.direction,
            masses.speed,
            min(mass, cap),
            # min() returns its first argument if that is NaN: the mass of a missing model stays NaN.
            min(masses.lumped, cap),
            min(masses.full, cap),
            self._iso_mass,
            min(cap, worst_mass),  # NaN becomes the cap, the safe side
            obstacle_mass,
            mu,
            stiffness,
            force,
            allowable_speed,
            allowable_speed - masses.speed,
            region,
            criterion,
            verdict,
            reason,
            age,
            masses.direction == ZERO_VECTOR,
            mass > cap,
            masses.smallest_singular_value,
        )

    def _verdict(
        self, masses: EffectiveMasses, mass: float, speed_limit: SpeedLimit, allowable_speed: float
    ) -> tuple[Verdict, str]:
        """Return the verdict on this joint state alone, and the reason if it is not OK."""
        settings = self.settings
        verdict, reason = Verdict.OK, ""
        if masses.speed > speed_limit.allowable_speed - self._closing_speed:
            verdict = Verdict.VIOLATION
            reason = f"{masses.speed:.3f} m/s is above {_limit_text(speed_limit, allowable_speed)}"
        elif masses.speed > settings.warn_ratio * allowable_speed:
            verdict = Verdict.WARN
            reason = f"{masses.speed:.3f} m/s is close to {_limit_text(speed_limit, allowable_speed)}"
        best_mass, best_model = (masses.lumped, "lumped") if math.isnan(masses.full) else (masses.full, "full")
        best_mass = min(best_mass, settings.mass_cap)  # near a singular pose both masses exceed the cap
        if mass < best_mass * (1.0 - settings.model_margin):
            model = settings.effective_mass_model.value
            warning = f"the {model} mass of {mass:.3g} kg is below the {best_model} model's {best_mass:.3g} kg"
            return max(verdict, Verdict.WARN), f"{reason}; {warning}" if reason else warning
        return verdict, reason

    def _verdict_mass(self, masses: EffectiveMasses) -> tuple[float, float, str]:
        """Return the effective mass behind the verdict, that of the worst direction, and why there is none."""
        model = self.settings.effective_mass_model
        reason = self.dynamics.robot.masses_reason
        if reason:
            return 0.0, 0.0, reason
        if model is MassModel.ISO:
            mass = worst_mass = self._iso_mass
        elif model is not MassModel.FULL and math.isnan(masses.lumped):
            return 0.0, 0.0, f"no lumped mass ({masses.lumped_reason}): choose effective_mass_model full or iso"
        elif model is not MassModel.LUMPED and math.isnan(masses.full):
            return 0.0, 0.0, f"no full mass ({self.dynamics.full_reason}): choose effective_mass_model lumped or iso"
        elif model is MassModel.LUMPED:
            mass, worst_mass = masses.lumped, masses.worst_lumped
        elif model is MassModel.FULL:
            mass, worst_mass = masses.full, masses.worst_full
        else:
            mass, worst_mass = max(masses.lumped, masses.full), max(masses.worst_lumped, masses.worst_full)
        if mass < MIN_EFFECTIVE_MASS:
            reason = f"{model.value} mass = {mass:.3g} kg: must be at least {MIN_EFFECTIVE_MASS:g} kg: check the robot"
            return 0.0, 0.0, reason
        return mass, worst_mass, ""

    def _unknown(self, name: str, reason: str, stamp_ns: int, age: float) -> ContactAssessment:
        return unknown_contact(name, reason, stamp_ns, age)._replace(iso_mass=self._iso_mass)


def no_robot_decision(reason: str, *, watchdog: bool = False) -> Decision:
    """Return the decision while there is no robot to watch; `watchdog`: no joint state came either."""
    return Decision((unknown_contact("", reason, 0, 0.0)._replace(watchdog=watchdog),), 0.0, 0.0)


def unknown_contact(name: str, reason: str, stamp_ns: int, age: float) -> ContactAssessment:
    """Return an UNKNOWN without numbers: all are 0, the masses of the models NaN."""
    return ContactAssessment(
        stamp_ns=max(stamp_ns, 0),
        contact_point=name,
        direction=ZERO_VECTOR,
        speed=0.0,
        effective_mass=0.0,
        lumped_mass=NAN,
        full_mass=NAN,
        iso_mass=0.0,
        worst_direction_mass=0.0,
        obstacle_mass=0.0,
        reduced_mass=0.0,
        stiffness=0.0,
        predicted_force=0.0,
        allowable_speed=0.0,
        margin=0.0,
        body_region="",
        criterion="",
        verdict=Verdict.UNKNOWN,
        reason=reason,
        input_age=age,
        worst_direction_used=False,
        mass_capped=False,
        smallest_singular_value=0.0,
    )


def _limit_text(speed_limit: SpeedLimit, allowable_speed: float) -> str:
    return f"the {allowable_speed:.3f} m/s that the {speed_limit.criterion} limit of {speed_limit.limit.region} allows"


def _latched(contact: ContactAssessment, cause: Cause) -> ContactAssessment:
    """Return `contact` with the worse of its own and the latched verdict, and nothing allowed."""
    if severity(contact.verdict) > severity(cause.verdict):
        return contact
    point = f"{cause.contact_point}: " if cause.contact_point else ""
    reason = f"latched until reset: {point}{cause.reason}"
    return contact._replace(verdict=cause.verdict, reason=reason, allowable_speed=0.0, margin=-contact.speed)
