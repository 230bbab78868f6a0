# SPDX-License-Identifier: Apache-2.0
"""Force from a CSV file: a column of force, and one of times or a constant rate."""

import codecs
import csv
import re
from array import array
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, islice, pairwise, zip_longest
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from scara_effmass.errors import BagError, SettingsError
from scara_effmass.importers.force_file import (
    SPELLINGS,
    UNITS,
    ForceFile,
    check_seconds,
    is_force_name,
    refuse_settings,
    select_force,
    select_unit,
    short_unit,
    uniform_samples,
)
from scara_effmass.importers.times import MAX_DIGITS, NS_PER_UNIT, Decimals, Midnights, Numbers, iso_ns, time_ns
from scara_effmass.input_files import check_regular_file
from scara_effmass.settings import ImportSettings
from scara_effmass.wire.cdr import MAX_SEC, NS

if TYPE_CHECKING:
    from _csv import Reader

Rows = Iterator[tuple[int, list[str]]]

DELIMITERS = "\t;,| "
"""What separates columns; a space stands for any white space, and is taken only if no other one fits as well."""
SPACES = re.compile(r"\s+(?![\s(\[])")
"""White space between columns, not that before a unit in brackets."""
BINARY_CHECK = 4096
"""Number of characters at the start of a file by which text is recognized."""
MAX_LINE = 1 << 22
"""Number of characters that no line reaches."""
DELIMITER_ROWS = 6
"""Number of rows, from the header on, that show the delimiter."""
MAX_HEAD = 64
"""Number of lines within which the numbers begin, if there are lines above the header."""
NUMBER_ROWS = 3
"""Number of rows of numbers that show that the row above is the header."""
DIGITS = "must be digits with a decimal point, or one decimal comma in a file not separated by commas"
TIMES = f"{DIGITS}, or in ISO 8601, or as 31.12.2025 10:11:12,345 or 2025/12/31 (day and month show in no 3/12/2025)"

BRACKETED = re.compile(r".*[(\[]\s*(?!\d+\s*[)\]])([^()\[\]]*?)\s*[)\]]\s*")
"""Name with a unit in brackets; a number in them is an index."""
SUFFIXED = re.compile(r".*_([A-Za-z]+)\s*")
NUMBER = re.compile(r"[\W_]*\d+")
REPEATED = re.compile(r"\.\d+$")
"""What pandas appends to a name that another column has."""
WORD = re.compile(r"[^\W_]+")
TIME_WORDS = {"t", "time", "times", "timestamp", "stamp", "date", "datetime", "elapsed", "zeit", "zeitstempel", "datum"}
LONG_UNITS = {"min", "minutes", "h", "hours", "d", "days"}
"""Units of time that are refused."""
SEPARATOR = re.compile(r"(?i)sep=(.)")
"""First line by which Excel knows the delimiter."""
DECIMAL_COMMA = re.compile(r"\s*[+-]?\d+,\d+\s*")
NS_SINCE_1970 = re.compile(r"\d{19}")
"""A time with so many digits is in nanoseconds, whatever began the clock."""
COUNTER = re.compile(r"(?i)(#|no|nr|n|i|index|idx|samples?|count|counter|row|id|nummer)\.?")
NANOSECONDS = re.compile(r"(.*?)n(?:ano)?sec(?:ond)?s?")
"""Name of a column with nanoseconds, in lower case; that of their seconds begins alike."""
SECONDS = ("sec", "secs", "second", "seconds")
DATE = re.compile(r"\d{4}([-/.])\d\d?\1\d\d?|\d\d?([-/.])\d\d?\2\d{4}")
LOWER_CASE = {unit.lower(): unit for unit in (*UNITS, *NS_PER_UNIT)} | SPELLINGS
KNOWN_UNITS = {*UNITS, *NS_PER_UNIT}


