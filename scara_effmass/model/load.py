"""A robot from a file, whatever its format."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from scara_effmass.errors import RobotError
from scara_effmass.model.dh import load_dh
from scara_effmass.model.urdf import parse_urdf

if TYPE_CHECKING:
    from pathlib import Path

    from scara_effmass.model.robot import Robot
    from scara_effmass.settings import MonitorSettings


def load_robot(path: Path, settings: MonitorSettings) -> Robot:
    """Return the robot in `path`: DH rows in `.yaml`/`.yml`, else URDF.

    `settings` names contact points, locked joints, payload and armature of a URDF; a DH file states its own.
    Raises RobotError.
    """
    if path.suffix.lower() in {".yaml", ".yml"}:
        for key in ("payload_mass", "armature", "locked_joints"):
            value = getattr(settings, key)
            if value and value != type(settings).model_fields[key].default:
                raise RobotError(f"{key} = {value!r}: for URDF files; {path} states its own, change it there")
        return load_dh(path, settings.contact_points)
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise RobotError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise RobotError(f"{path}: neither a URDF nor a DH YAML file") from None
    return robot_from_urdf(text, str(path), settings)


def robot_from_urdf(text: str, origin: str, settings: MonitorSettings) -> Robot:
    """Return the robot of the URDF `text`, as on the `robot_description` topic. Raises RobotError."""
    return parse_urdf(
        text, origin, settings.contact_points, settings.locked_joints, settings.payload_mass, _armature(settings)
    )


def _armature(settings: MonitorSettings) -> dict[str, float]:
    """Return the reflected rotor inertias by joint. Raises RobotError."""
    armature: dict[str, float] = {}
    for entry in settings.armature:
        joint, _, text = entry.partition("=")
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not joint or joint in armature or not 0.0 <= value < math.inf:
            raise RobotError(f"armature = {entry!r}: must be joint=value, each joint once, the value 0 or more")
        armature[joint] = value
    return armature
