# SPDX-License-Identifier: Apache-2.0
"""Compiled assessments: N joint states, P contact points each. A second way to the numbers of the reference."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from scara_effmass.codes import CriterionCode, Reason
from scara_effmass.iso15066 import contact as spring
from scara_effmass.iso15066.contact import MAX_TURN
from scara_effmass.kernel.acceleration import set_acceleration, set_normal_acceleration
from scara_effmass.kernel.codes import Model, Normal
from scara_effmass.kernel.compiled import BYTES, MATRICES, compiled, inlined
from scara_effmass.kernel.contact_point import (
    Approach,
    approach_of,
    drive_acceleration,
    fill_change,
    fill_held_change,
    held_mobility,
    in_base,
    squared_jacobian,
)
from scara_effmass.kernel.dynamics import fill_dynamics
from scara_effmass.kernel.hull import (
    place_on_link,
    set_hull,
    worst_mass_at_rest,
    worst_reduced_mass,
)
from scara_effmass.kernel.mobility import (
    along,
    set_scalar,
    set_scalars,
    smallest_eigenvalue,
    trace,
)
from scara_effmass.kernel.model_choice import Choice, choose_models, largest_along, mass_along, worst_mass
from scara_effmass.kernel.person import Person, person_of, set_principal, set_single
from scara_effmass.kernel.pose_change import assign, assign_symmetric, set_change, turn_change
from scara_effmass.kernel.records import (
    CASE,
    CONTACT,
    HULL_KNOWN,
    HULL_MASS,
    MIN_NORMAL_COMPONENT,
    POINT,
    SETUP,
    WORK,
    ByteArray,
    Case,
    Contact,
    Mobility,
    Point,
    Setup,
    Work,
)
from scara_effmass.kernel.spatial import NO_MATRIX, dot, matrix_at, rotate_back, sub, vector, vector_at
from scara_effmass.kernel.speed_limit import (
    Bound,
    Drives,
    Governing,
    bound_within,
    force_of,
    governing_case,
    governing_person_case,
    likely_case,
    pushed_rate,
    with_push,
)
from scara_effmass.kernel.state import STATE, VALUES, set_reason
from scara_effmass.kernel.static_force import clamping_force, holding_force
from scara_effmass.values import NO_MOBILITY, ZERO_VECTOR, FloatArray, Mobility6, Vector3, Verdict

EIGENVALUE_ROUNDING = 1e-12
"""Ratio of an eigenvalue of J_v J_v^T to its trace, up to which it counts as 0: its root would be rounding."""
_FORCE, _PRESSURE = float(CriterionCode.FORCE), float(CriterionCode.PRESSURE)
_OK, _WARN, _VIOLATION = float(Verdict.OK), float(Verdict.WARN), float(Verdict.VIOLATION)

turn_until_peak = inlined(spring.turn_until_peak)


@inlined
def set_normal(out: Mobility, m: Mobility6, mass: float, worst: float, approach: Approach, setup: Setup) -> None:
    """Write the mobility of one model for the contact normal of the settings, after its rank and change of pose."""
    out.is_scalar = setup.normal != Normal.WORST or not approach.is_moving or out.rank == 1
    if out.is_scalar:
        set_normal_acceleration(approach, setup, out)
    if setup.normal == Normal.FIXED:
        if out.change_rank > 0:
            either_way = approach.share == MIN_NORMAL_COMPONENT
            turn_change(out, approach.normal, approach.share * out.speed, either_way)
        set_scalar(out, along(m, approach.normal))
    elif setup.normal == Normal.WORST and approach.is_moving:
        set_scalars(out, m, approach.direction, out.rank)
    else:
        set_scalar(out, 1.0 / (mass if setup.normal == Normal.VELOCITY else worst))


@inlined
def fill_principals(iso: int, count: int, approach: Approach, setup: Setup, work: Work) -> None:
    """Write `count` mobilities along their eigenvectors; that of ISO's mass has the index `iso`."""
    towards = in_base(setup.person_joint, setup.person_vector, work.rotations)
    for i in range(count):
        if work.mobilities[i].change_rank > 0:
            set_principal(work.principals[i], work.mobilities[i], towards)
        else:
            rank = 3 if i == iso else approach.rank
            set_single(work.principals[i], work.mobilities[i].matrix_trace, rank, dot(approach.direction, towards))
            work.principals[i].speed_rate = work.mobilities[i].speed_rate
        work.principals[i].error = work.mobilities[i].error
        work.principals[i].error_root = work.mobilities[i].error_root