def open_csv(path: Path, settings: ImportSettings) -> ForceFile:
    """Read the column `settings.topic` at the times in `settings.time_column`, or at a constant `settings.rate`.

    Fields are separated by comma, semicolon, tab, bar or white space; with all but commas, numbers may have a decimal
    comma. The header, which may be a comment, states units, as in "Force (N)", "Force / N" or "force_n", or a row below
    it does; times without a unit are in seconds, or in ISO 8601. Lines above the header are skipped. Without header,
    columns are numbered from 0. Rows without time or force are skipped. Raises BagError or SettingsError.
    """
    refuse_settings(settings, ("axis",), str(path), "a column has no axes")
    header, rows, delimiter = _read(path, has_header=settings.header, has_times=not settings.rate)
    times, nanoseconds = _times(header, settings.time_column, path)
    no_force = [*times, *nanoseconds.values()] or ([] if settings.rate else [0])
    units = [(name, _unit(name)) for n, name in enumerate(header) if n not in no_force]
    remedy = "" if any(unit in UNITS for _, unit in units) else "; joint states need --joints FILE"
    force = _column(header, settings.topic or select_force(path, units, remedy), "topic", path)
    time = None if settings.rate and not times else _time_column(header, times, force, path)
    if time is not None and force in {time, nanoseconds.get(time)}:
        raise SettingsError(f"{path}: topic = time_column = {header[force]}: must be two columns")
    origin = f"{path}: {header[force]}"
    unit = select_unit(settings.unit, _unit(header[force]), origin)
    if time is not None and time in nanoseconds:
        names = f"{header[time]}, {header[nanoseconds[time]]}"
        rows = with_nanoseconds(rows, time, nanoseconds[time], path, names)
        header[time] += " [ns]"
    first = next(rows, (0, []))
    if time is not None and not _unit(header[time]) and NS_SINCE_1970.fullmatch("".join(first[1][time : time + 1])):
        header[time] += " [ns]"
    # A long file has millions of rows; these arrays need 16 bytes for each.
    stamps_ns, values = array("q"), array("d")
    for stamp_ns, value in _samples(path, header, chain([first], rows), time, force, settings.rate, Numbers(delimiter)):
        stamps_ns.append(stamp_ns)
        values.append(value)
    times_ns = np.frombuffer(stamps_ns, np.int64)
    if time is not None and not np.any(times_ns % NS) and 2 * len(np.unique(times_ns)) < len(times_ns):
        rule = "must be finer; else state --rate HZ, or --time-column SECONDS,NANOSECONDS if these are two columns"
        raise BagError(f"{path}: {header[time]}: has whole seconds, which several rows share: {rule}")
    sample_rate, blocks = uniform_samples(origin, times_ns, np.frombuffer(values))
    if time is not None and not _unit(header[time]) and iso_ns("".join(first[1][time : time + 1])) is None:
        remedy = "head the column with Time (ms), or write days of MATLAB or a spreadsheet as 2025-12-31 10:11:12.345"
        check_seconds(sample_rate, len(values), f"{path}: {header[time]}", remedy)
    return ForceFile(f"{path.name}, {header[force]}", unit, sample_rate, blocks)


def _read(path: Path, *, has_header: bool, has_times: bool) -> tuple[list[str], Rows, str]:
    """Return the header, an iterator over the rows below it with their line numbers, and the delimiter."""
    lines = _lines(path)
    start, head, delimiters = _head(path, lines, has_header=has_header)
    is_bare = not (has_header or has_times) and len(delimiters) > 1
    if is_bare and all(map(DECIMAL_COMMA.fullmatch, filter(str.strip, head[:DELIMITER_ROWS]))):
        rule = "must have a header, or ; between columns"
        raise BagError(f"{path}: line {start + 1}: is one number with a decimal comma, or two columns: {rule}")
    above = {mark: _lines_above_header(head, mark) if has_header else 0 for mark in delimiters}

    def fit(mark: str) -> tuple[float, bool, int]:
        share, columns = _fit(head[above[mark] :][:DELIMITER_ROWS], mark, has_header=has_header)
        return share, mark != " ", columns

    delimiter = max(delimiters, key=fit)
    rows = _read_rows(path, delimiter, start + above[delimiter], chain(head[above[delimiter] :], lines))
    line, header = next(rows)
    if len(header) < 2 and has_times:
        rule = "must have times and force, separated by , ; | tab or spaces; without times, state --rate HZ"
        raise BagError(f"{path}: line {line}: has one column; {rule}")
    if not has_header:
        return [*map(str, range(len(header)))], chain([(line, header)], rows), delimiter
    if all(_is_number(name, delimiter) for name in header if name):
        rule = "must be a header with the names of the columns; without one, use --no-header"
        raise BagError(f"{path}: line {line}: has numbers; {rule}")
    below = next(rows, None)
    if below and _are_units(below[1], delimiter):
        origin = f"{path}: line {below[0]}"
        return [_with_unit(*pair, origin) for pair in zip_longest(header, below[1], fillvalue="")], rows, delimiter
    return header, chain([below] if below else [], rows), delimiter


