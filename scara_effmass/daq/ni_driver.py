# SPDX-License-Identifier: Apache-2.0
"""Devices and errors of the driver NI-DAQmx. NI's Python client can be imported without the driver."""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, NamedTuple

from nidaqmx import constants, errors
from nidaqmx.system import System

import scara_effmass.errors
from scara_effmass.errors import DaqError, DeviceMissingError, DriverMissingError
from scara_effmass.input_files import read_table

SAMPLES_NOT_YET_AVAILABLE = -200284
"""A read has timed out; its buffer holds the samples that came until then."""
INVALID_VALUE = -200077
"""The device does not support the value of a property, which the message names."""


class _Meaning(NamedTuple):
    codes: Sequence[int]
    error: type[DaqError]
    advice: str


_MEANINGS = {
    name: _Meaning(values["codes"], getattr(scara_effmass.errors, values["error"]), values["advice"])
    for name, values in read_table(__file__, "ni_errors.yaml").items()
}
_LOST, UNKNOWN_CHANNEL = _MEANINGS["lost"], _MEANINGS["unknown_channel"].codes

_KEYS = {
    "SampClk_Rate": "ni9230.sample_rate",
    "SampPerChan": "ni9230.samples",
    "AI_Max": "sensor.range",
    "AI_Min": "sensor.range",
    "Coupling": "ni9230.coupling",
    "Excit": "ni9230.current",
    "Sensitivity": "sensor.sensitivity",
}
"""Parameter of this package for each property of the driver, by a part of the property's name."""

_DETAILS = ("Property:", "Requested Value:", "Possible Values:", "Maximum Value:", "Minimum Value:")


class Device(NamedTuple):
    """Device known to the driver: a chassis, a module in it, or a device without a chassis."""

    name: str
    product: str
    simulated: bool
    """Whether the driver simulates the device."""
    channels: tuple[str, ...]
    """Channels that support an IEPE force sensor."""
    problem: str
    """Why the device cannot be queried, for example because it is disconnected; empty if it can."""


def driver_version() -> str:
    """Return the version of the installed driver. Raises DriverMissingError."""
    with translated("NI-DAQmx"):
        return ".".join(str(part) for part in System.local().driver_version)


def devices() -> tuple[Device, ...]:
    """Return the devices known to the driver, connected or not. Raises DaqError."""
    with translated("NI-DAQmx"):
        return tuple(_query(device) for device in System.local().devices)


def _query(device: Any) -> Device:  # noqa: ANN401 - nidaqmx has no types
    try:
        force = constants.UsageTypeAI.FORCE_IEPE_SENSOR
        channels = tuple(channel.name for channel in device.ai_physical_chans if force in channel.ai_meas_types)
        return Device(device.name, device.product_type, device.is_simulated, channels, "")
    except errors.DaqError as error:
        problem = str(explain(error.error_code, str(error), device.name))
        return Device(device.name, "", simulated=False, channels=(), problem=problem)


def optional(item: Any, name: str) -> Any:  # noqa: ANN401 - nidaqmx has no types
    """Return a property of an object of NI's client; None if the device lacks it or it is no positive number."""
    with suppress(errors.Error):
        value = getattr(item, name)
        return None if isinstance(value, float) and not 0.0 < value < math.inf else value
    return None


@contextmanager
def translated(subject: str, *, was_connected: bool = False) -> Iterator[None]:
    """Raise errors of NI-DAQmx as a DaqError about `subject`."""
    try:
        yield
    except DaqError:
        raise
    except (errors.Error, OSError) as error:
        raise daq_error(error, subject, was_connected=was_connected) from error


def daq_error(error: Exception, subject: str, *, was_connected: bool = False, addition: str = "") -> DaqError:
    """Return the DaqError for an error of NI's client; see `explain`."""
    if isinstance(error, errors.DaqError):
        if error.error_code in UNKNOWN_CHANNEL:
            addition += _alternatives()
        return explain(error.error_code, str(error), subject, was_connected=was_connected, addition=addition)
    if isinstance(error, (errors.DaqNotFoundError, errors.DaqNotSupportedError)):
        cause = "is not installed" if isinstance(error, errors.DaqNotFoundError) else "does not exist for this system"
        return DriverMissingError(
            f"the driver NI-DAQmx {cause}; install it from ni.com/downloads, or set source to bag or sim"
        )
    return DriverMissingError(f"the driver NI-DAQmx cannot be used; reinstall it: {' '.join(str(error).split())}")


def _alternatives() -> str:
    try:
        channels = [channel for device in devices() for channel in device.channels]
    except DaqError:
        return ""
    return f"; channels for an IEPE force sensor: {', '.join(channels) or 'none'}"


def explain(code: int, message: str, subject: str, *, was_connected: bool = False, addition: str = "") -> DaqError:
    """Return the error for `code` in one line: subject, remedy, `addition`, and the driver's `message`.

    A device that does not answer, or whose name is unknown, is lost if it `was_connected` before, otherwise missing.
    """
    meaning = next((meaning for meaning in _MEANINGS.values() if code in meaning.codes), None)
    if meaning is None:
        meaning = _Meaning((), DaqError, "see this code at ni.com")
        if code == INVALID_VALUE:
            key = next((key for part, key in _KEYS.items() if part in message), "the property")
            meaning = _Meaning((), DeviceMissingError, f"the device does not support this setting; correct {key}")
    if was_connected and code in UNKNOWN_CHANNEL:
        meaning = _LOST
    elif not was_connected and meaning is _LOST:
        meaning = _Meaning((), DeviceMissingError, "the device does not answer; connect and power it")
    # Keep the first line of the message, and the lines with the property and its possible values.
    lines = [line.strip() for line in message.splitlines() if line.strip()]
    text = "; ".join([*lines[:1], *(line for line in lines[1:] if line.startswith(_DETAILS))]) or "no description"
    return meaning.error(f"{subject}: {meaning.advice}{addition} (NI-DAQmx {code}: {text})")
