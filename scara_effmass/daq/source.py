# SPDX-License-Identifier: Apache-2.0
"""The interface of all force sources."""

from collections.abc import Callable
from importlib import import_module
from typing import NamedTuple, Protocol

from scara_effmass.settings import DaqSettings, ForceSourceKind
from scara_effmass.values import BoolArray, FloatArray


class Reading(NamedTuple):
    """Consecutive samples of all channels as a source returned them; arrays are read-only."""

    first_sample: int
    """Number of the first sample since `start`, lost samples included."""
    samples: FloatArray
    """(channels, n) [N]"""
    lost: int
    """Samples missing right before the first one."""
    read_ns: int
    """ROS time of the host when the last sample was known to exist."""
    stamp_ns: int | None = None
    """Time of the first sample; None of a device, whose stamps a `ClockFit` estimates."""
    clock_residual: float = 0.0
    """Uncertainty of `stamp_ns` [s]."""
    saturated: BoolArray | None = None
    """(channels, n), marks samples at the end of the measuring range; None where there is none."""
    run: int = 0
    """Increases when the source was restarted and its clock must be estimated anew."""
    relative_uncertainty: float | None = None
    """Uncertainty that a recording states; None: the settings state it."""


class ForceSource(Protocol):
    """A source of force. Its constructor takes the settings and the ROS clock, and opens nothing.

    All methods but `close` may raise DaqError; after a DeviceLostError or OverrunError, `close` and `start` may help.
    Attributes are valid from the end of `start` on.
    """

    simulated: bool
    """The samples are computed, not measured."""
    channels: tuple[str, ...]
    """Short names, one per row of samples; final from the constructor on unless there is only one."""
    description: str
    """Device or file in one phrase; the `source` of ForceBlock."""
    requested_rate: float
    sample_rate: float
    """Nominal rate [Hz] as far as the source knows it."""
    limit: float
    """Largest magnitude that the source can read [N]; infinite when unknown."""
    filter_delay: float
    """Delay from the force to its sample [s]."""
    uses_ros_time: bool = False
    """The samples follow the ROS clock, so `use_sim_time` is allowed."""
    is_unpaced: bool = False
    """Samples come as fast as they are taken, so the acquisition must wait rather than drop them."""
    subscriber_timeout: float = 0.0
    """How long to wait for a subscriber before `start` [s]; 0: start at once."""

    def start(self) -> None:
        """Open the source and start to acquire at sample 0."""

    def read(self, timeout_s: float) -> Reading | None:
        """Return the next block of samples; None when none came within `timeout_s` [s] or the source has ended."""

    def close(self) -> None:
        """Release everything; a `read` in another thread returns None. May be called at any time, and again."""

    @property
    def ended(self) -> bool:
        """Whether a finite acquisition or a recording is over."""
        return False

    @property
    def losses(self) -> tuple[str, ...]:
        """One line for each part of a recording that could not be read."""
        return ()

    @property
    def waiting_for(self) -> str:
        """What the next block is waiting for, where the source knows it."""
        return ""


SOURCES = {
    ForceSourceKind.NI9230: "scara_effmass.daq.ni9230:Ni9230Source",
    ForceSourceKind.BAG: "scara_effmass.daq.bag_source:BagSource",
    ForceSourceKind.SIM: "scara_effmass.daq.sim_source:make_sim_source",
}
"""Constructor of each source; its module, and the driver it needs, is imported when it is chosen."""


def make_source(settings: DaqSettings, now_ns: Callable[[], int]) -> ForceSource:
    """Return the source that `settings` select; `now_ns` returns the ROS time. Raises DaqError or SettingsError."""
    module, _, name = SOURCES[settings.source].partition(":")
    source: ForceSource = getattr(import_module(module), name)(settings, now_ns)
    return source
