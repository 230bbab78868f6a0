"""Measure the force of the unloaded sensor."""

import numpy as np
from numpy.typing import NDArray

from scara_effmass.settings import TareSettings
from scara_effmass.values import FloatArray

PARTS = 10
"""Parts of a tare; a short disturbance affects one or two of them."""
MIN_PARTS = 7
"""Valid parts, so that the median is that of valid ones."""


class Tare:
    """Median of the means of ten consecutive parts.

    An impact falls into one or two parts and moves the median by no more than the noise. With fewer than seven parts
    within the tolerance of the median and free of saturated samples, the sensor was not at rest and there is no result.
    """

    def __init__(self, settings: TareSettings, sample_rate: float) -> None:
        """Use `settings.time` of samples at `sample_rate` [Hz], at least ten."""
        self._tolerance = settings.tolerance
        self._length = max(1, round(settings.time * sample_rate / PARTS))
        self._sums = np.zeros(PARTS)
        self._saturated = np.zeros(PARTS, np.bool_)
        self._count = 0

    @property
    def done(self) -> bool:
        """Whether all samples were added."""
        return self._count == PARTS * self._length

    def add(self, force: FloatArray, saturated_samples: NDArray[np.uint32]) -> None:
        """Add the next samples, finite, [N]; those beyond the end are ignored. Indices as in `ForceBlock`."""
        start = 0
        while start < force.size and not self.done:
            part, offset = divmod(self._count, self._length)
            stop = min(force.size, start + self._length - offset)
            self._sums[part] += force[start:stop].sum()
            self._saturated[part] |= ((saturated_samples >= start) & (saturated_samples < stop)).any()
            self._count += stop - start
            start = stop

    def result(self) -> float | str:
        """Return the zero force [N], or why there is none; only when `done`."""
        means = self._sums[~self._saturated] / self._length
        if means.size < MIN_PARTS:
            return "refused: the force was at the end of the measuring range"
        zero = float(np.median(means))
        if np.count_nonzero(np.abs(means - zero) <= self._tolerance) < MIN_PARTS:
            return f"refused: the force moved by {np.ptp(means):.3g} N, tare.tolerance is {self._tolerance:g} N"
        return zero
