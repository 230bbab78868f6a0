"""Impacts in a stream of force blocks; the same from a live stream as from a recording.

The samples are cut into frames at multiples of a fixed number, by sample number, so that neither how they came in
blocks nor where the recording begins makes a difference. Frames in which nothing happens give baseline and noise. From
the first other frame on samples are kept, until a quiet frame follows: that stretch is then judged as a whole.
"""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from scara_effmass.impacts.background import FRAMES, Background, Frame, median
from scara_effmass.impacts.segment import classify
from scara_effmass.impacts.series import Series
from scara_effmass.impacts.stream import Stream, finite_parts

if TYPE_CHECKING:
    from collections.abc import Iterable

    from scara_effmass.impacts.contact import DetectedContact
    from scara_effmass.impacts.segment import Segment
    from scara_effmass.settings import DetectionSettings
    from scara_effmass.values import FloatArray, ForceBlock, Impact

FRAME_TIME = 0.05
"""About the length of a frame [s]: long for an impact of robots, short for the start of a recording."""
FRAME_SAMPLES = 10
"""And the least number of samples in one."""
SETTLING_FRAMES = FRAMES + 3
"""After so many quiet frames in a row nothing is left of what was before."""
GAP_TIME = 0.3e-3
"""So long without force [s], and GAP_SAMPLES, are two contacts, not one."""
GAP_SAMPLES = 2
SAME_RATE = 0.01
"""The clock fit may change the sample rate by this share from block to block; beyond it is another recording."""
MOST_FRAMES = 0.6
"""Of what was recorded before the end came, so much has to be quiet."""


