"""The cart that is hit: where it waits, what it weighs, and what holds it back."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from scara_effmass.errors import SettingsError

if TYPE_CHECKING:
    from scara_effmass.values import Vector3

UNIT = 1e-6
"""The length of a unit vector is 1 within this."""
SLOW_MPS = 1e-3
"""Below it, friction of the guide is in proportion to the speed, so that it ends with the motion."""


@dataclass(frozen=True, slots=True)
class Cart:
    """The cart, its guide and where it stands when it waits.

    The force cell is on the cart, `tip_mass` of the cart's `mass` on the far side of it. `surface` is the unit normal
    of the plate on the robot, into which the tip is pressed; along the guide where it is None. Behind `travel` a brake
    stops the cart gently, as the end of a real guide would have to. Raises SettingsError for what cannot be.
    """

    tip: Vector3
    """Where the tip waits, in the robot's base frame [m]."""
    direction: Vector3
    """Unit vector along the guide, away from the robot."""
    mass: float
    """m_H, all that slides [kg]"""
    tip_mass: float = 0.0
    """[kg]"""
    surface: Vector3 | None = None
    guide_friction: float = 0.5
    """[N]"""
    travel: float = 0.15
    """free of the brake [m]"""
    brake_time: float = 0.05
    """in which the brake takes away 63 % of the speed [s]"""

    def __post_init__(self) -> None:
        if not 0.0 <= self.tip_mass < self.mass < math.inf:
            raise SettingsError(
                f"mass = {self.mass} with tip_mass = {self.tip_mass}: 0 <= tip_mass < mass would be right"
            )
        for name in ("direction", "surface"):
            vector = getattr(self, name)
            if vector is not None and not abs(math.hypot(*vector) - 1.0) < UNIT:
                raise SettingsError(f"{name} = {vector}: a unit vector would be right")

    def resistance(self, position: float, speed: float) -> float:
        """Return what guide and brake do to the cart [N], at `position` [m] beyond where it waited."""
        friction = -self.guide_friction * speed / SLOW_MPS
        if abs(speed) > SLOW_MPS:
            friction = -math.copysign(self.guide_friction, speed)
        braking = -self.mass / self.brake_time * speed if position > self.travel else 0.0
        return friction + braking
