# SPDX-License-Identifier: Apache-2.0
"""Dynamics of a robot at one joint state, and the effective mass of its contact points (Eqs. 1-14 of the paper).

    v = J_v qd                     velocity of the contact point (Eq. 1)
    A = J_v M^-1 J_v^T             mobility, the inverse of the operational mass matrix (Eqs. 3-4)
    m_n = 1 / (n^T A n)            effective mass along the unit vector n (Eqs. 5-8)

M is the mass matrix of the full model, or Eq. 14 of the lumped one. The paper is cited in `scara_effmass.model`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from itertools import combinations, product
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from scara_effmass.codes import ModelCode, NoLumpedMass
from scara_effmass.errors import RobotError
from scara_effmass.model.lumping import LumpedModel, lump
from scara_effmass.model.robot import Robot
from scara_effmass.reference.hull import Hull, farthest, point_maps
from scara_effmass.reference.mobility import Mobility, PoseChange, effective_mass, is_definite, worst_mass
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import FloatArray, Vector3

MIN_LEVER_M = 1e-9
"""Lever [m] below which a joint does not move the contact point."""
X_AXIS: FloatArray = np.eye(3)[0]
"""Direction of a contact at rest, whose mass is that of the worst direction anyway."""
NO_VERTICES: FloatArray = np.empty((0, 3))
SINGULAR_ROUNDING = 1e-6
"""Ratio of a singular value of J_v to its Frobenius norm, up to which it counts as 0."""
EFFORT_ROUNDING = 1e-9
"""Ratio by which a joint may exceed its effort limit where rounding makes it so."""
RANK_TOLERANCE = 1e-5
"""Fraction of the largest singular value of J_v below which a direction counts as unreachable.

Axes that meet in a point miss it by the rounded angles of a file: 1.5708 in place of pi / 2 by 4e-6.
"""


class ContactPoint(NamedTuple):
    """Name, Pinocchio's frame, and the dimensions in which a contact point can move outside singular poses.

    With `vertices` (V, 3) [m], in the frame of the joint that carries the frame, it is their hull, a whole link.
    """

    name: str
    frame: int
    rank: int
    vertices: FloatArray = NO_VERTICES


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


class PoseState:
    """Quantities of a robot at `q` and `qd` (n,), computed once: J, dJ/dt, M, M^-1, C and g, per model and contact."""

    def __init__(self, dynamics: RobotDynamics, q: FloatArray, qd: FloatArray) -> None:
        """Compute them."""
        self.dynamics, self.q, self.qd = dynamics, q, qd
        robot = dynamics.robot
        self.mass_matrix: dict[ModelCode, FloatArray] = {}
        self.inverse_mass_matrix: dict[ModelCode, FloatArray] = {}
        self.coriolis: dict[ModelCode, FloatArray] = {}
        for name, model in dynamics.models.items():
            data = model.createData()
            self.mass_matrix[name] = robot.mass_matrix(model, data, q).copy()
            self.inverse_mass_matrix[name] = np.linalg.inv(self.mass_matrix[name]).astype(float)
            self.coriolis[name] = np.reshape(pin.computeCoriolisMatrix(model, data, q, qd), 2 * q.shape)
        self.gravity = np.array(pin.computeGeneralizedGravity(robot.model, robot.model.createData(), q))
        self.data = robot.model.createData()
        pin.computeJointJacobiansTimeVariation(robot.model, self.data, q, qd)
        pin.framesForwardKinematics(robot.model, self.data, q)
        self.contacts = tuple(ContactState(self, point) for point in dynamics.contacts)

    def in_base(self, vector: Vector3, frame: str, setting: str = "contact_normal_frame") -> FloatArray:
        """Return `vector` of the robot's `frame` in base axes. Raises RobotError for an unknown frame."""
        index = self.dynamics.frame_index(frame, setting)
        return np.array(vector) if index is None else self.data.oMf[index].rotation @ np.array(vector)


