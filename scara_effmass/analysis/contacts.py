# SPDX-License-Identifier: Apache-2.0
"""Contacts in recordings of a force, without joint states: peaks, what stayed, and what is left out."""

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scara_effmass.analysis.forces import Measurement, file_measurements
from scara_effmass.errors import BagError
from scara_effmass.impacts.detector import Detector
from scara_effmass.impacts.load import TENSION, left_out_text
from scara_effmass.settings import DetectionSettings, ImportSettings
from scara_effmass.values import ForceBlock, Impact, LeftOut

NS = 1_000_000_000
NO_BLOCKS = "only impacts were recorded: what their detection left out is not known"


@dataclass(frozen=True, slots=True)
class RecordedContacts:
    """Contacts in one recording, by the detection of `daq_node`. `start_ns` is the stamp of its first sample or impact.

    `left_out` counts the force above the threshold that is in no contact. `problems` are parts that could not be read,
    and doubts.
    """

    path: Path
    source: str
    simulated: bool
    start_ns: int
    samples: int
    lost_samples: int
    contacts: tuple[Impact, ...]
    left_out: tuple[LeftOut, ...]
    problems: tuple[str, ...]

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
            "source": self.source,
            "simulated": self.simulated,
            "start_ns": self.start_ns,
            "samples": self.samples,
            "lost_samples": self.lost_samples,
            "contacts": contacts,
            "left_out": left_out,
            "problems": list(self.problems),
        }

    def rows(self) -> Iterator[tuple[object, ...]]:
        """Yield time, peak, impulse, duration, held force and remarks of each contact, for a table."""
        for contact in self.contacts:
            remarks = {
                f"on a load of {contact.load_force:.1f} N": contact.load_force,
                "press": contact.is_press,
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

    def lines(self) -> Iterator[tuple[str, str]]:
        """Yield subject and text of what is no contact."""
        for item in self.left_out:
            yield "left out", f"{left_out_text(item)} at {(item.stamp_ns - self.start_ns) / NS:.3f} s"
        for problem in self.problems:
            yield "note", problem


def recorded_contacts(path: Path, settings: ImportSettings, detection: DetectionSettings) -> RecordedContacts:
    """Return the contacts in the bag, CSV or TDMS file at `path`. Raises BagError, SettingsError."""
    unreadable: Counter[str] = Counter()
    detector = Detector(detection)
    contacts: list[Impact] = []
    samples = lost = 0
    start_ns: int | None = None
    sources: set[str] = set()
    blocks = simulated = False
    for value in _values(file_measurements(path, settings, unreadable)):
        start_ns = value.stamp_ns if start_ns is None else min(start_ns, value.stamp_ns)
        sources.add(value.source)
        simulated |= value.simulated
        if isinstance(value, Impact):
            contacts.append(value)
            continue
        lost += value.lost_samples if blocks else 0  # the first block counts those before the recording began
        blocks = True
        samples += int(np.isfinite(value.force).sum())
        contacts += detector.feed(value)
    contacts += detector.finish()
    if start_ns is None:
        raise BagError(f"{path}: must hold a force that can be read" + "".join(f"; {line}" for line in unreadable))
    left_out = tuple(detector.left_out)
    return RecordedContacts(
        path=path,
        source=", ".join(sorted(sources)),
        simulated=simulated,
        start_ns=start_ns,
        samples=samples,
        lost_samples=lost,
        contacts=tuple(contacts),
        left_out=left_out,
        problems=(*unreadable, *_doubts(contacts, left_out, samples, detector)),
    )


def _values(measured: Iterable[Measurement]) -> Iterator[ForceBlock | Impact]:
    return (measurement.value for measurement in measured)


def _doubts(contacts: Iterable[Impact], left_out: Iterable[LeftOut], samples: int, detector: Detector) -> Iterator[str]:
    """Yield what makes the list of contacts doubtful."""
    if not samples:
        yield NO_BLOCKS
    elif not detector.settled:
        yield "no steady baseline at the end: contacts there are not known"
    largest = max((contact.peak_force for contact in contacts), default=0.0)
    if any(item.reason == TENSION and item.peak_force > largest for item in left_out):
        sign = "the force goes further below the baseline than above it, but compression is positive"
        yield f"{sign}; read the sensor's file with --invert"
