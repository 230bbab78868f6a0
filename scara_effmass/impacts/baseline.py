# SPDX-License-Identifier: Apache-2.0
"""Baseline of the force: level and noise without contact, and how long runs of equal samples normally get."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable
from functools import cached_property

import numpy as np

from scara_effmass.settings import DetectionSettings
from scara_effmass.values import BoolArray, FloatArray, true_runs

BASELINE_FRAMES = 5
"""Number of quiet frames that define a baseline."""
MIN_FLAT_RUN = 3
"""Minimum number of equal consecutive samples in a dropout."""
MIN_ZERO_RUN = 2
"""Minimum number of consecutive exact zeros in a dropout."""
_MAX_SUBSAMPLES = 128
"""Number of evenly spaced samples per frame that enter the statistics; bounds the work at any sample rate."""
_GAUSSIAN = 1.4826
"""Standard deviation / median absolute deviation of Gaussian noise: 1 / Phi^-1(3/4)."""
_QUANTISED = 0.7413
"""Maximum standard deviation [quantization steps] of Gaussian noise of which half is rounded to one value."""
_FLAT_RUN_PROBABILITY = 1e-12
"""Runs of equal samples that are less probable are dropouts; at 12.8 kS/s about 1e-4 an hour are false."""
_ZERO_RUN_PROBABILITY = 1e-6
"""The same for exact zeros, which converters output without a signal; they are only searched near contacts."""
_FINE_SHARE = 0.1
"""Maximum share of samples that equal the previous one, at rest, for a sensor of fine resolution; with dropouts."""


class Frame:
    """The finite `samples` (n,) [N] of a frame, their extremes, and at most 128 evenly spaced `subsamples`.

    `is_present`: at least half of the samples are finite.
    """

    def __init__(self, samples: FloatArray) -> None:
        self.samples = samples[np.isfinite(samples)]
        self.is_present = self.samples.size >= 0.5 * samples.size
        self.subsamples = self.samples[:: -(-self.samples.size // _MAX_SUBSAMPLES) or 1]
        self.low, self.high = float(self.samples.min(initial=math.inf)), float(self.samples.max(initial=-math.inf))

    @cached_property
    def median_and_deviation(self) -> tuple[float, float]:
        """Median and robust standard deviation of the subsamples."""
        return median_and_deviation(self.subsamples)


def median_and_deviation(samples: FloatArray) -> tuple[float, float]:
    """Return median and robust standard deviation of `samples` (n,); the latter is 0 if more than half are equal."""
    centre = float(np.median(samples))
    return centre, _GAUSSIAN * float(np.median(np.abs(samples - centre)))


def quantisation_deviation(samples: FloatArray, centre: float) -> float:
    """Return the maximum standard deviation of noise that rounds more than half of `samples` (n,) to `centre`."""
    deviation = np.abs(samples - centre)
    return _QUANTISED * float(deviation[deviation > 0.0].min()) if deviation.any() else 0.0


def improbable_run_length(share: float, probability: float) -> int:
    """Return the minimum length of a run that is less probable than `probability`; `share` is that of one sample."""
    return math.ceil(math.log(probability) / math.log(share)) if share < 1.0 else sys.maxsize


def longest_flat_run(samples: FloatArray) -> int:
    """Return the maximum number of equal consecutive `samples` (n,)."""
    equal = samples[1:] == samples[:-1]
    if not (equal[1:] & equal[:-1]).any():
        return 1 + int(equal.any())  # fast path: usually no three samples are equal
    return 1 + int(np.diff(true_runs(equal)).max(initial=0))


class Baseline:
    """Level and noise of the latest quiet frames, and the thresholds derived from them, all in [N] as measured.

    Statistics are computed on demand, because the extremes of a frame usually suffice to show that it is quiet.
    """

    def __init__(self, settings: DetectionSettings, frames: Iterable[Frame] = ()) -> None:
        self._settings = settings
        self._frames = tuple(frames)[-BASELINE_FRAMES:]

    def extended(self, frames: Iterable[Frame]) -> Baseline:
        """Return the baseline after further quiet `frames`, which replace the oldest ones."""
        return Baseline(self._settings, (*self._frames, *frames))

    @property
    def force(self) -> float:
        """Median force without contact."""
        return self._force_and_noise[0]

    @property
    def noise(self) -> float:
        """Robust standard deviation of the force without contact."""
        return self._force_and_noise[1]

    @cached_property
    def threshold(self) -> float:
        """Force above the baseline beyond which there is a contact."""
        return self.threshold_for(self.noise) if self._frames else math.inf

    @cached_property
    def flat_run(self) -> int:
        """Minimum length of a run of equal samples that is a dropout."""
        return max(MIN_FLAT_RUN, improbable_run_length(self._equal_share, _FLAT_RUN_PROBABILITY))

    @cached_property
    def zero_run(self) -> int:
        """Minimum length of a run of exact zeros that is a dropout."""
        if abs(self.force) > self.threshold or self._equal_share < _FINE_SHARE:
            return MIN_ZERO_RUN  # a sensor far from zero, or of fine resolution, never reads zero twice
        share = self._share(lambda samples: samples == 0.0)
        return max(MIN_ZERO_RUN, improbable_run_length(share, _ZERO_RUN_PROBABILITY))

    def threshold_for(self, noise: float) -> float:
        """Return the contact threshold for `noise` [N]; at least that of the baseline."""
        return max(self._settings.threshold, self._settings.noise_factor * max(noise, self.noise))

    def is_quiet(self, frame: Frame) -> bool:
        """Return whether `frame` contains neither a contact, nor a tensile pulse, nor a dropout, nor a large gap."""
        if not frame.is_present:
            return False
        low, high = min([f.low for f in self._frames]), max([f.high for f in self._frames])
        # Fast path without statistics: the level of the baseline lies between the extremes of its frames.
        is_near = high - self._settings.threshold <= frame.low and frame.high <= low + self._settings.threshold
        if not is_near and not self.force - self.threshold <= frame.low <= frame.high <= self.force + self.threshold:
            return False
        run = longest_flat_run(frame.samples)
        return run < MIN_FLAT_RUN or run < self.flat_run

    def is_steady(self, frames: Iterable[Frame], share: float = 1.0) -> bool:
        """Return whether at least `share` of `frames` have about the same median.

        The tolerance follows from the noise within frames, so a ramp is not steady.
        """
        centres, deviations = np.array([frame.median_and_deviation for frame in frames]).T
        tolerance = max(self._settings.threshold, 3.0 * float(np.median(deviations)))
        return bool(np.mean(np.abs(centres - np.median(centres)) <= tolerance) >= share)

    @cached_property
    def _force_and_noise(self) -> tuple[float, float]:
        if not self._frames:
            return 0.0, 0.0
        parts = [frame.subsamples for frame in self._frames]
        force, noise = median_and_deviation(np.concatenate(parts))
        if noise == 0.0:  # by frame: a contact before the first baseline affects only a minority of the frames
            noise = float(np.median([quantisation_deviation(part, force) for part in parts]))
        return force, noise

    @cached_property
    def _equal_share(self) -> float:
        """Share of samples that equal the previous one."""
        return self._share(lambda samples: samples[1:] == samples[:-1])

    def _share(self, mark: Callable[[FloatArray], BoolArray]) -> float:
        """Return the share of samples that `mark` marks; one more is counted, so that it is never zero."""
        marked = sum(int(np.count_nonzero(mark(frame.samples))) for frame in self._frames)
        return (1 + marked) / (1 + sum(frame.samples.size for frame in self._frames))
