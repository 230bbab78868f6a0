# SPDX-License-Identifier: Apache-2.0
"""Means of joint states over intervals."""

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from scara_effmass.kernel.intervals import HIGHEST, INTERVAL_NS, LOWEST, QD, QDD, TORQUE, Intervals, Q
from scara_effmass.kernel.records import IntArray
from scara_effmass.values import FloatArray

STEP_NS = 4_000_000
TIMEOUT_S = 0.1


def states(count: int = 40) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Return stamps, q, qd and torque of two joints with constant accelerations."""
    stamps = 1_000_000_000 + STEP_NS * np.arange(count)
    t, qdd = (1e-9 * (stamps - stamps[0]))[:, None], np.array([2.0, -1.0])
    return stamps, 0.5 * qdd * t * t, qdd * t, 3.0 + np.array([5.0, -7.0]) * t


def test_means_are_those_of_the_interval() -> None:
    stamps, q, qd, torque = states()
    rows, means = Intervals(np.zeros(2), TIMEOUT_S).add(stamps, q, qd, torque)
    assert rows.tolist() == list(range(5, 40, 5))
    assert (np.diff(stamps[rows]) == INTERVAL_NS).all()
    for row, mean in zip(rows, means, strict=True):
        first, last = row - 5, row
        np.testing.assert_allclose(mean[QDD], [2.0, -1.0])
        np.testing.assert_allclose(mean[QD], (qd[first] + qd[last]) / 2.0, atol=1e-12)
        np.testing.assert_allclose(mean[TORQUE], (torque[first] + torque[last]) / 2.0)
        np.testing.assert_allclose(mean[Q], np.trapezoid(q[first : last + 1], axis=0) / 5.0, atol=1e-12)
        np.testing.assert_array_equal(mean[LOWEST], np.minimum(qd[first], qd[last]))
        np.testing.assert_array_equal(mean[HIGHEST], np.maximum(qd[first], qd[last]))


@settings(max_examples=100, deadline=None)
@given(
    st.sets(st.integers(1, 39), max_size=12) | st.just(set(range(1, 40))),
    st.sampled_from([1, 4]),
    st.lists(st.tuples(st.integers(1, 39), st.sampled_from([0, 200_000_000, -50_000_000, -3_000_000])), max_size=3),
)
def test_batches_do_not_matter(cuts: set[int], divisor: int, breaks: list[tuple[int, int]]) -> None:
    """Neither with gaps, steps back and torques that are not finite; one by one, joint states wait for others."""
    stamps, q, qd, torque = states()
    stamps = stamps[0] + (stamps - stamps[0]) // divisor
    for row, step_ns in breaks:
        stamps[row:] += step_ns
        torque[row, 0] += 0.0 if step_ns else np.nan
    rows, means = Intervals(np.zeros(2), TIMEOUT_S).add(stamps, q, qd, torque)
    parts, found = Intervals(np.zeros(2), TIMEOUT_S), []
    for start, stop in pairwise([0, *sorted(cuts), 40]):
        if stop == start + 1 and parts.wait(int(stamps[start]), q[start], qd[start], torque[start]):
            continue
        own, part = parts.add(stamps[start:stop], q[start:stop], qd[start:stop], torque[start:stop])
        found += [(start + row, mean.tobytes()) for row, mean in zip(own.tolist(), part, strict=True)]
    assert found == [(row, mean.tobytes()) for row, mean in zip(rows.tolist(), means, strict=True)]


def test_interval_does_not_span_a_gap_or_a_step_back_or_what_is_not_finite() -> None:
    for change in (200_000_000, -50_000_000):
        stamps, *values = states()
        stamps[13:] += change
        rows, _ = Intervals(np.zeros(2), TIMEOUT_S).add(stamps, *values)
        assert rows.tolist() == [5, 10, 18, 23, 28, 33, 38]
    for value in (np.nan, 1e9, -1e300):
        stamps, q, qd, torque = states()
        torque[13, 1] = value
        rows, means = Intervals(np.zeros(2), TIMEOUT_S).add(stamps, q, qd, torque)
        assert rows.tolist() == [5, 10, 19, 24, 29, 34, 39]
        assert np.abs(means).max() < 1e9


def test_continuous_joint_turns_on_across_pi() -> None:
    stamps, _, _, torque = states()
    t = 1e-9 * (stamps - stamps[0])
    q = np.column_stack(((3.0 + 3.0 * t + np.pi) % (2.0 * np.pi) - np.pi, t))
    qd = np.column_stack((np.full(40, 3.0), np.ones(40)))
    rows, means = Intervals(np.array([2.0 * np.pi, 0.0]), TIMEOUT_S).add(stamps, q, qd, torque)
    middle = 3.0 + 3.0 * (t[rows] - 0.01)
    np.testing.assert_allclose(np.cos(means[:, Q, 0]), np.cos(middle))
    np.testing.assert_allclose(np.sin(means[:, Q, 0]), np.sin(middle))


def test_sparse_joint_states_make_longer_intervals() -> None:
    stamps, q, qd, torque = states()
    rows, means = Intervals(np.zeros(2), TIMEOUT_S).add(10 * stamps, q, qd / 10.0, torque)
    assert rows.tolist() == list(range(2, 40, 2))  # at least three joint states
    np.testing.assert_allclose(means[:, QDD, 0], 0.02)
