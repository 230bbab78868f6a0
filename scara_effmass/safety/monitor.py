# SPDX-License-Identifier: Apache-2.0
"""Assess joint states: the verdict and the allowable speed of each contact point.

One path for one joint state and for many: admission, numbers, debouncing and latch, in order.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from struct import Struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scara_effmass.codes import Assumption, Reason
from scara_effmass.errors import EffmassError, KernelError, RobotError
from scara_effmass.iso15066 import Limit, limits_of
from scara_effmass.kernel import compiled
from scara_effmass.kernel.admission import METRES_PER_RADIAN, NANOSECONDS, WINDOW_S, admit, forget_all
from scara_effmass.kernel.contact_kernel import ContactKernel, too_large
from scara_effmass.kernel.other_joints import ELSEWHERE, MIN_SILENCE_NS, RESTS, UNREPORTED, Found, OtherJoints
from scara_effmass.kernel.records import CONTACT, REASON_SIZE, ByteArray, IntArray
from scara_effmass.kernel.settle import settle
from scara_effmass.kernel.state import (
    CODE,
    DEBOUNCE,
    DETAIL,
    JOINT_MEMORY,
    MEMORY,
    NO_SEQUENCE,
    RULES,
    STATE,
    VALUES,
    WORDS,
)
from scara_effmass.model.joint_values import max_joint_accelerations
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety.assessments import Assessments, Records, unknown_numbers
from scara_effmass.safety.assumptions import assumptions_of
from scara_effmass.safety.joint_state_adapter import MAX_LAYOUTS, JointStateAdapter, Layout, suggested_map
from scara_effmass.safety.load_watch import Doubt, LoadWatch
from scara_effmass.safety.reasons import ReasonTexts
from scara_effmass.safety.second_channel import ReferenceChannel
from scara_effmass.settings import WHOLE_ARM, MonitorSettings
from scara_effmass.values import NO_VALUES, Decision, FloatArray, JointState, Payload, Verdict

CHECK_INTERVAL = 2000
"""Number of joint states of which one is compared with the reference, at one contact; the contacts take turns."""
TRIALS = 24
"""Number of joint states at which kernel and reference are compared at one contact each, before the first one."""
CLOCK_STEPS = 10
"""Number of steps of a simulated clock that are remembered."""
DEFAULT_MAX_SPEED = (60.0, 10.0)
"""Maximum speed of a revolute [rad/s] and of a prismatic joint [m/s] whose description states none."""
MAX_DETAILS = 10_000
"""Number of different texts of reasons that are kept."""
OTHER_DETAIL = "one of too many different reasons"
HELD_REASONS = {ELSEWHERE: Reason.HELD_ELSEWHERE, UNREPORTED: Reason.HELD_UNREPORTED}
"""Reasons of joints that the model holds, by their state, besides UNMODELLED_MOTION."""
PAYLOAD, COMMANDS = "payload", "joint_commands"
"""Inputs that can be distrusted, beside those of the node."""
HEAD, REASON = Struct(f"3q{REASON_SIZE * 8}x"), Struct(f"3q{DETAIL + 1}d{(REASON_SIZE - DETAIL - 1) * 8}x")
"""Layout of the first fields of a State: two times and a number, without a reason and with its first values."""


class Cause(NamedTuple):
    """The first VIOLATION or UNKNOWN after the first valid joint state, or after the last reset."""

    stamp_ns: int
    contact_point: str
    verdict: Verdict
    reason: str


@dataclass
class Pending:
    """N joint states between two steps of the assessment.

    `records` (N,) are `State`s and `states` their bytes; `motions` (N, 6, n) are q, qd, tolerances of qd,
    accelerations, their errors, and the accelerations that stated ones replace, the first two also as `q` and `qd`;
    `numbers` (N, P, fields) are those of the contacts, and `unknown` (fields,) those of a contact without numbers;
    `memory` are the bytes of Rules, Memory, JointMemory and Debounce. The steps of the kernel are bound to them once.
    """

    records: Records
    states: NDArray[np.uint8]
    motions: FloatArray
    q: FloatArray
    qd: FloatArray
    numbers: FloatArray
    kernel: ContactKernel | ReferenceChannel
    unknown: FloatArray
    texts: ReasonTexts
    memory: tuple[ByteArray, ...]

    @cached_property
    def admit(self) -> Callable[[], None]:
        """Admit or refuse the joint states."""
        return admit.bind(self.states, self.motions, *self.memory[:3])

    @cached_property
    def compute(self) -> Callable[[], None]:
        """Compute the contacts at those that are admitted."""
        return self.kernel.bind(self.states, self.motions, self.numbers)

    @cached_property
    def settle(self) -> Callable[[], None]:
        """Debounce and latch the verdicts."""
        rules, memory, _, debounces = self.memory
        return settle.bind(self.states, self.numbers, self.unknown, rules, memory, debounces)


class Monitor:
    """Assesses joint states. The same joint states give the same assessments, live and offline, one by one or not.

    `ignored` counts joint states of other devices.
    """

    def __init__(self, dynamics: RobotDynamics, settings: MonitorSettings, *, use_reference: bool = False) -> None:
        """Watch the robot of `dynamics`; `use_reference`: compute with the reference in place of the kernel, slowly.

        Raises KernelError if the kernel cannot be compiled, LimitError or RobotError for `settings` that `check`
        refuses, and for a robot that is not in SI units.
        """
        robot = dynamics.robot
        if reason := robot.units_reason:
            raise RobotError(f"{robot.origin}: {reason}")
        if not use_reference and (reason := compiled.why_not()):
            raise KernelError(f"{reason}: repair it, or set use_reference to compute without it, slowly")
        self.dynamics, self.settings = dynamics, settings
        self._why_reference = "use_reference" if use_reference else too_large(robot)
        self.kernel_fault = ""
        """Where the kernel disagreed with the reference, which works alone since then; empty if nowhere."""
        self._max_qdd = max_joint_accelerations(settings.max_joint_acceleration, robot.joint_names)
        self._adapter = JointStateAdapter(robot.joint_names, settings, robot.periods, robot.held)
        self._others = OtherJoints({joint.name: joint.position for joint in robot.held}, self._adapter.expected)
        self._other_places = dict[tuple[str, ...], tuple[IntArray, IntArray]]()
        self._rules, self._memory = np.zeros(1, RULES), np.zeros(1, MEMORY)
        self._joints = np.zeros(robot.model.nv, JOINT_MEMORY)
        self._debounces = np.zeros(len(dynamics.contact_points), DEBOUNCE)
        self._details: list[str] = ["", *dynamics.contact_points, OTHER_DETAIL]
        self._detail_index = {text: index for index, text in reversed([*enumerate(self._details)])}
        self._clock_steps = [0] * CLOCK_STEPS
        self._memory_bytes = tuple(
            array.view(np.uint8) for array in (self._rules, self._memory, self._joints, self._debounces)
        )
        self.ignored = 0
        self._payload: Payload | None = None
        self.load_watch = LoadWatch(dynamics, settings)
        """What the torques of the joints say of the load."""
        self._distrusted: dict[str, tuple[Reason, str]] = {}
        self._command_number, self._command_conflict_ns = NO_SEQUENCE, 0
        self._other_names: tuple[str, ...] = ()
        self._state_payload(f"no payload on {settings.payload_topic} yet" if settings.payload_topic else "")
        forget_all(*self._memory_bytes[1:3])
        self.apply(settings)
        self._remembered_texts = self._texts
        """Those of the reasons that are remembered."""

    def compile(self) -> None:
        """Compare the kernel with the reference at TRIALS joint states, which reveals a faulty compiler or cache.

        Raises KernelError where it does not run.
        """
        robot, trial = self.dynamics.robot, self._new_pending(TRIALS)
        trial.records["stamp_ns"] = trial.records["now_ns"] = np.arange(1, TRIALS + 1)
        trial.motions[:, 0] = q = robot.sample_configurations(TRIALS)
        # Each contact takes its turn slowly, fast and at rest, and each joint in both directions.
        qd = np.cos(np.outer(np.arange(TRIALS) % 7, np.arange(1.0, q.shape[1] + 1.0)))
        rounds, turns = np.divmod(np.arange(TRIALS), len(self._points))
        trial.motions[:, 1] = qd * ((rounds + 1) % 3)[:, None]
        trial.memory = tuple(array.copy() for array in self._memory_bytes)
        try:
            trial.admit()
            trial.records["is_admitted"] = 1
            self.compute(trial)
            chosen = [slice(turn, turn + 1) for turn in turns.tolist()]
            fields = map(
                self._reference.difference, trial.motions, trial.numbers, trial.records["age"].tolist(), chosen
            )
            field = next(filter(None, fields), "")
            trial.settle()
        except Exception as error:
            raise KernelError(f"the kernel does not run: {error!r}: set use_reference to do without it") from error
        if field and not self._why_reference:
            self._doubt(field)

    def check(self, settings: MonitorSettings) -> tuple[Limit, ...]:
        """Return the limits of the first contact. Raises LimitError or RobotError for what `apply` refuses."""
        if settings.payload != self.settings.payload:
            self.dynamics.robot.rebuild(settings)
        if self.dynamics.robot.hulls and settings.contact_normal != "worst":
            raise RobotError(
                f"contact_normal = {settings.contact_normal!r}: must be worst where links are watched as a whole: "
                f"no bound holds for a known one; name contact_points in place of {WHOLE_ARM}"
            )
        self.dynamics.frame_index(settings.contact_normal_frame, "contact_normal_frame")
        self.dynamics.frame_index(settings.test_direction_frame, "test_direction_frame")
        self.dynamics.frame_index(settings.person_direction_frame, "person_direction_frame")
        return limits_of(settings, self.dynamics.contact_points)[0]

    def apply(self, settings: MonitorSettings) -> None:
        """Apply changed settings; of the robot, only the payload. Raises as `check`, and then changes nothing."""
        limits = self.check(settings)
        if settings.payload != self.settings.payload:
            self.dynamics = self.dynamics.with_payload(settings)
        self.settings, self._limits = settings, limits
        self._adapter.apply(settings)
        self._use_dynamics()
        robot, rules, joints = self.dynamics.robot, self._rules, self._joints
        rules["timeout_ns"] = round(settings.timeout * NANOSECONDS)
        rules["filters_velocity"] = settings.filters_velocity
        rules["velocity_tolerance"], rules["max_lag"] = settings.velocity_tolerance, settings.max_velocity_lag
        rules["release_ns"] = round(settings.release_time * NANOSECONDS)
        rules["latches"], rules["reference_speed"] = settings.latch, settings.reference_speed
        self._allow_future()
        speeds = robot.model.velocityLimit
        defaults = np.where(robot.revolute, *DEFAULT_MAX_SPEED)
        max_speeds = np.where((speeds > 0.0) & (speeds < math.inf), speeds, defaults)
        joints["lower"] = robot.model.lowerPositionLimit - settings.joint_limit_tolerance
        joints["upper"] = robot.model.upperPositionLimit + settings.joint_limit_tolerance
        joints["max_speed"] = max_speeds * (1.0 + settings.joint_speed_tolerance)
        joints["period"] = robot.periods
        joints["position_tolerance"] = settings.position_tolerance * self._per_joint
        # Whether a joint outside the model turns or slides is unknown: the tolerance of one that slides counts.
        self._others.tolerance = METRES_PER_RADIAN * settings.position_tolerance
        self._others.max_speed = self._others.tolerance / WINDOW_S
        self._others.held_tolerance = settings.position_tolerance
        self._others.silence_ns = max(int(rules["timeout_ns"][0]), MIN_SILENCE_NS)

    def _use_dynamics(self) -> None:
        """Compute with the present settings and payload from the next joint state on."""
        settings, robot = self.settings, self.dynamics.robot
        self.assumptions = assumptions_of(robot, settings)
        self._rules["is_assumed"] = bool(self.assumptions.limiting)
        self._texts = ReasonTexts.of(self.dynamics, settings, self._limits, self.assumptions)
        self._reference = ReferenceChannel(self.dynamics, settings)
        if self._why_reference:
            self._kernel: ContactKernel | ReferenceChannel = self._reference
        else:
            self._kernel = ContactKernel(self.dynamics, settings)
        self._until_check = CHECK_INTERVAL
        self._next_checked = 0
        self._unknown = unknown_numbers(0.0 if robot.masses_reason else robot.iso_mass)
        self._normal = f"{settings.contact_normal} {settings.contact_normal_frame}".strip()
        self._points = self.dynamics.contact_points
        self._single = self._new_pending(1)
        self._single_state = self._single.states.data
        self.load_watch = self.load_watch.of(self.dynamics, settings)

    @property
    def core(self) -> str:
        """What computes the numbers: the kernel, or the reference and why."""
        return f"reference: {self._why_reference}" if self._why_reference else "compiled kernel"

    @property
    def _per_joint(self) -> FloatArray:
        """Factor (n,) of tolerances that are stated for revolute joints."""
        return np.where(self.dynamics.robot.revolute, 1.0, METRES_PER_RADIAN)

    @property
    def rest_tolerance(self) -> FloatArray:
        """Tolerance (n,) of the velocities of the first joint state, the smallest one [rad/s, m/s]."""
        return np.asarray(self._joints["position_tolerance"] / WINDOW_S)

    @property
    def rejected(self) -> int:
        """Number of invalid joint states."""
        return int(self._memory["rejected"][0])

    @property
    def verdicts(self) -> dict[Verdict, int]:
        """Number of contact assessments per verdict, those of the watchdog included."""
        return {verdict: int(self._memory["counts"][0, verdict]) for verdict in Verdict}

    @property
    def first_cause(self) -> Cause | None:
        """What `latch` holds."""
        memory = self._memory[0]
        if not memory["has_cause"]:
            return None
        reason = self._remembered_texts.text(memory["cause_reason"].tolist(), self._details)
        point = self._details[memory["cause_point"]]
        return Cause(int(memory["cause_stamp_ns"]), point, Verdict(int(memory["cause_verdict"])), reason)

    @first_cause.setter
    def first_cause(self, cause: Cause | None) -> None:
        memory = self._memory[0]
        memory["has_cause"] = cause is not None
        if cause is not None:
            memory["cause_stamp_ns"], memory["cause_verdict"] = cause.stamp_ns, cause.verdict
            memory["cause_point"] = self._detail(cause.contact_point)
            memory["cause_reason"] = 0.0
            memory["cause_reason"][[CODE, DETAIL]] = Reason.STATED, self._detail(cause.reason)

    @property
    def payload_reason(self) -> str:
        """Why the payload is unknown, which makes every verdict UNKNOWN; empty if it is known."""
        return self._distrusted.get(PAYLOAD, (Reason.NONE, ""))[1]

    @property
    def payload_text(self) -> str:
        """The payload with its sources, or why it is unknown."""
        return self.payload_reason or self.dynamics.robot.payload_text

    @property
    def load_text(self) -> str:
        """The load by the torques, or why it is unknown; what states it, while the payload is assumed."""
        text, further = self.load_watch.text, self.load_watch.further_load
        if further is None or Assumption.PAYLOAD not in self.assumptions.assumed:
            return text
        most = f"{math.ceil(100.0 * further) / 100.0:.2f} kg"
        return f"{text}: up to {most} are not stated: state payload_mass and payload_com"

    @property
    def joint_map_hint(self) -> str:
        """Names of the last joint state without a joint of the robot, and a `joint_map` for them; empty if none."""
        names = self._other_names
        return f"; they name {', '.join(names)}{suggested_map(names, self.dynamics.robot.joint_names)}" if names else ""

    @property
    def unmodelled_joints(self) -> tuple[str, ...]:
        """Joints of the joint states that have moved, but are neither in the model nor stated as harmless."""
        return self._others.moved

    @property
    def unmatched(self) -> tuple[str, ...]:
        """Patterns of `ignored_joints` that fit no joint of the joint states so far."""
        return tuple(glob for glob in self.settings.ignored_joints if glob not in self._adapter.matched)

    def names_of(self, reported: tuple[str, ...]) -> tuple[str, ...]:
        """Return the names that `joint_map` and `joint_names` give to the joints of a joint state."""
        return self._adapter.layout(reported).names or reported

    def reset(self) -> None:
        """Clear the first cause, and with it a latched verdict; forget devices that moved when they were last seen."""
        self.first_cause = None
        self._others.forget()
        self._forget_verdicts()

    def clear_history(self) -> None:
        """Discard earlier joint states: the node's clock jumped back, and the stamps follow."""
        forget_all(*self._memory_bytes[1:3])
        self._adapter.forget()
        self._others.forget()
        self.load_watch.forget()
        self._forget_verdicts()

    def _forget_verdicts(self) -> None:
        self._debounces["has_seen"] = self._debounces["is_stale"] = 0

    def take_clock_step(self, step_ns: int) -> None:
        """Take the step [ns] of a simulated clock. Stamps may lead it by a step, because it stands still in between.

        The second largest of the last CLOCK_STEPS counts, because a single large one may be a jump.
        """
        self._clock_steps = [*self._clock_steps[1:], step_ns]
        self._allow_future()

    def _allow_future(self) -> None:
        rules, step_ns = self._rules, sorted(self._clock_steps)[-2]
        tolerance_ns = round(self.settings.future_tolerance * NANOSECONDS)
        rules["clock_step_ns"] = step_ns
        rules["future_tolerance_ns"] = tolerance_ns + min(step_ns, int(rules["timeout_ns"][0]) // 2)

    def expect_commands(self, tolerance: float) -> None:
        """Give UNKNOWN unless each position is within `tolerance` [rad] of the latest command; 0: do not compare.

        For a prismatic joint the tolerance is METRES_PER_RADIAN times that [m].
        """
        self._rules["expects_commands"] = tolerance > 0.0
        self._joints["command_tolerance"] = tolerance * self._per_joint

    def take_command(self, command: JointState, now_ns: int, sequence_number: int | None = None) -> None:
        """Take the positions that the controller commanded, received at `now_ns` on the node's clock.

        A command without all joints is ignored. One whose `sequence_number` does not increase is of a second publisher,
        or of a restarted one: that gives UNKNOWN until the numbers have increased for `timeout`.
        """
        layout = self._adapter.layout(command.names)
        if layout.order.size and len(command.position) == len(layout.names):
            self._joints["command"] = command.position[layout.order]
            self._memory["command_ns"], self._memory["has_command"] = now_ns, 1
            if sequence_number is not None:
                self._check_command_number(sequence_number, now_ns)

    def _check_command_number(self, number: int, now_ns: int) -> None:
        last, self._command_number = self._command_number, number
        if number <= last:
            self._command_conflict_ns = now_ns
            follows = f"command number {number} follows number {last}"
            self.distrust(COMMANDS, f"a second publisher of joint commands, or a restarted one: {follows}")
        elif COMMANDS in self._distrusted:
            self._command_conflict_ns = min(self._command_conflict_ns, now_ns)  # the clock may have gone back
            if now_ns - self._command_conflict_ns > int(self._rules["timeout_ns"][0]):
                self.distrust(COMMANDS, "")

    def distrust(self, source: str, reason: str, code: Reason = Reason.TWO_PUBLISHERS) -> None:
        """Give UNKNOWN for `reason`, because the input `source` is not to be trusted; an empty reason ends that."""
        self._distrusted.pop(source, None)
        if reason:
            self._distrusted[source] = code, reason
        code, text = next(iter(self._distrusted.values()), (Reason.NONE, ""))
        self._rules["distrusted_code"], self._rules["distrusted_detail"] = code, self._detail(text)

    def take_payload(self, payload: Payload | str) -> None:
        """Use the `payload` of `payload_topic` from the next joint state on.

        An impossible payload gives UNKNOWN, and so does a text that says why the payload is unknown.
        """
        self._state_payload(payload if isinstance(payload, str) else "")
        if isinstance(payload, str) or payload == self._payload:
            return
        try:
            self.dynamics = self.dynamics.with_payload(self.settings.with_payload(payload))
            self._use_dynamics()
            self._payload = payload
        except EffmassError as error:
            self._state_payload(f"the payload is unknown: {error}")

    def _state_payload(self, reason: str) -> None:
        self.distrust(PAYLOAD, reason, Reason.PAYLOAD_UNKNOWN)

    def assess(self, state: JointState, now_ns: int, sequence_number: int | None = None) -> Decision | None:
        """Return the decision on `state`, received at `now_ns` on the node's clock.

        `sequence_number` counts the messages of one publisher; joint states whose number does not increase come from
        several publishers, and give UNKNOWN.

        None for a joint state that names none of the robot's joints: it belongs to another device.
        """
        assessments = self.assess_one(state, now_ns, sequence_number)
        return None if assessments is None else assessments.decision(0)

    def assess_one(self, state: JointState, now_ns: int, sequence_number: int | None = None) -> Assessments | None:
        """Return the assessment of one joint state, as `assess`; None if it is of another device."""
        layout = self._adapter.layout(state.names)
        if layout.is_foreign:
            self._ignore(layout, np.array([now_ns]), state.position[None], state.velocity[None])
            return None
        pending, data = self._single, self._single_state
        number = NO_SEQUENCE if sequence_number is None else sequence_number
        if layout.reason is Reason.NONE:
            HEAD.pack_into(data, 0, state.stamp_ns, now_ns, number)
        else:
            detail = self._detail(layout.detail)
            REASON.pack_into(data, 0, state.stamp_ns, now_ns, number, layout.reason, layout.joint, detail)
        self._read(pending, layout, state.position, state.velocity, state.effort)
        self.compute(pending)
        self._until_check -= 1
        if self._until_check <= 0:
            self._compare(pending)
        return self.settle(pending)

    def _compare(self, pending: Pending) -> None:
        """Compare the contact whose turn it is with the reference, which works alone from the first difference on."""
        self._until_check = CHECK_INTERVAL
        if self._why_reference or not pending.records["is_admitted"][0]:
            return
        turn, self._next_checked = self._next_checked, (self._next_checked + 1) % len(self._points)
        age, chosen = float(pending.records["age"][0]), slice(turn, turn + 1)
        if field := self._reference.difference(pending.motions[0], pending.numbers[0], age, chosen):
            self._doubt(field)
            pending.records["is_admitted"] = 0
            pending.records["reason"][0, [CODE, DETAIL]] = Reason.KERNEL_DISAGREES, self._detail(field)

    def _doubt(self, field: str) -> None:
        """Compute with the reference from now on."""
        self.kernel_fault = self._why_reference = f"the compiled kernel disagrees with the reference in {field}"
        self._use_dynamics()

    def admit(
        self,
        names: tuple[str, ...],
        stamps: IntArray,
        clocks: IntArray,
        position: FloatArray,
        velocity: FloatArray,
        effort: FloatArray = NO_VALUES,
    ) -> Pending | None:
        """Return N joint states with the same `names`, admitted or refused; None if they are of another device.

        `stamps` and `clocks` (N,) are header stamps and times of arrival [ns]; `position`, `velocity` and `effort` are
        (N, k), the latter of any other length if there are none.
        """
        layout = self._adapter.layout(names)
        if layout.is_foreign:
            self._ignore(layout, clocks, position, velocity)
            return None
        pending = self._new_pending(len(stamps))
        records = pending.records
        records["stamp_ns"], records["now_ns"], records["sequence"] = stamps, clocks, NO_SEQUENCE
        records["reason"][:, : DETAIL + 1] = layout.reason, layout.joint, self._detail(layout.detail)
        self._read(pending, layout, position, velocity, effort)
        return pending

    def watch_others(
        self, names: tuple[str, ...], clocks: IntArray, position: FloatArray, velocity: FloatArray
    ) -> None:
        """Note which joints outside the model move in N joint states that are not assessed, given as to `admit`."""
        self._watch(self._adapter.layout(names), clocks, position, velocity)

    def compute(self, pending: Pending) -> None:
        """Compute the contacts of the admitted joint states; several threads may do so at once."""
        if self._max_qdd is not None:
            qdd, errors = pending.motions[:, 3], pending.motions[:, 4]
            is_stated = self._max_qdd >= np.abs(qdd) + errors  # a stated one counts in both directions
            pending.motions[:, 5] = np.where(is_stated, qdd, 0.0)
            errors[:], qdd[is_stated] = np.where(is_stated, self._max_qdd, errors), 0.0
        pending.compute()

    def settle(self, pending: Pending) -> Assessments:
        """Return the assessments of joint states that are computed, in the order of admission."""
        if pending.texts is not self._remembered_texts:
            self._restate(pending.texts)
        pending.settle()
        states, numbers = pending.states, pending.numbers
        if pending is self._single:
            states, numbers = states.copy(), numbers.copy()
        return Assessments(states, numbers, self._points, self._normal, self._details, pending.texts, self.assumptions)

    def _restate(self, texts: ReasonTexts) -> None:
        """Keep the words of the reasons that are remembered, whose codes mean others under new `texts`."""
        before, self._remembered_texts = self._remembered_texts, texts
        if before == texts:
            return
        debounces = self._debounces
        for reasons in (self._memory["cause_reason"], debounces["stale_reason"], *debounces["reasons"]):
            for reason in reasons:
                reason[WORDS] = self._detail(before.words(reason.tolist(), self._details))

    def refuse(self, reason: Reason, detail: str, stamp_ns: int, age: float = 0.0, seconds: float = 0.0) -> Pending:
        """Return one joint state that is invalid for `reason`, such as undecodable bytes, to be settled."""
        self._memory["rejected"] += 1
        return self._unknown_state(reason, detail, stamp_ns, age, seconds)

    def watchdog_decision(self, elapsed_ns: int, now_ns: int = 0) -> Assessments:
        """Return UNKNOWN because no joint state has come for `elapsed_ns` of steady time.

        Its stamp is that of the last valid joint state, or `now_ns` on the node's clock if there was none.
        It does not affect later verdicts: those depend on the gap between header stamps alone.
        """
        last_ns, seconds = int(self._memory["last_stamp_ns"][0]), elapsed_ns / 1e9
        if self.ignored:
            reason = Reason.OTHER_JOINTS_SINCE if last_ns else Reason.ONLY_OTHER_JOINTS
        else:
            reason = Reason.SILENCE if last_ns else Reason.NO_JOINT_STATE
        pending = self._unknown_state(reason, self.joint_map_hint, last_ns or now_ns, seconds, seconds)
        pending.records["reason"][0, VALUES + 1] = self.ignored
        pending.records["is_watchdog"] = 1
        return self.settle(pending)

    def assess_configurations(self, q: FloatArray, qd: FloatArray, qdd: FloatArray | None = None) -> Assessments:
        """Return the assessments of configurations `q` (N, n) with `qd` and `qdd` (N, n), each by itself.

        The velocities count as accurate as those of a first joint state. None is a robot that does not accelerate.
        """
        pending = self._new_pending(len(q))
        pending.records["is_admitted"] = 1
        pending.motions[:, 0], pending.motions[:, 1], pending.motions[:, 2] = q, qd, self.rest_tolerance
        pending.motions[:, 3] = 0.0 if qdd is None else qdd
        self.compute(pending)
        settled = pending.states, pending.numbers, self._points, self._normal, self._details, self._texts
        return Assessments(*settled, self.assumptions)

    def _new_pending(self, count: int) -> Pending:
        records = np.zeros(count, STATE)
        points, joints = len(self.dynamics.contact_points), len(self._joints)
        numbers = np.empty((count, points, CONTACT.itemsize // 8))
        motions = np.zeros((count, 6, joints))
        states, q, qd = records.view(np.uint8), motions[:, 0], motions[:, 1]
        kernel, unknown, texts, memory = self._kernel, self._unknown, self._texts, self._memory_bytes
        return Pending(records, states, motions, q, qd, numbers, kernel, unknown, texts, memory)

    def _ignore(self, layout: Layout, clocks: IntArray, position: FloatArray, velocity: FloatArray) -> None:
        """Count joint states of other devices, and note which of their joints move."""
        self.ignored += len(clocks)
        self._other_names = layout.names
        self._watch(layout, clocks, position, velocity)

    def _watch(self, layout: Layout, clocks: IntArray, position: FloatArray, velocity: FloatArray) -> Found | None:
        """Return which joint outside the model does not rest in each of N joint states, as `OtherJoints.watch`."""
        names = layout.names
        if names not in self._other_places:
            if len(self._other_places) == MAX_LAYOUTS:
                self._other_places.clear()
            numbers = self._others.numbers([names[column] for column in layout.others])
            self._other_places[names] = np.array(layout.others, np.int64), numbers
        columns, numbers = self._other_places[names]

        def of_others(values: FloatArray) -> FloatArray:
            if values.shape[-1] != len(names):
                return np.full((len(clocks), len(columns)), math.nan)
            return np.take(values, columns, axis=-1).reshape(len(clocks), len(columns))

        return self._others.watch(numbers, clocks, of_others(position), of_others(velocity))

    def _read(
        self, pending: Pending, layout: Layout, position: FloatArray, velocity: FloatArray, effort: FloatArray
    ) -> None:
        """Put the joint states in order, and admit or refuse them."""
        if layout.reason is not Reason.NONE:
            pending.records["reason"][:, VALUES] = layout.value
        else:
            reason, values = self._adapter.read(layout, position, velocity, pending.q, pending.qd)
            if reason is not Reason.NONE:
                pending.records["reason"][:, [CODE, VALUES, VALUES + 1]] = reason, *values
            elif (filtered := self._adapter.filter(layout, pending.records, pending.motions)) is not None:
                pending.records["delay"], known = filtered
                pending.records["reason"][~known, CODE] = Reason.LONE_POSITION
            self._refuse_unmodelled(pending.records, layout, position, velocity)
        pending.admit()
        if layout.reason is Reason.NONE:
            self._watch_load(pending, layout, effort)

    def _watch_load(self, pending: Pending, layout: Layout, effort: FloatArray) -> None:
        """Doubt or refuse the admitted joint states while the torques show a heavier load than the stated one."""
        records, watch = pending.records, self.load_watch
        before = watch.doubt
        has_effort = effort.shape[-1] == len(layout.names) and not watch.why_not
        if not has_effort and not before.reason:
            return
        changes: list[tuple[int, Doubt]] = []
        if has_effort:
            torque = (effort if layout.is_ordered else effort[..., layout.order]).reshape(len(records), -1)
            if len(records) == 1 and not before.reason:
                state = records[0]
                values = int(state["stamp_ns"]), pending.q[0], pending.qd[0], torque[0]
                if not state["is_admitted"] or watch.wait(*values):
                    return
            rows = np.flatnonzero(records["is_admitted"])
            found = watch.watch(records["stamp_ns"][rows], pending.q[rows], pending.qd[rows], torque[rows])
            changes = [(int(rows[row]), doubt) for row, doubt in found]
        for (start, doubt), (stop, _) in pairwise([(0, before), *changes, (len(records), Doubt())]):
            if doubt.reason:
                part, text = records[start:stop], self._detail(doubt.text)
                if doubt.reason is Reason.HEAVIER_LOAD:
                    part["doubt"] = text
                else:
                    admitted = part["is_admitted"] == 1
                    part["is_admitted"][admitted] = 0
                    part["reason"][np.ix_(admitted, [CODE, DETAIL])] = doubt.reason, text

    def _refuse_unmodelled(self, records: Records, layout: Layout, position: FloatArray, velocity: FloatArray) -> None:
        """Give the reason of joint states while a joint outside the model moves, rests elsewhere, or is missing."""
        if not layout.others and not self._others.has_seen:
            return
        found = self._watch(layout, np.ascontiguousarray(records["now_ns"]), position, velocity)
        if found is None:
            return
        reasons, positions = records["reason"], found.positions
        for number, state in {*zip(found.numbers.tolist(), found.states.tolist(), strict=True)}:
            if state != RESTS:
                rows = (found.numbers == number) & (found.states == state) & (reasons[:, CODE] == Reason.NONE)
                reasons[rows, CODE] = HELD_REASONS.get(state, Reason.UNMODELLED_MOTION)
                reasons[rows, DETAIL] = self._detail(self._others.text(number, state))
                if state == ELSEWHERE:
                    reasons[rows, VALUES], reasons[rows, VALUES + 1] = positions[rows], self._others.held[number]

    def _unknown_state(self, reason: Reason, detail: str, stamp_ns: int, age: float, seconds: float) -> Pending:
        pending = self._new_pending(1)
        record = pending.records[0]
        record["stamp_ns"], record["age"] = max(stamp_ns, 0), age
        record["reason"][[CODE, DETAIL, VALUES]] = reason, self._detail(detail), seconds
        return pending

    def _detail(self, text: str) -> int:
        """Return the number of a text of reasons; of too many different ones, that of a general one."""
        index = self._detail_index.get(text)
        if index is None:
            if len(self._details) >= MAX_DETAILS:
                return self._detail_index[OTHER_DETAIL]
            index = self._detail_index[text] = len(self._details)
            self._details.append(text)
        return index
