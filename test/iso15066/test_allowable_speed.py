# SPDX-License-Identifier: Apache-2.0
"""Allowable speed: reference values, agreement with the minimum over all limits, monotonicity."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.errors import LimitError
from scara_effmass.iso15066 import (
    BODY_REGIONS,
    MIN_EFFECTIVE_MASS,
    SpeedLimit,
    limits_for,
    peak_force,
    reduced_mass,
    speed_limit_of_mass,
    transferred_energy,
)
from scara_effmass.iso15066.allowable_speed import max_speed
from scara_effmass.settings import ContactType, Drives, MonitorSettings

if TYPE_CHECKING:
    from scara_effmass.iso15066 import (
        Limit,
    )

masses = st.floats(1e-3, 1e3) | st.sampled_from([MIN_EFFECTIVE_MASS, 1e6, math.inf])
uncertainties = st.floats(0.0, 1.0)
regions = st.sampled_from([name for name in BODY_REGIONS if name not in {"skull_forehead", "face"}])

EXAMPLE = limits_for(MonitorSettings())[0]
any_limit = st.builds(
    lambda force, stiffness, mass: replace(
        EXAMPLE, force_n=force, pressure_n_cm2=1e6, stiffness_n_m=stiffness, body_mass_kg=mass
    ),
    force=st.floats(10.0, 500.0),
    stiffness=st.floats(1e3, 1e6),
    mass=st.floats(0.1, 100.0) | st.just(math.inf),
)


def speed_limit_of(mass: float, **settings: object) -> SpeedLimit:
    checked = MonitorSettings.model_validate({"drives": "free", **settings})
    return speed_limit_of_mass(limits_for(checked), mass, checked)


def smallest_speed(limits: tuple[Limit, ...], mass: float, uncertainty: float) -> float:
    """Return the smallest v_max of all limits, straight from the standard's formula."""
    inverse_robot = 1.0 / mass
    speeds = []
    for limit in limits:
        inverse_mu = inverse_robot + 1.0 / limit.body_mass_kg
        force = min(limit.force_n, limit.pressure_n_cm2 * limit.contact_area_cm2)
        speeds.append(force * math.sqrt(inverse_mu / ((1.0 + uncertainty) * limit.stiffness_n_m)))
    return min(speeds)


@pytest.mark.parametrize(
    ("contact", "region", "light", "heavy", "criterion"),
    [
        ("transient", "hand_fingers", 1.679, 1.456, "force"),
        ("transient", "lower_leg", 1.085, 0.649, "force"),
        ("transient", "chest", 1.560, 0.943, "pressure"),
        ("quasi_static", "hand_fingers", 0.519, 0.307, "force"),
        ("quasi_static", "lower_leg", 0.539, 0.319, "force"),
    ],
)
def test_reference_speeds(contact: str, region: str, light: float, heavy: float, criterion: str) -> None:
    """Worked figures for 0.97 and 2.77 kg at 1 cm2 [m/s]."""
    for mass, expected in ((0.97, light), (2.77, heavy)):
        found = speed_limit_of(mass, contact=contact, body_regions=[region])
        assert found.allowable_speed == pytest.approx(expected, abs=0.0005)
        assert (found.limit.region, found.criterion) == (region, criterion)


def test_damping_and_friction_lower_the_speed_as_they_raise_the_force() -> None:
    elastic = speed_limit_of(2.77, body_regions=["chest"]).allowable_speed
    rubbing = speed_limit_of(2.77, body_regions=["chest"], contact_friction=0.75).allowable_speed
    assert rubbing == pytest.approx(elastic / 1.25)


@pytest.mark.parametrize("speed", [0.3, 0.9, 2.0])
def test_a_force_that_grows_reaches_the_limit_at_the_speed(speed: float) -> None:
    found = max_speed(speed, 2.0)
    assert found * (1.0 + 2.0 * found) == pytest.approx(speed)


@given(st.lists(any_limit, min_size=1, max_size=8).map(tuple), masses, uncertainties)
def test_governing_limits_give_the_speed_of_all_limits(
    limits: tuple[Limit, ...], mass: float, uncertainty: float
) -> None:
    expected = smallest_speed(limits, mass, uncertainty)
    settings = MonitorSettings(stiffness_uncertainty=uncertainty, drives=Drives.FREE)
    assert speed_limit_of_mass(limits, mass, settings).allowable_speed == pytest.approx(expected, rel=1e-9, abs=1e-12)


@given(st.sampled_from(ContactType), st.floats(0.05, 10.0), masses, uncertainties)
def test_speed_is_that_of_the_standards_table(
    contact: ContactType, area: float, mass: float, uncertainty: float
) -> None:
    settings = MonitorSettings(
        contact=contact, contact_area_m2=1e-4 * area, stiffness_uncertainty=uncertainty, drives=Drives.FREE
    )
    limits = limits_for(settings)
    expected = smallest_speed(limits, mass, uncertainty)
    assert speed_limit_of_mass(limits, mass, settings).allowable_speed == pytest.approx(expected, rel=1e-12, abs=1e-12)


