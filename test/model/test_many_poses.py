# SPDX-License-Identifier: Apache-2.0
"""Poses of many configurations are those of Pinocchio, one at a time."""

import numpy as np
import pytest

from scara_effmass.model.load import load_robot
from scara_effmass.model.many_poses import ManyPoses
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share


@pytest.mark.parametrize("name", ["omron_i4_550l.yaml", "robots/ur5_robot.urdf", "robots/panda.urdf"])
def test_positions_jacobians_and_directions_are_those_of_pinocchio(name: str) -> None:
    settings = MonitorSettings(robot=str(share("config", *name.split("/"))))
    dynamics = RobotDynamics(load_robot(settings.robot_path, settings))
    robot = dynamics.robot
    q = robot.sample_configurations(50)
    poses = ManyPoses(robot, q)
    states = [dynamics.at(row) for row in q]
    for index, (_, frame, _) in enumerate(dynamics.contacts):
        contacts = [state.contacts[index] for state in states]
        np.testing.assert_allclose(poses.position(frame), [contact.position for contact in contacts], atol=1e-14)
        np.testing.assert_allclose(poses.jacobian(frame), [contact.jacobian for contact in contacts], atol=1e-14)
    direction = (0.0, 0.6, -0.8)
    for name_of_frame in dict.fromkeys(("", robot.base_frame, *(frame.name for frame in robot.model.frames))):
        expected = np.array([state.in_base(direction, name_of_frame) for state in states])
        np.testing.assert_allclose(poses.in_base(direction, name_of_frame), expected, atol=1e-14)
