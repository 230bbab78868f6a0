# SPDX-License-Identifier: Apache-2.0
"""Admit joint states: order, stamp, range, velocities against positions, commands.

Intervals are between header stamps; the ages of stamp and command are on the node's clock.
The velocities are compared with the positions over WINDOW_S. The error of a joint is its displacement minus the
integral of its signed velocity, high-passed. Velocities that lag behind the positions by tau cause an error of tau
times the high-passed velocity. A wrong size or sign causes an error in proportion to the low-passed velocity. That is
uncorrelated with the high-passed velocity, on which a regression of the error therefore estimates tau alone.
The acceleration is the low-passed difference quotient of the velocities. Its error is by how much it exceeds a slower
one while the joint gets faster: it covers an acceleration that has just begun.
"""

from __future__ import annotations

import math
from typing import Any

from scara_effmass.codes import Reason
from scara_effmass.kernel.compiled import BYTES, MATRICES, compiled, inlined
from scara_effmass.kernel.records import ByteArray
from scara_effmass.kernel.state import (
    CODE,
    DETAIL,
    JOINT_MEMORY,
    MEMORY,
    NO_SEQUENCE,
    RULES,
    STATE,
    JointMemory,
    Memory,
    Rules,
    State,
    set_reason,
)
from scara_effmass.values import FloatArray

NANOSECONDS = 1_000_000_000
FAST_S, SLOW_S = 0.02, 0.06
"""Time constants [s] of the acceleration, and of the one that tells its error."""
MAX_ERROR = 3.0
"""Largest error of an acceleration over it: one that begins at rest has 2/3, and one that turns starts from 0."""
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


@inlined
def displacement(position: float, before: float, period: float) -> float:
    """Return by how much a joint has moved from the position `before`, the shorter way with a `period`."""
    moved = position - before
    return moved - period * math.floor(moved / period + 0.5) if period > 0.0 else moved


@inlined
def forget(memory: Memory, joints: tuple[JointMemory, ...]) -> None:
    """Forget all joint states, and the latest command."""
    memory.last_stamp_ns, memory.sequence, memory.observed_ns = 0, NO_SEQUENCE, 0
    memory.is_comparing = memory.has_command = 0
    memory.lag_correlation = memory.lag_excitation = 0.0
    for joint in joints:
        joint.is_unconfirmed = 1


@inlined
def check_stamp(state: State, rules: Rules, memory: Memory) -> Reason:
    """Write why the stamp is refused; return the code, 0 if it is not."""
    stamp_ns, now_ns, last_ns = state.stamp_ns, state.now_ns, memory.last_stamp_ns
    latest_ns = now_ns + rules.future_tolerance_ns
    code, seconds, step = Reason.NONE, 0.0, 0.0
    if stamp_ns <= 0:
        code = Reason.ZERO_STAMP
    elif stamp_ns > latest_ns:
        code, seconds = Reason.FUTURE_STAMP, (stamp_ns - now_ns) / 1e9
        if rules.clock_step_ns > rules.timeout_ns // 2:
            code, step = Reason.COARSE_CLOCK, rules.clock_step_ns / 1e9
    elif now_ns - stamp_ns > rules.timeout_ns:
        code, seconds = Reason.OLD_STAMP, (now_ns - stamp_ns) / 1e9
    elif stamp_ns == last_ns:
        code = Reason.REPEATED_STAMP
    elif stamp_ns < last_ns:
        code, seconds = Reason.BACKWARD_STAMP, (last_ns - stamp_ns) / 1e9
    if code != Reason.NONE:
        set_reason(state.reason, code, 0, seconds, step, 0.0)
    return code


@inlined
def check_range(state: State, q: FloatArray, qd: FloatArray, joints: tuple[JointMemory, ...]) -> bool:
    """Write which value is not finite or out of range; return whether one is."""
    for i in range(len(joints)):
        joint, x, v = joints[i], q[i], qd[i]
        if not math.isfinite(x):
            set_reason(state.reason, Reason.POSITION_NOT_FINITE, i, x, 0.0, 0.0)
        elif not math.isfinite(v):
            set_reason(state.reason, Reason.VELOCITY_NOT_FINITE, i, v, 0.0, 0.0)
        elif not joint.lower <= x <= joint.upper:
            set_reason(state.reason, Reason.POSITION_LIMIT, i, x, joint.lower, joint.upper)
        elif abs(v) > joint.max_speed:
            set_reason(state.reason, Reason.SPEED_LIMIT, i, v, joint.max_speed, 0.0)
        else:
            continue
        return True
    return False


@inlined
def begin_comparison(
    state: State, q: FloatArray, qd: FloatArray, memory: Memory, joints: tuple[JointMemory, ...]
) -> None:
    """Compare from this joint state on."""
    memory.is_comparing, memory.observed_ns = 1, state.stamp_ns
    for i in range(len(joints)):
        joint = joints[i]
        joint.position, joint.velocity, joint.mean_velocity = q[i], qd[i], qd[i]
        joint.error = joint.peak = joint.allowance = 0.0
        joint.fast_acceleration = joint.slow_acceleration = 0.0
        joint.since_ns, joint.since_position = state.stamp_ns, q[i]