@given(regions, masses.filter(math.isfinite), uncertainties)
def test_force_at_the_allowable_speed_is_the_limit(region: str, mass: float, uncertainty: float) -> None:
    found = speed_limit_of(mass, body_regions=[region], stiffness_uncertainty=uncertainty)
    speed, limit, mu, stiffness = found.allowable_speed, found.limit, found.reduced_mass, found.stiffness
    assert stiffness == (1.0 + uncertainty) * limit.stiffness_n_m
    assert mu == pytest.approx(reduced_mass(mass, limit.body_mass_kg), rel=1e-12)
    assert found.force(speed) == pytest.approx(limit.permissible_force_n)
    assert peak_force(speed, mu, stiffness) == pytest.approx(limit.permissible_force_n)
    assert transferred_energy(speed, mu) == pytest.approx(limit.permissible_force_n**2 / (2.0 * stiffness))


@given(st.sampled_from(ContactType), masses, masses, uncertainties, uncertainties)
def test_higher_mass_or_stiffness_never_raises_the_speed(
    contact: ContactType, mass: float, other_mass: float, uncertainty: float, other_uncertainty: float
) -> None:
    masses_and_uncertainties = zip(sorted((mass, other_mass)), sorted((uncertainty, other_uncertainty)), strict=True)
    light, heavy = (
        speed_limit_of(mass, contact=contact, stiffness_uncertainty=u).allowable_speed
        for mass, u in masses_and_uncertainties
    )
    assert heavy <= light * (1 + 1e-12)


@given(masses, st.floats(0.01, 100.0), st.floats(0.01, 100.0))
def test_larger_area_never_lowers_the_speed(mass: float, area: float, other_area: float) -> None:
    small, large = (speed_limit_of(mass, contact_area_m2=1e-4 * a) for a in sorted((area, other_area)))
    assert small.allowable_speed <= large.allowable_speed * (1 + 1e-12)


@given(masses, regions, st.floats(1.0, 4.0))
def test_tighter_settings_never_raise_the_speed(mass: float, region: str, tighter: float) -> None:
    standard = speed_limit_of(mass, body_regions=[region])
    limit = standard.limit
    for key, value in (
        ("max_force", limit.force_n / tighter),
        ("max_pressure_pa", 1e4 * limit.pressure_n_cm2 / tighter),
        ("stiffness_n_m", BODY_REGIONS[region].stiffness_n_m * tighter),
        ("body_mass", BODY_REGIONS[region].mass_kg * tighter),
    ):
        own = speed_limit_of(mass, body_regions=[region], **{key: value})
        assert own.allowable_speed <= standard.allowable_speed * (1 + 1e-12)


@given(masses, regions)
def test_more_regions_never_raise_the_speed(mass: float, region: str) -> None:
    all_regions = speed_limit_of(mass).allowable_speed
    assert all_regions <= speed_limit_of(mass, body_regions=[region]).allowable_speed * (1 + 1e-12)


@given(masses, regions)
def test_quasi_static_contact_is_never_faster_than_transient(mass: float, region: str) -> None:
    clamped, free = (speed_limit_of(mass, contact=c, body_regions=[region]) for c in ("quasi_static", "transient"))
    assert clamped.allowable_speed <= 0.5 * free.allowable_speed * (1 + 1e-12)


def test_speed_at_infinite_effective_mass() -> None:
    free = speed_limit_of(math.inf, body_regions=["lower_leg"])
    assert free.reduced_mass == pytest.approx(75.0)
    assert free.allowable_speed == pytest.approx(260.0 / math.sqrt(75.0 * 60e3))
    assert speed_limit_of(math.inf, contact="quasi_static").allowable_speed == 0.0


@pytest.mark.parametrize("mass", [0.0, -1.0, math.nan, -math.inf, 5e-324, MIN_EFFECTIVE_MASS / 2])
def test_invalid_mass_raises(mass: float) -> None:
    with pytest.raises(LimitError, match="effective_mass"):
        speed_limit_of(mass)


def test_limit_without_a_maximum_allows_any_speed() -> None:
    unlimited = replace(EXAMPLE, force_n=math.inf, pressure_n_cm2=math.inf)
    found = speed_limit_of_mass([unlimited], 2.0)
    assert (found.allowable_speed, found.limit) == (math.inf, unlimited)


def test_no_limit_raises() -> None:
    with pytest.raises(LimitError, match="at least one region"):
        speed_limit_of_mass((), 2.0)
