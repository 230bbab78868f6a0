# SPDX-License-Identifier: Apache-2.0
"""Speed limits of one contact point: which case governs, as `reference.speed_limit` defines them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from scara_effmass.iso15066.drives import MAX_MOBILITY
from scara_effmass.kernel.acceleration import acceleration_time, error_root, gain, max_rate, rates_along
from scara_effmass.kernel.compiled import inlined
from scara_effmass.kernel.hull import energy_anywhere, first_energy_anywhere, worst_reduced_mass
from scara_effmass.kernel.mobility import inverse, point_reduced_mass
from scara_effmass.kernel.person import (
    MAX_ROUNDS,
    ROUNDED,
    Meeting,
    Person,
    energy_at,
    energy_with,
    max_speed,
    meeting_of,
    person_mass,
    present_root,
)
from scara_effmass.kernel.pose_change import contact_time, growth, mass_matrix, mass_polynomials, max_growth
from scara_effmass.kernel.records import HULL_KNOWN, HULL_NONE, Case, Mobility, Principal, Setup, Work
from scara_effmass.kernel.spatial import scale
from scara_effmass.reference import speed_limit as reference
from scara_effmass.values import ZERO_VECTOR


class Bound(NamedTuple):
    """Speed [m/s] that a case allows: reduced mass [kg], its growth [s/m], push of the drives [N], gain of speed [m/s].

    With a moving person, `root` is the peak force without the push over sqrt(k) at the present speed [m/s sqrt(kg)].
    """

    speed: float
    reduced_mass: float
    growth: float
    push: float
    root: float
    gain: float


class Drives(NamedTuple):
    """Largest acceleration [m/s2] and least mobility [1/kg] of a push, and the force [N] that saturates no joint.

    `has_push`: the bound of the push counts as well.
    """

    acceleration: float
    min_mobility: float
    max_force: float
    has_push: bool


class Line(NamedTuple):
    """Line of the drives for masses without their uncertainty, `mass_factor`."""

    alpha: float
    beta: float
    mass_factor: float


class Governing(NamedTuple):
    """Index of the case that allows the least speed, its bound, and the largest force [N] of the mobilities in `seen`.

    `seen` is a set of bits: one for each mobility whose bound was computed.
    """

    case: int
    bound: Bound
    force: float
    seen: int


is_below = inlined(reference.is_below)
NO_BOUND = Bound(math.inf, 0.0, 0.0, 0.0, 0.0, 0.0)


@inlined
def with_speed(bound: Bound, speed: float) -> Bound:
    """Return `bound` with another speed."""
    return Bound(speed, bound.reduced_mass, bound.growth, bound.push, bound.root, bound.gain)


@inlined
def with_push(bound: Bound, push: float) -> Bound:
    """Return `bound` with another push of the drives [N]."""
    return Bound(bound.speed, bound.reduced_mass, bound.growth, push, bound.root, bound.gain)


@inlined
def slower(first: Bound, other: Bound) -> Bound:
    """Return the bound with the smaller speed; of equal ones the first, so that rounding does not choose its force."""
    if is_below(other.speed, first.speed):
        return other
    return with_speed(first, min(first.speed, other.speed))


class Rates(NamedTuple):
    """How fast force and speed grow during a contact: `growth` [1/s] of the energy, accelerations [m/s2] of the point.

    `root` is `error_root`. All are 0 where they do not count.
    """

    growth: float
    along: float
    across: float
    root: float


@inlined
def rates_of(m: Mobility, mass_factor: float, line: tuple[float, float], accelerates: bool) -> Rates:  # noqa: FBT001 - compiled
    """Return the rates of a contact by one line of the drives."""
    growing = rate = across = root = 0.0
    if m.change_rank > 0:
        k = mass_matrix(m, mass_factor * line[0], line[1])
        growing = growth(m, k, line[1])
        if accelerates and not m.is_scalar:
            rate, across = rates_along(m, k)
            root = error_root(m, mass_factor, line[0], line[1])
    return Rates(growing, rate, across, root)


@inlined
def lasting_growth(case: Case, m: Mobility, rates: Rates, mu: float) -> float:
    """Return the growth [s/m] of the energy until the peak of a contact with the reduced mass `mu`."""
    if m.change_rank == 0:
        return 0.0
    time = case.drive_time if case.drive_time > 0.0 else contact_time(mu, case.stiffness)
    return 0.5 * time * rates.growth / m.speed


@inlined
def speed_gain(case: Case, m: Mobility, rates: Rates, at_point: float, mu: float) -> float:
    """Return the gain of speed [m/s] until the peak of a contact with the mass `mu`, `at_point` that of a point."""
    time = case.drive_time if case.drive_time > 0.0 else contact_time(mu, case.stiffness)
    return gain(m, rates.along, rates.across, rates.root, at_point, acceleration_time(case, time))


@inlined
def bound_of(
    case: Case,
    m: Mobility,
    mass_factor: float,
    at_point: float,
    line: tuple[float, float],
    rate: float,
    accelerates: bool,  # noqa: FBT001 - compiled
    least: float,
) -> Bound:
    """Return the bound of v^T (alpha 1 + beta A)^-1 v, whose reduced mass is known `at_point`.

    Of a link, it bounds nothing if it allows the speed `least` [m/s] anyway.
    """
    growing, gained, mu = 0.0, 0.0, at_point
    rates = rates_of(m, mass_factor, line, accelerates)
    if m.hull != HULL_NONE and mu < math.inf:
        enough = 0.0
        if 0.0 < least < math.inf:
            most = 1.0 / (rate * least * least)
            faster = least * (1.0 + lasting_growth(case, m, rates, most) * least)
            if accelerates:
                faster += speed_gain(case, m, rates, at_point, most)
            enough = 1.0 / (rate * faster * faster)
        mu = mass_factor * worst_reduced_mass(m, mass_factor * line[0], line[1], enough / mass_factor)
        if mu <= enough:
            return NO_BOUND
    if mu < math.inf:
        if accelerates:
            gained = speed_gain(case, m, rates, at_point, mu)
        growing = lasting_growth(case, m, rates, mu)
    inverse_square = mu * rate
    if inverse_square <= 0.0:
        return Bound(math.inf, mu, growing, 0.0, 0.0, gained)
    speed = 1.0 / math.sqrt(inverse_square) - gained
    if speed > 0.0:
        speed = 2.0 * speed / (1.0 + math.sqrt(1.0 + 4.0 * growing * speed))
    elif -math.inf < speed < 0.0:
        speed *= 1.0 - growing * speed
    return Bound(speed, mu, growing, 0.0, 0.0, gained)


@inlined
def immovable_bound(case: Case, m: Mobility, mass_factor: float, rate: float, least: float) -> Bound:
    """Return the bound if the drives do not give way."""
    mu = mass_factor * point_reduced_mass(m, mass_factor * case.obstacle_mobility, 0.0)
    return bound_of(case, m, mass_factor, mu, (case.obstacle_mobility, 0.0), rate, True, least)  # noqa: FBT003 - compiled


@inlined
def free_bound(case: Case, m: Mobility, mass_factor: float, rate: float, least: float) -> Bound:
    """Return the bound of free joints; the push of the drives contains what accelerates them."""
    mu = mass_factor * point_reduced_mass(m, mass_factor * case.obstacle_mobility, 1.0)
    return bound_of(case, m, mass_factor, mu, (case.obstacle_mobility, 1.0), rate, False, least)  # noqa: FBT003 - compiled


@inlined
def is_no_slower(case: Case, k: int, mobility: float, rate: float, least: float, work: Work) -> bool:
    """Return whether `case` with 1 / mu of at least `mobility` [1/kg] allows the speed `least` [m/s] anyway.

    By what bounds every case with mobility `k`.
    """
    if not 0.0 < least < math.inf:  # of several cases that allow none, the first counts
        return False
    time = case.drive_time if case.drive_time > 0.0 else contact_time(inverse(mobility), case.stiffness)
    speed = least * (1.0 + work.growths[k] * time * least) + work.accelerations[k] * time
    allows: bool = rate * speed * speed <= mobility  # `speed` may be NaN
    return allows


@inlined
def case_bound(case: Case, m: Mobility, k: int, mass_factor: float, rate: float, least: float, work: Work) -> Bound:
    """Return the bound of the drives of the settings, of simulated contacts within the range of their simulation.

    It bounds nothing where it is found early to allow the speed `least` [m/s] anyway.
    """
    on_robot = work.least_mobilities[k]
    mobility = case.lines[0, 0] + case.lines[0, 1] * on_robot
    for i in range(1, case.line_count):
        of_line = case.lines[i, 0] + case.lines[i, 1] * on_robot
        # Every line is a bound; on a link, the one that is taken below may be any.
        mobility = max(mobility, of_line) if m.hull == HULL_NONE else min(mobility, of_line)
    if is_no_slower(case, k, mobility / m.speed_ratio, rate, least, work):
        return NO_BOUND
    if case.line_count > 1 and not m.matrix_trace <= MAX_MOBILITY * mass_factor:
        return immovable_bound(case, m, mass_factor, rate, least)
    mu, alpha, beta = math.inf, 0.0, 0.0
    for i in range(case.line_count):
        line_alpha, line_beta = case.lines[i, 0], case.lines[i, 1]
        line_mu = mass_factor * point_reduced_mass(m, mass_factor * line_alpha, line_beta)
        if line_mu < mu:
            mu, alpha, beta = line_mu, line_alpha, line_beta
    if m.hull != HULL_NONE and is_no_slower(case, k, (alpha + beta * on_robot) / m.speed_ratio, rate, least, work):
        return NO_BOUND
    return bound_of(case, m, mass_factor, mu, (alpha, beta), rate, True, least)  # noqa: FBT003 - compiled


@inlined
def holding_rate(case: Case, drives: Drives) -> float:
    """Return `case.rate`, with the force that saturates no joint where that is less than the limit."""
    rate = case.rate
    if drives.max_force < case.force:
        excess = case.force / drives.max_force if drives.max_force > 0.0 else math.inf
        rate *= excess * excess
    return rate


@inlined
def push_force(case: Case, drives: Drives, setup: Setup) -> float:
    """Return the force of drives that push robot and body part on."""
    mobility = drives.min_mobility / setup.mass_factor + case.obstacle_mobility
    force = drives.acceleration / mobility if mobility > 0.0 else math.inf
    return force if case.obstacle_mobility > 0.0 else min(force, setup.external_force)


@inlined
def pushed_rate(case: Case, force: float, push: float) -> float:
    """Return k / (F^2 - 2 F P), the rate at which free joints under the push P reach the force F; infinite: P does."""
    square = force * (force - 2.0 * push)
    return case.stiffness / square if square > 0.0 else math.inf


@inlined
def push_bound(
    case: Case, mobilities: Sequence[Mobility], drives: Drives, setup: Setup, speed: float, least: float
) -> Bound:
    """Return the bound of free joints and the push of the drives; an infinite push bounds nothing.

    Of a link, it bounds nothing where one of its points shows that it does not allow more than `speed` [m/s], or where
    it allows the speed `least` [m/s] anyway.
    """
    force = push_force(case, drives, setup)
    rate = pushed_rate(case, case.force, force)
    if rate == math.inf:
        return Bound(0.0 if force < math.inf else -math.inf, 0.0, 0.0, force, 0.0, 0.0)
    slowest, factor = NO_BOUND, setup.mass_factor
    for k in range(len(mobilities)):
        m = mobilities[k]
        if m.hull != HULL_NONE and speed > 0.0:
            mu = factor * point_reduced_mass(m, factor * case.obstacle_mobility, 1.0)
            if mu * rate * speed * speed >= 1.0:
                return Bound(-math.inf, 0.0, 0.0, force, 0.0, 0.0)
        bound = free_bound(case, m, factor, rate, least)
        slowest = bound if k == 0 else slower(slowest, bound)
    return with_push(slowest, force)


@inlined
def fill_bounds(mobilities: Sequence[Mobility], setup: Setup, work: Work) -> None:
    """Write what bounds every case with each mobility: most cases cannot set the speed.

    1 / mu(s), mu(s) = n^T (s 1 + A)^-1 n, rises by at least 1 per s (Cauchy-Schwarz); on a link, mu is at most that of
    one mass everywhere with its energy.
    """
    factor = setup.mass_factor
    alpha = factor * setup.min_alpha
    for k in range(len(mobilities)):
        m = mobilities[k]
        mobility = inverse(point_reduced_mass(m, alpha, 1.0)) - alpha
        if m.hull == HULL_KNOWN:
            mobility = m.square * m.speed_ratio / m.energy_of_arm
        work.least_mobilities[k] = mobility / factor
        x, work.growths[k] = ZERO_VECTOR, 0.0
        if m.change_rank > 0:
            masses = mass_polynomials(m, alpha)
            x = scale(inverse(masses.denominator[0]), masses.x0)
            work.growths[k] = 0.5 * max_growth(m, masses) / m.speed
        # Outside the range of the simulated contacts no case is skipped.
        work.accelerations[k] = max_rate(m, x, alpha) if m.matrix_trace <= MAX_MOBILITY * factor else math.inf


@inlined
def likely_case(cases: Sequence[Case], mass: float) -> int:
    """Return the case with the largest force over its limit for an effective mass [kg]: most others can be skipped."""
    likely, largest = 0, -1.0
    for i in range(len(cases)):
        square = cases[i].rate * mass / (1.0 + cases[i].obstacle_mobility * mass)
        if square > largest:
            likely, largest = i, square
    return likely


@inlined
def case_index(n: int, count: int) -> int:
    """Return the remainder of n, below twice `count`, without a division of integers, which is slow."""
    return n if n < count else n - count


@inlined
def force_of(bound: Bound, case: Case, hit: float, setup: Setup) -> float:
    """Return the bound of the force [N] of a contact at the speed `hit`."""
    energy = bound.root * bound.root
    if not setup.counts_person:
        if bound.reduced_mass < setup.mass_cap:
            hit = hit * (1.0 + bound.growth * hit) + bound.gain
        energy = min(bound.reduced_mass, setup.mass_cap) * hit * hit
    return setup.amplification * (bound.push + math.sqrt(bound.push * bound.push + case.stiffness * energy))


@inlined
def with_mobility(governing: Governing, k: int, bound: Bound, case: Case, hit: float, setup: Setup) -> Governing:
    """Return `governing` with the bound of mobility `k`, if there is one."""
    if bound.speed == math.inf:
        return governing
    force = max(governing.force, force_of(bound, case, hit, setup))
    return Governing(governing.case, slower(governing.bound, bound), force, governing.seen | 1 << k)


@inlined
def first_slowest(governing: Governing, other: Governing) -> Governing:
    """Return the one with the smaller speed; of equal ones that of the first case."""
    speed, least = other.bound.speed, governing.bound.speed
    return other if speed < least or (speed == least and other.case < governing.case) else governing


@inlined
def governing_case(
    cases: Sequence[Case],
    start: int,
    mobilities: Sequence[Mobility],
    drives: Drives,
    hit: float,
    setup: Setup,
    work: Work,
) -> Governing:
    """Return the case that allows the least speed, with forces at the speed `hit` [m/s].

    `start` is the first case that is tried.
    """
    governing = Governing(0, NO_BOUND, 0.0, 0)
    fill_bounds(mobilities, setup, work)
    for n in range(len(cases)):
        i = case_index(start + n, len(cases))
        case, tried = cases[i], Governing(i, NO_BOUND, 0.0, 0)
        rate = holding_rate(case, drives)
        for k in range(len(mobilities)):
            least = min(governing.bound.speed, tried.bound.speed)
            bound = case_bound(case, mobilities[k], k, setup.mass_factor, rate, least, work)
            tried = with_mobility(tried, k, bound, case, hit, setup)
        if drives.has_push and tried.bound.speed <= governing.bound.speed:
            bound = push_bound(case, mobilities, drives, setup, tried.bound.speed, governing.bound.speed)
            if tried.bound.speed < bound.speed:
                tried = Governing(i, bound, force_of(bound, case, hit, setup), 0)
        governing = first_slowest(governing, tried)
    return governing


@inlined
def ratio_at(meeting: Meeting, m: Mobility, line: Line, s: float) -> float:
    """Return a bound of the force anywhere on a link over that at its vertex, at the speed `s`."""
    at_vertex = energy_with(energy_at(meeting, s), s) / line.mass_factor
    mass = meeting.heaviest / line.mass_factor
    return math.sqrt(max(1.0, energy_anywhere(m, line.alpha, line.beta, mass, s, meeting.person_speed) / at_vertex))


@inlined
def max_link_speed(meeting: Meeting, m: Mobility, line: Line, root: float) -> float:
    """Return `max_speed` of a point whose whole link has up to `ratio_at` times its root.

    By the Illinois method; what it returns is never above the limit.
    """
    slow, fast, at_rest = 0.0, max_speed(meeting, root) + meeting.gain, ratio_at(meeting, m, line, 0.0)
    below = root - at_rest * present_root(meeting, -meeting.gain)
    if below < 0.0:
        return max_speed(meeting, root / at_rest)
    speed, above, last = fast, 0.0, 0.0
    for _ in range(MAX_ROUNDS):
        excess = ratio_at(meeting, m, line, speed) * present_root(meeting, speed - meeting.gain) - root
        if excess <= 0.0:
            slow, below = speed, -excess
            above *= 0.5 if last < 0.0 else 1.0
        else:
            fast, above = speed, excess
            below *= 0.5 if last > 0.0 else 1.0
        last = excess
        if fast - slow <= ROUNDED * fast or -ROUNDED * root <= excess <= 0.0:
            break
        speed = slow + (fast - slow) * below / (below + above)
    return slow - meeting.gain


@inlined
def person_line_bound(
    case: Case,
    p: Principal,
    m: Mobility,
    setup: Setup,
    line: tuple[float, float],
    rate: float,
    person: Person,
    least: float,
) -> Bound:
    """Return the bound of one line of the drives with a moving person, whose speed is not part of it.

    It bounds nothing if it allows the speed `least` [m/s] anyway.
    """
    alpha, beta, factor = setup.mass_factor * line[0], line[1], setup.mass_factor
    meeting, limit = meeting_of(case, p, factor, line[0], beta, person, math.inf), rate**-0.5
    enough = slow = 0.0
    if math.isfinite(least):
        slow = max(least + meeting.gain, 0.0)
        enough = limit / present_root(meeting, slow - meeting.gain)
    ratio, is_link = 1.0, m.hull != HULL_NONE and meeting.heaviest < math.inf
    is_clamped = case.obstacle_mobility == 0.0
    if is_link:
        mass, moving = meeting.heaviest / factor, person.speed
        at_vertex = energy_with(energy_at(meeting, slow), slow) / factor
        if is_clamped:  # the robot's share of the energy decides, at any speed
            at_vertex = mass = point_reduced_mass(m, alpha, beta)
            slow, moving = 1.0, 0.0
        energy = first_energy_anywhere(m, alpha, beta, mass, slow, moving, enough * enough * at_vertex)
        ratio = math.sqrt(max(1.0, energy / at_vertex))
    if ratio <= enough:
        return NO_BOUND
    if is_link and not is_clamped:
        of_line = Line(alpha, beta, factor)
        speed = max_link_speed(meeting, m, of_line, limit)
        ratio = ratio_at(meeting, m, of_line, person.robot_speed + meeting.gain)
    else:
        speed = max_speed(meeting, limit / ratio)
    if meeting.heaviest > setup.mass_cap:
        meeting = meeting_of(case, p, factor, line[0], beta, person, setup.mass_cap)
    return Bound(speed, person_mass(meeting), 0.0, 0.0, ratio * present_root(meeting, person.robot_speed), 0.0)


@inlined
def no_slower_than_at_rest(bound: Bound, person: Person) -> Bound:
    """Return `bound` with a speed that makes the person no slower than at rest."""
    return with_speed(bound, max(bound.speed, -person.speed))


@inlined
def person_case_bound(
    case: Case, p: Principal, m: Mobility, setup: Setup, rate: float, person: Person, least: float
) -> Bound:
    """Return the bound of the drives of the settings with a moving person, as `case_bound`."""
    if case.line_count > 1 and not m.matrix_trace <= MAX_MOBILITY * setup.mass_factor:
        line = case.obstacle_mobility, 0.0
        return no_slower_than_at_rest(person_line_bound(case, p, m, setup, line, rate, person, least), person)
    fastest = person_line_bound(case, p, m, setup, (case.lines[0, 0], case.lines[0, 1]), rate, person, least)
    for i in range(1, case.line_count):
        if fastest.speed == math.inf:
            break
        bound = person_line_bound(case, p, m, setup, (case.lines[i, 0], case.lines[i, 1]), rate, person, least)
        if is_below(fastest.speed, bound.speed):
            fastest = bound
    return no_slower_than_at_rest(fastest, person)


@inlined
def without_acceleration(person: Person) -> Person:
    """Return the person who meets free joints: the push of the drives contains what accelerates them."""
    return Person(person.has_direction, person.speed, person.robot_speed, accelerates=False)


@inlined
def person_push_bound(
    case: Case, mobilities: Sequence[Mobility], drives: Drives, setup: Setup, work: Work, person: Person, least: float
) -> Bound:
    """Return the bound of free joints and the push of the drives with a moving person, as `push_bound`."""
    force = push_force(case, drives, setup)
    rate, line = pushed_rate(case, case.force, force), (case.obstacle_mobility, 1.0)
    if rate == math.inf:
        return Bound(-person.speed if force < math.inf else -math.inf, 0.0, 0.0, force, 0.0, 0.0)
    slowest, person = NO_BOUND, without_acceleration(person)
    for k in range(len(mobilities)):
        bound = person_line_bound(case, work.principals[k], mobilities[k], setup, line, rate, person, least)
        slowest = slower(slowest, no_slower_than_at_rest(bound, person))
    return with_push(slowest, force)


@inlined
def governing_person_case(
    cases: Sequence[Case],
    start: int,
    mobilities: Sequence[Mobility],
    drives: Drives,
    setup: Setup,
    work: Work,
    person: Person,
) -> Governing:
    """Return what `governing_case` does, with a moving person."""
    governing = Governing(0, NO_BOUND, 0.0, 0)
    for n in range(len(cases)):
        i = case_index(start + n, len(cases))
        case, tried = cases[i], Governing(i, NO_BOUND, 0.0, 0)
        rate = holding_rate(case, drives)
        for k in range(len(mobilities)):
            least = min(governing.bound.speed, tried.bound.speed)
            bound = person_case_bound(case, work.principals[k], mobilities[k], setup, rate, person, least)
            tried = with_mobility(tried, k, bound, case, 0.0, setup)
        if drives.has_push and tried.bound.speed <= governing.bound.speed:
            bound = person_push_bound(case, mobilities, drives, setup, work, person, governing.bound.speed)
            if tried.bound.speed < bound.speed:
                tried = Governing(i, bound, force_of(bound, case, 0.0, setup), 0)
        governing = first_slowest(governing, tried)
    return governing


@inlined
def bound_within(
    rate: float,
    push: float,
    case: Case,
    m: Mobility,
    k: int,
    speed: float,
    drives: Drives,
    person: Person,
    setup: Setup,
    work: Work,
) -> Bound:
    """Return the bound of mobility `k`, of free joints with a `push`; none if it keeps `rate` at `speed` anyway.

    With a moving person the line of the drives is that of the limit, as in the allowable speed.
    """
    if setup.counts_person:
        p = work.principals[k]
        if push > 0.0:
            line, pushed = (case.obstacle_mobility, 1.0), without_acceleration(person)
            rate = pushed_rate(case, case.force, push)
            return person_line_bound(case, p, m, setup, line, rate, pushed, math.inf)
        return person_case_bound(case, p, m, setup, holding_rate(case, drives), person, math.inf)
    if push > 0.0:
        return free_bound(case, m, setup.mass_factor, rate, speed)
    return case_bound(case, m, k, setup.mass_factor, rate, speed, work)
