# SPDX-License-Identifier: Apache-2.0
"""Assessments agree with a recomputation from masses and limits, and are monotonic in their inputs."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from scara_effmass.codes import ModelCode, Reason
from scara_effmass.errors import LimitError, RobotError
from scara_effmass.iso15066 import BODY_REGIONS, Limit, contact_cases, limits_for
from scara_effmass.kernel.admission import METRES_PER_RADIAN, WINDOW_S
from scara_effmass.model.load import load_robot
from scara_effmass.reference import ContactState, RobotDynamics
from scara_effmass.reference.dynamics import X_AXIS
from scara_effmass.reference.mobility import Mobility, PoseChange
from scara_effmass.reference.speed_limit import DrivePush, speed_limit
from scara_effmass.safety import Monitor
from scara_effmass.settings import ContactType, Drives, MassModel, MonitorSettings
from scara_effmass.share import share
from scara_effmass.values import ContactAssessment, FloatArray, JointState, Vector3, Verdict

Variant = Callable[[Callable[[dict[str, Any]], object]], RobotDynamics]

JOINTS = ("joint1", "joint2", "joint3", "joint4")
NOW = 1_700_000_000_000_000_000
TRANSIENT = tuple(name for name in BODY_REGIONS if name not in {"skull_forehead", "face"})

Vector = tuple[float, float, float, float]
positions = st.tuples(st.floats(-2.3, 2.3), st.floats(-2.5, 2.5), st.floats(0.0, 0.4), st.floats(-3.0, 3.0))
# Not zero: a velocity of exactly zero has to be confirmed first.
_speeds = st.floats(1e-6, 1.0).flatmap(lambda speed: st.sampled_from([speed, -speed]))
velocities = st.tuples(*[_speeds] * 4)
fractions = st.floats(0.0, 1.0)


def settings_of(**settings: object) -> MonitorSettings:
    return MonitorSettings.model_validate({"release_time": 0.0, **settings})


def first_assessment(
    dynamics: RobotDynamics, q: Vector, qd: Vector, settings: MonitorSettings
) -> list[ContactAssessment]:
    """Return the assessments of the first joint state that a fresh monitor sees."""
    decision = Monitor(dynamics, settings).assess(JointState(NOW, JOINTS, np.array(q), np.array(qd)), NOW)
    assert decision is not None
    assert decision.allowable_speed == min(contact.allowable_speed for contact in decision.contacts)
    assert decision.contact_normal == f"{settings.contact_normal} {settings.contact_normal_frame}".strip()
    return list(decision.contacts)


def contact_at(dynamics: RobotDynamics, q: Vector, qd: Vector = (0.0, 0.0, 0.0, 0.0)) -> ContactState:
    """Return the first contact point of the reference."""
    return dynamics.at(np.array(q), np.array(qd)).contacts[0]


def direction_of(contact: ContactState, settings: MonitorSettings) -> FloatArray | None:
    """Return the direction of the velocity, None below the speed threshold."""
    return contact.direction if contact.speed >= settings.speed_threshold else None


def slowed(qd: Vector) -> Vector:
    """Return joint velocities at which most points are below the largest speed threshold."""
    a, b, c, d = (1e-3 * velocity for velocity in qd)
    return a, b, c, d


def assess_one(dynamics: RobotDynamics, q: Vector, qd: Vector, **settings: object) -> ContactAssessment:
    (contact,) = first_assessment(dynamics, q, qd, settings_of(**settings))
    return contact


def parallel(mass: float, other: float) -> float:
    """Return the reduced mass, as product over sum, unlike the code under test."""
    if math.isinf(mass) or math.isinf(other):
        return min(mass, other)
    return mass * other / (mass + other)


def require_no_numbers(contact: ContactAssessment) -> None:
    """Require an UNKNOWN whose masses, force and speeds are 0, and which names no limit."""
    assert contact.verdict is Verdict.UNKNOWN
    assert (contact.effective_mass, contact.worst_direction_mass, contact.reduced_mass) == (0.0, 0.0, 0.0)
    assert (contact.body_mass, contact.stiffness, contact.predicted_force) == (0.0, 0.0, 0.0)
    assert (contact.allowable_speed, contact.margin) == (0.0, -contact.speed)
    assert (contact.body_region, contact.criterion, contact.mass_capped) == ("", "", False)


any_settings = st.builds(
    settings_of,
    effective_mass_model=st.sampled_from(MassModel),
    mass_uncertainty=fractions,
    stiffness_uncertainty=fractions,
    speed_uncertainty=st.floats(0.0, 0.1),
    person_speed=st.floats(0.0, 0.3),
    model_margin=fractions,
    speed_threshold=st.floats(0.001, 0.02),
    warn_ratio=st.floats(0.01, 1.0),
    mass_cap=st.floats(100.0, 1000.0),
    body_regions=st.lists(st.sampled_from(TRANSIENT), unique=True).map(tuple),
    contact=st.sampled_from(ContactType),
    contact_area_m2=st.floats(5e-6, 1e-3),
    contact_normal=st.sampled_from(["worst", "velocity", "0 0 1", "0.6 -0.8 0"]),
    drives=st.sampled_from([Drives.FREE, Drives.IMMOVABLE]),
    external_force_limit=st.just(1.0),
)


def bounding_reduced_mass(
    contact: ContactState, model: ModelCode, iso_mass: float, body_mass: float, settings: MonitorSettings
) -> float:
    """Return the largest (v.n)^2 mu(n) / (share of the speed)^2 of one model, by linear algebra."""
    if settings.drives is Drives.IMMOVABLE:
        return body_mass
    factor = 1.0 + settings.mass_uncertainty
    if model is ModelCode.ISO:
        return parallel(iso_mass * factor, body_mass)
    mobility = contact.mobilities[model] / factor
    normal = settings.fixed_normal
    if normal is not None:
        return parallel(1.0 / float(np.array(normal) @ mobility @ np.array(normal)), body_mass)
    velocity = direction_of(contact, settings)
    if velocity is None:
        return parallel(factor * contact.effective_mass(model, None), body_mass)
    if settings.contact_normal == "velocity":
        return parallel(1.0 / float(velocity @ mobility @ velocity), body_mass)
    return float(velocity @ np.linalg.solve(mobility + np.eye(3) / body_mass, velocity))


def bounding_speed(
    contact: ContactState, model: ModelCode, iso_mass: float, limit: Limit, settings: MonitorSettings
) -> float:
    """Return v with v (1 + growth v) sqrt(mu k) = F, by linear algebra; the growth is that of 1.5 times the rise."""
    stiffness = limit.stiffness_n_m * (1.0 + settings.stiffness_uncertainty)
    mu = bounding_reduced_mass(contact, model, iso_mass, limit.body_mass_kg, settings)
    speed, growth = limit.permissible_force_n / math.sqrt(mu * stiffness), 0.0
    n = direction_of(contact, settings)
    if n is not None and settings.contact_normal != "velocity":
        change = contact.mobility(ModelCode.FULL if model is ModelCode.ISO else model, n).change
        assert change is not None
        if model is ModelCode.ISO:  # its mass stays as the pose changes
            change = PoseChange(change.speed, np.zeros((3, 3)), change.accelerations[1:])
        mobility = np.eye(3) / iso_mass if model is ModelCode.ISO else contact.mobilities[model]
        rate = change.mobility_rate / (1.0 + settings.mass_uncertainty)
        matrix = mobility / (1.0 + settings.mass_uncertainty) + np.eye(3) / limit.body_mass_kg
        w, along_speed, accelerations = np.linalg.solve(matrix, n), contact.speed, change.accelerations
        if settings.fixed_normal is not None:
            normal = np.array(settings.fixed_normal)
            along_speed *= max(abs(float(n @ normal)), 0.1)
            if abs(n @ normal) <= 0.1:  # the point may as well move the other way
                accelerations += tuple(-a for a in accelerations)
            n = normal * (1.0 if n @ normal >= 0.0 else -1.0)
            w = n / (n @ matrix @ n)
        if settings.drives is Drives.IMMOVABLE:
            w, rate, stiffness = n, 0.0 * rate, limit.stiffness_n_m  # the softest one lasts longest
        faster = max(0.0, *(float(w @ a) for a in accelerations)) / along_speed
        growth = (2.0 * faster + max(0.0, -float(w @ rate @ w))) / float(n @ w)
        growth *= 0.5 * min(1.5 * math.pi / 2.0 * math.sqrt(mu / stiffness), 0.5) / along_speed
    return float(2.0 * speed / (1.0 + math.sqrt(1.0 + 4.0 * growth * speed)))


def heavy_enough(contact: ContactState, margin: float) -> MassModel:
    """Return the model that auto takes: lumped if nowhere lighter than full by more than the margin."""
    lumped, full = contact.mobilities[ModelCode.LUMPED], contact.mobilities[ModelCode.FULL]
    lowest = np.linalg.eigvalsh(full - (1.0 - margin) * lumped)[0]
    assume(abs(lowest) > 1e-8 * np.trace(full))
    return MassModel.LUMPED if lowest > 0.0 else MassModel.FULL


@given(positions, velocities, any_settings)
def test_assessment_agrees_with_masses_and_limits(
    scara: RobotDynamics, q: Vector, qd: Vector, settings: MonitorSettings
) -> None:
    (contact,) = first_assessment(scara, q, qd, settings)
    error = settings.position_tolerance / WINDOW_S * np.array([1.0, 1.0, METRES_PER_RADIAN, 1.0])
    at = contact_at(scara, q, qd)
    # A clamped part is immovable, and the linear algebra below singular at a singular pose.
    assume(settings.contact is ContactType.TRANSIENT or at.smallest_singular_value > 1e-3)
    direction, iso_mass = direction_of(at, settings), scara.robot.iso_mass
    lumped, full = (at.effective_mass(model, direction) for model in (ModelCode.LUMPED, ModelCode.FULL))
    mass_by_model = {
        MassModel.LUMPED: lumped,
        MassModel.FULL: full,
        MassModel.ISO: iso_mass,
        MassModel.LARGEST: max(lumped, full, iso_mass),
    }
    model = settings.effective_mass_model
    if model is MassModel.AUTO:
        model = heavy_enough(at, settings.model_margin)
    mass = mass_by_model[model]
    models = list(mass_by_model)[:3] if model is MassModel.LARGEST else [model]
    codes, allowed = [ModelCode[m.name] for m in models], {}
    for limit in limits_for(settings):
        allowed[limit.region] = min(bounding_speed(at, code, iso_mass, limit, settings) for code in codes)
    assume(settings.person_speed == 0.0 or settings.contact_normal != "worst")  # test_person checks this
    share = 1.0
    if settings.fixed_normal is not None and direction is not None:
        share = max(abs(float(np.dot(settings.fixed_normal, direction))), 0.1)
    closing = settings.person_speed + settings.speed_uncertainty + at.speed_tolerance(error.tolist())
    expected = max(0.0, (min(allowed.values()) - closing) / share)
    # A clamped part near a singular pose: the smallest eigenvalue decides, which has an error of 1e-7.
    tolerance = 1e-4 if settings.contact is ContactType.QUASI_STATIC else 1e-6
    assert contact.allowable_speed == pytest.approx(expected, rel=tolerance, abs=1e-9)
    assert allowed[contact.body_region] == pytest.approx(min(allowed.values()), rel=tolerance)
    # As mobilities: masses that are infinite but for rounding differ.
    assert 1.0 / mass_by_model[MassModel(contact.mass_model)] == pytest.approx(1.0 / mass, abs=1e-12)
    assert contact.margin == contact.allowable_speed - contact.speed
    assert contact.effective_mass == pytest.approx(min(mass, settings.mass_cap), rel=1e-12)
    assert contact.mass_capped == (mass > settings.mass_cap)
    assert contact.worst_direction_used == (contact.speed < settings.speed_threshold)
    limit = next(limit for limit in limits_for(settings) if limit.region == contact.body_region)
    assert contact.criterion == limit.criterion
    assert contact.stiffness == limit.stiffness_n_m
    assert contact.body_mass == (0.0 if math.isinf(limit.body_mass_kg) else limit.body_mass_kg)
    mu = min(parallel(mass, limit.body_mass_kg), settings.mass_cap)
    assert contact.reduced_mass == pytest.approx(mu, rel=1e-12)
    force = (contact.speed + settings.person_speed) * math.sqrt(mu * limit.stiffness_n_m)
    assert contact.predicted_force == pytest.approx(force, rel=1e-12)

    speed = contact.speed
    if speed > expected * (1.0 + tolerance) + 1e-9:
        assert contact.verdict is Verdict.VIOLATION
    elif speed < settings.warn_ratio * expected * (1.0 - tolerance) - 1e-9:
        lighter = mass < min(full, settings.mass_cap) * (1.0 - settings.model_margin)
        assert contact.verdict is (Verdict.WARN if lighter else Verdict.OK)
    assert bool(contact.reason) == (contact.verdict is not Verdict.OK)


def test_fixed_normal_turns_with_its_frame(scara: RobotDynamics) -> None:
    q, qd = (0.7, 1.2, 0.1, -0.4), (0.4, 0.2, 0.1, 0.3)
    turned = assess_one(scara, q, qd, contact_normal="1 0 0", contact_normal_frame="tool")
    angle = q[0] + q[1] - q[3]  # joint 4 turns about -z
    in_base = assess_one(scara, q, qd, contact_normal=f"{math.cos(angle)!r} {math.sin(angle)!r} 0")
    assert turned.allowable_speed == pytest.approx(in_base.allowable_speed, rel=1e-12)
    assert turned.allowable_speed != pytest.approx(assess_one(scara, q, qd, contact_normal="1 0 0").allowable_speed)


@given(positions, velocities, any_settings)
def test_sign_of_the_margin_gives_the_verdict(
    scara: RobotDynamics, q: Vector, qd: Vector, settings: MonitorSettings
) -> None:
    (contact,) = first_assessment(scara, q, qd, settings)
    if contact.margin < 0.0:
        assert contact.verdict is Verdict.VIOLATION
    elif contact.allowable_speed > 0.0 and contact.margin > 0.0:
        assert contact.verdict in {Verdict.OK, Verdict.WARN}


@given(positions, velocities, any_settings)
def test_only_missing_masses_are_nan(
    offset_scara: RobotDynamics, q: Vector, qd: Vector, settings: MonitorSettings
) -> None:
    for contact in first_assessment(offset_scara, q, qd, settings):
        for name, value in contact._asdict().items():
            if isinstance(value, float) and name not in {"lumped_mass", "full_mass"}:
                assert math.isfinite(value), name
        assert contact.reduced_mass <= contact.effective_mass
        length = math.hypot(*contact.direction)
        assert length == 0.0 if contact.worst_direction_used else length == pytest.approx(1.0)


def test_worst_mass_is_finite_without_lumped_mass_across(offset_scara: RobotDynamics) -> None:
    """Straight down: joint 4, which carries no lumped inertia, moves the rim, but not along this direction."""
    rim = first_assessment(
        offset_scara, (0.3, 1.2, 0.1, 0.4), (1e-15, 1e-15, 0.1, 1e-15), settings_of(contact_normal="velocity")
    )[1]
    assert rim.lumped_mass == pytest.approx(0.55)
    assert rim.worst_direction_mass >= rim.lumped_mass
    why = "no lumped mass: a joint moves the contact point, but no lumped mass"
    assert (rim.mass_model, rim.mass_model_reason) == ("full", why)


@given(positions, velocities, st.sampled_from(["mass_uncertainty", "stiffness_uncertainty"]), fractions, fractions)
def test_higher_uncertainty_never_raises_the_allowable_speed(
    scara: RobotDynamics, q: Vector, qd: Vector, name: str, less: float, more: float
) -> None:
    less, more = sorted((less, more))
    slow, fast = (assess_one(scara, q, qd, drives="free", **{name: u}).allowable_speed for u in (more, less))
    assert slow <= fast


@given(positions, velocities, st.sampled_from(["person_speed", "speed_uncertainty"]), st.floats(0.0, 2.0))
def test_closing_speed_is_subtracted_along_the_velocity(
    scara: RobotDynamics, q: Vector, qd: Vector, name: str, closing: float
) -> None:
    alone, closer = (assess_one(scara, q, qd, contact_normal="velocity", **more) for more in ({}, {name: closing}))
    assert closer.allowable_speed == pytest.approx(max(0.0, alone.allowable_speed - closing), abs=1e-12)
    assert closer.predicted_force >= alone.predicted_force
    if not 0.0 < closing <= 1e-12:  # rounding decides
        assert (closer.predicted_force > alone.predicted_force) == (name == "person_speed" and closing > 0.0)


@given(positions, velocities, st.floats(0.001, 1.0))
def test_person_from_any_side_leaves_less_speed(
    scara: RobotDynamics, q: Vector, qd: Vector, person_speed: float
) -> None:
    alone, closer = (assess_one(scara, q, qd, drives="free", person_speed=v) for v in (0.0, person_speed))
    assert closer.allowable_speed <= alone.allowable_speed + 1e-9
    assert closer.force_bound >= closer.predicted_force


def test_part_of_the_person_along_a_known_normal_counts(scara: RobotDynamics) -> None:
    q, qd = (0.3, 1.2, 0.1, 0.0), (0.5, 0.3, 0.01, 0.1)
    speeds = [
        assess_one(scara, q, qd, contact_normal="0 0 1", person_speed=0.2, person_direction=towards).allowable_speed
        for towards in ((0.0, 0.0, 0.0), (0.0, 0.0, -2.0), (0.6, 0.0, 0.8), (1.0, 0.0, 0.0))
    ]
    alone = assess_one(scara, q, qd, contact_normal="0 0 1").allowable_speed
    share = (alone - speeds[0]) / 0.2
    assert speeds == pytest.approx([alone - share * 0.2 * part for part in (1.0, 1.0, 0.8, 0.1)])


def test_what_the_velocity_check_lets_pass_is_added_to_the_speed(scara: RobotDynamics) -> None:
    q, qd = (0.3, 1.2, 0.1, 0.0), (0.5, 0.3, 0.01, 0.1)
    exact, default = assess_one(scara, q, qd, position_tolerance=0.0), assess_one(scara, q, qd)
    levers = np.linalg.norm(contact_at(scara, q).jacobian, axis=0)
    added = levers @ [0.01, 0.01, 0.0025, 0.01] / WINDOW_S
    assert 0.01 < added < 0.02
    assert default.allowable_speed == pytest.approx(exact.allowable_speed - added, rel=1e-12)
    assert default.speed == exact.speed


def test_person_speed_above_every_limit_gives_violation_at_rest(scara: RobotDynamics) -> None:
    decision = Monitor(scara, settings_of(person_speed=5.0)).assess(
        JointState(NOW, JOINTS, np.array([0.3, 1.2, 0.1, 0.0]), np.full(4, 1e-9)), NOW
    )
    assert decision is not None
    assert decision.contacts[0].verdict is Verdict.VIOLATION
    assert (decision.allowable_speed, decision.speed_scaling) == (0.0, 0.0)


@given(positions, velocities)
def test_higher_speed_gives_violation(scara: RobotDynamics, q: Vector, qd: Vector) -> None:
    slower = assess_one(scara, q, qd, speed_threshold=1e-9)
    assume(slower.smallest_singular_value > 1e-4)  # near a singular pose the leading digits cancel
    factor = 1.5 * slower.allowable_speed / slower.speed
    assume(all(abs(factor * v) < limit for v, limit in zip(qd, (12.6, 12.6, 3.0, 50.0), strict=True)))
    faster = assess_one(scara, q, tuple(factor * v for v in qd), speed_threshold=1e-9)  # type: ignore[arg-type]
    assert faster.verdict is Verdict.VIOLATION
    assert faster.allowable_speed == pytest.approx(slower.allowable_speed, rel=1e-6)


@given(positions, velocities)
def test_largest_mass_gives_the_lowest_allowable_speed(scara: RobotDynamics, q: Vector, qd: Vector) -> None:
    lumped, full, largest = (
        assess_one(scara, q, qd, effective_mass_model=model)
        for model in (MassModel.LUMPED, MassModel.FULL, MassModel.LARGEST)
    )
    iso = assess_one(scara, q, qd, effective_mass_model=MassModel.ISO)
    contacts = (lumped, full, iso)
    assert largest.effective_mass == max(contact.effective_mass for contact in contacts)
    assert largest.allowable_speed == min(contact.allowable_speed for contact in contacts)
    assert largest.worst_direction_mass == max(contact.worst_direction_mass for contact in contacts)
    if not largest.mass_capped:
        assert largest.mass_model == max(contacts, key=lambda contact: contact.effective_mass).mass_model
    for contact in (lumped, full, largest):
        assert (contact.lumped_mass, contact.full_mass) == (lumped.effective_mass, full.effective_mass)
        assert contact.worst_direction_mass >= contact.effective_mass * (1.0 - 1e-6)


@given(positions, velocities)
def test_worst_direction_is_used_below_the_speed_threshold(scara: RobotDynamics, q: Vector, qd: Vector) -> None:
    qd = slowed(qd)
    contact = assess_one(scara, q, qd, speed_threshold=0.02, body_regions=("chest",))
    assume(contact.speed < 0.02)
    assert contact.worst_direction_used
    assert contact.direction == (0.0, 0.0, 0.0)
    assert contact.effective_mass == contact.worst_direction_mass
    directed = assess_one(scara, q, qd, speed_threshold=1e-9, body_regions=("chest",))
    assert contact.worst_normal_reduced_mass >= directed.worst_normal_reduced_mass * (1.0 - 1e-6)


@given(st.floats(-2.3, 2.3), velocities, st.sampled_from([0.0, 1e-12, -1e-9, 1e-7]), st.sampled_from(MassModel))
def test_stretched_arm_gives_capped_mass(
    scara: RobotDynamics, q1: float, qd: Vector, q2: float, model: MassModel
) -> None:
    still: Vector = (1e-9, 1e-9, 1e-9, 1e-9)
    for velocity in (still, qd):
        contact = assess_one(scara, (q1, q2, 0.1, 0.0), velocity, effective_mass_model=model)
        if contact.mass_model == "iso":
            assert contact.effective_mass == scara.robot.iso_mass
            continue
        assert contact.smallest_singular_value < 1e-7
        assert contact.worst_direction_mass == 1000.0
        if velocity is still:
            assert contact.mass_capped
            assert contact.effective_mass == 1000.0
            # mu -> m_H: an immovable robot, not an infinite force
            assert contact.reduced_mass == pytest.approx(contact.body_mass, rel=1e-6)
            assert contact.verdict is Verdict.OK, contact.reason
        assert contact.allowable_speed > 0.0


def test_clamped_contact_has_no_body_mass(scara: RobotDynamics) -> None:
    contact = assess_one(scara, (0.3, 1.2, 0.1, 0.0), (0.1, 0.1, 0.01, 0.1), contact="quasi_static")
    assert contact.body_mass == 0.0
    assert contact.reduced_mass == contact.effective_mass


def test_mass_below_the_full_model_gives_warn(scara: RobotDynamics) -> None:
    """The shipped lumped model is the heavier one; ISO's constant is not, in a fifth of the workspace."""
    q, qd = (0.0, -1.2, 0.1, 0.0), (0.0005, 0.0005, 0.01, 0.001)
    light = assess_one(scara, q, qd, effective_mass_model="iso", speed_threshold=0.02)
    assert light.full_mass > light.iso_mass * 1.2
    assert light.verdict is Verdict.WARN
    assert light.reason.startswith("the iso mass of 2.77 kg is below the full model's ")
    tolerant = assess_one(scara, q, qd, effective_mass_model="iso", speed_threshold=0.02, model_margin=1.0)
    assert tolerant.verdict is Verdict.OK


