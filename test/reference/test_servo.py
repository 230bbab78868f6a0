# SPDX-License-Identifier: Apache-2.0
"""Contact of a robot with drives that push on: any normal, effort limits, and forces that joints hold."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scara_effmass.iso15066 import contact_cases, limits_for
from scara_effmass.iso15066.drives import servo_reduced_masses
from scara_effmass.reference.mobility import Mobility
from scara_effmass.reference.speed_limit import DrivePush, speed_limit
from scara_effmass.settings import MonitorSettings
from test.iso15066.test_drives import servo, settings_of, speed_limit_of

__all__ = ["servo"]

X = np.array([1.0, 0.0, 0.0])


def test_no_normal_exceeds_the_bound_of_a_servo(servo: MonitorSettings) -> None:
    cases = contact_cases(limits_for(servo), servo)
    rng = np.random.default_rng(0)
    bounds, shares, along = [], [], []
    for _ in range(20):
        basis = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        matrix = basis @ np.diag(10.0 ** rng.uniform(-2.0, 0.7, 3)) @ basis.T
        n = basis @ rng.dirichlet([0.3, 0.3, 0.3]) ** 0.5
        bounds.append(speed_limit(cases, [Mobility.of_matrix(matrix, n, 3)]).force(1.0))
        normals = np.linalg.solve(matrix + np.geomspace(1e-3, 10.0, 50)[:, None, None] * np.eye(3), n)
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        shares.append(normals @ n)
        along.append(np.einsum("ni,ij,nj->n", normals, matrix, normals))
    limit = cases[0].limit
    stiffness, obstacle = np.array([limit.stiffness_n_m]), np.array([limit.body_mass_kg])
    (masses,) = servo_reduced_masses(np.concatenate(along), stiffness, obstacle, servo.servo)
    forces = np.array(shares) * np.sqrt(masses.reshape(20, 50) * stiffness)
    assert (forces.max(axis=1) <= bounds).all()


@given(st.floats(0.2, 20.0), st.floats(0.1, 200.0))
@settings(max_examples=40)
def test_effort_limits_bound_the_push_of_a_servo(servo: MonitorSettings, mass: float, push: float) -> None:
    """A constant push P at the robot's mass: peak P' + sqrt(P'^2 + k mu v^2), P' = P m_H / (m + m_H)."""
    cases = contact_cases(limits_for(servo), servo)
    bounded = speed_limit(cases, [Mobility.of_mass(mass, X)], DrivePush(push / mass, 1.0 / mass))
    limit = bounded.limit
    assert bounded.allowable_speed >= speed_limit_of(mass, servo).allowable_speed * (1 - 1e-12)
    assert bounded.force(bounded.allowable_speed) == pytest.approx(limit.permissible_force_n, rel=1e-9)
    if bounded.push > 0.0:
        assert bounded.push == pytest.approx(push * limit.body_mass_kg / (mass + limit.body_mass_kg))


@pytest.mark.parametrize("masses", [(1.0, 4.0), (4.0, 1.0)])
def test_push_counts_the_uncertainty_and_the_heaviest_mass(masses: tuple[float, float]) -> None:
    chosen = settings_of(body_regions=["chest"], drives="servo", servo={"bandwidth": 1000.0})
    mobilities = [Mobility.of_mass(mass, X).with_masses(1.5) for mass in masses]
    found = speed_limit(contact_cases(limits_for(chosen), chosen), mobilities, DrivePush(2.0, 0.25 / 1.5))
    inverse = 1.0 / found.limit.body_mass_kg
    assert found.push == pytest.approx(2.0 / (0.25 / 1.5 + inverse))
    assert found.reduced_mass == pytest.approx(1.0 / (0.25 / 1.5 + inverse))


@given(st.floats(0.2, 20.0), st.floats(0.0, 1.5))
@settings(max_examples=40)
def test_servo_bound_counts_up_to_the_force_that_its_drives_hold(
    servo: MonitorSettings, mass: float, share: float
) -> None:
    """The force is proportional to the speed, so that the allowable speed is, too; the push bound stays."""
    cases, mobility, whole = (
        contact_cases(limits_for(servo), servo),
        Mobility.of_mass(mass, X),
        speed_limit_of(mass, servo),
    )
    force = share * whole.limit.permissible_force_n
    limited = speed_limit(cases, [mobility], max_force=force)
    assert limited.allowable_speed == pytest.approx(min(share, 1.0) * whole.allowable_speed)
    assert limited.force(limited.allowable_speed) <= force * (1.0 + 1e-9) or share > 1.0
    push = DrivePush(5.0 / mass, 1.0 / mass)
    both = speed_limit(cases, [mobility], push, force).allowable_speed
    pushed = speed_limit(cases, [mobility], push, 0.0).allowable_speed
    assert both == pytest.approx(max(limited.allowable_speed, pushed))
