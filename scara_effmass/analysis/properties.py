# SPDX-License-Identifier: Apache-2.0
"""Temporal properties that verdicts must have, in signal temporal logic (STL), evaluated by RTAMT.

The time that RTAMT takes grows with the square of the length of a signal. Verdicts are therefore evaluated as runs of
equal verdicts, which loses nothing, and a few hundred runs at a time.
"""

from __future__ import annotations

import sys
import typing
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pyarrow import csv, parquet

from scara_effmass.bags.bag import Bag
from scara_effmass.bags.files import open_bag
from scara_effmass.input_files import read_table
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import Verdict, severity
from scara_effmass.wire.contact_states import decode_contact_states
from scara_effmass.wire.message_types import CONTACT_STATES, FORMER_CONTACT_STATE
from scara_effmass.wire.topics import verdict_qos

sys.modules["typing.io"] = typing  # for the parser of RTAMT; deprecated, and gone from Python 3.13
import rtamt  # noqa: E402

Columns = Mapping[str, Sequence[Any]]
Array = NDArray[Any]


class Property(NamedTuple):
    """An STL formula over `severity` (0 OK to 3 UNKNOWN) and the other signals of `_signals`.

    Whole numbers are compared with halves, because a robustness of 0 would decide nothing. `on_stamps` evaluates at the
    header stamps in place of the log times. A `live` property applies to recordings of a live monitor only.
    """

    text: str
    formula: str
    on_stamps: bool = False
    live: bool = False


PROPERTIES = tuple(Property(**values) for values in read_table(__file__, "properties.yaml"))


class PropertyResult(NamedTuple):
    """Number of `violations` of a property among the `evaluated` verdicts, and place and time of the first one."""

    verdicts: str
    text: str
    evaluated: int
    violations: int
    first: str

    def __str__(self) -> str:
        if not self.violations:
            return f"{self.verdicts}: {self.text}: holds for {self.evaluated}"
        return f"{self.verdicts}: {self.text}: violated {self.violations} times, first {self.first}"


_COLUMNS = (
    *("log_time_ns", "stamp_ns", "contact_point", "verdict", "reason", "watchdog"),
    *("allowable_speed_m_s", "margin_m_s", "input_age_s"),
)
_NOT_A_CAUSE = ("held after: ", "latched until reset: ")
_ENDS = ("the monitor was deactivated", "the node shuts down", "the node ends: ")
_SEVERITIES = {verdict.name: severity(verdict) for verdict in Verdict}
_NAMES = {int(verdict): verdict.name for verdict in Verdict}
_BLOCK = 16_384
_CHUNK = 250
_NEVER_NS = np.iinfo(np.int64).max
_NS = 1e9
_INSTANT_S = 1e-9
_SLACK_S = 1e-6
"""Margin below the release time, which a verdict may just reach."""


def check_assessment(table: Path, bags: Sequence[Path], settings: MonitorSettings) -> list[PropertyResult]:
    """Evaluate the verdicts in a file of `assess` (.parquet, .csv or .mcap), and those that `bags` recorded live."""
    blocks = _recorded(table) if table.suffix == ".mcap" else _rows(table)
    assessed = _check("assessed verdicts", blocks, settings)
    return assessed + [result for bag in bags for result in check_recording(bag, settings)]


def check_recording(path: Path, settings: MonitorSettings) -> list[PropertyResult]:
    """Evaluate the verdicts in a recording of a live monitor; empty if there are none. Raises BagError."""
    with open_bag(path) as bag:
        end_ns = bag.end_ns
    return _check(str(path), _recorded(path), settings, end_ns)


def _rows(path: Path) -> Iterator[tuple[str, Columns]]:
    """Yield blocks of the rows of each recording in a table."""
    names = ["bag", *_COLUMNS]
    if path.suffix == ".parquet":
        batches: Any = parquet.ParquetFile(path).iter_batches(_BLOCK, columns=names)
    else:
        with path.open(encoding="utf-8") as file:
            comments = next(number for number, line in enumerate(file) if not line.startswith("#"))
        batches = csv.open_csv(
            path, csv.ReadOptions(skip_rows=comments), convert_options=csv.ConvertOptions(include_columns=names)
        )
    for batch in batches:
        columns = {name: np.asarray(batch.column(name).to_pylist(), dtype=object) for name in names}
        for bag in dict.fromkeys(columns["bag"]):
            yield bag, {name: values[columns["bag"] == bag] for name, values in columns.items()}


def _recorded(path: Path) -> Iterator[tuple[str, Columns]]:
    """Yield blocks of the verdicts on each topic of contact states in a bag, a row per contact."""
    with open_bag(path) as bag:
        for topic in bag.topics:
            if topic.type in {CONTACT_STATES, FORMER_CONTACT_STATE}:
                rows = _contact_rows(bag, topic.name)
                while block := list(islice(rows, _BLOCK)):
                    yield topic.name, dict(zip(_COLUMNS, zip(*block, strict=True), strict=True))


