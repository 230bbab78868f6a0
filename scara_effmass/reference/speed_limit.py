# SPDX-License-Identifier: Apache-2.0
"""Allowable speed of a robot, whose mass depends on the contact normal and changes with the pose (ISO/TS 15066)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce

from scara_effmass.iso15066.allowable_speed import ContactCase, SpeedLimit
from scara_effmass.iso15066.drives import Line
from scara_effmass.reference.hull import TIE
from scara_effmass.reference.mobility import Mobility
from scara_effmass.reference.person import MovingPerson, person_speed_limit


@dataclass(frozen=True, slots=True)
class DrivePush:
    """Acceleration [m/s2] of the contact point that the effort limits allow, and its least mobility [1/kg].

    `clamping_limit` [N] is the force at which the robot stops pushing on a clamped body part.
    """

    acceleration: float
    min_mobility: float
    clamping_limit: float = math.inf

    def force(self, obstacle_mobility: float) -> float:
        """Return the force P = a / (1/m_n + 1/m_H) [N] of drives that push robot and body part on."""
        mobility = self.min_mobility + obstacle_mobility
        force = self.acceleration / mobility if mobility > 0.0 else math.inf
        return force if obstacle_mobility > 0.0 else min(force, self.clamping_limit)


def speed_limit(
    cases: Sequence[ContactCase],
    mobilities: Sequence[Mobility],
    push: DrivePush | None = None,
    max_force: float = math.inf,
    person: MovingPerson | None = None,
) -> SpeedLimit:
    """Return the smallest allowable speed of all `cases` and all `mobilities`, the relative speed of robot and person.

    With a `person` it is the speed of the robot alone, negative if the person is too fast for a robot at rest.
    With a `push`, two bounds of the force hold, so the one that allows the higher speed counts: the simulated servo, up
    to the contact force `max_force` [N], and free joints under the constant force of `push`.
    """
    return min((_of_case(case, mobilities, push, max_force, person) for case in cases), key=_speed)


def _speed(found: SpeedLimit) -> float:
    return found.allowable_speed


def is_below(speed: float, other: float) -> bool:
    """Return whether `speed` is below the `other` one by more than rounding."""
    difference = other - speed
    return difference > TIE * abs(speed) or difference == math.inf


def _slower(first: SpeedLimit, other: SpeedLimit) -> SpeedLimit:
    """Return the limit with the smaller speed; of equal ones the first, so that rounding does not choose its force."""
    if is_below(other.allowable_speed, first.allowable_speed):
        return other
    return replace(first, allowable_speed=min(first.allowable_speed, other.allowable_speed))


def _faster(first: SpeedLimit, other: SpeedLimit) -> SpeedLimit:
    """Return the limit with the larger speed, of equal ones the first."""
    return other if is_below(first.allowable_speed, other.allowable_speed) else first


def _of_case(
    case: ContactCase,
    mobilities: Sequence[Mobility],
    push: DrivePush | None,
    max_force: float,
    person: MovingPerson | None,
) -> SpeedLimit:
    limits = [_of_mobility(case, m, case.lines_for(m.trace), max_force, person) for m in mobilities]
    found = replace(reduce(_slower, limits), others=tuple(limits))
    return found if push is None else max(found, _pushed(case, mobilities, push, person), key=_speed)


def _of_mobility(
    case: ContactCase,
    mobility: Mobility,
    lines: Sequence[Line],
    max_force: float = math.inf,
    person: MovingPerson | None = None,
) -> SpeedLimit:
    """Return the bound F = u sqrt(mu k), where 1/mu(n) >= alpha + beta n^T A n holds for every one of the `lines`."""
    if person is not None:
        force = max(0.0, min(case.force, max_force))
        limits: list[SpeedLimit] = [person_speed_limit(case, mobility, line, person, force) for line in lines]
        found = reduce(_faster, limits)
        return replace(found, allowable_speed=max(found.allowable_speed, -person.speed))  # none is slower than at rest
    alpha, beta = min(lines, key=lambda line: mobility.point_reduced_mass(*line))
    mu = mobility.reduced_mass(alpha, beta)
    growth = gain = 0.0
    if mu < math.inf:
        gain = mobility.gain(alpha, beta, case.acceleration_time(mu))
        if mobility.change is not None:
            # The force grows with the square root of v^T (...)^-1 v.
            growth = 0.5 * case.contact_time(mu) * mobility.growth(alpha, beta) / mobility.change.speed
    return case.speed_limit(mu, growth, max_force, gain)


def _pushed(
    case: ContactCase, mobilities: Sequence[Mobility], push: DrivePush, person: MovingPerson | None
) -> SpeedLimit:
    """Return the bound F = P + sqrt(P^2 + k mu u^2) of free joints and the push P; 0 from 2 P = F on.

    The push contains what accelerates the robot. An infinite one bounds nothing: its speed is minus infinity.
    """
    mobilities = [mobility.steady for mobility in mobilities]
    force = push.force(case.obstacle_mobility)
    if force == math.inf:
        return SpeedLimit(-math.inf, case.limit, 0.0, case.stiffness, force)
    root = math.sqrt(max(0.0, case.force * (case.force - 2.0 * force)))
    limits = [_of_mobility(case, m, ((case.obstacle_mobility, 1.0),), root, person) for m in mobilities]
    limits = [replace(limit, push=force) for limit in limits]
    found = replace(reduce(_slower, limits), others=tuple(limits))
    if root == 0.0:
        return replace(found, allowable_speed=-person.speed if person else 0.0)
    return found
