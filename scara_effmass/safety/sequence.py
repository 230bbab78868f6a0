# SPDX-License-Identifier: Apache-2.0
"""The steps of an assessment that depend on earlier joint states, over arrays: comparison of velocities, debouncing.

The order of the operations is that of `safety`, so that the results are bit-identical.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scara_effmass.kernel.jit import compiled
from scara_effmass.safety.joint_state_validator import (
    LAG_EVIDENCE,
    LAG_MEMORY_S,
    LAG_PRIOR,
    LAG_TOLERANCE_S,
    RECENT_S,
    WINDOW_S,
    ComparedMotion,
    JointStateValidator,
)
from scara_effmass.values import BoolArray, FloatArray, Verdict

IntArray = NDArray[np.int64]
OK, WORST_FIRST = int(Verdict.OK), (int(Verdict.UNKNOWN), int(Verdict.VIOLATION), int(Verdict.WARN))
NO_REASON = -1


def agreeing_states(
    validator: JointStateValidator, stamp_ns: IntArray, now_ns: IntArray, q: FloatArray, qd: FloatArray
) -> FloatArray:
    """Return the velocity tolerances (m, n) of the leading joint states that `validator` accepts without a doubt.

    `q` and `qd` (N, n) are in the model's joint order. The validator continues after these m joint states, and must
    itself judge the next one, which may be valid as well.
    """
    memory = validator.agreement()
    tolerances = np.empty_like(q)
    if memory is None:
        return tolerances[:0]
    times = np.array([memory.last_stamp_ns, memory.observed_ns, validator.timeout_ns, validator.future_tolerance_ns])
    inputs = stamp_ns, now_ns, q, qd, times, memory.comparisons, memory.lag_evidence
    count = _agreeing(*inputs, *validator.limits, tolerances, np.empty_like(memory.comparisons))
    if count:
        last_ns = int(stamp_ns[count - 1])
        validator.agree(ComparedMotion(last_ns, last_ns, memory.comparisons, memory.lag_evidence))
    return tolerances[:count]


@compiled
def _agreeing(
    stamps: IntArray,
    clocks: IntArray,
    q: FloatArray,
    qd: FloatArray,
    times: IntArray,
    comparisons: FloatArray,
    evidence: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    max_speeds: FloatArray,
    position_tolerances: FloatArray,
    velocity_tolerance: float,
    max_lag: float,
    tolerances: FloatArray,
    new: FloatArray,
) -> int:
    """Compare as `JointStateValidator._velocity_mismatch`, up to the first joint state that it may refuse.

    Updates `comparisons` and `evidence`, writes `tolerances`; `new` is for the comparisons of one joint state.
    """
    last_ns, observed_ns, timeout_ns, future_ns = times
    correlation, excitation = evidence
    joints = q.shape[1]
    for row in range(len(stamps)):
        stamp_ns, now_ns = stamps[row], clocks[row]
        elapsed_ns = stamp_ns - observed_ns
        if not (last_ns < stamp_ns <= now_ns + future_ns and now_ns - stamp_ns <= timeout_ns >= elapsed_ns):
            return row
        seconds = elapsed_ns / 1e9
        decay, gain = WINDOW_S / (WINDOW_S + seconds), seconds / WINDOW_S
        half_step, scale_step = 0.5 * seconds, velocity_tolerance * seconds
        lag = min(max(correlation / excitation, 0.0), max_lag) if excitation != 0.0 else 0.0
        known_lag = lag * excitation / (excitation + LAG_EVIDENCE)
        lag_tolerance = LAG_TOLERANCE_S + max_lag * LAG_PRIOR / (LAG_PRIOR + excitation)
        new_correlation, new_excitation = 0.0, 0.0
        for i in range(joints):
            x, v = q[row, i], qd[row, i]
            if not (lower[i] <= x <= upper[i] and -max_speeds[i] <= v <= max_speeds[i]):
                return row
            last_x, last_v, error = comparisons[i, 0], comparisons[i, 1], comparisons[i, 2]
            mean, peak, allowance = comparisons[i, 3], comparisons[i, 4], comparisons[i, 5]
            error = (error + x - last_x - half_step * (v + last_v)) * decay
            mean = (mean + v * gain) * decay
            change = v - mean
            peak = max(peak * decay, abs(change))
            allowance = (allowance + half_step * abs(v - last_v) + scale_step * abs(v)) * decay
            tolerance = position_tolerances[i] + allowance + lag_tolerance * peak
            if not -tolerance <= error - lag * change <= tolerance:
                return row
            new_correlation += error * change
            new_excitation += change * change
            new[i, 0], new[i, 1], new[i, 2], new[i, 3], new[i, 4], new[i, 5] = x, v, error, mean, peak, allowance
            tolerances[row, i] = max(tolerance / WINDOW_S, abs(error - known_lag * change) / RECENT_S)
        for i in range(joints):
            for k in range(comparisons.shape[1]):
                comparisons[i, k] = new[i, k]
        last_ns = observed_ns = stamp_ns
        decay = LAG_MEMORY_S / (LAG_MEMORY_S + seconds)
        correlation = (correlation + new_correlation * seconds) * decay
        excitation = (excitation + new_excitation * seconds) * decay
        evidence[0], evidence[1] = correlation, excitation
    return len(stamps)


@compiled
def debounce(  # noqa: C901 - one loop, as in VerdictDebouncer
    verdicts: NDArray[np.int8],
    valid: BoolArray,
    cleared: BoolArray,
    stale: IntArray,
    stamps: IntArray,
    release_ns: int,
    seen_ns: IntArray,
    seen: IntArray,
    shown: NDArray[np.int8],
    codes: IntArray,
    held: BoolArray,
) -> None:
    """Debounce as `VerdictDebouncer`: write verdicts, the codes of their reasons, and whether these are held.

    All arrays are (m,); `held` comes as zeros. A code is the number of a row whose own reason it is, NO_REASON, or
    that in `stale` of the reason from which UNKNOWN is held. `seen_ns` and `seen` (5,) hold time and code of the last
    verdict of each number, and of the reason that makes the next valid row stale; they are updated.
    """
    for row in range(len(verdicts)):
        if cleared[row]:
            for number in range(len(seen)):
                seen[number] = NO_REASON
        if stale[row] != NO_REASON:
            seen[4] = stale[row]
        shown[row], codes[row] = 0, stale[row]
        if not valid[row]:
            continue
        verdict, stamp_ns = verdicts[row], stamps[row]
        if seen[4] != NO_REASON:
            seen_ns[0], seen[0], seen[4] = stamp_ns, seen[4], NO_REASON
        shown[row], codes[row] = verdict, NO_REASON
        if verdict != OK:
            seen_ns[verdict], seen[verdict], codes[row] = stamp_ns, row, row
        for worse in WORST_FIRST:
            if worse == verdict:
                break
            if seen[worse] == NO_REASON:
                continue
            if stamp_ns - seen_ns[worse] < release_ns:
                shown[row], codes[row], held[row] = worse, seen[worse], True
                break
            seen[worse] = NO_REASON
