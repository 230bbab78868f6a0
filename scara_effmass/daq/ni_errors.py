"""What the error codes of NI-DAQmx mean for a measurement of force, and what to do about each."""

from __future__ import annotations

from typing import NamedTuple

from scara_effmass.errors import (
    DaqError,
    DeviceLostError,
    DeviceMissingError,
    DeviceReservedError,
    OverrunError,
)

NOT_YET_AVAILABLE = -200284
"""A read timed out; what was there by then is in its buffer."""
ABSENT = frozenset({-200220, -200170})
"""There is no device, or no channel, of that name."""
_REFUSED_VALUE = -200077
"""A value that the device does not have; the message names the property."""


class _Meaning(NamedTuple):
    error: type[DaqError]
    advice: str


_LOST = _Meaning(DeviceLostError, "the device has gone: is it plugged in, and has it power?")
_INTERRUPTED = _Meaning(DeviceLostError, "the device was reset, or its connection failed: check cable and power")
_RESERVED = _Meaning(DeviceReservedError, "another program holds the device: end that, or close its test panel")
_OVERRUN = _Meaning(
    OverrunError,
    "samples were lost because they were not fetched in time: relieve this computer, or lower ni9230.sample_rate",
)
_ABSENT = _Meaning(DeviceMissingError, "there is no such channel: correct the name, or plug the device in")
_MISNAMED = _Meaning(DeviceMissingError, "no such channels can be measured together: correct ni9230.channels")
_NO_IEPE = _Meaning(
    DeviceMissingError,
    "this module cannot supply an IEPE force sensor: name a channel of one that can, as NI 9230, 9232 or 9234",
)
_RATE = _Meaning(DeviceMissingError, "the device does not sample that fast or slowly: correct ni9230.sample_rate")
_COUPLING = _Meaning(
    DeviceMissingError, "the device does not couple an IEPE sensor so: correct ni9230.coupling or ni9230.current"
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
    **dict.fromkeys(ABSENT, _ABSENT),
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
"""Our name for what the driver calls its properties, by a part of that."""

_DETAILS = ("Property:", "Requested Value:", "Possible Values:", "Maximum Value:", "Minimum Value:")


def in_our_words(code: int, message: str, subject: str, *, was_there: bool = False, addition: str = "") -> DaqError:
    """Return the error to raise for `code`, whose one line begins with `subject` and ends with the driver's `message`.

    A device that cannot be reached is a DeviceLostError if it `was_there` before, else a DeviceMissingError; and so is
    one whose name the driver no longer knows. `addition` goes with the advice.
    """
    meaning = _MEANINGS.get(code)
    if meaning is None:
        meaning = _refused(message) if code == _REFUSED_VALUE else _Meaning(DaqError, "look this code up at ni.com")
    if was_there and code in ABSENT:
        meaning = _LOST
    elif not was_there and meaning is _LOST:
        meaning = _LOST._replace(error=DeviceMissingError, advice="the device does not answer: plug it in, power it")
    return meaning.error(f"{subject}: {meaning.advice}{addition} (NI-DAQmx {code}: {_in_one_line(message)})")


def _refused(message: str) -> _Meaning:
    keys = [key for part, key in _KEYS.items() if part in message]
    advice = f"correct {keys[0]}" if keys else "correct what the property stands for"
    return _Meaning(DeviceMissingError, f"the device cannot be set so: {advice}")


def _in_one_line(message: str) -> str:
    """Return the first line of `message`, and what else of it says which value would be right."""
    lines = [line.strip() for line in message.splitlines() if line.strip()]
    return "; ".join([*lines[:1], *(line for line in lines[1:] if line.startswith(_DETAILS))]) or "no description"
