# SPDX-License-Identifier: Apache-2.0
"""The robot controller: a servo per joint along a planned trajectory, with feed-forward torques.

    tau = tau_plan + K (q_plan - q) + D (qd_plan - qd)        K = I w^2,  D = 2 zeta w I

I is the inertia that the joint's drive sees at the point of impact, w the bandwidth. The controller reads the encoders
once per control period and holds the torque until the next one.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from scara_effmass.errors import SettingsError
from scara_effmass.sim.collision_sim import CONTROL_PERIOD_NS, CollisionSim, ContactSample
from scara_effmass.values import FloatArray

CONTROL_RATE_HZ = 1e9 / CONTROL_PERIOD_NS
VELOCITY_TIME_CONSTANT_S = 1e-3
"""Time constant of the low-pass filter for the joint velocities."""


@dataclass(frozen=True, slots=True)
class ServoGains:
    """Bandwidth [Hz] and damping ratio of the joint servos. Raises SettingsError for gains that may not be stable.

    The default of 5 Hz has little effect during a contact of a few milliseconds.
    """

    bandwidth: float = 5.0
    damping_ratio: float = 0.7

    def __post_init__(self) -> None:
        if not (0.0 < self.bandwidth <= 60.0 and 0.3 <= self.damping_ratio <= 1.0):
            raise SettingsError(f"{self}: must have a bandwidth of up to 60 Hz and a damping ratio from 0.3 to 1")


DEFAULT_GAINS = ServoGains()


class EncoderReading(NamedTuple):
    """Joint positions and the controller's velocity estimates (n,), before rounding to counts."""

    q: FloatArray
    qd: FloatArray


@final
class JointController:
    """Move the robot of a simulation along trajectories."""

    def __init__(self, sim: CollisionSim, gains: ServoGains) -> None:
        """Start from the robot's current state, which sets the inertias I of the gains."""
        inertias = sim.joint_inertias()
        omega = 2.0 * math.pi * gains.bandwidth
        self._sim = sim
        self._stiffness = inertias * omega**2
        self._damping = inertias * 2.0 * gains.damping_ratio * omega
        self._weight = 1.0 - math.exp(-1.0 / (CONTROL_RATE_HZ * VELOCITY_TIME_CONSTANT_S))
        self._velocity = sim.qd

    def follow(self, q: FloatArray, qd: FloatArray) -> Iterator[tuple[EncoderReading, list[ContactSample]]]:
        """Follow positions and velocities (m, n), one row per control period.

        After each period yield the encoder reading at its start and the contact during it.
        """
        qdd = np.gradient(qd, 1.0 / CONTROL_RATE_HZ, axis=0)
        for q_plan, qd_plan, planned in zip(q, qd, self._sim.inverse_dynamics(q, qd, qdd), strict=True):
            position = self._sim.q
            self._velocity = self._velocity + self._weight * (self._sim.qd - self._velocity)
            torque = planned + self._stiffness * (q_plan - position) + self._damping * (qd_plan - self._velocity)
            yield EncoderReading(position, self._velocity), self._sim.advance(torque)
