"""Check the lumped masses of a SCARA against the closed forms, Eqs. 28 and 30 of the paper."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from scara_effmass.errors import RobotError
from scara_effmass.model.scara_closed_form import scara_lumped_mass, scara_max_lumped_mass
from scara_effmass.values import ContactAssessment, FloatArray, JointState

if TYPE_CHECKING:
    from scara_effmass.model.dynamics import RobotDynamics
    from scara_effmass.model.robot import Robot

BATCH_SIZE = 20_000
AXIS_TOLERANCE = 1e-9
"""Maximum of 1 - |cosine| between a joint axis and the base z axis."""


class ClosedFormCheck:
    """Compares published lumped masses with the closed forms, which use neither the mass matrix nor Pinocchio.

    The quill moves along z only, with the mass m_z of the links that it carries. Along n = (n_x, n_y, n_z)
    1/m_n = (n_x^2 + n_y^2) / m(Eq. 28) + n_z^2 / m_z; the worst-direction mass is the larger of Eq. 30 and m_z.
    """

    def __init__(self, dynamics: RobotDynamics, mass_cap: float) -> None:
        """Prepare the check; `mass_cap` [kg] limits masses as in the monitor. Raises RobotError for other robots."""
        if dynamics.lumped is None:
            raise RobotError(f"{dynamics.robot.origin}: no lumped mass ({dynamics.lumped_reason})")
        self._m2, self._m3 = dynamics.lumped.planar_masses(dynamics.robot)
        self._mz = sum(link.mass for link in dynamics.lumped.links[2:])
        self._zero_angles, self._axis_signs = _planar_angles(dynamics.robot)
        self._joint_names = dynamics.robot.joint_names[:2]
        self._cap = mass_cap
        self._names: tuple[str, ...] = ()
        self._rows: list[tuple[float, float, float, float, float, float]] = []
        self._checked = 0
        self._max_difference = 0.0

    def add(self, state: JointState, contacts: tuple[ContactAssessment, ...]) -> None:
        """Add the contact points of one joint state that have a lumped mass."""
        if state.names != self._names:
            self._names = state.names
            self._indices = [state.names.index(joint) if joint in state.names else -1 for joint in self._joint_names]
        for contact in contacts:
            if not math.isnan(contact.lumped_mass):
                first, second = self._indices
                q1, q2 = state.position[first], state.position[second]
                self._rows.append((q1, q2, *contact.direction, contact.lumped_mass))
        if len(self._rows) >= BATCH_SIZE:
            self._compare()

    def result(self) -> tuple[int, float]:
        """Return the number of masses checked and the maximum relative difference."""
        self._compare()
        return self._checked, self._max_difference

    def _compare(self) -> None:
        if not self._rows:
            return
        q1, q2, nx, ny, nz, mass = np.array(self._rows).T
        q1, q2 = self._zero_angles[0] + self._axis_signs[0] * q1, self._zero_angles[1] + self._axis_signs[1] * q2
        with np.errstate(divide="ignore", invalid="ignore"):
            planar = scara_lumped_mass(q1, q2, np.arctan2(ny, nx), self._m2, self._m3)
            directional = 1.0 / ((nx**2 + ny**2) / planar + nz**2 / self._mz)
            worst = np.maximum(scara_max_lumped_mass(q2, self._m2, self._m3), self._mz)
        has_direction = nx**2 + ny**2 + nz**2 > 0.0
        expected = np.minimum(np.where(has_direction, directional, worst), self._cap)
        self._max_difference = max(self._max_difference, float(np.max(np.abs(mass - expected) / expected)))
        self._checked += len(self._rows)
        self._rows.clear()


def _planar_angles(robot: Robot) -> tuple[FloatArray, FloatArray]:
    """Return q1 and q2 of the closed forms at joint position 0, and the signs of the joint axes along base z."""
    poses = [robot.model.jointPlacements[1]]
    for joint in (2, 3, 4):
        poses.append(poses[-1] * robot.model.jointPlacements[joint])
    axes = [float((pose.rotation @ robot.axis_in_joint_frame(i))[2]) for i, pose in enumerate(poses[:2], start=1)]
    if any(abs(abs(axis) - 1.0) > AXIS_TOLERANCE for axis in axes):
        raise RobotError(f"{robot.origin}: the first two joint axes of {robot.name} must be along z of its base frame")
    shoulder, elbow, _, tool = (pose.translation for pose in poses)
    link1, link2 = elbow - shoulder, tool - elbow
    angle1, angle2 = math.atan2(link1[1], link1[0]), math.atan2(link2[1], link2[0])
    return np.array([angle1, angle2 - angle1]), np.sign(axes)
