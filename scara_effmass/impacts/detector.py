# SPDX-License-Identifier: Apache-2.0
"""Impact detection in a stream of force blocks; the same live and offline.

Samples are processed in frames that are aligned to the sample number, so neither the block length nor the start of the
recording matters. Quiet frames define the baseline. The first frame that is not quiet starts a segment, and the next
quiet frame ends it; then the segment is classified as a whole.
"""

import math
from collections import deque
from collections.abc import Iterable

import numpy as np

from scara_effmass.impacts.segment import BASELINE_FRAMES, Baseline, DetectedContact, Frame, classify
from scara_effmass.settings import DetectionSettings
from scara_effmass.values import BoolArray, FloatArray, ForceBlock, Impact, true_runs

FRAME_TIME = 0.05
"""Approximate length of a frame [s]: much longer than an impact, much shorter than the quiet start of a recording."""
MIN_FRAME_SAMPLES = 10
GAP_TIME = 0.3e-3
"""Minimum time without force between two contacts [s]; at least MIN_GAP_SAMPLES samples."""
MIN_GAP_SAMPLES = 2
SAME_RATE = 0.01
"""Maximum relative change of the sample rate within a recording; the clock fit varies it a little."""
MIN_QUIET_SHARE = 0.6
"""Minimum share of quiet frames for a baseline if the recording ends before five frames are quiet."""
QUIET_LEVEL = 0.75
"""Maximum median of the quiet frame that ends a segment, as a share of the threshold; above, it is a noisy load."""
RESPONSE_TIME = 0.5
"""A tensile pulse within this time after a contact [s] is a response of sensor, converter or structure to it."""


def finite_parts(block: ForceBlock) -> list[ForceBlock]:
    """Split `block` at samples that are not finite, which are left out."""
    finite = np.isfinite(block.force)
    if block.force.size and finite.all():
        return [block]  # fast path
    saturated = block.saturated_samples
    return [
        block._replace(
            stamp_ns=block.stamp_ns + round(start / block.sample_rate * 1e9),
            first_sample=block.first_sample + start,
            force=block.force[start:stop],
            saturated_samples=saturated[(saturated >= start) & (saturated < stop)] - np.uint32(start),
        )
        for start, stop in true_runs(finite).tolist()
    ]


class SampleBuffer:
    """Latest samples of a stream as the sensor read them: the tare is added back, so that a new tare is not a step."""

    def __init__(self, first_sample: int) -> None:
        self.first = self.end = first_sample
        self._blocks: deque[ForceBlock] = deque()

    def append(self, block: ForceBlock) -> None:
        """Add a block; missing samples before it become NaN, with stamps that follow the block before them."""
        if missing := block.first_sample - self.end:
            last = self._blocks[-1]
            stamp_ns = last.stamp_ns + round((self.end - last.first_sample) / last.sample_rate * 1e9)
            gap = last._replace(stamp_ns=stamp_ns, first_sample=self.end, force=np.full(missing, np.nan))
            self._blocks.append(gap._replace(saturated_samples=block.saturated_samples[:0]))
        self._blocks.append(block)
        self.end = block.first_sample + block.force.size

    def discard_before(self, index: int) -> None:
        """Discard samples older than sample `index`."""
        self.first = max(self.first, index)
        while self._blocks and self._blocks[0].first_sample + self._blocks[0].force.size <= index:
            self._blocks.popleft()

    def samples(self, start: int, stop: int) -> FloatArray:
        """Return the samples in [start, stop) [N]."""
        parts = [
            block.force[max(start - block.first_sample, 0) : stop - block.first_sample] + block.tare
            for block in self._blocks
            if block.first_sample < stop
        ]
        return np.concatenate(parts or [np.empty(0)])

    def saturated(self, start: int, stop: int) -> BoolArray:
        """Return a mask of the samples in [start, stop) at the end of the measuring range."""
        mask = np.zeros(stop - start, dtype=np.bool_)
        for block in self._blocks:
            index = block.saturated_samples.astype(np.int64) + (block.first_sample - start)
            mask[index[(index >= 0) & (index < mask.size)]] = True
        return mask

    def block_at(self, index: int) -> ForceBlock:
        """Return the block that contains sample `index`, or the oldest one."""
        return next((block for block in reversed(self._blocks) if block.first_sample <= index), self._blocks[0])


