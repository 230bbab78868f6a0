# SPDX-License-Identifier: Apache-2.0
import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.errors import SettingsError
from scara_effmass.sim.cart import HERTZ, LINEAR, Cart, SpringContact

stiffnesses = st.floats(1e4, 1e8)
exponents = st.sampled_from([LINEAR, HERTZ, 2.0])
masses = st.floats(0.01, 100.0)
speeds = st.floats(0.01, 2.0)


@given(stiffnesses, exponents, st.floats(0.0, 1e4), st.floats(-1e-2, 1e-3), st.floats(-1.0, 1.0))
def test_force_is_never_tensile_and_zero_without_contact(
    k: float, n: float, c: float, depth: float, rate: float
) -> None:
    force = SpringContact(k, n, c).force(depth, rate)
    assert force >= 0.0
    assert depth > 0.0 or force == 0.0


@given(stiffnesses, exponents, st.floats(1e-6, 1e-3))
def test_force_follows_the_power_law(k: float, n: float, depth: float) -> None:
    assert SpringContact(k, n).force(depth, 0.0) == pytest.approx(k * depth**n)


@given(stiffnesses, speeds, masses)
def test_free_impact_has_the_textbook_peak_and_duration(k: float, v: float, mu: float) -> None:
    linear = (v * math.sqrt(mu * k), math.pi * math.sqrt(mu / k))
    assert SpringContact(k).free_impact(v, mu) == pytest.approx(linear)
    # Johnson, Contact Mechanics, 11.2: F = k^(2/5) (5/4 mu v^2)^(3/5), t = 2.94 depth / v
    hertz = (k**0.4 * (1.25 * mu * v * v) ** 0.6, 2.94 * (1.25 * mu * v * v / k) ** 0.4 / v)
    assert SpringContact(k, HERTZ).free_impact(v, mu) == pytest.approx(hertz, rel=2e-3)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("stiffness", 0.0),
        ("friction", 1.1),
        *((name, v) for name in SpringContact.__slots__ for v in (-1.0, math.nan, math.inf)),
    ],
)
def test_invalid_contact_raises(name: str, value: float) -> None:
    with pytest.raises(SettingsError, match=f"{name} = "):
        SpringContact(**{name: value})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mass": 0.0}, "mass = 0"),
        ({"mass": math.nan}, "mass = nan"),
        ({"tip_mass": 1.0}, "tip_mass = 1"),
        ({"direction": (1.0, 0.1, 0.0)}, "direction = "),
        ({"surface": (0.0, 0.0, math.nan)}, "surface = "),
    ],
)
def test_impossible_cart_is_refused(change: dict[str, Any], message: str) -> None:
    cart = Cart((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 1.0)
    with pytest.raises(SettingsError, match=message):
        replace(cart, **change)
