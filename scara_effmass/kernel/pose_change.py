# SPDX-License-Identifier: Apache-2.0
"""Change of pose during a contact: how fast the reduced mass grows. `reference.mobility` derives the equations."""

from __future__ import annotations

import math
from typing import NamedTuple

from scara_effmass.iso15066.contact import TIME_FACTOR, TRANSIENT_S
from scara_effmass.kernel.compiled import inlined
from scara_effmass.kernel.mobility import adjugate, along, determinant, inverse, shifted, trace
from scara_effmass.kernel.records import Mobility
from scara_effmass.kernel.spatial import (
    Matrix,
    dot,
    rotate,
    scale,
    scale_symmetric,
    set_matrix,
    sub,
    symmetric_product,
    vector,
    vector_at,
)
from scara_effmass.reference.mobility import CLAMPED_TOLERANCE
from scara_effmass.values import ZERO_VECTOR, FloatArray, Mobility6, Vector3


@inlined
def assign(out: FloatArray, a: Vector3) -> None:
    """Write an array (3,)."""
    out[0], out[1], out[2] = a


@inlined
def assign_symmetric(out: FloatArray, m: Mobility6) -> None:
    """Write an array (6,)."""
    out[0], out[1], out[2], out[3], out[4], out[5] = m


@inlined
def matrix_of(change: Mobility) -> Mobility6:
    """Return A."""
    m = change.matrix
    return m[0], m[1], m[2], m[3], m[4], m[5]


@inlined
def set_change(
    out: Mobility, m: Mobility6, n: Vector3, speed: float, powers: Matrix, free: Vector3, held: Vector3
) -> None:
    """Write the change of pose of a mobility whose rank is known."""
    assign(out.direction, n)
    assign(out.free, free)
    assign(out.held, held)
    assign_symmetric(out.matrix, m)
    set_matrix(out.powers, powers)
    out.speed, out.change_rank, out.either_way = speed, out.rank, False


@inlined
def turn_change(
    out: Mobility,
    normal: Vector3,
    min_speed: float,
    either_way: bool,  # noqa: FBT001 - compiled
) -> None:
    """Make the change that for a contact with this normal, at least `min_speed` along it, or `either_way`."""
    speed = out.speed * dot(vector(out.direction), normal)
    sign = -1.0 if speed < 0.0 else 1.0
    mobility = along(matrix_of(out), normal)
    assign_symmetric(out.matrix, (mobility, 0.0, 0.0, mobility, 0.0, mobility))
    assign(out.direction, scale(sign, normal))
    out.speed, out.change_rank, out.either_way = max(sign * speed, min_speed), 3, either_way


@inlined
def mass_matrix(change: Mobility, alpha: float, beta: float) -> Mobility6:
    """Return K = (alpha / beta 1 + A)^-1 [kg], of the adjugate in as many dimensions as the point moves in.

    For a beta of 0 it is 1.
    """
    if beta <= 0.0:
        return 1.0, 0.0, 0.0, 1.0, 0.0, 1.0
    m = matrix_of(change)
    s = max(alpha / beta, CLAMPED_TOLERANCE * trace(m))
    if change.change_rank == 1:
        mass = inverse(s + trace(m))
        return mass, 0.0, 0.0, mass, 0.0, mass
    if change.change_rank == 2:
        of_plane = m[3] + m[5], -m[1], -m[2], m[0] + m[5], -m[4], m[0] + m[3]
        numerator, denominator = shifted(of_plane, s), trace(adjugate(m)) + s * (s + trace(m))
    else:
        m = shifted(m, s)
        numerator = adjugate(m)
        denominator = determinant(m, numerator)
    return scale_symmetric(inverse(denominator), numerator)


@inlined
def growth(change: Mobility, k: Mobility6, beta: float) -> float:
    """Return d/dt ln(v^T (alpha 1 + beta A)^-1 v) [1/s] of the mass matrix `k`, without what lessens it."""
    n = vector(change.direction)
    x, energy_rate = symmetric_product(k, n), 0.0
    total = dot(n, x)
    if not 0.0 < total < math.inf:
        return math.inf
    if beta > 0.0:
        powers = vector_at(change.powers, 0), vector_at(change.powers, 1), vector_at(change.powers, 2)
        energy_rate = dot(x, rotate(powers, x))
    free, held = dot(x, vector(change.free)), dot(x, vector(change.held))
    if change.either_way:
        free, held = abs(free), abs(held)
    faster = max(0.0, free, held)
    rate: float = 2.0 * (faster / change.speed + max(0.0, -energy_rate)) / total
    return rate


