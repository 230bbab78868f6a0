"""Error codes of NI-DAQmx: the exception for each, and its remedy."""

from __future__ import annotations

from typing import NamedTuple

from scara_effmass.errors import (
    DaqError,
    DeviceLostError,
    DeviceMissingError,
    DeviceReservedError,
    OverrunError,
)

SAMPLES_NOT_YET_AVAILABLE = -200284
"""A read timed out; its buffer holds the samples so far."""
UNKNOWN_CHANNEL = frozenset({-200220, -200170})
"""No device or no channel has this name."""
_INVALID_VALUE = -200077
"""The device does not support a value; the message names the property."""


class _Meaning(NamedTuple):
    error: type[DaqError]
    advice: str


_LOST = _Meaning(DeviceLostError, "the device was disconnected; check cable and power")
_INTERRUPTED = _Meaning(DeviceLostError, "the device was reset or its connection failed; check cable and power")
_RESERVED = _Meaning(DeviceReservedError, "another program uses the device; end it or close its test panel")
_OVERRUN = _Meaning(
    OverrunError,
    "samples were overwritten before they were read; reduce the load of this computer or ni9230.sample_rate",
)
_NO_CHANNEL = _Meaning(DeviceMissingError, "no such channel; correct the name or connect the device")
_MISNAMED = _Meaning(DeviceMissingError, "these channels cannot be measured together; correct ni9230.channels")
_NO_IEPE = _Meaning(
    DeviceMissingError,
    "this module cannot supply an IEPE force sensor; use a channel of an NI 9230, 9232 or 9234",
)
_RATE = _Meaning(DeviceMissingError, "the device does not support this sample rate; correct ni9230.sample_rate")
_COUPLING = _Meaning(
    DeviceMissingError,
    "the device does not support this coupling of an IEPE sensor; correct ni9230.coupling or ni9230.current",
)

_MEANINGS: dict[int, _Meaning] = {
    **dict.fromkeys(
        (
            -201003,  # device cannot be accessed
            -201390,  # network: connection lost
            -201253,  # network: down
            -201252,  # network: target unreachable
            -201251,  # network: target not found
            -201250,  # network: timed out
            -200175,  # hardware not responding
            -200045,  # device removed
        ),
        _LOST,
    ),
    **dict.fromkeys(
        (
            -201452,  # operation aborted
            -200088,  # task is no longer valid, as after a reset
            -88710,  # aborting
            -88709,  # aborted
            -50405,  # transfer aborted, often by the power supply of the USB port
        ),
        _INTERRUPTED,
    ),
    **dict.fromkeys(
        (
            -50103,  # resource reserved
            -200022,  # resource already reserved
            -201105,  # reserved with conflicting settings
            -201352,  # reservation conflict
            -201420,  # network device reserved by another host
            -201273,  # network device in use
        ),
        _RESERVED,
    ),
    **dict.fromkeys(
        (
            -200279,  # samples no longer available: overwritten
            -200010,  # FIFO overflow on the device
            -200361,  # the same, other devices
            -209829,  # the same, other devices
            -200222,  # stopped before the buffer would be overwritten
            -200613,  # the same
            -200283,  # the same, of an intermediate buffer
            -200019,  # converter overrun
            -50410,  # transfer overwritten
        ),
        _OVERRUN,
    ),
    **dict.fromkeys(UNKNOWN_CHANNEL, _NO_CHANNEL),
    **dict.fromkeys(
        (
            -200099,  # no channel stated
            -200086,  # syntax of a range
            -200489,  # channel is in the task already
            -200371,  # channel stated twice
            -200620,  # the same
            -200072,  # the same
            -200071,  # too many channels
            -201426,  # devices that cannot be synchronized
            -201425,  # the same
        ),
        _MISNAMED,
    ),
    **dict.fromkeys(
        (
            -200430,  # not an analog input
            -200431,  # measurement not supported by the channel
            -200161,  # no internal excitation
        ),
        _NO_IEPE,
    ),
    **dict.fromkeys(
        (
            -200332,  # sample rate too high
            -200331,  # sample rate too low
            -200335,  # conversion rate too high
            -200081,  # rate too high for so many channels
            -201093,  # sample clock rate invalid
        ),
        _RATE,
    ),
    -201172: _COUPLING,  # IEPE with DC coupling
    -201498: _COUPLING,  # AC coupling without IEPE
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


def explain(code: int, message: str, subject: str, *, was_connected: bool = False, addition: str = "") -> DaqError:
    """Return the error for `code` in one line: subject, remedy, `addition`, and the driver's `message`.

    A device that does not answer is lost if it `was_connected` before, else missing; likewise an unknown name.
    """
    meaning = _MEANINGS.get(code)
    if meaning is None:
        meaning = _invalid_value(message) if code == _INVALID_VALUE else _Meaning(DaqError, "see this code at ni.com")
    if was_connected and code in UNKNOWN_CHANNEL:
        meaning = _LOST
    elif not was_connected and meaning is _LOST:
        meaning = _Meaning(DeviceMissingError, "the device does not answer; connect and power it")
    return meaning.error(f"{subject}: {meaning.advice}{addition} (NI-DAQmx {code}: {_one_line(message)})")


def _invalid_value(message: str) -> _Meaning:
    keys = [key for part, key in _KEYS.items() if part in message]
    return _Meaning(
        DeviceMissingError, f"the device does not support this setting; correct {keys[0] if keys else 'the property'}"
    )


def _one_line(message: str) -> str:
    """Return the first line of `message`, and the lines that state the property and its possible values."""
    lines = [line.strip() for line in message.splitlines() if line.strip()]
    return "; ".join([*lines[:1], *(line for line in lines[1:] if line.startswith(_DETAILS))]) or "no description"
