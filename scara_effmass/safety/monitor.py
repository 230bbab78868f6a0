# SPDX-License-Identifier: Apache-2.0
"""Assess joint states: the verdict and the allowable speed of each contact point."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from scara_effmass.errors import EffmassError, RobotError
from scara_effmass.iso15066 import (
    MIN_EFFECTIVE_MASS,
    Limit,
    Mobility,
    SpeedLimit,
    SpeedLimits,
    limits_for,
    peak_force,
    reduced_mass,
)
from scara_effmass.iso15066.mobility_matrix import Matrix
from scara_effmass.model.dynamics import EffectiveMasses, ModelMass, RobotDynamics, effective_mass
from scara_effmass.model.lumping import is_scara
from scara_effmass.safety.debounce import VerdictDebouncer, severity
from scara_effmass.safety.joint_state_adapter import JointStateAdapter, suggested_map
from scara_effmass.safety.joint_state_validator import NANOSECONDS, JointStateValidator, OtherDevice
from scara_effmass.settings import ContactType, Drives, MassModel, MonitorSettings
from scara_effmass.values import (
    NAN,
    NO_MOBILITY,
    ZERO_VECTOR,
    ContactAssessment,
    Decision,
    FloatArray,
    JointState,
    Mobility6,
    Payload,
    Vector3,
    Verdict,
)

MIN_NORMAL_COMPONENT = 0.1
"""Smallest share of the speed that counts along a fixed normal: its direction is known to about 6 degrees."""
_LUMPED = (MassModel.LUMPED, MassModel.LARGEST, MassModel.AUTO)
_FULL = (MassModel.FULL, MassModel.LARGEST, MassModel.AUTO)
NO_CLAMPING_FORCE = (
    "the clamping force is unknown: set the effort limits of the joints in the robot file, or external_force_limit"
)
_AXES: tuple[Vector3, ...] = tuple(
    (sign * x, sign * y, sign * z)
    for sign in (1.0, -1.0)
    for x, y, z in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
)


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
        """Watch the robot of `dynamics`.

        Raises LimitError or RobotError for `settings` that `check` refuses, and for a robot that is not in SI units.
        """
        if reason := dynamics.robot.units_reason:
            raise RobotError(f"{dynamics.robot.origin}: {reason}")
        self._use(dynamics)
        self.settings = settings
        self._adapter = JointStateAdapter(dynamics.robot.joint_names, settings)
        self._validator = JointStateValidator(dynamics.robot)
        self._debouncers = {name: VerdictDebouncer() for name in dynamics.contact_points}
        self.first_cause: Cause | None = None
        self._had_valid_input = False
        self._counts = [0] * len(Verdict)
        self.rejected = 0
        self.ignored = 0
        topic = settings.payload_topic
        self._payload: Payload | None = None
        self.payload_reason = f"no payload on {topic} yet" if topic else ""
        """Why the payload is unknown, which makes every verdict UNKNOWN; empty if it is known."""
        self._other_names: tuple[str, ...] = ()
        self.apply(settings)

    def _use(self, dynamics: RobotDynamics) -> None:
        self.dynamics = dynamics
        self._masses_reason = dynamics.robot.masses_reason
        self._iso_mass = 0.0 if self._masses_reason else dynamics.robot.iso_mass
        self._is_scara = is_scara(dynamics.robot)

    def check(self, settings: MonitorSettings) -> SpeedLimits:
        """Return the speed limits of `settings`. Raises LimitError or RobotError for what `apply` refuses."""
        if settings.payload != self.settings.payload:
            self.dynamics.robot.rebuild(settings)
        q = np.zeros(self.dynamics.robot.model.nv)
        self.dynamics.in_base(q, settings.fixed_normal or ZERO_VECTOR, settings.contact_normal_frame)
        self.dynamics.in_base(q, ZERO_VECTOR, settings.test_direction_frame, "test_direction_frame")
        return SpeedLimits(limits_for(settings), settings)

    def apply(self, settings: MonitorSettings) -> None:
        """Apply changed settings; of the robot, only the payload. Raises as `check`, and then changes nothing."""
        limits = self.check(settings)
        if settings.payload != self.settings.payload:
            self._use(self.dynamics.with_payload(settings))
        self.settings = settings
        self._limits = limits
        self._adapter.apply(settings)
        self._validator.apply(settings)
        self._is_auto = settings.effective_mass_model is MassModel.AUTO
        self._mass_factor = 1.0 + settings.mass_uncertainty
        margin = f"more than {100.0 * settings.model_margin:.3g} % lighter than the full model"
        self._heavy_enough, self._lighter = f"nowhere {margin}", f"the lumped model is {margin} along some direction"
        self._weakest = min(limits.limits, key=lambda limit: limit.permissible_force_n)
        self._normal_text = f"{settings.contact_normal} {settings.contact_normal_frame}".strip()
        self._test_direction = settings.fixed_test_direction
        self._normal_is_known = settings.contact_normal != "worst"
        # Along the velocity the bound is that of the paper and of the standard, in the pose of the first touch.
        choices = {} if settings.contact_normal == "velocity" else {"lumped": _LUMPED, "full": _FULL}
        self._changes = [name for name, choice in choices.items() if settings.effective_mass_model in choice]
        self._drives_push = settings.drives is Drives.SERVO
        self._joints_are_held = self._drives_push and not settings.servo.computed_torque
        self._clamps = settings.contact is ContactType.QUASI_STATIC
        self._closing_speed = settings.person_speed + settings.speed_uncertainty
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
        self._adapter.reset()
        self._validator.reset()
        for debouncer in self._debouncers.values():
            debouncer.clear()

    def take_clock_step(self, step_ns: int) -> None:
        """Take the step [ns] by which a simulated clock advanced, for the tolerance of stamps that lead it."""
        self._validator.take_clock_step(step_ns)

    def expect_commands(self, tolerance: float) -> None:
        """Give UNKNOWN unless each position is within `tolerance` [rad] of the latest command, [m / 4] if prismatic."""
        self._validator.expect_commands(tolerance)

    def take_command(self, command: JointState, now_ns: int) -> None:
        """Take the positions that the controller commanded, received at `now_ns` on the node's clock."""
        names = self._adapter.names_of(command.names)
        if not isinstance(names, str):
            self._validator.take_command(command._replace(names=names), now_ns)

    def take_payload(self, payload: Payload | str) -> None:
        """Count `payload` of `payload_topic` from the next joint state on.

        UNKNOWN follows from an impossible payload, and from a text that says why it is unknown.
        """
        if isinstance(payload, str):
            self.payload_reason = payload
            return
        self.payload_reason = ""
        if payload != self._payload:
            try:
                self._use(self.dynamics.with_payload(self.settings.with_payload(payload)))
                self._payload = payload
            except EffmassError as error:
                self.payload_reason = f"the payload is unknown: {error}"

    def assess(self, state: JointState, now_ns: int, sequence_number: int | None = None) -> Decision | None:
        """Return the decision on `state`, received at `now_ns` on the node's clock.

        `sequence_number` counts the messages of one publisher; joint states whose number does not increase come from
        several publishers, and give UNKNOWN.

        None for a joint state that names none of the robot's joints: it belongs to another device.
        """
        validator = self._validator
        previous_ns = validator.last_stamp_ns
        if previous_ns > now_ns + validator.future_tolerance_ns:
            # System time was set back, which raises no jump callback.
            self.clear_history()
            previous_ns = 0
        adapted = self._adapter.adapt(state) if self._adapter.is_needed else state
        motion = adapted if isinstance(adapted, str) else validator.validate(adapted, now_ns, sequence_number)
        if isinstance(motion, OtherDevice):
            self.ignored += 1
            self._other_names = motion.names
            return None
        age = (now_ns - state.stamp_ns) / 1e9 if state.stamp_ns > 0 else 0.0
        if isinstance(motion, str):
            return self.reject(motion, max(state.stamp_ns, 0) or now_ns, age)
        if self.payload_reason:
            return self._without_numbers(self.payload_reason, state.stamp_ns, age)
        if previous_ns and state.stamp_ns - previous_ns > validator.timeout_ns:
            for debouncer in self._debouncers.values():
                debouncer.mark_stale(f"no joint state for {(state.stamp_ns - previous_ns) / 1e9:.3f} s")
        tolerance = motion.velocity_tolerance
        if self._adapter.is_needed:
            changes = self._adapter.velocity_change
            tolerance = [tolerated + change for tolerated, change in zip(tolerance, changes, strict=True)]
        effective_masses = self.dynamics.effective_masses(
            motion.q,
            motion.qd,
            self.settings.speed_threshold,
            tolerance,
            self._changes,
            self.settings.model_margin if self._is_auto and self._is_scara else None,
        )
        contacts = [
            self._assess_contact(index, name, debouncer, masses, motion.q, motion.qd, state.stamp_ns, age)
            for index, ((name, debouncer), masses) in enumerate(
                zip(self._debouncers.items(), effective_masses, strict=True)
            )
        ]
        return self._decision(tuple(contacts))

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
        last_ns, seconds = self._validator.last_stamp_ns, elapsed_ns / 1e9
        reason = f"no joint state for {seconds:.2f} s" if last_ns else "no joint state yet"
        if self.ignored:
            reason += f" ({self.ignored} named none of the robot's joints){self.joint_map_hint}"
        contacts = [self._unknown(name, reason, last_ns or now_ns, seconds) for name in self._debouncers]
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
        self,
        index: int,
        name: str,
        debouncer: VerdictDebouncer,
        masses: EffectiveMasses,
        q: FloatArray,
        qd: FloatArray,
        stamp_ns: int,
        age: float,
    ) -> ContactAssessment:
        settings, cap = self.settings, self.settings.mass_cap
        models, why = self._models(masses)
        error = "" if models else why
        clamping_force = self._clamping_force(masses, q, index) if self._clamps else 0.0
        if clamping_force == math.inf:
            clamping_force = 0.0
            error = error or NO_CLAMPING_FORCE
        mass = worst_mass = obstacle_mass = stiffness = mu = worst_mu = force = force_bound = allowable_speed = 0.0
        region = criterion = model_name = model_reason = ""
        test_direction, test_mass = self._along_test_direction(models, masses, q)
        if error:
            verdict, reason = Verdict.UNKNOWN, error
        else:
            model_name, mass, worst_mass = models[0][:3]
            model_reason = why
            for model in models[1:]:
                worst_mass = max(worst_mass, model.worst_mass)
                if model.mass > mass and why is not self._heavy_enough:
                    mass, model_name = model.mass, model.name
            any_normal = _any_normal(models, masses)
            held = [
                self.dynamics.composite_mass(q, qd, index, model.name, masses)
                for model in models
                if self._joints_are_held and model.mobility
            ]
            if self._normal_is_known:
                mobilities, share = self._at_normal(models + held, masses, q)
            else:
                mobilities, share = any_normal + _any_normal(held, masses), 1.0
            push = (self.dynamics.drive_acceleration(q, index), 1.0 / worst_mass) if self._drives_push else None
            speed_limit = self._limits.worst_normal(mobilities, self._mass_factor, push)
            limit, criterion = speed_limit.limit, speed_limit.criterion
            region, stiffness, obstacle_mass = limit.region, limit.stiffness_n_m, limit.obstacle_mass_kg
            mu = min(reduced_mass(mass, obstacle_mass), cap)
            worst_mu = 0.0
            for mobility in any_normal:
                worst_mu = max(worst_mu, mobility.worst_reduced_mass(1.0 / obstacle_mass))
            worst_mu = min(worst_mu, cap)
            if obstacle_mass == math.inf:
                obstacle_mass = 0.0
            force = peak_force(masses.speed + settings.person_speed, mu, stiffness)
            closing_speed = self._closing_speed + masses.speed_tolerance
            force_bound = speed_limit.force(masses.speed * share + closing_speed, cap)
            # Below 0 if the person's own speed is too much.
            nominal_speed = (speed_limit.allowable_speed - closing_speed) / share
            allowable_speed = max(0.0, nominal_speed)
            verdict, reason = self._verdict(masses, mass, speed_limit, nominal_speed)
            if clamping_force > self._weakest.permissible_force_n:
                allowable_speed = 0.0
                verdict, reason = Verdict.VIOLATION, _clamping_text(clamping_force, self._weakest)
        verdict, reason = debouncer.update(verdict, reason, stamp_ns)
        if verdict is Verdict.UNKNOWN:
            allowable_speed = 0.0
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
            False,  # noqa: FBT003 - watchdog
            worst_mu,
            force_bound,
            clamping_force,
            NO_MOBILITY if masses.has_massless_direction else _entries(masses.lumped_mobility),
            _entries(masses.full_mobility),
            self._normal_text,
            model_name,
            model_reason,
            test_direction,
            min(test_mass, cap),
            self._adapter.delay_s,
        )

    def _along_test_direction(
        self, models: list[ModelMass], masses: EffectiveMasses, q: FloatArray
    ) -> tuple[Vector3, float]:
        """Return the test direction in base axes, and the largest mass of `models` along it [kg]; 0 if one has none."""
        if self._test_direction is None:
            return ZERO_VECTOR, 0.0
        direction = self.dynamics.in_base(q, self._test_direction, self.settings.test_direction_frame)
        if masses.has_massless_direction and any(model.name == "lumped" for model in models):
            return direction, 0.0
        along = [effective_mass(model.mobility, direction) if model.mobility else model.mass for model in models]
        return direction, max(along, default=0.0)

    def _at_normal(
        self, models: list[ModelMass], masses: EffectiveMasses, q: FloatArray
    ) -> tuple[list[Mobility], float]:
        """Return the mobilities along the contact normal of the settings, and the share of the speed along it."""
        settings, velocity = self.settings, masses.direction
        if settings.fixed_normal is None:
            return [Mobility.of_mass(model.mass) for model in models], 1.0
        normal = self.dynamics.in_base(q, settings.fixed_normal, settings.contact_normal_frame)
        share = abs(sum(n * v for n, v in zip(normal, velocity, strict=True)))
        share = 1.0 if velocity == ZERO_VECTOR else max(share, MIN_NORMAL_COMPONENT)
        mobilities = []
        for model in models:
            if model.mobility:
                change = model.change and model.change.along(normal, share * masses.speed)
                mobilities.append(Mobility.of_matrix(model.mobility, normal, masses.rank, change).along_normal())
            else:
                mobilities.append(Mobility.of_mass(model.mass))
        return mobilities, share

    def _verdict(
        self, masses: EffectiveMasses, mass: float, speed_limit: SpeedLimit, nominal_speed: float
    ) -> tuple[Verdict, str]:
        """Return the verdict on this joint state alone, and the reason if it is not OK.

        `nominal_speed` [m/s] is the allowable speed; it may be negative.
        """
        settings = self.settings
        verdict, reason = Verdict.OK, ""
        if masses.speed > nominal_speed:
            verdict = Verdict.VIOLATION
            reason = f"{masses.speed:.3f} m/s is above {_limit_text(speed_limit, nominal_speed)}"
        elif masses.speed > settings.warn_ratio * nominal_speed:
            verdict = Verdict.WARN
            reason = f"{masses.speed:.3f} m/s is close to {_limit_text(speed_limit, nominal_speed)}"
        best_mass, best_model = (masses.lumped, "lumped") if math.isnan(masses.full) else (masses.full, "full")
        best_mass = min(best_mass, settings.mass_cap)  # near a singular pose both masses exceed the cap
        if mass < best_mass * (1.0 - settings.model_margin):
            model = settings.effective_mass_model.value
            warning = f"the {model} mass of {mass:.3g} kg is below the {best_model} model's {best_mass:.3g} kg"
            return max(verdict, Verdict.WARN), f"{reason}; {warning}" if reason else warning
        return verdict, reason

    def _models(self, masses: EffectiveMasses) -> tuple[list[ModelMass], str]:
        """Return the models behind the verdict and why these; without one, why there is none."""
        choice = self.settings.effective_mass_model
        if self._masses_reason:
            return [], self._masses_reason
        names, why = self._choice(masses)
        if choice is MassModel.LUMPED and not names:
            return [], f"no lumped mass ({masses.lumped_reason}): choose effective_mass_model auto, full or iso"
        if choice is MassModel.FULL and not names:
            return [], f"no full mass ({self.dynamics.full_reason}): choose effective_mass_model auto, lumped or iso"
        models = []
        for name in names:
            if name == "lumped":
                change = masses.lumped_change
                model = ModelMass(name, masses.lumped, masses.worst_lumped, masses.lumped_mobility, change)
            elif name == "full":
                model = ModelMass(name, masses.full, masses.worst_full, masses.full_mobility, masses.full_change)
            else:
                model = ModelMass(name, self._iso_mass, self._iso_mass, [], None)
            models.append(model)
            if model.mass < MIN_EFFECTIVE_MASS:
                minimum = f"must be at least {MIN_EFFECTIVE_MASS:g} kg: check the robot"
                return [], f"{model.name} mass = {model.mass:.3g} kg: {minimum}"
            if math.isnan(model.worst_mass) and self.settings.contact_normal != "velocity":
                return [], (
                    f"no {model.name} mass for every contact normal, because a joint moves no lumped mass: choose "
                    "effective_mass_model auto or full, or contact_normal velocity"
                )
        return models, why

    def _choice(self, masses: EffectiveMasses) -> tuple[list[str], str]:
        """Return the names of the models that decide, none if the chosen one is missing, and why these."""
        settings, choice = self.settings, self.settings.effective_mass_model
        has_lumped, has_full = not math.isnan(masses.lumped), not math.isnan(masses.full)
        if not self._is_auto:
            there = {"lumped": has_lumped and choice in _LUMPED, "full": has_full and choice in _FULL}
            there["iso"] = choice in {MassModel.ISO, MassModel.LARGEST}
            return [name for name, is_there in there.items() if is_there], f"effective_mass_model {choice.value}"
        if masses.lumped_is_heavy_enough(settings.model_margin):
            # The change of pose can differ more than the mass: but for a SCARA, the full model bounds the speed, too.
            return ["lumped"] if self._is_scara else ["lumped", "full"], self._heavy_enough
        lumped_reason = masses.lumped_reason
        if masses.has_massless_direction:
            lumped_reason = lumped_reason or "a joint moves the contact point, but no lumped mass"
            has_lumped = False
        if has_full:
            return ["full"], self._lighter if has_lumped else f"no lumped mass: {lumped_reason}"
        if not has_lumped:
            return ["iso"], f"no full mass: {self.dynamics.full_reason}; no lumped mass: {lumped_reason}"
        # Without inertias nothing shows whether the lumped mass of another arm than a SCARA is too light.
        names = ["lumped"] if self._is_scara else ["lumped", "iso"]
        return names, f"largest of {' and '.join(names)}, no full mass: {self.dynamics.full_reason}"

    def _clamping_force(self, masses: EffectiveMasses, q: FloatArray, index: int) -> float:
        """Return the largest static force [N] of the drives, along a fixed normal, the velocity, or else any axis.

        Infinite if it is unknown.
        """
        settings, dynamics = self.settings, self.dynamics
        directions: tuple[Vector3, ...] = (masses.direction,)
        if settings.fixed_normal is not None:
            x, y, z = dynamics.in_base(q, settings.fixed_normal, settings.contact_normal_frame)
            directions = (x, y, z), (-x, -y, -z)
        elif masses.direction == ZERO_VECTOR:
            directions = _AXES
        force = dynamics.clamping_force(q, index, *directions)
        return min(force, settings.external_force_limit or math.inf)

    def _unknown(self, name: str, reason: str, stamp_ns: int, age: float) -> ContactAssessment:
        return unknown_contact(name, reason, stamp_ns, age)._replace(iso_mass=self._iso_mass)


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


