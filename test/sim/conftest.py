from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from scara_effmass.sim.cart import Cart
from scara_effmass.sim.collision_sim import NEAR_NS, CollisionSim
from scara_effmass.sim.motion import pose_at
from scara_effmass.sim.scara_kinematics import ElbowConfig, inverse_velocity

if TYPE_CHECKING:
    from collections.abc import Callable

    from scara_effmass.sim.collision_sim import ContactSample
    from scara_effmass.sim.spring_contact import SpringContact
    from scara_effmass.values import Vector3

ROBOT = Path(__file__).parents[2] / "config" / "omron_i4_550l.yaml"
X: Vector3 = (1.0, 0.0, 0.0)
Q3 = 0.236


class FreeImpact:
    """The arm without any torque, coasting with `speed` along x into a cart at (x, y), until they have parted."""

    def __init__(
        self,
        point: tuple[float, float],
        mass: float,
        contact: SpringContact,
        *,
        speed: float = 0.25,
        step_ns: int = NEAR_NS,
        gap: float = 1e-6,
        surface: Vector3 | None = None,
        tip_mass: float = 0.0,
        guide_friction: float = 0.0,
    ) -> None:
        x, y = point
        cart = Cart((x + gap, y, -Q3), X, mass, tip_mass, surface, guide_friction)
        self.cell = CollisionSim(ROBOT, cart, contact)
        q = np.array(pose_at(point, ElbowConfig.RIGHT, Q3))
        rates = inverse_velocity(q[:2], np.array([speed, 0.0]))
        self.cell.put(q, np.array([*rates, 0.0, rates.sum()]))
        self.normal = np.array(surface or X)
        self.effective_mass = self.cell.effective_mass(self.normal)
        self.reduced_mass = 1.0 / (1.0 / self.effective_mass + float(self.normal[0]) ** 2 / mass)
        self.speed = speed * float(self.normal[0])
        self.cell.place_cart()
        self.energy = self.cell.kinetic_energy()
        self.touches: list[ContactSample] = []
        self._step_ns = step_ns

    def run(self, each_step: Callable[[CollisionSim], object] | None = None) -> FreeImpact:
        """Step until the contact is over."""
        met = False
        for _ in range(20_000_000 // self._step_ns):
            if each_step is not None:
                each_step(self.cell)
            touch = self.cell.step(np.zeros(4), self._step_ns)
            self.touches.append(touch)
            if met and touch.force == 0.0:
                return self
            met = met or touch.force > 0.0
        raise AssertionError("the contact did not begin, or not end")

    @property
    def peak(self) -> float:
        """Of the force along the normal [N]."""
        return max(touch.force for touch in self.touches)


@pytest.fixture(scope="session")
def free_impact() -> type[FreeImpact]:
    return FreeImpact


@pytest.fixture(scope="session")
def robot() -> Path:
    return ROBOT