@inlined
def check_velocities(
    state: State,
    motion: FloatArray,
    rules: Rules,
    memory: Memory,
    joints: tuple[JointMemory, ...],
) -> bool:
    """Write which velocity contradicts its position, and the tolerances of all; return whether one does."""
    q, qd, tolerances = motion[0], motion[1], motion[2]
    if memory.is_comparing == 0 or state.stamp_ns - memory.observed_ns > rules.timeout_ns:
        begin_comparison(state, q, qd, memory, joints)
    seconds = (state.stamp_ns - memory.observed_ns) / 1e9
    memory.observed_ns = state.stamp_ns
    fast, slow = math.exp(-seconds / FAST_S), math.exp(-seconds / SLOW_S)
    decay, gain = WINDOW_S / (WINDOW_S + seconds), seconds / WINDOW_S
    half_step, scale_step = 0.5 * seconds, rules.velocity_tolerance * seconds
    excitation = memory.lag_excitation
    lag = min(max(memory.lag_correlation / excitation, 0.0), rules.max_lag) if excitation != 0.0 else 0.0
    known_lag = lag * excitation / (excitation + LAG_EVIDENCE)
    lag_tolerance = LAG_TOLERANCE_S + rules.max_lag * LAG_PRIOR / (LAG_PRIOR + excitation)
    correlation, excitation = 0.0, 0.0
    is_wrong = False
    for i in range(len(joints)):
        joint, x, v = joints[i], q[i], qd[i]
        error = (joint.error + displacement(x, joint.position, joint.period) - half_step * (v + joint.velocity)) * decay
        joint.mean_velocity = (joint.mean_velocity + v * gain) * decay
        change = v - joint.mean_velocity
        joint.peak = max(joint.peak * decay, abs(change))
        joint.allowance = (joint.allowance + half_step * abs(v - joint.velocity) + scale_step * abs(v)) * decay
        tolerance = joint.position_tolerance + joint.allowance + lag_tolerance * joint.peak
        excess = error - lag * change
        if not -tolerance <= excess <= tolerance:
            if not is_wrong:
                set_reason(state.reason, Reason.VELOCITY_MISMATCH, i, excess, 0.0, 0.0)
            is_wrong = True
            error = lag * change + math.copysign(min(abs(excess), MAX_EXCESS * tolerance), excess)
            joint.is_unconfirmed, joint.since_ns, joint.since_position = 1, state.stamp_ns, x
        if seconds > 0.0:
            rate = (v - joint.velocity) / seconds
            joint.fast_acceleration = rate + fast * (joint.fast_acceleration - rate)
            joint.slow_acceleration = rate + slow * (joint.slow_acceleration - rate)
        correlation += error * change
        excitation += change * change
        joint.position, joint.velocity, joint.error = x, v, error
        tolerances[i] = max(tolerance / WINDOW_S, abs(error - known_lag * change) / RECENT_S)
    decay = LAG_MEMORY_S / (LAG_MEMORY_S + seconds)
    memory.lag_correlation = (memory.lag_correlation + correlation * seconds) * decay
    memory.lag_excitation = (memory.lag_excitation + excitation * seconds) * decay
    return is_wrong


@inlined
def check_zeros(state: State, motion: FloatArray, joints: tuple[JointMemory, ...]) -> bool:
    """Write which joint reads a velocity of exactly zero that its position has not confirmed; return whether one does.

    A joint that moved farther than the comparison tolerates, in agreement with its velocity, shows that velocities
    are reported: then zeros are confirmed. The comparison finds a joint whose velocity is wrong.
    """
    q, qd, tolerances = motion[0], motion[1], motion[2]
    moves, first = False, -1
    for i in range(len(joints)):
        moved = displacement(q[i], joints[i].since_position, joints[i].period)
        if qd[i] != 0.0 and abs(moved) > tolerances[i] * WINDOW_S:
            moves = True
    for i in range(len(joints)):
        joint = joints[i]
        if moves or qd[i] != 0.0 or state.stamp_ns - joint.since_ns >= CONFIRMATION_NS:
            joint.is_unconfirmed = 0
        if joint.is_unconfirmed != 0 and first < 0:
            first = i
    if first >= 0:
        set_reason(state.reason, Reason.UNCONFIRMED_ZERO, first, 0.0, 0.0, 0.0)
    return first >= 0


