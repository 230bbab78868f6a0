# SPDX-License-Identifier: Apache-2.0
"""Peaks are compared with the limits for impacts, what stays with the quasi-static ones, also out of the series."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest

from scara_effmass.impacts.agreement import comparison_text
from scara_effmass.impacts.impact_matcher import PRESS
from scara_effmass.impacts.load import LATER_LOAD
from scara_effmass.impacts.segment import NOISE, STUCK
from scara_effmass.impacts.validator import Result, Validator
from scara_effmass.iso15066 import limits_for
from scara_effmass.settings import ContactType, MonitorSettings, ValidatorSettings
from scara_effmass.values import NAN, Impact, LeftOut, RunInfo, ValidatedImpact

if TYPE_CHECKING:
    from test.impacts.validation.conftest import Cell, MakeCell

REGION = "hand_fingers"
SETTINGS = ValidatorSettings(history=60.0, body_regions=(REGION,))
TRANSIENT, QUASI_STATIC = (
    limits_for(MonitorSettings(body_regions=(REGION,), contact=contact))[0].permissible_force_n
    for contact in (ContactType.TRANSIENT, ContactType.QUASI_STATIC)
)


@pytest.fixture(scope="module")
def campaign(make_cell: MakeCell) -> Cell:
    """The paper's twelve cases without noise."""
    return make_cell()


def validated(
    cell: Cell,
    change: Callable[[int, Impact], Impact],
    *,
    late_ns: int = 0,
    with_states: bool = True,
    left_out: tuple[LeftOut, ...] = (),
) -> tuple[list[ValidatedImpact], Result]:
    """Validate the impacts of `cell` after the `change`; the first one arrives `late_ns` later."""
    validator = Validator(SETTINGS)
    validator.leave_out(left_out)
    for since_ns, obstacle_mass, configuration in cell.runs:
        validator.runs.set(since_ns, obstacle_mass=obstacle_mass, configuration=configuration)
    items: list[tuple[int, Any, Any]] = [
        (at_ns, validator.add_decision, decision) for decision, at_ns in cell.states if with_states
    ]
    items += [
        (at_ns + late_ns * (number == 0), validator.add_impact, change(number, impact))
        for number, (impact, at_ns) in enumerate(cell.impacts)
    ]
    found = [one for at_ns, add, value in sorted(items, key=lambda item: item[0]) for one in add(value, at_ns)]
    return found + validator.finish(), validator.result()


def first(**changes: Any) -> Callable[[int, Impact], Impact]:  # noqa: ANN401 - fields of Impact
    return lambda number, impact: impact._replace(**changes) if number == 0 else impact


def same(_: int, impact: Impact) -> Impact:
    return impact


def test_without_force_that_stays_nothing_is_compared(campaign: Cell) -> None:
    impacts, result = validated(campaign, same)
    assert {(impact.held_force, impact.held_limit, impact.held_region) for impact in impacts} == {(0.0, 0.0, "")}
    assert (result.held.contacts, result.held.exceedances) == (0, 0)


@pytest.mark.parametrize(("held", "load", "exceeds"), [(0.9, 0.0, False), (1.1, 0.0, True), (0.6, 0.5, True)])
def test_what_stays_after_an_impact_has_the_quasi_static_limit(
    campaign: Cell, held: float, load: float, *, exceeds: bool
) -> None:
    _, before = validated(campaign, same)
    change = first(held_force=held * QUASI_STATIC, load_force=load * QUASI_STATIC, duration=0.8)
    impacts, result = validated(campaign, change, late_ns=800_000_000)
    impact = next(one for one in impacts if one.held_force)
    assert impact.held_force == pytest.approx((held + load) * QUASI_STATIC)
    assert (impact.held_limit, impact.held_region) == (QUASI_STATIC, REGION)
    assert (result.held.contacts, result.held.exceedances) == (1, int(exceeds))
    assert impact.exceeds_limit == (exceeds or impact.region_force > TRANSIENT)
    assert len(result.impacts) == 12  # the peak is an impact as any other
    assert result.models[0].fit.mass_scale == pytest.approx(before.models[0].fit.mass_scale)
    text = comparison_text(impact)
    assert text.startswith(f"converted {impact.region_force:.1f} N on {REGION}, ")
    assert f"held {impact.held_force:.1f} N on {REGION}, {'ABOVE' if exceeds else 'below'} its limit of " in text


def test_a_load_beneath_a_peak_adds_to_it(campaign: Cell) -> None:
    plain, _ = validated(campaign, same)
    loaded, _ = validated(campaign, first(load_force=40.0))
    by_stamp = {impact.stamp_ns: impact for impact in plain}
    (changed,) = [one for one in loaded if one.region_force != by_stamp[one.stamp_ns].region_force]
    assert changed.region_force == pytest.approx(by_stamp[changed.stamp_ns].region_force + 40.0)
    assert changed.measured_force == by_stamp[changed.stamp_ns].measured_force


def test_a_press_is_no_impact_of_the_series_but_is_compared(campaign: Cell) -> None:
    change = first(held_force=2.0 * QUASI_STATIC, compression_impulse=0.0)
    impacts, result = validated(campaign, change)
    assert (len(impacts), result.excluded) == (11, {PRESS: 1})
    assert (result.held.contacts, result.held.exceedances, result.held.worst.limit) == (1, 1, QUASI_STATIC)
    statistics = sum(impact.exceeds_limit for impact in result.impacts)
    assert result.exceedances == statistics + 1


