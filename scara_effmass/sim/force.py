"""Force where nothing is measured: noise and half-sine impacts, counted as a 24-bit converter would.

The same seed gives the same samples, however they are asked for, with any version of numpy; see `draws`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, final

import numpy as np
from numpy.random import PCG64

from scara_effmass.sim.rng import next_uniform, normal_pair, uniform

if TYPE_CHECKING:
    from scara_effmass.values import FloatArray

FULL_SCALE = 30.0
"""What the imagined converter reads at most, of either sign [V]."""
LARGEST_COUNT = 2**23 - 1

NOISE_SAMPLES = 2**21
"""After so many samples the noise repeats: 164 s at 12.8 kS/s, 16 s at 128 kS/s; 17 MB, whatever the channels."""
CHANNEL_SPACING = NOISE_SAMPLES // 8
"""By so much the noise of a channel is ahead of that of the channel before it."""
_CHUNK = 2**15

PEAKS = (20.0, 800.0)
"""Of random impacts [N], logarithmically uniform."""
DURATIONS = (0.5e-3, 4.0e-3)
"""Of random impacts [s], uniform."""
REBOUND_SHARE = 0.2
"""Of random impacts that are followed by a second, weaker contact."""
REBOUND_PEAKS = (0.3, 0.6)
"""Of the first contact's."""
REBOUND_GAPS = (0.01, 0.03)
"""Between the end of the first contact and the onset of the second [s]."""
SHORTEST_PERIOD = 0.1
"""Shorter periods [s] would let impacts overlap."""

_NOISE, _IMPACTS = 1, 2  # streams of the same seed


@dataclass(frozen=True, slots=True)
class HalfSine:
    """A true impact, F(t) = peak sin(pi t / duration): `peak_force` [N], `duration` [s], onset between samples."""

    onset_sample: float
    peak_force: float
    duration: float
    rebound: int = 0

    @property
    def impulse(self) -> float:
        """The integral of F [N s], 2 / pi times peak times duration."""
        return 2.0 / math.pi * self.peak_force * self.duration

    def sampled(self, sample_rate: float) -> tuple[int, FloatArray]:
        """Return the number of the first sample in contact, and the force [N] there and at those that follow."""
        first = math.ceil(self.onset_sample)
        numbers = np.arange(first, math.floor(self.onset_sample + self.duration * sample_rate) + 1)
        phase = np.pi * (numbers - self.onset_sample) / (self.duration * sample_rate)
        return first, self.peak_force * np.sin(phase)


ImpactSchedule = Callable[[int, int, int], tuple[HalfSine, ...]]
"""(channel, first, end) -> the impacts of that channel that reach into the samples from `first` to before `end`."""


@dataclass(frozen=True, slots=True)
class RandomImpacts:
    """Impacts at random, for all time: one per `period` [s], half to one and a half periods apart.

    A schedule without memory: each impact is drawn from its own number. Raises ValueError for too short a period.
    """

    seed: int
    sample_rate: float
    period: float

    def __post_init__(self) -> None:
        if not self.period >= SHORTEST_PERIOD:
            raise ValueError(f"period = {self.period}: at least {SHORTEST_PERIOD} s would be right")

    def __call__(self, channel: int, first: int, end: int) -> tuple[HalfSine, ...]:
        """See `ImpactSchedule`."""
        samples = self.period * self.sample_rate
        # Impact k begins k + 1 periods after the start, give or take a quarter, and is over before the next one may.
        numbers = range(max(0, math.floor(first / samples - 0.75)), max(0, math.ceil(end / samples - 0.75)))
        return tuple(
            contact
            for number in numbers
            for contact in _drawn(self, channel, number)
            if contact.onset_sample < end and contact.onset_sample + contact.duration * self.sample_rate >= first
        )


