"""The virtual cell: robot, cart and the tip between them, moved by MuJoCo's dynamics alone.

The tip is a spring of our own between MuJoCo's two halves of a step. MuJoCo's contacts are soft constraints, whose
stiffness is one per unit of inertia: with them the impact would not know the k that the law of the standard has.
Gravity is left out: the guide and the brake of the quill carry it, and it does no work in the plane.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, final

import mujoco
import numpy as np

from scara_effmass.sim.mjcf import TOOL, cell_mjcf

if TYPE_CHECKING:
    from pathlib import Path

    from scara_effmass.sim.cart import Cart
    from scara_effmass.sim.spring_contact import SpringContact
    from scara_effmass.values import FloatArray

TICK_NS = 1_000_000
"""For so long a torque is held: the period of the robot's controller."""
FAR_NS = 500_000
"""A step while nothing can touch."""
NEAR_NS = 10_000
"""A step near and in contact: a hundredth of the shortest contact in the paper.

It is good to 0.01 % of the peak, and to 0.2 % where damping takes a fifth of it."""
NEAR_M = 1e-3
"""Gap below which steps are short; the robot closes a quarter of it in a tick."""
SLIDING_MPS = 5e-3
"""Below it, friction of the tip is in proportion to the speed; so it can hold, if with some creep."""


class ContactSample(NamedTuple):
    """The contact at the beginning of a step."""

    time_ns: int
    depth: float
    """how far the tip is pressed in, negative for a gap [m]"""
    force: float
    """along the normal of the plate [N]"""
    measured: float
    """what the force cell feels of it, along the guide [N]"""


