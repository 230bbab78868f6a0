# SPDX-License-Identifier: Apache-2.0
"""Contact with a person who moves: the worst energy over every velocity of the person, and the speed that it allows.

Robot and person meet with w = v - u: v = s n is the velocity of the contact point, u that of the person. Twice the
energy of the worst contact normal is w^T K w with K = (alpha I + beta A)^-1 (`reference.mobility`), the peak force its
root times sqrt(k). For |u| <= v_p the largest one is a trust-region problem. With the eigenvalues k_i of K, it is

    min over l >= max k_i of  s^2 sum n_i^2 k_i l / (l - k_i)  +  l v_p^2,

at the l where u = (K - l I)^-1 K v has the length v_p, or at max k_i if it is shorter there. Every other l gives more,
so rounding never makes the bound too small. A person who moves in a known direction has one u = -v_p d; where n^T K d
is negative, robot and person move the same way, and it counts as 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from scara_effmass.iso15066.allowable_speed import ContactCase, SpeedLimit
from scara_effmass.iso15066.drives import Line
from scara_effmass.reference.mobility import CLAMPED_TOLERANCE, Mobility, PoseChange, lasting_time
from scara_effmass.values import FloatArray

MIN_EXCESS = 1e-12
"""Smallest relative excess of l over the largest k_i: it divides by the difference."""

ROUNDING = 1e-9
"""Relative excess of an upper bound of l, so that rounding does not make it too low."""
MIN_PERSON_SPEED = 1e-6
"""Speed [m/s] of the slowest person; a slower one counts as that fast, because l grows with s / v_p."""


Ratio = Callable[[float], float]
"""Ratio of two forces at a speed [m/s] of the contact point."""


@dataclass(frozen=True, slots=True)
class MovingPerson:
    """Person who moves at up to `speed` [m/s], against the unit vector `direction`, or in any direction for None."""

    speed: float
    direction: FloatArray | None


@dataclass(frozen=True, slots=True)
class Growth:
    """Rates that bound d/dt (w^T K w) <= s (cubic s^2 + square s + linear), which count for `time` [s]."""

    time: float = 0.0
    cubic: float = 0.0
    square: float = 0.0
    linear: float = 0.0

    def rate(self, s: float) -> float:
        """Return the bound [kg m2/s3] at the speed `s` [m/s]."""
        return s * (s * (s * self.cubic + self.square) + self.linear)


@dataclass(frozen=True)
class PersonContact:
    """Contact of one case and one line of its drives with a moving person.

    `masses` k_i [kg] are the eigenvalues of K, `direction` n in its axes. `towards` is d there, None for any direction.
    As the robot accelerates, the contact point gains `gain` [m/s] along n; across it and by the error of the
    acceleration, the force gains `root_gain` [m/s sqrt(kg)] over sqrt(k), the length in the norm of K.
    """

    masses: tuple[float, ...]
    direction: tuple[float, ...]
    towards: tuple[float, ...] | None
    person_speed: float
    growth: Growth
    gain: float = 0.0
    root_gain: float = 0.0

    @classmethod
    def of(
        cls,
        case: ContactCase,
        mobility: Mobility,
        line: Line,
        person: MovingPerson,
        max_mass: float = math.inf,
    ) -> PersonContact:
        """Return the contact of a robot with this `mobility`; a larger mass counts as `max_mass` [kg].

        A clamped body part does not move in directions in which the point cannot: their mass is 0.
        """
        alpha, beta = line
        count = len(mobility.values)
        values = np.append(mobility.values, [mobility.across] * (3 - count))
        floor = CLAMPED_TOLERANCE * beta * mobility.trace if count > 1 else 0.0
        inverses = max(alpha, floor) + beta * np.maximum(values, 0.0)
        masses = np.array([min(1.0 / inverse, max_mass) if inverse > 0.0 else max_mass for inverse in inverses])
        if case.obstacle_mobility == 0.0 and mobility.across == 0.0:
            masses[count:] = 0.0
        axes = mobility.basis
        n = axes.T @ mobility.direction
        n[count:] = 0.0  # but for rounding
        towards = None if person.direction is None else axes.T @ person.direction
        found = cls(
            tuple(masses.tolist()),
            tuple(n.tolist()),
            None if towards is None else tuple(towards.tolist()),
            person.speed,
            Growth(),
        )
        if math.isinf(max(found.masses)):
            return found
        time = case.acceleration_time(max(found.masses))
        found = found.accelerating(mobility, line, axes, time, max_mass)
        if mobility.change is None:
            return found
        time = case.contact_time(max(found.masses))
        return replace(found, growth=_growth(mobility.change, beta, axes, masses, n, towards, person.speed, time))

    def accelerating(
        self, mobility: Mobility, line: Line, axes: FloatArray, time: float, max_mass: float
    ) -> PersonContact:
        """Return the contact of a robot that accelerates for `time` [s], K diagonal along `axes`."""
        a, n = mobility.acceleration, mobility.direction
        across, lasting = 0.0, time
        if mobility.change is not None:
            rest = axes.T @ (a.shown - float(n @ a.shown) * n)
            across = math.sqrt(float(np.square(rest) @ self.masses))
            lasting = lasting_time(time, mobility.change.speed, a.along(n))
            error = min(mobility.error_root(*line), math.sqrt(max_mass) * a.error) if a.error else 0.0
        else:
            error = math.sqrt(max(self.masses)) * a.error
        return replace(self, gain=time * max(0.0, a.along(n)), root_gain=lasting * across + time * error)

    @property
    def person_mass(self) -> float:
        """Largest mass [kg] that a velocity of the person meets: the energy of a robot at rest is that times v_p^2."""
        if self.towards is None or math.isinf(max(self.masses)):
            return max(self.masses)
        return sum(k * d * d for k, d in zip(self.masses, self.towards, strict=True))

    @property
    def reduced_mass(self) -> float:
        """The mass n^T K n [kg] for a person at rest."""
        return sum(k * n * n for k, n in zip(self.masses, self.direction, strict=True) if n != 0.0)

    def energy(self, s: float) -> float:
        """Return the largest w^T K w [kg m2/s2], twice the energy, at the speed `s` [m/s] of the contact point."""
        v_p = self.person_speed
        if self.towards is not None:
            terms = zip(self.masses, self.direction, self.towards, strict=True)
            common = sum(k * n * d for k, n, d in terms if n != 0.0)
            return s * s * self.reduced_mass + 2.0 * s * v_p * max(0.0, common) + v_p * v_p * self.person_mass
        speeds = [(k, abs(n) * s) for k, n in zip(self.masses, self.direction, strict=True)]
        heaviest = max(self.masses)

        def excess(multiplier: float) -> float:
            """Return |u| - v_p."""
            return math.hypot(*[k * v / (multiplier - k) for k, v in speeds]) - v_p

        least = max(heaviest * (1.0 + MIN_EXCESS), *(k * (1.0 + v / v_p) for k, v in speeds))
        most = (heaviest + math.hypot(*(k * v for k, v in speeds)) / v_p) * (1.0 + ROUNDING)
        from scipy.optimize import brentq  # noqa: PLC0415 - slow, and the kernel does without it

        multiplier = least
        if excess(least) > 0.0:
            multiplier = float(brentq(excess, least, most, xtol=1e-300, rtol=1e-12))
        return sum(v * v * k * multiplier / (multiplier - k) for k, v in speeds) + multiplier * v_p * v_p

    def root(self, s: float) -> float:
        """Return the peak force over sqrt(k) [m/s sqrt(kg)] at the speed `s` [m/s] of the contact point.

        The force grows with the root of the energy: r + r' T. Without a person: (s (1 + growth s) + gain) sqrt(mu).
        """
        return self._root(s + self.gain) + self.root_gain

    def _root(self, s: float) -> float:
        """Return that of a robot that does not accelerate."""
        root = math.sqrt(self.energy(s))
        return root + 0.5 * self.growth.time * self.growth.rate(s) / root

    def max_speed(self, root: float) -> float:
        """Return the largest speed [m/s] of the contact point whose `root` is the stated one.

        Negative if there is none: then by how much slower the person has to be. `root` never falls as the speed rises.
        """
        return self._max_speed(root - self.root_gain) - self.gain

    def max_link_speed(self, root: float, ratio: Ratio) -> float:
        """Return that of a point whose whole link has `ratio` times its `root`, at its speed."""

        def excess(fast: float) -> float:
            """Return by how much the root of the link exceeds the stated one where the point is as fast as it gets."""
            speed = fast - self.gain
            return ratio(speed) * self.root(speed) - root

        fastest = self.max_speed(root) + self.gain
        if excess(0.0) > 0.0:
            return self.max_speed(root / ratio(-self.gain))
        if not excess(fastest) > 0.0:
            return fastest - self.gain
        from scipy.optimize import brentq  # noqa: PLC0415 - slow, and the kernel does without it

        return float(brentq(excess, 0.0, fastest, xtol=1e-300, rtol=1e-14)) - self.gain

    def _max_speed(self, root: float) -> float:
        """Return that of a robot that does not accelerate."""
        at_rest = self.person_mass
        if not self.person_speed * math.sqrt(at_rest) < root:
            return root / math.sqrt(at_rest) - self.person_speed
        fastest = root / math.sqrt(self.reduced_mass)
        if self._root(fastest) <= root:
            return fastest
        from scipy.optimize import brentq  # noqa: PLC0415 - slow, and the kernel does without it

        return float(brentq(lambda s: self._root(s) - root, 0.0, fastest, xtol=1e-300, rtol=1e-14))


def _growth(
    change: PoseChange,
    beta: float,
    axes: FloatArray,
    masses: FloatArray,
    n: FloatArray,
    towards: FloatArray | None,
    person_speed: float,
    time: float,
) -> Growth:
    """Return the bound of d/dt (w^T K w) = 2 w^T K a - beta w^T K (dA/dt) K w, w = s n - u.

    The accelerations a grow with s^2 and dA/dt with s. Of each product of n and u only what is positive counts, with
    |K a|, |K B K n| and the Frobenius norm of K B K, B = -beta dA/dt, where u may have any direction.
    """
    matrix = masses[:, None] * (-beta * axes.T @ change.mobility_rate @ axes) * masses
    pushes = [masses * (axes.T @ a) for a in change.accelerations]
    faster = max(0.0, *(float(n @ push) for push in pushes))
    lighter = max(0.0, float(n @ matrix @ n))
    if towards is None:
        met = max(float(np.linalg.norm(push)) for push in pushes)
        mixed, own = float(np.linalg.norm(matrix @ n)), float(np.linalg.norm(matrix))
    else:
        met = max(0.0, *(float(towards @ push) for push in pushes))
        mixed, own = max(0.0, float(towards @ matrix @ n)), max(0.0, float(towards @ matrix @ towards))
    v = change.speed
    return Growth(
        time,
        2.0 * faster / v**2 + lighter / v,
        2.0 * person_speed * (met / v**2 + mixed / v),
        person_speed**2 * own / v,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class PersonSpeedLimit(SpeedLimit):
    """Speed of the contact point alone that a limit allows, and the contact from which it follows.

    The force anywhere on a link is at most `ratio` times that at the point; None for a point.
    """

    case: ContactCase
    mobility: Mobility
    line: Line
    person: MovingPerson
    ratio: Ratio | None

    def _root(self, speed: float, max_mass: float) -> float:
        """Return the force over sqrt(k) without the push at the `speed` [m/s] of the contact point."""
        root = PersonContact.of(self.case, self.mobility, self.line, self.person, max_mass).root(speed)
        return root if self.ratio is None else root * self.ratio(speed)


def link_ratio(case: ContactCase, mobility: Mobility, line: Line, contact: PersonContact) -> Ratio | None:
    """Return the largest force anywhere on a link over that at its point, for a person in any direction.

    It takes the speed [m/s] of the point. Of a clamped body part the robot's share of the energy decides, at any speed.
    """
    energy = None if math.isinf(max(contact.masses)) else mobility.energy_anywhere(*line)
    if energy is None:
        return None
    if case.obstacle_mobility == 0.0:
        ratio = math.sqrt(max(1.0, energy(1.0, 0.0) / mobility.point_reduced_mass(*line)))
        return lambda _: ratio

    def ratio_at(speed: float) -> float:
        """Return the ratio where the point is as fast as it gets."""
        speed += contact.gain
        return math.sqrt(max(1.0, energy(speed, contact.person_speed) / contact.energy(speed)))

    return ratio_at


def person_speed_limit(
    case: ContactCase, mobility: Mobility, line: Line, person: MovingPerson, force: float
) -> PersonSpeedLimit:
    """Return the speed of the contact point at which the peak reaches `force` [N], for one line of the drives."""
    contact = PersonContact.of(case, mobility, line, person)
    ratio = link_ratio(case, mobility, line, contact)
    root = force / math.sqrt(case.stiffness)
    speed = contact.max_speed(root) if ratio is None else contact.max_link_speed(root, ratio)
    return PersonSpeedLimit(
        speed,
        case.limit,
        contact.reduced_mass,
        case.stiffness,
        case=case,
        mobility=mobility,
        line=line,
        person=person,
        ratio=ratio,
    )
