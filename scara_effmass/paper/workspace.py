"""Where the models are evaluated: the paper's grid of angles, and positions spread evenly over the workspace."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from scara_effmass.sim.scara_kinematics import ElbowConfig

if TYPE_CHECKING:
    from scara_effmass.paper.scara import Scara
    from scara_effmass.values import FloatArray

GRID = 50
"""Values of each angle, as in the paper: ends included, and even, so that no pose is exactly singular."""


class Poses(NamedTuple):
    """Angles [rad], any shape, both the same."""

    q1: FloatArray
    q2: FloatArray


def joint_grid(scara: Scara, side: ElbowConfig = ElbowConfig.RIGHT, count: int = GRID) -> Poses:
    """Return `count` by `count` poses, evenly over the ranges of q1 and, of that arm, q2."""
    q1 = np.linspace(-scara.q1_max, scara.q1_max, count)
    q2 = np.linspace(0.0, side.value * scara.q2_max, count)
    return Poses(*np.meshgrid(q1, q2, indexing="ij"))


def spread_positions(scara: Scara, side: ElbowConfig = ElbowConfig.RIGHT, count: int = GRID) -> Poses:
    """Return the poses (count^2,) whose tool positions each stand for the same area of the workspace.

    dA = l1 l2 |sin q2| dq1 dq2, so these are the centres of equal steps in q1 and in cos q2.
    """
    middles = (np.arange(count) + 0.5) / count
    q1 = scara.q1_max * (2.0 * middles - 1.0)
    q2 = side.value * np.arccos(1.0 - middles * (1.0 - np.cos(scara.q2_max)))
    first, second = np.meshgrid(q1, q2, indexing="ij")
    return Poses(first.ravel(), second.ravel())


class BothArms(NamedTuple):
    """Tool positions x, y [m] on rays and circles around the base, and the poses of either arm there.

    Angles are NaN where that arm does not reach; `right_q1` and so on, each of the same shape.
    """

    x: FloatArray
    y: FloatArray
    right: Poses
    left: Poses


def both_arms(scara: Scara, circles: int, rays: int) -> BothArms:
    """Return positions over all that at least one arm reaches; the outermost circle is the stretched arm."""
    q2 = np.linspace(0.0, scara.q2_max, circles)
    l1, l2 = scara.inertia.l1, scara.inertia.l2
    lead = np.arctan2(l2 * np.sin(q2), l1 + l2 * np.cos(q2))  # of the tool's bearing over q1, right arm
    widest = np.minimum(scara.q1_max + lead, np.pi)
    bearing = widest * np.linspace(-1.0, 1.0, rays)[:, None]
    radius = np.sqrt(l1**2 + l2**2 + 2.0 * l1 * l2 * np.cos(q2))
    sides = []
    for side in (ElbowConfig.RIGHT, ElbowConfig.LEFT):
        q1 = bearing - side.value * lead
        reached = np.abs(q1) <= scara.q1_max * (1.0 + 1e-12)
        sides.append(Poses(np.where(reached, q1, np.nan), np.broadcast_to(side.value * q2, q1.shape)))
    return BothArms(radius * np.cos(bearing), radius * np.sin(bearing), *sides)
