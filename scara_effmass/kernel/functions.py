# SPDX-License-Identifier: Apache-2.0
"""Compiled functions: dynamics, speed limits and verdict of N joint states, a second way to the reference's numbers.

Spatial vectors are in base axes about the place of their joint, angular part first (R. Featherstone, "Rigid Body
Dynamics Algorithms", 2008). The Coriolis matrix C has dM/dt = C + C^T (S. Echeandia and P. Wensing, "Numerical methods
to compute the Coriolis matrix and Christoffel symbols for rigid-body systems", 2021), as Pinocchio's. The equations of
`model.dynamics`, `iso15066` and `safety.contact_assessor` are not derived again here.

All functions are in this file, because numba compiles again what its cache holds only if the file changes.
"""

# ruff: noqa: C901, FBT001, FBT003, PLR0912, PLR0915 - keywords cost compile time, and calls are inlined or cost time

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from scara_effmass.iso15066.contact import TRANSIENT_S
from scara_effmass.iso15066.drives import MAX_MOBILITY
from scara_effmass.iso15066.mobility_matrix import BOUND_TOLERANCE, CLAMPED_TOLERANCE
from scara_effmass.iso15066.pose_change import TIME_FACTOR
from scara_effmass.iso15066.speed_limit import MIN_EFFECTIVE_MASS
from scara_effmass.kernel.jit import compiled
from scara_effmass.kernel.records import (
    AUTO,
    CLAMPED,
    CLOSE,
    FAST,
    FIXED,
    FULL,
    HELD,
    ISO,
    LARGEST,
    LIGHT,
    LUMPED,
    MASSLESS,
    MASSLESS_JOINT,
    MIN_NORMAL_COMPONENT,
    NO_FORCE,
    NO_FULL,
    NO_LUMPED,
    NO_MASSES,
    NO_WORST,
    NOT_DEFINITE,
    NOT_THERE,
    OK,
    ROW,
    TOO_LIGHT,
    VELOCITY,
    VIOLATION,
    WARN,
    WHY_FULL,
    WHY_HEAVY,
    WHY_LARGEST,
    WHY_LIGHTER,
    WHY_SETTING,
    WORST,
    ByteArray,
    Case,
    Point,
    Row,
    Setup,
    Work,
    dtype_of,
)
from scara_effmass.model.dynamics import EIGENVALUE_ROUNDING, MAX_NEGATIVE, MIN_LEVER_M
from scara_effmass.values import FloatArray, Mobility6, Vector3

_THIRD_TURN = 2.0 * math.pi / 3.0
# Columns of a mobility: scalars of `iso15066.Mobility`, then of `PoseChange` (direction, speed, A, Z, accelerations).
# `_CHANGES` is the rank of its change of pose, 0 without one.
_ALONG, _ADJUGATE, _TRACE, _MINORS, _DETERMINANT, _RANK, _CHANGES = range(7)
_N, _SPEED, _A, _Z, _FREE, _HELD = 7, 10, 11, 17, 26, 29
CASE, POINT, SETUP, WORK = dtype_of(Case), dtype_of(Point), dtype_of(Setup), dtype_of(Work)


@compiled
def place_joints(q: FloatArray, setup: Setup, work: Work) -> None:
    """Write the poses of the joints, and in `motions` (n, 18) each joint's S, dS/dt and the velocity of its link."""
    rotations, places, motions = work.rotations, work.places, work.motions
    for j in range(setup.joints):
        parent, rotation, at = setup.parent[j], setup.rotation[j], setup.place[j]
        place, motion = places[j], motions[j]
        x, y, z = setup.axis[j, 0], setup.axis[j, 1], setup.axis[j, 2]
        s, c = math.sin(q[j]), math.cos(q[j])
        for a in range(3):
            r0, r1, r2, origin = rotation[a, 0], rotation[a, 1], rotation[a, 2], at[a]
            if parent >= 0:
                u, v, w = rotations[parent, a, 0], rotations[parent, a, 1], rotations[parent, a, 2]
                r0 = u * rotation[0, 0] + v * rotation[1, 0] + w * rotation[2, 0]
                r1 = u * rotation[0, 1] + v * rotation[1, 1] + w * rotation[2, 1]
                r2 = u * rotation[0, 2] + v * rotation[1, 2] + w * rotation[2, 2]
                origin = places[parent, a] + u * at[0] + v * at[1] + w * at[2]
            axis = r0 * x + r1 * y + r2 * z
            if setup.is_revolute[j]:
                place[a], motion[a], motion[3 + a] = origin, axis, 0.0
                along_axis = (1.0 - c) * axis
                rotations[j, a, 0] = c * r0 + along_axis * x + s * (r1 * z - r2 * y)
                rotations[j, a, 1] = c * r1 + along_axis * y + s * (r2 * x - r0 * z)
                rotations[j, a, 2] = c * r2 + along_axis * z + s * (r0 * y - r1 * x)
            else:
                place[a], motion[a], motion[3 + a] = origin + axis * q[j], 0.0, axis
                rotations[j, a, 0], rotations[j, a, 1], rotations[j, a, 2] = r0, r1, r2
        wx = wy = wz = vx = vy = vz = 0.0
        if parent >= 0:
            before = motions[parent]
            wx, wy, wz = before[12], before[13], before[14]
            dx, dy, dz = place[0] - places[parent, 0], place[1] - places[parent, 1], place[2] - places[parent, 2]
            vx, vy, vz = before[15] + wy * dz - wz * dy, before[16] + wz * dx - wx * dz, before[17] + wx * dy - wy * dx
        x, y, z, u, v, w = motion[0], motion[1], motion[2], motion[3], motion[4], motion[5]
        motion[6], motion[7], motion[8] = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x
        motion[9] = wy * w - wz * v + vy * z - vz * y
        motion[10] = wz * u - wx * w + vz * x - vx * z
        motion[11] = wx * v - wy * u + vx * y - vy * x
        rate = work.qd[j]
        motion[12], motion[13], motion[14] = wx + rate * x, wy + rate * y, wz + rate * z
        motion[15], motion[16], motion[17] = vx + rate * u, vy + rate * v, vz + rate * w


