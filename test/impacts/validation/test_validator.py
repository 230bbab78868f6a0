# SPDX-License-Identifier: Apache-2.0
"""Validator: from contact states and impacts to the result of a series."""

from __future__ import annotations

import math
from contextlib import nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scara_effmass.errors import SettingsError
from scara_effmass.impacts.impact_matcher import APART
from scara_effmass.impacts.validator import Validator
from scara_effmass.settings import MassModel, ValidatorSettings
from scara_effmass.values import NAN, Decision, ForceBlock, RunInfo

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from scara_effmass.impacts.validator import Result
    from scara_effmass.values import ValidatedImpact, Vector3
    from test.impacts.validation.conftest import Cell, MakeCell, MakeImpact, MakeState

START = 1_700_000_000_000_000_000
MS = 1_000_000
LUMPED = (0.981, 1.247, 2.891)
OBSTACLES = (0.50, 2.39, 3.72, 7.35)
STIFFNESS = 2e5
ISO = 2.77


def with_full_mass(decision: Decision, mass: float) -> Decision:
    return decision._replace(contacts=tuple(contact._replace(full_mass=mass) for contact in decision.contacts))


def run(
    cell: Cell, settings: ValidatorSettings, order: Callable[[int], int] | None = None
) -> tuple[list[ValidatedImpact], Result]:
    """Feed `cell` by time of arrival, unless `order` states the stream (0: states) of each item."""
    validator = Validator(settings)
    for since_ns, obstacle_mass, configuration in cell.runs:
        validator.runs.set(since_ns, obstacle_mass=obstacle_mass, configuration=configuration)
    states, impacts = list(cell.states), list(cell.impacts)
    validated: list[ValidatedImpact] = []
    turn = 0
    while states or impacts:
        if not states or not impacts:
            first = not states
        elif order:
            first = bool(order(turn))
        else:
            first = impacts[0][1] < states[0][1]
        turn += 1
        validated += validator.add_impact(*impacts.pop(0)) if first else validator.add_decision(*states.pop(0))
    validated += validator.finish()
    return validated, validator.result()


def balanced(result: Result) -> bool:
    counted = len(result.impacts) + sum(result.excluded.values()) + sum(result.unpaired.values()) + result.waiting
    refused = sum(result.excluded.values()) + sum(result.unpaired.values())
    return result.seen == counted and len(result.refused) == refused


@pytest.fixture(scope="module")
def campaign(make_cell: MakeCell) -> Cell:
    """The paper's twelve cases without noise."""
    return make_cell()


def test_campaign_returns_its_input_parameters(campaign: Cell) -> None:
    validated, result = run(campaign, ValidatorSettings(history=60.0))
    assert balanced(result)
    assert (result.seen, result.waiting, result.simulated, len(validated)) == (12, 0, 12, 12)
    assert (result.accepted, result.reason, result.clock, result.force_sign) == (True, "", "", "")
    lumped, full, iso = result.models
    assert [m.model for m in result.models] == ["lumped", "full", "iso"]
    assert lumped.overall.fitted_stiffness == pytest.approx(STIFFNESS, rel=1e-9)
    assert lumped.overall.correlation == pytest.approx(1.0)
    assert lumped.fit.mass_scale == pytest.approx(1.0, abs=1e-6)
    assert lumped.fit.gain == pytest.approx(1.0, abs=1e-6)
    assert lumped.fit.exponent == pytest.approx(0.5, abs=1e-9)
    assert full.fit.mass_scale == pytest.approx(1 / 1.02, abs=1e-6)  # 2 % heavier than the truth
    assert 0.999 < full.overall.correlation < 1.0  # 2 % heavier
    assert iso.overall.correlation < 0.95
    assert [(model.accepted, model.decidable) for model in result.models] == [(True, True), (True, True), (False, True)]
    assert result.clock_offset.impacts == 12
    assert result.clock_offset.offset == pytest.approx(0.0, abs=result.clock_offset.resolution)
    assert list(result.comparison.relative_rmse) == ["lumped", "full", "iso"]
    assert result.comparison.text.startswith("lumped explains the forces best")
    for impact, (m_h, m_n) in zip(validated, [(m_h, m) for m_h in OBSTACLES for m in LUMPED], strict=True):
        assert impact.speed == pytest.approx(0.25, rel=1e-9)  # neither the latest, 0.1, nor between the two
        assert impact.effective_mass == pytest.approx(m_n)
        assert impact.reduced_mass == pytest.approx(m_n * m_h / (m_n + m_h))
        assert impact.direction == pytest.approx((0.0, -1.0, 0.0))
        assert (impact.obstacle_mass, impact.configuration) == (m_h, f"m_n {m_n} kg")
        assert impact.from_trend
        assert [p.model for p in impact.predictions] == ["lumped", "full", "iso"]


def test_statistics_of_each_impact(campaign: Cell) -> None:
    """It can be recomputed from the message's fields; the stiffness is too small."""
    validated, result = run(campaign, ValidatorSettings(history=60.0, stiffness_n_m=180e3))
    n = 0
    for n, impact in enumerate(validated, 1):
        assert impact.stiffness == 180_000.0
        assert impact.predicted_force == pytest.approx(0.25 * math.sqrt(impact.reduced_mass * 180_000.0))
        assert impact.relative_error == pytest.approx(math.sqrt(0.9) - 1.0)
        assert not impact.conservative
        assert (impact.series.count, impact.series.non_conservative) == (n, n)
        so_far = np.array([(i.predicted_force - i.measured_force) for i in validated[:n]])
        assert impact.series.bias == pytest.approx(so_far.mean())
        assert impact.series.rmse == pytest.approx(np.sqrt(np.mean(so_far**2)))
        assert impact.series.fitted_stiffness == (pytest.approx(STIFFNESS) if n > 1 else 0.0)
        assert impact.series.accepted == (n >= 6)  # two carts in three poses
        assert impact.series.decidable == (n >= 6)
        assert impact.measured_reduced_mass == pytest.approx(impact.reduced_mass)
        assert impact.measured_effective_mass == pytest.approx(impact.effective_mass)
        assert impact.measured_stiffness == pytest.approx(STIFFNESS)
        iso = impact.predictions[2]
        assert iso.effective_mass == ISO
        assert iso.predicted_force == pytest.approx(0.25 * math.sqrt(180e3 / (1 / ISO + 1 / impact.obstacle_mass)))
    assert n == 12
    assert result.models[0].overall.largest_shortfall == pytest.approx(1.0 - math.sqrt(0.9))


