# SPDX-License-Identifier: Apache-2.0
"""Serial robot, independent of its file format."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from scara_effmass.codes import Assumption
from scara_effmass.iso15066 import robot_mass
from scara_effmass.model.description import CONTINUOUS_LIMIT, HeldJoint, RotorInertia
from scara_effmass.settings import LumpingSettings, MonitorSettings
from scara_effmass.values import FloatArray

UNKNOWN_EFFORT = 1e9
"""Effort limit from which on none is stated; URDF files write 0 as well."""
SAMPLES = 64
"""Number of configurations at which structural properties of a model are evaluated."""


@dataclass(frozen=True, slots=True, eq=False)
class Robot:
    """Kinematics, inertial data and limits of one serial robot, payload included.

    `model` has one degree of freedom per joint and the inertia tensors that the file states; its armature is the
    diagonal of the matrix of `rotors`, and `mass_matrix` adds the rest. `contact_frames` maps contact points to frame
    ids. `tip` is the end of the last link in the last joint's frame; the link's distal axis is parallel to the joint
    axis through it. `payload` are the masses m_L [kg] of tool and load by source; `rebuild` returns this robot with the
    load of other settings. A `*_reason` states why masses, centres of mass (CoM) or inertias are implausible; it is
    empty if they are plausible. `units_reason` states what is certainly not in SI units: the monitor refuses the robot.
    `stated` is what the robot file states of the assumptions, `held` are its joints that the model does not move.
    `hulls` are the vertices (V, 3) [m] of contact points that are links as a whole, in the frame of their joint.
    `unwatched` are the moving links that `whole_arm` should watch, and cannot for lack of geometry.
    `torque_constants` (n,) are torques [N m, N] per unit of effort in the joint states.
    `reach` [m] is the largest distance of `tip` and contact points from the first joint, over the sampled poses.
    """

    origin: str
    base_frame: str
    model: pin.Model
    contact_frames: Mapping[str, int]
    tip: pin.SE3
    payload: Mapping[str, float]
    rebuild: Callable[[MonitorSettings], Robot]
    rotors: RotorInertia
    lumping: LumpingSettings
    masses_reason: str
    coms_reason: str
    inertias_reason: str
    notes: tuple[str, ...]
    stated: frozenset[Assumption]
    torque_constants: FloatArray
    reach: float = 0.0
    units_reason: str = ""
    held: tuple[HeldJoint, ...] = ()
    hulls: Mapping[str, FloatArray] = field(default_factory=dict)
    unwatched: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Name of the robot, as the file states it."""
        return str(self.model.name)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the model's joints, in its order."""
        return tuple(self.model.names)[1:]

    @property
    def named_points(self) -> tuple[str, ...]:
        """Contacts that are points, not links as a whole."""
        return tuple(name for name in self.contact_frames if name not in self.hulls)

    @property
    def last_link(self) -> str:
        """Name of the link that the last joint carries; of a DH file, that of the joint."""
        last = self.model.njoints - 1
        links = (frame.name for frame in self.model.frames if frame.type == pin.BODY and frame.parentJoint == last)
        return str(next(links, self.model.names[last]))

    @property
    def revolute(self) -> tuple[bool, ...]:
        """Whether each joint is revolute (else prismatic)."""
        return tuple(joint.shortname().startswith("JointModelR") for joint in list(self.model.joints)[1:])

    @property
    def periods(self) -> FloatArray:
        """Period (n,) [rad] of the position of each continuous joint, 0 of the others."""
        return np.where(np.asarray(self.model.upperPositionLimit) >= CONTINUOUS_LIMIT, 2.0 * math.pi, 0.0)

    @property
    def turns(self) -> dict[str, float]:
        """Period [rad] of the position of each continuous joint by name."""
        return {name: turn for name, turn in zip(self.joint_names, self.periods.tolist(), strict=True) if turn}

    @property
    def effort_limits(self) -> FloatArray:
        """Effort limits (n,) of the joints [N m, N]; infinite where the description states none."""
        effort = np.asarray(self.model.effortLimit, dtype=np.float64)
        return np.where((effort > 0.0) & (effort < UNKNOWN_EFFORT), effort, np.inf)

    @property
    def payload_mass(self) -> float:
        """Mass m_L of tool and workpiece [kg] (Eq. 17)."""
        return sum(self.payload.values())

    @property
    def payload_text(self) -> str:
        """The payload with its sources, such as "0.25 kg (robot file) + 2 kg (parameter payload_mass)"."""
        return " + ".join(f"{mass:.4g} kg ({source})" for source, mass in self.payload.items()) or "0 kg (not stated)"

    @property
    def moving_mass(self) -> float:
        """Mass M of all moving links without the payload [kg] (Eq. 17)."""
        return float(sum(inertia.mass for inertia in list(self.model.inertias)[1:])) - self.payload_mass

    @property
    def iso_mass(self) -> float:
        """Effective mass m_R of ISO/TS 15066 [kg] (Eq. 17), see `iso15066.robot_mass`."""
        return robot_mass(self.moving_mass, self.payload_mass)

    def frame_indices(self) -> dict[str, int]:
        """Return the indices of Pinocchio's frames by name; the link's, if a contact point has the name of its link."""
        return {frame.name: index for index, frame in reversed([*enumerate(self.model.frames)])}

    def mass_matrix(self, model: pin.Model, data: pin.Data, q: FloatArray) -> FloatArray:
        """Return the mass matrix (n, n) of `model`, this robot's or its lumped copy, rotors included.

        Computed in the frames of the joints, which rounds tiny inertias at the end of an arm less than the base frame.
        """
        return np.asarray(pin.crba(model, data, q, pin.Convention.LOCAL) + self.rotors.coupling)

    def axis_in_joint_frame(self, joint: int) -> FloatArray:
        """Return the unit axis (3,) of `joint` (1-based, as in Pinocchio) in its own frame."""
        data = self.model.joints[joint].createData()
        self.model.joints[joint].calc(data, pin.neutral(self.model), np.ones(self.model.nv))
        motion = data.v
        axis = motion.angular if self.revolute[joint - 1] else motion.linear
        return np.asarray(axis, dtype=np.float64)

    def joint_poses(self, q: FloatArray) -> FloatArray:
        """Return the poses (n, 4, 4) of the joint frames in the base frame at `q` (n,)."""
        data = self.model.createData()
        pin.forwardKinematics(self.model, data, q)
        return np.array([pose.homogeneous for pose in list(data.oMi)[1:]])

    def sample_configurations(self, count: int = SAMPLES) -> FloatArray:
        """Return (count, n) configurations [rad, m] spread evenly over the joint ranges, the same on every call.

        A range wider than one turn is sampled over the turn around its value nearest to zero.
        """
        lower, upper = self.model.lowerPositionLimit, self.model.upperPositionLimit
        centre = np.clip(0.0, lower, upper)
        lower, upper = np.maximum(lower, centre - np.pi), np.minimum(upper, centre + np.pi)
        # The generalised golden ratio gives a low-discrepancy sequence in n dimensions, without a seed.
        n = self.model.nv
        ratio = 2.0
        for _ in range(50):
            ratio = (1.0 + ratio) ** (1.0 / (n + 1))
        steps = ratio ** -np.arange(1, n + 1)
        fractions = (0.5 + np.outer(np.arange(1, count + 1), steps)) % 1.0
        return np.asarray(lower + fractions * (upper - lower), dtype=np.float64)
