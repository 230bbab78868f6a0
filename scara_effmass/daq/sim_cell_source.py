# SPDX-License-Identifier: Apache-2.0
"""The source `sim` with the scene `cell`: force from the simulated cell, live."""

from collections.abc import Callable, Iterator
from itertools import count
from typing import final

import numpy as np

from scara_effmass.daq.sim_source import SimSource
from scara_effmass.settings import DaqSettings
from scara_effmass.sim.live import LiveSim
from scara_effmass.sim.measurement import ForceSensor
from scara_effmass.values import FloatArray

MS = 1_000_000


@final
class SimCellSource(SimSource):
    """Force on the cart of the simulated cell, in blocks of `block_time` of ROS time.

    The simulation depends on `sim.seed` and `sim.start` alone, so `sim_node` with the same values publishes the joint
    states of the same cell.
    """

    uses_ros_time = True
    channels: tuple[str, ...] = ("cell",)

    def __init__(self, settings: DaqSettings, now_ns: Callable[[], int]) -> None:
        super().__init__(settings, now_ns, now_ns)
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
        self.limit = self._sensor.saturation
        self.filter_delay = self._sensor.filter_delay

    def compute_blocks(self) -> Iterator[tuple[int, int, FloatArray]]:
        """See `SimSource`; the robot starts at `sim.start`, or now."""
        sim = self._settings.sim
        start_ns = round(sim.start * 1e3) * MS or self._now_ns()
        simulation = LiveSim(start_ns, seed=sim.seed, sensor=self._sensor)
        period_ns = max(1, round(self._settings.block_time * 1e3)) * MS
        for due_ns in count(start_ns + period_ns, period_ns):
            output = simulation.advance_to(due_ns)
            yield due_ns, output.first_sample, output.force[np.newaxis]
