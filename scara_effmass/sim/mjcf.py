"""The simulated cell as MJCF, from the robot's Denavit-Hartenberg file; independent of the room `model`."""

import math
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import yaml

from scara_effmass.errors import RobotError
from scara_effmass.sim.cart import Cart

TOOL = "tool"
"""Contact point of the robot file, and the MJCF site there."""
_DISABLED = ("contact", "constraint", "gravity", "sensor", "actuation", "limit")
_JOINT_TYPES = {"revolute": "hinge", "prismatic": "slide"}
_TENSOR_SIZE = 6


def sim_mjcf(robot: Path, cart: Cart) -> tuple[str, tuple[str, ...]]:
    """Return the MJCF of robot and cart, and the names of the robot's joints.

    The cart's joint comes last. Raises RobotError.
    """
    try:
        body, names = _robot_body(yaml.safe_load(robot.read_text(encoding="utf-8")))
    except (OSError, yaml.YAMLError, KeyError, TypeError, ValueError) as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise RobotError(f"{robot}: {reason}; must be as config/omron_i4_550l.yaml") from None
    root = ET.Element("mujoco", model="cell")
    ET.SubElement(root, "compiler", angle="radian", inertiafromgeom="false")
    option = ET.SubElement(root, "option", integrator="Euler", gravity="0 0 0")
    ET.SubElement(option, "flag", dict.fromkeys(_DISABLED, "disable"))
    world = ET.SubElement(root, "worldbody")
    world.append(body)
    body = ET.SubElement(world, "body", name="cart", pos=_text(*cart.tip))
    ET.SubElement(body, "joint", name="guide", type="slide", axis=_text(*cart.direction))
    # The cart does not rotate: its moments of inertia have no effect.
    ET.SubElement(body, "inertial", pos="0 0 0", mass=_text(cart.mass), diaginertia="1e-3 1e-3 1e-3")
    return ET.tostring(root, encoding="unicode"), names


def _robot_body(document: dict[str, Any]) -> tuple[ET.Element, tuple[str, ...]]:
    """Return body and joint names: two bodies per Denavit-Hartenberg row.

    The outer body moves with the joint and holds Tx(a) Rx(alpha) of the row before; the inner one, the link, holds
    Rz(theta) Tz(d) and the inertia.
    """
    if "rotor_inertia" in document:
        raise ValueError("rotor_inertia: must be absent: the simulated cell has an armature for each joint only")
    base = parent = ET.Element("body", name="base")
    names = []
    frame = {"pos": "0 0 0"}
    for row, link in zip(document["joints"], document["links"], strict=True):
        name = str(row["name"])
        names.append(name)
        joint_body = ET.SubElement(parent, "body", {"name": f"{name}_body", **frame})
        armature = _text(row.get("armature", 0.0))
        ET.SubElement(joint_body, "joint", name=name, type=_JOINT_TYPES[row["type"]], axis="0 0 1", armature=armature)
        offset = {"pos": _text(0.0, 0.0, row.get("d", 0.0)), "quat": _quaternion(float(row.get("theta", 0.0)), axis=2)}
        parent = ET.SubElement(joint_body, "body", {"name": str(link["name"]), **offset})
        _add_inertial(parent, link)
        frame = {"pos": _text(row["a"], 0.0, 0.0), "quat": _quaternion(float(row["alpha"]), axis=0)}
    end = ET.SubElement(parent, "body", {"name": "payload", **frame})
    if payload := document.get("payload"):
        _add_inertial(end, payload)
    ET.SubElement(end, "site", name=TOOL, pos=_text(*document["contact_points"][TOOL]))
    return base, tuple(names)


def _add_inertial(body: ET.Element, link: dict[str, Any]) -> None:
    inertia = link["inertia"]
    if isinstance(inertia, (int, float)):
        # Only I_zz matters here; I_xx = I_yy = I_zz / 2 makes the tensor valid for MuJoCo.
        inertia = (inertia / 2.0, inertia / 2.0, inertia, 0.0, 0.0, 0.0)
    if len(inertia) != _TENSOR_SIZE:
        raise ValueError(f"inertia of {link.get('name', 'payload')} = {inertia}: must be one number or six")
    com = _text(*link.get("com", (0.0, 0.0, 0.0)))
    ET.SubElement(body, "inertial", pos=com, mass=_text(link["mass"]), fullinertia=_text(*inertia))


def _quaternion(angle: float, *, axis: int) -> str:
    quaternion = [math.cos(angle / 2.0), 0.0, 0.0, 0.0]
    quaternion[1 + axis] = math.sin(angle / 2.0)
    return _text(*quaternion)


def _text(*numbers: float) -> str:
    return " ".join(repr(float(number)) for number in numbers)
