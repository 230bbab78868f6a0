# SPDX-License-Identifier: Apache-2.0
"""Mobility of a contact point, and the reduced mass of its contact along the worst normal."""

from __future__ import annotations

import math
from typing import NamedTuple

from scara_effmass.iso15066.mobility_matrix import CLAMPED_TOLERANCE, Matrix
from scara_effmass.iso15066.pose_change import PoseChange
from scara_effmass.values import Vector3


class Mobility(NamedTuple):
    """Mobility A = J_v M^-1 J_v^T [1/kg] of a contact point, as the scalars that its contact forces depend on.

    `along` is n^T A n and `adjugate` n^T adj(A) n for the unit vector n of the velocity; `trace`, `minors` (sum of the
    principal minors) and `determinant` are the invariants of A, and `rank` is the number of dimensions in which the
    contact point can move: 1 for a single effective mass, as in ISO/TS 15066. `change` is the change of pose during
    the contact, None if it does not count.
    """

    along: float
    adjugate: float
    trace: float
    minors: float
    determinant: float
    rank: int
    change: PoseChange | None = None

    @classmethod
    def of_mass(cls, effective_mass: float) -> Mobility:
        """Return the mobility of one `effective_mass` [kg], which may be infinite, in the direction of the contact."""
        mobility = 1.0 / effective_mass
        return cls(mobility, 0.0, mobility, 0.0, 0.0, 1)

    @classmethod
    def of_matrix(cls, matrix: Matrix, direction: Vector3, rank: int, change: PoseChange | None = None) -> Mobility:
        """Return the scalars of A, a symmetric (3, 3) `matrix` [1/kg], for the unit vector `direction`."""
        (a, b, c), (_, d, e), (_, _, f) = matrix
        x, y, z = direction
        xx, yy, zz, xy, xz, yz = x * x, y * y, z * z, 2.0 * x * y, 2.0 * x * z, 2.0 * y * z
        # Entries of the adjugate.
        p, q, r = d * f - e * e, a * f - c * c, a * d - b * b
        s, t, u = c * e - b * f, b * e - c * d, b * c - a * e
        return cls(
            a * xx + d * yy + f * zz + b * xy + c * xz + e * yz,
            p * xx + q * yy + r * zz + s * xy + t * xz + u * yz,
            a + d + f,
            p + q + r,
            a * p + b * s + c * t,
            rank,
            change,
        )

    def along_normal(self) -> Mobility:
        """Return the mobility of a contact whose normal is that of `along`, whatever the velocity."""
        return Mobility(self.along, 0.0, self.along, 0.0, 0.0, 1, self.change)

    def worst_reduced_mass(self, alpha: float, beta: float = 1.0) -> float:
        """Return the largest (v.n)^2 / (alpha + beta n^T A n) over all unit normals n [kg], v the unit velocity.

        That is v^T (alpha I + beta A)^-1 v, the generalised Rayleigh quotient; with alpha = 1/m_H and beta = 1 it is
        the reduced mass of the peak force F = |v| sqrt(mu k) along the worst normal, and mu |v|^2 is twice the energy
        that a sticking contact absorbs. Where `alpha` is 0 (clamped), only directions that the contact point can reach
        count. Written with the adjugate: no decomposition, and one mobility serves every m_H.
        """
        if beta <= 0.0:
            return 1.0 / alpha if alpha > 0.0 else math.inf
        s = alpha / beta
        along, trace = self.along, self.trace
        if self.rank == 1:
            denominator, numerator = trace + s, 1.0
        else:
            s = max(s, CLAMPED_TOLERANCE * trace)
            numerator = trace - along + s
            denominator = self.minors + s * (trace + s)
            if self.rank > 2:
                numerator = self.adjugate + s * numerator
                denominator = self.determinant + s * denominator
        if denominator <= 0.0:
            return math.inf
        # Rounding must not take it below the value along the velocity.
        return max(numerator / denominator, 1.0 / (along + s) if along + s > 0.0 else 0.0) / beta
