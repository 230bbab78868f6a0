# SPDX-License-Identifier: Apache-2.0
"""Measure the force of the unloaded sensor."""

import numpy as np
from numpy.typing import NDArray

from scara_effmass.settings import TareSettings
from scara_effmass.values import BoolArray, FloatArray

PARTS = 10
"""Number of parts; a short disturbance affects one or two of them."""
MIN_PARTS = 7
"""Minimum number of valid parts; the median then lies among valid ones."""


class Tare:
    """Median of the means of ten consecutive parts of a signal.

    An impact falls into one or two parts, which move the median by no more than the noise. The sensor was at rest if at
    least seven parts have no saturated sample and are within the tolerance of the median; otherwise there is no result.
    """

    def __init__(self, settings: TareSettings, sample_rate: float) -> None:
        """Use `settings.time` of samples at `sample_rate` [Hz], at least ten."""
        self._tolerance = settings.tolerance
        self._length = PARTS * max(1, round(settings.time * sample_rate / PARTS))
        self._force: FloatArray = np.empty(0)
        self._saturated: BoolArray = np.empty(0, np.bool_)

    @property
    def done(self) -> bool:
        """Whether all samples were added."""
        return self._force.size == self._length

    def add(self, force: FloatArray, saturated_samples: NDArray[np.uint32]) -> None:
        """Add the next samples [N], all finite; those after the end are ignored. Indices are as in `ForceBlock`."""
        saturated = np.isin(np.arange(force.size), saturated_samples)
        self._force = np.concatenate((self._force, force))[: self._length]
        self._saturated = np.concatenate((self._saturated, saturated))[: self._length]

    def result(self) -> float | str:
        """Return the zero force [N], or the reason why there is none. Requires `done`."""
        valid = ~self._saturated.reshape(PARTS, -1).any(axis=1)
        means = self._force.reshape(PARTS, -1)[valid].mean(axis=1)
        if means.size < MIN_PARTS:
            return "refused: the force was at the end of the measuring range"
        zero = float(np.median(means))
        if np.count_nonzero(np.abs(means - zero) <= self._tolerance) < MIN_PARTS:
            return f"refused: the force moved by {np.ptp(means):.3g} N, tare.tolerance is {self._tolerance:g} N"
        return zero
