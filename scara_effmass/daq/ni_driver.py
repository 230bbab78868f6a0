# SPDX-License-Identifier: Apache-2.0
"""Devices and errors of the driver NI-DAQmx.

Only this module imports NI's Python client, which can be imported without the driver.
"""

import math
from contextlib import contextmanager, suppress
from typing import Any, NamedTuple

from scara_effmass.errors import (
    DaqError,
    DeviceLostError,
    DeviceMissingError,
    DeviceReservedError,
    DriverMissingError,
    OverrunError,
)

try:
    from nidaqmx import Task, constants, errors
    from nidaqmx.stream_readers import AnalogMultiChannelReader
    from nidaqmx.system import System
except ImportError as error:
    raise DriverMissingError(
        f"the Python client of NI-DAQmx cannot be used: install it with pip install nidaqmx ({error})"
    ) from error
from collections.abc import Iterator

__all__ = [
    "SAMPLES_NOT_YET_AVAILABLE",
    "AnalogMultiChannelReader",
    "Device",
    "Task",
    "constants",
    "daq_error",
    "devices",
    "driver_version",
    "errors",
    "optional",
    "translated",
]

SAMPLES_NOT_YET_AVAILABLE = -200284
"""A read timed out; its buffer holds the samples so far."""
UNKNOWN_CHANNEL = (-200220, -200170)
"""No device or no channel has this name."""
INVALID_VALUE = -200077
"""The device does not support a value; the message names the property."""


class _Meaning(NamedTuple):
    error: type[DaqError]
    advice: str


_LOST = _Meaning(DeviceLostError, "the device was disconnected; check cable and power")
_MEANINGS = {
    # Not accessible, not responding or removed; network device not found or its connection lost
    (-201003, -200175, -200045, -201390, -201253, -201252, -201251, -201250): _LOST,
    # Task aborted or no longer valid, as after a reset; transfer aborted, often by the power of the USB port
    (-201452, -200088, -88710, -88709, -50405): _Meaning(
        DeviceLostError, "the device was reset or its connection failed; check cable and power"
    ),
    # Reserved by a task, with conflicting settings, or by another host
    (-50103, -200022, -201105, -201352, -201420, -201273): _Meaning(
        DeviceReservedError, "another program uses the device; end it or close its test panel"
    ),
    # Samples overwritten in the buffer of the host, of the device or of the transfer; stopped before that
    (-200279, -200010, -200361, -209829, -200222, -200613, -200283, -200019, -50410): _Meaning(
        OverrunError,
        "samples were overwritten before they were read; reduce the load of this computer or ni9230.sample_rate",
    ),
    UNKNOWN_CHANNEL: _Meaning(DeviceMissingError, "no such channel; correct the name or connect the device"),
    # No channel, syntax of a range, channel named twice, too many channels, devices that cannot be synchronized
    (-200099, -200086, -200489, -200371, -200620, -200072, -200071, -201426, -201425): _Meaning(
        DeviceMissingError, "these channels cannot be measured together; correct ni9230.channels"
    ),
    # Not an analog input, measurement not supported, no internal excitation
    (-200430, -200431, -200161): _Meaning(
        DeviceMissingError,
        "this module cannot supply an IEPE force sensor; use a channel of an NI 9230, 9232 or 9234",
    ),
    # Sample rate, conversion rate or sample clock out of range, also for the number of channels
    (-200332, -200331, -200335, -200081, -201093): _Meaning(
        DeviceMissingError, "the device does not support this sample rate; correct ni9230.sample_rate"
    ),
    # IEPE with DC coupling, AC coupling without IEPE
    (-201172, -201498): _Meaning(
        DeviceMissingError,
        "the device does not support this coupling of an IEPE sensor; correct ni9230.coupling or ni9230.current",
    ),
}

_KEYS = {
    "SampClk_Rate": "ni9230.sample_rate",
    "SampPerChan": "ni9230.samples",
    "AI_Max": "sensor.range",
    "AI_Min": "sensor.range",
    "Coupling": "ni9230.coupling",
    "Excit": "ni9230.current",
    "Sensitivity": "sensor.sensitivity",
}
"""Parameter for each property of the driver, by a part of the property's name."""

_DETAILS = ("Property:", "Requested Value:", "Possible Values:", "Maximum Value:", "Minimum Value:")


class Device(NamedTuple):
    """A device that the driver knows: a chassis, a module in it, or a device without a chassis."""

    name: str
    product: str
    simulated: bool
    """A simulated device of the driver."""
    channels: tuple[str, ...]
    """Channels that can measure with an IEPE force sensor."""
    problem: str
    """Why the device cannot be queried, for instance while it is disconnected; empty otherwise."""


def driver_version() -> str:
    """Return the version of the installed driver. Raises DriverMissingError."""
    with translated("NI-DAQmx"):
        return ".".join(str(part) for part in System.local().driver_version)


def devices() -> tuple[Device, ...]:
    """Return the devices that are connected, or were and are still known to the driver. Raises DaqError."""
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
    """Return a property of an object of NI's client; None where the device lacks it or it is no positive number."""
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

    A device that does not answer is lost if it `was_connected` before, else missing; likewise an unknown name.
    """
    meaning = next((meaning for codes, meaning in _MEANINGS.items() if code in codes), None)
    if meaning is None:
        meaning = _Meaning(DaqError, "see this code at ni.com")
        if code == INVALID_VALUE:
            key = next((key for part, key in _KEYS.items() if part in message), "the property")
            meaning = _Meaning(DeviceMissingError, f"the device does not support this setting; correct {key}")
    if was_connected and code in UNKNOWN_CHANNEL:
        meaning = _LOST
    elif not was_connected and meaning is _LOST:
        meaning = _Meaning(DeviceMissingError, "the device does not answer; connect and power it")
    # The first line of the message, and those that state the property and its possible values.
    lines = [line.strip() for line in message.splitlines() if line.strip()]
    text = "; ".join([*lines[:1], *(line for line in lines[1:] if line.startswith(_DETAILS))]) or "no description"
    return meaning.error(f"{subject}: {meaning.advice}{addition} (NI-DAQmx {code}: {text})")
