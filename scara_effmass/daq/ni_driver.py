"""The driver NI-DAQmx: its devices and its errors.

The only module that imports NI's Python client, which works without the driver until it is used.
"""

from __future__ import annotations

import math
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, NamedTuple

from scara_effmass.daq.ni_errors import UNKNOWN_CHANNEL, explain
from scara_effmass.errors import DaqError, DriverMissingError

try:
    from nidaqmx import Task, constants, errors
    from nidaqmx.stream_readers import AnalogMultiChannelReader
    from nidaqmx.system import System
except ImportError as error:
    raise DriverMissingError(
        f"the Python client of NI-DAQmx cannot be used: install it with pip install nidaqmx ({error})"
    ) from error

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = [
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
