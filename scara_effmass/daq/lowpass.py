"""The optional low-pass: streaming, with its delay declared. Importing it loads scipy, so do so when one is chosen."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Protocol

import numpy as np
from scipy import optimize, signal

from scara_effmass.errors import SettingsError
from scara_effmass.settings import FilterKind

if TYPE_CHECKING:
    from collections.abc import Callable

    from scara_effmass.settings import FilterSettings
    from scara_effmass.values import FloatArray

NEGLIGIBLE = 1e-3
"""A sample is no longer said to influence the output when this fraction of its influence is left."""
HALF_WIDTH = 4.0
"""Where the Gaussian is cut off, in standard deviations; 6e-5 of it lies outside."""
LONGEST = 4001
"""Most taps of the Gaussian; with more, a block would take longer to filter than to come."""


class Lowpass(Protocol):
    """A low-pass over one channel, fed with consecutive samples in portions of any size.

    The first sample is taken to have been there for ever, so a constant passes from the first sample on.
    """

    delay: float
    """[samples]; for slow signals, where it depends on the frequency"""
    memory: int
    """A sample influences the output at its own index and at so many after it."""

    def __call__(self, samples: FloatArray) -> FloatArray:
        """Return the output for the next samples: as many, not yet shifted by the delay."""

    def reset(self) -> None:
        """Forget the past, as after a gap: the next sample is a first one."""


class Butterworth:
    """Causal low-pass of second order, half the power at the cutoff (scipy.signal.butter).

    Its output is the same bit for bit in whatever portions the samples come.
    """

    def __init__(self, cutoff: float, sample_rate: float) -> None:
        """Design it; both in [Hz]."""
        zeros, poles, gain = signal.butter(2, cutoff, fs=sample_rate, output="zpk")
        self._sections: FloatArray = signal.zpk2sos(zeros, poles, gain)
        self._steady: FloatArray = signal.sosfilt_zi(self._sections)
        self._state: FloatArray | None = None
        _, delays = signal.group_delay(signal.zpk2tf(zeros, poles, gain), w=[0.0])
        self.delay = float(delays[0])
        self.memory = math.ceil(math.log(NEGLIGIBLE) / math.log(max(abs(poles))))

    def __call__(self, samples: FloatArray) -> FloatArray:
        """Return the output for the next samples."""
        if not samples.size:
            return samples
        state = self._steady * samples[0] if self._state is None else self._state
        output: FloatArray
        output, self._state = signal.sosfilt(self._sections, samples, zi=state)
        return output

    def reset(self) -> None:
        """Forget the past."""
        self._state = None


class Gaussian:
    """Low-pass with Gaussian taps, half the power at the cutoff; it delays all frequencies alike.

    No tap is negative, so a peak is never made larger, and an impact is given no echo. Its output is the same to some
    1e-15 of the largest sample in whatever portions the samples come.
    """

    def __init__(self, cutoff: float, sample_rate: float) -> None:
        """Design it; both in [Hz]. Raises SettingsError when it would be too long."""
        # |H| = exp(-(2 pi f sigma)² / 2) of the continuous Gaussian, 1/sqrt(2) at the cutoff
        width = math.sqrt(math.log(2.0)) / (2.0 * math.pi * cutoff) * sample_rate
        reach = max(1, math.ceil(HALF_WIDTH * width))
        if 2 * reach + 1 > LONGEST:
            least = cutoff * HALF_WIDTH * width / (LONGEST // 2)
            raise SettingsError(
                f"filter.cutoff = {cutoff:g}: must be at least {math.ceil(least):d} Hz for zero_phase at "
                f"{sample_rate:g} Hz, or filter.kind must be causal"
            )
        angle = 2.0 * math.pi * cutoff / sample_rate
        n = np.arange(-reach, reach + 1)

        def taps(sigma: float) -> FloatArray:
            window = signal.windows.gaussian(2 * reach + 1, sigma)
            result: FloatArray = window / window.sum()
            return result

        def beyond_half_power(sigma: float) -> float:
            return float(taps(sigma) @ np.cos(angle * n)) - math.sqrt(0.5)

        # Sampled and cut off, it differs a little from the continuous one, the more the higher the cutoff.
        self._taps = taps(float(optimize.brentq(beyond_half_power, 0.1 * width, 10.0 * width, xtol=1e-12)))
        self._past: FloatArray | None = None
        self.delay = float(reach)
        self.memory = 2 * reach

    def __call__(self, samples: FloatArray) -> FloatArray:
        """Return the output for the next samples."""
        if not samples.size:
            return samples
        past = np.full(self.memory, samples[0]) if self._past is None else self._past
        known = np.concatenate((past, samples))
        self._past = known[-self.memory :]
        return np.convolve(known, self._taps, "valid")

    def reset(self) -> None:
        """Forget the past."""
        self._past = None


LOWPASSES: dict[FilterKind, Callable[[float, float], Lowpass]] = {
    FilterKind.CAUSAL: Butterworth,
    FilterKind.ZERO_PHASE: Gaussian,
}


def make_lowpass(settings: FilterSettings, sample_rate: float) -> Lowpass:
    """Return the low-pass of `settings`, whose kind is not none, for samples at `sample_rate` [Hz].

    Raises SettingsError when the samples are too few, or far too many, for the cutoff.
    """
    if not settings.cutoff < sample_rate / 2.0:
        raise SettingsError(
            f"filter.cutoff = {settings.cutoff:g}: must be below {sample_rate / 2.0:g} Hz, half of the sample rate"
        )
    return LOWPASSES[settings.kind](settings.cutoff, sample_rate)
