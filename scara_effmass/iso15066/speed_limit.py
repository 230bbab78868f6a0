"""The largest speed at which a contact stays within every limit, and the limit that sets it."""

from __future__ import annotations

import math
from bisect import bisect_right
from typing import TYPE_CHECKING, NamedTuple

from scara_effmass.errors import LimitError
from scara_effmass.iso15066.contact import reduced_mass

if TYPE_CHECKING:
    from collections.abc import Iterable

    from scara_effmass.iso15066.limits import Criterion, Limit

LIGHTEST_MASS = 1e-6
"""Effective mass below which an answer is refused [kg]: no robot weighs a milligram, the model is wrong."""


class SpeedLimit(NamedTuple):
    """The allowable relative speed [m/s] at one effective mass, what sets it, and the reduced mass [kg] there."""

    allowable_speed: float
    limit: Limit
    criterion: Criterion
    reduced_mass: float


class SpeedLimits:
    """The allowable speed under several limits at once; built once, then asked at every joint state.

    `limits` are all that were given, `governing` those that set the speed at some mass, from the lightest on.
    Raises LimitError when there is no limit at all.
    """

    __slots__ = ("_from_mass", "_steps", "governing", "limits")

    def __init__(self, limits: Iterable[Limit]) -> None:
        """Keep the limits that are the tightest at some effective mass; the others cannot matter."""
        self.limits = tuple(limits)
        if not self.limits:
            raise LimitError("no limit to derive a speed from; give at least one body region")
        self._from_mass, self.governing = _lower_envelope(self.limits)
        self._steps = [(limit, limit.permissible_force_n, limit.criterion) for limit in self.governing]

    def speed_limit(self, effective_mass: float, stiffness_factor: float = 1.0) -> SpeedLimit:
        """Return the smallest v_max = min(F, p A) / sqrt(mu k) over all limits.

        `effective_mass` [kg] may be infinite; `stiffness_factor` >= 1 multiplies every stiffness. The speed is
        relative: the person's own is part of it. Raises LimitError for a mass or factor that is NaN or too small.
        """
        if not (effective_mass >= LIGHTEST_MASS and stiffness_factor >= 1.0):
            raise LimitError(
                f"effective_mass = {effective_mass!r} kg, stiffness_factor = {stiffness_factor!r}: "
                f"must be at least {LIGHTEST_MASS:g} kg and 1"
            )
        limit, force, criterion = self._steps[bisect_right(self._from_mass, effective_mass) - 1]
        mu = reduced_mass(effective_mass, limit.obstacle_mass_kg)
        return SpeedLimit(force / math.sqrt(mu * stiffness_factor * limit.stiffness_n_m), limit, criterion, mu)


def _lower_envelope(limits: tuple[Limit, ...]) -> tuple[list[float], tuple[Limit, ...]]:
    """Return the limits that govern, from light to heavy, and the mass [kg] from which on each of them does.

    With 1/mu = 1/m_R + 1/m_H, v_max^2 = F^2/(mu k) = b/m_R + a is a straight line over 1/m_R, of slope
    b = F^2/k and intercept a = b/m_H. The minimum of straight lines is concave, so each line is the lowest on at
    most one interval and the slope grows as 1/m_R shrinks. Starting from the smallest slope (m_R = 0) and going on
    to the line that crosses next therefore visits every line that is ever the lowest. A factor on every
    stiffness scales all lines alike and changes no crossing.
    """
    lines = []
    for limit in limits:
        slope = limit.permissible_force_n**2 / limit.stiffness_n_m
        lines.append((slope, slope / limit.obstacle_mass_kg, limit))
    slope, intercept, limit = min(lines, key=lambda line: line[:2])
    from_mass, governing = [0.0], [limit]
    while flatter := [line for line in lines if line[1] < intercept]:
        mass, intercept, slope, limit = min(
            (((b - slope) / (intercept - a), a, b, limit) for b, a, limit in flatter),
            key=lambda crossing: crossing[:2],
        )
        from_mass.append(mass)
        governing.append(limit)
    return from_mass, tuple(governing)
