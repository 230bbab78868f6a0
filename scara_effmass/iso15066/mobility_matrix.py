# SPDX-License-Identifier: Apache-2.0
"""Mobility A = J_v M^-1 J_v^T of a contact point as a symmetric (3, 3) matrix [1/kg], the inverse of Eqs. 3-4."""

from scara_effmass.values import Mobility6, Vector3

CLAMPED_TOLERANCE = 1e-11
"""Ratio to the trace of the mobility that counts as unreachable against a clamped body part."""
BOUND_TOLERANCE = 1e-9
"""Ratio to the trace of the mobility, below which a direction does not count in `is_bounded`: rounding."""

Matrix = list[list[float]]


def matrix_of(entries: Mobility6) -> Matrix:
    """Return the symmetric (3, 3) matrix of its `entries` xx, xy, xz, yy, yz, zz."""
    a, b, c, d, e, f = entries
    return [[a, b, c], [b, d, e], [c, e, f]]


def mobility_along(matrix: Matrix, direction: Vector3) -> float:
    """Return n^T A n [1/kg] of a symmetric (3, 3) `matrix` A for the unit vector `direction` n (3,)."""
    (a, b, c), (_, d, e), (_, _, f) = matrix
    x, y, z = direction
    return a * x * x + d * y * y + f * z * z + 2.0 * (b * x * y + c * x * z + e * y * z)


def is_bounded(matrix: Matrix, bound: Matrix, factor: float) -> bool:
    """Return whether factor n^T A n <= n^T B n for every n, of two symmetric (3, 3) matrices; False for NaN.

    By the pivots of B - factor A, `bound` B and `matrix` A, with a tolerance of 1e-9 of the trace of B.
    """
    (a, b, c), (_, d, e), (_, _, f) = matrix
    (p, q, r), (_, s, t), (_, _, u) = bound
    slack = BOUND_TOLERANCE * (p + s + u)
    b, c, e = q - factor * b, r - factor * c, t - factor * e
    first = p - factor * a + slack
    if not first > 0.0:
        return False
    second = s - factor * d + slack - b * b / first
    e -= b * c / first
    return second > 0.0 and u - factor * f + slack - c * c / first - e * e / second > 0.0
