# SPDX-License-Identifier: Apache-2.0
"""Growth of the force by the change of pose: derivatives by finite differences, and the speed that remains allowed."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scara_effmass.iso15066.pose_change import PoseChange, contact_time

from scara_effmass.iso15066 import TRANSIENT_S, Mobility, SpeedLimits, limits_for
from scara_effmass.iso15066.drives import contact_lines
from scara_effmass.settings import ContactType, Drives, MonitorSettings
from scara_effmass.values import FloatArray, Vector3

SEEDS = st.integers(0, 2**32 - 1)
ALPHAS = st.sampled_from([1.0 / 75.0, 1.0 / 40.0, 1.0 / 3.0, 1.0 / 0.6])
STEP = 1e-6


def vector(values: FloatArray) -> Vector3:
    x, y, z = values.tolist()
    return x, y, z


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
        self.direction = vector(self.velocity / self.speed)
        self.normal = vector(basis[0])

    def change(self) -> PoseChange:
        accelerations = tuple(vector(a) for a in self.accelerations)
        return PoseChange(self.direction, self.speed, self.mobility.tolist(), self.rate.tolist(), accelerations)

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
    accelerations = tuple(vector(a) for a in rng.normal(size=(2, 3)))
    change = PoseChange(vector(velocity / speed), speed, mobility.tolist(), np.eye(3).tolist(), accelerations, rank)
    w = np.linalg.pinv(mobility) @ velocity / speed
    np.testing.assert_allclose(change.worst_normal(0.0), w / np.linalg.norm(w), atol=1e-7)
    along = w @ velocity / speed
    expected = 2.0 * max(0.0, *(np.array(accelerations) @ w)) / speed / along
    np.testing.assert_allclose(change.growth(0.0, 1.0), expected, rtol=1e-6)
    assert change.max_growth(0.0) >= expected
    # A mobility that falls adds its share, which depends on the length of w.
    falling = change._replace(mobility_rate=(-np.eye(3)).tolist())
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
    assert motion.change().growth(alpha, beta) == pytest.approx(expected, rel=1e-5, abs=1e-5)


@given(SEEDS, ALPHAS)
def test_growth_along_a_fixed_normal(seed: int, alpha: float) -> None:
    motion, n = Motion(seed), np.zeros(3)
    n[:] = motion.normal
    assume(abs(n @ motion.velocity) > 0.05 * motion.speed)

    def log_square(t: float, rate: float, faster: float) -> float:
        mobility, velocity = motion.at(t, rate, faster)
        return math.log((n @ velocity) ** 2 / (alpha + n @ mobility @ n))

    parts = [(log_square(STEP, *part) - log_square(-STEP, *part)) / (2.0 * STEP) for part in ((1.0, 0.0), (0.0, 1.0))]
    change = motion.change().along(motion.normal, 0.0)
    assert change.speed == pytest.approx(abs(n @ motion.velocity))
    assert change.growth(alpha, 1.0) == pytest.approx(sum(max(part, 0.0) for part in parts), rel=1e-5, abs=1e-5)


def test_speed_along_a_fixed_normal_has_a_minimum() -> None:
    change = PoseChange((1.0, 0.0, 0.0), 0.5, np.eye(3).tolist(), np.zeros((3, 3)).tolist(), ((0.0, 1.0, 0.0),))
    assert change.along((0.0, 1.0, 0.0), 0.1).growth(1.0, 1.0) == pytest.approx(2.0 * 1.0 / 0.1)


@given(SEEDS, ALPHAS)
def test_only_the_larger_acceleration_counts(seed: int, alpha: float) -> None:
    change = Motion(seed, accelerations=2).change()
    alone = [change._replace(accelerations=(a,)).growth(alpha, 1.0) for a in change.accelerations]
    assert change.growth(alpha, 1.0) == max(alone)


def test_immovable_robot_grows_with_its_acceleration_alone() -> None:
    change = Motion(1).change()._replace(direction=(1.0, 0.0, 0.0), speed=0.5, accelerations=((0.2, 3.0, 0.0),))
    assert change.growth(1.0 / 40.0, 0.0) == pytest.approx(2.0 * 0.2 / 0.5)


@given(SEEDS, ALPHAS, st.floats(1.0, 1e4))
def test_bound_of_the_growth(seed: int, alpha: float, larger: float) -> None:
    change = Motion(seed, accelerations=2).change()
    assert change.growth(alpha * larger, 1.0) <= change.max_growth(alpha) * (1.0 + 1e-9)


@given(SEEDS, ALPHAS)
def test_bound_of_the_growth_is_reached(seed: int, alpha: float) -> None:
    """By an acceleration along w and a mobility that falls along w."""
    motion = Motion(seed)
    w = np.linalg.solve(motion.mobility + alpha * np.eye(3), motion.velocity)
    w /= np.linalg.norm(w)
    rate = (-3.0 * np.outer(w, w)).tolist()
    change = motion.change()._replace(mobility_rate=rate, accelerations=(vector(0.5 * w), vector(2.0 * w)))
    assert change.max_growth(alpha) == pytest.approx(change.growth(alpha, 1.0))


EVERYWHERE = (1.0 / math.sqrt(3.0),) * 3
"""A direction without a zero and a negative component."""


@pytest.mark.parametrize("mobility", [-1.0, 0.0, 1e150])
def test_mobility_that_no_robot_has_gives_no_finite_growth(mobility: float) -> None:
    """Also one whose determinant is too large for a float; the worst normal is then that of the velocity."""
    change = Motion(1).change()._replace(mobility=(mobility * np.eye(3)).tolist(), direction=EVERYWHERE)
    assert change.growth(0.0, 1.0) == change.max_growth(0.0) == math.inf
    assert change.worst_normal(0.0) == EVERYWHERE


def test_clamped_body_part_ignores_unreachable_directions() -> None:
    mobility = np.diag([0.5, 0.5, 0.0]).tolist()
    change = PoseChange((0.6, 0.8, 0.0), 0.5, mobility, np.zeros((3, 3)).tolist(), ((0.6, 0.8, 0.0),))
    assert change.growth(0.0, 1.0) == pytest.approx(2.0 * 1.0 / 0.5)


def test_contact_time() -> None:
    """1.5 times a quarter period, at most the longest transient contact."""
    period = 2.0 * math.pi * math.sqrt(2.0 / 25_000.0)
    assert contact_time(2.0, 25_000.0) == pytest.approx(1.5 * period / 4.0)
    assert contact_time(2.0, 20.0) == contact_time(math.inf, 25_000.0) == TRANSIENT_S == 0.5


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
    """One region at a time: what is left out early never sets the speed. At that speed the force is the limit."""
    # Few regions on servos: each one is simulated.
    settings = MonitorSettings(drives=Drives(drives), body_regions=("chest", "abdomen") if drives == "servo" else ())
    mobilities = [
        Mobility.of_matrix(motion.mobility.tolist(), motion.direction, 3, motion.change())
        for motion in (Motion(seed, 2), Motion(other, 2))
    ]
    limits = limits_for(settings)
    found = SpeedLimits(limits, settings).worst_normal(mobilities, factor, push)
    alone = [SpeedLimits([limit], settings).worst_normal(mobilities, factor, push) for limit in limits]
    assert found == min(alone, key=lambda bound: bound.allowable_speed)
    assert found.force(found.allowable_speed) == pytest.approx(found.limit.permissible_force_n)
    if push is None:
        each = [SpeedLimits(limits, settings).worst_normal([mobility], factor) for mobility in mobilities]
        assert found == min(each, key=lambda bound: bound.allowable_speed)


@pytest.mark.parametrize("drives", Drives)
@pytest.mark.parametrize("factor", [1.0, 1.5])
def test_speed_of_a_straight_contact(drives: Drives, factor: float) -> None:
    """One mass in one direction: v (1 + growth v) sqrt(mu k) = F, growth = T (a / v0 - beta mu dA/dt / 2) / v0."""
    settings = MonitorSettings(drives=drives, body_regions=("chest",), stiffness_uncertainty=0.0)
    (limit,) = limits_for(settings)
    inverse_mass, rate, v0, a, k, m_h = 0.5, -3.0, 0.4, 0.7, limit.stiffness_n_m, limit.obstacle_mass_kg
    change = PoseChange(
        (1.0, 0.0, 0.0), v0, (inverse_mass * np.eye(3)).tolist(), (0.5 * rate * np.eye(3)).tolist(), ((a, 0.0, 0.0),)
    )
    mobility = Mobility(inverse_mass, 0.0, inverse_mass, 0.0, 0.0, 1, change)
    found = SpeedLimits([limit], settings).worst_normal([mobility], factor)
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
        replace(example, force_n=force, pressure_n_cm2=1e6, stiffness_n_m=k, obstacle_mass_kg=m)
        for force, k, m in ((100.0, 1e5, 1.0), (105.0, 1e4, 10.0))
    )
    settings = MonitorSettings(drives=Drives.IMMOVABLE, stiffness_uncertainty=0.0)
    zeros = np.zeros((3, 3)).tolist()
    still = Mobility(10.0, 0.0, 10.0, 0.0, 0.0, 1)
    change = PoseChange((1.0, 0.0, 0.0), 0.5, (10.0 * np.eye(3)).tolist(), zeros, ((1.0, 0.0, 0.0),))
    limits = SpeedLimits([mild, tight], settings)
    assert limits.worst_normal([still]).limit == tight
    assert limits.worst_normal([still._replace(change=change)]).limit == mild


def test_robot_that_cannot_give_way_to_a_clamped_body_part_has_no_allowable_speed() -> None:
    """An infinite reduced mass stays one with a change of pose."""
    settings = MonitorSettings(contact=ContactType.QUASI_STATIC, drives=Drives.FREE)
    zeros = np.zeros((3, 3)).tolist()
    change = PoseChange((1.0, 0.0, 0.0), 0.5, zeros, zeros, ((1.0, 0.0, 0.0),))
    found = SpeedLimits(limits_for(settings), settings).worst_normal([Mobility(0.0, 0.0, 0.0, 0.0, 0.0, 1, change)])
    assert (found.allowable_speed, found.growth) == (0.0, 0.0)


def test_push_of_drives_changes_the_pose_for_the_time_of_the_body_part() -> None:
    settings = MonitorSettings(drives=Drives.SERVO, body_regions=("chest",), stiffness_uncertainty=0.0)
    (limit,) = limits_for(settings)
    zeros, v0, a = np.zeros((3, 3)).tolist(), 0.4, 0.7
    change = PoseChange((1.0, 0.0, 0.0), v0, (0.5 * np.eye(3)).tolist(), zeros, ((a, 0.0, 0.0),))
    mobility = Mobility(0.5, 0.0, 0.5, 0.0, 0.0, 1, change)
    found = SpeedLimits([limit], settings).worst_normal([mobility], push=(0.5, 0.5))
    assert found.push > 0.0
    assert found.growth == pytest.approx(contact_time(limit.obstacle_mass_kg, limit.stiffness_n_m) * a / v0**2)


@given(SEEDS, ALPHAS)
def test_worst_normal_takes_the_most_energy(seed: int, alpha: float) -> None:
    motion = Motion(seed)
    normal = np.array(motion.change().worst_normal(alpha))
    assert np.linalg.norm(normal) == pytest.approx(1.0)
    shifted = alpha * np.eye(3) + motion.mobility
    others = np.random.default_rng(seed).normal(size=(200, 3))
    energies = [(n @ motion.velocity) ** 2 / (n @ shifted @ n) for n in (normal, *others)]
    assert energies[0] == pytest.approx(motion.velocity @ np.linalg.solve(shifted, motion.velocity))
    assert max(energies) <= energies[0] * (1.0 + 1e-9)


def test_drives_that_hold_no_force_allow_no_speed_however_fast_the_force_grows() -> None:
    """A singular mobility has an infinite growth, which times a speed of 0 is not a number."""
    settings = MonitorSettings(contact=ContactType.QUASI_STATIC, drives=Drives.FREE)
    singular = np.diag([-1.0, 1.0, 1.0]).tolist()
    change = PoseChange((0.0, 1.0, 0.0), 0.5, singular, np.zeros((3, 3)).tolist(), ((0.0, 1.0, 0.0),))
    mobility = Mobility.of_mass(1.0)._replace(change=change)
    assert change.growth(0.0, 1.0) == math.inf
    assert SpeedLimits(limits_for(settings), settings).worst_normal([mobility], max_force=0.0).allowable_speed == 0.0
