# SPDX-License-Identifier: Apache-2.0
"""Contact anywhere on a link: a bound of the contact energy over a convex hull, from its vertices alone.

Twice the energy of the worst contact at a point p of a link is v^T (s 1 + A)^-1 v with v = J_v(p) qd and
A = J_v M^-1 J_v^T; s = 1/m_H. By Woodbury's identity that is the minimum over x of

    (qd - x)^T M (qd - x) + m_H |J_v(p) x|^2.

J_v(p) is affine in p, so for a fixed x this is convex in p, and its maximum over the hull lies at a vertex: any x gives
a bound of every point of the hull. With weights w on the vertices, x = (M + m_H sum w_i J_i^T J_i)^-1 M qd is the
motion after contacts of these masses w_i m_H at all vertices at once. Only the twist d = J qd of the link and its
mobility B = J M^-1 J^T (6, 6) enter: with the rows sqrt(w_i) [1, -skew(r_i)] in T_w, the forces on the vertices are
u = (s 1 + T_w B T_w^T)^-1 T_w d, h = T_w^T u, the motion of the link after them is x = d - B h, and the bound is
h^T B h + m_H max_i |v_i(x)|^2. The weights follow by Frank-Wolfe steps; it bounds the energy whatever they are.

A person of velocity u has x depend on u: x + X u for any matrix X. The root of the energy is a norm of the robot's and
the person's motion, so it is at most the sum of two norms: at vertex i, that of x as above, plus |u| times the root of
the largest eigenvalue of X^T M X + m_H (1 - J_i X)^T (1 - J_i X), the mass that a person meets there. X is the motion
after a contact with a rigid body, of the person's mass spread evenly over the vertices, that has the velocity u. With
X = 0, the person only adds |u| to the speeds |v_i(x)|; the smaller one of both bounds counts.

The same x and X hold at every speed of the same motion: at c qd they are c x + X u, so energy and root follow from
those at qd, scaled. Every such bound grows with c and with |u|, and so does the least of them: a speed that keeps a
limit leaves every lower one within it. The steps look at the robot alone, so that the weights depend on neither.

At rest the direction of the motion is unknown: all that a point has is a speed, at most that of the fastest vertex. A
person meets the mass 1 / (s + a) along the direction of the least mobility a of a point, so a is at least that of the
largest mass that a person meets at a vertex, less s.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from scara_effmass.iso15066.allowable_speed import ContactCase
from scara_effmass.values import FloatArray

STEPS = 2
"""Largest number of Frank-Wolfe steps: with two, the bound of the force is mostly within 2 % of the worst point."""
MAX_GAP = 0.01
"""The steps end where further ones lessen the bound of the energy by less than this part of it, by its dual value."""
FIRST_TRIAL = 0.3
"""First trial for the length of a step; the second one follows from the slopes."""
MIN_MOBILITY = 0.01
"""Smallest mobility [1/kg] of a body part for which the place of a contact is chosen: that of 100 kg."""
TIE = 1e-9
"""Relative difference up to which the first vertex counts as the farthest, so that rounding does not choose."""


@dataclass(frozen=True, eq=False)
class Hull:
    """Convex hull of a link at one joint state: `vertices` (V, 3) [m] from the place of its joint.

    `twist` (6,) is linear, then angular, `mobility` B (6, 6) that of the link in one mass model, both about that place;
    None for a mass that is the same everywhere. `vertex` is that at which the contact counts, which must move.
    `energy_of_arm` [J] is the least x^T M x of joint velocities x that move the link in this way. The steps begin at
    the vertex `first`.
    """

    vertices: FloatArray
    twist: FloatArray
    vertex: int
    mobility: FloatArray | None = None
    energy_of_arm: float = math.inf
    first: int = 0

    @cached_property
    def maps(self) -> FloatArray:
        """T_i (V, 3, 6) of the vertices."""
        return point_maps(self.vertices)

    @cached_property
    def squares(self) -> FloatArray:
        """Squares (V,) of the speeds of the vertices [m2/s2]."""
        return np.asarray(np.sum((self.maps @ self.twist) ** 2, axis=1))

    @property
    def square(self) -> float:
        """Square of the speed of `vertex` [m2/s2]."""
        return float(self.squares[self.vertex])

    @property
    def speed_ratio(self) -> float:
        """Square of the largest speed of a vertex over that of `vertex`."""
        return max(1.0, float(self.squares.max()) / self.square)

    def with_masses(self, factor: float) -> Hull:
        """Return the hull of a robot whose masses are `factor` times as large."""
        if self.mobility is None:
            return self
        return replace(self, mobility=self.mobility / factor, energy_of_arm=factor * self.energy_of_arm)

    def energy_anywhere(self, alpha: float, beta: float, mass: float, least: float) -> Callable[[float, float], float]:
        """Return a bound of w^T (alpha 1 + beta A)^-1 w of every point, for a person in any direction.

        It takes the speed of `vertex` and that of the person [m/s]. The `mass` [kg] is that of a robot whose mass is
        the same everywhere. alpha / beta counts as at least `least` [1/kg].
        """
        if self.mobility is not None and beta > 0.0:
            energy, present = self.energy(max(alpha / beta, least)), math.sqrt(self.square)
            return lambda speed, person_speed: energy.at(speed / present, person_speed) / beta
        faster = math.sqrt(self.speed_ratio)
        return lambda speed, person_speed: mass * (faster * speed + person_speed) ** 2

    def energy(self, s: float) -> HullEnergy:
        """Return the bound of v^T (s 1 + A)^-1 v [kg m2/s2] of every point, `s` above 0 [1/kg]."""
        mobility, twist, maps = np.asarray(self.mobility), self.twist, self.maps
        found = HullEnergy(self, s, [], [])

        def evaluate(support: list[int], weights: FloatArray) -> tuple[FloatArray, float]:
            """Return the squares of the speeds |T_i x|, and the excess of the largest over their mean."""
            t_w = (np.sqrt(weights)[:, None, None] * maps[support]).reshape(-1, 6)
            h = t_w.T @ np.linalg.solve(s * np.eye(len(t_w)) + t_w @ mobility @ t_w.T, t_w @ twist)
            given = mobility @ h
            squares = np.sum((maps @ (twist - given)) ** 2, axis=1)
            found.of_arm.append(float(h @ given))
            found.squares.append(squares)
            return squares, float(squares.max() - weights @ squares[support])

        support, weights = [self.first], np.ones(1)
        squares, excess = evaluate(support, weights)
        for _ in range(STEPS):
            if not excess > MAX_GAP * s * found.at(1.0):
                break
            i, start, slope, t = farthest(squares), weights, excess, FIRST_TRIAL
            support = [*support, i]
            for _ in range(2):
                weights = np.append((1.0 - t) * start, t)
                squares, excess = evaluate(support, weights)
                if not excess > MAX_GAP * s * found.at(1.0):
                    break
                t = second_trial(slope, float(squares[i] - start @ squares[support[:-1]]))
        return found

    def met_masses(self, s: float) -> FloatArray:
        """Return a bound (V,) [kg] of the mass that a velocity of a person meets at each vertex, in any direction."""
        maps, mobility = self.maps, np.asarray(self.mobility)
        spread = np.mean(maps.transpose(0, 2, 1) @ maps, axis=0)
        h = np.linalg.solve(s * np.eye(6) + spread @ mobility, spread[:, :3])
        rests = np.eye(3) - maps @ (mobility @ h)
        masses: FloatArray = np.linalg.eigvalsh(h.T @ mobility @ h + rests.transpose(0, 2, 1) @ rests / s)[:, -1]
        return masses

    def worst_mass(self, s: float) -> float:
        """Return a bound [kg] of the largest effective mass of every point and direction, tightest for 1/m_H = s."""
        mobility = 1.0 / float(self.met_masses(s).max()) - s
        return 1.0 / mobility if mobility > 0.0 else math.inf


@dataclass(frozen=True, eq=False)
class HullEnergy:
    """Bound of v^T (s 1 + A)^-1 v [kg m2/s2] over a `hull`, at every speed of its motion.

    Of each motion x that proves one: h^T B h `of_arm` [kg m2/s2], and the `squares` (V,) of |v_i(x)| [m2/s2].
    """

    hull: Hull
    s: float
    of_arm: list[float]
    squares: list[FloatArray]

    @cached_property
    def met_roots(self) -> FloatArray:
        """Roots (V,) of `Hull.met_masses`."""
        return np.sqrt(self.hull.met_masses(self.s))

    def at(self, scale: float, person_speed: float = 0.0) -> float:
        """Return the bound at `scale` times the motion of the hull, for a person in any direction."""
        fastest = math.sqrt(self.hull.squares.max())
        least = scaled_energy(self.hull.energy_of_arm, self.s, scale, fastest, person_speed)
        for of_arm, squares in zip(self.of_arm, self.squares, strict=True):
            speed = scale * math.sqrt(squares.max()) + person_speed
            least = min(least, scale * scale * of_arm + speed * speed / self.s)
            if person_speed > 0.0:
                roots = scale * np.sqrt(of_arm + squares / self.s) + person_speed * self.met_roots
                least = min(least, float(roots.max()) ** 2)
        return least


def hull_mobility(cases: Sequence[ContactCase]) -> float:
    """Return the mobility [1/kg] of the body part that allows the least speed at a given reduced mass.

    It chooses the place at which the contact on a link counts, not the bound. A clamped part counts as a heavy one.
    """
    weakest = max(cases, key=lambda case: case.stiffness / case.force**2 / max(case.obstacle_mobility, MIN_MOBILITY))
    return max(weakest.obstacle_mobility, MIN_MOBILITY)


def scaled_energy(energy_of_arm: float, s: float, scale: float, speed: float, person_speed: float) -> float:
    """Return the least bound of x = t c qd, c the `scale`: contacts that slow down all of the arm.

    `speed` [m/s] is that of a link of it at qd.
    """
    slope = scale * energy_of_arm - speed * person_speed / s
    t = slope / (scale * (energy_of_arm + speed * speed / s)) if slope > 0.0 else 0.0
    rest, lost = t * scale * speed + person_speed, (1.0 - t) * scale
    return lost * lost * energy_of_arm + rest * rest / s


def second_trial(at_start: float, slope: float) -> float:
    """Return the length of a step where the slope vanishes, by those at its start and at the first trial."""
    low, high = (FIRST_TRIAL, 1.0) if slope > 0.0 else (0.0, FIRST_TRIAL)
    t = FIRST_TRIAL * at_start / (at_start - slope) if slope < at_start else 1.0
    margin = 0.02 * (high - low)
    return min(max(t, low + margin), high - margin)


def farthest(values: FloatArray) -> int:
    """Return the index of the largest value, of equal ones the first."""
    index = 0
    for i, value in enumerate(values.tolist()):
        if value > values[index] * (1.0 + TIE):
            index = i
    return index


def point_maps(points: FloatArray) -> FloatArray:
    """Return T = [1, -skew(r)] (V, 3, 6) of points r (V, 3): the velocity of each is T times the twist."""
    maps = np.zeros((len(points), 3, 6))
    maps[:, :, :3] = np.eye(3)
    maps[:, [0, 1, 2], [4, 5, 3]] = points[:, [2, 0, 1]]
    maps[:, [0, 1, 2], [5, 3, 4]] = -points[:, [1, 2, 0]]
    return maps
