# SPDX-License-Identifier: Apache-2.0
"""Reduced mass along the worst contact normal: search over directions, linear algebra, energy."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scara_effmass.reference.mobility import Mobility, is_bounded, is_definite
from scara_effmass.values import FloatArray

X = np.array([1.0, 0.0, 0.0])
OBSTACLES = st.sampled_from([0.6, 1.2, 2.0, 4.4, 40.0, 75.0, 1000.0, math.inf])


@st.composite
def mobilities(draw: st.DrawFn) -> tuple[FloatArray, FloatArray, int]:
    """Return a mobility (3, 3) [1/kg], a reachable unit velocity (3,), and the rank."""
    rank = draw(st.integers(1, 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    basis = np.linalg.qr(rng.normal(size=(3, 3)))[0][:, :rank]
    velocity = basis @ rng.normal(size=rank)
    return basis @ np.diag(10.0 ** rng.uniform(-2, 1, rank)) @ basis.T, velocity / np.linalg.norm(velocity), rank


@given(mobilities(), st.integers(0, 2**32 - 1), st.floats(0.0, 1.0))
def test_bound_of_a_mobility_is_that_of_the_eigenvalues(
    mobility: tuple[FloatArray, FloatArray, int], seed: int, factor: float
) -> None:
    """Also of mobilities of a plane or a line, whose difference has eigenvalues 0."""
    bound, _, rank = mobility
    values, basis = np.linalg.eigh(bound)
    rng = np.random.default_rng(seed)
    change = basis[:, 3 - rank :] @ rng.normal(size=(rank, rank)) @ basis[:, 3 - rank :].T
    matrix = bound + 0.3 * (change + change.T)
    lowest = np.linalg.eigvalsh(basis[:, 3 - rank :].T @ (bound - factor * matrix) @ basis[:, 3 - rank :])[0]
    if abs(lowest) > 1e-8 * values[-1]:
        assert is_bounded(matrix, bound, factor) == (lowest > 0.0)
    assert is_bounded(bound, bound, factor)


def test_mobility_that_is_nan_is_not_bounded() -> None:
    eye, nan = np.eye(3), np.full((3, 3), math.nan)
    assert is_bounded(eye, eye, 1.0)
    assert not is_bounded(nan, eye, 0.5)
    assert not is_bounded(eye, nan, 0.5)
    assert not is_definite(nan, 3)
    assert not is_definite(-eye, 3)
    assert is_definite(np.diag([1.0, 1.0, -1e-9]), 3)  # rounding


def reduced(mobility: tuple[FloatArray, FloatArray, int], alpha: float, beta: float = 1.0) -> float:
    matrix, velocity, rank = mobility
    return Mobility.of_matrix(matrix, velocity, rank).reduced_mass(alpha, beta)


@given(mobilities(), OBSTACLES, st.floats(0.05, 1.0))
def test_reduced_mass_is_the_rayleigh_quotient(
    mobility: tuple[FloatArray, FloatArray, int], obstacle: float, beta: float
) -> None:
    matrix, velocity, _ = mobility
    total = beta * matrix + np.eye(3) / obstacle
    inverse = np.linalg.pinv(total, rcond=1e-9) if math.isinf(obstacle) else np.linalg.inv(total)
    assert reduced(mobility, 1.0 / obstacle, beta) == pytest.approx(velocity @ inverse @ velocity, rel=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_no_normal_of_a_search_exceeds_that_of_the_worst(seed: int) -> None:
    """(v.n)^2 mu(n) over 200 000 random normals comes within 3e-4 of the maximum, and not above it."""
    rng = np.random.default_rng(seed)
    factor = rng.normal(size=(3, 3))
    matrix, velocity = factor @ factor.T, rng.normal(size=3)
    velocity /= np.linalg.norm(velocity)
    for obstacle in (0.6, 40.0, 75.0):
        maximum, centre, width = 0.0, np.zeros(3), 1.0
        for _ in range(2):  # over the sphere, then around the best direction
            normals = centre + width * rng.normal(size=(100_000, 3))
            normals /= np.linalg.norm(normals, axis=1)[:, None]
            along = np.einsum("ni,ij,nj->n", normals, matrix, normals)
            forces = (normals @ velocity) ** 2 / (along + 1.0 / obstacle)
            maximum, centre, width = float(forces.max()), normals[forces.argmax()], 0.03
        expected = reduced((matrix, velocity, 3), 1.0 / obstacle)
        assert maximum <= expected * (1.0 + 1e-12)
        assert math.sqrt(maximum) == pytest.approx(math.sqrt(expected), rel=3e-4)


@given(mobilities(), OBSTACLES)
def test_worst_normal_is_never_milder_than_the_velocity(
    mobility: tuple[FloatArray, FloatArray, int], obstacle: float
) -> None:
    matrix, velocity, _ = mobility
    assert reduced(mobility, 1.0 / obstacle) >= 1.0 / (velocity @ matrix @ velocity + 1.0 / obstacle) * (1.0 - 1e-12)


@given(mobilities(), st.floats(0.1, 100.0))
def test_sticking_contact_takes_up_this_energy(mobility: tuple[FloatArray, FloatArray, int], obstacle: float) -> None:
    """Momentum and a common velocity in all directions: the energy lost is mu_worst v^2 / 2."""
    matrix, velocity, _ = mobility
    impulse = np.linalg.solve(matrix + np.eye(3) / obstacle, velocity)
    lost = 0.5 * impulse @ velocity
    assert 0.5 * reduced(mobility, 1.0 / obstacle) == pytest.approx(lost, rel=1e-6)


@given(st.floats(1e-3, 1e3), OBSTACLES)
def test_single_mass_has_the_reduced_mass_of_the_standard(mass: float, obstacle: float) -> None:
    expected = mass if math.isinf(obstacle) else mass * obstacle / (mass + obstacle)
    assert Mobility.of_mass(mass, X).reduced_mass(1.0 / obstacle) == pytest.approx(expected, rel=1e-12)


def test_immovable_robot_has_the_mass_of_the_obstacle() -> None:
    assert Mobility.of_mass(math.inf, X).reduced_mass(1.0 / 40.0) == pytest.approx(40.0)
    assert Mobility.of_mass(2.0, X).reduced_mass(1.0 / 40.0, 0.0) == pytest.approx(40.0)
    assert Mobility.of_mass(2.0, X).reduced_mass(0.0, 0.0) == math.inf
    assert Mobility.of_mass(math.inf, X).reduced_mass(0.0) == math.inf


@pytest.mark.parametrize("trace", [0.01, 100.0])
def test_clamped_body_part_counts_directions_out_of_reach_as_nearly_rigid(trace: float) -> None:
    """Their mobility counts as 1e-11 of the trace."""
    mobility = Mobility.of_matrix(np.diag([trace, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]), 2)
    assert mobility.reduced_mass(0.0) == pytest.approx(1e11 / trace)


@given(mobilities(), OBSTACLES, st.floats(1.0, 2.0))
def test_heavier_robot_is_the_one_with_larger_masses(
    mobility: tuple[FloatArray, FloatArray, int], obstacle: float, factor: float
) -> None:
    matrix, velocity, rank = mobility
    heavier = Mobility.of_matrix(matrix, velocity, rank).with_masses(factor)
    assert heavier.effective_mass(velocity) == pytest.approx(factor / (velocity @ matrix @ velocity), rel=1e-9)
    expected = reduced((matrix / factor, velocity, rank), 1.0 / obstacle)
    assert heavier.reduced_mass(1.0 / obstacle) == pytest.approx(expected, rel=1e-9)
