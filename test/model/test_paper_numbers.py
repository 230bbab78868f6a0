# SPDX-License-Identifier: Apache-2.0
"""The shipped robot file reproduces the paper's numbers for the Omron i4-550L."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from scara_effmass.model.robot import Robot
from scara_effmass.reference import ContactState, RobotDynamics
from scara_effmass.studies.scara import (
    ScaraInertia,
    scara_full_mass,
    scara_lumped_mass,
    scara_max_lumped_mass,
)
from scara_effmass.values import FloatArray

M2, M3, M_R = 2.38, 0.97, 2.77
OBSTACLES = (0.50, 2.39, 3.72, 7.35)
Q1_RANGE, Q2_RANGE = np.radians(136.0), np.radians(148.0)
FITTED = ScaraInertia(
    l1=0.275,
    l2=0.275,
    m1=2.74,
    m2=2.00,
    m3=0.20,
    m4=0.35,
    r1=0.08029,
    r2=0.05775,
    i1=0.02952,
    i2=0.02272,
    i3=1e-4,
    i4=4e-4,
)

q1_values = st.floats(-Q1_RANGE, Q1_RANGE)
q2_values = st.floats(-Q2_RANGE, Q2_RANGE)
directions = st.floats(-np.pi, np.pi)


def reduced(mass: FloatArray, obstacle: float) -> FloatArray:
    return np.asarray(1.0 / (1.0 / mass + 1.0 / obstacle))


def joint_angles(x: float, y: float, elbow: float) -> tuple[float, float]:
    """Joint angles of a 0.275 m + 0.275 m arm at (x, y); `elbow` is the sign of q2: +1 is the right arm."""
    q2 = elbow * np.arccos((x * x + y * y) / (2.0 * 0.275**2) - 1.0)
    return float(np.arctan2(y, x) - q2 / 2.0), float(q2)


def test_planar_masses_are_m2_and_m3(omron: Robot, omron_dynamics: RobotDynamics) -> None:
    assert omron_dynamics.lumped is not None
    m2, m3 = omron_dynamics.lumped.planar_masses(omron)
    assert m2 == pytest.approx(M2, abs=0.005)
    assert m3 == pytest.approx(M3, abs=0.005)
    assert len(omron_dynamics.lumped.aggregated) == 5
    assert omron_dynamics.lumped.aggregated[0] == pytest.approx(1.94, abs=0.005)
    assert sum(omron_dynamics.lumped.aggregated) == pytest.approx(omron.moving_mass + omron.payload_mass, rel=1e-12)


def test_iso_mass(omron: Robot) -> None:
    assert omron.moving_mass == pytest.approx(5.04)
    assert omron.iso_mass == pytest.approx(M_R, abs=0.005)


@given(q1=q1_values, q2=q2_values, phi=directions)
def test_masses_agree_with_eqs_27_and_28(
    omron: Robot, omron_dynamics: RobotDynamics, along: Callable[..., ContactState], q1: float, q2: float, phi: float
) -> None:
    assume(abs(np.sin(q2)) > 1e-3)
    assert omron_dynamics.lumped is not None
    masses = along(omron_dynamics, [q1, q2, 0.1, 0.3], [np.cos(phi), np.sin(phi), 0.0])
    m2, m3 = omron_dynamics.lumped.planar_masses(omron)
    assert masses.lumped == pytest.approx(float(scara_lumped_mass(q1, q2, phi, m2, m3)), rel=1e-6)
    assert masses.full == pytest.approx(float(scara_full_mass(q1, q2, phi, FITTED)), rel=1e-6)


def test_masses_agree_with_eqs_27_and_28_in_thousands_of_cases(
    omron: Robot, omron_dynamics: RobotDynamics, along: Callable[..., ContactState]
) -> None:
    assert omron_dynamics.lumped is not None
    rng = np.random.default_rng(15066)
    q1, q2, phi = rng.uniform(-1.0, 1.0, (3, 4000)) * np.array([[Q1_RANGE], [Q2_RANGE], [np.pi]])
    q2 = np.where(np.abs(np.sin(q2)) > 1e-2, q2, 1.0)
    states = [
        along(omron_dynamics, [a, b, 0.2, c], [np.cos(c), np.sin(c), 0.0]) for a, b, c in zip(q1, q2, phi, strict=True)
    ]
    lumped = scara_lumped_mass(q1, q2, phi, *omron_dynamics.lumped.planar_masses(omron))
    np.testing.assert_allclose([s.lumped for s in states], lumped, rtol=1e-9)
    np.testing.assert_allclose([s.full for s in states], scara_full_mass(q1, q2, phi, FITTED), rtol=1e-9)


@given(q1=q1_values, phi=directions)
def test_smallest_mass_is_m3(q1: float, phi: float) -> None:
    assume(abs(np.cos(q1 - phi)) > 1e-6)
    assert scara_lumped_mass(q1, -q1 + phi + np.pi / 2.0, phi, M2, M3) == pytest.approx(M3, rel=1e-12)


@given(q1=q1_values, q2=q2_values, phi=directions)
def test_no_mass_is_below_m3(q1: float, q2: float, phi: float) -> None:
    assert scara_lumped_mass(q1, q2, phi, M2, M3) >= M3 * (1.0 - 1e-12)


@given(q2=q2_values, phi=directions)
def test_largest_mass_is_eq_30(q2: float, phi: float) -> None:
    assume(abs(np.sin(q2)) > 1e-3)
    largest = scara_max_lumped_mass(q2, M2, M3)
    assert largest >= M2 + M3 - 1e-12
    assert scara_lumped_mass(phi - q2, q2, phi, M2, M3) == pytest.approx(float(largest), rel=1e-6)


def test_stretched_arm_has_infinite_mass_along_itself() -> None:
    assert scara_max_lumped_mass(0.0, M2, M3) == np.inf
    assert scara_lumped_mass(0.0, 0.0, 0.0, M2, M3) == np.inf
    assert scara_full_mass(0.0, 0.0, 0.0, FITTED) == np.inf


@given(q1=q1_values, q2=q2_values, phi=directions, turn=directions)
def test_masses_are_invariant_under_rotation_and_reflection(q1: float, q2: float, phi: float, turn: float) -> None:
    assume(abs(np.sin(q2)) > 1e-2)
    for law, parameters in ((scara_lumped_mass, (M2, M3)), (scara_full_mass, (FITTED,))):
        mass = float(law(q1, q2, phi, *parameters))
        assert law(q1 + turn, q2, phi + turn, *parameters) == pytest.approx(mass, rel=1e-6)
        assert law(-q1, -q2, -phi, *parameters) == pytest.approx(mass, rel=1e-9)
        assert law(q1, q2, phi + np.pi, *parameters) == pytest.approx(mass, rel=1e-6)


def test_impact_point_of_figure_17(omron_dynamics: RobotDynamics, along: Callable[..., ContactState]) -> None:
    q1, q2 = joint_angles(0.3, 0.2, elbow=1.0)
    assert np.degrees([q1, q2]) == pytest.approx([-15.35, 98.08], abs=0.005)
    right = along(omron_dynamics, [q1, q2, 0.0, 0.0], [1.0, 0.0, 0.0])
    left = along(omron_dynamics, [*joint_angles(0.3, 0.2, elbow=-1.0), 0.0, 0.0], [1.0, 0.0, 0.0])
    assert right.lumped == pytest.approx(0.981, abs=5e-4)
    assert left.lumped == pytest.approx(2.891, abs=5e-4)
    mu = [reduced(np.array(right.lumped), obstacle) for obstacle in OBSTACLES]
    assert np.sqrt(mu) == pytest.approx([0.576, 0.834, 0.881, 0.930], abs=5.1e-4)


@pytest.mark.parametrize(("y", "mass"), [(0.2, 0.981), (0.0, 1.247), (-0.2, 2.891)])
def test_three_points_that_span_the_range(y: float, mass: float) -> None:
    assert scara_lumped_mass(*joint_angles(0.3, y, elbow=1.0), 0.0, M2, M3) == pytest.approx(mass, abs=5e-4)
