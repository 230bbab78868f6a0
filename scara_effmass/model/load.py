# SPDX-License-Identifier: Apache-2.0
"""Load a robot from a file of any format."""

from pathlib import Path
from typing import Protocol

from scara_effmass.model.dh import load_dh
from scara_effmass.model.robot import Robot
from scara_effmass.model.urdf import load_urdf
from scara_effmass.settings import MonitorSettings


class RobotFormat(Protocol):
    """Loader of one file format."""

    def __call__(self, path: Path, settings: MonitorSettings) -> Robot:
        """Return the robot in `path`. Raises RobotError where the file or `settings` cannot be used."""


ROBOT_FORMATS: dict[str, RobotFormat] = {
    ".urdf": load_urdf,
    ".yaml": load_dh,
    ".yml": load_dh,
}
"""Loader by file suffix; a file with another suffix, such as .xml, is read as URDF."""


def load_robot(path: Path | None = None, settings: MonitorSettings | None = None) -> Robot:
    """Return the robot in `path`; by default the one that `settings` name, the shipped Omron i4-550L if none.

    `settings` hold the contact points, and for a URDF also locked joints, payload and armature, which a DH file
    states itself. Raises RobotError.
    """
    settings = settings or MonitorSettings()
    path = path or settings.robot_path
    return ROBOT_FORMATS.get(path.suffix.lower(), load_urdf)(path, settings)
