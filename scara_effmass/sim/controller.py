"""The robot controller: a servo per joint along a planned trajectory, with feed-forward torques.

    tau = tau_plan + K (q_plan - q) + D (qd_plan - qd)        K = I w^2,  D = 2 zeta w I

I is the inertia that the joint's drive sees at the point of impact, w the bandwidth. The controller reads the encoders
once per control period and holds the torque until the next one.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from scara_effmass.errors import SettingsError
from scara_effmass.sim.collision_sim import CONTROL_PERIOD_NS, CollisionSim, ContactSample
from scara_effmass.sim.motion import Move, sample_moves
from scara_effmass.values import FloatArray

CONTROL_RATE_HZ = 1e9 / CONTROL_PERIOD_NS
_STABLE_RANGES = {
    "bandwidth": (0.0, 60.0, "Hz"),
    "damping_ratio": (0.3, 1.0, ""),
    "velocity_time_constant": (0.0, 2e-3, "s"),
}
"""The controller is stable within these in all configurations."""


@dataclass(frozen=True, slots=True)
class ServoGains:
    """Gains of the joint servos. Raises SettingsError for gains that would not be stable.

    The default of 5 Hz has little effect during a contact of a few milliseconds.
    """

    bandwidth: float = 5.0
    """[Hz]"""
    damping_ratio: float = 0.7
    velocity_time_constant: float = 1e-3
    """of the low-pass for the joint velocities [s]"""

    def __post_init__(self) -> None:
        for name, (minimum, maximum, unit) in _STABLE_RANGES.items():
            value = getattr(self, name)
            if not (minimum <= value <= maximum and value > 0.0):
                raise SettingsError(f"{name} = {value}: must be > 0 and from {minimum} to {maximum} {unit}".rstrip())


DEFAULT_GAINS = ServoGains()


class EncoderReading(NamedTuple):
    """Joint positions and the controller's velocity estimates (n,), before rounding to counts."""

    q: FloatArray
    qd: FloatArray


@final
class JointTrajectory:
    """Positions, velocities and torques (m, n) of consecutive moves, one row per control period."""

    def __init__(self, sim: CollisionSim, moves: Sequence[Move]) -> None:
        self.q, self.qd = sample_moves(moves, CONTROL_RATE_HZ)
        self.torque = sim.inverse_dynamics(self.q, self.qd, np.gradient(self.qd, 1.0 / CONTROL_RATE_HZ, axis=0))

    def __len__(self) -> int:
        return len(self.q)


@final
class JointController:
    """Moves the robot of a simulation along trajectories."""

    def __init__(self, sim: CollisionSim, gains: ServoGains) -> None:
        """Start from the robot's current state, which sets the inertias I of the gains."""
        inertias = sim.joint_inertias()
        omega = 2.0 * math.pi * gains.bandwidth
        self._sim = sim
        self._stiffness = inertias * omega**2
        self._damping = inertias * 2.0 * gains.damping_ratio * omega
        self._weight = 1.0 - math.exp(-1.0 / (CONTROL_RATE_HZ * gains.velocity_time_constant))
        self._velocity = sim.qd

    def advance(self, trajectory: JointTrajectory, index: int) -> tuple[EncoderReading, list[ContactSample]]:
        """Run control period `index` of `trajectory`; return the reading at its start and the contact during it."""
        q = self._sim.q
        self._velocity = self._velocity + self._weight * (self._sim.qd - self._velocity)
        torque = (
            trajectory.torque[index]
            + self._stiffness * (trajectory.q[index] - q)
            + self._damping * (trajectory.qd[index] - self._velocity)
        )
        return EncoderReading(q, self._velocity), self._sim.advance(torque)
