# SPDX-License-Identifier: Apache-2.0
"""Allowable speed: the highest relative speed at which a contact stays within every limit."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from scara_effmass.errors import LimitError
from scara_effmass.iso15066.drives import MAX_MOBILITY, Line, contact_lines
from scara_effmass.iso15066.limits import Criterion, Limit
from scara_effmass.iso15066.mobility import Mobility
from scara_effmass.iso15066.pose_change import contact_time
from scara_effmass.settings import Drives, MonitorSettings

MIN_EFFECTIVE_MASS = 1e-6
"""Smallest effective mass [kg] for which a speed is computed: a lower one means that the robot model is wrong."""
_TYPICAL = Mobility.of_mass(2.0)


class SpeedLimit(NamedTuple):
    """Allowable relative speed [m/s], the limit that governs, and the contact force over the relative speed.

    `reduced_mass` [kg] is that of the bound, drives included. `push` [N] is the force of the drives, 0 unless their
    effort limits give the tighter bound. `stiffness` [N/m] includes its uncertainty. `growth` [s/m] covers the change
    of pose during the contact: the speed v counts as v (1 + growth v).
    """

    allowable_speed: float
    limit: Limit
    criterion: Criterion
    reduced_mass: float
    stiffness: float
    push: float = 0.0
    growth: float = 0.0

    def force(self, speed: float, max_mass: float = math.inf) -> float:
        """Return the bound P + sqrt(P^2 + k mu u^2), u = v (1 + growth v), of the peak force [N] at `speed` v [m/s].

        P is `push`, a constant force of the drives against the contact; without one this is u sqrt(mu k).
        mu is at most `max_mass` [kg].
        """
        speed *= 1.0 + self.growth * speed
        energy = self.stiffness * min(self.reduced_mass, max_mass) * speed * speed
        return self.push + math.sqrt(self.push * self.push + energy)


_Bound = tuple[float, float, float, float]
"""v_max [m/s], reduced mass [kg], growth [s/m] and push [N]."""


@dataclass
class Case:  # no tuple, because mypyc reads the attributes of a class faster
    """One limit; `rate` is k / F^2, `lines` bound its reduced mass.

    `obstacle_mass` [kg] bounds it for any robot. `drive_time` is the time [s] for which the pose changes while drives
    push on; 0: that of free joints.
    """

    limit: Limit
    criterion: Criterion
    force: float
    stiffness: float
    rate: float
    obstacle_mass: float
    obstacle_mobility: float
    lines: tuple[Line, ...]
    drive_time: float

    def bound(self, mobility: Mobility, mass_factor: float, lines: tuple[Line, ...], rate: float) -> _Bound:
        """Return the bound of one `mobility`, whose masses count `mass_factor` times; `rate` is k / F^2."""
        mu, (alpha, beta) = math.inf, lines[0]
        for line in lines:
            line_mu = mass_factor * mobility.worst_reduced_mass(mass_factor * line[0], line[1])
            if line_mu < mu:
                mu, (alpha, beta) = line_mu, line
        change, growth = mobility.change, 0.0
        if change is not None and mu < math.inf:
            time = self.drive_time or contact_time(mu, self.stiffness)
            growth = 0.5 * time * change.growth(mass_factor * alpha, beta) / change.speed
        return _speed(mu * rate, growth), mu, growth, 0.0


class SpeedLimits:
    """Allowable speed under several `limits`."""

    __slots__ = ("cases", "is_free", "limits", "max_drive_time", "min_alpha", "min_stiffness", "weakest")

    def __init__(self, limits: Iterable[Limit], settings: MonitorSettings | None = None) -> None:
        """Use drives and stiffness uncertainty of `settings`: by default free joints and none.

        Raises LimitError without any limit.
        """
        settings = settings or MonitorSettings(stiffness_uncertainty=0.0, drives=Drives.FREE)
        self.limits = tuple(limits)
        if not self.limits:
            raise LimitError("body_regions: must hold at least one region with a limit")
        stiffness = tuple(limit.stiffness_n_m * (1.0 + settings.stiffness_uncertainty) for limit in self.limits)
        masses = tuple(limit.obstacle_mass_kg for limit in self.limits)
        lines = contact_lines(settings.drives, settings.servo, stiffness, masses)
        cases = [
            Case(
                limit,
                limit.criterion,
                limit.permissible_force_n,
                k,
                k / limit.permissible_force_n**2,
                limit.obstacle_mass_kg,
                1.0 / limit.obstacle_mass_kg,
                bounds,
                0.0 if settings.drives is Drives.FREE else contact_time(limit.obstacle_mass_kg, k),
            )
            for limit, k, bounds in zip(self.limits, stiffness, lines, strict=True)
        ]
        # The case that most often sets the speed comes first: the others can then mostly be skipped by a bound.
        self.cases = sorted(cases, key=lambda case: -case.rate * _TYPICAL.worst_reduced_mass(*case.lines[0]))
        self.min_alpha = min([alpha / beta for case in cases for alpha, beta in case.lines if beta], default=0.0)
        self.is_free = settings.drives is Drives.FREE
        self.min_stiffness = min(stiffness)
        self.weakest = min(self.limits, key=lambda limit: limit.permissible_force_n)
        """The limit with the smallest permissible force."""
        self.max_drive_time = max([case.drive_time for case in cases])

    def speed_limit(self, effective_mass: float) -> SpeedLimit:
        """Return the smallest v_max = min(F, p A) / sqrt(mu k) of all limits for one `effective_mass` [kg].

        It may be infinite. Raises LimitError for one that is NaN or too small.
        """
        if not effective_mass >= MIN_EFFECTIVE_MASS:
            raise LimitError(f"effective_mass = {effective_mass!r} kg: must be at least {MIN_EFFECTIVE_MASS:g} kg")
        return self.worst_normal([Mobility.of_mass(effective_mass)])

    def worst_normal(
        self,
        mobilities: Sequence[Mobility],
        mass_factor: float = 1.0,
        push: tuple[float, float] | None = None,
        max_force: float = math.inf,
    ) -> SpeedLimit:
        """Return the smallest speed of all limits, of all `mobilities`, and of all contact normals.

        `mass_factor` >= 1 multiplies the masses. `push` is the acceleration [m/s2] that the effort limits of the joints
        allow at the contact point, in any direction, and the smallest eigenvalue of its mobility [1/kg]: a second
        bound for drives that push on. The first one holds up to `max_force` [N]. The relative speed is that of robot
        and person towards each other.
        """
        # Plain loops: this is the hot path of the monitor.
        alpha = mass_factor * self.min_alpha
        bounded = []
        for mobility in mobilities:
            change, max_growth = mobility.change, 0.0
            max_mu = mass_factor * mobility.worst_reduced_mass(alpha) if self.is_free else math.inf
            if change is not None:
                time = self.max_drive_time or contact_time(max_mu, self.min_stiffness)
                max_growth = 0.5 * time * change.max_growth(alpha) / change.speed
            bounded.append((mobility, max_mu, max_growth))
        slowest, min_speed = None, math.inf
        for case in self.cases:
            bound: _Bound = math.inf, 0.0, 0.0, 0.0
            rate = case.rate
            if max_force < case.force:
                excess = case.force / max_force if max_force > 0.0 else math.inf
                rate *= excess * excess
            for mobility, max_mu, max_growth in bounded:
                # Most cases can be seen not to set the speed.
                speed = min_speed * (1.0 + max_growth * min_speed)
                if not min(max_mu, case.obstacle_mass) * rate * speed * speed <= 1.0:
                    simulated = len(case.lines) == 1 or mobility.trace <= MAX_MOBILITY * mass_factor
                    lines = case.lines if simulated else ((case.obstacle_mobility, 0.0),)
                    bound = min(bound, case.bound(mobility, mass_factor, lines, rate))
            if push is not None:
                bound = max(bound, _push_bound(case, mobilities, mass_factor, push))
            if bound[0] < min_speed:
                min_speed, slowest = bound[0], (case, bound)
        case, (_, mu, growth, case_push) = slowest or (self.cases[0], (0.0, 0.0, 0.0, 0.0))
        return SpeedLimit(min_speed, case.limit, case.criterion, mu, case.stiffness, case_push, growth)


def _speed(inverse_square: float, growth: float) -> float:
    """Return v [m/s] with v (1 + growth v) = 1 / sqrt(inverse_square)."""
    if inverse_square <= 0.0:
        return math.inf
    speed = 1.0 / math.sqrt(inverse_square)
    speed = 2.0 * speed / (1.0 + math.sqrt(1.0 + 4.0 * growth * speed))
    return max(0.0, speed)  # NaN, as of an infinite growth at no speed, must not count as no limit


def _push_bound(case: Case, mobilities: Sequence[Mobility], mass_factor: float, push: tuple[float, float]) -> _Bound:
    """Return the bound of free joints and the push of the drives.

    F = P + sqrt(P^2 + k mu u^2) with the push P = mu a of the acceleration a: v_max is 0 if P alone is too much.
    """
    acceleration, min_mobility = push
    mobility = min_mobility / mass_factor + case.obstacle_mobility
    force = acceleration / mobility if mobility > 0.0 else math.inf
    rest = case.force * (case.force - 2.0 * force)
    if rest <= 0.0:
        return 0.0, 0.0, 0.0, force
    free, rate = ((case.obstacle_mobility, 1.0),), case.stiffness / rest
    speed, mu, growth, _ = min([case.bound(mobility, mass_factor, free, rate) for mobility in mobilities])
    return speed, mu, growth, force
