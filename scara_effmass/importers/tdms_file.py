# SPDX-License-Identifier: Apache-2.0
"""Force from a TDMS file of LabVIEW or NI-DAQmx: a channel with waveform timing."""

import logging
from collections.abc import Callable, Iterator, Mapping
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from nptdms import TdmsFile
from nptdms.log import log_manager
from nptdms.reader import TdmsReader, _number_of_segment_values
from nptdms.timestamp import TdmsTimestamp

from scara_effmass.bags.bag import one_line
from scara_effmass.errors import BagError, SettingsError
from scara_effmass.importers.csv_file import is_time_name
from scara_effmass.importers.force_file import (
    ForceFile,
    IntArray,
    check_seconds,
    refuse_settings,
    select_force,
    select_unit,
    short_unit,
    split,
    uniform_samples,
)
from scara_effmass.importers.times import NS_PER_UNIT, axis_ns
from scara_effmass.input_files import check_regular_file
from scara_effmass.settings import ImportSettings
from scara_effmass.values import FloatArray, ForceBlock
from scara_effmass.wire.cdr import MAX_SEC, NS

MAX_SPAN_S = 1e9
MAX_PERIOD_CHANGE = 1e-6
"""Relative change of wf_increment that is rounding."""

# nptdms also logs the errors that it raises.
log_manager.set_level(logging.CRITICAL)


def open_tdms(path: Path, settings: ImportSettings) -> ForceFile:
    """Read the channel `settings.topic` ("group/channel") of a TDMS file.

    The properties wf_increment, wf_start_time and wf_start_offset give the times, unit_string gives the unit. Without
    wf_increment, times are those of a channel of the same group (`settings.time_column`), or `settings.rate` states the
    rate. A program that starts again and appends to its file changes the start time: the pause is a gap. Raises
    BagError or SettingsError.
    """
    refuse_settings(settings, ("axis", "header"), str(path), "a TDMS file has none")
    file = _guarded(path, lambda: TdmsFile.read(path))
    channels = {f"{group.name}/{channel.name}": channel for group in file.groups() for channel in group.channels()}
    name = _force_name(path, channels, settings.topic)
    channel = channels[name]
    origin = f"{path}: {name}"
    unit = select_unit(settings.unit, _unit(channel), origin)
    is_cut = file.file_status.incomplete_final_segment
    losses = (f"{path}: is cut off in its last segment; the rest is lost",) if is_cut else ()
    samples = np.asarray(_guarded(path, lambda: channel[:]), np.float64)
    increment = _seconds(channel.properties, "wf_increment", 0.0, origin)
    if settings.time_column:
        times = [
            key for key in (settings.time_column, f"{channel.group_name}/{settings.time_column}") if key in channels
        ]
    else:  # of the same group
        others = ((key, other) for key, other in channels.items() if key != name)
        times = [key for key, other in others if other.group_name == channel.group_name and _is_time(other)]
    if settings.rate and (increment or settings.time_column or times):
        raise SettingsError(f"{origin}: rate = {settings.rate:g}: must be empty, the file has times")
    if increment and not settings.time_column:
        sample_rate, blocks = _waveform(path, channel, increment, samples, origin)
        if not channel.properties.get("wf_xunit_string"):
            check_seconds(sample_rate, len(samples), f"{origin}: wf_increment", "as wf_xunit_string, or in a CSV file")
    elif settings.rate:
        if len(samples) > settings.rate * MAX_SEC:
            raise BagError(f"{origin}: rate = {settings.rate:g}: must be larger, the file lasts over {MAX_SEC} s")
        sample_rate, blocks = settings.rate, split(0, 0, samples, settings.rate)
    else:
        if not times and not settings.time_column:
            stated = channel.properties.get("wf_increment", "missing")
            remedy = "state --rate HZ, or the channel of the times with --time-column"
            raise BagError(f"{origin}: wf_increment = {stated}: must be the sampling period [s]; {remedy}")
        if len(times) != 1:
            setting = f"time_column = {settings.time_column}" if settings.time_column else "time_column is empty"
            raise SettingsError(f"{path}: {setting}: must be one of {', '.join(times or channels)}")
        times_ns = _times_ns(path, channels[times[0]], f"{path}: {times[0]}", len(channel))
        sample_rate, blocks = uniform_samples(origin, times_ns, samples[: len(times_ns)])
        if not _unit(channels[times[0]]) and np.issubdtype(channels[times[0]].dtype, np.number):
            remedy = "as unit_string, or in the header of a CSV file"
            check_seconds(sample_rate, len(times_ns), f"{path}: {times[0]}", remedy)
    return ForceFile(f"{path.name}, {name}", unit, sample_rate, blocks, losses=lambda: losses)