@pytest.mark.parametrize("model", MassModel)
def test_missing_model_gives_unknown(bare_scara: RobotDynamics, skew_scara: RobotDynamics, model: MassModel) -> None:
    q, qd = (0.3, 1.2, 0.1, 0.0), (0.01, 0.01, 0.01, 0.01)
    bare, skew = (assess_one(dynamics, q, qd, effective_mass_model=model) for dynamics in (bare_scara, skew_scara))
    assert math.isnan(bare.full_mass)
    assert math.isnan(skew.lumped_mass)
    if model is MassModel.FULL:
        require_no_numbers(bare)
        assert bare.reason.startswith("no full mass (the file gives no inertia tensors)")
    else:
        assert bare.verdict is Verdict.OK
    if model is MassModel.LUMPED:
        require_no_numbers(skew)
        assert skew.reason.startswith("no lumped mass (")
        assert skew.reason.endswith("choose effective_mass_model auto, full or iso")
    else:
        assert skew.verdict in {Verdict.OK, Verdict.WARN}


@given(positions, velocities, st.tuples(*[st.floats(-1.0, 1.0)] * 3), st.sampled_from(MassModel))
def test_test_direction_has_the_mass_of_a_motion_along_it(
    scara: RobotDynamics, q: Vector, qd: Vector, direction: tuple[float, float, float], model: MassModel
) -> None:
    assume(np.linalg.norm(direction) > 1e-3)
    contact = assess_one(scara, q, qd, effective_mass_model=model, test_direction=direction)
    unit = np.array(direction) / np.linalg.norm(direction)
    np.testing.assert_allclose(contact.test_direction, unit, atol=1e-12)
    jacobian = contact_at(scara, q).jacobian
    assume(np.linalg.svd(jacobian, compute_uv=False)[-1] > 1e-3)
    along = np.linalg.pinv(jacobian) @ unit
    speeds = tuple(0.5 * along / np.abs(along).max() + 1e-13)
    moved = assess_one(scara, q, speeds, effective_mass_model=model, speed_threshold=1e-6)
    assert contact.test_effective_mass == pytest.approx(moved.effective_mass, rel=1e-6)