def test_groups_by_configuration_and_by_obstacle(campaign: Cell) -> None:
    _, result = run(campaign, ValidatorSettings(history=60.0))
    iso = result.models[2]
    assert list(iso.by_obstacle_mass) == sorted(OBSTACLES)
    assert sorted(iso.by_configuration) == [f"m_n {m} kg" for m in LUMPED]
    assert sum(group.count for group in iso.by_configuration.values()) == 12
    lightest, heaviest = iso.by_configuration["m_n 0.981 kg"], iso.by_configuration["m_n 2.891 kg"]
    assert (
        lightest.bias > 0.0 > heaviest.bias
    )  # one mass for all poses: too much for the light, too little for the heavy
    assert {group.stiffness for group in iso.by_obstacle_mass.values()} == {iso.overall.stiffness}


@given(st.integers(0, 2**32), st.data())
@settings(max_examples=30)
def test_the_order_of_arrival_does_not_matter(make_cell: MakeCell, seed: int, data: st.DataObject) -> None:
    """Each published impact and the result are equal to the last bit, also with invalid impacts and clock jumps.

    After a jump, an impact is published with the problem of the clocks as far as it has shown by then.
    """
    cell = make_cell(step_ms=40)
    unequal: dict[str, Any] = {}
    for i in data.draw(st.lists(st.integers(0, 11), max_size=3)):
        impact, received_ns = cell.impacts[i]
        leap = {"stamp_ns": impact.stamp_ns + data.draw(st.sampled_from([-3000, 3000])) * MS}
        spoil: dict[str, Any] = data.draw(st.sampled_from([{"clipped": True}, {"rebound": 1}, leap]))
        unequal = {"decidable": False, "reason": ""} if spoil is leap else unequal
        cell.impacts[i] = (impact._replace(**spoil), received_ns)
    cell.states.pop(data.draw(st.integers(0, 299)))
    settings = ValidatorSettings(history=60.0)
    by_time, result = run(cell, settings)
    assert balanced(result)

    def comparable(impact: ValidatedImpact) -> ValidatedImpact:
        return replace(impact, series=replace(impact.series, **unequal))

    expected = [comparable(impact) for impact in by_time]
    turns = np.random.default_rng(seed).integers(0, 2, 400)
    for order in (lambda i: turns[i % 400], lambda _: 0, lambda _: 1):
        validated, same_result = run(cell, settings, order)
        assert ([comparable(impact) for impact in validated], same_result) == (expected, result)


@given(st.lists(st.tuples(st.integers(0, 12_000), st.floats(-10.0, 500.0), st.integers(0, 5)), max_size=25))
@settings(max_examples=50)
def test_no_impact_is_lost(make_cell: MakeCell, make_impact: MakeImpact, drawn: list[tuple[int, float, int]]) -> None:
    cell = make_cell(step_ms=40)
    cell.impacts.clear()
    for ms, peak, kind in sorted(drawn):
        impact = make_impact(START + ms * MS, peak, clipped=kind == 1, incomplete=kind == 2, rebound=int(kind == 3))
        cell.impacts.append((impact, impact.stamp_ns + 100 * MS))
    validated, result = run(cell, ValidatorSettings())
    assert balanced(result)
    assert result.seen == len(drawn)
    assert len(validated) == len(result.impacts)
    assert result.waiting == 0


def test_impact_waits_for_the_states_of_50_ms_after_it(make_state: MakeState, make_impact: MakeImpact) -> None:
    validator = Validator(ValidatorSettings(obstacle_mass=2.0))
    for ms in (0, 10, 20):
        assert not validator.add_decision(make_state(START + ms * MS), START + ms * MS)
    assert not validator.add_impact(make_impact(START + 25 * MS), START + 25 * MS)
    assert validator.result().waiting == 1
    assert balanced(validator.result())
    for ms in (30, 74):
        assert not validator.add_decision(make_state(START + ms * MS, 0.1), START + ms * MS)
    (validated,) = validator.add_decision(make_state(START + 75 * MS, 0.1), START + 75 * MS)
    assert validated.stamp_ns == START + 25 * MS
    assert validated.speed == pytest.approx(0.25)
    assert validator.result().waiting == 0


@pytest.mark.parametrize("is_silent", [False, True])
def test_without_an_end_an_impact_waits_no_longer_than_the_clock_tolerance(
    make_state: MakeState, make_impact: MakeImpact, *, is_silent: bool
) -> None:
    """When joint states stop, the monitor repeats its last stamp; when the monitor ends, time passes alone."""
    validator = Validator(ValidatorSettings(obstacle_mass=2.0))

    def go_on(at_ns: int) -> None:
        validator.pass_time(at_ns) if is_silent else validator.add_decision(make_state(START), at_ns)

    validator.add_decision(make_state(START), START)
    validator.add_impact(make_impact(START + 25 * MS), START + 100 * MS)
    go_on(START + 600 * MS)
    assert validator.result().waiting == 1
    go_on(START + 601 * MS)
    assert validator.result().unpaired == {"no contact state within 50 ms after the onset": 1}