def _head(path: Path, lines: Iterator[str], *, has_header: bool) -> tuple[int, list[str], str]:
    """Return how many lines precede the first row, this row with MAX_HEAD lines below it, and the possible delimiters.

    Comments are no rows, but the last one may be the header.
    """
    numbered = enumerate(lines)
    comment, delimiters = "", DELIMITERS
    for start, first in numbered:
        if first.startswith("#"):
            comment = first.lstrip("# ")
        elif match := SEPARATOR.fullmatch(first.rstrip("\r\n")):
            delimiters = match[1]
            if delimiters not in DELIMITERS.strip(" "):
                rule = "must be a comma, a semicolon, a tab or a bar"
                raise BagError(f"{path}: line {start + 1}: sep = {delimiters}: {rule}")
        elif first.strip():
            head = [first, *islice(lines, MAX_HEAD)]
            if has_header and any(_is_commented_header(comment, first, mark) for mark in delimiters):
                return start - 1, [comment, *head], delimiters
            return start, head, delimiters
        else:
            comment = ""
    raise BagError(f"{path}: is empty; must have a header row and rows of numbers")


def _lines_above_header(head: Sequence[str], delimiter: str) -> int:
    """Return the number of lines above the names of the columns, which precede the first rows of numbers.

    It is 0, so that the first line is the header, unless the names are as many as the numbers and state a time or unit,
    and no row above them could have samples.
    """
    rows = [_cells(line, delimiter) for line in head]
    texts = [(number, cells) for number, cells in enumerate(rows) if any(cells)]
    first = next((n for n, (_, cells) in enumerate(texts) if len(cells) > 1 and _are_numbers(cells, delimiter)), 0)
    data = [cells for _, cells in texts[first:][:NUMBER_ROWS]]
    if not first or not all(len(cells) == len(data[0]) and _are_numbers(cells, delimiter) for cells in data):
        return 0
    width = len(data[0])
    has_units = first > 1 and _are_units(texts[first - 1][1], delimiter)
    number, names = texts[first - 2 if has_units else first - 1]
    is_header = len(names) == width and (has_units or _is_named(names)) and not has_number(names, delimiter)
    has_samples = any(
        len(cells) == width and sum(_is_number(cell, delimiter) for cell in cells) > 1 for _, cells in texts[:first]
    )
    return number if is_header and not has_samples else 0


def _is_commented_header(comment: str, below: str, delimiter: str) -> bool:
    """Return whether the last comment names the columns of the numbers below it, as numpy.savetxt writes it."""
    names, cells = (_cells(line, delimiter) for line in (comment, below))
    return len(names) == len(cells) > 1 and _are_numbers(cells, delimiter) and _is_named(names)


def _is_named(names: Sequence[str]) -> bool:
    """Return whether one of the names states a time or a known unit."""
    return any(is_time_name(name) or _unit(name) in KNOWN_UNITS for name in names)


def has_number(cells: Sequence[str], delimiter: str) -> bool:
    """Return whether a cell is a number or a time."""
    return any(_is_number(cell, delimiter) for cell in cells)


def _are_numbers(cells: Sequence[str], delimiter: str) -> bool:
    return any(cells) and all(_is_number(cell, delimiter) for cell in cells if cell)


def _are_units(cells: Sequence[str], delimiter: str) -> bool:
    """Return whether a row has the units of the columns: no number, and a unit of force or time."""
    return not has_number(cells, delimiter) and any(spelled_unit(cell) in KNOWN_UNITS for cell in cells)


def spelled_unit(unit: str) -> str:
    """Return a unit without brackets, with the micro sign for the Greek mu, and short if it is spelled out."""
    unit = unit.strip("[]() ").replace("\u03bc", "\u00b5")
    return short_unit(unit)


def _with_unit(name: str, cell: str, origin: str) -> str:
    """Return the name of a column with the unit below it, unless one of the two is empty or it states the same."""
    stated, unit = _unit(name), spelled_unit(cell)
    if {stated, unit} <= KNOWN_UNITS and NS_PER_UNIT.get(stated, stated) != NS_PER_UNIT.get(unit, unit):
        raise BagError(f"{origin}: {name} = {cell}: must be {stated}, as the header states")
    return f"{name} [{unit}]" if name and unit and unit != stated else name or cell


