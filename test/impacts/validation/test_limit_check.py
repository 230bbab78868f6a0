# SPDX-License-Identifier: Apache-2.0
"""Force on a body region from the force on a measuring device."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.impacts.agreement import NO_REGION, RegionForce, region_force
from scara_effmass.iso15066 import limits_for, peak_force, reduced_mass
from scara_effmass.settings import MonitorSettings

HAND = limits_for(MonitorSettings(body_regions=("hand_fingers",)))
ALL = limits_for(MonitorSettings())
MASS = st.floats(0.5, 20.0)


@given(MASS, MASS, st.floats(1e4, 2e6), st.floats(0.05, 2.0))
def test_a_free_device_gives_the_force_of_the_law(robot: float, device: float, stiffness: float, speed: float) -> None:
    measured = peak_force(speed, reduced_mass(robot, device), stiffness)
    result = region_force(HAND, measured, [robot], device, stiffness)
    assert result.force == pytest.approx(peak_force(speed, reduced_mass(robot, 0.6), 75e3))
    assert (result.region, result.limit, result.criterion) == ("hand_fingers", 280.0, "force")
    assert result.exceeds == (result.force > 280.0)


def test_a_device_like_the_region_converts_nothing() -> None:
    assert region_force(HAND, 123.0, [3.0], 0.6, 75e3).force == pytest.approx(123.0)


def test_a_fixed_device_of_the_stiffness_of_the_hand_reads_too_much() -> None:
    """Mass 3 kg on a fixed 75 N/mm: mu is 3 kg instead of 0.5 kg, so the hand feels sqrt(1/6) of the force."""
    assert region_force(HAND, 400.0, [3.0], math.inf, 75e3).force == pytest.approx(400.0 / math.sqrt(6.0))


def test_clamped_region_has_an_infinite_mass() -> None:
    clamped = limits_for(MonitorSettings(body_regions=("hand_fingers",), contact="quasi_static"))
    result = region_force(clamped, 100.0, [3.0], math.inf, 75e3)
    assert (result.force, result.limit) == pytest.approx((100.0, 140.0))


def test_the_region_closest_to_its_limit_is_returned() -> None:
    result = region_force(ALL, 100.0, [3.0], 5.0, 1e5)
    others = [region_force([limit], 100.0, [3.0], 5.0, 1e5) for limit in ALL]
    assert result.force / result.limit == max(other.force / other.limit for other in others)


def test_nothing_without_stiffness() -> None:
    assert region_force(HAND, 100.0, [3.0], 5.0, 0.0) == NO_REGION


def test_nothing_where_neither_robot_nor_device_gives_way() -> None:
    assert region_force(HAND, 100.0, [math.inf], math.inf, 1e5) == NO_REGION


def test_force_at_the_limit_does_not_exceed_it() -> None:
    assert not RegionForce("hand_fingers", 280.0, 280.0, "force").exceeds


@pytest.mark.parametrize("masses", [(1.0, 4.0), (4.0, 1.0), (4.0, 0.0, 1.0)])
def test_the_mass_with_the_largest_force_over_its_limit_counts(masses: tuple[float, ...]) -> None:
    """The order does not matter; 0 is an unknown mass."""
    light, heavy = (region_force(ALL, 100.0, [mass], 40.0, 1e5) for mass in (1.0, 4.0))
    assert heavy.force / heavy.limit > light.force / light.limit
    assert region_force(ALL, 100.0, masses, 40.0, 1e5) == heavy


def test_no_known_mass_or_device_gives_no_region() -> None:
    assert region_force(ALL, 100.0, [0.0, 0.0], 5.0, 1e5) == region_force(ALL, 100.0, [3.0], 5.0, 0.0) == NO_REGION
