# SPDX-License-Identifier: Apache-2.0
"""The paper's robot as functions of q1 and q2: closed forms of its models (Eqs. 27, 28, 30), poses, distributions.

Vectorised and independent of Pinocchio: the test oracle of `reference.dynamics`, not used for verdicts. Angles in
[rad], lengths in [m], masses in [kg]; arguments broadcast. phi is the angle of the normal n = (cos phi, sin phi, 0) to
the base x axis. The results do not depend on q3, q4 and R_x. The paper is cited in `scara_effmass.model`.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from scara_effmass.codes import ModelCode
from scara_effmass.errors import RobotError
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
FINE_GRID = 1500
"""Values of each angle for the whole workspace; shares and median are accurate to 1e-3, the mean to 1e-3 kg."""
PEAK_BIN_KG, MAX_SHOWN_KG = 0.1, 8.0


def scara_lumped_mass(q1: ArrayLike, q2: ArrayLike, phi: ArrayLike, m2: float, m3: float) -> FloatArray:
    """Return m_n of a SCARA's lumped model [kg] (Eq. 28); infinite in the singular pose q2 = 0, q1 = phi.

    `m2` and `m3` are the equivalent planar masses M2 at the elbow and M3 at the end-effector.
    """
    elbow = np.sin(q2) ** 2
    numerator = m3 * (m2 + m3 * elbow)
    denominator = m2 * np.sin(np.add(q1, q2) - np.asarray(phi)) ** 2 + m3 * elbow
    with np.errstate(divide="ignore", over="ignore"):
        return np.asarray(numerator / denominator, dtype=np.float64)


def scara_max_lumped_mass(q2: ArrayLike, m2: float, m3: float) -> FloatArray:
    """Return the largest m_n of a SCARA's lumped model [kg], at q1 + q2 = phi (Eq. 30); infinite at q2 = 0."""
    with np.errstate(divide="ignore", over="ignore"):
        return np.asarray(m3 + m2 / np.sin(q2) ** 2, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class ScaraInertia:
    """Lengths, masses, centres of mass and inertias about z of a SCARA's links, as in the mass matrix after Eq. 24."""

    l1: float
    l2: float
    m1: float
    m2: float
    m3: float
    m4: float
    r1: float
    r2: float
    i1: float
    i2: float
    i3: float
    i4: float


def scara_full_mass(q1: ArrayLike, q2: ArrayLike, phi: ArrayLike, scara: ScaraInertia) -> FloatArray:
    """Return m_n of a SCARA's full model [kg] (Eq. 27), with M11, M12 and M22 as printed after Eq. 24."""
    s = scara
    tool = s.m3 + s.m4
    rotation = s.i2 + s.i3 + s.i4
    c2 = np.cos(q2)
    m22 = s.m2 * s.r2**2 + rotation + tool * s.l2**2
    m12 = m22 + (s.m2 * s.r2 + tool * s.l2) * s.l1 * c2
    m11 = (
        s.m1 * s.r1**2
        + s.m2 * (s.l1**2 + s.r2**2 + 2.0 * s.l1 * s.r2 * c2)
        + s.i1
        + rotation
        + tool * (s.l1**2 + 2.0 * s.l1 * s.l2 * c2 + s.l2**2)
    )
    s1 = np.sin(np.asarray(q1) - np.asarray(phi))
    s12 = np.sin(np.add(q1, q2) - np.asarray(phi))
    numerator = -(m12**2 - 2.0 * s.i4 * m12 + s.i4 * m11 + s.i4 * m22 - m11 * m22)
    denominator = (
        (m11 - 2.0 * m12 + m22) * s.l2**2 * s12**2
        + (m22 - s.i4) * s.l1**2 * s1**2
        + 2.0 * (m22 - m12) * s.l1 * s.l2 * s12 * s1
    )
    with np.errstate(divide="ignore", over="ignore"):
        return np.asarray(numerator / denominator, dtype=np.float64)


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


def equal_area_poses(scara: Scara, count: int = GRID) -> JointAngles:
    """Return poses (count^2,) of the right arm whose tool positions each represent the same area of the workspace.

    dA = l1 l2 |sin q2| dq1 dq2: the poses are the centres of equal steps in q1 and in cos q2.
    """
    centres = (np.arange(count) + 0.5) / count
    q1 = scara.q1_max * (2.0 * centres - 1.0)
    q2 = np.arccos(1.0 - centres * (1.0 - np.cos(scara.q2_max)))
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


class MassDistribution(NamedTuple):
    """Effective masses (n,) [kg], and the share of the workspace area (n,) with each of them."""

    mass: FloatArray
    share: FloatArray

    @property
    def mean(self) -> float:
        """Mean over the area [kg]."""
        return float(self.mass @ self.share)

    @property
    def median(self) -> float:
        """Median over the area [kg]."""
        order = np.argsort(self.mass)
        return float(self.mass[order][np.searchsorted(np.cumsum(self.share[order]), 0.5)])

    def below(self, mass: float) -> float:
        """Return the share with less than `mass` [kg]."""
        return float(self.share[self.mass < mass].sum())

    def density(self, edges: FloatArray) -> FloatArray:
        """Return the probability density [1/kg] between evenly spaced `edges` [kg]."""
        shares, _ = np.histogram(self.mass, edges, weights=self.share)
        return np.asarray(shares / (edges[1] - edges[0]))


def sampled_distribution(scara: Scara) -> MassDistribution:
    """Return the masses of the simplified model along x, right arm, at 2500 positions of equal area."""
    mass = scara.lumped(*equal_area_poses(scara))
    return MassDistribution(mass, np.full(mass.size, 1.0 / mass.size))


def workspace_distribution(scara: Scara, phi: float = 0.0) -> MassDistribution:
    """Return the masses of the simplified model over the whole workspace, by quadrature over the angles."""
    centres = (np.arange(FINE_GRID) + 0.5) / FINE_GRID
    q1, q2 = np.meshgrid(scara.q1_max * (2.0 * centres - 1.0), scara.q2_max * centres, indexing="ij")
    area = np.sin(q2).ravel()  # dA = l1 l2 |sin q2| dq1 dq2
    return MassDistribution(scara.lumped(q1, q2, phi).ravel(), area / area.sum())


def density_peaks(distribution: MassDistribution) -> FloatArray:
    """Return the masses [kg] at the local maxima of the density, to half of `PEAK_BIN_KG`."""
    # The first maximum is the lightest mass: the edges keep it inside a bin.
    edges = np.arange(distribution.mass.min() - 0.7 * PEAK_BIN_KG, MAX_SHOWN_KG, PEAK_BIN_KG)
    rises = np.diff(np.concatenate(([0.0], distribution.density(edges), [0.0])))
    return np.asarray((edges[:-1] + edges[1:])[(rises[:-1] > 0.0) & (rises[1:] < 0.0)] / 2.0)
