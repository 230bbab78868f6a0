# SPDX-License-Identifier: Apache-2.0
"""Contact with a person who moves, whose velocity counts as a vector. `reference.person` derives the equations."""

from __future__ import annotations

import math
from typing import NamedTuple

from scara_effmass.kernel.acceleration import acceleration_time, along, lasting_time, least_mobility
from scara_effmass.kernel.compiled import inlined
from scara_effmass.kernel.contact_point import Approach
from scara_effmass.kernel.mobility import trace
from scara_effmass.kernel.pose_change import assign, contact_time, matrix_of
from scara_effmass.kernel.records import Case, Mobility, Principal, Setup
from scara_effmass.kernel.spatial import (
    dot,
    norm,
    rotate,
    rotate_back,
    scale,
    set_matrix,
    sub,
    vector,
    vector_at,
)
from scara_effmass.reference.mobility import CLAMPED_TOLERANCE
from scara_effmass.reference.person import MIN_EXCESS, MIN_PERSON_SPEED
from scara_effmass.values import ZERO_VECTOR, FloatArray, Vector3

SWEEPS = 6
"""Jacobi sweeps; a 3 x 3 matrix is diagonal after four."""
MAX_ROUNDS = 40
"""Newton steps for l and rounds for the speed; both converge quadratically, mostly in five."""
ROUNDED = 1e-14
"""Relative step below which they end."""
EXCEEDED = 1e-12
"""Relative excess of a root, beyond rounding."""
HALVINGS = 52
"""Bisections for the speed where the pose changes."""
IDENTITY = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


class Person(NamedTuple):
    """Person who moves at `speed` [m/s], in any direction without a known one, and the speed of the contact point.

    That [m/s] includes its errors. If the robot `accelerates`, that counts.
    """

    has_direction: bool
    speed: float
    robot_speed: float
    accelerates: bool


class Meeting(NamedTuple):
    """Contact of one case and one line of its drives: masses k_i, n and d in the axes of K, and bounds of the growth.

    d/dt (w^T K w) <= s (cubic s^2 + square s + linear) counts for `time` [s]. The robot gains `gain` [m/s] along n, and
    the force over sqrt(k) besides `root_gain`.
    """

    masses: Vector3
    heaviest: float
    direction: Vector3
    towards: Vector3
    has_direction: bool
    person_speed: float
    time: float
    cubic: float
    square: float
    linear: float
    gain: float
    root_gain: float


class Energy(NamedTuple):
    """Bound s^2 square + 2 s mixed + constant of w^T K w."""

    square: float
    mixed: float
    constant: float


@inlined
def rotate_pair(a: FloatArray, axes: FloatArray, p: int, q: int) -> None:
    """Turn the axes `p` and `q` so that a[p, q] vanishes."""
    if a[p, q] == 0.0:
        return
    half = 0.5 * (a[q, q] - a[p, p]) / a[p, q]
    tangent = math.copysign(1.0, half) / (abs(half) + math.hypot(half, 1.0))
    cosine = 1.0 / math.sqrt(tangent * tangent + 1.0)
    sine = tangent * cosine
    for i in range(3):
        a[i, p], a[i, q] = cosine * a[i, p] - sine * a[i, q], sine * a[i, p] + cosine * a[i, q]
    for i in range(3):
        a[p, i], a[q, i] = cosine * a[p, i] - sine * a[q, i], sine * a[p, i] + cosine * a[q, i]
        axes[p, i], axes[q, i] = cosine * axes[p, i] - sine * axes[q, i], sine * axes[p, i] + cosine * axes[q, i]
    a[p, q] = a[q, p] = 0.0


@inlined
def set_axes(out: Principal, m: Mobility) -> None:
    """Write eigenvalues, the smallest first, and eigenvectors (rows) of the matrix of `m`, by Jacobi's method."""
    a, b, c, d, e, f = matrix_of(m)
    set_matrix(out.matrix, ((a, b, c), (b, d, e), (c, e, f)))
    set_matrix(out.axes, IDENTITY)
    for _ in range(SWEEPS):
        rotate_pair(out.matrix, out.axes, 0, 1)
        rotate_pair(out.matrix, out.axes, 0, 2)
        rotate_pair(out.matrix, out.axes, 1, 2)
    for i in range(3):
        out.values[i] = max(out.matrix[i, i], 0.0)
    for last in range(2, 0, -1):
        for i in range(last):
            if out.values[i] > out.values[i + 1]:
                out.values[i], out.values[i + 1] = out.values[i + 1], out.values[i]
                for j in range(3):
                    out.axes[i, j], out.axes[i + 1, j] = out.axes[i + 1, j], out.axes[i, j]


