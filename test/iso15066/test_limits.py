# SPDX-License-Identifier: Apache-2.0
"""Limits for given settings: the strictest row governs, and settings can only tighten it."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.errors import LimitError
from scara_effmass.iso15066 import BODY_REGIONS, Limit, limits_for
from scara_effmass.settings import ContactType, MonitorSettings

TRANSIENT_REGIONS = tuple(name for name in BODY_REGIONS if name not in {"skull_forehead", "face"})

contacts = st.sampled_from(ContactType)
selections = st.lists(st.sampled_from(TRANSIENT_REGIONS), unique=True).map(tuple)


def limits(**settings: object) -> dict[str, Limit]:
    return {limit.region: limit for limit in limits_for(MonitorSettings.model_validate(settings))}


def test_default_is_every_region_with_a_transient_limit() -> None:
    assert tuple(limits()) == TRANSIENT_REGIONS


@pytest.mark.parametrize("contact", list(ContactType))
def test_head_and_face_never_have_a_limit(contact: ContactType) -> None:
    without_head = [name for name in BODY_REGIONS if name not in {"skull_forehead", "face"}]
    assert list(limits(contact=contact)) == without_head
    for region in ("skull_forehead", "face"):
        with pytest.raises(LimitError, match="permits no contact with head and face"):
            limits(contact=contact, body_regions=[region, "chest"])


@pytest.mark.parametrize(
    ("setting", "value"), [("contact_area_m2", 1e-170), ("max_force", 0.9e-6), ("max_pressure_pa", 0.9e-2)]
)
def test_limits_that_permit_no_force_are_refused(setting: str, value: float) -> None:
    """The square of a smaller force would become zero."""
    with pytest.raises(LimitError, match=r"contact_area_m2, max_force and max_pressure_pa permit .* at least 1e-06 N"):
        limits(**{setting: value})


def test_clamped_body_part_is_infinitely_heavy() -> None:
    assert {limit.body_mass_kg for limit in limits(contact="quasi_static").values()} == {math.inf}


@given(selections, contacts)
def test_selected_regions_are_part_of_the_default(names: tuple[str, ...], contact: ContactType) -> None:
    default = limits(contact=contact)
    assert limits(contact=contact, body_regions=names) == {n: default[n] for n in default if not names or n in names}


def test_strictest_row_of_a_region_governs() -> None:
    hand = limits()["hand_fingers"]
    assert (hand.force_n, hand.pressure_n_cm2) == (280.0, 380.0)
    assert [point.number for point in hand.pressure_points] == [25]
    assert [point.number for point in hand.force_points] == list(range(17, 26))
    assert (hand.stiffness_n_m, hand.body_mass_kg, hand.energy_j) == (75e3, 0.6, 0.49)
    leg = limits()["lower_leg"]
    assert leg.clause == "force: Table A.2 row 28, 29; pressure: Table A.2 row 29"


@given(st.sampled_from(TRANSIENT_REGIONS))
def test_transient_limits_are_twice_the_quasi_static_limits(name: str) -> None:
    free, clamped = limits()[name], limits(contact="quasi_static")[name]
    assert (free.force_n, free.pressure_n_cm2) == (2.0 * clamped.force_n, 2.0 * clamped.pressure_n_cm2)


def test_criterion_changes_with_the_contact_area() -> None:
    small, large = (limits(body_regions=["chest"], contact_area_m2=area)["chest"] for area in (1e-4, 2e-4))
    assert (small.criterion, small.permissible_force_n) == ("pressure", 240.0)
    assert (large.criterion, large.permissible_force_n) == ("force", 280.0)


@given(
    contact=contacts,
    names=selections,
    max_force=st.just(0.0) | st.floats(1e-6, 500.0),
    max_pressure_pa=st.just(0.0) | st.floats(1.0, 7e6),
    stiffness_n_m=st.floats(0.0, 2e5),
    body_mass=st.floats(0.0, 100.0),
)
def test_settings_tighten_limits_or_raise(contact: ContactType, names: tuple[str, ...], **own: float) -> None:
    standard = limits(contact=contact, body_regions=names)
    loosest = {
        "max_force": max(limit.force_n for limit in standard.values()),
        "max_pressure_pa": 1e4 * max(limit.pressure_n_cm2 for limit in standard.values()),
        "stiffness_n_m": min(limit.stiffness_n_m for limit in standard.values()),
        "body_mass": min(limit.body_mass_kg for limit in standard.values()),
    }
    loosening = {
        key
        for key, value in own.items()
        if value and (value > loosest[key] if key.startswith("max") else value < loosest[key])
    }
    if loosening:
        with pytest.raises(LimitError) as error:
            limits(contact=contact, body_regions=names, **own)
        assert str(error.value).split(" = ")[0] in loosening
        return
    for name, limit in limits(contact=contact, body_regions=names, **own).items():
        assert limit.force_n == min(standard[name].force_n, own["max_force"] or math.inf)
        assert limit.pressure_n_cm2 == min(standard[name].pressure_n_cm2, (own["max_pressure_pa"] or math.inf) / 1e4)
        assert limit.stiffness_n_m == max(standard[name].stiffness_n_m, own["stiffness_n_m"])
        assert limit.body_mass_kg == max(standard[name].body_mass_kg, own["body_mass"])
        assert limit.energy_j == standard[name].energy_j


def test_own_limit_is_named_as_source() -> None:
    hand = limits(body_regions=["hand_fingers"], max_force=100.0, max_pressure_pa=5e5)["hand_fingers"]
    assert hand.force_points == hand.pressure_points == ()
    assert hand.clause == "force: own limit (max_force); pressure: own limit (max_pressure_pa)"


def test_settings_equal_to_the_standard_change_nothing() -> None:
    own = limits(
        body_regions=["hand_fingers"], max_force=280.0, max_pressure_pa=3.8e6, stiffness_n_m=75e3, body_mass=0.6
    )
    assert own == limits(body_regions=["hand_fingers"])


@pytest.mark.parametrize(
    ("settings", "parts"),
    [
        ({"max_force": 441.0}, ["max_force = 441 N", "440 N", "thigh_knee", "row 26, 27"]),
        ({"max_pressure_pa": 4.41e6}, ["max_pressure_pa = 4.41e+06 Pa", "4.4e+06 Pa", "thigh_knee", "row 27"]),
        ({"body_regions": ["neck"], "stiffness_n_m": 49e3}, ["stiffness_n_m = 49000 N/m", "50000 N/m", "neck"]),
        ({"body_mass": 0.5}, ["body_mass = 0.5 kg", "0.6 kg", "hand_fingers"]),
        ({"contact": "quasi_static", "body_mass": 75.0}, ["body_mass = 75 kg", "must be 0", "clamped"]),
        ({"body_regions": ["face"]}, ["body_regions = 'face'", "no contact with head and face", "row 3"]),
        ({"body_regions": ["skull_forehead"]}, ["body_regions = 'skull_forehead'", "row 1, 2"]),
        ({"body_regions": ["chest", "chest"]}, ["body_regions = 'chest'", "2 times"]),
        ({"body_regions": ["hands"]}, ["body_regions = 'hands'", *BODY_REGIONS]),
    ],
)
def test_errors_name_key_value_region_and_bound(settings: dict[str, object], parts: list[str]) -> None:
    with pytest.raises(LimitError) as error:
        limits(**settings)
    message = str(error.value)
    assert [part for part in parts if part not in message] == []
    assert "\n" not in message
