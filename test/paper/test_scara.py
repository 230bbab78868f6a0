"""The closed forms have the parameters of the robot file and agree with the mass matrices."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
import yaml

from scara_effmass.errors import RobotError
from scara_effmass.model.dynamics import RobotDynamics
from scara_effmass.model.load import load_robot
from scara_effmass.paper.scara import compare_models, matrix_masses, scara_of
from scara_effmass.paper.workspace import equal_area_poses
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share
from scara_effmass.sim.motion import ElbowConfig, inverse_kinematics

if TYPE_CHECKING:
    from pathlib import Path

    from scara_effmass.paper.scara import Scara


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
    assert max(check.lumped, check.full) < 1e-9


def test_wrong_parameter_gives_a_difference(dynamics: RobotDynamics, scara: Scara) -> None:
    poses = equal_area_poses(scara, count=8)
    heavier = replace(scara, m2=1.01 * scara.m2, inertia=replace(scara.inertia, i2=1.01 * scara.inertia.i2))
    check = compare_models(dynamics, heavier, *poses)
    assert check.lumped > 1e-3
    assert check.full > 1e-5


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
