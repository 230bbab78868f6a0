# SPDX-License-Identifier: Apache-2.0
"""Cycles, times and reasons of a summary match hand counts."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.analysis.summary import MAX_REASONS, OTHER_REASONS, Summary
from scara_effmass.codes import Reason
from scara_effmass.safety import unknown_contact
from scara_effmass.safety.remedies import remedy
from scara_effmass.values import ContactAssessment, Verdict
from test.decisions import decision_on, states_of

MS = 1_000_000
TIMEOUT_NS = 200 * MS


def contact(verdict: Verdict, margin: float = 0.5, reason: str = "", point: str = "tool") -> ContactAssessment:
    return unknown_contact(point, reason)._replace(
        verdict=verdict, margin=margin, speed=0.1, allowable_speed=0.1 + margin
    )


def test_verdict_lasts_until_the_next_cycle_or_the_timeout() -> None:
    summary = Summary(TIMEOUT_NS)
    for at_ms, verdict in ((0, Verdict.OK), (100, Verdict.WARN), (150, Verdict.OK), (1150, Verdict.VIOLATION)):
        summary.add(states_of(decision_on(contact(verdict)), log_time_ns=at_ms * MS))
    assert summary.cycles == {Verdict.OK: 2, Verdict.WARN: 1, Verdict.VIOLATION: 1}
    assert summary.time_ns[Verdict.OK] == 300 * MS
    assert summary.time_ns[Verdict.WARN] == 50 * MS
    assert summary.time_ns[Verdict.UNKNOWN] == 800 * MS
    assert summary.time_ns[Verdict.VIOLATION] == 0
    assert (summary.gaps, summary.max_gap_ns) == (1, 1000 * MS)


def test_backward_time_is_not_counted() -> None:
    summary = Summary(TIMEOUT_NS)
    summary.add(states_of(decision_on(contact(Verdict.OK)), log_time_ns=100 * MS))
    summary.add(states_of(decision_on(contact(Verdict.OK)), log_time_ns=50 * MS))
    assert sum(summary.time_ns.values()) == 0


def test_time_between_recordings_is_not_counted() -> None:
    summary, other = Summary(TIMEOUT_NS), Summary(TIMEOUT_NS)
    summary.add(states_of(decision_on(contact(Verdict.OK)), log_time_ns=0))
    other.add(states_of(decision_on(contact(Verdict.OK)), log_time_ns=10_000 * MS))
    summary.merge(other)
    assert (summary.gaps, sum(summary.time_ns.values())) == (0, 0)


def test_cycles_are_counted_by_the_contact_that_decides() -> None:
    summary = Summary(TIMEOUT_NS)
    cycles = [(Verdict.OK, Verdict.WARN), (Verdict.WARN, Verdict.OK), (Verdict.OK, Verdict.VIOLATION)]
    for first, second in [*cycles, (Verdict.UNKNOWN, Verdict.OK)]:
        contacts = contact(first), contact(second, point="link2")
        summary.add(states_of(decision_on(*contacts), log_time_ns=0))
    assert summary.as_dict()["deciding_contacts"] == {"link2": 2, "tool": 1}
    assert ("decided by", "link2 66.7%, tool 33.3%") in summary.lines()


@given(st.lists(st.tuples(st.sampled_from(Verdict), st.integers(0, 300)), min_size=1, max_size=20))
def test_merged_summaries_are_that_of_one_recording(cycles: list[tuple[Verdict, int]]) -> None:
    whole, merged = Summary(TIMEOUT_NS), Summary(TIMEOUT_NS)
    at_ms = 0
    for number, (verdict, step_ms) in enumerate(cycles):
        at_ms += step_ms
        assessed = states_of(
            decision_on(contact(verdict, float(-number % 7), f"{at_ms} s old")), log_time_ns=at_ms * MS
        )
        whole.add(assessed)
        if number % 5 == 0:
            part = Summary(TIMEOUT_NS)
        part.add(assessed)
        if number % 5 == 4 or number == len(cycles) - 1:
            merged.merge(part)
    assert (merged.cycles, merged.reason_counts()) == (whole.cycles, whole.reason_counts())
    assert merged.as_dict()["tightest"] == whole.as_dict()["tightest"]
    assert all(merged.time_ns[verdict] <= whole.time_ns[verdict] for verdict in Verdict if verdict)


@pytest.mark.parametrize("order", [1, -1])
def test_cycle_has_the_verdict_of_its_worst_contact_point(order: int) -> None:
    summary = Summary(TIMEOUT_NS)
    points = [contact(Verdict.VIOLATION, -0.1), contact(Verdict.UNKNOWN, -9.0, "stale", "elbow")]
    summary.add(states_of(decision_on(*points[::order]), log_time_ns=0))
    assert summary.cycles == {Verdict.UNKNOWN: 1}
    assert summary.reasons == {"stale": 1}
    assert ("UNKNOWN because", "stale (1 cycle)") in summary.lines()
    assert summary.tightest is not None
    assert summary.tightest.contact.margin == -0.1


def test_tightest_margin_has_positions_and_recording() -> None:
    summary = Summary(TIMEOUT_NS)
    for number, margin in enumerate((0.5, 0.2, 0.3)):
        decision, positions = decision_on(contact(Verdict.OK, margin)), {"joint1": float(number)}
        summary.add(states_of(decision, log_time_ns=number, positions=positions), f"bag{number}")
    tightest = summary.as_dict()["tightest"]
    assert (tightest["margin_m_s"], tightest["bag"], tightest["positions"]) == (0.2, "bag1", {"joint1": 1.0})


def test_reasons_are_counted_without_their_numbers() -> None:
    summary = Summary(TIMEOUT_NS)
    for reason in ("the joint state is 0.512 s old", "the joint state is -1e-05 s old", "joint1 at 2.5000 rad"):
        summary.add(states_of(decision_on(contact(Verdict.UNKNOWN, 0.0, reason)), log_time_ns=0))
    assert summary.reasons == {"the joint state is … s old": 2, "joint1 at … rad": 1}


def test_reasons_carry_the_range_of_their_numbers() -> None:
    summary = Summary(TIMEOUT_NS)
    for reason in ("a is 0.512 s old", "a is 203.101 s old", "joint1 at 2.5000 rad", "joint1 at 2.5000 rad"):
        summary.add(states_of(decision_on(contact(Verdict.UNKNOWN, 0.0, reason)), log_time_ns=0))
    assert summary.as_dict()["unknown_reasons"] == {"a is 0.512 to 203.101 s old": 2, "joint1 at 2.5 rad": 2}
    assert ("UNKNOWN because", "a is 0.512 to 203.101 s old (2 cycles)") in summary.lines()


@given(st.lists(st.tuples(st.floats(-1e6, 1e6), st.floats(0.0, 10.0)), min_size=1, max_size=30))
def test_range_covers_every_number(numbers: list[tuple[float, float]]) -> None:
    summary = Summary(TIMEOUT_NS)
    for first, second in numbers:
        summary.add(
            states_of(decision_on(contact(Verdict.UNKNOWN, 0.0, f"x is {first!r} m after {second!r} s")), log_time_ns=0)
        )
    (text,) = summary.as_dict()["unknown_reasons"]
    ends = [[float(number) for number in part.split(" to ")] for part in text[5:-2].split(" m after ")]
    for end, values in zip(ends, zip(*numbers, strict=True), strict=True):
        assert (end[0], end[-1]) == pytest.approx((min(values), max(values)))


@pytest.mark.parametrize(("unknown", "share"), [(5, False), (6, True)])
def test_remedy_of_the_leading_reason_from_five_percent_on(unknown: int, *, share: bool) -> None:
    summary = Summary(TIMEOUT_NS)
    for number in range(100):
        code, reason = Reason.ZERO_STAMP, "the header stamp is zero or negative"
        if number >= unknown - 1:
            code, reason = Reason.REPEATED_STAMP, "the header stamp is repeated"
        verdict = Verdict.UNKNOWN if number < unknown else Verdict.OK
        cycle = contact(verdict, reason=reason)._replace(reason_code=code)
        summary.add(states_of(decision_on(cycle), log_time_ns=0))
    assert summary.remedy == (remedy(Reason.ZERO_STAMP) if share else "")
    assert (("remedy", summary.remedy) in summary.lines()) is share


def test_remedy_of_gaps() -> None:
    summary = Summary(TIMEOUT_NS)
    for at_ms in (0, 10, 5000):
        cycle = contact(Verdict.UNKNOWN if at_ms == 10 else Verdict.OK, reason="the header stamp is zero or negative")
        summary.add(states_of(decision_on(cycle), log_time_ns=at_ms * MS))
    assert summary.remedy == remedy(Reason.GAP)


def test_reasons_with_an_ellipsis_are_kept() -> None:
    summary = Summary(TIMEOUT_NS)
    for reason in ("a … b", "a … 3", "a 2 3", "a … b"):
        summary.add(states_of(decision_on(contact(Verdict.UNKNOWN, 0.0, reason)), log_time_ns=0))
    assert summary.reason_counts() == {"a ... b": 2, "a ... 3": 1, "a 2 3": 1}


def test_number_of_reasons_is_bounded() -> None:
    summary = Summary(TIMEOUT_NS)
    for number in range(10 * MAX_REASONS):
        summary.add(states_of(decision_on(contact(Verdict.UNKNOWN, 0.0, f"name{number} is odd")), log_time_ns=0))
    assert len(summary.reasons) == MAX_REASONS + 1
    assert summary.reasons[OTHER_REASONS] == 9 * MAX_REASONS


def test_empty_summary_is_valid_json() -> None:
    result = Summary(TIMEOUT_NS).as_dict()
    assert result["tightest"] is None
    json.dumps(result, allow_nan=False)
