# SPDX-License-Identifier: Apache-2.0
"""Contact of two masses through a linear spring (ISO/TS 15066:2016, Annex A): m_R, mu, F and E.

v_max, their inverse, is in `allowable_speed`. The kernel has them once more, compiled.
"""

import math
from typing import TypeVar

from scara_effmass.values import FloatArray

TRANSIENT_S = 0.5
"""Duration of the longest transient contact [s] (ISO/TS 15066)."""
TIME_FACTOR = 1.5
"""Time for which the force may grow, over the time to its peak; above 1, to cover what is not linear in time."""
MAX_TURN = 0.05
"""Turn [rad], path [m] by `turn_until_peak` up to which the linear change of pose holds (docs/validity.md)."""
Quantity = TypeVar("Quantity", float, FloatArray)
"""A scalar or an array of any shape; the arrays of one call have the same shape."""


def robot_mass(moving_mass: float, payload_mass: float) -> float:
    """Return m_R = M/2 + m_L [kg], the standard's effective mass of a robot in any configuration (Eq. 17)."""
    return moving_mass / 2.0 + payload_mass


def reduced_mass(effective_mass: Quantity, other_mass: float) -> Quantity:
    """Return mu = 1 / (1/m_R + 1/m_H) [kg] (Eq. 16) of two positive masses [kg], either of which may be infinite.

    A clamped body part has an infinite `other_mass`: mu is then `effective_mass`.
    """
    if math.isinf(other_mass):
        return effective_mass
    return 1.0 / (1.0 / effective_mass + 1.0 / other_mass)


def peak_force(speed: Quantity | float, reduced_mass: Quantity, stiffness: float) -> Quantity:
    """Return F = v sqrt(mu k) [N] for the relative speed [m/s], the reduced mass [kg] and the stiffness [N/m]."""
    force: Quantity = speed * (reduced_mass * stiffness) ** 0.5
    return force


def force_per_root_stiffness(speed: Quantity | float, reduced_mass: Quantity) -> Quantity:
    """Return F / sqrt(k) = v sqrt(mu) [m/s sqrt(kg)], over which measured peak forces lie on a straight line."""
    return peak_force(speed, reduced_mass, 1.0)


def transferred_energy(speed: Quantity | float, reduced_mass: Quantity) -> Quantity:
    """Return E = mu v^2 / 2 [J] for the relative speed [m/s] and the reduced mass [kg]."""
    energy: Quantity = 0.5 * reduced_mass * speed**2
    return energy


def amplification(damping: float, friction: float, *, is_clamped: bool = False) -> float:
    """Return the bound of the total peak force of a damped contact with friction over that of an elastic one without.

    `damping` is the largest ratio c / (2 sqrt(mu k)) of a Kelvin-Voigt contact. Its force starts at c v and never
    exceeds the larger one of c v and the peak without damping, on free joints and on a servo; the sum of both bounds
    that of a servo against a clamped body part (shown by simulation in the tests). Friction dissipates, so that the
    energy of the worst normal bounds the normal force as before; the total one is sqrt(1 + friction^2) times that.
    """
    damped = 1.0 + 2.0 * damping if is_clamped else max(1.0, 2.0 * damping)
    return damped * math.sqrt(1.0 + friction * friction)


def turn_until_peak(acceleration: float, body_mass: float, stiffness: float) -> float:
    """Return by how much [rad, m] a joint with this `acceleration` [rad/s2, m/s2] turns more than at constant velocity.

    The time is that to the peak, a quarter period of `body_mass` [kg] on `stiffness` [N/m]: of an immovable robot.
    """
    return 0.5 * acceleration * (0.5 * math.pi) ** 2 * body_mass / stiffness


def contact_time(reduced_mass: float, stiffness: float) -> float:
    """Return the time [s] for which a change of pose counts.

    It is TIME_FACTOR times the time to the peak, a quarter period of `reduced_mass` [kg] on `stiffness` [N/m], and at
    most TRANSIENT_S.
    """
    return min(TIME_FACTOR * 0.5 * math.pi * math.sqrt(reduced_mass / stiffness), TRANSIENT_S)
