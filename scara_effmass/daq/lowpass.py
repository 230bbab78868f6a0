# SPDX-License-Identifier: Apache-2.0
"""Optional low-pass filters with a known delay. This module loads scipy: import it only when it is needed."""

import math

import numpy as np
from scipy import optimize, signal

from scara_effmass.errors import SettingsError
from scara_effmass.settings import FilterSettings
from scara_effmass.values import FloatArray

NEGLIGIBLE = 1e-3
"""Share of a sample's influence on the output below which it is neglected."""
HALF_WIDTH = 4.0
"""Half the length of the Gaussian in standard deviations; 6e-5 of it lies outside."""
MAX_TAPS = 4001
"""With more taps, it would take longer to filter a block than to measure it."""


class Lowpass:
    """Digital filter of one channel, called with consecutive portions of samples, of any size.

    It starts as if all samples before had equalled the first one, so a constant passes unchanged.
    """

    def __init__(self, numerator: FloatArray, denominator: FloatArray, delay: float, memory: int) -> None:
        """Create the filter with these coefficients and a gain of 1 at frequency 0."""
        self.delay = delay
        """[samples]; if it depends on the frequency, that of slow signals."""
        self.memory = memory
        """Number of outputs after its own index that a sample influences."""
        self._coefficients = numerator, denominator
        # State after a long constant 1, as `signal.lfilter_zi`, which needs a matrix of taps x taps.
        # Element k is the sum of numerator - denominator beyond k.
        rest = numerator - np.pad(denominator, (0, numerator.size - denominator.size))
        self._steady = np.cumsum(rest[:0:-1])[::-1]
        self._state: FloatArray | None = None

    def __call__(self, samples: FloatArray) -> FloatArray:
        """Return one output for each sample; the delay is not compensated."""
        if not samples.size:
            return samples
        state = self._steady * samples[0] if self._state is None else self._state
        output: FloatArray
        output, self._state = signal.lfilter(*self._coefficients, samples, zi=state)
        return output

    def reset(self) -> None:
        """Forget earlier samples, as after a gap."""
        self._state = None


def make_lowpass(settings: FilterSettings, sample_rate: float) -> Lowpass:
    """Return the low-pass of `settings`, whose kind must not be none, for samples at `sample_rate` [Hz].

    Raises SettingsError if the sample rate is too low, or far too high, for the cutoff.
    """
    if not settings.cutoff < sample_rate / 2.0:
        raise SettingsError(
            f"filter.cutoff = {settings.cutoff:g}: must be below {sample_rate / 2.0:g} Hz, half of the sample rate"
        )
    design = _butterworth if settings.kind == "causal" else _gaussian
    return design(settings.cutoff, sample_rate)


def _butterworth(cutoff: float, sample_rate: float) -> Lowpass:
    """Return a causal second-order low-pass with half the power at the cutoff.

    The output is the same to the last bit for portions of any size.
    """
    numerator, denominator = signal.butter(2, cutoff, fs=sample_rate)
    _, delays = signal.group_delay((numerator, denominator), w=[0.0])
    slowest_pole = max(abs(np.roots(denominator)))
    memory = math.ceil(math.log(NEGLIGIBLE) / math.log(slowest_pole))
    return Lowpass(numerator, denominator, float(delays[0]), memory)


def _gaussian(cutoff: float, sample_rate: float) -> Lowpass:
    """Return a low-pass with Gaussian taps and half the power at the cutoff; it delays all frequencies equally.

    No tap is negative, so peaks do not grow and impacts have no echo. The size of the portions changes the output by
    about 1e-15 of the largest sample. Raises SettingsError if the filter needs more than MAX_TAPS.
    """
    # |H| = exp(-(2 pi f sigma)² / 2) of the continuous Gaussian, 1/sqrt(2) at the cutoff
    width = math.sqrt(math.log(2.0)) / (2.0 * math.pi * cutoff) * sample_rate
    half = max(1, math.ceil(HALF_WIDTH * width))
    if 2 * half + 1 > MAX_TAPS:
        min_cutoff = math.ceil(cutoff * HALF_WIDTH * width / (MAX_TAPS // 2))
        raise SettingsError(
            f"filter.cutoff = {cutoff:g}: must be >= {min_cutoff} Hz with zero_phase at {sample_rate:g} Hz; "
            "filter.kind = causal allows less"
        )
    cosines = np.cos(2.0 * math.pi * cutoff / sample_rate * np.arange(-half, half + 1))

    def taps(sigma: float) -> FloatArray:
        window = signal.windows.gaussian(2 * half + 1, sigma)
        result: FloatArray = window / window.sum()
        return result

    def excess_gain(sigma: float) -> float:
        return float(taps(sigma) @ cosines) - math.sqrt(0.5)

    # The sampled, truncated Gaussian differs from the continuous one, most at high cutoffs.
    sigma = float(optimize.brentq(excess_gain, 0.1 * width, 10.0 * width, xtol=1e-12))
    return Lowpass(taps(sigma), np.ones(1), float(half), 2 * half)
