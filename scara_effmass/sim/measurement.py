# SPDX-License-Identifier: Apache-2.0
"""Simulated measurement: joint states from encoders, and force from a model of a PCB 208C03 on an NI-9230.

    sensor range -> decimation filter -> AC coupling -> noise -> 24 bits over 60 V

The converter oversamples eight times. Its linear-phase filter is flat up to 0.4535 of the sample rate, 100 dB down
from 0.5465, and delays by 38 samples. The converter runs on its own clock.

`SyntheticSignal` is not computed from any motion: noise and half-sine pulses in counts of the converter.

Random numbers do not change with the numpy version: they use the raw bits of PCG64, which numpy keeps stable; its
distributions may change.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple, final

import numpy as np
from numpy.random import PCG64

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

POSITION_STEP = np.array([2.0 * math.pi / 2**20, 2.0 * math.pi / 2**20, 1e-6, 2.0 * math.pi / 2**20])
"""Resolution of the simulated encoders [rad, rad, m, rad]."""
TORQUE_STEP = np.array([0.01, 0.01, 0.01, 0.001])
"""Resolution of the joint torques [N m, N]."""
VELOCITY_STEP = np.array([1e-4, 1e-4, 1e-5, 1e-4])
"""Resolution of the velocity estimates [rad/s, rad/s, m/s, rad/s]."""

NOISE_SAMPLES = 2**21
"""Period of the noise: 164 s at 12.8 kS/s, 16 s at 128 kS/s; 17 MB, for any number of channels."""
CHANNEL_SPACING = NOISE_SAMPLES // 8
"""Offset between the noise of consecutive channels."""
_SYNTHETIC_CHUNK = 2**16

PEAKS = (20.0, 800.0)
"""Range of random peak forces [N], log-uniform."""
DURATIONS = (0.5e-3, 4.0e-3)
"""Range of random durations [s], uniform."""
REBOUND_SHARE = 0.2
"""Share of random pulses with a rebound."""
REBOUND_PEAKS = (0.3, 0.6)
"""Range of the ratio of a rebound's peak to the first peak."""
REBOUND_GAPS = (0.01, 0.03)
"""Range of the time from the end of the first contact to the rebound [s]."""

_SYNTHETIC_STREAM, _PULSE_STREAM, _NOISE_STREAM, _STAMP_STREAM = 1, 2, 3, 4
"""Keys of random numbers."""
_NORMAL_CHUNK = 4096


def uniform(key: tuple[int, ...], count: int) -> FloatArray:
    """Return the first `count` numbers in [0, 1) of the stream `key`, with 53 random bits each."""
    return _next_uniform(PCG64(list(key)), count)


def _next_normal(bits: PCG64, count: int) -> FloatArray:
    """Return `count` standard normal numbers from the next bits of a stream (Box-Muller); `count` is even."""
    radius, angle = _next_uniform(bits, count).reshape(2, -1)
    radius = np.sqrt(-2.0 * np.log1p(-radius))
    return np.concatenate((radius * np.cos(2.0 * np.pi * angle), radius * np.sin(2.0 * np.pi * angle)))


