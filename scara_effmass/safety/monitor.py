# SPDX-License-Identifier: Apache-2.0
"""Assess joint states: the verdict and the allowable speed of each contact point."""

from __future__ import annotations

import math
from typing import NamedTuple

from scara_effmass.errors import EffmassError, RobotError
from scara_effmass.iso15066 import limits_for
from scara_effmass.iso15066.speed_limit import SpeedLimits
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety.contact_assessor import ContactAssessor
from scara_effmass.safety.debounce import UNKNOWN, VIOLATION, VerdictDebouncer, severity
from scara_effmass.safety.joint_state_adapter import JointStateAdapter, suggested_map
from scara_effmass.safety.joint_state_validator import NANOSECONDS, JointStateValidator, Motion, OtherDevice
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import (
    NAN,
    ZERO_VECTOR,
    ContactAssessment,
    Decision,
    JointState,
    Payload,
    Verdict,
)


class Cause(NamedTuple):
    """The first VIOLATION or UNKNOWN after the first valid joint state, or after the last reset."""

    stamp_ns: int
    contact_point: str
    verdict: Verdict
    reason: str


class Admitted(NamedTuple):
    """The motion in a joint state, None if it is refused for `reason`.

    With a motion, `reason` names the gap before it, from which on UNKNOWN is held; it is empty without a gap. `age` and
    the `delay` of the velocity are in [s].
    """

    motion: Motion | None
    reason: str
    stamp_ns: int
    age: float
    delay: float = 0.0


