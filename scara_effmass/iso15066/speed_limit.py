"""Allowable speed: the highest relative speed at which a contact stays within every limit."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable
from typing import TYPE_CHECKING, NamedTuple

from scara_effmass.errors import LimitError
from scara_effmass.iso15066.contact import reduced_mass

if TYPE_CHECKING:
    from scara_effmass.iso15066.limits import Criterion, Limit

MIN_EFFECTIVE_MASS = 1e-6
"""Smallest effective mass [kg] for which a speed is computed: a lower one means that the robot model is wrong."""


class SpeedLimit(NamedTuple):
    """Allowable relative speed [m/s] at one effective mass, the limit that governs, and the reduced mass [kg]."""

    allowable_speed: float
    limit: Limit
    criterion: Criterion
    reduced_mass: float


class SpeedLimits:
    """Allowable speed under several limits, of which only those that govern at some mass are evaluated.

    `limits` are all limits, `governing` those that set the speed at some mass, from light to heavy.
    """

    __slots__ = ("_from_mass", "_steps", "governing", "limits")

    def __init__(self, limits: Iterable[Limit]) -> None:
        """Find the limits that govern. Raises LimitError without any limit."""
        self.limits = tuple(limits)
        if not self.limits:
            raise LimitError("body_regions: must hold at least one region with a limit")
        self._from_mass, self.governing = _lower_envelope(self.limits)
        self._steps = [(limit, limit.permissible_force_n, limit.criterion) for limit in self.governing]

    def speed_limit(self, effective_mass: float, stiffness_factor: float = 1.0) -> SpeedLimit:
        """Return the smallest v_max = min(F, p A) / sqrt(mu k) of all limits.

        `effective_mass` [kg] may be infinite; `stiffness_factor` >= 1 multiplies every stiffness. The speed is that
        of robot and person towards each other. Raises LimitError for a mass or factor that is NaN or too small.
        """
        if not (effective_mass >= MIN_EFFECTIVE_MASS and stiffness_factor >= 1.0):
            raise LimitError(
                f"effective_mass = {effective_mass!r} kg, stiffness_factor = {stiffness_factor!r}: "
                f"must be at least {MIN_EFFECTIVE_MASS:g} kg and 1"
            )
        limit, force, criterion = self._steps[bisect_right(self._from_mass, effective_mass) - 1]
        mu = reduced_mass(effective_mass, limit.obstacle_mass_kg)
        return SpeedLimit(force / math.sqrt(mu * stiffness_factor * limit.stiffness_n_m), limit, criterion, mu)


def _lower_envelope(limits: tuple[Limit, ...]) -> tuple[list[float], tuple[Limit, ...]]:
    """Return the mass [kg] from which on each governing limit governs, and these limits, from light to heavy.

    With 1/mu = 1/m_R + 1/m_H, v_max^2 = F^2/(mu k) is a straight line over 1/m_R with slope b = F^2/k and
    intercept a = b/m_H. The minimum of straight lines is concave: each line is the lowest on at most one interval,
    and the slope grows as 1/m_R shrinks. So start at m_R = 0 with the smallest slope and go on to the line that
    crosses next. A factor on every stiffness scales all lines alike and moves no crossing.
    """
    lines = []
    for limit in limits:
        slope = limit.permissible_force_n**2 / limit.stiffness_n_m
        lines.append((slope, slope / limit.obstacle_mass_kg, limit))
    slope, intercept, limit = min(lines, key=lambda line: line[:2])
    from_mass, governing = [0.0], [limit]
    while lower_lines := [line for line in lines if line[1] < intercept]:
        mass, intercept, slope, limit = min(
            (((b - slope) / (intercept - a), a, b, limit) for b, a, limit in lower_lines),
            key=lambda crossing: crossing[:2],
        )
        from_mass.append(mass)
        governing.append(limit)
    return from_mass, tuple(governing)
