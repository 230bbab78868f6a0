# SPDX-License-Identifier: Apache-2.0
"""Tensile pulses are counted, but not those that are the response to a compression."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from scara_effmass.settings import DetectionSettings
from scara_effmass.values import FloatArray
from test.impacts.conftest import AddPulse, Detect

RATE = 12_800.0
SIZE = 150_000
ONSETS = (40_000, 70_000.4, 110_000.7)


@pytest.fixture
def noise() -> FloatArray:
    """Return ten seconds without contact."""
    return np.random.default_rng(0).normal(0.0, 0.05, SIZE)


@pytest.mark.parametrize("duration", [1e-3, 4e-3, 50e-3, 0.2])
def test_impacts_of_the_wrong_sign_are_counted(
    detect: Detect, add_pulse: AddPulse, noise: FloatArray, duration: float
) -> None:
    for onset in ONSETS:
        add_pulse(noise, onset, duration, -100.0)
    impacts, detector = detect(noise)
    assert (len(impacts), detector.tensile_pulses) == (0, 3)
    assert (detector.dropouts, detector.glitches, detector.sustained_contacts) == (0, 0, 0)
    impacts, detector = detect(-noise)
    assert (len(impacts), detector.tensile_pulses) == (3, 0)


@settings(max_examples=20)
@given(st.lists(st.integers(1, SIZE - 1), max_size=30))
def test_blocks_make_no_difference(detect: Detect, add_pulse: AddPulse, cuts: list[int]) -> None:
    force = np.random.default_rng(0).normal(0.0, 0.05, SIZE)
    for onset in range(20_000, 140_000, 7_000):
        add_pulse(force, onset, 10e-3, -100.0)
    assert detect(force, cuts=cuts).detector.tensile_pulses == 18


def test_in_a_train_that_is_divided_each_counts_once(detect: Detect, add_pulse: AddPulse, noise: FloatArray) -> None:
    onsets = range(30_000, 90_000, 500)
    for onset in onsets:
        add_pulse(noise, onset, 10e-3, -100.0)
    assert detect(noise).detector.tensile_pulses == len(onsets)


@pytest.mark.parametrize("cutoff", [0.1, 0.5])
@pytest.mark.parametrize("duration", [5e-3, 50e-3, 0.2])
def test_the_undershoot_of_an_impact_is_no_wrong_sign(
    detect: Detect, add_pulse: AddPulse, noise: FloatArray, cutoff: float, duration: float
) -> None:
    """AC coupling is a first-order high-pass filter: the areas above and below the baseline are equal."""
    force = np.zeros(SIZE)
    for onset in ONSETS:
        add_pulse(force, onset, duration, 1_500.0)
    gain = 1.0 / (1.0 + 2.0 * np.pi * cutoff / RATE)
    coupled = lfilter([gain, -gain], [1.0, -gain], force) + noise
    impacts, detector = detect(coupled)
    assert (len(impacts), detector.tensile_pulses) == (3, 0)
    if duration * cutoff > 0.02:
        assert coupled.min() < -50.0  # it could have been taken for one


@pytest.mark.parametrize("frequency", [100.0, 700.0, 2_000.0])
@pytest.mark.parametrize("damping", [0.01, 0.05, 0.2])
def test_ringing_is_no_wrong_sign(
    detect: Detect, add_pulse: AddPulse, noise: FloatArray, frequency: float, damping: float
) -> None:
    rate = 2.0 * np.pi * frequency
    for onset in (40_000, 110_000):
        add_pulse(noise, onset, 4e-3, 300.0)
        time = np.arange(SIZE - onset - 51) / RATE
        noise[onset + 51 :] -= 150.0 * np.sin(rate * time) * np.exp(-damping * rate * time)
    impacts, detector = detect(noise)
    assert len(impacts) >= 2
    assert detector.tensile_pulses == 0


@pytest.mark.parametrize(("after", "negative"), [(0.3, 0), (0.7, 1)])
def test_what_comes_soon_after_an_impact_is_its_answer(
    detect: Detect, add_pulse: AddPulse, noise: FloatArray, after: float, negative: int
) -> None:
    add_pulse(noise, 40_000, 4e-3, 100.0)
    add_pulse(noise, 40_000 + after * RATE, 4e-3, -100.0)
    impacts, detector = detect(noise)
    assert (len(impacts), detector.tensile_pulses) == (1, negative)


@pytest.mark.parametrize(("pause", "negative"), [(0.005, 0), (0.49, 0), (0.51, 1)])
def test_response_time_counts_from_the_end_of_a_long_contact(
    detect: Detect, add_pulse: AddPulse, noise: FloatArray, pause: float, negative: int
) -> None:
    """The contact and a tensile pulse soon after it are in one segment."""
    add_pulse(noise, 40_000, 0.3, 100.0)
    add_pulse(noise, 40_000 + (0.3 + pause) * RATE, 4e-3, -100.0)
    impacts, detector = detect(noise)
    assert (len(impacts), detector.tensile_pulses) == (1, negative)


def test_a_contact_after_it_excuses_none(detect: Detect, add_pulse: AddPulse, noise: FloatArray) -> None:
    add_pulse(noise, 40_000, 4e-3, -100.0)
    add_pulse(noise, 40_200, 4e-3, 50.0)
    impacts, detector = detect(noise)
    assert (len(impacts), detector.tensile_pulses) == (1, 1)


def test_a_push_of_the_wrong_sign_is_no_impact_of_it(detect: Detect, add_pulse: AddPulse, noise: FloatArray) -> None:
    add_pulse(noise, 40_000, 0.1, -100.0)
    assert detect(noise, settings=DetectionSettings(longest=0.05)).detector.tensile_pulses == 0
    assert detect(noise, settings=DetectionSettings(longest=0.15)).detector.tensile_pulses == 1


def test_a_load_that_goes_is_no_wrong_sign(detect: Detect, noise: FloatArray) -> None:
    noise[:60_000] += 40.0
    noise[100_000:] -= 40.0
    impacts, detector = detect(noise)
    assert (impacts, detector.tensile_pulses) == ([], 0)


@pytest.mark.parametrize("pause", [0.002, 0.005, 0.01, 0.02, 0.04, 0.1, 0.4])
def test_a_contact_after_a_released_load_is_complete_only_with_its_peak(
    detect: Detect, add_pulse: AddPulse, noise: FloatArray, pause: float
) -> None:
    """The baseline before the contact includes the load."""
    noise[:60_000] += 60.0
    add_pulse(noise, 60_000 + pause * RATE, 3e-3, 100.0)
    (impact,) = detect(noise).impacts
    assert impact.incomplete or impact.peak_force == pytest.approx(100.0, rel=0.01)
