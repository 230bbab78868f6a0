"""The robot's controller: a servo per joint along a planned motion, with the torques of the motion fed forward.

    tau = tau_plan + K (q_plan - q) + D (qd_plan - qd)        K = I w^2,  D = 2 zeta w I

I is the inertia that the joint's drive sees at the point of impact, w the bandwidth. It reads the encoders once per
tick and holds the torque until the next one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, final

import numpy as np

from scara_effmass.errors import SettingsError
from scara_effmass.sim.collision_sim import TICK_NS
from scara_effmass.sim.motion import sampled

if TYPE_CHECKING:
    from collections.abc import Sequence

    from scara_effmass.sim.collision_sim import CollisionSim, ContactSample
    from scara_effmass.sim.motion import Move
    from scara_effmass.values import FloatArray

TICK_HZ = 1e9 / TICK_NS


MOST_HZ = 60.0
LEAST_DAMPING = 0.3
SLOWEST_S = 2e-3
"""Within these the controller is stable in all configurations."""


@dataclass(frozen=True, slots=True)
class Servo:
    """Gains of the controller. With 5 Hz it hardly acts during a contact of some milliseconds.

    Raises SettingsError for what would not be stable at a tick of 1 ms.
    """

    bandwidth: float = 5.0
    """[Hz]"""
    damping_ratio: float = 0.7
    velocity_time_constant: float = 1e-3
    """of the low-pass from which the controller has its joint velocities [s]"""

    def __post_init__(self) -> None:
        if not 0.0 < self.bandwidth <= MOST_HZ:
            raise SettingsError(f"bandwidth = {self.bandwidth}: more than 0 and at most {MOST_HZ} Hz would be right")
        if not LEAST_DAMPING <= self.damping_ratio <= 1.0:
            raise SettingsError(f"damping_ratio = {self.damping_ratio}: {LEAST_DAMPING} to 1 would be right")
        if not 0.0 < self.velocity_time_constant <= SLOWEST_S:
            raise SettingsError(
                f"velocity_time_constant = {self.velocity_time_constant}: more than 0 and at most {SLOWEST_S} s"
                " would be right"
            )


SERVO = Servo()


class Encoders(NamedTuple):
    """Joint positions and the controller's estimate of their velocities (n,), before they are rounded to counts."""

    q: FloatArray
    qd: FloatArray


@final
class Plan:
    """A motion, tick by tick: positions, velocities and torques (m, n)."""

    def __init__(self, cell: CollisionSim, moves: Sequence[Move]) -> None:
        """Sample `moves`, one after the other."""
        self.q, self.qd = sampled(moves, TICK_HZ)
        self.torque = cell.inverse_dynamics(self.q, self.qd, np.gradient(self.qd, 1.0 / TICK_HZ, axis=0))

    def __len__(self) -> int:
        return len(self.q)


@final
class Drive:
    """Moves the robot of a cell along plans."""

    def __init__(self, cell: CollisionSim, servo: Servo, inertias: FloatArray) -> None:
        """Take over the robot as it stands; `inertias` (n,) [kg m2, kg] set the gains."""
        pulse = 2.0 * math.pi * servo.bandwidth
        self._cell = cell
        self._stiffness = inertias * pulse**2
        self._damping = inertias * 2.0 * servo.damping_ratio * pulse
        self._weight = 1.0 - math.exp(-1.0 / (TICK_HZ * servo.velocity_time_constant))
        self._velocity = cell.qd

    def tick(self, plan: Plan, number: int) -> tuple[Encoders, list[ContactSample]]:
        """Do tick `number` of `plan`; return what was read at its beginning, and the contact during it."""
        q = self._cell.q
        self._velocity = self._velocity + self._weight * (self._cell.qd - self._velocity)
        torque = (
            plan.torque[number]
            + self._stiffness * (plan.q[number] - q)
            + self._damping * (plan.qd[number] - self._velocity)
        )
        return Encoders(q, self._velocity), self._cell.tick(torque)
