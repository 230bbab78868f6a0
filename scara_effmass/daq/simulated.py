"""The source `sim`: simulated force at the pace of a converter that has a clock of its own."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, final

import numpy as np

from scara_effmass.daq.source import Reading, Unit
from scara_effmass.sim.synthetic_force import RandomPulses, SyntheticSignal

if TYPE_CHECKING:
    from collections.abc import Callable

    from scara_effmass.settings import DaqSettings

NS = 1_000_000_000


@final
class SimulatedForce:
    """Noise and half-sine impacts, a block each `block_time`; see `ForceSource`.

    It keeps the pace on steady time, whatever ROS time does, and the simulated converter's clock is off that by
    `sim.clock_error`. A block that is not fetched in time waits, and so do those after it: nothing is ever lost.
    """

    unit = Unit.NEWTON
    simulated = True
    filter_delay = 0.0
    ended = False

    def __init__(
        self, settings: DaqSettings, now_ns: Callable[[], int], steady_ns: Callable[[], int] = time.monotonic_ns
    ) -> None:
        sim = settings.sim
        self.channels = tuple(f"sim{number}" for number in range(sim.channels))
        self.description = f"simulated force: noise and half-sine impacts, seed {sim.seed}"
        self.requested_rate = self.sample_rate = sim.sample_rate
        self.limit = np.inf
        self._settings = settings
        self._now_ns = now_ns
        self._steady_ns = steady_ns
        self._block = max(1, round(settings.block_time * sim.sample_rate))
        self._true_rate = sim.sample_rate * (1.0 + sim.clock_error)
        self._closed = threading.Event()
        self._signal: SyntheticSignal | None = None
        self._start_ns = 0
        self._next = 0

    def start(self) -> None:
        """Make the noise, and begin at sample 0."""
        sim = self._settings.sim
        self._signal = SyntheticSignal(
            channels=sim.channels,
            sample_rate=sim.sample_rate,
            noise=sim.noise,
            seed=sim.seed,
            sensitivity=self._settings.sensor.sensitivity,
            pulses=RandomPulses(sim.seed, sim.sample_rate, sim.impact_period),
        )
        self.limit = self._signal.limit
        self._next = 0
        self._closed.clear()
        self._start_ns = self._steady_ns()

    def read(self, timeout_s: float) -> Reading | None:
        """Return the next block, once its last sample has been taken; None when that takes longer, or it is closed."""
        signal = self._signal
        if signal is None:
            return None
        end = self._next + self._block
        due_ns = self._start_ns + round(end * NS / self._true_rate)
        wait_s = (due_ns - self._steady_ns()) / NS
        if self._closed.wait(min(max(wait_s, 0.0), timeout_s)) or wait_s > timeout_s:
            return None
        samples = signal.samples(self._next, self._block)
        if self._settings.sensor.invert:
            samples = -samples
            samples.flags.writeable = False
        saturated = np.abs(samples) >= self.limit
        saturated.flags.writeable = False
        reading = Reading(self._next, samples, 0, self._now_ns(), saturated=saturated if saturated.any() else None)
        self._next = end
        return reading

    def close(self) -> None:
        """End a read that is waiting, and forget the noise."""
        self._closed.set()
        self._signal = None