def _waveform(
    path: Path,
    channel: Any,  # noqa: ANN401 - nptdms has no types
    increment: float,
    samples: FloatArray,
    origin: str,
) -> tuple[float, Iterator[ForceBlock]]:
    """Return rate and blocks of a channel with waveform timing, a gap before each start but the first."""
    if not 0.0 < increment * len(channel) < MAX_SPAN_S:
        raise BagError(f"{origin}: wf_increment = {increment:g}: must be the sampling period [s]")
    starts = list(_starts(path, channel, increment, origin))
    lost = [0]  # before each start, since the first one
    for (begin, begin_ns), (first, start_ns) in pairwise(starts):
        gap_s = (start_ns - begin_ns) / NS - (first - begin) * increment
        lost.append(lost[-1] + round(gap_s / increment))
        if lost[-1] < lost[-2]:
            problem = f"sample {first}: wf_start_time is {-gap_s:.6f} s before the end of the samples before"
            raise BagError(f"{origin}: {problem}; must advance")
    pieces = zip(lost, pairwise([*starts, (len(samples), 0)]), strict=False)
    return 1.0 / increment, chain.from_iterable(
        split(first + before, start_ns, samples[first:stop], 1.0 / increment)
        for before, ((first, start_ns), (stop, _)) in pieces
    )


def _starts(
    path: Path,
    channel: Any,  # noqa: ANN401 - nptdms has no types
    increment: float,
    origin: str,
) -> Iterator[tuple[int, int]]:
    """Yield the number of the first sample, and its time [ns], after each change of the start time."""
    properties: dict[str, Any] = {}
    previous: int | None = None
    for first, changes in _segments(path, channel.path):
        properties |= changes
        period = _seconds(properties, "wf_increment", increment, origin)
        if abs(period - increment) > MAX_PERIOD_CHANGE * increment:
            raise BagError(f"{origin}: wf_increment changes from {period:g} to {increment:g} s: must be constant")
        start_ns = _start_ns(properties, increment * len(channel), origin)
        if start_ns != previous and first < len(channel):
            yield first, start_ns
        previous = start_ns


def _start_ns(properties: dict[str, Any], span_s: float, origin: str) -> int:
    offset = _seconds(properties, "wf_start_offset", 0.0, origin)
    if not abs(offset) < MAX_SPAN_S:
        raise BagError(f"{origin}: wf_start_offset = {offset:g}: must be less than {MAX_SPAN_S:g} s")
    start = properties.get("wf_start_time")
    start_us = int(start.astype("datetime64[us]").astype(np.int64)) if isinstance(start, np.datetime64) else 0
    start_ns = 1000 * start_us + round(offset * NS)
    if not -MAX_SEC * NS <= start_ns <= (MAX_SEC - span_s) * NS:
        raise BagError(f"{origin}: wf_start_time = {start}: must be within {MAX_SEC} s of 1970")
    return start_ns


class _SegmentReader(TdmsReader):  # type: ignore[misc]
    """Keeps the properties that each segment states; nptdms itself keeps the last ones only."""

    def __init__(self, path: Path) -> None:
        self.changes: list[dict[str, Any]] = []
        super().__init__(str(path))

    def _update_object_properties(self, segment_object_properties: Any) -> None:  # noqa: ANN401
        self.changes.append({path: _converted(values) for path, values in (segment_object_properties or {}).items()})
        super()._update_object_properties(segment_object_properties)