@inlined
def in_axes(out: Principal, v: Vector3) -> Vector3:
    """Return a vector along the eigenvectors."""
    return dot(vector_at(out.axes, 0), v), dot(vector_at(out.axes, 1), v), dot(vector_at(out.axes, 2), v)


@inlined
def set_principal(out: Principal, m: Mobility, towards: Vector3) -> None:
    """Write a mobility with its change of pose, along its eigenvectors."""
    set_axes(out, m)
    out.unreached, out.changes, out.speed = 3 - m.rank, True, m.speed
    out.floor = CLAMPED_TOLERANCE * trace(matrix_of(m)) if m.rank > 1 else 0.0
    assign(out.direction, in_axes(out, vector(m.direction)))
    assign(out.towards, in_axes(out, towards))
    assign(out.free, in_axes(out, vector(m.free)))
    assign(out.held, in_axes(out, vector(m.held)))
    n, shown = vector(m.direction), vector(m.shown)
    assign(out.across, in_axes(out, sub(shown, scale(dot(n, shown), n))))
    out.speed_rate, out.least_mobility = along(m, n), least_mobility(m)
    powers = vector_at(m.powers, 0), vector_at(m.powers, 1), vector_at(m.powers, 2)
    for j in range(3):
        axis = vector_at(out.axes, j)
        forth, back = rotate(powers, axis), rotate_back(powers, axis)
        both = forth[0] + back[0], forth[1] + back[1], forth[2] + back[2]
        assign(out.lessening[j], in_axes(out, sub(ZERO_VECTOR, both)))
    for i in range(out.unreached):
        out.values[i] = out.direction[i] = 0.0


@inlined
def set_single(out: Principal, mobility: float, rank: int, cosine: float) -> None:
    """Write a mobility that is the same in `rank` dimensions; d lies at an angle of this `cosine` to n."""
    out.unreached, out.changes, out.floor, out.speed = 3 - rank, False, 0.0, 0.0
    assign(out.values, (mobility if rank > 2 else 0.0, mobility if rank > 1 else 0.0, mobility))
    assign(out.direction, (0.0, 0.0, 1.0))
    assign(out.across, ZERO_VECTOR)
    assign(out.towards, (math.sqrt(max(0.0, 1.0 - cosine * cosine)), 0.0, cosine))


@inlined
def with_growth(meeting: Meeting, p: Principal, mass_factor: float, beta: float, time: float) -> Meeting:
    """Return the contact with the growth of its energy as the pose changes."""
    k, n, v = meeting.masses, meeting.direction, meeting.person_speed
    free = k[0] * p.free[0], k[1] * p.free[1], k[2] * p.free[2]
    held = k[0] * p.held[0], k[1] * p.held[1], k[2] * p.held[2]
    factor, met, mixed, own, lighter, square = beta / mass_factor, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(3):
        along, along_person = 0.0, 0.0
        for j in range(3):
            entry = factor * k[i] * p.lessening[i, j] * k[j]
            along += entry * n[j]
            along_person += entry * meeting.towards[j]
            own += entry * entry
        lighter += n[i] * along
        mixed += meeting.towards[i] * along if meeting.has_direction else along * along
        square += meeting.towards[i] * along_person
    faster = max(0.0, dot(n, free), dot(n, held))
    if meeting.has_direction:
        met, mixed, own = max(0.0, dot(meeting.towards, free), dot(meeting.towards, held)), max(0.0, mixed), square
        own = max(0.0, own)
    else:
        met, mixed, own = max(norm(free), norm(held)), math.sqrt(mixed), math.sqrt(own)
    speed = p.speed
    return Meeting(
        k,
        meeting.heaviest,
        n,
        meeting.towards,
        meeting.has_direction,
        v,
        time,
        2.0 * faster / (speed * speed) + max(0.0, lighter) / speed,
        2.0 * v * (met / (speed * speed) + mixed / speed),
        v * v * own / speed,
        meeting.gain,
        meeting.root_gain,
    )


