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
from scara_effmass.kernel.spatial import dot, norm, scale, symmetric_product, vector, vector_at
from scara_effmass.reference.pose_state import MIN_LEVER_M
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
def push_count(approach: Approach, setup: Setup) -> int:
    """Return the number of directions in which the arm may push."""
    if setup.normal == Normal.FIXED:
        return 2
    return 1 if approach.is_moving else 6


@inlined
def push_direction(i: int, approach: Approach, setup: Setup) -> Vector3:
    """Return one of them: both ways along a fixed normal, the velocity, or at rest each axis both ways."""
    sign, axis = 1.0 if i % 2 == 0 else -1.0, i // 2
    if setup.normal == Normal.FIXED:
        return scale(sign, approach.normal)
    if approach.is_moving:
        return approach.direction
    return sign * (axis == 0), sign * (axis == 1), sign * (axis == 2)


@inlined
def clamping_force(approach: Approach, setup: Setup, work: Work) -> float:
    """Return the largest static force [N] in the directions of a push; infinite if unknown."""
    force = 0.0
    for j in range(setup.joints):
        if abs(work.gravity[j]) > setup.effort[j]:
            force = math.inf
    for i in range(push_count(approach, setup)):
        force = max(force, static_force(push_direction(i, approach, setup), approach.joints, setup, work))
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
    for i in range(push_count(approach, setup)):
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