class MassPolynomials(NamedTuple):
    """K n of K = (s + A)^-1 over s = least + t, t >= 0: (x0 + x1 t + x2 t^2) / (c0 + c1 t + c2 t^2 + c3 t^3).

    No coefficient of n^T x(t), nor of the denominator, is negative.
    """

    x0: Vector3
    x1: Vector3
    x2: Vector3
    denominator: tuple[float, float, float, float]


@inlined
def mass_polynomials(change: Mobility, least: float) -> MassPolynomials:
    """Return K n for every alpha / beta of at least `least` [1/kg], in as many dimensions as the point moves in."""
    n, m = vector(change.direction), matrix_of(change)
    s = max(least, CLAMPED_TOLERANCE * trace(m))
    if change.change_rank == 1:
        return MassPolynomials(n, ZERO_VECTOR, ZERO_VECTOR, (s + trace(m), 1.0, 0.0, 0.0))
    if change.change_rank == 2:
        of_plane = m[3] + m[5] + s, -m[1], -m[2], m[0] + m[5] + s, -m[4], m[0] + m[3] + s
        minors = trace(adjugate(m)) + s * (s + trace(m))
        return MassPolynomials(symmetric_product(of_plane, n), n, ZERO_VECTOR, (minors, s + s + trace(m), 1.0, 0.0))
    m = shifted(m, s)
    of_m = adjugate(m)
    x1 = sub(scale(trace(m), n), symmetric_product(m, n))
    return MassPolynomials(symmetric_product(of_m, n), x1, n, (determinant(m, of_m), trace(of_m), trace(m), 1.0))


@inlined
def quotient(part: float, whole: float) -> float:
    """Return part / whole, 0 for a negative part, and infinite where that is not a finite number."""
    if part <= 0.0:
        return 0.0
    return part / whole if part < math.inf and 0.0 < whole < math.inf else math.inf


@inlined
def max_share(change: Mobility, a: Vector3, masses: MassPolynomials) -> float:
    """Return a bound of x^T a / x^T n for every x of `masses`: the largest quotient of their coefficients."""
    n, largest = vector(change.direction), 0.0
    for x in (masses.x0, masses.x1, masses.x2):
        part = dot(x, a)
        largest = max(largest, quotient(abs(part) if change.either_way else part, dot(x, n)))
    return largest


@inlined
def max_growth(change: Mobility, masses: MassPolynomials) -> float:
    """Return a bound [1/s] of `growth` for every mass matrix of `masses`.

    A quotient of polynomials of t >= 0 whose denominator has no negative coefficient is at most the largest quotient of
    their coefficients.
    """
    n, (x, y, z, (c0, c1, c2, c3)) = vector(change.direction), masses
    powers = vector_at(change.powers, 0), vector_at(change.powers, 1), vector_at(change.powers, 2)
    of_x, of_y, of_z = rotate(powers, x), rotate(powers, y), rotate(powers, z)
    d0, d1, d2 = dot(n, x), dot(n, y), dot(n, z)
    loss = max(
        quotient(-dot(x, of_x), c0 * d0),
        quotient(-dot(x, of_y) - dot(y, of_x), c0 * d1 + c1 * d0),
        quotient(-dot(x, of_z) - dot(y, of_y) - dot(z, of_x), c0 * d2 + c1 * d1 + c2 * d0),
        quotient(-dot(y, of_z) - dot(z, of_y), c1 * d2 + c2 * d1 + c3 * d0),
        quotient(-dot(z, of_z), c2 * d2 + c3 * d1),
    )
    faster = max(max_share(change, vector(change.free), masses), max_share(change, vector(change.held), masses))
    bound: float = 2.0 * (faster / change.speed + loss)
    return bound


@inlined
def contact_time(reduced_mass: float, stiffness: float) -> float:
    """Return the time [s] for which the growth counts."""
    return min(TIME_FACTOR * 0.5 * math.pi * math.sqrt(reduced_mass / stiffness), TRANSIENT_S)