def _converted(values: Any) -> dict[str, Any]:  # noqa: ANN401 - nptdms has no types
    return {key: value.as_datetime64() if isinstance(value, TdmsTimestamp) else value for key, value in values}


def _segments(path: Path, channel: str) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yield for each segment the number of its first sample of a channel, and the properties that it states."""
    reader = _SegmentReader(path)
    try:
        reader.read_metadata(require_segment_indexes=True)
        counts = [_count(segment, channel) for segment in reader._segments]  # noqa: SLF001 - nptdms has no other access
    finally:
        reader.close()
    firsts = [0, *np.cumsum(counts).tolist()]
    yield from ((first, changes.get(channel, {})) for first, changes in zip(firsts, reader.changes, strict=False))


def _count(segment: Any, channel: str) -> int:  # noqa: ANN401 - nptdms has no types
    number = segment.object_index.get(channel)
    return 0 if number is None else int(_number_of_segment_values(segment.ordered_objects[number], segment))


def _times_ns(path: Path, channel: Any, origin: str, count: int) -> IntArray:  # noqa: ANN401 - nptdms has no types
    """Return the times (n,) [ns] in a channel, which must be `count` in ascending order. Raises BagError."""
    times = _guarded(path, lambda: channel[:])
    if np.issubdtype(channel.dtype, np.datetime64):
        times_ns = times.astype("datetime64[ns]").astype(np.int64)
    elif np.issubdtype(channel.dtype, np.number):
        seconds = np.asarray(times, np.float64) * (NS_PER_UNIT.get(_unit(channel) or "s", NS) / NS)
        if not np.all(np.abs(seconds) < MAX_SEC):
            raise BagError(f"{origin}: must be times within {MAX_SEC} s of 1970 or of the start")
        times_ns = np.rint(seconds * NS).astype(np.int64)
    else:
        raise BagError(f"{origin}: must be numbers or times")
    if len(times_ns) != count or np.any(np.diff(times_ns) < 0):
        raise BagError(f"{origin}: must be an ascending time for each of the {count} samples")
    return np.asarray(times_ns, np.int64)


def _is_time(channel: Any) -> bool:  # noqa: ANN401 - nptdms has no types
    if np.issubdtype(channel.dtype, np.datetime64):
        return True
    return np.issubdtype(channel.dtype, np.number) and (_unit(channel) in NS_PER_UNIT or is_time_name(channel.name))


def _guarded(path: Path, read: Callable[[], Any]) -> Any:  # noqa: ANN401 - nptdms has no types
    """Return what `read` returns. Raises BagError."""
    check_regular_file(path, BagError)
    try:
        return read()
    except Exception as error:  # noqa: BLE001 - nptdms raises any error at a damaged file
        raise BagError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or one_line(error)}") from None


def _force_name(path: Path, channels: dict[str, Any], topic: str) -> str:
    """Return the name of the channel `topic`; if empty, of the only one that can be force."""
    types = _guarded(path, lambda: {name: one.dtype for name, one in channels.items()})
    names = [name for name, one in channels.items() if len(one) and np.issubdtype(types[name], np.number)]
    if not names:
        raise BagError(f"{path}: has no channel with numbers")
    name = topic or select_force(path, [(key, _unit(channels[key])) for key in names if not _is_time(channels[key])])
    if name not in names:
        raise SettingsError(f"{path}: topic = {topic}: must be one of {', '.join(names)}")
    return name


def _unit(channel: Any) -> str:  # noqa: ANN401 - nptdms has no types
    return short_unit(str(channel.properties.get("unit_string", "")))


def _seconds(properties: Mapping[str, Any], name: str, default: float, origin: str) -> float:
    """Return a property of the time axis [s], `default` without it. Raises BagError."""
    if (value := properties.get(name)) is None:
        return default
    unit_s = axis_ns(str(properties.get("wf_xunit_string", "")), f"{origin}: wf_xunit_string") / NS
    try:
        return float(value) * unit_s
    except (TypeError, ValueError):
        raise BagError(f"{origin}: {name} = {value!r}: must be a number") from None
