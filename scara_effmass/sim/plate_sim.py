# SPDX-License-Identifier: Apache-2.0
"""Impact of an arm on a free plate: MuJoCo moves the arm, and an explicit spring models the contact.

MuJoCo reads the robot file by itself: mass matrix and kinematics are independent of the room `model`, which provides
only the joints, their limits and the contact points. The plate has the mass m_H of the body part and moves along its
normal, with friction in every direction.
"""

import math
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

import mujoco
import numpy as np

from scara_effmass.iso15066 import TRANSIENT_S, Limit, contact_time
from scara_effmass.iso15066.drives import servo_reduced_masses
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import ServoSettings
from scara_effmass.sim.collision_sim import GRAVITY, mass_matrix, sim_mjcf
from scara_effmass.values import FloatArray

PHASE_STEP = 0.04
"""Time step times the angular frequency of contact or servo, the larger one; the error of the peak is below 2e-4."""
MAX_STEP_S = 2e-3
"""Longest time step without contact."""
SLIDING = 0.02
"""Slip, over the speed of the point, at which friction reaches half of its coefficient."""
ROUNDS = 60
"""Rounds of the search of the worst velocity of a person."""
TINY = 1e-12
"""Speed [m/s] that counts as none."""
NORMALS = 24
"""Number of plate normals among which the worst one for servo drives is searched."""


class Peak(NamedTuple):
    """Peak `force` [N], its `time` after the first touch [s], and the largest joint motion `turn` by then [rad, m]."""

    force: float
    time: float
    turn: float


class Surface(NamedTuple):
    """Damping ratio of a Kelvin-Voigt contact, with its reduced mass at the first touch, and friction coefficient."""

    damping: float = 0.0
    friction: float = 0.0


ELASTIC = Surface()
AT_REST = np.zeros(3)
"""Velocity of a person who stands still."""


