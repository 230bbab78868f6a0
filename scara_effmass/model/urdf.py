# SPDX-License-Identifier: Apache-2.0
"""Load a robot from URDF: check the numbers of its tree of links and joints, then build it with Pinocchio's parser.

Pinocchio's parser skips what it cannot read, with a message on stderr only, so all numbers are checked before.
"""

from __future__ import annotations

import copy
import math
import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from itertools import takewhile
from pathlib import Path

import numpy as np
import pinocchio as pin

from scara_effmass.errors import RobotError
from scara_effmass.input_files import read_text
from scara_effmass.model.description import (
    CONTINUOUS_LIMIT,
    LEFT_OUT,
    MAX_VIRTUAL_M,
    ContactPoint,
    HeldJoint,
    RobotDescription,
    RotorInertia,
    StatedLink,
    angles_of,
    contact_point,
    inertia_tensor,
    link_length,
    numbers_of,
    principal_moments,
    rotor_inertia,
    watched_links,
)
from scara_effmass.model.hulls import LinkHull, margin, outer_vertices, package_folders, urdf_hulls
from scara_effmass.settings import WHOLE_ARM, MonitorSettings
from scara_effmass.values import FloatArray

MOVING = ("revolute", "continuous", "prismatic")
CHAIN_NOTES = (
    "contact point ",
    "chains of as many joints ",
    "held fixed in the model: ",
    "the arm ends at its gripper",
    "links as a whole, ",
    LEFT_OUT,
    "by their visual geometry",
    "no link has geometry",
    "not watched for lack of geometry: ",
)
"""Starts of the notes on which joints the model moves and which links are watched, and why."""
MIN_SHARE, MIN_EXTENT, MAX_MARGIN_M = 0.01, 0.1, 0.05
"""Share of the moving mass from which on a link must have geometry, extent of its geometry over its length, and
distance [m] from the geometry around it up to which a link needs none."""
MAX_JOINTS = 500
"""Largest number of joints in a file, fixed ones included; the time to check them grows with its square."""
LIGHT_SHARE = 0.1
"""Share of the moving mass below which joints beyond a contact point may be held in the model."""
FINGER_M, FINGER_RAD = 0.3, math.pi
"""Largest length of a finger from its first joint on, and range of that joint: a wrist turns farther."""
MIN_COSINE = 0.9
"""Cosine of the largest angle between the fingers and a point before them, seen from the link that carries them."""
ALIKE, FINGER_KG = 4.0, 0.05
"""Ratio of masses up to which branches are fingers of one gripper, and a mass that any finger may have."""
_ROTOR_INERTIA = ("rotor_inertia", "motorInertia")
_REDUCTION = ("gear_ratio", "mechanicalReduction")
"""Drake's ratio first: its files keep a mechanicalReduction of 1 beside it."""
_WAY_OUT = {
    "mujoco": "this is MJCF: use the robot's URDF, or convert it with mjcf_urdf_simple_converter",
    "mujocoinclude": "this is a part of an MJCF: use the robot's URDF",
    "sdf": "this is SDF: use the robot's URDF, or convert it with sdformat_urdf, `ros2 run sdformat_urdf` or `gz sdf`",
}
"""How to get a URDF from another format, by its root element."""
_XACRO = "must not contain xacro macros: expand them first (xacro FILE > robot.urdf)"
_SWEEP = np.linspace(0.0, 1.0, 5)
"""Shares of the ranges of a gripper's fingers at which the hulls hold them."""
_MIN_AXIS_LENGTH = 1e-9
"""Length below which an axis has no direction."""


def load_urdf(path: Path, settings: MonitorSettings) -> RobotDescription:
    """Return what the URDF file at `path` states. Raises RobotError."""
    return parse_urdf(read_text(path, RobotError), str(path), settings)


