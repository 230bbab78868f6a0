# SPDX-License-Identifier: Apache-2.0
"""Tuples of three, and spatial vectors made of them (R. Featherstone, "Rigid Body Dynamics Algorithms", 2008).

All are in base axes. Spatial vectors have their angular part first and are about a place that the caller knows. A
`Matrix` is three rows, a `Mobility6` the entries xx, xy, xz, yy, yz, zz of a symmetric matrix.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from scara_effmass.kernel.compiled import inlined
from scara_effmass.values import ZERO_VECTOR, FloatArray, Mobility6, Vector3

Matrix = tuple[Vector3, Vector3, Vector3]
NO_MATRIX: Matrix = (ZERO_VECTOR, ZERO_VECTOR, ZERO_VECTOR)


class Motion(NamedTuple):
    """Spatial motion."""

    angular: Vector3
    linear: Vector3


class Force(NamedTuple):
    """Spatial force or momentum."""

    angular: Vector3
    linear: Vector3


class Inertia(NamedTuple):
    """Spatial inertia: mass, first moments, and moments of inertia."""

    mass: float
    first: Vector3
    second: Mobility6


NO_MOTION = Motion(ZERO_VECTOR, ZERO_VECTOR)


@inlined
def vector(array: FloatArray) -> Vector3:
    """Return an array (3,) as a tuple."""
    return array[0], array[1], array[2]


@inlined
def vector_at(array: FloatArray, i: int) -> Vector3:
    """Return row `i` of an array (n, 3)."""
    return array[i, 0], array[i, 1], array[i, 2]


@inlined
def set_vector(array: FloatArray, i: int, a: Vector3) -> None:
    """Write row `i` of an array (n, 3)."""
    array[i, 0], array[i, 1], array[i, 2] = a


@inlined
def matrix_at(array: FloatArray, i: int) -> Matrix:
    """Return matrix `i` of an array (n, 3, 3)."""
    matrix = array[i]
    return vector_at(matrix, 0), vector_at(matrix, 1), vector_at(matrix, 2)


@inlined
def set_matrix(array: FloatArray, m: Matrix) -> None:
    """Write an array (3, 3)."""
    for a in range(3):
        set_vector(array, a, m[a])


@inlined
def add(a: Vector3, b: Vector3) -> Vector3:
    """Return a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def sub(a: Vector3, b: Vector3) -> Vector3:
    """Return a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inlined
def scale(s: float, a: Vector3) -> Vector3:
    """Return s a."""
    return s * a[0], s * a[1], s * a[2]


@inlined
def dot(a: Vector3, b: Vector3) -> float:
    """Return a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def cross(a: Vector3, b: Vector3) -> Vector3:
    """Return a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def norm(a: Vector3) -> float:
    """Return |a|."""
    return math.sqrt(dot(a, a))


@inlined
def rotate(m: Matrix, a: Vector3) -> Vector3:
    """Return M a."""
    return dot(m[0], a), dot(m[1], a), dot(m[2], a)


@inlined
def rotate_back(m: Matrix, a: Vector3) -> Vector3:
    """Return M^T a."""
    return add(add(scale(a[0], m[0]), scale(a[1], m[1])), scale(a[2], m[2]))


@inlined
def compose(m: Matrix, n: Matrix) -> Matrix:
    """Return M N."""
    return rotate_back(n, m[0]), rotate_back(n, m[1]), rotate_back(n, m[2])


@inlined
def turn(a: Vector3, axis: Vector3, sine: float, cosine: float) -> Vector3:
    """Return a turned backwards about `axis`: a row of M R(axis) if `a` is that row of M."""
    along = scale((1.0 - cosine) * dot(a, axis), axis)
    return add(add(scale(cosine, a), along), scale(sine, cross(a, axis)))


@inlined
def add_matrices(m: Matrix, n: Matrix) -> Matrix:
    """Return M + N."""
    return add(m[0], n[0]), add(m[1], n[1]), add(m[2], n[2])


@inlined
def outer(a: Vector3, b: Vector3) -> Matrix:
    """Return a b^T."""
    return scale(a[0], b), scale(a[1], b), scale(a[2], b)


@inlined
def skew_product(a: Vector3, b: Vector3) -> Matrix:
    """Return -(b x (a x .)) as a matrix: (a . b) 1 - a b^T."""
    s, m = dot(a, b), outer(scale(-1.0, a), b)
    return (m[0][0] + s, m[0][1], m[0][2]), (m[1][0], m[1][1] + s, m[1][2]), (m[2][0], m[2][1], m[2][2] + s)


@inlined
def symmetric_product(s: Mobility6, a: Vector3) -> Vector3:
    """Return S a of a symmetric matrix."""
    return rotate(((s[0], s[1], s[2]), (s[1], s[3], s[4]), (s[2], s[4], s[5])), a)


@inlined
def add_symmetric(s: Mobility6, t: Mobility6) -> Mobility6:
    """Return S + T."""
    return s[0] + t[0], s[1] + t[1], s[2] + t[2], s[3] + t[3], s[4] + t[4], s[5] + t[5]


@inlined
def scale_symmetric(factor: float, s: Mobility6) -> Mobility6:
    """Return a multiple of S."""
    return factor * s[0], factor * s[1], factor * s[2], factor * s[3], factor * s[4], factor * s[5]


@inlined
def symmetric_at(array: FloatArray, i: int) -> Mobility6:
    """Return row `i` of an array (n, 6)."""
    return array[i, 0], array[i, 1], array[i, 2], array[i, 3], array[i, 4], array[i, 5]


@inlined
def symmetric_outer(a: Vector3, b: Vector3) -> Mobility6:
    """Return a b^T, which must be symmetric: `b` is a multiple of `a`."""
    return a[0] * b[0], a[0] * b[1], a[0] * b[2], a[1] * b[1], a[1] * b[2], a[2] * b[2]


@inlined
def symmetric_skew(a: Vector3, b: Vector3) -> Mobility6:
    """Return the symmetric part of `skew_product`: with b = m a the moments of inertia of a mass m at `a`."""
    x, y, z = a[0] * b[0], a[1] * b[1], a[2] * b[2]
    xy, xz, yz = a[0] * b[1] + a[1] * b[0], a[0] * b[2] + a[2] * b[0], a[1] * b[2] + a[2] * b[1]
    return y + z, -0.5 * xy, -0.5 * xz, x + z, -0.5 * yz, x + y


@inlined
def motion_at(array: FloatArray, i: int) -> Motion:
    """Return row `i` of an array (n, 6)."""
    return Motion((array[i, 0], array[i, 1], array[i, 2]), (array[i, 3], array[i, 4], array[i, 5]))


@inlined
def force_at(array: FloatArray, i: int) -> Force:
    """Return row `i` of an array (n, 6)."""
    return Force((array[i, 0], array[i, 1], array[i, 2]), (array[i, 3], array[i, 4], array[i, 5]))


@inlined
def set_spatial(array: FloatArray, i: int, angular: Vector3, linear: Vector3) -> None:
    """Write row `i` of an array (n, 6)."""
    array[i, 0], array[i, 1], array[i, 2] = angular
    array[i, 3], array[i, 4], array[i, 5] = linear


@inlined
def inertia_at(array: FloatArray, i: int) -> Inertia:
    """Return row `i` of an array (n, 10)."""
    a = array[i]
    return Inertia(a[0], (a[1], a[2], a[3]), (a[4], a[5], a[6], a[7], a[8], a[9]))


@inlined
def set_inertia(array: FloatArray, i: int, inertia: Inertia) -> None:
    """Write row `i` of an array (n, 10)."""
    a = array[i]
    a[0], (a[1], a[2], a[3]), (a[4], a[5], a[6], a[7], a[8], a[9]) = inertia


@inlined
def shift_motion(v: Motion, lever: Vector3) -> Motion:
    """Return a motion about the place that is `lever` further on."""
    return Motion(v.angular, add(v.linear, cross(v.angular, lever)))


@inlined
def cross_motion(v: Motion, s: Motion) -> Motion:
    """Return v x s, the rate of a motion `s` that is fixed in a body with the velocity `v`."""
    return Motion(cross(v.angular, s.angular), add(cross(v.angular, s.linear), cross(v.linear, s.angular)))


@inlined
def shift_force(f: Force, lever: Vector3) -> Force:
    """Return a force about the place that is `lever` further back."""
    return Force(add(f.angular, cross(lever, f.linear)), f.linear)


@inlined
def power(v: Motion, f: Force) -> float:
    """Return the power of a force on a motion about the same place."""
    return dot(v.angular, f.angular) + dot(v.linear, f.linear)


@inlined
def momentum(body: Inertia, v: Motion) -> Force:
    """Return the momentum of an inertia on a motion about the same place."""
    angular = add(symmetric_product(body.second, v.angular), cross(body.first, v.linear))
    return Force(angular, add(scale(body.mass, v.linear), cross(v.angular, body.first)))


@inlined
def add_inertia(a: Inertia, b: Inertia) -> Inertia:
    """Return the inertia of both, about the same place."""
    return Inertia(a.mass + b.mass, add(a.first, b.first), add_symmetric(a.second, b.second))


@inlined
def shift_inertia(body: Inertia, lever: Vector3) -> Inertia:
    """Return an inertia about the place that is `lever` further back."""
    offset = scale(body.mass, lever)
    second = symmetric_skew(lever, add(scale(2.0, body.first), offset))
    return Inertia(body.mass, add(body.first, offset), add_symmetric(body.second, second))