@inlined
def check_command(state: State, q: FloatArray, rules: Rules, memory: Memory, joints: tuple[JointMemory, ...]) -> bool:
    """Write how the latest command contradicts the positions; return whether it does.

    Nothing else reveals positions and velocities that freeze together, or joints that are exchanged in both.
    """
    if memory.has_command == 0:
        set_reason(state.reason, Reason.NO_COMMAND, 0, 0.0, 0.0, 0.0)
        return True
    if state.now_ns - memory.command_ns > rules.timeout_ns:
        set_reason(state.reason, Reason.OLD_COMMAND, 0, (state.now_ns - memory.command_ns) / 1e9, 0.0, 0.0)
        return True
    for i in range(len(joints)):
        difference = displacement(q[i], joints[i].command, joints[i].period)
        if not abs(difference) <= joints[i].command_tolerance:  # also NaN
            set_reason(state.reason, Reason.COMMAND_MISMATCH, i, difference, 0.0, 0.0)
            return True
    return False


@inlined
def check(  # noqa: C901, PLR0911 - one check after the other
    state: State, motion: FloatArray, rules: Rules, memory: Memory, joints: tuple[JointMemory, ...]
) -> bool:
    """Return whether a joint state is valid; write why it is not, or which gap lies before it."""
    if state.now_ns + rules.future_tolerance_ns < memory.last_stamp_ns:  # system time was set back
        forget(memory, joints)
        state.is_cleared = 1
    given, previous_ns = int(state.reason[CODE]), memory.last_stamp_ns
    if 0 < given < Reason.POSITION_COUNT:
        return False
    last, memory.sequence = memory.sequence, state.sequence
    if last != NO_SEQUENCE and NO_SEQUENCE != state.sequence <= last:
        set_reason(state.reason, Reason.SECOND_PUBLISHER, 0, state.sequence, last, 0.0)
        return False
    if check_stamp(state, rules, memory) != Reason.NONE or (given > 0 and given != Reason.UNMODELLED_MOTION):
        return False
    memory.last_stamp_ns = state.stamp_ns
    if check_range(state, motion[0], motion[1], joints):
        return False
    if check_velocities(state, motion, rules, memory, joints):
        return False
    if check_zeros(state, motion, joints):
        return False
    if rules.expects_commands and check_command(state, motion[0], rules, memory, joints):
        return False
    for i in range(len(joints)):
        if rules.filters_velocity:
            motion[2, i] += motion[3, i]
        # One that reads zero has stopped: the estimate lags.
        motion[3, i] = joints[i].fast_acceleration if motion[1, i] != 0.0 else 0.0
        change = joints[i].fast_acceleration - joints[i].slow_acceleration
        is_rising = change * motion[3, i] > 0.0 and motion[1, i] * motion[3, i] > 0.0
        motion[4, i] = min(abs(change), MAX_ERROR * abs(motion[3, i])) if is_rising else 0.0
    elapsed_ns = state.stamp_ns - previous_ns
    if given == Reason.NONE and previous_ns != 0 and elapsed_ns > rules.timeout_ns:
        set_reason(state.reason, Reason.GAP, 0, elapsed_ns / 1e9, 0.0, 0.0)
    return True


@compiled(BYTES, MATRICES, BYTES, BYTES, BYTES)
def admit(
    states: ByteArray, motions: FloatArray, rules_of: ByteArray, memory_of: ByteArray, joints_of: ByteArray
) -> None:
    """Admit or refuse N joint states in order.

    `motions` (N, 5, n) are q, qd, tolerances of qd, qdd and its errors. The latter three are written here; in place of
    qdd comes the change of a filtered qd.
    All but `motions` are the bytes of State, Rules, Memory and JointMemory.
    """
    joints: Any = joints_of.view(JOINT_MEMORY)
    rules, memory = rules_of.view(RULES)[0], memory_of.view(MEMORY)[0]
    rows = states.view(STATE)
    for row in range(len(rows)):
        state = rows[row]
        state.is_cleared = state.is_watchdog = state.doubt = 0
        state.age = (state.now_ns - state.stamp_ns) / 1e9 if state.stamp_ns > 0 else 0.0
        if int(state.reason[CODE]) == Reason.UNDECODABLE:
            state.is_admitted = 0
        else:
            state.is_admitted = check(state, motions[row], rules, memory, joints)
        if state.is_admitted == 0:
            state.delay = 0.0
            memory.rejected += 1
            if state.stamp_ns <= 0:
                state.stamp_ns = state.now_ns
        elif int(state.reason[CODE]) == Reason.UNMODELLED_MOTION:
            state.is_admitted = 0
        elif rules.distrusted_code != 0:
            state.is_admitted = 0
            set_reason(state.reason, Reason.TWO_PUBLISHERS, 0, 0.0, 0.0, 0.0)
            state.reason[CODE], state.reason[DETAIL] = rules.distrusted_code, rules.distrusted_detail


@compiled(BYTES, BYTES)
def forget_all(memory_of: ByteArray, joints_of: ByteArray) -> None:
    """Forget all joint states, and the latest command."""
    joints: Any = joints_of.view(JOINT_MEMORY)
    forget(memory_of.view(MEMORY)[0], joints)
