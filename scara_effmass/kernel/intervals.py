# SPDX-License-Identifier: Apache-2.0
"""Means of joint states over consecutive intervals: their velocities and torques without a filter that delays them."""

from __future__ import annotations

import math

import numpy as np

from scara_effmass.kernel.admission import displacement
from scara_effmass.kernel.compiled import INTEGER, INTEGERS, MATRICES, MATRIX, VECTOR, compiled
from scara_effmass.kernel.records import IntArray
from scara_effmass.values import FloatArray

INTERVAL_NS = 20_000_000
"""Least duration of an interval [ns]."""
MIN_STATES = 3
"""Least number of joint states of an interval, both ends included."""
MAX_TORQUE = 1e9
"""Torque [N m, N] from which on it is none, as of a driver that does not set it: its square could overflow."""
MAX_WAITING = 64
"""Largest number of joint states that wait for others, with which they are averaged at once."""
Q, QD, QDD, TORQUE, LOWEST, HIGHEST = range(6)
"""Rows of the means of an interval: q, qd, qdd and torque, and the extremes of qd."""
LAST_Q, LAST_QD, LAST_TORQUE, FIRST_QD, SUM_Q, SUM_QD, SUM_TORQUE, MIN_QD, MAX_QD = range(9)


class Intervals:
    """Means of the joint states of n joints, whose positions have `periods` (n,), 0 for none.

    Joint states more than `timeout_s` [s] apart, or whose stamps do not increase, are of different intervals, and so
    are those on both sides of one that is not finite, or whose torque is above MAX_TORQUE.
    """

    def __init__(self, periods: FloatArray, timeout_s: float) -> None:
        self._periods, self._timeout_ns = periods, round(timeout_s * 1e9)
        self._memory, self._stamps = np.zeros((9, len(periods))), np.zeros(3, np.int64)
        self._waiting, self._waiting_stamps = np.empty((3, MAX_WAITING, len(periods))), np.empty(MAX_WAITING, np.int64)
        self._count, self._last_ns, self._end_ns = 0, 0, 0

    def wait(self, stamp_ns: int, q: FloatArray, qd: FloatArray, torque: FloatArray) -> bool:
        """Keep the next joint state if no interval ends with it; return whether it is kept.

        `q`, `qd` and `torque` are (n,). `add` takes what is kept first: several joint states at once are cheaper.
        """
        count = self._count
        if not count and not self._end_ns:
            self._last_ns, self._end_ns = stamp_ns - 1, stamp_ns + INTERVAL_NS
        if count == MAX_WAITING or not self._last_ns < stamp_ns < self._end_ns:
            return False
        self._waiting_stamps[count] = self._last_ns = stamp_ns
        self._waiting[0, count], self._waiting[1, count], self._waiting[2, count] = q, qd, torque
        self._count = count + 1
        return True

    def add(self, stamps: IntArray, q: FloatArray, qd: FloatArray, torque: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return the joint states (K,) with which intervals ended, by number, and their means (K, 6, n).

        `stamps` (N,) [ns], `q`, `qd` and `torque` (N, n) are the next joint states. The mean of qdd is exact: the
        change of qd over the duration; the others are by the trapezoidal rule.
        """
        if waiting := self._count:
            stamps = np.concatenate((self._waiting_stamps[:waiting], stamps))
            q, qd, torque = (
                np.concatenate(rows) for rows in zip(self._waiting[:, :waiting], (q, qd, torque), strict=True)
            )
            self._count = 0
        q, qd, torque = np.ascontiguousarray(q), np.ascontiguousarray(qd), np.ascontiguousarray(torque)
        ends, means = np.empty(len(stamps), np.int64), np.empty((len(stamps), 6, len(self._periods)))
        count = fill_intervals(
            stamps, q, qd, torque, self._periods, self._timeout_ns, self._memory, self._stamps, ends, means
        )
        first_ns, self._last_ns, length = self._stamps.tolist()
        self._end_ns = first_ns + INTERVAL_NS if length else 0
        return ends[:count] - waiting, means[:count]


@compiled(INTEGERS, MATRIX, MATRIX, MATRIX, VECTOR, INTEGER, MATRIX, INTEGERS, INTEGERS, MATRICES)
def fill_intervals(
    stamps: IntArray,
    q: FloatArray,
    qd: FloatArray,
    torque: FloatArray,
    periods: FloatArray,
    timeout_ns: int,
    memory: FloatArray,
    kept: IntArray,
    ends: IntArray,
    means: FloatArray,
) -> int:
    """Write the rows with which intervals end; return their number. `kept` is first and last stamp and length."""
    found, joints = 0, q.shape[1]
    for row in range(len(stamps)):
        is_finite = True
        for j in range(joints):
            is_finite &= math.isfinite(q[row, j]) and math.isfinite(qd[row, j]) and abs(torque[row, j]) < MAX_TORQUE
        if not is_finite:
            kept[2] = 0
            continue
        step = stamps[row] - kept[1]
        if kept[2] > 0 and not 0 < step <= timeout_ns:
            kept[2] = 0
        for j in range(joints):
            if kept[2] > 0:
                half = 0.5e-9 * step
                position = memory[LAST_Q, j] + displacement(q[row, j], memory[LAST_Q, j], periods[j])
                memory[SUM_Q, j] += half * (memory[LAST_Q, j] + position)
                memory[SUM_QD, j] += half * (memory[LAST_QD, j] + qd[row, j])
                memory[SUM_TORQUE, j] += half * (memory[LAST_TORQUE, j] + torque[row, j])
            else:
                position = q[row, j]
                memory[FIRST_QD, j], memory[MIN_QD, j], memory[MAX_QD, j] = qd[row, j], qd[row, j], qd[row, j]
                memory[SUM_Q : SUM_TORQUE + 1, j] = 0.0
            memory[LAST_Q, j], memory[LAST_QD, j], memory[LAST_TORQUE, j] = position, qd[row, j], torque[row, j]
            memory[MIN_QD, j] = min(memory[MIN_QD, j], qd[row, j])
            memory[MAX_QD, j] = max(memory[MAX_QD, j], qd[row, j])
        if kept[2] == 0:
            kept[0] = stamps[row]
        kept[1] = stamps[row]
        kept[2] += 1
        duration_ns = kept[1] - kept[0]
        if kept[2] < MIN_STATES or duration_ns < INTERVAL_NS:
            continue
        ends[found] = row
        for j in range(joints):
            seconds = 1e-9 * duration_ns
            means[found, Q, j] = memory[SUM_Q, j] / seconds
            means[found, QD, j] = memory[SUM_QD, j] / seconds
            means[found, QDD, j] = (qd[row, j] - memory[FIRST_QD, j]) / seconds
            means[found, TORQUE, j] = memory[SUM_TORQUE, j] / seconds
            means[found, LOWEST, j], means[found, HIGHEST, j] = memory[MIN_QD, j], memory[MAX_QD, j]
            memory[FIRST_QD, j], memory[MIN_QD, j], memory[MAX_QD, j] = qd[row, j], qd[row, j], qd[row, j]
            memory[SUM_Q : SUM_TORQUE + 1, j] = 0.0
        kept[0], kept[2] = kept[1], 1
        found += 1
    return found