@compiled
def place_bodies(k: int, setup: Setup, work: Work) -> None:
    """Write in `inertias` (n, 10) mass, first moments, and moments xx, xy, xz, yy, yz, zz about its place."""
    for j in range(setup.joints):
        r, out, lever, inertia = work.rotations[j], work.inertias[k, j], setup.lever[k, j], setup.inertia[k, j]
        m = setup.mass[k, j]
        a, b, c, d, e, f = inertia[0, 0], inertia[0, 1], inertia[0, 2], inertia[1, 1], inertia[1, 2], inertia[2, 2]
        r0, r1, r2 = r[0, 0], r[0, 1], r[0, 2]
        s0, s1, s2 = r[1, 0], r[1, 1], r[1, 2]
        t0, t1, t2 = r[2, 0], r[2, 1], r[2, 2]
        x = r0 * lever[0] + r1 * lever[1] + r2 * lever[2]
        y = s0 * lever[0] + s1 * lever[1] + s2 * lever[2]
        z = t0 * lever[0] + t1 * lever[1] + t2 * lever[2]
        out[0], out[1], out[2], out[3] = m, m * x, m * y, m * z
        u, v, w = r0 * a + r1 * b + r2 * c, r0 * b + r1 * d + r2 * e, r0 * c + r1 * e + r2 * f
        out[4] = u * r0 + v * r1 + w * r2 + m * (y * y + z * z)
        out[5] = u * s0 + v * s1 + w * s2 - m * x * y
        out[6] = u * t0 + v * t1 + w * t2 - m * x * z
        u, v, w = s0 * a + s1 * b + s2 * c, s0 * b + s1 * d + s2 * e, s0 * c + s1 * e + s2 * f
        out[7] = u * s0 + v * s1 + w * s2 + m * (x * x + z * z)
        out[8] = u * t0 + v * t1 + w * t2 - m * y * z
        u, v, w = t0 * a + t1 * b + t2 * c, t0 * b + t1 * d + t2 * e, t0 * c + t1 * e + t2 * f
        out[9] = u * t0 + v * t1 + w * t2 + m * (x * x + y * y)


@compiled
def shift_inertia(inertia: FloatArray, total: FloatArray, place: FloatArray, to: FloatArray) -> None:
    """Add to `total` an inertia about `place` as one about `to`: moments about a far point would cancel."""
    x, y, z = place[0] - to[0], place[1] - to[1], place[2] - to[2]
    m, h0, h1, h2 = inertia[0], inertia[1], inertia[2], inertia[3]
    total[0], total[1], total[2], total[3] = (
        total[0] + m,
        total[1] + h0 + m * x,
        total[2] + h1 + m * y,
        total[3] + h2 + m * z,
    )
    p, q, r = x * (2.0 * h0 + m * x), y * (2.0 * h1 + m * y), z * (2.0 * h2 + m * z)
    total[4] += inertia[4] + q + r
    total[5] += inertia[5] - x * h1 - y * h0 - m * x * y
    total[6] += inertia[6] - x * h2 - z * h0 - m * x * z
    total[7] += inertia[7] + p + r
    total[8] += inertia[8] - y * h2 - z * h1 - m * y * z
    total[9] += inertia[9] + p + q


@compiled
def momentum_of(c: FloatArray, motion: FloatArray) -> Mobility6:
    """Return the momentum of an inertia `c`, as in `inertias`, on a spatial `motion` about the same place."""
    x, y, z, u, v, w = motion[0], motion[1], motion[2], motion[3], motion[4], motion[5]
    return (
        c[4] * x + c[5] * y + c[6] * z + c[2] * w - c[3] * v,
        c[5] * x + c[7] * y + c[8] * z + c[3] * u - c[1] * w,
        c[6] * x + c[8] * y + c[9] * z + c[1] * v - c[2] * u,
        c[0] * u + y * c[3] - z * c[2],
        c[0] * v + z * c[1] - x * c[3],
        c[0] * w + x * c[2] - y * c[1],
    )


@compiled
def power(motion: FloatArray, at: FloatArray, force: Mobility6, place: Vector3) -> float:
    """Return the power of a spatial `force` about `place` on a `motion` about `at`."""
    a, b, c, d, e, f = force
    x, y, z = place[0] - at[0], place[1] - at[1], place[2] - at[2]
    total: float = motion[0] * (a + y * f - z * e) + motion[1] * (b + z * d - x * f) + motion[2] * (c + x * e - y * d)
    total += motion[3] * d + motion[4] * e + motion[5] * f
    return total


@compiled
def fill_mass_matrix(k: int, setup: Setup, work: Work) -> None:
    """Write M (n, n) in the upper half of `factors`, `composites` (n, 22) of the subtrees, and their `momenta`."""
    n, motions, composites, matrix = setup.joints, work.motions, work.composites[k], work.factors[k]
    for i in range(n):
        for j in range(i, n):
            matrix[i, j] = setup.coupling[i, j]
        for a in range(10):
            composites[i, a] = work.inertias[k, i, a]
    for i in range(n - 1, -1, -1):
        c, s, place, parent = composites[i], motions[i], work.places[i], setup.parent[i]
        if parent >= 0:
            shift_inertia(c, composites[parent], place, work.places[parent])
        momentum = momentum_of(c, s[:6])
        for a in range(6):
            work.momenta[k, i, a] = momentum[a]
        at, j = (place[0], place[1], place[2]), i
        while j >= 0:
            matrix[j, i] += power(motions[j], work.places[j], momentum, at)
            j = setup.parent[j]
        matrix[i, i] += setup.armature[k, i]
        work.diagonals[k, i] = matrix[i, i]