class Detector:
    """Detects impacts in the blocks of one channel, of any sample rate and block length.

    An impact is returned once a quiet frame has followed it; in a train of contacts, that may take `settings.longest`.

    Counted from the beginning: `dropouts`; `glitches` (single samples); `sustained_contacts`, longer than
    `settings.longest`; and `tensile_pulses`, which would be impacts if the sign of the force were inverted, and hint at
    a wrong `sensor.invert`. Pulses that follow a contact do not count, because AC coupling and ringing respond to
    compression with tension. Force below the baseline for BASELINE_FRAMES frames does not count either: it is a load
    that was removed.

    A sustained contact ends when the force is released, or when it has been steady for `settings.longest`; that load
    then becomes the baseline. Until then, swings of the load are neither impacts nor further sustained contacts.

    Detectors that start at different samples of a stream return the same impacts to the last bit once they have
    settled: after BASELINE_FRAMES + 3 consecutive quiet frames (0.4 s at 12.8 kS/s) and `settings.rebound_time`
    without a contact.
    """

    def __init__(self, settings: DetectionSettings) -> None:
        self._settings = settings
        self._rate = math.nan
        self.dropouts = self.glitches = self.sustained_contacts = self.tensile_pulses = 0
        self.settled = False
        """Whether the baseline is known at the latest sample; only then are impacts detected."""
        self._restart()

    def feed(self, block: ForceBlock) -> list[Impact]:
        """Return the impacts that end with `block`, in order.

        Samples that are not finite count as lost. A contact that continues after lost samples is one incomplete
        contact. A lower sample number or another sample rate starts a new recording.
        """
        impacts: list[Impact] = []
        for part in finite_parts(block):
            impacts += self._join(part)
            self._buffer.append(part)
            impacts += self._advance()
            self.settled = self._settled
        return impacts

    def finish(self) -> list[Impact]:
        """Return the pending impacts; the next block starts a new recording."""
        if math.isnan(self._rate):
            return []
        impacts = self._close()
        self.settled = self._settled
        self._rate = math.nan
        self._restart()
        return impacts

    def _restart(self) -> None:
        self._baseline = Baseline(self._settings)
        self._settled = False
        self._end = self._last = -math.inf  # of the latest impact, and of the latest contact
        self._rebound = 0
        self._frame_size, self._load_frames = MIN_FRAME_SAMPLES, BASELINE_FRAMES
        self._begin(0)

    def _begin(self, first_sample: int) -> None:
        """Expect samples that do not continue the previous ones."""
        self._buffer = SampleBuffer(first_sample)
        self._processed = self._counted = first_sample
        self._segment_start: int | None = None
        self._quiet_frames = self._frames_below = 0
        self._previous_quiet: Frame | None = None
        self._candidates: deque[Frame] = deque(maxlen=self._load_frames)
        self._held_from = first_sample
        self._first_search = True
        self._is_loaded = False  # whether a sustained contact may still continue

    def _join(self, block: ForceBlock) -> list[Impact]:
        """Prepare for `block`; if it does not continue the samples before, return the impacts that end before it."""
        missing = block.first_sample - self._buffer.end
        same_rate = abs(block.sample_rate - self._rate) <= SAME_RATE * self._rate
        self._rate = block.sample_rate
        continues = 0 < missing <= self._settings.longest * self._rate or not (missing or block.lost_samples)
        if same_rate and continues:
            return []
        impacts = self._close()
        if not same_rate or missing:
            self._restart()
        # The size is doubled in whole steps, so that sample rates that differ by a clock error have the same frames.
        doublings = max(0, round(math.log2(FRAME_TIME * self._rate / MIN_FRAME_SAMPLES)))
        self._frame_size = MIN_FRAME_SAMPLES << doublings
        self._load_frames = max(BASELINE_FRAMES, math.ceil(self._settings.longest * self._rate / self._frame_size))
        self._begin(block.first_sample)
        return impacts

    def _frame_end(self, index: int) -> int:
        """Return the end of the frame that contains sample `index`."""
        return (index // self._frame_size + 1) * self._frame_size

    def _advance(self) -> list[Impact]:
        impacts: list[Impact] = []
        while (stop := self._frame_end(self._processed)) <= self._buffer.end:  # the first frame may be incomplete
            frame = Frame(self._buffer.samples(self._processed, stop))
            self._processed = stop
            if self._settled:
                impacts += self._process(frame)
            else:
                self._search_baseline(frame)
        needed = self._processed - self._frame_size if self._settled else self._held_from - self._frame_size
        self._buffer.discard_before(needed if self._segment_start is None else min(needed, self._segment_start))
        return impacts

    def _search_baseline(self, frame: Frame) -> None:
        """Search for a baseline; once it is known, process the held samples again."""
        if frame.is_present:
            self._candidates.append(frame)
        hold = BASELINE_FRAMES * self._frame_size
        if self._first_search:
            hold = max(round(self._settings.longest * self._rate), 2 * hold)
        recent = list(self._candidates)[-BASELINE_FRAMES:]
        is_steady = len(recent) == BASELINE_FRAMES and self._baseline.is_steady(recent)
        if is_steady and not self._is_moving_load(recent):
            self._adopt(recent)
        if not self._settled and self._processed - self._held_from >= hold:
            self._held_from = self._frame_end(self._held_from)

    def _is_moving_load(self, recent: Iterable[Frame]) -> bool:
        """Return whether `recent` is above the lost baseline and the force was not within a threshold for `longest`."""
        levels, recent_levels = ([f.median_and_deviation[0] for f in frames] for frames in (self._candidates, recent))
        is_load = not self._first_search and np.median(recent_levels) > self._baseline.force + self._baseline.threshold
        return bool(is_load and (len(levels) < self._load_frames or np.ptp(levels) > self._baseline.threshold))

    def _adopt(self, frames: Iterable[Frame]) -> None:
        """Adopt `frames` as the baseline, unless the signal is stuck but was noisy before."""
        baseline = Baseline(self._settings, frames)
        if baseline.noise > 0.0 or self._baseline.flat_run > BASELINE_FRAMES * self._frame_size:
            self._baseline = baseline
            self._settled = True
            self._processed = self._held_from
            if not self._first_search:
                self._counted = self._held_from + 1  # events that continue from before have been counted

    def _lose_baseline(self, start: int) -> list[Impact]:
        """Report the segment from `start`, and search for another baseline from here on."""
        sustained = self.sustained_contacts
        impacts = self._report(self._classify(start, self._processed), start)
        self._is_loaded |= self.sustained_contacts > sustained
        self._settled = self._first_search = False
        self._held_from = self._processed
        self._segment_start = None
        return impacts

    def _process(self, frame: Frame) -> list[Impact]:
        """Process the next frame."""
        quiet = self._baseline.is_quiet(frame)
        if quiet and self._segment_start is None:
            self._update_baseline(frame)
            return []
        level = float(np.median(frame.samples)) - self._baseline.force if frame.is_present else 0.0
        self._quiet_frames = 0
        if self._segment_start is None:
            self._segment_start = max(self._processed - 2 * self._frame_size, self._buffer.first)
            self._frames_below = 0
            self._candidates.clear()
        if quiet and level <= QUIET_LEVEL * self._baseline.threshold:
            impacts = self._report(self._classify(self._segment_start, self._processed), self._segment_start)
            self._segment_start = None
            return impacts
        below = level < -self._baseline.threshold
        self._frames_below = self._frames_below + 1 if below else 0
        if self._frames_below == BASELINE_FRAMES:
            self._candidates.clear()
            return self._lose_baseline(self._segment_start)
        if frame.is_present:
            self._candidates.append(frame)
        longest = self._settings.longest * self._buffer.block_at(self._segment_start).sample_rate
        if self._processed - self._segment_start > longest + 2 * self._frame_size:
            return self._split(self._segment_start)
        return []

    def _update_baseline(self, frame: Frame) -> None:
        """Add the quiet frame before `frame` to the baseline if both of its neighbours are quiet."""
        self._quiet_frames += 1
        self._is_loaded = False
        if self._quiet_frames >= 3 and self._previous_quiet is not None:
            self._baseline = self._baseline.extended([self._previous_quiet])
        self._previous_quiet = frame

    def _split(self, start: int) -> list[Impact]:
        """Report the finished contacts of a segment that is too long, and continue with the unfinished one."""
        contacts = self._classify(start, self._processed)
        present = np.flatnonzero(np.isfinite(self._buffer.samples(start, self._processed)))
        at_end = bool(contacts) and contacts[-1].last >= present[-1] - self._frame_size  # a gap may follow
        if not at_end or self._is_sustained(contacts[-1], start):
            return self._lose_baseline(start)
        unfinished, finished = contacts[-1], contacts[:-1]
        after_finished = finished[-1].last + 1 if finished else 0
        self._segment_start = start + max(unfinished.first - self._frame_size, after_finished)
        return self._report(finished, start)

    def _close(self) -> list[Impact]:
        """Return the impacts in the pending samples, which no further samples continue."""
        buffer = self._buffer
        impacts: list[Impact] = []
        if not self._settled:
            rest = buffer.samples(self._processed, buffer.end)
            frames = [*self._candidates, *([Frame(rest)] if rest.size >= MIN_FRAME_SAMPLES else [])]
            share = MIN_QUIET_SHARE if self._first_search else 1.0
            if frames and self._baseline.is_steady(frames, share) and not self._is_moving_load(frames):
                self._adopt(frames)
                impacts += self._advance()
        if self._settled:
            start = self._segment_start
            if start is None:
                start = max(self._processed - self._frame_size, buffer.first)
            impacts += self._report(self._classify(start, buffer.end), start)
        return impacts

    def _classify(self, start: int, stop: int) -> list[DetectedContact]:
        """Return the contacts in the samples [start, stop), and count new dropouts, glitches and tensile pulses."""
        buffer = self._buffer
        gap = max(round(GAP_TIME * buffer.block_at(start).sample_rate), MIN_GAP_SAMPLES)
        samples, saturated = buffer.samples(start, stop), buffer.saturated(start, stop)
        longest = round(self._settings.longest * buffer.block_at(start).sample_rate)
        segment = classify(samples, saturated, self._baseline, gap, self._frame_size, longest)
        self.dropouts += int(np.count_nonzero(segment.dropouts + start >= self._counted))
        self.glitches += int(np.count_nonzero(segment.glitches + start >= self._counted))
        for pulse in segment.tensile_pulses:
            earlier = (start + contact.last for contact in segment.contacts if contact.first < pulse.first)
            delay = start + pulse.first - max(earlier, default=self._last)
            is_response = delay <= RESPONSE_TIME * buffer.block_at(start + pulse.first).sample_rate
            is_new = start + pulse.last >= self._counted
            is_impact = pulse.complete and not self._is_sustained(pulse, start)
            self.tensile_pulses += is_impact and is_new and not is_response
        self._counted = stop
        return segment.contacts

    def _is_sustained(self, contact: DetectedContact, start: int) -> bool:
        """Return whether `contact` of the segment that starts at sample `start` is too long for an impact."""
        sample_rate = self._buffer.block_at(start + contact.first).sample_rate
        return contact.last - contact.first >= round(self._settings.longest * sample_rate)

    def _report(self, contacts: Iterable[DetectedContact], start: int) -> list[Impact]:
        """Return the impacts among `contacts` of the segment from sample `start` on; count sustained contacts."""
        impacts: list[Impact] = []
        for contact in contacts:
            if self._is_sustained(contact, start):
                self.sustained_contacts += not self._is_loaded
            elif contact.complete or not self._is_loaded:  # otherwise it is the end of a sustained contact
                impacts.append(self._impact(contact, start))
            self._last = start + contact.last
        return impacts

    def _impact(self, contact: DetectedContact, start: int) -> Impact:
        block = self._buffer.block_at(start + math.floor(contact.onset))
        onset = start + contact.onset
        is_rebound = onset - self._end <= self._settings.rebound_time * block.sample_rate
        self._rebound = self._rebound + 1 if is_rebound else 0
        self._end = start + contact.end
        samples_into_block = (start - block.first_sample) + contact.onset
        return Impact(
            stamp_ns=block.stamp_ns + round(samples_into_block / block.sample_rate * 1e9),
            frame_id=block.frame_id,
            peak_force=contact.peak,
            duration=(contact.end - contact.onset) / block.sample_rate,
            impulse=contact.area / block.sample_rate,
            compression_impulse=contact.compression_area / block.sample_rate,
            onset_sample=onset,
            clipped=contact.clipped,
            incomplete=not contact.complete,
            rebound=self._rebound,
            baseline=self._baseline.force - block.tare,
            noise=self._baseline.noise,
            clock_residual=block.clock_residual,
            source=block.source,
            simulated=block.simulated,
        )
