# SPDX-License-Identifier: Apache-2.0
"""Baseline of the force, and classification of a segment with activity: contacts, tensile pulses, dropouts, glitches.

The baseline is level and noise without contact, and how long runs of equal samples normally get. Forces are in [N],
positions and durations in samples.
"""

from __future__ import annotations

import math
import sys
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

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

_COARSE_LEVELS = 2
"""Maximum number of values of a quiet sensor of coarse resolution."""
_COARSE_STEPS = 1.5
"""A drift by less than this number of its steps leads to a value that it repeats as the ones before."""

FLANK_LOW = 0.1
"""A flank is extrapolated from this share of the peak ..."""
FLANK_HIGH = 0.5
"""... to this one."""
MIN_INCOMPLETE_SAMPLES = 3
"""Minimum number of samples of a contact that is not complete."""
PEAK_SHARE = 0.8
"""A polynomial through the samples above this share of the peak gives its time."""
MIN_CUBIC_SAMPLES = 6
_GLITCH_SHARE = 0.25
"""The neighbours of a glitch are below this share of it; half-sines of 2.4 samples and more are therefore none."""
_MIN_REST_SAMPLES, _MIN_REST_GAPS, _REST_SPREAD = 8, 5, 2.0
"""Between two contacts, the force is at rest if it lasts for this many samples and minimum gaps, and if its median
and interquartile range are at most this multiple of the noise."""
RELEASE = 0.5
"""A contact ends below this share of the threshold."""
_PRESS_SHARE = 0.2
"""A contact that stays is a press if it reaches PEAK_SHARE of its peak later than this share of the transient time, or
if it does not fall below that again in the transient time."""
SINGLE_SAMPLE = "single samples"
STUCK = "signal stuck or dropped out"
NO_CONTACT = "too short for a contact, or no compression in total"
NOISE = "noise or ringing beside a contact"


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
    centre = _median(samples)
    return centre, _GAUSSIAN * _median(np.abs(samples - centre))