@compiled
def fill_coriolis_matrix(k: int, setup: Setup, work: Work) -> None:
    """Write C (n, n), after `fill_mass_matrix`.

    A link with the velocity field w x r + v adds the force w' x p, with its momentum p, and the torque N w' to the
    motion (w', v') of a joint: N = (h.v) 1 - v h^T - w x P, with the first moment h and P, the sum of m r r^T.
    """
    n, motions, composites, matrix = setup.joints, work.motions, work.composites[k], work.coriolis[k]
    for i in range(n):
        for j in range(n):
            matrix[i, j] = 0.0
        c, b, s = composites[i], work.inertias[k, i], motions[i]
        w0, w1, w2, v0, v1, v2 = s[12], s[13], s[14], s[15], s[16], s[17]
        h0, h1, h2 = b[1], b[2], b[3]
        c[10], c[11], c[12] = (
            b[0] * v0 + w1 * h2 - w2 * h1,
            b[0] * v1 + w2 * h0 - w0 * h2,
            b[0] * v2 + w0 * h1 - w1 * h0,
        )
        half = 0.5 * (b[4] + b[7] + b[9])
        p0, p1, p2, p3, p4, p5 = half - b[4], -b[5], -b[6], half - b[7], -b[8], half - b[9]
        c[13] = h1 * v1 + h2 * v2 + w2 * p1 - w1 * p2
        c[14] = w2 * p3 - w1 * p4 - v0 * h1
        c[15] = w2 * p4 - w1 * p5 - v0 * h2
        c[16] = w0 * p2 - w2 * p0 - v1 * h0
        c[17] = h0 * v0 + h2 * v2 + w0 * p4 - w2 * p1
        c[18] = w0 * p5 - w2 * p2 - v1 * h2
        c[19] = w1 * p0 - w0 * p1 - v2 * h0
        c[20] = w1 * p1 - w0 * p3 - v2 * h1
        c[21] = h0 * v0 + h1 * v1 + w1 * p2 - w0 * p4
    for i in range(n - 1, -1, -1):
        c, s, u = composites[i], motions[i], work.momenta[k, i]
        parent = setup.parent[i]
        if parent >= 0:
            d = composites[parent]
            x, y, z = (
                work.places[i, 0] - work.places[parent, 0],
                work.places[i, 1] - work.places[parent, 1],
                work.places[i, 2] - work.places[parent, 2],
            )
            d[10], d[11], d[12] = d[10] + c[10], d[11] + c[11], d[12] + c[12]
            d[13] += c[13] + y * c[11] + z * c[12]
            d[14] += c[14] - c[10] * y
            d[15] += c[15] - c[10] * z
            d[16] += c[16] - c[11] * x
            d[17] += c[17] + x * c[10] + z * c[12]
            d[18] += c[18] - c[11] * z
            d[19] += c[19] - c[12] * x
            d[20] += c[20] - c[12] * y
            d[21] += c[21] + x * c[10] + y * c[11]
        force = momentum_of(c, s[6:12])
        force = (
            force[0] + c[13] * s[0] + c[14] * s[1] + c[15] * s[2],
            force[1] + c[16] * s[0] + c[17] * s[1] + c[18] * s[2],
            force[2] + c[19] * s[0] + c[20] * s[1] + c[21] * s[2],
            force[3] + s[1] * c[12] - s[2] * c[11],
            force[4] + s[2] * c[10] - s[0] * c[12],
            force[5] + s[0] * c[11] - s[1] * c[10],
        )
        product_x = c[11] * s[5] - c[12] * s[4] + c[13] * s[0] + c[16] * s[1] + c[19] * s[2]
        product_y = c[12] * s[3] - c[10] * s[5] + c[14] * s[0] + c[17] * s[1] + c[20] * s[2]
        product_z = c[10] * s[4] - c[11] * s[3] + c[15] * s[0] + c[18] * s[1] + c[21] * s[2]
        momentum = u[0], u[1], u[2], u[3], u[4], u[5]
        at, j = (work.places[i, 0], work.places[i, 1], work.places[i, 2]), i
        while j >= 0:
            t = motions[j]
            matrix[j, i] = power(t, work.places[j], force, at)
            if i != j:
                matrix[i, j] = power(t[6:12], work.places[j], momentum, at)
                matrix[i, j] += t[0] * product_x + t[1] * product_y + t[2] * product_z
            j = setup.parent[j]


@compiled
def factorize(k: int, n: int, work: Work) -> None:
    """Put U D U^T of M (n, n) in its place, from the last joint to the first: D^-1 on the diagonal, U above it."""
    factors = work.factors[k]
    for i in range(n - 1, -1, -1):
        scale = 1.0 / factors[i, i]
        for j in range(i):
            share = factors[j, i] * scale
            for h in range(j + 1):
                factors[h, j] -= share * factors[h, i]
        for j in range(i):
            factors[j, i] *= scale
        factors[i, i] = scale


@compiled
def respond(k: int, n: int, work: Work) -> Mobility6:
    """Write M^-1 J_v^T transposed (3, n), with the factors of M; return J_v M^-1 J_v^T."""
    factors, jacobian, responses = work.factors[k], work.jacobian, work.responses[k]
    for i in range(n - 1, -1, -1):
        x, y, z = jacobian[0, i], jacobian[1, i], jacobian[2, i]
        for j in range(i + 1, n):
            factor = factors[i, j]
            x -= factor * responses[0, j]
            y -= factor * responses[1, j]
            z -= factor * responses[2, j]
        responses[0, i], responses[1, i], responses[2, i] = x, y, z
    for i in range(n):
        scale = factors[i, i]
        x, y, z = scale * responses[0, i], scale * responses[1, i], scale * responses[2, i]
        for j in range(i):
            factor = factors[j, i]
            x -= factor * responses[0, j]
            y -= factor * responses[1, j]
            z -= factor * responses[2, j]
        responses[0, i], responses[1, i], responses[2, i] = x, y, z
    return symmetric(n, jacobian, responses)


@compiled
def symmetric(n: int, left: FloatArray, right: FloatArray) -> Mobility6:
    """Return xx, xy, xz, yy, yz, zz of the product of `left` and the transpose of `right`, both (3, n)."""
    a = b = c = d = e = f = 0.0
    for i in range(n):
        x, y, z = left[0, i], left[1, i], left[2, i]
        u, v, w = right[0, i], right[1, i], right[2, i]
        a += x * u
        b += x * v
        c += x * w
        d += y * v
        e += y * w
        f += z * w
    return a, b, c, d, e, f


@compiled
def fill_jacobian(point: Point, setup: Setup, work: Work) -> Vector3:
    """Write J_v and dJ_v/dt (3, n) of a contact point; return its velocity [m/s]."""
    j = point.joint
    pose, places, motions, qd = work.rotations[j], work.places, work.motions, work.qd
    jacobian, rate = work.jacobian, work.jacobian_rate
    px, py, pz = point.place[0], point.place[1], point.place[2]
    x = places[j, 0] + pose[0, 0] * px + pose[0, 1] * py + pose[0, 2] * pz
    y = places[j, 1] + pose[1, 0] * px + pose[1, 1] * py + pose[1, 2] * pz
    z = places[j, 2] + pose[2, 0] * px + pose[2, 1] * py + pose[2, 2] * pz
    for a in range(3):
        for i in range(setup.joints):
            jacobian[a, i] = rate[a, i] = 0.0
    vx = vy = vz = 0.0
    while j >= 0:
        s = motions[j]
        if setup.is_revolute[j]:
            rx, ry, rz = x - places[j, 0], y - places[j, 1], z - places[j, 2]
            jacobian[0, j] = s[1] * rz - s[2] * ry
            jacobian[1, j] = s[2] * rx - s[0] * rz
            jacobian[2, j] = s[0] * ry - s[1] * rx
        else:
            for a in range(3):
                jacobian[a, j] = s[3 + a]
        vx += jacobian[0, j] * qd[j]
        vy += jacobian[1, j] * qd[j]
        vz += jacobian[2, j] * qd[j]
        j = setup.parent[j]
    j = point.joint
    while j >= 0:
        s = motions[j]
        rx, ry, rz = x - places[j, 0], y - places[j, 1], z - places[j, 2]
        rate[0, j] = s[9] + s[7] * rz - s[8] * ry + s[1] * vz - s[2] * vy
        rate[1, j] = s[10] + s[8] * rx - s[6] * rz + s[2] * vx - s[0] * vz
        rate[2, j] = s[11] + s[6] * ry - s[7] * rx + s[0] * vy - s[1] * vx
        j = setup.parent[j]
    return vx, vy, vz


@compiled
def along(m: Mobility6, n: Vector3) -> float:
    """Return n^T A n."""
    x, y, z = n
    return m[0] * x * x + m[3] * y * y + m[5] * z * z + 2.0 * (m[1] * x * y + m[2] * x * z + m[4] * y * z)


