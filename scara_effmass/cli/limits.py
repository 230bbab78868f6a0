"""`scara-effmass limits`."""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING, Any

from rich import box
from rich.table import Table

from scara_effmass.cli.console import print_json, printer
from scara_effmass.cli.options import add_json, add_limits, add_params, settings_from
from scara_effmass.iso15066 import (
    BODY_POINTS,
    BODY_REGIONS,
    EDITION,
    MIN_EFFECTIVE_MASS,
    TABLE_HASH,
    SpeedLimits,
    limits_for,
    transferred_energy,
)

if TYPE_CHECKING:
    from scara_effmass.iso15066 import BodyPoint, BodyRegion, Limit, SpeedLimit

EXAMPLES = """\
Speeds are relative ones at nominal values: the monitor's uncertainty margins come on top.

examples:
  scara-effmass limits
  scara-effmass limits --mass 0.97 --mass 2.77 --region hand_fingers --region chest
  scara-effmass limits --mass 2.77 --contact quasi_static --json
"""


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = EXAMPLES
    parser.add_argument(
        "--mass",
        dest="masses",
        action="append",
        type=_mass,
        default=[],
        metavar="KG",
        help="effective mass to give allowable speeds for; may be given several times",
    )
    add_limits(parser)
    add_params(parser)
    add_json(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the rows of the chosen regions, and the speeds for the masses."""
    settings = settings_from(args)
    limits = limits_for(settings)
    # Without a choice the whole table is shown, also the regions that this kind of contact has no limit for.
    regions = [BODY_REGIONS[limit.region] for limit in limits] if settings.body_regions else list(BODY_REGIONS.values())
    names = {region.name for region in regions}
    points = [point for point in BODY_POINTS if point.region in names]
    if args.json:
        result = {
            "edition": EDITION,
            "hash": TABLE_HASH,
            "body_points": [_point(point) for point in points],
            "body_regions": [_region(region) for region in regions],
            "contact": settings.contact.value,
            "contact_area_cm2": settings.contact_area,
            "allowable_speeds": [_speed(mass, limit) for mass in args.masses for limit in limits],
        }
        print_json(result)
        return 0
    console = printer()
    console.print(_points_table(points))
    console.print(_regions_table(regions))
    if args.masses:
        console.print(_speeds_table(args.masses, limits))
        console.print(_contact_line(limits[0]))
    console.print(f"{EDITION}; hash {TABLE_HASH}")
    return 0


def _mass(text: str) -> float:
    try:
        mass = float(text)
    except ValueError:
        mass = math.nan
    if not MIN_EFFECTIVE_MASS <= mass < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} kg: give a mass of at least {MIN_EFFECTIVE_MASS:g} kg")
    return mass


def _point(point: BodyPoint) -> dict[str, Any]:
    return {
        "number": point.number,
        "name": point.name,
        "region": point.region,
        "clause": point.clause,
        "quasi_static_force_n": point.quasi_static_force_n,
        "quasi_static_pressure_n_cm2": point.quasi_static_pressure_n_cm2,
        "transient_force_n": point.transient_force_n,
        "transient_pressure_n_cm2": point.transient_pressure_n_cm2,
    }


def _region(region: BodyRegion) -> dict[str, Any]:
    return {
        "name": region.name,
        "stiffness_n_m": region.stiffness_n_m,
        "mass_kg": region.mass_kg,
        "energy_j": region.energy_j,
        "clause": region.clause,
    }


def _ceiling(mass: float, limit: Limit) -> SpeedLimit:
    return SpeedLimits([limit]).speed_limit(mass)


def _speed(mass: float, limit: Limit) -> dict[str, Any]:
    ceiling = _ceiling(mass, limit)
    return {
        "effective_mass_kg": mass,
        "region": limit.region,
        "allowable_speed_m_s": ceiling.allowable_speed,
        "criterion": ceiling.criterion,
        "reduced_mass_kg": ceiling.reduced_mass,
        "permissible_force_n": limit.permissible_force_n,
        "force_n": limit.force_n,
        "pressure_n_cm2": limit.pressure_n_cm2,
        "energy_j": transferred_energy(ceiling.allowable_speed, ceiling.reduced_mass),
        "clause": limit.clause,
    }


def _points_table(points: list[BodyPoint]) -> Table:
    table = Table(
        box=box.SIMPLE_HEAD, title="Body points: force [N] and pressure [N/cm²] that are borne", title_justify="left"
    )
    for heading in ("row", "point", "region"):
        table.add_column(heading)
    for heading in ("clamped force", "clamped pressure", "transient force", "transient pressure"):
        table.add_column(heading, justify="right")
    for point in points:
        table.add_row(
            point.clause,
            point.name,
            point.region,
            f"{point.quasi_static_force_n:g}",
            f"{point.quasi_static_pressure_n_cm2:g}",
            _or_none(point.transient_force_n),
            _or_none(point.transient_pressure_n_cm2),
        )
    return table


def _or_none(value: float | None) -> str:
    return "none given" if value is None else f"{value:g}"


def _regions_table(regions: list[BodyRegion]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, title="Body regions: Table A.3; energy for information", title_justify="left")
    table.add_column("region")
    for heading in ("stiffness [N/mm]", "mass [kg]", "energy [J]"):
        table.add_column(heading, justify="right")
    for region in regions:
        table.add_row(region.name, f"{region.stiffness_n_m / 1e3:g}", f"{region.mass_kg:g}", f"{region.energy_j:g}")
    return table


def _speeds_table(masses: list[float], limits: tuple[Limit, ...]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, title="Allowable speed [mm/s], and what sets it", title_justify="left")
    table.add_column("region")
    for mass in masses:
        table.add_column(f"{mass:g} kg", justify="right")
    table.add_column("limits")
    for limit in limits:
        table.add_row(limit.region, *(_cell(_ceiling(mass, limit)) for mass in masses), limit.clause)
    if len(limits) > 1:
        tightest = SpeedLimits(limits)
        table.add_section()
        table.add_row("tightest", *(_cell(tightest.speed_limit(mass), named=True) for mass in masses), "")
    return table


def _cell(ceiling: SpeedLimit, *, named: bool = False) -> str:
    what = f"{ceiling.limit.region}, {ceiling.criterion}" if named else ceiling.criterion
    return f"{1e3 * ceiling.allowable_speed:.0f} ({what})"


def _contact_line(limit: Limit) -> str:
    person = "the body part clamped" if math.isinf(limit.obstacle_mass_kg) else "the body part free to give way"
    return f"{limit.contact.value} contact, {person}; contact area {limit.contact_area_cm2:g} cm²"
