# SPDX-License-Identifier: Apache-2.0
"""Contact anywhere on a link: the bound over a hull against every point in it, and against what it is for one point."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.reference.hull import Hull
from scara_effmass.values import FloatArray

MASSES = st.sampled_from([0.6, 4.4, 40.0, 1e6])


def link(seed: int, joints: int, vertices: int) -> Hull:
    """Return a hull of random vertices of a link of a random arm."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(joints, joints))
    matrix = root @ root.T + 0.1 * np.eye(joints)
    jacobian, qd = rng.normal(size=(6, joints)), rng.normal(size=joints)
    corners = 0.3 * rng.normal(size=(vertices, 3))
    mobility = jacobian @ np.linalg.solve(matrix, jacobian.T)
    return Hull(corners, jacobian @ qd, 0, mobility, float(qd @ matrix @ qd))


def point_energy(hull: Hull, r: FloatArray, s: float) -> float:
    """Return v^T (s 1 + A)^-1 v at one point."""
    t = np.hstack([np.eye(3), -pin.skew(r)])
    v = t @ hull.twist
    return float(v @ np.linalg.solve(s * np.eye(3) + t @ np.asarray(hull.mobility) @ t.T, v))


@given(st.integers(0, 2**32 - 1), st.integers(1, 7), st.integers(1, 16), MASSES)
def test_no_point_of_the_hull_has_more_energy(seed: int, joints: int, vertices: int, mass: float) -> None:
    hull = link(seed, joints, vertices)
    bound = hull.energy(1.0 / mass).at(1.0)
    weights = np.random.default_rng(seed).dirichlet(np.ones(vertices), 200)
    points = np.vstack([hull.vertices, weights @ hull.vertices])
    assert max(point_energy(hull, r, 1.0 / mass) for r in points) <= bound * (1.0 + 1e-9)


@given(st.integers(0, 2**32 - 1), st.integers(1, 7), MASSES)
def test_of_one_point_it_is_the_energy(seed: int, joints: int, mass: float) -> None:
    hull = link(seed, joints, 1)
    expected = point_energy(hull, hull.vertices[0], 1.0 / mass)
    assert hull.energy(1.0 / mass).at(1.0) == pytest.approx(expected, rel=1e-6)


@given(st.integers(0, 2**32 - 1), st.integers(1, 7), st.integers(1, 16), MASSES)
def test_it_is_no_more_than_the_energy_of_the_arm(seed: int, joints: int, vertices: int, mass: float) -> None:
    hull = link(seed, joints, vertices)
    assert hull.energy(1.0 / mass).at(1.0) <= hull.energy_of_arm


@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 7),
    st.integers(1, 16),
    st.sampled_from([0.0, 0.3, 1.6]),
    st.sampled_from([0.0, 0.1, 1.0, 8.0]),
)
def test_a_person_in_any_direction_is_within_the_bound_at_every_speed(
    seed: int, joints: int, vertices: int, speed: float, scale: float
) -> None:
    hull = link(seed, joints, vertices)
    rng, s = np.random.default_rng(seed), 0.2
    energy = hull.energy(s)
    bound = energy.at(scale, speed)
    assert bound <= min(energy.at(scale + 0.01, speed), energy.at(scale, speed + 0.01)) * (1.0 + 1e-12)
    for r in [*hull.vertices, *(rng.dirichlet(np.ones(vertices), 20) @ hull.vertices)]:
        t = np.hstack([np.eye(3), -pin.skew(r)])
        matrix = np.linalg.inv(s * np.eye(3) + t @ np.asarray(hull.mobility) @ t.T)
        directions = rng.normal(size=(50, 3))
        closing = scale * (t @ hull.twist) + speed * directions / np.linalg.norm(directions, axis=1, keepdims=True)
        assert np.einsum("ni,ij,nj->n", closing, matrix, closing).max() <= bound * (1.0 + 1e-9)


def test_masses_scale_the_energy() -> None:
    hull = link(3, 6, 8)
    assert hull.with_masses(2.0).energy(0.1).at(1.0) == pytest.approx(2.0 * hull.energy(0.2).at(1.0), rel=1e-9)
