# SPDX-License-Identifier: Apache-2.0
"""Static forces that the joints can hold at a contact point: clamping, and contacts that saturate no drive."""

from __future__ import annotations

import math
from collections.abc import Sequence

from scara_effmass.kernel.codes import Normal
from scara_effmass.kernel.compiled import inlined
from scara_effmass.kernel.contact_point import Approach
from scara_effmass.kernel.pose_change import mass_matrix
from scara_effmass.kernel.records import Case, Mobility, Setup, Work
from scara_effmass.kernel.spatial import add, cross, dot, norm, scale, symmetric_product, vector, vector_at
from scara_effmass.reference.dynamics import EFFORT_ROUNDING, MIN_LEVER_M, SINGULAR_ROUNDING
from scara_effmass.values import Vector3


@inlined
def static_force(n: Vector3, count: int, setup: Setup, work: Work) -> float:
    """Return the static force [N] along `n` that the joints can hold; -inf if no joint pushes."""
    force = math.inf
    is_loaded = False
    for j in range(count):
        lever = dot(n, vector_at(work.jacobian, j))
        if abs(lever) > MIN_LEVER_M:
            is_loaded = True
            held = work.gravity[j] if lever > 0.0 else -work.gravity[j]
            force = min(force, (setup.effort[j] - held) / abs(lever))
    return force if is_loaded else -math.inf


@inlined
def push_count(setup: Setup) -> int:
    """Return the number of directions of a push whose direction is known."""
    return 2 if setup.normal == Normal.FIXED else 1


@inlined
def push_direction(i: int, approach: Approach, setup: Setup) -> Vector3:
    """Return one of them: both ways along a fixed normal, else the velocity."""
    return scale(1.0 - 2.0 * i, approach.normal) if setup.normal == Normal.FIXED else approach.direction


@inlined
def is_held(force: Vector3, count: int, setup: Setup, work: Work) -> bool:
    """Whether no joint exceeds its effort limit."""
    for j in range(count):
        effort = dot(force, vector_at(work.jacobian, j)) + work.gravity[j]
        if abs(effort) > (1.0 + EFFORT_ROUNDING) * setup.effort[j]:
            return False
    return True


@inlined
def vertex_force(i: int, j: int, k: int, count: int, setup: Setup, work: Work) -> float:
    """Return the largest force [N] with which three joints reach their limits and none exceeds its own, 0 if none does.

    Without a third joint, `k` < 0, it is in the plane of two.
    """
    a, b, largest = vector_at(work.jacobian, i), vector_at(work.jacobian, j), 0.0
    ab = cross(a, b)
    c = ab if k < 0 else vector_at(work.jacobian, k)
    volume = dot(ab, c)
    if not abs(volume) > SINGULAR_ROUNDING * norm(a) * norm(b) * norm(c):
        return 0.0
    for signs in range(4 if k < 0 else 8):
        x = (1 - 2 * (signs & 1)) * setup.effort[i] - work.gravity[i]
        y = (1 - (signs & 2)) * setup.effort[j] - work.gravity[j]
        z = 0.0 if k < 0 else (1 - (signs & 4) // 2) * setup.effort[k] - work.gravity[k]
        sides = add(scale(x, cross(b, c)), add(scale(y, cross(c, a)), scale(z, ab)))
        force = scale(1.0 / volume, sides)
        if is_held(force, count, setup, work):
            largest = max(largest, norm(force))
    return largest


@inlined
def largest_clamping_force(count: int, setup: Setup, work: Work) -> float:
    """Return the largest static force [N] along any direction in which the joints move the point, 0 if they do not."""
    largest = 0.0
    for i in range(count):
        lever = vector_at(work.jacobian, i)
        if norm(lever) > MIN_LEVER_M:
            n = scale(1.0 / norm(lever), lever)
            there, back = static_force(n, count, setup, work), static_force(scale(-1.0, n), count, setup, work)
            largest = max(largest, there, back, math.inf if setup.effort[i] == math.inf else 0.0)
            for j in range(i):
                for k in range(-1, j):
                    largest = max(largest, vertex_force(i, j, k, count, setup, work))
    return largest


@inlined
def clamping_force(approach: Approach, setup: Setup, work: Work) -> float:
    """Return the largest static force [N] in the directions of a push; infinite if unknown."""
    force = 0.0
    if setup.normal != Normal.FIXED and not approach.is_moving:
        force = largest_clamping_force(approach.joints, setup, work)
    else:
        for i in range(push_count(setup)):
            force = max(force, static_force(push_direction(i, approach, setup), approach.joints, setup, work))
    for j in range(setup.joints):
        if abs(work.gravity[j]) > setup.effort[j]:
            force = math.inf
    return min(force, setup.external_force)


@inlined
def smaller_force(force: float, n: Vector3, count: int, setup: Setup, work: Work) -> float:
    """Return the smaller of `force` and the static force [N] along `n`, if a joint pushes there."""
    held = static_force(n, count, setup, work)
    return min(force, held) if held > -math.inf else force


@inlined
def least_holding_force(count: int, setup: Setup, work: Work) -> float:
    """Return the force [N] along any unit vector up to which no joint reaches its effort limit."""
    force = math.inf
    for j in range(count):
        lever = norm(vector_at(work.jacobian, j))
        if lever > MIN_LEVER_M:
            force = min(force, (setup.effort[j] - abs(work.gravity[j])) / lever)
    return force


@inlined
def holding_force(
    approach: Approach, cases: Sequence[Case], changes: Sequence[Mobility], setup: Setup, work: Work
) -> float:
    """Return the contact force [N] up to which no joint reaches its effort limit."""
    force, alpha = math.inf, math.inf
    if setup.counts_person or (setup.normal != Normal.FIXED and not approach.is_moving):
        return least_holding_force(approach.joints, setup, work)
    for i in range(push_count(setup)):
        force = smaller_force(force, push_direction(i, approach, setup), approach.joints, setup, work)
    if setup.normal == Normal.FIXED:
        return force
    for i in range(len(cases)):
        alpha = min(alpha, cases[i].obstacle_mobility)
    for k in range(len(changes)):
        if changes[k].change_rank > 0:
            worst = symmetric_product(mass_matrix(changes[k], alpha, 1.0), vector(changes[k].direction))
            length = norm(worst)
            if 0.0 < length < math.inf:
                force = smaller_force(force, scale(1.0 / length, worst), approach.joints, setup, work)
    return force
