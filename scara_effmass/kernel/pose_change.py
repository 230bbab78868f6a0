# SPDX-License-Identifier: Apache-2.0
"""Change of pose during a contact: how fast the reduced mass grows. `reference.mobility` derives the equations."""

from __future__ import annotations

import math

from scara_effmass.iso15066.contact import TIME_FACTOR, TRANSIENT_S
from scara_effmass.kernel.jit import inlined
from scara_effmass.kernel.mobility import adjugate, along, determinant, inverse, shifted, smallest_eigenvalue, trace
from scara_effmass.kernel.records import Mobility
from scara_effmass.kernel.spatial import (
    Matrix,
    dot,
    norm,
    rotate,
    scale,
    scale_symmetric,
    set_matrix,
    symmetric_product,
    vector,
    vector_at,
)
from scara_effmass.reference.mobility import CLAMPED_TOLERANCE
from scara_effmass.values import FloatArray, Mobility6, Vector3


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


@inlined
def max_growth(change: Mobility, x: Vector3) -> float:
    """Return a bound [1/s] of `growth` for every alpha / beta of at least that of `x`, its mass matrix times n."""
    total = dot(vector(change.direction), x)
    if not 0.0 < total < math.inf:
        return math.inf
    p = change.powers
    symmetric = (
        p[0, 0],
        0.5 * (p[0, 1] + p[1, 0]),
        0.5 * (p[0, 2] + p[2, 0]),
        p[1, 1],
        0.5 * (p[1, 2] + p[2, 1]),
        p[2, 2],
    )
    loss = max(0.0, -smallest_eigenvalue(symmetric, 3))
    acceleration = max(norm(vector(change.free)), norm(vector(change.held)))
    share = norm(x) / total
    bound: float = 2.0 * (share * acceleration / change.speed + total * share * share * loss)
    return bound


@inlined
def contact_time(reduced_mass: float, stiffness: float) -> float:
    """Return the time [s] for which the growth counts."""
    return min(TIME_FACTOR * 0.5 * math.pi * math.sqrt(reduced_mass / stiffness), TRANSIENT_S)
