# SPDX-License-Identifier: Apache-2.0
"""Biomechanical limits of ISO/TS 15066:2016, Annex A: body points (Table A.2) and body regions (Table A.3)."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from types import MappingProxyType

from scara_effmass.input_files import read_table

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


_TABLES = read_table(__file__, "table.yaml")

BODY_POINTS: tuple[BodyPoint, ...] = tuple(
    BodyPoint(
        number,
        name,
        region,
        f"Table A.2 row {number}",
        pressure,
        force,
        None if region in _TABLES["no_transient"] else 2.0,
    )
    for number, (name, region, pressure, force) in enumerate(_TABLES["points"], start=1)
)
"""The 29 rows of Table A.2, in their order."""

BODY_REGIONS: Mapping[str, BodyRegion] = MappingProxyType(
    {
        name: BodyRegion(name, 1e3 * stiffness, mass, energy, "Table A.3 (stiffness, mass), Annex A (energy)")
        for name, stiffness, mass, energy in _TABLES["regions"]
    }
)
"""The 12 regions by name, from head to foot."""

TABLE_HASH: str = hashlib.sha256(
    json.dumps(
        [[asdict(point) for point in BODY_POINTS], [asdict(region) for region in BODY_REGIONS.values()]], sort_keys=True
    ).encode()
).hexdigest()[:16]
"""First 16 hexadecimal digits of the SHA-256 of all rows; reports with the same hash used the same table."""
