# SPDX-License-Identifier: Apache-2.0
"""Read the reflected rotor inertia of a URDF's joints.

URDF's `<transmission>` states the reduction, and some robots the rotor inertia beside it: `<motorInertia>`, or Drake's
`<drake:rotor_inertia value=...>` with `<drake:gear_ratio value=...>`. `<dynamics armature=...>` of a joint is the
reflected inertia itself.
"""

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence

from scara_effmass.errors import RobotError

_ROTOR_INERTIA = ("rotor_inertia", "motorInertia")
_REDUCTION = ("gear_ratio", "mechanicalReduction")
"""Drake's ratio first: its files keep a mechanicalReduction of 1 beside it."""


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
