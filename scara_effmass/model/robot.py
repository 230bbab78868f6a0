# SPDX-License-Identifier: Apache-2.0
"""Serial robot, independent of its file format."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from scara_effmass.errors import RobotError
from scara_effmass.iso15066 import robot_mass
from scara_effmass.model.inertial_check import StatedLink, check_inertials, triangle_error
from scara_effmass.model.plausibility import judge
from scara_effmass.model.rotors import RotorInertia
from scara_effmass.settings import LumpingSettings, MonitorSettings
from scara_effmass.settings.loading import nearest
from scara_effmass.values import FloatArray, Vector3

PARALLEL = 2e-3
"""Sine of the angle below which two axes count as parallel, because some files write pi as 3.14."""
UNKNOWN_EFFORT = 1e9
"""Effort limit from which on none is stated; URDF files write 0 as well."""
MAX_MOVING_JOINTS = 64
"""Largest number of joints of a model; the memory of its dynamics grows with its cube, 300 joints take 2.6 GB."""
SAMPLES = 64
"""Number of configurations at which structural properties of a model are evaluated."""


@dataclass(frozen=True, slots=True)
class Robot:
    """Kinematics, inertial data and limits of one serial robot, payload included.

    `model` has one degree of freedom per joint and the inertia tensors that the file states; its armature is the
    diagonal of the matrix of `rotors`, and `mass_matrix` adds the rest. `contact_frames` maps contact points to frame
    ids. `tip` is the end of the last link in the last joint's frame; the link's distal axis is parallel to the joint
    axis through it. `payload` are the masses m_L [kg] of tool and load by source; `rebuild` returns this robot with the
    load of other settings. A `*_reason` states why masses, centres of mass (CoM) or inertias are implausible; it is
    empty if they are plausible. `units_reason` states what is certainly not in SI units: the monitor refuses the robot.
    `reach` [m] is the largest distance of `tip` and contact points from the first joint, over the sampled poses.
    """

    name: str
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
    reach: float = 0.0
    units_reason: str = ""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the model's joints, in its order."""
        return tuple(self.model.names)[1:]

    @property
    def revolute(self) -> tuple[bool, ...]:
        """Whether each joint is revolute (else prismatic)."""
        return tuple(joint.shortname().startswith("JointModelR") for joint in list(self.model.joints)[1:])

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


def add_contact_frame(
    model: pin.Model, frames: dict[str, int], name: str, joint: int, pose: pin.SE3, at: Vector3
) -> None:
    """Add the contact point `name`, `at` [m] in the frame `pose` of `joint`, to `model` and `frames`.

    Raises RobotError for a name that is taken.
    """
    if name in frames:
        raise RobotError(f"contact_points = {name!r}: must name each point once")
    place = pose * pin.SE3(np.eye(3), np.array(at))
    frames[name] = model.addFrame(pin.Frame(name, joint, 0, place, pin.FrameType.OP_FRAME))


