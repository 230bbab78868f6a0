"""Claims about effective mass: Figs. 6 to 9."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from scara_effmass.model.scara_closed_form import scara_max_lumped_mass
from scara_effmass.paper.claim import Basis, at_most, holds, more_than, near
from scara_effmass.paper.density import at_positions, over_workspace, peaks
from scara_effmass.paper.mass_maps import relative_error
from scara_effmass.paper.protocol import ALONG_X, ALONG_Y, OBLIQUE
from scara_effmass.paper.scara import matrix_masses
from scara_effmass.paper.workspace import joint_grid, spread_positions

if TYPE_CHECKING:
    from collections.abc import Iterator

    from scara_effmass.model.dynamics import RobotDynamics
    from scara_effmass.paper.claim import Claim
    from scara_effmass.paper.density import Distribution
    from scara_effmass.paper.scara import Scara

EQUAL = 1e-9
"""Relative difference [-] that rounding leaves between two ways to the same number."""
EXTREME_STEPS = 721
QUILL_M = (0.0, 0.236, 0.45)


def mass_claims(dynamics: RobotDynamics, scara: Scara) -> Iterator[Claim]:
    """Yield them."""
    yield from _extremes(scara)
    yield _independent_of_quill(dynamics, scara)
    yield from _density(scara, over_workspace(scara))
    yield from _errors(scara)


def _extremes(scara: Scara) -> Iterator[Claim]:
    """Search for the extremes over a full turn, rather than putting in where the paper says they are."""
    turn = np.radians(np.linspace(-180.0, 180.0, EXTREME_STEPS))
    step = float(np.degrees(turn[1] - turn[0]))
    q1, phi = np.meshgrid(np.radians(np.arange(-130.0, 131.0, 20.0)), (ALONG_X, OBLIQUE, ALONG_Y), indexing="ij")
    masses = scara.lumped(q1[..., None], turn, phi[..., None])
    lightest = turn[np.argmin(masses, axis=-1)]
    off = float(np.degrees(np.abs(np.sin(lightest + q1 - phi - np.pi / 2.0))).max())
    yield at_most(
        "minimum_at",
        "§4.1, Fig. 6",
        "smallest effective mass at q₂ = -q₁ + φ + π/2",
        step,
        off,
        "deg",
        Basis.RESULT,
        f"found by search over q₂ in steps of {step:g}°, for {q1.size} pairs of q₁ and φ; the bound is one step",
    )
    there = scara.lumped(q1, -q1 + phi + np.pi / 2.0, phi)
    yield at_most(
        "minimum_is_m3",
        "§4.1",
        "there it is M₃, and nowhere smaller",
        EQUAL,
        float(max(np.abs(there / scara.m3 - 1.0).max(), 1.0 - masses.min() / scara.m3)),
        "",
        Basis.RESULT,
        "relative difference from M₃ there, or how far the search found less",
    )
    q2, direction = np.meshgrid(np.radians(np.arange(10.0, 150.0, 10.0)), (ALONG_X, OBLIQUE, ALONG_Y), indexing="ij")
    masses = scara.lumped(turn, q2[..., None], direction[..., None])
    heaviest = turn[np.argmax(masses, axis=-1)]
    off = float(np.degrees(np.abs(np.sin(heaviest + q2 - direction))).max())
    yield at_most(
        "maximum_at",
        "§4.1, Eq. 30",
        "largest effective mass at q₂ = -q₁ + φ",
        step,
        off,
        "deg",
        Basis.RESULT,
        "holds at each q₂, with q₁ turning; along q₂ at fixed q₁ the largest value lies elsewhere",
    )
    there = scara.lumped(direction - q2, q2, direction)
    largest = scara_max_lumped_mass(q2, scara.m2, scara.m3)
    yield at_most(
        "maximum_is_eq_30",
        "Eq. 30",
        "there it is a function of q₂ alone",
        EQUAL,
        float(np.abs(there / largest - 1.0).max()),
        "",
        Basis.RESULT,
        "relative difference of Eq. 28 from M₃ + M₂ / sin² q₂, which never is below M₂ + M₃",
    )
    singular = float(scara.lumped(0.0, 0.0, ALONG_X))
    yield holds(
        "singularity",
        "§4.1",
        "infinite at φ = q₁ = q₂ = 0",
        "infinite" if np.isinf(singular) else f"{singular:g} kg",
        "infinite",
        Basis.RESULT,
        "maps are coloured up to the top of their scale; the 50 by 50 grid has no such pose on it",
        met=bool(np.isposinf(singular)),
    )


def _independent_of_quill(dynamics: RobotDynamics, scara: Scara) -> Claim:
    poses = spread_positions(scara, count=8)
    found = [np.concatenate(matrix_masses(dynamics, *poses, OBLIQUE, q3)) for q3 in QUILL_M]
    return at_most(
        "independent_of_q3",
        "§3.2",
        "independent of q₃ along a horizontal normal",
        EQUAL,
        float(max(np.abs(each / found[0] - 1.0).max() for each in found)),
        "",
        Basis.RESULT,
        f"largest relative change over q₃ = {', '.join(f'{q3:g}' for q3 in QUILL_M)} m, by the mass matrices",
    )


def _density(scara: Scara, whole: Distribution) -> Iterator[Claim]:
    few, below = at_positions(scara), whole.below(scara.iso_mass)
    exact = f"over the whole workspace {below:.1%}"
    yield more_than(
        "share_below_iso",
        "Fig. 8",
        "more than 70 % of 2500 positions below 2.77 kg",
        70.0,
        100.0 * few.below(scara.iso_mass),
        "%",
        Basis.RESULT,
        f"{exact}; so {1.0 - below:.0%} lie above, where the standard's mass is not conservative",
    )
    for name, mine, all_of_it in (("mean", few.mean, whole.mean), ("median", few.median, whole.median)):
        yield at_most(
            f"{name}_below_iso",
            "Fig. 8",
            f"the standard's mass lies above the {name}",
            scara.iso_mass,
            mine,
            "kg",
            Basis.RESULT,
            f"the paper prints no number for the {name}; over the whole workspace it is {all_of_it:.3f} kg",
        )
    found = peaks(whole)
    yield holds(
        "bimodal",
        "Fig. 8",
        "two peaks",
        f"{len(found)} peaks: " + ", ".join(f"{peak:.2f}" for peak in found) + " kg",
        "2 peaks in a histogram of 0.1 kg",
        Basis.RESULT,
        f"at M₃ = {scara.m3:.2f} and M₂ + M₃ = {scara.m2 + scara.m3:.2f} kg",
        met=len(found) == 2,
    )


def _errors(scara: Scara) -> Iterator[Claim]:
    poses = joint_grid(scara)
    full, simplified = scara.full(*poses), scara.lumped(*poses)
    error = relative_error(full, simplified)
    sign = (
        "larger" if np.all(simplified > full) else "smaller" if np.all(simplified < full) else "now larger, now smaller"
    )
    yield near(
        "worst_error",
        "Fig. 9",
        "error in effective mass reaches 10 % in the worst case",
        10.0,
        float(error.max()),
        0.5,
        "%",
        Basis.FITTED,
        f"on the 50 by 50 grid; the simplified mass is {sign} everywhere, a sign that the fit does not determine",
    )
    yield at_most(
        "error_in_75_percent",
        "Fig. 9",
        "error at most 6 % in 75 % of the cases",
        6.0,
        float(np.percentile(error, 75.0)),
        "%",
        Basis.FITTED,
        f"75th percentile; {np.mean(error <= 6.0):.1%} of the grid lies within 6 %",
    )
