"""The source `sim` with the scene `cell`: force from the simulated cell, live."""

import threading
from collections.abc import Callable
from typing import final

import numpy as np

from scara_effmass.daq.sim_source import simulated_reading
from scara_effmass.daq.source import ForceSource, Reading
from scara_effmass.settings import DaqSettings
from scara_effmass.sim.live import LiveOutput, LiveSim
from scara_effmass.sim.measurement import ForceSensor

NS = 1_000_000_000
MS = 1_000_000
MAX_POLL_S = 0.005
"""Longest polling period of the ROS clock, which may run at any pace."""


@final
class SimCellSource(ForceSource):
    """Force on the cart of the simulated cell, in blocks of `block_time` of ROS time.

    The simulation depends on `sim.seed` and `sim.start` alone: `sim_node` with the same values publishes the joint
    states of the same cell. Each block is computed ahead and returned when it is due, as by a device.
    """

    simulated = True
    uses_ros_time = True
    channels: tuple[str, ...] = ("cell",)

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
        self._simulation: LiveSim | None = None
        self._due_ns = 0
        self._next_output: LiveOutput | None = None

    def start(self) -> None:
        """Put the robot at its start, at `sim.start` or now."""
        start_ns = round(self._settings.sim.start * 1e3) * MS or self._now_ns()
        self._simulation = LiveSim(start_ns, seed=self._settings.sim.seed, sensor=self._sensor)
        self._due_ns = start_ns
        self._next_output = None
        self._closed.clear()

    def read(self, timeout_s: float) -> Reading | None:
        """Return the next block when it is due; None if that takes longer or the source was closed."""
        simulation = self._simulation
        if simulation is None:
            return None
        if self._next_output is None:
            self._due_ns += max(1, round(self._settings.block_time * 1e3)) * MS
            self._next_output = simulation.advance_to(self._due_ns)
        left_s = timeout_s
        while (wait_s := (self._due_ns - self._now_ns()) / NS) > 0.0:
            poll_s = min(wait_s, left_s, MAX_POLL_S)
            if poll_s <= 0.0 or self._closed.wait(poll_s):
                return None
            left_s -= poll_s
        output, self._next_output = self._next_output, None
        return simulated_reading(output.first_sample, output.force[np.newaxis], self.limit, self._now_ns())

    def close(self) -> None:
        """End a `read` that waits, and delete the simulation."""
        self._closed.set()
        self._simulation = None
