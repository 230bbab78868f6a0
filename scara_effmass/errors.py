# SPDX-License-Identifier: Apache-2.0
"""Exceptions of this package. Most of them also derive from a built-in exception.

A message is one line: `FILE: key = value: must be RULE`.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_MAX_LENGTH = 2000
"""Longer messages are shortened [characters]: they may quote a value from a file, which can have any length."""


class EffmassError(Exception):
    """Base of all errors of this package; the command line prints one line and exits with 2."""

    def __str__(self) -> str:
        text = " ".join(super().__str__().splitlines())
        half = _MAX_LENGTH // 2
        return text if len(text) <= _MAX_LENGTH else f"{text[:half]} … {text[-half:]}"  # the end states the rule


class SettingsError(EffmassError, ValueError):
    """Invalid parameter, option or settings file."""


class RobotError(EffmassError, ValueError):
    """Invalid robot description, or a mass model that the robot does not have."""


class CrossCheckError(EffmassError):
    """The bulk assessment of joint states differs from that of the monitor."""


class LimitError(EffmassError, ValueError):
    """Limit that the standard does not give, or a setting that would loosen a limit."""


class BagError(EffmassError, ValueError):
    """Recording that cannot be read or written."""


class DecodeError(EffmassError, ValueError):
    """Message bytes that do not match their type."""


class KernelError(EffmassError, RuntimeError):
    """Compiled kernel that cannot be had."""


class OutputError(EffmassError, OSError):
    """Output file that cannot be written or already exists."""


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Raise an OSError in the `with` block as the OutputError that `path` cannot be written."""
    try:
        yield
    except EffmassError:
        raise
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from None


class DaqError(EffmassError, OSError):
    """Failure of the force measurement; the message names the remedy."""


class DriverMissingError(DaqError):
    """The driver of the converter is not installed."""


class DeviceMissingError(DaqError):
    """No such device or channel, or the device does not support a setting."""


class DeviceReservedError(DaqError):
    """Another program uses the device."""


class DeviceLostError(DaqError):
    """The device was disconnected; it may come back."""


class OverrunError(DaqError):
    """Samples were overwritten before they were read; the acquisition must restart, with a gap."""
