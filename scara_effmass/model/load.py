# SPDX-License-Identifier: Apache-2.0
"""Load a robot from a file of any format, with its load and a check of its data."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np
import pinocchio as pin

from scara_effmass.errors import RobotError
from scara_effmass.model.description import MAX_VIRTUAL_M, RobotDescription, StatedLink, inertia_tensor, matching_links
from scara_effmass.model.dh import load_dh
from scara_effmass.model.hulls import shape_points, stated_hull
from scara_effmass.model.joint_values import torque_constants
from scara_effmass.model.light_ends import hold_light_end
from scara_effmass.model.plausibility import (
    MASS_REMEDY,
    MAX_DEGREES,
    MIN_DEGREES,
    InertialCheck,
    check_inertials,
    judge,
    triangle_error,
)
from scara_effmass.model.robot import Robot
from scara_effmass.model.urdf import load_urdf
from scara_effmass.settings import PAYLOAD_CONTACT, MonitorSettings
from scara_effmass.settings.loading import nearest

MAX_MOVING_JOINTS = 64
"""Largest number of joints of a model; the memory of its dynamics grows with its cube, 300 joints take 2.6 GB."""

MAX_GYRATION_M = 2.0
"""Largest radius of gyration of a payload, as of the distance of its centre of mass."""


class RobotFormat(Protocol):
    """Loader of one file format."""

    def __call__(self, path: Path, settings: MonitorSettings) -> RobotDescription:
        """Return what the file at `path` states. Raises RobotError where the file or `settings` cannot be used."""


ROBOT_FORMATS: dict[str, RobotFormat] = {
    ".urdf": load_urdf,
    ".yaml": load_dh,
    ".yml": load_dh,
}
"""Loader by file suffix."""


def loader_of(path: Path) -> RobotFormat:
    """Return what loads the file; one with an unknown suffix, such as .xml, is read as URDF."""
    return ROBOT_FORMATS.get(path.suffix.lower(), load_urdf)


def load_robot(path: str | Path | None = None, settings: MonitorSettings | None = None) -> Robot:
    """Return the robot in `path`; by default the one that `settings` name, the shipped Omron i4-550L if none.

    `settings` hold the contact points, the load and the armature, and for a URDF also locked joints. Raises RobotError.
    """
    settings = settings or MonitorSettings()
    path = Path(path or settings.robot_path)
    return build_robot(loader_of(path)(path, settings), settings)


def build_robot(stated: RobotDescription, settings: MonitorSettings) -> Robot:
    """Return the robot that a file has `stated`, with rotors, the load of `settings` and doubts about its data.

    m_L is the payload of the file, the links that match a glob of `settings.tool_links`, and the payload of `settings`,
    in the frame of the first contact point at the end of a chain of joints, or else of the tip.

    Raises RobotError for a model without joints or mass or with too many joints, for an impossible payload, and for
    `tool_links` that match none.
    """
    origin, links, rotors = stated.origin, stated.links, stated.rotors
    joints = list(stated.model.names)[1:]
    if not joints:
        raise RobotError(f"{origin}: must have at least one joint that moves")
    if len(joints) > MAX_MOVING_JOINTS:
        raise RobotError(f"{origin}: {len(joints)} joints move: must be at most {MAX_MOVING_JOINTS}; lock the others")
    if not settings.moving_mass and not any(link.mass > 0.0 for link in links):
        rule = "every link must have its mass and centre of mass; or state moving_mass, for ISO's mass"
        raise RobotError(f"{origin}: the moving links have no mass: {rule}")
    for joint, (lower, upper) in settings.position_limits.items():
        if joint not in joints:
            raise RobotError(f"{origin}: joint_limits = {joint!r}: {nearest(joint, joints)}")
        kind = stated.model.joints[joints.index(joint) + 1].shortname()
        if kind.startswith("JointModelR") and MIN_DEGREES < upper - lower <= MAX_DEGREES:
            raise RobotError(f"joint_limits = '{joint}={lower:g} {upper:g}': must be in radians, not in degrees")
    stated = _with_payload_shape(stated, settings)
    model = stated.model.copy()
    model.armature = np.diag(rotors.matrix)
    contact_frames = _add_contact_frames(model, stated)
    tool_mass = _tool_mass(links, settings.tool_links, origin)
    if settings.moving_mass:
        _replace_masses(model, settings.moving_mass + tool_mass + stated.payload_mass)
    load_notes = _add_payload(model, stated, settings)
    if settings.moving_mass:
        check = InertialCheck("", "moving_mass is stated, so ISO's mass counts", "", ())
    else:  # a link without mass has one as soon as it carries a load
        check = _with_massless(check_inertials(links), model)
    masses_reason = check.masses
    robot = Robot(
        origin=origin,
        base_frame=stated.base_frame,
        model=model,
        contact_frames=contact_frames,
        tip=stated.tip,
        payload=_payload(stated.payload_mass, tool_mass, settings),
        rebuild=partial(build_robot, stated),
        rotors=rotors,
        lumping=settings.lumping,
        masses_reason=masses_reason,
        coms_reason=masses_reason or check.coms,
        inertias_reason=masses_reason or check.coms or check.inertias,
        notes=(*stated.notes, *load_notes, *check.notes, *rotors.notes, *filter(None, [rotors.warning])),
        stated=stated.stated,
        held=stated.held,
        hulls=stated.hulls,
        unwatched=stated.unwatched,
        torque_constants=torque_constants(settings.torque_constants, joints, stated.torque_constants),
    )
    if stated.tool_tip in contact_frames:
        robot = hold_light_end(robot, stated.tool_tip)
    judged = judge(robot, links)
    robot = replace(robot, reach=judged.reach, units_reason=judged.units, notes=(*robot.notes, *judged.notes))
    masses = robot.masses_reason or judged.masses
    coms = robot.coms_reason or judged.masses
    inertias = robot.inertias_reason or judged.masses or judged.inertias
    return replace(robot, masses_reason=masses, coms_reason=coms, inertias_reason=inertias)


def _payload(stated_mass: float, tool_mass: float, settings: MonitorSettings) -> dict[str, float]:
    """Return the masses of the load [kg] by source, without those of 0, except a topic's and a stated one alone."""
    topic = settings.payload_topic
    sources = {"robot file": stated_mass, f"tool_links {', '.join(settings.tool_links)}": tool_mass}
    payload = {source: mass for source, mass in sources.items() if mass}
    if topic or settings.payload_mass or (not payload and "payload_mass" in settings.model_fields_set):
        payload[f"topic {topic}" if topic else "parameter payload_mass"] = settings.payload_mass
    return payload


