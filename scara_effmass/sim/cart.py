# SPDX-License-Identifier: Apache-2.0
"""The cart that the robot hits, and the contact law of its tip."""

import math
from dataclasses import dataclass

from scara_effmass.errors import SettingsError
from scara_effmass.values import Vector3

UNIT_LENGTH_TOLERANCE = 1e-6
VISCOUS_SPEED_MPS = 1e-3
"""Speed below which guide friction is proportional to the speed, so that it vanishes at rest."""
BRAKE_TIME_S = 0.05
"""Time constant of the brake."""
LINEAR = 1.0
HERTZ = 1.5
"""Exponents n of the contact law."""


@dataclass(frozen=True, slots=True)
class Cart:
    """A cart on a guide, in the robot's base frame. Raises SettingsError for impossible values.

    `tip` is the position of the tip at rest [m], `direction` the unit vector along the guide, away from the robot, and
    `mass` the whole sliding mass m_H [kg]. The force cell sits between the tip and the rest of the cart: `tip_mass`
    [kg] is in front of it. `surface` is the unit normal of the robot's plate that the tip touches; None stands for
    `direction`. `guide_friction` is in [N]. Beyond `travel` [m] a brake stops the cart smoothly.
    """

    tip: Vector3
    direction: Vector3
    mass: float
    tip_mass: float = 0.0
    surface: Vector3 | None = None
    guide_friction: float = 0.5
    travel: float = 0.15

    def __post_init__(self) -> None:
        if not 0.0 <= self.tip_mass < self.mass < math.inf:
            raise SettingsError(f"mass = {self.mass}, tip_mass = {self.tip_mass}: must be 0 <= tip_mass < mass")
        for name, vector in (("direction", self.direction), ("surface", self.normal)):
            if not abs(math.hypot(*vector) - 1.0) < UNIT_LENGTH_TOLERANCE:
                raise SettingsError(f"{name} = {vector}: must be a unit vector")

    @property
    def normal(self) -> Vector3:
        """Unit normal of the plate, away from the robot."""
        return self.direction if self.surface is None else self.surface

    def resistance(self, position: float, speed: float) -> float:
        """Return the force of guide and brake on the cart [N], `position` [m] from its rest position."""
        friction = -self.guide_friction * speed / VISCOUS_SPEED_MPS
        if abs(speed) > VISCOUS_SPEED_MPS:
            friction = -math.copysign(self.guide_friction, speed)
        braking = -self.mass / BRAKE_TIME_S * speed if position > self.travel else 0.0
        return friction + braking


@dataclass(frozen=True, slots=True)
class SpringContact:
    """Contact law of the tip: F = max(0, k d^n + c d'). Raises SettingsError for impossible values.

    `stiffness` is k [N/m^n]. `exponent` n = 1 is a linear spring, 3/2 a Hertz contact. `damping` is c [N s/m] of the
    Kelvin-Voigt model, `friction` the Coulomb coefficient between tip and plate. The paper gives no stiffness of its
    polyethylene tip, but forces of 160 to 860 N and durations of 1 to 4 ms. The default gives 200 to 510 N and 1.3 to
    3.2 ms for the paper's masses and speed.
    """

    stiffness: float = 2.0e6
    exponent: float = LINEAR
    damping: float = 0.0
    friction: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 < self.stiffness < math.inf:
            raise SettingsError(f"stiffness = {self.stiffness}: must be finite and > 0")
        for name, minimum, maximum in (("exponent", 1.0, math.inf), ("damping", 0.0, math.inf), ("friction", 0.0, 1.0)):
            value = getattr(self, name)
            if not minimum <= value <= maximum or value == math.inf:
                raise SettingsError(f"{name} = {value}: must be finite and from {minimum} to {maximum}")

    def force(self, depth: float, rate: float) -> float:
        """Return the force [N] at penetration `depth` [m] with rate `rate` [m/s]; 0 without contact."""
        if depth <= 0.0:
            return 0.0
        return max(0.0, self.stiffness * math.pow(depth, self.exponent) + self.damping * rate)

    def free_impact(self, speed: float, reduced_mass: float) -> tuple[float, float]:
        """Return peak force [N] and duration [s] where two free bodies collide at `speed` [m/s], without damping.

        The spring holds mu v^2 / 2 at the peak. For a linear spring F = v sqrt(mu k), t = pi sqrt(mu / k).
        """
        power = self.exponent + 1.0
        depth = math.pow(power * reduced_mass * speed**2 / (2.0 * self.stiffness), 1.0 / power)
        # Integral of (1 - x^p)^(-1/2) from 0 to 1.
        quarter = math.sqrt(math.pi) * math.gamma(1.0 + 1.0 / power) / math.gamma(0.5 + 1.0 / power)
        return self.stiffness * math.pow(depth, self.exponent), 2.0 * depth / speed * quarter


POLYETHYLENE = SpringContact()
