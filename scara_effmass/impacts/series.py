"""Contacts in their order: which are impacts, which rebounds of the one before, and when they were."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from scara_effmass.values import Impact

if TYPE_CHECKING:
    from collections.abc import Iterable

    from scara_effmass.impacts.background import Background
    from scara_effmass.impacts.contact import DetectedContact
    from scara_effmass.impacts.segment import Segment
    from scara_effmass.impacts.stream import Stream
    from scara_effmass.settings import DetectionSettings

ANSWER_TIME = 0.5
"""So long after a contact [s] a pull is the answer of sensor, converter or structure to it."""


class Series:
    """Makes impacts of contacts, and counts those that last too long for one as `pushes`.

    Pulls, which would be whole impacts if the sign of the force were changed, are counted as `negative` unless a
    contact came before within ANSWER_TIME.
    """

    def __init__(self, settings: DetectionSettings) -> None:
        self._settings = settings
        self.pushes = self.negative = 0
        self.restart()

    def restart(self) -> None:
        """Let no impact be a rebound of those up to now."""
        self._end = self._last = -math.inf
        self._rebound = 0

    def report(
        self, contacts: Iterable[DetectedContact], start: int, stream: Stream, background: Background
    ) -> list[Impact]:
        """Return the impacts among `contacts`, which count from sample `start` of `stream`."""
        impacts: list[Impact] = []
        for contact in contacts:
            if self.is_push(contact, start, stream):
                self.pushes += 1
            else:
                impacts.append(self._impact(contact, start, stream, background))
            self._last = start + contact.last
        return impacts

    def count_pulls(self, stretch: Segment, start: int, since: int, stream: Stream) -> None:
        """Count the pulls that end at sample `since` or later in `stretch`, which counts from sample `start`."""
        for pull in stretch.pulls:
            if not pull.complete or start + pull.last < since:
                continue
            contacts = (start + contact.last for contact in stretch.contacts if contact.first < pull.first)
            apart = start + pull.first - max(contacts, default=self._last)
            rate = stream.block_of(start + pull.first).sample_rate
            self.negative += apart > ANSWER_TIME * rate and not self.is_push(pull, start, stream)

    def is_push(self, contact: DetectedContact, start: int, stream: Stream) -> bool:
        """Return whether `contact`, which counts from sample `start` of `stream`, lasts too long for an impact."""
        sample_rate = stream.block_of(start + contact.first).sample_rate
        return contact.last - contact.first >= round(self._settings.longest * sample_rate)

    def _impact(self, contact: DetectedContact, start: int, stream: Stream, background: Background) -> Impact:
        block = stream.block_of(start + math.floor(contact.onset))
        onset = start + contact.onset
        soon = onset - self._end <= self._settings.rebound_time * block.sample_rate
        self._rebound = self._rebound + 1 if soon else 0
        self._end = start + contact.end
        since_block = (start - block.first_sample) + contact.onset
        return Impact(
            stamp_ns=block.stamp_ns + round(since_block / block.sample_rate * 1e9),
            frame_id=block.frame_id,
            peak_force=contact.peak,
            duration=(contact.end - contact.onset) / block.sample_rate,
            impulse=contact.area / block.sample_rate,
            onset_sample=onset,
            clipped=contact.clipped,
            incomplete=not contact.complete,
            rebound=self._rebound,
            baseline=background.baseline - block.tare,
            noise=background.noise,
            clock_residual=block.clock_residual,
            source=block.source,
            simulated=block.simulated,
        )