def test_impact_that_is_sent_twice_is_one_measurement(campaign: Cell) -> None:
    settings = ValidatorSettings(history=60.0)
    impacts = [(impact._replace(held_force=50.0), at_ns) for impact, at_ns in campaign.impacts]
    once, result = run(campaign._replace(impacts=impacts), settings)
    twice, same_result = run(campaign._replace(impacts=[item for item in impacts for _ in range(2)]), settings)
    assert twice == once
    assert same_result.excluded == {"duplicate: an impact of this source with this stamp came before": 12}
    assert same_result.held == result.held
    assert (same_result.accepted, balanced(same_result)) == (True, True)
    others = [item for impact, at_ns in impacts for item in ((impact, at_ns), (impact._replace(source="b"), at_ns))]
    assert len(run(campaign._replace(impacts=others), settings)[0]) == 24


def test_same_stamp_in_a_new_recording_is_no_duplicate(campaign: Cell) -> None:
    validator = Validator(ValidatorSettings(obstacle_mass=2.0, history=60.0))
    for _ in range(2):
        for state in campaign.states[:200]:
            validator.add_decision(*state)
        validator.add_impact(*campaign.impacts[0])
        validator.begin_recording()
    assert len(validator.result().impacts) == 2


def test_spoilt_impacts_are_counted_each_under_its_reason(campaign: Cell) -> None:
    spoilt: list[dict[str, Any]] = [
        {"clipped": True},
        {"incomplete": True},
        {"rebound": 2},
        {"peak_force": 1e-200},
        {"peak_force": NAN},
    ]
    impacts = [
        (i._replace(**(spoilt[n] if n < len(spoilt) else {})), received)
        for n, (i, received) in enumerate(campaign.impacts)
    ]
    validated, result = run(campaign._replace(impacts=impacts), ValidatorSettings(history=60.0))
    assert result.excluded == {
        "clipped: the force reached the end of the measuring range": 1,
        "incomplete: samples are lost or doubtful, or the recording ends during it": 1,
        "rebound of an earlier impact, but larger": 1,
        "no positive peak force": 2,
    }
    assert (len(validated), result.unpaired, result.accepted) == (7, {}, True)
    assert balanced(result)
    assert result.refused[0].excluded


def test_infinite_peak_is_excluded(campaign: Cell) -> None:
    (impact, received), *others = campaign.impacts
    impacts = [(impact._replace(peak_force=math.inf), received), *others]
    _, result = run(campaign._replace(impacts=impacts), ValidatorSettings(history=60.0))
    assert result.excluded == {"no positive peak force": 1}


def test_no_impacts(campaign: Cell) -> None:
    _, result = run(campaign._replace(impacts=[]), ValidatorSettings())
    assert not result.accepted
    assert result.reason == "no impacts, at least 6 are required"
    assert result.seen == 0
    assert "nothing to compare" in result.comparison.text
    _, result = run(campaign._replace(impacts=[], states=[]), ValidatorSettings())
    assert (result.contact_point, result.accepted) == ("", False)


def test_one_impact(campaign: Cell) -> None:
    (only,), result = run(campaign._replace(impacts=campaign.impacts[:1]), ValidatorSettings(history=60.0))
    assert (only.series.count, only.series.correlation, only.series.fitted_stiffness, only.series.accepted) == (
        1,
        0.0,
        0.0,
        False,
    )
    assert only.stiffness == pytest.approx(STIFFNESS)
    assert only.conservative
    assert result.reason == "1 impact, at least 6 are required"


@pytest.mark.parametrize(("excess", "conservative"), [(0.0, True), (0.5e-12, True), (1.5e-12, False)])
def test_a_prediction_low_by_rounding_is_conservative(campaign: Cell, excess: float, *, conservative: bool) -> None:
    impact, arrival_ns = campaign.impacts[0]
    settings = ValidatorSettings(history=60.0, stiffness_n_m=STIFFNESS)
    (as_predicted,), _ = run(campaign._replace(impacts=[(impact, arrival_ns)]), settings)
    impact = impact._replace(peak_force=as_predicted.predicted_force * (1.0 + excess))
    (only,), _ = run(campaign._replace(impacts=[(impact, arrival_ns)]), settings)
    assert only.conservative == conservative


def test_no_obstacle_mass(campaign: Cell) -> None:
    validated, result = run(campaign._replace(runs=[]), ValidatorSettings(history=60.0))
    assert not validated
    assert result.unpaired == {"obstacle_mass is not given": 12}
    assert result.refused[0].detail == "set it to the mass of the obstacle [kg]"


def test_no_contact_states(campaign: Cell) -> None:
    validated, result = run(campaign._replace(states=[]), ValidatorSettings())
    assert not validated
    assert result.unpaired == {"no contact state": 12}
    assert balanced(result)


@pytest.mark.parametrize("ahead_s", [-3.2, 3.2, -3600.0, 3600.0, -1.7e9])
def test_clocks_apart(make_cell: MakeCell, ahead_s: float) -> None:
    """The state with the stamp of the onset belongs to another time; only the arrival times show it."""
    cell = make_cell(force_clock_ns=round(ahead_s * 1e9))
    validated, result = run(cell, ValidatorSettings(history=60.0))
    assert not validated
    assert result.unpaired == {f"force and contact states are seconds apart: {APART}": 12}
    assert result.clock.startswith("force and contact states are ")
    assert float(result.clock.split()[5]) == pytest.approx(abs(ahead_s), abs=0.2)
    assert result.reason == result.clock
    assert not any(model.accepted for model in result.models)


def test_a_refused_impact_states_the_offset_that_its_velocity_shows(make_cell: MakeCell) -> None:
    """20 ms later, the robot is as slow as the settings call standing still."""
    settings = ValidatorSettings(history=60.0, speed_threshold=0.15)
    _, result = run(make_cell(force_clock_ns=20 * MS, step_ms=1), settings)
    assert result.unpaired == {"the robot stands still at the onset": 12}
    assert {impact.detail for impact in result.refused} == {
        "0.1000 m/s; the joint states are -20.5 ms behind the force"
    }