class Monitor:
    """Assesses joint states one by one. The same joint states give the same decisions, live and offline.

    `rejected` counts invalid joint states, `ignored` those of other devices. `first_cause` is what `latch` holds.
    """

    def __init__(self, dynamics: RobotDynamics, settings: MonitorSettings) -> None:
        """Watch the robot of `dynamics`.

        Raises LimitError or RobotError for `settings` that `check` refuses, and for a robot that is not in SI units.
        """
        if reason := dynamics.robot.units_reason:
            raise RobotError(f"{dynamics.robot.origin}: {reason}")
        self.dynamics = dynamics
        self.settings = settings
        self._adapter = JointStateAdapter(dynamics.robot.joint_names, settings)
        self.validator = JointStateValidator(dynamics.robot)
        self._debouncers = {name: VerdictDebouncer() for name in dynamics.contact_points}
        self.first_cause: Cause | None = None
        self._had_valid_input = False
        self._counts = [0] * len(Verdict)
        self.rejected = 0
        self.ignored = 0
        self.kernel_fault = ""
        """Where the kernel disagreed with the reference, which works alone since then; empty if nowhere."""
        topic = settings.payload_topic
        self._payload: Payload | None = None
        self.payload_reason = f"no payload on {topic} yet" if topic else ""
        """Why the payload is unknown, which makes every verdict UNKNOWN; empty if it is known."""
        self._other_names: tuple[str, ...] = ()
        self.apply(settings)

    def check(self, settings: MonitorSettings) -> SpeedLimits:
        """Return the speed limits of `settings`. Raises LimitError or RobotError for what `apply` refuses."""
        if settings.payload != self.settings.payload:
            self.dynamics.robot.rebuild(settings)
        self.dynamics.frame_index(settings.contact_normal_frame, "contact_normal_frame")
        self.dynamics.frame_index(settings.test_direction_frame, "test_direction_frame")
        return SpeedLimits(limits_for(settings), settings)

    def apply(self, settings: MonitorSettings) -> None:
        """Apply changed settings; of the robot, only the payload. Raises as `check`, and then changes nothing."""
        limits = self.check(settings)
        if settings.payload != self.settings.payload:
            self.dynamics = self.dynamics.with_payload(settings)
        self.settings = settings
        self._limits = limits
        self._reference_speed = settings.reference_speed
        self.assessor = ContactAssessor(self.dynamics, settings, limits)
        """Assesses one joint state by itself, for the present settings and payload."""
        self._adapter.apply(settings)
        self.validator.apply(settings)
        for debouncer in self._debouncers.values():
            debouncer.release_ns = round(settings.release_time * NANOSECONDS)

    @property
    def verdicts(self) -> dict[Verdict, int]:
        """Number of contact assessments per verdict, those of the watchdog included."""
        return {verdict: self._counts[verdict] for verdict in Verdict}

    @property
    def payload_text(self) -> str:
        """The payload with its sources, or why it is unknown."""
        return self.payload_reason or self.dynamics.robot.payload_text

    @property
    def lacks_kernel(self) -> bool:
        """Whether the kernel of `assessor` has yet to be loaded, and none has failed before."""
        return self.assessor.why_not is None and not self.kernel_fault

    @property
    def core(self) -> str:
        """What computes the numbers: the kernel, or Pinocchio and why."""
        why_not = self.kernel_fault or self.assessor.why_not
        return "compiled kernel" if why_not == "" else f"Pinocchio: {why_not or 'the kernel is not loaded'}"

    @property
    def joint_map_hint(self) -> str:
        """Names of the last joint state without a joint of the robot, and a `joint_map` for them; empty if none."""
        names = self._other_names
        return f"; they name {', '.join(names)}{suggested_map(names, self.dynamics.robot.joint_names)}" if names else ""

    def names_of(self, reported: tuple[str, ...]) -> tuple[str, ...]:
        """Return the names that `joint_map` and `joint_names` give to the joints of a joint state."""
        names = self._adapter.names_of(reported)
        return reported if isinstance(names, str) else names

    def reset(self) -> None:
        """Clear the first cause, and with it a latched verdict."""
        self.first_cause = None
        for debouncer in self._debouncers.values():
            debouncer.clear()

    def clear_history(self) -> None:
        """Discard earlier joint states: the node's clock jumped back, and the stamps follow."""
        self.validator.reset()
        for debouncer in self._debouncers.values():
            debouncer.clear()

    def take_clock_step(self, step_ns: int) -> None:
        """Take the step [ns] by which a simulated clock advanced, for the tolerance of stamps that lead it."""
        self.validator.take_clock_step(step_ns)

    def expect_commands(self, tolerance: float) -> None:
        """Give UNKNOWN unless each position is within `tolerance` [rad] of the latest command, [m / 4] if prismatic."""
        self.validator.expect_commands(tolerance)

    def take_command(self, command: JointState, now_ns: int) -> None:
        """Take the positions that the controller commanded, received at `now_ns` on the node's clock."""
        names = self._adapter.names_of(command.names)
        if not isinstance(names, str):
            self.validator.take_command(command._replace(names=names), now_ns)

    def take_payload(self, payload: Payload | str) -> None:
        """Use the `payload` of `payload_topic` from the next joint state on.

        An impossible payload gives UNKNOWN, and so does a text that says why the payload is unknown.
        """
        if isinstance(payload, str):
            self.payload_reason = payload
            return
        self.payload_reason = ""
        if payload != self._payload:
            try:
                self.dynamics = self.dynamics.with_payload(self.settings.with_payload(payload))
                self.assessor = ContactAssessor(self.dynamics, self.settings, self._limits)
                self._payload = payload
            except EffmassError as error:
                self.payload_reason = f"the payload is unknown: {error}"

    def assess(self, state: JointState, now_ns: int, sequence_number: int | None = None) -> Decision | None:
        """Return the decision on `state`, received at `now_ns` on the node's clock.

        `sequence_number` counts the messages of one publisher; joint states whose number does not increase come from
        several publishers, and give UNKNOWN.

        None for a joint state that names none of the robot's joints: it belongs to another device.
        """
        admitted = self.admit(state, now_ns, sequence_number)
        if admitted is None:
            return None
        motion, reason, stamp_ns, age, delay = admitted
        if motion is None:
            return self._without_numbers(reason, stamp_ns, age)
        if reason:
            for debouncer in self._debouncers.values():
                debouncer.mark_stale(reason)
        contacts = self.assessor.assess_live(motion.q, motion.qd, motion.velocity_tolerance, stamp_ns, age, delay)
        if isinstance(contacts, str):
            self.kernel_fault = contacts
            return self._without_numbers(contacts, stamp_ns, age)
        # mypyc has no fast loop for zip with keywords; both have one entry per contact point.
        pairs = zip(contacts, self._debouncers.values())  # noqa: B905
        return self._decision(tuple([_debounced(contact, debouncer) for contact, debouncer in pairs]))

    def admit(self, state: JointState, now_ns: int, sequence_number: int | None = None) -> Admitted | None:
        """Return the motion in `state`, or why it is refused, as `assess` does before it computes numbers.

        None for a joint state of another device.
        """
        validator = self.validator
        if self.went_back(now_ns):
            self.clear_history()
        previous_ns = validator.last_stamp_ns
        adapted = self._adapter.adapt(state) if self._adapter.is_needed else state
        motion = adapted if isinstance(adapted, str) else validator.validate(adapted, now_ns, sequence_number)
        if isinstance(motion, OtherDevice):
            self.ignored += 1
            self._other_names = motion.names
            return None
        age = (now_ns - state.stamp_ns) / 1e9 if state.stamp_ns > 0 else 0.0
        if isinstance(motion, str):
            self.rejected += 1
            return Admitted(None, motion, max(state.stamp_ns, 0) or now_ns, age)
        if self.payload_reason:
            return Admitted(None, self.payload_reason, state.stamp_ns, age)
        reason = ""
        if previous_ns and state.stamp_ns - previous_ns > validator.timeout_ns:
            reason = f"no joint state for {(state.stamp_ns - previous_ns) / 1e9:.3f} s"
        if self._adapter.is_needed:
            pairs = zip(motion.velocity_tolerance, self._adapter.velocity_change, strict=True)
            motion = motion._replace(velocity_tolerance=[tolerated + change for tolerated, change in pairs])
        return Admitted(motion, reason, state.stamp_ns, age, self._adapter.delay_s)

    def went_back(self, now_ns: int) -> bool:
        """Return whether system time was set back, which raises no jump callback."""
        return self.validator.last_stamp_ns > now_ns + self.validator.future_tolerance_ns

    def reject(self, reason: str, stamp_ns: int = 0, age: float = 0.0) -> Decision:
        """Return the decision on a joint state that is invalid for `reason`, such as undecodable bytes."""
        self.rejected += 1
        return self._without_numbers(reason, stamp_ns, age)

    def _without_numbers(self, reason: str, stamp_ns: int, age: float) -> Decision:
        """Return UNKNOWN for every contact point, and hold it."""
        for debouncer in self._debouncers.values():
            debouncer.mark_stale(reason)
        return self._decision(tuple(self._unknown(name, reason, stamp_ns, age) for name in self._debouncers))

    def watchdog_decision(self, elapsed_ns: int, now_ns: int = 0) -> Decision:
        """Return the decision when no joint state has come for `elapsed_ns` of steady time.

        Its stamp is that of the last valid joint state, or `now_ns` on the node's clock if there was none.
        It does not affect later verdicts: those depend on the gap between header stamps alone.
        """
        last_ns, seconds = self.validator.last_stamp_ns, elapsed_ns / 1e9
        reason = f"no joint state for {seconds:.2f} s" if last_ns else "no joint state yet"
        if self.ignored:
            reason += f" ({self.ignored} named none of the robot's joints){self.joint_map_hint}"
        contacts = [self._unknown(name, reason, last_ns or now_ns, seconds) for name in self._debouncers]
        return self._decision(tuple(contact._replace(watchdog=True) for contact in contacts))

    def _decision(self, contacts: tuple[ContactAssessment, ...]) -> Decision:
        """Return the decision on all contact points, latched if so set; note the first cause."""
        min_allowable_speed, min_scaling = math.inf, 1.0
        for contact in contacts:
            verdict, allowable_speed = contact.verdict, contact.allowable_speed
            min_allowable_speed = min(min_allowable_speed, allowable_speed)
            reference_speed = self._reference_speed or contact.speed
            if verdict is UNKNOWN or allowable_speed <= 0.0:
                min_scaling = 0.0
            elif reference_speed > allowable_speed:
                min_scaling = min(min_scaling, allowable_speed / reference_speed)
            self._counts[verdict] += 1
            if verdict is not UNKNOWN:
                self._had_valid_input = True
                if verdict is not VIOLATION:
                    continue
            if self._had_valid_input and self.first_cause is None:
                self.first_cause = Cause(contact.stamp_ns, contact.contact_point, verdict, contact.reason)
        cause = self.first_cause
        if cause is not None and self.settings.latch:
            return Decision(tuple(_latched(contact, cause) for contact in contacts), 0.0, 0.0)
        return Decision(contacts, min_allowable_speed, min_scaling)

    def _unknown(self, name: str, reason: str, stamp_ns: int, age: float) -> ContactAssessment:
        return unknown_contact(name, reason, stamp_ns, age)._replace(iso_mass=self.assessor.iso_mass)