@inlined
def mass_up_to(mobility: float, largest: float) -> float:
    """Return the mass of a mobility, at most `largest`."""
    return min(1.0 / mobility, largest) if mobility > 0.0 else largest


@inlined
def acceleration_root(
    k: Vector3, heaviest: float, p: Principal, alpha: float, beta_per_mass: float, time: float, max_mass: float
) -> float:
    """Return what the acceleration across n, and its error, add within `time` to the peak force over sqrt(k)."""
    if not p.changes:
        return time * math.sqrt(heaviest) * p.error
    a = p.across
    root = math.sqrt(k[0] * a[0] * a[0] + k[1] * a[1] * a[1] + k[2] * a[2] * a[2])
    root *= lasting_time(time, p.speed, p.speed_rate)
    if p.error > 0.0:
        error = math.sqrt(mass_up_to(alpha + beta_per_mass * p.least_mobility, max_mass)) * p.error
        root += time * (min(error, p.error_root / math.sqrt(beta_per_mass)) if beta_per_mass > 0.0 else error)
    return root


@inlined
def meeting_of(
    case: Case, p: Principal, mass_factor: float, alpha: float, beta: float, person: Person, max_mass: float
) -> Meeting:
    """Return the contact for one line of the drives; a larger mass counts as `max_mass`."""
    beta_per_mass = beta / mass_factor
    least, unreached = max(alpha, p.floor * beta_per_mass), p.unreached if case.obstacle_mobility == 0.0 else 0
    x = 0.0 if unreached > 0 else mass_up_to(least + beta_per_mass * p.values[0], max_mass)
    y = 0.0 if unreached > 1 else mass_up_to(least + beta_per_mass * p.values[1], max_mass)
    z = mass_up_to(least + beta_per_mass * p.values[2], max_mass)
    heaviest = max(x, y, z)
    gain = root_gain = time = 0.0
    if heaviest < math.inf:
        time = case.drive_time if case.drive_time > 0.0 else contact_time(heaviest, case.stiffness)
        if person.accelerates:
            lasting = acceleration_time(case, time)
            gain = lasting * max(0.0, p.speed_rate)
            root_gain = acceleration_root((x, y, z), heaviest, p, alpha, beta_per_mass, lasting, max_mass)
    meeting = Meeting(
        (x, y, z),
        heaviest,
        vector(p.direction),
        vector(p.towards),
        person.has_direction,
        person.speed,
        0.0,
        0.0,
        0.0,
        0.0,
        gain,
        root_gain,
    )
    if not p.changes or heaviest == math.inf:
        return meeting
    return with_growth(meeting, p, mass_factor, beta, time)


@inlined
def mass_of(meeting: Meeting, a: Vector3, b: Vector3) -> float:
    """Return a^T K b."""
    total = 0.0
    for i in range(3):
        if a[i] != 0.0 and b[i] != 0.0:
            total += meeting.masses[i] * a[i] * b[i]
    return total


@inlined
def person_mass(meeting: Meeting) -> float:
    """Return the largest mass that a velocity of the person meets."""
    if meeting.has_direction and meeting.heaviest < math.inf:
        return mass_of(meeting, meeting.towards, meeting.towards)
    return meeting.heaviest


@inlined
def multiplier_of(meeting: Meeting, s: float) -> float:
    """Return l at the speed `s` of the contact point, by Newton's method from below for 1 / |u(l)| = 1 / v_p."""
    k, n, v = meeting.masses, meeting.direction, meeting.person_speed
    multiplier = meeting.heaviest * (1.0 + MIN_EXCESS)
    for i in range(3):
        multiplier = max(multiplier, k[i] * (1.0 + abs(n[i]) * s / v))
    for _ in range(MAX_ROUNDS):
        square, slope = 0.0, 0.0
        for i in range(3):
            part = k[i] * n[i] * s / (multiplier - k[i])
            square += part * part
            slope += part * part / (multiplier - k[i])
        length = math.sqrt(square)
        if not length > v:
            break
        step = square / slope * (length - v) / v
        multiplier += step
        if step <= ROUNDED * multiplier:
            break
    return multiplier