def parse_urdf(text: str, origin: str, settings: MonitorSettings) -> RobotDescription:
    """Return what the URDF `text`, such as a robot_description, states; `origin` names it in errors.

    `settings.contact_points` are links, or points in their frames (default: the tip of the longest chain, and every
    link as a whole if the geometry of all of them can be read and the contact normal is not known). The model
    moves the joints from the base through every contact point to its `UrdfTree.tip_beyond`. All other joints, and
    those that match a glob of `settings.locked_joints`, are fixed: the mass behind them counts, their motion does not.
    `settings.armature` wins over the rotor inertia of the URDF. Raises RobotError.
    """
    tree = read_urdf(text, origin, settings.locked_joints)
    _require_matches(settings.locked_joints, tree)
    notes, tip = list[str](), tree.tip(tree.base)
    entries = tuple(dict.fromkeys(entry for entry in settings.contact_points if entry != WHOLE_ARM))
    if not entries:
        entries = (tip,)
        notes += tree.notes_on_tip(tip)
    points, links = tree.points(entries)
    tips = [tree.tip_beyond(link) for link in links]
    needed = {joint for tip in tips for joint in tree.chain(tip)}
    tree.require_no_follower(needed)
    for name in sorted(needed):
        tree.require_movable(name)
    _set_limits(tree, needed - tree.locked, settings.position_limits)
    fixed = {name for name in tree.joints if tree.kind(name) != "fixed" and (name not in needed or name in tree.locked)}
    if fixed:
        notes.append(f"held fixed in the model: {', '.join(sorted(fixed))}")
    if tree.lost:
        notes.append(f"mimic a joint that does not exist: {', '.join(tree.lost)}")
    if parts := sorted(tree.gripper & fixed - tree.named):
        notes.append(
            f"the arm ends at its gripper, which branches or mimics and yields no more than held: {', '.join(parts)}"
        )
    model, positions = _reduced_model(tree, fixed)
    frames = _frames(tree, model)
    rotors = _rotors(tree, list(model.names)[1:], settings.armature)
    placed = []
    for entry, point, link in zip(entries, points, links, strict=True):
        if frames[link].parentJoint == 0:
            locked = f" (locked: {', '.join(sorted(tree.locked))})" if tree.locked else ""
            raise RobotError(f"{origin}: contact_points = {entry!r}: must not be fixed to the base{locked}")
        pose = frames[link].placement * pin.SE3(np.eye(3), np.array(point.at))
        placed.append((point.name, frames[link].parentJoint, pose))
    hulls, unwatched, hull_notes = _hulls(tree, model, frames, fixed, placed, settings)
    notes += hull_notes
    moving = [
        link._replace(share=link.mass / (model.inertias[joint].mass or 1.0))
        for link in tree.stated
        if (joint := frames[link.name].parentJoint) > 0
    ]
    mass = sum(link.mass for link in moving)
    if not math.isclose(sum(body.mass for body in list(model.inertias)[1:]), mass, rel_tol=1e-9):
        raise RobotError(f"{origin}: Pinocchio does not read the <inertial> of every link: {mass:g} kg move")
    return RobotDescription(
        origin=origin,
        base_frame=tree.base,
        model=model,
        links=moving,
        rotors=rotors,
        payload_mass=0.0,
        contact_points=placed,
        tip=max((frames[name] for name in (*links, *tips)), key=lambda frame: frame.parentJoint).placement,
        notes=notes,
        stated=frozenset(),
        torque_constants=np.ones(model.nv),
        tool_tip=tip,
        held=tuple(
            HeldJoint(
                name,
                is_harmless=tree.is_harmless(name, needed),
                position=positions[name] if tree.shapes_arm(name, needed) else math.nan,
                is_stated=name in tree.named,
                is_wheel=name in tree.wheels,
            )
            for name in sorted(fixed)
        ),
        hulls=hulls,
        unwatched=unwatched,
    )


def _hulls(
    tree: UrdfTree,
    model: pin.Model,
    frames: Mapping[str, pin.Frame],
    fixed: set[str],
    placed: list[tuple[str, int, pin.SE3]],
    settings: MonitorSettings,
) -> tuple[dict[str, FloatArray], tuple[str, ...], list[str]]:
    """Return the hulls of the links that `whole_arm` watches, what it does not watch, and notes.

    Append the links that it watches to `placed`. The hull of a link that is a contact point, too, holds that point.
    Raises RobotError for geometry that cannot be read, unless it is not asked for, and for a missing folder in
    `package_dirs`.
    """
    if missing := next((folder for folder in settings.package_dirs if not Path(folder).is_dir()), None):
        raise RobotError(f"package_dirs = {missing}: must be a folder")
    if WHOLE_ARM not in (settings.contact_points or (WHOLE_ARM,)) or settings.contact_normal != "worst":
        return {}, (), []
    path = Path(tree.origin)
    folders = package_folders(path if path.is_file() else None, [Path(folder) for folder in settings.package_dirs])
    try:
        sweep = [_frames(tree, _reduced_model(tree, fixed, share)[0]) for share in _SWEEP] if tree.fingers else []
        found = urdf_hulls(tree.links, tree.origin, frames, folders, sweep)
    except RobotError as error:
        if settings.contact_points:
            raise
        return {}, (), [f"only the tip is watched, not whole_arm: {str(error).removeprefix(f'{tree.origin}: ')}"]
    if not found:
        return {}, (), ["no link has geometry: only the contact points are watched"]
    named = {joint for _, joint, _ in placed} if settings.contact_points else set[int]()
    is_chosen = settings.contact_links != MonitorSettings.model_fields["contact_links"].default
    unwatched = () if is_chosen else tuple(_unwatched(tree, model, frames, found, placed, named))
    points, hulls = {name: (joint, pose) for name, joint, pose in placed}, dict[str, FloatArray]()
    watched, left_out = watched_links([hull.link for hull in found], settings.contact_links, tree.origin)
    for hull in (hull for hull in found if hull.link in watched):
        tree.require_short_follower(hull, frames, set(tree.joints) - fixed)
        if hull.link in points:
            hulls[hull.link] = outer_vertices(np.vstack([hull.vertices, points[hull.link][1].translation]))
        else:
            placed.append((hull.link, hull.joint, frames[hull.link].placement))
            hulls[hull.link] = hull.vertices
    shapes = ", ".join(f"{hull.link} {hull.looseness:.2f}" for hull in found if hull.link in hulls)
    notes = [f"links as a whole, by polytopes with a volume over that of their convex hull of: {shapes}"]
    notes += left_out
    if visual := [hull.link for hull in found if hull.source == "visual" and hull.link in hulls]:
        notes.append(f"by their visual geometry, without another: {', '.join(visual)}")
    if unwatched:
        remedy = "add it, name contact points there, or state contact_links"
        notes.append(f"not watched for lack of geometry: {', '.join(unwatched)}: {remedy}")
    return hulls, unwatched, notes


