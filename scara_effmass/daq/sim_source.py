"""The source `sim`: simulated force at the pace of a converter with a clock of its own."""

import threading
import time
from collections.abc import Callable
from importlib import import_module
from typing import final

import numpy as np

from scara_effmass.daq.source import ForceSource, Reading
from scara_effmass.settings import DaqSettings, SimScene
from scara_effmass.sim.synthetic_force import RandomPulses, SyntheticSignal
from scara_effmass.values import FloatArray

NS = 1_000_000_000


def make_sim_source(settings: DaqSettings, now_ns: Callable[[], int]) -> ForceSource:
    """Return the source of the scene `settings.sim.scene`."""
    if settings.sim.scene is SimScene.HALF_SINES:
        return HalfSineSource(settings, now_ns)
    # MuJoCo, only for the scene that needs it
    source: ForceSource = import_module("scara_effmass.daq.sim_cell_source").SimCellSource(settings, now_ns)
    return source


def simulated_reading(first: int, samples: FloatArray, limit: float, now_ns: int) -> Reading:
    """Return a reading of `samples` (channels, n), read-only, with those at the limit [N] marked."""
    saturated = np.abs(samples) >= limit
    saturated.flags.writeable = False
    return Reading(first, samples, 0, now_ns, saturated=saturated if saturated.any() else None)


@final
class HalfSineSource(ForceSource):
    """Noise and half-sine impacts, one block each `block_time`.

    The steady clock sets the pace, whatever ROS time does; the simulated converter deviates from it by
    `sim.clock_error`. A block that is not read in time waits, and no sample is ever lost.
    """

    filter_delay = 0.0
    simulated = True

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
        """Create the signal, and begin at sample 0."""
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
        """Return the next block after its last sample; None if that takes longer or the source was closed."""
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
        reading = simulated_reading(self._next, samples, self.limit, self._now_ns())
        self._next = end
        return reading

    def close(self) -> None:
        """End a `read` that waits, and delete the signal."""
        self._closed.set()
        self._signal = None
