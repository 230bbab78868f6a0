# SPDX-License-Identifier: Apache-2.0
"""Force from a CSV file with a header row, a column of times and a column of force."""

import csv
import math
import re
from array import array
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path

import numpy as np

from scara_effmass.errors import BagError, SettingsError
from scara_effmass.importers.force_file import UNITS, ForceFile, select_unit, uniform_samples
from scara_effmass.settings import ImportSettings
from scara_effmass.wire.cdr import MAX_SEC, NS

Rows = Iterator[tuple[int, list[str]]]

DELIMITERS = ",;\t"
NS_PER_UNIT = {"s": NS, "sec": NS, "ms": 1_000_000, "us": 1000, "µs": 1000, "ns": 1}
BINARY_CHECK = 4096
"""Number of characters at the start of a file by which text is recognized."""
MAX_DIGITS = 20
"""Maximum number of digits of an integer time; longer ones are read as floats."""

BRACKETED = re.compile(r".*[(\[]\s*([^()\[\]]*?)\s*[)\]]\s*")
SUFFIXED = re.compile(r".*_([A-Za-z]+)\s*")
LOWER_CASE = {unit.lower(): unit for unit in (*UNITS, *NS_PER_UNIT)}


def open_csv(path: Path, settings: ImportSettings) -> ForceFile:
    """Read the column `settings.topic` at the times in `settings.time_column`.

    Fields are separated by comma, semicolon or tab. The header states units, as in "Force (N)" or "force_n"; times
    without a unit are in seconds. Rows without time or force are skipped. Raises BagError or SettingsError.
    """
    header, rows = _read(path)
    time = _column(header, settings.time_column or header[0], "time_column", path)
    force = _column(header, settings.topic or _force_column(header, time, path), "topic", path)
    if time == force:
        raise SettingsError(f"{path}: topic = time_column = {header[time]}: must be two columns")
    origin = f"{path}: {header[force]}"
    unit = select_unit(settings.unit, _unit(header[force]), origin)
    time_unit = _unit(header[time]) or "s"
    if time_unit not in NS_PER_UNIT:
        raise BagError(f"{path}: {header[time]}: has the unit {time_unit}; must be one of {', '.join(NS_PER_UNIT)}")
    # A long file has millions of rows; these arrays need 16 bytes for each.
    stamps_ns, values = array("q"), array("d")
    for stamp_ns, value in _samples(path, header, rows, time, force, NS_PER_UNIT[time_unit]):
        stamps_ns.append(stamp_ns)
        values.append(value)
    try:
        sample_rate, blocks = uniform_samples(np.frombuffer(stamps_ns, np.int64), np.frombuffer(values))
    except ValueError as error:
        raise BagError(f"{origin}: {error}") from None
    return ForceFile(f"{path.name}, {header[force]}", unit, sample_rate, blocks)


def _read(path: Path) -> tuple[list[str], Rows]:
    """Return the header, and an iterator over the rows below it with their line numbers."""
    lines = _lines(path)
    numbered = enumerate(lines)
    start, first = next(((n, line) for n, line in numbered if line.strip() and not line.startswith("#")), (0, ""))
    if not first:
        raise BagError(f"{path}: is empty; must have a header row and rows of numbers")
    delimiter = max(DELIMITERS, key=lambda mark: len(next(csv.reader([first], delimiter=mark))))
    rows = _rows(path, start, chain([first], lines), delimiter)
    _, header = next(rows)
    if len(header) < 2:
        raise BagError(f"{path}: line {start + 1}: has one column; must have times and force, separated by , ; or tab")
    if all(_is_number(name) for name in header if name):
        raise BagError(f"{path}: line {start + 1}: has numbers; must be a header with the names of the columns")
    return header, rows


def _lines(path: Path) -> Iterator[str]:
    try:
        # Names of other columns may be in any encoding.
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            if "\0" in file.read(BINARY_CHECK):
                raise BagError(f"{path}: must be text in UTF-8")
            file.seek(0)
            yield from file
    except OSError as error:
        raise BagError(f"{path}: cannot be read: {error.strerror}") from None


def _rows(path: Path, start: int, lines: Iterator[str], delimiter: str) -> Rows:
    reader = csv.reader(lines, delimiter=delimiter)
    try:
        for row in reader:
            if row:
                yield start + reader.line_num, [cell.strip() for cell in row]
    except csv.Error as error:
        raise BagError(f"{path}: line {start + reader.line_num}: is not CSV: {error}") from None


def _column(header: Sequence[str], name: str, key: str, path: Path) -> int:
    if header.count(name.strip()) == 1:
        return header.index(name.strip())
    problem = "must be a name that only one column has" if name.strip() in header else "must be one of"
    raise SettingsError(f"{path}: {key} = {name}: {problem} {', '.join(header)}")


def _force_column(header: Sequence[str], time: int, path: Path) -> str:
    """Return the only column that can be force; columns with a unit of force have priority."""
    others = [name for number, name in enumerate(header) if number != time]
    candidates = [name for name in others if _unit(name) in UNITS] or others
    if len(candidates) == 1:
        return candidates[0]
    raise SettingsError(f"{path}: topic is empty: must be one of {', '.join(candidates)}")


def _unit(name: str) -> str:
    """Return the unit at the end of a column name; empty if there is none."""
    if match := BRACKETED.fullmatch(name):
        return match[1].replace("\u03bc", "\u00b5")  # Greek mu and micro sign look the same
    match = SUFFIXED.fullmatch(name)
    return LOWER_CASE.get(match[1].lower(), "") if match else ""


def _samples(
    path: Path, header: Sequence[str], rows: Rows, time: int, force: int, ns_per_unit: int
) -> Iterator[tuple[int, float]]:
    """Yield the stamp [ns] and the value of each row."""
    previous = -math.inf
    for line, row in rows:
        if len(row) <= max(time, force) or not row[time] or not row[force]:
            continue
        value = _number(row[force], f"{path}: line {line}: {header[force]}")
        origin = f"{path}: line {line}: {header[time]}"
        # A float has too few digits for nanoseconds since 1970.
        is_integer = row[time].isdecimal() and len(row[time]) <= MAX_DIGITS
        seconds = int(row[time]) if is_integer else _number(row[time], origin)
        if not previous <= seconds < math.inf:
            raise BagError(f"{origin} = {row[time]}: must not be less than {previous:.15g}, the time before")
        previous = seconds
        if abs(seconds * ns_per_unit) > MAX_SEC * NS:
            raise BagError(f"{origin} = {row[time]}: must be within {MAX_SEC} s of 1970 or of the start")
        yield round(seconds * ns_per_unit), value


def _number(text: str, origin: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise BagError(f"{origin} = {text!r}: must be digits with a decimal point") from None


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
