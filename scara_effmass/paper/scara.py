"""The paper's robot: what its three models say, as functions of the first two joints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from scara_effmass.errors import RobotError
from scara_effmass.model.scara_closed_form import ScaraInertia, scara_full_mass, scara_lumped_mass

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from scara_effmass.model.dynamics import RobotDynamics
    from scara_effmass.values import FloatArray

ANY_SPEED = 1e-6
"""[m/s]; the effective mass does not depend on how fast the contact point moves."""


@dataclass(frozen=True, slots=True)
class Scara:
    """A SCARA by its closed forms: angles in [rad], lengths in [m], masses in [kg].

    `m2`, `m3` are the equivalent planar masses at elbow and end-effector, `iso_mass` is M/2 + m_L (Eq. 17),
    `aggregated` are the lumped masses by axis, the first one at rest; q1 and q2 reach to both sides of 0.
    """

    m2: float
    m3: float
    iso_mass: float
    aggregated: tuple[float, ...]
    inertia: ScaraInertia
    q1_max: float
    q2_max: float

    def lumped(self, q1: ArrayLike, q2: ArrayLike, phi: ArrayLike = 0.0) -> FloatArray:
        """m_n of the simplified model, Eq. 28."""
        return scara_lumped_mass(q1, q2, phi, self.m2, self.m3)

    def full(self, q1: ArrayLike, q2: ArrayLike, phi: ArrayLike = 0.0) -> FloatArray:
        """m_n of the full model, Eq. 27."""
        return scara_full_mass(q1, q2, phi, self.inertia)

    def tool(self, q1: FloatArray, q2: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return x and y of the tool axis."""
        l1, l2 = self.inertia.l1, self.inertia.l2
        return l1 * np.cos(q1) + l2 * np.cos(q1 + q2), l1 * np.sin(q1) + l2 * np.sin(q1 + q2)


class Agreement(NamedTuple):
    """How far closed forms and matrix path lie apart: largest relative differences over `poses`."""

    poses: int
    lumped: float
    full: float


def closed_form_of(dynamics: RobotDynamics) -> Scara:
    """Return the closed forms' parameters of `dynamics`, read off its file. Raises RobotError if it is no SCARA."""
    if dynamics.lumped is None or dynamics.full_reason:
        raise RobotError(
            f"{dynamics.robot.origin}: a model is missing: {dynamics.lumped_reason or dynamics.full_reason}"
        )
    model = dynamics.robot.model
    links = list(model.inertias)[1:]
    mass = [float(link.mass) for link in links]
    turning = [float(link.inertia[2, 2]) for link in links]
    inertia = ScaraInertia(
        l1=_across(model.jointPlacements[2].translation),
        l2=_across(model.jointPlacements[3].translation),
        m1=mass[0],
        m2=mass[1],
        m3=mass[2],
        m4=mass[3],
        r1=_across(links[0].lever),
        r2=_across(links[1].lever),
        i1=turning[0],
        i2=turning[1],
        i3=turning[2],
        i4=turning[3],
    )
    m2, m3 = dynamics.lumped.planar_masses(dynamics.robot)
    q1_max, q2_max = (float(limit) for limit in model.upperPositionLimit[:2])
    return Scara(m2, m3, dynamics.robot.iso_mass, dynamics.lumped.aggregated, inertia, q1_max, q2_max)


def _across(vector: FloatArray) -> float:
    """Return the length of `vector` (3,) across the axes, which are all along z."""
    return float(np.hypot(vector[0], vector[1]))


def matrix_masses(
    dynamics: RobotDynamics, q1: FloatArray, q2: FloatArray, phi: float, q3: float = 0.2
) -> tuple[FloatArray, FloatArray]:
    """Return lumped and full m_n (n,) from the mass matrices (Eqs. 3-8), pose by pose along phi.

    The tool points along the normal (Eq. 24). No pose may be singular.
    """
    (frame,) = dynamics.robot.contact_frames.values()
    normal = np.array([np.cos(phi), np.sin(phi), 0.0])
    found = np.empty((len(q1), 2))
    for row, (first, second) in enumerate(zip(q1.tolist(), q2.tolist(), strict=True)):
        q = np.array([first, second, q3, first + second - phi])
        (effective_masses,) = dynamics.effective_masses(
            q, np.linalg.pinv(dynamics.jacobian(q, frame)) @ normal, ANY_SPEED
        )
        found[row] = effective_masses.lumped, effective_masses.full
    return found[:, 0], found[:, 1]


def agreement(dynamics: RobotDynamics, scara: Scara, q1: FloatArray, q2: FloatArray, phi: float = 0.0) -> Agreement:
    """Compare Eqs. 27 and 28 with the matrix path at the poses (n,)."""
    lumped, full = matrix_masses(dynamics, q1, q2, phi)
    closed = scara.lumped(q1, q2, phi), scara.full(q1, q2, phi)
    worst = [float(np.max(np.abs(a - b) / b)) for a, b in zip((lumped, full), closed, strict=True)]
    return Agreement(len(q1), *worst)