@final
class CollisionSim:
    """Robot and cart. The cart is away until `place_cart`, and then touches only what comes to it."""

    def __init__(self, robot: Path, cart: Cart, contact: SpringContact) -> None:
        """Build it, all joints at zero and at rest. Raises RobotError."""
        mjcf, self.joints = cell_mjcf(robot, cart)
        self.cart = cart
        self.contact = contact
        self.model = mujoco.MjModel.from_xml_string(mjcf)
        self.data = mujoco.MjData(self.model)
        self.time_ns = 0
        self.cart_placed = False
        self._n = len(self.joints)
        self._site = self.model.site(TOOL).id
        self._tool = self.data.site_xpos[self._site]
        self._q, self._v = self.data.qpos, self.data.qvel
        self._applied = self.data.qfrc_applied
        self._jacobian = np.zeros((3, self.model.nv))
        self._guide = np.array(cart.direction)
        self._normal = self._guide if cart.surface is None else np.array(cart.surface)
        self._plane = (*self._normal.tolist(), float(self._normal @ np.array(cart.tip)))
        self._along = float(self._normal @ self._guide)
        self._step_ns = 0
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
    def tool(self) -> FloatArray:
        """Where the tool is (3,) [m], a copy, as of the beginning of the latest step."""
        return np.array(self._tool)

    @property
    def cart_position(self) -> float:
        """How far the cart is from where it waits [m]."""
        return float(self._q[self._n])

    @property
    def cart_speed(self) -> float:
        """Of the cart along its guide [m/s]."""
        return float(self._v[self._n])

    def put(self, q: FloatArray, qd: FloatArray) -> None:
        """Put the robot at `q`, moving with `qd`; the cart waits where it stands."""
        self._q[: self._n] = q
        self._v[: self._n] = qd
        mujoco.mj_forward(self.model, self.data)

    def place_cart(self) -> None:
        """Put the cart on its guide, at rest. Raises ValueError when the robot is in its way."""
        self._q[self._n] = self._v[self._n] = 0.0
        mujoco.mj_forward(self.model, self.data)
        if (depth := self._depth()) > 0.0:
            raise ValueError(f"the tool is {depth * 1e3:.1f} mm behind the tip; before it would be right")
        self.cart_placed = True

    def depth(self) -> float:
        """Return how deep the tip is pressed in [m], negative for a gap."""
        mujoco.mj_kinematics(self.model, self.data)
        return self._depth()

    def tool_velocity(self) -> FloatArray:
        """Return the velocity of the tool (3,) [m/s]."""
        mujoco.mj_fwdPosition(self.model, self.data)
        mujoco.mj_jacSite(self.model, self.data, self._jacobian, None, self._site)
        return np.asarray(self._jacobian @ self._v)

    def effective_mass(self, direction: FloatArray) -> float:
        """Return the mass [kg] that the robot presents at the tool along the unit vector `direction` (3,).

        1 / (n^T J M^-1 J^T n), with J and M^-1 as MuJoCo has them.
        """
        mujoco.mj_fwdPosition(self.model, self.data)
        mujoco.mj_jacSite(self.model, self.data, self._jacobian, None, self._site)
        row = (direction @ self._jacobian)[None, :]
        solved = np.empty_like(row)
        mujoco.mj_solveM(self.model, self.data, solved, row)
        return float(1.0 / np.dot(row[0], solved[0]))

    def joint_inertias(self) -> FloatArray:
        """Return the diagonal of the robot's mass matrix (n,) [kg m2, kg], as a drive sees its joint."""
        mujoco.mj_fwdPosition(self.model, self.data)
        columns = np.empty(self.model.nv)
        inertias = []
        for unit in np.eye(self.model.nv)[: self._n]:
            mujoco.mj_mulM(self.model, self.data, columns, unit)
            inertias.append(float(columns @ unit))
        return np.array(inertias)

    def inverse_dynamics(self, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray:
        """Return the joint torques (m, n) [N m, N] of motions `q`, `qd`, `qdd` (m, n), without any contact."""
        scratch = mujoco.MjData(self.model)
        torques = []
        for row in zip(q, qd, qdd, strict=True):
            scratch.qpos[: self._n], scratch.qvel[: self._n], scratch.qacc[: self._n] = row
            mujoco.mj_inverse(self.model, scratch)
            torques.append(scratch.qfrc_inverse[: self._n].copy())
        return np.array(torques)

    def kinetic_energy(self) -> float:
        """Return that of robot and cart [J]."""
        mujoco.mj_fwdPosition(self.model, self.data)
        momentum = np.empty(self.model.nv)
        mujoco.mj_mulM(self.model, self.data, momentum, self._v)
        return float(self._v @ momentum / 2.0)

    def tick(self, torque: FloatArray) -> list[ContactSample]:
        """Move on by TICK_NS with the joint torques `torque` (n,) [N m, N] held; return the contact, if one is near."""
        if self._near():
            return [self.step(torque, NEAR_NS) for _ in range(TICK_NS // NEAR_NS)]
        for _ in range(TICK_NS // FAR_NS):
            self._begin(torque, FAR_NS)
            self._end(self.cart.resistance(self.cart_position, self.cart_speed), FAR_NS)
        return []

    def step(self, torque: FloatArray, step_ns: int) -> ContactSample:
        """Move on by `step_ns` with `torque` (n,) held; return the contact at its beginning."""
        self._begin(torque, step_ns)
        push = force = 0.0
        depth = self._depth()
        if self.cart_placed and depth > 0.0:
            push, force = self._press(depth)
        along = push + self.cart.resistance(self.cart_position, self.cart_speed)
        touch = ContactSample(self.time_ns, depth, force, push - self.cart.tip_mass * along / self.cart.mass)
        self._end(along, step_ns)
        return touch

    def _begin(self, torque: FloatArray, step_ns: int) -> None:
        if step_ns != self._step_ns:
            self.model.opt.timestep = step_ns / 1e9
            self._step_ns = step_ns
        mujoco.mj_step1(self.model, self.data)
        self._applied[: self._n] = torque

    def _end(self, along: float, step_ns: int) -> None:
        """Let the forces act, `along` [N] on the cart."""
        self._applied[self._n] = along
        mujoco.mj_step2(self.model, self.data)
        self.time_ns += step_ns

    def _press(self, depth: float) -> tuple[float, float]:
        """Apply the contact to the robot; return its force along the guide and along the normal [N]."""
        mujoco.mj_jacSite(self.model, self.data, self._jacobian, None, self._site)
        row = self._normal @ self._jacobian
        rate = float(row @ self._v) - self._along * self.cart_speed
        force = self.contact.force(depth, rate)
        self._applied -= force * row
        push = force * self._along
        if self.contact.friction:
            velocity = self._jacobian @ self._v - self._guide * self.cart_speed
            sliding = velocity - rate * self._normal
            drag = self.contact.friction * force / max(float(np.linalg.norm(sliding)), SLIDING_MPS) * sliding
            self._applied -= drag @ self._jacobian
            push += float(self._guide @ drag)
        return push, force

    def _depth(self) -> float:
        x, y, z = self._tool.tolist()
        nx, ny, nz, offset = self._plane
        return float(nx * x + ny * y + nz * z - offset - self._along * self._q[self._n])

    def _near(self) -> bool:
        if not self.cart_placed:
            return False
        closing = float(self._normal @ (self.tool_velocity() - self._guide * self.cart_speed))
        return -self._depth() < max(NEAR_M, 2.0 * closing * TICK_NS / 1e9)