def _contact_rows(bag: Bag, topic: str) -> Iterator[tuple[Any, ...]]:
    """Yield _COLUMNS of each contact on a topic."""
    for raw in bag.messages([topic]):
        if raw.type == FORMER_CONTACT_STATE:
            state = bag.deserialize(raw)
            yield (
                *(raw.log_time_ns, state.header.stamp.sec * 10**9 + state.header.stamp.nanosec),
                *(state.contact_point, _NAMES.get(state.verdict, "UNKNOWN"), state.reason, state.watchdog),
                *(state.allowable_speed, state.margin, state.input_age),
            )
            continue
        decision = decode_contact_states(raw.data)
        for contact in decision.contacts:
            yield (
                *(raw.log_time_ns, decision.stamp_ns),
                *(contact.contact_point, contact.verdict.name, contact.reason, decision.watchdog),
                *(contact.allowable_speed, contact.margin, decision.input_age),
            )


class _Trace:
    """Collect the runs of equal verdicts of one contact point."""

    def __init__(self, max_gap_ns: float) -> None:
        self.count = 0
        self._max_gap_ns = max_gap_ns
        self._blocks: list[dict[str, Array]] = []
        self._last_stamp_ns = 0

    def add(self, block: Columns) -> None:
        """Append a block of verdicts, in the order of their publication."""
        self.count += len(block["verdict"])
        log, stamp = (np.asarray(block[name], dtype=np.int64) for name in ("log_time_ns", "stamp_ns"))
        reason, watchdog = block["reason"], np.asarray(block["watchdog"], dtype=bool)
        level = np.array([_SEVERITIES[name] for name in block["verdict"]])
        is_cause = np.array([not text.startswith(_NOT_A_CAUSE) for text in reason]) & ~watchdog
        cause = np.where(is_cause, level, 0)
        # The stamp of a refused joint state may be anything: its UNKNOWN counts at a time between its neighbours.
        has_time = ~watchdog & (cause < _SEVERITIES["UNKNOWN"])
        index, count = np.arange(level.size), level.size
        before = np.maximum.accumulate(np.where(has_time, index, -1))
        after = np.minimum.accumulate(np.where(has_time, index, count)[::-1])[::-1]
        known = np.concatenate(([self._last_stamp_ns], stamp, [_NEVER_NS]))
        stamp = np.where(has_time, stamp, np.clip(stamp, known[before + 1], known[after + 1]))
        self._last_stamp_ns = int(known[before[-1] + 1])
        ended = np.array([text.startswith(_ENDS) for text in reason]) & watchdog
        keys = np.stack((level, cause, watchdog, ended))
        changes = (np.diff(keys) != 0).any(axis=0) | (np.diff(log) > self._max_gap_ns) | (np.diff(stamp) < 0)
        first = np.concatenate(([0], np.flatnonzero(changes) + 1))
        last = np.concatenate((first[1:], [level.size])) - 1
        numbers = {name: np.asarray(block[name], dtype=float) for name in _COLUMNS[-3:]}
        self._blocks.append(
            {
                "log": log[first],
                "log_end": log[last],
                "stamp": stamp[first],
                "stamp_end": stamp[last],
                "severity": level[first],
                "cause": cause[first],
                "watchdog": watchdog[first],
                "ended": ended[first],
                "allowable_speed": np.maximum.reduceat(numbers["allowable_speed_m_s"], first),
                "margin": np.minimum.reduceat(numbers["margin_m_s"], first),
                "age": np.maximum.reduceat(numbers["input_age_s"], first),
            }
        )

    def columns(self) -> dict[str, Array]:
        """Return the columns of all runs: times of the first and the last verdict [ns], and the worst values."""
        return {name: np.concatenate([block[name] for block in self._blocks]) for name in self._blocks[0]}