def _unwatched(
    tree: UrdfTree,
    model: pin.Model,
    frames: Mapping[str, pin.Frame],
    found: Sequence[LinkHull],
    placed: Sequence[tuple[str, int, pin.SE3]],
    named: Collection[int],
) -> Iterator[str]:
    """Yield the moving links that the hulls `found` and the contact points `placed` do not cover.

    They are links with mass and without a hull, links whose hulls are much shorter, and those whose frame or centre of
    mass is far outside. A joint whose index is in `named` carries a contact point that the settings name.
    """
    shaped, seen = {hull.link for hull in found}, set(named)
    masses = {link.name: link.mass for link in tree.stated if frames[link.name].parentJoint > 0}
    for name, mass in masses.items():
        joint = frames[name].parentJoint
        if name not in shaped and joint not in named and mass > MIN_SHARE * sum(masses.values()):
            seen.add(joint)
            yield name
    coms = {link.name: link.com for link in tree.stated}
    for joint in (joint for joint in range(1, model.njoints) if joint not in seen):
        ends = {name: frame.placement for name, frame in frames.items() if frame.parentJoint == joint}
        length = link_length(model, joint, ends.values())
        hulls = [hull.vertices for hull in found if hull.joint == joint]
        extent = float(np.ptp(np.concatenate(hulls), axis=0).max()) if hulls else 0.0
        if length > MAX_VIRTUAL_M and extent < MIN_EXTENT * length:
            yield f"the link behind {model.names[joint]}"
        elif hulls:
            watched = np.vstack([*hulls, *(pose.translation for _, parent, pose in placed if parent == joint)])
            for name in sorted(ends.keys() - shaped):
                place, com = ends[name], coms.get(name, np.zeros(3))
                if margin(np.array([place.translation, place.act(com)]), watched) > MAX_MARGIN_M:
                    yield name


def _rotors(tree: UrdfTree, joints: Sequence[str], entries: Sequence[str]) -> RotorInertia:
    """Return the rotor inertia of `joints`, with a note on every transmission that states none."""
    stated, reasons = _armatures(tree.root, tree.origin)
    matrix = np.diag([stated.get(name, math.nan) for name in joints])
    rotors = rotor_inertia(joints, matrix, "the URDF", entries, tree.origin)
    notes = [
        f"<transmission> of {', '.join(names)} {reason}"
        for reason in dict.fromkeys(reasons.values())
        if (names := [name for name in rotors.unstated if reasons.get(name) == reason])
    ]
    return replace(rotors, notes=(*rotors.notes, *notes))


def _armatures(root: ET.Element, origin: str) -> tuple[dict[str, float], dict[str, str]]:
    """Return the armature N^2 J by joint name, and why a transmission gives none, by joint name. Raises RobotError.

    `<dynamics armature=...>` of a joint is N^2 J. A `<transmission>` states the reduction N, and some the rotor inertia
    J: `<motorInertia>`, or Drake's `<drake:rotor_inertia value=...>` with `<drake:gear_ratio value=...>`.
    """
    armature: dict[str, float] = {}
    reasons: dict[str, str] = {}
    for joint in root.findall("joint"):
        dynamics = joint.find("dynamics")
        if dynamics is not None and "armature" in dynamics.attrib:
            name = joint.get("name", "")
            armature[name] = _rotor_number(dynamics.get("armature"), f"{origin}: joint {name}: <dynamics armature>")
    for transmission in root.findall("transmission"):
        where = f"{origin}: transmission {transmission.get('name')}"
        joints = [joint.get("name", "") for joint in transmission.findall("joint")]
        actuators = transmission.findall("actuator")
        if len(joints) != 1 or len(actuators) > 1:
            reasons |= dict.fromkeys(joints, "couples several joints or motors")
            continue
        rotor = _first(actuators, _ROTOR_INERTIA, where)
        if math.isnan(rotor):
            reasons[joints[0]] = "states no rotor inertia"
        else:
            reduction = _first((*actuators, transmission), _REDUCTION, where)
            armature[joints[0]] = rotor * (1.0 if math.isnan(reduction) else reduction * reduction)
    return armature, {joint: reason for joint, reason in reasons.items() if joint not in armature}


def _first(parents: Iterable[ET.Element], tags: Sequence[str], where: str) -> float:
    """Return the number in the first child of `parents` named in `tags`, in any namespace; NaN if there is none."""
    for tag in tags:
        for parent in parents:
            for child in parent:
                if child.tag.rpartition("}")[2] == tag:
                    return _rotor_number(child.get("value", child.text), f"{where}: <{tag}>")
    return math.nan


def _rotor_number(text: str | None, where: str) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not 0.0 <= abs(value) < math.inf:
        raise RobotError(f"{where} = {text!r}: must be a finite number")
    return value


def _frames(tree: UrdfTree, model: pin.Model) -> dict[str, pin.Frame]:
    """Return the frames of the links, by name."""
    return {name: model.frames[model.getBodyId(name)] for name in tree.links}