def unknown_decision(
    reason: str, stamp_ns: int = 0, contact_points: tuple[str, ...] = ("",), *, watchdog: bool = False
) -> Decision:
    """Return a decision without a monitor: UNKNOWN for each contact point; `watchdog`: it answers no joint state.

    Without a robot there is one contact point, without a name.
    """
    contacts = (unknown_contact(name, reason, stamp_ns, 0.0) for name in contact_points)
    return Decision(tuple(contact._replace(watchdog=watchdog) for contact in contacts), 0.0, 0.0)


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


def _debounced(contact: ContactAssessment, debouncer: VerdictDebouncer) -> ContactAssessment:
    """Return `contact` with its debounced verdict and reason, and nothing allowed under UNKNOWN."""
    own = contact.verdict
    verdict, reason = debouncer.update(own, contact.reason, contact.stamp_ns)
    if verdict is own:
        return contact
    if verdict is UNKNOWN:
        return contact._replace(verdict=verdict, reason=reason, allowable_speed=0.0, margin=-contact.speed)
    return contact._replace(verdict=verdict, reason=reason)


def _latched(contact: ContactAssessment, cause: Cause) -> ContactAssessment:
    """Return `contact` with the worse of its own and the latched verdict, and nothing allowed."""
    if severity(contact.verdict) > severity(cause.verdict):
        return contact
    point = f"{cause.contact_point}: " if cause.contact_point else ""
    reason = f"latched until reset: {point}{cause.reason}"
    return contact._replace(verdict=cause.verdict, reason=reason, allowable_speed=0.0, margin=-contact.speed)
