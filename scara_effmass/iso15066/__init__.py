"""The standard's limits: its table, the limits that hold for given settings, and the speed they allow.

Source: ISO/TS 15066:2016, Annex A; `EDITION` says what is not confirmed about ISO 10218-2:2025.
"""

from scara_effmass.iso15066.contact import (
    force_per_root_stiffness,
    peak_force,
    reduced_mass,
    robot_mass,
    transferred_energy,
)
from scara_effmass.iso15066.limits import Criterion, Limit, limits_for
from scara_effmass.iso15066.speed_limit import LIGHTEST_MASS, SpeedLimit, SpeedLimits
from scara_effmass.iso15066.table import BODY_POINTS, BODY_REGIONS, EDITION, TABLE_HASH, BodyPoint, BodyRegion

__all__ = [
    "BODY_POINTS",
    "BODY_REGIONS",
    "EDITION",
    "LIGHTEST_MASS",
    "TABLE_HASH",
    "BodyPoint",
    "BodyRegion",
    "Criterion",
    "Limit",
    "SpeedLimit",
    "SpeedLimits",
    "force_per_root_stiffness",
    "limits_for",
    "peak_force",
    "reduced_mass",
    "robot_mass",
    "transferred_energy",
]