def _reduced_model(tree: UrdfTree, fixed: set[str], share: float | None = None) -> tuple[pin.Model, dict[str, float]]:
    """Return Pinocchio's model with the joints `fixed` at zero, or at the limit nearest to it, and their positions.

    Fingers of a gripper are at a `share` of their range if it is given.
    """
    try:
        root = copy.deepcopy(tree.root)
        # The parser prints messages on materials and geometry, which the model does not need.
        for material in root.findall("material"):
            root.remove(material)
        for link in root.findall("link"):
            for geometry in (*link.findall("visual"), *link.findall("collision")):
                link.remove(geometry)
        # A joint may have the name of a link, which Pinocchio cannot reduce.
        renamed = {name: f"{name} (joint)" if name in tree.links else name for name in tree.joints}
        for joint in root.findall("joint"):
            joint.set("name", renamed[joint.get("name", "")])
        model = pin.buildModelFromXML(ET.tostring(root, encoding="unicode"))
        reference = np.clip(pin.neutral(model), model.lowerPositionLimit, model.upperPositionLimit)
        joints = {name: model.getJointId(renamed[name]) for name in sorted(fixed)}
        # A planar or floating joint has several coordinates, and is held at zero.
        places = {name: (model.idx_qs[joint], model.nqs[joint]) for name, joint in joints.items()}
        for name in tree.fingers if share is not None else ():
            master, factor, offset = tree.drive(name)
            (index, size), driven_by = places[name], places[master][0]
            lower, upper = model.lowerPositionLimit[driven_by], model.upperPositionLimit[driven_by]
            if size == 1 and upper - lower <= FINGER_RAD:
                reference[index] = offset + factor * (lower + share * (upper - lower))
        positions = {name: float(reference[index]) if size == 1 else 0.0 for name, (index, size) in places.items()}
        reduced = pin.buildReducedModel(model, list(joints.values()), reference)
    except (ValueError, RuntimeError) as error:  # RuntimeError includes that of elements nested too deeply
        raise RobotError(f"{tree.origin}: Pinocchio cannot read it: {' '.join(str(error).split())}") from None
    for name, unique in renamed.items():
        if reduced.existJointName(unique):
            reduced.names[reduced.getJointId(unique)] = name
    return reduced, positions


def read_urdf(text: str, origin: str, locked_joints: Sequence[str]) -> UrdfTree:
    """Return the tree of the URDF `text`, without a check of the limits of joints. Raises RobotError."""
    if "<!ENTITY" in text:
        raise RobotError(f"{origin}: must not define XML entities")
    try:
        root = ET.fromstring(text)  # noqa: S314  a robot description is trusted input: the robot runs on it
    except (ET.ParseError, ValueError) as error:
        if "<xacro:" in text:  # its prefix is often declared nowhere
            raise RobotError(f"{origin}: {_XACRO}") from None
        raise RobotError(f"{origin}: not XML: {error}") from None
    if root.tag != "robot":
        way_out = f"; {_WAY_OUT[root.tag]}" if root.tag in _WAY_OUT else ""
        raise RobotError(f"{origin}: root element = <{root.tag}>: must be <robot>{way_out}")
    if any("xacro" in element.tag for element in root.iter()):
        raise RobotError(f"{origin}: {_XACRO}")
    joints = root.findall("joint")
    if len(joints) > MAX_JOINTS:
        raise RobotError(f"{origin}: {len(joints)} joints: must be at most {MAX_JOINTS}")
    for joint in joints:
        where = f"{origin}: joint {joint.get('name')}"
        _check_pose(joint, where)
        for dynamics in joint.findall("dynamics"):
            dynamics.attrib.setdefault("damping", "0")  # urdfdom refuses an armature alone
            for key in ("damping", "friction"):
                numbers_of(dynamics, key, where, 1, default="0")
    return UrdfTree(root, origin, locked_joints)


