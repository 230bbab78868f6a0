# SPDX-License-Identifier: Apache-2.0
"""Growth of the force by the change of pose: derivatives by finite differences, and the speed that remains allowed."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from scara_effmass.iso15066 import SpeedLimit, contact_cases, contact_time, limits_for
from scara_effmass.iso15066.drives import contact_lines
from scara_effmass.reference.mobility import Mobility, PoseChange
from scara_effmass.reference.speed_limit import DrivePush, speed_limit
from scara_effmass.settings import ContactType, Drives, MonitorSettings
from scara_effmass.values import FloatArray

SEEDS = st.integers(0, 2**32 - 1)
ALPHAS = st.sampled_from([1.0 / 75.0, 1.0 / 40.0, 1.0 / 3.0, 1.0 / 0.6])
STEP = 1e-6


X = np.array([1.0, 0.0, 0.0])
ZEROS = np.zeros((3, 3))


def bound_of(settings: MonitorSettings, mobilities: list[Mobility], **bounds: Any) -> SpeedLimit:  # noqa: ANN401
    return speed_limit(contact_cases(limits_for(settings), settings), mobilities, **bounds)


class Motion:
    """A random contact point: mobility A, dA/dt = Z + Z^T, velocity v, its accelerations, free and held."""

    def __init__(self, seed: int, accelerations: int = 1) -> None:
        rng = np.random.default_rng(seed)
        basis = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        self.mobility = basis @ np.diag(10.0 ** rng.uniform(-1.5, 1.0, 3)) @ basis.T
        self.rate = rng.normal(size=(3, 3))
        self.velocity = rng.normal(size=3) * 10.0 ** rng.uniform(-2, 0)
        self.speed = float(np.linalg.norm(self.velocity))
        self.accelerations = rng.normal(size=(accelerations, 3))
        self.direction = self.velocity / self.speed
        self.normal = basis[0]

    def moving(self, **change: Any) -> Mobility:  # noqa: ANN401
        """Return the mobility with its change of pose, of which `change` replaces fields."""
        of_pose = PoseChange(self.speed, self.rate + self.rate.T, tuple(self.accelerations))
        return Mobility.of_matrix(self.mobility, self.direction, 3, replace(of_pose, **change))

    def at(self, t: float, rate: float, faster: float) -> tuple[FloatArray, FloatArray]:
        """Return A and v a time `t` later, with only a part of their changes."""
        mobility = self.mobility + rate * t * (self.rate + self.rate.T)
        return mobility, self.velocity + faster * t * self.accelerations[0]


@given(SEEDS, st.sampled_from([1, 2]))
def test_change_of_a_point_that_moves_in_fewer_dimensions_is_exact(seed: int, rank: int) -> None:
    """Against a clamped body part, where in three dimensions the mobility across would be rounding alone."""
    rng = np.random.default_rng(seed)
    basis = np.linalg.qr(rng.normal(size=(3, 3)))[0][:, :rank]
    mobility = basis @ np.diag(10.0 ** rng.uniform(-1.5, 1.0, rank)) @ basis.T
    velocity = basis @ rng.normal(size=rank)
    speed = float(np.linalg.norm(velocity))
    accelerations = tuple(rng.normal(size=(2, 3)))
    change = PoseChange(speed, 2.0 * np.eye(3), accelerations)
    moving = Mobility.of_matrix(mobility, velocity / speed, rank, change)
    w = np.linalg.pinv(mobility) @ velocity / speed
    np.testing.assert_allclose(moving.worst_normal(0.0), w / np.linalg.norm(w), atol=1e-7)
    along = w @ velocity / speed
    expected = 2.0 * max(0.0, *(np.array(accelerations) @ w)) / speed / along
    np.testing.assert_allclose(moving.growth(0.0, 1.0), expected, rtol=1e-6)
    # A mobility that falls adds its share, which depends on the length of w.
    falling = replace(moving, change=replace(change, mobility_rate=-2.0 * np.eye(3)))
    for alpha in (0.0, 0.3):
        w = np.linalg.pinv(mobility + alpha * basis @ basis.T) @ velocity / speed
        faster, along = max(0.0, *(np.array(accelerations) @ w)), w @ velocity / speed
        np.testing.assert_allclose(falling.growth(alpha, 1.0), 2.0 * (faster / speed + w @ w) / along, rtol=1e-6)


@given(SEEDS, ALPHAS, st.floats(0.1, 2.0))
def test_growth_is_the_derivative_of_the_worst_force(seed: int, alpha: float, beta: float) -> None:
    motion = Motion(seed)

    def log_square(t: float, rate: float, faster: float) -> float:
        mobility, velocity = motion.at(t, rate, faster)
        return math.log(velocity @ np.linalg.solve(alpha * np.eye(3) + beta * mobility, velocity))

    parts = [(log_square(STEP, *part) - log_square(-STEP, *part)) / (2.0 * STEP) for part in ((1.0, 0.0), (0.0, 1.0))]
    expected = sum(max(part, 0.0) for part in parts)
    assert motion.moving().growth(alpha, beta) == pytest.approx(expected, rel=1e-5, abs=1e-5)


@given(SEEDS, ALPHAS)
def test_growth_along_a_fixed_normal(seed: int, alpha: float) -> None:
    motion = Motion(seed)
    n = motion.normal
    assume(abs(n @ motion.velocity) > 0.05 * motion.speed)

    def log_square(t: float, rate: float, faster: float) -> float:
        mobility, velocity = motion.at(t, rate, faster)
        return math.log((n @ velocity) ** 2 / (alpha + n @ mobility @ n))

    parts = [(log_square(STEP, *part) - log_square(-STEP, *part)) / (2.0 * STEP) for part in ((1.0, 0.0), (0.0, 1.0))]
    along = motion.moving().along(motion.normal, 0.0, either_way=False)
    assert along.change is not None
    assert along.change.speed == pytest.approx(abs(n @ motion.velocity))
    assert along.growth(alpha, 1.0) == pytest.approx(sum(max(part, 0.0) for part in parts), rel=1e-5, abs=1e-5)


def test_speed_along_a_fixed_normal_has_a_minimum() -> None:
    y = np.array([0.0, 1.0, 0.0])
    moving = Mobility.of_matrix(np.eye(3), X, 3, PoseChange(0.5, ZEROS, (y,)))
    for sign in (1.0, -1.0):  # a speed of 0 along the normal has no sign
        along = moving.along(sign * y, 0.1, either_way=True)
        assert along.growth(1.0, 1.0) == pytest.approx(2.0 * 1.0 / 0.1)


@given(SEEDS, ALPHAS)
def test_only_the_larger_acceleration_counts(seed: int, alpha: float) -> None:
    motion = Motion(seed, accelerations=2)
    alone = [motion.moving(accelerations=(a,)).growth(alpha, 1.0) for a in motion.accelerations]
    assert motion.moving().growth(alpha, 1.0) == max(alone)


def test_immovable_robot_grows_with_its_acceleration_alone() -> None:
    moving = replace(Motion(1).moving(speed=0.5, accelerations=(np.array([0.2, 3.0, 0.0]),)), direction=X)
    assert moving.growth(1.0 / 40.0, 0.0) == pytest.approx(2.0 * 0.2 / 0.5)


@pytest.mark.parametrize("mobility", [-1.0, 0.0])
def test_mobility_that_no_robot_has_gives_no_finite_growth(mobility: float) -> None:
    """The worst normal is then that of the velocity."""
    motion = Motion(1)
    moving = Mobility.of_matrix(mobility * np.eye(3), motion.direction, 3, motion.moving().change)
    assert moving.growth(0.0, 1.0) == moving.reduced_mass(0.0) == math.inf
    assert moving.worst_normal(0.0) is motion.direction


def test_clamped_body_part_ignores_unreachable_directions() -> None:
    n = np.array([0.6, 0.8, 0.0])
    moving = Mobility.of_matrix(np.diag([0.5, 0.5, 0.0]), n, 3, PoseChange(0.5, ZEROS, (n,)))
    assert moving.growth(0.0, 1.0) == pytest.approx(2.0 * 1.0 / 0.5)


@given(
    SEEDS,
    SEEDS,
    st.sampled_from(["free", "servo", "immovable"]),
    st.floats(1.0, 1.5),
    st.sampled_from([None, (0.01, 0.2), (5.0, 0.2)]),
)
def test_speed_of_all_limits_is_the_smallest_of_each(
    seed: int, other: int, drives: str, factor: float, push: tuple[float, float] | None
) -> None:
    """One region and one mobility at a time. At that speed the force is the limit."""
    # Few regions on servos: each one is simulated.
    settings = MonitorSettings(drives=Drives(drives), body_regions=("chest", "abdomen") if drives == "servo" else ())
    mobilities = [Motion(each, 2).moving().with_masses(factor) for each in (seed, other)]
    drive_push = push and DrivePush(*push)
    cases = contact_cases(limits_for(settings), settings)
    found = speed_limit(cases, mobilities, drive_push)
    alone = [speed_limit([case], mobilities, drive_push) for case in cases]
    assert found == min(alone, key=lambda bound: bound.allowable_speed)
    assert found.force(found.allowable_speed) == pytest.approx(found.limit.permissible_force_n)
    if push is None:
        each = [speed_limit(cases, [mobility]) for mobility in mobilities]
        assert found == min(each, key=lambda bound: bound.allowable_speed)


@pytest.mark.parametrize("drives", Drives)
@pytest.mark.parametrize("factor", [1.0, 1.5])
def test_speed_of_a_straight_contact(drives: Drives, factor: float) -> None:
    """One mass in one direction: v (1 + growth v) sqrt(mu k) = F, growth = T (a / v0 - beta mu dA/dt / 2) / v0."""
    settings = MonitorSettings(drives=drives, body_regions=("chest",), stiffness_uncertainty=0.0)
    (limit,) = limits_for(settings)
    inverse_mass, rate, v0, a, k, m_h = 0.5, -3.0, 0.4, 0.7, limit.stiffness_n_m, limit.body_mass_kg
    mobility = Mobility.of_mass(1.0 / inverse_mass, X, PoseChange(v0, rate * np.eye(3), (a * X,)))
    found = bound_of(settings, [mobility.with_masses(factor)])
    (lines,) = contact_lines(drives, settings.servo, (k,), (m_h,))
    mu, beta = min((1.0 / (alpha + beta * inverse_mass / factor), beta) for alpha, beta in lines)
    time = 1.5 * math.pi / 2.0 * math.sqrt((mu if drives is Drives.FREE else m_h) / k)
    growth = time * (a / v0 - 0.5 * rate * beta * mu / factor) / v0
    assert found.reduced_mass == pytest.approx(mu)
    assert found.growth == pytest.approx(growth)
    v = found.allowable_speed
    assert v * (1.0 + growth * v) * math.sqrt(mu * k) == pytest.approx(limit.permissible_force_n)


def test_milder_limit_governs_by_its_longer_contact() -> None:
    """A light robot that drives hold, and two limits with the same k m_H."""
    (example,) = limits_for(MonitorSettings(body_regions=("chest",)))
    tight, mild = (
        replace(example, force_n=force, pressure_n_cm2=1e6, stiffness_n_m=k, body_mass_kg=m)
        for force, k, m in ((100.0, 1e5, 1.0), (105.0, 1e4, 10.0))
    )
    settings = MonitorSettings(drives=Drives.IMMOVABLE, stiffness_uncertainty=0.0)
    still = Mobility.of_mass(0.1, X)
    cases = contact_cases([mild, tight], settings)
    assert speed_limit(cases, [still]).limit == tight
    assert speed_limit(cases, [replace(still, change=PoseChange(0.5, ZEROS, (X,)))]).limit == mild


def test_robot_that_cannot_give_way_to_a_clamped_body_part_has_no_allowable_speed() -> None:
    """An infinite reduced mass stays one with a change of pose."""
    settings = MonitorSettings(contact=ContactType.QUASI_STATIC, drives=Drives.FREE)
    found = bound_of(settings, [Mobility.of_mass(math.inf, X, PoseChange(0.5, ZEROS, (X,)))])
    assert (found.allowable_speed, found.growth) == (0.0, 0.0)


def test_push_of_drives_changes_the_pose_for_the_time_of_the_body_part() -> None:
    settings = MonitorSettings(drives=Drives.SERVO, body_regions=("chest",), stiffness_uncertainty=0.0)
    (limit,) = limits_for(settings)
    v0, a = 0.4, 0.7
    mobility = Mobility.of_mass(2.0, X, PoseChange(v0, ZEROS, (a * X,)))
    found = bound_of(settings, [mobility], push=DrivePush(0.5, 0.5))
    assert found.push > 0.0
    assert found.growth == pytest.approx(contact_time(limit.body_mass_kg, limit.stiffness_n_m) * a / v0**2)


@given(SEEDS, ALPHAS)
def test_worst_normal_takes_the_most_energy(seed: int, alpha: float) -> None:
    motion = Motion(seed)
    normal = motion.moving().worst_normal(alpha)
    assert np.linalg.norm(normal) == pytest.approx(1.0)
    shifted = alpha * np.eye(3) + motion.mobility
    others = np.random.default_rng(seed).normal(size=(200, 3))
    energies = [(n @ motion.velocity) ** 2 / (n @ shifted @ n) for n in (normal, *others)]
    assert energies[0] == pytest.approx(motion.velocity @ np.linalg.solve(shifted, motion.velocity))
    assert max(energies) <= energies[0] * (1.0 + 1e-9)


def test_drives_that_hold_no_force_allow_no_speed_however_fast_the_force_grows() -> None:
    """A singular mobility has an infinite growth, which times a speed of 0 is not a number."""
    settings = MonitorSettings(contact=ContactType.QUASI_STATIC, drives=Drives.FREE)
    mobility = Mobility.of_matrix(np.diag([-1.0, 1.0, 1.0]), X, 3, PoseChange(0.5, ZEROS, (X,)))
    assert mobility.growth(0.0, 1.0) == math.inf
    assert bound_of(settings, [mobility], max_force=0.0).allowable_speed == 0.0
    (case, *_) = contact_cases(limits_for(settings), settings)
    assert case.speed_limit(1.0, math.inf, 0.0).allowable_speed == 0.0
    assert case.speed_limit(1.0, math.inf, 100.0).allowable_speed == 0.0