@final
class SimulatedSignal:
    """Simulated force of some channels [N], compression positive, in steps of the imagined converter.

    `noise` is a standard deviation [N], `sensitivity` in [mV/N]. A channel repeats its noise after NOISE_SAMPLES, and
    all channels share it, each CHANNEL_SPACING further on.
    """

    def __init__(
        self,
        *,
        channels: int,
        sample_rate: float,
        noise: float,
        seed: int,
        sensitivity: float,
        impacts: ImpactSchedule,
    ) -> None:
        self.sample_rate = sample_rate
        self.step = FULL_SCALE * 1e3 / sensitivity / LARGEST_COUNT
        """What one count is [N]."""
        self.limit = self.step * LARGEST_COUNT
        """The largest force that can be told [N]."""
        self._channels = channels
        self._impacts = impacts
        self._noise = _normal(seed)
        self._noise *= noise / self.step
        np.rint(self._noise, out=self._noise)

    def samples(self, first: int, count: int) -> FloatArray:
        """Return (channels, count), read-only: the samples from number `first` on."""
        counts = np.empty((self._channels, count))
        for channel, row in enumerate(counts):
            self._copy_noise(row, first + channel * CHANNEL_SPACING)
            for impact in self._impacts(channel, first, first + count):
                onset, pulse = _counted(impact, self.sample_rate, self.step)
                here, end = max(onset, first), min(onset + len(pulse), first + count)
                if here < end:
                    row[here - first : end - first] += pulse[here - onset : end - onset]
        np.clip(counts, -LARGEST_COUNT, LARGEST_COUNT, out=counts)
        counts *= self.step
        counts.flags.writeable = False
        return counts

    def impacts(self, first: int, end: int, channel: int = 0) -> tuple[HalfSine, ...]:
        """Return the true impacts of a channel that reach into the samples from `first` to before `end`."""
        return self._impacts(channel, first, end)

    def _copy_noise(self, row: FloatArray, first: int) -> None:
        done = 0
        while done < len(row):
            place = (first + done) % NOISE_SAMPLES
            part = self._noise[place : place + len(row) - done]
            row[done : done + len(part)] = part
            done += len(part)


@lru_cache(maxsize=1024)
def _drawn(impacts: RandomImpacts, channel: int, number: int) -> tuple[HalfSine, ...]:
    draws = uniform((impacts.seed, _IMPACTS, channel, number), 6).tolist()
    at, peak, duration, again, rebound, gap = draws
    contact = HalfSine(
        onset_sample=(number + 0.75 + 0.5 * at) * impacts.period * impacts.sample_rate,
        peak_force=PEAKS[0] * (PEAKS[1] / PEAKS[0]) ** peak,
        duration=_between(DURATIONS, duration),
    )
    if again >= REBOUND_SHARE:
        return (contact,)
    later = (contact.duration + _between(REBOUND_GAPS, gap)) * impacts.sample_rate
    force = contact.peak_force * _between(REBOUND_PEAKS, rebound)
    # The duration of a linear contact does not depend on its speed.
    return contact, HalfSine(contact.onset_sample + later, force, contact.duration, rebound=1)


@lru_cache(maxsize=1024)
def _counted(impact: HalfSine, sample_rate: float, step: float) -> tuple[int, FloatArray]:
    """Return an impact in whole counts; made once, so that no block boundary can change a digit of it."""
    first, force = impact.sampled(sample_rate)
    counts = np.rint(force / step)
    counts.flags.writeable = False
    return first, counts


def _normal(seed: int) -> FloatArray:
    """Return NOISE_SAMPLES standard normal numbers, made in chunks so that little more memory than theirs is taken."""
    bits = PCG64([seed, _NOISE])
    normal = np.empty(NOISE_SAMPLES)
    for pair in normal.reshape(-1, 2, _CHUNK):
        pair[:] = normal_pair(next_uniform(bits, _CHUNK), next_uniform(bits, _CHUNK))
    return normal


def _between(limits: tuple[float, float], share: float) -> float:
    low, high = limits
    return low + (high - low) * share