class UrdfTree:
    """Links and joints of a URDF; `locked` are joints that match the globs of `locked_joints`, or are of a gripper."""

    def __init__(self, root: ET.Element, origin: str, locked_joints: Sequence[str]) -> None:
        self.root = root
        self.origin = origin
        self.links = _by_name(root, "link", origin)
        self.joints = _by_name(root, "joint", origin)
        self.stated = [link for name, element in self.links.items() for link in _stated(name, element, origin)]
        self.named = {name for name in self.joints if self.kind(name) != "fixed" and _is_locked(name, locked_joints)}
        self.locked = self.named
        self._parents: dict[str, tuple[str, str]] = {}
        for name, joint in self.joints.items():
            parent, child = (_end(joint, role, self.links, origin) for role in ("parent", "child"))
            if child in self._parents:
                raise RobotError(
                    f"{origin}: link {child}: must have one joint above it, not {self._parents[child][1]} and {name}"
                )
            self._parents[child] = (parent, name)
        self._links_of = {name: (parent, child) for child, (parent, name) in self._parents.items()}
        bases = sorted(self.links.keys() - self._parents.keys())
        if len(bases) != 1:
            raise RobotError(
                f"{origin}: links without parent: {', '.join(bases) or 'none'}: must be exactly one, the base"
            )
        self.base = bases[0]
        for link in self.links:
            if len(set(self._chain_links(link))) != len(self._chain_links(link)):
                raise RobotError(f"{origin}: link {link}: the joints above it must not form a loop")
        mimics = {name: joint.find("mimic") for name, joint in self.joints.items() if self.kind(name) != "fixed"}
        self._masters = {name: mimic.get("joint", "") for name, mimic in mimics.items() if mimic is not None}
        """The joint that each joint with <mimic> follows."""
        self.lost = sorted(name for name, master in self._masters.items() if master not in self.joints)
        """Joints that mimic one that does not exist."""
        self._moving = {name for name in self.joints if self.kind(name) != "fixed"}
        self._masses = dict.fromkeys(self.joints, 0.0)
        for stated in self.stated:
            for name in self.chain(stated.name):
                self._masses[name] += stated.mass
            self._check_moments(stated)
        masses = [stated.mass for stated in self.stated if self._moving.intersection(self.chain(stated.name))]
        self._light_kg = LIGHT_SHARE * (sum(masses) - max(masses, default=0.0))
        """Mass below which a part is light; of a robot without masses nothing is. The heaviest link may be a base."""
        self._origins = {name: _origin(joint) for name, joint in self.joints.items()}
        self._lengths = dict.fromkeys(self.joints, 0.0)
        """Distances [m] of the origins of joints and links from each joint on, added along the chain."""
        for link in self.links:
            length = 0.0
            for name in self.chain(link):
                self._lengths[name] = max(self._lengths[name], length)
                length += float(np.linalg.norm(self._origins[name].translation))
        self.fingers = self._beyond({name for names in self._branches() if self._is_hand(names) for name in names})
        """Joints of grippers that branch into fingers, see `_is_hand`."""
        self.gripper = self.fingers | self._beyond(self._coupled_fingers())
        """Joints of grippers by their structure, whatever their names, which are held as the locked ones are."""
        self.locked = self.named | self.gripper
        driven, steered = ({name for name in self._moving if self._is_wheel(name, forks)} for forks in (0, 1))
        self.wheels = driven or steered
        """Joints that may drive the base: its wheels, or if it has none, those of its steered forks."""

    def _check_moments(self, link: StatedLink) -> None:
        """Raise RobotError for a negative principal moment of a `link` that moves."""
        if any(self.kind(name) != "fixed" for name in self.chain(link.name)):
            try:
                principal_moments(link.inertia)
            except ValueError as error:
                raise RobotError(f"{self.origin}: link {link.name}: inertia: {error}") from None

    def points(self, entries: Sequence[str]) -> tuple[list[ContactPoint], list[str]]:
        """Return contact points and their links. Raises RobotError for a link that is not there."""
        points = [contact_point(entry) for entry in entries]
        # Without a link of its own, a contact point is the link of its name.
        links = [point.link or point.name for point in points]
        for entry, link in zip(entries, links, strict=True):
            if link not in self.links:
                rule = f"must be one of {', '.join(sorted(self.links))}, or NAME=LINK: X Y Z"
                raise RobotError(f"{self.origin}: contact_points = {entry!r}: {rule}")
        return points, links

    def kind(self, joint: str) -> str:
        """Return the type of `joint`."""
        return self.joints[joint].get("type", "")

    def chain(self, link: str) -> list[str]:
        """Return the joints from `link` up to the base."""
        return [self._parents[step][1] for step in self._chain_links(link)[:-1]]

    def tip(self, link: str) -> str:
        """Return the end of the longest chain from `link` outwards: most moving joints, then farthest from the last.

        A chain ends before a locked joint: the tip is the link that carries a gripper's fingers, not a finger.
        """
        return self._ends(link)[0][-1]

    def _ends(self, link: str) -> list[tuple[int, bool, int, int, str]]:
        """Return the ends of the chains from `link` outwards, least first.

        The first has most moving joints; among equal ones it carries fingers or lies before them, then it is farthest
        from its last joint [mm], as a tool beside a camera is, then it has most joints.
        """
        # What is locked below all moving joints, such as a base, ends no chain.
        ends = {joint for joint in self.locked if self._moving_above(joint) - self.locked}
        free = {name: parent for name, (parent, joint) in self._parents.items() if joint not in ends}
        palms = {self._links_of[joint][0] for joint in self.gripper} & free.keys()
        ranked = []
        for end in free.keys() - set(free.values()) | palms | {link}:
            beyond = self._joints_beyond(link, end)
            if (beyond or end == link) and ends.isdisjoint(beyond):
                moving = sum(map(self._moves, beyond))
                distance_mm = round(1e3 * float(np.linalg.norm(self._place(end))))
                is_beside = not any(end == palm or self._is_before_fingers(end, palm) for palm in palms)
                ranked.append((-moving, is_beside, -distance_mm, -len(beyond), end))
        return sorted(ranked)

    def _moves(self, joint: str) -> bool:
        """Return whether `joint` moves on its own: it is neither fixed nor locked, and mimics none."""
        return self.kind(joint) != "fixed" and joint not in self.locked and joint not in self._masters

    def _place(self, link: str) -> FloatArray:
        """Return the origin (3,) [m] of `link` in the frame of the last joint that moves it."""
        place = pin.SE3.Identity()
        for joint in takewhile(lambda joint: not self._moves(joint), self.chain(link)):
            place = self._origins[joint] * place
        return np.asarray(place.translation)

    def _is_before_fingers(self, link: str, palm: str) -> bool:
        """Return whether the fingers on `palm` point to `link`: to a tool centre point, and not to a camera."""
        starts = [child for parent, child in map(self._links_of.__getitem__, self.gripper) if parent == palm]
        origin = self._place(palm)
        offset, ahead = self._place(link) - origin, np.mean([self._place(start) for start in starts], axis=0) - origin
        return bool(offset @ ahead > MIN_COSINE * np.linalg.norm(offset) * np.linalg.norm(ahead))

    def tip_beyond(self, link: str) -> str:
        """Return the end of the chain of joints whose motion counts for a contact point at `link`.

        For a link that is fixed to another one, that is the tip of the other, unless less than a tenth of the moving
        mass moves there, as in a gripper, whose fingers often have no joint states.
        """
        body = link
        while body in self._parents and self.kind(self._parents[body][1]) == "fixed":
            body = self._parents[body][0]
        light = self._mass_beyond(body) < LIGHT_SHARE * self._mass_beyond(self.base)
        return self.tip(link if light else body)

    def _mass_beyond(self, body: str) -> float:
        """Return the mass [kg] of the links that move on `body`."""
        mass = 0.0
        for link in self.stated:
            joints = self._joints_beyond(body, link.name)
            if any(self.kind(joint) != "fixed" and joint not in self.locked for joint in joints):
                mass += link.mass
        return mass

    def is_harmless(self, joint: str, needed: Collection[str]) -> bool:
        """Return whether `joint` moves a finger of a gripper that the arm carries, and no contact point.

        The joints `needed` move the contact points; they carry the gripper.
        """
        return joint in self.fingers and self._is_carried(joint, needed)

    def _is_carried(self, joint: str, needed: Collection[str]) -> bool:
        return joint not in needed and not (self._moving_above(joint) - self.locked).isdisjoint(needed)

    def shapes_arm(self, joint: str, needed: Collection[str]) -> bool:
        """Return whether masses or geometry depend on where the model holds `joint`, or the direction of gravity does.

        They do not on a slide below the arm, on a wheel beside it, and hardly on light parts of the tool. The joints
        `needed` move the contact points.
        """
        moved = set(needed) - self.locked
        is_of_tool = self._is_carried(joint, needed) and self._masses[joint] < self._light_kg
        if self.kind(joint) not in MOVING or is_of_tool or joint in self.gripper:
            return False
        carries = self.kind(joint) != "prismatic" and any(joint in self._moving_above(other) for other in moved)
        return carries or not self._moving_above(joint).isdisjoint(moved)

    def _is_wheel(self, joint: str, forks: int) -> bool:
        """Return whether `joint` turns without end about a horizontal axis, with no more on it.

        It is on the base, or on as many vertical `forks` that turn on the base. Rollers may be on it. A caster turns
        beside wheels that are driven, and few drivers report it.
        """
        above = self._moving_above(joint)
        if any(self.kind(name) != "continuous" for name in self._beyond({joint})) or len(above) != forks:
            return False
        return self._is_horizontal(joint) and not any(map(self._is_horizontal, above))

    def _is_horizontal(self, joint: str) -> bool:
        """Return whether the axis of `joint` is nearer to horizontal than to vertical, with all joints at zero."""
        turned, axis = np.eye(3), self.joints[joint].find("axis")
        for name in self.chain(self._links_of[joint][1]):
            turned = self._origins[name].rotation @ turned
        local = (1.0, 0.0, 0.0) if axis is None else numbers_of(axis, "xyz", f"{self.origin}: joint {joint}", 3)
        x, y, z = (turned @ np.array(local)).tolist()
        return bool(math.hypot(x, y) > abs(z))

    def notes_on_tip(self, link: str) -> list[str]:
        """Return notes on the choice of `link` as the contact point."""
        joints = [name for name in self.chain(link)[::-1] if self._moves(name)]
        choice = "the end of the longest chain (set contact_points for another)"
        notes = [f"contact point {link}: {choice}: {', '.join(joints)}"]
        others = [end for count, *_, end in self._ends(self.base) if count == -len(joints)]
        if others := [end for end in others if not set(joints) <= set(self.chain(end))]:
            notes.append(f"chains of as many joints end at {', '.join(others)}: {link} comes first by length and name")
        return notes

    def _branches(self) -> Iterable[list[str]]:
        """Return the joints on each rigid body."""
        branches: dict[str, list[str]] = {}
        for name in self._moving:
            branches.setdefault(self._body_above(name), []).append(name)
        return branches.values()

    def _is_hand(self, names: Collection[str]) -> bool:
        """Return whether `names`, the joints on one rigid body, begin two or more fingers of a gripper.

        One finger mimics another, or the heaviest ones have alike masses. A hand's other joints are tiny, as motors.
        """
        fingers = sorted(filter(self._is_finger, names), key=lambda name: self._masses[name])
        if len(fingers) < 2:
            return False
        second, heaviest = (self._masses[name] for name in fingers[-2:])
        are_alike = heaviest <= ALIKE * max(second, FINGER_KG)
        are_coupled = any(self._masters.get(name) in fingers for name in fingers)
        others = set(names).difference(fingers)
        has_only_fingers = all(self._is_small(name) and self._masses[name] <= FINGER_KG for name in others)
        return (are_alike or are_coupled) and has_only_fingers

    def _coupled_fingers(self) -> set[str]:
        """Return the joints of fingers that a joint of the same finger mimics."""
        pairs = ((name, master) for name, master in self._masters.items() if master in self._moving_above(name))
        return {master for name, master in pairs if self._is_finger(name) and self._is_finger(master)}

    def _is_finger(self, joint: str) -> bool:
        """Return whether a finger may begin at `joint`: a small part that another joint moves, and no wrist."""
        if self.kind(joint) not in {"revolute", "prismatic"} or not self._moving_above(joint):
            return False
        limit, where = self.joints[joint].find("limit"), f"{self.origin}: joint {joint}"
        if limit is None:
            return False
        lower, upper = (numbers_of(limit, key, where, 1, "0", math.inf)[0] for key in ("lower", "upper"))
        return self._is_small(joint) and upper - lower <= FINGER_RAD

    def _is_small(self, joint: str) -> bool:
        """Return whether what moves behind `joint` is light, and not longer than a finger."""
        return self._is_light(self._masses[joint]) and self._lengths[joint] <= FINGER_M

    def _is_light(self, mass: float) -> bool:
        return not mass or mass < self._light_kg

    def _beyond(self, starts: Collection[str]) -> set[str]:
        """Return the moving joints among `starts`, and beyond them."""
        return {name for name in self._moving if name in starts or not self._moving_above(name).isdisjoint(starts)}

    def _moving_above(self, joint: str) -> set[str]:
        """Return the joints that move the parent link of `joint`."""
        return {name for name in self.chain(self._links_of[joint][0]) if self.kind(name) != "fixed"}

    def _body_above(self, joint: str) -> str:
        """Return the first link of the rigid body that carries `joint`."""
        link = self._links_of[joint][0]
        while link in self._parents and self.kind(self._parents[link][1]) == "fixed":
            link = self._parents[link][0]
        return link

    def require_movable(self, joint: str) -> None:
        """Raise RobotError if the model cannot move `joint`, which a contact point needs."""
        kind = self.kind(joint)
        if kind not in {*MOVING, "fixed"} and joint not in self.locked:
            raise RobotError(
                f"{self.origin}: joint {joint}: type = {kind!r}: must be one of {', '.join(MOVING)}, fixed: describe "
                "it by prismatic and continuous joints, or, if it never moves, hold it by locked_joints"
            )
        if joint in self._masters and joint not in self.locked:
            raise RobotError(f"{self.origin}: joint {joint}: must not mimic another joint: fix it with locked_joints")

    def require_no_follower(self, needed: Collection[str]) -> None:
        """Raise RobotError for a joint that mimics one that the model moves, unless it moves a small part beside it.

        Held, it would not follow. The joints `needed` move the contact points.
        """
        for joint in sorted(self._masters):
            master, is_beside = self._leader(joint), joint not in needed
            if master in needed and master not in self.locked and not (is_beside and self._is_small(joint)):
                way_out = (
                    f"hang it on a link that {master} moves, by a fixed joint, so that its mass counts"
                    if is_beside
                    else "remove <mimic>, and report the position of this joint in the joint states, too"
                )
                raise RobotError(f"{self.origin}: joint {joint}: must not mimic {master}, which moves: {way_out}")

    def require_short_follower(self, hull: LinkHull, frames: Mapping[str, pin.Frame], moved: Collection[str]) -> None:
        """Raise RobotError for geometry longer than a finger behind a joint that mimics one of those `moved`.

        The model holds the joint, so that the polytope `hull` would not follow.
        """
        for joint in self.chain(hull.link):
            start = frames[self._links_of[joint][1]].placement.translation
            length = float(np.linalg.norm(hull.vertices - start, axis=1).max())
            if joint in self._masters and self._leader(joint) in moved and length > FINGER_M:
                way_out = f"if {hull.link}, {length:.2g} m long, cannot touch a person, leave it out of contact_links"
                raise RobotError(
                    f"{self.origin}: joint {joint}: must not mimic {self._leader(joint)}, which moves: {way_out}"
                )

    def drive(self, joint: str) -> tuple[str, float, float]:
        """Return the finger joint that `joint` mimics, the multiplier and the offset; itself if it mimics none."""
        master, mimic = self._masters.get(joint, joint), self.joints[joint].find("mimic")
        if mimic is None or master not in self.fingers:
            return joint, 1.0, 0.0
        where = f"{self.origin}: joint {joint}"
        factor, offset = (
            numbers_of(mimic, key, where, 1, default)[0] for key, default in (("multiplier", "1"), ("offset", "0"))
        )
        return master, factor, offset

    def _leader(self, joint: str) -> str:
        """Return the joint that `joint` mimics, if need be by way of others."""
        followers = set[str]()
        while joint in self._masters.keys() - followers:
            followers.add(joint)
            joint = self._masters[joint]
        return joint

    def _joints_beyond(self, body: str, link: str) -> list[str]:
        """Return the joints from `link` up to the link `body`, none if `link` is not on it."""
        links = self._chain_links(link)
        return self.chain(link)[: links.index(body) if body in links else 0]

    def _chain_links(self, link: str) -> list[str]:
        """Return the links from `link` to the base, cut at the first repetition."""
        path = [link]
        while path[-1] in self._parents and path.count(path[-1]) == 1:
            path.append(self._parents[path[-1]][0])
        return path