def _replace_masses(model: pin.Model, mass: float) -> None:
    """Give the last body of `model` all of `mass` [kg], and no joint an effort limit: gravity is unknown, too."""
    for joint in range(1, model.njoints):
        model.inertias[joint] = pin.Inertia(mass * (joint == model.njoints - 1), np.zeros(3), np.zeros((3, 3)))
    model.effortLimit = np.zeros(model.nv)


def _with_massless(check: InertialCheck, model: pin.Model) -> InertialCheck:
    """Return `check` with the links of `model` that lack a mass, and a note on links that only join two joints.

    Those are short, such as between the axes of a base that moves in x, y and yaw, and have mass beyond them.
    """
    missing, virtual = list[str](), list[str]()
    for joint in range(1, model.njoints):
        if model.inertias[joint].mass > 0.0:
            continue
        lengths = [
            float(np.linalg.norm(model.jointPlacements[child].translation))
            for child in range(joint + 1, model.njoints)
            if model.parents[child] == joint
        ]
        beyond = sum(model.inertias[int(body)].mass for body in model.subtrees[joint])
        is_virtual = beyond > 0.0 and max(lengths, default=math.inf) <= MAX_VIRTUAL_M
        (virtual if is_virtual else missing).append(model.names[joint])
    if virtual:
        note = f"links without mass, which only join two joints: behind {', '.join(virtual)}"
        check = check._replace(notes=(note, *check.notes))
    if missing:
        problem = f"no mass behind {', '.join(missing)}: the robot is heavier than the file says"
        check = check._replace(masses=f"{problem}: {MASS_REMEDY}")
    return check


