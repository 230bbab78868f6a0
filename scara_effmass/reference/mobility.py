# SPDX-License-Identifier: Apache-2.0
"""Mobility A = J_v M^-1 J_v^T [1/kg] of a contact point (the inverse of Eqs. 3-4): masses and impulses of a contact.

Vectors are (3,) and matrices (3, 3), in base axes, but for `Mobility.values` (rank,) and `Mobility.axes` (3, rank).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from scara_effmass.reference.hull import Hull
from scara_effmass.values import FloatArray

CLAMPED_TOLERANCE = 1e-11
"""Ratio to the trace of a mobility, below which a direction counts as that much mobile against a clamped body part."""
REACH_TOLERANCE = 1e-6
"""Ratio to the trace of a mobility, below which a direction counts as that much mobile for errors of accelerations."""
BOUND_TOLERANCE = 1e-9
"""Ratio to the trace of a mobility, below which a difference of two mobilities is rounding."""
DIRECTION_ROUNDING = 1e-9
"""Length of the component of a unit vector up to which it is rounding."""
MAX_NEGATIVE = 1e-6
"""Ratio of a negative eigenvalue of a mobility to its trace, up to which it is rounding."""


def effective_mass(mobility: FloatArray, n: FloatArray) -> float:
    """Return m_n = 1 / (n^T A n) [kg] along the unit vector n (Eq. 8); infinite if no joint moves the point along n."""
    inverse = float(n @ mobility @ n)
    return 1.0 / inverse if inverse > 0.0 else math.inf


def worst_mass(mobility: FloatArray, rank: int) -> float:
    """Return the largest m_n [kg] over all n in the `rank` dimensions in which the point moves: 1 / min eigenvalue."""
    inverse = float(np.linalg.eigvalsh(mobility)[3 - rank])
    return 1.0 / inverse if inverse > 0.0 else math.inf


def is_definite(mobility: FloatArray, rank: int) -> bool:
    """Return whether no mass is negative; False for a mobility that is not finite."""
    trace = float(np.trace(mobility))
    return 0.0 < trace < math.inf and bool(np.linalg.eigvalsh(mobility)[3 - rank] > -MAX_NEGATIVE * trace)


def is_bounded(mobility: FloatArray, bound: FloatArray, factor: float) -> bool:
    """Return whether factor n^T A n <= n^T B n for every n, A the `mobility` and B the `bound`; False for NaN."""
    difference = bound - factor * mobility + BOUND_TOLERANCE * np.trace(bound) * np.eye(3)
    return bool(np.isfinite(difference).all() and np.linalg.eigvalsh(difference)[0] > 0.0)


@dataclass(frozen=True, slots=True)
class PoseChange:
    """Motion of a contact point after the first touch, while the joints move on.

    `speed` [m/s] is that along the direction of the contact, `mobility_rate` dA/dt [1/(kg s)]. `accelerations` [m/s2]
    are those of the point with free joints and at constant joint velocities, or the latter alone, if a controller holds
    each joint; also their opposites where the contact may be passed either way.
    """

    speed: float
    mobility_rate: FloatArray
    accelerations: tuple[FloatArray, ...]


@dataclass(frozen=True, slots=True)
class Acceleration:
    """Acceleration of a contact point that goes on through the contact.

    `shown` is J_v qdd (3,) [m/s2], that of the joint states; `held` is dJ_v/dt qd (3,), of which the change of pose
    counts what is positive. Besides, `error` [m/s2] counts in any direction: its sqrt(2 energy) is at most
    `error_root` [m/s2 sqrt(kg)], the sum of |error of qdd_j| sqrt(M_jj).
    """

    shown: FloatArray
    held: FloatArray
    error: float
    error_root: float

    def along(self, n: FloatArray) -> float:
        """Return d/dt of the speed along n [m/s2], without the part that the change of pose counts."""
        return float(n @ self.shown) + min(0.0, float(n @ self.held))

    def turned(self, n: FloatArray, *, either_way: bool) -> Acceleration:
        """Return that of a contact with the normal n alone, or with the larger one of n and -n `either_way`."""
        along = max(self.along(n), self.along(-n)) if either_way else self.along(n)
        return Acceleration(along * n, np.zeros(3), self.error, self.error_root)


NO_ACCELERATION = Acceleration(np.zeros(3), np.zeros(3), 0.0, 0.0)


def lasting_time(time: float, speed: float, rate: float) -> float:
    """Return for how much of the `time` [s] a point at `speed` [m/s] accelerates, which brakes at a `rate` below 0."""
    return time if rate >= 0.0 else min(time, -speed / rate)


@dataclass(frozen=True)
class Mobility:
    """Mobility A = U diag(a) U^T of a contact point that hits along the unit vector `direction` n.

    `values` are the eigenvalues a [1/kg] and `axes` U their directions, of the dimensions in which the point moves.
    `change` is that of the pose during the contact; None if it does not count. `across` [1/kg] is the mobility across
    the axes, which counts for the velocity of a person: 0 where the point does not move. With a `hull`, the point
    stands for the whole link.
    """

    values: FloatArray
    axes: FloatArray
    direction: FloatArray
    change: PoseChange | None = None
    across: float = 0.0
    acceleration: Acceleration = NO_ACCELERATION
    hull: Hull | None = None

    @classmethod
    def of_matrix(
        cls, matrix: FloatArray, direction: FloatArray, rank: int, change: PoseChange | None = None
    ) -> Mobility:
        """Return the mobility A = `matrix` of a point that moves in `rank` dimensions."""
        values, axes = np.linalg.eigh(matrix)
        return cls(values[3 - rank :], axes[:, 3 - rank :], direction, change)

    @classmethod
    def of_mass(cls, mass: float, direction: FloatArray, change: PoseChange | None = None) -> Mobility:
        """Return the mobility of one effective `mass` [kg], which may be infinite, along `direction`."""
        return cls(np.array([1.0 / mass]), direction[:, None], direction, change)

    @classmethod
    def of_any_direction(cls, mass: float, direction: FloatArray) -> Mobility:
        """Return the mobility of one effective `mass` [kg] that is the same in every direction."""
        return replace(cls.of_mass(mass, direction), across=1.0 / mass)

    @cached_property
    def trace(self) -> float:
        """Trace of A [1/kg]."""
        return float(self.values.sum())

    @cached_property
    def basis(self) -> FloatArray:
        """Orthonormal axes (3, 3): `axes`, then those of the dimensions in which the point does not move."""
        return np.hstack((self.axes, np.linalg.svd(self.axes)[0][:, len(self.values) :]))

    @cached_property
    def mass(self) -> float:
        """Effective mass [kg] along `direction` (Eq. 8)."""
        return self.effective_mass(self.direction)

    @cached_property
    def _parts(self) -> tuple[FloatArray, FloatArray | None]:
        """`_parts_of` the direction."""
        return self._parts_of(self.direction)

    def _parts_of(self, n: FloatArray) -> tuple[FloatArray, FloatArray | None]:
        """Return n (3,) along the axes (rank,), and what is out of their reach (3,); None for rounding."""
        along = self.axes.T @ n
        rest = n - self.axes @ along
        return along, rest if np.linalg.norm(rest) > DIRECTION_ROUNDING else None

    @cached_property
    def steady(self) -> Mobility:
        """The mobility of a robot that does not accelerate."""
        return replace(self, acceleration=NO_ACCELERATION)

    @property
    def worst_mass(self) -> float:
        """Largest effective mass [kg] over all directions."""
        inverse = float(self.values[0])
        return 1.0 / inverse if inverse > 0.0 else math.inf

    def effective_mass(self, n: FloatArray) -> float:
        """Return m_n [kg] along the unit vector n (Eq. 8)."""
        return effective_mass(self.axes * self.values @ self.axes.T, n)

    def with_masses(self, factor: float) -> Mobility:
        """Return the mobility of a robot whose masses are `factor` times as large: A / factor."""
        change = self.change and replace(self.change, mobility_rate=self.change.mobility_rate / factor)
        error_root = self.acceleration.error_root * math.sqrt(factor)
        acceleration = replace(self.acceleration, error_root=error_root)
        return replace(
            self,
            values=self.values / factor,
            change=change,
            across=self.across / factor,
            acceleration=acceleration,
            hull=self.hull and self.hull.with_masses(factor),
        )

    def along(self, normal: FloatArray, min_speed: float, *, either_way: bool) -> Mobility:
        """Return the mobility of a contact with the unit `normal`: n^T A n, at least `min_speed` [m/s] along it.

        `either_way`: the point may move with or against the normal, so that accelerations both ways count.
        """
        mass = self.effective_mass(normal)
        if self.change is None:
            return replace(Mobility.of_mass(mass, normal), acceleration=self.acceleration)
        speed = self.change.speed * float(self.direction @ normal)
        normal = -normal if speed < 0.0 else normal
        accelerations = self.change.accelerations
        if either_way:
            accelerations += tuple(-a for a in accelerations)
        change = replace(self.change, speed=max(abs(speed), min_speed), accelerations=accelerations)
        acceleration = self.acceleration.turned(normal, either_way=either_way)
        return replace(Mobility.of_mass(mass, normal, change), acceleration=acceleration)

    def impulse(self, alpha: float, beta: float = 1.0, n: FloatArray | None = None) -> FloatArray:
        """Return w = (alpha I + beta A)^-1 n [kg], the impulse of a sticking contact at unit speed; may be infinite.

        n is the direction of the contact if None.

        With alpha = 1/m_H and beta = 1 the body part m_H and the robot move on together. Against a clamped body part
        (alpha = 0) a direction that the point cannot reach counts as nearly rigid.
        """
        if len(self.values) > 1:
            alpha = max(alpha, CLAMPED_TOLERANCE * beta * self.trace)
        shares = alpha + beta * self.values
        if not (shares > 0.0).all():
            return np.full(3, math.inf)
        along, rest = self._parts if n is None else self._parts_of(n)
        w: FloatArray = self.axes @ (along / shares)
        return w if rest is None else w + rest / alpha

    def reduced_mass(self, alpha: float, beta: float = 1.0) -> float:
        """Return mu [kg] of the worst contact normal, and of a link a bound of that of every point of its hull.

        The energy anywhere on the link counts with the speed of the point that stands for it.
        """
        point = self.point_reduced_mass(alpha, beta)
        anywhere = None if point == math.inf else self.energy_anywhere(alpha, beta)
        return point if anywhere is None else max(point, anywhere(1.0, 0.0))

    def energy_anywhere(self, alpha: float, beta: float) -> Callable[[float, float], float] | None:
        """Return `Hull.energy_anywhere`; None for a point."""
        floor = CLAMPED_TOLERANCE * self.trace
        if self.hull is None:
            return None
        return self.hull.energy_anywhere(alpha, beta, self.point_reduced_mass(alpha, beta), floor)

    def point_reduced_mass(self, alpha: float, beta: float = 1.0) -> float:
        """Return mu = n^T (alpha I + beta A)^-1 n [kg], that of the worst contact normal.

        That is the largest (n.m)^2 / (alpha + beta m^T A m) over all unit normals m (the generalised Rayleigh
        quotient), so never less than that of m = n. The peak force of the worst normal is |v| sqrt(mu k), the energy
        of a sticking contact mu |v|^2 / 2. For one effective mass it is the mu of ISO/TS 15066 (Eq. 16).
        """
        w = self.impulse(alpha, beta)
        if not np.isfinite(w).all():
            return math.inf
        along = alpha + beta / self.mass
        return max(float(self.direction @ w), 1.0 / along if along > 0.0 else 0.0)

    def worst_normal(self, alpha: float) -> FloatArray:
        """Return the unit normal of the largest reduced mass, along (alpha I + A)^-1 n; n where that is infinite."""
        w = self.impulse(alpha)
        return w / np.linalg.norm(w) if np.isfinite(w).all() else self.direction

    def growth(self, alpha: float, beta: float) -> float:
        """Return d/dt ln(v^T (alpha I + beta A)^-1 v) [1/s] as the pose changes, without the terms that reduce it.

        With w = (alpha I + beta A)^-1 v the derivative is (2 w.a - beta w^T (dA/dt) w) / (v.w). The term of the
        accelerations a (the larger one) and that of dA/dt count only where they are positive.
        """
        if self.change is None:
            return 0.0
        w = self.impulse(alpha, beta)
        if not np.isfinite(w).all():
            return math.inf
        faster = max(0.0, *(float(w @ a) for a in self.change.accelerations))
        lighter = max(0.0, -beta * float(w @ self.change.mobility_rate @ w))
        return (2.0 * faster / self.change.speed + lighter) / float(self.direction @ w)

    def largest_mass(self, alpha: float, beta: float) -> float:
        """Return the largest eigenvalue [kg] of (alpha I + beta A)^-1; may be infinite."""
        least = alpha + beta * max(REACH_TOLERANCE * self.trace, float(self.values[0]))
        return 1.0 / least if least > 0.0 else math.inf

    def error_root(self, alpha: float, beta: float) -> float:
        """Return the largest sqrt(a^T K a) [m/s2 sqrt(kg)] of the error a of the acceleration, K as in `impulse`."""
        a = self.acceleration
        if not a.error > 0.0:
            return 0.0
        root = math.sqrt(self.largest_mass(alpha, beta)) * a.error
        return min(root, a.error_root / math.sqrt(beta)) if beta > 0.0 else root

    def gain(self, alpha: float, beta: float, time: float) -> float:
        """Return by how much [m/s] the speed counts as higher, because the point accelerates for `time` [s].

        That is |v + t a|_K - |v|_K over sqrt(mu), where |v|_K^2 = v^T K v is twice the energy of the worst normal.
        """
        a, n = self.acceleration, self.direction
        if len(self.values) == 1:
            return time * (max(0.0, a.along(n)) + a.error)
        w = self.impulse(alpha, beta)
        mu = float(n @ w)
        if self.change is None or not 0.0 < mu < math.inf:
            return 0.0
        speed = self.change.speed
        rest = a.shown - float(w @ a.shown) / mu * n
        across = math.sqrt(max(0.0, float(rest @ self.impulse(alpha, beta, rest)) / mu))
        rate = a.along(w) / mu
        lasting = lasting_time(time, speed, rate)
        shown = math.hypot(speed + lasting * rate, lasting * across) - speed
        return max(0.0, shown) + time * self.error_root(alpha, beta) / math.sqrt(mu)
