"""Claims about effective and reduced mass: Figs. 6 to 15."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from scara_effmass.iso15066 import reduced_mass
from scara_effmass.model.scara_closed_form import scara_max_lumped_mass
from scara_effmass.paper.claim import Basis, Claim
from scara_effmass.paper.density import MassDistribution, density_peaks, sampled_distribution, workspace_distribution
from scara_effmass.paper.protocol import ALONG_X, ALONG_Y, OBLIQUE, OBSTACLES_KG, SHOWN_OBSTACLE_KG
from scara_effmass.paper.scara import Scara, matrix_masses, relative_error
from scara_effmass.paper.workspace import equal_area_poses, joint_grid
from scara_effmass.sim.motion import ElbowConfig
from scara_effmass.values import FloatArray

if TYPE_CHECKING:
    from scara_effmass.model.dynamics import RobotDynamics

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


def reduced_mass_claims(scara: Scara) -> Iterator[Claim]:
    """Yield the claims of section 4.2."""
    poses = joint_grid(scara)
    lumped, full = scara.lumped(*poses), scara.full(*poses)
    mu = [reduced_mass(lumped, obstacle) for obstacle in OBSTACLES_KG]
    singular = scara.lumped(0.0, 0.0, ALONG_X)
    limits = [float(reduced_mass(singular, obstacle)) for obstacle in OBSTACLES_KG]
    text = "µ tends to m_H where the effective mass tends to infinity, and never diverges"
    yield Claim("mu_limit", "§4.2", text).holds(
        ", ".join(f"{limit:g}" for limit in limits) + " kg in the singular pose",
        "exactly m_H there, and nowhere more",
        met=limits == list(OBSTACLES_KG)
        and all(float(values.max()) <= obstacle for values, obstacle in zip(mu, OBSTACLES_KG, strict=True)),
    )
    spans = [float(np.ptp(values)) for values in mu]
    text = "the smaller the obstacle's mass, the narrower the range of µ"
    yield Claim("narrow_range", "Fig. 10", text).holds(
        ", ".join(f"{span:.2f}" for span in spans) + " kg wide",
        "widths in the order of m_H",
        met=spans == sorted(spans),
    )
    errors = [
        float(relative_error(reduced_mass(full, obstacle), values).max())
        for values, obstacle in zip(mu, OBSTACLES_KG, strict=True)
    ]
    text = "error in reduced mass at most 5 %"
    yield Claim("worst_reduced_error", "Fig. 11", text, Basis.FITTED).at_most(
        max(errors),
        5.0,
        "%",
        "largest for each m_H on the 50 by 50 grid: " + ", ".join(f"{error:.2f}" for error in errors) + " %",
    )
    text = "turning the normal and q₁ by the same angle leaves the masses as they are"
    yield Claim("turned_values", "Figs. 12, 13", text).at_most(
        max(_max_difference(scara.lumped(poses.q1 + phi, poses.q2, phi), lumped) for phi in (ALONG_Y, OBLIQUE)),
        EQUAL,
        note="largest relative difference",
    )
    along_x, along_y = (workspace_distribution(scara, phi).below(scara.iso_mass) for phi in (ALONG_X, ALONG_Y))
    text = "the plots along y and obliquely equal the one along x, only turned"
    yield Claim("turned_plots", "Fig. 12", text).near(
        100.0 * along_y,
        100.0 * along_x,
        1.0,
        "%",
        "share of the workspace below the ISO standard's value, along y against along x: the values turn with the "
        "normal, the workspace does not, because q₁ ends at ±136°",
    )
    left = scara.lumped(*joint_grid(scara, ElbowConfig.LEFT))
    text = "the left arm's masses mirror the right arm's at the normal"
    yield Claim("left_arm", "Fig. 14", text).at_most(
        _max_difference(left[::-1], lumped),
        EQUAL,
        note=f"largest relative difference at poses mirrored in the x axis; figure for m_H = {SHOWN_OBSTACLE_KG:g} kg",
    )


def _extremes(scara: Scara) -> Iterator[Claim]:
    """Search the extremes over a full turn, independent of where the paper puts them."""
    turn = np.radians(np.linspace(-180.0, 180.0, SEARCH_STEPS))
    step = float(np.degrees(turn[1] - turn[0]))
    q1, phi = np.meshgrid(np.radians(np.arange(-130.0, 131.0, 20.0)), (ALONG_X, OBLIQUE, ALONG_Y), indexing="ij")
    masses = scara.lumped(q1[..., None], turn, phi[..., None])
    lightest = turn[np.argmin(masses, axis=-1)]
    text = "smallest effective mass at q₂ = -q₁ + φ + π/2"
    yield Claim("minimum_at", "§4.1, Fig. 6", text).at_most(
        float(np.degrees(np.abs(np.sin(lightest + q1 - phi - np.pi / 2.0))).max()),
        step,
        "deg",
        f"found by search over q₂ in steps of {step:g}°, for {q1.size} pairs of q₁ and φ; the bound is one step",
    )
    at_minimum = scara.lumped(q1, -q1 + phi + np.pi / 2.0, phi)
    yield Claim("minimum_is_m3", "§4.1", "there it is M₃, and nowhere smaller").at_most(
        float(max(np.abs(at_minimum / scara.m3 - 1.0).max(), 1.0 - masses.min() / scara.m3)),
        EQUAL,
        note="relative difference from M₃ there, or how far the search found less",
    )
    q2, phi = np.meshgrid(np.radians(np.arange(10.0, 150.0, 10.0)), (ALONG_X, OBLIQUE, ALONG_Y), indexing="ij")
    masses = scara.lumped(turn, q2[..., None], phi[..., None])
    heaviest = turn[np.argmax(masses, axis=-1)]
    yield Claim("maximum_at", "§4.1, Eq. 30", "largest effective mass at q₂ = -q₁ + φ").at_most(
        float(np.degrees(np.abs(np.sin(heaviest + q2 - phi))).max()),
        step,
        "deg",
        "holds at each q₂, with q₁ turning; along q₂ at fixed q₁ the largest value lies elsewhere",
    )
    at_maximum = scara.lumped(phi - q2, q2, phi)
    yield Claim("maximum_is_eq_30", "Eq. 30", "there it is a function of q₂ alone").at_most(
        float(np.abs(at_maximum / scara_max_lumped_mass(q2, scara.m2, scara.m3) - 1.0).max()),
        EQUAL,
        note="relative difference of Eq. 28 from M₃ + M₂ / sin² q₂, which never is below M₂ + M₃",
    )
    singular = float(scara.lumped(0.0, 0.0, ALONG_X))
    yield Claim("singularity", "§4.1", "infinite at φ = q₁ = q₂ = 0").holds(
        "infinite" if np.isinf(singular) else f"{singular:g} kg",
        "infinite",
        "maps are coloured up to the top of their scale; the 50 by 50 grid has no such pose on it",
        met=bool(np.isposinf(singular)),
    )


def _independent_of_quill(dynamics: RobotDynamics, scara: Scara) -> Claim:
    poses = equal_area_poses(scara, count=8)
    masses = [np.concatenate(matrix_masses(dynamics, *poses, OBLIQUE, q3)) for q3 in QUILL_M]
    return Claim("independent_of_q3", "§3.2", "independent of q₃ along a horizontal normal").at_most(
        float(max(np.abs(mass / masses[0] - 1.0).max() for mass in masses)),
        EQUAL,
        note=f"largest relative change over q₃ = {', '.join(f'{q3:g}' for q3 in QUILL_M)} m, by the mass matrices",
    )


def _density(scara: Scara, whole: MassDistribution) -> Iterator[Claim]:
    sampled, below = sampled_distribution(scara), whole.below(scara.iso_mass)
    yield Claim("share_below_iso", "Fig. 8", "more than 70 % of 2500 positions below 2.77 kg").more_than(
        100.0 * sampled.below(scara.iso_mass),
        70.0,
        "%",
        f"over the whole workspace {below:.1%}; so {1.0 - below:.0%} lie above, where the standard's mass is not "
        "conservative",
    )
    for name, value, exact in (("mean", sampled.mean, whole.mean), ("median", sampled.median, whole.median)):
        yield Claim(f"{name}_below_iso", "Fig. 8", f"the standard's mass lies above the {name}").at_most(
            value,
            scara.iso_mass,
            "kg",
            f"the paper prints no number for the {name}; over the whole workspace it is {exact:.3f} kg",
        )
    peaks = density_peaks(whole)
    yield Claim("bimodal", "Fig. 8", "two peaks").holds(
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
    yield Claim("worst_error", "Fig. 9", "error in effective mass reaches 10 % in the worst case", Basis.FITTED).near(
        float(error.max()),
        10.0,
        0.5,
        "%",
        f"on the 50 by 50 grid; the simplified mass is {sign} everywhere, a sign that the fit does not determine",
    )
    yield Claim("error_in_75_percent", "Fig. 9", "error at most 6 % in 75 % of the cases", Basis.FITTED).at_most(
        float(np.percentile(error, 75.0)),
        6.0,
        "%",
        f"75th percentile; {np.mean(error <= 6.0):.1%} of the grid lies within 6 %",
    )


def _max_difference(values: FloatArray, reference: FloatArray) -> float:
    """Return the largest relative difference."""
    return float(np.abs(values / reference - 1.0).max())
