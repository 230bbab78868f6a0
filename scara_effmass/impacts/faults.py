"""What a force signal holds that no force made: runs of a stuck value, and single samples far off."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from scara_effmass.values import BoolArray, FloatArray

_LONE = 0.25
"""A sample is alone when its neighbours are below this share of it: never in a half-sine of 2.4 samples or more."""


def runs(mask: BoolArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return where the runs of True in `mask` (n,) begin and where they have ended."""
    edges = np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=0))
    return edges[::2], edges[1::2]


def has_flat_run(samples: FloatArray, length: int) -> bool:
    """Return whether `length` or more neighbours in `samples` (n,) are equal."""
    equal = samples[1:] == samples[:-1]
    if length > 2 and not np.count_nonzero(equal[1:] & equal[:-1]):
        return False  # no three: soon told, and the usual case
    index = equal.nonzero()[0]
    steps = length - 2
    return index.size > steps and bool((index[steps:] - index[: index.size - steps] == steps).any())


def stuck_runs(
    samples: FloatArray, flat_run: int, zero_run: int, saturated: BoolArray
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return where the drop-outs in `samples` (n,) begin and where they have ended.

    A drop-out is a run of at least `flat_run` equal samples, or of `zero_run` that are exactly zero. Samples that are
    `saturated` (n,) repeat for another reason.
    """
    first, last = runs((samples[1:] == samples[:-1]) & ~saturated[1:])
    stuck = last - first + 1 >= np.where(samples[first] == 0.0, zero_run, flat_run)
    return first[stuck], last[stuck] + 1


def lone_samples(force: FloatArray, level: float) -> NDArray[np.intp]:
    """Return where in `force` (n,) above baseline a single sample is far from both its neighbours.

    Either it is beyond `level` and they are near the baseline, or they are beyond it and the sample is not.
    """
    before, here, after = force[:-2], force[1:-1], force[2:]
    size = np.abs(here)
    spike = (size > level) & (np.maximum(np.abs(before), np.abs(after)) < _LONE * size)
    rim = np.minimum(before, after)
    hole = (rim > level) & (here < _LONE * rim)
    return np.flatnonzero(spike | hole) + 1
