"""Poses of the comparison: the paper's joint grid, poses of equal area, and a polar grid for both arms."""

from typing import NamedTuple

import numpy as np

from scara_effmass.paper.scara import Scara
from scara_effmass.sim.motion import ElbowConfig
from scara_effmass.values import FloatArray

GRID = 50
"""Values of each angle, as in the paper. The number is even, so that no pose is exactly singular."""


class JointAngles(NamedTuple):
    """q1 and q2 [rad], arrays of equal shape."""

    q1: FloatArray
    q2: FloatArray


def joint_grid(scara: Scara, elbow_config: ElbowConfig = ElbowConfig.RIGHT, count: int = GRID) -> JointAngles:
    """Return `count` by `count` poses, evenly spaced over the ranges of q1 and q2, limits included."""
    q1 = np.linspace(-scara.q1_max, scara.q1_max, count)
    q2 = np.linspace(0.0, elbow_config.value * scara.q2_max, count)
    return JointAngles(*np.meshgrid(q1, q2, indexing="ij"))


def equal_area_poses(scara: Scara, elbow_config: ElbowConfig = ElbowConfig.RIGHT, count: int = GRID) -> JointAngles:
    """Return poses (count^2,) whose tool positions each represent the same area of the workspace.

    dA = l1 l2 |sin q2| dq1 dq2: the poses are the centres of equal steps in q1 and in cos q2.
    """
    centres = (np.arange(count) + 0.5) / count
    q1 = scara.q1_max * (2.0 * centres - 1.0)
    q2 = elbow_config.value * np.arccos(1.0 - centres * (1.0 - np.cos(scara.q2_max)))
    q1, q2 = np.meshgrid(q1, q2, indexing="ij")
    return JointAngles(q1.ravel(), q2.ravel())


class PolarGrid(NamedTuple):
    """Tool positions x, y [m] and the pose of each arm there; its q1 is NaN out of its reach."""

    x: FloatArray
    y: FloatArray
    right: JointAngles
    left: JointAngles


def polar_grid(scara: Scara, circles: int, rays: int) -> PolarGrid:
    """Return positions over the reach of both arms; the outermost circle is the stretched arm."""
    q2 = np.linspace(0.0, scara.q2_max, circles)
    l1, l2 = scara.inertia.l1, scara.inertia.l2
    lead = np.arctan2(l2 * np.sin(q2), l1 + l2 * np.cos(q2))  # bearing of the tool minus q1, right arm
    max_bearing = np.minimum(scara.q1_max + lead, np.pi)
    bearing = max_bearing * np.linspace(-1.0, 1.0, rays)[:, None]
    radius = np.sqrt(l1**2 + l2**2 + 2.0 * l1 * l2 * np.cos(q2))
    poses = []
    for elbow_config in (ElbowConfig.RIGHT, ElbowConfig.LEFT):
        q1 = bearing - elbow_config.value * lead
        reachable = np.abs(q1) <= scara.q1_max * (1.0 + 1e-12)
        q2_of_arm = np.broadcast_to(elbow_config.value * q2, q1.shape)
        poses.append(JointAngles(np.where(reachable, q1, np.nan), q2_of_arm))
    return PolarGrid(radius * np.cos(bearing), radius * np.sin(bearing), *poses)
