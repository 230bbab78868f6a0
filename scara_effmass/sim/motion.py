"""Moves between joint positions (q1, q2, q3, q4) [rad, rad, m, rad].

A move is a path q(s), s from 0 to 1, with a time scaling s(t). It gives positions and their exact derivatives. Every
move starts and ends at rest, so consecutive moves are continuous in position and velocity.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from scara_effmass.sim.scara_kinematics import ElbowConfig, inverse_kinematics, joint_rates
from scara_effmass.values import FloatArray

JointPositions = tuple[float, float, float, float]


class TimeScaling(Protocol):
    """A function s(t) from 0 to 1."""

    @property
    def duration(self) -> float:
        """Duration of the move [s]."""

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return s and ds/dt [1/s] at the times `t` (m,) [s], all between 0 and the duration."""


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
        """See `TimeScaling`."""
        return self.length / self.speed + self.ramp

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `TimeScaling`."""
        # The profile is symmetric in time: mirror its second half.
        from_end = np.minimum(t, self.duration - t)
        ramping = from_end < self.ramp
        travelled = np.where(ramping, self.acceleration * from_end**2 / 2.0, self.speed * (from_end - self.ramp / 2.0))
        speed = np.where(ramping, self.acceleration * from_end, self.speed)
        s = travelled / self.length
        return np.where(t <= self.duration / 2.0, s, 1.0 - s), speed / self.length


@dataclass(frozen=True, slots=True)
class QuinticScaling:
    """The quintic polynomial with zero velocity and acceleration at both ends."""

    duration: float

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `TimeScaling`."""
        x = t / self.duration
        return x**3 * (10.0 - 15.0 * x + 6.0 * x**2), 30.0 * x**2 * (1.0 - x) ** 2 / self.duration


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
    """A straight line of the tool axis from `start` to `end` (x, y) [m]; with equal ends, a dwell.

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


def joint_positions_at(xy: tuple[float, float], elbow_config: ElbowConfig, q3: float) -> JointPositions:
    """Return the joint positions with the tool axis at `xy` [m] and the tool oriented as the base."""
    q1, q2 = inverse_kinematics(np.asarray(xy), elbow_config).tolist()
    return q1, q2, q3, q1 + q2


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
