# SPDX-License-Identifier: Apache-2.0
"""Time series, decimation and episodes keep every peak, gap and verdict."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.analysis.time_series import (
    NO_JOINT_STATE,
    TimeSeries,
    TimeSeriesBuilder,
    decimate,
    intervals,
)
from scara_effmass.safety import unknown_contact
from scara_effmass.values import Verdict
from test.decisions import decision_on, states_of

OK, WARN, VIOLATION, UNKNOWN = Verdict.OK, Verdict.WARN, Verdict.VIOLATION, Verdict.UNKNOWN
TIMEOUT = 0.2

assessed = unknown_contact("tool", "")._replace(
    verdict=OK, speed=0.2, allowable_speed=1.0, margin=0.8, effective_mass=2.0, lumped_mass=2.0, iso_mass=2.77
)


def series(times: list[float], verdicts: list[Verdict]) -> TimeSeries:
    builder = TimeSeriesBuilder()
    for number, (time, verdict) in enumerate(zip(times, verdicts, strict=True)):
        stamp_ns = 10**12 + round(time * 1e9)
        row = assessed._replace(verdict=verdict, reason=f"row {number}", margin=0.1 - time)
        builder.add(states_of(decision_on(row, stamp_ns=stamp_ns), log_time_ns=stamp_ns), 0)
    return builder.build()


def test_assessments_are_in_order_of_their_stamps() -> None:
    builder = TimeSeriesBuilder()
    late = decision_on(assessed._replace(speed=0.5, reason="late"), stamp_ns=3_000_000_000)
    builder.add(states_of(late, log_time_ns=3_004_000_000), 0)
    early = decision_on(assessed._replace(verdict=WARN, reason="early"), stamp_ns=1_000_000_000)
    builder.add(states_of(early, log_time_ns=1_001_000_000), 0)
    kept = builder.build()
    assert kept.time.tolist() == [0.0, 2.0]
    assert kept.rows["speed"].tolist() == [0.2, 0.5]
    assert kept.rows["iso_mass"].tolist() == [2.77, 2.77]
    assert np.isnan(kept.rows["full_mass"]).all()
    assert {index: change.reason for index, change in kept.changes.items()} == {1: "late", 0: "early"}


def test_unknown_values_are_nan() -> None:
    builder = TimeSeriesBuilder()
    zero = decision_on(unknown_contact("tool", "the header stamp is zero or negative"), stamp_ns=0)
    builder.add(states_of(zero, log_time_ns=1_000_000_000), 0)
    held = assessed._replace(verdict=UNKNOWN, reason="held after: stale", allowable_speed=0.0)
    builder.add(states_of(decision_on(held, stamp_ns=2_000_000_000), log_time_ns=2_001_000_000), 0)
    kept = builder.build()
    assert kept.time.tolist() == [0.0, 1.0]
    assert np.isnan(kept.rows["speed"][0])
    assert np.isnan(kept.rows["effective_mass"][0])
    assert kept.rows["speed"][1] == 0.2
    assert np.isnan(kept.rows["allowable_speed"]).all()
    assert np.isnan(kept.rows["margin"]).all()


def test_an_empty_time_series_has_no_intervals() -> None:
    empty = TimeSeriesBuilder().build()
    assert len(empty.time) == 0
    assert list(intervals(empty, TIMEOUT)) == []


@given(st.lists(st.one_of(st.floats(-1e3, 1e3), st.just(float("nan"))), min_size=1, max_size=400), st.integers(1, 20))
def test_decimation_keeps_peaks_gaps_and_ends_of_every_column(values: list[float], columns: int) -> None:
    y = np.array(values)
    t = np.linspace(0.0, 0.1 * (len(y) - 1), len(y))
    few_t, few_y = decimate(t, y, columns)
    assert len(few_t) <= max(5 * columns, 0) or len(few_t) == len(t)
    assert np.all(np.diff(few_t) > 0.0)
    assert few_t[0] == t[0]
    assert few_t[-1] == t[-1]
    assert np.isin(few_t, t).all()
    edges = np.linspace(0.0, t[-1] if t[-1] > 0.0 else 1.0, columns + 1)
    for left, right in zip(edges[:-1] + 1e-9, edges[1:] - 1e-9, strict=True):
        inside, kept = y[(t > left) & (t < right)], few_y[(few_t > left - 2e-9) & (few_t < right + 2e-9)]
        if np.isnan(inside).any():
            assert np.isnan(kept).any()
        if not np.isnan(inside).all():
            assert np.nanmax(kept) >= np.nanmax(inside)
            assert np.nanmin(kept) <= np.nanmin(inside)


def test_a_single_peak_among_a_million_points_stays() -> None:
    y = np.zeros(1_000_000)
    y[123_456] = 7.0
    _, few = decimate(np.linspace(0.0, 1e3, len(y)), y, 1500)
    assert few.max() == 7.0
    assert len(few) < 7500


def test_intervals_have_verdict_margin_and_reason_and_silence_is_unknown() -> None:
    run = series([0.0, 0.1, 0.2, 0.3, 1.0, 1.1, 1.2], [OK, WARN, VIOLATION, VIOLATION, VIOLATION, OK, WARN])
    rows = list(intervals(run, TIMEOUT))
    assert [(row.verdict, round(row.start, 3), round(row.stop, 3), row.reason) for row in rows] == [
        (OK, 0.0, 0.1, "row 0"),
        (WARN, 0.1, 0.2, "row 1"),
        (VIOLATION, 0.2, 0.5, "row 2"),
        (UNKNOWN, 0.5, 1.0, NO_JOINT_STATE),
        (VIOLATION, 1.0, 1.1, "row 2"),
        (OK, 1.1, 1.2, "row 5"),
        (WARN, 1.2, 1.2, "row 6"),
    ]
    assert [row.min_margin for row in rows[1:3]] == pytest.approx([0.0, -0.2])


def test_an_interval_has_the_region_of_its_smallest_margin_and_the_pose_of_its_start() -> None:
    builder = TimeSeriesBuilder()
    for number, (verdict, margin) in enumerate(
        [(OK, 0.8), (WARN, 0.1), (WARN, 0.05), (WARN, 0.2), (UNKNOWN, 0.0), (UNKNOWN, -9.0), (VIOLATION, -0.1)]
    ):
        positions, stamp_ns = {"joint1": 0.1 * number, "joint2": 0.2 * number}, 10**9 + 10**8 * number
        contact = assessed._replace(verdict=verdict, margin=margin, body_region=f"region {number}")
        decision = decision_on(contact, stamp_ns=stamp_ns)
        builder.add(states_of(decision, log_time_ns=stamp_ns, positions=positions), 0)
    rows = list(intervals(builder.build(), TIMEOUT))
    assert [(row.verdict, row.min_margin, row.body_region) for row in rows] == [
        (OK, 0.8, "region 0"),
        (WARN, 0.05, "region 2"),
        (UNKNOWN, pytest.approx(math.nan, nan_ok=True), "region 4"),
        (VIOLATION, -0.1, "region 6"),
    ]
    assert rows[1].positions == {"joint1": 0.1, "joint2": 0.2}


def test_an_interval_after_a_silence_has_the_region_of_its_own_joint_states() -> None:
    builder = TimeSeriesBuilder()
    for stamp_ns, region in ((10**9, "chest"), (3 * 10**9, "abdomen")):
        contact = assessed._replace(verdict=WARN, body_region=region)
        builder.add(states_of(decision_on(contact, stamp_ns=stamp_ns), log_time_ns=stamp_ns), 0)
    run = builder.build()
    expected = [(WARN, "chest"), (UNKNOWN, ""), (WARN, "abdomen")]
    assert [(row.verdict, row.body_region) for row in intervals(run, TIMEOUT)] == expected
    assert [row.body_region for row in intervals(run.with_gaps(TIMEOUT), TIMEOUT)] == ["chest", "", "", "abdomen"]


steps = st.lists(st.tuples(st.floats(0.001, 1.0), st.sampled_from(list(Verdict))), min_size=2, max_size=40)


@given(steps)
def test_intervals_cover_the_whole_time_once(steps: list[tuple[float, Verdict]]) -> None:
    times = np.cumsum([step for step, _ in steps])
    rows = list(intervals(series((times - times[0]).tolist(), [verdict for _, verdict in steps]), TIMEOUT))
    assert rows[0].start == 0.0
    assert rows[-1].stop == pytest.approx(times[-1] - times[0])
    assert all(first.stop == second.start for first, second in pairwise(rows))
