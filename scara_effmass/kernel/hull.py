# SPDX-License-Identifier: Apache-2.0
"""Contact anywhere on a link: a bound of v^T (s 1 + A)^-1 v over a convex hull. `reference.hull` derives it.

Twists, the mobility B of the link and the vertices are about the place of the joint that carries the link.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from scara_effmass.kernel.codes import Model
from scara_effmass.kernel.compiled import inlined
from scara_effmass.kernel.contact_point import Approach
from scara_effmass.kernel.mobility import (
    adjugate,
    determinant,
    inverse,
    point_reduced_mass,
    shifted,
    smallest_eigenvalue,
)
from scara_effmass.kernel.pose_change import assign_symmetric
from scara_effmass.kernel.records import HULL_KNOWN, HULL_MASS, HULL_NONE, Mobility, Point, Setup, Work
from scara_effmass.kernel.spatial import (
    Force,
    Inertia,
    Motion,
    add,
    add_inertia,
    add_symmetric,
    cross,
    dot,
    matrix_at,
    momentum,
    motion_at,
    power,
    rotate,
    rotate_back,
    scale,
    scale_symmetric,
    set_spatial,
    set_vector,
    shift_inertia,
    shift_motion,
    sub,
    symmetric_at,
    symmetric_product,
    vector_at,
)
from scara_effmass.reference import hull as reference
from scara_effmass.reference.hull import FIRST_TRIAL, MAX_GAP, STEPS, TIE
from scara_effmass.reference.mobility import CLAMPED_TOLERANCE
from scara_effmass.values import NO_MOBILITY, ZERO_VECTOR, FloatArray, Mobility6, Vector3

scaled_energy = inlined(reference.scaled_energy)
second_trial = inlined(reference.second_trial)


class Certificate(NamedTuple):
    """Motion of the link that proves the `bound` of the energy [J] of its hull, and the fastest `vertex` in it.

    `excess` [m2/s2]: by how much the square of its speed exceeds the weighted mean of the supports. `met` is the bound
    at the scale of the motion, and with the person, that was asked for.
    """

    motion: Motion
    vertex: int
    excess: float
    bound: float
    met: float


@inlined
def fill_vertices(point: Point, work: Work) -> None:
    """Write the vertices of a link, in base axes, from the place of its joint."""
    rotation = matrix_at(work.rotations, point.joint)
    for i in range(point.vertex_count):
        set_vector(work.vertices, i, rotate(rotation, vector_at(point.vertices, i)))


@inlined
def add_row(b: FloatArray, motion: Motion, factor: float) -> None:
    """Add factor y y^T to a symmetric matrix (6, 6)."""
    y = motion.angular + motion.linear
    for i in range(6):
        for j in range(6):
            b[i, j] += factor * y[i] * y[j]


@inlined
def clear(b: FloatArray) -> None:
    """Set a matrix (6, 6) to 0."""
    for i in range(6):
        for j in range(6):
            b[i, j] = 0.0


@inlined
def fill_twist_mobility(k: int, joint: int, setup: Setup, work: Work) -> None:
    """Write the mobility B = J M^-1 J^T of the link in model `k`, with the rows of U^-1 J^T."""
    factors, b, rows = work.factors[k], work.twist_mobility[k], work.twists
    clear(b)
    fill_twists(joint, setup, work)
    for i in range(joint, -1, -1):
        for j in range(i + 1, joint + 1):
            for a in range(6):
                rows[i, a] -= factors[i, j] * rows[j, a]
        add_row(b, motion_at(rows, i), factors[i, i])


@inlined
def fill_twists(joint: int, setup: Setup, work: Work) -> None:
    """Write the motion of the link, about the place of its joint, per joint velocity."""
    place, j = vector_at(work.places, joint), joint
    for i in range(joint + 1):
        set_spatial(work.twists, i, ZERO_VECTOR, ZERO_VECTOR)
    while j >= 0:
        motion = shift_motion(motion_at(work.axes, j), sub(place, vector_at(work.places, j)))
        set_spatial(work.twists, j, motion.angular, motion.linear)
        j = setup.parent[j]


@inlined
def fill_held_twist_mobility(k: int, joint: int, setup: Setup, work: Work) -> None:
    """Write the mobility of the link if a controller of its own holds each joint."""
    b = work.twist_mobility[2 + k]
    clear(b)
    fill_twists(joint, setup, work)
    for i in range(joint + 1):
        add_row(b, motion_at(work.twists, i), 1.0 / work.diagonals[k, i])


@inlined
def force_on(b: FloatArray, f: Force) -> Motion:
    """Return B f."""
    x = f.angular + f.linear
    y0 = y1 = y2 = y3 = y4 = y5 = 0.0
    for j in range(6):
        y0 += b[0, j] * x[j]
        y1 += b[1, j] * x[j]
        y2 += b[2, j] * x[j]
        y3 += b[3, j] * x[j]
        y4 += b[4, j] * x[j]
        y5 += b[5, j] * x[j]
    return Motion((y0, y1, y2), (y3, y4, y5))


@inlined
def mobility_at(b: FloatArray, lever: Vector3) -> Mobility6:
    """Return the mobility A = T B T^T [1/kg] of the point at `lever` r.

    With B = [[W, C], [C^T, V]], angular part first, it is V - P - P^T, P = skew(r) (C + W skew(r) / 2).
    """
    x, y, z = lever
    p, q, r = vector_at(b, 0), vector_at(b, 1), vector_at(b, 2)
    f = cross(lever, add(vector_at(b, 3), scale(0.5, sub(scale(z, q), scale(y, r)))))
    g = cross(lever, add(vector_at(b, 4), scale(0.5, sub(scale(x, r), scale(z, p)))))
    h = cross(lever, add(vector_at(b, 5), scale(0.5, sub(scale(y, p), scale(x, q)))))
    return (
        b[3, 3] - 2.0 * f[0],
        b[3, 4] - f[1] - g[0],
        b[3, 5] - f[2] - h[0],
        b[4, 4] - 2.0 * g[1],
        b[4, 5] - g[2] - h[1],
        b[5, 5] - 2.0 * h[2],
    )


@inlined
def energy_at(m: Mobility6, s: float, v: Vector3) -> float:
    """Return v^T (s 1 + A)^-1 v."""
    m = shifted(m, s)
    of_m = adjugate(m)
    energy: float = dot(v, symmetric_product(of_m, v)) / determinant(m, of_m)
    return energy


@inlined
def worst_vertex(k: int, s: float, is_moving: bool, point: Point, work: Work) -> int:  # noqa: FBT001 - compiled
    """Return the vertex with the largest energy in model `k`, at rest that with the largest mass; -1: no model."""
    twist, worst, largest = motion_at(work.velocities, point.joint), 0, -1.0
    for i in range(point.vertex_count):
        lever = vector_at(work.vertices, i)
        v = shift_motion(twist, lever).linear
        if k < 0:
            value = dot(v, v)
        else:
            m = mobility_at(work.twist_mobility[k], lever)
            value = energy_at(m, s, v) if is_moving else inverse(smallest_eigenvalue(m, point.rank))
        if value > largest * (1.0 + TIE):
            worst, largest = i, value
    return worst


@inlined
def fastest_square(point: Point, work: Work) -> float:
    """Return the square of the speed of the fastest vertex."""
    twist, largest = motion_at(work.velocities, point.joint), 0.0
    for i in range(point.vertex_count):
        v = shift_motion(twist, vector_at(work.vertices, i)).linear
        largest = max(largest, dot(v, v))
    return largest


@inlined
def fill_energies(k: int, joint: int, work: Work) -> None:
    """Write twice the least kinetic energy with which the link moves as it does in model `k`, free and held joints."""
    free = held = 0.0
    for i in range(joint + 1):
        velocity = work.qd[i]
        for j in range(i):
            velocity += work.factors[k, j, i] * work.qd[j]
        free += velocity * velocity / work.factors[k, i, i]
        held += work.diagonals[k, i] * work.qd[i] * work.qd[i]
    work.energies[k], work.energies[2 + k] = free, held


@inlined
def place_on_link(point: Point, setup: Setup, work: Work) -> int:
    """Write the vertices of a link and its mobilities; return the vertex at which its contact counts, -1 for a point.

    That only says where the contact counts: the bound of the energy is that of the whole hull.
    """
    if point.vertex_count == 0:
        return -1
    fill_vertices(point, work)
    first = -1
    for k in range(1, -1, -1):
        if setup.has_full if k == Model.FULL else setup.has_lumped:
            fill_twist_mobility(k, point.joint, setup, work)
            fill_energies(k, point.joint, work)
            first = k if first < 0 else first
            if setup.joints_are_held:
                fill_held_twist_mobility(k, point.joint, setup, work)
    threshold = setup.speed_threshold * setup.speed_threshold
    work.fastest_square = fastest_square(point, work)
    is_moving = work.fastest_square >= threshold
    vertex = worst_vertex(first, point.hull_mobility, is_moving, point, work)
    work.worst_vertex = vertex
    twist = motion_at(work.velocities, point.joint)
    if is_moving and square_at(twist, vector_at(work.vertices, vertex)) < threshold:
        return worst_vertex(-1, 0.0, is_moving, point, work)  # the fastest
    return vertex


@inlined
def copy_link(out: Mobility, k: int, point: Point, work: Work) -> None:
    """Write vertices and mobility of a link; `k` is the index of the latter."""
    out.vertex_count = point.vertex_count
    for i in range(6):
        for j in range(6):
            out.twist_mobility[i, j] = work.twist_mobility[k, i, j]
    for i in range(point.vertex_count):
        set_vector(out.vertices, i, vector_at(work.vertices, i))


@inlined
def set_hull(out: Mobility, kind: int, k: int, approach: Approach, point: Point, work: Work) -> None:
    """Write the hull of a link into the mobility of its worst vertex; `k` is the index of the link's mobility."""
    out.hull, out.speed_ratio = HULL_NONE, 1.0
    if approach.vertex < 0 or not approach.is_moving:
        return
    twist = motion_at(work.velocities, point.joint)
    square = approach.speed * approach.speed
    out.hull, out.vertex, out.square = kind, work.worst_vertex, square
    out.speed_ratio = max(1.0, work.fastest_square / square)
    if kind == HULL_KNOWN:
        out.energy_of_arm = work.energies[k]
        set_spatial(out.twist, 0, twist.angular, twist.linear)
        copy_link(out, k, point, work)