@inlined
def person_share(approach: Approach, setup: Setup, work: Work) -> float:
    """Return the share of the person's speed that adds to the robot's along a known contact normal, either way."""
    if setup.counts_person:
        return 0.0
    if not setup.has_person_direction or not (setup.normal == Normal.FIXED or approach.is_moving):
        return 1.0
    normal = approach.normal if setup.normal == Normal.FIXED else approach.direction
    towards = in_base(setup.person_joint, setup.person_vector, work.rotations)
    return max(abs(dot(normal, towards)), MIN_NORMAL_COMPONENT)


@inlined
def fill_mobilities(choice: Choice, approach: Approach, point: Point, setup: Setup, work: Work) -> tuple[int, int]:
    """Write the mobilities of the models that decide; return their number, and that with joints that are held."""
    models, held = 0, approach.held
    changes = approach.is_moving and setup.normal != Normal.VELOCITY
    for k in range(3):
        if not choice.takes[k]:
            continue
        any_normal, out = work.any_normal[models], work.mobilities[models]
        any_normal.change_rank, out.change_rank, out.rank = 0, 0, 3 if k == Model.ISO else approach.rank
        models += 1
        kind = HULL_MASS if k == Model.ISO else HULL_KNOWN
        set_hull(any_normal, kind, k, approach, point, work)
        set_hull(out, kind, k, approach, point, work)
        m, worst = choice.full if k == Model.FULL else choice.lumped, work.worst[k]
        if k == Model.ISO:  # the same in every direction and pose
            m = 1.0 / worst, 0.0, 0.0, 1.0 / worst, 0.0, 1.0 / worst
            if changes:
                set_change(out, m, approach.direction, approach.speed, NO_MATRIX, held, held)
        else:
            worst = worst_mass_at_rest(k, worst, approach, point, setup, work, out)
            if changes:
                fill_change(k, m, approach, held, setup, work, out)
        if approach.is_moving:
            set_scalars(any_normal, m, approach.direction, out.rank)
        else:
            set_scalar(any_normal, 1.0 / worst)
        set_acceleration(k, work.worst[k], approach, setup, work, out)
        set_normal(out, m, work.masses[k], worst, approach, setup)
    count = models
    if setup.joints_are_held:
        for k in range(2):
            if choice.takes[k]:
                add_held(k, approach, held, changes, point, setup, work, work.mobilities[count])
                set_hull(work.mobilities[count], HULL_KNOWN, 2 + k, approach, point, work)
                count += 1
    return models, count


@inlined
def add_held(
    k: int,
    approach: Approach,
    held: Vector3,
    changes: bool,  # noqa: FBT001 - compiled
    point: Point,
    setup: Setup,
    work: Work,
    out: Mobility,
) -> None:
    """Write the mobility of model `k` if a controller of its own holds each joint."""
    m = held_mobility(k, approach.joints, work)
    out.change_rank, out.rank = 0, approach.rank
    if changes:
        fill_held_change(k, m, approach, held, work, out)
    worst = worst_mass(m, approach.rank)
    set_acceleration(k, worst, approach, setup, work, out)
    worst = worst_mass_at_rest(2 + k, worst, approach, point, setup, work, out)
    set_normal(out, m, mass_along(m, approach), worst, approach, setup)


@inlined
def deciding_mass(choice: Choice, setup: Setup, work: Work) -> tuple[int, float, float]:
    """Return the model with the largest mass, that mass, and the largest of every contact normal [kg]."""
    model, mass, worst = -1, 0.0, 0.0
    for k in range(3):
        if not choice.takes[k]:
            continue
        if model < 0:
            model, mass, worst = k, work.masses[k], work.worst[k]
            continue
        worst = max(worst, work.worst[k])
        if min(work.masses[k], setup.mass_cap) > mass and not choice.is_heavy:
            model, mass = k, work.masses[k]
    return model, mass, worst