def _limit_text(speed_limit: SpeedLimit, nominal_speed: float) -> str:
    limit = f"the {speed_limit.criterion} limit of {speed_limit.limit.region}"
    return f"the {max(nominal_speed, 0.0):.3f} m/s that {limit} allows"


def _clamping_text(force: float, limit: Limit) -> str:
    permissible = f"the {limit.permissible_force_n:.0f} N of {limit.region}"
    return f"the drives can clamp with {force:.0f} N, above {permissible}, at any speed"


def _any_normal(models: list[ModelMass], masses: EffectiveMasses) -> list[Mobility]:
    """Return the mobilities of `models` for any contact normal: at rest those of the worst direction."""
    if masses.direction == ZERO_VECTOR:
        return [Mobility.of_mass(model.worst_mass) for model in models]
    return [
        Mobility.of_matrix(model.mobility, masses.direction, masses.rank, model.change)
        if model.mobility
        else Mobility.of_mass(model.mass)
        for model in models
    ]


def _entries(mobility: Matrix) -> Mobility6:
    """Return the six entries of a symmetric (3, 3) matrix, zeros for an empty one."""
    if not mobility:
        return NO_MOBILITY
    (a, b, c), (_, d, e), (_, _, f) = mobility
    return a, b, c, d, e, f


def _latched(contact: ContactAssessment, cause: Cause) -> ContactAssessment:
    """Return `contact` with the worse of its own and the latched verdict, and nothing allowed."""
    if severity(contact.verdict) > severity(cause.verdict):
        return contact
    point = f"{cause.contact_point}: " if cause.contact_point else ""
    reason = f"latched until reset: {point}{cause.reason}"
    return contact._replace(verdict=cause.verdict, reason=reason, allowable_speed=0.0, margin=-contact.speed)
