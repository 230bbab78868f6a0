"""The force bounds of the verdict against an independent simulation; prints the tables of docs/bounds.md.

    python benchmarks/bounds.py [--poses 200] [--seed 1]

MuJoCo moves the arm, an explicit spring is the contact, and a free plate of mass m_H is the body part. Each contact
begins at exactly the speed that the monitor allows for that region, all margins 0.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.optimize import linprog

from scara_effmass.iso15066 import Limit, limits_for
from scara_effmass.model.dynamics import RobotDynamics
from scara_effmass.model.load import load_robot
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share
from scara_effmass.sim.cart import Cart
from scara_effmass.sim.collision_sim import TOOL, sim_mjcf
from scara_effmass.values import ContactAssessment, FloatArray, JointState, Verdict

ROBOTS = Path(__file__).parents[1] / "test" / "robots"
SCARA = share("config", "omron_i4_550l.yaml")
NO_MARGINS: dict[str, Any] = {
    "effective_mass_model": "full",
    "mass_uncertainty": 0.0,
    "velocity_tolerance": 0.0,
    "max_velocity_lag": 0.0,
    "position_tolerance": 0.0,
}
SLOW_MPS = 0.01
TINY = 1e-12
PHASE_STEP = 0.04
"""Time step times the angular frequency of contact or servo, the larger one; the error of the peak is below 2e-4."""
SMALL_TURN = 0.02
"""Turn of the joints [rad, m] until the peak that hardly changes the effective mass."""
HELD = 1e-4
"""Pace at which the arm stays in the pose of the first touch."""
PUSH_S = 0.5
"""Time for which drives push on."""
NOW = 1_767_225_600_000_000_000


@dataclass(frozen=True)
class Servo:
    """Position control in joint space whose reference moves on at constant velocity.

    `coupled`: computed torque, else an independent controller per joint, tuned to its own inertia at the start.
    """

    bandwidth: float
    damping: float = 0.7
    coupled: bool = True


class Arm:
    """One robot in the monitor (Pinocchio) and in MuJoCo, which reads the robot file by itself."""

    def __init__(self, path: Path, armature: float = 0.0, effort: Sequence[float] = ()) -> None:
        """Load the URDF or DH file `path`; `armature` [kg m2] goes to every joint of a URDF, `effort` replaces limits.

        Gravity acts only with `effort`: unlimited drives carry the weight.
        """
        names = load_robot(path).joint_names if armature else ()
        rotors = tuple(f"{name}={armature}" for name in names)
        self.dynamics = RobotDynamics(load_robot(path, MonitorSettings(armature=rotors)))
        self.names = self.dynamics.robot.joint_names
        self.n = len(self.names)
        self.effort = np.array(effort)
        if effort:
            self.dynamics.robot.model.effortLimit = self.effort
        self.frame = self.dynamics.contact_points[0]
        if path.suffix == ".yaml":
            mjcf, _ = sim_mjcf(path, Cart((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 1.0))
            self.model = mujoco.MjModel.from_xml_string(mjcf)
        else:
            self.model = _urdf_model(path)
            self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
            self.model.dof_armature[:] = armature
        self.model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
        self.data = mujoco.MjData(self.model)
        limits = self.dynamics.robot.model
        self._lower = np.maximum(limits.lowerPositionLimit, -math.pi)
        self._upper = np.minimum(limits.upperPositionLimit, math.pi)
        self._max_speed = limits.velocityLimit
        self._monitors: dict[MonitorSettings, Monitor] = {}

    def draw(self, rng: np.random.Generator, **settings: object) -> tuple[FloatArray, FloatArray]:
        """Return a random pose (n,) and the joint velocities (n,) of a random direction, at the allowed speed.

        The joints move as little as the direction needs, and within their speed limits.
        """
        while True:
            q, direction = rng.uniform(self._lower, self._upper), rng.normal(size=3)
            qd = np.linalg.pinv(self.kinematics(q)[0]) @ direction * (SLOW_MPS / np.linalg.norm(direction))
            qd += TINY  # the monitor takes a velocity of exactly 0 for a missing one
            if np.all(np.abs(qd) < self._max_speed):
                contact = self.assess(q, qd, **settings)
                qd *= contact.allowable_speed / contact.speed
                if np.all(np.abs(qd) < self._max_speed):
                    return q, qd

    def assess(self, q: FloatArray, qd: FloatArray, **settings: object) -> ContactAssessment:
        """Return the monitor's assessment of the first contact point, without margins."""
        checked = MonitorSettings.model_validate(NO_MARGINS | settings)
        monitor = self._monitors.setdefault(checked, Monitor(self.dynamics, checked))
        monitor.clear_history()
        decision = monitor.assess(JointState(NOW, self.names, q, qd), NOW)
        if decision is None or decision.contacts[0].verdict is Verdict.UNKNOWN:
            raise RuntimeError(f"no verdict: {decision}")
        return decision.contacts[0]

    def kinematics(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return J_v (3, n) of the contact point and the mass matrix (n, n) at `q`, by MuJoCo."""
        self.data.qpos[: self.n] = q
        mujoco.mj_fwdPosition(self.model, self.data)
        return self._jacobian(), self._mass_matrix()

    def peak_force(
        self,
        q: FloatArray,
        qd: FloatArray,
        normal: FloatArray,
        limit: Limit,
        servo: Servo | None = None,
        pace: float = 1.0,
    ) -> tuple[float, float]:
        """Return the peak force [N] on a plate that the contact point touches, and the turn of the joints until then.

        The turn is the largest of all joints [rad, m]. The plate has the unit `normal` (3,). Without `servo` the joints
        are free, and the contact ends with the first separation. With `pace` below 1 velocities, effort limits and
        gravity are smaller and the peak is scaled up: the arm stays in the pose of the first touch.
        """
        qd = qd * pace
        n, model, data, k = self.n, self.model, self.data, limit.stiffness_n_m
        mujoco.mj_resetData(model, data)
        jacobian, mass_matrix = self.kinematics(q)
        row = normal @ jacobian
        rate = math.sqrt(k * (row @ np.linalg.solve(mass_matrix, row) + 1.0 / limit.obstacle_mass_kg))
        gains = np.zeros(n)
        if servo is not None:
            w = 2.0 * math.pi * servo.bandwidth
            gains = np.diag(mass_matrix)
            rate = max(rate, w)
        dt = PHASE_STEP / rate
        model.opt.timestep = dt
        model.opt.gravity[2] = -9.81 * pace if self.effort.size else 0.0
        data.qvel[:n] = qd
        mujoco.mj_forward(model, data)
        offset = float(normal @ self._point())
        plate = plate_speed = peak = turn = 0.0
        for step in range(math.ceil((PUSH_S if servo is not None else 4.0 / rate) / dt)):
            mujoco.mj_step1(model, data)
            depth = float(normal @ self._point()) - offset - plate
            force = k * max(depth, 0.0)
            if servo is None and step > 2 and depth <= 0.0:
                break
            if force > peak:
                peak, turn = force, float(np.max(np.abs(data.qpos[:n] - q)))
            torque = np.zeros(n)
            if servo is not None:
                error, error_rate = q + qd * (step * dt) - data.qpos[:n], qd - data.qvel[:n]
                demand = w * w * error + 2.0 * servo.damping * w * error_rate
                torque = data.qfrc_bias[:n] + (self._mass_matrix() @ demand if servo.coupled else gains * demand)
                if self.effort.size:
                    torque = np.clip(torque, -self.effort * pace, self.effort * pace)
            data.qfrc_applied[:n] = torque - force * (normal @ self._jacobian())
            mujoco.mj_step2(model, data)
            plate_speed += dt * force / limit.obstacle_mass_kg
            plate += dt * plate_speed
        return peak / pace, turn

    def _point(self) -> FloatArray:
        return np.asarray(self.data.site(TOOL).xpos if self.frame == TOOL else self.data.body(self.frame).xpos)

    def _jacobian(self) -> FloatArray:
        jacobian = np.zeros((3, self.model.nv))
        if self.frame == TOOL:
            mujoco.mj_jacSite(self.model, self.data, jacobian, None, self.model.site(TOOL).id)
        else:
            mujoco.mj_jacBody(self.model, self.data, jacobian, None, self.model.body(self.frame).id)
        return jacobian[:, : self.n]

    def _mass_matrix(self) -> FloatArray:
        full = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, full)
        return full[: self.n, : self.n]


def _urdf_model(path: Path) -> mujoco.MjModel:
    root = ET.parse(path).getroot()  # noqa: S314 - a file of this project
    for link in root.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", fusestatic="false")
    return mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))


def region_limit(region: str) -> Limit:
    """Return the transient limit of `region`."""
    (limit,) = limits_for(MonitorSettings(body_regions=(region,)))
    return limit


def worst_normal(arm: Arm, q: FloatArray, qd: FloatArray, limit: Limit) -> FloatArray:
    """Return the unit normal (3,) along (A + I / m_H)^-1 v, where free joints give the largest force."""
    jacobian, mass_matrix = arm.kinematics(q)
    mobility = jacobian @ np.linalg.solve(mass_matrix, jacobian.T)
    normal = np.linalg.solve(mobility + np.eye(3) / limit.obstacle_mass_kg, jacobian @ qd)
    return np.asarray(normal / np.linalg.norm(normal))


def contacts(
    arm: Arm,
    region: str,
    count: int,
    rng: np.random.Generator,
    *,
    pushing: Servo | None = None,
    plate: str = "worst",
    pace: float = 1.0,
    **settings: object,
) -> FloatArray:
    """Return the peak force over the limit and the turn of the joints [rad, m] of contacts at the allowed speed.

    Shape (count, 2). The `plate` is at the worst angle for free joints, across the velocity, or at a random angle.
    """
    limit = region_limit(region)
    results = []
    for _ in range(count):
        q, qd = arm.draw(rng, body_regions=[region], **settings)
        velocity = arm.kinematics(q)[0] @ qd
        normal = worst_normal(arm, q, qd, limit)
        if plate != "worst":
            normal = velocity if plate == "velocity" else rng.normal(size=3)
            normal *= np.sign(normal @ velocity) / np.linalg.norm(normal)
        peak, turn = arm.peak_force(q, qd, normal, limit, pushing, pace)
        results.append((peak / limit.permissible_force_n, turn))
    return np.array(results)


def clamping_force(arm: Arm, q: FloatArray, direction: FloatArray) -> float:
    """Return the largest F [N] with |g + J^T n F| <= tau_max, by linear programming; g and J by MuJoCo."""
    data, effort = arm.data, arm.dynamics.robot.effort_limits
    arm.model.opt.gravity[2] = -9.81
    data.qpos[: arm.n], data.qvel[:] = q, 0.0
    mujoco.mj_forward(arm.model, data)
    gravity = data.qfrc_bias[: arm.n].copy()
    arm.model.opt.gravity[2] = 0.0
    lever = direction @ arm.kinematics(q)[0]
    solution = linprog(
        [-1.0],
        A_ub=np.concatenate((lever, -lever))[:, None],
        b_ub=np.concatenate((effort - gravity, effort + gravity)),
        bounds=[(None, None)],
    )
    return max(float(solution.x[0]), 0.0)


def main() -> None:
    """Run the sweeps and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--poses", type=int, default=200, help="contacts in each row")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    arms = {
        "i4-550L": Arm(SCARA),
        "UR5": Arm(ROBOTS / "ur5_robot.urdf"),
        "UR10": Arm(ROBOTS / "ur10_robot.urdf", 0.1),
    }
    console = Console(width=150)
    columns = ("n", "held: median", "held: max", "median", "max", "above 1", "max, turn < 0.02")

    def row(table: Table, labels: Sequence[str], arm: Arm, region: str, count: int, **options: Any) -> None:  # noqa: ANN401
        (held, _), (ratio, turn) = (
            contacts(arm, region, count, np.random.default_rng(args.seed), pace=pace, **options).T
            for pace in (HELD, 1.0)  # the same motions: only the change of pose differs
        )
        little = ratio[turn <= SMALL_TURN]
        table.add_row(
            *labels,
            str(count),
            f"{np.median(held):.3f}",
            f"{held.max():.4f}",
            f"{np.median(ratio):.3f}",
            f"{ratio.max():.3f}",
            f"{100.0 * np.mean(ratio > 1.005):.0f} %",
            f"{little.max():.4f}" if little.size else "-",
        )

    table = Table("arm", "region", "contact_normal", "plate", *columns, title="peak force / limit, joints free")
    for name, arm in arms.items():
        for region in ("lower_leg", "chest", "hand_fingers"):
            for normal, plate in (("worst", "worst"), ("velocity", "worst"), ("worst", "random")):
                labels = (name, region, normal, plate)
                row(table, labels, arm, region, args.poses, plate=plate, contact_normal=normal)
    console.print(table)
    table = Table(
        "arm", "bandwidth", "region", "drives", *columns, title="peak force / limit, drives push on for 0.5 s"
    )
    count = max(args.poses // 8, 1)
    for name, arm in arms.items():
        for bandwidth in (1.0, 5.0, 20.0):
            for region in ("abdomen", "chest", "lower_leg"):
                for drives in ("servo", "free"):
                    options = {"servo": {"bandwidth": bandwidth}} if drives == "servo" else {}
                    row(
                        table,
                        (name, f"{bandwidth:g} Hz", region, drives),
                        arm,
                        region,
                        count,
                        pushing=Servo(bandwidth),
                        drives=drives,
                        **options,
                    )
    console.print(table)
    ur5, forces = arms["UR5"], []
    for _ in range(args.poses):
        q, qd = ur5.draw(rng)
        velocity = ur5.kinematics(q)[0] @ qd
        forces.append(clamping_force(ur5, q, velocity / np.linalg.norm(velocity)))
    quartiles = ", ".join(f"{force:.0f}" for force in np.percentile(forces, (5, 50, 95)))
    console.print(f"UR5, clamping force along the velocity, percentiles 5, 50, 95: {quartiles} N")


if __name__ == "__main__":
    main()
