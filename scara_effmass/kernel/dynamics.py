# SPDX-License-Identifier: Apache-2.0
"""Dynamics of one joint state: what does not depend on a contact point.

Spatial vectors are about the origin of their joint: moments about a far point lose digits. The Coriolis matrix C has
dM/dt = C + C^T (S. Echeandia and P. Wensing, "Numerical methods to compute the Coriolis matrix and Christoffel symbols
for rigid-body systems", 2021), as Pinocchio's. M is U D U^T with a unit upper triangular U, so that U^T qd are
velocities whose inertias D are not coupled.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from scara_effmass.kernel.codes import Model
from scara_effmass.kernel.compiled import inlined
from scara_effmass.kernel.records import Setup, Work
from scara_effmass.kernel.spatial import (
    NO_MOTION,
    Force,
    Inertia,
    Matrix,
    Motion,
    add,
    add_inertia,
    add_matrices,
    compose,
    cross,
    cross_motion,
    dot,
    force_at,
    inertia_at,
    matrix_at,
    momentum,
    motion_at,
    power,
    rotate,
    rotate_back,
    scale,
    set_inertia,
    set_matrix,
    set_spatial,
    set_vector,
    shift_force,
    shift_inertia,
    shift_motion,
    skew_product,
    sub,
    symmetric_product,
    symmetric_skew,
    turn,
    vector,
    vector_at,
)
from scara_effmass.values import ZERO_VECTOR, FloatArray, Mobility6, Vector3


class Flow(NamedTuple):
    """Coriolis matrix B of a moving link: B (w, v) is the force w x p and the torque T^T w, with its momentum p."""

    momentum: Vector3
    torque: Matrix


@inlined
def fill_dynamics(q: FloatArray, setup: Setup, work: Work) -> None:
    """Write poses and velocities at `q` and `work.qd`, the factors of each model's M, and gravity."""
    place_joints(q, setup, work)
    for k in range(2):
        work.has_coriolis[k] = 0
        if setup.has_full or setup.needs_gravity if k == Model.FULL else setup.has_lumped:
            place_bodies(k, setup, work)
            fill_mass_matrix(k, setup, work)
            factorize(k, setup.joints, work)
    if setup.needs_gravity:
        fill_gravity(setup, work)


@inlined
def place_joints(q: FloatArray, setup: Setup, work: Work) -> None:
    """Write the pose of each joint, its motion S in `axes`, dS/dt in `axis_rates`, and the velocity of its link."""
    for j in range(setup.joints):
        parent = setup.parent[j]
        rotation, origin = matrix_at(setup.rotation, j), vector_at(setup.place, j)
        velocity = NO_MOTION
        if parent >= 0:
            base, base_place = matrix_at(work.rotations, parent), vector_at(work.places, parent)
            rotation, origin = compose(base, rotation), add(base_place, rotate(base, origin))
        axis = vector_at(setup.axis, j)
        axis_in_base = rotate(rotation, axis)
        if setup.is_revolute[j]:
            s, c = math.sin(q[j]), math.cos(q[j])
            rotation = turn(rotation[0], axis, s, c), turn(rotation[1], axis, s, c), turn(rotation[2], axis, s, c)
            motion = Motion(axis_in_base, ZERO_VECTOR)
        else:
            origin = add(origin, scale(q[j], axis_in_base))
            motion = Motion(ZERO_VECTOR, axis_in_base)
        set_matrix(work.rotations[j], rotation)
        set_vector(work.places, j, origin)
        if parent >= 0:
            lever = sub(origin, vector_at(work.places, parent))
            velocity = shift_motion(motion_at(work.velocities, parent), lever)
        rate, qd = cross_motion(velocity, motion), work.qd[j]
        set_spatial(work.axes, j, motion.angular, motion.linear)
        set_spatial(work.axis_rates, j, rate.angular, rate.linear)
        angular, linear = scale(qd, motion.angular), scale(qd, motion.linear)
        set_spatial(work.velocities, j, add(velocity.angular, angular), add(velocity.linear, linear))


@inlined
def rotate_inertia(m: Matrix, s: Mobility6) -> Mobility6:
    """Return M S M^T."""
    x, y, z = symmetric_product(s, m[0]), symmetric_product(s, m[1]), symmetric_product(s, m[2])
    return dot(x, m[0]), dot(x, m[1]), dot(x, m[2]), dot(y, m[1]), dot(y, m[2]), dot(z, m[2])


@inlined
def place_bodies(k: int, setup: Setup, work: Work) -> None:
    """Write the inertia of each link of model `k` about the place of its joint."""
    for j in range(setup.joints):
        rotation, mass, i = matrix_at(work.rotations, j), setup.mass[k, j], setup.inertia[k, j]
        about_com = i[0, 0], i[0, 1], i[0, 2], i[1, 1], i[1, 2], i[2, 2]
        body = Inertia(0.0, ZERO_VECTOR, rotate_inertia(rotation, about_com))
        lever = rotate(rotation, vector_at(setup.lever[k], j))
        first = scale(mass, lever)
        point = Inertia(mass, first, symmetric_skew(lever, first))
        set_inertia(work.inertias[k], j, add_inertia(body, point))


