# SPDX-License-Identifier: Apache-2.0
"""Inertia of rotors and gears reflected to the joints, from the robot file and the setting `armature`.

The matrix B (n, n) is added to M(q). Its diagonal is the armature N^2 J of each joint (reduction N, rotor inertia J).
Off-diagonal terms belong to geared chains in which a motor turns with more than one joint: B = T^T J T, with T the
velocities of the motors per joint velocity.

A URDF's `<transmission>` states the reduction, and some robots the rotor inertia beside it: `<motorInertia>`, or
Drake's `<drake:rotor_inertia value=...>` with `<drake:gear_ratio value=...>`. `<dynamics armature=...>` of a joint is
the reflected inertia itself.
"""

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import yaml

from scara_effmass.errors import RobotError
from scara_effmass.share import share
from scara_effmass.values import FloatArray

_RULE = "must be joint=value (0 or more), joint1,joint2=value"

_MAX_INERTIA = 1e6
"""Largest inertia that is not a typing error."""
_ROTOR_INERTIA = ("rotor_inertia", "motorInertia")
_REDUCTION = ("gear_ratio", "mechanicalReduction")
"""Drake's ratio first: its files keep a mechanicalReduction of 1 beside it."""


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
    if np.abs(matrix).max(initial=0.0) > _MAX_INERTIA:
        raise RobotError(f"{origin}: rotor inertia: must be at most {_MAX_INERTIA:g} kg m2 or kg")
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
        raise RobotError(f"armature = {entry!r}: {_RULE} or the name of a published arm")
    for name in pair:
        if name not in joints:
            raise RobotError(f"{origin}: armature = {entry!r}: joint must be one of {', '.join(joints)}")
    indices = sorted(joints.index(name) for name in pair)
    return indices[0], indices[-1], value


def _published(name: str, count: int, origin: str) -> tuple[list[float], str]:
    """Return the published armatures of the arm `name`, which must have `count` joints, and their source."""
    table = yaml.safe_load(share("config", "armatures.yaml").read_text(encoding="utf-8"))
    if name not in table:
        raise RobotError(f"armature = {name!r}: {_RULE} or one of {', '.join(table)}")
    arm = table[name]
    if len(arm["armature"]) != count:
        raise RobotError(f"{origin}: armature = {name!r}: must be for {count} joints, not {len(arm['armature'])}")
    return arm["armature"], f"{name} ({arm['source']}: {arm['note']})"


def armatures(root: ET.Element, origin: str) -> tuple[dict[str, float], dict[str, str]]:
    """Return the armature N^2 J by joint name, and why a transmission gives none, by joint name. Raises RobotError."""
    armature: dict[str, float] = {}
    reasons: dict[str, str] = {}
    for joint in root.findall("joint"):
        dynamics = joint.find("dynamics")
        if dynamics is not None and "armature" in dynamics.attrib:
            name = joint.get("name", "")
            armature[name] = _number(dynamics.get("armature"), f"{origin}: joint {name}: <dynamics armature>")
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
                    return _number(child.get("value", child.text), f"{where}: <{tag}>")
    return math.nan


def _number(text: str | None, where: str) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not 0.0 <= abs(value) < math.inf:
        raise RobotError(f"{where} = {text!r}: must be a finite number")
    return value
