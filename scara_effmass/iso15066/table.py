# SPDX-License-Identifier: Apache-2.0
"""Biomechanical limits of ISO/TS 15066:2016, Annex A: body points (Table A.2) and body regions (Table A.3)."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from types import MappingProxyType

EDITION = "ISO/TS 15066:2016, Annex A (carried into ISO 10218-2:2025; changes of numbers there unconfirmed)"
CLAUSE_2025 = "ISO 10218-2:2025, Annex M (measurement: Annex N; by secondary sources)"
"""Place of both tables in the edition of 2025. The standard itself was not at hand."""


@dataclass(frozen=True, slots=True)
class BodyPoint:
    """One row of Table A.2: the quasi-static limits of one body point.

    `transient_factor` multiplies them for a free impact; None if the standard gives no transient limit.
    """

    number: int
    name: str
    region: str
    clause: str
    quasi_static_pressure_n_cm2: float
    quasi_static_force_n: float
    transient_factor: float | None

    @property
    def transient_pressure_n_cm2(self) -> float | None:
        """Pressure limit of a free impact [N/cm2], or None."""
        return None if self.transient_factor is None else self.transient_factor * self.quasi_static_pressure_n_cm2

    @property
    def transient_force_n(self) -> float | None:
        """Force limit of a free impact [N], or None."""
        return None if self.transient_factor is None else self.transient_factor * self.quasi_static_force_n


@dataclass(frozen=True, slots=True)
class BodyRegion:
    """A body region as a spring and a mass; its energy limit is for information only."""

    name: str
    stiffness_n_m: float
    mass_kg: float
    energy_j: float
    clause: str


_NO_TRANSIENT = frozenset({"skull_forehead", "face"})

_POINT_ROWS = (  # name, region, pressure [N/cm2], force [N], both quasi-static; D dominant, ND non-dominant hand
    ("middle of forehead", "skull_forehead", 130.0, 130.0),
    ("temple", "skull_forehead", 110.0, 130.0),
    ("masticatory muscle", "face", 110.0, 65.0),
    ("neck muscle", "neck", 140.0, 150.0),
    ("seventh cervical vertebra", "neck", 210.0, 150.0),
    ("shoulder joint", "back_shoulders", 160.0, 210.0),
    ("fifth lumbar vertebra", "back_shoulders", 210.0, 210.0),
    ("sternum", "chest", 120.0, 140.0),
    ("pectoral muscle", "chest", 170.0, 140.0),
    ("abdominal muscle", "abdomen", 140.0, 110.0),
    ("pelvic bone", "pelvis", 210.0, 180.0),
    ("deltoid muscle", "upper_arm_elbow", 190.0, 150.0),
    ("humerus", "upper_arm_elbow", 220.0, 150.0),
    ("radial bone", "lower_arm_wrist", 190.0, 160.0),
    ("forearm muscle", "lower_arm_wrist", 180.0, 160.0),
    ("arm nerve", "lower_arm_wrist", 180.0, 160.0),
    ("forefinger pad D", "hand_fingers", 300.0, 140.0),
    ("forefinger pad ND", "hand_fingers", 270.0, 140.0),
    ("forefinger end joint D", "hand_fingers", 280.0, 140.0),
    ("forefinger end joint ND", "hand_fingers", 220.0, 140.0),
    ("thenar eminence", "hand_fingers", 200.0, 140.0),
    ("palm D", "hand_fingers", 260.0, 140.0),
    ("palm ND", "hand_fingers", 260.0, 140.0),
    ("back of the hand D", "hand_fingers", 200.0, 140.0),
    ("back of the hand ND", "hand_fingers", 190.0, 140.0),
    ("thigh muscle", "thigh_knee", 250.0, 220.0),
    ("kneecap", "thigh_knee", 220.0, 220.0),
    ("shin", "lower_leg", 220.0, 130.0),
    ("calf muscle", "lower_leg", 210.0, 130.0),
)

_REGION_ROWS = (  # name, stiffness [N/mm], mass [kg], energy [J]
    ("skull_forehead", 150.0, 4.4, 0.23),
    ("face", 75.0, 4.4, 0.11),
    ("neck", 50.0, 1.2, 0.84),
    ("back_shoulders", 35.0, 40.0, 2.5),
    ("chest", 25.0, 40.0, 1.6),
    ("abdomen", 10.0, 40.0, 2.4),
    ("pelvis", 25.0, 40.0, 2.6),
    ("upper_arm_elbow", 30.0, 3.0, 1.5),
    ("lower_arm_wrist", 40.0, 2.0, 1.3),
    ("hand_fingers", 75.0, 0.6, 0.49),
    ("thigh_knee", 50.0, 75.0, 1.9),
    ("lower_leg", 60.0, 75.0, 0.52),
)

BODY_POINTS: tuple[BodyPoint, ...] = tuple(
    BodyPoint(
        number, name, region, f"Table A.2 row {number}", pressure, force, None if region in _NO_TRANSIENT else 2.0
    )
    for number, (name, region, pressure, force) in enumerate(_POINT_ROWS, start=1)
)
"""The 29 rows of Table A.2, in their order."""

BODY_REGIONS: Mapping[str, BodyRegion] = MappingProxyType(
    {
        name: BodyRegion(name, 1e3 * stiffness, mass, energy, "Table A.3 (stiffness, mass), Annex A (energy)")
        for name, stiffness, mass, energy in _REGION_ROWS
    }
)
"""The 12 regions by name, from head to foot."""

TABLE_HASH: str = hashlib.sha256(
    json.dumps(
        [[asdict(point) for point in BODY_POINTS], [asdict(region) for region in BODY_REGIONS.values()]], sort_keys=True
    ).encode()
).hexdigest()[:16]
"""First 16 hexadecimal digits of the SHA-256 of all rows; reports with the same hash used the same table."""
