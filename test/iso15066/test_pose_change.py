"""Growth of the force by the change of pose: derivatives by finite differences, and the speed that it leaves."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from scara_effmass.iso15066 import Mobility, SpeedLimits, limits_for
from scara_effmass.iso15066.pose_change import MAX_CONTACT_S, PoseChange, contact_time
from scara_effmass.settings import Drives, MonitorSettings
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


def test_indefinite_mobility_allows_no_speed() -> None:
    change = Motion(1).change()._replace(mobility=(-np.eye(3)).tolist())
    assert change.growth(0.1, 1.0) == change.max_growth(0.1) == math.inf


def test_contact_time() -> None:
    """1.5 times a quarter period, at most the longest transient contact."""
    period = 2.0 * math.pi * math.sqrt(2.0 / 25_000.0)
    assert contact_time(2.0, 25_000.0) == pytest.approx(1.5 * period / 4.0)
    assert contact_time(math.inf, 25_000.0) == MAX_CONTACT_S


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
