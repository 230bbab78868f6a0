# SPDX-License-Identifier: Apache-2.0
"""Check joint states before anything is computed from them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scara_effmass.model.robot import Robot
from scara_effmass.safety.joint_state_adapter import suggested_map
from scara_effmass.settings import MonitorSettings, VelocitySource
from scara_effmass.values import FloatArray, JointState

IndexArray = NDArray[np.intp]
_Comparison = tuple[float, float, float, float, float, float]
"""What the comparison of a joint's velocity with its position remembers. All but the first two fade with WINDOW_S:

position; velocity; error, the displacement minus the integral of the velocity; mean velocity; largest difference
between the velocity and its mean; allowance, the error that a scale error of the velocity and its sampling explain.
"""

NANOSECONDS = 1_000_000_000
CLOCK_STEPS = 10
"""Number of steps of a simulated clock that are remembered."""
CONFIRMATION_NS = NANOSECONDS // 10
"""Time for which a joint must keep its position before its velocity of exactly zero is accepted."""
WINDOW_S = 0.7
"""Time constant [s] over which the displacement of a joint is compared with the integral of its velocity."""
LAG_TOLERANCE_S = 0.01
"""Tolerance [s] of the estimated lag of the velocities: jitter of the stamps, joints that differ."""
LAG_MEMORY_S = 10.0
"""Time constant [s] of the estimate of the lag."""
LAG_PRIOR = 0.01
"""Excitation [rad2/s] at which half of the maximum lag remains as uncertainty of the estimate."""
LAG_EVIDENCE = 1.0
"""Excitation [rad2/s] at which half of the estimated lag explains an error: at first, a wrong size looks like a lag."""
RECENT_S = 0.1
"""Shortest time [s] within which the error of a joint is taken to have arisen."""
MAX_EXCESS = 1.5
"""Multiple of the tolerance up to which an error is remembered: it bounds the time that a mismatch lasts."""
METRES_PER_RADIAN = 0.25
"""Tolerance of the position of a prismatic joint [m] per radian of that of a revolute joint."""
DEFAULT_MAX_SPEED = (60.0, 10.0)
"""Maximum speed of a revolute [rad/s] and of a prismatic joint [m/s] whose description states none."""


class Motion(NamedTuple):
    """Positions and velocities (n,) of a valid joint state, in the model's joint order [rad, m].

    `velocity_tolerance` is what the comparison with the positions lets pass, per joint: the mean velocity error over
    WINDOW_S that it cannot reveal, or the present error over RECENT_S if that is more.
    """

    q: FloatArray
    qd: FloatArray
    velocity_tolerance: list[float]


class ComparedMotion(NamedTuple):
    """Memory of the comparison of velocities with positions, while it agrees; times in [ns].

    `comparisons` (n, 6) are the entries of `_Comparison`, `lag_evidence` (2,) correlation and excitation.
    """

    last_stamp_ns: int
    observed_ns: int
    comparisons: FloatArray
    lag_evidence: FloatArray


class ComparisonLimits(NamedTuple):
    """Bounds (n,) of positions and velocities [rad, m, per second], and the tolerances of their comparison."""

    lower: FloatArray
    upper: FloatArray
    max_speeds: FloatArray
    position_tolerances: FloatArray
    velocity_tolerance: float
    max_lag: float


class OtherDevice(NamedTuple):
    """Result for a joint state whose `names` are none of the robot's joints: another device on the same topic."""

    names: tuple[str, ...]