def _fit(head: Sequence[str], delimiter: str, *, has_header: bool) -> tuple[float, int]:
    """Return how well a delimiter fits: the share of numbers in the first rows, and the number of columns.

    Numbers count in columns that have a name; white space fits only if most cells are numbers, and the row below the
    header has as many columns.
    """
    try:
        first, *rows = ([cell.strip() for cell in row] for row in _reader(head, delimiter) if row)
    except (csv.Error, ValueError):
        return -1.0, 0
    numbered = [pair for row in ([] if has_header else [first]) + rows for pair in enumerate(row) if pair[1]]
    named = {column for column, name in enumerate(first) if name}
    numbers = sum(column in named and _is_number(cell, delimiter) for column, cell in numbered)
    if delimiter == " " and rows and (len(rows[0]) != len(first) or 2 * numbers <= len(numbered)):
        return -1.0, 0
    return numbers / max(len(numbered), 1), len(first)


def _reader(lines: Iterable[str], delimiter: str) -> "Reader":
    """Return a reader of the cells; a space as delimiter stands for any white space."""
    if delimiter == " ":
        lines, delimiter = ("\t".join(SPACES.split(line.strip())) + "\n" for line in lines), "\t"
    return csv.reader(lines, delimiter=delimiter, skipinitialspace=True)


def _cells(line: str, delimiter: str) -> list[str]:
    """Return the cells of one line; none if it is not CSV."""
    try:
        return [cell.strip() for cell in next(_reader([line], delimiter), [])]
    except csv.Error:
        return []


def _latin_1(error: UnicodeError) -> tuple[str, int]:
    """Decode bytes that are not UTF-8 as Latin-1."""
    if not isinstance(error, UnicodeDecodeError):
        raise error
    return error.object[error.start : error.end].decode("latin-1"), error.end


AS_LATIN_1 = "scara_effmass.latin_1"
codecs.register_error(AS_LATIN_1, _latin_1)


def _lines(path: Path) -> Iterator[str]:
    check_regular_file(path, BagError)
    try:
        with path.open("rb") as content:
            is_utf_16 = content.read(2) in {codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE}
        encoding, errors = ("utf-16", "replace") if is_utf_16 else ("utf-8-sig", AS_LATIN_1)
        with path.open(encoding=encoding, errors=errors) as file:
            if "\0" in file.read(BINARY_CHECK):
                raise BagError(f"{path}: must be text in UTF-8, in Latin-1, or in UTF-16 with a byte order mark")
            file.seek(0)
            number = 0
            while line := file.readline(MAX_LINE):
                number += 1
                if len(line) == MAX_LINE:
                    raise BagError(f"{path}: line {number}: must have fewer than {MAX_LINE} characters")
                yield line
    except OSError as error:
        raise BagError(f"{path}: cannot be read: {error.strerror}") from None


def named_rows(path: Path, delimiter: str, names: set[str]) -> Rows:
    """Yield the rows of a file from its header on, which is the first line with all `names`, also as a comment.

    Without `names` or such a line, it is the first one that is no comment. Raises BagError.
    """
    lines = _lines(path)
    head = list(islice(lines, MAX_HEAD))
    is_row = [not (line.startswith("#") or SEPARATOR.fullmatch(line.strip())) for line in head]
    start = is_row.index(True) if True in is_row else len(head)
    texts = ((number, text) for number, line in enumerate(head) for text in (line.lstrip("# "), line))
    if names and (header := next((item for item in texts if names <= {*_cells(item[1], delimiter)}), None)):
        start, head[header[0]] = header
    return _read_rows(path, delimiter, start, chain(head[start:], lines))


def _read_rows(path: Path, delimiter: str, start: int, lines: Iterator[str]) -> Rows:
    """Yield line number and cells of each row, none of a blank one, in the `lines` of a file after number `start`.

    Raises BagError for more cells than the first row has.
    """
    reader = _reader(lines, delimiter)
    columns = 0
    try:
        for row in reader:
            cells = [cell.strip() for cell in row]
            columns = columns or len(cells)
            if any(cells[columns:]) or (delimiter == " " and any(cells) and len(cells) < columns):
                problem = f"has {len(cells)} fields, the first row {columns}: must be as many"
                remedy = "; a decimal comma needs another mark between the columns" if delimiter == "," else ""
                raise BagError(f"{path}: line {start + reader.line_num}: {problem}{remedy}")
            yield start + reader.line_num, cells
    except csv.Error as error:
        raise BagError(f"{path}: line {start + reader.line_num}: is not CSV: {error}") from None