def test_no_test_direction_gives_none(offset_scara: RobotDynamics) -> None:
    pose, moving = (0.3, 1.2, 0.1, 0.4), (0.1, 0.1, 0.1, 0.1)
    for contact in first_assessment(offset_scara, pose, moving, settings_of()):
        assert (contact.test_direction, contact.test_effective_mass) == ((0.0, 0.0, 0.0), 0.0)
    # Joint 4 moves the rim, but no lumped mass: there is none along every direction.
    settings = settings_of(effective_mass_model="lumped", test_direction=(1.0, 0.0, 0.0), contact_normal="velocity")
    tool, rim = first_assessment(offset_scara, pose, (0.1, 0.1, 0.1, 1e-15), settings)
    assert tool.test_effective_mass > 0.9
    assert (rim.test_direction, rim.test_effective_mass) == ((1.0, 0.0, 0.0), 0.0)


class TestAuto:
    """The lumped model is taken where it is checked and not too light; see also the recomputation above."""

    Q, QD = (0.3, 1.2, 0.1, 0.0), (0.1, 0.1, 0.01, 0.1)

    @given(positions, velocities, st.sampled_from(["worst", "velocity", "0.6 -0.8 0"]), st.floats(0.0, 0.5))
    def test_allows_no_more_than_the_full_model_but_for_the_margin(
        self, light_scara: RobotDynamics, q: Vector, qd: Vector, normal: str, margin: float
    ) -> None:
        auto, full = (
            assess_one(
                light_scara,
                q,
                qd,
                effective_mass_model=model,
                contact_normal=normal,
                model_margin=margin,
                position_tolerance=0.0,
            )
            for model in (MassModel.AUTO, MassModel.FULL)
        )
        least = 1.0 - margin
        assert auto.effective_mass >= full.effective_mass * least * (1.0 - 1e-6)
        assert auto.worst_direction_mass >= full.worst_direction_mass * least * (1.0 - 1e-6)
        assert auto.worst_normal_reduced_mass >= full.worst_normal_reduced_mass * least * (1.0 - 1e-6)
        assert auto.allowable_speed * math.sqrt(least) <= full.allowable_speed * (1.0 + 1e-6)
        assert auto.verdict in {Verdict.OK, Verdict.WARN, Verdict.VIOLATION}
        assert "below the full" not in auto.reason

    def test_takes_full_where_lumped_is_lighter_along_any_normal(self, light_scara: RobotDynamics) -> None:
        contacts = {
            model.value: assess_one(light_scara, self.Q, self.QD, effective_mass_model=model)
            for model in (MassModel.AUTO, MassModel.FULL, MassModel.LUMPED)
        }
        auto = contacts["auto"]
        assert auto._replace(mass_model_reason="") == contacts["full"]._replace(mass_model_reason="")
        assert (
            auto.mass_model_reason
            == "the lumped model is more than 10 % lighter than the full model along some direction"
        )
        assert contacts["full"].mass_model_reason == "effective_mass_model full"
        tolerant = assess_one(light_scara, self.Q, self.QD, model_margin=0.9)
        assert (tolerant.mass_model, tolerant.effective_mass) == ("lumped", contacts["lumped"].effective_mass)

    def test_takes_lumped_without_inertias_for_a_scara_alone(
        self, bare_scara: RobotDynamics, scara_variant: Variant
    ) -> None:
        scara = assess_one(bare_scara, self.Q, self.QD)
        assert (scara.mass_model, scara.effective_mass) == ("lumped", scara.lumped_mass)
        assert "no full mass: the file gives no inertia tensors" in scara.mass_model_reason

        def without_quill(file: dict[str, Any]) -> None:
            del file["joints"][2:], file["links"][2:]
            for body in (*file["links"], file["payload"]):
                body.pop("inertia", None)

        planar = scara_variant(without_quill)
        monitor = Monitor(planar, settings_of())
        decision = monitor.assess(JointState(NOW, JOINTS[:2], np.array(self.Q[:2]), np.array(self.QD[:2])), NOW)
        assert decision is not None
        (contact,) = decision.contacts
        assert contact.effective_mass == max(contact.lumped_mass, contact.iso_mass)
        assert contact.mass_model_reason.startswith("largest of lumped and iso, no full mass")

    def test_takes_full_for_a_point_that_a_massless_joint_moves(
        self, offset_scara: RobotDynamics, scara_variant: Variant
    ) -> None:
        _, rim = first_assessment(offset_scara, self.Q, self.QD, settings_of())
        assert (rim.mass_model, rim.effective_mass) == ("full", rim.full_mass)
        assert rim.mass_model_reason.startswith("no lumped mass: joint4 moves the contact point")

        def bare_rim(file: dict[str, Any]) -> None:
            file["contact_points"] = {"rim": [0.05, 0.0, 0.0]}
            for body in (*file["links"], file["payload"]):
                body.pop("inertia", None)

        iso = assess_one(scara_variant(bare_rim), self.Q, self.QD)
        assert (iso.mass_model, iso.effective_mass) == ("iso", iso.iso_mass)
        assert iso.mass_model_reason.startswith(
            "no full mass: the file gives no inertia tensors; no lumped mass: joint4"
        )

    @pytest.mark.parametrize(("radius", "model"), [(0.9e-4, "lumped"), (1.1e-4, "iso"), (0.05, "iso")])
    def test_counts_iso_without_inertias_where_joint_4_moves_the_point(
        self, scara_variant: Variant, radius: float, model: str
    ) -> None:
        """The lumped masses of this tool have a hundredth of its inertia about joint 4."""

        def bare(file: dict[str, Any]) -> None:
            file["contact_points"] = {"rim": [0.0, radius, 0.0]}
            file["payload"]["com"] = [0.002, 0.0, 0.0]
            for body in (*file["links"], file["payload"]):
                body.pop("inertia", None)

        contact = assess_one(scara_variant(bare), self.Q, self.QD)
        assert contact.mass_model == model
        assert contact.mass_model_reason.startswith(f"largest of lumped{' and iso' * (model == 'iso')}, no full mass")

    def test_is_the_default(self, scara: RobotDynamics) -> None:
        assert MonitorSettings().effective_mass_model is MassModel.AUTO
        auto, lumped = (
            assess_one(scara, self.Q, self.QD, **settings) for settings in ({}, {"effective_mass_model": "lumped"})
        )
        assert auto._replace(mass_model_reason="") == lumped._replace(mass_model_reason="")


