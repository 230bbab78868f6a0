# SPDX-License-Identifier: Apache-2.0
"""Simulated measurement: joint states from encoders, and force from a model of a PCB 208C03 on an NI-9230.

    sensor range -> decimation filter -> AC coupling -> noise -> 24 bits over 60 V

The converter oversamples eight times. Its linear-phase filter is flat up to 0.4535 of the sample rate, 100 dB down
from 0.5465, and delays by 38 samples. The converter runs on its own clock.
"""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np

from scara_effmass.sim.rng import normal, uniform
from scara_effmass.values import FloatArray, ForceBlock

if TYPE_CHECKING:
    from scara_effmass.sim.collision_sim import ContactSample

FULL_SCALE = 30.0
"""Range of the converter, positive and negative [V]."""
MAX_COUNT = 2**23 - 1
OVERSAMPLING = 8
FILTER_DELAY = 38
"""Delay of the decimation filter [samples]."""
_TAPS = 2 * FILTER_DELAY * OVERSAMPLING + 1
_KAISER_BETA = 10.06
"""0.1102 (A - 8.7) for A = 100 dB (Kaiser, 1974)."""
_FILTER = np.sinc(np.arange(_TAPS) / OVERSAMPLING - FILTER_DELAY) * np.kaiser(_TAPS, _KAISER_BETA)
_FILTER /= _FILTER.sum()

TARE_S = 0.5
BLOCK_S = 0.1
STAMP_DELAY_S = 0.3e-3
"""Largest constant delay of the stamps of a run: the error of the estimated converter clock."""
STAMP_JITTER_S = 20e-6
"""Largest additional delay of one block."""
FRAME_ID = "force_sensor"
SOURCE = "simulated force: MuJoCo cell, sensor 208C03 on NI-9230, AC coupled"
_NOISE_STREAM, _STAMP_STREAM = 3, 4

POSITION_STEP = np.array([2.0 * math.pi / 2**20, 2.0 * math.pi / 2**20, 1e-6, 2.0 * math.pi / 2**20])
"""Resolution of the simulated encoders [rad, rad, m, rad]."""
VELOCITY_STEP = np.array([1e-4, 1e-4, 1e-5, 1e-4])
"""Resolution of the velocity estimates [rad/s, rad/s, m/s, rad/s]."""


def quantize(q: FloatArray, qd: FloatArray, noise: random.Random) -> tuple[FloatArray, FloatArray]:
    """Return `q` and `qd` (m, 4) in whole encoder counts, read-only, with triangular noise of up to one count."""

    def round_to_counts(values: FloatArray, step: FloatArray) -> FloatArray:
        # Python guarantees the sequence of random() only.
        dither = np.array([noise.random() + noise.random() - 1.0 for _ in range(values.size)]).reshape(values.shape)
        rounded = np.asarray(np.rint(values / step + dither) * step + 0.0)  # + 0.0 turns -0.0 into 0.0
        rounded.flags.writeable = False
        return rounded

    return round_to_counts(q, POSITION_STEP), round_to_counts(qd, VELOCITY_STEP)


def newtons_per_count(sensitivity: float) -> float:
    """Return the resolution [N] of a sensor of `sensitivity` [mV/N] on the converter."""
    return FULL_SCALE * 1e3 / sensitivity / MAX_COUNT


@dataclass(frozen=True, slots=True)
class ForceSensor:
    """Sensor and converter.

    `sample_rate` is nominal [Hz]; with a positive relative `clock_error` the converter samples faster. `sensitivity` is
    in [mV/N], `range` the largest force of either sign [N], `noise` a standard deviation [N], and `corner` the corner
    frequency of the AC coupling [Hz].
    """

    sample_rate: float = 12_800.0
    clock_error: float = 0.0
    sensitivity: float = 2.248
    range: float = 2224.0
    noise: float = 0.1
    corner: float = 0.1
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
    """Convert the contact force to samples, in portions of any length."""

    def __init__(self, sensor: ForceSensor, start_ns: int) -> None:
        """Take sample 0 at `start_ns`, after a long time without force."""
        self.sensor = sensor
        self.start_ns = start_ns
        self.samples = 0
        """Number of samples returned so far."""
        self._fine_rate = sensor.true_rate * OVERSAMPLING
        self._fine = np.zeros(_TAPS - 1)
        self._fine_end = 0
        self._times = [0.0]
        self._forces = [0.0]
        self._mean = 0.0

    def push(self, contact: Sequence[ContactSample], until_ns: int) -> FloatArray:
        """Add the force up to `until_ns`, zero after the last of `contact`; return the new samples (n,) [N]."""
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
        return self._quantize(self._decimate(count)) if count else np.empty(0)

    def _decimate(self, count: int) -> FloatArray:
        """Return the next `count` samples after the decimation filter, and drop the input they used up."""
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
        self._mean = float(mean[-1])
        noise = sensor.noise * normal((sensor.seed, _NOISE_STREAM), self.samples, count)
        counts = np.rint((force - mean + noise) / sensor.step)
        self.samples += count
        return np.asarray(np.clip(counts, -MAX_COUNT, MAX_COUNT) * sensor.step)


def measure_force(
    contact: Sequence[ContactSample], start_ns: int, end_ns: int, sensor: ForceSensor, seed: int
) -> tuple[ForceBlock, ...]:
    """Return the whole force blocks of a run that starts at `start_ns` and lasts `end_ns`.

    The times of the samples in `contact` count from the start of the run, which the tare precedes. `seed` sets the
    errors of the stamps.
    """
    phase, delay, *jitter = uniform((seed, _STAMP_STREAM), 2 + math.ceil(end_ns / 1e9 / BLOCK_S)).tolist()
    length = round(BLOCK_S * sensor.sample_rate)
    tare_samples = round(TARE_S * sensor.sample_rate)
    # The first block starts at a random time within the first 0.1 s of the run.
    adc_start_ns = -round((TARE_S + BLOCK_S + sensor.filter_delay - phase * BLOCK_S) * 1e9)
    samples = Adc(sensor, adc_start_ns).push(contact, end_ns)
    tare = float(samples[:tare_samples].mean())

    def stamp_ns(sample: int, late_s: float) -> int:
        elapsed_ns = round((sample / sensor.true_rate - sensor.filter_delay + late_s) * 1e9)
        return int(start_ns + adc_start_ns + elapsed_ns)

    blocks = []
    for number, block_jitter in enumerate(jitter):
        first = tare_samples + (number + 1) * length
        force = samples[first : first + length] - tare
        if len(force) < length:
            break
        saturated = np.flatnonzero(np.abs(force + tare) >= sensor.saturation).astype(np.uint32)
        force.flags.writeable = saturated.flags.writeable = False
        blocks.append(
            ForceBlock(
                stamp_ns=stamp_ns(first, delay * STAMP_DELAY_S + block_jitter * STAMP_JITTER_S),
                frame_id=FRAME_ID,
                first_sample=first,
                sample_rate=sensor.true_rate,
                force=force,
                saturated_samples=saturated,
                clock_residual=STAMP_DELAY_S + STAMP_JITTER_S,
                filter_delay=sensor.filter_delay,
                source=SOURCE,
                simulated=True,
                tare=tare,
                tare_stamp_ns=stamp_ns(tare_samples, delay * STAMP_DELAY_S),
            )
        )
    return tuple(blocks)
