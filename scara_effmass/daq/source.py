"""The seam: what every source of force offers, whatever is behind it."""

from __future__ import annotations

from enum import Enum
from importlib import import_module
from typing import TYPE_CHECKING, NamedTuple, Protocol

from scara_effmass.settings import ForceSourceKind, SimScene

if TYPE_CHECKING:
    from collections.abc import Callable

    from scara_effmass.settings import DaqSettings
    from scara_effmass.values import BoolArray, FloatArray


class Unit(Enum):
    """What the samples of a source are."""

    NEWTON = "N"
    VOLT = "V"


class Reading(NamedTuple):
    """Consecutive samples of all channels, as they came off the source; its arrays are read-only.

    `first_sample` counts from the source's `start`, lost samples included; `lost` are missing right before it.
    `read_ns` is the host's ROS time at which the last sample was known to exist. A recording knows when the first
    sample was taken: `stamp_ns`, good to `clock_residual` [s]; of a device it is None, to be found by a `ClockFit`.
    `saturated` (channels, n) marks samples at the end of the measuring range, None where there is none. `run` grows
    when the source had to be started again: numbers go on, what was learnt about its clock does not.
    """

    first_sample: int
    samples: FloatArray
    """(channels, n), in the unit of the source"""
    lost: int
    read_ns: int
    stamp_ns: int | None = None
    clock_residual: float = 0.0
    saturated: BoolArray | None = None
    run: int = 0


class ForceSource(Protocol):
    """A source of force. Its constructor takes the settings and the clock, and opens nothing.

    All but `close` may raise DaqError; a DeviceLostError or OverrunError means that `close` and `start` may help.
    """

    unit: Unit
    simulated: bool
    """The samples are computed, nothing was measured."""
    channels: tuple[str, ...]
    """Short names, one per row of samples; known from the start of `start` on, as are all below."""
    description: str
    """One phrase for people: what, where, coupling; the `source` of ForceBlock."""
    requested_rate: float
    sample_rate: float
    """The real one [Hz], as far as the source itself knows it."""
    limit: float
    """Largest magnitude it can read, in its unit; infinite when unknown."""
    filter_delay: float
    """From the force to its sample [s]."""

    def start(self) -> None:
        """Open it and begin to acquire."""

    def read(self, timeout_s: float) -> Reading | None:
        """Wait for the next block of samples; None when none has come within `timeout_s` [s] or it has ended."""

    @property
    def ended(self) -> bool:
        """Whether there will be no more: a finite acquisition or a recording is over."""

    def close(self) -> None:
        """Give everything back; may be called at any time, and again."""


SOURCES: dict[ForceSourceKind | SimScene, str] = {
    ForceSourceKind.NI9230: "scara_effmass.daq.ni9230:Ni9230",
    ForceSourceKind.BAG: "scara_effmass.daq.recorded:RecordedForce",
    SimScene.HALF_SINES: "scara_effmass.daq.simulated:SimulatedForce",
    SimScene.CELL: "scara_effmass.daq.virtual_cell:VirtualCellForce",
}
"""Where each source is; its module, and the driver it needs, is imported when it is chosen."""


def make_source(settings: DaqSettings, now_ns: Callable[[], int]) -> ForceSource:
    """Return the source that `settings` choose; `now_ns` gives the ROS time. Raises DaqError or SettingsError."""
    chosen = settings.sim.scene if settings.source is ForceSourceKind.SIM else settings.source
    module, _, name = SOURCES[chosen].partition(":")
    source: ForceSource = getattr(import_module(module), name)(settings, now_ns)
    return source
