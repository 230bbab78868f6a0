"""The source `sim` with the scene `cell`: force from the simulated cell, as it happens."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, final

import numpy as np

from scara_effmass.daq.source import Reading, Unit
from scara_effmass.sim.adc import ForceSensor
from scara_effmass.sim.live import LiveSettings, LiveSim

if TYPE_CHECKING:
    from collections.abc import Callable

    from scara_effmass.settings import DaqSettings
    from scara_effmass.sim.live import LiveOutput

NS = 1_000_000_000
MS = 1_000_000
LONGEST_NAP_S = 0.005
"""ROS time may run at any pace, so it is looked at this often."""


@final
class VirtualCellForce:
    """The force that the simulated cell's cart feels, in blocks of `block_time` of ROS time; see `ForceSource`.

    The cell's course depends on `sim.seed` and `sim.start` alone: `sim_node` with the same two shows the joint
    states of the same cell. Each block is computed ahead and handed out when it is due, as a device would.
    """

    unit = Unit.NEWTON
    simulated = True
    channels: tuple[str, ...] = ("cell",)
    ended = False

    def __init__(self, settings: DaqSettings, now_ns: Callable[[], int]) -> None:
        sim = settings.sim
        self._sensor = ForceSensor(
            sample_rate=sim.sample_rate,
            clock_error=sim.clock_error,
            sensitivity=settings.sensor.sensitivity,
            range=settings.sensor.range,
            noise=sim.noise,
            seed=sim.seed,
        )
        self.description = f"simulated force: simulated cell (MuJoCo), seed {sim.seed}"
        self.requested_rate = self.sample_rate = sim.sample_rate
        self.limit = self._sensor.saturation
        self.filter_delay = self._sensor.filter_delay
        self._settings = settings
        self._now_ns = now_ns
        self._closed = threading.Event()
        self._bench: LiveSim | None = None
        self._due_ns = 0
        self._ahead: LiveOutput | None = None

    def start(self) -> None:
        """Put the robot at its start, at `sim.start` or now."""
        start_ns = round(self._settings.sim.start * 1e3) * MS or self._now_ns()
        self._bench = LiveSim(LiveSettings(sensor=self._sensor, seed=self._settings.sim.seed), start_ns)
        self._due_ns = start_ns
        self._ahead = None
        self._closed.clear()

    def read(self, timeout_s: float) -> Reading | None:
        """Return the next block once its time has come; None when that takes longer, or it is closed."""
        bench = self._bench
        if bench is None:
            return None
        if self._ahead is None:
            self._due_ns += max(1, round(self._settings.block_time * 1e3)) * MS
            self._ahead = bench.advance_to(self._due_ns)
        left_s = timeout_s
        while (wait_s := (self._due_ns - self._now_ns()) / NS) > 0.0:
            nap_s = min(wait_s, left_s, LONGEST_NAP_S)
            if nap_s <= 0.0 or self._closed.wait(nap_s):
                return None
            left_s -= nap_s
        output, self._ahead = self._ahead, None
        samples = output.force[np.newaxis]
        saturated = np.abs(samples) >= self.limit
        saturated.flags.writeable = False
        marks = saturated if saturated.any() else None
        return Reading(output.first_sample, samples, 0, self._now_ns(), saturated=marks)

    def close(self) -> None:
        """End a read that is waiting, and take the cell away."""
        self._closed.set()
        self._bench = None
