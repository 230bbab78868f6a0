# SPDX-License-Identifier: Apache-2.0
import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scara_effmass.sim.collision_sim import ContactSample
from scara_effmass.sim.measurement import FILTER_DELAY, Adc, ForceSensor
from scara_effmass.values import FloatArray

RATE = 12_800.0
QUIET = ForceSensor(noise=0.0)
EXACT_RATE = ForceSensor(sample_rate=12_500.0, noise=0.0, corner=0.0)
"""The converter samples every 10 us, the step of the force here, so interpolation adds no error."""
STEP_NS = 10_000


def contact_samples(force: Callable[[FloatArray], FloatArray], seconds: float) -> list[ContactSample]:
    times_ns = np.arange(0, round(seconds * 1e9), STEP_NS)
    forces = force(times_ns / 1e9).tolist()
    return [ContactSample(time_ns, 0.0, f, f) for time_ns, f in zip(times_ns.tolist(), forces, strict=True)]


def convert(sensor: ForceSensor, force: Callable[[FloatArray], FloatArray], seconds: float) -> FloatArray:
    return Adc(sensor, 0).push(contact_samples(force, seconds), round(seconds * 1e9))


def half_sine(onset: float, peak: float, duration: float) -> Callable[[FloatArray], FloatArray]:
    def force(t: FloatArray) -> FloatArray:
        inside = (t >= onset) & (t <= onset + duration)
        return np.where(inside, peak * np.sin(np.pi * (t - onset) / duration), 0.0)

    return force


def response(relative_frequency: float) -> complex:
    """Return the complex gain, without the delay, at a frequency relative to the sample rate."""
    rate = EXACT_RATE.sample_rate
    samples = convert(EXACT_RATE, lambda t: 1000.0 * np.cos(2.0 * np.pi * relative_frequency * rate * t), 0.2)
    numbers = np.arange(len(samples))[4 * FILTER_DELAY :]
    phase = 2.0 * np.pi * relative_frequency * (numbers - FILTER_DELAY)
    waves = np.stack((np.cos(phase), np.sin(phase)), axis=1)
    (real, imaginary), *_ = np.linalg.lstsq(waves, samples[4 * FILTER_DELAY :] / 1000.0, rcond=None)
    return complex(real, imaginary)


@pytest.mark.parametrize("frequency", [0.01, 0.1, 0.2, 0.4, 0.4535])
def test_passband_is_only_delayed(frequency: float) -> None:
    assert abs(response(frequency) - 1.0) < 1e-4


@pytest.mark.parametrize("frequency", [0.5465, 0.7, 0.93, 1.3, 2.4, 3.9])
def test_stopband_is_suppressed(frequency: float) -> None:
    assert abs(response(frequency)) < 3e-5


@pytest.mark.parametrize("duration", [1.28e-3, 2e-3, 4e-3])
@pytest.mark.parametrize("phase", [0.0, 0.3, 0.7])
def test_impact_keeps_peak_and_impulse(duration: float, phase: float) -> None:
    onset = (200 + phase) / RATE
    samples = convert(QUIET, half_sine(onset, 300.0, duration), 0.05)
    index = int(samples.argmax())
    before, top, after = samples[index - 1 : index + 2].tolist()
    bend = before - 2.0 * top + after
    peak = top - (after - before) ** 2 / (8.0 * bend)
    assert peak == pytest.approx(300.0, rel=5e-3)
    seconds = (index - (after - before) / (2.0 * bend) - FILTER_DELAY) / RATE
    assert seconds == pytest.approx(onset + duration / 2.0, abs=10e-6)
    assert samples[150:350].sum() / RATE == pytest.approx(300.0 * duration * 2.0 / math.pi, rel=8e-3)


def test_constant_force_decays_with_the_ac_coupling() -> None:
    samples = convert(QUIET, lambda t: np.full_like(t, 100.0), 1.0)
    after = np.arange(len(samples)) / RATE - FILTER_DELAY / RATE
    assert samples[500:] == pytest.approx(100.0 * np.exp(-2.0 * math.pi * 0.1 * after[500:]), abs=0.05)


def test_samples_are_whole_counts_with_the_set_noise() -> None:
    samples = Adc(ForceSensor(noise=0.2, seed=5), 0).push((), 2_000_000_000)
    step = 60.0 / 2**24 / 2.248e-3
    assert ForceSensor().step == pytest.approx(step, rel=1e-6)
    counts = samples / ForceSensor().step
    assert np.abs(counts - np.rint(counts)).max() < 1e-6
    assert samples.std() == pytest.approx(0.2, rel=0.02)
    assert abs(samples.mean()) < 0.01


def test_force_beyond_the_range_is_clipped() -> None:
    sensor = ForceSensor(noise=0.0)
    samples = convert(sensor, half_sine(0.01, 5000.0, 4e-3), 0.05)
    plateau = samples[(samples > sensor.saturation)]
    assert len(plateau) > 30
    # The filter rings where the sensor clips.
    assert samples.max() < 1.1 * sensor.range


@pytest.mark.parametrize("clock_error", [-50e-6, 0.0, 50e-6])
def test_clock_error_changes_the_number_of_samples(clock_error: float) -> None:
    adc = Adc(ForceSensor(clock_error=clock_error), 0)
    seconds = 100
    for second in range(seconds):
        adc.push((), (second + 1) * 1_000_000_000)
    assert adc.samples == math.floor(seconds * RATE * (1.0 + clock_error)) + 1


FORCE = contact_samples(half_sine(0.005, 300.0, 2e-3), 0.03)
SENSOR = ForceSensor(seed=3)
WHOLE = Adc(SENSOR, 0).push(FORCE, 100_000_000)


@settings(max_examples=50)
@given(st.lists(st.integers(1, len(FORCE)), max_size=10))
def test_samples_do_not_depend_on_the_portions(cuts: list[int]) -> None:
    adc = Adc(SENSOR, 0)
    bounds = sorted({0, *cuts, len(FORCE)})
    parts = [
        adc.push(FORCE[first:end], 100_000_000 if end == len(FORCE) else FORCE[end - 1].time_ns)
        for first, end in pairwise(bounds)
    ]
    assert np.array_equal(np.concatenate(parts), WHOLE)
    assert adc.samples == len(WHOLE) == 1281
