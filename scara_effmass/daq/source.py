# SPDX-License-Identifier: Apache-2.0
"""Interface of all force sources."""

from typing import NamedTuple, Protocol

from scara_effmass.values import BoolArray, FloatArray


class Reading(NamedTuple):
    """Consecutive samples of all channels as a source returned them; arrays are read-only."""

    first_sample: int
    """Number of the first sample, counted from `start` and including lost samples."""
    samples: FloatArray
    """(channels, n) [N], as the sensors read them"""
    lost: int
    """Number of samples missing directly before the first one."""
    read_ns: int
    """ROS time of the host at which the last sample existed."""
    stamp_ns: int | None = None
    """Time of the first sample; None for a device, whose stamps are estimated by a `ClockFit`."""
    clock_residual: float = 0.0
    """Uncertainty of `stamp_ns` [s]."""
    saturated: BoolArray | None = None
    """(channels, n), marks samples whose force is not known: at the end of the measuring range, or with a fault of the
    sensor; None if there are none."""
    faults: tuple[str, ...] = ()
    """What is wrong with the sensor of each channel, empty for a sound one; () if nothing is."""
    run: int = 0
    """Increases when the source restarts and its clock must be estimated again."""
    relative_uncertainty: float | None = None
    """Uncertainty stated by a recording; None: that of the settings applies."""
    sample_rate: float = 0.0
    """Rate stated by a recording for these samples [Hz]; 0: that of the source."""
    tare: float = 0.0
    """Tare of a recording, which `samples` include [N], and its time; 0: none."""
    tare_stamp_ns: int = 0


class ForceSource(Protocol):
    """Source of force. Its constructor takes the settings and the ROS clock, and opens nothing.

    All methods but `close` may raise DaqError; after a DeviceLostError or OverrunError, `close` and `start` may help.
    Attributes are valid once `start` has returned.
    """

    simulated: bool
    """Whether the samples are computed and not measured."""
    channels: tuple[str, ...]
    """Short names, one per row of samples; if there are several, the constructor sets their final values."""
    description: str
    """Short description of the device or file: the `source` of ForceBlock."""
    requested_rate: float
    sample_rate: float
    """Nominal rate [Hz], as precisely as the source knows it."""
    limit: float
    """Largest magnitude that the source can read [N]; infinite when unknown."""
    filter_delay: float
    """Delay from the force to its sample [s]."""
    uses_ros_time: bool = False
    """Whether the samples follow the ROS clock; only then is `use_sim_time` allowed."""
    is_unpaced: bool = False
    """Whether samples come as fast as they are taken; the acquisition then waits and drops none."""
    subscriber_timeout: float = 0.0
    """How long to wait for a subscriber before `start` [s]; 0: not at all."""

    def start(self) -> None:
        """Open the source and start to acquire at sample 0."""

    def read(self, timeout_s: float) -> Reading | None:
        """Return the next block of samples; None if none came within `timeout_s` [s] or the source has ended."""

    def close(self) -> None:
        """Release everything; a `read` in another thread returns None. May be called at any time and repeatedly."""

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
        """What the next block waits for, if the source knows it."""
        return ""
