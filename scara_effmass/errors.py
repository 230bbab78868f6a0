# SPDX-License-Identifier: Apache-2.0
"""Exceptions: one tree, whose leaves are also builtin exceptions.

A message is one line: `FILE: key = value: must be RULE`.
"""

_MAX_LENGTH = 2000
"""Longest message [characters]: a value from a file may be of any length."""


class EffmassError(Exception):
    """Base of all errors of this package; the command line prints one line and exits with 2."""

    def __str__(self) -> str:
        text = " ".join(super().__str__().splitlines())
        half = _MAX_LENGTH // 2
        return text if len(text) <= _MAX_LENGTH else f"{text[:half]} … {text[-half:]}"  # the rule is at the end


class SettingsError(EffmassError, ValueError):
    """Invalid parameter, option or settings file."""


class RobotError(EffmassError, ValueError):
    """Invalid robot description, or a model that the robot does not have."""


class CrossCheckError(EffmassError):
    """The assessment of many joint states at once differs from that of the monitor."""


class LimitError(EffmassError, ValueError):
    """Limit that the standard does not state, or setting that would loosen one."""


class BagError(EffmassError, ValueError):
    """Recording that cannot be read or written."""


class DecodeError(EffmassError, ValueError):
    """Message bytes that do not match their type."""


class OutputError(EffmassError, OSError):
    """File that cannot be written or already exists."""


class DaqError(EffmassError, OSError):
    """Failure of the force measurement; the message names the remedy."""


class DriverMissingError(DaqError):
    """The driver of the converter is not installed."""


class DeviceMissingError(DaqError):
    """No such device or channel, or unsupported by it."""


class DeviceReservedError(DaqError):
    """Another program has reserved the device."""


class DeviceLostError(DaqError):
    """The device was disconnected; it may come back."""


class OverrunError(DaqError):
    """Samples were overwritten before they were read; the acquisition must restart, with a gap."""