class Detector:
    """Finds impacts; counts what it does not take for one. Any rate, any length of blocks, one channel.

    An impact is returned once a quiet frame (FRAME_TIME, or FRAME_SAMPLES) has followed it, which for a train of
    contacts may take `settings.longest`. `dropouts` and `glitches` (single samples) are counted from the beginning on.

    Of one stream, detectors that began at different samples return the same impacts to the last bit once they have
    settled: after SETTLING_FRAMES in a row that are quiet to both (0.4 s at 12.8 kS/s), and `settings.rebound_time`
    without a contact, for it may be the rebound of one that only the elder has seen.
    """

    def __init__(self, settings: DetectionSettings) -> None:
        self._settings = settings
        self._series = Series(settings)
        self._rate = math.nan
        self.dropouts = self.glitches = 0
        self.settled = False
        """Whether the baseline at the last sample is known, or was when it was finished. Else impacts are not found."""
        self._forget()

    @property
    def pushes(self) -> int:
        """How many contacts were longer than `settings.longest`."""
        return self._series.pushes

    @property
    def negative(self) -> int:
        """How many contacts would be whole impacts if the sign of the force were changed: is the sensor inverted?

        Those that follow a contact are not among them: coupling for alternating current, and whatever rings, answer
        a push with a pull. What stays below the baseline for FRAMES frames is a load that goes.
        """
        return self._series.negative

    def feed(self, block: ForceBlock) -> list[Impact]:
        """Return the impacts that are over by the end of `block`, in their order.

        Samples that are not finite count as lost. Lost samples end a contact; a sample number that goes back, or
        another sample rate, begins a new recording.
        """
        found: list[Impact] = []
        for part in finite_parts(block):
            found += self._join(part)
            self._stream.append(part)
            found += self._advance()
            self.settled = self._settled
        return found

    def finish(self) -> list[Impact]:
        """Return the impacts that were still waiting for what follows, and begin anew with what is fed next."""
        if math.isnan(self._rate):
            return []
        found = self._close()
        self.settled = self._settled
        self._rate = math.nan
        self._forget()
        return found

    def _forget(self) -> None:
        self._background = Background(self._settings)
        self._settled = False
        self._series.restart()
        self._frame = FRAME_SAMPLES
        self._begin(0)

    def _begin(self, first_sample: int) -> None:
        """Wait for samples that do not join the ones before."""
        self._stream = Stream(first_sample)
        self._done = self._counted = first_sample
        self._stretch: int | None = None
        self._quiet_frames = self._frames_below = 0
        self._last_quiet: Frame | None = None
        self._unsettled: deque[Frame] = deque(maxlen=FRAMES)
        self._held = first_sample
        self._fresh = True

    def _join(self, block: ForceBlock) -> list[Impact]:
        """Return what the gap before `block`, if there is one, has ended."""
        missing = block.first_sample - self._stream.end
        same = abs(block.sample_rate - self._rate) <= SAME_RATE * self._rate
        self._rate = block.sample_rate
        if same and not missing and not block.lost_samples:
            return []
        found = self._close()
        if not same or not 0 <= missing <= self._settings.longest * self._rate:
            self._forget()
        self._begin(block.first_sample)
        # In steps of two: rates that differ as clocks do have the same frames.
        self._frame = FRAME_SAMPLES << max(0, round(math.log2(FRAME_TIME * self._rate / FRAME_SAMPLES)))
        return found

    def _after(self, index: int) -> int:
        """Return where the frame that holds sample `index` ends."""
        return (index // self._frame + 1) * self._frame

    def _advance(self) -> list[Impact]:
        found: list[Impact] = []
        while (stop := self._after(self._done)) <= self._stream.end:  # the first frame may be a part of one
            samples = self._stream.samples(self._done, stop)
            self._done = stop
            if self._settled:
                found += self._watch(samples)
            else:
                self._settle(Frame(samples))
        needed = self._done - self._frame if self._settled else self._held - self._frame
        self._stream.forget_before(needed if self._stretch is None else min(needed, self._stretch))
        return found

    def _settle(self, frame: Frame) -> None:
        """Look for a baseline; once there is one, what was held goes through again."""
        self._unsettled.append(frame)
        hold = FRAMES * self._frame
        if self._fresh:
            hold = max(round(self._settings.longest * self._rate), 2 * hold)
        if len(self._unsettled) == FRAMES and self._background.steady(self._unsettled):
            self._adopt(self._unsettled)
        if not self._settled and self._done - self._held >= hold:
            self._held = self._after(self._held)

    def _adopt(self, frames: Iterable[Frame]) -> None:
        """Take `frames` for the background, unless the signal is stuck: it was livelier before."""
        background = Background(self._settings, frames)
        if background.noise > 0.0 or self._background.flat_run > FRAMES * self._frame:
            self._background = background
            self._settled = True
            self._done = self._held
            if not self._fresh:
                self._counted = self._held + 1  # what goes on there has been counted when it began

    def _give_up(self, start: int) -> list[Impact]:
        """Report what is in the stretch from `start`, and look for another baseline from here on."""
        found = self._report(self._judge(start, self._done).contacts, start)
        self._settled = self._fresh = False
        self._unsettled.clear()
        self._held = self._done
        self._stretch = None
        return found

    def _watch(self, samples: FloatArray) -> list[Impact]:
        """Go on by one frame, of which `samples` are the last ones."""
        frame = Frame(samples)
        quiet = self._background.is_quiet(frame)
        if quiet and self._stretch is None:
            self._learn(frame)
            return []
        self._quiet_frames = 0
        if self._stretch is None:
            self._stretch = max(self._done - 2 * self._frame, self._stream.first)
            self._frames_below = 0
        if quiet:
            found = self._report(self._judge(self._stretch, self._done).contacts, self._stretch)
            self._stretch = None
            return found
        below = median(samples.copy()) < self._background.baseline - self._background.level
        self._frames_below = self._frames_below + 1 if below else 0
        if self._frames_below == FRAMES:
            return self._give_up(self._stretch)
        longest = self._settings.longest * self._stream.block_of(self._stretch).sample_rate
        if self._done - self._stretch > longest + 2 * self._frame:
            return self._divide(self._stretch)
        return []

    def _learn(self, frame: Frame) -> None:
        """Admit the quiet frame before `frame` if those on both sides of it were quiet as well."""
        self._quiet_frames += 1
        if self._quiet_frames >= 3 and self._last_quiet is not None:
            self._background = self._background.followed_by([self._last_quiet])
        self._last_quiet = frame

    def _divide(self, start: int) -> list[Impact]:
        """Report what is over in a stretch that has become too long, and go on with the contact that is not."""
        contacts = self._judge(start, self._done).contacts
        going_on = contacts[-1] if contacts and start + contacts[-1].last >= self._done - self._frame else None
        if going_on is None or self._series.is_push(going_on, start, self._stream):
            return self._give_up(start)
        over = contacts[:-1]
        self._stretch = start + max(going_on.first - self._frame, over[-1].last + 1 if over else 0)
        return self._report(over, start)

    def _close(self) -> list[Impact]:
        """Return what is found when nothing more joins."""
        stream = self._stream
        found: list[Impact] = []
        rest = stream.samples(self._done, stream.end)
        if not self._settled:
            frames = [*self._unsettled, *([Frame(rest)] if rest.size >= FRAME_SAMPLES else [])]
            if frames and self._background.steady(frames, MOST_FRAMES if self._fresh else 1.0):
                self._adopt(frames)
                found += self._advance()
                rest = stream.samples(self._done, stream.end)
        if self._settled and (self._stretch is not None or (rest.size and not self._background.is_quiet(Frame(rest)))):
            start = max(self._done - self._frame, stream.first) if self._stretch is None else self._stretch
            found += self._report(self._judge(start, stream.end).contacts, start)
        return found

    def _judge(self, start: int, stop: int) -> Segment:
        """Judge the samples from `start` up to `stop`, and count what is new in it."""
        stream = self._stream
        samples, saturated = stream.samples(start, stop), stream.saturated(start, stop)
        gap = max(round(GAP_TIME * stream.block_of(start).sample_rate), GAP_SAMPLES)
        stretch = classify(samples, saturated, self._background, gap, self._frame)
        self.dropouts += int(np.count_nonzero(stretch.dropouts + start >= self._counted))
        self.glitches += int(np.count_nonzero(stretch.glitches + start >= self._counted))
        self._series.count_pulls(stretch, start, self._counted, stream)
        self._counted = stop
        return stretch

    def _report(self, contacts: Iterable[DetectedContact], start: int) -> list[Impact]:
        return self._series.report(contacts, start, self._stream, self._background)
