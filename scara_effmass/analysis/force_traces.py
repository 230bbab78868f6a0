# SPDX-License-Identifier: Apache-2.0
"""Force over time of the impacts in a recording."""

import math
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from scara_effmass.analysis.recorded_run import RecordedForce, file_measurements
from scara_effmass.analysis.summary import iso_time
from scara_effmass.analysis.time_series import decimate
from scara_effmass.analysis.validation import ValidatedRecording
from scara_effmass.settings import ImportSettings
from scara_effmass.values import FloatArray, ForceBlock
from scara_effmass.wire.cdr import NS

BEFORE_S = 0.01
"""Time before the onset; its median force is the baseline."""
LOW_SHARE = 0.1
"""Share of the peak; the contact lasts while the force is above it."""
AFTER_S = 0.1
"""Longest time after the onset in a report."""
LEFT, RIGHT, BASE, TOP = 46.0, 314.0, 126.0, 16.0
"""Edges of the axes of a drawing [pixel]."""
COLUMNS = 120
"""Columns of pixels to which a drawn trace is decimated."""
SHOWN_DURATIONS = 4.0
"""Width of a drawing in durations of the contact."""


class ForceTrace(NamedTuple):
    """Force (n,) [N] above the baseline at `time` (n,) [s] since the onset; empty without force blocks.

    `complete`: from the onset on no sample is lost, saturated or NaN.
    """

    time: FloatArray
    force: FloatArray
    complete: bool = True

    @property
    def duration(self) -> float | None:
        """Time above `LOW_SHARE` of the peak [s], None if the rising or falling edge is missing."""
        if not self.force.size:
            return None
        peak = int(self.force.argmax())
        low = np.flatnonzero(self.force < LOW_SHARE * self.force[peak])
        rise, fall = low[low < peak], low[low > peak]
        return float(self.time[fall[0]] - self.time[rise[-1]]) if rise.size and fall.size else None

    @property
    def sampling_loss(self) -> float | None:
        """Largest share of the peak of a half-sine of this duration that can fall between two samples."""
        duration = self.duration
        if duration is None:
            return None
        return sampling_loss(duration, 1.0 / float(np.median(np.diff(self.time))))


class Drawing(NamedTuple):
    """A trace in SVG coordinates [pixel] for `macros.html`, and the ends of its axes [N, ms]."""

    points: str
    predicted_y: float | None
    top: str
    end: str
    zero: float
    left: float = LEFT
    base: float = BASE


class ShownTrace(NamedTuple):
    """One impact in a report; forces [N], speed [m/s]."""

    title: str
    time: str
    drawing: Drawing
    simulated: bool
    peak: float
    predicted: float | None
    speed: float | None


def sampling_loss(duration: float, rate: float) -> float:
    """Return 1 - cos(pi / (2 T f)) for a half-sine of `duration` T [s] sampled at `rate` f [Hz]."""
    return 1.0 - math.cos(min(0.5 * math.pi / (duration * rate), 0.5 * math.pi))


def draw_trace(trace: ForceTrace, predicted: float | None) -> Drawing:
    """Return the drawing of a non-empty trace and of the `predicted` peak [N]."""
    end = _round_up(min(SHOWN_DURATIONS * (trace.duration or AFTER_S), float(trace.time[-1])))
    shown = (trace.time >= -0.2 * end) & (trace.time <= end)
    time, force = decimate(trace.time[shown], trace.force[shown], COLUMNS)
    top = _round_up(1.02 * max(float(force.max()), predicted or 0.0, 1e-9))

    def y(value: float) -> float:
        return round(BASE - (BASE - TOP) * value / top, 1)

    def x(seconds: float) -> float:
        return round(LEFT + (RIGHT - LEFT) * (seconds + 0.2 * end) / (1.2 * end), 1)

    points = " ".join(f"{x(t)},{y(value)}" for t, value in zip(time.tolist(), force.tolist(), strict=True))
    return Drawing(points, y(predicted) if predicted else None, f"{top:g}", f"{1e3 * end:.3g}", x(0.0))


