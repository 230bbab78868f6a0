# SPDX-License-Identifier: Apache-2.0
"""Effective mass, impact force and allowable speed of a serial robot, live from its joint states.

`load_robot`, `RobotDynamics` and `Monitor` assess joint states; `Detector` finds impacts in a force signal;
`Validator` compares measured impacts with the forces predicted from the effective mass. The names below load on first
use, so that `import scara_effmass` alone imports neither Pinocchio nor ROS.
"""

from __future__ import annotations

import os
import sys
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from scara_effmass.codes import ModelCode
    from scara_effmass.errors import EffmassError
    from scara_effmass.impacts.detector import Detector
    from scara_effmass.impacts.validator import Result, Validator
    from scara_effmass.model.load import load_robot
    from scara_effmass.model.robot import Robot
    from scara_effmass.reference import PoseState, RobotDynamics
    from scara_effmass.safety import Monitor
    from scara_effmass.settings import DetectionSettings, MonitorSettings, ValidatorSettings
    from scara_effmass.values import (
        ContactAssessment,
        Decision,
        ForceBlock,
        Impact,
        JointState,
        ValidatedImpact,
        Verdict,
    )

__all__ = [
    "ContactAssessment",
    "Decision",
    "DetectionSettings",
    "Detector",
    "EffmassError",
    "ForceBlock",
    "Impact",
    "JointState",
    "ModelCode",
    "Monitor",
    "MonitorSettings",
    "PoseState",
    "Result",
    "Robot",
    "RobotDynamics",
    "ValidatedImpact",
    "Validator",
    "ValidatorSettings",
    "Verdict",
    "load_robot",
]

__version__ = version("scara_effmass")


def _import_changed_sources() -> None:
    """Let an editable installation import all sources if one of them is newer than its compiled module.

    Compiled modules depend on each other, so either all of them are used or none. SCARA_EFFMASS_SOURCES=1: none.
    """
    for finder in sys.meta_path:
        compiled, sources = getattr(finder, "known_wheel_files", {}), getattr(finder, "known_source_files", {})
        ours = [name for name in compiled if name in sources and name.startswith(f"{__name__}.")]
        folder = Path(getattr(finder, "dir", ""))
        times = [(Path(sources[name]).stat().st_mtime, (folder / compiled[name]).stat().st_mtime) for name in ours]
        if os.environ.get("SCARA_EFFMASS_SOURCES") == "1" or any(source > library for source, library in times):
            for name in ours:
                del compiled[name]


_import_changed_sources()

_MODULES = [
    "errors",
    "codes",
    "values",
    "settings",
    "impacts.detector",
    "impacts.validator",
    "safety",
    "model.robot",
    "model.load",
    "reference",
]
"""Modules of the public names; those that load Pinocchio come last."""


def __getattr__(name: str) -> object:
    """Import the public name `name` on first use."""
    for module in map(import_module, (f"{__name__}.{module}" for module in _MODULES if name in __all__)):
        if hasattr(module, name):
            return getattr(module, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
