"""NI-DAQmx, the driver: what it knows of its devices, and its errors in our words.

The only module that imports NI's client. That works without the driver; using it then raises DriverMissingError.
"""

from __future__ import annotations

import math
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, NamedTuple

from scara_effmass.daq.ni_errors import ABSENT, in_our_words
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
    "devices",
    "driver_version",
    "errors",
    "optional",
    "told",
    "translated",
]


class Device(NamedTuple):
    """A device that the driver knows: a chassis, a module in it, or one that stands alone."""

    name: str
    product: str
    simulated: bool
    """Made up by the driver for trying things out."""
    channels: tuple[str, ...]
    """Those that can measure force with an IEPE sensor."""
    trouble: str
    """Why it cannot be examined, as when it is not plugged in; else empty."""


def driver_version() -> str:
    """Return the version of the installed driver. Raises DriverMissingError."""
    with translated("NI-DAQmx"):
        return ".".join(str(part) for part in System.local().driver_version)


def devices() -> tuple[Device, ...]:
    """Return what is connected, or was and is remembered by the driver. Raises DaqError."""
    with translated("NI-DAQmx"):
        return tuple(_examined(device) for device in System.local().devices)


def _examined(device: Any) -> Device:  # noqa: ANN401 - nidaqmx has no types
    try:
        force = constants.UsageTypeAI.FORCE_IEPE_SENSOR
        channels = tuple(channel.name for channel in device.ai_physical_chans if force in channel.ai_meas_types)
        return Device(device.name, device.product_type, device.is_simulated, channels, "")
    except errors.DaqError as error:
        return Device(
            device.name,
            "",
            simulated=False,
            channels=(),
            trouble=str(in_our_words(error.error_code, str(error), device.name)),
        )


def optional(thing: Any, name: str) -> Any:  # noqa: ANN401 - nidaqmx has no types
    """Return property `name` of a thing of NI's client; None where driver or device has none, or no useful number."""
    with suppress(errors.Error):
        value = getattr(thing, name)
        return None if isinstance(value, float) and not 0.0 < value < math.inf else value
    return None


@contextmanager
def translated(subject: str, *, was_there: bool = False) -> Iterator[None]:
    """Raise what NI-DAQmx raises as a DaqError of ours."""
    try:
        yield
    except DaqError:
        raise
    except (errors.Error, OSError) as error:
        raise told(error, subject, was_there=was_there) from error


def told(error: Exception, subject: str, *, was_there: bool = False, addition: str = "") -> DaqError:
    """Return `error` of NI's client in our words, `addition` behind the advice; see `in_our_words`."""
    if isinstance(error, errors.DaqError):
        if error.error_code in ABSENT:
            addition += _alternatives()
        return in_our_words(error.error_code, str(error), subject, was_there=was_there, addition=addition)
    if isinstance(error, (errors.DaqNotFoundError, errors.DaqNotSupportedError)):
        cause = "is not installed" if isinstance(error, errors.DaqNotFoundError) else "does not exist for this system"
        return DriverMissingError(
            f"the driver NI-DAQmx {cause}: install it from ni.com/downloads, or set source to bag or sim"
        )
    return DriverMissingError(f"the driver NI-DAQmx cannot be used, install it again: {' '.join(str(error).split())}")


def _alternatives() -> str:
    try:
        known = [channel for device in devices() for channel in device.channels]
    except DaqError:
        return ""
    return f"; channels for an IEPE force sensor here: {', '.join(known) or 'none'}"
