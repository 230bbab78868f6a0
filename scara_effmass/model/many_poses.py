# SPDX-License-Identifier: Apache-2.0
"""Forward kinematics of many configurations at once, in numpy: Pinocchio takes one at a time."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from scara_effmass.model.robot import Robot
from scara_effmass.values import FloatArray, Vector3


class ManyPoses:
    """Poses of the joint frames of a robot at the configurations `q` (m, n) [rad, m], in base axes."""

    def __init__(self, robot: Robot, q: FloatArray) -> None:
        """Compute the poses."""
        self._robot, model = robot, robot.model
        self._rotations, self._places = [np.tile(np.eye(3), (len(q), 1, 1))], [np.zeros((len(q), 3))]
        for joint, is_revolute in enumerate(robot.revolute, start=1):
            parent, pose, axis = model.parents[joint], model.jointPlacements[joint], robot.axis_in_joint_frame(joint)
            rotation = _times(self._rotations[parent], pose.rotation)
            place = self._places[parent] + self._rotations[parent] @ pose.translation
            if is_revolute:  # formula of Rodrigues
                cross, angle = pin.skew(axis), q[:, joint - 1, None, None]
                turned = _times(rotation, cross)
                rotation = rotation + np.sin(angle) * turned + (1.0 - np.cos(angle)) * _times(turned, cross)
            else:
                place = place + q[:, joint - 1, None] * (rotation @ axis)
            self._rotations.append(rotation)
            self._places.append(place)

    def position(self, frame: int) -> FloatArray:
        """Return the positions (m, 3) [m] of Pinocchio's `frame`."""
        of_frame = self._robot.model.frames[frame]
        joint = of_frame.parentJoint
        return np.asarray(self._places[joint] + self._rotations[joint] @ of_frame.placement.translation)

    def jacobian(self, frame: int) -> FloatArray:
        """Return J_v (m, 3, n): linear velocity of Pinocchio's `frame`, per joint velocity."""
        robot, joint = self._robot, self._robot.model.frames[frame].parentJoint
        point = self.position(frame)
        jacobian = np.zeros((*point.shape, robot.model.nv))
        while joint > 0:
            axis = self._rotations[joint] @ robot.axis_in_joint_frame(joint)
            is_revolute = robot.revolute[joint - 1]
            jacobian[:, :, joint - 1] = np.cross(axis, point - self._places[joint]) if is_revolute else axis
            joint = robot.model.parents[joint]
        return jacobian

    def in_base(self, vector: Vector3, frame: str) -> FloatArray:
        """Return `vector` (3,) of the robot's `frame` in base axes (m, 3)."""
        robot = self._robot
        if frame in {"", robot.base_frame}:
            return np.tile(vector, (len(self._places[0]), 1))
        of_frame = robot.model.frames[robot.frame_indices()[frame]]
        return np.asarray(self._rotations[of_frame.parentJoint] @ (of_frame.placement.rotation @ np.array(vector)))


def _times(matrices: FloatArray, matrix: FloatArray) -> FloatArray:
    """Return `matrices` (m, 3, 3) @ `matrix` (3, 3) by one product, which is faster than m of them."""
    return (matrices.reshape(-1, 3) @ matrix).reshape(-1, 3, 3)
