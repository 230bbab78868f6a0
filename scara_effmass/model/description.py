# SPDX-License-Identifier: Apache-2.0
"""What a robot file states, whatever its format.

The inertia B (n, n) of the rotors is added to M(q). Its diagonal is the armature N^2 J of each joint (reduction N,
rotor inertia J). Off-diagonal terms belong to geared chains in which a motor turns with more than one joint:
B = T^T J T, with T the velocities of the motors per joint velocity.
"""

import math
import reprlib
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin
import yaml

from scara_effmass.codes import Assumption
from scara_effmass.errors import RobotError
from scara_effmass.share import share
from scara_effmass.values import FloatArray, Vector3

PARALLEL = 2e-3
"""Sine of the angle below which two axes count as parallel, because some files write pi as 3.14."""
MAX_ANGLE_RAD = 7.0
"""Fixed angle that is certainly not in radians: it exceeds one turn."""
_ARMATURE_RULE = "must be joint=value (0 or more), joint1,joint2=value"
CONTINUOUS_LIMIT = 1e6
"""Limit [rad] of a continuous joint read as revolute, for which Pinocchio uses one coordinate, as joint_states do."""
LEFT_OUT = "links that contact_links leaves out: "
"""Start of the note on them."""
MAX_VIRTUAL_M = 0.03
"""Length of a link up to which it may only join two joints, without mass or geometry of its own."""
_MAX_NUMBER = 1e6
"""Largest magnitude of a length, mass or inertia [SI]; beyond it the dynamics overflow."""
_MAX_ROTOR_INERTIA = 1e6
"""Largest rotor inertia that is not a typing error."""
_ROUNDING = 1e-12
"""Moment [kg m2] of a millimetre of steel: a smaller one is rounding of a file without inertia tensors."""


class StatedLink(NamedTuple):
    """Inertial data of one moving link as stated in the file, before fixed links and payload are added.

    `com` (3,) [m] and `inertia` (3, 3) [kg m2] about it are in the axes that the file uses. `share` is that of the mass
    of the rigid body that the link is a part of.
    """

    name: str
    mass: float
    com: FloatArray
    inertia: FloatArray
    share: float = 1.0

    @property
    def placeholder(self) -> bool:
        """Whether the inertia is the identity, or the mass times it, which no link of a robot has."""
        return any(np.allclose(self.inertia, scale * np.eye(3), rtol=1e-6, atol=0.0) for scale in (1.0, self.mass))


class HeldJoint(NamedTuple):
    """A joint of the robot file that is fixed in the model.

    `is_harmless`: it moves no more than a finger of a gripper, without a contact point. `position`
    [rad, m] is where the model holds it, NaN if masses and geometry of the arm hardly depend on it. `is_stated`:
    `locked_joints` names it. `is_wheel`: it may drive the base.
    """

    name: str
    is_harmless: bool
    position: float = math.nan
    is_stated: bool = False
    is_wheel: bool = False

    @property
    def is_expected(self) -> bool:
        """Whether joint states must have it: its position or motion counts, and nothing states that it rests."""
        return (self.is_wheel or math.isfinite(self.position)) and not self.is_stated


@dataclass(frozen=True)
class RotorInertia:
    """The matrix B (n, n) [kg m2, kg for a sliding joint], the joints without a statement, and notes on the sources."""

    matrix: FloatArray
    unstated: tuple[str, ...]
    notes: tuple[str, ...]

    @cached_property
    def coupling(self) -> FloatArray:
        """The off-diagonal terms (n, n) of the matrix."""
        return self.matrix - np.diag(np.diag(self.matrix))

    @property
    def warning(self) -> str:
        """One line that names the joints without a statement, empty if there is none."""
        if not self.unstated:
            return ""
        names = ", ".join(self.unstated)
        return f"no rotor inertia for {names}: the masses are a lower bound if the drives are back-driven"


