"""Claims about the reduced mass: Figs. 10 to 15."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from scara_effmass.iso15066 import reduced_mass
from scara_effmass.paper.claim import Basis, Statement
from scara_effmass.paper.density import workspace_distribution
from scara_effmass.paper.mass_claims import EQUAL
from scara_effmass.paper.protocol import ALONG_X, ALONG_Y, OBLIQUE, OBSTACLES_KG, SHOWN_OBSTACLE_KG
from scara_effmass.paper.scara import relative_error
from scara_effmass.paper.workspace import joint_grid
from scara_effmass.sim.scara_kinematics import ElbowConfig

if TYPE_CHECKING:
    from collections.abc import Iterator

    from scara_effmass.paper.claim import Claim
    from scara_effmass.paper.scara import Scara
    from scara_effmass.values import FloatArray


def reduced_mass_claims(scara: Scara) -> Iterator[Claim]:
    """Yield the claims of section 4.2."""
    poses = joint_grid(scara)
    lumped, full = scara.lumped(*poses), scara.full(*poses)
    mu = [reduced_mass(lumped, obstacle) for obstacle in OBSTACLES_KG]
    singular = scara.lumped(0.0, 0.0, ALONG_X)
    limits = [float(reduced_mass(singular, obstacle)) for obstacle in OBSTACLES_KG]
    text = "µ tends to m_H where the effective mass tends to infinity, and never diverges"
    yield Statement("mu_limit", "§4.2", text).holds(
        ", ".join(f"{limit:g}" for limit in limits) + " kg in the singular pose",
        "exactly m_H there, and nowhere more",
        met=limits == list(OBSTACLES_KG)
        and all(float(values.max()) <= obstacle for values, obstacle in zip(mu, OBSTACLES_KG, strict=True)),
    )
    spans = [float(np.ptp(values)) for values in mu]
    text = "the smaller the obstacle's mass, the narrower the range of µ"
    yield Statement("narrow_range", "Fig. 10", text).holds(
        ", ".join(f"{span:.2f}" for span in spans) + " kg wide",
        "widths in the order of m_H",
        met=spans == sorted(spans),
    )
    errors = [
        float(relative_error(reduced_mass(full, obstacle), values).max())
        for values, obstacle in zip(mu, OBSTACLES_KG, strict=True)
    ]
    text = "error in reduced mass at most 5 %"
    yield Statement("worst_reduced_error", "Fig. 11", text, Basis.FITTED).at_most(
        max(errors),
        5.0,
        "%",
        "largest for each m_H on the 50 by 50 grid: " + ", ".join(f"{error:.2f}" for error in errors) + " %",
    )
    text = "turning the normal and q₁ by the same angle leaves the masses as they are"
    yield Statement("turned_values", "Figs. 12, 13", text).at_most(
        max(_max_difference(scara.lumped(poses.q1 + phi, poses.q2, phi), lumped) for phi in (ALONG_Y, OBLIQUE)),
        EQUAL,
        note="largest relative difference",
    )
    along_x, along_y = (workspace_distribution(scara, phi).below(scara.iso_mass) for phi in (ALONG_X, ALONG_Y))
    text = "the plots along y and obliquely equal the one along x, only turned"
    yield Statement("turned_plots", "Fig. 12", text).near(
        100.0 * along_y,
        100.0 * along_x,
        1.0,
        "%",
        "share of the workspace below the ISO standard's value, along y against along x: the values turn with the "
        "normal, the workspace does not, because q₁ ends at ±136°",
    )
    left = scara.lumped(*joint_grid(scara, ElbowConfig.LEFT))
    text = "the left arm's masses mirror the right arm's at the normal"
    yield Statement("left_arm", "Fig. 14", text).at_most(
        _max_difference(left[::-1], lumped),
        EQUAL,
        note=f"largest relative difference at poses mirrored in the x axis; figure for m_H = {SHOWN_OBSTACLE_KG:g} kg",
    )


def _max_difference(values: FloatArray, reference: FloatArray) -> float:
    """Return the largest relative difference."""
    return float(np.abs(values / reference - 1.0).max())