@compiled
def inverse(mobility: float) -> float:
    """Return 1 / `mobility`, infinite unless that is positive."""
    return 1.0 / mobility if mobility > 0.0 else math.inf


@compiled
def smallest_eigenvalue(m: Mobility6, rank: int) -> float:
    """Return the smallest of the `rank` largest eigenvalues."""
    a, b, c, d, e, f = m
    mean = (a + d + f) / 3.0
    if rank == 1:
        return 3.0 * mean
    if rank == 2:
        minors = a * d - b * b + a * f - c * c + d * f - e * e
        largest = 1.5 * mean + math.sqrt(max(2.25 * mean * mean - minors, 0.0))
        return minors / largest if largest > 0.0 else 0.0
    a, d, f = a - mean, d - mean, f - mean
    spread = math.sqrt((a * a + d * d + f * f) / 6.0 + (b * b + c * c + e * e) / 3.0)
    cube = spread * spread * spread
    if cube == 0.0:
        return mean
    determinant = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
    third = math.acos(max(-1.0, min(1.0, 0.5 * determinant / cube))) / 3.0
    return mean + 2.0 * spread * math.cos(third + _THIRD_TURN)


@compiled
def is_definite(m: Mobility6, rank: int) -> bool:
    """Return whether no mass is negative; False for a mobility that is not finite."""
    trace = m[0] + m[3] + m[5]
    return 0.0 < trace < math.inf and smallest_eigenvalue(m, rank) > -MAX_NEGATIVE * trace


@compiled
def is_bounded(m: Mobility6, bound: Mobility6, factor: float) -> bool:
    """Return whether factor n^T A n <= n^T B n for every n."""
    slack = BOUND_TOLERANCE * (bound[0] + bound[3] + bound[5])
    b, c, e = bound[1] - factor * m[1], bound[2] - factor * m[2], bound[4] - factor * m[4]
    first = bound[0] - factor * m[0] + slack
    if not first > 0.0:
        return False
    second = bound[3] - factor * m[3] + slack - b * b / first
    e -= b * c / first
    return second > 0.0 and bound[5] - factor * m[5] + slack - c * c / first - e * e / second > 0.0


@compiled
def set_scalar(out: FloatArray, mobility: float) -> None:
    """Write a mobility that is the same for every contact normal, or known for one."""
    out[_ALONG], out[_ADJUGATE], out[_TRACE] = mobility, 0.0, mobility
    out[_MINORS], out[_DETERMINANT], out[_RANK] = 0.0, 0.0, 1.0


@compiled
def set_matrix(out: FloatArray, m: Mobility6, n: Vector3, rank: int) -> None:
    """Write the scalars of A along `n`."""
    a, b, c, d, e, f = m
    x, y, z = n
    xx, yy, zz, xy, xz, yz = x * x, y * y, z * z, 2.0 * x * y, 2.0 * x * z, 2.0 * y * z
    p, q, r = d * f - e * e, a * f - c * c, a * d - b * b
    s, t, u = c * e - b * f, b * e - c * d, b * c - a * e
    out[_ALONG] = a * xx + d * yy + f * zz + b * xy + c * xz + e * yz
    out[_ADJUGATE] = p * xx + q * yy + r * zz + s * xy + t * xz + u * yz
    out[_TRACE], out[_MINORS], out[_DETERMINANT], out[_RANK] = a + d + f, p + q + r, a * p + b * s + c * t, rank


@compiled
def set_change(out: FloatArray, m: Mobility6, n: Vector3, speed: float, k: int, size: int, work: Work) -> None:
    """Write the change of pose, with K = dJ/dt - J M^-1 C in `work.rate` (3, n); `_HELD` is that of a held velocity."""
    qd, responses = work.qd, work.responses[k]
    for a in range(3):
        free = held = x = y = z = 0.0
        for i in range(size):
            rate = work.rate[a, i]
            free += rate * qd[i]
            held += work.jacobian_rate[a, i] * qd[i]
            x += rate * responses[0, i]
            y += rate * responses[1, i]
            z += rate * responses[2, i]
        out[_N + a], out[_FREE + a], out[_HELD + a] = n[a], free, held
        out[_Z + 3 * a], out[_Z + 3 * a + 1], out[_Z + 3 * a + 2] = x, y, z
    for a in range(6):
        out[_A + a] = m[a]
    out[_SPEED], out[_CHANGES] = speed, out[_RANK]


@compiled
def turn_change(out: FloatArray, normal: Vector3, min_speed: float) -> None:
    """Make the change that for a contact with this normal, at least `min_speed` along it."""
    speed = out[_SPEED] * (out[_N] * normal[0] + out[_N + 1] * normal[1] + out[_N + 2] * normal[2])
    sign = -1.0 if speed < 0.0 else 1.0
    m = out[_A : _A + 6]
    mobility = along((m[0], m[1], m[2], m[3], m[4], m[5]), normal)
    m[0], m[1], m[2], m[3], m[4], m[5] = mobility, 0.0, 0.0, mobility, 0.0, mobility
    for a in range(3):
        out[_N + a] = sign * normal[a]
    out[_SPEED], out[_CHANGES] = max(sign * speed, min_speed), 3.0


@compiled
def worst_reduced_mass(m: FloatArray, alpha: float, beta: float) -> float:
    """Return v^T (alpha I + beta A)^-1 v."""
    if beta <= 0.0:
        return inverse(alpha)
    s = alpha / beta
    trace = m[_TRACE]
    if m[_RANK] == 1.0:
        denominator, numerator = trace + s, 1.0
    else:
        s = max(s, CLAMPED_TOLERANCE * trace)
        numerator = trace - m[_ALONG] + s
        denominator = m[_MINORS] + s * (trace + s)
        if m[_RANK] > 2.0:
            numerator = m[_ADJUGATE] + s * numerator
            denominator = m[_DETERMINANT] + s * denominator
    if denominator <= 0.0:
        return math.inf
    least = m[_ALONG] + s
    mass: float = max(numerator / denominator, 1.0 / least if least > 0.0 else 0.0) / beta
    return mass


@compiled
def solve_mobility(change: FloatArray, s: float) -> Vector3:
    """Return (s I + A)^-1 n [kg], with the adjugate in as many dimensions as the point moves in."""
    a, b, c, d, e, f = change[_A], change[_A + 1], change[_A + 2], change[_A + 3], change[_A + 4], change[_A + 5]
    x, y, z = change[_N], change[_N + 1], change[_N + 2]
    trace = a + d + f
    s = max(s, CLAMPED_TOLERANCE * trace)
    if change[_CHANGES] == 1.0:
        mass = inverse(s + trace)
        return mass * x, mass * y, mass * z
    if change[_CHANGES] == 2.0:
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


