"""Robots from URDF, through Pinocchio's parser."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from scara_effmass.errors import RobotError
from scara_effmass.model.robot import Robot, finished

if TYPE_CHECKING:
    from collections.abc import Sequence

_MOVING = ("revolute", "continuous", "prismatic")
_FULL_TURNS = 1e6
"""Range [rad] of a continuous joint: Pinocchio then keeps one coordinate for it, as joint_states has."""


def parse_urdf(
    text: str,
    origin: str,
    contact_points: Sequence[str] = (),
    locked_joints: Sequence[str] = (),
    payload_mass: float = 0.0,
) -> Robot:
    """Return the robot of the URDF `text`; `origin` names it in errors.

    `contact_points` are link names (default: the tip of the longest chain). Joints matching a glob of
    `locked_joints`, and joints that move no contact point, are held fixed: their mass counts, their motion does
    not. `payload_mass` [kg] is a point mass at the first contact point. Raises RobotError in one line.
    """
    root = _parsed(text, origin)
    joints = {joint.get("name", ""): joint for joint in root.findall("joint")}
    parent_of = {_link(joint, "child"): (_link(joint, "parent"), name) for name, joint in joints.items()}
    locked = {
        name
        for name, joint in joints.items()
        if joint.get("type") in _MOVING and any(fnmatchcase(name.lower(), glob.lower()) for glob in locked_joints)
    }
    links = {link.get("name", "") for link in root.findall("link")}
    notes = []
    if contact_points:
        for name in contact_points:
            if name not in links:
                raise RobotError(f"{origin}: contact point {name!r} is no link of it: it has {', '.join(sorted(links))}")
    else:
        contact_points = (_tip(links, parent_of, locked, joints, origin),)
        notes.append(f"contact point {contact_points[0]}: the tip of the longest chain (set contact_points for another)")
    needed = {name for point in contact_points for name in _chain(point, parent_of)}
    still = {name for name, joint in joints.items() if joint.get("type") in _MOVING and name not in needed} | locked
    if still:
        notes.append(f"held fixed in the model: {', '.join(sorted(still))}")
    for name in sorted(needed - still):
        joint = joints[name]
        if joint.get("type") not in (*_MOVING, "fixed"):
            raise RobotError(f"{origin}: joint {name}: type {joint.get('type')!r} is not one of {', '.join(_MOVING)}, fixed")
        if joint.find("mimic") is not None:
            raise RobotError(f"{origin}: joint {name} mimics another: name it in locked_joints to hold it fixed")
    model = _reduced(root, origin, still)
    frames = {name: model.getBodyId(name) for name in contact_points}
    tip = model.frames[frames[contact_points[0]]]
    if tip.parentJoint == 0:
        raise RobotError(f"{origin}: contact point {contact_points[0]!r} is fixed to the base: name one that moves")
    if payload_mass > 0.0:
        model.appendBodyToJoint(tip.parentJoint, pin.Inertia(payload_mass, np.zeros(3), np.zeros((3, 3))), tip.placement)
    roots = links - set(parent_of)
    return finished(
        model,
        origin,
        name=root.get("name", ""),
        base_frame=min(links - set(parent_of)),
        contact_frames=frames,
        tool_point=tuple(tip.placement.translation.tolist()),
        payload_mass=payload_mass,
        notes=tuple(notes),
    )


def _parsed(text: str, origin: str) -> ET.Element:
    try:
        root = ET.fromstring(text)  # noqa: S314  a robot description is trusted input: the robot runs on it
    except ET.ParseError as error:
        raise RobotError(f"{origin}: not XML: {error}") from None
    if root.tag != "robot":
        raise RobotError(f"{origin}: the root element is <{root.tag}>, a URDF has <robot>")
    if any("xacro" in element.tag for element in root.iter()):
        raise RobotError(f"{origin}: holds xacro macros: expand it first (xacro FILE > robot.urdf)")
    for joint in root.findall("joint"):
        limit = joint.find("limit")
        if joint.get("type") in {"revolute", "prismatic"} and (limit is None or limit.get("lower") == limit.get("upper")):
            raise RobotError(f"{origin}: joint {joint.get('name')}: needs <limit> with lower below upper")
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            if limit is None:
                limit = ET.SubElement(joint, "limit", effort="0", velocity="0")
            limit.set("lower", str(-_FULL_TURNS))
            limit.set("upper", str(_FULL_TURNS))
    return root


def _reduced(root: ET.Element, origin: str, still: set[str]) -> pin.Model:
    """Return Pinocchio's model with the joints `still` held at zero, or at the limit nearest to it."""
    try:
        model = pin.buildModelFromXML(ET.tostring(root, encoding="unicode"))
    except (ValueError, RuntimeError) as error:
        raise RobotError(f"{origin}: Pinocchio refuses it: {' '.join(str(error).split())}") from None
    reference = np.clip(pin.neutral(model), model.lowerPositionLimit, model.upperPositionLimit)
    ids = [model.getJointId(name) for name in sorted(still) if model.existJointName(name)]
    return pin.buildReducedModel(model, ids, reference)


def _link(joint: ET.Element, role: str) -> str:
    element = joint.find(role)
    return "" if element is None else element.get("link", "")


def _chain(link: str, parent_of: dict[str, tuple[str, str]]) -> list[str]:
    """Return the joints from `link` up to the root."""
    joints = []
    while link in parent_of:
        link, joint = parent_of[link]
        joints.append(joint)
    return joints


def _tip(
    links: set[str],
    parent_of: dict[str, tuple[str, str]],
    locked: set[str],
    joints: dict[str, ET.Element],
    origin: str,
) -> str:
    """Return the leaf link behind the most moving joints, then the most joints, outside what is locked."""
    leaves = links - {parent for parent, _ in parent_of.values()}
    ranked = []
    for leaf in leaves:
        chain = _chain(leaf, parent_of)
        if not locked.intersection(chain):
            moving = sum(joints[name].get("type") in _MOVING for name in chain)
            ranked.append((-moving, -len(chain), leaf))
    if not ranked:
        raise RobotError(f"{origin}: no link outside the locked joints: name a contact point in contact_points")
    return min(ranked)[2]
