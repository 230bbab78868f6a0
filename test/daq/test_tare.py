# SPDX-License-Identifier: Apache-2.0
"""Tests of the tare."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.daq.conditioning import Tare
from scara_effmass.settings import TareSettings
from scara_effmass.values import FloatArray

RATE = 1000.0
N = 500
NONE = np.empty(0, np.uint32)
REFUSED = "refused: the force was at the end of the measuring range, or the sensor open or shorted"


def noise(seed: int = 0, sigma: float = 0.1) -> FloatArray:
    return np.random.default_rng(seed).normal(scale=sigma, size=N)


def tare_of(force: FloatArray, saturated: slice | None = None) -> float | str:
    tare = Tare(TareSettings(), RATE)
    indices = NONE if saturated is None else np.arange(force.size, dtype=np.uint32)[saturated]
    tare.add(force, indices)
    assert tare.done
    return tare.result()


@given(st.floats(-1e3, 1e3), st.integers(0, 2**32 - 1))
def test_tare_is_the_force_at_rest(bias: float, seed: int) -> None:
    # The median of ten means is 1.2 times as uncertain as the mean: 0.0055 N here.
    assert tare_of(bias + noise(seed)) == pytest.approx(bias, abs=6 * 0.0055)


@given(bias=st.floats(-1e3, 1e3), start=st.integers(0, N), length=st.integers(1, 50), peak=st.floats(-2e3, 2e3))
def test_impact_does_not_change_the_tare(bias: float, start: int, length: int, peak: float) -> None:
    force = bias + noise()
    force[start : start + length] += peak
    assert tare_of(force) == pytest.approx(bias, abs=0.03)


@given(st.lists(st.integers(0, N), max_size=10))
def test_size_of_portions_does_not_matter(cuts: list[int]) -> None:
    force = 3.0 + noise()
    tare = Tare(TareSettings(), RATE)
    for portion in np.split(force, sorted(cuts)):
        tare.add(portion, NONE)
    assert tare.done
    assert tare.result() == pytest.approx(tare_of(force), abs=1e-12)


@pytest.mark.parametrize(
    "moving",
    [
        pytest.param(np.linspace(0.0, 20.0, N), id="ramp"),
        pytest.param(np.where(np.arange(N) < N // 2, 0.0, 5.0), id="step"),
        pytest.param(5.0 * np.sin(np.arange(N) * 0.02), id="oscillation"),
    ],
)
def test_changing_force_is_refused(moving: FloatArray) -> None:
    result = tare_of(moving + noise())
    assert isinstance(result, str)
    assert result.startswith("refused: the force moved by ")
    assert result.endswith(" N, tare.tolerance is 1 N")


def test_saturated_sensor_is_refused_after_three_parts() -> None:
    assert tare_of(np.full(N, 2224.0), slice(None)) == REFUSED
    force = 2.0 + noise()
    force[200:340] = 2224.0  # three of the ten parts
    assert tare_of(force, slice(200, 340)) == pytest.approx(2.0, abs=0.03)


def test_tare_ends_after_its_time() -> None:
    tare = Tare(TareSettings(time=0.5), RATE)
    tare.add(np.zeros(N - 1), NONE)
    before = tare.done
    tare.add(np.concatenate(([0.0], np.full(1000, 1e3))), NONE)
    assert (before, tare.done) == (False, True)
    assert tare.result() == 0.0


def test_tare_uses_at_least_ten_samples() -> None:
    tare = Tare(TareSettings(time=0.5), 1.0)
    tare.add(np.full(9, 4.0), NONE)
    before = tare.done
    tare.add(np.full(1, 4.0), NONE)
    assert (before, tare.done) == (False, True)
    assert tare.result() == 4.0
