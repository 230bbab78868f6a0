# SPDX-License-Identifier: Apache-2.0
"""The distribution of Fig. 8 agrees with independent numbers."""

import numpy as np
import pytest

from scara_effmass.studies.scara import (
    MassDistribution,
    Scara,
    density_peaks,
    sampled_distribution,
    workspace_distribution,
)


def test_distribution_over_the_workspace_has_the_known_values(scara: Scara) -> None:
    along_x, along_y = workspace_distribution(scara), workspace_distribution(scara, np.pi / 2.0)
    assert along_x.below(2.77) == pytest.approx(0.709, abs=1e-3)
    assert along_x.mean == pytest.approx(2.359, abs=2e-3)
    assert along_x.median == pytest.approx(1.7725, abs=1e-3)
    assert along_y.below(2.77) == pytest.approx(0.773, abs=1e-3)
    assert along_y.median == pytest.approx(1.427, abs=1e-3)


def test_2500_positions_approximate_the_workspace(scara: Scara) -> None:
    sampled, whole = sampled_distribution(scara), workspace_distribution(scara)
    assert sampled.mass.size == 2500
    assert sampled.below(2.77) == pytest.approx(whole.below(2.77), abs=5e-3)
    assert sampled.median == pytest.approx(whole.median, abs=0.02)


def test_density_is_normalised_and_its_peaks_are_returned() -> None:
    rng = np.random.default_rng(8)
    mass = np.concatenate((rng.normal(1.5, 0.1, 4000), rng.normal(4.0, 0.1, 6000)))
    distribution = MassDistribution(mass, np.full(mass.size, 1.0 / mass.size))
    edges = np.linspace(0.0, 8.0, 81)
    assert np.sum(distribution.density(edges)) * 0.1 == pytest.approx(1.0)
    assert any(abs(peak - 1.5) < 0.2 for peak in density_peaks(distribution))
    assert any(abs(peak - 4.0) < 0.2 for peak in density_peaks(distribution))
    assert distribution.median == pytest.approx(float(np.median(mass)), abs=1e-3)


def test_workspace_distribution_has_the_papers_two_peaks(scara: Scara) -> None:
    np.testing.assert_allclose(density_peaks(workspace_distribution(scara)), [1.0, 3.35], atol=0.1)
