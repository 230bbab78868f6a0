"""Allowable speed: the highest relative speed at which a contact stays within every limit."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, NamedTuple

from scara_effmass.errors import LimitError
from scara_effmass.iso15066.drives import MAX_MOBILITY, Line, contact_lines
from scara_effmass.iso15066.mobility import Mobility
from scara_effmass.settings import Drives, MonitorSettings

if TYPE_CHECKING:
    from scara_effmass.iso15066.limits import Criterion, Limit

MIN_EFFECTIVE_MASS = 1e-6
"""Smallest effective mass [kg] for which a speed is computed: a lower one means that the robot model is wrong."""


class SpeedLimit(NamedTuple):
    """Allowable relative speed [m/s], the limit that governs, and the contact force over the relative speed.

    `reduced_mass` [kg] is that of the bound, drives included; `push` [N] is that of the drives, where their effort
    limits give the tighter bound. `stiffness` [N/m] includes its uncertainty.
    """

    allowable_speed: float
    limit: Limit
    criterion: Criterion
    reduced_mass: float
    stiffness: float
    push: float = 0.0

    def force(self, speed: float, max_mass: float = math.inf) -> float:
        """Return the bound P + sqrt(P^2 + k mu v^2) of the peak force [N] at the relative `speed` v [m/s].

        P is `push`, a constant force of the drives against the contact; without one this is v sqrt(mu k).
        mu is at most `max_mass` [kg].
        """
        energy = self.stiffness * min(self.reduced_mass, max_mass) * speed * speed
        return self.push + math.sqrt(self.push * self.push + energy)


class _Case(NamedTuple):
    """One limit; `rate` is k / F^2, `lines` bound its reduced mass."""

    limit: Limit
    criterion: Criterion
    force: float
    stiffness: float
    rate: float
    obstacle_mobility: float
    lines: tuple[Line, ...]


class SpeedLimits:
    """Allowable speed under several limits. `limits` are all of them, `governing` those that can set the speed."""

    __slots__ = ("_cases", "governing", "limits")

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
            _Case(
                limit,
                limit.criterion,
                limit.permissible_force_n,
                k,
                k / limit.permissible_force_n**2,
                1.0 / limit.obstacle_mass_kg,
                bounds,
            )
            for limit, k, bounds in zip(self.limits, stiffness, lines, strict=True)
        ]
        self._cases = _governing(cases)
        self.governing = tuple(case.limit for case in self._cases)

    def speed_limit(self, effective_mass: float) -> SpeedLimit:
        """Return the smallest v_max = min(F, p A) / sqrt(mu k) of all limits for one `effective_mass` [kg].

        It may be infinite. Raises LimitError for one that is NaN or too small.
        """
        if not effective_mass >= MIN_EFFECTIVE_MASS:
            raise LimitError(f"effective_mass = {effective_mass!r} kg: must be at least {MIN_EFFECTIVE_MASS:g} kg")
        return self.worst_normal([Mobility.of_mass(effective_mass)])

    def worst_normal(
        self, mobilities: Sequence[Mobility], mass_factor: float = 1.0, push: tuple[float, float] | None = None
    ) -> SpeedLimit:
        """Return the smallest speed of all limits, of all `mobilities`, and of all contact normals.

        `mass_factor` >= 1 multiplies the masses. `push` is the acceleration [m/s2] that the effort limits of the joints
        allow at the contact point, in any direction, and the smallest eigenvalue of its mobility [1/kg]: a second
        bound for drives that push on. The relative speed is that of robot and person towards each other.
        """
        # Plain loops: this is the hot path of the monitor.
        slowest, slowest_mu, slowest_push, max_square = self._cases[0], 0.0, 0.0, -1.0
        for case in self._cases:
            mu = 0.0
            for mobility in mobilities:
                simulated = len(case.lines) == 1 or mobility.trace <= MAX_MOBILITY * mass_factor
                model_mu = math.inf
                for alpha, beta in case.lines if simulated else ((case.obstacle_mobility, 0.0),):
                    line_mu = mass_factor * mobility.worst_reduced_mass(mass_factor * alpha, beta)
                    model_mu = min(model_mu, line_mu)
                mu = max(mu, model_mu)
            square, case_push = mu * case.rate, 0.0  # 1 / v_max^2
            if push is not None and push[0] < math.inf:
                bound = _push_bound(case, mobilities, mass_factor, push)
                if bound[0] < square:
                    square, mu, case_push = bound
            if square > max_square:
                slowest, slowest_mu, slowest_push, max_square = case, mu, case_push, square
        limit, criterion = slowest.limit, slowest.criterion
        return SpeedLimit(max_square**-0.5, limit, criterion, slowest_mu, slowest.stiffness, slowest_push)


def _push_bound(
    case: _Case, mobilities: Sequence[Mobility], mass_factor: float, push: tuple[float, float]
) -> tuple[float, float, float]:
    """Return 1 / v_max^2 [s2/m2], the reduced mass of free joints [kg] and the push of the drives [N].

    F = P + sqrt(P^2 + k mu v^2) with the push P = mu a of the acceleration a: infinite if P alone is too much.
    """
    acceleration, min_mobility = push
    force = acceleration / (min_mobility / mass_factor + case.obstacle_mobility)
    mu = max(mass_factor * m.worst_reduced_mass(mass_factor * case.obstacle_mobility) for m in mobilities)
    rest = case.force * (case.force - 2.0 * force)
    return (mu * case.stiffness / rest if rest > 0.0 else math.inf), mu, force


def _governing(cases: list[_Case]) -> list[_Case]:
    """Return the cases that can set the speed, where each has one line.

    With c = k / F^2 the case has 1/v_max^2 = c / (alpha + beta a) over the mobility a; another is never above it if
    that holds at both ends, a = 0 and infinity.
    """
    if any(len(case.lines) > 1 for case in cases):
        return cases
    kept: list[_Case] = []
    for case in sorted(cases, key=lambda case: -case.rate):
        alpha, beta = case.lines[0]
        ends = ((other.rate, *other.lines[0]) for other in kept)
        if not any(case.rate * a <= c * alpha and case.rate * b <= c * beta for c, a, b in ends):
            kept.append(case)
    return kept
