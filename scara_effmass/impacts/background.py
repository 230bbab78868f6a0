"""The force while nothing touches the sensor: its level, its noise, and which repetitions are normal for it."""

from __future__ import annotations

import math
import sys
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable

    from scara_effmass.settings import DetectionSettings
    from scara_effmass.values import FloatArray

FRAMES = 5
"""So many frames are known at a time."""
_KEPT = 128
"""Samples that are kept of a frame, evenly spaced: bounds the work, whatever the sample rate."""
_GAUSSIAN = 1.4826
"""Standard deviation over median absolute deviation, for Gaussian noise: 1 / Phi^-1(3/4)."""
_QUANTISED = 0.7413
"""Largest standard deviation of Gaussian noise half of which is rounded to one value [steps]: 1 / (2 Phi^-1(3/4))."""
_CHANCE_EQUAL = 1e-12
"""A run of equal samples is no chance when it is less probable than this: below 1e-4 an hour at 12.8 kS/s."""
_CHANCE_ZERO = 1e-6
"""The same for exact zeros, which are looked at around contacts only and are how converters say nothing."""


class Frame(NamedTuple):
    """What is kept of one frame of samples."""

    kept: FloatArray
    samples: int
    equal: int
    """How many equal the sample before."""
    zero: int

    @classmethod
    def of(cls, samples: FloatArray) -> Frame:
        """Return what is kept of `samples` (n,) [N]."""
        equal = int(np.count_nonzero(samples[1:] == samples[:-1]))
        zero = samples.size - int(np.count_nonzero(samples))
        return cls(samples[:: -(-samples.size // _KEPT)].copy(), samples.size, equal, zero)


def median(samples: FloatArray) -> float:
    """Return the median of `samples` (n,), which it reorders; a fraction of the cost of numpy's."""
    middle = samples.size // 2
    if samples.size % 2:
        samples.partition(middle)
        return float(samples[middle])
    samples.partition((middle - 1, middle))
    return 0.5 * float(samples[middle - 1] + samples[middle])


def centre_and_spread(samples: FloatArray) -> tuple[float, float]:
    """Return median and robust standard deviation of `samples` (n,), which it reorders.

    The latter is zero where more than half of the samples are equal.
    """
    centre = median(samples)
    return centre, _GAUSSIAN * median(np.abs(samples - centre))


def rounded_spread(samples: FloatArray, centre: float) -> float:
    """Return the most that noise may deviate of whose `samples` (n,) more than half are rounded to `centre`."""
    deviation = np.abs(samples - centre)
    others = deviation[deviation > 0.0]
    return _QUANTISED * float(others.min()) if others.size else 0.0


def run_beyond_chance(share: float, chance: float) -> int:
    """Return how long a run of samples must be to be less probable than `chance` if a sample has `share` of one."""
    return math.ceil(math.log(chance) / math.log(share)) if share < 1.0 else sys.maxsize


class Background:
    """Baseline and noise of the last quiet frames, and what follows from them. All in [N] as the sensor reads it.

    `level` above the baseline there is a contact, `release` above it there is none any more. `flat_run` equal samples
    in a row, or `zero_run` exact zeros, are a drop-out.
    """

    def __init__(self, settings: DetectionSettings) -> None:
        self._settings = settings
        self._frames: deque[Frame] = deque(maxlen=FRAMES)
        self.baseline = self.noise = 0.0
        self.level = self.release = math.inf
        self.flat_run = self.zero_run = sys.maxsize

    def admit(self, frames: Iterable[Frame]) -> None:
        """Add quiet `frames`; the oldest go."""
        self._frames.extend(frames)
        self.baseline, self.noise = centre_and_spread(np.concatenate([frame.kept for frame in self._frames]))
        if self.noise == 0.0:  # judged frame by frame: a contact before the baseline is known is in the fewest
            self.noise = median(np.array([rounded_spread(frame.kept, self.baseline) for frame in self._frames]))
        self.level = self.level_of(self.noise)
        self.release = 0.5 * self.level
        samples = 1 + sum(frame.samples for frame in self._frames)
        equal = (1 + sum(frame.equal for frame in self._frames)) / samples
        self.flat_run = max(3, run_beyond_chance(equal, _CHANCE_EQUAL))
        if abs(self.baseline) > self.level:
            self.zero_run = 2  # zero is no force that the quiet sensor could read
        else:
            zero = (1 + sum(frame.zero for frame in self._frames)) / samples
            self.zero_run = max(2, run_beyond_chance(zero, _CHANCE_ZERO))

    def level_of(self, noise: float) -> float:
        """Return what a contact has to exceed in `noise` [N], at least that of the background."""
        return max(self._settings.threshold, self._settings.noise_factor * max(noise, self.noise))

    def steady(self, frames: Iterable[Frame], share: float = 1.0) -> bool:
        """Return whether at least `share` of `frames` are about one level: then that is the baseline.

        What a frame may be off is judged by the spread within frames, so a ramp is not taken for noise.
        """
        centres, spreads = np.array([centre_and_spread(frame.kept.copy()) for frame in frames]).T
        tolerance = max(self._settings.threshold, 3.0 * median(spreads))
        return bool(np.mean(np.abs(centres - np.median(centres)) <= tolerance) >= share)
