# SPDX-License-Identifier: Apache-2.0
"""A joint trajectory with scaled time, followed exactly, as by joint_trajectory_controller in position mode."""

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from scara_effmass.values import FloatArray, JointState


class ScaledTrajectory:
    """Simulated controller: each cycle advances the time of the trajectory by factor x period."""

    def __init__(self, names: Sequence[str], times: FloatArray, q: FloatArray, qd: FloatArray) -> None:
        """Follow positions `q` and velocities `qd` (m, n) at the increasing `times` (m,) [s], from the first one on."""
        self._names = tuple(names)
        self._position = CubicHermiteSpline(times, q, qd)
        self._velocity = self._position.derivative()
        self._end = float(times[-1])
        self.time = float(times[0])
        """Time in the trajectory [s]."""

    @property
    def ended(self) -> bool:
        """Whether the motion has reached the end of the trajectory."""
        return self.time >= self._end

    def advance(self, factor: float, period: float, stamp_ns: int) -> JointState:
        """Advance by `period` [s] at `factor` times the programmed speed; return the joint state at the end of it."""
        self.time = min(self.time + factor * period, self._end)
        q, qd = self.at(np.array([self.time]), np.array([0.0 if self.ended else factor]))
        return JointState(stamp_ns, self._names, q[0], qd[0])

    def at(self, times: FloatArray, factors: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return positions and velocities (m, n) at `times` of the trajectory (m,) [s], at `factors` (m,)."""
        return self._position(times), factors[:, np.newaxis] * self._velocity(times)