@given(positions, velocities)
def test_tightest_contact_point_governs(offset_scara: RobotDynamics, q: Vector, qd: Vector) -> None:
    settings = settings_of(effective_mass_model="full", reference_speed=1.0)
    decision = Monitor(offset_scara, settings).assess(JointState(NOW, JOINTS, np.array(q), np.array(qd)), NOW)
    assert decision is not None
    tool, rim = decision.contacts
    assert (tool.contact_point, rim.contact_point) == ("tool", "rim")
    assert decision.allowable_speed == min(tool.allowable_speed, rim.allowable_speed)
    assert decision.speed_scaling == min(1.0, decision.allowable_speed)


def test_configurations_have_no_stamp_age_or_delay(scara: RobotDynamics) -> None:
    monitor = Monitor(scara, settings_of())
    for decision in monitor.assess_configurations(
        np.tile([0.3, 1.2, 0.1, 0.0], (2, 1)), np.full((2, 4), 0.1)
    ).decisions():
        assert (decision.stamp_ns, decision.input_age, decision.velocity_delay) == (0, 0.0, 0.0)
        assert list(decision.contacts) == first_assessment(scara, (0.3, 1.2, 0.1, 0.0), (0.1,) * 4, settings_of())


def test_unknown_contact_point_allows_nothing(offset_scara: RobotDynamics) -> None:
    settings = settings_of(effective_mass_model="lumped")
    decision = Monitor(offset_scara, settings).assess(
        JointState(NOW, JOINTS, np.array([0.3, 1.2, 0.1, 0.0]), np.array([0.1, 0.1, 0.01, 0.5])), NOW
    )
    assert decision is not None
    assert [contact.verdict for contact in decision.contacts] == [Verdict.OK, Verdict.UNKNOWN]
    assert "joint4" in decision.contacts[1].reason
    assert (decision.allowable_speed, decision.speed_scaling) == (0.0, 0.0)


