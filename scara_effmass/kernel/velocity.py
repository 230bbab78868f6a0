# SPDX-License-Identifier: Apache-2.0
"""Velocity of the joints over a window of joint states: mean of the reported ones, or slope of the positions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scara_effmass.kernel.admission import displacement
from scara_effmass.kernel.compiled import FLAG, FLAGS, INTEGER, INTEGERS, MATRICES, MATRIX, VECTOR, compiled, inlined
from scara_effmass.kernel.records import IntArray
from scara_effmass.values import FloatArray


class VelocityWindow:
    """Filters the velocities of consecutive joint states of n joints.

    Their positions have `periods` (n,), 0 for none. Over `window_s` [s], the velocity is the mean of the reported ones,
    or the slope of the least-squares line through the positions (without a window: through the last two). Both are late
    by the mean age of the samples. A gap of more than `timeout_s` [s], or a stamp that does not increase, starts over.
    """

    def __init__(self, periods: FloatArray, window_s: float, timeout_s: float, from_positions: bool) -> None:  # noqa: FBT001
        self._window_ns, self._timeout_ns = round(window_s * 1e9), round(timeout_s * 1e9)
        self._from_positions = from_positions
        self._periods = periods
        self._stamps, self._samples = np.empty(0, np.int64), np.empty((0, len(periods)))

    def reset(self) -> None:
        """Discard the samples."""
        self._stamps, self._samples = self._stamps[:0], self._samples[:0]

    def apply(self, stamps: IntArray, motions: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Write the filtered velocities in `motions` (N, 6, n), and the change of qd within its delay.

        Returns the delays (N,) [s] and whether there is a velocity (N,): one position alone has none.
        """
        kept = len(self._stamps)
        values = motions[:, 0 if self._from_positions else 1]
        stamps, samples = np.concatenate((self._stamps, stamps)), np.concatenate((self._samples, values))
        delays, known = np.zeros(len(motions)), np.ones(len(motions), np.bool_)
        first = filter_rows(
            stamps,
            samples,
            self._periods,
            kept,
            self._window_ns,
            self._timeout_ns,
            self._from_positions,
            motions,
            delays,
            known,
        )
        self._stamps, self._samples = stamps[first:], samples[first:]
        return delays, known


@compiled(INTEGERS, MATRIX, VECTOR, INTEGER, INTEGER, INTEGER, FLAG, MATRICES, VECTOR, FLAGS)
def filter_rows(
    stamps: IntArray,
    samples: FloatArray,
    periods: FloatArray,
    kept: int,
    window_ns: int,
    timeout_ns: int,
    from_positions: bool,  # noqa: FBT001 - compiled
    motions: FloatArray,
    delays: FloatArray,
    known: NDArray[np.bool_],
) -> int:
    """Filter the rows from number `kept` on; return the first sample of the last window."""
    first, shortest = 0, 2 if from_positions else 1
    for row in range(kept, len(stamps)):
        now, out = stamps[row], motions[row - kept]
        if row > first and not 0 < now - stamps[row - 1] <= timeout_ns:
            first = row
        while row + 1 - first > shortest and now - stamps[first] > window_ns:
            first += 1
        count = row + 1 - first
        total = 0.0
        for i in range(first, row + 1):
            total += (stamps[i] - now) / 1e9
        delays[row - kept] = -total / count
        for j in range(samples.shape[1]):
            out[3, j] = 0.0
        if count < 2:
            known[row - kept] = not from_positions
            continue
        for j in range(samples.shape[1]):
            if from_positions:
                # At constant acceleration, the slope over the newer half lags half as much.
                half = first + min(count // 2, count - 2)
                velocity = slope(stamps[first : row + 1], samples[first : row + 1, j], periods[j])
                change = 2.0 * (slope(stamps[half : row + 1], samples[half : row + 1, j], periods[j]) - velocity)
            else:
                velocity = 0.0
                for i in range(first, row + 1):
                    velocity += samples[i, j]
                velocity /= count
                change = samples[row, j] - velocity
            out[1, j], out[3, j] = velocity, abs(change)
    return first


@inlined
def slope(stamps: IntArray, values: FloatArray, period: float) -> float:
    """Return the slope of the least-squares line through `values` (m,) at `stamps` (m,) [ns], per second.

    With a `period`, no value is more than half of it off the last one.
    """
    last = len(stamps) - 1
    mean = 0.0
    for i in range(len(stamps)):
        mean += (stamps[i] - stamps[last]) / 1e9
    mean /= len(stamps)
    product = square = 0.0
    for i in range(len(stamps)):
        time = (stamps[i] - stamps[last]) / 1e9 - mean
        # Values that rest have the slope 0 exactly, however the sum is rounded.
        product += time * displacement(values[i], values[last], period)
        square += time * time
    return product / square
