"""The cart that the robot hits: position, mass, guide friction and brake."""

import math
from dataclasses import dataclass

from scara_effmass.errors import SettingsError
from scara_effmass.values import Vector3

UNIT_LENGTH_TOLERANCE = 1e-6
VISCOUS_SPEED_MPS = 1e-3
"""Guide friction is proportional to the speed below this, so that it vanishes at rest."""


@dataclass(frozen=True, slots=True)
class Cart:
    """A cart on a guide, in the robot's base frame. Raises SettingsError for impossible values.

    The force cell sits between the tip and the rest of the cart: `tip_mass` of `mass` is in front of it. A brake
    behind `travel` stops the cart smoothly.
    """

    tip: Vector3
    """position of the tip at rest [m]"""
    direction: Vector3
    """unit vector along the guide, away from the robot"""
    mass: float
    """m_H, the whole sliding mass [kg]"""
    tip_mass: float = 0.0
    """[kg]"""
    surface: Vector3 | None = None
    """unit normal of the plate on the robot that the tip touches; None: `direction`"""
    guide_friction: float = 0.5
    """[N]"""
    travel: float = 0.15
    """distance to the brake [m]"""
    brake_time: float = 0.05
    """time constant of the brake [s]"""

    def __post_init__(self) -> None:
        if not 0.0 <= self.tip_mass < self.mass < math.inf:
            raise SettingsError(f"mass = {self.mass}, tip_mass = {self.tip_mass}: must be 0 <= tip_mass < mass")
        for name in ("direction", "surface"):
            vector = getattr(self, name)
            if vector is not None and not abs(math.hypot(*vector) - 1.0) < UNIT_LENGTH_TOLERANCE:
                raise SettingsError(f"{name} = {vector}: must be a unit vector")

    def resistance(self, position: float, speed: float) -> float:
        """Return the force of guide and brake on the cart [N], `position` [m] from its rest position."""
        friction = -self.guide_friction * speed / VISCOUS_SPEED_MPS
        if abs(speed) > VISCOUS_SPEED_MPS:
            friction = -math.copysign(self.guide_friction, speed)
        braking = -self.mass / self.brake_time * speed if position > self.travel else 0.0
        return friction + braking
