# SPDX-License-Identifier: Apache-2.0
"""CellStatus: what a display may show; silence, missing and contradicting monitors are UNKNOWN."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.cell.status import BIN_NS, HISTORY_NS, CellStatus, Diagnostic, LoadSample, Validation, left_out_entry
from scara_effmass.safety import unknown_contact
from scara_effmass.values import (
    ContactAssessment,
    Decision,
    ForceBlock,
    Impact,
    RunInfo,
    SeriesStatistics,
    Verdict,
    severity,
)
from test.decisions import decision_on

MS = 1_000_000
S = 1000 * MS


def contact(
    verdict: Verdict = Verdict.OK, point: str = "tool", speed: float = 0.2, limit: float = 0.5, reason: str = ""
) -> ContactAssessment:
    known = unknown_contact(point, reason)._replace(verdict=verdict)
    return known._replace(speed=speed, allowable_speed=limit, margin=limit - speed)


def decision(number: int = 2, *contacts: ContactAssessment) -> Decision:
    return decision_on(*(contacts or (contact(),)), speed_scaling=0.5, sequence_number=number)


def ok_cell(at_ns: int = S) -> CellStatus:
    status = CellStatus(0)
    status.take_publisher(400 * MS, exists=True)
    status.take_decision(decision(1), at_ns)
    assert (status.verdict, status.allowable_speed, status.speed_scaling) == (Verdict.OK, 0.5, 0.5)
    return status


def impact(stamp_ns: int = 10 * S, rebound: int = 0) -> Impact:
    flags = {"clipped": False, "incomplete": False, "simulated": True}
    numbers = dict.fromkeys(("impulse", "onset_sample", "baseline", "noise", "clock_residual"), 0.0)
    return Impact(stamp_ns, "", 100.0, 0.02, rebound=rebound, source="sim", **numbers, **flags)  # type: ignore[arg-type]


def validation(stamp_ns: int, count: int) -> Validation:
    none, rest = (0.0, 0.0), (0, True, True, "")
    series = SeriesStatistics(count, *(0.9, 1e5, 0.0, 1.0), 0, 1.0, none, 1.0, none, 0.1, 0.5, none, 0.0, *rest)
    return Validation(stamp_ns, *(110.0, 100.0, 0.1, 0.5, 0.25), True, "hand", 90.0, 140.0, False, series)  # noqa: FBT003


def test_load_text_is_that_of_the_last_estimate_or_of_the_monitor() -> None:
    status = CellStatus(0)
    assert status.load_text(S).startswith("unknown: no monitor")
    values = {"load by the torques": "unknown: effort_uncertainty is 0"}
    status.diagnostics["/monitor: model"] = Diagnostic("/monitor: model", 0, "", values, S)
    assert status.load_text(S) == "unknown: effort_uncertainty is 0"
    status.loads.append(LoadSample(S, 0.5, 0.4, 0.6, 0.25, is_observable=True, text="0.50 kg (0.40 to 0.60)"))
    assert status.load_text(3 * S) == "0.50 kg (0.40 to 0.60); 2 s ago"


def test_impact_keeps_why_the_validator_left_it_out() -> None:
    status = CellStatus(0)
    for stamp_ns in (10 * S, 11 * S):
        status.take_impact(impact(stamp_ns), S)
    for values in ({left_out_entry(10 * S): "no contact state"}, {}):  # the second one after a reset
        status.take_diagnostic(Diagnostic("/validator: series", 1, "", values, S))
    assert [record.left_out for record in status.impacts] == ["no contact state", ""]


def test_empty_panels_say_why() -> None:
    status = CellStatus(0)
    for reason in (status.no_impact_reason, status.no_validation_reason):
        assert reason == "no impact: no force is received, so no daq node runs in this cell"
    block = ForceBlock(S, "cell", 0, 1000.0, np.zeros(100))
    status.take_force(block)
    assert (status.no_impact_reason, status.unknown_force) == ("no impact yet", "")
    status.take_force(block._replace(saturated_samples=np.arange(100, dtype=np.uint32)))
    assert status.no_impact_reason == status.unknown_force == "force not known: sensor open, shorted or overloaded"
    status.take_impact(impact(), S)
    assert status.no_impact_reason == ""
    assert status.no_validation_reason.startswith("no impact is validated: no validator runs")
    status.take_validation(validation(10 * S, 1))
    assert status.no_validation_reason == ""


def test_a_cell_without_any_state_is_unknown() -> None:
    status = CellStatus(0)
    status.update(S)
    assert (status.verdict, status.reason) == (Verdict.UNKNOWN, "no contact states yet")


@pytest.mark.parametrize(
    ("exists", "now_ns", "reason"),
    [
        (True, S + 401 * MS, "the monitor is silent: no contact states for 0.4 s"),
        (False, S, "no monitor: contact_states has no publisher"),
    ],
)
def test_a_lost_monitor_is_unknown_by_itself_and_allows_nothing(exists: bool, now_ns: int, reason: str) -> None:  # noqa: FBT001
    status = ok_cell()
    status.take_publisher(400 * MS, exists=exists)
    status.update(now_ns)
    assert (status.verdict, status.reason) == (Verdict.UNKNOWN, reason)
    assert (status.allowable_speed, status.speed_scaling) == (0.0, 0.0)


def test_a_monitor_is_not_silent_before_its_deadline_is_over() -> None:
    status = ok_cell()
    status.take_publisher(400 * MS, exists=True)
    status.update(S + 400 * MS)
    assert status.verdict is Verdict.OK


def test_two_monitors_at_once_are_unknown_until_one_is_silent() -> None:
    status = ok_cell()
    status.take_decision(decision(1), S + 300 * MS)
    assert (status.verdict, status.reason) == (Verdict.UNKNOWN, "two monitors publish contact_states: must be one")
    status.take_decision(decision(2), S + 701 * MS)
    assert status.verdict is Verdict.OK


@pytest.mark.parametrize("numbers", [(1, 1, 2, 2, 3, 3), (1, 2, 2, 3, 3, 4), (900, 1, 901, 2, 902, 3)])
def test_two_monitors_that_publish_in_turn_are_unknown(numbers: tuple[int, ...]) -> None:
    status = CellStatus(0)
    for index, number in enumerate(numbers):
        status.take_decision(decision(number), S + index * MS)
    assert (status.verdict, status.reason) == (Verdict.UNKNOWN, "two monitors publish contact_states: must be one")
    assert status.lost == 0


def test_a_successor_of_a_silent_monitor_counts_at_once() -> None:
    status = ok_cell()
    status.take_decision(decision(1, contact(point="flange")), 9 * S)
    assert (status.verdict, [one.contact_point for one in status.contacts]) == (Verdict.OK, ["flange"])


def test_decisions_without_numbers_are_no_second_monitor() -> None:
    status = CellStatus(0)
    for index in range(6):
        status.take_decision(decision(0), S + index * MS)
    assert (status.verdict, status.lost) == (Verdict.OK, 0)


def test_messages_that_did_not_arrive_are_counted() -> None:
    status = ok_cell()
    for number in (2, 5, 6, 8):
        status.take_decision(decision(number), S + number * MS)
    assert status.lost == 3


@given(st.lists(st.tuples(st.sampled_from(Verdict), st.sampled_from(Verdict)), min_size=1))
def test_the_worst_contact_of_the_latest_decision_decides(verdicts: list[tuple[Verdict, Verdict]]) -> None:
    status = CellStatus(0)
    for index, (tool, elbow) in enumerate(verdicts):
        contacts = contact(tool, reason="tool"), contact(elbow, "elbow", limit=0.4, reason="elbow")
        status.take_decision(decision(index + 1, *contacts), S + index * MS)
        assert severity(status.verdict) == max(severity(tool), severity(elbow))
        point = "tool" if severity(tool) > severity(elbow) else "elbow"  # whose margin is smaller
        assert (status.contact_point, status.reason) == (point, point)
        assert (status.allowable_speed == 0.0) == (status.verdict is Verdict.UNKNOWN)


def test_points_of_a_monitor_that_ended_are_forgotten() -> None:
    status = ok_cell()
    status.take_publisher(400 * MS, exists=False)
    status.update(S)
    status.take_publisher(400 * MS, exists=True)
    status.update(2 * S)
    assert (status.verdict, status.reason) == (Verdict.UNKNOWN, "no contact states yet")
    status.take_decision(decision(1, contact(point="flange")), 9 * S)
    assert (status.verdict, [one.contact_point for one in status.contacts]) == (Verdict.OK, ["flange"])


def test_episodes_have_cause_start_and_end() -> None:
    status = ok_cell(S)
    status.take_decision(decision(2, contact(Verdict.WARN, reason="close")), S + 10)
    status.take_decision(decision(3, contact(Verdict.WARN, reason="closer")), S + 20)
    status.take_decision(decision(4, contact()), S + 30)
    status.take_decision(decision(5, contact(Verdict.VIOLATION, reason="too fast")), S + 40)
    episodes = [(e.verdict, e.contact_point, e.cause, e.start_ns, e.end_ns) for e in status.episodes]
    assert episodes == [
        (Verdict.UNKNOWN, "", "no contact states yet", 0, S),
        (Verdict.WARN, "tool", "close", S + 10, S + 30),
        (Verdict.VIOLATION, "tool", "too fast", S + 40, None),
    ]


def test_episodes_of_messages_that_waited_during_a_silence_follow_it() -> None:
    status = ok_cell(S)
    status.update(3 * S)
    for number, verdict in enumerate((Verdict.WARN, Verdict.OK, Verdict.VIOLATION)):
        status.take_decision(decision(2 + number, contact(verdict)), 2 * S + number)
    ends = [(episode.start_ns, episode.end_ns) for episode in status.episodes]
    assert ends == [(0, S), (3 * S, 3 * S), (3 * S, 3 * S), (3 * S, None)]


def test_an_episode_stays_simulated_when_the_simulation_has_ended() -> None:
    status = ok_cell()
    status.run_info = RunInfo(simulated=True)
    status.update(3 * S)  # silent
    status.run_info = None
    status.update(4 * S)
    assert status.simulated == []
    assert status.episodes[-1].simulated == ["robot"]


@given(st.lists(st.tuples(st.integers(0, 30 * MS), st.floats(0, 2), st.floats(0, 2)), min_size=1, max_size=60))
def test_each_interval_of_the_history_keeps_its_worst_sample(steps: list[tuple[int, float, float]]) -> None:
    status, at_ns, margins = CellStatus(0), 0, dict[int, float]()
    for number, (step_ns, speed, limit) in enumerate(steps):
        at_ns += step_ns
        status.take_decision(decision(number + 1, contact(speed=speed, limit=limit)), at_ns)
        margins[at_ns // BIN_NS] = min(margins.get(at_ns // BIN_NS, 9.0), limit - speed)
    kept = {sample.at_ns // BIN_NS: sample.allowable_speed - sample.speed for sample in status.speeds}
    assert kept == margins


def test_an_hour_at_1_khz_keeps_a_minute_and_few_episodes() -> None:
    status = ok_cell()
    for number in range(5000):
        verdict = Verdict.WARN if number % 2 else Verdict.OK
        status.take_decision(decision(number + 2, contact(verdict)), S + number * BIN_NS)
    assert status.speeds[-1].at_ns - status.speeds[0].at_ns == HISTORY_NS
    assert len(status.speeds) == HISTORY_NS // BIN_NS + 1
    assert len(status.episodes) == 1000


def test_an_impact_gets_rebounds_force_and_validation() -> None:
    status = ok_cell()
    assert status.simulated == []
    status.take_impact(impact(), S)
    status.take_impact(impact(10 * S + 50 * MS, rebound=1), S)
    force = np.zeros(12_800)
    force[6400 + 33] = 100.0  # the onset is in the middle of the second block
    for number, start_ns in enumerate((8_500 * MS, 9_500 * MS)):
        block = ForceBlock(start_ns, "", 0, 12_800.0, force * number, simulated=True)
        status.update(S)
        assert not len(status.impacts[0].force)
        status.take_force(block)
    status.update(S)
    status.take_validation(validation(10 * S, 1))
    (record,) = status.impacts
    assert (record.rebounds, record.force.max()) == (1, 100.0)
    assert record.time_s[record.force.argmax()] == pytest.approx(33 / 12_800)
    assert -0.002 <= record.time_s[0] < 0.0
    assert 0.025 < record.time_s[-1] <= 0.026
    assert len(record.force) <= 400
    assert record.validation == status.validations[0]
    assert status.simulated == ["force"]


@pytest.mark.parametrize(("rate", "step"), [(12_800.0, 1), (25_600.0, 2)])
def test_force_around_an_impact_keeps_as_many_samples_as_it_may(rate: float, step: int) -> None:
    status = ok_cell()
    status.take_impact(impact(), S)
    status.take_force(ForceBlock(9_900 * MS, "", 0, rate, np.ones(25_600), simulated=True))
    status.update(S)
    (record,) = status.impacts
    assert np.diff(record.time_s) == pytest.approx(step / rate, abs=1e-9)


@pytest.mark.parametrize(("wait_ns", "is_shown"), [(2 * S - 1, True), (2 * S, False)])
def test_the_force_of_an_impact_is_awaited_for_2_s(wait_ns: int, is_shown: bool) -> None:  # noqa: FBT001
    status = ok_cell()
    status.take_impact(impact(), S)
    status.update(S)
    status.take_force(ForceBlock(9_900 * MS, "", 0, 12_800.0, np.ones(12_800), simulated=True))
    status.update(S + wait_ns)
    assert bool(len(status.impacts[0].force)) == is_shown


def test_a_new_series_of_validations_replaces_the_old_one() -> None:
    status = CellStatus(0)
    for count in (1, 2, 3, 1):
        status.take_validation(validation(S, count))
    assert [validation.series.count for validation in status.validations] == [1]