@given(positions, velocities, st.floats(0.0, 5.0))
def test_scaling_brings_the_reference_speed_to_the_allowable_one(
    scara: RobotDynamics, q: Vector, qd: Vector, reference: float
) -> None:
    monitor = Monitor(scara, settings_of(reference_speed=reference))
    decision = monitor.assess(JointState(NOW, JOINTS, np.array(q), np.array(qd)), NOW)
    assert decision is not None
    reference_speed = reference or decision.contacts[0].speed
    assert 0.0 <= decision.speed_scaling <= 1.0
    assert decision.speed_scaling * reference_speed <= decision.allowable_speed * (1.0 + 1e-12)
    if decision.speed_scaling < 1.0:
        assert decision.speed_scaling * reference_speed == pytest.approx(decision.allowable_speed)


def test_changed_settings_apply_to_the_next_joint_state(scara: RobotDynamics) -> None:
    monitor = Monitor(scara, settings_of())
    effective_masses = []
    for i, model in enumerate(("lumped", "full", "iso")):
        monitor.apply(settings_of(effective_mass_model=model))
        now = NOW + i
        decision = monitor.assess(JointState(now, JOINTS, np.array([0.3, 1.2, 0.1, 0.0]), np.full(4, 0.1)), now)
        assert decision is not None
        contact = decision.contacts[0]
        effective_masses.append(contact.effective_mass)
        assert contact.effective_mass == {"lumped": contact.lumped_mass, "full": contact.full_mass}.get(
            model, contact.iso_mass
        )
    assert len(set(effective_masses)) == 3


def test_payload_with_another_centre_of_mass_applies(scara: RobotDynamics) -> None:
    q, qd = (0.3, 1.2, 0.1, 0.0), (0.1, 0.1, 0.1, 0.1)
    monitor = Monitor(scara, settings_of(payload_mass=2.0))
    offset = settings_of(payload_mass=2.0, payload_com=(0.2, 0.0, 0.0))
    monitor.apply(offset)
    decision = monitor.assess(JointState(NOW, JOINTS, np.array(q), np.array(qd)), NOW)
    assert decision is not None
    # As text, because a NaN is equal to itself only as the same object.
    assert repr(list(decision.contacts)) == repr(first_assessment(scara.with_payload(offset), q, qd, offset))
    assert decision.contacts[0].full_mass != assess_one(scara, q, qd, payload_mass=2.0).full_mass


def test_inertia_of_the_payload_applies_and_an_impossible_one_changes_nothing(scara: RobotDynamics) -> None:
    q, qd = (0.3, 1.2, 0.1, 0.0), (0.1, 0.1, 0.1, 0.1)
    monitor = Monitor(scara, settings_of(payload_mass=2.0))
    solid = settings_of(payload_mass=2.0, payload_inertia=(0.2, 0.2, 0.2, 0.0, 0.0, 0.0))
    monitor.apply(solid)
    with pytest.raises(RobotError, match="triangle inequality"):
        monitor.apply(settings_of(payload_mass=2.0, payload_inertia=(0.2, 0.2, 0.5, 0.0, 0.0, 0.0)))
    decision = monitor.assess(JointState(NOW, JOINTS, np.array(q), np.array(qd)), NOW)
    assert decision is not None
    assert list(decision.contacts) == first_assessment(scara.with_payload(solid), q, qd, solid)
    # The inertia turns with the tool, whose heavier turning adds to the mass along the velocity.
    assert decision.contacts[0].full_mass > assess_one(scara, q, qd, payload_mass=2.0).full_mass


def test_effort_limits_raise_the_speed_of_a_stiff_servo(scara: RobotDynamics, scara_variant: Variant) -> None:
    """One below the weight of its joint cannot be that of the drive, so nothing is known of what it adds."""

    def limited(vertical: float) -> RobotDynamics:
        efforts = {"joint3": vertical}
        return scara_variant(lambda file: [j.update(max_effort=efforts.get(j["name"], 1.0)) for j in file["joints"]])

    q, qd, stiff = (0.3, 1.2, 0.1, 0.0), (0.1, 0.1, 1e-6, 0.1), {"drives": "servo", "servo": {"bandwidth": 1000.0}}
    speeds = [assess_one(robot, q, qd, **stiff).allowable_speed for robot in (scara, limited(1.0), limited(5.5))]
    assert 1.2 * speeds[0] == 1.2 * speeds[1] < speeds[2] < assess_one(scara, q, qd).allowable_speed


@pytest.mark.parametrize("speed_threshold", [0.001, 0.02])
@pytest.mark.parametrize("normal", ["worst", "velocity", "0.6 -0.8 0"])
def test_computed_torque_counts_up_to_the_effort_limits(
    scara: RobotDynamics, scara_variant: Variant, normal: str, speed_threshold: float
) -> None:
    """A saturated joint yields while the others push on: the arm is no longer one mass on one servo."""
    weak = scara_variant(lambda file: [joint.update(max_effort=20.0) for joint in file["joints"]])
    q, qd, region = (0.3, 1.2, 0.1, 0.0), (0.01, 0.01, 0.001, 0.01), "chest"
    settings: dict[str, object] = {"drives": "servo", "servo": {"computed_torque": True}, "body_regions": [region]}
    settings |= {"contact_normal": normal, "speed_threshold": speed_threshold, "speed_uncertainty": 0.0}
    settings |= {"position_tolerance": 0.0, "velocity_tolerance": 0.0, "max_velocity_lag": 0.0}
    strong, limited = assess_one(scara, q, qd, **settings), assess_one(weak, q, qd, **settings)
    normals: list[Vector3] = [strong.direction]
    if normal == "0.6 -0.8 0":
        normals = [(0.6, -0.8, 0.0), (-0.6, 0.8, 0.0)]
    force = contact_at(weak, q).least_holding_force
    if normal == "0.6 -0.8 0" or speed_threshold == 0.001:
        force = min(contact_at(weak, q).clamping_force([np.array(n)]) for n in normals)
    (limit,) = limits_for(settings_of(body_regions=[region]))
    expected = force / limit.permissible_force_n * strong.allowable_speed
    assert 0.0 < limited.allowable_speed < 0.5 * strong.allowable_speed
    if normal == "velocity" or (normal == "worst" and speed_threshold == 0.02):
        assert limited.allowable_speed == pytest.approx(expected)
    else:  # the pose changes less at a lower speed, and the worst normal counts, too
        assert limited.allowable_speed == pytest.approx(expected, rel=0.2)


