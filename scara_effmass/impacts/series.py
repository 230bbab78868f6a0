"""Contacts in their order: which are impacts, which rebounds of the one before, and when they were."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from scara_effmass.values import Impact

if TYPE_CHECKING:
    from collections.abc import Iterable

    from scara_effmass.impacts.background import Background
    from scara_effmass.impacts.contact import Contact
    from scara_effmass.impacts.stream import Stream
    from scara_effmass.settings import DetectionSettings


class Series:
    """Makes impacts of contacts, and counts those that last too long for one as `pushes`."""

    def __init__(self, settings: DetectionSettings) -> None:
        self._settings = settings
        self.pushes = 0
        self.restart()

    def restart(self) -> None:
        """Let no impact be a rebound of those up to now."""
        self._end = -math.inf
        self._rebound = 0

    def report(self, contacts: Iterable[Contact], start: int, stream: Stream, background: Background) -> list[Impact]:
        """Return the impacts among `contacts`, which count from sample `start` of `stream`."""
        return [
            self._impact(contact, start, stream, background)
            for contact in contacts
            if not self._is_push(contact, stream.block_of(start + contact.first).sample_rate)
        ]

    def _is_push(self, contact: Contact, sample_rate: float) -> bool:
        push = contact.last - contact.first >= round(self._settings.longest * sample_rate)
        self.pushes += push
        return push

    def _impact(self, contact: Contact, start: int, stream: Stream, background: Background) -> Impact:
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