@compiled
def growth(change: FloatArray, alpha: float, beta: float) -> float:
    """Return d/dt ln(v^T (alpha I + beta A)^-1 v) [1/s], without what lessens it."""
    x, y, z = change[_N], change[_N + 1], change[_N + 2]
    total, energy_rate = 1.0, 0.0
    if beta > 0.0:
        nx, ny, nz = x, y, z
        x, y, z = solve_mobility(change, alpha / beta)
        total = nx * x + ny * y + nz * z
        if not 0.0 < total < math.inf:
            return math.inf
        r = change[_Z : _Z + 9]
        energy_rate = x * (r[0] * x + r[1] * y + r[2] * z) + y * (r[3] * x + r[4] * y + r[5] * z)
        energy_rate += z * (r[6] * x + r[7] * y + r[8] * z)
    faster = max(0.0, x * change[_FREE] + y * change[_FREE + 1] + z * change[_FREE + 2])
    faster = max(faster, x * change[_HELD] + y * change[_HELD + 1] + z * change[_HELD + 2])
    rate: float = 2.0 * (faster / change[_SPEED] + max(0.0, -energy_rate)) / total
    return rate


@compiled
def max_growth(change: FloatArray, alpha: float) -> float:
    """Return a bound [1/s] of `growth` for every alpha / beta of at least `alpha` [1/kg]."""
    x, y, z = solve_mobility(change, alpha)
    total = change[_N] * x + change[_N + 1] * y + change[_N + 2] * z
    if not 0.0 < total < math.inf:
        return math.inf
    rate = free = held = 0.0
    for a in range(9):
        rate += change[_Z + a] * change[_Z + a]
    for a in range(3):
        free += change[_FREE + a] * change[_FREE + a]
        held += change[_HELD + a] * change[_HELD + a]
    square = (x * x + y * y + z * z) / (total * total)
    acceleration = math.sqrt(max(free, held))
    bound: float = 2.0 * (math.sqrt(square) * acceleration / change[_SPEED] + total * square * math.sqrt(rate))
    return bound


@compiled
def contact_time(reduced_mass: float, stiffness: float) -> float:
    """Return the time [s] for which the growth counts."""
    return min(TIME_FACTOR * 0.5 * math.pi * math.sqrt(reduced_mass / stiffness), TRANSIENT_S)


