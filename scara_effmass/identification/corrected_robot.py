# SPDX-License-Identifier: Apache-2.0
"""Robot file with the masses that a recording shows, and where they come from."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin
import yaml

from scara_effmass.errors import BagError, RobotError
from scara_effmass.identification.arm import ArmEstimate, with_parameters
from scara_effmass.identification.regression import link_parameters
from scara_effmass.input_files import digest, read_yaml
from scara_effmass.model.dh import DhFile
from scara_effmass.model.load import loader_of
from scara_effmass.model.urdf import load_urdf
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import FloatArray

URDF_INERTIA = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
DH_INERTIA = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def corrected_name(path: Path) -> str:
    """Return the name of the corrected file of the robot at `path`: that of a URDF, also for a xacro file."""
    return path.with_suffix(".urdf").name if loader_of(path) is load_urdf else path.name


def corrected_robot(
    estimate: ArmEstimate, settings: MonitorSettings, recording: Path, mass_uncertainty: float
) -> bytes:
    """Return the robot file of `settings` with the masses identified from a `recording`.

    A comment says where they come from, and states their `mass_uncertainty`. Of a URDF, each link behind a moving joint
    has all of the body that moves with it; the links fixed to it have none. Masses of a lumped model have no inertia.
    Raises RobotError for a link that is not physically possible once its stated load is taken off.
    """
    path = settings.robot_path
    name = recording.name.encode("ascii", "backslashreplace").decode()
    origin = f"{name} (SHA-256 {digest(recording, BagError)})"
    source = f"identified by scara-effmass from {origin}, for mass_uncertainty {mass_uncertainty:.3f}"
    unloaded = settings.model_copy(update={"payload_mass": 0.0, "payload_inertia": (0.0,) * 6})
    loaded, bare = (link_parameters(estimate.robot.rebuild(case).model) for case in (settings, unloaded))
    load = loaded - bare
    if loader_of(path) is load_urdf:
        return _urdf(path, estimate, _bodies(estimate, load, path), source)
    rows = read_yaml(path, RobotError)
    file = DhFile.model_validate(rows)
    load[-1] += (file.joints[-1].next_in_joint() * file.payload.body).toDynamicParameters()
    for joint, row, body in zip(file.joints, rows["links"], _bodies(estimate, load, path), strict=True):
        link = joint.link_in_joint().actInv(body)
        row |= {"mass": _rounded(link.mass), "com": [_rounded(value) for value in link.lever]}
        row.pop("inertia", None)
        if not estimate.point_masses:
            row["inertia"] = [_rounded(link.inertia[place]) for place in DH_INERTIA]
    heading = f"# Masses {source}. The comments of the original are not kept.\n"
    return (heading + yaml.safe_dump(rows, sort_keys=False, default_flow_style=None, allow_unicode=True)).encode()


def _bodies(estimate: ArmEstimate, load: FloatArray, path: Path) -> list[pin.Inertia]:
    """Return the identified bodies in the frames of their joints, without the `load` (n, 10). Raises RobotError."""
    parameters = estimate.parameters - load
    for name, link in zip(estimate.robot.joint_names, parameters, strict=True):
        body = pin.PseudoInertia.FromDynamicParameters(link).toMatrix()
        if not (link[0] > 0.0 and (estimate.point_masses or np.linalg.eigvalsh(body)[0] > 0.0)):
            raise RobotError(
                f"{path}: the link behind {name} is not physically possible without its stated load: check the payload"
            )
    return list(with_parameters(estimate.robot.model, parameters).inertias)[1:]


def _urdf(path: Path, estimate: ArmEstimate, bodies: list[pin.Inertia], source: str) -> bytes:
    root = ET.fromstring(path.read_bytes())  # noqa: S314 - a local file that the robot was loaded from
    joints = {joint.get("name"): joint for joint in root.iter("joint") if joint.find("child") is not None}
    children = {name: _link(joint, "child") for name, joint in joints.items()}
    elements = {link.get("name"): link for link in root.findall("link")}
    for name, inertia in zip(estimate.robot.joint_names, bodies, strict=True):
        body = [children[name]]
        for link in body:
            fixed = (key for key, joint in joints.items() if _link(joint, "parent") == link)
            body += [children[key] for key in fixed if key not in estimate.robot.joint_names]
        for link in body:
            for inertial in elements[link].findall("inertial"):
                elements[link].remove(inertial)
        tensor = np.zeros((3, 3)) if estimate.point_masses else inertia.inertia
        elements[body[0]].insert(0, _inertial(inertia, tensor))
    root.insert(0, ET.Comment(f" inertial elements {source} ".replace("--", "- -")))
    ET.indent(root)
    return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True))


def _link(joint: ET.Element, kind: str) -> str:
    element = joint.find(kind)
    return "" if element is None else str(element.get("link"))


def _inertial(inertia: pin.Inertia, tensor: FloatArray) -> ET.Element:
    """Return the element of a body, with its inertia `tensor` (3, 3), in the frame of its link."""
    element = ET.Element("inertial")
    ET.SubElement(element, "origin", xyz=" ".join(f"{value:.9g}" for value in inertia.lever), rpy="0 0 0")
    ET.SubElement(element, "mass", value=f"{inertia.mass:.9g}")
    ET.SubElement(element, "inertia", {name: f"{tensor[place]:.9g}" for name, place in URDF_INERTIA.items()})
    return element


def _rounded(value: float) -> float:
    return float(f"{value:.9g}")