@inlined
def fill_limits(
    setup: Setup, cases: Sequence[Case], work: Work, contact: Contact, choice: Choice, approach: Approach, point: Point
) -> None:
    """Write what follows from the models that decide: masses, speeds, forces and the verdict."""
    cap = setup.mass_cap
    model, mass, worst = deciding_mass(choice, setup, work)
    models, count = fill_mobilities(choice, approach, point, setup, work)
    acceleration, min_mobility, max_force = math.inf, 0.0, math.inf
    if setup.is_servo:
        acceleration, min_mobility = drive_acceleration(approach.joints, setup, work), 1.0 / worst
    if setup.joints_are_coupled:
        max_force = holding_force(approach, cases, work.mobilities[:models], setup, work)
    start = likely_case(cases, worst)
    person, share = person_of(approach, setup), person_share(approach, setup, work)
    closing_speed = setup.person_speed * share + setup.speed_uncertainty + approach.tolerance
    hit = approach.speed * approach.share + closing_speed
    if setup.counts_person:
        fill_principals(models - 1 if choice.takes.iso else -1, count, approach, setup, work)
        has_push = setup.is_servo and approach.rank == 3  # where the point does not move, drives have no least mobility
        drives = Drives(acceleration, min_mobility, max_force, has_push)
        governing = governing_person_case(cases, start, work.mobilities[:count], drives, setup, work, person)
    else:
        drives = Drives(acceleration, min_mobility, max_force, setup.is_servo)
        governing = governing_case(cases, start, work.mobilities[:count], drives, hit, setup, work)
    case = cases[governing.case]
    mu = mass if case.body_mass == math.inf else 1.0 / (1.0 / mass + 1.0 / case.body_mass)
    worst_mu = 0.0
    for k in range(models):
        worst_mu = max(worst_mu, worst_reduced_mass(work.any_normal[k], 1.0 / case.body_mass, 1.0, worst_mu))
    contact.effective_mass, contact.mass_capped = min(mass, cap), 1.0 if mass > cap else 0.0
    contact.worst_direction_mass = min(cap, worst)
    contact.body_mass = 0.0 if case.body_mass == math.inf else case.body_mass
    contact.reduced_mass, contact.stiffness = min(mu, cap), case.nominal_stiffness
    contact.predicted_force = (approach.speed + setup.person_speed) * math.sqrt(
        contact.reduced_mass * contact.stiffness
    )
    contact.contact_energy = 0.5 * contact.reduced_mass * (approach.speed + setup.person_speed) ** 2
    contact.worst_normal_reduced_mass = min(worst_mu, cap)
    contact.body_region, contact.criterion, contact.mass_model = (
        case.region + 1,
        _PRESSURE if case.is_pressure else _FORCE,
        model + 1,
    )
    contact.force_bound = largest_force(governing, case, work.mobilities[:count], drives, person, hit, setup, work)
    set_verdict(contact, case, cases[point.weakest], governing.bound, share, closing_speed, mass, approach, setup)


@inlined
def largest_force(
    governing: Governing,
    case: Case,
    mobilities: Sequence[Mobility],
    drives: Drives,
    person: Person,
    hit: float,
    setup: Setup,
    work: Work,
) -> float:
    """Return the largest bound of the force [N] of all mobilities in the case that governs, at the speed `hit`."""
    force, push = governing.force, governing.bound.push
    for k in range(len(mobilities)):
        if not governing.seen >> k & 1:
            rate = pushed_rate(case, force / setup.amplification, push)
            bound = bound_within(rate, push, case, mobilities[k], k, hit, drives, person, setup, work)
            force = max(force, force_of(with_push(bound, push), case, hit, setup))
    return force


@inlined
def farthest_turn(contact: Contact, case: Case, approach: Approach) -> float:
    """Return by how much [rad, m] the fastest joint turns more than at constant velocity."""
    mass = contact.worst_normal_reduced_mass if case.body_mass == math.inf else case.body_mass
    return turn_until_peak(approach.joint_acceleration, mass, case.nominal_stiffness)


