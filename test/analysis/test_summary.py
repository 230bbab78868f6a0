"""Cycles, times and reasons of a summary match hand counts."""

import json

import numpy as np
import pytest

from scara_effmass.analysis.summary import MAX_REASONS, OTHER_REASONS, Summary
from scara_effmass.safety import unknown_contact
from scara_effmass.values import ContactAssessment, JointState, Verdict

MS = 1_000_000
TIMEOUT_NS = 200 * MS


def contact(verdict: Verdict, margin: float = 0.5, reason: str = "", point: str = "tool") -> ContactAssessment:
    return unknown_contact(point, reason, 1, 0.0)._replace(
        verdict=verdict, margin=margin, speed=0.1, allowable_speed=0.1 + margin
    )


def test_verdict_lasts_until_the_next_cycle_or_the_timeout() -> None:
    summary = Summary(TIMEOUT_NS)
    for at_ms, verdict in ((0, Verdict.OK), (100, Verdict.WARN), (150, Verdict.OK), (1150, Verdict.VIOLATION)):
        summary.add([contact(verdict)], at_ms * MS)
    assert summary.cycles == {Verdict.OK: 2, Verdict.WARN: 1, Verdict.VIOLATION: 1}
    assert summary.time_ns[Verdict.OK] == 300 * MS
    assert summary.time_ns[Verdict.WARN] == 50 * MS
    assert summary.time_ns[Verdict.UNKNOWN] == 800 * MS
    assert summary.time_ns[Verdict.VIOLATION] == 0
    assert (summary.gaps, summary.max_gap_ns) == (1, 1000 * MS)


def test_backward_time_is_not_counted() -> None:
    summary = Summary(TIMEOUT_NS)
    summary.add([contact(Verdict.OK)], 100 * MS)
    summary.add([contact(Verdict.OK)], 50 * MS)
    assert sum(summary.time_ns.values()) == 0


def test_time_between_recordings_is_not_counted() -> None:
    summary = Summary(TIMEOUT_NS)
    summary.add([contact(Verdict.OK)], 0)
    summary.new_recording()
    summary.add([contact(Verdict.OK)], 10_000 * MS)
    assert (summary.gaps, sum(summary.time_ns.values())) == (0, 0)


@pytest.mark.parametrize("order", [1, -1])
def test_cycle_has_the_verdict_of_its_worst_contact_point(order: int) -> None:
    summary = Summary(TIMEOUT_NS)
    points = [contact(Verdict.VIOLATION, -0.1), contact(Verdict.UNKNOWN, -9.0, "stale", "elbow")]
    summary.add(points[::order], 0)
    assert summary.cycles == {Verdict.UNKNOWN: 1}
    assert summary.reasons == {"stale": 1}
    assert summary.tightest is not None
    assert summary.tightest.contact.margin == -0.1


def test_tightest_margin_has_positions_and_recording() -> None:
    summary = Summary(TIMEOUT_NS)
    for number, margin in enumerate((0.5, 0.2, 0.3)):
        position = np.array([float(number)])
        state = JointState(1, ("joint1",), position, position)
        summary.add([contact(Verdict.OK, margin)], number, state, f"bag{number}")
    tightest = summary.as_dict()["tightest"]
    assert (tightest["margin_m_s"], tightest["bag"], tightest["positions"]) == (0.2, "bag1", {"joint1": 1.0})


def test_reasons_are_counted_without_their_numbers() -> None:
    summary = Summary(TIMEOUT_NS)
    for reason in ("the joint state is 0.512 s old", "the joint state is -1e-05 s old", "joint1 at 2.5000 rad"):
        summary.add([contact(Verdict.UNKNOWN, 0.0, reason)], 0)
    assert summary.reasons == {"the joint state is … s old": 2, "joint1 at … rad": 1}


def test_number_of_reasons_is_bounded() -> None:
    summary = Summary(TIMEOUT_NS)
    for number in range(10 * MAX_REASONS):
        summary.add([contact(Verdict.UNKNOWN, 0.0, f"name{number} is odd")], 0)
    assert len(summary.reasons) == MAX_REASONS + 1
    assert summary.reasons[OTHER_REASONS] == 9 * MAX_REASONS


def test_empty_summary_is_valid_json() -> None:
    result = Summary(TIMEOUT_NS).as_dict()
    assert result["tightest"] is None
    json.dumps(result, allow_nan=False)
