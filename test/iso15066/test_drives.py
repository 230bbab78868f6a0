# SPDX-License-Identifier: Apache-2.0
"""Contact with drives that push on: limits, and a simulation of its own with another integrator."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from numba import njit

from scara_effmass.iso15066 import TRANSIENT_S, Limit, SpeedLimit, limits_for, speed_limit_of_mass
from scara_effmass.iso15066.contact import amplification
from scara_effmass.iso15066.drives import MAX_MOBILITY, servo_reduced_masses
from scara_effmass.settings import Drives, MonitorSettings, ServoSettings


def speed_limit_of(mass: float, settings: MonitorSettings) -> SpeedLimit:
    return speed_limit_of_mass(limits_for(settings), mass, settings)


def settings_of(**changes: object) -> MonitorSettings:
    return MonitorSettings.model_validate(changes)


@pytest.fixture(
    scope="module",
    params=[
        (region, bandwidth) for region in ("abdomen", "hand_fingers", "lower_leg") for bandwidth in (1.0, 5.0, 20.0)
    ],
    ids=str,
)
def servo(request: pytest.FixtureRequest) -> MonitorSettings:
    """A servo against one region: soft and heavy, stiff and light, heaviest."""
    region, bandwidth = request.param
    return settings_of(body_regions=[region], drives="servo", servo={"bandwidth": bandwidth})


def integrate(
    mass: float,
    stiffness: float,
    alpha: float,
    bandwidth: float,
    damping: float,
    stop: float,
    end: float,
    viscosity: float = 0.0,
) -> float:
    """Return the peak force [N] at 1 m/s within `end`, by Runge-Kutta's fourth order in absolute coordinates.

    `alpha` is 1/m_H, 0 for a clamped body part; the reference moves on until `stop` and then stands still. The contact
    damps by `viscosity` [N s/m].
    """
    servo = 2.0 * math.pi * bandwidth
    step = 0.03 / max(math.sqrt(stiffness * (1.0 / mass + alpha)), servo, viscosity * (1.0 / mass + alpha))
    x, vx, y, vy, peak = 0.0, 1.0, 0.0, 0.0, viscosity
    for start, length, speed in ((0.0, stop, 1.0), (stop, end - stop, 0.0)):
        count = math.ceil(length / step)
        dt = length / count if count else 0.0
        for i in range(count):
            dx = dvx = dy = dvy = sx = svx = sy = svy = 0.0
            for at, weight in ((0.0, 1.0), (0.5, 2.0), (0.5, 2.0), (1.0, 1.0)):
                px, pvx, py, pvy = x + at * dt * dx, vx + at * dt * dvx, y + at * dt * dy, vy + at * dt * dvy
                force = max(stiffness * (px - py) + viscosity * (pvx - pvy), 0.0) if px >= py else 0.0
                reference = start + (i + at) * dt if speed else stop
                dx, dy, dvy = pvx, pvy, alpha * force
                dvx = servo**2 * (reference - px) + 2.0 * damping * servo * (speed - pvx) - force / mass
                sx, svx, sy, svy = sx + weight * dx, svx + weight * dvx, sy + weight * dy, svy + weight * dvy
            x, vx, y, vy = x + dt / 6.0 * sx, vx + dt / 6.0 * svx, y + dt / 6.0 * sy, vy + dt / 6.0 * svy
            peak = max(peak, stiffness * (x - y) + viscosity * (vx - vy) if x >= y else 0.0)
    return peak


peak_force: Callable[..., float] = njit()(integrate)


@pytest.mark.parametrize(("bandwidth", "damping"), [(0.5, 0.3), (3.0, 1.5), (9.0, 0.5), (30.0, 0.3), (30.0, 1.5)])
@pytest.mark.parametrize("region", ["abdomen", "hand_fingers"])
def test_bound_of_a_servo_is_never_exceeded(region: str, bandwidth: float, damping: float) -> None:
    settings = settings_of(body_regions=[region], drives="servo", servo={"bandwidth": bandwidth, "damping": damping})
    for mass in np.geomspace(1.0 / MAX_MOBILITY, 100.0, 6).tolist():
        found = speed_limit_of(mass, settings)
        limit = found.limit
        force = peak_force(
            mass, limit.stiffness_n_m, 1.0 / limit.body_mass_kg, bandwidth, damping, TRANSIENT_S, TRANSIENT_S
        )
        assert force <= found.force(1.0)
        assert found.force(1.0) <= 1.35 * force


@given(
    mass=st.floats(0.05, 100.0),
    limit=st.sampled_from(limits_for(MonitorSettings())),
    bandwidth=st.floats(0.5, 30.0),
    damping=st.floats(0.3, 1.5),
    contact_damping=st.floats(0.0, 1.0),
    is_clamped=st.booleans(),
)
@hypothesis_settings(max_examples=150)
def test_damped_contact_exceeds_the_elastic_one_by_its_first_force_at_most(
    mass: float, limit: Limit, bandwidth: float, damping: float, contact_damping: float, *, is_clamped: bool
) -> None:
    """Whichever reduced mass the damping ratio is stated with: that of free joints, or the larger one of the servo."""
    alpha = 0.0 if is_clamped else 1.0 / limit.body_mass_kg
    contact = mass, limit.stiffness_n_m, alpha, bandwidth, damping, 0.3, 0.5
    elastic = peak_force(*contact)
    for root in (elastic, math.sqrt(limit.stiffness_n_m / (1.0 / mass + alpha))):
        peak = peak_force(*contact, 2.0 * contact_damping * root)
        assert peak <= amplification(contact_damping, 0.0, is_clamped=is_clamped) * elastic * 1.004


@given(st.floats(0.05, 100.0))
@hypothesis_settings(max_examples=20)
def test_servo_lies_between_free_and_immovable(servo: MonitorSettings, mass: float) -> None:
    found = speed_limit_of(mass, servo)
    free, immovable = (
        speed_limit_of(mass, servo.model_copy(update={"drives": drives})) for drives in (Drives.FREE, Drives.IMMOVABLE)
    )
    assert immovable.allowable_speed * (1 - 1e-9) <= found.allowable_speed <= free.allowable_speed * (1 + 1e-9)
    limit = immovable.limit
    assert immovable.force(1.0) == pytest.approx(math.sqrt(limit.body_mass_kg * limit.stiffness_n_m))


def test_limits_of_the_bandwidth() -> None:
    """A slow servo gives the two free masses, a fast one the immovable robot."""
    stiffness, obstacle, mobility = np.array([25e3]), np.array([40.0]), np.array([0.5])
    slow = servo_reduced_masses(mobility, stiffness, obstacle, ServoSettings(bandwidth=0.01))
    fast = servo_reduced_masses(mobility, stiffness, obstacle, ServoSettings(bandwidth=300.0))
    assert slow[0, 0] == pytest.approx(1.0 / (0.5 + 1.0 / 40.0), rel=0.01)
    assert fast[0, 0] == pytest.approx(40.0, rel=0.03)


def test_simulated_peak_is_never_too_low() -> None:
    """Without a drive the two free masses are exact: half a step of 0.1 rad is worth at most 0.26 % of the mass."""
    mobility = np.geomspace(0.02, 10.0, 40)
    (masses,) = servo_reduced_masses(mobility, np.array([25e3]), np.array([40.0]), ServoSettings(bandwidth=1e-6))
    excess = masses * (mobility + 1.0 / 40.0)
    assert excess.min() >= 1.0 - 1e-6
    assert excess.max() <= 1.0 / math.cos(0.05) ** 2 + 1e-6


@pytest.mark.parametrize("damping", [0.3, 0.7, 1.5])
@pytest.mark.parametrize(("bandwidth", "stopping_time"), [(0.5, 0.5), (1.5, 0.1), (5.0, 0.5), (20.0, 0.1), (20.0, 1.0)])
def test_clamping_is_bounded_by_the_stiffness_of_the_servo(
    bandwidth: float, stopping_time: float, damping: float
) -> None:
    servo = ServoSettings(bandwidth=bandwidth, damping=damping, stopping_time=stopping_time)
    for region in ("abdomen", "hand_fingers"):
        settings = settings_of(body_regions=[region], contact="quasi_static", drives="servo").model_copy(
            update={"servo": servo}
        )
        for mass in [*np.geomspace(1.0 / MAX_MOBILITY, 100.0, 6).tolist(), 300.0, 1000.0, 3000.0]:
            found = speed_limit_of(mass, settings)
            end = stopping_time + 3.0 / bandwidth
            force = peak_force(mass, found.limit.stiffness_n_m, 0.0, bandwidth, damping, stopping_time, end)
            assert force <= found.force(1.0)
            assert mass < 2.0 or found.force(1.0) <= 2.3 * force
            assert found.force(found.allowable_speed) == pytest.approx(found.limit.permissible_force_n)


def test_robot_lighter_than_the_simulated_ones_counts_as_immovable() -> None:
    servo, immovable = (speed_limit_of(0.04, settings_of(drives=drives)) for drives in ("servo", "immovable"))
    assert servo.allowable_speed == pytest.approx(immovable.allowable_speed)


def test_clamped_body_part_allows_no_speed_against_an_unbounded_push() -> None:
    assert speed_limit_of(2.0, settings_of(drives="immovable", contact="quasi_static")).allowable_speed == 0.0
