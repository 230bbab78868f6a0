"""Claims about reduced mass: Figs. 10 to 15."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from scara_effmass.iso15066 import reduced_mass
from scara_effmass.paper.claim import Basis, at_most, holds, near
from scara_effmass.paper.density import over_workspace
from scara_effmass.paper.mass_claims import EQUAL
from scara_effmass.paper.mass_maps import relative_error
from scara_effmass.paper.protocol import ALONG_X, ALONG_Y, OBLIQUE, OBSTACLES_KG, SHOWN_OBSTACLE_KG
from scara_effmass.paper.workspace import joint_grid
from scara_effmass.sim.scara_kinematics import ElbowConfig

if TYPE_CHECKING:
    from collections.abc import Iterator

    from scara_effmass.paper.claim import Claim
    from scara_effmass.paper.scara import Scara
    from scara_effmass.values import FloatArray


def reduced_mass_claims(scara: Scara) -> Iterator[Claim]:
    """Yield them."""
    poses = joint_grid(scara)
    lumped, full = scara.lumped(*poses), scara.full(*poses)
    singular = scara.lumped(0.0, 0.0, ALONG_X)
    limits = [float(reduced_mass(singular, obstacle)) for obstacle in OBSTACLES_KG]
    yield holds(
        "mu_limit",
        "§4.2",
        "µ tends to m_H where the effective mass tends to infinity, and never diverges",
        ", ".join(f"{limit:g}" for limit in limits) + " kg in the singular pose",
        "exactly m_H there, and nowhere more",
        Basis.RESULT,
        met=limits == list(OBSTACLES_KG)
        and all(float(reduced_mass(lumped, each).max()) <= each for each in OBSTACLES_KG),
    )
    spans = [float(np.ptp(reduced_mass(lumped, obstacle))) for obstacle in OBSTACLES_KG]
    yield holds(
        "narrow_range",
        "Fig. 10",
        "the smaller the obstacle's mass, the narrower the range of µ",
        ", ".join(f"{span:.2f}" for span in spans) + " kg wide",
        "widths in the order of m_H",
        Basis.RESULT,
        met=spans == sorted(spans),
    )
    errors = [
        float(relative_error(reduced_mass(full, each), reduced_mass(lumped, each)).max()) for each in OBSTACLES_KG
    ]
    yield at_most(
        "worst_reduced_error",
        "Fig. 11",
        "error in reduced mass at most 5 %",
        5.0,
        max(errors),
        "%",
        Basis.FITTED,
        "largest for each m_H on the 50 by 50 grid: " + ", ".join(f"{error:.2f}" for error in errors) + " %",
    )
    turned = max(_largest_difference(scara.lumped(poses.q1 + phi, poses.q2, phi), lumped) for phi in (ALONG_Y, OBLIQUE))
    yield at_most(
        "turned_values",
        "Figs. 12, 13",
        "turning the normal and q₁ by the same angle leaves the masses as they are",
        EQUAL,
        turned,
        "",
        Basis.RESULT,
        "largest relative difference",
    )
    along_x, along_y = (over_workspace(scara, phi).below(scara.iso_mass) for phi in (ALONG_X, ALONG_Y))
    yield near(
        "turned_plots",
        "Fig. 12",
        "the plots along y and obliquely equal the one along x, only turned",
        100.0 * along_x,
        100.0 * along_y,
        1.0,
        "%",
        Basis.RESULT,
        "share of the workspace below the ISO standard's value, along y against along x: the values turn with the "
        "normal, the workspace does not, because q₁ ends at ±136°",
    )
    left = scara.lumped(*joint_grid(scara, ElbowConfig.LEFT))
    mirrored = _largest_difference(left[::-1], lumped)
    yield at_most(
        "left_arm",
        "Fig. 14",
        "the left arm's masses mirror the right arm's at the normal",
        EQUAL,
        mirrored,
        "",
        Basis.RESULT,
        f"largest relative difference at poses mirrored in the x axis; figure for m_H = {SHOWN_OBSTACLE_KG:g} kg",
    )


def _largest_difference(one: FloatArray, other: FloatArray) -> float:
    return float(np.abs(one / other - 1.0).max())
