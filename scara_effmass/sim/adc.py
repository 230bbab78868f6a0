"""Force sensor and analogue-to-digital converter: a model of a PCB 208C03 on an NI-9230.

    sensor range -> decimation filter -> AC coupling -> noise -> 24 bits over 60 V

The converter oversamples eight times. Its linear-phase filter is flat up to 0.4535 of the sample rate, 100 dB down
from 0.5465, and delays by 38 samples. The converter runs on its own clock.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np

from scara_effmass.sim.rng import normal
from scara_effmass.values import FloatArray

if TYPE_CHECKING:
    from scara_effmass.sim.collision_sim import ContactSample

FULL_SCALE = 30.0
"""Range of the converter, of either sign [V]."""
MAX_COUNT = 2**23 - 1
OVERSAMPLING = 8
FILTER_DELAY = 38
"""Delay of the decimation filter [samples]."""
_TAPS = 2 * FILTER_DELAY * OVERSAMPLING + 1
_KAISER_BETA = 10.06
"""0.1102 (A - 8.7) for A = 100 dB (Kaiser, 1974)."""
_NOISE_STREAM = 3


def newtons_per_count(sensitivity: float) -> float:
    """Return the resolution [N] of a sensor of `sensitivity` [mV/N] on the converter."""
    return FULL_SCALE * 1e3 / sensitivity / MAX_COUNT


@dataclass(frozen=True, slots=True)
class ForceSensor:
    """Sensor and converter."""

    sample_rate: float = 12_800.0
    """nominal [Hz]"""
    clock_error: float = 0.0
    """relative; positive: more samples than nominal"""
    sensitivity: float = 2.248
    """[mV/N]"""
    range: float = 2224.0
    """of either sign [N]"""
    noise: float = 0.1
    """standard deviation [N]"""
    corner: float = 0.1
    """of the AC coupling [Hz]"""
    seed: int = 0

    @property
    def step(self) -> float:
        """Resolution [N]."""
        return newtons_per_count(self.sensitivity)

    @property
    def saturation(self) -> float:
        """Force from which a sample counts as saturated [N]: 1 % below the range, as the AC coupling decays."""
        return self.range * (1.0 - 1e-2)

    @property
    def true_rate(self) -> float:
        """Samples per second of true time [Hz]."""
        return self.sample_rate * (1.0 + self.clock_error)

    @property
    def filter_delay(self) -> float:
        """Delay from the force to its sample [s]."""
        return FILTER_DELAY / self.true_rate


FORCE_SENSOR = ForceSensor()


@final
class Adc:
    """Converts the contact force to samples, in portions of any length."""

    def __init__(self, sensor: ForceSensor, start_ns: int) -> None:
        """Take sample 0 at `start_ns`, after a long time without force."""
        self.sensor = sensor
        self.start_ns = start_ns
        self.samples = 0
        """number of samples returned so far"""
        self._fine_rate = sensor.true_rate * OVERSAMPLING
        self._fine = np.zeros(_TAPS - 1)
        self._fine_end = 0
        self._times = [0.0]
        self._forces = [0.0]
        self._mean = 0.0

    def push(self, contact: Sequence[ContactSample], until_ns: int) -> FloatArray:
        """Add the force up to `until_ns`, zero after the last of `contact`; return the samples (n,) [N] due."""
        self._times += [(sample.time_ns - self.start_ns) / 1e9 for sample in contact]
        self._forces += [sample.measured for sample in contact]
        if not contact or contact[-1].time_ns < until_ns:
            self._times.append((until_ns - self.start_ns) / 1e9)
            self._forces.append(0.0)
        end = math.floor(self._times[-1] * self._fine_rate) + 1
        times = np.arange(self._fine_end, end) / self._fine_rate
        sensed = np.clip(np.interp(times, self._times, self._forces), -self.sensor.range, self.sensor.range)
        self._times, self._forces = self._times[-1:], self._forces[-1:]
        self._fine = np.concatenate((self._fine, sensed))
        self._fine_end = max(end, self._fine_end)
        count = max(0, (self._fine_end - 1) // OVERSAMPLING + 1 - self.samples)
        return self._quantize(self._decimate(count))

    def _decimate(self, count: int) -> FloatArray:
        """Return the next `count` samples after the decimation filter, and drop the input they used up."""
        if not count:
            return np.empty(0)
        consumed = OVERSAMPLING * count
        windows = np.lib.stride_tricks.sliding_window_view(self._fine, _TAPS)[:consumed:OVERSAMPLING]
        filtered = windows @ _FILTER if self._fine.any() else np.zeros(count)
        self._fine = self._fine[consumed:]
        return filtered

    def _quantize(self, force: FloatArray) -> FloatArray:
        """Return `force` (n,) [N] with AC coupling and noise, in whole counts."""
        sensor = self.sensor
        count = len(force)
        keep = math.exp(-2.0 * math.pi * sensor.corner / sensor.sample_rate)
        kept = keep ** np.arange(1, count + 1)
        mean = kept * (self._mean + (1.0 - keep) * np.cumsum(force / kept))
        self._mean = float(mean[-1]) if count else self._mean
        noise = sensor.noise * normal((sensor.seed, _NOISE_STREAM), self.samples, count)
        counts = np.rint((force - mean + noise) / sensor.step)
        self.samples += count
        return np.asarray(np.clip(counts, -MAX_COUNT, MAX_COUNT) * sensor.step)


def _decimation_filter() -> FloatArray:
    at = np.arange(_TAPS) / OVERSAMPLING - FILTER_DELAY
    taps = np.sinc(at) * np.kaiser(_TAPS, _KAISER_BETA)
    return np.asarray(taps / taps.sum())


_FILTER = _decimation_filter()
