# SPDX-License-Identifier: Apache-2.0
"""`scara-effmass limits`."""

import argparse
import math
from dataclasses import asdict
from typing import Any

from scara_effmass.cli.console import WIDE, print_json, print_table, printer
from scara_effmass.cli.options import monitor_settings
from scara_effmass.iso15066 import (
    BODY_POINTS,
    BODY_REGIONS,
    CLAUSE_2025,
    EDITION,
    TABLE_HASH,
    BodyPoint,
    Limit,
    limits_for,
    speed_limit_of_mass,
    transferred_energy,
)
from scara_effmass.settings import Drives, MonitorSettings
from scara_effmass.values import at_most

SCOPE = "relative speed at nominal values; a monitor allows less, by margins and drives"
"""What the allowable speeds leave out."""


def run(args: argparse.Namespace) -> int:
    """Print the rows of the chosen regions, and the allowable speeds of the masses."""
    settings = monitor_settings(args)
    limits = limits_for(settings)
    nominal = settings.model_copy(update={"stiffness_uncertainty": 0.0, "drives": Drives.FREE})
    # Without --region the table also has the regions without a limit for this type of contact.
    regions = [BODY_REGIONS[limit.region] for limit in limits] if settings.body_regions else list(BODY_REGIONS.values())
    names = {region.name for region in regions}
    points = [point for point in BODY_POINTS if point.region in names]
    if args.json:
        clause = {"clause_2025": CLAUSE_2025}
        result = {
            "edition": EDITION,
            "hash": TABLE_HASH,
            "body_points": [asdict(point) | clause | _transient(point) for point in points],
            "body_regions": [asdict(region) | clause for region in regions],
            "contact": settings.contact.value,
            "contact_area_m2": settings.contact_area_m2,
            "scope": SCOPE,
            "allowable_speeds": [_speed(mass, limit, nominal) for mass in args.masses for limit in limits],
        }
        print_json(result)
        return 0
    is_wide = printer().width >= WIDE
    print_table(
        "Body points (2016: Table A.2): permissible force and pressure",
        ("row", "point", "region", "clamped\n[N]", "\n[N/cm²]", "transient\n[N]", "\n[N/cm²]"),
        (
            (
                *(point.clause if is_wide else point.clause.rpartition(" ")[2], point.name, point.region),
                *(point.quasi_static_force_n, point.quasi_static_pressure_n_cm2, *_transient(point).values()),
            )
            for point in points
        ),
    )
    print_table(
        "Body regions (2016: Table A.3); energy for information",
        ("region", "stiffness [N/mm]", "mass [kg]", "energy [J]"),
        ((region.name, region.stiffness_n_m / 1e3, region.mass_kg, region.energy_j) for region in regions),
    )
    if args.masses:
        _print_speeds(args.masses, limits, nominal)
    printer().print(f"{EDITION}; hash {TABLE_HASH}")
    printer().print(f"both tables: {CLAUSE_2025}")
    return 0


def _transient(point: BodyPoint) -> dict[str, float | None]:
    """Return the limits of a free impact, which are no fields of `point`."""
    force_n, pressure_n_cm2 = point.transient_force_n, point.transient_pressure_n_cm2
    return {"transient_force_n": force_n, "transient_pressure_n_cm2": pressure_n_cm2}


def _speed(mass: float, limit: Limit, settings: MonitorSettings) -> dict[str, Any]:
    found = speed_limit_of_mass([limit], mass, settings)
    return {
        "effective_mass_kg": mass,
        "region": limit.region,
        "allowable_speed_m_s": found.allowable_speed,
        "criterion": found.criterion,
        "reduced_mass_kg": found.reduced_mass,
        "permissible_force_n": limit.permissible_force_n,
        "force_n": limit.force_n,
        "pressure_n_cm2": limit.pressure_n_cm2,
        "energy_j": transferred_energy(found.allowable_speed, found.reduced_mass),
        "clause": limit.clause,
    }


def _print_speeds(masses: list[float], limits: tuple[Limit, ...], settings: MonitorSettings) -> None:
    rows = []
    for limit in limits:
        speed_limits = (speed_limit_of_mass([limit], mass, settings) for mass in masses)
        speeds = (f"{at_most(1e3 * speed.allowable_speed, 0)} ({speed.criterion})" for speed in speed_limits)
        rows.append((limit.region, *speeds, limit.clause))
    if len(limits) > 1:
        speed_limits = (speed_limit_of_mass(limits, mass, settings) for mass in masses)
        speeds = (f"{at_most(1e3 * s.allowable_speed, 0)} ({s.limit.region}, {s.criterion})" for s in speed_limits)
        rows.append(("lowest", *speeds, ""))
    headings = ("region", *(f"{mass:g} kg" for mass in masses), "limits")
    print_table("Allowable speed [mm/s] and the limit that sets it", headings, rows)
    person = "clamped body part" if math.isinf(limits[0].body_mass_kg) else "body part free to recoil"
    area = f"contact area {limits[0].contact_area_cm2:g} cm²"
    printer().print(f"{limits[0].contact.value} contact, {person}; {area}; joints free")
    printer().print(SCOPE)
