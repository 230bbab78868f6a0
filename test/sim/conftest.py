from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np
import pytest

from scara_effmass.sim.cart import Cart
from scara_effmass.sim.collision_sim import FINE_STEP_NS, CollisionSim
from scara_effmass.sim.motion import joint_positions_at
from scara_effmass.sim.scara_kinematics import ElbowConfig, joint_rates

if TYPE_CHECKING:
    from collections.abc import Callable

    from scara_effmass.sim.collision_sim import ContactSample
    from scara_effmass.sim.spring_contact import SpringContact
    from scara_effmass.values import Vector3

ROBOT = Path(__file__).parents[2] / "config" / "omron_i4_550l.yaml"
X: Vector3 = (1.0, 0.0, 0.0)
Q3 = 0.236


class FreeImpact:
    """The robot without torque, moving at `speed` along x into a cart at (x, y), until they separate."""

    def __init__(
        self,
        point: tuple[float, float],
        mass: float,
        contact: SpringContact,
        *,
        speed: float = 0.25,
        step_ns: int = FINE_STEP_NS,
        gap: float = 1e-6,
        surface: Vector3 | None = None,
        tip_mass: float = 0.0,
        guide_friction: float = 0.0,
    ) -> None:
        x, y = point
        cart = Cart((x + gap, y, -Q3), X, mass, tip_mass, surface, guide_friction)
        self.sim = CollisionSim(ROBOT, cart, contact)
        q = np.array(joint_positions_at(point, ElbowConfig.RIGHT, Q3))
        rates = joint_rates(q[:2], np.array([speed, 0.0]))
        self.sim.set_state(q, np.array([*rates, 0.0, rates.sum()]))
        self.normal = np.array(surface or X)
        self.effective_mass = self.sim.effective_mass(self.normal)
        self.reduced_mass = 1.0 / (1.0 / self.effective_mass + float(self.normal[0]) ** 2 / mass)
        self.speed = speed * float(self.normal[0])
        self.sim.place_cart()
        self.energy = self.kinetic_energy(self.sim)
        self.samples: list[ContactSample] = []
        self._step_ns = step_ns

    def run(self, each_step: Callable[[CollisionSim], object] | None = None) -> FreeImpact:
        """Step until the contact ends."""
        in_contact = False
        for _ in range(20_000_000 // self._step_ns):
            if each_step is not None:
                each_step(self.sim)
            sample = self.sim.step(np.zeros(4), self._step_ns)
            self.samples.append(sample)
            if in_contact and sample.force == 0.0:
                return self
            in_contact = in_contact or sample.force > 0.0
        raise AssertionError("no complete contact")

    @staticmethod
    def kinetic_energy(sim: CollisionSim) -> float:
        """Return the kinetic energy of robot and cart [J]."""
        mujoco.mj_fwdPosition(sim.model, sim.data)
        momentum = np.empty(sim.model.nv)
        mujoco.mj_mulM(sim.model, sim.data, momentum, sim.data.qvel)
        return float(sim.data.qvel @ momentum / 2.0)

    @property
    def peak(self) -> float:
        """Peak force along the normal [N]."""
        return max(sample.force for sample in self.samples)


@pytest.fixture(scope="session")
def free_impact() -> type[FreeImpact]:
    return FreeImpact


@pytest.fixture(scope="session")
def robot() -> Path:
    return ROBOT
