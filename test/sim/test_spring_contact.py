from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.errors import SettingsError
from scara_effmass.sim.spring_contact import HERTZ, LINEAR, SpringContact

stiffnesses = st.floats(1e4, 1e8)
depths = st.floats(1e-6, 1e-3)
exponents = st.sampled_from([LINEAR, HERTZ, 2.0])
masses = st.floats(0.01, 100.0)
speeds = st.floats(0.01, 2.0)


@given(stiffnesses, exponents, st.floats(0.0, 1e4), st.floats(-1e-2, 1e-3), st.floats(-1.0, 1.0))
def test_it_never_pulls_and_ends_with_the_contact(k: float, n: float, c: float, depth: float, rate: float) -> None:
    force = SpringContact(k, n, c).force(depth, rate)
    assert force >= 0.0
    assert depth > 0.0 or force == 0.0


@given(stiffnesses, exponents, depths)
def test_the_force_is_the_slope_of_the_energy(k: float, n: float, depth: float) -> None:
    contact = SpringContact(k, n)
    step = depth * 1e-4
    slope = (contact.energy(depth + step) - contact.energy(depth - step)) / (2.0 * step)
    assert contact.force(depth, 0.0) == pytest.approx(slope, rel=1e-6)


@given(stiffnesses, speeds, masses)
def test_the_peak_of_a_linear_spring_is_v_sqrt_mu_k(k: float, v: float, mu: float) -> None:
    assert SpringContact(k).peak(v, mu) == pytest.approx(v * math.sqrt(mu * k))


@given(stiffnesses, speeds, masses)
def test_the_peak_of_hertz_is_that_of_the_textbook(k: float, v: float, mu: float) -> None:
    # Johnson, Contact Mechanics, 11.2: F = k^(2/5) (5/4 mu v^2)^(3/5)
    assert SpringContact(k, HERTZ).peak(v, mu) == pytest.approx(k**0.4 * (1.25 * mu * v * v) ** 0.6)


@given(stiffnesses, speeds, masses)
def test_a_linear_contact_lasts_half_a_period(k: float, v: float, mu: float) -> None:
    assert SpringContact(k).duration(v, mu) == pytest.approx(math.pi * math.sqrt(mu / k))


@given(stiffnesses, speeds, masses)
def test_a_contact_of_hertz_lasts_as_long_as_in_the_textbook(k: float, v: float, mu: float) -> None:
    # Johnson, 11.2: 2.94 times the depth over the speed
    depth = (1.25 * mu * v * v / k) ** 0.4
    assert SpringContact(k, HERTZ).duration(v, mu) == pytest.approx(2.94 * depth / v, rel=2e-3)


@pytest.mark.parametrize("name", ["stiffness", "exponent", "damping", "friction"])
@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf])
def test_what_no_tip_can_be_is_refused(name: str, value: float) -> None:
    with pytest.raises(SettingsError, match=f"{name} = "):
        SpringContact(**{name: value})


def test_a_tip_without_stiffness_and_the_critical_damping_of_hertz_are_refused() -> None:
    with pytest.raises(SettingsError, match="stiffness = 0"):
        SpringContact(0.0)
    with pytest.raises(SettingsError, match="linear"):
        SpringContact(exponent=HERTZ).critical_damping(1.0)
