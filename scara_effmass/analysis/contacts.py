# SPDX-License-Identifier: Apache-2.0
"""Contacts in recordings of a force, without joint states: peaks, what stayed, and what is left out."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from scara_effmass.analysis.forces import AC_COUPLED, LARGER_HELD, file_measurements, lost_samples
from scara_effmass.bags.batches import LossLog
from scara_effmass.errors import BagError
from scara_effmass.impacts.detector import Detector
from scara_effmass.impacts.load import MAX_HELD_S, TENSION, left_out_text
from scara_effmass.settings import DetectionSettings, ImportSettings
from scara_effmass.values import ForceBlock, Impact, LeftOut

NS = 1_000_000_000
NO_BLOCKS = "only impacts were recorded: what their detection left out is not known"


@dataclass(frozen=True, slots=True)
class RecordedContacts:
    """Contacts in one recording, by the detection of `daq_node`. `start_ns` is the stamp of its first sample or impact.

    `topic` is that of the force, empty if it is the only one. `left_out` counts the force above the threshold that is
    in no contact. `losses` are parts that could not be read.
    """

    path: Path
    topic: str
    source: str
    simulated: bool
    start_ns: int
    samples: int
    lost_samples: int
    contacts: tuple[Impact, ...]
    left_out: tuple[LeftOut, ...]
    losses: tuple[str, ...]
    doubts: tuple[str, ...] = ()

    @property
    def force_text(self) -> str:
        """The force in one line."""
        origin = "simulated, not measured" if self.simulated else "as recorded"
        topic = f"{self.topic}: " if self.topic else ""
        return f"{topic}{self.samples} samples, {self.lost_samples} lost; {origin}: {self.source}"

    def as_dict(self) -> dict[str, Any]:
        """Return everything as JSON types, in SI units, with times since the beginning of the recording."""
        contacts = [
            {
                "time_s": (contact.stamp_ns - self.start_ns) / NS,
                "stamp_ns": contact.stamp_ns,
                "peak_force_n": contact.peak_force,
                "impulse_n_s": contact.impulse,
                "duration_s": contact.duration,
                "held_force_n": contact.held_force,
                "load_force_n": contact.load_force,
                "compression_impulse_n_s": contact.compression_impulse,
                "rebound": contact.rebound,
                "press": contact.is_press,
                "clipped": contact.clipped,
                "incomplete": contact.incomplete,
            }
            for contact in self.contacts
        ]
        left_out = [
            {
                "reason": item.reason,
                "count": item.occurrences,
                "peak_force_n": item.peak_force,
                "time_s": (item.stamp_ns - self.start_ns) / NS,
            }
            for item in self.left_out
        ]
        return {
            "recording": str(self.path),
            "topic": self.topic,
            "source": self.source,
            "simulated": self.simulated,
            "start_ns": self.start_ns,
            "samples": self.samples,
            "lost_samples": self.lost_samples,
            "complete": not (self.losses or self.lost_samples),
            "contacts": contacts,
            "left_out": left_out,
            "problems": [*self.losses, *self.doubts],
        }

    def rows(self) -> Iterator[tuple[str, ...]]:
        """Yield time, peak, impulse, duration, held force and remarks of each contact, for a table."""
        for contact in self.contacts:
            remarks = {
                f"on a load of {contact.load_force:.1f} N": contact.load_force,
                "press": contact.is_press,
                f"over {MAX_HELD_S:g} s: at least": contact.duration >= MAX_HELD_S,
                f"rebound {contact.rebound}": contact.rebound,
                "clipped: at least": contact.clipped,
                "incomplete: at least": contact.incomplete,
            }
            yield (
                f"{(contact.stamp_ns - self.start_ns) / NS:.3f}",
                f"{contact.peak_force:.1f}",
                f"{contact.impulse:.3f}",
                f"{1e3 * contact.duration:.1f}",
                f"{contact.held_force:.1f}" if contact.held_force else "-",
                ", ".join(text for text, applies in remarks.items() if applies),
            )

    def texts(self) -> Iterator[str]:
        """Yield the same in one line for each contact."""
        for time, peak, impulse, duration, held, remarks in self.rows():
            parts = [f"at {time} s: {peak} N", f"{impulse} N s", f"{duration} ms"]
            parts += [] if held == "-" else [f"held {held} N"]
            yield ", ".join([*parts, remarks] if remarks else parts)

    def lines(self) -> Iterator[tuple[str, str]]:
        """Yield subject and text of what is no contact."""
        for item in self.left_out:
            yield "left out", f"{left_out_text(item)} at {(item.stamp_ns - self.start_ns) / NS:.3f} s"
        for loss in self.losses:
            yield "not read", loss
        for doubt in self.doubts:
            yield "note", doubt


def recorded_contacts(path: Path, settings: ImportSettings, detection: DetectionSettings) -> RecordedContacts:
    """Return the contacts in the bag, CSV or TDMS file at `path`. Raises BagError, SettingsError."""
    losses = LossLog()
    detector = Detector(detection)
    contacts: list[Impact] = []
    samples = lost = 0
    start_ns: int | None = None
    sources: set[str] = set()
    simulated = False
    before: ForceBlock | None = None
    for _, value in file_measurements(path, settings, losses):
        start_ns = value.stamp_ns if start_ns is None else min(start_ns, value.stamp_ns)
        sources.add(value.source)
        simulated |= value.simulated
        if isinstance(value, Impact):
            contacts.append(value)
            continue
        lost += lost_samples(value, before)
        before = value
        samples += int(np.isfinite(value.force).sum())
        contacts += detector.feed(value)
    contacts += detector.finish()
    if start_ns is None:
        raise BagError("; ".join([f"{path}: must hold a force that can be read", *losses]))
    recorded = RecordedContacts(
        path=path,
        topic=settings.topic,
        source=", ".join(sorted(sources)),
        simulated=simulated,
        start_ns=start_ns,
        samples=samples,
        lost_samples=lost,
        contacts=tuple(contacts),
        left_out=tuple(detector.left_out),
        losses=tuple(losses),
    )
    doubts = _doubts(recorded, settings, is_settled=detector.settled)
    return replace(recorded, doubts=tuple(doubts))


def _doubts(recorded: RecordedContacts, settings: ImportSettings, *, is_settled: bool) -> Iterator[str]:
    """Yield what makes the list of contacts doubtful."""
    if not recorded.samples:
        yield NO_BLOCKS
    elif not is_settled:
        yield "no steady baseline at the end: contacts there are not known"
    if AC_COUPLED in recorded.source and any(contact.held_force for contact in recorded.contacts):
        yield LARGER_HELD
    largest = max((contact.peak_force for contact in recorded.contacts), default=0.0)
    tension = max((item.peak_force for item in recorded.left_out if item.reason == TENSION), default=0.0)
    if settings.axis != "norm" and tension > largest:  # a norm has no sign
        sign = "the force goes further below the baseline than above it, but compression is positive"
        option = "without --invert" if settings.sensor.invert else "with --invert"
        yield f"{sign}; read files and wrenches {option}, and import force blocks again so"
