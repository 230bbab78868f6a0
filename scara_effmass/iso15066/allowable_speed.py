# SPDX-License-Identifier: Apache-2.0
"""Allowable speed: the highest relative speed at which a contact stays within every limit."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

from scara_effmass.errors import LimitError
from scara_effmass.iso15066.contact import amplification, contact_time
from scara_effmass.iso15066.drives import MAX_MOBILITY, Line, contact_lines
from scara_effmass.iso15066.limits import Criterion, Limit
from scara_effmass.settings import Drives, MonitorSettings

MIN_EFFECTIVE_MASS = 1e-6
"""Smallest effective mass [kg] for which a speed is computed: a lower one means that the robot model is wrong."""
CLAMPED_SHARE = 0.7
"""Share of the stopping time for which an acceleration counts: the force of a reference that gains a t is less than the
largest force at the speed a t of its end. Above the largest one, 0.67, of simulated servos of 1 to 20 Hz."""
TYPICAL_MASS = 2.0
"""Effective mass [kg] of the order of the contact cases."""


@dataclass(frozen=True, slots=True)
class SpeedLimit:
    """Allowable relative speed [m/s], the limit that governs, and the contact force over the relative speed.

    `reduced_mass` [kg] is that of the bound, drives included. `push` [N] is the force of the drives, 0 unless their
    effort limits give the tighter bound. `stiffness` [N/m] includes its uncertainty. `growth` [s/m] covers the change
    of pose during the contact and `gain` [m/s] the acceleration: the speed v counts as v (1 + growth v) + gain.
    `others` are limits that hold as well, whose force may be larger at lower speeds.
    """

    allowable_speed: float
    limit: Limit
    reduced_mass: float
    stiffness: float
    push: float = 0.0
    growth: float = 0.0
    gain: float = 0.0
    others: tuple[SpeedLimit, ...] = field(default=(), compare=False)

    @property
    def criterion(self) -> Criterion:
        """The limit that sets the speed."""
        return self.limit.criterion

    def force(self, speed: float, max_mass: float = math.inf) -> float:
        """Return the bound P + sqrt(P^2 + k mu u^2) of the peak force [N] at `speed` v [m/s], which counts as u.

        P is `push`, a constant force of the drives against the contact; without one this is u sqrt(mu k).
        mu is at most `max_mass` [kg]; a larger one is that of a singular pose, and has no known growth. With `others`
        it is the largest of all.
        """
        root = self._root(speed, max_mass)
        own = self.push + math.sqrt(self.push * self.push + self.stiffness * root * root)
        return max(own, *(other.force(speed, max_mass) for other in self.others)) if self.others else own

    def _root(self, speed: float, max_mass: float) -> float:
        """Return the force over sqrt(k) without the push [m/s sqrt(kg)]."""
        if self.reduced_mass < max_mass:
            speed = speed * (1.0 + self.growth * speed) + self.gain
        return speed * math.sqrt(min(self.reduced_mass, max_mass))


@dataclass(frozen=True, slots=True)
class ContactCase:
    """Contact with one limit: `stiffness` [N/m] includes its uncertainty, `lines` bound 1/mu from below.

    `drive_time` is the time [s] for which the pose changes while drives push on; None: that of free joints. The total
    force is `amplification` times that of an elastic contact without friction.
    """

    limit: Limit
    stiffness: float
    lines: tuple[Line, ...]
    drive_time: float | None
    amplification: float

    @property
    def force(self) -> float:
        """Permissible force [N] of an elastic contact without friction."""
        return self.limit.permissible_force_n / self.amplification

    @property
    def obstacle_mobility(self) -> float:
        """1/m_H [1/kg], 0 for a clamped body part."""
        return 1.0 / self.limit.body_mass_kg

    def lines_for(self, mobility: float) -> tuple[Line, ...]:
        """Return the lines for a robot of this mobility [1/kg]; one too light to be simulated counts as immovable."""
        simulated = len(self.lines) == 1 or mobility <= MAX_MOBILITY
        return self.lines if simulated else ((self.obstacle_mobility, 0.0),)

    def contact_time(self, reduced_mass: float) -> float:
        """Return the time [s] for which the pose changes."""
        return self.drive_time or contact_time(reduced_mass, self.stiffness)

    def acceleration_time(self, reduced_mass: float) -> float:
        """Return the time [s] for which the acceleration counts."""
        is_clamped = self.drive_time and not self.obstacle_mobility
        return self.contact_time(reduced_mass) * (CLAMPED_SHARE if is_clamped else 1.0)

    def speed_limit(
        self, reduced_mass: float, growth: float = 0.0, max_force: float = math.inf, gain: float = 0.0
    ) -> SpeedLimit:
        """Return the speed v at which F = u sqrt(mu k) reaches the limit, at most `max_force`; v counts as u."""
        force = max(0.0, min(self.force, max_force))
        speed = max_speed(force / math.sqrt(reduced_mass * self.stiffness) - gain, growth)
        return SpeedLimit(speed, self.limit, reduced_mass, self.stiffness, growth=growth, gain=gain)

    def speed_limit_of_mass(self, effective_mass: float) -> SpeedLimit:
        """Return the speed limit of one `effective_mass` [kg] in a pose that does not change."""
        mobility = 1.0 / effective_mass
        inverse = max(alpha + beta * mobility for alpha, beta in self.lines_for(mobility))
        return self.speed_limit(1.0 / inverse if inverse > 0.0 else math.inf)


def weakest_case(cases: Iterable[ContactCase]) -> ContactCase:
    """Return the case that permits the smallest force."""
    return min(cases, key=lambda case: case.force)


def max_speed(speed: float, growth: float) -> float:
    """Return v [m/s] with v (1 + growth v) = `speed`, with the `growth` [s/m].

    A negative speed allows no motion. There, too, a larger growth gives a lower speed, so that rounding decides no tie.
    """
    if speed == 0.0 or math.isinf(speed):
        return speed
    if speed < 0.0:
        return speed * (1.0 - growth * speed)
    return 2.0 * speed / (1.0 + math.sqrt(1.0 + 4.0 * growth * speed))


def contact_cases(limits: Iterable[Limit], settings: MonitorSettings | None = None) -> tuple[ContactCase, ...]:
    """Return the contact of each limit with the drives and stiffness uncertainty of `settings`, strictest first.

    By default joints are free, and there is no uncertainty. Raises LimitError without any limit.
    """
    settings = settings or MonitorSettings(stiffness_uncertainty=0.0, drives=Drives.FREE)
    limits = tuple(limits)
    if not limits:
        raise LimitError("body_regions: must hold at least one region with a limit")
    stiffness = tuple(limit.stiffness_n_m * (1.0 + settings.stiffness_uncertainty) for limit in limits)
    masses = tuple(limit.body_mass_kg for limit in limits)

    amplified = amplification(
        settings.contact_damping,
        settings.contact_friction,
        is_clamped=math.isinf(masses[0]),  # all limits are of one type of contact
    )

    def drive_time(limit: Limit) -> float | None:
        """Return that of the nominal stiffness: a softer contact lasts longer."""
        if settings.drives is Drives.FREE:
            return None
        is_clamped = math.isinf(limit.body_mass_kg)
        return settings.servo.stopping_time if is_clamped else contact_time(limit.body_mass_kg, limit.stiffness_n_m)

    cases = [
        ContactCase(limit, k, lines, drive_time(limit), amplified)
        for limit, k, lines in zip(
            limits, stiffness, contact_lines(settings.drives, settings.servo, stiffness, masses), strict=True
        )
    ]
    return tuple(sorted(cases, key=lambda case: case.speed_limit_of_mass(TYPICAL_MASS).allowable_speed))


def speed_limit_of_mass(
    limits: Iterable[Limit], effective_mass: float, settings: MonitorSettings | None = None
) -> SpeedLimit:
    """Return the smallest v_max = min(F, p A) / sqrt(mu k) of all `limits` for one `effective_mass` [kg].

    It may be infinite. Raises LimitError for one that is NaN or too small.
    """
    if not effective_mass >= MIN_EFFECTIVE_MASS:
        raise LimitError(f"effective_mass = {effective_mass!r} kg: must be at least {MIN_EFFECTIVE_MASS:g} kg")
    cases = contact_cases(limits, settings)
    return min((case.speed_limit_of_mass(effective_mass) for case in cases), key=lambda found: found.allowable_speed)
