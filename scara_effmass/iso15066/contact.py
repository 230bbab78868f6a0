"""Mechanics of the contact: two masses and a linear spring (ISO/TS 15066:2016, Annex A)."""

from __future__ import annotations

import math
from typing import TypeVar

from scara_effmass.values import FloatArray

Quantity = TypeVar("Quantity", float, FloatArray)
"""One value, or an array of any shape; arrays in one call have the same shape."""


def reduced_mass(robot_mass: Quantity, obstacle_mass: float) -> Quantity:
    """Return mu = (1/m_R + 1/m_H)^-1 [kg] of two positive masses [kg], either of which may be infinite.

    A clamped body part is an infinite `obstacle_mass`: mu is then `robot_mass` itself.
    """
    if math.isinf(obstacle_mass):
        return robot_mass
    return 1.0 / (1.0 / robot_mass + 1.0 / obstacle_mass)


def peak_force(speed: Quantity | float, reduced_mass: Quantity, stiffness: float) -> Quantity:
    """Return F = v sqrt(mu k) [N], from the relative speed [m/s], the reduced mass [kg] and the stiffness [N/m]."""
    force: Quantity = speed * (reduced_mass * stiffness) ** 0.5
    return force


def transferred_energy(speed: Quantity | float, reduced_mass: Quantity) -> Quantity:
    """Return E = mu v^2 / 2 [J], from the relative speed [m/s] and the reduced mass [kg]."""
    energy: Quantity = 0.5 * reduced_mass * speed**2
    return energy
