# SPDX-License-Identifier: Apache-2.0
"""Assess the contact points at one joint state by itself: numbers and verdict, before debouncing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from scara_effmass.iso15066 import (
    MIN_EFFECTIVE_MASS,
    limits_for,
    peak_force,
    reduced_mass,
)
from scara_effmass.iso15066.mobility import Mobility
from scara_effmass.iso15066.mobility_matrix import Matrix
from scara_effmass.iso15066.speed_limit import SpeedLimit, SpeedLimits
from scara_effmass.kernel.contact_columns import NUMBERS, ContactColumns, columns_of, columns_of_kernel
from scara_effmass.kernel.records import CODE_LAYOUT, MIN_NORMAL_COMPONENT, ROW_LAYOUT
from scara_effmass.model.dynamics import EffectiveMasses, ModelMass, effective_mass
from scara_effmass.model.dynamics import RobotDynamics as FormerDynamics
from scara_effmass.model.lumping import is_scara, lumped_suffices
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety.reasons import CRITERIA, MASSLESS, MODELS, NO_CLAMPING_FORCE, Reasons
from scara_effmass.settings import ContactType, Drives, MassModel, MonitorSettings
from scara_effmass.values import (
    NO_MOBILITY,
    ZERO_VECTOR,
    ContactAssessment,
    FloatArray,
    Mobility6,
    Vector3,
    Verdict,
)

TRIALS = 24
"""Number of joint states at which the kernel must agree with the reference before it is used."""
AGREEMENT = 1e-10
"""Tolerance of that agreement. Where terms of the reference cancel, as for tiny inertias, rounding exceeds it."""
CHECK_INTERVAL = 2000
"""Number of joint states of which one is assessed by kernel and reference, to compare them.

