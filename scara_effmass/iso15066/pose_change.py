# SPDX-License-Identifier: Apache-2.0
"""Change of pose during a contact: how fast the force along the worst normal grows after the first touch."""

from __future__ import annotations

import math
from typing import NamedTuple

from scara_effmass.iso15066.contact import TIME_FACTOR, contact_time
from scara_effmass.iso15066.mobility_matrix import CLAMPED_TOLERANCE, Matrix, mobility_along
from scara_effmass.values import Vector3

__all__ = ["TIME_FACTOR", "PoseChange", "contact_time"]


class PoseChange(NamedTuple):
    """Motion of a contact point, and change of its mobility A, while the joints move on.

    `direction` n is the unit vector of the velocity or a fixed contact normal, and `speed` [m/s] the velocity along it.
    `mobility` is A [1/kg], and `mobility_rate` Z [1/(kg s)] with dA/dt = Z + Z^T. `accelerations` [m/s2] are those of
    the contact point with free joints, and with joints that keep their velocities. The point moves in `rank`
    dimensions, in which n is.
    """

    direction: Vector3
    speed: float
    mobility: Matrix
    mobility_rate: Matrix
    accelerations: tuple[Vector3, ...]
    rank: int = 3

    def growth(self, alpha: float, beta: float) -> float:
        """Return d/dt ln(v^T (alpha I + beta A)^-1 v) [1/s], without the terms that reduce it.

        With w = (alpha I + beta A)^-1 v the derivative is (2 w.a - beta w^T (dA/dt) w) / (v.w). The term of the
        accelerations a (the larger one) and that of the mobility count only where they are positive.
        """
        if beta <= 0.0:
            wx, wy, wz = self.direction
            along, energy_rate = 1.0, 0.0
        else:
            wx, wy, wz = self._solve(alpha / beta)
            nx, ny, nz = self.direction
            along = nx * wx + ny * wy + nz * wz
            if not 0.0 < along < math.inf:
                return math.inf
            (a, b, c), (d, e, f), (g, h, i) = self.mobility_rate
            energy_rate = wx * (a * wx + b * wy + c * wz) + wy * (d * wx + e * wy + f * wz)
            energy_rate += wz * (g * wx + h * wy + i * wz)
        faster = 0.0
        for ax, ay, az in self.accelerations:
            faster = max(faster, wx * ax + wy * ay + wz * az)
        return 2.0 * (faster / self.speed + max(0.0, -energy_rate)) / along

    def max_growth(self, alpha: float) -> float:
        """Return an upper bound [1/s] of `growth` for every alpha / beta >= `alpha` [1/kg], from norms of the vectors.

        The angle between w and v is largest at the smallest alpha / beta, and so is the reduced mass v.w.
        """
        wx, wy, wz = self._solve(alpha)
        nx, ny, nz = self.direction
        along = nx * wx + ny * wy + nz * wz
        if not 0.0 < along < math.inf:
            return math.inf
        (a, b, c), (d, e, f), (g, h, i) = self.mobility_rate
        rate = math.sqrt(a * a + b * b + c * c + d * d + e * e + f * f + g * g + h * h + i * i)
        square = (wx * wx + wy * wy + wz * wz) / (along * along)
        acceleration = math.sqrt(max([ax * ax + ay * ay + az * az for ax, ay, az in self.accelerations]))
        return 2.0 * (math.sqrt(square) * acceleration / self.speed + along * square * rate)

    def worst_normal(self, alpha: float) -> Vector3:
        """Return the unit normal (3,) along (alpha I + A)^-1 v; `direction` where that is singular."""
        x, y, z = self._solve(alpha)
        length = math.sqrt(x * x + y * y + z * z)
        return (x / length, y / length, z / length) if 0.0 < length < math.inf else self.direction

    def along(self, normal: Vector3, min_speed: float) -> PoseChange:
        """Return the change for a contact with this unit `normal` (3,), at least `min_speed` [m/s] along it."""
        x, y, z = self.direction
        nx, ny, nz = normal
        speed = self.speed * (x * nx + y * ny + z * nz)
        if speed < 0.0:
            speed, nx, ny, nz = -speed, -nx, -ny, -nz
        m = mobility_along(self.mobility, normal)
        mobility = [[m, 0.0, 0.0], [0.0, m, 0.0], [0.0, 0.0, m]]
        return PoseChange((nx, ny, nz), max(speed, min_speed), mobility, self.mobility_rate, self.accelerations)

    def _solve(self, s: float) -> Vector3:
        """Return (s I + A)^-1 n (3,) [kg], by the adjugate in `rank` dimensions: more would leave rounding errors."""
        (a, b, c), (_, d, e), (_, _, f) = self.mobility
        x, y, z = self.direction
        trace = a + d + f
        s = max(s, CLAMPED_TOLERANCE * trace)
        if self.rank == 1:
            p = q = r = 1.0
            t = u = v = 0.0
            determinant = s + trace
        elif self.rank == 2:
            p, q, r, t, u, v = s + d + f, s + a + f, s + a + d, -b, -c, -e
            determinant = a * d - b * b + a * f - c * c + d * f - e * e + s * (s + trace)
        else:
            a, d, f = a + s, d + s, f + s
            p, q, r = d * f - e * e, a * f - c * c, a * d - b * b
            t, u, v = c * e - b * f, b * e - c * d, b * c - a * e
            determinant = a * p + b * t + c * u
        if determinant <= 0.0:
            return math.inf, math.inf, math.inf
        return (
            (p * x + t * y + u * z) / determinant,
            (t * x + q * y + v * z) / determinant,
            (u * x + v * y + r * z) / determinant,
        )
