"""The cell in MuJoCo's format, the robot from its Denavit-Hartenberg file; independent of the room `model`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET

import yaml

from scara_effmass.errors import RobotError

if TYPE_CHECKING:
    from pathlib import Path

    from scara_effmass.sim.cart import Cart

TOOL = "tool"
"""The contact point of the file at which the robot is hit, and the name of the site there."""
TENSOR = 6
_OFF = ("contact", "constraint", "gravity", "sensor", "actuation", "limit")
_MJCF_JOINT = {"revolute": "hinge", "prismatic": "slide"}


def cell_mjcf(robot: Path, cart: Cart) -> tuple[str, tuple[str, ...]]:
    """Return the robot in the file `robot`, the cart and nothing else as MJCF, and the names of the robot's joints.

    The joint of the cart comes last. Raises RobotError.
    """
    arm, names = _arm(robot)
    world = ET.Element("mujoco", model="cell")
    ET.SubElement(world, "compiler", angle="radian", inertiafromgeom="false")
    option = ET.SubElement(world, "option", integrator="Euler", gravity="0 0 0")
    ET.SubElement(option, "flag", dict.fromkeys(_OFF, "disable"))
    bodies = ET.SubElement(world, "worldbody")
    bodies.append(arm)
    body = ET.SubElement(bodies, "body", name="cart", pos=" ".join(map(repr, cart.tip)))
    ET.SubElement(body, "joint", name="guide", type="slide", axis=" ".join(map(repr, cart.direction)))
    # It does not turn, so any moments of inertia will do.
    ET.SubElement(body, "inertial", pos="0 0 0", mass=repr(cart.mass), diaginertia="1e-3 1e-3 1e-3")
    return ET.tostring(world, encoding="unicode"), names


def _arm(path: Path) -> tuple[ET.Element, tuple[str, ...]]:
    """Return an element `body`, with a site `tool` at its end, and the names of the joints.

    Each joint has a body that moves about or along its z, and in it one that is fixed, the link, with the inertia:
    so every pose is one factor of a row, Rz(theta) Tz(d) or Tx(a) Rx(alpha).
    """
    try:
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
        return _built(document)
    except OSError as error:
        raise RobotError(f"{path}: cannot be read: {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise RobotError(f"{path}: not YAML: {' '.join(str(error).split())}") from None
    except KeyError as error:
        raise RobotError(
            f"{path}: {error.args[0]} is missing; config/omron_i4_550l.yaml shows what is needed"
        ) from None
    except (TypeError, ValueError) as error:
        raise RobotError(f"{path}: {error}; config/omron_i4_550l.yaml shows what is needed") from None


def _built(document: dict[str, Any]) -> tuple[ET.Element, tuple[str, ...]]:
    base = parent = ET.Element("body", name="base")
    names = []
    foot = {"pos": "0 0 0"}
    for row, link in zip(document["joints"], document["links"], strict=True):
        names.append(str(row["name"]))
        moved = ET.SubElement(parent, "body", {"name": f"{names[-1]}_body", **foot})
        ET.SubElement(
            moved,
            "joint",
            name=names[-1],
            type=_MJCF_JOINT[row["type"]],
            axis="0 0 1",
            armature=_text(row.get("armature", 0.0)),
        )
        turned = _turn(float(row.get("theta", 0.0)), 2)
        parent = ET.SubElement(
            moved, "body", name=str(link["name"]), pos=_text(0.0, 0.0, row.get("d", 0.0)), quat=turned
        )
        _weigh(parent, link)
        foot = {"pos": _text(row["a"], 0.0, 0.0), "quat": _turn(float(row["alpha"]), 0)}
    end = ET.SubElement(parent, "body", {"name": "payload", **foot})
    if payload := document.get("payload"):
        _weigh(end, payload)
    ET.SubElement(end, "site", name=TOOL, pos=_text(*document["contact_points"][TOOL]))
    return base, tuple(names)


def _weigh(body: ET.Element, link: dict[str, Any]) -> None:
    inertia = link["inertia"]
    if isinstance(inertia, (int, float)):
        # Where only I_zz is stated, the other two do not matter; half of it each is what a body can have.
        inertia = (inertia / 2.0, inertia / 2.0, inertia, 0.0, 0.0, 0.0)
    if len(inertia) != TENSOR:
        raise ValueError(f"inertia of {link.get('name', 'payload')} = {inertia}: one number or six would be right")
    com = _text(*link.get("com", (0.0, 0.0, 0.0)))
    ET.SubElement(body, "inertial", pos=com, mass=_text(link["mass"]), fullinertia=_text(*inertia))


def _turn(angle: float, axis: int) -> str:
    quaternion = [math.cos(angle / 2.0), 0.0, 0.0, 0.0]
    quaternion[1 + axis] = math.sin(angle / 2.0)
    return _text(*quaternion)


def _text(*numbers: float) -> str:
    return " ".join(repr(float(number)) for number in numbers)
