# SPDX-License-Identifier: Apache-2.0
"""Effective mass of a serial robot at its contact points, per joint state (Eqs. 3-14 of the paper, over Pinocchio).

    v = J_v qd                     velocity of the contact point (Eq. 1)
    A = J_v M^-1 J_v^T             mobility, the inverse of the operational mass matrix (Eqs. 3-4)
    m_n = 1 / (n^T A n)            effective mass along the unit vector n (Eqs. 5-8)

The mass of the worst direction is the inverse of A's smallest eigenvalue within the directions that the contact point
can move in. The paper is cited in `scara_effmass.model`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from scara_effmass.errors import RobotError
from scara_effmass.iso15066.mobility_matrix import Matrix, is_bounded, mobility_along
from scara_effmass.iso15066.pose_change import PoseChange
from scara_effmass.model.lumping import LumpedModel, lump
from scara_effmass.model.robot import Robot
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import NAN, ZERO_VECTOR, FloatArray, Vector3

RANK_TOLERANCE = 1e-9
"""Fraction of the largest singular value of J_v below which a direction counts as unreachable."""
MAX_NEGATIVE = 1e-6
"""Ratio of a negative eigenvalue of a mobility to its trace, up to which it counts as rounding."""
EIGENVALUE_ROUNDING = 1e-12
"""Ratio of an eigenvalue of J_v J_v^T to its trace, up to which it counts as 0: its root would be rounding."""
MIN_LEVER_M = 1e-9
"""Lever [m] below which a joint does not move the contact point."""
LUMPED_NOT_DEFINITE = "the lumped mass matrix is singular or not positive definite at this pose"
_WORLD_AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
_THIRD_TURN = 2.0 * math.pi / 3.0


class EffectiveMasses(NamedTuple):
    """Effective masses [kg], speed [m/s] and direction of one contact point at one joint state.

    Below the speed threshold `direction` is zero, and `lumped` and `full` are the masses of the worst direction.
    A mass is infinite in a direction that no joint moves, and NaN if its model does not cover this state;
    `lumped_reason` then states why. The mobilities A = J_v M^-1 J_v^T [1/kg] of a model are symmetric (3, 3) lists, of
    which `rank` eigenvalues are not 0 outside singular poses; empty without the model. `speed_tolerance` [m/s]
    bounds the error of the speed that the stated errors of the joint velocities can cause. The changes of pose are
    None for models that `RobotDynamics.effective_masses` was not asked for, and at rest.
    """

    speed: float
    direction: Vector3
    lumped: float
    full: float
    smallest_singular_value: float
    lumped_reason: str
    lumped_mobility: Matrix
    full_mobility: Matrix
    rank: int
    has_massless_direction: bool
    speed_tolerance: float
    lumped_change: PoseChange | None = None
    full_change: PoseChange | None = None

    @property
    def worst_lumped(self) -> float:
        """Largest lumped mass over all directions [kg]; NaN where a joint that moves no lumped mass moves the point."""
        return NAN if self.has_massless_direction else _worst_mass(self.lumped_mobility, self.rank)

    @property
    def worst_full(self) -> float:
        """Largest full mass over all directions in which the contact point can move [kg]."""
        return _worst_mass(self.full_mobility, self.rank)

    def lumped_is_heavy_enough(self, margin: float) -> bool:
        """Return whether both models exist and, along every normal, lumped mass >= (1 - margin) full mass.

        Then it holds for the worst direction, and for the reduced mass with any body part along the worst normal.
        """
        lumped = [] if self.has_massless_direction else self.lumped_mobility
        return _is_heavy_enough(lumped, self.full_mobility, margin)


class ModelMass(NamedTuple):
    """Mass of one model along the velocity, and along the worst direction [kg], with its mobility [1/kg].

    ISO's fixed mass has an empty mobility. `change` is that of the pose; None where it does not count.
    """

    name: str
    mass: float
    worst_mass: float
    mobility: Matrix
    change: PoseChange | None


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
        models = {} if self.lumped is None else {"lumped": self.lumped.model}
        if not self.full_reason:
            models["full"] = robot.model
        self._models = {name: (model, model.createData()) for name, model in models.items()}
        self._coupled_rotors = bool(robot.rotors.coupling.any())
        self._kinematics = robot.model.createData()
        self._frame_indices = robot.frame_indices()
        self._massless_joints = () if self.lumped is None else self.lumped.massless_joints
        self._lumped_is_regular = self.lumped is None or self.lumped.is_regular
        self.contacts = tuple((name, frame, self._rank(name, frame)) for name, frame in robot.contact_frames.items())
        """Name, Pinocchio's frame and rank of each contact point."""

    def with_payload(self, settings: MonitorSettings) -> RobotDynamics:
        """Return the dynamics of the same robot with the load of `settings`."""
        return RobotDynamics(self.robot.rebuild(settings))

    @property
    def contact_points(self) -> tuple[str, ...]:
        """Names of the contact points, in the order of `effective_masses`."""
        return tuple(name for name, _, _ in self.contacts)

    def effective_masses(
        self,
        q: FloatArray,
        qd: FloatArray,
        speed_threshold: float,
        velocity_tolerance: Sequence[float] = (),
        changes: Container[str] = (),
        margin: float | None = None,
    ) -> list[EffectiveMasses]:
        """Return the effective masses of each contact point at `q` (n,) [rad, m] and `qd` (n,), Eqs. 3-14.

        A contact point slower than `speed_threshold` [m/s] has no direction; its masses are of the worst direction.
        `velocity_tolerance` (n,) bounds the errors of `qd`; empty: no errors. `changes` names the models, lumped or
        full, whose change of pose is computed; with `margin` only that of the lumped one where
        `EffectiveMasses.lumped_is_heavy_enough`, else only that of the full one.
        """
        pairs = list(self._models.values())
        inverses = [self._inverse(model, data, q) for model, data in pairs]
        chosen = [name in changes for name in self._models]
        matrices: list[FloatArray | None] = [None for _ in inverses]

        def coriolis(index: int) -> FloatArray:
            matrix = matrices[index]
            if matrix is None:
                model, data = pairs[index]
                matrix = matrices[index] = pin.computeCoriolisMatrix(model, data, q, qd)
            return matrix

        # The Coriolis matrix comes with J and dJ/dt.
        kinematics = self._kinematics
        if any(chosen):
            coriolis(chosen.index(True))
            kinematics = pairs[chosen.index(True)][1]
        else:
            pin.computeJointJacobians(self.robot.model, kinematics, q)
        rates = qd.tolist()
        return [
            self._at_contact(
                rates, kinematics, frame, rank, inverses, chosen, coriolis, speed_threshold, velocity_tolerance, margin
            )
            for _, frame, rank in self.contacts
        ]

    def _at_contact(
        self,
        qd: list[float],
        kinematics: pin.Data,
        frame: int,
        rank: int,
        inverses: list[FloatArray],
        chosen: list[bool],
        coriolis: Callable[[int], FloatArray],
        speed_threshold: float,
        velocity_tolerance: Sequence[float],
        margin: float | None,
    ) -> EffectiveMasses:
        # Few calls of numpy, because each costs more than the products of a row; the rest uses the rows as lists.
        jacobian = self._jacobian(frame, kinematics)
        rows: Matrix = jacobian.tolist()
        vx, vy, vz = _times(rows, qd)
        speed = math.sqrt(vx * vx + vy * vy + vz * vz)
        moving = speed >= speed_threshold and speed > 0.0
        direction = (vx / speed, vy / speed, vz / speed) if moving else ZERO_VECTOR
        responses = [jacobian.dot(inverse) for inverse in inverses]  # J_v M^-1
        response_rows: list[Matrix] = [response.tolist() for response in responses]
        mobilities = [_symmetric(rows, response) for response in response_rows]
        lumped_mobility = mobilities[0] if self.lumped is not None else []
        full_mobility = mobilities[-1] if not self.full_reason else []
        reason = self.lumped_reason
        if not self._lumped_is_regular and not _is_definite(lumped_mobility, rank):
            lumped_mobility, reason = [], LUMPED_NOT_DEFINITE
        if moving:
            lumped, full = effective_mass(lumped_mobility, direction), effective_mass(full_mobility, direction)
        else:
            lumped, full = _worst_mass(lumped_mobility, rank), _worst_mass(full_mobility, rank)
        has_massless_direction = False
        for joint in self._massless_joints:
            x, y, z = rows[0][joint], rows[1][joint], rows[2][joint]
            if x * x + y * y + z * z > MIN_LEVER_M * MIN_LEVER_M:
                has_massless_direction = True
                nx, ny, nz = direction
                if not moving or abs(nx * x + ny * y + nz * z) > MIN_LEVER_M:
                    lumped = NAN
                    reason = massless_text(self.robot.joint_names[joint])
        if margin is not None and len(chosen) > 1:
            takes_lumped = _is_heavy_enough([] if has_massless_direction else lumped_mobility, full_mobility, margin)
            chosen = [chosen[0] and takes_lumped, chosen[1] and not takes_lumped]
        changes: list[PoseChange | None] = [None for _ in chosen]
        if moving and any(chosen):
            jacobian_rate = self._jacobian_rate(frame, kinematics)
            held = _times(jacobian_rate.tolist(), qd)
            for i, response in enumerate(responses):
                if chosen[i]:
                    # K = dJ/dt - J M^-1 C: K qd accelerates the point of free joints, and dA/dt = Z + Z^T.
                    rate: Matrix = (jacobian_rate - response.dot(coriolis(i))).tolist()
                    turning = [[_dot(row, column) for column in response_rows[i]] for row in rate]
                    accelerations = _times(rate, qd), held
                    changes[i] = PoseChange(direction, speed, mobilities[i], turning, accelerations, rank)
        squares = _symmetric(rows, rows)
        square = smallest_eigenvalue(squares, rank)
        singular = math.sqrt(square) if square > EIGENVALUE_ROUNDING * _trace(squares) else 0.0
        # By position, because keywords cost time in the hot path.
        return EffectiveMasses(
            speed,
            direction,
            lumped,
            full,
            singular,
            reason,
            lumped_mobility,
            full_mobility,
            rank,
            has_massless_direction,
            _speed_tolerance(rows, velocity_tolerance),
            changes[0] if self.lumped is not None else None,
            changes[-1] if not self.full_reason else None,
        )

    def composite_mass(
        self, q: FloatArray, qd: FloatArray, contact: int, name: str, masses: EffectiveMasses
    ) -> ModelMass:
        """Return the mass of the arm at `q` and `qd` (n,) if a controller of its own holds each joint.

        The mobility is J_v D^-1 J_v^T with the diagonal D of M. `contact` is an index of `contact_points`, `name` the
        model, lumped or full, and `masses` are those of the same joint state.
        """
        model, data = self._models[name]
        _, frame, rank = self.contacts[contact]
        pin.computeJointJacobiansTimeVariation(self.robot.model, self._kinematics, q, qd)
        jacobian, jacobian_rate = self._jacobian(frame, self._kinematics), self._jacobian_rate(frame, self._kinematics)
        response = jacobian.T / np.diagonal(self.robot.mass_matrix(model, data, q))[:, None]
        mobility: Matrix = (jacobian @ response).tolist()
        worst_mass = _worst_mass(mobility, rank)
        if masses.direction == ZERO_VECTOR:
            return ModelMass(name, worst_mass, worst_mass, mobility, None)
        coriolis = np.diagonal(pin.computeCoriolisMatrix(model, data, q, qd))
        rate = ((jacobian_rate - response.T * coriolis) @ response).tolist()
        x, y, z = (jacobian_rate @ qd).tolist()
        change = PoseChange(masses.direction, masses.speed, mobility, rate, ((x, y, z),), rank)
        return ModelMass(name, effective_mass(mobility, masses.direction), worst_mass, mobility, change)

    def in_base(self, q: FloatArray, vector: Vector3, frame: str, setting: str = "contact_normal_frame") -> Vector3:
        """Return `vector` (3,) of the robot's `frame` in base axes at `q`.

        Raises RobotError for an unknown frame, which `setting` names.
        """
        model = self.robot.model
        if frame in {"", self.robot.base_frame}:
            return vector
        if frame not in self._frame_indices:
            names = ", ".join(dict.fromkeys(frame.name for frame in model.frames))
            raise RobotError(f"{self.robot.origin}: {setting} = {frame!r}: must be one of {names}")
        pin.framesForwardKinematics(model, self._kinematics, q)
        x, y, z = (self._kinematics.oMf[self._frame_indices[frame]].rotation @ vector).tolist()
        return x, y, z

    def drive_acceleration(self, q: FloatArray, contact: int) -> float:
        """Return the largest acceleration [m/s2] of a contact point that the effort limits of the joints allow.

        That is sum_i |J_v M^-1 e_i| (tau_max,i + |g_i(q)|) over the joints, in the model with the larger sum; infinite
        if an effort limit is unknown. `contact` is an index of `contact_points`. Gravity acts along -z of the base.
        """
        jacobian = self.jacobian(q, self.contacts[contact][1])
        effort = self.robot.effort_limits + np.abs(self._gravity(q))
        if not np.isfinite(effort).all():
            return math.inf
        inverses = [self._inverse(model, data, q) for model, data in self._models.values()]
        sums = [float(np.linalg.norm(jacobian @ inverse, axis=0) @ effort) for inverse in inverses]
        return max(sums, default=math.inf)

    def clamping_force(self, q: FloatArray, contact: int, *directions: Vector3) -> float:
        """Return the largest static force [N] along one of the unit vectors `directions` that the joints can hold.

        J^T n F + g(q) = tau with |tau_i| <= tau_max,i: the smallest (tau_max,i - s_i g_i) / |(J^T n)_i| over the
        joints, s_i the sign of (J^T n)_i. 0 along a direction in which no joint pushes; infinite without effort limits,
        and where they cannot carry the weight: then they are not those of the drives.
        """
        if (np.abs(self._gravity(q)) > self.robot.effort_limits).any():
            return math.inf
        return max([0.0, *self._static_forces(q, contact, directions)])

    def holding_force(self, q: FloatArray, contact: int, *directions: Vector3) -> float:
        """Return the static force [N] up to which no joint reaches its effort limit, along any of `directions`.

        As `clamping_force`, but the smallest one: negative where the weight alone is too much for a joint, infinite
        without effort limits and where no joint pushes.
        """
        return min(self._static_forces(q, contact, directions), default=math.inf)

    def _static_forces(self, q: FloatArray, contact: int, directions: Sequence[Vector3]) -> list[float]:
        """Return the static force [N] along each of `directions` in which a joint pushes."""
        jacobian, gravity = self.jacobian(q, self.contacts[contact][1]), self._gravity(q)
        forces = []
        for direction in directions:
            lever = direction @ jacobian
            loaded = np.abs(lever) > MIN_LEVER_M
            if loaded.any():
                margin = self.robot.effort_limits - np.sign(lever) * gravity
                forces.append(float(np.min(margin[loaded] / np.abs(lever[loaded]))))
        return forces

    def _gravity(self, q: FloatArray) -> FloatArray:
        return np.asarray(pin.computeGeneralizedGravity(self.robot.model, self._kinematics, q))

    def position(self, q: FloatArray, frame: int) -> FloatArray:
        """Return the position (3,) [m] of Pinocchio's `frame` in base axes."""
        pin.framesForwardKinematics(self.robot.model, self._kinematics, q)
        return np.array(self._kinematics.oMf[frame].translation)

    def jacobian(self, q: FloatArray, frame: int) -> FloatArray:
        """Return J_v (3, n): linear velocity of Pinocchio's `frame` in base axes, per joint velocity."""
        pin.computeJointJacobians(self.robot.model, self._kinematics, q)
        return self._jacobian(frame, self._kinematics)

    def _jacobian(self, frame: int, data: pin.Data) -> FloatArray:
        """Return J_v (3, n) at the configuration of the latest `computeJointJacobians` on `data`."""
        jacobian: FloatArray = pin.getFrameJacobian(self.robot.model, data, frame, _WORLD_AXES)
        linear = jacobian[:3]
        return linear if linear.ndim > 1 else linear[:, None]  # Pinocchio returns a vector for a single joint

    def _jacobian_rate(self, frame: int, data: pin.Data) -> FloatArray:
        """Return dJ_v/dt (3, n) of the latest `computeJointJacobiansTimeVariation` on `data`."""
        rate: FloatArray = pin.getFrameJacobianTimeVariation(self.robot.model, data, frame, _WORLD_AXES)
        linear = rate[:3]
        return linear if linear.ndim > 1 else linear[:, None]

    def _inverse(self, model: pin.Model, data: pin.Data, q: FloatArray) -> FloatArray:
        """Return the inverse (n, n) of the mass matrix of `model`, this robot's or its lumped copy."""
        if self._coupled_rotors:
            return np.asarray(np.linalg.inv(self.robot.mass_matrix(model, data, q)), dtype=np.float64)
        inverse: FloatArray = pin.computeMinverse(model, data, q)
        return inverse

    def _rank(self, name: str, frame: int) -> int:
        """Return in how many dimensions the contact point can move outside singular poses."""
        jacobians = [self.jacobian(q, frame) for q in self.robot.sample_configurations()]
        values = np.linalg.svd(np.array(jacobians), compute_uv=False)
        rank = int(np.sum(values > max(RANK_TOLERANCE * values.max(), MIN_LEVER_M), axis=1).max())
        if rank == 0:
            raise RobotError(
                f"{self.robot.origin}: contact point {name}: must not lie on the axis of every joint that moves it"
            )
        return rank


