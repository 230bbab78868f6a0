# SPDX-License-Identifier: Apache-2.0
"""Lumped and full model of a robot, and its contact points."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from scara_effmass.codes import ModelCode
from scara_effmass.errors import RobotError
from scara_effmass.model.lumping import LumpedModel, lump
from scara_effmass.model.robot import Robot
from scara_effmass.reference.hull import point_maps
from scara_effmass.reference.pose_state import MIN_LEVER_M, NO_VERTICES, ContactPoint, PoseState
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import FloatArray

RANK_TOLERANCE = 1e-5
"""Fraction of the largest singular value of J_v below which a direction counts as unreachable.

Axes that meet in a point miss it by the rounded angles of a file: 1.5708 in place of pi / 2 by 4e-6.
"""


class RobotDynamics:
    """Lumped and full model of one robot.

    `lumped` is None, and `lumped_reason` states why, if the robot has no lumped model; likewise `full_reason`.
    `models` holds Pinocchio's models of those that exist.
    """

    def __init__(self, robot: Robot) -> None:
        """Build the models. Raises RobotError for a contact point that no joint moves."""
        self.robot = robot
        self.lumped: LumpedModel | None = None
        self.lumped_reason = ""
        try:
            self.lumped = lump(robot)
        except RobotError as error:
            self.lumped_reason = str(error)
        self.full_reason = _full_reason(robot)
        self.models: dict[ModelCode, pin.Model] = {}
        if self.lumped is not None:
            self.models[ModelCode.LUMPED] = self.lumped.model
        if not self.full_reason:
            self.models[ModelCode.FULL] = robot.model
        self._frame_indices = robot.frame_indices()
        self.contacts = _contact_points(robot)

    def with_payload(self, settings: MonitorSettings) -> RobotDynamics:
        """Return the dynamics of the same robot with the load of `settings`."""
        return RobotDynamics(self.robot.rebuild(settings))

    @property
    def contact_points(self) -> tuple[str, ...]:
        """Names of the contact points."""
        return tuple(point.name for point in self.contacts)

    def at(self, q: FloatArray, qd: FloatArray | None = None) -> PoseState:
        """Return the state at `q` (n,) [rad, m] and `qd` (n,), by default at rest."""
        return PoseState(self, np.asarray(q, dtype=float), np.zeros(len(q)) if qd is None else np.asarray(qd))

    def frame_index(self, frame: str, setting: str) -> int | None:
        """Return Pinocchio's index of `frame`, None for the base. Raises RobotError, which names `setting`."""
        if frame in {"", self.robot.base_frame}:
            return None
        if frame not in self._frame_indices:
            names = ", ".join(dict.fromkeys(frame.name for frame in self.robot.model.frames))
            raise RobotError(f"{self.robot.origin}: {setting} = {frame!r}: must be one of {names}")
        return self._frame_indices[frame]


def _contact_points(robot: Robot) -> tuple[ContactPoint, ...]:
    """Return the contact points with the number of dimensions in which each moves outside singular poses.

    A link moves in as many as the vertex of its hull that moves in most.
    """
    model, data = robot.model, robot.model.createData()
    places = {
        name: robot.hulls.get(name, model.frames[frame].placement.translation[None])
        for name, frame in robot.contact_frames.items()
    }
    jacobians: dict[str, list[FloatArray]] = {name: [] for name in places}
    for q in robot.sample_configurations():
        pin.computeJointJacobians(model, data, q)
        for name, frame in robot.contact_frames.items():
            joint = model.frames[frame].parentJoint
            jacobian = np.reshape(pin.getJointJacobian(model, data, joint, pin.ReferenceFrame.LOCAL), (6, model.nv))
            jacobians[name].append(point_maps(places[name]) @ jacobian)
    points = []
    for name, frame in robot.contact_frames.items():
        values = np.linalg.svd(np.array(jacobians[name]), compute_uv=False)
        rank = int(np.sum(values > max(RANK_TOLERANCE * values.max(), MIN_LEVER_M), axis=-1).max())
        if rank == 0:
            raise RobotError(
                f"{robot.origin}: contact point {name}: must not lie on the axis of every joint that moves it"
            )
        points.append(ContactPoint(name, frame, rank, robot.hulls.get(name, NO_VERTICES)))
    return tuple(points)


def _full_reason(robot: Robot) -> str:
    """Return why the robot has no full model, or an empty string."""
    if robot.inertias_reason:
        return robot.inertias_reason
    data = robot.model.createData()
    for q in robot.sample_configurations():
        matrix = robot.mass_matrix(robot.model, data, q)
        scale = np.sqrt(np.diag(matrix).clip(min=0.0))
        if np.any(scale == 0.0):
            joint = robot.joint_names[int(np.flatnonzero(scale == 0.0)[0])]
            return f"{joint} moves no inertia: its link must have an inertia, or the joint an armature"
        if np.linalg.eigvalsh(matrix / np.outer(scale, scale))[0] < 1e-12:
            return f"the mass matrix is not positive definite at q = {np.round(q, 3).tolist()}"
    return ""
