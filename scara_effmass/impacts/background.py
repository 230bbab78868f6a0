"""The force while nothing touches the sensor: its level, its noise, and which repetitions are normal for it."""

from __future__ import annotations

import math
import sys
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from scara_effmass.impacts.faults import has_flat_run

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
LEAST_FLAT_RUN = 3
"""Fewer equal samples in a row are never a drop-out."""
_CHANCE_EQUAL = 1e-12
"""A run of equal samples is no chance when it is less probable than this: below 1e-4 an hour at 12.8 kS/s."""
_CHANCE_ZERO = 1e-6
"""The same for exact zeros, which are looked at around contacts only and are how converters say nothing."""


class Frame:
    """One frame of samples (n,) [N], which are between `low` and `high`."""

    def __init__(self, samples: FloatArray) -> None:
        self.samples = samples
        self.low = float(samples.min())
        self.high = float(samples.max())

    @property
    def kept(self) -> FloatArray:
        """Some of the samples, evenly spaced."""
        return self.samples[:: -(-self.samples.size // _KEPT)]

    @property
    def equal(self) -> int:
        """How many samples equal the one before."""
        return int(np.count_nonzero(self.samples[1:] == self.samples[:-1]))

    @property
    def zero(self) -> int:
        """How many samples are exactly zero."""
        return self.samples.size - int(np.count_nonzero(self.samples))


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

    Each is found when it is asked for: while nothing happens, what the samples are between mostly says enough.
    """

    def __init__(self, settings: DetectionSettings, frames: Iterable[Frame] = ()) -> None:
        self._settings = settings
        self._frames = tuple(frames)[-FRAMES:]

    def followed_by(self, frames: Iterable[Frame]) -> Background:
        """Return the background when quiet `frames` have come after these; the oldest go."""
        return Background(self._settings, (*self._frames, *frames))

    @property
    def baseline(self) -> float:
        """The force while nothing touches the sensor."""
        return self._baseline_and_noise[0]

    @property
    def noise(self) -> float:
        """Its robust standard deviation."""
        return self._baseline_and_noise[1]

    @cached_property
    def level(self) -> float:
        """So much above the baseline there is a contact."""
        return self.level_of(self.noise) if self._frames else math.inf

    @property
    def release(self) -> float:
        """So much above the baseline there is none any more."""
        return 0.5 * self.level

    @cached_property
    def flat_run(self) -> int:
        """So many equal samples in a row are a drop-out."""
        equal = self._share(frame.equal for frame in self._frames)
        return max(LEAST_FLAT_RUN, run_beyond_chance(equal, _CHANCE_EQUAL))

    @cached_property
    def zero_run(self) -> int:
        """So many exact zeros in a row are a drop-out."""
        if abs(self.baseline) > self.level:
            return 2  # zero is no force that the quiet sensor could read
        return max(2, run_beyond_chance(self._share(frame.zero for frame in self._frames), _CHANCE_ZERO))

    def level_of(self, noise: float) -> float:
        """Return what a contact has to exceed in `noise` [N], at least that of the background."""
        return max(self._settings.threshold, self._settings.noise_factor * max(noise, self.noise))

    def is_quiet(self, frame: Frame) -> bool:
        """Return whether nothing happens in `frame`: no contact, no pull, no drop-out."""
        if not self._is_within_level(frame):
            return False
        return not (has_flat_run(frame.samples, LEAST_FLAT_RUN) and has_flat_run(frame.samples, self.flat_run))

    def steady(self, frames: Iterable[Frame], share: float = 1.0) -> bool:
        """Return whether at least `share` of `frames` are about one level: then that is the baseline.

        What a frame may be off is judged by the spread within frames, so a ramp is not taken for noise.
        """
        centres, spreads = np.array([centre_and_spread(frame.kept.copy()) for frame in frames]).T
        tolerance = max(self._settings.threshold, 3.0 * median(spreads))
        return bool(np.mean(np.abs(centres - np.median(centres)) <= tolerance) >= share)

    def _is_within_level(self, frame: Frame) -> bool:
        # The baseline is one of the samples, or between two, and the level no less than the threshold: mostly that is
        # enough, and neither has to be found.
        threshold = self._settings.threshold
        highest, lowest = max([each.high for each in self._frames]), min([each.low for each in self._frames])
        if frame.low >= highest - threshold and frame.high <= lowest + threshold:
            return True
        return frame.low >= self.baseline - self.level and frame.high <= self.baseline + self.level

    @cached_property
    def _baseline_and_noise(self) -> tuple[float, float]:
        if not self._frames:
            return 0.0, 0.0
        baseline, noise = centre_and_spread(np.concatenate([frame.kept for frame in self._frames]))
        if noise == 0.0:  # judged frame by frame: a contact before the baseline is known is in the fewest
            noise = median(np.array([rounded_spread(frame.kept, baseline) for frame in self._frames]))
        return baseline, noise

    def _share(self, counts: Iterable[int]) -> float:
        """Return what share of the samples was counted, one more than there were."""
        return (1 + sum(counts)) / (1 + sum(frame.samples.size for frame in self._frames))
