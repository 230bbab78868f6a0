"""The mass a robot presents, cycle by cycle: Eqs. 3-14 of the paper over Pinocchio.

    v = J_v qd                     velocity of the contact point (Eq. 1)
    A = J_v M^-1 J_v^T             mobility: the inverse of the operational mass matrix (Eqs. 3-4)
    m_n = 1 / (n^T A n)            effective mass along the unit vector n (Eqs. 5-8)

The worst direction's mass is one over A's smallest eigenvalue within the directions the contact point can reach.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin

from scara_effmass.errors import RobotError
from scara_effmass.model.lumping import LumpedModel, lump
from scara_effmass.values import NAN

if TYPE_CHECKING:
    from scara_effmass.model.robot import Robot
    from scara_effmass.values import FloatArray, Vector3

REACHED = 1e-9
"""Share of the largest singular value below which a direction of motion counts as out of reach."""
STILL_M = 1e-9
"""Lever [m] below which a massless joint does not move the contact point."""


class Presented(NamedTuple):
    """What one contact point presents at one joint state [m/s, kg].

    `direction` is the zero vector and `lumped`, `full` are those of the worst direction where the speed is below
    the threshold. A mass is `inf` in a direction that no joint moves, NaN where its model has no answer
    (`lumped_reason` then says why, for this state).
    """

    speed: float
    direction: Vector3
    lumped: float
    full: float
    worst_lumped: float
    worst_full: float
    smallest_singular_value: float
    lumped_reason: str


class Arm:
    """One robot with its models, ready to be asked once per joint state. Not safe to share between threads.

    `lumped_reason` and `full_reason` say why that model does not exist for this robot; they are empty where it does.
    """

    def __init__(self, robot: Robot) -> None:
        """Build the models of `robot`."""
        self.robot = robot
        self.lumped: LumpedModel | None = None
        self.lumped_reason = ""
        try:
            self.lumped = lump(robot)
        except RobotError as error:
            self.lumped_reason = str(error)
        self.full_reason = _full_reason(robot)
        self._models = [
            model
            for model in (
                None if self.lumped is None else self.lumped.model,
                None if self.full_reason else robot.model,
            )
            if model is not None
        ]
        self._data = [model.createData() for model in self._models]
        self._kinematics = robot.model.createData()
        n = robot.model.nv
        # One slot per model, and the identity, which makes J_v J_v^T come out of the same product.
        self._inverses = np.zeros((len(self._models) + 1, n, n))
        self._inverses[-1] = np.eye(n)
        self._massless = () if self.lumped is None else self.lumped.massless
        self._contacts = tuple((name, frame, 3 - self._rank(frame)) for name, frame in robot.contact_frames.items())

    @property
    def contact_points(self) -> tuple[str, ...]:
        """Names of the watched points, in the order of `presented`."""
        return tuple(name for name, _, _ in self._contacts)

    def presented(self, q: FloatArray, qd: FloatArray, speed_threshold: float) -> list[Presented]:
        """Return what each contact point presents at `q` (n,) [rad, m], moving with `qd` (n,).

        Below `speed_threshold` [m/s] a point has no direction, and its masses are those of the worst one.
        """
        inverses = self._inverses
        for slot, (model, data) in enumerate(zip(self._models, self._data, strict=True)):
            inverses[slot] = pin.computeMinverse(model, data, q)
        return [self._at_contact(q, qd, frame, lowest, speed_threshold) for _, frame, lowest in self._contacts]

    def _at_contact(self, q: FloatArray, qd: FloatArray, frame: int, lowest: int, speed_threshold: float) -> Presented:
        jacobian = self.jacobian(q, frame)
        vx, vy, vz = jacobian.dot(qd).tolist()
        speed = (vx * vx + vy * vy + vz * vz) ** 0.5
        mobilities = np.matmul(np.matmul(jacobian, self._inverses), jacobian.T)
        worst = [1.0 / e if e > 0.0 else np.inf for e in np.linalg.eigvalsh(mobilities)[:, lowest].tolist()]
        singular = (1.0 / worst[-1]) ** 0.5
        if speed < speed_threshold:
            direction: Vector3 = (0.0, 0.0, 0.0)
            along = worst
        else:
            direction = (vx / speed, vy / speed, vz / speed)
            along = [_along(a, direction) for a in mobilities.tolist()]
        full = worst_full = lumped = worst_lumped = NAN
        reason = self.lumped_reason
        if not self.full_reason:
            full, worst_full = along[-2], worst[-2]
        if self.lumped is not None:
            lumped, worst_lumped = along[0], worst[0]
            for joint in self._massless:
                x, y, z = jacobian[:, joint].tolist()
                if x * x + y * y + z * z > STILL_M * STILL_M:
                    worst_lumped = NAN
                    nx, ny, nz = direction
                    if direction == (0.0, 0.0, 0.0) or abs(nx * x + ny * y + nz * z) > STILL_M:
                        lumped = NAN
                        reason = f"{self.robot.joint_names[joint]} moves the contact point along n, but no lumped mass"
        return Presented(speed, direction, lumped, full, worst_lumped, worst_full, singular, reason)

    def jacobian(self, q: FloatArray, frame: int) -> FloatArray:
        """Return J_v (3, n), the linear velocity of Pinocchio's frame `frame` in base axes per joint velocity."""
        full: FloatArray = pin.computeFrameJacobian(
            self.robot.model, self._kinematics, q, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        return full[:3]

    def _rank(self, frame: int) -> int:
        """Return in how many dimensions the contact point can move, outside singular poses."""
        values = [np.linalg.svd(self.jacobian(q, frame), compute_uv=False) for q in self.robot.sample_configurations()]
        rank = max(int(np.sum(s > REACHED * s[0])) for s in values)
        if rank == 0:
            raise RobotError(f"{self.robot.origin}: no joint moves contact frame {frame}")
        return rank


def _along(mobility: list[list[float]], direction: Vector3) -> float:
    """m_n = 1 / (n^T A n), Eq. 8; infinite where no joint moves the point along n."""
    (a, b, c), (_, d, e), (_, _, f) = mobility
    x, y, z = direction
    inverse = a * x * x + d * y * y + f * z * z + 2.0 * (b * x * y + c * x * z + e * y * z)
    return 1.0 / inverse if inverse > 0.0 else np.inf


def _full_reason(robot: Robot) -> str:
    if robot.inertias_reason:
        return robot.inertias_reason
    data = robot.model.createData()
    for q in robot.sample_configurations():
        matrix = pin.crba(robot.model, data, q)
        scale = np.sqrt(np.diag(matrix).clip(min=0.0))
        if np.any(scale == 0.0):
            joint = robot.joint_names[int(np.flatnonzero(scale == 0.0)[0])]
            return f"{joint} moves no inertia: give its link an inertia or the joint an armature"
        if np.linalg.eigvalsh(matrix / np.outer(scale, scale))[0] < 1e-12:
            return f"the mass matrix is not positive definite at q = {np.round(q, 3).tolist()}"
    return ""