def _add_contact_frames(model: pin.Model, stated: RobotDescription) -> dict[str, int]:
    """Add a frame per contact point to `model` and return the ids of the frames by name. Raises RobotError."""
    frames: dict[str, int] = {}
    for name, joint, pose in stated.contact_points:
        if name in frames:
            raise RobotError(f"contact_points = {name!r}: must name each point once")
        frames[name] = model.addFrame(pin.Frame(name, joint, 0, pose, pin.FrameType.OP_FRAME))
    return frames


def _payload_frame(stated: RobotDescription) -> tuple[set[int], int, pin.SE3]:
    """Return the joints at the ends of chains, and joint and pose of the frame of the payload."""
    ends = set(range(1, stated.model.njoints)) - set(stated.model.parents)
    places = ((joint, pose) for _, joint, pose in stated.contact_points if joint in ends)
    return ends, *next(places, (stated.model.njoints - 1, stated.tip))


def _with_payload_shape(stated: RobotDescription, settings: MonitorSettings) -> RobotDescription:
    """Return `stated` with `payload_shape` as a contact. Raises RobotError."""
    shapes = settings.payload_shapes
    if not shapes:
        return stated
    if any(name == PAYLOAD_CONTACT for name, *_ in stated.contact_points):
        raise RobotError(f"{stated.origin}: payload_shape: another contact has the name {PAYLOAD_CONTACT}: rename it")
    _, joint, pose = _payload_frame(stated)
    points = np.concatenate([shape_points(shape.kind, shape.sizes) + shape.centre for shape in shapes])
    hull = stated_hull(PAYLOAD_CONTACT, joint, points @ pose.rotation.T + pose.translation)
    return replace(
        stated,
        contact_points=[*stated.contact_points, (PAYLOAD_CONTACT, joint, pose)],
        hulls={**stated.hulls, PAYLOAD_CONTACT: hull.vertices},
    )


def _add_payload(model: pin.Model, stated: RobotDescription, settings: MonitorSettings) -> list[str]:
    """Add the payload of `settings` to `model`, and return notes. Raises RobotError for an inertia that no body has."""
    load = StatedLink(
        "payload", settings.payload_mass, np.array(settings.payload_com), inertia_tensor(settings.payload_inertia)
    )
    is_forgotten = "payload_mass" not in settings.model_fields_set and not settings.payload_topic
    if load.com.any() and is_forgotten:
        raise RobotError(f"payload_com = {list(settings.payload_com)}: must be 0 without payload_mass")
    problem = "must be 0 without payload_mass" if not load.mass and load.inertia.any() else ""
    try:
        problem = problem or triangle_error(load)
    except ValueError as error:
        problem = str(error)
    if not problem and np.linalg.norm(load.inertia, 2) > MAX_GYRATION_M**2 * load.mass:
        problem = f"must be of a radius of gyration of at most {MAX_GYRATION_M:g} m"
    if problem:
        raise RobotError(f"payload_inertia = {list(settings.payload_inertia)}: {problem}")
    if not load.mass:
        return []
    ends, joint, pose = _payload_frame(stated)
    model.appendBodyToJoint(joint, pin.Inertia(load.mass, load.com, load.inertia), pose)
    notes = []
    if len(ends) > 1:
        notes.append(f"the payload moves with {model.names[joint]}: name the point that carries it first")
    if not load.inertia.any():
        notes.append("the payload counts as a point mass: set payload_inertia")
    return notes


def _tool_mass(links: Sequence[StatedLink], globs: Sequence[str], origin: str) -> float:
    """Return the mass [kg] of the `links` whose name matches one of `globs`. Raises RobotError for one without."""
    chosen = matching_links([link.name for link in links], globs, f"{origin}: tool_links", "one of the links")
    return sum(link.mass for link in links if link.name in chosen)
