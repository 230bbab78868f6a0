"""A recording of force, of whatever format, as `RecordedForce` plays it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from scara_effmass.daq.source import Unit
from scara_effmass.errors import SettingsError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from scara_effmass.values import BoolArray, FloatArray

NS = 1_000_000_000

UNITS = {
    "N": (Unit.NEWTON, 1.0),
    "kN": (Unit.NEWTON, 1e3),
    "lbf": (Unit.NEWTON, 4.4482216152605),
    "kgf": (Unit.NEWTON, 9.80665),
    "V": (Unit.VOLT, 1.0),
    "mV": (Unit.VOLT, 1e-3),
}
"""What a recording may be in, and what it takes to get from there to the unit of a source (NIST SP 811, B.8)."""


class RecordedBlock(NamedTuple):
    """Consecutive samples (n,), which begin at `stamp_ns`, good to `clock_residual` [s], after `lost` missing ones."""

    stamp_ns: int
    samples: FloatArray
    lost: int
    clock_residual: float
    saturated: BoolArray | None = None
    simulated: bool = False


def nothing() -> None:
    """Close a file that has been read already."""


@dataclass(frozen=True, slots=True)
class ForceFile:
    """A recording that has been opened. Its `blocks` come in the order of their times, at a constant `sample_rate`.

    It spans the times from `start_ns` to `end_ns`, of which the first sample may be later than the start. `losses`
    says what could not be read so far, a line each. `close` may be called at any time, but not while `blocks` are read.
    """

    description: str
    channel: str
    unit: Unit
    sample_rate: float
    start_ns: int
    end_ns: int
    blocks: Iterator[RecordedBlock]
    losses: Callable[[], tuple[str, ...]] = tuple
    close: Callable[[], None] = nothing


def declared_unit(setting: str, written: str, origin: str) -> tuple[Unit, float]:
    """Return the unit of a source, and the factor to it, for the unit that the setting and the recording declare.

    Either may be empty; raises SettingsError when both are, or they differ.
    """
    choices = ", ".join(UNITS)
    if not setting and not written:
        raise SettingsError(f"{origin}: does not say its unit; bag.unit = one of {choices} would be right")
    if not setting and written not in UNITS:
        right = f"convert it to one of {choices}, or say with bag.unit which of these it is"
        raise SettingsError(f"{origin}: has the unit {written!r}; {right}")
    if setting and written in UNITS and written != setting:
        raise SettingsError(f"{origin}: bag.unit = {setting}, but it is in {written}; leave bag.unit empty")
    return UNITS[setting or written]
