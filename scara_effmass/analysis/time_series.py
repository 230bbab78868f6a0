# SPDX-License-Identifier: Apache-2.0
"""Time series of the assessments of one contact point, for figures and reports."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scara_effmass.analysis.assessment import AssessedStates
from scara_effmass.bags.batches import IntArray
from scara_effmass.codes import Reason
from scara_effmass.kernel.state import CODE
from scara_effmass.values import NAN, BoolArray, FloatArray, Verdict

NO_JOINT_STATE = "no joint state"
"""Reason of the episodes in which no joint state arrived."""


@dataclass(frozen=True, slots=True)
class TimeSeries:
    """Assessments at `time` (m,) [s] since `start_ns`; unknown values are NaN. Speeds [m/s], masses [kg].

    Where the verdict changes, `reasons` holds its reason by index, and `places` its body region, the joint positions by
    name, and the code of the reason. `mass_models` counts the mass models with the reasons for them.
    """

    start_ns: int
    reasons: dict[int, str]
    mass_models: Counter[str]
    time: FloatArray
    verdict: NDArray[np.int64]
    speed: FloatArray
    allowable_speed: FloatArray
    margin: FloatArray
    effective_mass: FloatArray
    lumped_mass: FloatArray
    full_mass: FloatArray
    iso_mass: FloatArray
    places: dict[int, tuple[str, dict[str, float], Reason]] = field(default_factory=dict)

    def with_gaps(self, timeout: float) -> TimeSeries:
        """Return a copy with a row of NaN after each gap longer than `timeout` [s] begins, which breaks a line."""
        gaps = np.flatnonzero(np.diff(self.time) > timeout) + 1
        columns = {name: np.insert(getattr(self, name), gaps, NAN) for name in _VALUES}
        return TimeSeries(
            start_ns=self.start_ns,
            reasons={},
            places={},
            mass_models=self.mass_models,
            time=np.insert(self.time, gaps, self.time[gaps - 1] + timeout),
            verdict=np.insert(self.verdict, gaps, Verdict.UNKNOWN),
            **columns,
        )


_VALUES = tuple(field.name for field in fields(TimeSeries))[5:-1]


class Episode(NamedTuple):
    """An interval of one verdict, from `start` to `stop` [s] since the first joint state.

    `min_margin` [m/s] is NaN where no margin is known; `reason` with its code, `body_region` and the joint
    `positions` by name [rad, m] are those of the first joint state.
    """

    start: float
    stop: float
    verdict: Verdict
    min_margin: float
    reason: str
    body_region: str = ""
    positions: Mapping[str, float] = MappingProxyType({})
    reason_code: Reason = Reason.NONE


class TimeSeriesBuilder:
    """Collects the assessments of one contact point; each takes 72 bytes, an hour at 1 kHz 260 MB."""

    def __init__(self) -> None:
        """Start empty."""
        self._stamps_ns: list[IntArray] = []
        self._verdicts: list[NDArray[np.int8]] = []
        self._values: list[FloatArray] = []
        self._count = 0
        self._reasons: dict[int, str] = {}
        self._places: dict[int, tuple[str, dict[str, float], Reason]] = {}
        self._mass_models: Counter[str] = Counter()

    def add(self, states: AssessedStates, point: int) -> None:
        """Add contact point number `point`, each assessment at its own stamp where that is valid, else the log time."""
        assessments = states.assessments
        contact, labels = assessments.contacts[:, point], assessments.labels
        verdict = contact["verdict"].astype(np.int8)
        known, decided = contact["effective_mass"] > 0.0, verdict != Verdict.UNKNOWN
        before = self._verdicts[-1][-1] if self._verdicts else -1
        for row in np.flatnonzero(np.diff(verdict, prepend=np.int8(before))).tolist():
            index = self._count + row
            self._reasons[index] = assessments.reason(row, point)
            region, code = (
                labels["body_region"][int(contact["body_region"][row])],
                Reason(int(contact["reason"][row, CODE])),
            )
            self._places[index] = region, states.positions(row), code
        models, whys = contact["mass_model"], contact["mass_model_reason"].astype(np.int64)
        for model, name in enumerate(labels["mass_model"]):
            counts = np.bincount(whys[models == model])
            for reason in np.flatnonzero(counts).tolist() if name else ():
                self._mass_models[f"{name}: {labels['mass_model_reason'][reason]}"] += int(counts[reason])
        self._count += len(states)
        self._stamps_ns.append(np.where(known, assessments.states["stamp_ns"], states.log_time_ns))
        self._verdicts.append(verdict)
        columns = (
            np.where(known, contact["speed"], NAN),
            np.where(decided, contact["allowable_speed"], NAN),
            np.where(decided, contact["margin"], NAN),
            np.where(known, contact["effective_mass"], NAN),
            contact["lumped_mass"],
            contact["full_mass"],
            np.where(contact["iso_mass"] > 0.0, contact["iso_mass"], NAN),
        )
        self._values.append(np.array(columns))

    def build(self) -> TimeSeries:
        """Return the assessments so far, in order of time."""
        stamps_ns = np.concatenate([*self._stamps_ns, np.empty(0, np.int64)])
        order = np.argsort(stamps_ns, kind="stable")
        stamps_ns = stamps_ns[order]
        columns = np.concatenate([*self._values, np.empty((len(_VALUES), 0))], axis=1)[:, order]
        start_ns = int(stamps_ns[0]) if len(stamps_ns) else 0
        rank = np.empty(len(order), np.int64)
        rank[order] = np.arange(len(order))
        return TimeSeries(
            start_ns=start_ns,
            reasons={int(rank[index]): reason for index, reason in self._reasons.items()},
            places={int(rank[index]): place for index, place in self._places.items()},
            mass_models=self._mass_models,
            time=(stamps_ns - start_ns) / 1e9,
            verdict=np.concatenate([*self._verdicts, np.empty(0, np.int64)])[order],
            **dict(zip(_VALUES, columns, strict=True)),
        )


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
    time, verdict = series.time, series.verdict
    if not len(time):
        return
    silent = np.diff(time) > timeout
    starts = [0, *(np.flatnonzero(silent | (np.diff(verdict) != 0)) + 1).tolist()]
    changes = sorted(series.reasons)
    for start, stop in zip(starts, [*starts[1:], len(time)], strict=True):
        end = float(time[min(stop, len(time) - 1)])
        last = min(end, float(time[stop - 1]) + timeout)
        margins = series.margin[start:stop]
        min_margin = NAN if np.isnan(margins).all() else float(np.nanmin(margins))
        number = bisect_right(changes, start)
        changed = changes[number - 1] if number else 0
        reason, place = series.reasons.get(changed, ""), series.places.get(changed, ("", {}, Reason.NONE))
        yield Episode(float(time[start]), last, Verdict(verdict[start]), min_margin, reason, *place)
        if end > last:
            yield Episode(last, end, Verdict.UNKNOWN, NAN, NO_JOINT_STATE, reason_code=Reason.GAP)
