# SPDX-License-Identifier: Apache-2.0
"""Force from a LabVIEW measurement file (.lvm), a text file."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import lvm_read
import numpy as np
from numpy.typing import NDArray

from scara_effmass.bags.bag import one_line
from scara_effmass.errors import BagError, SettingsError
from scara_effmass.importers.force_file import (
    ForceFile,
    check_seconds,
    refuse_settings,
    select_force,
    select_unit,
    short_unit,
    uniform_samples,
)
from scara_effmass.importers.times import axis_ns, time_ns
from scara_effmass.input_files import read_text
from scara_effmass.settings import ImportSettings
from scara_effmass.values import FloatArray
from scara_effmass.wire.cdr import MAX_SEC, NS

MAX_LVM_BYTES = 200_000_000
X, COMMENT = "X_Value", "Comment"


class _Channel(NamedTuple):
    """A channel of one segment: its column and that of its times, and start [ns], X0, Delta_X and units.

    `samples` are those that the header states; 0 if it states none. X0 and Delta_X are in `x_unit`.
    """

    name: str
    column: int
    x_column: int | None
    samples: int
    start_ns: int
    x0: float
    dx: float
    unit: str
    x_dimension: str
    x_unit: str


def open_lvm(path: Path, settings: ImportSettings) -> ForceFile:
    """Read the channel `settings.topic` of an .lvm file.

    Times are those of the X column, or X0 and Delta_X, after date and time of each segment, which are taken as UTC.
    Raises BagError or SettingsError.
    """
    refuse_settings(settings, ("axis", "header", "time_column"), str(path), "an .lvm file has none")
    text = read_text(path, BagError, MAX_LVM_BYTES)
    try:
        content: dict[Any, Any] = lvm_read.read_str(text)
        segments = [
            (list(_channels(content, content[number])), content[number]) for number in range(content["Segments"])
        ]
    except BagError:
        raise
    except Exception as error:  # noqa: BLE001 - lvm_read raises any error at a damaged file
        raise BagError(f"{path}: cannot be read as a LabVIEW measurement file: {one_line(error)}") from None
    name = _name(path, [channel for channels, _ in segments for channel in channels], settings.topic)
    times_ns, values, unit, stated, x_units = [], [], "", 0, set()
    for channels, segment in segments:
        for channel in channels:
            if channel.name == name:
                own_ns, samples = _samples(segment, channel, settings.rate, f"{path}: {name}")
                times_ns.append(own_ns)
                values.append(samples)
                unit = unit or channel.unit
                stated += channel.samples
                x_units.add(channel.x_unit)
    origin = f"{path}: {name}"
    stamps_ns, force = np.concatenate(times_ns), np.concatenate(values)
    if not len(force) or np.any(np.diff(stamps_ns) < 0):
        raise BagError(f"{origin}: must have times that advance, also from segment to segment")
    unit = select_unit(settings.unit, unit, origin)
    sample_rate, blocks = uniform_samples(origin, stamps_ns, force)
    if not settings.rate and "" in x_units:
        check_seconds(sample_rate, len(force), f"{origin}: the X axis", "as X_Unit_Label, or in a CSV file")
    lost = f"{path}: has {len(force)} of the {stated} samples that it states; the rest is lost"
    losses = (lost,) if len(force) < stated else ()
    return ForceFile(f"{path.name}, {name}", unit, sample_rate, blocks, losses=lambda: losses)


def _channels(header: dict[Any, Any], segment: dict[str, Any]) -> Iterator[_Channel]:
    """Yield the channels of a segment. Raises any error for a damaged one."""
    has_x = header.get("X_Columns", "One") != "No"
    x_column: int | None = None
    columns = sum(name not in {"", X, COMMENT} for name in segment["Channel names"])
    if columns < segment["Channels"]:
        problem = f"{columns} of its {segment['Channels']} channels are in columns"
        raise ValueError(f"{problem}: must be written with X_Columns One")
    for number, name in enumerate(segment["Channel names"]):
        if name == X and has_x:
            x_column = number
        elif name not in {"", COMMENT} and number < segment["data"].shape[1]:
            place = number if not has_x else number - 1  # of its entry in the lines of the header

            def entry(key: str, place: int = place, default: Any = "") -> Any:  # noqa: ANN401
                entries = segment.get(key, [])
                return entries[place] if isinstance(entries, list) and 0 <= place < len(entries) else default

            date, time = (entry(key) or header.get(key, "") for key in ("Date", "Time"))
            yield _Channel(
                name,
                number,
                x_column,
                int(entry("Samples", default=0)),
                _start_ns(date, time),
                float(entry("X0", default=0.0)),
                np.nan if x_column is not None else float(entry("Delta_X", default=np.nan)),
                short_unit(str(entry("Y_Unit_Label"))),
                str(entry("X_Dimension")),
                str(entry("X_Unit_Label")),
            )


def _start_ns(date: str, time: str) -> int:
    if not (date and time):
        return 0
    try:
        return time_ns(f"{date} {time}", NS)
    except ValueError:
        raise ValueError(f"Date = {date}, Time = {time}: must be as 2025/12/31 and 23:59:58.5") from None


def _samples(
    segment: dict[str, Any], channel: _Channel, rate: float, origin: str
) -> tuple[NDArray[np.int64], FloatArray]:
    """Return the stamps (n,) [ns] and values (n,) of a channel, at `rate` [Hz] unless it is 0. Raises BagError."""
    data = segment["data"]
    values = np.asarray(data[:, channel.column], np.float64)
    if rate and (channel.x_column is not None or channel.dx > 0.0):
        raise SettingsError(f"{origin}: rate = {rate:g}: must be empty, the file has times")
    if channel.x_dimension.lower() not in {"", "time"}:
        raise BagError(f"{origin}: X_Dimension = {channel.x_dimension}: must be Time")
    unit_s = axis_ns(channel.x_unit, f"{origin}: X_Unit_Label") / NS
    dx = 1.0 / (rate * unit_s) if rate else channel.dx
    x = channel.x0 + np.arange(len(values)) * (dx or np.nan) if channel.x_column is None else data[:, channel.x_column]
    seconds = x * unit_s
    kept = np.isfinite(seconds)
    if not kept.any() or np.abs(seconds[kept]).max() + abs(channel.start_ns) / NS > MAX_SEC:
        remedy = f"or there must be a column {X}; without times, state --rate HZ"
        raise BagError(f"{origin}: Delta_X = {dx:g}: must be the sampling period [s], {remedy}")
    return channel.start_ns + np.rint(seconds[kept] * NS).astype(np.int64), values[kept]


def _name(path: Path, channels: list[_Channel], topic: str) -> str:
    """Return the channel `topic`, or the only one that can be force."""
    units: dict[str, str] = {}
    for channel in channels:
        units[channel.name] = units.get(channel.name) or channel.unit
    name = topic or select_force(path, list(units.items()))
    if name not in units:
        raise SettingsError(f"{path}: topic = {topic}: must be one of {', '.join(units)}")
    return name