class JointStateValidator:
    """Validates joint states against the robot, the clock and the joint states before them.

    All its state is keyed to header stamps, so the same messages give the same results live and offline.
    """

    def __init__(self, robot: Robot) -> None:
        """Expect the joints of `robot`. Call `apply` before `validate`."""
        self._robot = robot
        self._joints = robot.joint_names
        self._units = ["rad" if revolute else "m" for revolute in robot.revolute]
        self._command_tolerances: list[float] = []
        self._command: list[float] = []
        self._command_ns = 0
        self._clock_steps = [0] * CLOCK_STEPS
        self._names: tuple[str, ...] | None = None
        self._layout: IndexArray | str | OtherDevice | None = None
        self.reset()

    def apply(self, settings: MonitorSettings) -> None:
        """Apply changed settings from the next joint state on."""
        robot = self._robot
        tolerance = settings.joint_limit_tolerance
        self._lower = (robot.model.lowerPositionLimit - tolerance).tolist()
        self._upper = (robot.model.upperPositionLimit + tolerance).tolist()
        max_speeds = [
            speed if 0.0 < speed < math.inf else DEFAULT_MAX_SPEED[0 if revolute else 1]
            for speed, revolute in zip(robot.model.velocityLimit.tolist(), robot.revolute, strict=True)
        ]
        self._max_speeds = [speed * (1.0 + settings.joint_speed_tolerance) for speed in max_speeds]
        self.timeout_ns = round(settings.timeout * NANOSECONDS)
        self._future_tolerance = settings.future_tolerance
        self._allow_future()
        self._empty_velocity = "the velocity is empty: set velocity_source to from_positions"
        if settings.velocity_source is VelocitySource.FROM_POSITIONS:
            self._empty_velocity = "the velocity is empty, and one joint state alone cannot be differentiated"
        self._position_tolerances = self._per_joint(settings.position_tolerance)
        self._velocity_tolerance = settings.velocity_tolerance
        self._max_lag = settings.max_velocity_lag

    def take_clock_step(self, step_ns: int) -> None:
        """Take the step [ns] of a simulated clock. Stamps may lead it by a step, because it stands still in between.

        The second largest of the last CLOCK_STEPS counts, because a single large one may be a jump.
        """
        self._clock_steps = [*self._clock_steps[1:], step_ns]
        self._allow_future()

    def _allow_future(self) -> None:
        self._clock_step_ns = sorted(self._clock_steps)[-2]
        tolerance_ns = round(self._future_tolerance * NANOSECONDS)
        self.future_tolerance_ns = tolerance_ns + min(self._clock_step_ns, self.timeout_ns // 2)

    def expect_commands(self, tolerance: float) -> None:
        """Require positions within `tolerance` [rad] of the latest command; scaled for prismatic joints."""
        self._command_tolerances = self._per_joint(tolerance)

    def take_command(self, command: JointState, now_ns: int) -> None:
        """Take the positions that the controller commanded at `now_ns`; a command without all joints is ignored."""
        order = self.joint_order(command.names)
        if order is not None and len(command.position) == len(command.names):
            self._command = command.position[order].tolist()
            self._command_ns = now_ns

    def reset(self) -> None:
        """Discard the history of joint states, as after a jump of the clock."""
        self._command.clear()
        self.last_stamp_ns = 0
        self._last_sequence_number: int | None = None
        self._unconfirmed = set(range(len(self._joints)))
        self._observed_ns = 0
        self._agreed_since: list[tuple[int, float]] = []
        self._comparisons: list[_Comparison] = []
        self._lag_correlation = self._lag_excitation = 0.0

    @property
    def limits(self) -> ComparisonLimits:
        """Bounds and tolerances of the present settings."""
        tolerances = np.array(self._position_tolerances), self._velocity_tolerance, self._max_lag
        return ComparisonLimits(np.array(self._lower), np.array(self._upper), np.array(self._max_speeds), *tolerances)

    def agreement(self) -> ComparedMotion | None:
        """Return the memory of the comparison; None before it has begun, and while a joint is unconfirmed."""
        if self._unconfirmed or not self._comparisons:
            return None
        evidence = np.array([self._lag_correlation, self._lag_excitation])
        return ComparedMotion(self.last_stamp_ns, self._observed_ns, np.array(self._comparisons), evidence)

    def agree(self, memory: ComparedMotion) -> None:
        """Continue with the `memory` that the comparison of later joint states left, which agreed."""
        self.last_stamp_ns, self._observed_ns = memory.last_stamp_ns, memory.observed_ns
        self._comparisons = [(a, b, c, d, e, f) for a, b, c, d, e, f in memory.comparisons.tolist()]
        self._lag_correlation, self._lag_excitation = memory.lag_evidence.tolist()

    def joint_order(self, names: tuple[str, ...]) -> IndexArray | None:
        """Return the indices of the robot's joints in `names`, None if these are invalid or of another device."""
        order = self._joint_indices(names)
        if isinstance(order, (str, OtherDevice)):
            return None
        return np.arange(len(self._joints)) if order is None else order

    def validate(
        self, state: JointState, now_ns: int, sequence_number: int | None = None
    ) -> Motion | OtherDevice | str:
        """Return the motion in `state`, or the reason why it is invalid.

        `now_ns` is the node's clock, `sequence_number` that of the message at its publisher, None if unknown.
        """
        if state.names is not self._names:
            self._layout = self._joint_indices(state.names)
            self._names = state.names
        layout = self._layout
        if isinstance(layout, (str, OtherDevice)):
            return layout
        last, self._last_sequence_number = self._last_sequence_number, sequence_number
        if last is not None and sequence_number is not None and sequence_number <= last:
            return f"a second publisher, or a restarted one: joint state number {sequence_number} follows number {last}"
        motion = self._stamp_error(state.stamp_ns, now_ns) or self._length_error(state) or self._motion(state, layout)
        if self._command_tolerances and isinstance(motion, Motion):
            return self._command_error(motion.q.tolist(), now_ns) or motion
        return motion

    def _command_error(self, positions: list[float], now_ns: int) -> str:
        """Return why the latest command contradicts `positions`, or an empty string.

        Nothing else reveals positions and velocities that freeze together, or joints that are exchanged in both.
        """
        if not self._command:
            return "no joint command yet"
        if now_ns - self._command_ns > self.timeout_ns:
            return f"no joint command for {(now_ns - self._command_ns) / 1e9:.3f} s"
        for i, (x, commanded, tolerance) in enumerate(
            zip(positions, self._command, self._command_tolerances, strict=True)
        ):
            if not abs(x - commanded) <= tolerance:  # also NaN
                return f"{self._joints[i]} is {x - commanded:+.4f} {self._units[i]} off its command"
        return ""

    def _per_joint(self, tolerance: float) -> list[float]:
        return [tolerance * (1.0 if revolute else METRES_PER_RADIAN) for revolute in self._robot.revolute]

    def _joint_indices(self, names: tuple[str, ...]) -> IndexArray | str | OtherDevice | None:
        """Return the indices of the robot's joints in `names`; None if `names` are exactly these, in order."""
        if not names:
            return "the joint state has no names"
        if "" in names:
            return f"name {names.index('')} of the joint state is empty"
        index_of = {name: index for index, name in enumerate(names)}
        if len(index_of) != len(names):
            duplicate = next(name for index, name in enumerate(names) if index_of[name] != index)
            return f"joint {duplicate} is named twice"
        missing = [name for name in self._joints if name not in index_of]
        if len(missing) == len(self._joints):
            return OtherDevice(names)
        if missing:
            return f"joint {missing[0]} is missing{suggested_map(names, self._joints)}"
        indices = [index_of[name] for name in self._joints]
        return None if indices == list(range(len(names))) else np.array(indices)

    def _length_error(self, state: JointState) -> str:
        n = len(state.names)
        if len(state.position) != n:
            return f"{len(state.position)} positions for {n} names"
        if len(state.velocity) == n:
            return ""
        if len(state.velocity):
            return f"{len(state.velocity)} velocities for {n} names"
        return self._empty_velocity

    def _stamp_error(self, stamp_ns: int, now_ns: int) -> str:
        last_ns, latest_ns = self.last_stamp_ns, now_ns + self.future_tolerance_ns
        if last_ns < stamp_ns <= latest_ns and now_ns - stamp_ns <= self.timeout_ns:
            return ""
        if stamp_ns <= 0:
            return "the header stamp is zero"
        if stamp_ns > latest_ns:
            clock_reason = f": /clock moves in steps of {self._clock_step_ns / 1e9:.3f} s, above half of timeout"
            is_slow = self._clock_step_ns > self.timeout_ns // 2
            return f"the header stamp is {(stamp_ns - now_ns) / 1e9:.3f} s in the future{clock_reason * is_slow}"
        if now_ns - stamp_ns > self.timeout_ns:
            return f"the joint state is {(now_ns - stamp_ns) / 1e9:.3f} s old"
        if stamp_ns == last_ns:
            return "the header stamp is repeated"
        return f"the header stamp goes back by {(last_ns - stamp_ns) / 1e9:.6f} s"

    def _motion(self, state: JointState, layout: IndexArray | None) -> Motion | str:
        """Return the motion in `state` if its values are within limits and consistent, else the reason."""
        q, qd = state.position, state.velocity
        if layout is not None:
            q = q[layout]
            qd = qd[layout]
        self.last_stamp_ns = stamp_ns = state.stamp_ns
        positions, velocities = q.tolist(), qd.tolist()
        # mypyc has no fast loop for zip with keywords; all have one value per joint.
        for x, v, lower, upper, max_speed in zip(  # noqa: B905
            positions, velocities, self._lower, self._upper, self._max_speeds
        ):
            # A comparison with NaN is false, so this form also catches NaN.
            if not (lower <= x <= upper and -max_speed <= v <= max_speed):
                return self._range_error(positions, velocities)
        tolerances: list[float] = []
        reason = self._velocity_mismatch(positions, velocities, stamp_ns, tolerances)
        return reason or Motion(q, qd, tolerances)

    def _range_error(self, positions: list[float], velocities: list[float]) -> str:
        for i, (name, x, v, unit) in enumerate(zip(self._joints, positions, velocities, self._units, strict=True)):
            if not math.isfinite(x):
                return f"the position of {name} is {x}"
            if not math.isfinite(v):
                return f"the velocity of {name} is {v}"
            if not self._lower[i] <= x <= self._upper[i]:
                return f"{name} at {x:.4f} {unit} lies outside its limits {self._lower[i]:.4f} to {self._upper[i]:.4f}"
            if abs(v) > self._max_speeds[i]:
                return f"{name} at {v:.4f} {unit}/s exceeds its maximum speed of {self._max_speeds[i]:.4f} {unit}/s"
        raise AssertionError("unreachable: the caller found a value out of range")

    def _velocity_mismatch(
        self, positions: list[float], velocities: list[float], stamp_ns: int, tolerances: list[float]
    ) -> str:
        """Return why the velocities contradict the positions, or an empty string; fill `tolerances` (n,).

        The error of a joint is its displacement minus the integral of its signed velocity, high-passed with WINDOW_S.
        Velocities that lag behind the positions by tau cause an error of tau times the high-passed velocity. A wrong
        size or sign causes one in proportion to the low-passed velocity, which is uncorrelated with it, so a regression
        of the error on the high-passed velocity estimates tau alone.
        """
        elapsed_ns = stamp_ns - self._observed_ns
        if elapsed_ns > self.timeout_ns or not self._comparisons:
            self._comparisons = [(x, v, 0.0, v, 0.0, 0.0) for x, v in zip(positions, velocities, strict=True)]
            self._agreed_since = [(stamp_ns, x) for x in positions]
            elapsed_ns = 0
        self._observed_ns = stamp_ns
        seconds = elapsed_ns / 1e9
        decay, gain = WINDOW_S / (WINDOW_S + seconds), seconds / WINDOW_S
        half_step, scale_step = 0.5 * seconds, self._velocity_tolerance * seconds
        excitation = self._lag_excitation
        lag = min(max(self._lag_correlation / excitation, 0.0), self._max_lag) if excitation else 0.0
        known_lag = lag * excitation / (excitation + LAG_EVIDENCE)
        lag_tolerance = LAG_TOLERANCE_S + self._max_lag * LAG_PRIOR / (LAG_PRIOR + excitation)
        correlation, excitation, reason = 0.0, 0.0, ""
        comparisons: list[_Comparison] = []
        for x, v, position_tolerance, comparison in zip(  # noqa: B905 - as in _motion
            positions, velocities, self._position_tolerances, self._comparisons
        ):
            last_x, last_v, error, mean, peak, allowance = comparison
            error = (error + x - last_x - half_step * (v + last_v)) * decay
            mean = (mean + v * gain) * decay
            change = v - mean
            peak *= decay
            if change > peak:
                peak = change
            elif -change > peak:
                peak = -change
            step = v - last_v if v > last_v else last_v - v
            allowance = (allowance + half_step * step + scale_step * (v if v > 0.0 else -v)) * decay
            tolerance = position_tolerance + allowance + lag_tolerance * peak
            excess = error - lag * change
            if not -tolerance <= excess <= tolerance:
                i = len(comparisons)
                reason = reason or self._mismatch(i, excess)
                error = lag * change + math.copysign(min(abs(excess), MAX_EXCESS * tolerance), excess)
                self._unconfirmed.add(i)
                self._agreed_since[i] = stamp_ns, x
            correlation += error * change
            excitation += change * change
            comparisons.append((x, v, error, mean, peak, allowance))
            tolerances.append(max(tolerance / WINDOW_S, abs(error - known_lag * change) / RECENT_S))
        self._comparisons = comparisons
        decay = LAG_MEMORY_S / (LAG_MEMORY_S + seconds)
        self._lag_correlation = (self._lag_correlation + correlation * seconds) * decay
        self._lag_excitation = (self._lag_excitation + excitation * seconds) * decay
        if self._unconfirmed and not reason:
            reason = self._unconfirmed_zero(positions, velocities, stamp_ns, tolerances)
        return reason

    def _unconfirmed_zero(
        self, positions: list[float], velocities: list[float], stamp_ns: int, tolerances: list[float]
    ) -> str:
        """Return which joint reads a velocity of exactly zero that its position has not confirmed, or an empty string.

        A joint that moved farther than the comparison tolerates, in agreement with its velocity, shows that velocities
        are reported: then zeros are confirmed. The comparison finds a joint whose velocity is wrong.
        """
        moves = any(
            v != 0.0 and abs(x - first_x) > tolerance * WINDOW_S
            for x, v, (_, first_x), tolerance in zip(positions, velocities, self._agreed_since, tolerances, strict=True)
        )
        self._unconfirmed = {
            i
            for i in self._unconfirmed
            if not moves and velocities[i] == 0.0 and stamp_ns - self._agreed_since[i][0] < CONFIRMATION_NS
        }
        if not self._unconfirmed:
            return ""
        return f"the velocity of {self._joints[min(self._unconfirmed)]} reads zero, not yet confirmed by its position"

    def _mismatch(self, i: int, excess: float) -> str:
        return f"the position of {self._joints[i]} is {excess:+.4f} {self._units[i]} off the integral of its velocity"
