"""One contact in a stretch of force: where it begins and ends, its peak and its impulse. Units: [N] and samples."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from scara_effmass.values import BoolArray, FloatArray

FOOT = 0.1
"""The flank is taken from this share of the peak..."""
HALF = 0.5
"""...to this one."""


class DetectedContact(NamedTuple):
    """One contact, in samples from the beginning of the stretch."""

    first: int
    """First and last sample that are above the release level."""
    last: int
    onset: float
    end: float
    peak: float
    """[N] above baseline"""
    area: float
    """[N samples] above baseline"""
    complete: bool
    """Both its flanks were seen."""
    clipped: bool = False


def separate(force: FloatArray, valid: BoolArray, level: float, release: float, gap: int) -> list[tuple[int, int]]:
    """Return first and last sample of each contact in `force` (n,) [N] above baseline.

    A contact is above `release`, and somewhere above `level`. It is over after `gap` samples below `release`; those
    that are not `valid` (n,) say nothing about it.
    """
    above = np.flatnonzero((force > release) & valid)
    if not above.size:
        return []
    if valid.all():
        between = np.diff(above) - 1
    else:
        seen = np.cumsum(valid)
        between = np.diff(seen[above]) - 1
    parts = np.flatnonzero(between >= gap)
    first = above[np.concatenate(([0], parts + 1))]
    last = above[np.concatenate((parts, [above.size - 1]))]
    return [(int(i), int(k)) for i, k in zip(first, last, strict=True) if force[i : k + 1].max() > level]


def top(force: FloatArray, index: int) -> float:
    """Return the top of the parabola through the sample at `index`, a local maximum, and its two neighbours [N]."""
    here = float(force[index])
    if index in (0, force.size - 1):
        return here
    before, after = float(force[index - 1]), float(force[index + 1])
    curvature = before - 2.0 * here + after
    return here - (after - before) ** 2 / (8.0 * curvature) if curvature < 0.0 else here


def rise(force: FloatArray, first: int, peak: float) -> tuple[float, bool]:
    """Return where the flank that begins before sample `first` leaves the baseline, and whether it was seen.

    The line through the crossings of FOOT and HALF of the `peak` is followed down to zero, though not past a sample
    that is below zero, nor past the first one. A valley that is higher than FOOT, between two contacts, takes its
    place. At `first` there certainly is contact.
    """
    half = first + int(np.argmax(force[first:] > HALF * peak))
    part = force[: half + 1]
    low = np.flatnonzero(part[:-1] <= HALF * peak)
    if not low.size:
        return 0.0, False
    foot = max(FOOT * peak, float(part[:-1].min()))
    upper = _crossing(part, int(low[-1]), HALF * peak)
    before = int(np.flatnonzero(part[:-1] <= foot)[-1])
    lower = _crossing(part, before, foot)
    onset = lower - foot * (upper - lower) / (HALF * peak - foot) if foot < HALF * peak else lower
    since = _crossing(part, before, 0.0) if part[before] <= 0.0 else 0.0
    return min(max(onset, since), float(first)), foot < 0.5 * (FOOT + HALF) * peak


def _crossing(force: FloatArray, index: int, value: float) -> float:
    """Return where the line from the sample at `index` to the next one has `value`."""
    return index + (value - float(force[index])) / float(force[index + 1] - force[index])


def measure(force: FloatArray, first: int, last: int, earliest: int, latest: int, *, whole: bool) -> DetectedContact:
    """Return the contact from sample `first` to `last` of `force` (n,) [N] above baseline.

    Nothing before sample `earliest` or after `latest` belongs to it. Only a `whole` one, of which no sample is clipped
    or missing, has a parabola for its peak.
    """
    part = force[earliest : latest + 1]
    begin, stop = first - earliest, last - earliest
    index = begin + int(np.argmax(part[begin : stop + 1]))
    peak = top(part, index) if whole else float(part[index])
    onset, rise_seen = rise(part, begin, peak)
    back, fall_seen = rise(part[::-1], part.size - 1 - stop, peak)
    end = part.size - 1 - back
    inside = slice(max(math.ceil(onset), 0), min(math.floor(end), part.size - 1) + 1)
    within = part[inside]
    ends = 0.5 * (within[0] * (inside.start - onset) + within[-1] * (end - (inside.stop - 1)))
    area = float(within.sum() - 0.5 * (within[0] + within[-1]) + ends)
    return DetectedContact(first, last, earliest + onset, earliest + end, peak, area, rise_seen and fall_seen)