def test_the_first_half_second_of_a_press_has_the_limit_for_impacts(campaign: Cell) -> None:
    change = first(peak_force=1.5 * TRANSIENT, held_force=0.1 * QUASI_STATIC, compression_impulse=0.0)
    _, result = validated(campaign, change)
    assert (result.held.exceedances, result.held.worst.limit) == (1, TRANSIENT)
    assert result.held.worst.force == pytest.approx(1.5 * TRANSIENT)


def test_a_sensor_across_the_plate_shows_a_part_of_what_a_refused_contact_holds(campaign: Cell) -> None:
    validator = Validator(SETTINGS)
    run = RunInfo(1, obstacle_mass=2.0, plate_normal=(1.0, 0.0, 0.0), guide_direction=(0.6, 0.8, 0.0))
    validator.runs.begin(run, 1)
    (impact, at_ns), *_ = campaign.impacts
    press = impact._replace(held_force=0.8 * QUASI_STATIC, compression_impulse=0.0)
    assert [*validator.add_impact(press, at_ns), *validator.finish()] == []
    result = validator.result()
    assert (result.held.exceedances, result.held.worst.limit) == (1, QUASI_STATIC)
    assert result.held.worst.force == pytest.approx(0.8 / 0.6 * QUASI_STATIC)


def test_what_stays_is_compared_without_the_state_of_the_robot(campaign: Cell) -> None:
    change = first(held_force=2.0 * QUASI_STATIC)
    impacts, result = validated(campaign, change, with_states=False)
    assert (impacts, sum(result.unpaired.values())) == ([], 12)
    assert (result.held.contacts, result.held.exceedances) == (1, 1)
    assert result.exceedances == 1


@pytest.mark.parametrize(
    ("changes", "others", "above", "unmeasured"),
    [
        ({"clipped": True, "peak_force": 5000.0}, 1, 1, 1),
        ({"clipped": True, "peak_force": 10.0}, 1, 0, 1),
        ({"incomplete": True, "peak_force": 5000.0}, 1, 1, 1),
        ({"incomplete": True, "peak_force": 5000.0, "held_force": 2.0 * QUASI_STATIC}, 1, 1, 1),
        ({"rebound": 1, "peak_force": 5000.0}, 1, 1, 0),  # larger than its impact
        ({"rebound": 1, "peak_force": 10.0}, 0, 0, 0),
        ({"peak_force": 5000.0, "stamp_ns": 1}, 1, 1, 0),  # no state of the robot
        ({"peak_force": NAN}, 0, 0, 0),
    ],
)
def test_contacts_left_out_of_the_series_are_compared(
    campaign: Cell, changes: dict[str, Any], others: int, above: int, unmeasured: int
) -> None:
    impacts, result = validated(campaign, lambda number, impact: impact._replace(**changes) if number == 1 else impact)
    assert len(impacts) == 11
    assert (result.left_out.contacts, result.left_out.exceedances, result.unmeasured) == (others, above, unmeasured)
    assert result.exceedances == sum(impact.exceeds_limit for impact in result.impacts) + above
    assert result.impacts[-1].series.exceedances == result.exceedances


def test_peaks_left_out_are_converted_with_the_worst_impact_of_the_series(campaign: Cell) -> None:
    _, result = validated(campaign, first(clipped=True, load_force=7.0))
    worst = max(impact.region_force / impact.measured_force for impact in result.impacts)
    assert result.left_out.worst.force == pytest.approx(worst * campaign.impacts[0][0].peak_force + 7.0)
    _, unpaired = validated(campaign, same, with_states=False)  # nothing to convert with
    assert unpaired.left_out.worst.force == max(impact.peak_force for impact, _ in campaign.impacts)


@pytest.mark.parametrize(
    ("reason", "peak", "above", "unmeasured"),
    [
        (NOISE, 5000.0, 1, 0),
        (NOISE, 10.0, 0, 0),
        (STUCK, 10.0, 0, 1),
        (LATER_LOAD, 1.1 * QUASI_STATIC, 1, 0),  # acts on a body as on the sensor
    ],
)
def test_force_in_no_impact_is_compared(campaign: Cell, reason: str, peak: float, above: int, unmeasured: int) -> None:
    _, result = validated(campaign, same, left_out=(LeftOut(reason, 1, peak, 0),))
    assert (result.left_out.contacts, result.left_out.exceedances, result.unmeasured) == (1, above, unmeasured)
    assert result.within_limits == (not result.exceedances and not unmeasured)


def test_the_load_in_a_force_in_no_impact_is_not_converted(campaign: Cell) -> None:
    _, result = validated(campaign, same, left_out=(LeftOut(NOISE, 1, 17.0, 0, load_force=7.0),))
    worst = max(impact.region_force / impact.measured_force for impact in result.impacts)
    assert result.left_out.worst.force == pytest.approx(10.0 * worst + 7.0)


@pytest.mark.parametrize("reason", [NOISE, LATER_LOAD])
def test_force_in_no_impact_on_an_oblique_guide_is_that_along_the_normal(reason: str) -> None:
    validator = Validator(SETTINGS)
    run = RunInfo(1, obstacle_mass=2.0, plate_normal=(1.0, 0.0, 0.0), guide_direction=(0.6, 0.8, 0.0))
    validator.begin_run(run, 1)
    validator.leave_out([LeftOut(reason, 1, 60.0, 2, load_force=6.0)])
    assert validator.result().left_out.worst.force == pytest.approx(100.0)