@inlined
def square_at(x: Motion, lever: Vector3) -> float:
    """Return the square of the speed of a point."""
    v = shift_motion(x, lever).linear
    return dot(v, v)


@inlined
def farthest(m: Mobility, x: Motion) -> int:
    """Return the fastest vertex in the motion `x`."""
    index, largest = 0, -1.0
    for i in range(m.vertex_count):
        square = square_at(x, vector_at(m.vertices, i))
        if square > largest * (1.0 + TIE):
            index, largest = i, square
    return index


@inlined
def unit(axis: int) -> Vector3:
    """Return the unit vector along an axis."""
    return (1.0 if axis == 0 else 0.0), (1.0 if axis == 1 else 0.0), (1.0 if axis == 2 else 0.0)


@inlined
def add_support(m: Mobility, vertex: int, count: int) -> None:
    """Make `vertex` the support `count` of the weights, with its blocks T_i B T_j^T of the other ones."""
    m.support[count] = vertex
    lever = vector_at(m.vertices, vertex)
    for axis in range(3):
        e = unit(axis)
        moved = force_on(m.twist_mobility, Force(cross(lever, e), e))
        for j in range(count + 1):
            set_vector(m.blocks[count, j], axis, shift_motion(moved, vector_at(m.vertices, m.support[j])).linear)


