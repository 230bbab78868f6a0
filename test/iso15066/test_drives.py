# SPDX-License-Identifier: Apache-2.0
"""Contact with drives that push on: limits, and a simulation of its own with another integrator."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from scara_effmass.iso15066 import TRANSIENT_S, Mobility, SpeedLimits, limits_for
from scara_effmass.iso15066.drives import MAX_MOBILITY, servo_reduced_masses
from scara_effmass.settings import MonitorSettings


def speed_limits(**changes: object) -> SpeedLimits:
    checked = MonitorSettings.model_validate(changes)
    return SpeedLimits(limits_for(checked), checked)


@pytest.fixture(
    scope="module",
    params=[
        (region, bandwidth) for region in ("abdomen", "hand_fingers", "lower_leg") for bandwidth in (1.0, 5.0, 20.0)
    ],
    ids=str,
)
def servo(request: pytest.FixtureRequest) -> tuple[SpeedLimits, str, float]:
    """Limits of one region against a servo, the region and the bandwidth: soft and heavy, stiff and light, heaviest."""
    region, bandwidth = request.param
    return speed_limits(body_regions=[region], drives="servo", servo={"bandwidth": bandwidth}), region, bandwidth


def peak_force(mass: float, stiffness: float, obstacle: float, bandwidth: float, damping: float) -> float:
    """Return the peak force [N] at 1 m/s, integrated by solve_ivp in absolute coordinates within `TRANSIENT_S`."""
    servo = 2.0 * math.pi * bandwidth

    def rates(t: float, state: np.ndarray) -> list[float]:
        x, vx, y, vy = state
        force = stiffness * max(x - y, 0.0)
        drive = mass * (servo**2 * (t - x) + 2.0 * damping * servo * (1.0 - vx))
        return [vx, (drive - force) / mass, vy, force / obstacle]

    period = 2.0 * math.pi / math.sqrt(stiffness * (1.0 / mass + 1.0 / obstacle))
    solution = solve_ivp(rates, (0.0, TRANSIENT_S), [0.0, 1.0, 0.0, 0.0], max_step=period / 40, rtol=1e-8, atol=1e-10)
    return float(stiffness * np.max(solution.y[0] - solution.y[2]))


@pytest.mark.parametrize(("bandwidth", "damping"), [(0.5, 0.3), (3.0, 1.5), (9.0, 0.5), (30.0, 0.3), (30.0, 1.5)])
@pytest.mark.parametrize("region", ["abdomen", "hand_fingers"])
def test_bound_of_a_servo_is_never_exceeded(region: str, bandwidth: float, damping: float) -> None:
    limits = speed_limits(body_regions=[region], drives="servo", servo={"bandwidth": bandwidth, "damping": damping})
    for mass in np.geomspace(1.0 / MAX_MOBILITY, 100.0, 6).tolist():
        speed_limit = limits.speed_limit(mass)
        limit = speed_limit.limit
        force = peak_force(mass, limit.stiffness_n_m, limit.obstacle_mass_kg, bandwidth, damping)
        assert force <= speed_limit.force(1.0)
        assert speed_limit.force(1.0) <= 1.35 * force


@given(st.floats(0.05, 100.0))
@settings(max_examples=20)
def test_servo_lies_between_free_and_immovable(servo: tuple[SpeedLimits, str, float], mass: float) -> None:
    limits, region, _ = servo
    found = limits.speed_limit(mass)
    free, immovable = (
        speed_limits(body_regions=[region], drives=drives).speed_limit(mass) for drives in ("free", "immovable")
    )
    assert immovable.allowable_speed * (1 - 1e-9) <= found.allowable_speed <= free.allowable_speed * (1 + 1e-9)
    limit = immovable.limit
    assert immovable.force(1.0) == pytest.approx(math.sqrt(limit.obstacle_mass_kg * limit.stiffness_n_m))


def test_no_normal_exceeds_the_bound_of_a_servo(servo: tuple[SpeedLimits, str, float]) -> None:
    limits, _, bandwidth = servo
    rng = np.random.default_rng(0)
    bounds, shares, along = [], [], []
    for _ in range(20):
        basis = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        matrix = basis @ np.diag(10.0 ** rng.uniform(-2.0, 0.7, 3)) @ basis.T
        x, y, z = basis @ rng.dirichlet([0.3, 0.3, 0.3]) ** 0.5
        bounds.append(limits.worst_normal([Mobility.of_matrix(matrix.tolist(), (x, y, z), 3)]).force(1.0))
        normals = np.linalg.solve(matrix + np.geomspace(1e-3, 10.0, 50)[:, None, None] * np.eye(3), np.array([x, y, z]))
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        shares.append(normals @ [x, y, z])
        along.append(np.einsum("ni,ij,nj->n", normals, matrix, normals))
    (limit,) = limits.limits
    stiffness, obstacle = np.array([limit.stiffness_n_m]), np.array([limit.obstacle_mass_kg])
    (masses,) = servo_reduced_masses(np.concatenate(along), stiffness, obstacle, bandwidth, 0.7)
    forces = np.array(shares) * np.sqrt(masses.reshape(20, 50) * stiffness)
    assert (forces.max(axis=1) <= bounds).all()


def test_limits_of_the_bandwidth() -> None:
    """A slow servo gives the two free masses, a fast one the immovable robot."""
    stiffness, obstacle, mobility = np.array([25e3]), np.array([40.0]), np.array([0.5])
    slow = servo_reduced_masses(mobility, stiffness, obstacle, 0.01, 0.7)
    fast = servo_reduced_masses(mobility, stiffness, obstacle, 300.0, 0.7)
    assert slow[0, 0] == pytest.approx(1.0 / (0.5 + 1.0 / 40.0), rel=0.01)
    assert fast[0, 0] == pytest.approx(40.0, rel=0.03)


def test_simulated_peak_is_never_too_low() -> None:
    """Without a drive the two free masses are exact: half a step of 0.1 rad is worth at most 0.26 % of the mass."""
    mobility = np.geomspace(0.02, 10.0, 40)
    (masses,) = servo_reduced_masses(mobility, np.array([25e3]), np.array([40.0]), 1e-6, 0.7)
    excess = masses * (mobility + 1.0 / 40.0)
    assert excess.min() >= 1.0 - 1e-6
    assert excess.max() <= 1.0 / math.cos(0.05) ** 2 + 1e-6


def test_robot_lighter_than_the_simulated_ones_counts_as_immovable() -> None:
    servo, immovable = (speed_limits(drives=drives).speed_limit(0.04) for drives in ("servo", "immovable"))
    assert servo.allowable_speed == pytest.approx(immovable.allowable_speed)


@given(st.floats(0.2, 20.0), st.floats(0.1, 200.0))
@settings(max_examples=40)
def test_effort_limits_bound_the_push_of_a_servo(
    servo: tuple[SpeedLimits, str, float], mass: float, push: float
) -> None:
    """A constant push P at the robot's mass: peak P' + sqrt(P'^2 + k mu v^2), P' = P m_H / (m + m_H)."""
    limits, _, _ = servo
    mobility = Mobility.of_mass(mass)
    bounded = limits.worst_normal([mobility], push=(push / mass, mobility.trace))
    limit = bounded.limit
    assert bounded.allowable_speed >= limits.speed_limit(mass).allowable_speed * (1 - 1e-12)
    assert bounded.force(bounded.allowable_speed) == pytest.approx(limit.permissible_force_n, rel=1e-9)
    if bounded.push > 0.0:
        assert bounded.push == pytest.approx(push * limit.obstacle_mass_kg / (mass + limit.obstacle_mass_kg))


@pytest.mark.parametrize("masses", [(1.0, 4.0), (4.0, 1.0)])
def test_push_counts_the_uncertainty_and_the_heaviest_mass(masses: tuple[float, float]) -> None:
    limits = speed_limits(body_regions=["chest"], drives="servo", servo={"bandwidth": 1000.0})
    found = limits.worst_normal([Mobility.of_mass(mass) for mass in masses], 1.5, (2.0, 0.25))
    inverse = 1.0 / found.limit.obstacle_mass_kg
    assert found.push == pytest.approx(2.0 / (0.25 / 1.5 + inverse))
    assert found.reduced_mass == pytest.approx(1.0 / (0.25 / 1.5 + inverse))


def test_clamped_body_part_allows_no_speed_against_an_unbounded_push() -> None:
    for drives in ("servo", "immovable"):
        assert speed_limits(drives=drives, contact="quasi_static").speed_limit(2.0).allowable_speed == 0.0


@given(st.floats(0.2, 20.0), st.floats(0.0, 1.5))
@settings(max_examples=40)
def test_servo_bound_counts_up_to_the_force_that_its_drives_hold(
    servo: tuple[SpeedLimits, str, float], mass: float, share: float
) -> None:
    """The force is proportional to the speed, so that the allowable speed is, too; the push bound stays."""
    limits, _, _ = servo
    mobility, whole = Mobility.of_mass(mass), limits.speed_limit(mass)
    force = share * whole.limit.permissible_force_n
    limited = limits.worst_normal([mobility], max_force=force)
    assert limited.allowable_speed == pytest.approx(min(share, 1.0) * whole.allowable_speed)
    assert limited.force(limited.allowable_speed) <= force * (1.0 + 1e-9) or share > 1.0
    push = 5.0 / mass, mobility.trace
    both = limits.worst_normal([mobility], push=push, max_force=force).allowable_speed
    pushed = limits.worst_normal([mobility], push=push, max_force=0.0).allowable_speed
    assert both == pytest.approx(max(limited.allowable_speed, pushed))
