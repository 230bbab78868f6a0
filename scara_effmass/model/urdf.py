# SPDX-License-Identifier: Apache-2.0
"""Load a robot from URDF with Pinocchio's parser."""

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from scara_effmass.errors import RobotError
from scara_effmass.input_files import read_text
from scara_effmass.model.contact_point import contact_point
from scara_effmass.model.robot import Robot, add_contact_frame, build_robot
from scara_effmass.model.rotors import RotorInertia, rotor_inertia
from scara_effmass.model.transmission import armatures
from scara_effmass.model.urdf_tree import UrdfTree, read_urdf
from scara_effmass.settings import MonitorSettings


def load_urdf(path: Path, settings: MonitorSettings) -> Robot:
    """Return the robot of the URDF file at `path`. Raises RobotError."""
    return parse_urdf(read_text(path, RobotError), str(path), settings)


def parse_urdf(text: str, origin: str, settings: MonitorSettings) -> Robot:
    """Return the robot of the URDF `text`, such as a robot_description; `origin` names it in errors.

    `settings.contact_points` are links, or points in their frames (default: the tip of the longest chain). The model
    moves the joints from the base through every contact point to its `UrdfTree.tip_beyond`. All other joints, and
    those that match a glob of `settings.locked_joints`, are fixed: the mass behind them counts, their motion does not.
    `settings.armature` wins over the rotor inertia of the URDF. `build_robot` adds the payload. Raises RobotError.
    """
    tree = read_urdf(text, origin, settings.locked_joints, settings.position_limits)
    notes = []
    entries = settings.contact_points
    if not entries:
        entries = (tree.tip(tree.base),)
        notes.append(f"contact point {entries[0]}: the tip of the longest chain (set contact_points for another)")
    entries = tuple(dict.fromkeys(entries))
    points = [contact_point(entry) for entry in entries]
    # Without a link of its own, a contact point is the link of its name.
    links = [point.link or point.name for point in points]
    for entry, link in zip(entries, links, strict=True):
        if link not in tree.links:
            names = ", ".join(sorted(tree.links))
            raise RobotError(f"{origin}: contact_points = {entry!r}: must be one of {names}, or NAME=LINK: X Y Z")
    tips = [tree.tip_beyond(link) for link in links]
    needed = {joint for tip in tips for joint in tree.chain(tip)}
    for name in sorted(needed):
        tree.require_movable(name)
    fixed = {name for name in tree.joints if tree.kind(name) != "fixed" and (name not in needed or name in tree.locked)}
    if fixed:
        notes.append(f"held fixed in the model: {', '.join(sorted(fixed))}")
    model = _reduced_model(tree, fixed)
    rotors = _rotors(tree, list(model.names)[1:], settings.armature)
    frames: dict[str, int] = {}
    for entry, point, link in zip(entries, points, links, strict=True):
        body = model.frames[model.getBodyId(link)]
        if body.parentJoint == 0:
            locked = f" (locked: {', '.join(sorted(tree.locked))})" if tree.locked else ""
            raise RobotError(f"{origin}: contact_points = {entry!r}: must not be fixed to the base{locked}")
        add_contact_frame(model, frames, point.name, body.parentJoint, body.placement, point.at)
    moving = [link for link in tree.stated if model.frames[model.getBodyId(link.name)].parentJoint > 0]
    stated = sum(link.mass for link in moving)
    if not math.isclose(sum(body.mass for body in list(model.inertias)[1:]), stated, rel_tol=1e-9):
        raise RobotError(f"{origin}: Pinocchio does not read the <inertial> of every link: {stated:g} kg move")
    end = max((model.frames[model.getBodyId(name)] for name in (*links, *tips)), key=lambda frame: frame.parentJoint)
    return build_robot(
        model,
        origin,
        settings,
        links=moving,
        rotors=rotors,
        notes=notes,
        file_payload=0.0,
        contact_frames=frames,
        tip=end.placement,
        name=tree.root.get("name", ""),
        base_frame=tree.base,
    )


def _rotors(tree: UrdfTree, joints: Sequence[str], entries: Sequence[str]) -> RotorInertia:
    """Return the rotor inertia of `joints`, with a note on every transmission that states none."""
    stated, reasons = armatures(tree.root, tree.origin)
    matrix = np.diag([stated.get(name, math.nan) for name in joints])
    rotors = rotor_inertia(joints, matrix, "the URDF", entries, tree.origin)
    notes = [
        f"<transmission> of {', '.join(names)} {reason}"
        for reason in dict.fromkeys(reasons.values())
        if (names := [name for name in rotors.unstated if reasons.get(name) == reason])
    ]
    return replace(rotors, notes=(*rotors.notes, *notes))


def _reduced_model(tree: UrdfTree, fixed: set[str]) -> pin.Model:
    """Return Pinocchio's model with the joints `fixed` at zero, or at the limit nearest to zero."""
    try:
        model = pin.buildModelFromXML(ET.tostring(tree.root, encoding="unicode"))
        reference = np.clip(pin.neutral(model), model.lowerPositionLimit, model.upperPositionLimit)
        return pin.buildReducedModel(model, [model.getJointId(name) for name in sorted(fixed)], reference)
    except (ValueError, RuntimeError) as error:  # RuntimeError includes that of elements nested too deeply
        raise RobotError(f"{tree.origin}: Pinocchio cannot read it: {' '.join(str(error).split())}") from None
