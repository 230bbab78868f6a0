# SPDX-License-Identifier: Apache-2.0
"""The properties of a detected impact agree with closed-form solutions."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from scara_effmass.impacts.load import NO_SIGNAL
from scara_effmass.settings import DetectionSettings
from scara_effmass.values import FloatArray
from test.impacts.conftest import AddPulse, Detect

RATE = 12_800.0
SENSOR_NOISE = 0.022
"""Broadband resolution of a PCB 208C03, standard deviation [N]."""
BENCH_NOISE = 0.1

PHASES = 64
EVERY = 0.7  # s, more than settings.rebound_time


def half_sine(phase: FloatArray) -> FloatArray:
    """Return the force of a linear spring."""
    return np.sin(np.pi * phase)


def hertz(phase: FloatArray) -> FloatArray:
    """Return approximately the force of a Hertz contact: the power 3/2 of its compression."""
    return np.sin(np.pi * phase) ** 1.5


def damped(phase: FloatArray) -> FloatArray:
    """Return a skewed pulse with a steep rise and a slow fall."""
    return np.exp(-phase) * np.sin(np.pi * phase) / 0.6394


class Errors:
    """Relative errors of impacts at all phases of the sampling; that of the onset is in samples."""

    def __init__(
        self,
        detect: Detect,
        add_pulse: AddPulse,
        duration: float,
        peak: float,
        noise: float,
        shape: Callable[[FloatArray], FloatArray] = half_sine,
    ) -> None:
        onsets = np.round((0.4 + EVERY * np.arange(PHASES)) * RATE) + np.arange(PHASES) / PHASES
        force = np.random.default_rng(0).normal(0.0, noise, int((EVERY * PHASES + 0.4) * RATE))
        for onset in onsets:
            around = slice(int(onset) - 10, int(onset + duration * RATE) + 10)
            add_pulse(force[around], onset - around.start, duration, peak, shape=shape)
        impacts, detector = detect(force)
        assert len(impacts) == PHASES
        assert (detector.dropouts, detector.glitches, detector.sustained_contacts) == (0, 0, 0)
        assert not any(impact.incomplete or impact.clipped or impact.rebound for impact in impacts)
        phase = np.linspace(0.0, 1.0, 100_001)
        area = float(np.mean(shape(phase)))
        self.peak = np.array([impact.peak_force for impact in impacts]) / (peak * shape(phase).max()) - 1.0
        self.onset = np.array([impact.onset_sample for impact in impacts]) - onsets
        self.duration = np.array([impact.duration for impact in impacts]) / duration - 1.0
        self.impulse = np.array([impact.impulse for impact in impacts]) / (peak * area * duration) - 1.0


@pytest.mark.parametrize("duration", [0.5e-3, 0.7e-3, 1e-3, 2e-3, 4e-3, 20e-3, 100e-3])
@pytest.mark.parametrize(("peak", "noise"), [(20.0, 0.0), (800.0, 0.0), (50.0, SENSOR_NOISE), (150.0, BENCH_NOISE)])
def test_half_sines(detect: Detect, add_pulse: AddPulse, duration: float, peak: float, noise: float) -> None:
    """Peak within 0.5 % at all phases.

    With noise, of a peak that is 1500 times the noise or more: the largest of many noisy samples is above the peak.
    """
    errors = Errors(detect, add_pulse, duration, peak, noise)
    assert np.abs(errors.peak).max() < 0.005
    assert np.abs(errors.onset).max() < max(0.5, 0.006 * duration * RATE)
    assert np.abs(errors.duration).max() * duration * RATE < max(0.6, 0.01 * duration * RATE)
    assert np.abs(errors.impulse).max() < (0.025 if duration < 1e-3 else 0.006)


@pytest.mark.parametrize("duration", [1e-3, 4e-3, 20e-3])
@pytest.mark.parametrize("shape", [hertz, damped])
@pytest.mark.parametrize(("peak", "noise"), [(50.0, SENSOR_NOISE), (150.0, BENCH_NOISE)])
def test_other_shapes(
    detect: Detect,
    add_pulse: AddPulse,
    duration: float,
    shape: Callable[[FloatArray], FloatArray],
    peak: float,
    noise: float,
) -> None:
    errors = Errors(detect, add_pulse, duration, peak, noise, shape)
    assert np.abs(errors.peak).max() < 0.005
    assert np.abs(errors.impulse).max() < 0.01
    # A Hertz contact begins gently: the straight flank leaves the baseline 3 % of the duration after it.
    assert np.abs(errors.onset).max() < max(0.5, 0.04 * duration * RATE)
    assert np.abs(errors.duration).max() < 0.07


def test_a_damped_oscillator(detect: Detect) -> None:
    """For an integrated mass on a spring and damper, the impulse is the change of momentum while the force pushes."""
    mass, stiffness, damping, speed = 0.5, 4e5, 90.0, 0.25

    def motion(_: float, state: FloatArray) -> FloatArray:
        return np.array([state[1], -(stiffness * state[0] + damping * state[1]) / mass])

    time = np.arange(400) / RATE
    solution = solve_ivp(motion, (0.0, time[-1]), [0.0, speed], t_eval=time, rtol=1e-9, atol=1e-12)
    push = stiffness * solution.y[0] + damping * solution.y[1]
    released = int(np.argmax(push < 0.0))
    force = np.zeros(20_000)
    force[10_000 : 10_000 + released] = push[:released]
    (impact,), _ = detect(force)
    assert impact.peak_force == pytest.approx(push.max(), rel=0.002)
    assert impact.impulse == pytest.approx(mass * (speed - solution.y[1][released]), rel=0.02)
    assert impact.onset_sample == pytest.approx(10_000, abs=2.0)  # a damper's force begins with a step


def test_an_impact_is_reported_in_full(detect: Detect, add_pulse: AddPulse) -> None:
    force = np.random.default_rng(0).normal(30.0, BENCH_NOISE, 30_000)
    add_pulse(force, 20_000.4, 4e-3, 100.0)
    (impact,), detector = detect(force, tare=28.0, cuts=range(0, 30_000, 1280))
    assert detector.dropouts == detector.glitches == detector.sustained_contacts == 0
    assert impact.baseline == pytest.approx(2.0, abs=0.03)
    assert impact.noise == pytest.approx(BENCH_NOISE, rel=0.15)
    assert impact.stamp_ns == pytest.approx(1_700_000_000_123_456_789 + impact.onset_sample / RATE * 1e9, abs=2_000)
    assert (impact.frame_id, impact.source, impact.clock_residual, impact.simulated) == (
        "force_sensor",
        "generated by the test",
        2e-5,
        True,
    )


def test_rebounds_are_told_apart(detect: Detect, add_pulse: AddPulse) -> None:
    force = np.random.default_rng(0).normal(0.0, SENSOR_NOISE, 40_000)
    onsets = [5_000, 5_000 + 60, 5_600, 8_000, 8_000 + 6_600]
    peaks = [100.0, 40.0, 30.0, 12.0, 9.0]
    for onset, peak in zip(onsets, peaks, strict=True):
        add_pulse(force, onset, 4e-3, peak)
    impacts, _ = detect(force)
    assert [impact.rebound for impact in impacts] == [0, 1, 2, 3, 0]
    assert [impact.onset_sample for impact in impacts] == pytest.approx(onsets, abs=1.0)
    assert [impact.peak_force for impact in impacts] == pytest.approx(peaks, rel=0.01)


@given(st.integers(0, 600), st.integers(4, 40))
def test_an_impact_in_the_first_moment_is_found(detect: Detect, add_pulse: AddPulse, onset: int, samples: int) -> None:
    force = np.random.default_rng(0).normal(0.0, SENSOR_NOISE, 10_000)
    add_pulse(force, onset, samples / RATE, 100.0)
    (impact,), _ = detect(force)
    assert impact.peak_force == pytest.approx(100.0, rel=0.2 if samples < 8 else 0.01)
    assert impact.incomplete == (onset == 0 and force[0] > 2.5)


@given(st.integers(1, 50))
def test_an_impact_cut_by_the_beginning_or_the_end_is_incomplete(
    detect: Detect, add_pulse: AddPulse, inside: int
) -> None:
    force = np.random.default_rng(0).normal(0.0, SENSOR_NOISE, 10_000)
    add_pulse(force, inside - 51, 51 / RATE, 100.0)
    for signal in (force, force[::-1]):
        impacts, _ = detect(signal)
        assert len(impacts) == (1 if inside > 3 else len(impacts))
        assert all(impact.incomplete for impact in impacts)
        assert all(impact.peak_force <= 100.2 for impact in impacts)


def test_a_clipped_impact(detect: Detect, add_pulse: AddPulse) -> None:
    force = np.random.default_rng(0).normal(0.0, BENCH_NOISE, 40_000)
    add_pulse(force, 20_000, 10e-3, 3_000.0)
    saturated = np.flatnonzero(force >= 2224.0)
    force[saturated] = 2224.0
    (impact,), detector = detect(force, cuts=[20_064], saturated=saturated.tolist())
    assert impact.clipped
    assert not impact.incomplete
    assert impact.peak_force == pytest.approx(2224.0, abs=0.1)
    assert impact.duration == pytest.approx(10e-3, rel=0.02)
    assert detector.dropouts == 0
    (unmarked,), detector = detect(force)
    assert unmarked.incomplete
    assert unmarked.peak_force <= 2224.1
    assert detector.dropouts == 1


@pytest.mark.parametrize("level", [None, 0.0, -2224.0])
@pytest.mark.parametrize("first", [0, 12_800])
def test_a_sensor_that_is_open_for_two_times_counts_twice(
    detect: Detect, add_pulse: AddPulse, level: float | None, first: int
) -> None:
    force = np.random.default_rng(0).normal(0.0, BENCH_NOISE, 80_000)
    marks = np.r_[first : first + 6_400, 51_200:57_600]
    if level is not None:
        force[marks] = level
    add_pulse(force, 40_000, 10e-3, 100.0)
    (impact,), detector = detect(force, cuts=range(0, 80_000, 999), saturated=marks.tolist())
    assert not impact.clipped
    (left_out,) = (item for item in detector.left_out if item.reason == NO_SIGNAL)
    assert (left_out.occurrences, left_out.size_text) == (2, "force not known")


@pytest.mark.parametrize("rate", [20.0, 33.3, 100.0])
def test_a_coarse_load_cell(detect: Detect, add_pulse: AddPulse, rate: float) -> None:
    step = 0.03
    generator = np.random.default_rng(0)
    for onset in generator.uniform(50.0, 70.0, 20):
        force = generator.normal(0.0, 0.015, 100)
        add_pulse(force, onset, 0.3, 5.0, rate)
        (impact,), detector = detect(
            np.round(force / step) * step, rate, settings=DetectionSettings(threshold=0.5, longest=2.0)
        )
        assert not impact.incomplete
        assert detector.dropouts == detector.glitches == 0
        assert impact.impulse == pytest.approx(5.0 * 0.3 * 2.0 / np.pi, rel=0.06)
        assert impact.peak_force == pytest.approx(5.0, rel=0.05)
