# SPDX-License-Identifier: Apache-2.0
"""Acceleration that goes on through a contact. `reference.mobility` derives the equations."""

from __future__ import annotations

import math

from scara_effmass.iso15066.allowable_speed import CLAMPED_SHARE
from scara_effmass.kernel.codes import Model, Normal
from scara_effmass.kernel.compiled import inlined
from scara_effmass.kernel.contact_point import Approach
from scara_effmass.kernel.mobility import inverse, trace
from scara_effmass.kernel.pose_change import assign, matrix_of
from scara_effmass.kernel.records import MIN_NORMAL_COMPONENT, Case, Mobility, Setup, Work
from scara_effmass.kernel.spatial import dot, norm, scale, sub, symmetric_product, vector
from scara_effmass.reference.mobility import REACH_TOLERANCE
from scara_effmass.values import ZERO_VECTOR, Mobility6, Vector3


@inlined
def set_acceleration(k: int, heaviest: float, approach: Approach, setup: Setup, work: Work, out: Mobility) -> None:
    """Write the acceleration with the masses of model `k`, the `heaviest` of all directions."""
    out.heaviest, out.error, out.error_root = heaviest, approach.error, math.inf
    assign(out.shown, ZERO_VECTOR)
    assign(out.opposed, ZERO_VECTOR)
    if approach.is_limited:
        return
    if not approach.is_moving:
        out.error += norm(approach.shown)
        return
    assign(out.shown, approach.shown)
    assign(out.opposed, approach.held)
    # Beside a stated limit that is smaller, the point may speed up by it: it could brake.
    out.error = max(out.error, setup.max_acceleration - max(0.0, dot(approach.direction, approach.shown)))
    if k != Model.ISO and setup.max_acceleration == 0.0:
        out.error_root = 0.0
        for j in range(setup.joints):
            out.error_root += math.sqrt(work.diagonals[k, j]) * work.errors[j]


@inlined
def along(out: Mobility, n: Vector3) -> float:
    """Return d/dt of the speed along n, without the part that the change of pose counts."""
    return dot(n, vector(out.shown)) + min(0.0, dot(n, vector(out.opposed)))


@inlined
def set_normal_acceleration(approach: Approach, setup: Setup, out: Mobility) -> None:
    """Write the acceleration of a contact with a known normal, or of a mass that is the same for every normal."""
    n = approach.direction
    if setup.normal == Normal.FIXED and approach.is_moving:
        n = approach.normal if dot(approach.direction, approach.normal) >= 0.0 else scale(-1.0, approach.normal)
    out.is_scalar, out.speed_rate = True, along(out, n)
    if setup.normal == Normal.FIXED and approach.share == MIN_NORMAL_COMPONENT:
        out.speed_rate = max(out.speed_rate, along(out, scale(-1.0, n)))


@inlined
def least_mobility(m: Mobility) -> float:
    """Return the smallest eigenvalue [1/kg] for errors of accelerations."""
    return max(REACH_TOLERANCE * trace(matrix_of(m)), inverse(m.heaviest))


@inlined
def error_root(m: Mobility, mass_factor: float, alpha: float, beta: float) -> float:
    """Return the largest sqrt(a^T K a) of the error a of the acceleration."""
    if not m.error > 0.0:
        return 0.0
    beta_per_mass = beta / mass_factor
    heaviest = inverse(alpha + beta_per_mass * least_mobility(m))
    root = math.sqrt(heaviest) * m.error
    return min(root, m.error_root / math.sqrt(beta_per_mass)) if beta > 0.0 else root


@inlined
def lasting_time(time: float, speed: float, rate: float) -> float:
    """Return for how much of the `time` a point at `speed` accelerates, which brakes at a `rate` below 0."""
    return time if rate >= 0.0 else min(time, -speed / rate)


@inlined
def rates_along(m: Mobility, k: Mobility6) -> tuple[float, float]:
    """Return the accelerations [m/s2] along and across the worst contact normal of the mass matrix `k`."""
    n, shown = vector(m.direction), vector(m.shown)
    x = symmetric_product(k, n)
    total = dot(n, x)
    if not 0.0 < total < math.inf:
        return 0.0, 0.0
    rest = sub(shown, scale(dot(x, shown) / total, n))
    across = math.sqrt(max(0.0, dot(rest, symmetric_product(k, rest)) / total))
    return along(m, x) / total, across


@inlined
def gain(m: Mobility, rate: float, across: float, root: float, mu: float, time: float) -> float:
    """Return by how much [m/s] the speed counts as higher, because the point accelerates for `time` [s].

    `rate` and `across` are those of `rates_along`, and `root` of `error_root`.
    """
    if m.is_scalar:
        return time * (max(0.0, m.speed_rate) + m.error)
    lasting = lasting_time(time, m.speed, rate)
    along_n, across_n = m.speed + lasting * rate, lasting * across
    faster = math.sqrt(along_n * along_n + across_n * across_n) - m.speed  # hypot is a call of the C library
    added: float = max(0.0, faster) + time * root / math.sqrt(mu)
    return added


@inlined
def max_rate(m: Mobility, x: Vector3, alpha: float) -> float:
    """Return a bound [m/s2] of the gain per time for every alpha / beta of at least `alpha` [1/kg].

    `x` is its mass matrix times n.
    """
    if m.is_scalar:
        return max(0.0, m.speed_rate) + m.error
    rate = norm(vector(m.shown)) + m.error
    if not rate > 0.0:
        return 0.0
    heaviest, total = inverse(alpha + least_mobility(m)), dot(vector(m.direction), x)
    return rate * math.sqrt(heaviest / total) if 0.0 < total < math.inf else math.inf


@inlined
def acceleration_time(case: Case, time: float) -> float:
    """Return the part of the `time` of the pose change for which the acceleration counts."""
    is_clamped = case.drive_time > 0.0 and case.obstacle_mobility == 0.0
    return CLAMPED_SHARE * time if is_clamped else time
