# SPDX-License-Identifier: Apache-2.0
"""Time series of the assessments of one contact point, for figures and reports."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scara_effmass.analysis.assessment import AssessedStates
from scara_effmass.analysis.summary import mass_model_counts
from scara_effmass.bags.batches import IntArray
from scara_effmass.codes import Reason
from scara_effmass.kernel.state import CODE
from scara_effmass.values import NAN, BoolArray, FloatArray, Verdict

NO_JOINT_STATE = "no joint state"
"""Reason of the episodes in which no joint state arrived."""


class Change(NamedTuple):
    """Reason of a verdict with its code and joint positions by name [rad, m], at its first joint state."""

    reason: str = ""
    positions: Mapping[str, float] = MappingProxyType({})
    reason_code: Reason = Reason.NONE


VALUES = ("speed", "allowable_speed", "margin", "effective_mass", "lumped_mass", "full_mass", "iso_mass")
"""Speeds [m/s] and masses [kg] of a row; NaN where they are unknown."""
ROW = np.dtype([("stamp_ns", "i8"), ("verdict", "i4"), ("body_region", "i4"), *((name, "f8") for name in VALUES)])


@dataclass(frozen=True, slots=True)
class TimeSeries:
    """Assessments `rows` (m,) of dtype ROW in order of their stamps.

    `changes` are the changes of the verdict by index. `mass_models` counts the mass models with the reasons for them.
    `body_region` of a row is an index of `regions`, of which the first is empty: no region.
    """

    changes: Mapping[int, Change]
    mass_models: Counter[str]
    regions: tuple[str, ...]
    rows: NDArray[Any]

    @property
    def start_ns(self) -> int:
        """Stamp of the first row, 0 without rows."""
        return int(self.rows["stamp_ns"][0]) if len(self.rows) else 0

    @property
    def time(self) -> FloatArray:
        """Time of each row (m,) [s] since the first one."""
        return np.asarray((self.rows["stamp_ns"] - self.start_ns) / 1e9)

    def with_gaps(self, timeout: float) -> TimeSeries:
        """Return a copy with a row of NaN after each gap longer than `timeout` [s] begins, which breaks a line."""
        gaps = np.flatnonzero(np.diff(self.time) > timeout) + 1
        silent = np.zeros(len(gaps), ROW)
        silent["stamp_ns"] = self.rows["stamp_ns"][gaps - 1] + round(timeout * 1e9)
        silent["verdict"] = Verdict.UNKNOWN
        for name in VALUES:
            silent[name] = NAN
        return replace(self, changes={}, rows=np.insert(self.rows, gaps, silent))


class Episode(NamedTuple):
    """An interval of one verdict, from `start` to `stop` [s] since the first joint state.

    `min_margin` [m/s] is NaN where no margin is known. `body_region` governs at the joint state with that margin, or at
    the first one; the other fields are those of the `Change` before the interval.
    """

    start: float
    stop: float
    verdict: Verdict
    min_margin: float
    body_region: str
    reason: str
    positions: Mapping[str, float] = MappingProxyType({})
    reason_code: Reason = Reason.NONE


class TimeSeriesBuilder:
    """Collects the assessments of one contact point; each takes 72 bytes, an hour at 1 kHz 260 MB."""

    def __init__(self) -> None:
        """Start empty."""
        self._rows = [np.empty(0, ROW)]
        self._count = 0
        self._changes: dict[int, Change] = {}
        self._regions = {"": 0}
        self._mass_models: Counter[str] = Counter()

    def add(self, states: AssessedStates, point: int) -> None:
        """Add contact point number `point`, each assessment at its own stamp where that is valid, else the log time."""
        assessments = states.assessments
        contacts, labels = assessments.contacts[:, point], assessments.labels
        rows = np.empty(len(states), ROW)
        for name in ("verdict", *VALUES):
            rows[name] = contacts[name]
        regions = [self._regions.setdefault(region, len(self._regions)) for region in labels["body_region"]]
        rows["body_region"] = np.array(regions)[contacts["body_region"].astype(np.int64)]
        known, decided = contacts["effective_mass"] > 0.0, rows["verdict"] != Verdict.UNKNOWN
        rows["stamp_ns"] = np.where(known, assessments.states["stamp_ns"], states.log_time_ns)
        for is_valid, names in (
            (known, ("speed", "effective_mass")),
            (decided, ("allowable_speed", "margin")),
            (rows["iso_mass"] > 0.0, ("iso_mass",)),
        ):
            for name in names:
                rows[name][~is_valid] = NAN
        before = self._rows[-1]["verdict"][-1] if self._count else -1
        for row in np.flatnonzero(np.diff(rows["verdict"], prepend=before)).tolist():
            code = Reason(int(contacts["reason"][row, CODE]))
            self._changes[self._count + row] = Change(assessments.reason(row, point), states.positions(row), code)
        self._mass_models += mass_model_counts(contacts, labels)
        self._count += len(states)
        self._rows.append(rows)

    def build(self) -> TimeSeries:
        """Return the assessments so far, in order of time."""
        rows = np.concatenate(self._rows)
        order = np.argsort(rows["stamp_ns"], kind="stable")
        rank = np.argsort(order)
        changes = {int(rank[index]): change for index, change in self._changes.items()}
        return TimeSeries(changes, self._mass_models, tuple(self._regions), rows[order])


def decimate(time: FloatArray, values: FloatArray, columns: int) -> tuple[FloatArray, FloatArray]:
    """Return at most 5 points per pixel column that draw the same lines: first, last, minimum, maximum, and one NaN.

    `time` (m,) is ascending. Equal columns of time become equal columns of pixels, so no peak and no gap is lost.
    """
    if len(time) <= 5 * columns:
        return time, values
    span = time[-1] - time[0] or 1.0
    column = np.minimum((columns * (time - time[0]) / span).astype(np.int64), columns - 1)
    starts = np.flatnonzero(np.diff(column, prepend=-1))
    sizes = np.diff(starts, append=len(time))

    def first_of_column(mask: BoolArray) -> IntArray:
        indices = np.flatnonzero(mask)
        first: IntArray = indices[np.diff(column[indices], prepend=-1) > 0]
        return first

    low, high = (np.repeat(extremum.reduceat(values, starts), sizes) for extremum in (np.fmin, np.fmax))
    masks = values == low, values == high, np.isnan(values)
    indices = np.unique(np.concatenate([starts, starts + sizes - 1, *map(first_of_column, masks)]))
    return time[indices], values[indices]


def intervals(series: TimeSeries, timeout: float) -> Iterator[Episode]:
    """Yield the intervals of equal verdict in order; a silence beyond `timeout` [s] is UNKNOWN."""
    time, verdict, margin = series.time, series.rows["verdict"], series.rows["margin"]
    if not len(time):
        return
    silent = np.diff(time) > timeout
    starts = [0, *(np.flatnonzero(silent | (np.diff(verdict) != 0)) + 1).tolist()]
    changes = sorted(series.changes)
    for start, stop in zip(starts, [*starts[1:], len(time)], strict=True):
        end = float(time[min(stop, len(time) - 1)])
        last = min(end, float(time[stop - 1]) + timeout)
        margins = margin[start:stop]
        tightest = start if np.isnan(margins).all() else start + int(np.nanargmin(margins))
        region = series.regions[series.rows["body_region"][tightest]]
        number = bisect_right(changes, start)
        change = series.changes[changes[number - 1]] if number else Change()
        yield Episode(float(time[start]), last, Verdict(verdict[start]), float(margin[tightest]), region, *change)
        if end > last:
            yield Episode(last, end, Verdict.UNKNOWN, NAN, "", NO_JOINT_STATE, reason_code=Reason.GAP)