def _check_pose(joint: ET.Element, where: str) -> None:
    pose, axis = joint.find("origin"), joint.find("axis")
    if pose is not None:
        numbers_of(pose, "xyz", where, 3, default="0 0 0")
        angles_of(pose, where)
    if (
        axis is not None
        and math.hypot(*numbers_of(axis, "xyz", where, 3)) < _MIN_AXIS_LENGTH
        and joint.get("type") in MOVING
    ):
        raise RobotError(f"{where}: axis = {axis.get('xyz')!r}: must have a direction")


def _origin(joint: ET.Element) -> pin.SE3:
    """Return the pose of the frame of `joint` in its parent link, whose numbers are checked."""
    pose = joint.find("origin")
    if pose is None:
        return pin.SE3.Identity()
    xyz = np.array(numbers_of(pose, "xyz", "", 3, default="0 0 0"))
    return pin.SE3(pin.rpy.rpyToMatrix(np.array(angles_of(pose, ""))), xyz)


def _is_locked(joint: str, globs: Sequence[str]) -> bool:
    return any(fnmatchcase(joint.lower(), glob.lower()) for glob in globs)


def _require_matches(globs: Sequence[str], tree: UrdfTree) -> None:
    """Raise RobotError for a glob of locked_joints that matches no joint."""
    joints = [name for name in tree.joints if tree.kind(name) != "fixed"]
    for glob in globs:
        if not any(_is_locked(joint, [glob]) for joint in joints):
            raise RobotError(f"{tree.origin}: locked_joints = {glob!r}: must match a joint: {', '.join(joints)}")