@compiled
def is_less(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    """Return whether bound `a` is less than `b`, entry by entry as tuples are compared."""
    for i in range(4):
        if a[i] != b[i]:
            return a[i] < b[i]
    return False


@compiled
def case_bound(
    case: Case, m: FloatArray, mass_factor: float, simulated: bool, free: bool, rate: float
) -> tuple[float, float, float, float]:
    """Return speed, reduced mass, growth and push 0 of one mobility: `free` joints, `simulated` or immovable drives."""
    mu, alpha, beta = math.inf, 0.0, 0.0
    for i in range(case.line_count if simulated and not free else 1):
        line_alpha, line_beta = case.lines[i, 0], case.lines[i, 1]
        if free or not simulated:
            line_alpha, line_beta = case.obstacle_mobility, 1.0 if free else 0.0
        line_mu = mass_factor * worst_reduced_mass(m, mass_factor * line_alpha, line_beta)
        if line_mu < mu:
            mu, alpha, beta = line_mu, line_alpha, line_beta
    growing = 0.0
    if m[_CHANGES] > 0.0 and mu < math.inf:
        time = case.drive_time if case.drive_time > 0.0 else contact_time(mu, case.stiffness)
        growing = 0.5 * time * growth(m, mass_factor * alpha, beta) / m[_SPEED]
    inverse_square = mu * rate
    if inverse_square <= 0.0:
        return math.inf, mu, growing, 0.0
    speed = 1.0 / math.sqrt(inverse_square)
    speed = 2.0 * speed / (1.0 + math.sqrt(1.0 + 4.0 * growing * speed))
    return max(0.0, speed), mu, growing, 0.0  # NaN, of an infinite growth at no speed, must not count as no limit


@compiled
def push_bound(
    case: Case, mobilities: FloatArray, mass_factor: float, acceleration: float, min_mobility: float
) -> tuple[float, float, float, float]:
    """Return the bound of free joints and the push of the drives."""
    mobility = min_mobility / mass_factor + case.obstacle_mobility
    force = acceleration / mobility if mobility > 0.0 else math.inf
    rest = case.force * (case.force - 2.0 * force)
    if rest <= 0.0:
        return 0.0, 0.0, 0.0, force
    least = math.inf, math.inf, math.inf, math.inf
    for m in mobilities:
        bound = case_bound(case, m, mass_factor, True, True, case.stiffness / rest)
        if is_less(bound, least):
            least = bound
    return least[0], least[1], least[2], force


@compiled
def worst_normal(
    cases: Sequence[Case],
    mobilities: FloatArray,
    setup: Setup,
    acceleration: float,
    min_mobility: float,
    max_force: float,
    work: Work,
) -> tuple[int, float, float, float, float]:
    """Return the case that governs, its speed, reduced mass, growth and push. An infinite acceleration has no push."""
    factor = setup.mass_factor
    alpha = factor * setup.min_alpha
    governing, slowest = 0, (math.inf, 0.0, 0.0, 0.0)
    masses, growths = work.max_masses, work.growths
    for k in range(len(mobilities)):
        m = mobilities[k]
        masses[k] = factor * worst_reduced_mass(m, alpha, 1.0) if setup.is_free else math.inf
        growths[k] = 0.0
        if m[_CHANGES] > 0.0:
            time = setup.max_drive_time
            time = time if time > 0.0 else contact_time(masses[k], setup.min_stiffness)
            growths[k] = 0.5 * time * max_growth(m, alpha) / m[_SPEED]
    for i in range(len(cases)):
        case = cases[i]
        bound = math.inf, 0.0, 0.0, 0.0
        rate = case.rate
        if max_force < case.force:
            excess = case.force / max_force if max_force > 0.0 else math.inf
            rate *= excess * excess
        for k in range(len(mobilities)):
            speed = slowest[0] * (1.0 + growths[k] * slowest[0])
            if not min(masses[k], case.max_mu) * rate * speed * speed <= 1.0:
                simulated = case.line_count == 1 or mobilities[k, _TRACE] <= MAX_MOBILITY * factor
                other = case_bound(case, mobilities[k], factor, simulated, False, rate)
                if is_less(other, bound):
                    bound = other
        if acceleration < math.inf:
            other = push_bound(case, mobilities, factor, acceleration, min_mobility)
            if is_less(bound, other):
                bound = other
        if bound[0] < slowest[0]:
            governing, slowest = i, bound
    if slowest[0] == math.inf:
        slowest = math.inf, 0.0, 0.0, 0.0
    return governing, slowest[0], slowest[1], slowest[2], slowest[3]


@compiled
def in_base(joint: int, vector: FloatArray, rotations: FloatArray) -> Vector3:
    """Return a vector in the frame of `joint`, -1 the base, in base axes."""
    x, y, z = vector[0], vector[1], vector[2]
    if joint < 0:
        return x, y, z
    r = rotations[joint]
    return (
        r[0, 0] * x + r[0, 1] * y + r[0, 2] * z,
        r[1, 0] * x + r[1, 1] * y + r[1, 2] * z,
        r[2, 0] * x + r[2, 1] * y + r[2, 2] * z,
    )


@compiled
def static_force(n: Vector3, setup: Setup, work: Work) -> float:
    """Return the static force [N] along `n` that the joints can hold; -inf if no joint pushes."""
    force = math.inf
    is_loaded = False
    for j in range(setup.joints):
        lever = n[0] * work.jacobian[0, j] + n[1] * work.jacobian[1, j] + n[2] * work.jacobian[2, j]
        if abs(lever) > MIN_LEVER_M:
            is_loaded = True
            held = work.gravity[j] if lever > 0.0 else -work.gravity[j]
            force = min(force, (setup.effort[j] - held) / abs(lever))
    return force if is_loaded else -math.inf


@compiled
def clamping_force(n: Vector3, normal: Vector3, setup: Setup, work: Work) -> float:
    """Return the largest static force [N] along a fixed normal, the velocity, or any axis; infinite if unknown."""
    force = 0.0
    for j in range(setup.joints):
        if abs(work.gravity[j]) > setup.effort[j]:
            force = math.inf
    if setup.normal == FIXED:
        for sign in (1.0, -1.0):
            turned = sign * normal[0], sign * normal[1], sign * normal[2]
            force = max(force, static_force(turned, setup, work))
    elif n[0] == 0.0 and n[1] == 0.0 and n[2] == 0.0:
        for sign in (1.0, -1.0):
            for axis in ((sign, 0.0, 0.0), (0.0, sign, 0.0), (0.0, 0.0, sign)):
                force = max(force, static_force(axis, setup, work))
    else:
        force = max(force, static_force(n, setup, work))
    return min(force, setup.external_force)


@compiled
def smaller_force(force: float, n: Vector3, setup: Setup, work: Work) -> float:
    """Return the smaller of `force` and the static force [N] along `n`, if a joint pushes there."""
    held = static_force(n, setup, work)
    return min(force, held) if held > -math.inf else force


@compiled
def holding_force(
    n: Vector3, normal: Vector3, cases: Sequence[Case], changes: FloatArray, setup: Setup, work: Work
) -> float:
    """Return the contact force [N] up to which no joint reaches its effort limit."""
    force = math.inf
    if setup.normal == FIXED:
        for sign in (1.0, -1.0):
            force = smaller_force(force, (sign * normal[0], sign * normal[1], sign * normal[2]), setup, work)
    elif n[0] == 0.0 and n[1] == 0.0 and n[2] == 0.0:
        for sign in (1.0, -1.0):
            for axis in ((sign, 0.0, 0.0), (0.0, sign, 0.0), (0.0, 0.0, sign)):
                force = smaller_force(force, axis, setup, work)
    else:
        force = smaller_force(force, n, setup, work)
        alpha = math.inf
        for i in range(len(cases)):
            alpha = min(alpha, cases[i].obstacle_mobility)
        for k in range(len(changes)):
            if changes[k, _CHANGES] > 0.0:
                x, y, z = solve_mobility(changes[k], alpha)
                length = math.sqrt(x * x + y * y + z * z)
                if 0.0 < length < math.inf:
                    force = smaller_force(force, (x / length, y / length, z / length), setup, work)
    return force


@compiled
def chosen_models(
    setup: Setup, masses: FloatArray, reason: int, is_massless: bool, is_heavy: bool
) -> tuple[bool, bool, bool, int]:
    """Return whether lumped, full and ISO mass decide, and why."""
    has_lumped, has_full = not math.isnan(masses[LUMPED]), not math.isnan(masses[FULL])
    if setup.model != AUTO:
        return (
            has_lumped and setup.model in (LUMPED, LARGEST),
            has_full and setup.model in (FULL, LARGEST),
            setup.model in (ISO, LARGEST),
            WHY_SETTING,
        )
    if is_heavy:
        return True, not setup.is_scara, False, WHY_HEAVY
    if is_massless:
        has_lumped = False
        reason = MASSLESS if reason == NOT_THERE else reason
    if has_full:
        return False, True, False, WHY_LIGHTER if has_lumped else WHY_FULL + reason
    if not has_lumped:
        return False, False, True, WHY_FULL + MASSLESS_JOINT + setup.joints + reason
    return True, False, not setup.lumped_suffices, WHY_LARGEST


@compiled
def add_mobility(
    out: FloatArray, m: Mobility6, n: Vector3, normal: Vector3, mass: float, worst: float, share: float, setup: Setup
) -> None:
    """Write the mobility of one model for the contact normal of the settings, after its change of pose."""
    rank, is_moving = int(out[_RANK]), n[0] != 0.0 or n[1] != 0.0 or n[2] != 0.0
    if setup.normal == FIXED:
        if out[_CHANGES] > 0.0:
            turn_change(out, normal, share * out[_SPEED])
        set_scalar(out, along(m, normal))
        return
    if setup.normal == WORST and is_moving:
        set_matrix(out, m, n, rank)
    else:
        set_scalar(out, 1.0 / (mass if setup.normal == VELOCITY else worst))


@compiled
def fill_change(work: Work, setup: Setup, k: int, m: Mobility6, n: Vector3, speed: float, out: FloatArray) -> None:
    """Write the change of pose of model `k`."""
    size = setup.joints
    if not work.has_coriolis[k]:
        fill_coriolis_matrix(k, setup, work)
        work.has_coriolis[k] = 1
    for j in range(size):
        x, y, z = work.jacobian_rate[0, j], work.jacobian_rate[1, j], work.jacobian_rate[2, j]
        for i in range(size):
            c = work.coriolis[k, i, j]
            x -= work.responses[k, 0, i] * c
            y -= work.responses[k, 1, i] * c
            z -= work.responses[k, 2, i] * c
        work.rate[0, j], work.rate[1, j], work.rate[2, j] = x, y, z
    set_change(out, m, n, speed, k, size, work)


@compiled
def fill_held_change(work: Work, setup: Setup, k: int, m: Mobility6, n: Vector3, speed: float, out: FloatArray) -> None:
    """Write the change of pose if a controller holds each joint: only the diagonals of M and C count."""
    for a in range(3):
        for j in range(setup.joints):
            held = work.responses[HELD, a, j]
            work.rate[a, j] = work.jacobian_rate[a, j] - held * work.coriolis[k, j, j]
    set_change(out, m, n, speed, HELD, setup.joints, work)
    for a in range(3):
        out[_FREE + a] = out[_HELD + a]


@compiled
def drive_acceleration(work: Work, setup: Setup) -> float:
    """Return the acceleration [m/s2] of the point that the effort limits allow at most; infinite if unknown."""
    largest = 0.0
    for k in range(2):
        total = 0.0
        for j in range(setup.joints):
            x, y, z = work.responses[k, 0, j], work.responses[k, 1, j], work.responses[k, 2, j]
            total += math.sqrt(x * x + y * y + z * z) * (setup.effort[j] + abs(work.gravity[j]))
        if setup.has_full if k == FULL else setup.has_lumped:
            largest = max(largest, total)
    for j in range(setup.joints):
        if setup.effort[j] == math.inf:
            return math.inf
    return largest if setup.has_lumped or setup.has_full else math.inf


@compiled
def fill_limits(
    setup: Setup,
    cases: Sequence[Case],
    work: Work,
    row: Row,
    n: Vector3,
    mobilities: tuple[Mobility6, Mobility6],
    takes: tuple[bool, bool, bool],
    is_heavy: bool,
    normal: Vector3,
    rank: int,
    tolerance: float,
) -> None:
    """Write what follows from the models that decide: masses, speeds, forces and the verdict."""
    cap, speed = setup.mass_cap, row.speed
    is_moving = row.worst_direction_used == 0.0
    mass = worst_mass = 0.0
    name, models, count = -1, 0, 0
    share = 1.0
    if setup.normal == FIXED and is_moving:
        share = max(abs(n[0] * normal[0] + n[1] * normal[1] + n[2] * normal[2]), MIN_NORMAL_COMPONENT)
    for k in range(3):
        if not takes[k]:
            continue
        if name < 0:
            name, mass, worst_mass = k, work.masses[k], work.worst[k]
        else:
            worst_mass = max(worst_mass, work.worst[k])
            if min(work.masses[k], cap) > mass and not is_heavy:
                name, mass = k, work.masses[k]
        any_normal, out = work.any_normal[models], work.mobilities[count]
        any_normal[_CHANGES] = out[_CHANGES] = 0.0
        out[_RANK] = rank
        if k == ISO:
            set_scalar(any_normal, 1.0 / setup.iso_mass)
            set_scalar(out, 1.0 / setup.iso_mass)
        else:
            m = mobilities[k]
            if is_moving:
                set_matrix(any_normal, m, n, rank)
                if setup.normal != VELOCITY:
                    fill_change(work, setup, k, m, n, speed, out)
            else:
                set_scalar(any_normal, 1.0 / work.worst[k])
            add_mobility(out, m, n, normal, work.masses[k], work.worst[k], share, setup)
        models, count = models + 1, count + 1
    if setup.joints_are_held:
        for k in range(2):
            if takes[k]:
                count = add_held(setup, work, k, n, normal, rank, speed, share, count)
    acceleration, min_mobility = math.inf, 0.0
    if setup.is_servo:
        acceleration, min_mobility = drive_acceleration(work, setup), 1.0 / worst_mass
    max_force = math.inf
    if setup.joints_are_coupled:
        max_force = holding_force(n, normal, cases, work.mobilities[:models], setup, work)
    governing, allowed, bound_mass, growing, push = worst_normal(
        cases, work.mobilities[:count], setup, acceleration, min_mobility, max_force, work
    )
    case = cases[governing]
    mu = mass if case.obstacle_mass == math.inf else 1.0 / (1.0 / mass + 1.0 / case.obstacle_mass)
    mu = min(mu, cap)
    worst_mu = 0.0
    for k in range(models):
        worst_mu = max(worst_mu, worst_reduced_mass(work.any_normal[k], 1.0 / case.obstacle_mass, 1.0))
    closing_speed = setup.closing_speed + tolerance
    hit = speed * share + closing_speed
    hit *= 1.0 + growing * hit
    row.force_bound = push + math.sqrt(push * push + case.stiffness * min(bound_mass, cap) * hit * hit)
    nominal_speed = (allowed - closing_speed) / share
    row.effective_mass, row.mass_capped = min(mass, cap), 1.0 if mass > cap else 0.0
    row.worst_direction_mass = min(cap, worst_mass)
    row.body_mass = 0.0 if case.obstacle_mass == math.inf else case.obstacle_mass
    row.reduced_mass, row.stiffness = mu, case.nominal_stiffness
    row.predicted_force = (speed + setup.person_speed) * math.sqrt(mu * case.nominal_stiffness)
    row.allowable_speed = max(0.0, nominal_speed)
    row.worst_normal_reduced_mass = min(worst_mu, cap)
    row.body_region, row.criterion, row.mass_model = case.region + 1, 2.0 if case.is_pressure else 1.0, name + 1
    verdict, remark = OK, 0
    if speed > nominal_speed:
        verdict, remark = VIOLATION, FAST
    elif speed > setup.warn_ratio * nominal_speed:
        verdict, remark = WARN, CLOSE
    best_mass = row.lumped_mass if math.isnan(row.full_mass) else row.full_mass
    if mass < best_mass * (1.0 - setup.model_margin):
        verdict, remark = max(verdict, WARN), remark + LIGHT
    if row.clamping_force > setup.weakest_force:
        verdict, remark, row.allowable_speed = VIOLATION, CLAMPED, 0.0
    row.verdict, row.remark = verdict, remark


@compiled
def add_held(
    setup: Setup,
    work: Work,
    k: int,
    n: Vector3,
    normal: Vector3,
    rank: int,
    speed: float,
    share: float,
    count: int,
) -> int:
    """Write the mobility of model `k` if a controller of its own holds each joint; return the new number of them."""
    out = work.mobilities[count]
    is_moving = n[0] != 0.0 or n[1] != 0.0 or n[2] != 0.0
    for j in range(setup.joints):
        for a in range(3):
            work.responses[HELD, a, j] = work.jacobian[a, j] / work.diagonals[k, j]
    m = symmetric(setup.joints, work.jacobian, work.responses[HELD])
    worst = inverse(smallest_eigenvalue(m, rank))
    out[_CHANGES], out[_RANK] = 0.0, rank
    if is_moving and setup.normal != VELOCITY:
        fill_held_change(work, setup, k, m, n, speed, out)
    add_mobility(out, m, n, normal, inverse(along(m, n)) if is_moving else worst, worst, share, setup)
    return count + 1


@compiled
def assess_point(
    setup: Setup, cases: Sequence[Case], work: Work, point: Point, tolerances: FloatArray, row: Row
) -> None:
    """Write the assessment of one contact point."""
    rank, size = point.rank, setup.joints
    vx, vy, vz = fill_jacobian(point, setup, work)
    speed = math.sqrt(vx * vx + vy * vy + vz * vz)
    is_moving = speed >= setup.speed_threshold and speed > 0.0
    n = (vx / speed, vy / speed, vz / speed) if is_moving else (0.0, 0.0, 0.0)
    none = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    lumped = full = none
    work.masses[LUMPED] = work.masses[FULL] = work.worst[LUMPED] = work.worst[FULL] = math.nan
    work.masses[ISO] = work.worst[ISO] = setup.iso_mass
    has_lumped, reason = setup.has_lumped, NOT_THERE
    if has_lumped:
        lumped = respond(LUMPED, size, work)
        if not setup.is_lumped_regular and not is_definite(lumped, rank):
            has_lumped, reason, lumped = False, NOT_DEFINITE, none
        else:
            work.masses[LUMPED] = inverse(along(lumped, n) if is_moving else smallest_eigenvalue(lumped, rank))
    if setup.has_full:
        full = respond(FULL, size, work)
        work.masses[FULL] = inverse(along(full, n) if is_moving else smallest_eigenvalue(full, rank))
    is_massless = False
    tolerance = 0.0
    for j in range(size):
        x, y, z = work.jacobian[0, j], work.jacobian[1, j], work.jacobian[2, j]
        square = x * x + y * y + z * z
        tolerance += tolerances[j] * math.sqrt(square)
        if setup.is_massless[j] and square > MIN_LEVER_M * MIN_LEVER_M:
            is_massless = True
            if not is_moving or abs(n[0] * x + n[1] * y + n[2] * z) > MIN_LEVER_M:
                work.masses[LUMPED], reason = math.nan, MASSLESS_JOINT + j
    is_heavy = has_lumped and setup.has_full and not is_massless and setup.model == AUTO
    is_heavy = is_heavy and is_bounded(lumped, full, 1.0 - setup.model_margin)
    takes_lumped, takes_full, takes_iso, why = chosen_models(setup, work.masses, reason, is_massless, is_heavy)
    takes = takes_lumped, takes_full, takes_iso
    if takes_lumped and not is_massless:
        work.worst[LUMPED] = inverse(smallest_eigenvalue(lumped, rank)) if is_moving else work.masses[LUMPED]
    if takes_full:
        work.worst[FULL] = inverse(smallest_eigenvalue(full, rank)) if is_moving else work.masses[FULL]
    error = 0
    if not setup.has_masses:
        error = NO_MASSES
    elif setup.model == LUMPED and not takes_lumped:
        error = NO_LUMPED + reason
    elif setup.model == FULL and not takes_full:
        error = NO_FULL
    for k in range(3):
        if error == 0 and takes[k]:
            if work.masses[k] < MIN_EFFECTIVE_MASS:
                error = TOO_LIGHT + k
            elif math.isnan(work.worst[k]) and setup.normal != VELOCITY:
                error = NO_WORST + k
    cap = setup.mass_cap
    for a in range(3):
        row.direction[a] = n[a]
    for a in range(6):
        row.lumped_mobility[a] = 0.0 if is_massless else lumped[a]
        row.full_mobility[a] = full[a]
    row.speed, row.iso_mass = speed, setup.iso_mass
    row.lumped_mass = min(work.masses[LUMPED], cap)
    row.full_mass = min(work.masses[FULL], cap)
    squares = symmetric(size, work.jacobian, work.jacobian)
    square = smallest_eigenvalue(squares, rank)
    is_regular = square > EIGENVALUE_ROUNDING * (squares[0] + squares[3] + squares[5])
    row.smallest_singular_value = math.sqrt(square) if is_regular else 0.0
    row.worst_direction_used = 0.0 if is_moving else 1.0
    normal = in_base(setup.normal_joint, setup.normal_vector, work.rotations)
    row.test_effective_mass = 0.0
    d = in_base(setup.test_joint, setup.test_vector, work.rotations)
    for a in range(3):
        row.test_direction[a] = d[a]
    if setup.has_test and error == 0 and not (is_massless and takes_lumped):
        along_test = setup.iso_mass if takes_iso else 0.0
        along_test = max(along_test, inverse(along(lumped, d))) if takes_lumped else along_test
        along_test = max(along_test, inverse(along(full, d))) if takes_full else along_test
        row.test_effective_mass = min(along_test, cap)
    row.clamping_force = 0.0
    if setup.clamps:
        row.clamping_force = clamping_force(n, normal, setup, work)
        if row.clamping_force == math.inf:
            row.clamping_force = 0.0
            error = NO_FORCE if error == 0 else error
    row.effective_mass = row.worst_direction_mass = row.body_mass = row.reduced_mass = row.stiffness = 0.0
    row.predicted_force = row.allowable_speed = row.worst_normal_reduced_mass = row.force_bound = 0.0
    row.mass_capped = row.verdict = row.body_region = row.criterion = row.mass_model = row.remark = 0.0
    row.error, row.mass_model_reason = error, 0.0 if error else why
    if error == 0:
        fill_limits(setup, cases, work, row, n, (lumped, full), takes, is_heavy, normal, rank, tolerance)
    row.margin = row.allowable_speed - speed


@compiled
def assess(
    states: FloatArray, robot: ByteArray, at: ByteArray, limits: ByteArray, numbers: FloatArray, scratch: ByteArray
) -> None:
    """Write in `numbers` (P, N, fields) the rows of P contact points at N `states` (N, 3, n): q, qd, tolerances of qd.

    `robot`, `at` and `limits` are the bytes of Setup, Points and Cases: numba recognizes records slowly at a call.
    `scratch` holds one Work: numba frees an array made here while its record is in use.
    """
    cases: Any
    setup, points, cases, rows = robot.view(SETUP)[0], at.view(POINT), limits.view(CASE), numbers.view(ROW)
    work = scratch.view(WORK)[0]
    for i in range(len(states)):
        for j in range(setup.joints):
            work.qd[j] = states[i, 1, j]
        place_joints(states[i, 0], setup, work)
        for k in range(2):
            work.has_coriolis[k] = 0
            if setup.has_full or setup.needs_gravity if k == FULL else setup.has_lumped:
                place_bodies(k, setup, work)
                fill_mass_matrix(k, setup, work)
                factorize(k, setup.joints, work)
        if setup.needs_gravity:
            g = setup.gravity
            for j in range(setup.joints):
                c, s = work.composites[FULL, j], work.motions[j]
                work.gravity[j] = -c[0] * (s[3] * g[0] + s[4] * g[1] + s[5] * g[2]) - (
                    s[0] * (c[2] * g[2] - c[3] * g[1])
                    + s[1] * (c[3] * g[0] - c[1] * g[2])
                    + s[2] * (c[1] * g[1] - c[2] * g[0])
                )
        for p in range(len(points)):
            assess_point(setup, cases, work, points[p], states[i, 2], rows[p, i, 0])


@compiled
def assess_columns(
    states: FloatArray,
    robot: ByteArray,
    at: ByteArray,
    limits: ByteArray,
    columns: FloatArray,
    rows: FloatArray,
    scratch: ByteArray,
) -> None:
    """Write in `columns` (fields, N, P) what `assess` writes; `rows` (P, B, fields) hold B joint states at a time.

    In one call, because a thread that comes back to Python waits for the others.
    """
    points, block, fields = rows.shape
    for first in range(0, len(states), block):
        last = min(first + block, len(states))
        assess(states[first:last], robot, at, limits, rows, scratch)
        for p in range(points):
            for field in range(fields):
                for i in range(last - first):
                    columns[field, first + i, p] = rows[p, i, field]
