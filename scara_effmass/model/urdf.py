"""Robots from URDF, through Pinocchio's parser."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from scara_effmass.errors import RobotError
from scara_effmass.model.robot import build_robot
from scara_effmass.model.urdf_tree import read_urdf

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from scara_effmass.model.robot import Robot
    from scara_effmass.model.urdf_tree import UrdfTree
    from scara_effmass.values import FloatArray


def parse_urdf(
    text: str,
    origin: str,
    contact_points: Sequence[str] = (),
    locked_joints: Sequence[str] = (),
    payload_mass: float = 0.0,
    armature: Mapping[str, float] | None = None,
) -> Robot:
    """Return the robot of the URDF `text`; `origin` names it in errors.

    `contact_points` are link names (default: the tip of the longest chain). The model moves the joints from the
    base through every contact point to the tip beyond it. The others, and those matching a glob of
    `locked_joints`, are held fixed: their mass counts, their motion does not. `payload_mass` [kg] is a point mass
    at the first contact point behind the last joint, or at the tip. `armature` is the rotor inertia reflected to
    joints, by name [kg m2, kg]: URDF has no place for it. Raises RobotError in one line.
    """
    tree = read_urdf(text, origin, locked_joints)
    notes = []
    if not contact_points:
        contact_points = (tree.tip(tree.base),)
        notes.append(
            f"contact point {contact_points[0]}: the tip of the longest chain (set contact_points for another)"
        )
    for name in contact_points:
        if name not in tree.links:
            raise RobotError(
                f"{origin}: contact point {name!r} is no link of it: it has {', '.join(sorted(tree.links))}"
            )
    tips = [tree.tip(name) for name in contact_points]
    needed = {joint for tip in tips for joint in tree.chain(tip)}
    for name in sorted(needed):
        tree.require_movable(name)
    held = {name for name in tree.joints if tree.kind(name) != "fixed" and (name not in needed or name in tree.locked)}
    if held:
        notes.append(f"held fixed in the model: {', '.join(sorted(held))}")
    model = _reduced(tree, held)
    model.armature = _armature(model, armature or {}, origin)
    frames = {name: model.getBodyId(name) for name in contact_points}
    for name, frame in frames.items():
        if model.frames[frame].parentJoint == 0:
            locked = f" (locked: {', '.join(sorted(tree.locked))})" if tree.locked else ""
            raise RobotError(f"{origin}: contact point {name!r} is fixed to the base{locked}: name one that moves")
    end = max(
        (model.frames[model.getBodyId(name)] for name in (*contact_points, *tips)), key=lambda frame: frame.parentJoint
    )
    if payload_mass > 0.0:
        model.appendBodyToJoint(
            end.parentJoint, pin.Inertia(payload_mass, np.zeros(3), np.zeros((3, 3))), end.placement
        )
    return build_robot(
        model,
        origin,
        [link for link in tree.stated if model.frames[model.getBodyId(link.name)].parentJoint > 0],
        notes,
        name=tree.root.get("name", ""),
        base_frame=tree.base,
        contact_frames=frames,
        tool_point=tuple(end.placement.translation.tolist()),
        payload_mass=payload_mass,
    )


def _armature(model: pin.Model, given: Mapping[str, float], origin: str) -> FloatArray:
    names = list(model.names)[1:]
    for name, value in given.items():
        if name not in names:
            raise RobotError(f"{origin}: armature {name} = {value}: the model moves {', '.join(names)}")
    return np.array([given.get(name, 0.0) for name in names])


def _reduced(tree: UrdfTree, held: set[str]) -> pin.Model:
    """Return Pinocchio's model with the joints `held` at zero, or at the limit nearest to it."""
    try:
        model = pin.buildModelFromXML(ET.tostring(tree.root, encoding="unicode"))
        reference = np.clip(pin.neutral(model), model.lowerPositionLimit, model.upperPositionLimit)
        return pin.buildReducedModel(model, [model.getJointId(name) for name in sorted(held)], reference)
    except (ValueError, RuntimeError) as error:
        raise RobotError(f"{tree.origin}: Pinocchio refuses it: {' '.join(str(error).split())}") from None
