# SPDX-License-Identifier: Apache-2.0
"""Masses of one contact point: lumped, full and ISO, and which of them decide."""

from __future__ import annotations

import math
from typing import NamedTuple

from scara_effmass.codes import ModelReason, NoLumpedMass, Reason
from scara_effmass.iso15066 import MIN_EFFECTIVE_MASS
from scara_effmass.kernel.codes import Model, Normal
from scara_effmass.kernel.compiled import inlined
from scara_effmass.kernel.contact_point import Approach, mobility_of
from scara_effmass.kernel.mobility import along, inverse, is_bounded, is_definite, smallest_eigenvalue
from scara_effmass.kernel.records import Setup, Work
from scara_effmass.kernel.spatial import dot, vector_at
from scara_effmass.reference.dynamics import MIN_LEVER_M
from scara_effmass.values import NO_MOBILITY, Mobility6, Vector3


class Takes(NamedTuple):
    """Which models decide, by `Model`."""

    lumped: bool
    full: bool
    iso: bool


class Choice(NamedTuple):
    """Mobilities, the models that decide, and why. `error` is the reason if no mass can decide."""

    lumped: Mobility6
    full: Mobility6
    takes: Takes
    why: int
    is_heavy: bool
    is_massless: bool
    error: Reason
    error_value: float


@inlined
def mass_along(m: Mobility6, approach: Approach) -> float:
    """Return the effective mass [kg] along the velocity, at rest the largest."""
    return inverse(along(m, approach.direction)) if approach.is_moving else worst_mass(m, approach.rank)


@inlined
def worst_mass(m: Mobility6, rank: int) -> float:
    """Return the largest effective mass [kg]."""
    return inverse(smallest_eigenvalue(m, rank))


@inlined
def massless_joint(approach: Approach, setup: Setup, work: Work) -> tuple[bool, int]:
    """Return whether a joint without lumped mass moves the point, and the last that does along the velocity, or -1."""
    is_massless, last = False, -1
    for j in range(approach.joints):
        lever = vector_at(work.jacobian, j)
        if setup.is_massless[j] and dot(lever, lever) > MIN_LEVER_M * MIN_LEVER_M:
            is_massless = True
            if not approach.is_moving or abs(dot(approach.direction, lever)) > MIN_LEVER_M:
                last = j
    return is_massless, last


@inlined
def choose_models(approach: Approach, is_link: bool, setup: Setup, work: Work) -> Choice:  # noqa: FBT001 - compiled
    """Write `masses` along the velocity and `worst` of the models that decide; return the choice.

    Of a link, the lumped model is compared at one place, so the full one decides as well.
    """
    masses, worst, count, rank = work.masses, work.worst, approach.joints, approach.rank
    lumped = full = NO_MOBILITY
    masses[Model.LUMPED] = masses[Model.FULL] = worst[Model.LUMPED] = worst[Model.FULL] = math.nan
    masses[Model.ISO] = worst[Model.ISO] = setup.iso_mass
    reason: int = NoLumpedMass.NOT_THERE
    has_lumped = setup.has_lumped
    if has_lumped:
        lumped = mobility_of(Model.LUMPED, count, work)
        if setup.is_lumped_regular or is_definite(lumped, rank):
            masses[Model.LUMPED] = mass_along(lumped, approach)
        else:
            has_lumped, reason, lumped = False, NoLumpedMass.NOT_DEFINITE, NO_MOBILITY
    if setup.has_full:
        full = mobility_of(Model.FULL, count, work)
        masses[Model.FULL] = mass_along(full, approach)
    is_massless, joint = massless_joint(approach, setup, work)
    if joint >= 0:
        masses[Model.LUMPED], reason = math.nan, NoLumpedMass.MASSLESS_JOINT + joint
    is_heavy = has_lumped and setup.has_full and not is_massless and setup.model == Model.AUTO
    is_heavy = is_heavy and is_bounded(lumped, full, 1.0 - setup.model_margin)
    takes_lumped, takes_full, takes_iso, why = deciding_models(setup, work, reason, is_massless, is_heavy)
    takes_full = takes_full or (is_heavy and is_link)
    if takes_lumped and not is_massless:
        worst[Model.LUMPED] = worst_mass(lumped, rank) if approach.is_moving else masses[Model.LUMPED]
    if takes_full:
        worst[Model.FULL] = worst_mass(full, rank) if approach.is_moving else masses[Model.FULL]
    takes = Takes(takes_lumped, takes_full, takes_iso)
    error, value = error_of(takes, reason, setup, work)
    return Choice(lumped, full, takes, why, is_heavy, is_massless, error, value)


@inlined
def deciding_models(
    setup: Setup,
    work: Work,
    reason: int,
    is_massless: bool,  # noqa: FBT001 - compiled
    is_heavy: bool,  # noqa: FBT001 - compiled
) -> tuple[bool, bool, bool, int]:
    """Return whether lumped, full and ISO mass decide, and why."""
    has_lumped, has_full = not math.isnan(work.masses[Model.LUMPED]), not math.isnan(work.masses[Model.FULL])
    model = setup.model
    if model != Model.AUTO:
        takes_lumped = has_lumped and (model in (Model.LUMPED, Model.LARGEST))
        takes_full = has_full and (model in (Model.FULL, Model.LARGEST))
        return takes_lumped, takes_full, model in (Model.ISO, Model.LARGEST), ModelReason.SETTING
    if is_heavy:
        return True, not setup.is_scara, False, ModelReason.HEAVY_ENOUGH
    if is_massless:
        has_lumped = False
        reason = NoLumpedMass.MASSLESS if reason == NoLumpedMass.NOT_THERE else reason
    if has_full:
        return False, True, False, ModelReason.LIGHTER if has_lumped else ModelReason.NO_LUMPED + reason
    if not has_lumped:
        return False, False, True, ModelReason.NO_LUMPED + NoLumpedMass.MASSLESS_JOINT + setup.joints + reason
    return True, False, not setup.lumped_suffices, ModelReason.LARGEST


@inlined
def error_of(takes: Takes, reason: int, setup: Setup, work: Work) -> tuple[Reason, float]:
    """Return why there is no mass to decide with, and the first number of that reason."""
    if not setup.has_masses:
        return Reason.NO_MASSES, 0.0
    if setup.model == Model.LUMPED and not takes.lumped:
        return Reason.NO_LUMPED_MASS, 1.0 * reason
    if setup.model == Model.FULL and not takes.full:
        return Reason.NO_FULL_MASS, 0.0
    for k in range(3):
        if takes[k]:
            if work.masses[k] < MIN_EFFECTIVE_MASS:
                return Reason.TOO_LIGHT, 1.0 + k
            if math.isnan(work.worst[k]) and setup.normal != Normal.VELOCITY:
                return Reason.NO_WORST_MASS, 1.0 + k
    return Reason.NONE, 0.0


@inlined
def largest_along(choice: Choice, n: Vector3, setup: Setup) -> float:
    """Return the largest effective mass [kg] along `n` of the models that decide."""
    mass = setup.iso_mass if choice.takes.iso else 0.0
    mass = max(mass, inverse(along(choice.lumped, n))) if choice.takes.lumped else mass
    return max(mass, inverse(along(choice.full, n))) if choice.takes.full else mass
