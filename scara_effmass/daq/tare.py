"""What is taken for zero force."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from scara_effmass.settings import TareSettings
    from scara_effmass.values import FloatArray

PARTS = 10
"""A tare is taken in so many parts, so that a short disturbance spoils one or two of them and not the whole."""
LEAST_PARTS = 7
"""So many have to be good for the median to be theirs."""


class Tare:
    """Finds the force of an unloaded sensor: the median of the means of ten consecutive parts.

    An impact is in one or two parts and moves the median by no more than the noise. When fewer than seven parts lie
    within the tolerance of it, or are free of saturated samples, the sensor was not at rest: there is no result.
    """

    def __init__(self, settings: TareSettings, sample_rate: float) -> None:
        """Take `settings.time` of samples at `sample_rate` [Hz], and no fewer than ten."""
        self._tolerance = settings.tolerance
        self._length = max(1, round(settings.time * sample_rate / PARTS))
        self._means: list[float] = []
        self._saturated: list[bool] = []
        self._begin_part()

    def _begin_part(self) -> None:
        self._sum = 0.0
        self._count = 0
        self._part_saturated = False

    @property
    def done(self) -> bool:
        """Whether there were samples enough."""
        return len(self._means) == PARTS

    def add(self, force: FloatArray, saturated_samples: NDArray[np.uint32]) -> None:
        """Take in the next samples, finite, in [N]; what is beyond the end is left. Indices as in `ForceBlock`."""
        start = 0
        while start < force.size and not self.done:
            part = force[start : start + self._length - self._count]
            stop = start + part.size
            self._sum += float(part.sum())
            self._count += part.size
            if saturated_samples.size:
                self._part_saturated |= bool(((saturated_samples >= start) & (saturated_samples < stop)).any())
            start = stop
            if self._count == self._length:
                self._means.append(self._sum / self._length)
                self._saturated.append(self._part_saturated)
                self._begin_part()

    def result(self) -> float | str:
        """Return the force that is zero [N], or why there is none; it has to be done."""
        means = np.array([mean for mean, saturated in zip(self._means, self._saturated, strict=True) if not saturated])
        if means.size < LEAST_PARTS:
            return "refused: the force was at the end of the measuring range"
        zero = float(np.median(means))
        if np.count_nonzero(np.abs(means - zero) <= self._tolerance) < LEAST_PARTS:
            return f"refused: the force moved by {np.ptp(means):.3g} N, tare.tolerance is {self._tolerance:g} N"
        return zero