@inlined
def fill_mass_matrix(k: int, setup: Setup, work: Work) -> None:
    """Write M (n, n) in the upper half of `factors`, with the inertias of the subtrees and their momenta (CRBA)."""
    n, matrix, composites, places = setup.joints, work.factors[k], work.composites[k], work.places
    for i in range(n):
        for j in range(i, n):
            matrix[i, j] = setup.coupling[i, j]
        set_inertia(composites, i, inertia_at(work.inertias[k], i))
    for i in range(n - 1, -1, -1):
        parent, place, subtree = setup.parent[i], vector_at(places, i), inertia_at(composites, i)
        if parent >= 0:
            moved = shift_inertia(subtree, sub(place, vector_at(places, parent)))
            set_inertia(composites, parent, add_inertia(inertia_at(composites, parent), moved))
        of_joint, j = momentum(subtree, motion_at(work.axes, i)), i
        set_spatial(work.momenta[k], i, of_joint.angular, of_joint.linear)
        while j >= 0:
            moment = shift_force(of_joint, sub(place, vector_at(places, j)))
            matrix[j, i] += power(motion_at(work.axes, j), moment)
            j = setup.parent[j]
        matrix[i, i] += setup.armature[k, i]
        work.diagonals[k, i] = matrix[i, i]


@inlined
def factorize(k: int, n: int, work: Work) -> None:
    """Put U D U^T of M (n, n) in its place, from the last joint to the first: D^-1 on the diagonal, U above it."""
    factors = work.factors[k]
    for i in range(n - 1, -1, -1):
        inverse = 1.0 / factors[i, i]
        for j in range(i):
            share = factors[j, i] * inverse
            for h in range(j + 1):
                factors[h, j] -= share * factors[h, i]
        for j in range(i):
            factors[j, i] *= inverse
        factors[i, i] = inverse


@inlined
def fill_gravity(setup: Setup, work: Work) -> None:
    """Write the efforts that hold the full model against gravity."""
    gravity = vector(setup.gravity)
    for j in range(setup.joints):
        subtree = inertia_at(work.composites[Model.FULL], j)
        weight = Force(cross(subtree.first, gravity), scale(subtree.mass, gravity))
        work.gravity[j] = -power(motion_at(work.axes, j), weight)


@inlined
def flow_at(array: FloatArray, i: int) -> Flow:
    """Return row `i` of an array (n, 12)."""
    a = array[i]
    return Flow((a[0], a[1], a[2]), ((a[3], a[4], a[5]), (a[6], a[7], a[8]), (a[9], a[10], a[11])))


@inlined
def set_flow(array: FloatArray, i: int, flow: Flow) -> None:
    """Write row `i` of an array (n, 12)."""
    a = array[i]
    (a[0], a[1], a[2]), ((a[3], a[4], a[5]), (a[6], a[7], a[8]), (a[9], a[10], a[11])) = flow


@inlined
def flow_of(body: Inertia, v: Motion) -> Flow:
    """Return the flow of a link: T^T = (h . v) 1 - v h^T - w x P, with first moments h and P, the sum of m r r^T."""
    s = body.second
    half = 0.5 * (s[0] + s[3] + s[5])
    p = (half - s[0], -s[1], -s[2]), (-s[1], half - s[3], -s[4]), (-s[2], -s[4], half - s[5])
    turned = cross(p[0], v.angular), cross(p[1], v.angular), cross(p[2], v.angular)
    torque = add_matrices(skew_product(body.first, v.linear), turned)
    return Flow(momentum(body, v).linear, torque)


@inlined
def add_flow(a: Flow, b: Flow, lever: Vector3) -> Flow:
    """Return the flow of `a` and of `b`, whose place is `lever` further on."""
    torque = add_matrices(a.torque, add_matrices(b.torque, skew_product(lever, b.momentum)))
    return Flow(add(a.momentum, b.momentum), torque)


@inlined
def fill_coriolis_matrix(k: int, setup: Setup, work: Work) -> None:
    """Write C (n, n), after `fill_mass_matrix`."""
    n, places, flows, matrix = setup.joints, work.places, work.flows, work.coriolis[k]
    for i in range(n):
        for j in range(n):
            matrix[i, j] = 0.0
        set_flow(flows, i, flow_of(inertia_at(work.inertias[k], i), motion_at(work.velocities, i)))
    for i in range(n - 1, -1, -1):
        parent, place, flow, s = setup.parent[i], vector_at(places, i), flow_at(flows, i), motion_at(work.axes, i)
        if parent >= 0:
            set_flow(flows, parent, add_flow(flow_at(flows, parent), flow, sub(place, vector_at(places, parent))))
        turning = momentum(inertia_at(work.composites[k], i), motion_at(work.axis_rates, i))
        angular = add(turning.angular, rotate_back(flow.torque, s.angular))
        force = Force(angular, add(turning.linear, cross(s.angular, flow.momentum)))
        coupled = add(cross(flow.momentum, s.linear), rotate(flow.torque, s.angular))
        of_joint, j = force_at(work.momenta[k], i), i
        while j >= 0:
            lever, t = sub(place, vector_at(places, j)), motion_at(work.axes, j)
            matrix[j, i] = power(t, shift_force(force, lever))
            if i != j:
                rate = power(motion_at(work.axis_rates, j), shift_force(of_joint, lever))
                matrix[i, j] = rate + dot(t.angular, coupled)
            j = setup.parent[j]


@inlined
def fill_coriolis(k: int, setup: Setup, work: Work) -> None:
    """Write C (n, n) and C qd (n,)."""
    fill_coriolis_matrix(k, setup, work)
    n, matrix = setup.joints, work.coriolis[k]
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += matrix[i, j] * work.qd[j]
        work.bias[k, i] = total
    work.has_coriolis[k] = 1
