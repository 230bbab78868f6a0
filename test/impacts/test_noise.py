# SPDX-License-Identifier: Apache-2.0
"""Noise is not reported as an impact."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import lfilter

from scara_effmass.impacts.detector import Detector
from scara_effmass.impacts.load import IN_NOISE
from scara_effmass.settings import DetectionSettings
from scara_effmass.values import FloatArray
from test.impacts.conftest import START_NS, AddPulse, Detect, MakeBlock

RATE = 12_800.0
HOUR = 46_080_000
CHUNK = 1_280_000
SENSOR_NOISE = 0.022


def test_an_hour_at_the_floor_of_the_sensor(make_block: MakeBlock) -> None:
    """This also holds for the lowest threshold that the noise allows."""
    generator = np.random.default_rng(1)
    detector = Detector(DetectionSettings(threshold=0.1))
    for first in range(0, HOUR, CHUNK):
        force = generator.standard_normal(CHUNK)
        force *= SENSOR_NOISE
        assert detector.feed(make_block(force, first)) == []
    assert detector.finish() == []
    assert (detector.dropouts, detector.glitches, detector.sustained_contacts) == (0, 0, 0)


def hum(generator: np.random.Generator, time: FloatArray) -> FloatArray:
    return generator.normal(0.0, 0.1, time.size) + 20.0 * np.sin(2.0 * np.pi * 50.0 * time)


def white(generator: np.random.Generator, time: FloatArray) -> FloatArray:
    return generator.normal(0.0, 20.0, time.size)


def heavy_tails(generator: np.random.Generator, time: FloatArray) -> FloatArray:
    return 0.1 * generator.standard_t(3.0, time.size)


def pink(generator: np.random.Generator, time: FloatArray) -> FloatArray:
    """Return 1/f noise from a filter with three poles (Kellet's economy method)."""
    white = generator.normal(0.0, 0.5, time.size)
    poles = [(0.99765, 0.0990460), (0.96300, 0.2965164), (0.57000, 1.0526913)]
    return np.asarray(sum(lfilter([gain], [1.0, -pole], white) for pole, gain in poles) + 0.1848 * white)


def drift(generator: np.random.Generator, time: FloatArray) -> FloatArray:
    return generator.normal(0.0, 0.1, time.size) + 50.0 * np.sin(2.0 * np.pi * 0.05 * time)


def converter(generator: np.random.Generator, time: FloatArray) -> FloatArray:
    """Return noise quantized like that of a 24-bit converter with a range of 60 V, at 2.248 mV/N."""
    step = 60.0 / 2**24 / 2.248e-3
    return np.round(generator.normal(0.0, SENSOR_NOISE, time.size) / step) * step


def coarse(generator: np.random.Generator, time: FloatArray) -> FloatArray:
    return np.round(generator.normal(0.0, 0.5, time.size))


@pytest.mark.parametrize("kind", [hum, heavy_tails, pink, drift, converter, coarse])
def test_other_noise(
    detect: Detect, add_pulse: AddPulse, kind: Callable[[np.random.Generator, FloatArray], FloatArray]
) -> None:
    """A minute of noise gives no impact, and an impact well above the noise is found."""
    force = kind(np.random.default_rng(0), np.arange(int(60 * RATE)) / RATE)
    impacts, detector = detect(force)
    assert impacts == []
    assert (detector.dropouts, detector.sustained_contacts) == (0, 0)
    add_pulse(force[600_000:601_000], 100.0, 4e-3, 500.0)
    (impact,), _ = detect(force)
    assert impact.peak_force == pytest.approx(500.0, rel=0.05)


def test_noise_that_sets_in_is_learnt(detect: Detect, add_pulse: AddPulse) -> None:
    generator = np.random.default_rng(0)
    force = generator.normal(0.0, 0.1, 200_000)
    force[100_000:] += generator.normal(0.0, 2.0, 100_000)
    add_pulse(force, 180_000, 4e-3, 100.0)
    (impact,), _ = detect(force)
    assert impact.onset_sample == pytest.approx(180_000, abs=5)
    assert impact.noise == pytest.approx(2.0, rel=0.15)


def test_contacts_do_not_enter_the_noise(detect: Detect, add_pulse: AddPulse) -> None:
    generator = np.random.default_rng(0)
    force = generator.normal(0.0, 0.1, 200_000)
    quiet = force.copy()
    for onset in range(8_000, 190_000, 4_000):
        add_pulse(force, onset, 30e-3, 200.0)
    add_pulse(quiet, 188_000, 30e-3, 200.0)
    often, once = detect(force).impacts, detect(quiet).impacts[0]
    assert len(often) == 46
    for impact in often:
        assert impact.noise == pytest.approx(once.noise, rel=0.2)
        assert impact.baseline == pytest.approx(0.0, abs=0.03)


@pytest.mark.parametrize(("resolution", "drift"), [(0.5, 0.3), (1.0, 0.3), (1.0, 1.0), (2.0, 0.3)])
def test_a_drifting_zero_of_a_quiet_coarse_sensor_is_not_stuck(
    detect: Detect, add_pulse: AddPulse, resolution: float, drift: float
) -> None:
    for seed in range(3):
        generator = np.random.default_rng(seed)
        force = drift * np.arange(80_000) / 5000.0 + generator.normal(0.0, 0.05, 80_000) + generator.uniform(0.0, 1.0)
        add_pulse(force, 70_000.0, 14e-3, 283.0, rate=5000.0)
        (impact,), detector = detect(resolution * np.round(force / resolution), 5000.0)
        assert impact.peak_force == pytest.approx(283.0, abs=resolution)
        assert (impact.incomplete, detector.dropouts) == (False, 0)


@pytest.mark.parametrize("kind", [hum, white])
def test_force_that_noise_hides_is_counted(
    detect: Detect, add_pulse: AddPulse, kind: Callable[[np.random.Generator, FloatArray], FloatArray]
) -> None:
    """Noise of 20 N raises the threshold to 160 N."""
    force = kind(np.random.default_rng(0), np.arange(int(6 * RATE)) / RATE)
    add_pulse(force[40_000:41_000], 100.0, 10e-3, 70.0)
    largest = float(force[40_000:41_000].max())
    impacts, detector = detect(force)
    assert impacts == []
    (hidden,) = [item for item in detector.left_out if item.reason == IN_NOISE]
    assert hidden.occurrences == 1
    assert (hidden.stamp_ns - START_NS) / 1e9 == pytest.approx(40_000 / RATE, abs=0.1)
    assert hidden.peak_force == pytest.approx(largest, abs=6.0)
