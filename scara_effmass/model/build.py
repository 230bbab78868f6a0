# SPDX-License-Identifier: Apache-2.0
"""Build a robot from what a file states: contact points, load, rotors, and whether the data are plausible."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from scara_effmass.errors import RobotError
from scara_effmass.model.plausibility import StatedLink, check_inertials, judge, triangle_error
from scara_effmass.model.robot import Robot
from scara_effmass.model.rotors import RotorInertia
from scara_effmass.settings import MonitorSettings
from scara_effmass.settings.loading import nearest
from scara_effmass.values import FloatArray, Vector3

MAX_MOVING_JOINTS = 64
"""Largest number of joints of a model; the memory of its dynamics grows with its cube, 300 joints take 2.6 GB."""


class ContactPoint(NamedTuple):
    """A point to watch: `at` [m] in the frame of `link`; an empty `link` leaves both to the robot file."""

    name: str
    link: str
    at: Vector3


def contact_point(entry: str) -> ContactPoint:
    """Return the contact point of `entry`: "name", "name=link", or "name=link: x y z" [m]. Raises RobotError."""
    name, equals, place = entry.partition("=")
    link, text = place.rsplit(":", 1) if ":" in place else (place, "0 0 0")
    try:
        at = tuple(float(word) for word in text.split())
    except ValueError:
        at = ()
    if not name or bool(equals) > bool(link.strip()) or len(at) != 3 or not all(map(math.isfinite, at)):
        raise RobotError(f"contact_points = {entry!r}: must be NAME or NAME=LINK: X Y Z, in metres")
    return ContactPoint(name.strip(), link.strip(), at)


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
