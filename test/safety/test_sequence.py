# SPDX-License-Identifier: Apache-2.0
"""Arrays of joint states and verdicts give, bit for bit, the results of one joint state after another."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scara_effmass.safety.debounce import HELD, VerdictDebouncer
from scara_effmass.safety.joint_state_validator import ComparedMotion, JointStateValidator, Motion
from scara_effmass.safety.sequence import NO_REASON, IntArray, agreeing_states, debounce

from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import FloatArray, JointState, Verdict

NAMES = ("joint1", "joint2", "joint3", "joint4")
CENTRE, SIZE = np.array([0.2, 0.4, 0.1, -0.3]), np.array([0.4, 0.3, 0.02, 0.5])
START_NS, STEP_NS = 10**15, 8_000_000
FAULTS = ("repeated", "late", "old", "future", "jump", "wrong velocity", "limit", "speed", "nan", "nan velocity")


class Columns(NamedTuple):
    """Stamps and clocks [ns], positions and velocities of joint states."""

    stamps: IntArray
    clocks: IntArray
    q: FloatArray
    qd: FloatArray


def validator(dynamics: RobotDynamics) -> JointStateValidator:
    return Monitor(dynamics, MonitorSettings()).validator


def motion(count: int, rate: float, lag: float, scale: float, seed: int) -> Columns:
    """Return a motion whose velocities are late by `lag` [s], too large by `scale`, and noisy."""
    rng = np.random.default_rng(seed)
    stamps = START_NS + np.cumsum(rng.integers(STEP_NS // 2, 2 * STEP_NS, count))
    phase = rate * np.array([1.0, 1.4, 0.6, 2.1])
    time = (stamps - START_NS)[:, None] / 1e9
    qd = scale * SIZE * phase * np.cos(phase * (time - lag)) + rng.normal(0.0, 1e-3, (count, 4))
    return Columns(stamps, stamps + rng.integers(0, 10**6, count), CENTRE + SIZE * np.sin(phase * time), qd)


def joint_state(columns: Columns, row: int) -> tuple[JointState, int]:
    """Return the joint state of a row, and the time of the clock."""
    stamps, clocks, q, qd = columns
    return JointState(int(stamps[row]), NAMES, q[row], qd[row]), int(clocks[row])


def agreeing(validator: JointStateValidator, columns: Columns, row: int) -> FloatArray:
    """Return the tolerances of the joint states from number `row` on that agree."""
    return agreeing_states(validator, columns.stamps[row:], columns.clocks[row:], columns.q[row:], columns.qd[row:])


def damage(kind: str, row: int, columns: Columns) -> None:
    """Put a fault into the joint state number `row`, or begin one there."""
    stamps, clocks, q, qd = columns
    if kind == "repeated":
        stamps[row] = stamps[row - 1]
    elif kind == "late":
        stamps[row:] += 201_000_000
        clocks[row:] += 201_000_000
    elif kind == "old":
        stamps[row:] += 10**9
        clocks[row:] += 10**9
        clocks[row] = stamps[row] + 200_000_001
    elif kind == "future":
        stamps[row] = clocks[row] + 20_000_001
    elif kind == "jump":
        q[row:, 1] += 0.1
    elif kind == "wrong velocity":
        qd[row : row + 60] *= -1.0
    else:
        column, value = {"limit": (q, 3.0), "speed": (qd, -40.0), "nan": (q, np.nan)}.get(kind, (qd, np.nan))
        column[row, 1] = value


@given(
    st.floats(0.0, 6.0),
    st.floats(-0.01, 0.06),
    st.sampled_from([0.8, 1.0, 1.1, 1.3]),
    st.lists(st.tuples(st.integers(2, 299), st.sampled_from(FAULTS)), max_size=4),
    st.integers(0, 2**32 - 1),
)
@example(2.0, 0.02, 1.0, [], 1)
@example(2.0, 0.02, 1.0, [(row, kind) for row, kind in zip(range(20, 300, 28), FAULTS, strict=True)], 2)
def test_joint_states_agree_as_one_by_one(
    scara: RobotDynamics, rate: float, lag: float, scale: float, faults: list[tuple[int, str]], seed: int
) -> None:
    columns = motion(300, rate, lag, scale, seed)
    for row, kind in faults:
        damage(kind, row, columns)
    single, many = validator(scara), validator(scara)
    expected = [single.validate(*joint_state(columns, row)) for row in range(300)]
    row, singles = 0, 0
    while row < 300:
        tolerances = agreeing(many, columns, row)
        for tolerance, motion_ in zip(tolerances, expected[row:], strict=False):
            assert isinstance(motion_, Motion)
            assert motion_.velocity_tolerance == tolerance.tolist()
        row += len(tolerances)
        if row < 300:
            result, wanted = many.validate(*joint_state(columns, row)), expected[row]
            assert type(result) is type(wanted)
            if isinstance(result, Motion) and isinstance(wanted, Motion):
                assert result.velocity_tolerance == wanted.velocity_tolerance
                singles += 1
            else:
                assert result == wanted
            row += 1
    memories = single.agreement(), many.agreement()
    assert (memories[0] is None) == (memories[1] is None)
    for one, other in zip(*(memory or () for memory in memories), strict=True):
        np.testing.assert_array_equal(one, other)
    if not faults and rate > 1.0 and scale == 1.0 and 0.0 <= lag < 0.05:
        assert singles < 20  # until the velocities are confirmed


def test_lag_evidence_of_before_counts(scara: RobotDynamics) -> None:
    """Velocities that are late by what was estimated agree, as they do one by one; without the estimate, less so."""
    columns = motion(300, 4.0, 0.05, 1.0, 3)
    tolerances = []
    for evidence in ([0.0, 0.0], [0.05 * 50.0, 50.0]):
        one = validator(scara)
        for row in range(20):
            one.validate(*joint_state(columns, row))
        memory = one.agreement()
        assert isinstance(memory, ComparedMotion)
        one.agree(memory._replace(lag_evidence=np.array(evidence)))
        tolerances.append(agreeing(one, columns, 20)[0])
    assert (tolerances[1] < tolerances[0]).all()


def test_joints_exactly_at_their_limits_agree(scara: RobotDynamics) -> None:
    one = validator(scara)
    for limit in (one.limits.lower, one.limits.upper):
        columns = motion(100, 0.0, 0.0, 1.0, 5)
        columns.q[:], columns.qd[:] = limit, 0.0
        columns.stamps[:] += 10**9
        columns.clocks[:] += 10**9
        one.reset()
        for row in range(50):
            one.validate(*joint_state(columns, row))
        assert len(agreeing(one, columns, 50)) == 50


verdicts = st.sampled_from(Verdict)
rows = st.lists(
    st.tuples(st.integers(0, 60), verdicts, st.booleans(), st.integers(0, 9), st.integers(0, 9)),
    min_size=1,
    max_size=60,
)


@given(rows, st.sampled_from([0, 1, 100, 10_000]), st.integers(1, 60))
@example([(0, Verdict.VIOLATION, True, 1, 1), (99, Verdict.OK, True, 1, 1)], 100, 60)
def test_verdicts_are_debounced_as_one_by_one(
    steps: list[tuple[int, Verdict, bool, int, int]], release_ns: int, size: int
) -> None:
    """In blocks of `size` rows: texts of an earlier block are those that it left."""
    debouncer = VerdictDebouncer()
    debouncer.release_ns = release_ns
    stamps = np.cumsum([1 + gap for gap, *_ in steps])
    seen_ns, kept = np.zeros(5, np.int64), [""] * 5
    for first in range(0, len(steps), size):
        part = steps[first : first + size]
        expected = []
        for row, (_, verdict, is_valid, clear, stale) in enumerate(part, first):
            if clear == 0:
                debouncer.clear()
            if stale == 0:
                debouncer.mark_stale(f"stale {row}")
            if is_valid:
                reason = "" if verdict is Verdict.OK else f"reason {row}"
                expected.append(debouncer.update(verdict, reason, int(stamps[row])))
            else:
                expected.append((Verdict.UNKNOWN, f"stale {row}" if stale == 0 else ""))
        # Rows have codes from 0 on, texts of stale joint states and those of the blocks before lie below NO_REASON.
        texts = [f"stale {row}" for row in range(first, first + len(part))] + kept
        own = NO_REASON - 1 - np.arange(len(texts))
        stale_codes = np.where([step[4] == 0 for step in part], own[: len(part)], NO_REASON)
        seen = np.array([own[len(part) + i] if kept[i] else NO_REASON for i in range(5)])
        shown, codes = np.empty(len(part), np.int8), np.empty(len(part), np.int64)
        held = np.zeros(len(part), np.bool_)
        debounce(
            np.array([step[1] for step in part], np.int8),
            np.array([step[2] for step in part]),
            np.array([step[3] == 0 for step in part]),
            stale_codes,
            stamps[first : first + len(part)],
            release_ns,
            seen_ns,
            seen,
            shown,
            codes,
            held,
        )

        def text(code: int, texts: list[str] = texts, first: int = first) -> str:
            if code == NO_REASON:
                return ""
            return f"reason {first + code}" if code >= 0 else texts[NO_REASON - 1 - code]

        found = [
            (Verdict(value), f"{HELD}{text(code)}" if is_held else text(code))
            for value, code, is_held in zip(shown.tolist(), codes.tolist(), held.tolist(), strict=True)
        ]
        assert found == expected
        kept = [text(int(code)) for code in seen]


@pytest.mark.parametrize("count", [0, 1, 2])
def test_nothing_agrees_before_zero_velocities_are_confirmed(scara: RobotDynamics, count: int) -> None:
    columns = motion(100, 0.0, 0.0, 1.0, 4)
    columns[3][:] = 0.0
    one = validator(scara)
    for row in range(count):
        one.validate(*joint_state(columns, row))
    assert agreeing(one, columns, count).shape == (0, 4)