@inlined
def factorized(m: Mobility6, least: float) -> Mobility6:
    """Return Cholesky's factor L, its columns one after the other and its diagonal inverted.

    No pivot can be smaller than `least`; rounding must not make it so.
    """
    a = 1.0 / math.sqrt(max(m[0], least))
    b, c = m[1] * a, m[2] * a
    d = 1.0 / math.sqrt(max(m[3] - b * b, least))
    e = (m[4] - b * c) * d
    return a, b, c, d, e, 1.0 / math.sqrt(max(m[5] - c * c - e * e, least))


@inlined
def forward(factor: Mobility6, a: Vector3) -> Vector3:
    """Return L^-1 a."""
    x = a[0] * factor[0]
    y = (a[1] - factor[1] * x) * factor[3]
    return x, y, (a[2] - factor[2] * x - factor[4] * y) * factor[5]


@inlined
def backward(factor: Mobility6, a: Vector3) -> Vector3:
    """Return L^-T a."""
    z = a[2] * factor[5]
    y = (a[1] - factor[4] * z) * factor[3]
    return (a[0] - factor[1] * y - factor[2] * z) * factor[0], y, z


@inlined
def fill_factor(m: Mobility, s: float, i: int) -> None:
    """Write block row `i` of Cholesky's factor of s / w + T B T^T, and of its product with the forces."""
    least = s / m.weights[i]
    rest = shift_motion(motion_at(m.twist, 0), vector_at(m.vertices, m.support[i])).linear
    x, y, z = matrix_at(m.blocks[i], i)
    pivot = x[0] + least, x[1], x[2], y[1] + least, y[2], z[2] + least
    for j in range(i):
        factor = symmetric_at(m.pivots, j)
        for axis in range(3):
            row = vector_at(m.blocks[i, j], axis)
            for k in range(j):
                row = sub(row, rotate(matrix_at(m.system[j], k), vector_at(m.system[i, k], axis)))
            set_vector(m.system[i, j], axis, forward(factor, row))
        x, y, z = matrix_at(m.system[i], j)
        squares = dot(x, x), dot(x, y), dot(x, z), dot(y, y), dot(y, z), dot(z, z)
        pivot = add_symmetric(pivot, scale_symmetric(-1.0, squares))
        rest = sub(rest, rotate((x, y, z), vector_at(m.forces, j)))
    factor = factorized(pivot, least)
    assign_symmetric(m.pivots[i], factor)
    set_vector(m.forces, i, forward(factor, rest))


