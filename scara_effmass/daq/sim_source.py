# SPDX-License-Identifier: Apache-2.0
"""The source `sim`: simulated force at the pace of a converter, from half-sines or from the simulated cell."""

import math
import threading
import time
from collections.abc import Callable, Iterator
from itertools import count
from typing import final

import numpy as np

from scara_effmass.daq.source import ForceSource, Reading
from scara_effmass.settings import DaqSettings
from scara_effmass.sim.measurement import ForceSensor, RandomPulses, SyntheticSignal
from scara_effmass.values import FloatArray
from scara_effmass.wire.cdr import NS

MS = 1_000_000
MAX_POLL_S = 0.005
"""Longest polling period of the clock that sets the pace; ROS time may run at any speed."""


class SimSource(ForceSource):
    """Simulated force; each block is computed ahead and returned when it is due, as a device would do.

    A block that is not read in time waits, so no sample is lost.
    """

    simulated = True

    def __init__(self, settings: DaqSettings, now_ns: Callable[[], int], pace_ns: Callable[[], int]) -> None:
        """Return blocks when the clock `pace_ns` has reached the time at which they are due."""
        self.requested_rate = self.sample_rate = settings.sim.sample_rate
        self._settings, sim = settings, settings.sim
        self._sensor = ForceSensor(
            sample_rate=sim.sample_rate,
            clock_error=sim.clock_error,
            sensitivity=settings.sensor.sensitivity,
            range=settings.sensor.range,
            noise=sim.noise,
            seed=sim.seed,
        )
        self._now_ns = now_ns
        self._pace_ns = pace_ns
        self._closed = threading.Event()
        self._blocks: Iterator[tuple[int, int, FloatArray]] | None = None
        self._next: tuple[int, int, FloatArray] | None = None

    def compute_blocks(self) -> Iterator[tuple[int, int, FloatArray]]:
        """Yield the time [ns] at which each block is due, its first sample number, and its samples (channels, n)."""
        raise NotImplementedError

    def start(self) -> None:
        """Begin at sample 0."""
        self._blocks, self._next = self.compute_blocks(), None
        self._wait_s()
        self._closed.clear()

    def read(self, timeout_s: float) -> Reading | None:
        """Return the next block when it is due; None if that takes longer than `timeout_s` or the source is closed."""
        left_s = timeout_s
        while (wait_s := self._wait_s()) > 0.0:
            poll_s = min(wait_s, left_s, MAX_POLL_S)
            if poll_s <= 0.0 or self._closed.wait(poll_s):
                return None
            left_s -= poll_s
        if self._next is None:
            return None
        (_, first, samples), self._next = self._next, None
        saturated = np.abs(samples) >= self.limit
        saturated.flags.writeable = samples.flags.writeable = False
        return Reading(first, samples, 0, self._now_ns(), saturated=saturated if saturated.any() else None)

    def _wait_s(self) -> float:
        """Compute the next block; return the time until it is due [s], infinite while the time of day is not known."""
        if self._blocks is None:
            return 0.0
        if not self._pace_ns():  # before the first message on /clock
            return math.inf
        self._next = self._next or next(self._blocks)
        return (self._next[0] - self._pace_ns()) / NS

    def close(self) -> None:
        """End a waiting `read`, and delete the simulation."""
        self._closed.set()
        self._blocks = None


@final
class HalfSineSource(SimSource):
    """Noise and half-sine impacts, one block each `block_time`.

    The pace is that of the steady clock and not of ROS time; the simulated converter deviates from it by
    `sim.clock_error`.
    """

    filter_delay = 0.0

    def __init__(
        self, settings: DaqSettings, now_ns: Callable[[], int], steady_ns: Callable[[], int] = time.monotonic_ns
    ) -> None:
        super().__init__(settings, now_ns, steady_ns)
        self.channels = tuple(f"sim{number}" for number in range(settings.sim.channels))
        self.description = f"simulated force: noise and half-sine impacts, seed {settings.sim.seed}"
        self.limit = np.inf

    def compute_blocks(self) -> Iterator[tuple[int, int, FloatArray]]:
        """See `SimSource`."""
        sim, is_inverted = self._settings.sim, self._settings.sensor.invert
        pulses = RandomPulses(sim.seed, sim.sample_rate, sim.impact_period)
        signal = SyntheticSignal(sim.channels, self._sensor, pulses)
        self.limit = signal.limit
        start_ns = self._pace_ns()
        size = max(1, round(self._settings.block_time * sim.sample_rate))
        for first in count(0, size):
            samples = signal.samples(first, size)
            due_ns = start_ns + round((first + size) * NS / self._sensor.true_rate)
            yield due_ns, first, -samples if is_inverted else samples


@final
class SimCellSource(SimSource):
    """Force on the cart of the simulated cell, in blocks of `block_time` of ROS time.

    The simulation depends on `sim.seed` and `sim.start` alone, so `sim_node` with the same values publishes the joint
    states of the same cell.
    """

    uses_ros_time = True
    channels: tuple[str, ...] = ("cell",)

    def __init__(self, settings: DaqSettings, now_ns: Callable[[], int]) -> None:
        from scara_effmass.sim.experiment import LiveSim  # noqa: PLC0415 - needs MuJoCo, which the other scene does not

        super().__init__(settings, now_ns, now_ns)
        self._start_sim = LiveSim
        self.description = f"simulated force: simulated cell (MuJoCo), seed {settings.sim.seed}"
        self.limit = self._sensor.saturation
        self.filter_delay = self._sensor.filter_delay

    def compute_blocks(self) -> Iterator[tuple[int, int, FloatArray]]:
        """See `SimSource`; the robot starts at `sim.start`, or now, and the converter not before it is read.

        Blocks from before would be read at once, so that none of them shows its time.
        """
        sim, skipped = self._settings.sim, 0
        start_ns = round(sim.start * 1e3) * MS or self._now_ns()
        simulation = self._start_sim(start_ns, seed=sim.seed, sensor=self._sensor)
        period_ns = max(1, round(self._settings.block_time * 1e3)) * MS
        begin_ns = start_ns
        for _ in range(2):  # time goes on meanwhile
            if (late_ns := (self._now_ns() - begin_ns) // period_ns * period_ns) > 0:
                begin_ns += late_ns
                before = simulation.advance_to(begin_ns)
                skipped = before.first_sample + len(before.force)
        for due_ns in count(begin_ns + period_ns, period_ns):
            output = simulation.advance_to(due_ns)
            yield due_ns, output.first_sample - skipped, output.force[np.newaxis]


def make_sim_source(settings: DaqSettings, now_ns: Callable[[], int]) -> ForceSource:
    """Return the source of the scene `settings.sim.scene`."""
    source = HalfSineSource if settings.sim.scene == "half_sines" else SimCellSource
    return source(settings, now_ns)