@inlined
def judge(speed: float, nominal_speed: float, turn: float, setup: Setup) -> tuple[float, Reason]:
    """Return the verdict on speed and acceleration, and why it is not OK."""
    if speed > nominal_speed:
        return _VIOLATION, Reason.TOO_FAST
    if speed > setup.warn_ratio * nominal_speed:
        return _WARN, Reason.NEAR_LIMIT
    if turn > MAX_TURN:
        return _WARN, Reason.TURNS
    return _OK, Reason.NONE


@inlined
def set_verdict(
    contact: Contact,
    case: Case,
    weakest: Case,
    bound: Bound,
    share: float,
    closing_speed: float,
    mass: float,
    approach: Approach,
    setup: Setup,
) -> None:
    """Write the allowable speed and the verdict.

    `case` allows the least speed, `weakest` the smallest force. `share` of the person's speed, and all of
    `closing_speed` [m/s], add to that of the robot.
    """
    nominal_speed = (bound.speed - closing_speed) / approach.share
    contact.allowable_speed = max(0.0, nominal_speed)
    turn = farthest_turn(contact, case, approach)
    verdict, code = judge(approach.speed, nominal_speed, turn, setup)
    best_mass = contact.lumped_mass if math.isnan(contact.full_mass) else contact.full_mass
    is_light = mass < best_mass * (1.0 - setup.model_margin)
    if is_light:
        verdict, code = max(verdict, _WARN), code if code != Reason.NONE else Reason.LIGHT_MODEL
    if setup.is_servo:  # it pushes no further than its reference moves on
        contact.clamping_force = min(contact.clamping_force, contact.force_bound)
    elif contact.clamping_force > weakest.force:
        verdict, code, contact.allowable_speed = _VIOLATION, Reason.CLAMPED, 0.0
    contact.verdict = verdict
    if code == Reason.CLAMPED:
        set_reason(
            contact.reason, code, 0, contact.clamping_force, weakest.force * setup.amplification, weakest.region + 1.0
        )
    elif code == Reason.TURNS:
        set_reason(contact.reason, code, approach.fastest_joint, turn, 0.0, 0.0)
    elif code != Reason.NONE:
        explain_speed(contact, code, bound, share, setup)
        if is_light:
            contact.reason[VALUES + 4], contact.reason[VALUES + 5] = contact.effective_mass, best_mass


@inlined
def explain_speed(contact: Contact, code: Reason, bound: Bound, share: float, setup: Setup) -> None:
    """Write the reason `code` with speed and allowed speed, of the person if it alone leaves no speed."""
    set_reason(contact.reason, code, 0, contact.speed, contact.allowable_speed, contact.criterion)
    if code == Reason.TOO_FAST and setup.person_speed > 0.0 and bound.speed <= setup.person_speed * share:
        rest = bound.speed / share if share > 0.0 else bound.speed + setup.person_speed
        set_reason(contact.reason, Reason.PERSON_TOO_FAST, 0, setup.person_speed, max(0.0, rest), contact.criterion)
    contact.reason[VALUES + 3] = contact.body_region


@inlined
def set_motion(contact: Contact, approach: Approach, choice: Choice, setup: Setup, work: Work) -> None:
    """Write what is known of every contact point: motion, mobilities and masses of the models."""
    cap = setup.mass_cap
    assign(contact.direction, approach.direction)
    assign_symmetric(contact.lumped_mobility, NO_MOBILITY if choice.is_massless else choice.lumped)
    assign_symmetric(contact.full_mobility, choice.full)
    contact.speed, contact.iso_mass = approach.speed, setup.iso_mass
    contact.lumped_mass = min(work.masses[Model.LUMPED], cap)
    contact.full_mass = min(work.masses[Model.FULL], cap)
    squares = squared_jacobian(approach.joints, work)
    square = smallest_eigenvalue(squares, approach.rank)
    is_regular = square > EIGENVALUE_ROUNDING * trace(squares)
    contact.smallest_singular_value = math.sqrt(square) if is_regular else 0.0
    contact.worst_direction_used = 0.0 if approach.is_moving else 1.0
    test_direction = in_base(setup.test_joint, setup.test_vector, work.rotations)
    assign(contact.test_direction, test_direction)
    contact.test_effective_mass = 0.0
    is_unknown = choice.is_massless and choice.takes.lumped
    if setup.has_test and choice.error == Reason.NONE and not is_unknown:
        contact.test_effective_mass = min(largest_along(choice, test_direction, setup), cap)


