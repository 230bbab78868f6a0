"""Force from a TDMS file, as LabVIEW and NI-DAQmx log it: a channel with waveform timing."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from nptdms import TdmsFile
from nptdms.log import log_manager

from scara_effmass.daq.force_file import NS, UNITS, ForceFile, RecordedBlock, declared_unit
from scara_effmass.errors import BagError, SettingsError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from scara_effmass.settings import BagSettings
    from scara_effmass.values import FloatArray

LONGEST_S = 1e9
"""Thirty years."""

log_manager.set_level(logging.CRITICAL)
"""What is wrong with a file is said once, by the error it ends in."""

SPELLINGS = {"newton": "N", "newtons": "N", "kilonewton": "kN", "kilonewtons": "kN", "volt": "V", "volts": "V"}
"""How units are also written, in lower case."""


def open_tdms_force(settings: BagSettings, block_time: float) -> ForceFile:
    """Read the channel `settings.topic` ("group/channel") of a TDMS file, cut to `block_time` [s].

    Its properties wf_increment, wf_start_time and wf_start_offset give the times, unit_string the unit. Raises
    BagError or SettingsError.
    """
    path = Path(settings.path)
    file = _read(path)
    channel, name = _channel(path, file, settings.topic)
    origin = f"{path}: {name}"
    increment = _property(channel, "wf_increment", origin)
    if not 0.0 < increment * len(channel) < LONGEST_S:
        found = f"wf_increment = {channel.properties.get('wf_increment', 'missing')}"
        raise BagError(f"{origin}: {found}; the time from sample to sample [s] would be right")
    offset = _property(channel, "wf_start_offset", origin)
    start = channel.properties.get("wf_start_time")
    start_ns = int(start.astype("datetime64[ns]").astype(np.int64)) if isinstance(start, np.datetime64) else 0
    if not abs(offset) < LONGEST_S:
        raise BagError(f"{origin}: wf_start_offset = {offset:g}; some seconds would be right")
    start_ns += round(offset * NS)
    written = str(channel.properties.get("unit_string", ""))
    unit, scale = declared_unit(settings.unit, SPELLINGS.get(written.lower(), written), origin)
    cut_off = file.file_status.incomplete_final_segment
    losses = (f"{path}: is cut off in its last segment; what came there is lost",) if cut_off else ()
    with np.errstate(over="ignore"):  # infinite, then, which is no force
        samples = np.asarray(channel[:], np.float64) * scale
    return ForceFile(
        description=f"{path.name}, {name}",
        channel=name,
        unit=unit,
        sample_rate=1.0 / increment,
        start_ns=start_ns,
        end_ns=start_ns + round(len(samples) * increment * NS),
        blocks=_blocks(samples, start_ns, increment, max(1, round(block_time / increment))),
        losses=lambda: losses,
    )


def _blocks(samples: FloatArray, start_ns: int, increment: float, size: int) -> Iterator[RecordedBlock]:
    for first in range(0, len(samples), size):
        stamp_ns = start_ns + round(first * increment * NS)
        yield RecordedBlock(stamp_ns, samples[first : first + size], 0, 0.0)


def _read(path: Path) -> Any:  # noqa: ANN401 - of a library without types
    try:
        return TdmsFile.read(path)
    except OSError as error:
        raise BagError(f"{path}: cannot be read: {error.strerror or error}") from None
    except Exception as error:  # noqa: BLE001 - a damaged file shows itself in every error the library knows
        raise BagError(f"{path}: cannot be read: {' '.join(str(error).split()) or type(error).__name__}") from None


def _channel(path: Path, file: Any, asked: str) -> tuple[Any, str]:  # noqa: ANN401 - of a library without types
    """Return the channel that is asked for, or the only one that can be force, and its name."""
    channels = {
        f"{group.name}/{channel.name}": channel
        for group in file.groups()
        for channel in group.channels()
        if len(channel) and np.issubdtype(channel.dtype, np.number)
    }
    if not channels:
        raise BagError(f"{path}: holds no channel with numbers")
    candidates = [asked] if asked else [name for name, each in channels.items() if _is_force(each)] or list(channels)
    if len(candidates) == 1 and candidates[0] in channels:
        return channels[candidates[0]], candidates[0]
    said = f"bag.topic = {asked}: there is no such channel with numbers" if asked else "bag.topic is empty"
    raise SettingsError(f"{path}: {said}; one of {', '.join(channels)} would be right")


def _is_force(channel: Any) -> bool:  # noqa: ANN401 - of a library without types
    written = str(channel.properties.get("unit_string", ""))
    return SPELLINGS.get(written.lower(), written) in UNITS


def _property(channel: Any, name: str, origin: str) -> float:  # noqa: ANN401 - of a library without types
    value = channel.properties.get(name, 0.0)
    try:
        return float(value)
    except (TypeError, ValueError):
        raise BagError(f"{origin}: {name} = {value!r}; a number would be right") from None
