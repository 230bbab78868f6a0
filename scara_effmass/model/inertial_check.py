"""What a robot file states of its links, and how far that can be believed."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from scara_effmass.values import FloatArray

_TRIANGLE = 1e-3
"""Share by which rounding in a file may break the triangle inequality."""


class StatedLink(NamedTuple):
    """One moving link as its file states it, before fixed links and payload are added to it.

    `com` (3,) [m] and `inertia` (3, 3) [kg m2], about the centre of mass, are in axes of the file's choice.
    """

    name: str
    mass: float
    com: FloatArray
    inertia: FloatArray

    @property
    def placeholder(self) -> bool:
        """Whether the inertia is the identity, or the mass times it: numbers that no link of a robot arm has."""
        return any(np.allclose(self.inertia, scale * np.eye(3), rtol=1e-6, atol=0.0) for scale in (1.0, self.mass))


class InertialCheck(NamedTuple):
    """Why masses, centres of mass and inertias cannot be believed; empty where they can."""

    masses: str
    coms: str
    inertias: str
    notes: tuple[str, ...]


def check_inertials(links: Sequence[StatedLink]) -> InertialCheck:
    """Look for placeholders and impossible tensors among `links`; a single link is no pattern."""
    heavy = [link for link in links if link.mass > 0.0]
    fake = [link.name for link in heavy if link.placeholder]
    all_fake = 1 < len(heavy) == len(fake)
    masses = coms = inertias = ""
    notes: tuple[str, ...] = ()
    if all_fake and all(link.mass == 1.0 for link in heavy):
        masses = "every link has mass 1 and identity inertia: placeholders, not data"
    if len(heavy) > 1 and all(np.allclose(link.com, 0.0) for link in heavy):
        coms = "every centre of mass lies at its link's origin: placeholders, not data"
    bare = [link.name for link in heavy if np.allclose(link.inertia, 0.0, atol=1e-12)]
    if len(bare) == len(heavy):
        inertias = "the file gives no inertia tensors"
    elif bare:
        inertias = f"no inertia tensor for {', '.join(bare)}, while other links have one"
    elif all_fake:
        inertias = "every inertia tensor is the identity, or the mass times it: placeholders, not data"
    else:
        inertias = next(filter(None, map(_impossible, heavy)), "")
        if fake:
            notes = (f"placeholder inertia, taken as it stands, which errs to the heavy side: {', '.join(fake)}",)
    return InertialCheck(masses, coms, inertias, notes)


def principal_moments(inertia: FloatArray) -> tuple[float, float, float]:
    """Return the principal moments of an inertia tensor (3, 3), ascending. Raises ValueError where one is negative."""
    low, middle, high = np.linalg.eigvalsh(inertia).tolist()
    if low < -1e-9 * high or high < 0.0:
        raise ValueError(f"principal moments ({low:.6g}, {middle:.6g}, {high:.6g}) kg m2: none may be negative")
    return low, middle, high


def _impossible(link: StatedLink) -> str:
    low, middle, high = principal_moments(link.inertia)
    if high <= (low + middle) * (1.0 + _TRIANGLE):
        return ""
    return (
        f"the inertia of {link.name} cannot belong to a body: of its principal moments "
        f"({low:.6g}, {middle:.6g}, {high:.6g}) kg m2 the largest exceeds the sum of the others"
    )
