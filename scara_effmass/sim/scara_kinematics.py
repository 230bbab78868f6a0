"""Inverse kinematics of a SCARA's tool axis in closed form, independent of the room `model`.

    x = l1 cos q1 + l2 cos(q1 + q2)        y = l1 sin q1 + l2 sin(q1 + q2)

The law of cosines gives q2 up to its sign, which is the elbow configuration. The right arm has q2 > 0: in the paper's
section 5, the right arm reaches (300, 200) mm with q = (-15.35, 98.08) deg.
"""

from enum import Enum

import numpy as np

from scara_effmass.errors import RobotError
from scara_effmass.values import FloatArray

L1 = 0.275
L2 = 0.275
"""Link lengths of the Omron i4-550L [m], from the paper."""


class ElbowConfig(Enum):
    """Right or left arm of a SCARA; the value is the sign of q2."""

    RIGHT = 1.0
    LEFT = -1.0


def inverse_kinematics(xy: FloatArray, elbow_config: ElbowConfig) -> FloatArray:
    """Return q1 and q2 [rad], shape (..., 2), with the tool axis at `xy` (..., 2) [m].

    q1 lies in (-pi, pi]. Raises RobotError where `xy` is out of reach.
    """
    x, y = xy[..., 0], xy[..., 1]
    cosine = (x**2 + y**2 - L1**2 - L2**2) / (2.0 * L1 * L2)
    if np.any(np.abs(cosine) > 1.0):
        radius = np.hypot(x, y)
        reach = f"{abs(L1 - L2):.4f} to {L1 + L2:.4f} m"
        raise RobotError(f"radius = {radius.min():.4f} to {radius.max():.4f} m: must be in reach, {reach}")
    q2 = elbow_config.value * np.arccos(cosine)
    q1 = np.arctan2(y, x) - np.arctan2(L2 * np.sin(q2), L1 + L2 * np.cos(q2))
    return np.stack((np.pi - (np.pi - q1) % (2.0 * np.pi), q2), axis=-1)


def joint_rates(q: FloatArray, velocity: FloatArray) -> FloatArray:
    """Return the rates of q1 and q2 [rad/s], shape (..., 2), for the tool velocity `velocity` (..., 2) [m/s].

    Infinite or NaN at the singular poses sin q2 = 0.
    """
    q12 = q[..., 0] + q[..., 1]
    vx, vy = velocity[..., 0], velocity[..., 1]
    along_upper = vx * np.cos(q[..., 0]) + vy * np.sin(q[..., 0])
    along_lower = vx * np.cos(q12) + vy * np.sin(q12)
    sine = np.sin(q[..., 1])
    rate1 = along_lower / (L1 * sine)
    rate2 = -(L1 * along_upper + L2 * along_lower) / (L1 * L2 * sine)
    return np.stack((rate1, rate2), axis=-1)
