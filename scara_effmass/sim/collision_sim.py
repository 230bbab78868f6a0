# SPDX-License-Identifier: Apache-2.0
"""MuJoCo simulation of a collision: robot, cart, and a spring contact between them.

The contact force is applied between MuJoCo's two half steps. MuJoCo's own contacts are soft constraints whose
stiffness scales with inertia, so the k of ISO/TS 15066 would not be known. Gravity is left out: the guide and the
brake of the quill carry the weight, and it does no work in the horizontal plane. The model is built from the robot's
Denavit-Hartenberg file, independently of the room `model`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, final
from xml.etree import ElementTree as ET

import mujoco
import numpy as np

from scara_effmass.errors import RobotError, SettingsError
from scara_effmass.input_files import read_yaml
from scara_effmass.values import FloatArray, Vector3

CONTROL_PERIOD_NS = 1_000_000
"""Period of the robot controller; the torque is constant for one period."""
COARSE_STEP_NS = 500_000
"""Simulation step far from contact."""
FINE_STEP_NS = 10_000
"""Simulation step near and in contact: 1 % of the paper's shortest contact.

The error of the peak is 0.01 %, and 0.2 % if damping reduces the peak by a fifth."""
FINE_STEP_GAP_M = 1e-3
"""Gap below which steps are fine; the robot closes a quarter of it in one control period."""
TIP_VISCOUS_SPEED_MPS = 5e-3
"""Sliding speed below which tip friction is proportional to the speed: the tip holds, with some creep."""

TOOL = "tool"
"""Name of the contact point in the robot file and of the MJCF site there."""
_DISABLED = ("contact", "constraint", "sensor", "actuation", "limit")
GRAVITY = -9.81
"""Acceleration along z [m/s2], where there is one: free joints of the cell move without it."""
_JOINT_TYPES = {"revolute": "hinge", "prismatic": "slide"}

GUIDE: Vector3 = (1.0, 0.0, 0.0)
"""Direction of the cart's guide, and of the path of the tool, in the robot's base frame."""
GUIDE_VISCOUS_SPEED_MPS = 1e-3
"""Speed below which guide friction is proportional to the speed, so that it vanishes at rest."""
TRAVEL_M, BRAKE_TIME_S = 0.15, 0.05
"""Way of the cart to its brake, and time constant of the brake."""
LINEAR = 1.0
HERTZ = 1.5
"""Exponents n of the contact law."""


@dataclass(frozen=True, slots=True)
class Cart:
    """A cart on a guide along GUIDE, away from the robot; at its end a brake stops the cart smoothly.

    `tip` is the position of the tip at rest in the robot's base frame [m], `mass` the whole sliding mass m_H [kg].
    `normal` is the unit normal of the robot's plate that the tip touches. `guide_friction` is in [N].
    """

    tip: Vector3
    mass: float
    normal: Vector3 = GUIDE
    guide_friction: float = 0.5

    def resistance(self, position: float, speed: float) -> float:
        """Return the force of guide and brake on the cart [N], `position` [m] from its rest position."""
        friction = -self.guide_friction * speed / GUIDE_VISCOUS_SPEED_MPS
        if abs(speed) > GUIDE_VISCOUS_SPEED_MPS:
            friction = -math.copysign(self.guide_friction, speed)
        braking = -self.mass / BRAKE_TIME_S * speed if position > TRAVEL_M else 0.0
        return friction + braking


@dataclass(frozen=True, slots=True)
class SpringContact:
    """Contact law of the tip: F = max(0, k d^n + c d'). Raises SettingsError for impossible values.

    `stiffness` is k [N/m^n]. `exponent` n = 1 is a linear spring, 3/2 a Hertz contact. `damping` is c [N s/m] of the
    Kelvin-Voigt model, `friction` the Coulomb coefficient between tip and plate. The paper gives no stiffness of its
    polyethylene tip, but forces of 160 to 860 N and durations of 1 to 4 ms. The default gives 200 to 510 N and 1.3 to
    3.2 ms for the paper's masses and speed.
    """

    stiffness: float = 2.0e6
    exponent: float = LINEAR
    damping: float = 0.0
    friction: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 < self.stiffness < math.inf:
            raise SettingsError(f"stiffness = {self.stiffness}: must be finite and > 0")
        for name, minimum, maximum in (("exponent", 1.0, math.inf), ("damping", 0.0, math.inf), ("friction", 0.0, 1.0)):
            value = getattr(self, name)
            if not minimum <= value <= maximum or value == math.inf:
                raise SettingsError(f"{name} = {value}: must be finite and from {minimum} to {maximum}")

    def force(self, depth: float, rate: float) -> float:
        """Return the force [N] at penetration `depth` [m] with rate `rate` [m/s]; 0 without contact."""
        if depth <= 0.0:
            return 0.0
        return max(0.0, self.stiffness * math.pow(depth, self.exponent) + self.damping * rate)

    def free_impact(self, speed: float, reduced_mass: float) -> tuple[float, float]:
        """Return peak force [N] and duration [s] where two free bodies collide at `speed` [m/s], without damping.

        The spring holds mu v^2 / 2 at the peak. For a linear spring F = v sqrt(mu k), t = pi sqrt(mu / k).
        """
        power = self.exponent + 1.0
        depth = math.pow(power * reduced_mass * speed**2 / (2.0 * self.stiffness), 1.0 / power)
        # Integral of (1 - x^p)^(-1/2) from 0 to 1.
        quarter = math.sqrt(math.pi) * math.gamma(1.0 + 1.0 / power) / math.gamma(0.5 + 1.0 / power)
        return self.stiffness * math.pow(depth, self.exponent), 2.0 * depth / speed * quarter


POLYETHYLENE = SpringContact()


class ContactSample(NamedTuple):
    """Contact at the beginning of a step: penetration `depth` [m], negative for a gap, and forces [N].

    `force` acts along the normal of the plate; `measured` is the force on the cart, along the guide.
    """

    time_ns: int
    depth: float
    force: float
    measured: float


class TrueContact(NamedTuple):
    """One contact, along the axis of the force cell: `peak_force` [N], `impulse` [N s], `duration` [s].

    `speed` is the closing speed of tip and plate along the normal of the plate [m/s].
    """

    onset_ns: int
    speed: float
    peak_force: float
    duration: float
    impulse: float


def find_contacts(samples: Sequence[ContactSample]) -> tuple[TrueContact, ...]:
    """Return the complete contacts in `samples`, which are in time order."""
    pressed = np.array([False, *(sample.force > 0.0 for sample in samples), False])
    begins, ends = np.flatnonzero(pressed[:-1] != pressed[1:]).reshape(-1, 2).T.tolist()
    return tuple(
        _contact(samples[begin - 1 : end + 1])
        for begin, end in zip(begins, ends, strict=True)
        if begin > 0 and end < len(samples)
    )


def _contact(samples: Sequence[ContactSample]) -> TrueContact:
    """Return the contact that fills `samples` except for the first and the last one."""
    before, first, last = samples[0], samples[1], samples[-1]
    step_s = (first.time_ns - before.time_ns) / 1e9
    speed = (first.depth - before.depth) / step_s
    onset_ns = first.time_ns - round(first.depth / speed * 1e9)
    forces = [sample.measured for sample in samples]
    return TrueContact(onset_ns, speed, max(forces), (last.time_ns - onset_ns) / 1e9, sum(forces) * step_s)


@final
class CollisionSim:
    """Robot and cart. The cart takes part in contact only after `place_cart`."""

    def __init__(self, robot: Path, cart: Cart, contact: SpringContact) -> None:
        """Build the model of the DH file `robot`, all joints at zero and at rest. Raises RobotError."""
        self.cart = cart
        self.contact = contact
        self.model = mujoco.MjModel.from_xml_string(sim_mjcf(robot, cart))
        self.data = mujoco.MjData(self.model)
        self.time_ns = 0
        self.cart_placed = False
        self._n = self.model.nv - 1
        self._site = self.model.site(TOOL).id
        self._tool = self.data.site_xpos[self._site]
        self._q, self._v = self.data.qpos, self.data.qvel
        self._applied = self.data.qfrc_applied
        self._jacobian = np.zeros((3, self.model.nv))
        self._guide = np.array(GUIDE)
        self._normal = np.array(cart.normal)
        self._plane = (*cart.normal, float(self._normal @ np.array(cart.tip)))
        self._normal_on_guide = float(self._normal @ self._guide)
        mujoco.mj_forward(self.model, self.data)

    @property
    def q(self) -> FloatArray:
        """Positions of the robot's joints (n,), a copy."""
        return np.array(self._q[: self._n])

    @property
    def qd(self) -> FloatArray:
        """Velocities of the robot's joints (n,), a copy."""
        return np.array(self._v[: self._n])

    @property
    def cart_position(self) -> float:
        """Position of the cart on its guide, from its rest position [m]."""
        return float(self._q[self._n])

    @property
    def cart_speed(self) -> float:
        """Speed of the cart along its guide [m/s]."""
        return float(self._v[self._n])

    def set_state(self, q: FloatArray, qd: FloatArray) -> None:
        """Set the robot's joint positions and velocities (n,); the cart keeps its state."""
        self._q[: self._n] = q
        self._v[: self._n] = qd
        mujoco.mj_forward(self.model, self.data)

    def place_cart(self) -> None:
        """Place the cart at its rest position. Raises ValueError if the tool is in its way."""
        self._q[self._n] = self._v[self._n] = 0.0
        mujoco.mj_forward(self.model, self.data)
        if (depth := self._depth()) > 0.0:
            raise ValueError(f"tool: {depth * 1e3:.1f} mm behind the tip of the cart: must be in front of it")
        self.cart_placed = True

    def tool_velocity(self) -> FloatArray:
        """Return the tool velocity (3,) [m/s]."""
        self._update_jacobian()
        return np.asarray(self._jacobian @ self._v)

    def effective_mass(self, direction: FloatArray) -> float:
        """Return the robot's effective mass [kg] at the tool along the unit vector `direction` (3,).

        m_n = 1 / (n^T J M^-1 J^T n), with MuJoCo's J and M^-1.
        """
        self._update_jacobian()
        row = (direction @ self._jacobian)[None, :]
        solution = np.empty_like(row)
        mujoco.mj_solveM(self.model, self.data, solution, row)
        return float(1.0 / np.dot(row[0], solution[0]))

    def joint_inertias(self) -> FloatArray:
        """Return the diagonal of the robot's mass matrix (n,) [kg m2, kg]."""
        return np.diag(mass_matrix(self.model, self.data))[: self._n]

    def inverse_dynamics(self, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray:
        """Return the joint torques (m, n) [N m, N] of the motion `q`, `qd`, `qdd` (m, n), without contact."""
        scratch = mujoco.MjData(self.model)
        torques = []
        for row in zip(q, qd, qdd, strict=True):
            scratch.qpos[: self._n], scratch.qvel[: self._n], scratch.qacc[: self._n] = row
            mujoco.mj_inverse(self.model, scratch)
            torques.append(scratch.qfrc_inverse[: self._n].copy())
        return np.array(torques)

    def advance(self, torque: FloatArray) -> list[ContactSample]:
        """Advance by one control period with joint torques `torque` (n,) [N m, N].

        Return the contact at each step, nothing far from contact.
        """
        close = self._close_to_contact()
        step_ns = FINE_STEP_NS if close else COARSE_STEP_NS
        samples = [self.step(torque, step_ns) for _ in range(CONTROL_PERIOD_NS // step_ns)]
        return samples if close else []

    def step(self, torque: FloatArray, step_ns: int) -> ContactSample:
        """Advance by `step_ns` with joint torques `torque` (n,); return the contact at the beginning."""
        self.model.opt.timestep = step_ns / 1e9
        mujoco.mj_step1(self.model, self.data)
        self._applied[: self._n] = torque
        push = force = 0.0
        depth = self._depth()
        if self.cart_placed and depth > 0.0:
            push, force = self._apply_contact(depth)
        self._applied[self._n] = push + self.cart.resistance(self.cart_position, self.cart_speed)
        sample = ContactSample(self.time_ns, depth, force, push)
        mujoco.mj_step2(self.model, self.data)
        self.time_ns += step_ns
        return sample

    def _apply_contact(self, depth: float) -> tuple[float, float]:
        """Apply the contact to the robot; return its force along the guide and along the normal [N]."""
        mujoco.mj_jacSite(self.model, self.data, self._jacobian, None, self._site)
        row = self._normal @ self._jacobian
        rate = float(row @ self._v) - self._normal_on_guide * self.cart_speed
        force = self.contact.force(depth, rate)
        self._applied -= force * row
        push = force * self._normal_on_guide
        if self.contact.friction:
            velocity = self._jacobian @ self._v - self._guide * self.cart_speed
            sliding = velocity - rate * self._normal
            speed = max(float(np.linalg.norm(sliding)), TIP_VISCOUS_SPEED_MPS)
            drag = self.contact.friction * force / speed * sliding
            self._applied -= drag @ self._jacobian
            push += float(self._guide @ drag)
        return push, force

    def _depth(self) -> float:
        """Return the penetration of the tip [m], negative for a gap."""
        x, y, z = self._tool.tolist()
        nx, ny, nz, offset = self._plane
        return float(nx * x + ny * y + nz * z - offset - self._normal_on_guide * self._q[self._n])

    def _close_to_contact(self) -> bool:
        if not self.cart_placed:
            return False
        closing_speed = float(self._normal @ (self.tool_velocity() - self._guide * self.cart_speed))
        return -self._depth() < max(FINE_STEP_GAP_M, 2.0 * closing_speed * CONTROL_PERIOD_NS / 1e9)

    def _update_jacobian(self) -> None:
        mujoco.mj_fwdPosition(self.model, self.data)
        mujoco.mj_jacSite(self.model, self.data, self._jacobian, None, self._site)


def mass_matrix(model: mujoco.MjModel, data: mujoco.MjData) -> FloatArray:
    """Return the mass matrix (n, n) [kg m2, kg] at the positions in `data`."""
    mujoco.mj_fwdPosition(model, data)
    matrix = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, matrix)
    return matrix


def sim_mjcf(robot: Path, cart: Cart | None = None) -> str:
    """Return the MJCF of the DH file `robot` and `cart`, whose joint comes last. Raises RobotError."""
    document = read_yaml(robot, RobotError)
    if "rotor_inertia" in document:
        raise RobotError(f"{robot}: rotor_inertia: must be absent: the simulation knows only an armature per joint")
    root = ET.Element("mujoco", model="cell")
    ET.SubElement(root, "compiler", angle="radian", inertiafromgeom="false")
    option = ET.SubElement(root, "option", integrator="Euler", gravity="0 0 0")
    ET.SubElement(option, "flag", dict.fromkeys(_DISABLED, "disable"))
    world = ET.SubElement(root, "worldbody")
    world.append(_robot_body(document))
    if cart is not None:
        # The guide carries its weight.
        body = ET.SubElement(world, "body", name="cart", pos=_text(*cart.tip), gravcomp="1")
        ET.SubElement(body, "joint", name="guide", type="slide", axis=_text(*GUIDE))
        # The cart does not rotate: its moments of inertia have no effect.
        ET.SubElement(body, "inertial", pos="0 0 0", mass=_text(cart.mass), diaginertia="1e-3 1e-3 1e-3")
    return ET.tostring(root, encoding="unicode")


def _robot_body(document: dict[str, Any]) -> ET.Element:
    """Return the base body, which contains all others.

    Each Denavit-Hartenberg row makes two bodies. The outer one moves with the joint and holds Tx(a) Rx(alpha) of the
    row before; the inner one, the link, holds Rz(theta) Tz(d) and the inertia.
    """
    base = parent = ET.Element("body", name="base")
    frame = {"pos": "0 0 0"}
    for row, link in zip(document["joints"], document["links"], strict=True):
        name = str(row["name"])
        joint_body = ET.SubElement(parent, "body", {"name": f"{name}_body", **frame})
        armature = _text(row.get("armature", 0.0))
        ET.SubElement(joint_body, "joint", name=name, type=_JOINT_TYPES[row["type"]], axis="0 0 1", armature=armature)
        offset = {"pos": _text(0.0, 0.0, row.get("d", 0.0)), "axisangle": _text(0.0, 0.0, 1.0, row.get("theta", 0.0))}
        parent = ET.SubElement(joint_body, "body", {"name": str(link["name"]), **offset})
        _add_inertial(parent, link)
        frame = {"pos": _text(row["a"], 0.0, 0.0), "axisangle": _text(1.0, 0.0, 0.0, row["alpha"])}
    end = ET.SubElement(parent, "body", {"name": "payload", **frame})
    if payload := document.get("payload"):
        _add_inertial(end, payload)
    ET.SubElement(end, "site", name=TOOL, pos=_text(*document["contact_points"][TOOL]))
    return base


def _add_inertial(body: ET.Element, link: dict[str, Any]) -> None:
    inertia = link["inertia"]
    if isinstance(inertia, (int, float)):
        # Only I_zz matters here; I_xx = I_yy = I_zz / 2 makes the tensor valid for MuJoCo.
        inertia = (inertia / 2.0, inertia / 2.0, inertia, 0.0, 0.0, 0.0)
    com = _text(*link.get("com", (0.0, 0.0, 0.0)))
    ET.SubElement(body, "inertial", pos=com, mass=_text(link["mass"]), fullinertia=_text(*inertia))


def _text(*numbers: float) -> str:
    return " ".join(repr(float(number)) for number in numbers)
