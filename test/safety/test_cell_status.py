# SPDX-License-Identifier: Apache-2.0
"""CellStatus: what a display may show; silence, missing and contradicting monitors are UNKNOWN."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.cell.status import BIN_NS, HISTORY_NS, CellStatus, Validation
from scara_effmass.safety import unknown_contact
from scara_effmass.values import ContactAssessment, ForceBlock, Impact, RunInfo, Verdict

MS = 1_000_000
S = 1000 * MS


def contact(
    verdict: Verdict = Verdict.OK, point: str = "tool", speed: float = 0.2, limit: float = 0.5, reason: str = ""
) -> ContactAssessment:
    return unknown_contact(point, reason, S, 0.0)._replace(verdict=verdict, speed=speed, allowable_speed=limit)


def ok_cell(at_ns: int = S) -> CellStatus:
    status = CellStatus(0)
    status.take_publisher(400 * MS, exists=True)
    status.take_contact(contact(), at_ns)
    for name in ("allowable_speed", "speed_scaling"):
        status.take_scalar(name, 0.5, at_ns)
    status.update(at_ns)
    assert (status.verdict, status.allowable_speed, status.speed_scaling) == (Verdict.OK, 0.5, 0.5)
    return status


def impact(stamp_ns: int = 10 * S, rebound: int = 0) -> Impact:
    flags = {"clipped": False, "incomplete": False, "simulated": True}
    numbers = dict.fromkeys(("impulse", "onset_sample", "baseline", "noise", "clock_residual"), 0.0)
    return Impact(stamp_ns, "", 100.0, 0.02, rebound=rebound, source="sim", **numbers, **flags)  # type: ignore[arg-type]


def validation(stamp_ns: int, count: int) -> Validation:
    values: dict[str, Any] = dict.fromkeys(Validation.__slots__, 0.0)
    return Validation(**values | {"stamp_ns": stamp_ns, "count": count})


def test_a_cell_without_any_state_is_unknown() -> None:
    status = CellStatus(0)
    status.update(S)
    assert (status.verdict, status.reason) == (Verdict.UNKNOWN, "no contact state yet")


@pytest.mark.parametrize(
    ("exists", "now_ns", "reason"),
    [
        (True, S + 401 * MS, "the monitor is silent: no contact state for 0.4 s"),
        (False, S, "no monitor: contact_state has no publisher"),
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
    status.take_other_monitor(S + 300 * MS)
    status.take_contact(contact(), S + 300 * MS)
    assert (status.verdict, status.reason) == (Verdict.UNKNOWN, "two monitors publish contact_state: must be one")
    status.take_contact(contact(), S + 701 * MS)
    assert status.verdict is Verdict.OK


def test_one_silent_contact_point_is_enough() -> None:
    status = ok_cell()
    status.take_contact(contact(point="elbow"), S)
    for at_ns in range(S, 2 * S, 10 * MS):
        status.take_speed("elbow", 0.1, 0.5, at_ns)
    status.update(2 * S)
    assert (status.verdict, status.contact_point) == (Verdict.UNKNOWN, "tool")


@pytest.mark.parametrize("number", [float("nan"), float("inf")])
def test_a_speed_that_is_no_number_is_unknown(number: float) -> None:
    status = ok_cell()
    status.take_contact(contact(speed=number), S)
    assert status.verdict is Verdict.UNKNOWN
    status.take_scalar("speed_scaling", number, S)
    status.take_contact(contact(), S)
    assert (status.verdict, status.speed_scaling) == (Verdict.OK, 0.0)


def test_the_worst_contact_point_decides() -> None:
    status = ok_cell()
    status.take_contact(contact(Verdict.WARN, "elbow", reason="close"), S)
    assert (status.verdict, status.contact_point, status.reason) == (Verdict.WARN, "elbow", "close")
    status.take_contact(contact(Verdict.VIOLATION, reason="too fast"), S)
    assert (status.verdict, status.contact_point, status.reason) == (Verdict.VIOLATION, "tool", "too fast")


@pytest.mark.parametrize("names", [("", "tool"), ("tool", "")])
def test_points_of_a_monitor_without_a_robot_replace_and_are_replaced(names: tuple[str, str]) -> None:
    status = CellStatus(0)
    for name in names:
        status.take_contact(contact(point=name), S)
    assert list(status.contacts) == [names[1]]


def test_points_of_an_earlier_monitor_are_forgotten() -> None:
    status = ok_cell()
    status.take_other_monitor(9 * S)
    status.take_contact(contact(point="flange"), 9 * S)
    assert (status.verdict, list(status.contacts)) == (Verdict.OK, ["flange"])


def test_points_of_a_monitor_that_ended_are_forgotten() -> None:
    status = ok_cell()
    status.take_publisher(400 * MS, exists=False)
    status.update(S)
    status.take_publisher(400 * MS, exists=True)
    status.update(2 * S)
    assert (status.verdict, status.reason) == (Verdict.UNKNOWN, "no contact state yet")
    status.take_contact(contact(point="flange"), 9 * S)
    assert (status.verdict, list(status.contacts)) == (Verdict.OK, ["flange"])


@given(st.permutations(["tool", "elbow", "rim"]), st.sampled_from(["tool", "elbow", "rim"]))
def test_a_contact_point_that_disappears_stays_unknown_and_is_named(order: list[str], gone: str) -> None:
    status = CellStatus(0)
    status.take_publisher(400 * MS, exists=True)
    for step in range(100):
        for place, name in enumerate(order):
            if step < 10 or name != gone:
                status.take_contact(contact(point=name), S + 10 * MS * step + place)
        is_silent = step > 50
        assert status.verdict is (Verdict.UNKNOWN if is_silent else Verdict.OK) or 48 <= step <= 50
    assert (status.contact_point, status.reason[:21]) == (gone, "the monitor is silent")


def test_episodes_have_cause_start_and_end() -> None:
    status = ok_cell(S)
    status.take_contact(contact(Verdict.WARN, reason="close"), S + 10)
    status.take_contact(contact(Verdict.WARN, reason="closer"), S + 20)
    status.take_contact(contact(), S + 30)
    status.take_contact(contact(Verdict.VIOLATION, reason="too fast"), S + 40)
    episodes = [(e.verdict, e.contact_point, e.cause, e.start_ns, e.end_ns) for e in status.episodes]
    assert episodes == [
        (Verdict.UNKNOWN, "", "no contact state yet", 0, S),
        (Verdict.WARN, "tool", "close", S + 10, S + 30),
        (Verdict.VIOLATION, "tool", "too fast", S + 40, None),
    ]


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
    for step_ns, speed, limit in steps:
        at_ns += step_ns
        status.take_speed("tool", speed, limit, at_ns)
        margins[at_ns // BIN_NS] = min(margins.get(at_ns // BIN_NS, 9.0), limit - speed)
    kept = {sample.at_ns // BIN_NS: sample.allowable_speed - sample.speed for sample in status.speeds}
    assert kept == margins


def test_an_hour_at_1_khz_keeps_a_minute_and_few_episodes() -> None:
    status = ok_cell()
    for number in range(5000):
        status.take_contact(contact(Verdict.WARN if number % 2 else Verdict.OK), S + number * BIN_NS)
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
    assert [validation.count for validation in status.validations] == [1]
