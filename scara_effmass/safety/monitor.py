"""The verdict: from a joint state to what each contact point may do."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from scara_effmass.iso15066 import LIGHTEST_MASS, SpeedLimits, limits_for, peak_force, reduced_mass
from scara_effmass.safety.debounce import VerdictDebouncer, severity
from scara_effmass.safety.joint_state_validator import NANOSECONDS, JointStateValidator, OtherDevice
from scara_effmass.settings import MassModel
from scara_effmass.values import NAN, ContactAssessment, Decision, Verdict

if TYPE_CHECKING:
    from scara_effmass.iso15066 import SpeedLimit
    from scara_effmass.model.dynamics import EffectiveMasses, RobotDynamics
    from scara_effmass.settings import MonitorSettings
    from scara_effmass.values import JointState

NOWHERE = (0.0, 0.0, 0.0)


class Cause(NamedTuple):
    """The first VIOLATION or UNKNOWN since joint states were first understood, or since the last reset."""

    stamp_ns: int
    contact_point: str
    verdict: Verdict
    reason: str


class Monitor:
    """Decides, joint state by joint state. The same states give the same decisions, live and offline."""

    def __init__(self, dynamics: RobotDynamics, settings: MonitorSettings) -> None:
        """Watch the robot of `dynamics`. Raises LimitError for `settings` that loosen a limit of the standard."""
        self.dynamics = dynamics
        self._intake = JointStateValidator(dynamics.robot)
        self._iso_mass = 0.0 if dynamics.robot.masses_reason else dynamics.robot.iso_mass
        self._holds = {name: VerdictDebouncer() for name in dynamics.contact_points}
        self.first_cause: Cause | None = None
        self._understood = False
        self._counts = [0] * len(Verdict)
        self.rejected = 0
        self.ignored = 0
        self.apply(settings)

    def apply(self, settings: MonitorSettings) -> None:
        """Take over changed settings; the robot stays. Raises LimitError, and then changes nothing."""
        limits = SpeedLimits(limits_for(settings))
        self.settings = settings
        self._limits = limits
        self._intake.apply(settings)
        self._mass_factor = 1.0 + settings.mass_uncertainty
        self._stiffness_factor = 1.0 + settings.stiffness_uncertainty
        self._closing_speed = settings.person_speed + settings.speed_uncertainty
        for hold in self._holds.values():
            hold.release_ns = round(settings.release_time * NANOSECONDS)

    @property
    def verdicts(self) -> dict[Verdict, int]:
        """How often each verdict was given, contact point by contact point, silence included."""
        return {verdict: self._counts[verdict] for verdict in Verdict}

    def reset(self) -> None:
        """Clear the first cause, and with it a latched verdict."""
        self.first_cause = None
        for hold in self._holds.values():
            hold.clear()

    def clear_history(self) -> None:
        """Forget earlier joint states: the node's clock has jumped back, and stamps will with it."""
        self._intake.forget()
        for hold in self._holds.values():
            hold.clear()

    def assess(self, state: JointState, now_ns: int) -> Decision | None:
        """Return the decision for `state` as seen at `now_ns` on the node's clock.

        None for a joint state that names none of the robot's joints: it is another device's, and is counted.
        """
        intake = self._intake
        previous_ns = intake.last_stamp_ns
        if previous_ns > now_ns + intake.future_ns:
            # It was no future when it came: the clock has been set back, which system time tells nobody.
            self.clear_history()
            previous_ns = 0
        motion = intake.check(state, now_ns)
        if isinstance(motion, OtherDevice):
            self.ignored += 1
            return None
        age = (now_ns - state.stamp_ns) / 1e9 if state.stamp_ns > 0 else 0.0
        if isinstance(motion, str):
            return self.reject(motion, state.stamp_ns, age)
        if previous_ns and state.stamp_ns - previous_ns > intake.timeout_ns:
            for hold in self._holds.values():
                hold.mark_stale(f"no joint state for {(state.stamp_ns - previous_ns) / 1e9:.3f} s")
        effective_masses = self.dynamics.effective_masses(motion.q, motion.qd, self.settings.speed_threshold)
        contacts = [
            self._judged(name, hold, p, state.stamp_ns, age)
            for (name, hold), p in zip(self._holds.items(), effective_masses, strict=True)
        ]
        return self._decided(tuple(contacts))

    def reject(self, reason: str, stamp_ns: int = 0, age: float = 0.0) -> Decision:
        """Return the decision for a joint state that cannot be used for `reason`, such as unreadable bytes."""
        self.rejected += 1
        for hold in self._holds.values():
            hold.mark_stale(reason)
        return self._decided(tuple(self._unknown(name, reason, stamp_ns, age) for name in self._holds))

    def watchdog_decision(self, elapsed_ns: int) -> Decision:
        """Return the decision when no joint state has come for `elapsed_ns` of steady time.

        It changes no verdict of later joint states: a gap in their own stamps does that.
        """
        seconds = elapsed_ns / 1e9
        reason = f"no joint state for {seconds:.2f} s" if self._intake.last_stamp_ns else "no joint state yet"
        if self.ignored:
            reason += f" ({self.ignored} named none of the robot's joints)"
        contacts = [self._unknown(name, reason, self._intake.last_stamp_ns, seconds) for name in self._holds]
        return self._decided(tuple(contact._replace(watchdog=True) for contact in contacts))

    def _decided(self, contacts: tuple[ContactAssessment, ...]) -> Decision:
        for contact in contacts:
            verdict = contact.verdict
            self._counts[verdict] += 1
            if verdict is not Verdict.UNKNOWN:
                self._understood = True
                if verdict is not Verdict.VIOLATION:
                    continue
            if self._understood and self.first_cause is None:
                self.first_cause = Cause(contact.stamp_ns, contact.contact_point, verdict, contact.reason)
        cause = self.first_cause
        if cause is not None and self.settings.latch:
            return Decision(tuple(_latched(contact, cause) for contact in contacts), 0.0, 0.0)
        allowable = min([contact.allowable_speed for contact in contacts])
        return Decision(contacts, allowable, min([self._scaling(contact) for contact in contacts]))

    def _scaling(self, contact: ContactAssessment) -> float:
        wanted = self.settings.reference_speed or contact.speed
        allowable = contact.allowable_speed
        if contact.verdict is Verdict.UNKNOWN or allowable <= 0.0:
            return 0.0
        return 1.0 if wanted <= allowable else allowable / wanted

    def _judged(
        self, name: str, hold: VerdictDebouncer, p: EffectiveMasses, stamp_ns: int, age: float
    ) -> ContactAssessment:
        settings = self.settings
        mass, worst, trouble = self._mass_of_verdict(p)
        if trouble:
            obstacle_mass = stiffness = mu = force = allowable = 0.0
            region = criterion = ""
            verdict, reason = Verdict.UNKNOWN, trouble
        else:
            ceiling = self._limits.speed_limit(mass * self._mass_factor, self._stiffness_factor)
            limit, criterion = ceiling.limit, ceiling.criterion
            region, stiffness, obstacle_mass = limit.region, limit.stiffness_n_m, limit.obstacle_mass_kg
            mu = min(reduced_mass(mass, obstacle_mass), settings.mass_cap)
            if obstacle_mass == math.inf:
                obstacle_mass = 0.0
            force = peak_force(p.speed + settings.person_speed, mu, stiffness)
            allowable = max(0.0, ceiling.allowable_speed - self._closing_speed)
            verdict, reason = self._verdict(p, mass, ceiling, allowable)
        verdict, reason = hold.update(verdict, reason, stamp_ns)
        if verdict is Verdict.UNKNOWN:
            allowable = 0.0
        cap = settings.mass_cap
        # By position, in the order of the fields: by name it takes twice as long, and this is the hot path.
        return ContactAssessment(
            stamp_ns,
            name,
            p.direction,
            p.speed,
            min(mass, cap),
            # min() keeps a NaN that stands first: a mass without a model stays NaN.
            min(p.lumped, cap),
            min(p.full, cap),
            self._iso_mass,
            min(cap, worst),  # in this order NaN becomes the cap: the safe end of what is not known
            obstacle_mass,
            mu,
            stiffness,
            force,
            allowable,
            allowable - p.speed,
            region,
            criterion,
            verdict,
            reason,
            age,
            p.direction == NOWHERE,
            mass > cap,
            p.smallest_singular_value,
        )

    def _verdict(self, p: EffectiveMasses, mass: float, ceiling: SpeedLimit, allowable: float) -> tuple[Verdict, str]:
        """Return the verdict on this joint state alone, and why it is not OK."""
        settings = self.settings
        verdict, reason = Verdict.OK, ""
        if p.speed > ceiling.allowable_speed - self._closing_speed:
            verdict, reason = Verdict.VIOLATION, f"{p.speed:.3f} m/s is above {_allowed(ceiling, allowable)}"
        elif p.speed > settings.warn_ratio * allowable:
            verdict, reason = Verdict.WARN, f"{p.speed:.3f} m/s nears {_allowed(ceiling, allowable)}"
        known, which = (p.lumped, "lumped") if math.isnan(p.full) else (p.full, "full")
        known = min(known, settings.mass_cap)  # near a singular pose both are beyond it, and no number means much
        if mass < known * (1.0 - settings.model_margin):
            used = settings.effective_mass_model.value
            lighter = f"the {used} mass of {mass:.3g} kg is below the {which} model's {known:.3g} kg"
            return max(verdict, Verdict.WARN), f"{reason}; {lighter}" if reason else lighter
        return verdict, reason

    def _mass_of_verdict(self, p: EffectiveMasses) -> tuple[float, float, str]:
        """Return the effective mass that counts, that of its worst direction, and why there is none."""
        model = self.settings.effective_mass_model
        reason = self.dynamics.robot.masses_reason
        if reason:
            return 0.0, 0.0, reason
        if model is MassModel.ISO:
            return self._iso_mass, self._iso_mass, ""
        if model is not MassModel.FULL and math.isnan(p.lumped):
            return 0.0, 0.0, f"no lumped mass ({p.lumped_reason}): choose effective_mass_model full or iso"
        if model is not MassModel.LUMPED and math.isnan(p.full):
            return 0.0, 0.0, f"no full mass ({self.dynamics.full_reason}): choose effective_mass_model lumped or iso"
        if model is MassModel.LUMPED:
            mass, worst = p.lumped, p.worst_lumped
        elif model is MassModel.FULL:
            mass, worst = p.full, p.worst_full
        else:
            mass, worst = max(p.lumped, p.full), max(p.worst_lumped, p.worst_full)
        if mass < LIGHTEST_MASS:
            return 0.0, 0.0, f"an effective mass of {mass:.3g} kg cannot be: the robot description is wrong"
        return mass, worst, ""

    def _unknown(self, name: str, reason: str, stamp_ns: int, age: float) -> ContactAssessment:
        return unknown_contact(name, reason, stamp_ns, age)._replace(iso_mass=self._iso_mass)