@inlined
def motion_after(m: Mobility, s: float, count: int) -> tuple[Motion, float]:
    """Return the motion x of the link after contacts of masses w_i / s at the first `count` supports, and its energy.

    The forces f on them follow from (s / w + T B T^T) f = T d by Cholesky's method; h = T^T f, x = d - B h.
    """
    twist, h = motion_at(m.twist, 0), Force(ZERO_VECTOR, ZERO_VECTOR)
    for i in range(count):
        fill_factor(m, s, i)
    for i in range(count - 1, -1, -1):
        rest = vector_at(m.forces, i)
        for j in range(i + 1, count):
            rest = sub(rest, rotate_back(matrix_at(m.system[j], i), vector_at(m.forces, j)))
        force = backward(symmetric_at(m.pivots, i), rest)
        set_vector(m.forces, i, force)
        lever = vector_at(m.vertices, m.support[i])
        h = Force(add(h.angular, cross(lever, force)), add(h.linear, force))
    given = force_on(m.twist_mobility, h)
    return Motion(sub(twist.angular, given.angular), sub(twist.linear, given.linear)), power(given, h)


@inlined
def mean_square(m: Mobility, x: Motion, weights: FloatArray, count: int) -> float:
    """Return the weighted mean of the squares of the speeds of the supports."""
    total = 0.0
    for i in range(count):
        total += weights[i] * square_at(x, vector_at(m.vertices, m.support[i]))
    return total


@inlined
def certified(m: Mobility, s: float, i: int, scaling: float, person_speed: float) -> float:
    """Return the bound that the motion `i` proves, at `scaling` times the motion of the link."""
    speed = scaling * m.fastest[i] + person_speed
    bound: float = scaling * scaling * m.of_arm[i] + speed * speed / s
    if person_speed > 0.0:
        root = 0.0
        for j in range(m.vertex_count):
            root = max(root, scaling * m.own_roots[i, j] + person_speed * m.met_roots[j])
        bound = min(bound, root * root)
    return bound


@inlined
def certificate(m: Mobility, s: float, count: int, scaling: float, person_speed: float) -> Certificate:
    """Return the bound of the energy of the whole hull by the weights of `count` supports, and keep it."""
    x, energy = motion_after(m, s, count)
    vertex, i = farthest(m, x), m.certificates
    square = square_at(x, vector_at(m.vertices, vertex))
    m.certificates, m.of_arm[i], m.fastest[i] = i + 1, energy, math.sqrt(square)
    if person_speed > 0.0:
        for j in range(m.vertex_count):
            m.own_roots[i, j] = math.sqrt(energy + square_at(x, vector_at(m.vertices, j)) / s)
    met = certified(m, s, i, scaling, person_speed)
    return Certificate(x, vertex, square - mean_square(m, x, m.weights, count), energy + square / s, met)