def test_force_blocks_detect_smaller_clock_offsets(campaign: Cell) -> None:
    """They show offsets from 0.5 s on; the late arrival of an impact alone could be a late report."""
    validator = Validator(ValidatorSettings(history=60.0))
    for state in campaign.states:
        validator.add_decision(*state)
    for i in range(10):
        validator.add_force(block([0.0] * 128, START + i * 100 * MS), START + (i * 100 + 15) * MS)
    assert validator.result().clock == ""
    for i in range(11):
        validator.add_force(block([0.0] * 128, START + i * 100 * MS), START + (i * 100 + 10 + 802) * MS)
    assert validator.result().clock == f"force and contact states are 0.80 s apart: {APART}"
    for i in range(30):
        validator.add_force(block([0.0] * 128, START + i * 100 * MS), START + (i * 100 + 10 - 798) * MS)
    assert validator.result().clock == f"force and contact states are 0.80 s apart: {APART}"


@pytest.mark.parametrize("days", [-1, 1])
def test_clocks_that_share_no_time_without_arrivals(campaign: Cell, days: int) -> None:
    """Recordings of two days have no arrival times; their stamps do not overlap."""
    day = days * 86_400_000 * MS
    cell = campaign._replace(
        states=[(state, 0) for state, _ in campaign.states],
        impacts=[(impact._replace(stamp_ns=impact.stamp_ns + day), 0) for impact, _ in campaign.impacts],
    )
    validated, result = run(cell, ValidatorSettings(history=60.0))
    assert not validated
    assert result.clock.startswith("impacts and contact states are at least 8638")
    assert result.unpaired == {"no contact state within 50 ms before the onset": 12}


def test_impacts_without_arrival_times_are_matched_by_stamp(campaign: Cell) -> None:
    cell = campaign._replace(
        states=[(state, 0) for state, _ in campaign.states], impacts=[(impact, 0) for impact, _ in campaign.impacts]
    )
    settings = ValidatorSettings(history=60.0)
    assert run(cell, settings) == run(campaign, settings)


@pytest.mark.parametrize(
    ("delay_ns", "apart"), [(-500 * MS, 0), (-500 * MS - 1, 1), (1500 * MS, 0), (1500 * MS + 1, 1)]
)
def test_impact_arrives_between_the_clock_tolerance_before_and_the_delay_after_its_onset(
    make_state: MakeState, make_impact: MakeImpact, delay_ns: int, apart: int
) -> None:
    """The contact states arrive at the times of their stamps."""
    validator = Validator(ValidatorSettings(obstacle_mass=2.0))
    for ms in range(-1000, 20, 10):
        validator.add_decision(make_state(START + ms * MS), START + ms * MS)
    validator.add_impact(make_impact(START - 500 * MS), START - 500 * MS + delay_ns)
    validator.finish()
    result = validator.result()
    assert result.unpaired == ({f"force and contact states are seconds apart: {APART}": 1} if apart else {})
    assert bool(result.clock) == bool(apart)


def test_impact_without_arrival_time_waits_for_the_states_around_its_onset(
    make_state: MakeState, make_impact: MakeImpact
) -> None:
    validator = Validator(ValidatorSettings(obstacle_mass=2.0))
    validator.add_decision(make_state(START - 5 * MS), START)
    assert not validator.add_impact(make_impact(START), 0)
    assert not validator.add_decision(make_state(START + 49 * MS), START + 50 * MS)
    assert validator.result().waiting == 1
    assert len(validator.add_decision(make_state(START + 50 * MS), START + 51 * MS)) == 1


