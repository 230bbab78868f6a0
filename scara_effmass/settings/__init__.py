# SPDX-License-Identifier: Apache-2.0
"""Settings; ROS parameters, YAML files and --help are derived from them."""

from scara_effmass.settings.daq import (
    BagSettings,
    DaqSettings,
    DetectionSettings,
    FilterKind,
    FilterSettings,
    ForceSourceKind,
    ImportSettings,
    Ni9230Settings,
    SensorSettings,
    SimSettings,
    TareSettings,
)
from scara_effmass.settings.loading import checked, load_settings
from scara_effmass.settings.monitor import (
    PAYLOAD_CONTACT,
    WHOLE_ARM,
    ContactType,
    Drives,
    FreeParameters,
    LumpingPolicy,
    LumpingSettings,
    MassModel,
    MonitorSettings,
    ServoSettings,
    VelocitySource,
)
from scara_effmass.settings.validator import CriterionSettings, ValidatorSettings

__all__ = [
    "PAYLOAD_CONTACT",
    "WHOLE_ARM",
    "BagSettings",
    "ContactType",
    "CriterionSettings",
    "DaqSettings",
    "DetectionSettings",
    "Drives",
    "FilterKind",
    "FilterSettings",
    "ForceSourceKind",
    "FreeParameters",
    "ImportSettings",
    "LumpingPolicy",
    "LumpingSettings",
    "MassModel",
    "MonitorSettings",
    "Ni9230Settings",
    "SensorSettings",
    "ServoSettings",
    "SimSettings",
    "TareSettings",
    "ValidatorSettings",
    "VelocitySource",
    "checked",
    "load_settings",
]
