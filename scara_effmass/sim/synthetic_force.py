# SPDX-License-Identifier: Apache-2.0
"""Synthetic force, not computed from any motion: noise and half-sine pulses, in counts of a 24-bit converter.

The same seed gives the same samples, for any block size and numpy version; see `rng`.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np
from numpy.random import PCG64

from scara_effmass.sim.measurement import FRAME_ID, MAX_COUNT, newtons_per_count
from scara_effmass.sim.rng import next_normal, uniform
from scara_effmass.values import FloatArray, ForceBlock

NOISE_SAMPLES = 2**21
"""Period of the noise: 164 s at 12.8 kS/s, 16 s at 128 kS/s; 17 MB, for any number of channels."""
CHANNEL_SPACING = NOISE_SAMPLES // 8
"""Offset between the noise of consecutive channels."""
_CHUNK = 2**16

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
_NOISE_STREAM, _PULSE_STREAM = 1, 2

SAMPLE_RATE = 12_800.0
"""Sample rate of recorded synthetic force [Hz], the fastest of an NI-9230."""
BLOCK_SAMPLES = 1280
BLOCK_NS = 100_000_000
NOISE = 0.05
"""Standard deviation of the noise [N]."""
SENSITIVITY = 2.248
"""Nominal sensitivity of a PCB 208C03 [mV/N]."""
SOURCE = "simulated force: noise and half-sine impacts at chosen times, not computed from the motion"


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
    """Synthetic force of several channels [N], compression positive, in whole counts.

    `noise` is a standard deviation [N], `sensitivity` in [mV/N]. All channels share one noise of NOISE_SAMPLES,
    CHANNEL_SPACING apart.
    """

    def __init__(
        self,
        *,
        channels: int,
        sample_rate: float,
        noise: float,
        seed: int,
        sensitivity: float,
        pulses: PulseSchedule,
    ) -> None:
        self.sample_rate = sample_rate
        self.pulses = pulses
        self.step = newtons_per_count(sensitivity)
        """Resolution [N]."""
        self.limit = self.step * MAX_COUNT
        """Largest force that fits the converter [N]."""
        self._starts = CHANNEL_SPACING * np.arange(channels)[:, np.newaxis]
        self._noise = np.empty(NOISE_SAMPLES)
        bits = PCG64([seed, _NOISE_STREAM])
        for chunk in self._noise.reshape(-1, _CHUNK):
            chunk[:] = np.rint(next_normal(bits, _CHUNK) * (noise / self.step))

    def samples(self, first: int, count: int) -> FloatArray:
        """Return the samples (channels, count) from number `first` on, read-only."""
        counts = np.take(self._noise, self._starts + np.arange(first, first + count), mode="wrap")
        for channel, row in enumerate(counts):
            for pulse in self.pulses(channel, first, first + count):
                onset, force = pulse.sample(self.sample_rate)
                begin, end = max(onset, first), min(onset + len(force), first + count)
                if begin < end:
                    row[begin - first : end - first] += np.rint(force[begin - onset : end - onset] / self.step)
        np.clip(counts, -MAX_COUNT, MAX_COUNT, out=counts)
        counts *= self.step
        counts.flags.writeable = False
        return counts


def synthetic_force(pulses: Sequence[Pulse], duration_s: float, start_ns: int, seed: int) -> Iterator[ForceBlock]:
    """Yield the whole blocks of 0.1 s that fit into `duration_s` [s], from `start_ns` on."""
    signal = SyntheticSignal(
        channels=1,
        sample_rate=SAMPLE_RATE,
        noise=NOISE,
        seed=seed,
        sensitivity=SENSITIVITY,
        pulses=lambda _channel, _first, _end: pulses,
    )
    for number in range(int(duration_s * SAMPLE_RATE) // BLOCK_SAMPLES):
        first = number * BLOCK_SAMPLES
        yield ForceBlock(
            stamp_ns=start_ns + number * BLOCK_NS,
            frame_id=FRAME_ID,
            first_sample=first,
            sample_rate=SAMPLE_RATE,
            force=signal.samples(first, BLOCK_SAMPLES)[0],
            source=SOURCE,
            simulated=True,
        )


def _interpolate(limits: tuple[float, float], share: float) -> float:
    minimum, maximum = limits
    return minimum + (maximum - minimum) * share
