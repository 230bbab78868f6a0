# SPDX-License-Identifier: Apache-2.0
"""Poses of many configurations are those of Pinocchio, one at a time."""

import numpy as np
import pytest

from scara_effmass.model.dynamics import RobotDynamics
from scara_effmass.model.load import load_robot
from scara_effmass.model.many_poses import ManyPoses
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share


@pytest.mark.parametrize("name", ["omron_i4_550l.yaml", "robots/ur5_robot.urdf", "robots/panda.urdf"])
def test_positions_jacobians_and_directions_are_those_of_pinocchio(name: str) -> None:
    settings = MonitorSettings(robot=str(share("config", *name.split("/"))))
    dynamics = RobotDynamics(load_robot(settings.robot_path, settings))
    robot = dynamics.robot
    q = robot.sample_configurations(50)
    poses = ManyPoses(robot, q)
    for _, frame, _ in dynamics.contacts:
        np.testing.assert_allclose(poses.position(frame), [dynamics.position(row, frame) for row in q], atol=1e-14)
        np.testing.assert_allclose(poses.jacobian(frame), [dynamics.jacobian(row, frame) for row in q], atol=1e-14)
    direction = (0.0, 0.6, -0.8)
    for name_of_frame in dict.fromkeys(("", robot.base_frame, *(frame.name for frame in robot.model.frames))):
        expected = np.array([dynamics.in_base(row, direction, name_of_frame) for row in q])
        np.testing.assert_allclose(poses.in_base(direction, name_of_frame), expected, atol=1e-14)