class PlateSim:
    """An arm that touches a plate with one of its contact points."""

    def __init__(self, path: Path, dynamics: RobotDynamics) -> None:
        """Load the robot file `path` of `dynamics`, a URDF or a DH file."""
        self._robot = robot = dynamics.robot
        self.n = robot.model.nv
        if path.suffix == ".yaml":
            self.model = mujoco.MjModel.from_xml_string(sim_mjcf(path))
        else:
            self.model = _urdf_model(path, robot.joint_names)
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        self.model.dof_armature[:] = robot.model.armature
        self.model.dof_damping[:] = 0.0
        self.data = mujoco.MjData(self.model)
        self._nominal = self.model.body_mass.copy(), self.model.body_inertia.copy(), self.model.dof_armature.copy()
        self._jacobian_of_point = np.zeros((3, self.n))
        self._frames = [robot.model.frames[frame] for frame in robot.contact_frames.values()]
        bodies = [int(self.model.jnt_bodyid[frame.parentJoint - 1]) for frame in self._frames]
        self._points = [
            # The body, views of its position and orientation, and the place on it.
            (body, self.data.xpos[body], self.data.xmat[body].reshape(3, 3), np.array(frame.placement.translation))
            for body, frame in zip(bodies, self._frames, strict=True)
        ]

    def scale_masses(self, factors: FloatArray) -> None:
        """Multiply mass, inertia and armature behind each joint by `factors` (n,)."""
        mass, inertia, armature = self._nominal
        by_joint = np.append(factors, 1.0)  # MuJoCo gives the base index -1: the last factor
        by_body = by_joint[self.model.body_dofadr[self.model.body_weldid]]
        self.model.body_mass[:] = mass * by_body
        self.model.body_inertia[:] = inertia * by_body[:, None]
        self.model.dof_armature[:] = armature * factors
        mujoco.mj_setConst(self.model, self.data)

    def move_contact(self, point: int, place: FloatArray) -> None:
        """Move contact point number `point`, such as a link, to `place` (3,) [m] in its own frame."""
        self._points[point][3][:] = self._frames[point].placement.act(place)

    def kinematics(self, q: FloatArray, point: int = 0) -> tuple[FloatArray, FloatArray]:
        """Return J_v (3, n) of contact point number `point`, and the mass matrix (n, n), at `q` (n,)."""
        self.data.qpos[:] = q
        matrix = mass_matrix(self.model, self.data)
        return self._jacobian(point, self._position(point)).copy(), matrix

    def gravity(self, q: FloatArray) -> FloatArray:
        """Return the joint torques (n,) that hold the arm against gravity at `q` (n,) [N m, N]."""
        self.model.opt.gravity[2] = GRAVITY
        self.data.qpos[:], self.data.qvel[:] = q, 0.0
        mujoco.mj_forward(self.model, self.data)
        return np.array(self.data.qfrc_bias)

    def worst_person(self, q: FloatArray, qd: FloatArray, limit: Limit, speed: float, point: int = 0) -> FloatArray:
        """Return the velocity (3,) of a person at `speed` [m/s] with the largest energy of a contact with free joints.

        The energy is convex in the velocity, so that stepping to the end of its gradient converges.
        """
        jacobian, inertia = self.kinematics(q, point)
        mobility = jacobian @ np.linalg.solve(inertia, jacobian.T) + np.eye(3) / limit.body_mass_kg
        person = np.zeros(3)
        for _ in range(ROUNDS):
            towards = np.linalg.solve(mobility, jacobian @ qd - person)
            person = -speed * towards / np.linalg.norm(towards)
        return person

    def worst_normal(
        self,
        q: FloatArray,
        qd: FloatArray,
        limit: Limit,
        servo: ServoSettings | None = None,
        point: int = 0,
        person: FloatArray = AT_REST,
    ) -> FloatArray:
        """Return the unit normal (3,) along which the force is largest, in the pose of the first touch.

        With a servo it follows from the two-mass model. It is one of (A + s I)^-1 v, where s ranges from 1 / m_H, for
        free joints, to infinity, for an immovable robot.
        """
        jacobian, inertia = self.kinematics(q, point)
        mobility, velocity = jacobian @ np.linalg.solve(inertia, jacobian.T), jacobian @ qd - person
        least = 1.0 / limit.body_mass_kg
        if servo is None:
            normal = np.linalg.solve(mobility + least * np.eye(3), velocity)
            return np.asarray(normal / np.linalg.norm(normal))
        most = np.trace(mobility) + least
        shifts = np.geomspace(max(least, 1e-6 * most), 1e3 * most, NORMALS)
        normals = np.linalg.solve(mobility + shifts[:, None, None] * np.eye(3), velocity[:, None])[:, :, 0]
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        mobilities = np.einsum("ni,ij,nj->n", normals, mobility, normals)
        k, m_h = np.array([limit.stiffness_n_m]), np.array([limit.body_mass_kg])
        mu = servo_reduced_masses(mobilities, k, m_h, servo)[0]
        return np.asarray(normals[np.argmax((normals @ velocity) ** 2 * mu)])

    def touch(  # noqa: PLR0915 - one time step after the other
        self,
        q: FloatArray,
        qd: FloatArray,
        normal: FloatArray,
        limit: Limit,
        servo: ServoSettings | None = None,
        point: int = 0,
        pace: float = 1.0,
        qdd: FloatArray | None = None,
        surface: Surface = ELASTIC,
        person: FloatArray = AT_REST,
    ) -> Peak:
        """Return the peak of the total force on a plate with the unit `normal` (3,) that contact point `point` touches.

        Stiffness and mass of the plate are those of `limit`; a clamped one does not move, another one has the velocity
        `person` (3,) [m/s] at first. A `servo` compensates gravity and moves its reference on, which gains `qdd` (n,)
        for the time that the bound assumes, until it has clamped the plate for its stopping time; a controller per
        joint is tuned to the inertia of its joint at the start. Without `servo` the joints are free but for the torques
        of `qdd` at the first touch, gravity is off, and the contact ends with the first separation. `pace` below 1
        scales velocities, effort limits and gravity down and the peak up, so that the arm stays in the pose of the
        first touch. Raises ArithmeticError if the simulation diverges.
        """
        model, data, k = self.model, self.data, limit.stiffness_n_m
        mujoco.mj_resetData(model, data)
        jacobian, inertia = self.kinematics(q, point)
        row = normal @ jacobian
        mobility = row @ np.linalg.solve(inertia, row) + 1.0 / limit.body_mass_kg
        rate, damping = math.sqrt(k * mobility), 2.0 * surface.damping * math.sqrt(k / mobility)
        coarse, duration, stop = 0.0, 4.0 / rate, math.inf
        accelerates_for = contact_time(limit.body_mass_kg, k)
        model.opt.gravity[2] = 0.0
        qdd = np.zeros(self.n) if qdd is None else qdd
        velocity, effort = qd * pace, self._robot.effort_limits * pace
        if servo is not None:
            omega = 2.0 * math.pi * servo.bandwidth
            rate, coarse, duration = max(rate, omega), min(PHASE_STEP / omega, MAX_STEP_S), TRANSIENT_S
            if math.isinf(limit.body_mass_kg):
                stop, duration = servo.stopping_time, servo.stopping_time + 1.0 / servo.bandwidth
            model.opt.gravity[2] = GRAVITY * pace
        fine, inertias, weakest = PHASE_STEP / rate, np.diag(inertia), -effort
        offset = float(normal @ self._position(point))
        acceleration, half = np.zeros(self.n), velocity.copy()
        free_torque = np.zeros(self.n) if servo or not qdd.any() else self._torque_of(velocity, qdd)
        plate, plate_half, push, along = 0.0, person * pace, np.zeros(3), normal
        sliding = SLIDING * float(np.linalg.norm(jacobian @ velocity)) + TINY
        time = depth = step = 0.0
        peak_force = peak_time = 0.0
        qpos, qvel, torque = data.qpos, data.qvel, data.qfrc_applied
        peak_q = qpos.copy()
        while time < duration:
            # Leapfrog: `half` and `plate_half` are velocities half a step earlier.
            qvel[:] = half + 0.5 * step * acceleration
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
            position = self._position(point)
            last_depth, depth = depth, float(normal.dot(position)) - offset - plate
            if not math.isfinite(depth):
                raise ArithmeticError(f"{self._robot.name}: simulation of an impact diverged after {time:.6f} s")
            if servo is None and depth <= 0.0 < time:
                break
            torque[:] = free_torque
            if servo is not None:
                gaining = min(time, stop, accelerates_for)
                error = q + velocity * min(time, stop) - qpos
                error += qdd * gaining * (min(time, stop) - 0.5 * gaining)
                error_rate = (velocity + qdd * gaining) * (time < stop) - qvel
                now = qdd * (time < min(stop, accelerates_for))
                stated = self._torque(servo, error, error_rate, now, inertias)
                torque[:] = np.minimum(np.maximum(stated, weakest), effort)
            if depth > 0.0 or time == 0.0:
                jacobian, force = self._jacobian(point, position), k * depth
                if surface != ELASTIC:
                    slip = jacobian @ qvel - plate_half - 0.5 * step * push / limit.body_mass_kg
                    closing = float(normal @ slip)
                    force += damping * closing
                    slip -= closing * normal
                    along = normal + surface.friction * slip / (math.sqrt(slip @ slip) + sliding)
                push = max(force, 0.0) * along
                total = math.sqrt(push.dot(push))
                if total > peak_force:
                    peak_force, peak_time, peak_q = total, time, qpos.copy()
                torque -= push.dot(jacobian)
            else:
                push = np.zeros(3)
            mujoco.mj_fwdAcceleration(model, data)
            acceleration[:] = data.qacc_smooth
            closing_speed = max(depth - last_depth, 0.0) / step if step else 0.0
            last_step, step = step, fine if depth >= -2.0 * closing_speed * coarse else max(fine, coarse)
            half += 0.5 * (last_step + step) * acceleration
            plate_half += 0.5 * (last_step + step) * push / limit.body_mass_kg
            qpos += step * half
            plate += step * float(normal.dot(plate_half))
            time += step
        return Peak(peak_force / pace, peak_time, float(np.max(np.abs(peak_q - q))))

    def _torque_of(self, qd: FloatArray, qdd: FloatArray) -> FloatArray:
        """Return the joint torques (n,) that accelerate the arm with `qdd` (n,) at `qd` (n,) in its present pose."""
        self.data.qvel[:] = qd
        mujoco.mj_forward(self.model, self.data)
        torque = np.zeros(self.n)
        mujoco.mj_mulM(self.model, self.data, torque, qdd)
        return np.asarray(torque + self.data.qfrc_bias)

    def _torque(
        self, servo: ServoSettings, error: FloatArray, error_rate: FloatArray, qdd: FloatArray, inertias: FloatArray
    ) -> FloatArray:
        """Return the joint torques (n,) for errors of position and velocity (n,), and accelerations `qdd` (n,).

        `inertias` (n,) are those to which a controller per joint is tuned.
        """
        omega = 2.0 * math.pi * servo.bandwidth
        acceleration = qdd + omega**2 * error + 2.0 * servo.damping * omega * error_rate
        if servo.computed_torque:
            torque = np.empty(self.n)
            mujoco.mj_mulM(self.model, self.data, torque, acceleration)
        else:
            torque = inertias * acceleration
        return np.asarray(torque + self.data.qfrc_bias)

    def _position(self, point: int) -> FloatArray:
        _, position, orientation, place = self._points[point]
        return np.asarray(position + orientation.dot(place))

    def _jacobian(self, point: int, position: FloatArray) -> FloatArray:
        """Return J_v (3, n) of contact point number `point`, which is at `position` (3,); the next call replaces it."""
        body, *_ = self._points[point]
        mujoco.mj_jac(self.model, self.data, self._jacobian_of_point, None, position, body)
        return self._jacobian_of_point


def _urdf_model(path: Path, joints: tuple[str, ...]) -> mujoco.MjModel:
    """Return the URDF `path` with `joints`; all other joints are fixed at zero, as the monitor fixes them."""
    root = ET.parse(path).getroot()  # noqa: S314 - a robot file that the user chose
    for link in root.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    for joint in root.findall("joint"):
        if joint.get("name") not in joints:
            joint.set("type", "fixed")
    ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", fusestatic="false")
    return mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