@inlined
def set_place(contact: Contact, approach: Approach, point: Point, work: Work) -> None:
    """Write where the contact counts, in base axes and in the frame of the point or link."""
    assign(contact.position, approach.place)
    if approach.vertex < 0:
        assign(contact.position_in_link, ZERO_VECTOR)
        return
    lever = rotate_back(
        matrix_at(work.rotations, point.joint), sub(approach.place, vector_at(work.places, point.joint))
    )
    in_frame = rotate_back(
        (vector_at(point.rotation, 0), vector_at(point.rotation, 1), vector_at(point.rotation, 2)),
        sub(lever, vector(point.place)),
    )
    assign(contact.position_in_link, in_frame)


@inlined
def assess_point(
    setup: Setup, cases: Sequence[Case], work: Work, point: Point, motion: FloatArray, age: float, contact: Contact
) -> None:
    """Write the assessment of one contact point."""
    approach = approach_of(point, place_on_link(point, setup, work), motion, age, setup, work)
    choice = choose_models(approach, point.vertex_count > 0, setup, work)
    set_motion(contact, approach, choice, setup, work)
    set_place(contact, approach, point, work)
    error = choice.error
    contact.clamping_force = clamping_force(approach, setup, work) if setup.clamps else 0.0
    if contact.clamping_force == math.inf and not setup.is_servo:
        error = Reason.NO_CLAMPING_FORCE if error == Reason.NONE else error
    contact.effective_mass = contact.worst_direction_mass = contact.body_mass = contact.reduced_mass = (
        contact.stiffness
    ) = 0.0
    contact.predicted_force = contact.contact_energy = contact.allowable_speed = 0.0
    contact.worst_normal_reduced_mass = contact.force_bound = 0.0
    contact.mass_capped = contact.verdict = contact.body_region = contact.criterion = contact.mass_model = 0.0
    contact.mass_model_reason = choice.why if error == Reason.NONE else 0.0
    set_reason(contact.reason, Reason.NONE, 0, 0.0, 0.0, 0.0)
    if error == Reason.NONE:
        fill_limits(setup, cases, work, contact, choice, approach, point)
    else:
        explain(error, choice.error_value, contact)
    if contact.clamping_force == math.inf:
        contact.clamping_force = 0.0
    contact.margin = contact.allowable_speed - approach.speed


@inlined
def explain(error: Reason, value: float, contact: Contact) -> None:
    """Write the reason why the verdict is UNKNOWN; `value` is its first number."""
    mass = 0.0
    if error == Reason.TOO_LIGHT:
        masses = contact.lumped_mass, contact.full_mass, contact.iso_mass
        mass = masses[int(value) - 1]
    set_reason(contact.reason, error, 0, value, mass, 0.0)


@compiled(BYTES, MATRICES, BYTES, BYTES, BYTES, MATRICES, BYTES)
def assess_states(
    rows: ByteArray,
    motions: FloatArray,
    robot: ByteArray,
    at: ByteArray,
    limits: ByteArray,
    numbers: FloatArray,
    scratch: ByteArray,
) -> None:
    """Write in `numbers` (N, P, fields) the contacts of P points at the admitted ones of N joint states.

    `rows` are the bytes of their States, `motions` (N, 6, n) q, qd, tolerances of qd, qdd, its errors, replaced qdd;
    `robot`, `at` and `limits` are the bytes of Setup, Points and the Cases of each, `scratch` those of one Work.
    """
    cases: Any
    setup, points, cases, contacts = robot.view(SETUP)[0], at.view(POINT), limits.view(CASE), numbers.view(CONTACT)
    work, states, count = scratch.view(WORK)[0], rows.view(STATE), len(cases) // len(points)
    for i in range(len(states)):
        if states[i].is_admitted == 0:
            continue
        for j in range(setup.joints):
            work.qd[j], work.errors[j] = motions[i, 1, j], motions[i, 4, j]
        fill_dynamics(motions[i, 0], setup, work)
        age = max(0.0, states[i].age) + setup.reaction_time  # a stamp may lead the clock
        for p in range(len(points)):
            own = cases[p * count : (p + 1) * count]
            assess_point(setup, own, work, points[p], motions[i], age, contacts[i, p, 0])
