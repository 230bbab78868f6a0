# SPDX-License-Identifier: Apache-2.0
"""Poses of a robot in its base frame: geometry of one for drawings, and the kinematics of many at once in numpy."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from scara_effmass.model.lumping import LumpedModel
from scara_effmass.model.robot import Robot
from scara_effmass.values import ContactAssessment, FloatArray, Vector3

MIN_SEGMENT_M = 1e-6
"""Length [m] below which a segment is not drawn."""


class PoseGeometry(NamedTuple):
    """Positions [m] in the base frame at one pose.

    `segments` (k, 2, 3) are the links as lines: from joint to joint, to the tip, and to the contact points beside them.
    `lumped_masses` are masses [kg] with their positions; empty without a lumped model. `hulls` are the poses of
    the frames in which the robot's hulls are.
    """

    segments: FloatArray
    lumped_masses: tuple[tuple[float, Vector3], ...]
    contact_points: dict[str, Vector3]
    hulls: dict[str, pin.SE3]

    def places(self, contacts: Iterable[ContactAssessment]) -> dict[str, Vector3]:
        """Return where each contact point is, a link as a whole at its worst place among `contacts`."""
        worst = {contact.contact_point: contact.position for contact in contacts if any(contact.position_in_link)}
        return self.contact_points | worst


class MassEllipsoid(NamedTuple):
    """Principal effective masses (3,) [kg], and their unit directions as the columns of the rotation `axes` (3, 3).

    With semi-axes s sqrt(m_i), the radius along any unit vector n is s sqrt(m_n), m_n the effective mass along n.
    """

    masses: FloatArray
    axes: FloatArray


def pose_geometry(robot: Robot, lumped: LumpedModel | None, q: FloatArray) -> PoseGeometry:
    """Return links and contact points of `robot`, and its `lumped` masses, at `q` (n,) [rad, m]."""
    model = robot.model
    poses = [pin.SE3.Identity(), *(pin.SE3(pose) for pose in robot.joint_poses(q))]
    contacts = [model.frames[frame] for frame in robot.contact_frames.values()]
    points = [poses[frame.parentJoint].act(frame.placement.translation) for frame in contacts]
    lines = [(poses[-1].translation, poses[-1].act(robot.tip.translation))]
    lines += [(poses[frame.parentJoint].translation, point) for frame, point in zip(contacts, points, strict=True)]
    for joint in range(1, model.njoints):
        parent = poses[model.parents[joint]]
        start = parent.act(model.jointPlacements[joint].translation)
        lines += [(parent.translation, start), (start, poses[joint].translation)]  # the latter: how far it slides
    segments = np.array(lines)
    lengths = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
    masses = () if lumped is None else lumped.masses
    hulls = ((name, poses[frame.parentJoint]) for name, frame in zip(robot.contact_frames, contacts, strict=True))
    return PoseGeometry(
        segments[lengths > MIN_SEGMENT_M],
        tuple((mass, _vector(poses[joint].act(np.array(point)))) for mass, joint, point in masses),
        {name: _vector(point) for name, point in zip(robot.contact_frames, points, strict=True)},
        {name: pose for name, pose in hulls if name in robot.hulls},
    )


def mass_ellipsoid(mobility: FloatArray, max_mass: float) -> MassEllipsoid:
    """Return the ellipsoid of a symmetric (3, 3) `mobility` [1/kg], largest mass first.

    `max_mass` [kg] limits the masses, which are infinite where no joint moves the contact point.
    """
    mobilities, axes = np.linalg.eigh(mobility)
    axes[:, 2] *= np.sign(np.linalg.det(axes))  # right-handed, to be a rotation
    return MassEllipsoid(1.0 / np.maximum(mobilities, 1.0 / max_mass), axes)


def rotation_to(direction: Vector3) -> FloatArray:
    """Return a rotation (3, 3) that turns the z axis to the unit vector `direction`."""
    return np.asarray(pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), np.array(direction)).matrix())


def quaternion(rotation: FloatArray) -> tuple[float, float, float, float]:
    """Return x, y, z, w of a rotation (3, 3), as ROS and three.js order them."""
    x, y, z, w = pin.Quaternion(rotation).coeffs().tolist()
    return x, y, z, w


class ManyPoses:
    """Poses of the joint frames of a robot at the configurations `q` (m, n) [rad, m], in base axes.

    In numpy, because Pinocchio takes one configuration at a time.
    """

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


def _vector(point: FloatArray) -> Vector3:
    x, y, z = point.tolist()
    return x, y, z