@pytest.mark.parametrize("use_reference", [False, True])
@pytest.mark.parametrize(("normal", "lift"), [("worst", 1e4), ("velocity", 1e4), ("worst", 30.0)])
def test_weakest_direction_of_a_robot_at_rest_limits_computed_torque(
    scara_variant: Variant, normal: str, lift: float, *, use_reference: bool
) -> None:
    """A stretched arm holds least across itself, wherever it points."""
    efforts = {"joint1": 20.0, "joint2": 20.0, "joint3": lift, "joint4": 1e4}
    weak = scara_variant(lambda file: [joint.update(max_effort=efforts[joint["name"]]) for joint in file["joints"]])
    settings = settings_of(
        drives="servo", servo={"computed_torque": True}, body_regions=["chest"], contact_normal=normal
    )
    monitor = Monitor(weak, settings, use_reference=use_reference)
    q = np.array([[q1, 0.2, 0.1, 0.0] for q1 in (0.0, 0.5, 1.0, math.pi / 2.0)])
    speeds = monitor.assess_configurations(q, np.full(q.shape, 1e-6)).contacts["allowable_speed"]
    assert 0.0 < speeds[0, 0] == pytest.approx(speeds[:, 0])


def test_unknown_effort_limits_give_no_clamping_force(scara: RobotDynamics) -> None:
    contact = assess_one(scara, (0.3, 1.2, 0.1, 0.0), (0.1,) * 4, contact="quasi_static", drives="free")
    assert contact.verdict is Verdict.UNKNOWN
    assert contact.reason.startswith("the clamping force is unknown")
    assert (contact.clamping_force, contact.allowable_speed) == (0.0, 0.0)


def test_computed_torque_allows_no_speed_where_the_weight_is_too_much_for_a_joint(scara_variant: Variant) -> None:
    def with_lift(effort: float) -> RobotDynamics:
        efforts = {"joint1": 1e4, "joint2": 1e4, "joint3": effort, "joint4": 1e4}
        return scara_variant(lambda file: [joint.update(max_effort=efforts[joint["name"]]) for joint in file["joints"]])

    weak, strong = with_lift(1.0), with_lift(1000.0)
    q, qd, up = (0.3, 1.2, 0.1, 0.0), (1e-6, 1e-6, -0.1, 1e-6), np.array((0.0, 0.0, 1.0))
    assert contact_at(weak, q).holding_force([up]) < 0.0 < contact_at(strong, q).holding_force([up])
    settings: dict[str, object] = {"drives": "servo", "servo": {"computed_torque": True}, "body_regions": ["abdomen"]}
    limited, whole = (assess_one(robot, q, qd, **settings) for robot in (weak, strong))
    assert limited.allowable_speed == 0.0 < whole.allowable_speed


@given(
    positions,
    velocities,
    st.sampled_from(["worst", "velocity", "0.6 -0.8 0"]),
    st.sampled_from([0.001, 0.02]),
    st.sampled_from([{"computed_torque": False}, {"computed_torque": True}]),
)
def test_servo_counts_joints_that_are_held_one_by_one(
    scara: RobotDynamics, q: Vector, qd: Vector, normal: str, speed_threshold: float, servo: dict[str, bool]
) -> None:
    """Mobility and change of pose of the arm of one mass matrix, and of the arm of its diagonal alone."""
    qd = slowed(qd) if speed_threshold == 0.02 else qd
    settings = settings_of(
        drives="servo",
        servo=servo,
        effective_mass_model="full",
        body_regions=["chest"],
        contact_normal=normal,
        speed_threshold=speed_threshold,
        position_tolerance=0.0,
    )
    (contact,) = first_assessment(scara, q, qd, settings)
    at = contact_at(scara, q, qd)
    direction, share, mobilities = direction_of(at, settings), 1.0, []
    fixed = None if settings.fixed_normal is None else np.array(settings.fixed_normal)
    if fixed is not None and direction is not None:
        share = max(abs(float(fixed @ direction)), 0.1)
    coupled, held = at.mobility(ModelCode.FULL, direction), at.held_mobility(ModelCode.FULL, direction)
    for mobility in (coupled,) if servo["computed_torque"] else (coupled, held):
        if fixed is not None:
            mobilities.append(mobility.along(fixed, share * at.speed, either_way=share == 0.1))
        elif direction is None:
            mobilities.append(Mobility.of_mass(mobility.worst_mass, X_AXIS))
        elif normal == "velocity":
            mobilities.append(Mobility.of_mass(mobility.effective_mass(direction), direction))
        else:
            mobilities.append(mobility)
    heavier = [mobility.with_masses(1.0 + settings.mass_uncertainty) for mobility in mobilities]
    limit = speed_limit(contact_cases(limits_for(settings), settings), heavier)
    closing = settings.person_speed + settings.speed_uncertainty
    assert contact.allowable_speed == pytest.approx(max(0.0, (limit.allowable_speed - closing) / share))


def test_mass_of_the_standard_on_a_servo_is_that_mass_alone(scara_variant: Variant) -> None:
    """The push of the drives accelerates the arm as their effort limits allow."""
    efforts = {"joint1": 5.0, "joint2": 5.0, "joint3": 50.0, "joint4": 5.0}
    weak = scara_variant(lambda file: [joint.update(max_effort=efforts[joint["name"]]) for joint in file["joints"]])
    q, qd = (0.3, 1.2, 0.1, 0.0), (0.1, 0.1, 0.1, 0.1)
    for bandwidth in (1.0, 1000.0):
        servo = {"bandwidth": bandwidth, "computed_torque": False}
        settings = settings_of(drives="servo", servo=servo, effective_mass_model="iso", position_tolerance=0.0)
        (contact,) = first_assessment(weak, q, qd, settings)
        mobility = Mobility.of_mass(weak.robot.iso_mass * (1.0 + settings.mass_uncertainty), X_AXIS)
        push = DrivePush(contact_at(weak, q).drive_acceleration(), mobility.trace)
        limit = speed_limit(contact_cases(limits_for(settings), settings), [mobility], push)
        expected = limit.allowable_speed - settings.speed_uncertainty
        assert contact.allowable_speed == pytest.approx(expected)


@pytest.mark.parametrize("efforts", [(40.0, 30.0, 500.0, 5.0), (5.0, 5.0, 500.0, 5.0), (5.0, 50.0, 90.0, 0.1)])
@pytest.mark.parametrize("point", ["tool", "rim", "forearm", "elbow"])
def test_robot_at_rest_clamps_in_any_direction(scara_variant: Variant, efforts: tuple[float, ...], point: str) -> None:
    """Base axes are no directions of their own: turned arms were OK along them and violated a limit between them."""

    def change(file: dict[str, Any]) -> None:
        at = [0.275, 0.0, 0.0]
        file["contact_points"].update(rim=[0.05, 0.0, 0.0], forearm={"link": 2, "at": at}, elbow={"link": 1, "at": at})
        for joint, effort in zip(file["joints"], efforts, strict=True):
            joint["max_effort"] = effort

    robot = scara_variant(change)
    index, settings = robot.contact_points.index(point), settings_of(contact="quasi_static", drives="free")
    for q in [(0.3, 1.2, 0.1, 0.0), (0.3, 0.0, 0.1, 0.5), (-1.0, -0.7, 0.2, 2.0)]:
        contact = first_assessment(robot, q, (1e-6,) * 4, settings)[index]
        assert contact.worst_direction_used
        reference = robot.at(np.array(q)).contacts[index]
        assert contact.clamping_force == pytest.approx(reference.largest_clamping_force(), rel=1e-12)


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (0.6, 0.8, 0.0), (0.6, -0.8, 0.0)])
def test_fixed_normal_clamps_along_both_its_senses(scara_variant: Variant, normal: Vector3) -> None:
    """Downwards the weight of the arm pushes, too."""
    robot = scara_variant(lambda file: [joint.update(max_effort=500.0) for joint in file["joints"]])
    q, text = (0.3, 1.2, 0.1, 0.0), " ".join(map(str, normal))
    contact = assess_one(robot, q, (0.1,) * 4, contact="quasi_static", contact_normal=text, drives="free")
    x, y, z = normal
    there, back = (contact_at(robot, q).clamping_force([np.array(n)]) for n in (normal, (-x, -y, -z)))
    assert (abs(there - back) > 10.0) == (z != 0.0)
    assert contact.clamping_force == pytest.approx(max(there, back))