def _check(
    verdicts: str, blocks: Iterator[tuple[str, Columns]], settings: MonitorSettings, end_ns: int = 0
) -> list[PropertyResult]:
    """Evaluate all properties; `end_ns` is the end of a recording of a live monitor."""
    deadline_s = verdict_qos(settings.timeout).deadline_s
    bounds = {
        "timeout": settings.timeout,
        "release": settings.release_time - _SLACK_S,
        "deadline": deadline_s,
    }
    traces: dict[str, _Trace] = defaultdict(lambda: _Trace(deadline_s * _NS / 4.0))
    topics: dict[str, _Trace] = defaultdict(lambda: _Trace(deadline_s * _NS / 4.0))
    for source, block in blocks:
        points = np.asarray(block["contact_point"], dtype=object)
        for point in dict.fromkeys(points):
            is_point = points == point
            columns = {name: np.asarray(block[name], dtype=object)[is_point] for name in _COLUMNS}
            traces[f"{source}: {point}"].add(columns)
        if end_ns:  # by topic: the names of the contact points change when the monitor gets its robot
            topics[source].add(block)
    results, count = [], sum(trace.count for trace in traces.values())
    for rule in PROPERTIES:
        if (rule.live and not end_ns) or (rule.on_stamps and settings.release_time <= _SLACK_S):
            continue
        violations = [
            (at_s, place)
            for place, trace in (topics if rule.live else traces).items()
            for at_s in _violations(rule, bounds, trace.columns(), end_ns)
        ]
        first = ""
        if violations:
            at_s, place = min(violations, key=itemgetter(0))
            first = f"in {place}, at {at_s:.6f} s"
        results.append(PropertyResult(verdicts, rule.text, count, len(violations), first))
    return results if traces else []


def _violations(rule: Property, bounds: Mapping[str, float], runs: dict[str, Array], last_ns: int) -> list[float]:
    """Return the times [s] at which a property begins to be violated."""
    formula = rule.formula.format(**bounds)
    clock = "stamp" if rule.on_stamps else "log"
    if rule.on_stamps:  # the watchdog repeats a stamp, and its verdicts do not affect later ones
        runs = {name: values[~runs["watchdog"]] for name, values in runs.items()}
    begins_s: list[float] = []
    # Stamps go back where the clock of the monitor went back and the monitor discarded its history.
    parts = np.split(np.arange(runs[clock].size), np.flatnonzero(np.diff(runs[clock]) < 0) + 1)
    for part in parts:
        start_ns, end_ns = runs[clock][part], runs[f"{clock}_end"][part]
        for begin in range(0, part.size, _CHUNK):
            stop = min(begin + _CHUNK, part.size)
            memory_ns = start_ns[begin] - _NS * max(bounds.values())
            before = min(int(np.searchsorted(end_ns, memory_ns)), begin)
            chunk = {name: values[part[before:stop]] for name, values in runs.items()}
            until_ns = start_ns[stop] if stop < part.size else max(end_ns[-1], last_ns * rule.live)
            origin_ns, from_s = start_ns[before], (start_ns[begin] - start_ns[before]) / _NS
            until_s = (until_ns - origin_ns) / _NS
            robustness = _evaluate(formula, _signals(chunk, clock, origin_ns, until_s))
            ends = [at_s for at_s, _ in robustness[1:]] + [until_s]
            begins_s += [
                origin_ns / _NS + max(at_s, from_s)
                for (at_s, value), end_s in zip(robustness, ends, strict=True)
                if value < 0.0 and end_s > from_s and at_s <= until_s
            ]
    return begins_s


def _signals(runs: dict[str, Array], clock: str, origin_ns: int, until_s: float) -> dict[str, list[list[float]]]:
    """Return the signals as steps [time in s, value] up to `until_s`; `cause` and `answer` are 0 between two runs."""
    start_s, end_s = ((runs[name] - origin_ns) / _NS for name in (clock, f"{clock}_end"))
    start_s = np.maximum.accumulate(start_s + _INSTANT_S / 10.0 * np.arange(start_s.size))  # steps need different times
    stop_s = max(until_s, float(start_s[-1]), float(end_s[-1])) + 2.0 * _INSTANT_S
    names = ("severity", "watchdog", "allowable_speed", "margin", "age")
    values = {name: runs[name].astype(float) for name in names} | {"active": 1.0 - runs["ended"]}
    signals = {
        name: [*map(list, zip(start_s.tolist(), value.tolist(), strict=True)), [stop_s, float(value[-1])]]
        for name, value in values.items()
    }
    for name, impulse in (("cause", runs["cause"].astype(float)), ("answer", np.ones(start_s.size))):
        steps: list[list[float]] = []
        for start, end, value in zip(start_s.tolist(), end_s.tolist(), impulse.tolist(), strict=True):
            if steps and steps[-1][0] >= start:
                steps.pop()
            steps += [[start, value], [max(end, start) + _INSTANT_S, 0.0]]
        signals[name] = [*steps, [stop_s, 0.0]]
    return signals


def _evaluate(formula: str, signals: dict[str, list[list[float]]]) -> list[list[float]]:
    """Return the robustness of an STL formula as steps [time in s, value]; below 0 the formula is violated."""
    spec = rtamt.StlDenseTimeSpecification()
    used = [name for name in signals if name in formula]
    for name in used:
        spec.declare_var(name, "float")
    spec.spec = formula
    spec.parse()
    robustness: list[list[float]] = spec.evaluate(*([name, signals[name]] for name in used))
    return robustness