def _set_limits(tree: UrdfTree, moved: Collection[str], limits: Mapping[str, tuple[float, float]]) -> None:
    """Check the limits of joints, those of `limits` [rad or m] in place of others; only the joints `moved` need some.

    A continuous joint becomes a revolute one. Raises RobotError.
    """
    for name, joint in tree.joints.items():
        if tree.kind(name) in MOVING:
            _add_limit(joint, limits.get(name), is_held=name not in moved)
            _check_limit(joint, f"{tree.origin}: joint {name}", is_held=name not in moved)


def _add_limit(joint: ET.Element, limits: tuple[float, float] | None, *, is_held: bool) -> None:
    """Replace the ends of the <limit> of `joint` by `limits`, and complete it, which urdfdom requires."""
    if limits is None and not is_held:
        return
    limit = joint.find("limit")
    if limit is None:
        limit = ET.SubElement(joint, "limit")
    for key in ("effort", "velocity"):
        limit.attrib.setdefault(key, "0")
    if limits is not None:
        joint.set("type", joint.get("type", "").replace("continuous", "revolute"))
        limit.attrib.update(lower=str(limits[0]), upper=str(limits[1]))


def _check_limit(joint: ET.Element, where: str, *, is_held: bool) -> None:
    limit = joint.find("limit")
    if joint.get("type") == "continuous":
        joint.set("type", "revolute")
        if limit is None:
            limit = ET.SubElement(joint, "limit", effort="0", velocity="0")
        limit.set("lower", str(-CONTINUOUS_LIMIT))
        limit.set("upper", str(CONTINUOUS_LIMIT))
    hint = f', in the file or as joint_limits "{joint.get("name")}=LOWER UPPER"'
    if limit is None:
        raise RobotError(f"{where}: must have <limit> with lower < upper{hint}")
    lower, upper = (numbers_of(limit, key, where, 1, default="0", largest=math.inf)[0] for key in ("lower", "upper"))
    if lower >= upper and not is_held:
        raise RobotError(f"{where}: limit lower = {lower:g}: must be < upper = {upper:g}{hint}")
    for key in ("effort", "velocity"):
        if numbers_of(limit, key, where, 1, largest=math.inf)[0] < 0.0:
            raise RobotError(f"{where}: limit {key} = {limit.get(key)!r}: must not be negative")


