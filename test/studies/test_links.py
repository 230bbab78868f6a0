# SPDX-License-Identifier: Apache-2.0
"""The study of whole links: its dense maximum against one point at a time, and how tight the bound is."""

import numpy as np
import pinocchio as pin
import pytest

from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share
from scara_effmass.studies.links import POINTS, largest_energy, surfaces, tightness

SCARA = share("config", "omron_i4_550l.yaml")


def test_largest_energy_is_that_of_one_of_the_points() -> None:
    rng = np.random.default_rng(1)
    root, points, twist = rng.normal(size=(6, 6)), rng.normal(size=(40, 3)), rng.normal(size=6)
    mobility, values = root @ root.T, []
    for r in points:
        t = np.hstack([np.eye(3), -pin.skew(r)])
        v = t @ twist
        values.append(float(v @ np.linalg.solve(0.2 * np.eye(3) + t @ mobility @ t.T, v)))
    assert largest_energy(points, twist, mobility, 0.2) == pytest.approx(max(values), rel=1e-12)


def test_points_cover_the_boxes_of_a_dh_file() -> None:
    surface = surfaces(SCARA, MonitorSettings(), 1)
    assert [*surface] == ["link1", "link2", "link3", "link4"]
    joint, points = surface["link2"]
    assert (joint, len(points)) == ("joint2", 8 + POINTS)
    centre, size = np.array([0.1375, 0.0, 0.1]), np.array([0.425, 0.15, 0.2])  # in the file
    distances = 2.0 * np.abs(points - centre) / size
    assert distances.max(axis=1) == pytest.approx(1.0)  # on a face
    assert (distances > 1.0 - 1e-9).any(axis=0).all()


def test_bound_of_the_links_of_the_scara_is_tight() -> None:
    ratios = tightness(SCARA, MonitorSettings(), 90, 1)
    values = np.concatenate([*ratios.values()])
    assert len(values) > 350  # a link that hardly moves has no direction
    assert values.min() >= 1.0 - 1e-9
    assert np.median(values) <= 1.03
    assert np.percentile(values, 95) <= 1.15
