# SPDX-License-Identifier: Apache-2.0
"""Mobilities A = J_v M^-1 J_v^T of a contact point: effective masses and reduced masses.

`reference.mobility` derives the equations.
"""

from __future__ import annotations

import math

from scara_effmass.kernel.compiled import inlined
from scara_effmass.kernel.records import Mobility
from scara_effmass.kernel.spatial import dot, symmetric_product
from scara_effmass.reference.mobility import BOUND_TOLERANCE, CLAMPED_TOLERANCE, MAX_NEGATIVE
from scara_effmass.values import Mobility6, Vector3

_THIRD_TURN = 2.0 * math.pi / 3.0


@inlined
def along(m: Mobility6, n: Vector3) -> float:
    """Return n^T A n."""
    return dot(n, symmetric_product(m, n))


@inlined
def trace(m: Mobility6) -> float:
    """Return the sum of the eigenvalues."""
    return m[0] + m[3] + m[5]


@inlined
def adjugate(m: Mobility6) -> Mobility6:
    """Return the adjugate matrix."""
    a, b, c, d, e, f = m
    return d * f - e * e, c * e - b * f, b * e - c * d, a * f - c * c, b * c - a * e, a * d - b * b


@inlined
def determinant(m: Mobility6, of_adjugate: Mobility6) -> float:
    """Return the determinant, from the adjugate matrix."""
    return m[0] * of_adjugate[0] + m[1] * of_adjugate[1] + m[2] * of_adjugate[2]


@inlined
def shifted(m: Mobility6, s: float) -> Mobility6:
    """Return A + s 1."""
    return m[0] + s, m[1], m[2], m[3] + s, m[4], m[5] + s


@inlined
def inverse(mobility: float) -> float:
    """Return 1 / `mobility`, infinite unless that is positive."""
    return 1.0 / mobility if mobility > 0.0 else math.inf


@inlined
def smallest_eigenvalue(m: Mobility6, rank: int) -> float:
    """Return the smallest of the `rank` largest eigenvalues."""
    if rank == 1:
        return trace(m)
    mean = trace(m) / 3.0
    if rank == 2:
        minors = trace(adjugate(m))
        largest = 1.5 * mean + math.sqrt(max(2.25 * mean * mean - minors, 0.0))
        return minors / largest if largest > 0.0 else 0.0
    rest = shifted(m, -mean)
    a, b, c, d, e, f = rest
    spread = math.sqrt((a * a + d * d + f * f) / 6.0 + (b * b + c * c + e * e) / 3.0)
    cube = spread * spread * spread
    if cube == 0.0:
        return mean
    cosine = 0.5 * determinant(rest, adjugate(rest)) / cube
    return mean + 2.0 * spread * math.cos(math.acos(max(-1.0, min(1.0, cosine))) / 3.0 + _THIRD_TURN)


@inlined
def is_definite(m: Mobility6, rank: int) -> bool:
    """Return whether no mass is negative; False for a mobility that is not finite."""
    return 0.0 < trace(m) < math.inf and smallest_eigenvalue(m, rank) > -MAX_NEGATIVE * trace(m)


@inlined
def is_bounded(m: Mobility6, bound: Mobility6, factor: float) -> bool:
    """Return whether factor n^T A n <= n^T B n for every n: a Cholesky factorization of the difference."""
    slack = BOUND_TOLERANCE * trace(bound)
    b, c, e = bound[1] - factor * m[1], bound[2] - factor * m[2], bound[4] - factor * m[4]
    first = bound[0] - factor * m[0] + slack
    if not first > 0.0:
        return False
    second = bound[3] - factor * m[3] + slack - b * b / first
    e -= b * c / first
    return second > 0.0 and bound[5] - factor * m[5] + slack - c * c / first - e * e / second > 0.0


@inlined
def set_scalar(out: Mobility, mobility: float) -> None:
    """Write a mobility that is the same for every contact normal, or known for one."""
    out.along, out.adjugate, out.matrix_trace = mobility, 0.0, mobility
    out.minors, out.determinant, out.rank = 0.0, 0.0, 1


@inlined
def set_scalars(out: Mobility, m: Mobility6, n: Vector3, rank: int) -> None:
    """Write the scalars of A along `n`."""
    of_m = adjugate(m)
    out.along, out.adjugate, out.matrix_trace = along(m, n), along(of_m, n), trace(m)
    out.minors, out.determinant, out.rank = trace(of_m), determinant(m, of_m), rank


@inlined
def point_reduced_mass(m: Mobility, alpha: float, beta: float) -> float:
    """Return v^T (alpha 1 + beta A)^-1 v."""
    if beta <= 0.0:
        return inverse(alpha)
    s = alpha / beta
    if m.rank == 1:
        denominator, numerator = m.matrix_trace + s, 1.0
    else:
        s = max(s, CLAMPED_TOLERANCE * m.matrix_trace)
        numerator = m.matrix_trace - m.along + s
        denominator = m.minors + s * (m.matrix_trace + s)
        if m.rank > 2:
            numerator = m.adjugate + s * numerator
            denominator = m.determinant + s * denominator
    if denominator <= 0.0:
        return math.inf
    least = m.along + s
    mass: float = max(numerator / denominator, 1.0 / least if least > 0.0 else 0.0) / beta
    return mass