NO_TRACE = ForceTrace(np.empty(0), np.empty(0))


def force_traces(recording: ValidatedRecording, settings: ImportSettings, after_s: float) -> list[ForceTrace]:
    """Return the force of each impact of `recording`, up to `after_s` after its onset. Raises BagError."""
    onsets = [impact.stamp_ns for impact in recording.impacts]
    if recording.force_clock:
        return file_traces(recording.files[-1], settings, onsets, after_s, recording.force_offset)
    topic = settings.model_copy(update={"topic": recording.force_topic})
    return file_traces(recording.path, topic, onsets, after_s)


def _round_up(value: float) -> float:
    """Return the next larger end of an axis: a number of two digits, the second one even."""
    step = 10.0 ** math.floor(math.log10(value)) / 5.0
    return float(f"{step * math.ceil(value / step):.2g}")


def file_traces(
    path: Path, settings: ImportSettings, onsets_ns: Iterable[int], after_s: float, offset_s: float = 0.0
) -> list[ForceTrace]:
    """Return the force in the file or bag at `path` from each of `onsets_ns` to the next one, at most for `after_s`.

    `offset_s` is added to the stamps of the file. Raises BagError, SettingsError.
    """
    onsets = np.array(list(onsets_ns), np.int64)
    following = [min(onsets[onsets > onset], default=math.inf) for onset in onsets]
    ends = np.minimum((np.array(following) - onsets) / NS, after_s)
    parts: list[list[tuple[FloatArray, FloatArray]]] = [[] for _ in onsets]
    complete = np.full(len(onsets), fill_value=True)
    for _, block in file_measurements(path, settings, Counter()):
        if not isinstance(block, ForceBlock):
            continue
        is_finite = np.isfinite(block.force)
        is_doubtful = ~is_finite
        is_doubtful[block.saturated_samples] = True
        is_doubtful[:1] |= block.lost_samples > 0
        first = (block.stamp_ns + round(offset_s * NS) - onsets) / NS
        last = first + len(block.force) / block.sample_rate
        for index in np.flatnonzero((first < ends) & (last > -BEFORE_S)):
            time = first[index] + np.arange(len(block.force)) / block.sample_rate
            inside = (time >= -BEFORE_S) & (time <= ends[index])
            complete[index] &= not is_doubtful[inside & (time > 0.0)].any()
            inside &= is_finite
            parts[index].append((time[inside], block.force[inside]))
    traces = [_above_baseline(*map(np.concatenate, zip(*part, strict=True))) if part else NO_TRACE for part in parts]
    return [trace._replace(complete=bool(intact)) for trace, intact in zip(traces, complete, strict=True)]


def recorded_traces(forces: RecordedForce, title: str) -> list[ShownTrace]:
    """Return the recorded impacts that are no rebounds."""
    traces = []
    for impact in forces.impacts:
        time = (forces.stamp_ns - impact.stamp_ns) / NS
        inside = (time >= -BEFORE_S) & (time <= AFTER_S) & np.isfinite(forces.force)
        if not impact.rebound and inside.any():
            trace = _above_baseline(time[inside], forces.force[inside])
            traces += shown(title, impact.stamp_ns, trace, simulated=impact.simulated, peak=impact.peak_force)
    return traces


def _above_baseline(time: FloatArray, force: FloatArray) -> ForceTrace:
    before = force[time < 0.0]
    return ForceTrace(time, force - (np.median(before) if before.size else 0.0))


def shown(
    title: str,
    stamp_ns: int,
    trace: ForceTrace,
    *,
    simulated: bool,
    peak: float,
    predicted: float | None = None,
    speed: float | None = None,
) -> list[ShownTrace]:
    """Return the trace of an impact as a report shows it; none if the trace ends before the onset."""
    if not (trace.time.size and trace.time[-1] > 0.0):
        return []
    drawing = draw_trace(trace, predicted)
    return [ShownTrace(title, iso_time(stamp_ns), drawing, simulated, peak, predicted, speed)]
