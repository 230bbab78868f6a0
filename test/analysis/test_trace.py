"""Courses for figures: nothing that a person could have seen is lost on the way."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.analysis.trace import TimeSeries, Trace, thinned, verdict_spans
from scara_effmass.safety import unknown_contact
from scara_effmass.values import Verdict

known = unknown_contact("tool", "", 1, 0.0)._replace(
    verdict=Verdict.OK, speed=0.2, allowable_speed=1.0, effective_mass=2.0, lumped_mass=2.0, iso_mass=2.77
)


def course(times: list[float], verdicts: list[Verdict]) -> TimeSeries:
    nothing = np.full(len(times), np.nan)
    return TimeSeries(0, np.array(times), np.array(verdicts, np.int64), *(nothing for _ in range(6)))


def test_a_trace_keeps_what_was_decided_in_order_of_time() -> None:
    trace = Trace()
    trace.add(known._replace(speed=0.5, stamp_ns=3_000_000_000), 3_004_000_000)
    trace.add(known._replace(stamp_ns=1_000_000_000), 1_001_000_000)
    kept = trace.course()
    assert kept.time.tolist() == [0.0, 2.0]
    assert kept.speed.tolist() == [0.2, 0.5]
    assert kept.iso_mass.tolist() == [2.77, 2.77]
    assert np.isnan(kept.full_mass).all()


def test_what_is_not_known_is_nan() -> None:
    trace = Trace()
    trace.add(unknown_contact("tool", "the header stamp is zero", 0, 0.0), 1_000_000_000)
    held = known._replace(verdict=Verdict.UNKNOWN, reason="held after: stale", allowable_speed=0.0)
    trace.add(held._replace(stamp_ns=2_000_000_000), 2_001_000_000)
    kept = trace.course()
    assert kept.time.tolist() == [0.0, 1.0]
    assert np.isnan(kept.speed[0])
    assert np.isnan(kept.effective_mass[0])
    assert kept.speed[1] == 0.2
    assert np.isnan(kept.allowable_speed).all()


def test_an_empty_trace_is_an_empty_course() -> None:
    assert len(Trace().course().time) == 0


@given(st.lists(st.one_of(st.floats(-1e3, 1e3), st.just(float("nan"))), min_size=1, max_size=400), st.integers(1, 20))
def test_thinning_keeps_peaks_gaps_and_ends_of_every_column(values: list[float], columns: int) -> None:
    y = np.array(values)
    t = np.linspace(0.0, 0.1 * (len(y) - 1), len(y))
    few_t, few_y = thinned(t, y, columns)
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
    _, few = thinned(np.linspace(0.0, 1e3, len(y)), y, 1500)
    assert few.max() == 7.0
    assert len(few) < 7500


def test_spans_join_equal_verdicts_and_show_silence_as_unknown() -> None:
    ok, warn, unknown = Verdict.OK, Verdict.WARN, Verdict.UNKNOWN
    spans = verdict_spans(course([0.0, 0.1, 0.2, 1.0, 1.1], [ok, ok, warn, warn, ok]), 0.2)
    expected = [(0.0, 0.2, ok), (0.2, 0.4, warn), (0.4, 1.0, unknown), (1.0, 1.1, warn)]
    assert [span[2] for span in spans] == [span[2] for span in expected]
    assert np.array([span[:2] for span in spans]) == pytest.approx(np.array([span[:2] for span in expected]))


@given(st.lists(st.tuples(st.floats(0.001, 1.0), st.sampled_from(list(Verdict))), min_size=2, max_size=40))
def test_spans_cover_the_whole_time_once(steps: list[tuple[float, Verdict]]) -> None:
    times = np.cumsum([step for step, _ in steps])
    spans = verdict_spans(course((times - times[0]).tolist(), [verdict for _, verdict in steps]), 0.2)
    assert spans[0][0] == 0.0
    assert spans[-1][1] == pytest.approx(times[-1] - times[0])
    assert all(first[1] == second[0] for first, second in pairwise(spans))
    assert all(first[2] is not second[2] for first, second in pairwise(spans))
