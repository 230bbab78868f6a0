# SPDX-License-Identifier: Apache-2.0
"""Force from a TDMS file of LabVIEW or NI-DAQmx: a channel with waveform timing."""

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from nptdms import TdmsFile
from nptdms.log import log_manager

from scara_effmass.errors import BagError, SettingsError
from scara_effmass.importers.force_file import BLOCK_TIME_S, UNITS, ForceFile, SampleBlock, select_unit
from scara_effmass.settings import ImportSettings
from scara_effmass.values import FloatArray
from scara_effmass.wire.cdr import MAX_SEC, NS

MAX_SPAN_S = 1e9

# nptdms also logs the errors that it raises.
log_manager.set_level(logging.CRITICAL)

SPELLINGS = {"newton": "N", "newtons": "N", "kilonewton": "kN", "kilonewtons": "kN", "volt": "V", "volts": "V"}
"""Units spelled out, in lower case."""


def open_tdms(path: Path, settings: ImportSettings) -> ForceFile:
    """Read the channel `settings.topic` ("group/channel") of a TDMS file.

    The properties wf_increment, wf_start_time and wf_start_offset give the times, unit_string gives the unit. Raises
    BagError or SettingsError.
    """
    file = _read(path)
    channel, name = _channel(path, file, settings.topic)
    origin = f"{path}: {name}"
    increment = _property(channel, "wf_increment", origin)
    if not 0.0 < increment * len(channel) < MAX_SPAN_S:
        stated = channel.properties.get("wf_increment", "missing")
        raise BagError(f"{origin}: wf_increment = {stated}: must be the sampling period [s]")
    offset = _property(channel, "wf_start_offset", origin)
    if not abs(offset) < MAX_SPAN_S:
        raise BagError(f"{origin}: wf_start_offset = {offset:g}: must be less than {MAX_SPAN_S:g} s")
    start = channel.properties.get("wf_start_time")
    start_us = int(start.astype("datetime64[us]").astype(np.int64)) if isinstance(start, np.datetime64) else 0
    start_ns = 1000 * start_us + round(offset * NS)
    if not -MAX_SEC * NS <= start_ns <= (MAX_SEC - increment * len(channel)) * NS:
        raise BagError(f"{origin}: wf_start_time = {start}: must be within {MAX_SEC} s of 1970")
    unit = select_unit(settings.unit, _unit(channel), origin)
    is_cut = file.file_status.incomplete_final_segment
    losses = (f"{path}: is cut off in its last segment; the rest is lost",) if is_cut else ()
    return ForceFile(
        description=f"{path.name}, {name}",
        unit=unit,
        sample_rate=1.0 / increment,
        blocks=_blocks(np.asarray(channel[:], np.float64), start_ns, increment),
        losses=lambda: losses,
    )


def _blocks(samples: FloatArray, start_ns: int, increment: float) -> Iterator[SampleBlock]:
    size = max(1, round(BLOCK_TIME_S / increment))
    for first in range(0, len(samples), size):
        stamp_ns = start_ns + round(first * increment * NS)
        yield SampleBlock(stamp_ns, samples[first : first + size], lost_samples=0, clock_residual=0.0)


def _read(path: Path) -> Any:  # noqa: ANN401 - nptdms has no types
    try:
        return TdmsFile.read(path)
    except OSError as error:
        raise BagError(f"{path}: cannot be read: {error.strerror or error}") from None
    except Exception as error:  # noqa: BLE001 - nptdms raises any error at a damaged file
        raise BagError(f"{path}: cannot be read: {' '.join(str(error).split()) or type(error).__name__}") from None


def _channel(path: Path, file: Any, topic: str) -> tuple[Any, str]:  # noqa: ANN401 - nptdms has no types
    """Return the channel `topic` (empty: the only one that can be force) and its name."""
    channels = {
        f"{group.name}/{channel.name}": channel
        for group in file.groups()
        for channel in group.channels()
        if len(channel) and np.issubdtype(channel.dtype, np.number)
    }
    if not channels:
        raise BagError(f"{path}: has no channel with numbers")
    forces = [name for name, channel in channels.items() if _unit(channel) in UNITS]
    candidates = [topic] if topic else forces or list(channels)
    if len(candidates) == 1 and candidates[0] in channels:
        return channels[candidates[0]], candidates[0]
    setting = f"topic = {topic}" if topic else "topic is empty"
    raise SettingsError(f"{path}: {setting}: must be one of {', '.join(channels)}")


def _unit(channel: Any) -> str:  # noqa: ANN401 - nptdms has no types
    stated = str(channel.properties.get("unit_string", ""))
    return SPELLINGS.get(stated.lower(), stated)


def _property(channel: Any, name: str, origin: str) -> float:  # noqa: ANN401 - nptdms has no types
    value = channel.properties.get(name, 0.0)
    try:
        return float(value)
    except (TypeError, ValueError):
        raise BagError(f"{origin}: {name} = {value!r}: must be a number") from None