def _median(samples: FloatArray) -> float:
    """Return the median of finite `samples` (n,), in a fraction of the time that numpy takes for few samples."""
    last = samples.size // 2
    first = last - 1 + samples.size % 2
    ordered = np.partition(samples, (first, last))
    return 0.5 * float(ordered[first] + ordered[last])


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

    `frames` are the quiet frames. Statistics are computed on demand, because the extremes of a frame usually suffice to
    show that it is quiet.
    """

    def __init__(self, settings: DetectionSettings, frames: Iterable[Frame] = ()) -> None:
        self._settings = settings
        self.frames = tuple(frames)[-BASELINE_FRAMES:]

    def extended(self, frames: Iterable[Frame]) -> Baseline:
        """Return the baseline after further quiet `frames`, which replace the oldest ones."""
        return Baseline(self._settings, (*self.frames, *frames))

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
        return self.threshold_for(self.noise) if self.frames else math.inf

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

    @cached_property
    def drift(self) -> float:
        """Distance from the level [N] within which a quiet sensor of coarse resolution repeats any value; else 0."""
        levels = np.unique(np.concatenate([frame.samples for frame in self.frames]))
        return _COARSE_STEPS * float(np.ptp(levels)) if levels.size == _COARSE_LEVELS else 0.0

    def is_stuck(self, samples: FloatArray) -> bool:
        """Return whether finite `samples` (n,) have a run of equal ones that is a dropout."""
        run = longest_flat_run(samples)
        if run < MIN_FLAT_RUN or run < self.flat_run:
            return False
        return not np.abs(samples - self.force).max() < self.drift

    def threshold_for(self, noise: float) -> float:
        """Return the contact threshold for `noise` [N]; at least that of the baseline."""
        return max(self._settings.threshold, self._settings.noise_factor * max(noise, self.noise))

    def is_quiet(self, frame: Frame) -> bool:
        """Return whether `frame` contains neither a contact, nor a tensile pulse, nor a dropout, nor a large gap."""
        if not frame.is_present:
            return False
        low, high = min([f.low for f in self.frames]), max([f.high for f in self.frames])
        # Fast path without statistics: the level of the baseline lies between the extremes of its frames.
        is_near = high - self._settings.threshold <= frame.low and frame.high <= low + self._settings.threshold
        if not is_near and not self.force - self.threshold <= frame.low <= frame.high <= self.force + self.threshold:
            return False
        return not self.is_stuck(frame.samples)

    def is_steady(self, frames: Iterable[Frame], share: float = 1.0) -> bool:
        """Return whether at least `share` of `frames` have about the same median.

        The tolerance follows from the noise within frames, so a ramp is not steady.
        """
        centres, deviations = np.array([frame.median_and_deviation for frame in frames]).T
        tolerance = max(self._settings.threshold, 3.0 * float(np.median(deviations)))
        return bool(np.mean(np.abs(centres - np.median(centres)) <= tolerance) >= share)

    @cached_property
    def _force_and_noise(self) -> tuple[float, float]:
        if not self.frames:
            return 0.0, 0.0
        parts = [frame.subsamples for frame in self.frames]
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
        marked = sum(int(np.count_nonzero(mark(frame.samples))) for frame in self.frames)
        return (1 + marked) / (1 + sum(frame.samples.size for frame in self.frames))


class DetectedContact(NamedTuple):
    """One contact; positions count from the start of the segment."""

    first: int
    """First and last sample above the release level."""
    last: int
    onset: float
    end: float
    peak: float
    """[N] above baseline"""
    area: float
    """[N samples] above baseline"""
    compression_area: float
    """[N samples] above baseline, from the onset to the peak"""
    complete: bool
    """Whether the rise and all samples of the transient were recorded, and of a contact that ends in it, the fall.

    False beside a single sample far above its neighbours, which may be its top and is then its `peak`.
    """
    clipped: bool = False
    held: float = 0.0
    """[N] largest force after the transient, 0 if the contact ended in it"""


class Remainder(NamedTuple):
    """Force above the threshold outside of all contacts: first sample, largest force [N] above baseline, and reason."""

    first: int
    peak: float
    reason: str


class Segment(NamedTuple):
    """Content of a segment; dropouts and glitches are given by their first samples."""

    contacts: list[DetectedContact]
    tensile_pulses: list[DetectedContact]
    """Contacts that the force has if its sign is inverted."""
    dropouts: NDArray[np.intp]
    glitches: NDArray[np.intp]
    remainders: list[Remainder]


Span = tuple[int, int]
"""First and last sample of a contact."""


class _Signal(NamedTuple):
    """Force (n,) [N] above `baseline`, masks (n,) of the valid and the saturated samples, and contact threshold [N].

    The other numbers are those of `classify`.
    """

    force: FloatArray
    valid: BoolArray
    saturated: BoolArray
    baseline: Baseline
    threshold: float
    gap: int
    margin: int
    longest: int
    transient: int


def classify(
    samples: FloatArray,
    saturated: BoolArray,
    baseline: Baseline,
    gap: int,
    margin: int,
    longest: int = sys.maxsize,
    transient: int = sys.maxsize,
) -> Segment:
    """Return the content of `samples` (n,) [N]; missing samples are NaN.

    Contacts are separated by at least `gap` samples without force. A contact is complete only if the `margin` samples
    before it are at the baseline. A load that swings for `longest` samples is one contact. The peak of a contact is
    that of its first `transient` samples.
    """
    force = samples - baseline.force
    dropouts = flat_runs(samples, baseline.flat_run, baseline.zero_run, saturated)
    dropouts = dropouts[np.abs(force[dropouts[:, 0]]) >= baseline.drift]
    valid = np.isfinite(samples)
    for start, stop in dropouts:
        valid[start:stop] = False
    if baseline.zero_run == MIN_ZERO_RUN:
        valid[[0, -1]] &= samples[[0, -1]] != 0.0  # they may belong to a run that continues outside
    force[~valid] = 0.0
    threshold = _threshold(force, valid, baseline, gap, margin)
    glitches = lone_samples(force, threshold)
    glitches = glitches[valid[glitches - 1] & valid[glitches] & valid[glitches + 1]]
    single = force[glitches]
    force[glitches] = 0.5 * (force[glitches - 1] + force[glitches + 1])

    signal = _Signal(force, valid, saturated, baseline, threshold, gap, margin, longest, transient)
    contacts, others = _contacts(signal)
    tensile_pulses: list[DetectedContact] = []
    if force.min() < -baseline.threshold:
        threshold = _threshold(-force, valid, baseline, gap, margin)
        pulls = signal._replace(force=-force, threshold=threshold, longest=sys.maxsize, transient=sys.maxsize)
        tensile_pulses, _ = _contacts(pulls)
    spans = [(first, last + 1, NO_CONTACT) for first, last in others]
    spans += [(start, stop, STUCK) for start, stop in dropouts.tolist()]
    for index, height in zip(glitches.tolist(), single.tolist(), strict=True):
        beside = [n for n, contact in enumerate(contacts) if contact.first - 1 <= index <= contact.last + 1]
        if beside and height > force[index]:  # it may be the top of the contact
            contact = contacts[beside[0]]
            contacts[beside[0]] = contact._replace(peak=max(contact.peak, height), complete=False)
        else:
            spans.append((index, index + 1, SINGLE_SAMPLE))
    remainders = _remainders(samples - baseline.force, baseline.threshold, contacts, spans)
    return Segment(contacts, tensile_pulses, dropouts[:, 0], glitches, remainders)


def _remainders(
    force: FloatArray, threshold: float, contacts: Iterable[DetectedContact], spans: Iterable[tuple[int, int, str]]
) -> list[Remainder]:
    """Return the force (n,) [N] above `threshold` outside of `contacts`: `spans` with reasons, and the rest."""
    rest = np.where(np.isfinite(force), force, 0.0)
    remainders = []
    for start, stop, reason in spans:
        remainders.append(Remainder(int(start), float(rest[start:stop].max()), reason))
        rest[start:stop] = 0.0
    for contact in contacts:
        rest[contact.first : contact.last + 1] = 0.0
    if (peak := float(rest.max(initial=0.0))) > threshold:
        remainders.append(Remainder(int(rest.argmax()), peak, NOISE))
    return [remainder for remainder in remainders if remainder.peak > threshold]


def flat_runs(samples: FloatArray, flat_run: int, zero_run: int, saturated: BoolArray) -> NDArray[np.intp]:
    """Return start and stop (k, 2) of each dropout in `samples` (n,).

    A dropout is a run of at least `flat_run` equal samples, or of `zero_run` exact zeros. `saturated` (n,) samples do
    not count, because they repeat at the end of the measuring range.
    """
    runs = true_runs((samples[1:] == samples[:-1]) & ~saturated[1:]) + np.array((0, 1))
    min_run = np.where(samples[runs[:, 0]] == 0.0, zero_run, flat_run)
    dropouts: NDArray[np.intp] = runs[np.diff(runs)[:, 0] >= min_run]
    return dropouts


def lone_samples(force: FloatArray, threshold: float) -> NDArray[np.intp]:
    """Return the positions in `force` (n,) above baseline of single samples far from both neighbours.

    Either the sample exceeds `threshold` and its neighbours are near the baseline (a spike), or the other way around (a
    hole). A sample next to a hole is not a spike.
    """
    previous, current, following = force[:-2], force[1:-1], force[2:]
    size = np.abs(current)
    spike = (size > threshold) & (np.maximum(np.abs(previous), np.abs(following)) < _GLITCH_SHARE * size)
    rim = np.minimum(previous, following)
    hole = (rim > threshold) & (current < _GLITCH_SHARE * rim)
    between_holes = np.zeros_like(hole)
    between_holes[1:] |= hole[:-1]
    between_holes[:-1] |= hole[1:]
    return np.flatnonzero(spike & ~between_holes | hole) + 1


def separate(force: FloatArray, valid: BoolArray, threshold: float, gap: int) -> list[tuple[int, int]]:
    """Return first and last sample of each contact in `force` (n,) [N] above baseline.

    A contact exceeds `threshold` at least once, and ends when the force is below half of it for `gap` samples; samples
    that are not `valid` (n,) do not count.
    """
    above = np.flatnonzero((force > RELEASE * threshold) & valid)
    if not above.size:
        return []
    between = np.diff(np.cumsum(valid)[above]) - 1
    parts = np.split(above, np.flatnonzero(between >= gap) + 1)
    return [(int(part[0]), int(part[-1])) for part in parts if force[part].max() > threshold]


def interpolated_peak(force: FloatArray, index: int) -> float:
    """Return the vertex [N] of the parabola through `index` and its neighbours; the force there without a maximum."""
    current = float(force[index])
    if index in (0, force.size - 1):
        return current
    previous, following = float(force[index - 1]), float(force[index + 1])
    if current < max(previous, following):  # the force still rises
        return current
    curvature = previous - 2.0 * current + following
    return current - (following - previous) ** 2 / (8.0 * curvature) if curvature < 0.0 else current


def flank_onset(force: FloatArray, first: int, peak: float) -> tuple[float, bool]:
    """Return where the rising flank before sample `first` leaves the baseline, and whether the flank was recorded.

    The line through the points where the flank crosses FLANK_LOW and FLANK_HIGH of the `peak` is extrapolated to zero,
    but not beyond the last sample below zero or the first sample of `force`. If the force between two contacts does not
    fall to FLANK_LOW, its minimum takes that place. The onset is not after `first`, where there is certainly contact.
    """
    high = FLANK_HIGH * peak
    high_index = first + int(np.argmax(force[first:] > high))
    flank = force[: high_index + 1]
    below_high = np.flatnonzero(flank[:-1] <= high)
    if not below_high.size:
        return 0.0, False
    low = max(FLANK_LOW * peak, float(flank[:-1].min()))
    upper = _crossing(flank, int(below_high[-1]), high)
    low_index = int(np.flatnonzero(flank[:-1] <= low)[-1])
    lower = _crossing(flank, low_index, low)
    extrapolated = lower - low * (upper - lower) / (high - low) if low < high else lower
    earliest = _crossing(flank, low_index, 0.0) if flank[low_index] <= 0.0 else 0.0
    return min(max(extrapolated, earliest), float(first)), low < 0.5 * (FLANK_LOW + FLANK_HIGH) * peak


def compression_area(force: FloatArray, onset: float, index: int) -> float:
    """Return the integral [N samples] of `force` (n,) [N] from `onset` [samples] to the peak near sample `index`.

    The force is so flat near its top that noise decides which sample is the largest. The time of the peak is therefore
    that of a least-squares cubic, or of a parabola if there are few samples. The trapezoidal sum is corrected for the
    curvature (Euler-Maclaurin; the slope is 0 at the peak).
    """
    top = force > PEAK_SHARE * force[index]
    low = index - int(np.argmin(top[index::-1])) + 1 if not top[: index + 1].all() else 0
    high = index + int(np.argmin(top[index:])) if not top[index:].all() else force.size
    low, high = max(min(low, index - 1), 0), min(max(high, index + 2), force.size)
    peak_at = float(index)
    if high - low >= 3:
        offsets = np.arange(low, high) - peak_at
        degree = 3 if offsets.size >= MIN_CUBIC_SAMPLES else 2
        a, b, c, _ = np.pad(np.linalg.pinv(np.vander(offsets, degree + 1)) @ force[low:high], (3 - degree, 0))
        root = b * b - 3.0 * a * c
        if b < 0.0 <= root:
            peak_at += float(np.clip(-c / (b - math.sqrt(root)), offsets[0], offsets[-1]))
    first, last = math.ceil(onset), math.floor(peak_at)
    inside = force[first : last + 1]
    if inside.size < 2:
        return 0.5 * float(force[index]) * max(peak_at - onset, 0.0)
    ends = 0.5 * inside[0] * (first - onset) + inside[-1] * (peak_at - last)
    return float(inside.sum() - 0.5 * (inside[0] + inside[-1]) + ends + (inside[1] - inside[0]) / 12.0)


def measure(
    force: FloatArray,
    first: int,
    last: int,
    earliest: int,
    latest: int,
    *,
    intact: bool,
    transient: int = sys.maxsize,
) -> DetectedContact:
    """Return the contact from sample `first` to `last` of `force` (n,) [N] above baseline.

    Samples before `earliest` or after `latest` belong to other contacts. The peak is that of the first `transient`
    samples. It is interpolated only if the contact is `intact`: no sample is clipped or missing.
    """
    part = force[earliest : latest + 1]
    begin, stop = first - earliest, last - earliest
    later = part[begin + transient + 1 : stop + 1]
    held = float(later.max()) if later.size else 0.0
    index = begin + int(np.argmax(part[begin : stop + 1 - later.size]))
    peak = interpolated_peak(part, index) if intact else float(part[index])
    start, rise_recorded = flank_onset(part, begin, peak)
    reversed_end, fall_recorded = flank_onset(part[::-1], part.size - 1 - stop, held or peak)
    is_high = part[begin : stop + 1 - later.size] > PEAK_SHARE * peak
    is_slow = int(np.argmax(is_high)) > _PRESS_SHARE * transient or bool(is_high[index - begin :].all())
    end = part.size - 1 - reversed_end
    inside = slice(math.ceil(start), math.floor(end) + 1)
    within = part[inside]
    ends = 0.5 * (within[0] * (inside.start - start) + within[-1] * (end - (inside.stop - 1)))
    area = float(within.sum() - 0.5 * (within[0] + within[-1]) + ends)
    return DetectedContact(
        first=first,
        last=last,
        onset=earliest + start,
        end=earliest + end,
        peak=peak,
        area=area,
        compression_area=0.0 if later.size and is_slow else compression_area(part[: stop + 1], max(start, 0.0), index),
        complete=rise_recorded and (fall_recorded or later.size > 0),
        held=held,
    )


def _contacts(signal: _Signal) -> tuple[list[DetectedContact], list[Span]]:
    """Return the contacts in `signal`, and first and last sample of what is above the threshold but no contact."""
    contacts: list[DetectedContact] = []
    others: list[Span] = []
    spans = separate(signal.force, signal.valid, signal.threshold, signal.gap)
    for span in _loads(signal, spans):
        contact = _contact(signal, span, spans)
        present = np.count_nonzero(signal.valid[span[0] : span[1] + 1])
        # In total, a contact compresses the sensor; noise does not.
        if contact.area > 0.0 and (contact.complete or present >= MIN_INCOMPLETE_SAMPLES):
            contacts.append(contact)
        else:
            others.append(span)
    return contacts, others


def _contact(signal: _Signal, span: Span, spans: list[Span]) -> DetectedContact:
    """Return the contact in `span`; others of `spans` bound its flanks."""
    force, valid, threshold = signal.force, signal.valid, signal.threshold
    first, last = span
    before, after = bisect_left(spans, (first, first)), bisect_right(spans, (last, last))
    earliest = spans[before - 1][1] + 1 if before else 0
    latest = spans[after][0] - 1 if after < len(spans) else force.size - 1
    clipped = bool(signal.saturated[first : last + 1].any())
    top = first + int(np.argmax(force[first : last + 1]))
    intact = not clipped and bool(valid[first : last + 1].all() and valid[max(top - 1, 0) : top + 2].all())
    contact = measure(force, first, last, earliest, latest, intact=intact, transient=signal.transient)
    rest = force[max(earliest, first - signal.margin) : first]
    end = first + signal.transient if contact.held else math.ceil(contact.end)
    complete = (
        contact.complete
        and first > 0
        and (last < force.size - 1 or contact.held > 0.0)
        and bool(valid[max(math.floor(contact.onset), 0) : end + 1].all())
        and (rest.size < MIN_INCOMPLETE_SAMPLES or abs(float(np.median(rest))) <= threshold)
        # Force below the baseline shows a load that was released since; after another contact it may be ringing.
        and bool(before or np.count_nonzero(rest < -threshold) < MIN_INCOMPLETE_SAMPLES)
    )
    if contact.held and not complete:  # how quickly the force rose is not known
        contact = contact._replace(compression_area=0.0)
    return contact._replace(complete=complete, clipped=clipped)


def _loads(signal: _Signal, spans: list[Span]) -> list[Span]:
    """Return `spans`, in which those during which the force swings about a load are joined.

    The force must swing for `signal.longest` samples, without being at rest between two contacts.
    """
    force, baseline = signal.force, signal.baseline
    if not spans or spans[-1][1] - spans[0][0] < signal.longest:
        return spans
    min_rest = max(_MIN_REST_SAMPLES, _MIN_REST_GAPS * signal.gap)
    chains = [spans[:1]]
    for span in spans[1:]:
        between = force[chains[-1][-1][1] + 1 : span[0]]
        low, level, high = np.percentile(between, (25.0, 50.0, 75.0))
        if between.size >= min_rest and max(abs(level), high - low) <= _REST_SPREAD * baseline.noise:
            chains.append([span])
        else:
            chains[-1].append(span)
    joined: list[Span] = []
    for chain in chains:
        first, last = chain[0][0], chain[-1][1]
        is_load = last - first >= signal.longest and force[first : last + 1].mean() > RELEASE * baseline.threshold
        joined += [(first, last)] if is_load else chain
    return joined


def _threshold(force: FloatArray, valid: BoolArray, baseline: Baseline, gap: int, margin: int) -> float:
    """Return the contact threshold [N].

    It is that of the baseline, but higher if the force outside the contacts is noisier, as while the structure rings.
    A slow change, as after a press with AC coupling, is no noise: each part of `margin` samples has a level of its own.
    """
    outside = valid.copy()
    for first, last in separate(force, valid, baseline.threshold, gap):
        outside[first : last + 1] = False
    rest = force[outside]
    if not rest.size:
        return baseline.threshold
    parts = np.array_split(rest, max(rest.size // margin, 1))
    noise = np.concatenate([part - _median(part) for part in parts])
    return baseline.threshold_for(median_and_deviation(noise)[1])


def _crossing(force: FloatArray, index: int, value: float) -> float:
    """Return the position at which the line from sample `index` to the next one reaches `value`."""
    return index + (value - float(force[index])) / float(force[index + 1] - force[index])
