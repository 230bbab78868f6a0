# SPDX-License-Identifier: Apache-2.0
"""Effective mass, impact force and allowable speed of a serial robot, live from its joint states.

`load_robot`, `RobotDynamics` and `Monitor` assess joint states; `Detector` finds impacts in a force signal;
`Validator` compares measured impacts with the forces predicted from the effective mass. The names below load on first
use, so that `import scara_effmass` alone imports neither Pinocchio nor ROS.
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import version
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

__version__: str

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
    """Import the public name `name` on first use; read the version, which needs an installation, on first use too."""
    if name == "__version__":
        return version("scara_effmass")
    for module in map(import_module, (f"{__name__}.{module}" for module in _MODULES if name in __all__)):
        if hasattr(module, name):
            return getattr(module, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
