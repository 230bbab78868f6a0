# SPDX-License-Identifier: Apache-2.0
"""Contact with a person who moves: the worst velocity by search, the growth by finite differences, closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.iso15066 import contact_cases, limits_for
from scara_effmass.reference.mobility import Mobility
from scara_effmass.reference.person import MovingPerson, PersonContact, person_speed_limit
from scara_effmass.reference.speed_limit import DrivePush, speed_limit
from scara_effmass.settings import Drives, MonitorSettings
from scara_effmass.values import FloatArray
from test.reference.test_pose_change import SEEDS, Motion

SPEEDS = st.floats(0.01, 3.0)
LINES = st.sampled_from([(1.0 / 40.0, 1.0), (1.0 / 75.0, 0.4), (1.0 / 3.0, 1.0), (0.1, 0.0)])
SETTINGS = MonitorSettings(drives=Drives.FREE, body_regions=("chest",))
(CASE,) = contact_cases(limits_for(SETTINGS), SETTINGS)
X = np.array([1.0, 0.0, 0.0])


def mass_matrix(mobility: FloatArray, line: tuple[float, float]) -> FloatArray:
    alpha, beta = line
    return np.asarray(np.linalg.inv(alpha * np.eye(3) + beta * mobility))


def worst_energy(matrix: FloatArray, velocity: FloatArray, person_speed: float, seed: int) -> float:
    """Return the largest (v - u)^T K (v - u), |u| <= v_p: the sum is convex, so u = -v_p K(v - u) / |...| climbs."""
    starts = np.random.default_rng(seed).normal(size=(64, 3))
    u = person_speed * np.vstack((starts, np.eye(3), -np.eye(3), -velocity))
    u /= np.linalg.norm(u, axis=1, keepdims=True) / person_speed
    for _ in range(3000):
        gradient = (velocity - u) @ matrix
        u = -person_speed * gradient / np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-300)
    w = velocity - u
    return float(np.max(np.einsum("ni,ij,nj->n", w, matrix, w)))


@given(SEEDS, LINES, SPEEDS, SPEEDS)
def test_energy_is_that_of_the_worst_velocity_of_the_person(
    seed: int, line: tuple[float, float], speed: float, person_speed: float
) -> None:
    motion = Motion(seed)
    contact = PersonContact.of(CASE, motion.moving(), line, MovingPerson(person_speed, None))
    expected = worst_energy(mass_matrix(motion.mobility, line), speed * motion.direction, person_speed, seed)
    assert contact.energy(speed) >= expected * (1.0 - 1e-9)
    assert contact.energy(speed) == pytest.approx(expected, rel=1e-3)


def test_velocity_along_a_light_axis_is_met_across_it() -> None:
    """The hard case: the worst velocity of the person has a part across v that no gradient shows."""
    mobility = Mobility(np.array([1.0, 0.1, 0.1]), np.eye(3), X)
    contact = PersonContact.of(CASE, mobility, (0.0, 1.0), MovingPerson(1.0, None))
    # K = diag(1, 10, 10), v = (0.5, 0, 0): l = 10, u = (-K v / (l - K))_x = -1/18, and the rest of |u| = 1 across.
    across = 1.0 - (0.5 / 9.0) ** 2
    assert contact.energy(0.5) == pytest.approx((0.5 + 0.5 / 9.0) ** 2 + 10.0 * across, rel=1e-9)


@given(SEEDS, LINES, SPEEDS, SPEEDS)
def test_person_along_the_velocity_adds_the_speed_on_a_ball(
    seed: int, line: tuple[float, float], speed: float, person_speed: float
) -> None:
    """One mass in every direction: F = (s + v_p) sqrt(mu k), whether the direction of the person is known or not."""
    direction = Motion(seed).direction
    mobility = Mobility.of_any_direction(2.5, direction)
    alpha, beta = line
    mu = 1.0 / (alpha + beta / 2.5)
    for towards in (None, direction):
        contact = PersonContact.of(CASE, mobility, line, MovingPerson(person_speed, towards))
        assert contact.energy(speed) == pytest.approx((speed + person_speed) ** 2 * mu, rel=1e-9)


@given(SEEDS, LINES, SPEEDS, SPEEDS)
def test_known_direction_counts_one_velocity_and_never_more_than_any(
    seed: int, line: tuple[float, float], speed: float, person_speed: float
) -> None:
    motion, towards = Motion(seed), Motion(seed + 1).direction
    known = PersonContact.of(CASE, motion.moving(), line, MovingPerson(person_speed, towards))
    w = speed * motion.direction + person_speed * towards
    matrix = mass_matrix(motion.mobility, line)
    met = float(w @ matrix @ w)
    if motion.direction @ matrix @ towards >= 0.0:
        assert known.energy(speed) == pytest.approx(met, rel=1e-9)
    else:  # a person who flees may stop
        assert known.energy(speed) >= met
    anyone = PersonContact.of(CASE, motion.moving(), line, MovingPerson(person_speed, None))
    assert known.energy(speed) <= anyone.energy(speed) * (1.0 + 1e-9)


@given(SEEDS, LINES, SPEEDS, SPEEDS)
def test_growth_bounds_the_change_of_the_energy(
    seed: int, line: tuple[float, float], speed: float, person_speed: float
) -> None:
    """w^T K w with v(t) and A(t) of the moving point, for every velocity of the person."""
    motion = Motion(seed)
    contact = PersonContact.of(CASE, motion.moving(), line, MovingPerson(person_speed, None))
    pace, h = speed / motion.speed, 1e-6
    rng = np.random.default_rng(seed)
    people = rng.normal(size=(32, 3))
    people *= person_speed * rng.uniform(size=(32, 1)) / np.linalg.norm(people, axis=1, keepdims=True)

    def energies(t: float) -> FloatArray:
        mobility = motion.mobility + pace * t * (motion.rate + motion.rate.T)
        w = pace * motion.velocity + pace**2 * t * motion.accelerations[0] - people
        return np.asarray(np.einsum("ni,ij,nj->n", w, mass_matrix(mobility, line), w))

    rates = (energies(h) - energies(-h)) / (2.0 * h)
    bound = contact.growth.rate(speed)
    assert np.max(rates) <= bound + 1e-5 * (1.0 + abs(bound))


@given(SEEDS, SPEEDS, st.sampled_from([Drives.FREE, Drives.SERVO, Drives.IMMOVABLE]), st.booleans())
def test_allowable_speed_reaches_the_limit_exactly(
    seed: int,
    person_speed: float,
    drives: Drives,
    known: bool,  # noqa: FBT001 - a parameter
) -> None:
    settings = MonitorSettings(drives=drives, body_regions=("chest",))
    (case,) = contact_cases(limits_for(settings), settings)
    motion = Motion(seed)
    person = MovingPerson(person_speed, motion.direction if known else None)
    for line in case.lines:
        found = person_speed_limit(case, motion.moving(), line, person, case.force)
        if found.allowable_speed >= 0.0:
            assert found.force(found.allowable_speed) == pytest.approx(case.force, rel=1e-9)
        else:  # the person alone is too fast
            assert found.force(0.0) > case.force


@given(SEEDS, SPEEDS, SPEEDS)
def test_faster_person_leaves_less_speed(seed: int, one: float, other: float) -> None:
    slow, fast = sorted((one, other))
    mobilities = [Motion(seed).moving()]
    push = DrivePush(50.0, 0.05)
    for drives in (None, push):
        allowed = [speed_limit([CASE], mobilities, drives, person=MovingPerson(v, None)) for v in (slow, fast)]
        assert allowed[1].allowable_speed <= allowed[0].allowable_speed + 1e-9


@given(SEEDS)
def test_slow_person_changes_little(seed: int) -> None:
    moving = Motion(seed).moving()
    for mobility in (moving, replace(moving, change=None)):
        alone = speed_limit([CASE], [mobility])
        slow = speed_limit([CASE], [mobility], person=MovingPerson(1e-6, None))
        assert slow.allowable_speed <= alone.allowable_speed + 1e-9
    assert slow.allowable_speed == pytest.approx(alone.allowable_speed, rel=1e-3)


def test_clamped_body_part_does_not_meet_a_point_that_cannot_move() -> None:
    settings = MonitorSettings(drives=Drives.FREE, body_regions=("chest",), contact="quasi_static")
    (clamped,) = contact_cases(limits_for(settings), settings)
    plane = Mobility(np.array([0.2, 0.5]), np.eye(3)[:, :2], X)
    contact = PersonContact.of(clamped, plane, (0.0, 1.0), MovingPerson(1.0, None))
    assert contact.masses[2] == 0.0
    assert contact.person_mass == pytest.approx(5.0)
    free = PersonContact.of(CASE, replace(plane), (1.0 / 40.0, 1.0), MovingPerson(1.0, None))
    assert free.person_mass == pytest.approx(40.0)
    assert math.isfinite(free.energy(1.0))