@pytest.mark.parametrize(("qd", "normal"), [((-1.0, 1.5, 0.01, 0.1), "worst"), ((0.5, -2.0, 0.01, 0.1), "0.6 -0.8 0")])
def test_arm_that_does_not_yield_has_the_speed_of_its_path_by_every_mass(
    scara: RobotDynamics, qd: Vector, normal: str
) -> None:
    """The mass of the standard does not change with the pose, but the velocity does."""
    q = (0.3, 1.2, 0.1, 0.0)
    chosen = {"contact_normal": normal, "drives": "immovable", "body_regions": ["abdomen"]}
    full, iso = (assess_one(scara, q, qd, effective_mass_model=model, **chosen) for model in ("full", "iso"))
    assert full.allowable_speed > 0.0
    assert iso.allowable_speed == pytest.approx(full.allowable_speed, rel=1e-9)


def test_largest_mass_counts_the_change_of_pose_of_the_lumped_model(bare_scara: RobotDynamics) -> None:
    q, qd = (0.3, 0.3, 0.1, 0.0), (1.0, -2.0, 0.1, 0.1)
    largest, lumped = (assess_one(bare_scara, q, qd, effective_mass_model=model) for model in ("largest", "lumped"))
    assert largest.allowable_speed <= lumped.allowable_speed


def test_rejected_settings_change_nothing(scara: RobotDynamics) -> None:
    monitor = Monitor(scara, settings_of(max_force=100.0))
    before = monitor.settings
    with pytest.raises(LimitError):
        monitor.apply(settings_of(max_force=1e5, latch=True))
    assert monitor.settings is before
    decision = monitor.assess(JointState(NOW, JOINTS, np.array([0.3, 1.2, 0.1, 0.0]), np.full(4, 0.1)), NOW)
    assert decision is not None
    assert decision.contacts[0].verdict is Verdict.OK


@pytest.mark.parametrize("model", MassModel)
@pytest.mark.parametrize(("scale", "valid"), [(1e-5, True), (1e-7, False)])
def test_effective_mass_below_the_minimum_gives_unknown(
    scara_variant: Variant,
    model: MassModel,
    scale: float,
    valid: bool,  # noqa: FBT001
) -> None:
    """The masses of the shipped robot lie between 0.5 and 3 kg; the minimum is a milligram."""

    def shrink(file: dict[str, Any]) -> None:
        for body in (*file["links"], file["payload"]):
            body["mass"] *= scale
            body["inertia"] *= scale

    # The minimum holds for a robot whose reach suits its mass, too.
    dynamics = RobotDynamics(replace(scara_variant(shrink).robot, units_reason=""))
    light = assess_one(dynamics, (0.3, 1.2, 0.1, 0.0), (0.1, 0.1, 0.01, 0.1), effective_mass_model=model)
    if valid:
        assert light.verdict in {Verdict.OK, Verdict.WARN}
        assert light.effective_mass > 0.0
    else:
        require_no_numbers(light)
        name = "lumped" if model in {MassModel.LARGEST, MassModel.AUTO} else model.value
        assert light.reason.startswith(f"{name} mass = ")
        assert "must be at least 1e-06 kg" in light.reason


def test_placeholder_masses_give_unknown(scara_variant: Variant) -> None:
    def replace_inertias(file: dict[str, Any]) -> None:
        for link in file["links"]:
            link.update(mass=1.0, inertia=[1.0, 1.0, 1.0, 0.0, 0.0, 0.0])

    contact = assess_one(scara_variant(replace_inertias), (0.3, 1.2, 0.1, 0.0), (0.1, 0.1, 0.01, 0.1))
    require_no_numbers(contact)
    assert contact.reason == "every link has mass 1 and identity inertia: placeholders, not data"
    assert contact.iso_mass == 0.0


def test_speed_exactly_at_the_allowable_speed_is_no_violation(scara: RobotDynamics) -> None:
    q, qd = (0.3, 1.2, 0.1, 0.0), (1.5, 0.4, 0.01, 0.1)
    alone = assess_one(scara, q, qd, drives="free")
    # Between a/2 and a the difference a - v is exact, and so is the allowable speed a - (a - v) = v.
    assert 0.5 * alone.allowable_speed < alone.speed < alone.allowable_speed
    closing = alone.allowable_speed - alone.speed
    equal = assess_one(scara, q, qd, speed_uncertainty=closing, warn_ratio=1.0, drives="free")
    assert equal.allowable_speed == equal.speed
    assert equal.verdict is Verdict.OK
    above = assess_one(scara, q, qd, speed_uncertainty=closing + 1e-9, warn_ratio=1.0, drives="free")
    assert above.verdict is Verdict.VIOLATION


def test_mass_equal_to_the_full_one_gives_no_warning_at_zero_margin(scara: RobotDynamics) -> None:
    q, qd = (0.3, 1.2, 0.1, 0.0), (0.1, 0.1, 0.01, 0.1)
    contact = assess_one(scara, q, qd, effective_mass_model="full", model_margin=0.0)
    assert (contact.verdict, contact.reason) == (Verdict.OK, "")


def test_violation_with_a_low_mass_states_both_reasons(scara: RobotDynamics) -> None:
    q, qd = (0.0, -1.2, 0.1, 0.0), (0.0005, 0.0005, 0.01, 0.001)
    contact = assess_one(scara, q, qd, effective_mass_model="iso", speed_threshold=0.02, person_speed=5.0)
    assert contact.verdict is Verdict.VIOLATION
    assert contact.reason.startswith("a person at 5.000 m/s leaves no speed: the force limit of ")
    assert "; the iso mass of 2.77 kg is below the full model's " in contact.reason


def test_scaling_at_rest_is_zero_if_nothing_is_allowed(scara: RobotDynamics) -> None:
    monitor = Monitor(scara, settings_of(person_speed=5.0))
    for now in (NOW, NOW + 100_000_000):
        decision = monitor.assess(JointState(now, JOINTS, np.array([0.3, 1.2, 0.1, 0.0]), np.zeros(4)), now)
    assert decision is not None
    (contact,) = decision.contacts
    assert (contact.verdict, contact.speed) == (Verdict.VIOLATION, 0.0)
    assert decision.speed_scaling == 0.0


@pytest.mark.parametrize("use_reference", [False, True])
def test_force_bound_is_the_largest_of_all_masses(*, use_reference: bool) -> None:
    """A mass that grows as the pose changes may allow less speed, and hit less hard at a lower one, than another."""
    settings = MonitorSettings(effective_mass_model="largest", mass_uncertainty=0.0)
    dynamics = RobotDynamics(load_robot(settings=settings))
    q = dynamics.robot.sample_configurations(300)
    qd = np.random.default_rng(1).uniform(-1.0, 1.0, q.shape) * 10.0 ** np.linspace(-2.0, 0.5, len(q))[:, None]
    states = slice(0, len(q), 10 if use_reference else 1)
    monitor = Monitor(dynamics, settings, use_reference=use_reference)
    contacts = monitor.assess_configurations(q[states], qd[states]).contacts
    assert (contacts["predicted_force"] <= contacts["force_bound"] * (1.0 + 1e-9)).all()


