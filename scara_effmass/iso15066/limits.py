# SPDX-License-Identifier: Apache-2.0
"""Limits of the chosen body regions for a type of contact. Settings may tighten them but never loosen them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Literal

from scara_effmass.errors import LimitError
from scara_effmass.iso15066.table import BODY_POINTS, BODY_REGIONS
from scara_effmass.settings import ContactType, MonitorSettings

if TYPE_CHECKING:
    from scara_effmass.iso15066.table import BodyPoint, BodyRegion

_CM2_PER_M2 = _PA_PER_N_CM2 = 1e4
MIN_FORCE_N = 1e-6
"""Smallest permissible force [N], far below any that can be measured."""

Criterion = Literal["force", "pressure"]


@dataclass(frozen=True, slots=True)
class Limit:
    """Limits of one body region in one type of contact.

    `force_points` and `pressure_points` are the strictest rows of Table A.2 for the region, which set the limit;
    empty if a stricter limit from the settings replaces them. `body_mass_kg` is infinite for a clamped body
    part. Pressure and area are in the units of Table A.2. `energy_j` is the standard's value, for information only.
    """

    region: str
    contact: ContactType
    force_n: float
    force_points: tuple[BodyPoint, ...]
    pressure_n_cm2: float
    pressure_points: tuple[BodyPoint, ...]
    contact_area_cm2: float
    stiffness_n_m: float
    body_mass_kg: float
    energy_j: float

    @property
    def permissible_force_n(self) -> float:
        """Smaller of the force limit and the pressure limit times the contact area [N]."""
        return min(self.force_n, self.pressure_n_cm2 * self.contact_area_cm2)

    @property
    def criterion(self) -> Criterion:
        """The smaller of the two limits at this contact area; force if they are equal."""
        return "force" if self.force_n <= self.pressure_n_cm2 * self.contact_area_cm2 else "pressure"

    @property
    def clause(self) -> str:
        """Source of the limits: rows of Table A.2 or settings."""
        force = _rows(self.force_points) or "own limit (max_force)"
        pressure = _rows(self.pressure_points) or "own limit (max_pressure_pa)"
        return f"force: {force}; pressure: {pressure}"


def limits_of(settings: MonitorSettings, contacts: Sequence[str]) -> tuple[tuple[Limit, ...], ...]:
    """Return the limits of each of the `contacts`, see `limits_for`.

    Raises LimitError for an entry of `contact_areas` that matches none of them, too.
    """
    for glob in settings.stated_areas:
        if not any(fnmatchcase(contact, glob) for contact in contacts):
            raise LimitError(f"contact_areas = {glob!r}: must match one of the contacts {', '.join(contacts)}")
    return tuple(limits_for(settings, contact) for contact in contacts)


def contact_area(settings: MonitorSettings, contact: str) -> float:
    """Return the contact area [m2] of a `contact` point or link."""
    areas = (area for glob, area in settings.stated_areas.items() if fnmatchcase(contact, glob))
    return next(areas, settings.contact_area_m2)


def limits_for(settings: MonitorSettings, contact: str = "") -> tuple[Limit, ...]:
    """Return the limits of `settings.body_regions`, from head to foot; by default of all regions that have one.

    The area is that of a `contact` point or link by its name; by default `contact_area_m2`.

    A limit from `settings` replaces the standard's in the regions where it is stricter. Raises LimitError for a region
    that is unknown, repeated or of the head (where the standard permits no contact), for a setting that is looser than
    the standard in every chosen region, and for limits that permit less than `MIN_FORCE_N`.
    """
    area_cm2 = _CM2_PER_M2 * contact_area(settings, contact)
    regions = _chosen_regions(settings.body_regions)
    limits = tuple(_standard_limit(region, settings.contact, area_cm2) for region in regions)
    _check_not_looser(settings, limits)
    limits = tuple(_tightened(limit, settings) for limit in limits)
    weakest = min(limits, key=lambda limit: limit.permissible_force_n)
    if weakest.permissible_force_n < MIN_FORCE_N:
        raise LimitError(
            f"contact_area_m2, max_force and max_pressure_pa permit {weakest.permissible_force_n:.3g} N on "
            f"{weakest.region}: must permit at least {MIN_FORCE_N:g} N"
        )
    return limits


def _chosen_regions(names: tuple[str, ...]) -> tuple[BodyRegion, ...]:
    covered = {point.region for point in BODY_POINTS if point.transient_factor is not None}
    for name in names:
        if name not in BODY_REGIONS:
            raise LimitError(f"body_regions = {name!r}: must be one of {', '.join(BODY_REGIONS)}")
        if names.count(name) > 1:
            raise LimitError(f"body_regions = {name!r}: must be named once, not {names.count(name)} times")
        if name not in covered:
            rows = _rows([point for point in BODY_POINTS if point.region == name])
            raise LimitError(
                f"body_regions = {name!r}: the standard permits no contact with head and face ({rows} hold for no "
                "speed): leave it out and prevent the contact by other means"
            )
    return tuple(region for region in BODY_REGIONS.values() if region.name in (names or covered))


def _standard_limit(region: BodyRegion, contact: ContactType, area_cm2: float) -> Limit:
    clamped = contact is ContactType.QUASI_STATIC
    points = [point for point in BODY_POINTS if point.region == region.name]
    force, force_points = _strictest(
        {point: point.quasi_static_force_n if clamped else point.transient_force_n for point in points}
    )
    pressure, pressure_points = _strictest(
        {point: point.quasi_static_pressure_n_cm2 if clamped else point.transient_pressure_n_cm2 for point in points}
    )
    return Limit(
        region=region.name,
        contact=contact,
        force_n=force,
        force_points=force_points,
        pressure_n_cm2=pressure,
        pressure_points=pressure_points,
        contact_area_cm2=area_cm2,
        stiffness_n_m=region.stiffness_n_m,
        body_mass_kg=math.inf if clamped else region.mass_kg,
        energy_j=region.energy_j,
    )


def _strictest(values: Mapping[BodyPoint, float | None]) -> tuple[float, tuple[BodyPoint, ...]]:
    """Return the smallest of `values`, and the rows that state it."""
    smallest = min(value for value in values.values() if value is not None)
    return smallest, tuple(point for point, value in values.items() if value == smallest)


def _check_not_looser(settings: MonitorSettings, limits: tuple[Limit, ...]) -> None:
    """Raise LimitError for a setting that is looser than the standard in every region, and so tightens nothing."""
    force = max(limits, key=lambda limit: limit.force_n)
    if settings.max_force > force.force_n:
        raise LimitError(
            f"max_force = {settings.max_force:g} N: must be at most the standard's {force.force_n:g} N "
            f"for {force.region} ({force.contact.value}, {_rows(force.force_points)}), or 0 for no own limit"
        )
    pressure = max(limits, key=lambda limit: limit.pressure_n_cm2)
    if settings.max_pressure_pa > _PA_PER_N_CM2 * pressure.pressure_n_cm2:
        raise LimitError(
            f"max_pressure_pa = {settings.max_pressure_pa:g} Pa: must be at most the standard's "
            f"{_PA_PER_N_CM2 * pressure.pressure_n_cm2:g} Pa for {pressure.region} "
            f"({pressure.contact.value}, {_rows(pressure.pressure_points)}), or 0 for no own limit"
        )
    stiffness = min(limits, key=lambda limit: limit.stiffness_n_m)
    if 0.0 < settings.stiffness_n_m < stiffness.stiffness_n_m:
        raise LimitError(
            f"stiffness_n_m = {settings.stiffness_n_m:g} N/m: must be at least the standard's "
            f"{stiffness.stiffness_n_m:g} N/m for {stiffness.region} (Table A.3), or 0 for it"
        )
    mass = min(limits, key=lambda limit: limit.body_mass_kg)
    if 0.0 < settings.body_mass < mass.body_mass_kg:
        rule = f"at least the standard's {mass.body_mass_kg:g} kg for {mass.region} (Table A.3), or 0 for it"
        if math.isinf(mass.body_mass_kg):
            rule = f"0: a clamped body part is infinitely heavy (contact = {mass.contact.value})"
        raise LimitError(f"body_mass = {settings.body_mass:g} kg: must be {rule}")


def _tightened(limit: Limit, settings: MonitorSettings) -> Limit:
    max_force = settings.max_force or math.inf
    max_pressure = (settings.max_pressure_pa or math.inf) / _PA_PER_N_CM2
    return replace(
        limit,
        force_n=min(limit.force_n, max_force),
        force_points=() if max_force < limit.force_n else limit.force_points,
        pressure_n_cm2=min(limit.pressure_n_cm2, max_pressure),
        pressure_points=() if max_pressure < limit.pressure_n_cm2 else limit.pressure_points,
        stiffness_n_m=max(limit.stiffness_n_m, settings.stiffness_n_m),
        body_mass_kg=max(limit.body_mass_kg, settings.body_mass),
    )


def _rows(points: Sequence[BodyPoint]) -> str:
    """Return "Table A.2 row 28, 29", or an empty string without points."""
    return ", ".join([point.clause for point in points[:1]] + [str(point.number) for point in points[1:]])