@inlined
def fill_system(m: Mobility, s: float) -> None:
    """Write the rows of (s 1 + G B) H = G [0 1]^T, G the mean of T_i^T T_i; angular components come first.

    G is the inertia of a unit mass that is spread evenly over the vertices.
    """
    body = Inertia(0.0, ZERO_VECTOR, NO_MOBILITY)
    part = Inertia(1.0 / m.vertex_count, ZERO_VECTOR, NO_MOBILITY)
    for i in range(m.vertex_count):
        body = add_inertia(body, shift_inertia(part, vector_at(m.vertices, i)))
    for j in range(9):
        column = motion_at(m.twist_mobility, j) if j < 6 else Motion(ZERO_VECTOR, unit(j - 6))
        given = momentum(body, column)
        for i in range(3):
            m.rows[i, j], m.rows[3 + i, j] = given.angular[i], given.linear[i]
        if j < 6:
            m.rows[j, j] += s


@inlined
def eliminate(rows: FloatArray) -> None:
    """Solve the six equations of `rows` (6, 9) for their last three columns, in place, by Gauss and Jordan."""
    for k in range(6):
        pivot = k
        for i in range(k + 1, 6):
            if abs(rows[i, k]) > abs(rows[pivot, k]):
                pivot = i
        for j in range(k, 9):
            rows[k, j], rows[pivot, j] = rows[pivot, j], rows[k, j]
        scaling = 1.0 / rows[k, k]
        for j in range(k, 9):
            rows[k, j] *= scaling
        for i in range(6):
            if i != k:
                factor = rows[i, k]
                for j in range(k, 9):
                    rows[i, j] -= factor * rows[k, j]


@inlined
def solution(rows: FloatArray, j: int) -> Force:
    """Return column `j` of `rows`."""
    return Force((rows[0, j], rows[1, j], rows[2, j]), (rows[3, j], rows[4, j], rows[5, j]))


@inlined
def fill_met_roots(m: Mobility, s: float) -> None:
    """Write the root of a bound of the mass [kg] that a velocity of a person meets at each vertex, in any direction."""
    fill_system(m, s)
    eliminate(m.rows)
    a, b, c = solution(m.rows, 6), solution(m.rows, 7), solution(m.rows, 8)
    after = force_on(m.twist_mobility, a), force_on(m.twist_mobility, b), force_on(m.twist_mobility, c)
    of_arm = (
        power(after[0], a),
        power(after[0], b),
        power(after[0], c),
        power(after[1], b),
        power(after[1], c),
        power(after[2], c),
    )
    for i in range(m.vertex_count):
        lever = vector_at(m.vertices, i)
        x = sub(unit(0), shift_motion(after[0], lever).linear)
        y = sub(unit(1), shift_motion(after[1], lever).linear)
        z = sub(unit(2), shift_motion(after[2], lever).linear)
        squares = dot(x, x), dot(x, y), dot(x, z), dot(y, y), dot(y, z), dot(z, z)
        mass = add_symmetric(of_arm, scale_symmetric(1.0 / s, squares))
        m.met_roots[i] = math.sqrt(max(0.0, -smallest_eigenvalue(scale_symmetric(-1.0, mass), 3)))


@inlined
def of_whole_arm(m: Mobility, s: float, scaling: float, person_speed: float) -> float:
    """Return the bound by contacts that slow down all of the arm, at `scaling` times the motion of the link."""
    energy: float = scaled_energy(m.energy_of_arm, s, scaling, math.sqrt(m.square * m.speed_ratio), person_speed)
    return energy


