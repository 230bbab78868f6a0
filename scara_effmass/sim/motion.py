"""Moves between poses (q1, q2, q3, q4) [rad, rad, m, rad]: where they lead, and when they are where.

A move is a path q(s), s from 0 to 1, and a time law s(t); positions come with their exact derivatives. Every move
begins and ends at rest, so moves in a row are continuous in position and velocity.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from scara_effmass.sim.scara_kinematics import inverse, inverse_velocity

if TYPE_CHECKING:
    from collections.abc import Sequence

    from scara_effmass.sim.scara_kinematics import ElbowConfig
    from scara_effmass.values import FloatArray

Pose = tuple[float, float, float, float]


class TimeLaw(Protocol):
    """How a move gets from s = 0 to s = 1."""

    @property
    def duration(self) -> float:
        """How long it takes [s]."""

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return s and ds/dt [1/s] at the times `t` (m,) [s], all between 0 and the duration."""


@dataclass(frozen=True, slots=True)
class Trapezoid:
    """Constant acceleration [m/s2], constant speed [m/s], constant deceleration over a path of `length` [m]."""

    length: float
    speed: float
    acceleration: float

    @property
    def ramp(self) -> float:
        """How long it accelerates [s]."""
        return self.speed / self.acceleration

    @property
    def duration(self) -> float:
        """See `TimeLaw`."""
        return self.length / self.speed + self.ramp

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `TimeLaw`."""
        # It is symmetric: the second half is the first one, seen from the end.
        from_end = np.minimum(t, self.duration - t)
        ramping = from_end < self.ramp
        travelled = np.where(ramping, self.acceleration * from_end**2 / 2.0, self.speed * (from_end - self.ramp / 2.0))
        speed = np.where(ramping, self.acceleration * from_end, self.speed)
        s = travelled / self.length
        return np.where(t <= self.duration / 2.0, s, 1.0 - s), speed / self.length


@dataclass(frozen=True, slots=True)
class Quintic:
    """The polynomial of least degree with velocity and acceleration zero at both ends."""

    duration: float

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `TimeLaw`."""
        x = t / self.duration
        return x**3 * (10.0 - 15.0 * x + 6.0 * x**2), 30.0 * x**2 * (1.0 - x) ** 2 / self.duration


@dataclass(frozen=True, slots=True)
class JointMove:
    """All joints in proportion from `start` to `end`."""

    start: Pose
    end: Pose
    law: TimeLaw

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return positions and velocities (m, 4) at the times `t` (m,)."""
        s, rate = self.law.at(t)
        travel = np.subtract(self.end, self.start)
        return np.asarray(self.start) + np.outer(s, travel), np.outer(rate, travel)


@dataclass(frozen=True, slots=True)
class LineMove:
    """The tool axis straight from `start` to `end` (x, y) [m], quill and tool orientation held; equal ends: a rest."""

    start: tuple[float, float]
    end: tuple[float, float]
    arm: ElbowConfig
    q3: float
    law: TimeLaw

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return positions and velocities (m, 4) at the times `t` (m,)."""
        s, rate = self.law.at(t)
        travel = np.subtract(self.end, self.start)
        q12 = inverse(np.asarray(self.start) + np.outer(s, travel), self.arm)
        rates = inverse_velocity(q12, np.outer(rate, travel))
        # The last axis points down, so the tool keeps its orientation while q4 = q1 + q2.
        q = np.column_stack((q12, np.full(len(t), self.q3), q12.sum(axis=1)))
        return q, np.column_stack((rates, np.zeros(len(t)), rates.sum(axis=1)))


Move = JointMove | LineMove


def pose_at(xy: tuple[float, float], arm: ElbowConfig, q3: float) -> Pose:
    """Return the pose with the tool axis at `xy` [m] and the tool's orientation that of the base."""
    q1, q2 = inverse(np.asarray(xy), arm).tolist()
    return q1, q2, q3, q1 + q2


def sampled(moves: Sequence[Move], frequency: float) -> tuple[FloatArray, FloatArray]:
    """Return positions and velocities (m, 4) of `moves`, one after the other, sampled at `frequency` [Hz].

    The first sample is the start of the first move, the last one lies less than a period before the end of the last.
    """
    ends = np.cumsum([move.law.duration for move in moves])
    times = np.arange(int(np.ceil(ends[-1] * frequency - 1e-9))) / frequency
    which = np.searchsorted(ends, times, side="right")
    parts = [move.at(times[which == number] - (ends[number] - move.law.duration)) for number, move in enumerate(moves)]
    q, qd = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return q, qd
