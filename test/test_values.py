# SPDX-License-Identifier: Apache-2.0
"""Texts of speeds never show more than is allowed, nor less than is."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.values import at_least, at_most, limit_share, speed_texts

NOISE = 1.0 + 1e-11


@given(st.floats(-1e9, 1e9), st.integers(0, 4))
def test_an_allowed_value_is_rounded_down_and_an_actual_one_up(value: float, digits: int) -> None:
    step = 10.0**-digits
    down, up = float(at_most(value, digits)), abs(float(at_least(value, digits)))
    assert value - step * NOISE - 1e-11 * abs(value) <= down <= value + 1e-11 * abs(value)
    assert abs(value) * (1.0 - 1e-11) <= up <= abs(value) * NOISE + step


@pytest.mark.parametrize(
    ("value", "allowed", "actual"),
    [
        (0.045, "0.04", "0.05"),
        (0.25, "0.25", "0.25"),
        (0.1 + 0.2, "0.30", "0.30"),  # 0.30000000000000004
        (0.29, "0.29", "0.29"),
        (0.0, "0.00", "0.00"),
        (-0.0, "0.00", "0.00"),
        (1e-9, "0.00", "0.01"),
        (-0.001, "-0.01", "-0.01"),
        (math.inf, "inf", "inf"),
        (math.nan, "nan", "nan"),
    ],
)
def test_examples(value: float, allowed: str, actual: str) -> None:
    assert (at_most(value, 2), at_least(value, 2)) == (allowed, actual)
    assert len(at_most(1e300, 2)) > 300


def test_nothing_allowed_is_the_largest_share() -> None:
    assert limit_share(0.0, 0.0) == math.inf > limit_share(9.0, 1e-3)


@pytest.mark.parametrize(
    ("speed", "allowable", "texts"),
    [
        (0.1, 0.2, ("0.100", "0.200")),
        (0.5962, 0.5968, ("0.5962", "0.5968")),
        (0.111451, 0.111459, ("0.111451", "0.111459")),
        (0.5968, 0.5962, ("0.597", "0.596")),
        (0.2, 0.2, ("0.200", "0.200")),
        (math.nan, 0.2, ("nan", "0.200")),
        (1 / 3, 1 / 3, ("0.333334", "0.333333")),
    ],
)
def test_allowed_speed_never_looks_too_high(speed: float, allowable: float, texts: tuple[str, str]) -> None:
    assert speed_texts(speed, allowable) == texts