That takes 160 us, because the caches are cold: 2 % of the cycles, and too rare to change the 99.9th percentile.
"""
SINGULAR = 1e-6
"""Tolerance of that check where the smallest singular value is below it: there the leading digits cancel."""
CANCELLED = 1e-5
"""Tolerance of that check with a servo or a clamped body part, whose bounds invert nearly singular matrices."""
_LUMPED = (MassModel.LUMPED, MassModel.LARGEST, MassModel.AUTO)
_FULL = (MassModel.FULL, MassModel.LARGEST, MassModel.AUTO)
_AXES: tuple[Vector3, ...] = tuple(
    (sign * x, sign * y, sign * z)
    for sign in (1.0, -1.0)
    for x, y, z in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
)


class ContactAssessor:
    """Assesses the contact points of a robot at one joint state at a time: no history, no debouncing."""

    def __init__(
        self, dynamics: RobotDynamics, settings: MonitorSettings, speed_limits: SpeedLimits | None = None
    ) -> None:
        """Use the robot of `dynamics`, whose payload is that of `settings` or of a topic.

        Raises LimitError for body regions without a limit, unless `speed_limits` are given.
        """
        self.dynamics = dynamics
        self._former = FormerDynamics(dynamics.robot)
        self.settings = settings
        self.iso_mass = 0.0 if dynamics.robot.masses_reason else dynamics.robot.iso_mass
        self._is_scara = is_scara(dynamics.robot)
        self._lumped_suffices = lumped_suffices(dynamics.robot)
        self._limits = limits = speed_limits or SpeedLimits(limits_for(settings), settings)
        self._names = dynamics.contact_points
        self._speed_threshold = settings.speed_threshold
        self._is_auto = settings.effective_mass_model is MassModel.AUTO
        self._margin = settings.model_margin if self._is_auto and self._is_scara else None
        self._mass_factor = 1.0 + settings.mass_uncertainty
        self._reasons = Reasons(dynamics, settings, limits)
        self._normal_text = f"{settings.contact_normal} {settings.contact_normal_frame}".strip()
        self._test_direction = settings.fixed_test_direction
        self._normal_is_known = settings.contact_normal != "worst"
        # Along the velocity, the bound is that of the paper and of the standard: the pose is that of the first touch.
        choices = {} if settings.contact_normal == "velocity" else {"lumped": _LUMPED, "full": _FULL}
        self._changes = [name for name, choice in choices.items() if settings.effective_mass_model in choice]
        self._drives_push = settings.drives is Drives.SERVO
        self._joints_are_coupled = self._drives_push and settings.servo.computed_torque
        self._joints_are_held = self._drives_push and not settings.servo.computed_torque
        self._min_obstacle_mobility = min([1.0 / limit.obstacle_mass_kg for limit in limits.limits])
        self._clamps = settings.contact is ContactType.QUASI_STATIC
        self._closing_speed = settings.person_speed + settings.speed_uncertainty
        self._kernel: Any = None
        self.why_not: str | None = None
        """Why the kernel is not used, empty if it is, None before `load_kernel`."""
        self._write: Any = None
        self._run: Any = None
        self._rows: Any = None
        # As attributes, because mypyc looks up a name of the module in a dictionary.
        self._unpack: Any = ROW_LAYOUT.iter_unpack
        self._unpack_codes: Any = CODE_LAYOUT.unpack
        # Past the constructor of the named tuple, a Python function that takes as long as the rest.
        self._new: Any = partial(tuple.__new__, ContactAssessment)
        self._labels: dict[bytes, tuple[Any, ...]] = {}
        self._until_check = 0
        cancels = self._drives_push or self._clamps
        self._tolerance = CANCELLED if cancels else AGREEMENT

    def assess(
        self,
        q: FloatArray,
        qd: FloatArray,
        velocity_tolerance: Sequence[float] = (),
        stamp_ns: int = 0,
        age: float = 0.0,
        delay: float = 0.0,
    ) -> list[ContactAssessment]:
        """Return the assessment of each contact point at `q` (n,) [rad, m] and `qd` (n,), finite numbers.

        `velocity_tolerance` (n,) bounds the errors of `qd`; empty: no errors. `stamp_ns`, the `age` of the joint state
        [s] and the `delay` of its velocity [s] are those of the assessments.
        """
        effective_masses = self._former.effective_masses(
            q, qd, self._speed_threshold, velocity_tolerance, self._changes, self._margin
        )
        return [
            self._assess(index, self._names[index], masses, q, qd, stamp_ns, age, delay)
            for index, masses in enumerate(effective_masses)
        ]

    def copy(self) -> ContactAssessor:
        """Return an assessor for the same robot and settings that has not loaded its kernel, for another thread."""
        return ContactAssessor(RobotDynamics(self.dynamics.robot), self.settings, self._limits)

    def assess_live(
        self,
        q: FloatArray,
        qd: FloatArray,
        velocity_tolerance: list[float],
        stamp_ns: int,
        age: float,
        delay: float,
    ) -> list[ContactAssessment] | str:
        """Return what `assess` returns, computed by the kernel once `load_kernel` has found it to agree.

        Every CHECK_INTERVAL joint states the two are compared. If they disagree, this returns a text that names the
        field, and the kernel is not used again.
        """
        if self._run is None:
            return self.assess(q, qd, velocity_tolerance, stamp_ns, age, delay)
        self._write(*q.tolist(), *qd.tolist(), *velocity_tolerance)
        self._run()
        contacts = [
            self._from_row(row, name, stamp_ns, age, delay)
            for row, name in zip(self._unpack(self._rows), self._names)  # noqa: B905 - as in Monitor
        ]
        self._until_check -= 1
        if self._until_check <= 0:
            self._until_check = CHECK_INTERVAL
            expected = self.assess(q, qd, velocity_tolerance, stamp_ns, age, delay)
            for contact, reference in zip(contacts, expected, strict=True):
                if field := _difference(contact, reference, self._tolerance):
                    self.why_not = reason = f"the compiled kernel disagrees with Pinocchio in {field}"
                    self._run = None
                    return reason
        return contacts

    def _from_row(self, n: tuple[Any, ...], name: str, stamp_ns: int, age: float, delay: float) -> ContactAssessment:
        """Return the assessment in a row `n` of the kernel: its numbers, and the bytes of its codes."""
        codes = n[35]
        texts = self._labels.get(codes)
        if texts is None:
            texts = self._labels[codes] = self._labels_of(codes)
        reason = self._reasons.of_row(n[:35] + self._unpack_codes(codes)) if texts[7] else ""
        contact: ContactAssessment = self._new(
            (
                stamp_ns,
                name,
                (n[0], n[1], n[2]),
                n[3],  # speed to margin, one by one: an unpacked slice takes longer
                n[4],
                n[5],
                n[6],
                n[7],
                n[8],
                n[9],
                n[10],
                n[11],
                n[12],
                n[13],
                n[14],
                texts[0],
                texts[1],
                texts[2],
                reason,
                age,
                texts[3],
                texts[4],
                n[15],
                False,
                n[16],
                n[17],
                n[18],
                (n[19], n[20], n[21], n[22], n[23], n[24]),
                (n[25], n[26], n[27], n[28], n[29], n[30]),
                self._normal_text,
                texts[5],
                texts[6],
                (n[31], n[32], n[33]),
                n[34],
                delay,
            )
        )
        return contact

    def _labels_of(self, codes: bytes) -> tuple[Any, ...]:
        """Return region, criterion, verdict, worst_direction_used, mass_capped, model and why, has_reason."""
        used, capped, verdict, region, criterion, model, why, error, remark = map(int, self._unpack_codes(codes))
        texts = self._reasons
        return (
            texts.regions[region],
            CRITERIA[criterion],
            Verdict(verdict),
            used > 0,
            capped > 0,
            MODELS[model],
            texts.whys[why],
            error + remark > 0,
        )

    def compute(self, q: FloatArray, qd: FloatArray, velocity_tolerance: FloatArray) -> tuple[ContactColumns, ...]:
        """Return the columns of each contact point at N joint states, from the kernel where it is available.

        `q`, `qd` and `velocity_tolerance` are (N, n) and as in `assess`.
        """
        if self.load_kernel():
            return self.compute_reference(q, qd, velocity_tolerance)
        return self._columns(q, qd, velocity_tolerance)

    def compute_reference(
        self, q: FloatArray, qd: FloatArray, velocity_tolerance: FloatArray
    ) -> tuple[ContactColumns, ...]:
        """Return what `compute` does, from `assess` state by state."""
        rows = zip(q, qd, velocity_tolerance.tolist(), strict=True)
        contacts = [self.assess(*row) for row in rows]
        return tuple(
            columns_of(name, self._normal_text, [row[index] for row in contacts])
            for index, name in enumerate(self.dynamics.contact_points)
        )

    def load_kernel(self) -> str:
        """Compile or load the kernel. Return why `assess` has to replace it, empty if the kernel is used.

        The kernel must agree with `assess` at TRIALS joint states, which reveals a stale cache or a faulty compiler.
        """
        if self.why_not is None:
            try:
                self.why_not = self._load_kernel()
            except Exception as error:  # noqa: BLE001 - a compiler or a damaged cache may raise anything
                self.why_not = f"the kernel cannot be loaded: {error!r}"
        return self.why_not

    def _load_kernel(self) -> str:
        from scara_effmass.kernel.contact_kernel import ContactKernel, why_not  # noqa: PLC0415 - numba takes 1 s

        if reason := why_not(self.dynamics.robot):
            return reason
        self._kernel = ContactKernel(self.dynamics, self.settings, self._limits)
        if reason := self._disagreement():
            return reason
        self._write, self._run, self._rows = self._kernel.single_state()
        return ""

    def _disagreement(self) -> str:
        """Return where the kernel disagrees with `assess`, empty if nowhere."""
        q = self.dynamics.robot.sample_configurations(TRIALS)
        # Some at rest, fast ones, and each joint in both directions.
        qd = (
            np.cos(np.outer(np.arange(TRIALS) % 7, np.arange(1.0, q.shape[1] + 1.0))) * (np.arange(TRIALS) % 3)[:, None]
        )
        states = q, qd, np.abs(qd) / 64.0
        indices = range(TRIALS)
        for points, expected in zip(self._columns(*states), self.compute_reference(*states), strict=True):
            for name in NUMBERS:
                if not np.allclose(
                    getattr(points, name), getattr(expected, name), AGREEMENT, AGREEMENT, equal_nan=True
                ):
                    return f"the compiled kernel disagrees with Pinocchio in {name}"
            if points.reasons(indices) != expected.reasons(indices) or points.labels() != expected.labels():
                return "the compiled kernel disagrees with Pinocchio in what limits the speed"
        return ""

    def _columns(self, q: FloatArray, qd: FloatArray, velocity_tolerance: FloatArray) -> tuple[ContactColumns, ...]:
        """Return the columns from the kernel."""
        reasons = self._reasons
        texts = {"body_region": reasons.regions, "criterion": CRITERIA}
        texts |= {"mass_model": MODELS, "mass_model_reason": reasons.whys}
        columns = self._kernel.columns(q, qd, velocity_tolerance)
        of_points = ((name, columns[:, :, index]) for index, name in enumerate(self.dynamics.contact_points))
        return tuple(
            columns_of_kernel(name, self._normal_text, of_point, texts, partial(_reason_at, reasons, of_point))
            for name, of_point in of_points
        )

    def _assess(
        self,
        index: int,
        name: str,
        masses: EffectiveMasses,
        q: FloatArray,
        qd: FloatArray,
        stamp_ns: int,
        age: float,
        delay: float,
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
                if min(model.mass, cap) > mass and why is not self._reasons.heavy_enough:
                    mass, model_name = model.mass, model.name
            any_normal = _any_normal(models, masses)
            held = [
                self._former.composite_mass(q, qd, index, model.name, masses)
                for model in models
                if self._joints_are_held and model.mobility
            ]
            if self._normal_is_known:
                mobilities, share = self._at_normal(models + held, masses, q)
            else:
                mobilities, share = any_normal + _any_normal(held, masses), 1.0
            push = (self._former.drive_acceleration(q, index), 1.0 / worst_mass) if self._drives_push else None
            max_force = self._holding_force(models, masses, q, index) if self._joints_are_coupled else math.inf
            speed_limit = self._limits.worst_normal(mobilities, self._mass_factor, push, max_force)
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
            if clamping_force > self._limits.weakest.permissible_force_n:
                allowable_speed = 0.0
                verdict, reason = Verdict.VIOLATION, self._reasons.clamping(clamping_force)
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
            self.iso_mass,
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
            delay,
        )

    def _along_test_direction(
        self, models: list[ModelMass], masses: EffectiveMasses, q: FloatArray
    ) -> tuple[Vector3, float]:
        """Return the test direction in base axes, and the largest mass of `models` along it [kg]; 0 if one has none."""
        if self._test_direction is None:
            return ZERO_VECTOR, 0.0
        direction = self._former.in_base(q, self._test_direction, self.settings.test_direction_frame)
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
        normal = self._former.in_base(q, settings.fixed_normal, settings.contact_normal_frame)
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
        settings, verdict, reason = self.settings, Verdict.OK, ""
        is_above = masses.speed > nominal_speed
        if is_above or masses.speed > settings.warn_ratio * nominal_speed:
            verdict = Verdict.VIOLATION if is_above else Verdict.WARN
            criterion, region = speed_limit.criterion, speed_limit.limit.region
            reason = self._reasons.speed(masses.speed, nominal_speed, criterion, region, is_above=is_above)
        best_mass, best_model = (masses.lumped, "lumped") if math.isnan(masses.full) else (masses.full, "full")
        best_mass = min(best_mass, settings.mass_cap)  # near a singular pose both masses exceed the cap
        if mass < best_mass * (1.0 - settings.model_margin):
            return max(verdict, Verdict.WARN), self._reasons.light(reason, mass, best_mass, best_model)
        return verdict, reason

    def _models(self, masses: EffectiveMasses) -> tuple[list[ModelMass], str]:
        """Return the models behind the verdict and why these; without one, why there is none."""
        choice = self.settings.effective_mass_model
        if self._reasons.masses_reason:
            return [], self._reasons.masses_reason
        names, why = self._choice(masses)
        if choice is MassModel.LUMPED and not names:
            return [], self._reasons.no_lumped(masses.lumped_reason)
        if choice is MassModel.FULL and not names:
            return [], self._reasons.no_full
        models = []
        for name in names:
            if name == "lumped":
                change = masses.lumped_change
                model = ModelMass(name, masses.lumped, masses.worst_lumped, masses.lumped_mobility, change)
            elif name == "full":
                model = ModelMass(name, masses.full, masses.worst_full, masses.full_mobility, masses.full_change)
            else:
                model = ModelMass(name, self.iso_mass, self.iso_mass, [], None)
            models.append(model)
            if model.mass < MIN_EFFECTIVE_MASS:
                return [], self._reasons.too_light(model.name, model.mass)
            if math.isnan(model.worst_mass) and self.settings.contact_normal != "velocity":
                return [], self._reasons.no_worst(model.name)
        return models, why

    def _choice(self, masses: EffectiveMasses) -> tuple[list[str], str]:
        """Return the names of the models that decide, none if the chosen one is missing, and why these."""
        settings, choice = self.settings, self.settings.effective_mass_model
        has_lumped, has_full = not math.isnan(masses.lumped), not math.isnan(masses.full)
        if not self._is_auto:
            there = {"lumped": has_lumped and choice in _LUMPED, "full": has_full and choice in _FULL}
            there["iso"] = choice in {MassModel.ISO, MassModel.LARGEST}
            return [name for name, is_there in there.items() if is_there], self._reasons.setting
        if masses.lumped_is_heavy_enough(settings.model_margin):
            # The change of pose can differ more than the mass: but for a SCARA, the full model bounds the speed, too.
            return ["lumped"] if self._is_scara else ["lumped", "full"], self._reasons.heavy_enough
        lumped_reason = masses.lumped_reason
        if masses.has_massless_direction:
            lumped_reason = lumped_reason or MASSLESS
            has_lumped = False
        if has_full:
            return ["full"], self._reasons.lighter if has_lumped else self._reasons.full_alone(lumped_reason)
        if not has_lumped:
            return ["iso"], self._reasons.iso_alone(lumped_reason)
        return ["lumped"] if self._lumped_suffices else ["lumped", "iso"], self._reasons.largest

    def _clamping_force(self, masses: EffectiveMasses, q: FloatArray, index: int) -> float:
        """Return the largest static force [N] of the drives along `_directions`; infinite if it is unknown."""
        force = self._former.clamping_force(q, index, *self._directions(masses, q))
        return min(force, self.settings.external_force_limit or math.inf)

    def _holding_force(self, models: list[ModelMass], masses: EffectiveMasses, q: FloatArray, index: int) -> float:
        """Return the contact force [N] up to which no joint reaches its effort limit.

        Above it, computed torque no longer holds: saturated joints yield, the others push on, and the arm can hit
        again, faster. The force acts along `_directions`, and without a fixed normal also along the worst one.
        """
        normals = self._directions(masses, q)
        if self.settings.fixed_normal is None:
            normals += [model.change.worst_normal(self._min_obstacle_mobility) for model in models if model.change]
        return self._former.holding_force(q, index, *normals)

    def _directions(self, masses: EffectiveMasses, q: FloatArray) -> list[Vector3]:
        """Return a fixed normal and its opposite, else the direction of the velocity, at rest those of all axes."""
        settings = self.settings
        if settings.fixed_normal is not None:
            x, y, z = self._former.in_base(q, settings.fixed_normal, settings.contact_normal_frame)
            return [(x, y, z), (-x, -y, -z)]
        return [*_AXES] if masses.direction == ZERO_VECTOR else [masses.direction]


def _difference(contact: ContactAssessment, expected: ContactAssessment, tolerance: float) -> str:
    """Return the first field, other than the reason, in which `contact` differs from `expected`; empty if none."""
    if expected.smallest_singular_value < SINGULAR:
        tolerance = max(tolerance, SINGULAR)
    for field in ContactAssessment._fields:
        value, reference = getattr(contact, field), getattr(expected, field)
        if value != reference and field != "reason" and not _is_close(value, reference, tolerance):
            return field
    return ""


def _is_close(value: Any, reference: Any, tolerance: float) -> bool:  # noqa: ANN401 - any field
    if isinstance(value, tuple):
        return all(_is_close(a, b, tolerance) for a, b in zip(value, reference, strict=True))
    if isinstance(value, (str, bool, Verdict)):
        return False
    both_nan = math.isnan(value) and math.isnan(reference)
    return both_nan or math.isclose(value, reference, rel_tol=tolerance, abs_tol=tolerance)


def _reason_at(reasons: Reasons, columns: FloatArray, index: int) -> str:
    return reasons.of_row(columns[:, index].tolist())


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
