# SPDX-License-Identifier: Apache-2.0
"""ISO/TS 15066:2016, Annex A: the limits table, the contact formulas, and the speed that the limits allow.

`EDITION` states what is unconfirmed about ISO 10218-2:2025, which carries the limits on.
"""

from scara_effmass.iso15066.allowable_speed import (
    MIN_EFFECTIVE_MASS,
    ContactCase,
    SpeedLimit,
    contact_cases,
    speed_limit_of_mass,
)
from scara_effmass.iso15066.contact import (
    TRANSIENT_S,
    contact_time,
    force_per_root_stiffness,
    peak_force,
    reduced_mass,
    robot_mass,
    transferred_energy,
)
from scara_effmass.iso15066.limits import Criterion, Limit, contact_area, limits_for, limits_of
from scara_effmass.iso15066.table import (
    BODY_POINTS,
    BODY_REGIONS,
    CLAUSE_2025,
    EDITION,
    TABLE_HASH,
    BodyPoint,
    BodyRegion,
)

__all__ = [
    "BODY_POINTS",
    "BODY_REGIONS",
    "CLAUSE_2025",
    "EDITION",
    "MIN_EFFECTIVE_MASS",
    "TABLE_HASH",
    "TRANSIENT_S",
    "BodyPoint",
    "BodyRegion",
    "ContactCase",
    "Criterion",
    "Limit",
    "SpeedLimit",
    "contact_area",
    "contact_cases",
    "contact_time",
    "force_per_root_stiffness",
    "limits_for",
    "limits_of",
    "peak_force",
    "reduced_mass",
    "robot_mass",
    "speed_limit_of_mass",
    "transferred_energy",
]
