# SPDX-License-Identifier: Apache-2.0
"""The study of whole links: its dense maximum against one point at a time, and simulated impacts below the limit."""

import numpy as np
import pinocchio as pin
import pytest

from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share
from scara_effmass.studies.links import impacts, largest_energy


def test_largest_energy_is_that_of_one_of_the_points() -> None:
    rng = np.random.default_rng(1)
    root, points, twist = rng.normal(size=(6, 6)), rng.normal(size=(40, 3)), rng.normal(size=6)
    mobility, values = root @ root.T, []
    for r in points:
        t = np.hstack([np.eye(3), -pin.skew(r)])
        v = t @ twist
        values.append(float(v @ np.linalg.solve(0.2 * np.eye(3) + t @ mobility @ t.T, v)))
    assert largest_energy(points, twist, mobility, 0.2) == pytest.approx(max(values), rel=1e-12)


def test_simulated_impacts_on_the_links_of_the_scara_keep_the_limit() -> None:
    forces = impacts(share("config", "omron_i4_550l.yaml"), MonitorSettings(), 6, 1)
    assert forces.max() < 1.01
    assert np.median(forces) > 0.7
