"""Force from a CSV file, as programs for load cells export it: a header row, a column of times, one of force."""

from __future__ import annotations

import csv
import math
import re
from array import array
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from scara_effmass.daq.even_time import EvenBlocks
from scara_effmass.daq.force_file import NS, UNITS, ForceFile, declared_unit
from scara_effmass.errors import BagError, SettingsError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from scara_effmass.settings import BagSettings

DELIMITERS = ",;\t"
TIME_UNITS = {"s": NS, "sec": NS, "ms": 1_000_000, "us": 1000, "µs": 1000, "ns": 1}
"""In [ns]."""

HEAD = 4096
"""In so many characters, what is no text shows itself."""

FARTHEST_NS = 2**62
"""In 2116; twice that is too much for 64 bits."""
MOST_DIGITS = 20
"""Of the nanoseconds until then; a number that has more is far beyond."""

BRACKETED = re.compile(r".*[(\[]\s*([^()\[\]]*?)\s*[)\]]\s*")
SUFFIXED = re.compile(r".*_([A-Za-z]+)\s*")
LOWER_CASE = {unit.lower(): unit for unit in (*UNITS, *TIME_UNITS)}


class _Table(NamedTuple):
    """A file: its header, and the rows below as they are read, each with the number of its line."""

    header: list[str]
    rows: Iterator[tuple[int, list[str]]]


def open_csv_force(settings: BagSettings, block_time: float) -> ForceFile:
    """Read a CSV file: the column `settings.topic` at the times in `settings.time_column`, cut to `block_time` [s].

    Fields are separated by comma, semicolon or tab; units stand in the header, as in "Force (N)" or "force_n", times
    without one are in seconds. Rows in which either field is blank are skipped. Raises BagError or SettingsError.
    """
    path = Path(settings.path)
    header, rows = _read(path)
    time = _column(header, settings.time_column or header[0], "bag.time_column", path)
    force = _column(header, settings.topic or _only_force(header, time, path), "bag.topic", path)
    if time == force:
        raise SettingsError(f"{path}: bag.topic and bag.time_column are both {header[time]!r}; two columns are needed")
    origin = f"{path}: {header[force]}"
    unit, scale = declared_unit(settings.unit, _unit(header[force]), origin)
    written = _unit(header[time])
    if written and written not in TIME_UNITS:
        raise BagError(
            f"{path}: {header[time]} is in {written}; times in one of {', '.join(TIME_UNITS)} would be right"
        )
    # a long file has millions of rows: as arrays they take 16 bytes each
    stamps_ns, values = array("q"), array("d")
    for stamp_ns, value in _samples(path, header, rows, time, force, TIME_UNITS[written or "s"]):
        stamps_ns.append(stamp_ns)
        values.append(value)
    try:
        even = EvenBlocks(zip(stamps_ns, values, strict=True), block_time, scale)
    except ValueError as error:
        raise BagError(f"{origin}: {error}") from None
    return ForceFile(
        description=f"{path.name}, {header[force]}",
        channel=header[force],
        unit=unit,
        sample_rate=even.sample_rate,
        start_ns=even.start_ns,
        end_ns=stamps_ns[-1],
        blocks=iter(even),
    )


def _read(path: Path) -> _Table:
    lines = _lines(path)
    numbered = enumerate(lines)
    start, first = next(((n, line) for n, line in numbered if line.strip() and not line.startswith("#")), (0, ""))
    if not first:
        raise BagError(f"{path}: is empty; a header row and rows of numbers would be right")
    counts = {each: len(next(csv.reader([first], delimiter=each))) for each in DELIMITERS}
    delimiter = max(counts, key=lambda each: counts[each])
    rows = _rows(path, start, chain([first], lines), delimiter)
    _, header = next(rows)
    if len(header) < 2:
        raise BagError(f"{path}: line {start + 1}: has one column; times and force, separated by , ; or tab are needed")
    if all(_is_number(name) for name in header if name):
        raise BagError(
            f"{path}: line {start + 1}: holds numbers; a header with the names of the columns would be right"
        )
    return _Table(header, rows)


def _lines(path: Path) -> Iterator[str]:
    try:
        # the names of other columns may be in any encoding
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            if "\0" in file.read(HEAD):
                raise BagError(f"{path}: is no text in UTF-8; a CSV file in that encoding would be right")
            file.seek(0)
            yield from file
    except OSError as error:
        raise BagError(f"{path}: cannot be read: {error.strerror}") from None


def _rows(path: Path, start: int, lines: Iterator[str], delimiter: str) -> Iterator[tuple[int, list[str]]]:
    reader = csv.reader(lines, delimiter=delimiter)
    try:
        for row in reader:
            if row:
                yield start + reader.line_num, [cell.strip() for cell in row]
    except csv.Error as error:
        raise BagError(f"{path}: line {start + reader.line_num}: is no CSV: {error}") from None


def _column(header: Sequence[str], name: str, key: str, path: Path) -> int:
    found = [number for number, each in enumerate(header) if each == name.strip()]
    if len(found) == 1:
        return found[0]
    what = "several columns have this name" if found else "there is no such column"
    raise SettingsError(f"{path}: {key} = {name}: {what}; one of {', '.join(header)} would be right")


def _only_force(header: Sequence[str], time: int, path: Path) -> str:
    others = [name for number, name in enumerate(header) if number != time]
    candidates = [name for name in others if _unit(name) in UNITS] or others
    if len(candidates) == 1:
        return candidates[0]
    raise SettingsError(f"{path}: bag.topic is empty; one of {', '.join(candidates)} would be right")


def _unit(name: str) -> str:
    """Return the unit that the name of a column ends in, empty where there is none."""
    if found := BRACKETED.fullmatch(name):
        return found[1].replace("\u03bc", "\u00b5")  # two characters that look the same: Greek mu, micro sign
    found = SUFFIXED.fullmatch(name)
    return LOWER_CASE.get(found[1].lower(), "") if found else ""


def _samples(
    path: Path, header: Sequence[str], rows: Iterator[tuple[int, list[str]]], time: int, force: int, unit_ns: int
) -> Iterator[tuple[int, float]]:
    last = -math.inf
    for line, row in rows:
        if len(row) <= max(time, force) or not row[time] or not row[force]:
            continue
        origin = f"{path}: line {line}"
        value = _number(row[force], f"{origin}: {header[force]}")
        # a float has not enough digits for the date in nanoseconds
        whole = row[time].isdecimal() and len(row[time]) <= MOST_DIGITS
        when = int(row[time]) if whole else _number(row[time], f"{origin}: {header[time]}")
        if not last <= when < math.inf:
            goes = f"{header[time]} = {row[time]} comes after {last:.15g}"
            raise BagError(f"{origin}: {goes}; times that rise would be right")
        last = when
        stamp_ns = when * unit_ns
        if abs(stamp_ns) > FARTHEST_NS:
            goes = f"{header[time]} = {row[time]} is more than {FARTHEST_NS // NS} s"
            raise BagError(f"{origin}: {goes}; seconds since 1970 or since the start would be right")
        yield round(stamp_ns), value


def _number(text: str, origin: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise BagError(f"{origin} = {text!r} is no number; digits with a decimal point would be right") from None


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