@pytest.mark.parametrize("stated", [(), ("joint1=0.5", "joint2=0.5", "joint3=0.5", "joint4=60")])
@pytest.mark.parametrize("use_reference", [False, True])
def test_joint_that_turns_too_far_by_accelerating_is_named(
    scara: RobotDynamics, stated: tuple[str, ...], *, use_reference: bool
) -> None:
    """The quarter period of 40 kg on 10 N/mm is 0.0993 s, so that 10.1 rad/s2 turn a joint by 0.05 rad.

    Also if a larger acceleration is stated.
    """
    settings = MonitorSettings(body_regions=("abdomen",), max_joint_acceleration=stated)
    monitor = Monitor(scara, settings, use_reference=use_reference)
    q, qd = np.array([[0.3, 1.2, 0.1, 0.2]]), np.array([[0.01, 0.01, 0.0, 0.0]])
    below, above = (
        monitor.assess_configurations(q, qd, np.array([[0.0, 0.0, 0.0, qdd]])).decision(0).contacts[0]
        for qdd in (10.0, -10.3)
    )
    assert (below.verdict, below.reason_code) == (Verdict.OK, Reason.NONE)
    assert (above.verdict, above.reason_code) == (Verdict.WARN, Reason.TURNS)
    assert above.allowable_speed == pytest.approx(below.allowable_speed, rel=0.05)
    assert above.reason.startswith("joint4 accelerates: until the peak of a contact it would turn 0.051 rad further")


@pytest.mark.parametrize("person_speed", [0.0, 1.0])
@pytest.mark.parametrize("use_reference", [False, True])
def test_force_is_finite_where_the_acceleration_leaves_no_speed(
    scara: RobotDynamics, person_speed: float, *, use_reference: bool
) -> None:
    """An infinite one, as of drives without effort limits, makes a message that consumers refuse."""
    settings = MonitorSettings(person_speed=person_speed)
    monitor = Monitor(scara, settings, use_reference=use_reference)
    q, qd, qdd = np.array([[0.3, 1.2, 0.1, 0.2]]), np.array([[0.5, 0.4, 0.0, 0.0]]), np.array([[40.0, 30.0, 0.0, 0.0]])
    for contact in monitor.assess_configurations(q, qd, qdd).decision(0).contacts:
        assert (contact.verdict, contact.allowable_speed) == (Verdict.VIOLATION, 0.0)
        assert 140.0 < contact.force_bound < math.inf


@pytest.mark.parametrize(
    ("shown", "errors", "qdd", "counted"),
    [
        ((4.0, -4.0, 0.0, 5.0), 0.0, 0.0, 5.0),
        ((4.0, -4.5, 0.0, 1.0), 0.5, 0.0, 5.0),
        ((4.0, -4.5, 5.5, 4.75), 1.0, (0.0, -4.5, 5.5, 4.75), (5.0, 1.0, 1.0, 1.0)),
    ],
    ids=["covered", "covered_with_its_error", "exceeded_by_some"],
)
def test_stated_acceleration_of_a_joint_counts_both_ways_unless_it_shows_a_larger_one(
    scara: RobotDynamics, shown: Vector, errors: float, qdd: float | Vector, counted: float | Vector
) -> None:
    def numbers(motion: tuple[float | Vector, float | Vector], *stated: str) -> bytes:
        monitor, q = Monitor(scara, settings_of(max_joint_acceleration=stated)), np.array([[0.3, 1.2, 0.1, 0.2]])
        pending = monitor.admit(JOINTS, np.array([NOW]), np.array([NOW]), q, np.full((1, 4), 0.1))
        assert pending is not None
        pending.motions[:, 3], pending.motions[:, 4] = motion
        monitor.compute(pending)
        return pending.numbers.tobytes()

    assert numbers((shown, errors), *(f"{joint}=5" for joint in JOINTS)) == numbers((qdd, counted))


def speed_until_it_reacts(monitor: Monitor, q: FloatArray, qd: FloatArray, **settings: float) -> float:
    """Return the allowable speed of a robot that reacts after 0.3 s, or after `reaction_time`."""
    monitor.apply(MonitorSettings.model_validate({"drives": "free", "reaction_time": 0.3, **settings}))
    qdd = np.full((1, len(q)), 1e-3)
    return float(monitor.assess_configurations(q[None], qd[None], qdd).contacts["allowable_speed"][0, 0])


@pytest.mark.parametrize("use_reference", [False, True])
def test_stated_acceleration_hides_none_of_held_joint_velocities(scara: RobotDynamics, *, use_reference: bool) -> None:
    monitor = Monitor(scara, MonitorSettings(), use_reference=use_reference)
    motion = np.array([0.3, 1.2, 0.1, 0.2]), np.array([-0.8, 1.9, 0.0, 0.0])  # 0.39 m/s2 along the velocity
    assert speed_until_it_reacts(monitor, *motion, max_acceleration=0.1) <= speed_until_it_reacts(monitor, *motion)
    assert speed_until_it_reacts(monitor, *motion, max_acceleration=1.0) < speed_until_it_reacts(monitor, *motion)


@pytest.mark.parametrize("use_reference", [False, True])
@pytest.mark.parametrize("contact_normal", ["worst", "0.6 -0.8 0"])
def test_robot_that_brakes_can_still_accelerate_as_stated(
    scara: RobotDynamics, contact_normal: str, *, use_reference: bool
) -> None:
    """A stated limit counts in full beside a harder braking, as far as that lacks beside a larger acceleration."""
    q, qd = np.array([[0.3, 1.2, 0.1, 0.2]]), np.array([[0.4, 0.5, 0.1, 0.1]])

    def allowable_speed(factor: float, limit: float) -> float:
        settings = settings_of(drives="free", max_acceleration=limit, contact_normal=contact_normal)
        monitor = Monitor(scara, settings, use_reference=use_reference)
        return float(monitor.assess_configurations(q, qd, factor * qd).contacts["allowable_speed"][0, 0])

    assert allowable_speed(-9.0, 2.0) <= allowable_speed(0.0, 2.0) < allowable_speed(-9.0, 0.0)
    assert allowable_speed(9.0, 2.0) == allowable_speed(9.0, 0.0)


@pytest.mark.parametrize("contact_normal", ["worst", "velocity", "0.6 -0.8 0"])
@pytest.mark.parametrize("model", ["iso", "full", "lumped"])
def test_kernel_counts_the_stated_acceleration_of_a_robot_that_brakes_as_the_reference(
    scara: RobotDynamics, model: str, contact_normal: str
) -> None:
    settings = settings_of(max_acceleration=2.0, effective_mass_model=model, contact_normal=contact_normal)
    q, qd = np.array([[0.3, 1.2, 0.1, 0.2]]), np.array([[0.4, 0.5, 0.1, 0.1]])
    kernel, reference = (
        Monitor(scara, settings, use_reference=use).assess_configurations(q, qd, -9.0 * qd).contacts["allowable_speed"]
        for use in (False, True)
    )
    assert kernel == pytest.approx(reference, rel=1e-9)


@pytest.mark.parametrize("use_reference", [False, True])
def test_point_at_rest_gets_faster_by_joints_that_move(*, use_reference: bool) -> None:
    settings = MonitorSettings(robot=str(share("config", "robots", "ur5_robot.urdf")), contact_points=("ee_link",))
    dynamics = RobotDynamics(load_robot(settings=settings))
    q = np.linspace(-1.0, 1.0, 6)
    jacobian = dynamics.at(q, np.zeros(6)).contacts[0].jacobian
    qd = np.ones(6) - np.linalg.pinv(jacobian) @ jacobian @ np.ones(6)
    monitor = Monitor(dynamics, settings, use_reference=use_reference)
    at_once = speed_until_it_reacts(monitor, q, qd, reaction_time=0.0)
    assert 0.0 < speed_until_it_reacts(monitor, q, qd) < at_once - 0.05
