# SPDX-License-Identifier: Apache-2.0
"""The closed forms have the parameters of the robot file and agree with the mass matrices."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from scara_effmass.errors import RobotError
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share
from scara_effmass.sim.motion import ElbowConfig, inverse_kinematics
from scara_effmass.studies.scara import (
    MassDistribution,
    Scara,
    compare_models,
    density_peaks,
    equal_area_poses,
    joint_grid,
    matrix_masses,
    polar_grid,
    sampled_distribution,
    scara_of,
    workspace_distribution,
)


def test_parameters_equal_those_of_the_file(scara: Scara) -> None:
    rows = yaml.safe_load(share("config", "omron_i4_550l.yaml").read_text(encoding="utf-8"))
    assert (scara.inertia.l1, scara.inertia.l2) == pytest.approx([joint["a"] for joint in rows["joints"][:2]])
    links = rows["links"]
    first, second, third, fourth = (link["mass"] for link in links)
    tool = rows["payload"]["mass"]
    inertia = scara.inertia
    assert (inertia.m1, inertia.m2, inertia.m3, inertia.m4) == pytest.approx((first, second, third, fourth + tool))
    assert (inertia.r1, inertia.r2) == pytest.approx([link["com"][0] for link in links[:2]])
    assert inertia.i2 == pytest.approx(links[1]["inertia"])
    assert scara.iso_mass == pytest.approx((first + second + third + fourth) / 2.0 + tool)


@pytest.mark.parametrize("phi", [0.0, 0.9, np.pi / 2.0, -2.0])
def test_closed_forms_agree_with_the_mass_matrices(dynamics: RobotDynamics, scara: Scara, phi: float) -> None:
    check = compare_models(dynamics, scara, *equal_area_poses(scara, count=12), phi)
    assert check.poses == 144
    assert max(check.lumped_relative_difference, check.full_relative_difference) < 1e-9


def test_wrong_parameter_gives_a_difference(dynamics: RobotDynamics, scara: Scara) -> None:
    poses = equal_area_poses(scara, count=8)
    heavier = replace(scara, m2=1.01 * scara.m2, inertia=replace(scara.inertia, i2=1.01 * scara.inertia.i2))
    check = compare_models(dynamics, heavier, *poses)
    assert check.lumped_relative_difference > 1e-3
    assert check.full_relative_difference > 1e-5


def test_matrix_masses_do_not_depend_on_the_quill(dynamics: RobotDynamics, scara: Scara) -> None:
    poses = equal_area_poses(scara, count=4)
    low, high = (np.concatenate(matrix_masses(dynamics, *poses, 0.5, q3)) for q3 in (0.0, 0.45))
    np.testing.assert_allclose(low, high, rtol=1e-12)


def test_tool_position_agrees_with_inverse_kinematics(scara: Scara) -> None:
    xy = np.array([[0.3, 0.2], [0.1, -0.4], [-0.3, 0.3]])
    q = inverse_kinematics(xy, ElbowConfig.RIGHT)
    np.testing.assert_allclose(np.stack(scara.tool(q[:, 0], q[:, 1]), axis=1), xy, atol=1e-12)


def test_robot_that_is_no_scara_raises(tmp_path: Path) -> None:
    rows = yaml.safe_load(share("config", "omron_i4_550l.yaml").read_text(encoding="utf-8"))
    rows["joints"][2]["a"] = 0.05
    path = tmp_path / "robot.yaml"
    path.write_text(yaml.safe_dump(rows, sort_keys=False), encoding="utf-8")
    with pytest.raises(RobotError):
        scara_of(RobotDynamics(load_robot(path, MonitorSettings())))


@pytest.mark.parametrize("elbow_config", ElbowConfig)
def test_grid_spans_both_ranges_without_singular_poses(scara: Scara, elbow_config: ElbowConfig) -> None:
    q1, q2 = np.degrees(joint_grid(scara, elbow_config))
    assert q1.shape == q2.shape == (50, 50)
    assert (q1.min(), q1.max()) == pytest.approx((-136.0, 136.0), abs=1e-2)
    assert np.abs(q2).max() == pytest.approx(148.0, abs=1e-2)
    assert np.all(q2 * elbow_config.value >= 0.0)
    assert np.isfinite(scara.lumped(*joint_grid(scara, elbow_config))).all()


def test_positions_are_uniform_over_the_area(scara: Scara) -> None:
    x, y = scara.tool(*equal_area_poses(scara))
    assert len(x) == 2500
    # At every radius r the arm covers 272 deg, so the share of positions within r grows with r^2.
    r2 = np.sort(x**2 + y**2)
    inner, outer = 0.55 * np.cos(np.radians(74.0)), 0.55
    share = (r2 - inner**2) / (outer**2 - inner**2)
    np.testing.assert_allclose(share, np.linspace(0.0, 1.0, 2500), atol=0.011)
    # Squares inside the workspace contain positions in proportion to their area.
    area = np.radians(272.0) / 2.0 * (outer**2 - inner**2)
    for centre in ((0.35, 0.1), (0.2, 0.3), (-0.15, 0.3)):
        inside = (np.abs(x - centre[0]) < 0.08) & (np.abs(y - centre[1]) < 0.08)
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