def _dot(a: list[float], b: list[float]) -> float:
    total = 0.0
    for x, y in zip(a, b):  # noqa: B905 - mypyc has no fast loop for zip with keywords
        total += x * y
    return total


def _times(rows: Matrix, vector: list[float]) -> Vector3:
    return _dot(rows[0], vector), _dot(rows[1], vector), _dot(rows[2], vector)


def _speed_tolerance(jacobian: Matrix, velocity_tolerance: Sequence[float]) -> float:
    """Return the error of the speed [m/s] that errors of the joint velocities up to `velocity_tolerance` can cause."""
    tolerance = 0.0
    for joint_tolerance, x, y, z in zip(velocity_tolerance, jacobian[0], jacobian[1], jacobian[2]):  # noqa: B905
        tolerance += joint_tolerance * math.sqrt(x * x + y * y + z * z)
    return tolerance


def _symmetric(left: Matrix, right: Matrix) -> Matrix:
    """Return the product (3, 3) of `left` (3, n) and the transposed `right` (3, n), which is symmetric."""
    x, y, z = left
    u, v, w = right
    b, c, e = _dot(x, v), _dot(x, w), _dot(y, w)
    return [[_dot(x, u), b, c], [b, _dot(y, v), e], [c, e, _dot(z, w)]]


