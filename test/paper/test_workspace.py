"""Pose grids cover the workspace evenly and contain reachable poses only."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from scara_effmass.paper.workspace import equal_area_poses, joint_grid, polar_grid
from scara_effmass.sim.motion import ElbowConfig

if TYPE_CHECKING:
    from scara_effmass.paper.scara import Scara


@pytest.mark.parametrize("elbow_config", ElbowConfig)
def test_grid_spans_both_ranges_without_singular_poses(scara: Scara, elbow_config: ElbowConfig) -> None:
    q1, q2 = np.degrees(joint_grid(scara, elbow_config))
    assert q1.shape == q2.shape == (50, 50)
    assert (q1.min(), q1.max()) == pytest.approx((-136.0, 136.0), abs=1e-2)
    assert np.abs(q2).max() == pytest.approx(148.0, abs=1e-2)
    assert np.all(q2 * elbow_config.value >= 0.0)
    assert np.isfinite(scara.lumped(*joint_grid(scara, elbow_config))).all()


@pytest.mark.parametrize("elbow_config", ElbowConfig)
def test_positions_are_uniform_over_the_area(scara: Scara, elbow_config: ElbowConfig) -> None:
    x, y = scara.tool(*equal_area_poses(scara, elbow_config))
    assert len(x) == 2500
    # At every radius r the arm covers 272 deg, so the share of positions within r grows with r^2.
    r2 = np.sort(x**2 + y**2)
    inner, outer = 0.55 * np.cos(np.radians(74.0)), 0.55
    share = (r2 - inner**2) / (outer**2 - inner**2)
    np.testing.assert_allclose(share, np.linspace(0.0, 1.0, 2500), atol=0.011)
    # Squares inside the workspace contain positions in proportion to their area.
    area = np.radians(272.0) / 2.0 * (outer**2 - inner**2)
    for centre in ((0.35, 0.1), (0.2, 0.3), (-0.15, 0.3)):
        inside = (np.abs(x - centre[0]) < 0.08) & (np.abs(y - elbow_config.value * centre[1]) < 0.08)
        assert inside.mean() == pytest.approx(0.16**2 / area, rel=0.1)


def test_poses_of_both_arms_have_the_same_tool_position(scara: Scara) -> None:
    grid = polar_grid(scara, 20, 61)
    for poses, elbow_config in ((grid.right, ElbowConfig.RIGHT), (grid.left, ElbowConfig.LEFT)):
        reachable = np.isfinite(poses.q1)
        assert np.all(np.sign(poses.q2[:, 1:]) == elbow_config.value)
        x, y = scara.tool(*poses)
        np.testing.assert_allclose(x[reachable], grid.x[reachable], atol=1e-12)
        np.testing.assert_allclose(y[reachable], grid.y[reachable], atol=1e-12)
        assert np.nanmax(np.abs(poses.q1)) <= scara.q1_max * (1.0 + 1e-9)
    alone = np.isfinite(grid.right.q1) ^ np.isfinite(grid.left.q1)
    assert (np.isfinite(grid.right.q1) | np.isfinite(grid.left.q1)).all()
    assert 0.1 < alone.mean() < 0.9
