# SPDX-License-Identifier: Apache-2.0
"""SCARA closed forms of the paper (Eqs. 27, 28 and 30): test oracle and figures, not used for verdicts.

Vectorised and independent of Pinocchio; production computes masses in `dynamics`. Angles in [rad], lengths in [m],
masses in [kg]; all arguments broadcast. phi is the angle of the normal n = (cos phi, sin phi, 0) to the base x axis.
The results do not depend on q3, q4 and R_x. The paper is cited in `scara_effmass.model`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from scara_effmass.values import FloatArray


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
