"""The contact of the tip: a force from how deep and how fast it is pressed in, and what theory says of an impact.

    F = k d^n + c d'        never negative: nothing sticks

n = 1 is a linear spring, n = 3/2 that of Hertz; c is the damping of Kelvin and Voigt.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from scara_effmass.errors import SettingsError

LINEAR = 1.0
HERTZ = 1.5
"""Exponents n."""
MOST_FRICTION = 1.0


@dataclass(frozen=True, slots=True)
class SpringContact:
    """What the tip is made of; raises SettingsError for what no tip can be.

    The default makes 200 to 510 N and 1.3 to 3.2 ms of the paper's masses and speed, within the 160 to 860 N and 1 to
    4 ms of a tip of polyethylene. The paper does not give its stiffness.
    """

    stiffness: float = 2.0e6
    """k [N/m^n]"""
    exponent: float = LINEAR
    """n"""
    damping: float = 0.0
    """c [N s/m]"""
    friction: float = 0.0
    """Coulomb's coefficient, between the tip and the plate it slides on"""

    def __post_init__(self) -> None:
        for name, least in (("stiffness", 0.0), ("exponent", 1.0), ("damping", 0.0), ("friction", 0.0)):
            value = getattr(self, name)
            most = MOST_FRICTION if name == "friction" else math.inf
            if not least <= value <= most or value == math.inf or (name == "stiffness" and value == 0.0):
                raise SettingsError(f"{name} = {value}: from {least} to {most} would be right")

    def force(self, depth: float, rate: float) -> float:
        """Return the force [N] at `depth` [m], which grows by `rate` [m/s]; 0 where there is no contact."""
        if depth <= 0.0:
            return 0.0
        return max(0.0, self.stiffness * math.pow(depth, self.exponent) + self.damping * rate)

    def energy(self, depth: float) -> float:
        """Return what the spring holds at `depth` [J]."""
        power = self.exponent + 1.0
        return self.stiffness * math.pow(max(depth, 0.0), power) / power

    def peak(self, speed: float, reduced_mass: float) -> float:
        """Return the peak force [N] of two free bodies that meet at `speed` [m/s], without damping.

        All of mu v^2 / 2 is in the spring when the force is largest: v sqrt(mu k) for a linear one.
        """
        power = self.exponent + 1.0
        depth = math.pow(power * reduced_mass * speed**2 / (2.0 * self.stiffness), 1.0 / power)
        return self.stiffness * math.pow(depth, self.exponent)

    def duration(self, speed: float, reduced_mass: float) -> float:
        """Return how long such an impact lasts [s], from energy as well: pi sqrt(mu / k) for a linear spring."""
        power = self.exponent + 1.0
        depth = math.pow(self.peak(speed, reduced_mass) / self.stiffness, 1.0 / self.exponent)
        # The integral of (1 - x^p)^(-1/2) from 0 to 1.
        quarter = math.sqrt(math.pi) * math.gamma(1.0 + 1.0 / power) / math.gamma(0.5 + 1.0 / power)
        return 2.0 * depth / speed * quarter

    def critical_damping(self, reduced_mass: float) -> float:
        """Return the c [N s/m], of a linear spring, at which two free bodies no longer part: 2 sqrt(mu k)."""
        if self.exponent != LINEAR:
            raise SettingsError(f"exponent = {self.exponent}: only a linear spring has a critical damping")
        return 2.0 * math.sqrt(reduced_mass * self.stiffness)


POLYETHYLENE = SpringContact()