def _by_name(root: ET.Element, tag: str, origin: str) -> dict[str, ET.Element]:
    elements: dict[str, ET.Element] = {}
    for element in root.findall(tag):
        name = element.get("name", "")
        if not name or name in elements:
            raise RobotError(f"{origin}: {tag} {name!r}: must have a unique name")
        if name == "universe":
            raise RobotError(f"{origin}: {tag} universe: must have another name, which Pinocchio gives to the world")
        elements[name] = element
    return elements


def _end(joint: ET.Element, role: str, links: dict[str, ET.Element], origin: str) -> str:
    element = joint.find(role)
    name = "" if element is None else element.get("link", "")
    if name not in links:
        raise RobotError(f"{origin}: joint {joint.get('name')}: {role} = {name!r}: must be a link")
    return name


def _stated(name: str, link: ET.Element, origin: str) -> list[StatedLink]:
    """Return the link's inertial data in a list, which is empty if the link has none."""
    inertial = link.find("inertial")
    if inertial is None:
        return []
    where = f"{origin}: link {name}"
    pose, mass, inertia = (inertial.find(tag) for tag in ("origin", "mass", "inertia"))
    if mass is None or inertia is None:
        raise RobotError(f"{where}: <inertial> must have <mass> and <inertia>")
    com = (0.0, 0.0, 0.0) if pose is None else numbers_of(pose, "xyz", where, 3, default="0 0 0")
    if pose is not None:
        angles_of(pose, where)
    (mass_kg,) = numbers_of(mass, "value", where, 1)
    if mass_kg < 0.0:
        raise RobotError(f"{where}: mass = {mass_kg:g}: must not be negative")
    keys = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    tensor = inertia_tensor([numbers_of(inertia, key, where, 1)[0] for key in keys])
    return [StatedLink(name, mass_kg, np.array(com), tensor)]
