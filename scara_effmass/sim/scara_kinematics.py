"""Kinematics of the tool axis of a SCARA, inverted in closed form; written independently of the room `model`.

    x = l1 cos q1 + l2 cos(q1 + q2)        y = l1 sin q1 + l2 sin(q1 + q2)

Solved by the law of cosines for q2, whose sign is the arm: positive for the right arm, as in the paper, where
(300, 200) mm in the right arm is q = (-15.35, 98.08) deg.
"""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

from scara_effmass.errors import RobotError

if TYPE_CHECKING:
    from scara_effmass.values import FloatArray

L1 = 0.275
L2 = 0.275
"""Link lengths of the Omron i4-550L [m], from the paper."""


class ElbowConfig(Enum):
    """On which side the elbow is; the value is the sign of q2."""

    RIGHT = 1.0
    LEFT = -1.0


def inverse(xy: FloatArray, arm: ElbowConfig) -> FloatArray:
    """Return q1 and q2 [rad], shape (..., 2), that put the tool axis at `xy` (..., 2) [m].

    q1 lies in (-pi, pi]. Raises RobotError where `xy` is out of reach.
    """
    x, y = xy[..., 0], xy[..., 1]
    cosine = (x**2 + y**2 - L1**2 - L2**2) / (2.0 * L1 * L2)
    if np.any(np.abs(cosine) > 1.0):
        radius = np.hypot(x, y)
        reach = f"{abs(L1 - L2):.4f} to {L1 + L2:.4f} m"
        raise RobotError(f"radii from {radius.min():.4f} to {radius.max():.4f} m are asked for; {reach} are in reach")
    q2 = arm.value * np.arccos(cosine)
    q1 = np.arctan2(y, x) - np.arctan2(L2 * np.sin(q2), L1 + L2 * np.cos(q2))
    return np.stack((np.pi - (np.pi - q1) % (2.0 * np.pi), q2), axis=-1)


def inverse_velocity(q: FloatArray, velocity: FloatArray) -> FloatArray:
    """Return the rates of q1 and q2 [rad/s], shape (..., 2), that move the tool axis with `velocity` (..., 2) [m/s].

    Undefined, and infinite or NaN, at the singular poses sin q2 = 0.
    """
    q12 = q[..., 0] + q[..., 1]
    vx, vy = velocity[..., 0], velocity[..., 1]
    along_upper = vx * np.cos(q[..., 0]) + vy * np.sin(q[..., 0])
    along_lower = vx * np.cos(q12) + vy * np.sin(q12)
    sine = np.sin(q[..., 1])
    rate1 = along_lower / (L1 * sine)
    rate2 = -(L1 * along_upper + L2 * along_lower) / (L1 * L2 * sine)
    return np.stack((rate1, rate2), axis=-1)