@dataclass(frozen=True, slots=True)
class RobotDescription:
    """Kinematics and inertial data of one serial robot, without the load of the settings.

    `model` has one degree of freedom per joint; its bodies include the payload of the file, `payload_mass` [kg], but no
    rotors. `contact_points` are names with the joint that moves each point and its pose in the frame of that joint.
    `tip` is the end of the last link in the last joint's frame. `origin` names the file in errors, `stated` is what the
    file states of the assumptions, and `held` are its joints that the model does not move.
    `hulls` are the vertices (V, 3) [m] of the contact points that are links as a whole, in the frame of their joint.
    `unwatched` are the moving links that `whole_arm` should watch, and cannot for lack of geometry.
    `tool_tip` is the contact point at the end of the longest chain, whose last joint may be one of a tool, as a jaw.
    `torque_constants` (n,) are torques [N m, N] per unit of effort; 1 where the file states none.
    """

    origin: str
    base_frame: str
    model: pin.Model
    links: Sequence[StatedLink]
    rotors: RotorInertia
    payload_mass: float
    contact_points: Sequence[tuple[str, int, pin.SE3]]
    tip: pin.SE3
    notes: Sequence[str]
    stated: frozenset[Assumption]
    torque_constants: FloatArray
    held: tuple[HeldJoint, ...] = ()
    tool_tip: str = ""
    hulls: Mapping[str, FloatArray] = field(default_factory=dict)
    unwatched: tuple[str, ...] = ()


def matching_links(links: Sequence[str], globs: Sequence[str], setting: str, which: str) -> list[str]:
    """Return those of `links` that match one of `globs`. Raises RobotError for a pattern of the `setting` without."""
    for glob in globs:
        if not any(fnmatchcase(link, glob) for link in links):
            raise RobotError(f"{setting} = {glob!r}: must match {which} {', '.join(links)}")
    return [link for link in links if any(fnmatchcase(link, glob) for glob in globs)]


def watched_links(links: Sequence[str], globs: Sequence[str], origin: str) -> tuple[list[str], list[str]]:
    """Return those of `links` with geometry that match `globs`, and a note on the others. Raises RobotError."""
    watched = matching_links(links, globs, f"{origin}: contact_links", "a link with geometry:")
    left_out = [link for link in links if link not in watched]
    return watched, [f"{LEFT_OUT}{', '.join(left_out)}"] if left_out else []


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


def inertia_tensor(entries: Sequence[float]) -> FloatArray:
    """Return the tensor (3, 3) of `entries` ixx, iyy, izz, ixy, ixz, iyz."""
    ixx, iyy, izz, ixy, ixz, iyz = entries
    return np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])


def principal_moments(inertia: FloatArray) -> tuple[float, float, float]:
    """Return the principal moments of an inertia tensor (3, 3), ascending. Raises ValueError if one is negative."""
    low, middle, high = np.linalg.eigvalsh(inertia).tolist()
    if low < -max(1e-9 * high, _ROUNDING):
        raise ValueError(f"principal moments ({low:.6g}, {middle:.6g}, {high:.6g}) kg m2: must not be negative")
    return low, middle, high


def rotor_inertia(
    joints: Sequence[str], stated: FloatArray, source: str, entries: Sequence[str], origin: str
) -> RotorInertia:
    """Return the rotor inertia of `joints`: what `entries` state, else `stated` (n, n) by `source`, NaN where unknown.

    An entry is "joint=value", "joint1,joint2=value" for an off-diagonal term, or the name of an arm in
    `config/armatures.yaml`, whose values are those of all joints, base to tip. `origin` names the robot in errors.
    Raises RobotError for a wrong entry, and for a matrix that is not positive semi-definite.
    """
    matrix = stated.copy()
    sources = dict.fromkeys(np.flatnonzero(~np.isnan(np.diag(stated))).tolist(), source)
    for entry in (entry for entry in entries if "=" not in entry):
        values, source = _published(entry, len(joints), origin)
        np.fill_diagonal(matrix, values)
        sources = dict.fromkeys(range(len(joints)), source)
    seen = set()
    for entry in (entry for entry in entries if "=" in entry):
        i, j, value = _parsed(entry, joints, origin)
        if (i, j) in seen:
            raise RobotError(f"armature = {entry!r}: must state each joint once")
        seen.add((i, j))
        matrix[i, j] = matrix[j, i] = value
        if i == j:
            sources[i] = "the setting armature"
    unstated = tuple(joints[i] for i in range(len(joints)) if i not in sources)
    matrix = np.nan_to_num(matrix)
    if np.abs(matrix).max(initial=0.0) > _MAX_ROTOR_INERTIA:
        raise RobotError(f"{origin}: rotor inertia: must be at most {_MAX_ROTOR_INERTIA:g} kg m2 or kg")
    lowest = float(np.linalg.eigvalsh(matrix).min(initial=0.0))
    if lowest < -1e-9 * np.trace(matrix):
        raise RobotError(
            f"{origin}: rotor inertia: must be a positive semi-definite matrix: its smallest eigenvalue is {lowest:.4g}"
        )
    notes = [
        f"rotor inertia from {source}: "
        + ", ".join(f"{joints[i]} {matrix[i, i]:.4g}" for i in sorted(sources) if sources[i] == source)
        for source in dict.fromkeys(sources.values())
    ]
    if pairs := np.argwhere(np.triu(matrix, 1)).tolist():
        notes.append("coupled rotors: " + ", ".join(f"{joints[i]},{joints[j]} {matrix[i, j]:.4g}" for i, j in pairs))
    return RotorInertia(matrix, unstated, tuple(notes))


