# SPDX-License-Identifier: Apache-2.0
"""Jacobian, mobilities and change of pose of one contact point, from the dynamics of its joint state.

Joints after that of the contact point do not move it: all sums end there. With M = U D U^T, A is the sum of D^-1 y y^T
over the rows y of U^-1 J_v^T, the Jacobian of the uncoupled velocities.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from scara_effmass.kernel.codes import Model, Normal
from scara_effmass.kernel.compiled import inlined
from scara_effmass.kernel.dynamics import fill_coriolis
from scara_effmass.kernel.pose_change import set_change
from scara_effmass.kernel.records import MIN_NORMAL_COMPONENT, Mobility, Point, Setup, Work
from scara_effmass.kernel.spatial import (
    NO_MATRIX,
    add,
    add_matrices,
    add_symmetric,
    cross,
    dot,
    matrix_at,
    motion_at,
    norm,
    outer,
    rotate,
    scale,
    set_vector,
    shift_motion,
    sub,
    symmetric_outer,
    vector,
    vector_at,
)
from scara_effmass.values import NO_MOBILITY, ZERO_VECTOR, FloatArray, Mobility6, Vector3


class Approach(NamedTuple):
    """Motion of a contact point towards a contact.

    The first `joints` joints can move it. `place` [m], `velocity` and the `tolerance` of the speed [m/s] are in base
    axes; `direction` is zero below the speed threshold. The part `share` of the speed counts along the fixed `normal`,
    at least MIN_NORMAL_COMPONENT; it is 1 at rest and without a fixed normal. Accelerations are those `shown` by the
    joint states, J_v qdd, with its `error`, and of `held` joint velocities. If it `is_limited`, the error is the stated
    limit of the acceleration. `fastest_joint` has the largest
    `joint_acceleration` [rad/s2, m/s2] of those before the point. `vertex` is that of the hull of a link, else -1.
    """

    joints: int
    rank: int
    place: Vector3
    velocity: Vector3
    direction: Vector3
    speed: float
    is_moving: bool
    normal: Vector3
    share: float
    tolerance: float
    shown: Vector3
    held: Vector3
    error: float
    is_limited: bool
    fastest_joint: int
    joint_acceleration: float
    vertex: int


@inlined
def in_base(joint: int, array: FloatArray, rotations: FloatArray) -> Vector3:
    """Return a vector in the frame of `joint`, -1 the base, in base axes."""
    if joint < 0:
        return vector(array)
    return rotate(matrix_at(rotations, joint), vector(array))


@inlined
def approach_of(point: Point, vertex: int, motion: FloatArray, age: float, setup: Setup, work: Work) -> Approach:
    """Write the rows of J_v^T and dJ_v^T/dt; return the motion of the contact point.

    That is `vertex` of the hull of a link, unless it is -1. `motion` has the tolerances of qd in row 2, accelerations
    and their errors in rows 3 and 4; it is `age` [s] old.
    """
    joint = point.joint
    lever = in_base(joint, point.place, work.rotations) if vertex < 0 else vector_at(work.vertices, vertex)
    place = add(vector_at(work.places, joint), lever)
    velocity, shown, tolerance, error = ZERO_VECTOR, ZERO_VECTOR, 0.0, 0.0
    fastest, joint_acceleration = 0, 0.0
    for i in range(joint + 1):
        set_vector(work.jacobian, i, ZERO_VECTOR)
    j = joint
    while j >= 0:
        column = shift_motion(motion_at(work.axes, j), sub(place, vector_at(work.places, j))).linear
        set_vector(work.jacobian, j, column)
        velocity = add(velocity, scale(work.qd[j], column))
        shown = add(shown, scale(motion[3, j], column))
        tolerance += motion[2, j] * norm(column)
        error += motion[4, j] * norm(column)
        of_joint = abs(motion[3, j] + motion[5, j])
        if of_joint > joint_acceleration:
            fastest, joint_acceleration = j, of_joint
        j = setup.parent[j]
    speed = norm(velocity)
    is_moving = speed >= setup.speed_threshold and speed > 0.0
    n = ZERO_VECTOR
    if is_moving:
        n = velocity[0] / speed, velocity[1] / speed, velocity[2] / speed
    elif vertex >= 0:
        speed = math.sqrt(work.fastest_square)
    normal, share = in_base(setup.normal_joint, setup.normal_vector, work.rotations), 1.0
    if setup.normal == Normal.FIXED and is_moving:
        share = max(abs(dot(n, normal)), MIN_NORMAL_COMPONENT)
    held = fill_jacobian_rate(joint, place, velocity, setup, work)
    total = add(shown, held)
    rate = (max(0.0, dot(n, total)) if is_moving else norm(total)) + error
    is_limited = setup.max_acceleration >= norm(shown) + error
    if is_limited:
        error = setup.max_acceleration
    return Approach(
        joint + 1,
        point.rank,
        place,
        velocity,
        n,
        speed,
        is_moving,
        normal,
        share,
        tolerance + age * max(rate, setup.max_acceleration),
        shown,
        held,
        error,
        is_limited,
        fastest,
        joint_acceleration,
        vertex,
    )


@inlined
def fill_jacobian_rate(joint: int, place: Vector3, velocity: Vector3, setup: Setup, work: Work) -> Vector3:
    """Write the rows of dJ_v^T/dt; return the acceleration of the point with held joint velocities."""
    acceleration, j = ZERO_VECTOR, joint
    for i in range(joint + 1):
        set_vector(work.jacobian_rate, i, ZERO_VECTOR)
    while j >= 0:
        lever = sub(place, vector_at(work.places, j))
        turned = cross(motion_at(work.axes, j).angular, velocity)
        rate = add(shift_motion(motion_at(work.axis_rates, j), lever).linear, turned)
        set_vector(work.jacobian_rate, j, rate)
        acceleration = add(acceleration, scale(work.qd[j], rate))
        j = setup.parent[j]
    return acceleration


@inlined
def squared_jacobian(count: int, work: Work) -> Mobility6:
    """Return J_v J_v^T."""
    total = NO_MOBILITY
    for i in range(count):
        column = vector_at(work.jacobian, i)
        total = add_symmetric(total, symmetric_outer(column, column))
    return total


@inlined
def mobility_of(k: int, count: int, work: Work) -> Mobility6:
    """Write the rows of U^-1 J_v^T of model `k`; return A."""
    factors, uncoupled, total = work.factors[k], work.uncoupled[k], NO_MOBILITY
    for i in range(count - 1, -1, -1):
        y = vector_at(work.jacobian, i)
        for j in range(i + 1, count):
            y = sub(y, scale(factors[i, j], vector_at(uncoupled, j)))
        set_vector(uncoupled, i, y)
        total = add_symmetric(total, symmetric_outer(y, scale(factors[i, i], y)))
    return total


@inlined
def fill_responses(k: int, count: int, joints: int, work: Work) -> None:
    """Write the first `joints` rows of M^-1 J_v^T, after `mobility_of`."""
    factors, responses = work.factors[k], work.responses
    for i in range(joints):
        response = scale(factors[i, i], vector_at(work.uncoupled[k], i)) if i < count else ZERO_VECTOR
        for j in range(i):
            response = sub(response, scale(factors[j, i], vector_at(responses, j)))
        set_vector(responses, i, response)


@inlined
def fill_change(
    k: int, m: Mobility6, approach: Approach, held: Vector3, setup: Setup, work: Work, out: Mobility
) -> None:
    """Write the change of pose of model `k`: K M^-1 J_v^T and K qd, with K = dJ_v/dt - J_v M^-1 C."""
    if not work.has_coriolis[k]:
        fill_coriolis(k, setup, work)
    joints, coriolis, bias = setup.joints, work.coriolis[k], work.bias[k]
    fill_responses(k, approach.joints, joints, work)
    powers, free = NO_MATRIX, held
    for i in range(joints):
        response, opposed = vector_at(work.responses, i), ZERO_VECTOR
        for j in range(joints):
            opposed = sub(opposed, scale(coriolis[i, j], vector_at(work.responses, j)))
        if i < approach.joints:
            powers = add_matrices(powers, outer(vector_at(work.jacobian_rate, i), response))
        powers = add_matrices(powers, outer(response, opposed))
        free = sub(free, scale(bias[i], response))
    set_change(out, m, approach.direction, approach.speed, powers, free, held)


@inlined
def held_mobility(k: int, count: int, work: Work) -> Mobility6:
    """Return A if a controller of its own holds each joint: only the diagonal of M counts."""
    total = NO_MOBILITY
    for i in range(count):
        column = vector_at(work.jacobian, i)
        total = add_symmetric(total, symmetric_outer(column, scale(1.0 / work.diagonals[k, i], column)))
    return total


@inlined
def fill_held_change(k: int, m: Mobility6, approach: Approach, held: Vector3, work: Work, out: Mobility) -> None:
    """Write the change of pose of `held_mobility`, after `fill_change`: only the diagonal of C counts."""
    powers = NO_MATRIX
    for i in range(approach.joints):
        response = scale(1.0 / work.diagonals[k, i], vector_at(work.jacobian, i))
        rate = sub(vector_at(work.jacobian_rate, i), scale(work.coriolis[k, i, i], response))
        powers = add_matrices(powers, outer(rate, response))
    set_change(out, m, approach.direction, approach.speed, powers, held, held)


@inlined
def drive_acceleration(count: int, setup: Setup, work: Work) -> float:
    """Return an upper bound [m/s2] of the acceleration of the point under the effort limits; infinite if unknown."""
    largest = 0.0
    for j in range(setup.joints):
        if setup.effort[j] == math.inf or abs(work.gravity[j]) > setup.effort[j]:
            return math.inf
    for k in range(2):
        if setup.has_full if k == Model.FULL else setup.has_lumped:
            fill_responses(k, count, setup.joints, work)
            total = 0.0
            for j in range(setup.joints):
                total += norm(vector_at(work.responses, j)) * (setup.effort[j] + abs(work.gravity[j]))
            largest = max(largest, total)
    return largest if setup.has_lumped or setup.has_full else math.inf
