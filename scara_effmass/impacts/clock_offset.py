# SPDX-License-Identifier: Apache-2.0
"""Offset between the clocks of force and joint states, from the kink in the velocity at an impact."""

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from scara_effmass.values import FloatArray

WINDOW = 0.05
"""The kink is searched within this time before and after the onset of the force [s]."""
LONGEST_CONTACT_S = 0.01
"""Longest contact [s] whose kink is found with joint states at 100 Hz; most of the window must be without contact."""
MIN_STATES = 8
MIN_LOSS = 0.02
"""Minimum relative loss of speed at a kink."""
EARLIER_SHARE = 0.25
"""The kink is the first loss above this share of the largest one; a rebound may take more speed than the impact."""
MIN_RIVAL_LOSS = 0.1
"""Sudden losses of speed below this share of the largest one do not vote for the offset of a recording."""
MAX_RIVAL = 0.9
"""No offset is found if another one has more than this share of its votes."""
MAX_VOTERS = 500
"""Maximum number of impacts, and of kinks, that vote: the strongest ones."""
NOISE_FACTOR = 6.0
"""A kink exceeds this multiple of the robust standard deviation of all changes of speed in the window."""


class ClockOffset(NamedTuple):
    """Offset of the joint clock from the force clock [s] over `impacts` that show a kink.

    Positive: the force is stamped earlier than the joint states. `offset` is the median, `low` and `high` are the
    extremes, `resolution` is half of the longest period of the states. `beyond` impacts exceed the tolerance.
    """

    impacts: int
    offset: float
    low: float
    high: float
    resolution: float
    beyond: int


class Kink(NamedTuple):
    """Delay of the kink in the velocity after the onset of the force, and half the period of the states [s]."""

    delay: float
    resolution: float


def velocity_kink(seconds: FloatArray, velocity: FloatArray, duration: float) -> Kink | None:
    """Return the first large sudden loss of speed in `velocity` (n, 3) [m/s] at the `seconds` (n,) after the onset.

    Half of the loss has occurred in the middle of a contact of `duration` [s]. None if there are too few states, or no
    loss of at least MIN_LOSS that stands out from the noise.
    """
    if len(seconds) < MIN_STATES:
        return None
    speeds = np.linalg.norm(velocity, axis=1)
    fastest = int(np.argmax(speeds))
    if not speeds[fastest] > 0.0:
        return None
    along = velocity @ velocity[fastest] / speeds[fastest]
    period = float(np.median(np.diff(seconds)))
    width = duration + period
    begins = seconds[seconds + width <= seconds[-1]]
    if not begins.size:
        return None
    before = along[: begins.size]
    loss = before - np.interp(begins + width, seconds, along)
    middle = float(np.median(loss))
    noise = 1.4826 * float(np.median(np.abs(loss - middle)))
    threshold = middle + max(NOISE_FACTOR * noise, MIN_LOSS * speeds[fastest])
    large = loss > max(threshold, EARLIER_SHARE * loss.max())
    if not large.any():
        return None
    first = int(np.argmax(large))
    k = first + int(np.argmax(loss[first : int(np.searchsorted(begins, begins[first] + width))]))
    half = float(before[k] - 0.5 * loss[k])
    inside = seconds[(seconds > begins[k]) & (seconds < begins[k] + width)]
    times = np.array([begins[k], *inside, begins[k] + width])
    values = np.interp(times, seconds, along)
    i = int(np.argmax(values[1:] <= half))
    share = (values[i] - half) / (values[i] - values[i + 1])
    return Kink(float(times[i] + share * (times[i + 1] - times[i]) - 0.5 * duration), 0.5 * period)


def recording_offset(
    onsets: FloatArray, impulses: FloatArray, durations: FloatArray, seconds: FloatArray, velocity: FloatArray
) -> Kink | None:
    """Return the offset of the clock of `velocity` (n, 3) [m/s] at `seconds` (n,) from that of m impacts.

    The impacts have `onsets` (m,) [s], `impulses` (m,) [N s] and `durations` (m,) [s]. Each pair of an impact and a
    sudden loss of speed votes for an offset with the product of impulse and loss; kinks near the best offset refine it.
    None if no loss stands out, or if another offset has more than MAX_RIVAL of the votes of the best one.
    """
    if not len(onsets) or len(seconds) < MIN_STATES:
        return None
    period = float(np.median(np.diff(seconds)))
    width = float(np.median(durations)) + period
    speeds = np.linalg.norm(velocity, axis=1)
    after = np.column_stack([np.interp(seconds + width, seconds, component) for component in velocity.T])
    loss = speeds - np.einsum("ij,ij->i", after, velocity) / np.maximum(speeds, np.finfo(float).tiny)
    sudden = loss - np.interp(seconds - width, seconds, loss)  # braking is just as strong before
    begins = np.flatnonzero(sudden > max(MIN_RIVAL_LOSS * sudden.max(), MIN_LOSS * speeds.max()))
    if not begins.size:
        return None
    runs = np.split(begins, np.flatnonzero(np.diff(seconds[begins]) > width) + 1)
    kinks = np.array([run[np.argmax(sudden[run])] for run in runs])
    strongest = np.argsort(-impulses, kind="stable")[:MAX_VOTERS]
    kinks = kinks[np.argsort(-sudden[kinks], kind="stable")[:MAX_VOTERS]]
    offsets = np.subtract.outer(seconds[kinks], onsets[strongest]).ravel()
    votes = np.multiply.outer(sudden[kinks], impulses[strongest]).ravel()
    order = np.argsort(offsets)
    offsets, total = offsets[order], np.concatenate([[0.0], np.cumsum(votes[order])])
    sums = total[np.searchsorted(offsets, offsets + width, side="right")] - total[:-1]
    best = int(np.argmax(sums))
    rivals = np.abs(offsets - offsets[best]) > WINDOW
    if rivals.any() and sums[rivals].max() > MAX_RIVAL * sums[best]:
        return None
    near: list[Kink] = []
    for onset, duration in zip(onsets + offsets[best], durations, strict=True):
        window = slice(*np.searchsorted(seconds, [onset - WINDOW, onset + WINDOW]))
        if kink := velocity_kink(seconds[window] - onset, velocity[window], float(duration)):
            near.append(kink)
    if not near:
        return None
    return Kink(float(offsets[best] + np.median([kink.delay for kink in near])), max(k.resolution for k in near))


def clock_offset(kinks: Iterable[Kink], tolerance: float) -> ClockOffset:
    """Return the offset of a series; without kinks, its resolution is infinite."""
    kinks = list(kinks)
    if not kinks:
        return ClockOffset(0, math.nan, math.nan, math.nan, math.inf, 0)
    delays = np.array([kink.delay for kink in kinks])
    return ClockOffset(
        impacts=len(kinks),
        offset=float(np.median(delays)),
        low=float(delays.min()),
        high=float(delays.max()),
        resolution=max(kink.resolution for kink in kinks),
        beyond=int(np.count_nonzero(np.abs(delays) > tolerance)),
    )