@inlined
def energy_at(meeting: Meeting, s: float) -> Energy:
    """Return the bound of the energy for every speed, the least one at the speed `s` of the contact point."""
    v, n = meeting.person_speed, meeting.direction
    if meeting.has_direction:
        mixed = v * max(0.0, mass_of(meeting, n, meeting.towards))
        return Energy(mass_of(meeting, n, n), mixed, v * v * person_mass(meeting))
    multiplier, square = multiplier_of(meeting, s), 0.0
    for i in range(3):
        k = meeting.masses[i]
        square += n[i] * n[i] * k * multiplier / (multiplier - k)
    return Energy(square, 0.0, multiplier * v * v)


@inlined
def energy_with(energy: Energy, s: float) -> float:
    """Return the bound of w^T K w at the speed `s` of the contact point."""
    return s * (s * energy.square + 2.0 * energy.mixed) + energy.constant


@inlined
def root_at(meeting: Meeting, energy: Energy, s: float) -> float:
    """Return the peak force over sqrt(k) at the speed `s` of the contact point."""
    root = math.sqrt(energy_with(energy, s))
    rate = s * (s * (s * meeting.cubic + meeting.square) + meeting.linear)
    return root + 0.5 * meeting.time * rate / root


@inlined
def present_root(meeting: Meeting, s: float) -> float:
    """Return the peak force over sqrt(k) of the worst velocity of the person, at the speed `s` of the contact point."""
    s += meeting.gain
    return root_at(meeting, energy_at(meeting, s), s) + meeting.root_gain


@inlined
def speed_of(meeting: Meeting, energy: Energy, root: float) -> float:
    """Return the speed at which this bound of the energy gives `root`."""
    rest = root * root - energy.constant
    if not rest > 0.0:
        return 0.0
    fast = rest / (energy.mixed + math.sqrt(energy.mixed * energy.mixed + energy.square * rest))
    if root_at(meeting, energy, fast) <= root:
        return fast
    slow = 0.0
    for _ in range(HALVINGS):
        middle = 0.5 * (slow + fast)
        if root_at(meeting, energy, middle) <= root:
            slow = middle
        else:
            fast = middle
    return slow


@inlined
def max_speed(meeting: Meeting, root: float) -> float:
    """Return the largest speed of the contact point with this `root`; negative if the person has to be slower.

    Every round takes the bound of the energy at the speed of the last one. None of them is too fast, unless the pose
    changes so fast that the force falls with the energy: then the speed follows by halving.
    """
    root -= meeting.root_gain
    at_rest = person_mass(meeting)
    if not meeting.person_speed * math.sqrt(at_rest) < root:
        return root / math.sqrt(at_rest) - meeting.person_speed - meeting.gain
    start = root / math.sqrt(meeting.heaviest) - meeting.person_speed
    speed = speed_of(meeting, energy_at(meeting, max(0.0, start)), root)
    for _ in range(MAX_ROUNDS):
        last = speed
        speed = max(last, speed_of(meeting, energy_at(meeting, last), root))
        if speed - last <= ROUNDED * speed:
            break
    if root_at(meeting, energy_at(meeting, speed), speed) > root * (1.0 + EXCEEDED):
        slow = 0.0
        for _ in range(HALVINGS):
            middle = 0.5 * (slow + speed)
            if root_at(meeting, energy_at(meeting, middle), middle) <= root:
                slow = middle
            else:
                speed = middle
        return slow - meeting.gain
    return speed - meeting.gain


@inlined
def person_of(approach: Approach, setup: Setup) -> Person:
    """Return the person that a contact point meets."""
    has_direction = setup.has_person_direction and approach.is_moving
    robot_speed = approach.speed + (setup.speed_uncertainty + approach.tolerance)
    return Person(has_direction, max(setup.person_speed, MIN_PERSON_SPEED), robot_speed, accelerates=True)