def _trace(matrix: Matrix) -> float:
    return matrix[0][0] + matrix[1][1] + matrix[2][2]


def smallest_eigenvalue(matrix: Matrix, rank: int) -> float:
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


def _worst_mass(mobility: Matrix, rank: int) -> float:
    """Return the largest effective mass over all directions [kg]: infinite at a singular pose, NaN without a model."""
    if not mobility:
        return NAN
    min_mobility = smallest_eigenvalue(mobility, rank)
    return 1.0 / min_mobility if min_mobility > 0.0 else math.inf


def _is_definite(mobility: Matrix, rank: int) -> bool:
    """Return whether no mass is negative; False for a mobility that is not finite."""
    trace = _trace(mobility)
    return 0.0 < trace < math.inf and smallest_eigenvalue(mobility, rank) > -MAX_NEGATIVE * trace


def _is_heavy_enough(lumped: Matrix, full: Matrix, margin: float) -> bool:
    """Return whether both mobilities exist and, along every normal, lumped mass >= (1 - margin) full mass."""
    return bool(lumped) and bool(full) and is_bounded(lumped, full, 1.0 - margin)


def effective_mass(mobility: Matrix, direction: Vector3) -> float:
    """Return the effective mass along n, m_n = 1 / (n^T A n) (Eq. 8).

    Infinite if no joint moves the point along n, NaN without a model.
    """
    if not mobility:
        return NAN
    inverse = mobility_along(mobility, direction)
    return 1.0 / inverse if inverse > 0.0 else math.inf


def massless_text(joint: str) -> str:
    """Return why there is no lumped mass along a direction in which `joint` moves the contact point."""
    return f"{joint} moves the contact point along n, but no lumped mass"


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
