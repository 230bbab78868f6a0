"""The exceptions of the suite: one tree, whose leaves also are the builtin a caller would expect.

Each message is one line that names the file, the key and the value, and says what would be right.
"""

from __future__ import annotations


class EffmassError(Exception):
    """Anything this suite refuses to do; the command line prints it in one line and exits with 2."""


class SettingsError(EffmassError, ValueError):
    """A parameter, option or settings file that cannot be used."""


class RobotError(EffmassError, ValueError):
    """A robot description that cannot be used, or a question the model of it cannot answer."""


class LimitError(EffmassError, ValueError):
    """A contact limit that the standard does not give, or a setting that would loosen one."""


class BagError(EffmassError, ValueError):
    """A recording that cannot be read or written."""


class DecodeError(EffmassError, ValueError):
    """Message bytes that are not what their type says."""


class OutputError(EffmassError, OSError):
    """A file that cannot be written, or that exists already."""


class DaqError(EffmassError, OSError):
    """Force cannot be measured; each leaf says what to do about it."""


class DriverMissingError(DaqError):
    """The driver of the converter is not installed."""


class DeviceMissingError(DaqError):
    """No such device or channel, or one that cannot do what is asked."""


class DeviceReservedError(DaqError):
    """Another program holds the device."""


class DeviceLostError(DaqError):
    """The device was there and has gone; it may come back."""


class OverrunError(DaqError):
    """Samples were overwritten before they were read: the acquisition has to begin again, with a gap."""
