# SPDX-License-Identifier: Apache-2.0
"""Tests of the low-pass filters."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from scara_effmass.daq.lowpass import MAX_TAPS, NEGLIGIBLE, Lowpass, make_lowpass
from scara_effmass.errors import SettingsError
from scara_effmass.settings import FilterKind, FilterSettings
from scara_effmass.values import FloatArray

RATE = 12_800.0
KINDS = ("causal", "zero_phase")

kinds = st.sampled_from(KINDS)
relative_cutoffs = st.floats(0.01, 0.49)
signals = arrays(np.float64, st.integers(1, 300), elements=st.floats(-1e4, 1e4))


def lowpass(kind: FilterKind, cutoff: float = 2000.0, rate: float = RATE) -> Lowpass:
    return make_lowpass(FilterSettings(kind=kind, cutoff=cutoff), rate)


def impulse_response(low: Lowpass, n: int = 20_000) -> FloatArray:
    """Return the impulse response after a long rest."""
    low.reset()
    low(np.zeros(1))
    return low(np.eye(1, n)[0])


def gain_at(response: FloatArray, relative_frequency: float) -> complex:
    n = np.arange(response.size)
    return complex((response * np.exp(-2j * math.pi * relative_frequency * n)).sum())


@given(kinds, relative_cutoffs)
def test_power_is_halved_at_the_cutoff(kind: FilterKind, relative_cutoff: float) -> None:
    response = impulse_response(lowpass(kind, relative_cutoff * RATE))
    assert abs(gain_at(response, relative_cutoff)) ** 2 == pytest.approx(0.5, rel=1e-6)
    assert gain_at(response, 0.0) == pytest.approx(1.0, rel=1e-9)
    gains = [abs(gain_at(response, f)) for f in np.linspace(0.0, 0.5, 30)]
    assert all(after <= before + 1e-4 for before, after in pairwise(gains))


@given(kinds, relative_cutoffs)
def test_ramp_is_late_by_the_stated_delay(kind: FilterKind, relative_cutoff: float) -> None:
    low = lowpass(kind, relative_cutoff * RATE)
    n = 5 * low.memory + 100
    ramp = np.arange(n, dtype=float)
    assert low(ramp)[-10:] == pytest.approx(ramp[-10:] - low.delay, abs=1e-6)


@given(relative_cutoffs)
def test_delay_of_the_butterworth_is_that_of_the_analogue_filter(relative_cutoff: float) -> None:
    # H = 1 / (s² + sqrt(2) s + 1) has the delay sqrt(2) at s = 0; the bilinear transform maps s = j to the cutoff.
    delay = math.sqrt(2.0) / (2.0 * math.tan(math.pi * relative_cutoff))
    assert lowpass("causal", relative_cutoff * RATE).delay == pytest.approx(delay, rel=1e-6)


@given(relative_cutoffs, st.floats(0.0, 0.5))
def test_gaussian_delays_all_frequencies_equally(relative_cutoff: float, frequency: float) -> None:
    low = lowpass("zero_phase", relative_cutoff * RATE)
    response = impulse_response(low, 2 * low.memory)
    shifted_back = gain_at(response, frequency) * np.exp(2j * math.pi * frequency * low.delay)
    assert abs(shifted_back.imag) < 1e-12
    assert low.delay == low.memory / 2
    assert low.delay.is_integer()


@given(relative_cutoffs, signals)
def test_gaussian_does_not_overshoot(relative_cutoff: float, samples: FloatArray) -> None:
    output = lowpass("zero_phase", relative_cutoff * RATE)(samples)
    rounding = 1e-12 * np.abs(samples).max()
    assert output.max() <= samples.max() + rounding
    assert output.min() >= samples.min() - rounding


@given(kinds, relative_cutoffs, signals, st.lists(st.floats(0.0, 1.0), max_size=8))
@example("causal", 0.1, np.sin(np.arange(300.0)), [0.1, 0.11, 0.5, 0.9])
@example("zero_phase", 0.1, np.sin(np.arange(300.0)), [0.1, 0.11, 0.5, 0.9])
def test_size_of_portions_does_not_matter(
    kind: FilterKind, relative_cutoff: float, samples: FloatArray, cuts: list[float]
) -> None:
    low = lowpass(kind, relative_cutoff * RATE)
    whole = low(samples)
    low.reset()
    portions = np.concatenate(
        [low(portion) for portion in np.split(samples, [round(cut * samples.size) for cut in sorted(cuts)])]
    )
    if kind == "causal":
        assert portions.tobytes() == whole.tobytes()
    else:
        assert np.abs(portions - whole).max() <= 1e-14 * np.abs(samples).max()


@given(kinds, relative_cutoffs, st.floats(-1e4, 1e4), st.integers(1, 100))
def test_constant_passes_unchanged(kind: FilterKind, relative_cutoff: float, constant: float, n: int) -> None:
    output = lowpass(kind, relative_cutoff * RATE)(np.full(n, constant))
    assert output == pytest.approx(np.full(n, constant), rel=1e-10)


@given(kinds, relative_cutoffs)
def test_influence_beyond_the_stated_memory_is_negligible(kind: FilterKind, relative_cutoff: float) -> None:
    low = lowpass(kind, relative_cutoff * RATE)
    response = np.abs(impulse_response(low))
    left = response[low.memory + 1 :].sum() / response.sum()
    assert left <= (0.0 if kind == "zero_phase" else 2.0 * NEGLIGIBLE)
    assert response[: low.memory + 1].sum() > 0.0


@pytest.mark.parametrize("kind", KINDS)
def test_reset_filter_equals_a_new_filter(kind: FilterKind) -> None:
    samples = np.random.default_rng(1).normal(size=200)
    low = lowpass(kind)
    fresh = low(samples)
    low(np.full(50, 1e6))
    low.reset()
    assert np.array_equal(low(samples), fresh)


@pytest.mark.parametrize("kind", KINDS)
def test_input_stays_unchanged_and_may_be_read_only(kind: FilterKind) -> None:
    samples = np.arange(100.0)
    samples.flags.writeable = False
    assert lowpass(kind)(samples).shape == (100,)
    assert np.array_equal(samples, np.arange(100.0))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("cutoff", [500.0, 501.0, 1e5])
def test_cutoff_above_half_the_sample_rate_is_refused(kind: FilterKind, cutoff: float) -> None:
    message = f"filter.cutoff = {cutoff:g}: must be below 500 Hz, half of the sample rate"
    with pytest.raises(SettingsError, match=f"^{message}$"):
        lowpass(kind, cutoff, 1000.0)
    lowpass(kind, 499.9, 1000.0)


def test_gaussian_with_too_many_taps_is_refused() -> None:
    with pytest.raises(SettingsError, match=r"^filter.cutoff = 1: must be >= 4 Hz with zero_phase at 12800 Hz; "):
        lowpass("zero_phase", 1.0)
    assert lowpass("zero_phase", 4.0).memory < MAX_TAPS
    assert lowpass("causal", 1.0).delay > 1000.0