@pytest.mark.parametrize(("excluded", "accepted"), [(True, True), (False, False)])
def test_excluded_impacts_do_not_lower_the_share_of_paired_ones(
    campaign: Cell, make_impact: MakeImpact, *, excluded: bool, accepted: bool
) -> None:
    """There are 13 more impacts that are clipped, or at which the robot stood still."""
    extra = [(make_impact(START + (i + 1) * MS // 4, clipped=excluded), START + 180 * MS) for i in range(13)]
    validated, result = run(campaign._replace(impacts=[*extra, *campaign.impacts]), ValidatorSettings(history=60.0))
    assert (len(validated), result.seen) == (12, 25)
    assert result.accepted == validated[-1].series.accepted == accepted
    if not accepted:
        assert (
            result.reason
            == validated[-1].series.reason
            == ("12 impacts of 25 paired with the robot, at least 50% must be: the robot stands still at the onset")
        )


def block(force: Sequence[float], stamp_ns: int = START) -> ForceBlock:
    return ForceBlock(
        stamp_ns=stamp_ns,
        frame_id="force_sensor",
        first_sample=0,
        sample_rate=12_800.0,
        force=np.array(force),
        lost_samples=0,
        saturated_samples=np.array([], dtype=np.uint32),
        clock_residual=0.0,
        filter_delay=0.0,
        source="generated by the test",
        simulated=True,
        tare=0.0,
        tare_stamp_ns=0,
        relative_uncertainty=0.0,
    )


@pytest.mark.parametrize(
    ("force", "text"),
    [
        (
            [0.1, -312.0, 2.0, NAN],
            "force goes to -312 N and never above 2 N: compression is positive; set sensor.invert",
        ),
        ([0.0, 312.0, -60.0], ""),
        ([0.3, -0.4], ""),
        ([0.0, -9.9], ""),
        ([0.0, -11.0], "force goes to -11 N and never above 0 N: compression is positive; set sensor.invert"),
        ([100.0, -299.0], ""),
        ([100.0, -301.0], "force goes to -301 N and never above 100 N: compression is positive; set sensor.invert"),
        ([NAN], ""),
    ],
)
def test_inverted_force_is_reported(campaign: Cell, force: list[float], text: str) -> None:
    validator = Validator(ValidatorSettings())
    for state in campaign.states:
        validator.add_decision(*state)
    validator.add_force(block(np.repeat(force, 2).tolist()), 0)
    result = validator.result()
    assert result.force_sign == text
    assert result.reason == (text or "no impacts, at least 6 are required")


def test_one_sample_is_no_wrong_sign_and_hides_none() -> None:
    validator = Validator(ValidatorSettings())
    validator.add_force(block([0.1, -900.0, 0.1, 0.0]), 0)
    assert not validator.result().force_sign
    validator.add_force(block([0.1, -312.0, -312.0, 900.0, 0.1]), 0)
    assert validator.result().force_sign.startswith("force goes to -312 N and never above 0 N")


def test_joined_series_keeps_what_its_recordings_state(campaign: Cell) -> None:
    series, recording = Validator(ValidatorSettings()), Validator(ValidatorSettings())
    for state in (*campaign.states[:3], campaign.states[1]):
        recording.add_decision(*state)
    recording.add_force(block([0.0, -11.0, -11.0])._replace(relative_uncertainty=0.03), 0)
    recording.begin_recording()
    series.extend(recording)
    result = series.result()
    assert result.force_sign.startswith("force goes to -11 N")
    assert (result.late_states, result.gain_tolerance) == (1, 0.03)


def test_every_impact_states_a_problem_of_the_series(campaign: Cell) -> None:
    validator = Validator(ValidatorSettings(obstacle_mass=2.0))
    validator.add_force(block([-100.0, -100.0]), 0)
    for state in campaign.states:
        validator.add_decision(*state)
    impacts = [impact for each in campaign.impacts for impact in validator.add_impact(*each)]
    assert len(impacts) > 6
    assert {impact.series.reason[:22] for impact in impacts} == {"force goes to -100 N a"}


def test_other_contact_points_are_named(make_state: MakeState, make_impact: MakeImpact) -> None:
    validator = Validator(ValidatorSettings(obstacle_mass=2.0, contact_point="tool"))
    for ms in range(0, 70, 10):
        validator.add_decision(make_state(START + ms * MS, 0.9, contact_point="elbow"), 0)
        validator.add_decision(make_state(START + ms * MS, 0.25), 0)
    (validated,) = validator.add_impact(make_impact(START + 5 * MS), 0)
    assert (validated.contact_point, validated.speed) == ("tool", 0.25)
    assert validator.result().other_contact_points == ("elbow",)


def test_the_first_contact_point_is_selected_and_the_others_are_named(
    make_state: MakeState, make_impact: MakeImpact
) -> None:
    validator = Validator(ValidatorSettings(obstacle_mass=2.0))
    for ms in range(0, 200, 8):
        elbow = make_state(START + ms * MS, 0.9, contact_point="elbow").contacts
        tool = make_state(START + ms * MS, 0.25)
        validator.add_decision(tool._replace(contacts=tool.contacts + elbow), 0)
    (validated,) = validator.add_impact(make_impact(START + 100 * MS), 0)
    assert (validated.contact_point, validated.speed) == ("tool", 0.25)
    assert validator.result().other_contact_points == ("elbow",)


def test_the_first_contact_point_where_none_is_chosen(make_state: MakeState) -> None:
    validator = Validator(ValidatorSettings())
    for name in ("", "elbow", "tool"):  # the first one: there is no robot yet
        validator.add_decision(make_state(START, contact_point=name), 0)
    result = validator.result()
    assert (result.contact_point, result.other_contact_points) == ("elbow", ("tool",))


@pytest.mark.parametrize(
    ("model", "masses", "effective"),
    [
        (MassModel.FULL, (1.0, 2.0), 2.0),
        (MassModel.ISO, (1.0, 2.0), ISO),
        (MassModel.LARGEST, (1.0, 2.0), ISO),
        (MassModel.LARGEST, (1.0, 3.0), 3.0),
        (MassModel.LARGEST, (4.0, 3.0), 4.0),
        (MassModel.LARGEST, (3.0, NAN), 3.0),
        (MassModel.LARGEST, (NAN, 1.0), ISO),
        (MassModel.LUMPED, (1.0, NAN), 1.0),
        (MassModel.AUTO, (1.9, 2.0), 1.9),
        (MassModel.AUTO, (1.7, 2.0), 2.0),
        (MassModel.AUTO, (NAN, 2.0), 2.0),
        (MassModel.AUTO, (NAN, NAN), ISO),
    ],
)
def test_selected_model(
    make_state: MakeState,
    make_impact: MakeImpact,
    model: MassModel,
    masses: tuple[float, float],
    effective: float,
) -> None:
    validator = Validator(ValidatorSettings(obstacle_mass=2.0, effective_mass_model=model))
    for ms in range(0, 70, 10):
        validator.add_decision(make_state(START + ms * MS, 0.25, (1.0, 0.0, 0.0), *masses), 0)
    (validated,) = validator.add_impact(make_impact(START + 5 * MS), 0)
    assert validated.effective_mass == effective
    assert all(math.isfinite(p.effective_mass) for p in validated.predictions)
    assert validator.result().model == model.value


@pytest.mark.parametrize(
    ("model", "mass"),
    [(MassModel.FULL, NAN), *((MassModel.FULL, mass) for mass in (math.inf, 0.0, 0.9e-6))],
)
def test_selected_model_without_a_mass_is_rejected(
    make_state: MakeState, make_impact: MakeImpact, model: MassModel, mass: float
) -> None:
    validator = Validator(ValidatorSettings(obstacle_mass=2.0, effective_mass_model=model))
    for ms in range(0, 70, 10):
        validator.add_decision(with_full_mass(make_state(START + ms * MS, lumped=1.0), mass), 0)
    assert not validator.add_impact(make_impact(START + 5 * MS), 0)
    assert validator.result().unpaired == {f"no {model.value} mass": 1}


def test_obstacle_mass_at_the_onset_applies(make_state: MakeState, make_impact: MakeImpact) -> None:
    """The run changes between impacts, also while an impact waits."""
    validator = Validator(ValidatorSettings(obstacle_mass=1.0, configuration="near"))
    validated = []
    for ms in range(0, 200, 10):
        validated += validator.add_decision(make_state(START + ms * MS), 0)
        if ms in {20, 60}:
            validator.add_impact(make_impact(START + (ms + 5) * MS), 0)
            validator.runs.set(START + (ms + 6) * MS, obstacle_mass=2.0 + ms)
    assert [(i.obstacle_mass, i.configuration) for i in validated] == [(1.0, "near"), (22.0, "near")]
    assert validator.runs.latest.obstacle_mass == 62.0
    validator.runs.set(START, configuration="far")
    assert validator.runs.latest.obstacle_mass == 62.0
    validator.runs.set(START + 66 * MS, obstacle_mass=1.5)  # in place of the one that began then
    assert validator.runs.latest.obstacle_mass == 1.5


@pytest.mark.parametrize("mass", [-1.0, NAN, math.inf, 1001.0])
def test_invalid_obstacle_mass_is_refused(mass: float) -> None:
    validator = Validator(ValidatorSettings())
    with pytest.raises(SettingsError, match=r"^obstacle_mass = .*: must be 0 \(not stated\) to 1000 kg"):
        validator.runs.set(0, obstacle_mass=mass)
    assert validator.runs.latest.obstacle_mass == 0.0


@pytest.mark.parametrize(
    ("info", "problem"),
    [
        (RunInfo(obstacle_mass=1000.0, stamp_ns=2**63 - 1), ""),
        (RunInfo(obstacle_mass=1000.5), "obstacle_mass = 1000.5: must be 0"),
        (RunInfo(obstacle_mass=-0.1), "obstacle_mass = -0.1: must be 0"),
        (RunInfo(obstacle_mass=NAN), "obstacle_mass = nan: must be 0"),
        (RunInfo(stamp_ns=2**63), "stamp = 9223372036854775808 ns: must be ROS time"),
        (RunInfo(configuration="a\nb"), r"configuration = 'a\\nb': must be printable"),
    ],
)
def test_run_information_that_cannot_be_used_is_refused_and_makes_the_obstacle_unknown(
    info: RunInfo, problem: str
) -> None:
    validator = Validator(ValidatorSettings(obstacle_mass=2.0))
    with pytest.raises(SettingsError, match=problem) if problem else nullcontext():
        validator.runs.begin(info, START)
    assert validator.runs.at(START - 1).obstacle_mass == 2.0
    assert validator.runs.latest.obstacle_mass == (0.0 if problem else 1000.0)


def test_impact_before_its_run_information_leaves_the_series(make_state: MakeState, make_impact: MakeImpact) -> None:
    """Its obstacle is not that of the run before; impacts of earlier runs and recordings stay."""
    validator = Validator(ValidatorSettings(obstacle_mass=2.0))
    for offset in (0, 3600_000, 0):  # the last recording has older stamps than the one before
        validator.begin_recording()
        validator.begin_run(RunInfo(obstacle_mass=2.0, stamp_ns=START + offset * MS), 0)
        for ms in range(0, 400, 8):
            validator.add_decision(make_state(START + (offset + ms) * MS, 0.25), 0)
        for ms in (100, 300):
            assert validator.add_impact(make_impact(START + (offset + ms) * MS), 0)
    assert validator.begin_run(RunInfo(obstacle_mass=7.0, stamp_ns=START + 200 * MS), START + 350 * MS) == 1
    result = validator.result()
    assert len(result.impacts) == 5
    assert {(refused.stamp_ns, refused.reason) for refused in result.refused} == {
        (START + 300 * MS, "its RunInfo arrived after it")
    }
    assert result.unpaired == {"its RunInfo arrived after it": 1}
    validator.reset()
    assert validator.begin_run(RunInfo(obstacle_mass=7.0, stamp_ns=START), 0) == 0


def test_run_information_replaces_the_settings_that_it_states() -> None:
    runs = Validator(ValidatorSettings(obstacle_mass=2.0, configuration="near")).runs
    runs.begin(RunInfo(obstacle_mass=3.0), START)  # from its arrival on
    runs.begin(RunInfo(configuration="far", stamp_ns=START - 10), START + 5)  # from its stamp on
    stated = [runs.at(since_ns) for since_ns in (0, START - 11, START - 10, START - 1, START)]
    assert [(run.obstacle_mass, run.configuration) for run in stated] == [
        (2.0, "near"),
        (2.0, "near"),
        (2.0, "far"),
        (2.0, "far"),
        (3.0, "near"),
    ]
    runs.set(START + 1, obstacle_mass=4.0)
    runs.begin(RunInfo(configuration="far"), START + 2)
    assert runs.latest[:3] == (START + 2, 4.0, "far")
    runs.forget_obstacle(START + 3)
    assert runs.latest[:3] == (START + 3, 0.0, "far")
    runs.begin(RunInfo(obstacle_mass=5.0, stamp_ns=START + 1), START + 4)  # latched before, read again
    assert runs.latest[:3] == (START + 3, 5.0, "near")
    runs.restart()
    assert runs.at(0) == runs.latest
    assert runs.latest[:3] == (0, 5.0, "near")


def test_plate_normal_of_the_run_replaces_that_of_the_settings() -> None:
    runs = Validator(ValidatorSettings(obstacle_mass=2.0, plate_normal="0 0 -2")).runs
    assert (runs.latest.normal, runs.latest.guide) == ((0.0, 0.0, -1.0), None)
    runs.begin(RunInfo(plate_normal=(3.0, 4.0, 0.0), guide_direction=(2.0, 0.0, 0.0)), START)
    assert (runs.latest.normal, runs.latest.guide) == ((0.6, 0.8, 0.0), (1.0, 0.0, 0.0))
    runs.begin(RunInfo(), START + 1)
    assert (runs.latest.normal, runs.latest.guide) == ((0.0, 0.0, -1.0), None)
    runs.set(START + 2, normal=(0.0, 1.0, 0.0))
    assert runs.latest.normal == (0.0, 1.0, 0.0)
    runs.begin(RunInfo(plate_normal=(0.0, 0.0, 3.0)), START + 2)
    assert (runs.latest.normal, runs.latest.guide) == ((0.0, 0.0, 1.0), None)
    for wrong in (RunInfo(plate_normal=(NAN, 0.0, 0.0)), RunInfo(guide_direction=(math.inf, 0.0, 0.0))):
        with pytest.raises(SettingsError, match="must be finite"):
            runs.begin(wrong, START + 3)


@pytest.mark.parametrize(("normal", "share"), [((1.0, 0.0, 0.0), 1.0), ((-0.8, 0.6, 0.0), 0.8)])
def test_speed_and_masses_are_those_along_the_normal_of_the_plate(
    make_state: MakeState, make_impact: MakeImpact, normal: Vector3, share: float
) -> None:
    """The mobility is 1 / m along x, 0.5 / m along y; with the guide along x, an oblique cart acts as m_H / cos^2."""
    validator = Validator(ValidatorSettings(stiffness_n_m=200e3))
    validator.runs.begin(RunInfo(obstacle_mass=2.0, plate_normal=normal, guide_direction=(1.0, 0.0, 0.0)), 0)
    for ms in range(0, 70, 10):
        validator.add_decision(make_state(START + ms * MS, 0.25, lumped=1.5), 0)
    (impact,) = validator.add_impact(make_impact(START + 5 * MS, 50.0, compression_impulse=0.1), 0)
    mass = 1.5 / (share**2 + 0.5 * (1.0 - share**2))
    mu = 1.0 / (1.0 / mass + share**2 / 2.0)
    assert impact.speed == pytest.approx(0.25 * share)
    assert impact.effective_mass == pytest.approx(mass)
    assert impact.reduced_mass == pytest.approx(mu)
    assert impact.predicted_force == pytest.approx(0.25 * share * math.sqrt(mu * 2e5) * share)
    assert impact.measured_reduced_mass == pytest.approx(0.1 / share / (0.25 * share))
    assert (impact.measured_force, impact.force_share) == pytest.approx((50.0, share))


def test_guide_in_the_plate_is_rejected(make_state: MakeState, make_impact: MakeImpact) -> None:
    """The normal is from the settings, the guide from the run information."""
    validator = Validator(ValidatorSettings(plate_normal="1 0 0"))
    validator.begin_run(RunInfo(obstacle_mass=2.0, guide_direction=(0.0, 1.0, 0.0)), 0)
    for ms in range(0, 70, 10):
        validator.add_decision(make_state(START + ms * MS, 0.25, lumped=1.5), 0)
    assert not validator.add_impact(make_impact(START + 5 * MS, 50.0), 0)
    assert validator.result().unpaired == {"the guide lies in the plate": 1}


def test_reset_begins_a_new_series(campaign: Cell) -> None:
    validator = Validator(ValidatorSettings(history=60.0, obstacle_mass=2.39))
    for state in campaign.states:
        validator.add_decision(*state)
    for impact in campaign.impacts:
        validator.add_impact(*impact)
    assert validator.result().seen == 12
    validator.add_decision(campaign.states[-2][0], 0)
    assert validator.result().late_states == 1
    validator.reset()
    result = validator.result()
    assert (result.seen, result.impacts, result.late_states, result.accepted) == (0, (), 0, False)
    (validated,) = validator.add_impact(*campaign.impacts[0])
    assert (validated.series.count, validated.obstacle_mass) == (1, 2.39)


@pytest.mark.parametrize("is_reset", [False, True])
def test_reset_forgets_the_stated_uncertainty(campaign: Cell, *, is_reset: bool) -> None:
    """A force 10 % too large is within the 30 % of the previous series, but not within the default of 5 %."""
    validator = Validator(ValidatorSettings(history=60.0))
    validator.add_force(block([0.0])._replace(relative_uncertainty=0.3), START)
    if is_reset:
        validator.reset()
    for since_ns, obstacle_mass, configuration in campaign.runs:
        validator.runs.set(since_ns, obstacle_mass=obstacle_mass, configuration=configuration)
    for state in campaign.states:
        validator.add_decision(*state)
    for impact, at_ns in campaign.impacts:
        validator.add_impact(impact._replace(compression_impulse=1.1 * impact.compression_impulse), at_ns)
    validator.finish()
    tolerance = 0.05 if is_reset else 0.3
    assert (f"must be within {tolerance:.0%} of 1" in validator.result().reason) == is_reset


@pytest.mark.parametrize(("heaviest", "one_pose"), [(2.09, True), (2.2, False)])
def test_masses_within_5_percent_are_one_pose(make_cell: MakeCell, heaviest: float, *, one_pose: bool) -> None:
    _, result = run(make_cell(masses=(2.0, 2.05, heaviest)), ValidatorSettings(history=60.0))
    assert ("one pose cannot show that the mass follows the pose" in result.reason) == one_pose


def test_recordings_one_after_the_other(make_cell: MakeCell) -> None:
    """Recordings with the same stamps but different obstacles form one series."""
    cell = make_cell()
    validator = Validator(ValidatorSettings(history=60.0))
    validated: list[ValidatedImpact] = []
    for number, (since_ns, obstacle_mass, configuration) in enumerate(cell.runs):
        validator.runs.set(0, obstacle_mass=obstacle_mass, configuration=configuration)
        shift = START - since_ns
        for state, received_ns in cell.states[200 * number : 200 * number + 200]:
            validated += validator.add_decision(state._replace(stamp_ns=state.stamp_ns + shift), received_ns + shift)
        impact, received_ns = cell.impacts[number]
        validated += validator.add_impact(impact._replace(stamp_ns=impact.stamp_ns + shift), received_ns + shift)
        validated += validator.begin_recording()
    together, _ = run(cell, ValidatorSettings(history=60.0))
    assert [i.predicted_force for i in validated] == [i.predicted_force for i in together]
    assert validator.result().accepted


def test_a_clock_that_goes_back_begins_a_new_recording(make_state: MakeState, make_impact: MakeImpact) -> None:
    validator = Validator(ValidatorSettings(obstacle_mass=2.0))
    validator.runs.set(START, obstacle_mass=3.0)
    validator.add_decision(make_state(START), 0)
    validator.add_impact(make_impact(START + 5 * MS), 0)
    early = START - 60_000 * MS
    for ms in range(0, 70, 10):
        validator.add_decision(make_state(early + ms * MS), 0)
    assert validator.result().unpaired == {"no contact state within 50 ms after the onset": 1}
    (validated,) = validator.add_impact(make_impact(early + 5 * MS), 0)
    assert validated.obstacle_mass == 3.0


def test_impact_after_the_clock_went_back_is_not_compared_with_states_of_the_time_before(
    make_state: MakeState, make_impact: MakeImpact
) -> None:
    """Within the history, they have the same stamps."""
    validator = Validator(ValidatorSettings(obstacle_mass=2.0))
    for ms in range(0, 3000, 10):
        validator.add_decision(make_state(START + ms * MS, 0.25), START + ms * MS)
    for ms in range(1000, 1500, 10):
        validator.add_decision(make_state(START + ms * MS, 0.5), START + ms * MS)
    (validated,) = validator.add_impact(make_impact(START + 1205 * MS), START + 1300 * MS)
    assert validated.speed == pytest.approx(0.5)
    assert validator.result().late_states == 0


def test_the_series_is_predicted_with_its_own_stiffness(make_cell: MakeCell) -> None:
    rng = np.random.default_rng(0)
    forces = [i.peak_force * (1.0 + rng.normal(0.0, 0.05)) for i, _ in make_cell().impacts]
    validated, result = run(make_cell(forces), ValidatorSettings(history=60.0))
    overall = result.models[0].overall
    assert len({i.stiffness for i in validated}) == 12  # each with what was known then
    assert {i.stiffness for i in result.impacts} == {overall.fitted_stiffness}
    assert result.impacts[-1] == validated[-1]
    difference = [i.predicted_force - i.measured_force for i in result.impacts]
    assert overall.bias == pytest.approx(np.mean(difference), abs=1e-9)
    assert overall.non_conservative == sum(not i.conservative for i in result.impacts)


def test_an_impact_may_be_reported_late(campaign: Cell) -> None:
    """A train of contacts is reported at its end, which does not show that clocks differ."""
    late = [(impact, impact.stamp_ns + 1200 * MS) for impact, _ in campaign.impacts]
    validated, result = run(campaign._replace(impacts=late), ValidatorSettings(history=60.0))
    assert (len(validated), result.clock, result.accepted) == (12, "", True)


def test_clocks_that_differed_in_an_earlier_recording(make_cell: MakeCell) -> None:
    cell = make_cell(force_clock_ns=-5000 * MS)
    validator = Validator(ValidatorSettings(history=60.0))
    for state in cell.states:
        validator.add_decision(*state)
    for impact in cell.impacts:
        validator.add_impact(*impact)
    text = validator.result().clock
    assert text
    validator.begin_recording()
    assert validator.result().clock == text
    validator.reset()
    assert validator.result().clock == ""


def test_impact_waits_until_the_states_cover_its_clock_uncertainty(
    make_state: MakeState, make_impact: MakeImpact
) -> None:
    """It waits 1 ms by the settings plus the residual of the force clock, but at least the 50 ms of the kink."""
    for residual, covered_ms in ((0.0, 50), (-0.004, 50), (-0.089, 90)):
        validator = Validator(ValidatorSettings(obstacle_mass=2.0, state_tolerance=0.2))
        for ms in (-100, -99):
            validator.add_decision(make_state(START + ms * MS), 0)
        assert not validator.add_impact(make_impact(START, clock_residual=residual), 0)
        assert not validator.add_decision(make_state(START + covered_ms * MS - 1), 0)
        assert len(validator.add_decision(make_state(START + covered_ms * MS), 0)) == 1


@pytest.mark.parametrize("residual", [NAN, math.inf, 1e300, -61.0])
def test_impact_without_a_usable_stamp_is_excluded(
    make_state: MakeState, make_impact: MakeImpact, residual: float
) -> None:
    validator = Validator(ValidatorSettings(obstacle_mass=2.0))
    validator.add_decision(make_state(START), START)
    assert not validator.add_impact(make_impact(START, clock_residual=residual), START + MS)
    assert [(impact.excluded, impact.reason) for impact in validator.result().refused] == [(True, "no usable stamp")]


def test_models_are_compared_on_the_same_impacts(make_state: MakeState, make_impact: MakeImpact) -> None:
    """The full mass is unknown for half of the impacts; the comparison leaves these out for all models."""
    validator = Validator(ValidatorSettings(obstacle_mass=2.0))
    for number, mass in enumerate((0.8, 1.0, 1.5, 2.0, 3.0, 4.0)):
        start_ns = START + number * 1000 * MS
        full = mass if number % 2 else NAN
        for ms in range(0, 70, 10):
            validator.add_decision(with_full_mass(make_state(start_ns + ms * MS, lumped=mass), full), 0)
        validator.add_impact(make_impact(start_ns + 5 * MS, 100.0 + 20.0 * number), 0)
    result = validator.result()
    assert [model.overall.count for model in result.models] == [6, 3, 6]
    assert result.comparison.count == 3
    errors = result.comparison.relative_rmse
    assert errors["lumped"] == errors["full"] != result.models[0].overall.relative_rmse


def test_one_reduced_mass_at_several_speeds_tells_no_models_apart(
    make_state: MakeState, make_impact: MakeImpact
) -> None:
    validator = Validator(ValidatorSettings(obstacle_mass=2.0))
    for number, speed in enumerate((0.1, 0.2, 0.3, 0.4)):
        start_ns = START + number * 1000 * MS
        for ms in range(0, 70, 10):
            validator.add_decision(make_state(start_ns + ms * MS, speed, lumped=1.0 + 0.002 * number), 0)
        validator.add_impact(make_impact(start_ns + 5 * MS, 400.0 * speed), 0)
    result = validator.result()
    assert result.models[0].overall.correlation > 0.99
    assert "the models cannot be told apart" in result.comparison.text
