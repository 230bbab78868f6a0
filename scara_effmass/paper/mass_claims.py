"""Claims about the effective mass: Figs. 6 to 9."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from scara_effmass.model.scara_closed_form import scara_max_lumped_mass
from scara_effmass.paper.claim import Basis, Statement
from scara_effmass.paper.density import density_peaks, sampled_distribution, workspace_distribution
from scara_effmass.paper.protocol import ALONG_X, ALONG_Y, OBLIQUE
from scara_effmass.paper.scara import matrix_masses, relative_error
from scara_effmass.paper.workspace import equal_area_poses, joint_grid

if TYPE_CHECKING:
    from collections.abc import Iterator

    from scara_effmass.model.dynamics import RobotDynamics
    from scara_effmass.paper.claim import Claim
    from scara_effmass.paper.density import MassDistribution
    from scara_effmass.paper.scara import Scara

EQUAL = 1e-9
"""Relative rounding error between two ways to the same number."""
SEARCH_STEPS = 721
QUILL_M = (0.0, 0.236, 0.45)


def mass_claims(dynamics: RobotDynamics, scara: Scara) -> Iterator[Claim]:
    """Yield the claims of sections 3.2 and 4.1."""
    yield from _extremes(scara)
    yield _independent_of_quill(dynamics, scara)
    yield from _density(scara, workspace_distribution(scara))
    yield from _errors(scara)


def _extremes(scara: Scara) -> Iterator[Claim]:
    """Search the extremes over a full turn, independent of where the paper puts them."""
    turn = np.radians(np.linspace(-180.0, 180.0, SEARCH_STEPS))
    step = float(np.degrees(turn[1] - turn[0]))
    q1, phi = np.meshgrid(np.radians(np.arange(-130.0, 131.0, 20.0)), (ALONG_X, OBLIQUE, ALONG_Y), indexing="ij")
    masses = scara.lumped(q1[..., None], turn, phi[..., None])
    lightest = turn[np.argmin(masses, axis=-1)]
    text = "smallest effective mass at q₂ = -q₁ + φ + π/2"
    yield Statement("minimum_at", "§4.1, Fig. 6", text).at_most(
        float(np.degrees(np.abs(np.sin(lightest + q1 - phi - np.pi / 2.0))).max()),
        step,
        "deg",
        f"found by search over q₂ in steps of {step:g}°, for {q1.size} pairs of q₁ and φ; the bound is one step",
    )
    at_minimum = scara.lumped(q1, -q1 + phi + np.pi / 2.0, phi)
    yield Statement("minimum_is_m3", "§4.1", "there it is M₃, and nowhere smaller").at_most(
        float(max(np.abs(at_minimum / scara.m3 - 1.0).max(), 1.0 - masses.min() / scara.m3)),
        EQUAL,
        note="relative difference from M₃ there, or how far the search found less",
    )
    q2, phi = np.meshgrid(np.radians(np.arange(10.0, 150.0, 10.0)), (ALONG_X, OBLIQUE, ALONG_Y), indexing="ij")
    masses = scara.lumped(turn, q2[..., None], phi[..., None])
    heaviest = turn[np.argmax(masses, axis=-1)]
    yield Statement("maximum_at", "§4.1, Eq. 30", "largest effective mass at q₂ = -q₁ + φ").at_most(
        float(np.degrees(np.abs(np.sin(heaviest + q2 - phi))).max()),
        step,
        "deg",
        "holds at each q₂, with q₁ turning; along q₂ at fixed q₁ the largest value lies elsewhere",
    )
    at_maximum = scara.lumped(phi - q2, q2, phi)
    yield Statement("maximum_is_eq_30", "Eq. 30", "there it is a function of q₂ alone").at_most(
        float(np.abs(at_maximum / scara_max_lumped_mass(q2, scara.m2, scara.m3) - 1.0).max()),
        EQUAL,
        note="relative difference of Eq. 28 from M₃ + M₂ / sin² q₂, which never is below M₂ + M₃",
    )
    singular = float(scara.lumped(0.0, 0.0, ALONG_X))
    yield Statement("singularity", "§4.1", "infinite at φ = q₁ = q₂ = 0").holds(
        "infinite" if np.isinf(singular) else f"{singular:g} kg",
        "infinite",
        "maps are coloured up to the top of their scale; the 50 by 50 grid has no such pose on it",
        met=bool(np.isposinf(singular)),
    )


def _independent_of_quill(dynamics: RobotDynamics, scara: Scara) -> Claim:
    poses = equal_area_poses(scara, count=8)
    masses = [np.concatenate(matrix_masses(dynamics, *poses, OBLIQUE, q3)) for q3 in QUILL_M]
    return Statement("independent_of_q3", "§3.2", "independent of q₃ along a horizontal normal").at_most(
        float(max(np.abs(mass / masses[0] - 1.0).max() for mass in masses)),
        EQUAL,
        note=f"largest relative change over q₃ = {', '.join(f'{q3:g}' for q3 in QUILL_M)} m, by the mass matrices",
    )


def _density(scara: Scara, whole: MassDistribution) -> Iterator[Claim]:
    sampled, below = sampled_distribution(scara), whole.below(scara.iso_mass)
    yield Statement("share_below_iso", "Fig. 8", "more than 70 % of 2500 positions below 2.77 kg").more_than(
        100.0 * sampled.below(scara.iso_mass),
        70.0,
        "%",
        f"over the whole workspace {below:.1%}; so {1.0 - below:.0%} lie above, where the standard's mass is not "
        "conservative",
    )
    for name, value, exact in (("mean", sampled.mean, whole.mean), ("median", sampled.median, whole.median)):
        yield Statement(f"{name}_below_iso", "Fig. 8", f"the standard's mass lies above the {name}").at_most(
            value,
            scara.iso_mass,
            "kg",
            f"the paper prints no number for the {name}; over the whole workspace it is {exact:.3f} kg",
        )
    peaks = density_peaks(whole)
    yield Statement("bimodal", "Fig. 8", "two peaks").holds(
        f"{len(peaks)} peaks: " + ", ".join(f"{peak:.2f}" for peak in peaks) + " kg",
        "2 peaks in a histogram of 0.1 kg",
        f"at M₃ = {scara.m3:.2f} and M₂ + M₃ = {scara.m2 + scara.m3:.2f} kg",
        met=len(peaks) == 2,
    )


def _errors(scara: Scara) -> Iterator[Claim]:
    poses = joint_grid(scara)
    full, simplified = scara.full(*poses), scara.lumped(*poses)
    error = relative_error(full, simplified)
    sign = "larger" if np.all(simplified > full) else "smaller" if np.all(simplified < full) else "not on one side"
    yield Statement(
        "worst_error", "Fig. 9", "error in effective mass reaches 10 % in the worst case", Basis.FITTED
    ).near(
        float(error.max()),
        10.0,
        0.5,
        "%",
        f"on the 50 by 50 grid; the simplified mass is {sign} everywhere, a sign that the fit does not determine",
    )
    yield Statement("error_in_75_percent", "Fig. 9", "error at most 6 % in 75 % of the cases", Basis.FITTED).at_most(
        float(np.percentile(error, 75.0)),
        6.0,
        "%",
        f"75th percentile; {np.mean(error <= 6.0):.1%} of the grid lies within 6 %",
    )
