"""Force over time of the impacts in a recording."""

from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np

from scara_effmass.analysis.recorded_run import file_measurements, measurement_topic, measurements
from scara_effmass.analysis.validation import ValidatedRecording
from scara_effmass.bags.files import open_bag
from scara_effmass.settings import ImportSettings
from scara_effmass.values import FloatArray, ForceBlock
from scara_effmass.wire.cdr import NS

BEFORE_S = 0.01
"""Time before the onset, whose median is the baseline."""


class ForceTrace(NamedTuple):
    """Force (n,) above the baseline [N] at the `time` (n,) since the onset [s]; empty without force blocks."""

    time: FloatArray
    force: FloatArray


NO_TRACE = ForceTrace(np.empty(0), np.empty(0))


def force_traces(recording: ValidatedRecording, settings: ImportSettings, after_s: float) -> list[ForceTrace]:
    """Return the force of each impact of `recording`, until `after_s` after its onset. Raises BagError."""
    onsets = np.array([impact.stamp_ns for impact in recording.impacts], np.int64)
    parts: list[list[tuple[FloatArray, FloatArray]]] = [[] for _ in onsets]
    unreadable: Counter[str] = Counter()
    shift_ns = round(recording.force_offset * NS)
    with open_bag(recording.path) as bag:
        if recording.force_clock:
            found = file_measurements(Path(recording.force_topic), settings, unreadable)
        else:
            found = measurements(bag, measurement_topic(bag, settings.topic), settings, unreadable)
        for block in (value for _, value in found if isinstance(value, ForceBlock)):
            first = (block.stamp_ns + shift_ns - onsets) / NS
            last = first + len(block.force) / block.sample_rate
            for index in np.flatnonzero((first < after_s) & (last > -BEFORE_S)):
                time = first[index] + np.arange(len(block.force)) / block.sample_rate
                inside = (time >= -BEFORE_S) & (time <= after_s)
                parts[index].append((time[inside], block.force[inside]))
    return [_above_baseline(*map(np.concatenate, zip(*part, strict=True))) if part else NO_TRACE for part in parts]


def _above_baseline(time: FloatArray, force: FloatArray) -> ForceTrace:
    before = force[time < 0.0]
    return ForceTrace(time, force - (np.median(before) if before.size else 0.0))