def normal(key: tuple[int, ...], first: int, count: int) -> FloatArray:
    """Return `count` standard normal numbers of the endless stream `key`, from number `first` on.

    Any part of the stream can be requested, in any order.
    """
    chunks = range(first // _NORMAL_CHUNK, (first + count - 1) // _NORMAL_CHUNK + 1)
    joined = np.concatenate([np.empty(0), *(_normal_chunk(key, chunk) for chunk in chunks)])
    return joined[first % _NORMAL_CHUNK :][:count]


@lru_cache(maxsize=4)
def _normal_chunk(key: tuple[int, ...], chunk: int) -> FloatArray:
    return _next_normal(PCG64([*key, chunk]), _NORMAL_CHUNK)


def _next_uniform(bits: PCG64, count: int) -> FloatArray:
    return np.asarray((bits.random_raw(count) >> np.uint64(11)) * 2.0**-53)


def quantize(q: FloatArray, qd: FloatArray, noise: random.Random) -> tuple[FloatArray, FloatArray]:
    """Return `q` and `qd` (m, 4) in whole encoder counts, read-only, with triangular noise of up to one count."""

    def round_to_counts(values: FloatArray, step: FloatArray) -> FloatArray:
        # Python guarantees the sequence of random() only.
        dither = np.array([noise.random() + noise.random() - 1.0 for _ in range(values.size)]).reshape(values.shape)
        rounded = np.asarray(np.rint(values / step + dither) * step + 0.0)  # + 0.0 turns -0.0 into 0.0
        rounded.flags.writeable = False
        return rounded

    return round_to_counts(q, POSITION_STEP), round_to_counts(qd, VELOCITY_STEP)


def read_torque(torque: FloatArray) -> FloatArray:
    """Return joint torques (..., 4) in whole steps, read-only. The simulated joints have no friction."""
    effort = np.asarray(np.rint(torque / TORQUE_STEP) * TORQUE_STEP + 0.0)
    effort.flags.writeable = False
    return effort


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
        return FULL_SCALE * 1e3 / self.sensitivity / MAX_COUNT

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


class Pulse(NamedTuple):
    """A half-sine pulse F(t) = peak sin(pi t / duration): `onset_s` [s], `peak_force` [N], `duration` [s]."""

    onset_s: float
    peak_force: float
    duration: float
    rebound: int = 0

    @property
    def impulse(self) -> float:
        """Integral of F [N s]."""
        return 2.0 / math.pi * self.peak_force * self.duration

    def sample(self, sample_rate: float) -> tuple[int, FloatArray]:
        """Return the number of the first sample in the pulse, and the force [N] from there to its end."""
        onset = self.onset_s * sample_rate
        first = math.ceil(onset)
        numbers = np.arange(first, math.floor(onset + self.duration * sample_rate) + 1)
        phase = np.pi * (numbers - onset) / (self.duration * sample_rate)
        return first, self.peak_force * np.sin(phase)


PulseSchedule = Callable[[int, int, int], Iterable[Pulse]]
"""(channel, first, end) -> all pulses of the channel in the samples from `first` to before `end`, or more of them."""


@dataclass(frozen=True, slots=True)
class RandomPulses:
    """An endless `PulseSchedule`: one pulse per `period` [s], half to one and a half periods apart.

    It has no state: the number of a pulse is its random key. Pulses may overlap if the period is below 0.1 s.
    """

    seed: int
    sample_rate: float
    period: float

    def __call__(self, channel: int, first: int, end: int) -> Iterator[Pulse]:
        """See `PulseSchedule`."""
        samples = self.period * self.sample_rate
        # Pulse k starts k + 1 periods after the start, +- a quarter, and ends before the next one can start.
        for number in range(max(0, math.floor(first / samples - 0.75)), max(0, math.ceil(end / samples - 0.75))):
            key = (self.seed, _PULSE_STREAM, channel, number)
            onset, peak, duration, rebounds, rebound_peak, gap = uniform(key, 6).tolist()
            pulse = Pulse(
                onset_s=(number + 0.75 + 0.5 * onset) * self.period,
                peak_force=PEAKS[0] * (PEAKS[1] / PEAKS[0]) ** peak,
                duration=_interpolate(DURATIONS, duration),
            )
            yield pulse
            if rebounds < REBOUND_SHARE:
                # A linear contact lasts equally long at any speed.
                later_s = pulse.onset_s + pulse.duration + _interpolate(REBOUND_GAPS, gap)
                force = pulse.peak_force * _interpolate(REBOUND_PEAKS, rebound_peak)
                yield Pulse(later_s, force, pulse.duration, rebound=1)


@final
class SyntheticSignal:
    """Synthetic force of several channels [N], compression positive, in whole counts of `sensor`.

    All channels share one noise of NOISE_SAMPLES, CHANNEL_SPACING apart.
    """

    def __init__(self, channels: int, sensor: ForceSensor, pulses: PulseSchedule) -> None:
        self.sensor = sensor
        self.pulses = pulses
        self.limit = sensor.step * MAX_COUNT
        """Largest force that fits the converter [N]."""
        self._starts = CHANNEL_SPACING * np.arange(channels)[:, np.newaxis]
        self._noise = np.empty(NOISE_SAMPLES)
        bits = PCG64([sensor.seed, _SYNTHETIC_STREAM])
        for chunk in self._noise.reshape(-1, _SYNTHETIC_CHUNK):
            chunk[:] = np.rint(_next_normal(bits, _SYNTHETIC_CHUNK) * (sensor.noise / sensor.step))

    def samples(self, first: int, count: int) -> FloatArray:
        """Return the samples (channels, count) from number `first` on, read-only."""
        counts = np.take(self._noise, self._starts + np.arange(first, first + count), mode="wrap")
        for channel, row in enumerate(counts):
            for pulse in self.pulses(channel, first, first + count):
                onset, force = pulse.sample(self.sensor.sample_rate)
                begin, end = max(onset, first), min(onset + len(force), first + count)
                if begin < end:
                    row[begin - first : end - first] += np.rint(force[begin - onset : end - onset] / self.sensor.step)
        np.clip(counts, -MAX_COUNT, MAX_COUNT, out=counts)
        counts *= self.sensor.step
        counts.flags.writeable = False
        return counts


def _interpolate(limits: tuple[float, float], share: float) -> float:
    minimum, maximum = limits
    return minimum + (maximum - minimum) * share
