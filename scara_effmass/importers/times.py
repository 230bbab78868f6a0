# SPDX-License-Identifier: Apache-2.0
"""Times and numbers as text: seconds, ISO 8601, dates with the day first, decimal point or comma."""

import math
import re
from datetime import datetime, timedelta, timezone

from scara_effmass.errors import BagError
from scara_effmass.importers.force_file import short_unit
from scara_effmass.wire.cdr import MAX_SEC, NS

NS_PER_UNIT = {"s": NS, "sec": NS, "ms": 1_000_000, "us": 1000, "µs": 1000, "ns": 1}
MAX_DIGITS = 20
"""Maximum number of digits of an integer time; longer ones are read as floats."""
MIN_WHOLE = 100.0
"""With thousands separators, 976 stands beside 1.558; with decimals, 9.5 and 97.6 would, too."""
_ISO = re.compile(
    r"(?:(\d{4})-?(\d\d)-?(\d\d)[T ]\s*)?(\d\d):?(\d\d):?(\d\d)(?:[.,](\d+)|:(\d{3}))?"
    r"\s*([ap]\.?m\.?)?\s*(Z|UTC|[+-]\d\d(?::?\d\d)?)?",
    re.IGNORECASE,
)

_TIME_OF_DAY = re.compile(r"\s*\d\d?:")
DAY_NS = 86_400 * NS
HALF_A_DAY_NS = DAY_NS // 2

_DAY_FIRST = re.compile(r"^(\d\d?)\.(\d\d?)\.(\d{4})(?=[T ])")
_MONTH_NAME = re.compile(r"^(\d\d?)-([A-Za-z]{3})-(\d{4})(?=[T ])")
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_SLASHES = re.compile(r"^(\d{4})/(\d\d?)/(\d\d?)(?=[T ])")
_ONE_DIGIT = re.compile(r"(?<!\d)(?=\d(?:-|[T ]|:\d\d:))")
"""Where a month, day or hour begins that has one digit."""


def iso_ns(text: str) -> int | None:
    """Return a time in ISO 8601 [ns since 1970], without a zone in UTC, without a date after midnight; else None.

    The date may also be as in 31.12.2025, 2025/12/31 or 31-Dec-2025, a month, day or hour may have one digit, the time
    of day AM or PM behind it, and three digits of milliseconds a colon before them. Raises ValueError for no such time.
    """
    text = text.strip()
    if ":" in text:
        text = _MONTH_NAME.sub(lambda date: f"{date[3]}-{_MONTHS.index(date[2].lower()) + 1:02}-{date[1]}", text)
        text = _ONE_DIGIT.sub("0", _SLASHES.sub(r"\1-\2-\3", _DAY_FIRST.sub(r"\3-\2-\1", text)))
    match = _ISO.fullmatch(text)
    if match is None or (match[1] is None and ":" not in text):
        return None
    *date, hour, minute, second, fraction, milliseconds, half, zone = match.groups()
    if half:
        datetime.strptime(hour, "%I")  # noqa: DTZ007 - raises ValueError for hours that no clock of 12 hours has
        hour = int(hour) % 12 + 12 * (half[0] in "Pp")
    year, month, day = (int(part) for part in date) if date[0] else (1970, 1, 1)
    offset = timedelta()
    if zone and zone[0] in "+-":
        hours, minutes = int(zone[1:3]), int(zone[3:].lstrip(":") or 0)
        offset = timedelta(hours=hours, minutes=minutes) * (-1 if zone[0] == "-" else 1)
    moment = datetime(year, month, day, int(hour), int(minute), 0, tzinfo=timezone.utc) - offset
    whole = (moment - datetime(1970, 1, 1, tzinfo=timezone.utc)) // timedelta(seconds=1) + int(second)
    return whole * NS + int((fraction or milliseconds or "0")[:9].ljust(9, "0"))


def axis_ns(unit: str, origin: str) -> int:
    """Return the nanoseconds in the `unit` of a time axis, empty for seconds. Raises BagError for another unit."""
    unit = short_unit(unit) or "s"
    if unit not in NS_PER_UNIT:
        raise BagError(f"{origin} = {unit}: must be one of {', '.join(NS_PER_UNIT)}")
    return NS_PER_UNIT[unit]


class Numbers:
    """Reads the numbers of one file, with a decimal point or, where no comma separates the columns, a decimal comma."""

    def __init__(self, delimiter: str) -> None:
        self._marks = "." if delimiter == "," else ".,"

    def __call__(self, text: str) -> float:
        """Return the number. Raises ValueError, also for the other decimal mark than the numbers before."""
        found = {mark for mark in ".," if mark in text}
        if not found <= set(self._marks) or len(found) > 1 or "_" in text:  # Python reads 1_0 as 10
            raise ValueError(text)
        if found:
            (self._marks,) = found
        return float(text.replace(",", "."))


class Decimals:
    """Tells thousands separators from decimal marks in the numbers of one column."""

    def __init__(self) -> None:
        self._lengths: set[int] = set()
        self._largest_whole = 0.0

    def add(self, text: str, value: float) -> None:
        """Add the `text` of a number with this `value`."""
        _, mark, digits = text.replace(",", ".").partition(".")
        if mark:
            self._lengths.add(len(digits))
        elif math.isfinite(value):
            self._largest_whole = max(self._largest_whole, abs(value))

    def check(self, origin: str) -> None:
        """Raise BagError, which begins with `origin`, if the marks look like thousands separators."""
        if self._lengths == {3} and self._largest_whole >= MIN_WHOLE:
            rule = "must have no thousands separator, or decimals in every number"
            raise BagError(f"{origin}: 3 digits behind every mark, none in {self._largest_whole:g}: {rule}")


class Midnights:
    """Continues times of day without a date after midnight."""

    def __init__(self) -> None:
        self._previous_ns = self._midnight_ns = 0

    def continued(self, text: str, stamp_ns: int) -> int:
        """Return the time `stamp_ns` that `text` states, on the next day if the last one is over half a day later."""
        if _TIME_OF_DAY.match(text):
            stamp_ns += self._midnight_ns
            if self._previous_ns - stamp_ns > HALF_A_DAY_NS:
                self._midnight_ns += DAY_NS
                stamp_ns += DAY_NS
        self._previous_ns = stamp_ns
        return stamp_ns


def time_ns(text: str, ns_per_unit: int, number: Numbers | None = None) -> int:
    """Return a time [ns]: a number in units of `ns_per_unit`, or ISO 8601. Raises ValueError or OverflowError.

    MATLAB writes durations with their unit, as in 0.5 sec.
    """
    if text.endswith(" sec"):
        text, ns_per_unit = text.removesuffix(" sec"), NS
    # A float has too few digits for nanoseconds since 1970.
    if text.removeprefix("-").isdecimal() and len(text) <= MAX_DIGITS:
        stamp_ns = int(text) * ns_per_unit
    else:
        iso = iso_ns(text)
        stamp_ns = round((number or float)(text) * ns_per_unit) if iso is None else iso
    if abs(stamp_ns) > MAX_SEC * NS:
        raise OverflowError(text)
    return stamp_ns