def _column(header: Sequence[str], name: str, key: str, path: Path) -> int:
    """Return the number of the column with this name, or with this number from 0."""
    if header.count(name.strip()) == 1:
        return header.index(name.strip())
    if name.strip() not in header and name.isdecimal() and len(name) < MAX_DIGITS and int(name) < len(header):
        return int(name)
    problem = (
        "must be a name that only one column has, or its number from 0:" if name.strip() in header else "must be one of"
    )
    raise SettingsError(f"{path}: {key} = {name}: {problem} {', '.join(header)}")


def _times(header: Sequence[str], stated: str, path: Path) -> tuple[list[int], dict[int, int]]:
    """Return the columns of times, those `stated` or else all, and for columns of seconds those of their nanoseconds.

    The nanoseconds are the second one of two stated columns, or named as in "stamp.sec", "stamp.nanosec".
    """
    names = [name.lower() for name in header]
    nanoseconds = {
        names.index(matches[1] + word): column
        for column, name in enumerate(names)
        for word in SECONDS
        if (matches := NANOSECONDS.fullmatch(name)) and matches[1] + word in names
    }
    if not stated:
        is_time = [_unit(name) in NS_PER_UNIT or (is_time_name(name) and not _unit(name)) for name in header]
        times = {n for n, is_one in enumerate(is_time) if is_one} | nanoseconds.keys()
        return sorted(times - {*nanoseconds.values()}), nanoseconds
    parts = [stated] if stated.strip() in header else stated.split(",", 1)
    time, *others = (_column(header, part, "time_column", path) for part in parts)
    return [time], dict.fromkeys([time], others[0]) if others else nanoseconds


def with_nanoseconds(rows: Rows, time: int, nanoseconds: int, path: Path, names: str) -> Rows:
    """Yield the rows with nanoseconds in the column `time`, empty unless both columns `names` are filled.

    Raises BagError unless these have whole numbers.
    """
    for line, row in rows:
        seconds, rest = ("".join(row[column : column + 1]) for column in (time, nanoseconds))
        if seconds and rest:
            is_whole = seconds.removeprefix("-").isdecimal() and rest.isdecimal()
            if not is_whole or len(seconds) > MAX_DIGITS or len(rest) >= len(str(NS)):
                rule = f"must be whole seconds, and nanoseconds below {NS}"
                raise BagError(f"{path}: line {line}: {names} = {seconds}, {rest}: {rule}")
            row[time] = str(int(seconds) * NS + int(rest))
        elif seconds:
            row[time] = ""
        yield line, row


def is_time_name(name: str) -> bool:
    """Return whether a column or channel has a name of times."""
    return bool(TIME_WORDS & _words(name))


def _words(name: str) -> set[str]:
    return set(WORD.findall(name.lower()))


def _time_column(header: Sequence[str], times: list[int], force: int, path: Path) -> int:
    """Return which of the columns `times` has those of the column `force`. Raises SettingsError if several may.

    In a file of several blocks, it shares a word with the force ("A: Time", "A: Force"), or each block begins with it.
    """
    if len(times) == 1:
        return times[0]
    if not times:
        first = NUMBER.sub("", header[0])
        alike = [n for n, name in enumerate(header) if first and NUMBER.sub("", name) == first]
        if COUNTER.fullmatch(header[0]) or force in alike:
            rule = "no column has times; state --rate HZ or --time-column"
            raise SettingsError(f"{path}: {header[0]}: counts, or is a value like other columns: {rule}")
        return max((n for n in alike if n < force), default=0)
    shared = {n: len(_words(header[n]) & _words(header[force])) for n in times}
    best = [n for n in times if shared[n] == max(shared.values())]
    if len(best) == 1:
        return best[0]
    if times == [*range(len(times))] and not any(shared.values()):  # one block, with the time in several forms
        return 0
    is_alternating = times[0] == 0 and force not in times and all(b - a > 1 for a, b in pairwise(times))
    if is_alternating:
        return max(n for n in times if n < force)
    names = ", ".join(header[n] for n in times)
    raise SettingsError(f"{path}: time_column is empty: must be that of {header[force]}, one of {names}")


