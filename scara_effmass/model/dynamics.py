"""Effective mass of a serial robot at its contact points, per joint state (Eqs. 3-14 of the paper, over Pinocchio).

    v = J_v qd                     velocity of the contact point (Eq. 1)
    A = J_v M^-1 J_v^T             mobility, the inverse of the operational mass matrix (Eqs. 3-4)
    m_n = 1 / (n^T A n)            effective mass along the unit vector n (Eqs. 5-8)

The mass of the worst direction is the inverse of A's smallest eigenvalue within the directions that the contact point
can move in. The paper is cited in `scara_effmass.model`.
"""

import math
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from scara_effmass.errors import RobotError
from scara_effmass.model.lumping import LumpedModel, lump
from scara_effmass.model.robot import Robot
from scara_effmass.values import NAN, ZERO_VECTOR, FloatArray, Vector3

RANK_TOLERANCE = 1e-9
"""Fraction of the largest singular value of J_v below which a direction counts as unreachable."""
MIN_LEVER_M = 1e-9
"""Lever [m] below which a joint does not move the contact point."""
_WORLD_AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
_THIRD_TURN = 2.0 * math.pi / 3.0


class EffectiveMasses(NamedTuple):
    """Effective masses [kg], speed [m/s] and direction of one contact point at one joint state.

    Below the speed threshold `direction` is zero, and `lumped` and `full` are the masses of the worst direction.
    A mass is infinite in a direction that no joint moves, and NaN if its model does not cover this state;
    `lumped_reason` then states why.
    """

    speed: float
    direction: Vector3
    lumped: float
    full: float
    worst_lumped: float
    worst_full: float
    smallest_singular_value: float
    lumped_reason: str


class RobotDynamics:
    """Lumped and full model of one robot with Pinocchio's working data. Not thread-safe.

    `lumped` is None, and `lumped_reason` states why, if the robot has no lumped model; likewise `full_reason`.
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
        self._models = [] if self.lumped is None else [self.lumped.model]
        if not self.full_reason:
            self._models.append(robot.model)
        self._data = [model.createData() for model in self._models]
        self._coupled_rotors = bool(robot.rotors.coupling.any())
        self._kinematics = robot.model.createData()
        self._massless_joints = () if self.lumped is None else self.lumped.massless_joints
        self._contacts = tuple((name, frame, self._rank(name, frame)) for name, frame in robot.contact_frames.items())

    @property
    def contact_points(self) -> tuple[str, ...]:
        """Names of the contact points, in the order of `effective_masses`."""
        return tuple(name for name, _, _ in self._contacts)

    def effective_masses(self, q: FloatArray, qd: FloatArray, speed_threshold: float) -> list[EffectiveMasses]:
        """Return the effective masses of each contact point at `q` (n,) [rad, m] and `qd` (n,), Eqs. 3-14.

        A contact point slower than `speed_threshold` [m/s] has no direction; its masses are of the worst direction.
        """
        pin.computeJointJacobians(self.robot.model, self._kinematics, q)
        inverses = [self._inverse(model, data, q) for model, data in zip(self._models, self._data, strict=True)]
        return [self._at_contact(qd, frame, rank, inverses, speed_threshold) for _, frame, rank in self._contacts]

    def _at_contact(
        self, qd: FloatArray, frame: int, rank: int, inverses: list[FloatArray], speed_threshold: float
    ) -> EffectiveMasses:
        jacobian = self._jacobian(frame)
        transposed = jacobian.T
        vx, vy, vz = jacobian.dot(qd).tolist()
        speed = math.sqrt(vx * vx + vy * vy + vz * vz)
        moving = speed >= speed_threshold and speed > 0.0
        direction = (vx / speed, vy / speed, vz / speed) if moving else ZERO_VECTOR
        masses = []
        for inverse in inverses:
            mobility = jacobian.dot(inverse).dot(transposed).tolist()
            min_mobility = smallest_eigenvalue(mobility, rank)
            worst = 1.0 / min_mobility if min_mobility > 0.0 else math.inf
            masses.append((_effective_mass(mobility, direction) if moving else worst, worst))
        full, worst_full = (NAN, NAN) if self.full_reason else masses[-1]
        lumped, worst_lumped = (NAN, NAN) if self.lumped is None else masses[0]
        reason = self.lumped_reason
        for joint in self._massless_joints:
            x, y, z = jacobian[:, joint].tolist()
            if x * x + y * y + z * z > MIN_LEVER_M * MIN_LEVER_M:
                worst_lumped = NAN
                nx, ny, nz = direction
                if not moving or abs(nx * x + ny * y + nz * z) > MIN_LEVER_M:
                    lumped = NAN
                    reason = f"{self.robot.joint_names[joint]} moves the contact point along n, but no lumped mass"
        singular = math.sqrt(max(smallest_eigenvalue(jacobian.dot(transposed).tolist(), rank), 0.0))
        return EffectiveMasses(speed, direction, lumped, full, worst_lumped, worst_full, singular, reason)

    def jacobian(self, q: FloatArray, frame: int) -> FloatArray:
        """Return J_v (3, n): linear velocity of Pinocchio's `frame` in base axes, per joint velocity."""
        pin.computeJointJacobians(self.robot.model, self._kinematics, q)
        return self._jacobian(frame)

    def _jacobian(self, frame: int) -> FloatArray:
        """Return J_v (3, n) at the configuration of the latest `computeJointJacobians`."""
        jacobian: FloatArray = pin.getFrameJacobian(self.robot.model, self._kinematics, frame, _WORLD_AXES)
        linear = jacobian[:3]
        return linear if linear.ndim > 1 else linear[:, None]  # Pinocchio returns a vector for a single joint

    def _inverse(self, model: pin.Model, data: pin.Data, q: FloatArray) -> FloatArray:
        """Return the inverse (n, n) of the mass matrix of `model`, this robot's or its lumped copy."""
        if self._coupled_rotors:
            return np.asarray(np.linalg.inv(self.robot.mass_matrix(model, data, q)), dtype=np.float64)
        inverse: FloatArray = pin.computeMinverse(model, data, q)
        return inverse

    def _rank(self, name: str, frame: int) -> int:
        """Return in how many dimensions the contact point can move outside singular poses."""
        values = np.array(
            [np.linalg.svd(self.jacobian(q, frame), compute_uv=False) for q in self.robot.sample_configurations()]
        )
        rank = int(np.sum(values > max(RANK_TOLERANCE * values.max(), MIN_LEVER_M), axis=1).max())
        if rank == 0:
            raise RobotError(
                f"{self.robot.origin}: contact point {name}: must not lie on the axis of every joint that moves it"
            )
        return rank


