# SPDX-License-Identifier: Apache-2.0
"""Impact detection in a stream of force blocks; the same live and offline.

Samples are processed in frames that are aligned to the sample number, so neither the block length nor the start of the
recording matters. Quiet frames define the baseline. The first frame that is not quiet starts a segment, and the next
quiet frame ends it; then the segment is classified as a whole.
"""

import math
from collections import deque
from collections.abc import Iterable, Sequence

import numpy as np

from scara_effmass.impacts.load import (
    EARLIER_LOAD,
    IN_NOISE,
    LATER_LOAD,
    NO_BASELINE,
    SLOW_CHANGE,
    TENSION,
    HeldContact,
    LeftOuts,
    LoadLevel,
)
from scara_effmass.impacts.segment import (
    BASELINE_FRAMES,
    NOISE,
    RELEASE,
    SINGLE_SAMPLE,
    Baseline,
    DetectedContact,
    Frame,
    Segment,
    classify,
)
from scara_effmass.iso15066 import TRANSIENT_S
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
REST_TIME = 0.5
"""A load that is at rest for this time [s] becomes the baseline: its medians vary by at most REST_SHARE of the
threshold. A hand is never that still."""
REST_SHARE = 0.1
RELEASED_TIME = 0.04
"""Time at the baseline before a load [s] that ends the load; at least MIN_RELEASED_SAMPLES samples."""
MIN_RELEASED_SAMPLES = 8
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
    If the force stays, the impact is returned when the force is released, when it has been steady (for
    `settings.longest`, or at rest for REST_TIME, or for BASELINE_FRAMES frames before it rises) and thus becomes the
    baseline, or MAX_HELD_S after the onset. It then states the `held_force`. Contacts on a baseline that an earlier
    contact left state that `load_force`.

    Counted from the beginning: `dropouts`; `glitches` (single samples); `sustained_contacts`, longer than
    `settings.longest`; and `tensile_pulses`, which would be impacts if the sign of the force were inverted, and hint at
    a wrong `sensor.invert`. Pulses that follow a contact do not count, because AC coupling and ringing respond to
    compression with tension. Force below the baseline for BASELINE_FRAMES frames does not count either: it is a load
    that was removed. `left_out` counts, with its peak, all force above the threshold that is in no impact, and without
    one each stretch of saturated samples at the baseline, as of an open sensor.

    Detectors that start at different samples of a stream return the same impacts to the last bit once they have
    settled: after BASELINE_FRAMES + 3 consecutive quiet frames (0.4 s at 12.8 kS/s) and `settings.rebound_time`
    without a contact; only `load_force` needs the whole stream.
    """

    def __init__(self, settings: DetectionSettings) -> None:
        self._settings = settings
        self._rate = math.nan
        self._tare_stamp_ns = 0
        self.left_out = LeftOuts()
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
            if part.tare_stamp_ns != self._tare_stamp_ns:
                self._tare_stamp_ns = part.tare_stamp_ns
                self._level.tare()
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
        self._frame_size = MIN_FRAME_SAMPLES
        self._load_frames = self._rest_frames = BASELINE_FRAMES
        self._unloaded: Baseline | None = None  # the latest baseline that includes no load
        self._level = LoadLevel(self._settings.threshold)
        self._held: HeldContact | None = None
        self._slow: HeldContact | None = None
        self._tare_stamp_ns = 0
        self._begin(0)

    def _begin(self, first_sample: int) -> None:
        """Expect samples that do not continue the previous ones."""
        self._buffer = SampleBuffer(first_sample)
        self._processed = self._counted = self._seen = first_sample
        self._segment_start: int | None = None
        self._quiet_frames = self._frames_below = 0
        self._previous_quiet: Frame | None = None
        self._candidates: deque[Frame] = deque(maxlen=self._load_frames)
        self._held_from = first_sample
        self._first_search = True
        self._is_loaded = False  # whether a sustained contact may still continue
        self._later_load = False  # whether it goes on after its report
        self._unseen = math.inf, -math.inf, 0  # lowest level, largest force and its time before the first baseline

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
        self._load_frames, self._rest_frames = (
            max(BASELINE_FRAMES, round(seconds * self._rate / self._frame_size))
            for seconds in (self._settings.longest, REST_TIME)
        )
        self._begin(block.first_sample)
        return impacts

    def _frame_end(self, index: int) -> int:
        """Return the end of the frame that contains sample `index`."""
        return (index // self._frame_size + 1) * self._frame_size

    def _advance(self) -> list[Impact]:
        impacts: list[Impact] = []
        while (stop := self._frame_end(self._processed)) <= self._buffer.end:  # the first frame may be incomplete
            frame = Frame(self._buffer.samples(self._processed, stop))
            self._count_unknown(frame, self._processed, stop)
            self._processed = stop
            impacts += self._process(frame) if self._settled else self._search_baseline(frame)
        needed = self._processed - self._frame_size if self._settled else self._held_from - self._frame_size
        self._buffer.discard_before(needed if self._segment_start is None else min(needed, self._segment_start))
        return impacts

    def _count_unknown(self, frame: Frame, start: int, stop: int) -> None:
        """Count the frame of the samples [start, stop) and take it for missing if all are saturated by no contact."""
        is_contact = frame.high > self._baseline.force + self._baseline.threshold
        if is_contact or not self._buffer.saturated(start, stop).all():
            return
        frame.is_present = False
        if stop > self._seen:
            self.left_out.add_unknown(self._stamp_ns(start), start, stop)
            self._seen = stop

    def _search_baseline(self, frame: Frame) -> list[Impact]:
        """Search for a baseline; once it is known, process the held samples again. Return a contact that ends."""
        if frame.is_present:
            self._candidates.append(frame)
        if self._held is not None and (release := self._find_release(frame, self._zero, self._held_from)) is not None:
            return self._settle_again(release)
        hold = BASELINE_FRAMES * self._frame_size
        if self._first_search:
            hold = max(round(self._settings.longest * self._rate), 2 * hold)
        recent = list(self._candidates)[-BASELINE_FRAMES:]
        is_steady = len(recent) == BASELINE_FRAMES and self._baseline.is_steady(recent)
        impacts: list[Impact] = []
        if is_steady and not self._is_moving_load(recent):
            impacts = self._adopt(recent)
        if not self._settled and self._processed - self._held_from >= hold:
            impacts = self._discard(self._frame_end(self._held_from))
        return impacts

    @property
    def _zero(self) -> Baseline:
        """Baseline without the load or the slow change that the present one includes."""
        includes_load = self._level.load > 0.0 or self._slow is not None
        return self._unloaded if includes_load and self._unloaded is not None else self._baseline

    @property
    def _load(self) -> float:
        """Load in the baseline [N]: that of an earlier contact, and a slow change, which may be a press."""
        load = self._baseline.force - self._level.zero
        return load if load > self._settings.threshold else 0.0

    def _find_release(self, frame: Frame, zero: Baseline, earliest: int) -> int | None:
        """Return the sample from `earliest` on since which the force is at `zero`; None if it is not in `frame`."""
        if frame.low > zero.force + QUIET_LEVEL * zero.threshold:
            return None  # fast path
        length = max(round(RELEASED_TIME * self._rate), MIN_RELEASED_SAMPLES)
        first = max(self._processed - self._frame_size - length, earliest, self._buffer.first)
        samples = self._buffer.samples(first, self._processed)
        force = samples - zero.force
        for start, stop in true_runs((force >= -zero.threshold) & (force <= QUIET_LEVEL * zero.threshold)).tolist():
            if stop - start >= length and not zero.is_stuck(samples[start:stop]):
                return first + int(start)
        return None

    def _settle_again(self, release: int) -> list[Impact]:
        """Return the contact that ends at the `release`, and continue with the baseline before it."""
        impacts = self._discard(release)
        self._settled = True
        self._counted = max(self._counted, release + 1)
        return impacts + self._unload(release)

    def _release(self, release: int) -> list[Impact]:
        """Return the contacts before the `release` of the load, and continue with the baseline before it."""
        start = self._segment_start
        impacts: list[Impact] = []
        if start is not None and start < release:
            self._extend(start, release)
            impacts = self._report(self._classify(start, release), start)
        return impacts + self._unload(release)

    def _extend(self, start: int, stop: int) -> None:
        """Add the samples [start, stop) to the contact that stays and to the slow change."""
        for contact in (self._held, self._slow):
            if contact is not None:
                self._extend_contact(contact, start, stop)

    def _extend_contact(self, contact: HeldContact, start: int, stop: int) -> None:
        """Add the samples [start, stop) to `contact`; count what it leaves out, unless a segment counts that."""
        for index, force in contact.extend(self._buffer.samples(start, stop), start):
            if index < self._held_from:
                self.glitches += 1
                self._leave_out(SINGLE_SAMPLE, force, self._stamp_ns(index), load=contact.impact.load_force)

    def _unload(self, release: int) -> list[Impact]:
        """Continue at sample `release` without the load; return the contact that left it."""
        self._baseline = self._zero
        self._processed, self._segment_start = release, None
        self._buffer.discard_before(release)
        self._level.load = 0.0
        return self._end_held() + self._end_slow(at_once=True)

    def _discard(self, until: int) -> list[Impact]:
        """Account for the samples before sample `until`, which no baseline reaches; return a contact that took long."""
        first, samples = self._held_from, self._buffer.samples(self._held_from, until)
        self._held_from = until
        stamp_ns = self._stamp_ns(first)
        if self._held is not None:
            self._extend_contact(self._held, first, until)
            return self._end_held() if self._held.takes_long(until) else []
        peak = float(samples[np.isfinite(samples)].max(initial=-math.inf))
        if self._first_search:
            low, high, high_ns = self._unseen
            level = float(np.nanmedian(samples)) if np.isfinite(samples).any() else math.inf
            self._unseen = (min(low, level), *((peak, stamp_ns) if peak > high else (high, high_ns)))
        elif (size := peak - min(self._zero.force, self._level.zero)) > self._baseline.threshold:
            reason = LATER_LOAD if self._is_loaded else NO_BASELINE
            self.left_out.add(reason, size, stamp_ns, not self._later_load)
            self._later_load = True
        return []

    def _end_held(self) -> list[Impact]:
        """Return the contact that stayed, if there is one."""
        held, self._held = self._held, None
        self._later_load = False
        return [] if held is None else [held.impact]

    def _stamp_ns(self, index: int) -> int:
        block = self._buffer.block_at(index)
        return block.stamp_ns + round((index - block.first_sample) / block.sample_rate * 1e9)

    def _is_moving_load(self, recent: Iterable[Frame]) -> bool:
        """Return whether `recent` is above the lost baseline, and the force was neither steady nor at rest."""
        levels, recent_levels = ([f.median_and_deviation[0] for f in frames] for frames in (self._candidates, recent))
        threshold = self._baseline.threshold
        if self._first_search or np.median(recent_levels) <= self._baseline.force + threshold:
            return False
        if self._is_at_rest(self._rest_frames):
            return False
        return bool(len(levels) < self._load_frames or np.ptp(levels) > threshold)

    def _is_at_rest(self, frames: int) -> bool:
        """Return whether the force hardly moved in the latest `frames`, as that of a thing that lies still."""
        rest = list(self._candidates)[-frames:]
        levels = [frame.median_and_deviation[0] for frame in rest]
        if len(rest) < frames or np.ptp(levels) > REST_SHARE * self._baseline.threshold:
            return False
        return not any(self._baseline.is_stuck(frame.samples) for frame in rest)

    def _adopt(self, frames: Iterable[Frame]) -> list[Impact]:
        """Adopt `frames` as the baseline, unless the signal is stuck but was noisy before.

        Returns the contacts that end, or that turn out to be none of drift.
        """
        baseline = Baseline(self._settings, frames)
        if not (baseline.noise > 0.0 or self._baseline.flat_run > BASELINE_FRAMES * self._frame_size):
            return []
        if self._held is not None:
            self._extend_contact(self._held, self._held_from, self._processed)
        if self._first_search:
            # The recording may begin just before a load.
            levels = (frame.median_and_deviation[0] for frame in self._candidates)
            self._level.settle(min([baseline.force, self._unseen[0], *levels]))
        earlier, self._baseline = self._zero, baseline
        self._settled = True
        self._processed = self._held_from
        if not self._first_search:
            self._counted = self._held_from + 1  # events that continue from before have been counted
        is_back = baseline.force <= self._level.zero + self._level.load + self._settings.threshold
        slow = self._end_slow(at_once=True) if is_back else []
        self._level.settle(baseline.force)
        if not self._level.load:
            self._unloaded = baseline
        else:
            self._unloaded = None if self._first_search else earlier
        if self._first_search:
            level, high = (baseline.force, self._stamp_ns(self._held_from)), self._unseen[1:]
            self._count_unseen(*max(level, high), baseline.force - self._level.load, baseline.threshold)
        return slow if self._level.load else self._end_held() + slow

    def _count_unseen(self, high: float, stamp_ns: int, level: float, threshold: float) -> None:
        """Count a force up to `high`, before or in the first baseline, if it is a `threshold` above `level` [N]."""
        if high - level > threshold:
            self.left_out.add(NO_BASELINE, high - level, stamp_ns)

    def _lose_baseline(
        self, start: int, longest: float | None = None, transient_s: float = TRANSIENT_S
    ) -> list[Impact]:
        """Report the segment from `start`, and search for another baseline from here on."""
        sustained = self.sustained_contacts
        contacts = self._classify(start, self._processed, longest, transient_s)
        if not contacts:  # a load goes
            self._extend(start, self._processed)
        goes_on = bool(contacts) and self._goes_on(contacts[-1], start)
        impacts = self._report(contacts, start, goes_on=goes_on)
        self._is_loaded |= self.sustained_contacts > sustained
        self._settled = self._first_search = False
        self._held_from = self._processed
        self._segment_start = None
        return impacts

    def _goes_on(self, contact: DetectedContact, start: int) -> bool:
        """Return whether the last `contact` of the segment that starts at sample `start` has not ended yet."""
        samples = self._buffer.samples(start, self._processed)
        last = Frame(samples[-self._frame_size :])
        present = np.flatnonzero(np.isfinite(samples))  # a gap may follow
        is_loaded = last.is_present and np.median(last.samples) > self._baseline.force + self._baseline.threshold
        return bool(is_loaded or contact.last >= present[-1] - self._frame_size)  # the signal may be stuck

    def _process(self, frame: Frame) -> list[Impact]:
        """Process the next frame."""
        quiet = self._baseline.is_quiet(frame)
        if quiet and self._segment_start is None:
            self._update_baseline(frame)
            return self._follow_level(frame)
        level = float(np.median(frame.samples)) - self._baseline.force if frame.is_present else 0.0
        self._quiet_frames = 0
        if self._segment_start is None:
            self._segment_start = max(self._processed - 2 * self._frame_size, self._buffer.first)
            self._frames_below = 0
            self._candidates.clear()
        zero = self._zero
        if zero is not self._baseline:
            # The level before a slow change is no release of it.
            earliest = 0 if self._slow is None else math.floor(self._slow.impact.onset_sample) + 1
            release = self._find_release(frame, zero, max(self._segment_start, earliest))
            if release is not None:
                return self._release(release)
        if quiet and level <= QUIET_LEVEL * self._baseline.threshold:
            impacts = self._report(self._classify(self._segment_start, self._processed), self._segment_start)
            self._segment_start = None
            return impacts
        below = level < -self._baseline.threshold
        self._frames_below = self._frames_below + 1 if below else 0
        # A contact in this frame would be cut, and found again with the next baseline.
        if (
            self._frames_below >= BASELINE_FRAMES
            and frame.high - self._baseline.force <= level + self._baseline.threshold
        ):
            self._candidates.clear()
            return self._lose_baseline(self._segment_start)
        if self._rises_from_rest(frame):
            self._processed -= self._frame_size
            within_rest_s = (BASELINE_FRAMES - 1) * self._frame_size / self._rate
            return self._end_at_rest(self._segment_start, min(within_rest_s, TRANSIENT_S))
        if frame.is_present:
            self._candidates.append(frame)
        return self._end_long_segment(self._segment_start, level)

    def _rises_from_rest(self, frame: Frame) -> bool:
        """Return whether the force rises in `frame` as in a contact, from a load on which it was at rest until then."""
        if not self._is_at_rest(BASELINE_FRAMES):
            return False
        rest = Baseline(self._settings, self._candidates)
        if rest.force <= self._baseline.force + QUIET_LEVEL * self._baseline.threshold:
            return False
        return frame.high > rest.force + rest.threshold and all(map(rest.is_quiet, rest.frames))

    def _end_at_rest(self, start: int, transient_s: float = TRANSIENT_S) -> list[Impact]:
        """Report the segment from `start` on, whose peaks are those of `transient_s`; the load becomes the baseline."""
        impacts = self._lose_baseline(start, TRANSIENT_S, transient_s)
        impacts += self._adopt(list(self._candidates)[-BASELINE_FRAMES:])
        self._counted = self._processed
        return impacts

    def _end_long_segment(self, start: int, level: float) -> list[Impact]:
        """Report the segment from `start` on if it is long or its force, at `level` in the last frame, is at rest."""
        rate, length = self._buffer.block_at(start).sample_rate, self._processed - start
        margin = 3 * self._frame_size  # before the contact
        if (
            level > self._baseline.threshold
            and length > TRANSIENT_S * rate + margin
            and self._is_at_rest(self._rest_frames)
        ):
            return self._end_at_rest(start)
        return self._split(start) if length > self._settings.longest * rate + 2 * self._frame_size else []

    def _update_baseline(self, frame: Frame) -> None:
        """Add the quiet frame before `frame` to the baseline if both of its neighbours are quiet."""
        self._quiet_frames += 1
        self._is_loaded = False
        if self._quiet_frames >= 3 and self._previous_quiet is not None:
            self._baseline = self._baseline.extended([self._previous_quiet])
        self._previous_quiet = frame

    def _follow_level(self, frame: Frame) -> list[Impact]:
        """Follow the force without contact, or the load that a contact left; notice slow changes, as the baseline does.

        Returns the contact that left the load, if it ends or takes long.
        """
        first, level = self._processed - self._frame_size, 0.5 * (frame.low + frame.high)
        if frame.high - frame.low > self._settings.threshold:  # neither middle nor median of noise is a sure level
            zero = self._level.zero + self._level.load
            level = min(level, frame.median_and_deviation[0], key=lambda middle: abs(middle - zero))
            if frame.high - max(level, zero) > self._settings.threshold:
                self._leave_out(IN_NOISE, frame.high - zero, self._stamp_ns(first), 0, self._level.load)
        change = self._level.follow(level, self._frame_size / self._rate)
        if self._held is not None:
            self._extend_contact(self._held, first, self._processed)
            if not self._level.load or self._held.takes_long(self._processed):
                return self._end_held()
        if change < 0.0:
            self.left_out.add(EARLIER_LOAD, -change, self._stamp_ns(first))
        elif self._slow is not None:
            self._extend_contact(self._slow, first, self._processed)
            if change < RELEASE * self._settings.threshold:
                self._end_slow()
        elif change > self._settings.threshold and self._held is None:  # that of a contact is in its held force
            self._slow = self._slow_change(first, change)
        elif not self._level.load and change <= REST_SHARE * self._settings.threshold:
            self._unloaded = self._baseline
        return []

    def _slow_change(self, first: int, change: float) -> HeldContact:
        """Return the slow change that is beyond the threshold at sample `first`."""
        block, level = self._buffer.block_at(first), self._level.zero + self._level.load
        rebound, end = self._rebound, self._end
        press = DetectedContact(0, 0, 0.0, 0.0, change, 0.0, 0.0, complete=True)
        impact = self._impact(press, first)._replace(baseline=level - block.tare, load_force=self._level.load)
        self._rebound, self._end = rebound, end
        return HeldContact(impact, level, self._settings.threshold, block.sample_rate)

    def _end_slow(self, *, at_once: bool = False) -> list[Impact]:
        """Count a slow change that is over, or whose end is not known; if it ended `at_once`, return it as a press.

        Drift would not end at once. A press that began before another contact would not be in order.
        """
        slow, self._slow = self._slow, None
        if slow is None:
            return []
        if at_once and slow.impact.onset_sample > self._last:
            return [slow.impact]
        self._leave_out(SLOW_CHANGE, slow.largest, slow.impact.stamp_ns, load=slow.impact.load_force)
        return []

    def _split(self, start: int) -> list[Impact]:
        """Report the finished contacts of a segment that is too long, and continue with the unfinished one."""
        contacts = self._classify(start, self._processed)
        goes_on = bool(contacts) and self._goes_on(contacts[-1], start)
        if not goes_on or self._is_sustained(contacts[-1], start):
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
                impacts += self._adopt(frames)
                impacts += self._advance()
        if self._settled:
            start = self._segment_start
            if start is None:
                start = max(self._processed - self._frame_size, buffer.first)
            impacts += self._report(self._classify(start, buffer.end), start)
        elif buffer.end > self._held_from:
            impacts += self._discard(buffer.end)
            if self._first_search:
                low, high, high_ns = self._unseen
                self._count_unseen(high, high_ns, low, self._settings.threshold)
        impacts += self._end_held()
        self._end_slow()
        return impacts

    def _classify(
        self, start: int, stop: int, longest: float | None = None, transient_s: float = TRANSIENT_S
    ) -> list[DetectedContact]:
        """Return the contacts in the samples [start, stop), and count what else is new in them.

        A load that swings for `longest` [s], by default that of the settings, is one contact. The peak of a contact is
        that of its first `transient_s`.
        """
        buffer, rate = self._buffer, self._buffer.block_at(start).sample_rate
        samples, saturated = buffer.samples(start, stop), buffer.saturated(start, stop)
        segment = classify(
            samples,
            saturated,
            self._baseline,
            gap=max(round(GAP_TIME * rate), MIN_GAP_SAMPLES),
            margin=self._frame_size,
            longest=round((longest or self._settings.longest) * rate),
            transient=round(transient_s * rate),
        )
        self.dropouts += int(np.count_nonzero(segment.dropouts + start >= self._counted))
        self.glitches += int(np.count_nonzero(segment.glitches + start >= self._counted))
        self._count_tension(segment, start)
        for reason in {remainder.reason for remainder in segment.remainders}:
            new = [item for item in segment.remainders if item.reason == reason and start + item.first >= self._counted]
            for number, remainder in enumerate(new):
                is_event = number == 0 or reason != NOISE  # ringing is one event
                self._leave_out(reason, remainder.peak, self._stamp_ns(start + remainder.first), is_event)
        self._counted = stop
        return segment.contacts

    def _leave_out(self, reason: str, peak: float, stamp_ns: int, count: int = 1, load: float | None = None) -> None:
        """Count force with its `peak` on a `load` [N], by default the present one."""
        load = self._load if load is None else load
        self.left_out.add(reason, peak + load, stamp_ns, count, load)

    def _count_tension(self, segment: Segment, start: int) -> None:
        """Count the tensile pulses of the segment that starts at sample `start`, which answer no contact."""
        for pulse in segment.tensile_pulses:
            earlier = (start + contact.last for contact in segment.contacts if contact.first < pulse.first)
            delay = start + pulse.first - max(earlier, default=self._last)
            is_response = delay <= RESPONSE_TIME * self._buffer.block_at(start + pulse.first).sample_rate
            below_zero = pulse.peak - max(self._baseline.force - self._level.zero, 0.0)  # the rest is a load that goes
            if is_response or start + pulse.last < self._counted:
                continue
            self.tensile_pulses += pulse.complete and not self._is_sustained(pulse, start)
            if start + pulse.first >= self._counted and below_zero > self._baseline.threshold:
                self.left_out.add(TENSION, below_zero, self._stamp_ns(start + pulse.first))

    def _is_sustained(self, contact: DetectedContact, start: int) -> bool:
        """Return whether `contact` of the segment that starts at sample `start` is too long for an impact."""
        sample_rate = self._buffer.block_at(start + contact.first).sample_rate
        return contact.last - contact.first >= round(self._settings.longest * sample_rate)

    def _report(self, contacts: Sequence[DetectedContact], start: int, *, goes_on: bool = False) -> list[Impact]:
        """Return the impacts among `contacts` of the segment from sample `start` on; count sustained contacts.

        If the last contact `goes_on`, it is returned at its end.
        """
        impacts = self._end_held() if contacts else []
        for number, contact in enumerate(contacts, start=1):
            is_sustained = self._is_sustained(contact, start)
            if self._is_loaded and (is_sustained or not contact.complete):  # it continues a sustained contact
                self._count_later_load(contact, start)
            elif goes_on and number == len(contacts):
                self.sustained_contacts += 1
                self._hold(contact, start)
            else:
                self.sustained_contacts += is_sustained
                impacts.append(self._impact(contact, start))
            self._last = start + contact.last
        return impacts

    def _count_later_load(self, contact: DetectedContact, start: int) -> None:
        peak = max(contact.peak, contact.held)
        self._leave_out(LATER_LOAD, peak, self._stamp_ns(start + contact.first), not self._later_load)
        self._later_load = True

    def _hold(self, contact: DetectedContact, start: int) -> None:
        """Begin a contact whose force stays, which the samples from here on extend."""
        rate = self._buffer.block_at(start + contact.first).sample_rate
        impact = self._impact(contact._replace(end=contact.last + 1.0), start)
        self._held = HeldContact(impact, self._baseline.force, self._baseline.threshold, rate)

    def _impact(self, contact: DetectedContact, start: int) -> Impact:
        block = self._buffer.block_at(start + math.floor(contact.onset))
        onset = start + contact.onset
        is_rebound = onset - self._end <= self._settings.rebound_time * block.sample_rate
        rebound = self._rebound + 1 if is_rebound else 0
        is_press = contact.held > 0.0 and not contact.compression_area
        if not is_press and not self._is_sustained(contact, start):  # neither has rebounds
            self._rebound, self._end = rebound, start + contact.end
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
            rebound=rebound,
            baseline=self._baseline.force - block.tare,
            noise=self._baseline.noise,
            clock_residual=block.clock_residual,
            source=block.source,
            simulated=block.simulated,
            held_force=contact.held,
            load_force=self._load,
        )