def _unit(name: str) -> str:
    """Return the unit at the end of a column name; empty if there is none."""
    name = REPEATED.sub("", name)
    if match := BRACKETED.fullmatch(name):
        return spelled_unit(match[1])
    match = SUFFIXED.fullmatch(name)
    if match and (unit := LOWER_CASE.get(match[1].lower())):
        return unit
    # "Time / ms", "Force in N": the last word, where the others say what it is.
    *words, last = WORD.findall(name) or [""]
    is_time, is_force = bool(TIME_WORDS & {*map(str.lower, words)}), is_force_name(" ".join(words))
    last = spelled_unit(last)
    is_unit = (is_time and last in {*NS_PER_UNIT, *LONG_UNITS}) or (is_force and last in UNITS)
    return last if is_unit else ""


def _samples(
    path: Path, header: Sequence[str], rows: Rows, time: int | None, force: int, rate: float, number: Numbers
) -> Iterator[tuple[int, float]]:
    """Yield the stamp [ns] and the value of each row that has both.

    The column `time` has the stamps; without it, the first row is at 0. At a `rate`, a row without a value is a lost
    sample, and times in whole seconds state the start alone.
    """
    unit = "s" if time is None else _unit(header[time]) or "s"
    if time is not None and unit not in NS_PER_UNIT:
        rule = f"must be one of {', '.join(NS_PER_UNIT)}; without times, state --rate HZ"
        raise BagError(f"{path}: {header[time]}: has the unit {unit}; {rule}")
    previous_ns, previous, start_ns = -MAX_SEC * NS - 1, "", None
    decimals, midnights = Decimals(), Midnights()
    for count, (line, row) in enumerate(rows):
        if not all(len(row) > column and row[column] for column in (time, force) if column is not None):
            continue
        origin = f"{path}: line {line}"
        try:
            value = number(row[force])
        except ValueError:
            raise BagError(f"{origin}: {header[force]} = {row[force]!r}: {DIGITS}") from None
        decimals.add(row[force], value)
        stamp_ns = elapsed_ns = round(count / rate * NS) if rate else 0
        if elapsed_ns > MAX_SEC * NS:
            raise BagError(f"{origin}: rate = {rate:g}: must be larger, the file lasts over {MAX_SEC} s")
        if time is not None:
            stamp_ns = midnights.continued(row[time], _stated_ns(row[time], header[time], unit, number, origin))
            if stamp_ns < previous_ns:
                raise BagError(
                    f"{origin}: {header[time]} = {row[time]}: must not be less than {previous}, the time before"
                )
            previous_ns, previous = stamp_ns, row[time]
        if time is not None and rate:
            start_ns = stamp_ns - elapsed_ns if start_ns is None else start_ns
            if stamp_ns % NS or abs(stamp_ns - elapsed_ns - start_ns) >= NS:
                rule = "must be empty, the file has times" if stamp_ns % NS else "must be the rate of the times"
                raise SettingsError(f"{origin}: rate = {rate:g}: {rule}: {header[time]} = {row[time]}")
            stamp_ns = start_ns + elapsed_ns
        yield stamp_ns, value
    decimals.check(f"{path}: {header[force]}")


def _stated_ns(text: str, name: str, unit: str, number: Numbers, origin: str) -> int:
    """Return the time [ns] in a cell of the column `name`. Raises BagError, which begins with `origin`."""
    try:
        return time_ns(text, NS_PER_UNIT[unit], number)
    except OverflowError:
        rule = f"must be within {MAX_SEC} s of 1970 or of the start"
        remedy = "" if _unit(name) else "; without a unit, it is in seconds: head it with Time (ms)"
        raise BagError(f"{origin}: {name} = {text}: {rule}{remedy}") from None
    except ValueError:
        rule = "must have the time in the same column, or --time-column must name that of the times"
        rule = f"is a date; {rule}" if DATE.fullmatch(text) else TIMES
        raise BagError(f"{origin}: {name} = {text!r}: {rule}") from None


def _is_number(text: str, delimiter: str) -> bool:
    try:
        time_ns(text, 1, Numbers(delimiter))
    except OverflowError:
        return True
    except ValueError:
        return text.lower().lstrip("+-") == "nan"
    return True
