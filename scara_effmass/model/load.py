"""A robot from a file, whatever its format."""

from __future__ import annotations

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

    `settings` names contact points, locked joints and the payload of a URDF; a DH file states its own payload.
    Raises RobotError.
    """
    if path.suffix.lower() in {".yaml", ".yml"}:
        if settings.payload_mass > 0.0:
            raise RobotError(
                f"payload_mass = {settings.payload_mass}: {path} states its payload itself; change it there"
            )
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
    return parse_urdf(text, origin, settings.contact_points, settings.locked_joints, settings.payload_mass)