def build_robot(
    bare: pin.Model,
    origin: str,
    settings: MonitorSettings,
    *,
    links: Sequence[StatedLink],
    rotors: RotorInertia,
    notes: Sequence[str],
    file_payload: float,
    contact_frames: Mapping[str, int],
    tip: pin.SE3,
    name: str,
    base_frame: str,
) -> Robot:
    """Return the Robot of the model `bare`, with `rotors`, the load of `settings` and a plausibility check of `links`.

    m_L is `file_payload` [kg], which `bare` includes, the links that match a glob of `settings.tool_links`, and the
    payload of `settings`, in the frame of the first contact point at the end of a chain of joints, or else of `tip`.

    Raises RobotError for a model without joints or mass or with too many joints, for an impossible payload, and for
    `tool_links` that match none.
    """
    fields: dict[str, Any] = {"contact_frames": contact_frames, "tip": tip, "name": name, "base_frame": base_frame}
    if bare.nv == 0:
        raise RobotError(f"{origin}: must have at least one joint that moves")
    if bare.nv > MAX_MOVING_JOINTS:
        raise RobotError(f"{origin}: {bare.nv} joints move: must be at most {MAX_MOVING_JOINTS}; lock the others")
    if not any(link.mass > 0.0 for link in links):
        raise RobotError(f"{origin}: the moving links have no mass: every link must have its mass and centre of mass")
    joints = list(bare.names)[1:]
    for joint in settings.position_limits:
        if joint not in joints:
            raise RobotError(f"{origin}: joint_limits = {joint!r}: {nearest(joint, joints)}")
    model = bare.copy()
    model.armature = np.diag(rotors.matrix)
    load_notes = []
    if load := _payload(settings):
        ends = set(range(1, model.njoints)) - set(model.parents)
        frames = (model.frames[frame] for frame in contact_frames.values())
        places = ((frame.parentJoint, frame.placement) for frame in frames if frame.parentJoint in ends)
        joint, pose = next(places, (model.njoints - 1, tip))
        model.appendBodyToJoint(joint, load, pose)
        if len(ends) > 1:
            load_notes.append(f"the payload moves with {model.names[joint]}: name the point that carries it first")
        if not load.inertia.any():
            load_notes.append("the payload counts as a point mass: set payload_inertia")
    check = check_inertials(links)
    bodies = zip(list(model.names)[1:], list(model.inertias)[1:], strict=True)
    massless = [joint for joint, body in bodies if body.mass == 0.0]
    masses_reason = check.masses
    if massless:
        masses_reason = f"no mass behind {', '.join(massless)}: the robot is heavier than the file says"
    source = f"topic {settings.payload_topic}" if settings.payload_topic else "parameter payload_mass"
    payload = {
        "robot file": file_payload,
        f"tool_links {', '.join(settings.tool_links)}": _tool_mass(links, settings.tool_links, origin),
        source: settings.payload_mass,
    }
    robot = Robot(
        model=model,
        origin=origin,
        payload={name: mass for name, mass in payload.items() if mass or name.startswith("topic ")},
        rebuild=partial(
            build_robot, bare, origin, links=links, rotors=rotors, notes=notes, file_payload=file_payload, **fields
        ),
        rotors=rotors,
        lumping=settings.lumping,
        masses_reason=masses_reason,
        coms_reason=masses_reason or check.coms,
        inertias_reason=masses_reason or check.coms or check.inertias,
        notes=(*notes, *load_notes, *check.notes, *rotors.notes, *filter(None, [rotors.warning])),
        **fields,
    )
    judged = judge(robot)
    return replace(robot, reach=judged.reach, units_reason=judged.units, notes=(*robot.notes, *judged.notes))


def inertia_tensor(entries: Sequence[float]) -> FloatArray:
    """Return the tensor (3, 3) of `entries` ixx, iyy, izz, ixy, ixz, iyz."""
    ixx, iyy, izz, ixy, ixz, iyz = entries
    return np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])


def _payload(settings: MonitorSettings) -> pin.Inertia | None:
    """Return the payload of `settings`, None for a mass of 0. Raises RobotError for an inertia that no body has."""
    load = StatedLink(
        "payload", settings.payload_mass, np.array(settings.payload_com), inertia_tensor(settings.payload_inertia)
    )
    problem = "must be 0 without payload_mass" if not load.mass and load.inertia.any() else ""
    try:
        problem = problem or triangle_error(load)
    except ValueError as error:
        problem = str(error)
    if problem:
        raise RobotError(f"payload_inertia = {list(settings.payload_inertia)}: {problem}")
    return pin.Inertia(load.mass, load.com, load.inertia) if load.mass else None


def _tool_mass(links: Sequence[StatedLink], globs: Sequence[str], origin: str) -> float:
    """Return the mass [kg] of the `links` whose name matches one of `globs`. Raises RobotError for one without."""
    for glob in globs:
        if not any(fnmatchcase(link.name, glob) for link in links):
            names = ", ".join(link.name for link in links)
            raise RobotError(f"{origin}: tool_links = {glob!r}: must match one of the links {names}")
    return sum(link.mass for link in links if any(fnmatchcase(link.name, glob) for glob in globs))
