"""From the force in the cell to samples: a quartz sensor of the type 208C03 on an NI-9230, imagined.

    clip at the sensor's range -> decimation filter -> AC coupling -> noise -> 24 bits over 60 V

The converter samples eight times as fast as its rate and has a filter of linear phase: flat to 0.4535 of the rate,
100 dB down from 0.5465 on, its delay 38 samples. Its clock is its own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np

from scara_effmass.sim.force import FULL_SCALE, LARGEST_COUNT
from scara_effmass.sim.rng import normal

if TYPE_CHECKING:
    from collections.abc import Sequence

    from scara_effmass.sim.collision_sim import ContactSample
    from scara_effmass.values import FloatArray

OVERSAMPLING = 8
FILTER_DELAY = 38
"""Of the decimation filter [samples]."""
_TAPS = 2 * FILTER_DELAY * OVERSAMPLING + 1
_KAISER_BETA = 10.06
"""0.1102 (A - 8.7) for A = 100 dB (Kaiser, 1974)."""
_NOISE = 3
"""This stream of the seed."""


@dataclass(frozen=True, slots=True)
class ForceSensor:
    """Sensor and converter."""

    sample_rate: float = 12_800.0
    """nominal [Hz]"""
    clock_error: float = 0.0
    """relative; positive: it takes more samples"""
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
        """What one count is [N]."""
        return FULL_SCALE * 1e3 / self.sensitivity / LARGEST_COUNT

    @property
    def saturation(self) -> float:
        """From this force on, a sample is at the end of the range [N]; the coupling lets a plateau sink meanwhile."""
        return self.range * (1.0 - 1e-2)

    @property
    def true_rate(self) -> float:
        """Samples per second of true time [Hz]."""
        return self.sample_rate * (1.0 + self.clock_error)

    @property
    def filter_delay(self) -> float:
        """From the force to its sample [s]."""
        return FILTER_DELAY / self.true_rate


FORCE_SENSOR = ForceSensor()


@final
class Converter:
    """Takes in the force as it goes on and gives out samples when they are due."""

    def __init__(self, sensor: ForceSensor, start_ns: int) -> None:
        """Take sample 0 at `start_ns`, when nothing has pressed on the sensor for long."""
        self.sensor = sensor
        self.start_ns = start_ns
        self.samples = 0
        """given out so far"""
        self._fine_rate = sensor.true_rate * OVERSAMPLING
        self._fine = np.zeros(_TAPS - 1)
        self._fine_end = 0
        self._times = [0.0]
        self._forces = [0.0]
        self._mean = 0.0

    def push(self, touches: Sequence[ContactSample], until_ns: int) -> FloatArray:
        """Take in the force up to `until_ns`, zero after the last of `touches`; return the samples (n,) [N] due."""
        self._times += [(touch.time_ns - self.start_ns) / 1e9 for touch in touches]
        self._forces += [touch.measured for touch in touches]
        if not touches or touches[-1].time_ns < until_ns:
            self._times.append((until_ns - self.start_ns) / 1e9)
            self._forces.append(0.0)
        end = math.floor(self._times[-1] * self._fine_rate) + 1
        times = np.arange(self._fine_end, end) / self._fine_rate
        felt = np.clip(np.interp(times, self._times, self._forces), -self.sensor.range, self.sensor.range)
        self._times, self._forces = self._times[-1:], self._forces[-1:]
        self._fine = np.concatenate((self._fine, felt))
        self._fine_end = max(end, self._fine_end)
        count = max(0, (self._fine_end - 1) // OVERSAMPLING + 1 - self.samples)
        return self._converted(self._filtered(count))

    def _filtered(self, count: int) -> FloatArray:
        """Return the next `count` samples behind the decimation filter, and forget what is behind them."""
        if not count:
            return np.empty(0)
        used = OVERSAMPLING * count
        windows = np.lib.stride_tricks.sliding_window_view(self._fine, _TAPS)[:used:OVERSAMPLING]
        filtered = windows @ _FILTER if self._fine.any() else np.zeros(count)
        self._fine = self._fine[used:]
        return filtered

    def _converted(self, force: FloatArray) -> FloatArray:
        """Return the samples of `force` (n,) without its mean over the past, with noise, in whole counts [N]."""
        sensor = self.sensor
        count = len(force)
        keep = math.exp(-2.0 * math.pi * sensor.corner / sensor.sample_rate)
        kept = keep ** np.arange(1, count + 1)
        mean = kept * (self._mean + (1.0 - keep) * np.cumsum(force / kept))
        self._mean = float(mean[-1]) if count else self._mean
        noise = sensor.noise * normal((sensor.seed, _NOISE), self.samples, count)
        counts = np.rint((force - mean + noise) / sensor.step)
        self.samples += count
        return np.asarray(np.clip(counts, -LARGEST_COUNT, LARGEST_COUNT) * sensor.step)


def _decimation_filter() -> FloatArray:
    at = np.arange(_TAPS) / OVERSAMPLING - FILTER_DELAY
    taps = np.sinc(at) * np.kaiser(_TAPS, _KAISER_BETA)
    return np.asarray(taps / taps.sum())


_FILTER = _decimation_filter()