def _parsed(entry: str, joints: Sequence[str], origin: str) -> tuple[int, int, float]:
    """Return the indices, ascending, and the value of an entry "joint=value" or "joint1,joint2=value"."""
    names, _, text = entry.partition("=")
    pair = [name.strip() for name in names.split(",")]
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or (len(pair) == 1 and value < 0.0) or len(pair) > 2 or len(set(pair)) < len(pair):
        raise RobotError(f"armature = {entry!r}: {_ARMATURE_RULE} or the name of a published arm")
    for name in pair:
        if name not in joints:
            raise RobotError(f"{origin}: armature = {entry!r}: joint must be one of {', '.join(joints)}")
    indices = sorted(joints.index(name) for name in pair)
    return indices[0], indices[-1], value


def _published(name: str, count: int, origin: str) -> tuple[list[float], str]:
    """Return the published armatures of the arm `name`, which must have `count` joints, and their source."""
    table = yaml.safe_load(share("config", "armatures.yaml").read_text(encoding="utf-8"))
    if name not in table:
        raise RobotError(f"armature = {name!r}: {_ARMATURE_RULE} or one of {', '.join(table)}")
    arm = table[name]
    if len(arm["armature"]) != count:
        raise RobotError(f"{origin}: armature = {name!r}: must be for {count} joints, not {len(arm['armature'])}")
    return arm["armature"], f"{name} ({arm['source']}: {arm['note']})"


def numbers_of(
    element: ET.Element, key: str, where: str, count: int, default: str = "", largest: float = _MAX_NUMBER
) -> tuple[float, ...]:
    """Return the `count` numbers of an attribute of a URDF element. Raises RobotError, which `where` begins."""
    text = element.get(key, default)
    try:
        # Python also reads 1_000 and digits of other scripts, which Pinocchio's parser does not.
        values = tuple(float(word) for word in text.split()) if text.isascii() and "_" not in text else ()
    except ValueError:
        values = ()
    name = f"{where}: <{element.tag} {key}> = {reprlib.repr(text)}"
    if len(values) != count or not all(map(math.isfinite, values)):
        raise RobotError(f"{name}: must be {count} finite number{'s' * (count > 1)}")
    if max(map(abs, values)) > largest:
        raise RobotError(f"{name}: must be at most {largest:g}")
    return values


def link_length(model: pin.Model, joint: int, ends: Iterable[pin.SE3]) -> float:
    """Return the distance [m] from a joint to the farthest of the next joints and of `ends` in its frame."""
    placements = [model.jointPlacements[child] for child in range(1, model.njoints) if model.parents[child] == joint]
    return max((float(np.linalg.norm(end.translation)) for end in (*placements, *ends)), default=0.0)


def angles_of(origin: ET.Element, where: str) -> tuple[float, ...]:
    """Return roll, pitch and yaw [rad] of an <origin>. Raises RobotError, which `where` begins, also for degrees."""
    angles = numbers_of(origin, "rpy", where, 3, default="0 0 0")
    if max(map(abs, angles)) > MAX_ANGLE_RAD:
        raise RobotError(f"{where}: <origin rpy> = {origin.get('rpy')!r}: must be in radians, not in degrees")
    return angles
