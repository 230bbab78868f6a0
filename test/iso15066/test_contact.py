# SPDX-License-Identifier: Apache-2.0
"""Contact formulas: limits of the reduced mass, energy balance, arrays and scalars."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from scara_effmass.iso15066 import (
    TRANSIENT_S,
    contact_time,
    force_per_root_stiffness,
    peak_force,
    reduced_mass,
    robot_mass,
    transferred_energy,
)
from scara_effmass.iso15066.contact import amplification
from scara_effmass.values import FloatArray

masses = st.floats(1e-3, 1e3)
speeds = st.floats(1e-3, 10.0)
stiffnesses = st.floats(1e3, 1e6)


@pytest.mark.parametrize(("cart", "expected"), [(0.50, 0.42), (2.39, 1.28), (3.72, 1.59), (7.35, 2.01)])
def test_reduced_mass_of_the_four_test_carts(cart: float, expected: float) -> None:
    assert reduced_mass(2.77, cart) == pytest.approx(expected, abs=0.005)


def test_robot_mass_is_half_the_moving_mass_and_the_payload() -> None:
    assert robot_mass(5.04, 0.25) == pytest.approx(2.77)


def test_force_per_root_stiffness_is_speed_times_root_of_mass() -> None:
    assert force_per_root_stiffness(0.5, 4.0) == 1.0


@given(masses, masses)
def test_reduced_mass_is_symmetric_and_below_both(robot: float, obstacle: float) -> None:
    mu = reduced_mass(robot, obstacle)
    assert mu == pytest.approx(reduced_mass(obstacle, robot))
    assert 0.5 * min(robot, obstacle) <= mu * (1 + 1e-12)
    assert mu <= min(robot, obstacle) * (1 + 1e-12)


@given(masses)
def test_reduced_mass_with_an_infinite_mass_is_the_other_mass(mass: float) -> None:
    assert reduced_mass(mass, math.inf) == mass
    assert reduced_mass(math.inf, mass) == pytest.approx(mass)
    assert reduced_mass(math.inf, math.inf) == math.inf


@given(speeds, masses, stiffnesses)
def test_spring_energy_at_peak_force_is_the_transferred_energy(speed: float, mu: float, stiffness: float) -> None:
    force = peak_force(speed, mu, stiffness)
    assert force**2 / (2.0 * stiffness) == pytest.approx(transferred_energy(speed, mu))


def test_peak_force_agrees_with_an_integrated_impact() -> None:
    """Two free masses meet at 0.25 m/s; the largest spring force in 2e5 steps of symplectic Euler."""
    robot, hand, stiffness, speed = 0.97, 0.6, 75e3, 0.25
    mu = 1.0 / (1.0 / robot + 1.0 / hand)
    step = math.pi * math.sqrt(mu / stiffness) / 200_000
    compression, closing, largest = 0.0, speed, 0.0
    while closing > 0.0:
        closing -= stiffness * compression * (1.0 / robot + 1.0 / hand) * step
        compression += closing * step
        largest = max(largest, stiffness * compression)
    assert peak_force(speed, reduced_mass(robot, hand), stiffness) == pytest.approx(largest, rel=1e-4)


def test_arrays_agree_with_scalars() -> None:
    robot = np.array([0.1, 0.97, 2.77, np.inf])
    mu = reduced_mass(robot, 0.6)
    force, energy = peak_force(0.25, mu, 75e3), transferred_energy(0.25, mu)
    for i, mass in enumerate(robot.tolist()):
        scalar = reduced_mass(mass, 0.6)
        assert mu[i] == scalar
        assert force[i] == pytest.approx(peak_force(0.25, scalar, 75e3), rel=1e-15)
        assert energy[i] == transferred_energy(0.25, scalar)


def test_contact_time() -> None:
    """1.5 times a quarter period, at most the longest transient contact."""
    period = 2.0 * math.pi * math.sqrt(2.0 / 25_000.0)
    assert contact_time(2.0, 25_000.0) == pytest.approx(1.5 * period / 4.0)
    assert contact_time(2.0, 20.0) == contact_time(math.inf, 25_000.0) == TRANSIENT_S == 0.5


def peak_of(force: Callable[[float, float], float]) -> tuple[float, float]:
    """Return the peak force of a unit mass at unit speed, and the speed after the contact."""

    def parted(_: float, state: FloatArray) -> float:
        return float(state[0]) + 1e-9

    parted.terminal, parted.direction = True, -1.0  # type: ignore[attr-defined]
    motion = solve_ivp(
        lambda _, state: [state[1], -force(*state)], (0.0, 50.0), [0.0, 1.0], events=parted, rtol=1e-9, max_step=0.01
    )
    return max(force(x, u) for x, u in motion.y.T), -float(motion.y[1, -1])


HUNT_AND_CROSSLEY = [(0.5, 0.52), (0.4, 0.56), (0.3, 0.62), (0.2, 0.72)]
"""Coefficients of restitution, and the damping ratio that docs/contact.md states for each."""


def hunt_and_crossley(gain: float) -> Callable[[float, float], float]:
    return lambda x, u: max(0.0, x * (1.0 + gain * u))


@given(st.floats(0.0, 2.0))
@settings(max_examples=20)
def test_amplification_bounds_a_damped_spring(damping: float) -> None:
    peak, _ = peak_of(lambda x, u: max(0.0, x + 2.0 * damping * u))
    assert peak <= amplification(damping, 0.0) * (1.0 + 1e-9)
    assert damping < 0.5 or peak == pytest.approx(amplification(damping, 0.0))


@pytest.mark.parametrize(("restitution", "damping"), HUNT_AND_CROSSLEY)
def test_damping_ratio_that_covers_hunt_and_crossley(restitution: float, damping: float) -> None:
    gain = brentq(lambda gain: peak_of(hunt_and_crossley(gain))[1] - restitution, 0.01, 9.0, xtol=1e-3)
    peak, _ = peak_of(hunt_and_crossley(gain))
    assert amplification(damping, 0.0) == pytest.approx(peak, abs=0.03)
    assert amplification(damping, 0.0) >= peak


def test_friction_adds_a_force_across_the_normal() -> None:
    assert amplification(0.0, 0.75) == pytest.approx(1.25)
    assert amplification(0.0, 0.0) == 1.0
