"""The paper's robot: full, simplified and standard model as functions of q1 and q2."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from scara_effmass.errors import RobotError
from scara_effmass.model.scara_closed_form import ScaraInertia, scara_full_mass, scara_lumped_mass
from scara_effmass.values import FloatArray

if TYPE_CHECKING:
    from scara_effmass.model.dynamics import RobotDynamics

MIN_SPEED = 1e-6
"""Lower speed limit for a direction [m/s]; the effective mass does not depend on the speed."""


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


class ModelAgreement(NamedTuple):
    """Largest relative differences between closed forms and mass matrices over `poses` poses."""

    poses: int
    lumped: float
    full: float


def scara_of(dynamics: RobotDynamics) -> Scara:
    """Return the closed-form parameters of the robot in `dynamics`. Raises RobotError if it is not a SCARA."""
    robot, lumped = dynamics.robot, dynamics.lumped
    if lumped is None or dynamics.full_reason:
        raise RobotError(f"{robot.origin}: a model is missing: {dynamics.lumped_reason or dynamics.full_reason}")
    model = robot.model
    link1, link2, link3, link4 = list(model.inertias)[1:]
    inertia = ScaraInertia(
        l1=_planar_length(model.jointPlacements[2].translation),
        l2=_planar_length(model.jointPlacements[3].translation),
        m1=float(link1.mass),
        m2=float(link2.mass),
        m3=float(link3.mass),
        m4=float(link4.mass),
        r1=_planar_length(link1.lever),
        r2=_planar_length(link2.lever),
        i1=float(link1.inertia[2, 2]),
        i2=float(link2.inertia[2, 2]),
        i3=float(link3.inertia[2, 2]),
        i4=float(link4.inertia[2, 2]),
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
    (frame,) = dynamics.robot.contact_frames.values()
    normal = np.array([np.cos(phi), np.sin(phi), 0.0])
    masses = np.empty((2, len(q1)))
    for i, (angle1, angle2) in enumerate(zip(q1.tolist(), q2.tolist(), strict=True)):
        q = np.array([angle1, angle2, q3, angle1 + angle2 - phi])
        qd = np.linalg.pinv(dynamics.jacobian(q, frame)) @ normal
        (effective_masses,) = dynamics.effective_masses(q, qd, MIN_SPEED)
        masses[:, i] = effective_masses.lumped, effective_masses.full
    return masses[0], masses[1]


def compare_models(
    dynamics: RobotDynamics, scara: Scara, q1: FloatArray, q2: FloatArray, phi: float = 0.0
) -> ModelAgreement:
    """Compare Eqs. 27 and 28 with the mass matrices at the poses (n,)."""
    lumped, full = matrix_masses(dynamics, q1, q2, phi)
    differences = [
        float(np.max(np.abs(matrix - closed_form) / closed_form))
        for matrix, closed_form in ((lumped, scara.lumped(q1, q2, phi)), (full, scara.full(q1, q2, phi)))
    ]
    return ModelAgreement(len(q1), *differences)