def no_robot_decision(reason: str, *, watchdog: bool = False) -> Decision:
    """Return the decision while there is no robot to watch; `watchdog` where no joint state asked for it."""
    return Decision((unknown_contact("", reason, 0, 0.0)._replace(watchdog=watchdog),), 0.0, 0.0)


def unknown_contact(name: str, reason: str, stamp_ns: int, age: float) -> ContactAssessment:
    """Return an UNKNOWN of which nothing but the reason is known: all numbers 0, the masses of the models NaN."""
    return ContactAssessment(
        stamp_ns=max(stamp_ns, 0),
        contact_point=name,
        direction=NOWHERE,
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


def _allowed(ceiling: SpeedLimit, allowable: float) -> str:
    return f"the {allowable:.3f} m/s that the {ceiling.criterion} limit of {ceiling.limit.region} allows"


def _latched(contact: ContactAssessment, cause: Cause) -> ContactAssessment:
    """Return `contact` under the latched `cause`: nothing is allowed, and the worse verdict of the two holds."""
    if severity(contact.verdict) > severity(cause.verdict):
        return contact
    at = f"{cause.contact_point}: " if cause.contact_point else ""
    reason = f"latched until reset: {at}{cause.reason}"
    return contact._replace(verdict=cause.verdict, reason=reason, allowable_speed=0.0, margin=-contact.speed)
