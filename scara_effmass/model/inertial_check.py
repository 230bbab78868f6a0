# SPDX-License-Identifier: Apache-2.0
"""Plausibility check of the inertial data that a robot file states."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from scara_effmass.values import FloatArray

_TRIANGLE = 1e-3
"""Relative tolerance of the triangle inequality, for values rounded in the file."""


class StatedLink(NamedTuple):
    """Inertial data of one moving link as stated in the file, before fixed links and payload are added.

    `com` (3,) [m] and `inertia` (3, 3) [kg m2] about it are in the axes that the file uses.
    """

    name: str
    mass: float
    com: FloatArray
    inertia: FloatArray

    @property
    def placeholder(self) -> bool:
        """Whether the inertia is the identity, or the mass times it, which no link of a robot has."""
        return any(np.allclose(self.inertia, scale * np.eye(3), rtol=1e-6, atol=0.0) for scale in (1.0, self.mass))


class InertialCheck(NamedTuple):
    """Why masses, centres of mass and inertias are implausible (empty if they are plausible), and notes."""

    masses: str
    coms: str
    inertias: str
    notes: tuple[str, ...]


def check_inertials(links: Sequence[StatedLink]) -> InertialCheck:
    """Find placeholders and impossible tensors in `links`. A pattern needs at least two links with mass."""
    heavy = [link for link in links if link.mass > 0.0]
    placeholders = [link.name for link in heavy if link.placeholder]
    all_placeholders = 1 < len(heavy) == len(placeholders)
    masses = coms = inertias = ""
    notes: tuple[str, ...] = ()
    if all_placeholders and all(link.mass == 1.0 for link in heavy):
        masses = "every link has mass 1 and identity inertia: placeholders, not data"
    if len(heavy) > 1 and all(np.allclose(link.com, 0.0) for link in heavy):
        coms = "every centre of mass lies at its link's origin: placeholders, not data"
    without_inertia = [link.name for link in heavy if np.allclose(link.inertia, 0.0, atol=1e-12)]
    if len(without_inertia) == len(heavy):
        inertias = "the file gives no inertia tensors"
    elif without_inertia:
        inertias = f"no inertia tensor for {', '.join(without_inertia)}, while other links have one"
    elif all_placeholders:
        inertias = "every inertia tensor is the identity, or the mass times it: placeholders, not data"
    else:
        inertias = next(filter(None, map(triangle_error, heavy)), "")
        if placeholders:
            notes = (f"placeholder inertia, used as stated, which makes the robot heavier: {', '.join(placeholders)}",)
    return InertialCheck(masses, coms, inertias, notes)


def principal_moments(inertia: FloatArray) -> tuple[float, float, float]:
    """Return the principal moments of an inertia tensor (3, 3), ascending. Raises ValueError if one is negative."""
    low, middle, high = np.linalg.eigvalsh(inertia).tolist()
    if low < -1e-9 * high or high < 0.0:
        raise ValueError(f"principal moments ({low:.6g}, {middle:.6g}, {high:.6g}) kg m2: must not be negative")
    return low, middle, high


def triangle_error(link: StatedLink) -> str:
    """Return why the inertia of `link` is impossible, or an empty string. Raises ValueError for a negative moment."""
    low, middle, high = principal_moments(link.inertia)
    if high <= (low + middle) * (1.0 + _TRIANGLE):
        return ""
    return (
        f"the inertia of {link.name} is impossible: its principal moments ({low:.6g}, {middle:.6g}, {high:.6g}) kg m2 "
        "violate the triangle inequality"
    )
