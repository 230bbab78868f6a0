"""The course of one contact point over a run, kept for a figure."""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from scara_effmass.values import NAN, Verdict

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from scara_effmass.values import ContactAssessment, FloatArray


@dataclass(frozen=True, slots=True)
class TimeSeries:
    """What was decided, over time (m,) since `start_ns` [s]; NaN where nothing is known [m/s, kg]."""

    start_ns: int
    time: FloatArray
    verdict: NDArray[np.int64]
    speed: FloatArray
    allowable_speed: FloatArray
    effective_mass: FloatArray
    lumped_mass: FloatArray
    full_mass: FloatArray
    iso_mass: FloatArray


class Trace:
    """Collects a Course cycle by cycle: 64 bytes each, so an hour at 1 kHz takes 230 MB."""

    def __init__(self) -> None:
        """Begin with nothing."""
        self._at_ns = array("q")
        self._verdicts = array("q")
        self._values = array("d")

    def add(self, contact: ContactAssessment, at_ns: int) -> None:
        """Take in what was decided at `at_ns`; it is drawn at its own stamp, where that was fit to be used."""
        known = contact.effective_mass > 0.0
        allowed = contact.verdict is not Verdict.UNKNOWN
        self._at_ns.append(contact.stamp_ns if known else at_ns)
        self._verdicts.append(contact.verdict)
        self._values.extend(
            (
                contact.speed if known else NAN,
                contact.allowable_speed if allowed else NAN,
                contact.effective_mass if known else NAN,
                contact.lumped_mass,
                contact.full_mass,
                contact.iso_mass if contact.iso_mass > 0.0 else NAN,
            )
        )

    def course(self) -> TimeSeries:
        """Return what came so far, in order of time."""
        at_ns = np.array(self._at_ns)
        order = np.argsort(at_ns, kind="stable")
        at_ns = at_ns[order]
        columns = np.array(self._values).reshape(-1, 6)[order].T
        start_ns = int(at_ns[0]) if len(at_ns) else 0
        return TimeSeries(start_ns, (at_ns - start_ns) / 1e9, np.array(self._verdicts)[order], *columns)


def thinned(time: FloatArray, values: FloatArray, columns: int) -> tuple[FloatArray, FloatArray]:
    """Return at most 5 points per column that draw like all: first, last, smallest, largest, and one NaN.

    `time` (m,) is ascending; equal columns of time become equal columns of pixels, so no peak and no gap is lost.
    """
    if len(time) <= 5 * columns:
        return time, values
    span = time[-1] - time[0] or 1.0
    column = np.minimum((columns * (time - time[0]) / span).astype(np.int64), columns - 1)
    starts = np.flatnonzero(np.diff(column, prepend=-1))
    stops = np.append(starts[1:], len(time))
    chosen: set[int] = set()
    for start, stop in zip(starts.tolist(), stops.tolist(), strict=True):
        part = values[start:stop]
        missing = np.isnan(part)
        chosen |= {start, stop - 1}
        if not missing.all():
            chosen |= {start + int(np.nanargmin(part)), start + int(np.nanargmax(part))}
        if missing.any():
            chosen.add(start + int(np.argmax(missing)))
    indices = np.array(sorted(chosen))
    return time[indices], values[indices]


def verdict_spans(course: TimeSeries, timeout: float) -> list[tuple[float, float, Verdict]]:
    """Return runs of equal verdict as (from, to, verdict) [s]; silence beyond `timeout` [s] is UNKNOWN."""
    spans: list[tuple[float, float, Verdict]] = []

    def extend(start: float, stop: float, verdict: Verdict) -> None:
        if spans and spans[-1][2] is verdict:
            spans[-1] = (spans[-1][0], stop, verdict)
        elif stop > start:
            spans.append((start, stop, verdict))

    ends = np.append(course.time[1:], course.time[-1:])
    for start, stop, number in zip(course.time.tolist(), ends.tolist(), course.verdict.tolist(), strict=True):
        extend(start, min(stop, start + timeout), Verdict(number))
        if stop > start + timeout:
            extend(start + timeout, stop, Verdict.UNKNOWN)
    return spans