class ContactState:
    """One contact point at one joint state: `jacobian` J_v and `jacobian_rate` dJ_v/dt (3, n), velocity and speed.

    A link counts at one `vertex` of its hull, by default the fastest. `is_moved_by` (n,) holds of the joints between
    base and point.
    """

    def __init__(self, state: PoseState, point: ContactPoint, vertex: int | None = None) -> None:
        """Compute kinematics; masses follow on demand."""
        self.state, self.point, self.name, self.rank = state, point, point.name, point.rank
        model, data, axes = state.dynamics.robot.model, state.data, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        frame = model.frames[point.frame]
        self.joint = joint = frame.parentJoint
        size = 6, model.nv
        # Pinocchio returns a vector for a single joint.
        self.link_jacobian = np.reshape(pin.getJointJacobian(model, data, joint, axes), size)
        link_rate = np.reshape(pin.getJointJacobianTimeVariation(model, data, joint, axes), size)
        self.twist: FloatArray = self.link_jacobian @ state.qd
        pose = data.oMi[joint]
        self.vertices: FloatArray = point.vertices @ pose.rotation.T
        self.maps = point_maps(self.vertices)
        self.vertex = vertex
        if vertex is None and len(self.vertices):
            self.vertex = farthest(np.sum((self.maps @ self.twist) ** 2, axis=1))
        self.worst_vertex = self.vertex or 0
        lever = pose.rotation @ frame.placement.translation if self.vertex is None else self.vertices[self.vertex]
        (to_point,) = point_maps(lever[None])
        self.jacobian: FloatArray = to_point @ self.link_jacobian
        spin = pin.skew(np.cross(self.twist[3:], lever))
        self.jacobian_rate: FloatArray = to_point @ link_rate - spin @ self.link_jacobian[3:]
        self.is_moved_by = np.any(self.link_jacobian, axis=0)
        self.velocity: FloatArray = self.jacobian @ state.qd
        """v = J_v qd [m/s] (Eq. 1)."""
        self.speed = float(np.linalg.norm(self.velocity))
        self.direction = self.velocity / self.speed if self.speed > 0.0 else None
        """Unit vector n of the velocity; None at rest."""
        self.position: FloatArray = pose.translation + lever
        self.position_in_link = frame.placement.actInv(pose.rotation.T @ lever) if len(self.vertices) else np.zeros(3)

    def at_worst_vertex(self, s: float, threshold: float) -> ContactState:
        """Return the contact at the vertex with the largest v^T (s 1 + A)^-1 v; at rest at that of the largest mass.

        Up to the speed `threshold` [m/s] a vertex is at rest. That only says where the contact counts; at rest, the
        speed is that of the fastest vertex.
        """
        code = next((code for code in (ModelCode.FULL, ModelCode.LUMPED) if code in self.state.mass_matrix), None)
        if self.vertex is None or code is None:
            return self
        jacobians = self.maps @ self.link_jacobian
        mobilities = jacobians @ self.state.inverse_mass_matrix[code] @ jacobians.transpose(0, 2, 1)
        if self.speed < threshold:
            values = np.array([worst_mass(mobility, self.rank) for mobility in mobilities])
        else:
            v = jacobians @ self.state.qd
            values = np.sum(v * np.linalg.solve(s * np.eye(3) + mobilities, v[..., None])[..., 0], axis=1)
        worst = ContactState(self.state, self.point, farthest(values))
        if self.speed < threshold:
            worst.speed = self.speed
        elif worst.speed < threshold:
            self.worst_vertex = worst.worst_vertex
            return self
        return worst

    def hull(self, mass_matrix: FloatArray | None) -> Hull | None:
        """Return the hull of a link with these masses (n, n), None for one mass everywhere; None for a point."""
        if self.vertex is None:
            return None
        if mass_matrix is None:
            return Hull(self.vertices, self.twist, self.vertex)
        inverse, n = np.linalg.inv(mass_matrix), self.joint
        mobility = self.link_jacobian @ inverse @ self.link_jacobian.T
        # The joints beyond the link may move as it costs the least energy: of M^-1 only the first n rows count.
        energy = float(self.state.qd[:n] @ np.linalg.solve(inverse[:n, :n], self.state.qd[:n]))
        return Hull(self.vertices, self.twist, self.vertex, mobility, energy, self.worst_vertex)

    @cached_property
    def smallest_singular_value(self) -> float:
        """Smallest singular value of J_v in the dimensions in which the point moves; 0 at a singular pose."""
        values = np.linalg.svd(self.jacobian, compute_uv=False)
        value = float(values[self.rank - 1])
        return value if value > SINGULAR_ROUNDING * float(np.linalg.norm(values)) else 0.0

    def speed_tolerance(self, velocity_tolerance: Sequence[float]) -> float:
        """Return the error of the speed [m/s] that errors of the joint velocities up to these (n,) can cause."""
        if not len(velocity_tolerance):
            return 0.0
        return float(np.linalg.norm(self.jacobian, axis=0) @ np.asarray(velocity_tolerance))

    @cached_property
    def massless_joints(self) -> tuple[int, ...]:
        """Joints (0-based) that move the contact point, but no lumped mass."""
        lumped = self.state.dynamics.lumped
        joints = () if lumped is None else lumped.massless_joints
        return tuple(joint for joint in joints if np.linalg.norm(self.jacobian[:, joint]) > MIN_LEVER_M)

    @cached_property
    def mobilities(self) -> dict[ModelCode, FloatArray]:
        """A = J_v M^-1 J_v^T [1/kg] (Eqs. 3-4) of each model that has one at this pose."""
        inverses, lumped = self.state.inverse_mass_matrix, self.state.dynamics.lumped
        mobilities = {name: self.jacobian @ inverse @ self.jacobian.T for name, inverse in inverses.items()}
        # The lumped mass matrix of parallel axes is definite by its form, others can lose that at a pose.
        if lumped is not None and not lumped.is_regular and not is_definite(mobilities[ModelCode.LUMPED], self.rank):
            del mobilities[ModelCode.LUMPED]
        return mobilities

    def no_lumped_mass(self, n: FloatArray | None) -> int | None:
        """Return the code of `NoLumpedMass` along n, along the worst direction for None; None if there is a mass."""
        for joint in reversed(self.massless_joints):
            if n is None or abs(float(n @ self.jacobian[:, joint])) > MIN_LEVER_M:
                return NoLumpedMass.MASSLESS_JOINT + joint
        if ModelCode.LUMPED in self.mobilities:
            return None
        return NoLumpedMass.NOT_DEFINITE if ModelCode.LUMPED in self.state.mass_matrix else NoLumpedMass.NOT_THERE

    def effective_mass(self, model: ModelCode, n: FloatArray | None) -> float:
        """Return m_n [kg] along the unit vector n (Eq. 8), the largest of all for None; NaN without such a mass.

        It is infinite along a direction in which no joint moves the point.
        """
        if model not in self.mobilities or (model is ModelCode.LUMPED and self.no_lumped_mass(n) is not None):
            return math.nan
        mobility = self.mobilities[model]
        return worst_mass(mobility, self.rank) if n is None else effective_mass(mobility, n)

    @property
    def lumped(self) -> float:
        """Lumped effective mass [kg] along the velocity, the largest of all directions at rest; NaN without one."""
        return self.effective_mass(ModelCode.LUMPED, self.direction)

    @property
    def full(self) -> float:
        """Full effective mass [kg] along the velocity, the largest of all directions at rest; NaN without one."""
        return self.effective_mass(ModelCode.FULL, self.direction)

    def mobility(self, model: ModelCode, n: FloatArray | None) -> Mobility:
        """Return the mobility of free joints for a contact along n at the current speed; at rest for None.

        dA/dt = K M^-1 J_v^T + its transpose with K = dJ_v/dt - J_v M^-1 C, because dM/dt = C + C^T.
        """
        response = self.jacobian @ self.state.inverse_mass_matrix[model]  # J_v M^-1
        turning = self.jacobian_rate - response @ self.state.coriolis[model]
        free, held = turning @ self.state.qd, self.jacobian_rate @ self.state.qd
        found = self._mobility(self.mobilities[model], turning @ response.T, (free, held), n)
        return replace(found, hull=self.hull(self.state.mass_matrix[model]))

    def held_mobility(self, model: ModelCode, n: FloatArray | None) -> Mobility:
        """Return the mobility J_v D^-1 J_v^T of joints that a controller each holds, D the diagonal of M.

        dD/dt = 2 diag(C); the joints keep their velocities.
        """
        response = self.jacobian / np.diagonal(self.state.mass_matrix[model])
        turning = self.jacobian_rate - response * np.diagonal(self.state.coriolis[model])
        held = self.jacobian_rate @ self.state.qd
        found = self._mobility(response @ self.jacobian.T, turning @ response.T, (held,), n)
        diagonal = np.diag(np.diagonal(self.state.mass_matrix[model]))
        return replace(found, hull=self.hull(diagonal))

    def uniform_mobility(self, mass: float, n: FloatArray | None) -> Mobility:
        """Return the mobility of one `mass` [kg] in every direction for a contact along n; at rest for None.

        The mass stays as the pose changes, the velocity of the point does not.
        """
        if n is None:
            return Mobility.of_matrix(np.eye(3) / mass, X_AXIS, len(X_AXIS))
        change = PoseChange(self.speed, np.zeros((3, 3)), (self.jacobian_rate @ self.state.qd,))
        return replace(Mobility.of_matrix(np.eye(3) / mass, n, len(X_AXIS), change), hull=self.hull(None))

    def _mobility(
        self, matrix: FloatArray, rate: FloatArray, accelerations: tuple[FloatArray, ...], n: FloatArray | None
    ) -> Mobility:
        if n is None:
            return Mobility.of_matrix(matrix, X_AXIS, self.rank)
        return Mobility.of_matrix(matrix, n, self.rank, PoseChange(self.speed, rate + rate.T, accelerations))

    def drive_acceleration(self) -> float:
        """Return an upper bound [m/s2] of the acceleration of the point under the effort limits of the joints.

        That is sum_i |J_v M^-1 e_i| (tau_max,i + |g_i(q)|) in the model with the larger sum; infinite if an effort
        limit is unknown, or below the gravity effort of its joint. Gravity acts along -z of the base.
        """
        effort = self.state.dynamics.robot.effort_limits + np.abs(self.state.gravity)
        if not np.isfinite(effort).all() or not self._carries_weight:
            return math.inf
        inverses = self.state.inverse_mass_matrix.values()
        return max(
            (float(np.linalg.norm(self.jacobian @ inverse, axis=0) @ effort) for inverse in inverses), default=math.inf
        )

    @property
    def _carries_weight(self) -> bool:
        """Whether no effort limit is below the gravity effort of its joint: it cannot be that of the drive."""
        return bool((np.abs(self.state.gravity) <= self.state.dynamics.robot.effort_limits).all())

    def static_forces(self, directions: Sequence[FloatArray]) -> list[float]:
        """Return the largest static force [N] along each unit vector in which a joint pushes.

        J_v^T n F + g(q) = tau with |tau_i| <= tau_max,i: the smallest (tau_max,i - s_i g_i) / |(J_v^T n)_i| over the
        joints, s_i the sign of (J_v^T n)_i. Negative where the weight alone is too much for a joint. Directions in
        which no joint pushes are left out, so the list may be shorter than `directions`.
        """
        limits, forces = self.state.dynamics.robot.effort_limits, []
        for n in directions:
            lever = n @ self.jacobian
            loaded = np.abs(lever) > MIN_LEVER_M
            if loaded.any():
                margin = limits - np.sign(lever) * self.state.gravity
                forces.append(float(np.min(margin[loaded] / np.abs(lever[loaded]))))
        return forces

    def clamping_force(self, directions: Sequence[FloatArray]) -> float:
        """Return the largest of the `static_forces` [N] along `directions`, 0 if no joint pushes.

        Infinite if no loaded joint has an effort limit, or if a limit is below the gravity effort of its joint.
        """
        if not self._carries_weight:
            return math.inf
        return max([0.0, *self.static_forces(directions)])

    def largest_clamping_force(self) -> float:
        """Return the largest static force [N] along any direction in which the joints move the point, 0 if they do not.

        It is at a vertex of their force polytope |J_v^T f + g(q)| <= tau_max, which is convex (Chiacchio,
        Bouffard-Vercelli and Pierrot 1997): there one to three joints reach their limits. Infinite if a joint that
        moves the point has no limit, or if a limit is below the gravity effort of its joint.
        """
        loaded = np.linalg.norm(self.jacobian, axis=0) > MIN_LEVER_M
        levers, gravity = self.jacobian.T[loaded], self.state.gravity[loaded]
        limits = self.state.dynamics.robot.effort_limits[loaded]
        if not self._carries_weight or not np.isfinite(limits).all():
            return math.inf
        largest, most = 0.0, (1.0 + EFFORT_ROUNDING) * limits
        for count in (1, 2, 3):
            for joints in map(list, combinations(range(len(limits)), count)):
                inverse = np.linalg.pinv(levers[joints], SINGULAR_ROUNDING)
                for signs in product((1.0, -1.0), repeat=count):
                    force = inverse @ (signs * limits[joints] - gravity[joints])
                    if (np.abs(levers @ force + gravity) <= most).all():
                        largest = max(largest, float(np.linalg.norm(force)))
        return largest

    @property
    def least_holding_force(self) -> float:
        """Force [N] along any unit vector up to which no joint reaches its effort limit."""
        levers = np.linalg.norm(self.jacobian, axis=0)
        loaded = levers > MIN_LEVER_M
        margin = self.state.dynamics.robot.effort_limits - np.abs(self.state.gravity)
        return float(np.min(margin[loaded] / levers[loaded], initial=math.inf))

    def holding_force(self, directions: Sequence[FloatArray]) -> float:
        """Return the force [N] up to which no joint reaches its effort limit, along any of `directions`."""
        return min(self.static_forces(directions), default=math.inf)


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
