# SPDX-License-Identifier: Apache-2.0
"""Temporal properties that verdicts must have, compared block by block in bounded memory."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pyarrow import csv, parquet

from scara_effmass.analysis.tables import SCHEMA
from scara_effmass.bags.bag import Bag
from scara_effmass.bags.batches import IntArray
from scara_effmass.bags.files import open_bag
from scara_effmass.codes import Reason
from scara_effmass.errors import BagError, DecodeError
from scara_effmass.safety.reasons import HELD_AFTER, LATCHED_UNTIL_RESET, plain_text
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import BoolArray, FloatArray, Verdict, severity
from scara_effmass.wire.contact_states import decode_contact_states
from scara_effmass.wire.message_types import CONTACT_STATES, FORMER_CONTACT_STATE
from scara_effmass.wire.topics import verdict_qos

Columns = Mapping[str, Sequence[Any]]
Array = NDArray[Any]


class _Verdicts(NamedTuple):
    """Consecutive verdicts (m,) of one contact point, in the order of their publication.

    `cause` is the severity without debouncing and latch, 0 where that is unknown. `ended`: the monitor ends with it.
    """

    log_ns: IntArray
    stamp_ns: IntArray
    severity: IntArray
    cause: IntArray
    watchdog: BoolArray
    ended: BoolArray
    allowable_speed: FloatArray
    margin: FloatArray
    age: FloatArray


_OK, _WARN, _VIOLATION, _UNKNOWN = (severity(verdict) for verdict in sorted(Verdict, key=severity))

# A number that is NaN violates.
EACH: Mapping[str, Callable[[_Verdicts, float], BoolArray]] = {
    "UNKNOWN implies speed 0": lambda v, _: (v.severity < _UNKNOWN) | (v.allowable_speed <= 0.0),
    "a permissive verdict is not below the speed": lambda v, _: (v.severity > _WARN) | (v.margin >= 0.0),
    "a permissive verdict is not older than the timeout": lambda v, timeout: (v.severity > _WARN) | (v.age <= timeout),
    "a watchdog's verdict is UNKNOWN": lambda v, _: ~v.watchdog | (v.severity == _UNKNOWN),
}
"""Properties of each verdict at its log time, with the `timeout` [s]."""
HELD = {
    "WARN is held for the release time": _WARN,
    "a VIOLATION is not followed by OK or WARN within the release time": _VIOLATION,
    "UNKNOWN is held for the release time": _UNKNOWN,
}
"""Properties that no verdict is less severe than this within the release time of a cause so severe, by the stamps."""
DEADLINE = "a verdict comes at least every deadline while active"
"""Property of the verdicts of a live monitor on one topic."""
PROPERTIES = (*EACH, *HELD, DEADLINE)


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
_NOT_A_CAUSE = (HELD_AFTER, LATCHED_UNTIL_RESET)
_ENDS = tuple(plain_text(code) for code in (Reason.DEACTIVATED, Reason.SHUTDOWN, Reason.NODE_ERROR))
"""Beginnings of reasons: former recordings have no codes."""
_SEVERITIES = {verdict.name: severity(verdict) for verdict in Verdict}
_NAMES = {int(verdict): verdict.name for verdict in Verdict}
_BLOCK = 16_384
_NEVER_NS = np.iinfo(np.int64).max
_NS = 1e9
_SLACK_NS = 1000
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
        # Inferred types are those of the first block: reasons that are all empty there would be no texts.
        types = csv.ConvertOptions(include_columns=names, column_types=SCHEMA)
        batches = csv.open_csv(path, csv.ReadOptions(skip_rows=comments), convert_options=types)
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
                try:
                    while block := list(islice(rows, _BLOCK)):
                        yield topic.name, dict(zip(_COLUMNS, zip(*block, strict=True), strict=True))
                except DecodeError as error:
                    raise BagError(f"{path}: {topic.name}: {error}") from None


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


class _Violations:
    """Count the times at which a property begins to be violated."""

    def __init__(self) -> None:
        self.count = 0
        self.first_ns = _NEVER_NS
        self._is_violated = False

    def add(self, violated: BoolArray, at_ns: IntArray) -> None:
        """Take whether each of the next verdicts violates the property, and their times."""
        begins = violated & ~np.concatenate(([self._is_violated], violated[:-1]))
        self.count += int(begins.sum())
        if not self.count:
            return
        self.first_ns = min(self.first_ns, int(at_ns[begins].min(initial=_NEVER_NS)))
        self._is_violated = bool(violated[-1:].any())


class _Trace:
    """Evaluate the properties of the verdicts of one contact point."""

    def __init__(self, settings: MonitorSettings) -> None:
        self.count = 0
        self.violations: dict[str, _Violations] = defaultdict(_Violations)
        self._timeout_s = settings.timeout
        self._release_ns = round(settings.release_time * _NS) - _SLACK_NS
        self._known_ns = self._end_ns = 0
        self._cause_ns = dict.fromkeys(HELD, -_NEVER_NS)

    def add(self, block: Columns) -> None:
        """Take the next verdicts."""
        verdicts = _verdicts(block, self._known_ns)
        self.count += len(verdicts.severity)
        for text, holds in EACH.items():
            self.violations[text].add(~holds(verdicts, self._timeout_s), verdicts.log_ns)
        # The watchdog repeats a stamp, and its verdicts do not affect later ones.
        is_answer = ~verdicts.watchdog
        stamp_ns = verdicts.stamp_ns[is_answer]
        if self._release_ns <= 0 or not stamp_ns.size:
            return
        # Stamps go back where the clock of the monitor went back and the monitor discarded its history.
        starts = np.flatnonzero(np.diff(stamp_ns, prepend=self._end_ns) < 0)
        part = np.repeat(starts, np.diff(starts, append=stamp_ns.size))
        first = np.concatenate((np.full(stamp_ns.size - part.size, -1), part))
        for text, level in HELD.items():
            is_cause = verdicts.cause[is_answer] >= level
            last = np.maximum.accumulate(np.where(is_cause, np.arange(stamp_ns.size), -1))
            cause_ns = np.where(last >= 0, stamp_ns[last], self._cause_ns[text])
            is_recent = (last >= first) & (stamp_ns - self._release_ns <= cause_ns)
            self.violations[text].add(is_recent & (verdicts.severity[is_answer] < level), stamp_ns)
            self._cause_ns[text] = int(cause_ns[-1]) if last[-1] >= first[-1] else -_NEVER_NS
        self._end_ns = int(stamp_ns[-1])
        has_time = verdicts.cause[is_answer] < _UNKNOWN
        self._known_ns = int(stamp_ns[has_time][-1]) if has_time.any() else self._known_ns


class _Topic:
    """Evaluate DEADLINE for the verdicts on one topic of a live monitor."""

    def __init__(self, deadline_s: float) -> None:
        self.violations = _Violations()
        self._deadline_ns = round(deadline_s * _NS)
        self._last_ns = _NEVER_NS
        self._has_ended = False

    def add(self, log_ns: IntArray, ended: BoolArray) -> None:
        """Take the times of the next verdicts, and whether the monitor ends with each of them."""
        due_ns = np.concatenate(([min(self._last_ns, int(log_ns[0]))], log_ns[:-1])) + self._deadline_ns
        is_active = ~np.concatenate(([self._has_ended], ended[:-1]))
        self.violations.add(is_active & (log_ns > due_ns), due_ns)
        self._last_ns, self._has_ended = int(log_ns[-1]), bool(ended[-1])


def _verdicts(block: Columns, known_ns: int) -> _Verdicts:
    """Return the verdicts in a block; `known_ns` is the last known stamp before it."""
    log_ns, stamp_ns = (np.asarray(block[name], dtype=np.int64) for name in ("log_time_ns", "stamp_ns"))
    reason, watchdog = block["reason"], np.asarray(block["watchdog"], dtype=bool)
    level = np.array([_SEVERITIES[name] for name in block["verdict"]])
    is_cause = np.array([not text.startswith(_NOT_A_CAUSE) for text in reason]) & ~watchdog
    cause = np.where(is_cause, level, 0)
    # The stamp of a refused joint state may be anything: its UNKNOWN counts at a time between its neighbours.
    has_time = ~watchdog & (cause < _UNKNOWN)
    index, count = np.arange(level.size), level.size
    before = np.maximum.accumulate(np.where(has_time, index, -1))
    after = np.minimum.accumulate(np.where(has_time, index, count)[::-1])[::-1]
    known = np.concatenate(([known_ns], stamp_ns, [_NEVER_NS]))
    stamp_ns = np.where(has_time, stamp_ns, np.clip(stamp_ns, known[before + 1], known[after + 1]))
    ended = np.array([text.startswith(_ENDS) for text in reason]) & watchdog
    numbers = (np.asarray(block[name], dtype=float) for name in _COLUMNS[-3:])
    return _Verdicts(log_ns, stamp_ns, level, cause, watchdog, ended, *numbers)


def _check(
    verdicts: str, blocks: Iterator[tuple[str, Columns]], settings: MonitorSettings, end_ns: int = 0
) -> list[PropertyResult]:
    """Evaluate all properties; `end_ns` is the end of a recording of a live monitor."""
    traces: dict[str, _Trace] = defaultdict(lambda: _Trace(settings))
    topics: dict[str, _Topic] = defaultdict(lambda: _Topic(verdict_qos(settings.timeout).deadline_s))
    for source, block in blocks:
        points = np.asarray(block["contact_point"], dtype=object)
        for point in dict.fromkeys(points):
            is_point = points == point
            columns = {name: np.asarray(block[name], dtype=object)[is_point] for name in _COLUMNS}
            traces[f"{source}: {point}"].add(columns)
        if end_ns:  # by topic: the names of the contact points change when the monitor gets its robot
            every = _verdicts(block, 0)
            topics[source].add(every.log_ns, every.ended)
    results, count = [], sum(trace.count for trace in traces.values())
    found = {text: {place: trace.violations[text] for place, trace in traces.items()} for text in (*EACH, *HELD)}
    if settings.release_time * _NS <= _SLACK_NS:
        found = {text: found[text] for text in EACH}
    if end_ns:
        for topic in topics.values():
            topic.add(np.array([end_ns]), np.array([True]))
        found[DEADLINE] = {place: topic.violations for place, topic in topics.items()}
    for text, violations in found.items():
        total, first = sum(own.count for own in violations.values()), ""
        if total:
            place, own = min(violations.items(), key=lambda item: item[1].first_ns)
            first = f"in {place}, at {own.first_ns / _NS:.6f} s"
        results.append(PropertyResult(verdicts, text, count, total, first))
    return results if traces else []