@inlined
def hull_energy(m: Mobility, s: float, scaling: float, person_speed: float, enough: float) -> float:
    """Return a bound of v^T (s 1 + A)^-1 v over the hull, for a person of up to `person_speed` [m/s] in any direction.

    It is that at `scaling` times the motion of the link. Frank-Wolfe steps on the weights of the vertices, until the
    bound is at most `enough`.
    """
    found = of_whole_arm(m, s, scaling, person_speed)
    if found <= enough:
        return found
    if person_speed > 0.0:
        fill_met_roots(m, s)
    m.certificates = 0
    add_support(m, m.vertex, 0)
    m.weights[0] = 1.0
    last = certificate(m, s, 1, scaling, person_speed)
    found, least = min(found, last.met), min(of_whole_arm(m, s, 1.0, 0.0), last.bound)
    for count in range(1, STEPS + 1):
        if found <= enough or not last.excess > MAX_GAP * s * least:
            break
        slope, lever, t = last.excess, vector_at(m.vertices, last.vertex), FIRST_TRIAL
        add_support(m, last.vertex, count)
        for i in range(count):
            m.starts[i] = m.weights[i]
        for _ in range(2):
            for i in range(count):
                m.weights[i] = (1.0 - t) * m.starts[i]
            m.weights[count] = t
            last = certificate(m, s, count + 1, scaling, person_speed)
            found, least = min(found, last.met), min(least, last.bound)
            if found <= enough or not last.excess > MAX_GAP * s * least:
                break
            t = second_trial(slope, square_at(last.motion, lever) - mean_square(m, last.motion, m.starts, count))
    return found


@inlined
def worst_reduced_mass(m: Mobility, alpha: float, beta: float, enough: float) -> float:
    """Return v^T (alpha 1 + beta A)^-1 v / v^2, of a link a bound of that of every point over v^2 of `vertex`.

    That of a link may be larger than need be, unless it is above `enough`.
    """
    mass = point_reduced_mass(m, alpha, beta)
    if m.hull == HULL_NONE or mass == math.inf:
        return mass
    if m.hull == HULL_MASS or beta <= 0.0:
        return mass * m.speed_ratio
    per_mass = beta * m.square
    energy = hull_energy(m, least_of(m, alpha, beta), 1.0, 0.0, enough * per_mass)
    bound: float = max(mass, energy / per_mass)
    return bound


@inlined
def least_of(m: Mobility, alpha: float, beta: float) -> float:
    """Return s of the line; a direction without mobility counts as nearly rigid."""
    s: float = max(alpha / beta, CLAMPED_TOLERANCE * m.matrix_trace)
    return s


@inlined
def worst_mass_at_rest(
    k: int, mass: float, approach: Approach, point: Point, setup: Setup, work: Work, out: Mobility
) -> float:
    """Return the largest mass over all directions, `mass` at the contact point, of a link a bound over all its points.

    `k` is the index of the link's mobility, `out` is scratch.
    """
    if approach.vertex < 0 or approach.is_moving or approach.rank < 3 or setup.clamps:
        return mass
    s, root = point.hull_mobility, 0.0
    copy_link(out, k, point, work)
    fill_met_roots(out, s)
    for i in range(out.vertex_count):
        root = max(root, out.met_roots[i])
    worst: float = max(mass, inverse(1.0 / (root * root) - s))
    return worst


@inlined
def energy_anywhere(m: Mobility, alpha: float, beta: float, mass: float, s: float, person_speed: float) -> float:
    """Return a bound of w^T (alpha 1 + beta A)^-1 w anywhere on a link, for a person in any direction.

    It is that at the speed `s` [m/s] of the vertex, after `hull_energy` at any speed. The `mass` is that of a robot
    whose mass is the same everywhere.
    """
    if m.hull == HULL_MASS or beta <= 0.0:
        speed = s * math.sqrt(m.speed_ratio) + person_speed
        return mass * speed * speed
    least, scaling = least_of(m, alpha, beta), s / math.sqrt(m.square)
    energy = of_whole_arm(m, least, scaling, person_speed)
    for i in range(m.certificates):
        energy = min(energy, certified(m, least, i, scaling, person_speed))
    return energy / beta


@inlined
def first_energy_anywhere(
    m: Mobility, alpha: float, beta: float, mass: float, s: float, person_speed: float, enough: float
) -> float:
    """Return `energy_anywhere`, computing its certificates until the bound is at most `enough`."""
    if m.hull == HULL_MASS or beta <= 0.0:
        return energy_anywhere(m, alpha, beta, mass, s, person_speed)
    scaling = s / math.sqrt(m.square)
    return hull_energy(m, least_of(m, alpha, beta), scaling, person_speed, enough * beta) / beta
