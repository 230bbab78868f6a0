# SPDX-License-Identifier: Apache-2.0
"""Moves of a SCARA between joint positions (q1, q2, q3, q4) [rad, rad, m, rad], independent of the room `model`.

    x = l1 cos q1 + l2 cos(q1 + q2)        y = l1 sin q1 + l2 sin(q1 + q2)

The law of cosines gives q2 up to its sign, which is the elbow configuration. The right arm has q2 > 0: in the paper's
section 5, the right arm reaches (300, 200) mm with q = (-15.35, 98.08) deg.

A move is a path q(s), s from 0 to 1, with a time scaling s(t). It gives positions and their exact derivatives. Every
move starts and ends at rest, so consecutive moves are continuous in position and velocity.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from scara_effmass.errors import RobotError
from scara_effmass.values import FloatArray

L1 = 0.275
L2 = 0.275
"""Link lengths of the Omron i4-550L [m], from the paper."""

JointPositions = tuple[float, float, float, float]


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


def joint_positions_at(xy: tuple[float, float], elbow_config: ElbowConfig, q3: float) -> JointPositions:
    """Return the joint positions with the tool axis at `xy` [m] and the tool oriented as the base."""
    q1, q2 = inverse_kinematics(np.asarray(xy), elbow_config).tolist()
    return q1, q2, q3, q1 + q2


@dataclass(frozen=True, slots=True)
class TrapezoidalScaling:
    """Trapezoidal speed over a path of `length` [m]: `acceleration` [m/s2], constant `speed` [m/s], deceleration."""

    length: float
    speed: float
    acceleration: float

    @property
    def ramp(self) -> float:
        """Duration of the acceleration [s]."""
        return self.speed / self.acceleration

    @property
    def duration(self) -> float:
        """Duration of the move [s]."""
        return self.length / self.speed + self.ramp

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return s and ds/dt [1/s] at the times `t` (m,) [s], all between 0 and the duration."""
        # The profile is symmetric in time: mirror its second half.
        from_end = np.minimum(t, self.duration - t)
        ramping = from_end < self.ramp
        travelled = np.where(ramping, self.acceleration * from_end**2 / 2.0, self.speed * (from_end - self.ramp / 2.0))
        speed = np.where(ramping, self.acceleration * from_end, self.speed)
        s = travelled / self.length
        return np.where(t <= self.duration / 2.0, s, 1.0 - s), speed / self.length


@dataclass(frozen=True, slots=True)
class QuinticScaling:
    """The quintic polynomial with zero velocity and acceleration at both ends, over `duration` [s]."""

    duration: float

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return s and ds/dt [1/s] at the times `t` (m,) [s], all between 0 and the duration."""
        x = t / self.duration
        return x**3 * (10.0 - 15.0 * x + 6.0 * x**2), 30.0 * x**2 * (1.0 - x) ** 2 / self.duration


TimeScaling = TrapezoidalScaling | QuinticScaling


@dataclass(frozen=True, slots=True)
class JointMove:
    """A straight line in joint space."""

    start: JointPositions
    end: JointPositions
    time_scaling: TimeScaling

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return positions and velocities (m, 4) at the times `t` (m,)."""
        s, rate = self.time_scaling.at(t)
        travel = np.subtract(self.end, self.start)
        return np.asarray(self.start) + np.outer(s, travel), np.outer(rate, travel)


@dataclass(frozen=True, slots=True)
class LinearMove:
    """A straight line of the tool axis from `start` to `end` (x, y) [m]; a dwell if both are equal.

    Quill position and tool orientation are constant.
    """

    start: tuple[float, float]
    end: tuple[float, float]
    elbow_config: ElbowConfig
    q3: float
    time_scaling: TimeScaling

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return positions and velocities (m, 4) at the times `t` (m,)."""
        s, rate = self.time_scaling.at(t)
        travel = np.subtract(self.end, self.start)
        q12 = inverse_kinematics(np.asarray(self.start) + np.outer(s, travel), self.elbow_config)
        rates = joint_rates(q12, np.outer(rate, travel))
        # The last axis points down: q4 = q1 + q2 keeps the tool orientation.
        q = np.column_stack((q12, np.full(len(t), self.q3), q12.sum(axis=1)))
        return q, np.column_stack((rates, np.zeros(len(t)), rates.sum(axis=1)))


Move = JointMove | LinearMove


def sample_moves(moves: Sequence[Move], frequency: float) -> tuple[FloatArray, FloatArray]:
    """Return positions and velocities (m, 4) of consecutive `moves`, sampled at `frequency` [Hz].

    The first sample is the start of the first move; the last one is less than a period before the end.
    """
    ends = np.cumsum([move.time_scaling.duration for move in moves])
    times = np.arange(int(np.ceil(ends[-1] * frequency - 1e-9))) / frequency
    index = np.searchsorted(ends, times, side="right")
    parts = [move.at(times[index == i] - (ends[i] - move.time_scaling.duration)) for i, move in enumerate(moves)]
    q, qd = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return q, qd