def smallest_eigenvalue(matrix: list[list[float]], rank: int) -> float:
    """Return the smallest of the `rank` (1 to 3) largest eigenvalues of a symmetric (3, 3) matrix.

    Closed form (O. K. Smith, "Eigenvalues of a symmetric 3 x 3 matrix", Communications of the ACM 4(4), 168, 1961),
    much faster than `numpy.linalg.eigvalsh`. The error is below 1e-7 of the largest eigenvalue, which is enough because
    a mobility is added to 1 / m_H. Rounding or an indefinite matrix can make the result negative.
    """
    (a, b, c), (_, d, e), (_, _, f) = matrix
    mean = (a + d + f) / 3.0
    if rank == 1:
        return 3.0 * mean
    if rank == 2:
        minors = a * d - b * b + a * f - c * c + d * f - e * e
        largest = 1.5 * mean + math.sqrt(max(2.25 * mean * mean - minors, 0.0))
        return minors / largest if largest > 0.0 else 0.0
    a, d, f = a - mean, d - mean, f - mean
    spread = math.sqrt((a * a + d * d + f * f) / 6.0 + (b * b + c * c + e * e) / 3.0)
    cube = spread * spread * spread
    if cube == 0.0:
        return mean
    determinant = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
    third = math.acos(max(-1.0, min(1.0, 0.5 * determinant / cube))) / 3.0
    return mean + 2.0 * spread * math.cos(third + _THIRD_TURN)


def _effective_mass(mobility: list[list[float]], direction: Vector3) -> float:
    """Return the effective mass along n, m_n = 1 / (n^T A n) (Eq. 8); infinite if no joint moves the point along n."""
    (a, b, c), (_, d, e), (_, _, f) = mobility
    x, y, z = direction
    inverse = a * x * x + d * y * y + f * z * z + 2.0 * (b * x * y + c * x * z + e * y * z)
    return 1.0 / inverse if inverse > 0.0 else math.inf


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
