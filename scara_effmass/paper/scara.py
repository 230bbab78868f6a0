# SPDX-License-Identifier: Apache-2.0
"""The paper's robot as functions of q1 and q2: its full, simplified and ISO model, and the poses of the figures."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from scara_effmass.codes import ModelCode
from scara_effmass.errors import RobotError
from scara_effmass.model.scara_closed_form import ScaraInertia, scara_full_mass, scara_lumped_mass
from scara_effmass.reference import RobotDynamics
from scara_effmass.sim.motion import ElbowConfig
from scara_effmass.values import FloatArray

ALONG_X, ALONG_Y = 0.0, math.pi / 2.0
OBLIQUE = math.atan2(0.8, 0.6)
"""phi of the normal (0.6, 0.8, 0) of Fig. 12 (b)."""
OBSTACLES_KG = (0.50, 2.39, 3.72, 7.35)
SHOWN_OBSTACLE_KG = 2.39
"""Obstacle mass of Figs. 12, 14, 15 and 18; the text states it for 12 and 18 only."""
GRID = 50
"""Values of each angle, as in the paper. The number is even, so that no pose is exactly singular."""


@dataclass(frozen=True, slots=True)
class Scara:
    """Parameters of a SCARA's closed forms: angles [rad], lengths [m], masses [kg].

    `m2` and `m3` are the equivalent planar masses at elbow and end-effector, `iso_mass` is m_R = M/2 + m_L (Eq. 17),
    `aggregated` are the lumped masses by axis, the first one at rest. q1 and q2 are limited symmetrically.
    """

    m2: float
    m3: float
    iso_mass: float
    aggregated: tuple[float, ...]
    inertia: ScaraInertia
    q1_max: float
    q2_max: float

    def lumped(self, q1: ArrayLike, q2: ArrayLike, phi: ArrayLike = 0.0) -> FloatArray:
        """Return m_n of the simplified model, Eq. 28."""
        return scara_lumped_mass(q1, q2, phi, self.m2, self.m3)

    def full(self, q1: ArrayLike, q2: ArrayLike, phi: ArrayLike = 0.0) -> FloatArray:
        """Return m_n of the full model, Eq. 27."""
        return scara_full_mass(q1, q2, phi, self.inertia)

    def tool(self, q1: FloatArray, q2: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return x and y of the tool axis."""
        l1, l2 = self.inertia.l1, self.inertia.l2
        return l1 * np.cos(q1) + l2 * np.cos(q1 + q2), l1 * np.sin(q1) + l2 * np.sin(q1 + q2)


def scara_of(dynamics: RobotDynamics) -> Scara:
    """Return the closed-form parameters of the robot in `dynamics`. Raises RobotError if it is not a SCARA."""
    robot, lumped = dynamics.robot, dynamics.lumped
    if lumped is None or dynamics.full_reason:
        raise RobotError(f"{robot.origin}: a model is missing: {dynamics.lumped_reason or dynamics.full_reason}")
    model = robot.model
    links = list(model.inertias)[1:]
    inertia = ScaraInertia(
        *(_planar_length(model.jointPlacements[joint].translation) for joint in (2, 3)),
        *(float(link.mass) for link in links),
        *(_planar_length(link.lever) for link in links[:2]),
        *(float(link.inertia[2, 2]) for link in links),
    )
    m2, m3 = lumped.planar_masses(robot)
    q1_max, q2_max = (float(limit) for limit in model.upperPositionLimit[:2])
    return Scara(m2, m3, robot.iso_mass, lumped.aggregated, inertia, q1_max, q2_max)


def _planar_length(vector: FloatArray) -> float:
    """Return the length of `vector` (3,) perpendicular to the joint axes, which are along z."""
    return float(np.hypot(vector[0], vector[1]))


def relative_error(full: FloatArray, simplified: FloatArray) -> FloatArray:
    """Return |full - simplified| / full [%]."""
    return np.asarray(100.0 * np.abs(full - simplified) / full)


def matrix_masses(
    dynamics: RobotDynamics, q1: FloatArray, q2: FloatArray, phi: float, q3: float = 0.2
) -> tuple[FloatArray, FloatArray]:
    """Return lumped and full m_n (n,) along phi from the mass matrices (Eqs. 3-8).

    The tool points along the normal (Eq. 24). No pose may be singular.
    """
    normal = np.array([np.cos(phi), np.sin(phi), 0.0])
    masses = np.empty((2, len(q1)))
    for i, (angle1, angle2) in enumerate(zip(q1.tolist(), q2.tolist(), strict=True)):
        q = np.array([angle1, angle2, q3, angle1 + angle2 - phi])
        contact = dynamics.at(q).contacts[0]
        masses[:, i] = [contact.effective_mass(model, normal) for model in (ModelCode.LUMPED, ModelCode.FULL)]
    return masses[0], masses[1]


class ModelAgreement(NamedTuple):
    """Largest relative differences between closed forms and mass matrices over `poses` poses."""

    poses: int
    lumped_relative_difference: float
    full_relative_difference: float


def compare_models(
    dynamics: RobotDynamics, scara: Scara, q1: FloatArray, q2: FloatArray, phi: float = 0.0
) -> ModelAgreement:
    """Compare Eqs. 27 and 28 with the mass matrices at the poses (n,)."""
    pairs = zip(matrix_masses(dynamics, q1, q2, phi), (scara.lumped(q1, q2, phi), scara.full(q1, q2, phi)), strict=True)
    return ModelAgreement(len(q1), *(max_difference(matrix, closed_form) for matrix, closed_form in pairs))


def max_difference(values: FloatArray, reference: FloatArray | float) -> float:
    """Return the largest relative difference of `values` from `reference`."""
    return float(np.abs(values / reference - 1.0).max())


class JointAngles(NamedTuple):
    """q1 and q2 [rad], arrays of equal shape."""

    q1: FloatArray
    q2: FloatArray


def joint_grid(scara: Scara, elbow_config: ElbowConfig = ElbowConfig.RIGHT) -> JointAngles:
    """Return `GRID` by `GRID` poses, evenly spaced over the ranges of q1 and q2, limits included."""
    q1 = np.linspace(-scara.q1_max, scara.q1_max, GRID)
    q2 = np.linspace(0.0, elbow_config.value * scara.q2_max, GRID)
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
    """Tool positions x, y [m] and the pose of each arm there, with q1 NaN where the arm does not reach."""

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
    for side in (1.0, -1.0):
        q1 = bearing - side * lead
        reachable = np.abs(q1) <= scara.q1_max * (1.0 + 1e-12)
        poses.append(JointAngles(np.where(reachable, q1, np.nan), np.broadcast_to(side * q2, q1.shape)))
    return PolarGrid(radius * np.cos(bearing), radius * np.sin(bearing), *poses)
