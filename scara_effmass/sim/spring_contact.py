"""The contact law of the tip, and the peak force and duration that theory gives for a free impact.

    F = max(0, k d^n + c d')

n = 1 is a linear spring, n = 3/2 a Hertz contact; c is Kelvin-Voigt damping.
"""

import math
from dataclasses import dataclass

from scara_effmass.errors import SettingsError

LINEAR = 1.0
HERTZ = 1.5
"""Exponents n."""
MAX_FRICTION = 1.0


@dataclass(frozen=True, slots=True)
class SpringContact:
    """Material of the tip. Raises SettingsError for impossible values.

    The paper does not give the stiffness of its polyethylene tip, but 160 to 860 N and 1 to 4 ms. The default gives
    200 to 510 N and 1.3 to 3.2 ms for the paper's masses and speed.
    """

    stiffness: float = 2.0e6
    """k [N/m^n]"""
    exponent: float = LINEAR
    """n"""
    damping: float = 0.0
    """c [N s/m]"""
    friction: float = 0.0
    """Coulomb coefficient between tip and plate"""

    def __post_init__(self) -> None:
        for name, minimum in (("stiffness", 0.0), ("exponent", 1.0), ("damping", 0.0), ("friction", 0.0)):
            value = getattr(self, name)
            maximum = MAX_FRICTION if name == "friction" else math.inf
            if not minimum <= value <= maximum or value == math.inf or (name == "stiffness" and value == 0.0):
                raise SettingsError(f"{name} = {value}: must be finite and from {minimum} to {maximum}, stiffness > 0")

    def force(self, depth: float, rate: float) -> float:
        """Return the force [N] at penetration `depth` [m] with rate `rate` [m/s]; 0 without contact."""
        if depth <= 0.0:
            return 0.0
        return max(0.0, self.stiffness * math.pow(depth, self.exponent) + self.damping * rate)

    def peak_force(self, speed: float, reduced_mass: float) -> float:
        """Return the peak force [N] of two free bodies that collide at `speed` [m/s], without damping.

        The spring holds mu v^2 / 2 at the peak: F = v sqrt(mu k) for a linear spring.
        """
        power = self.exponent + 1.0
        depth = math.pow(power * reduced_mass * speed**2 / (2.0 * self.stiffness), 1.0 / power)
        return self.stiffness * math.pow(depth, self.exponent)

    def duration(self, speed: float, reduced_mass: float) -> float:
        """Return the duration of such an impact [s]: pi sqrt(mu / k) for a linear spring."""
        power = self.exponent + 1.0
        depth = math.pow(self.peak_force(speed, reduced_mass) / self.stiffness, 1.0 / self.exponent)
        # Integral of (1 - x^p)^(-1/2) from 0 to 1.
        quarter = math.sqrt(math.pi) * math.gamma(1.0 + 1.0 / power) / math.gamma(0.5 + 1.0 / power)
        return 2.0 * depth / speed * quarter


POLYETHYLENE = SpringContact()
