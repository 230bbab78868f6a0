# SPDX-License-Identifier: Apache-2.0
"""The paper's statements, compared with this project's results."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from scara_effmass.iso15066 import reduced_mass
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import DaqSettings
from scara_effmass.sim.motion import ElbowConfig
from scara_effmass.studies.runs import (
    REPETITIONS,
    SPEED,
    RecordedRun,
    mean_peaks,
    origin,
    points_by_mass,
    root_reduced_mass,
)
from scara_effmass.studies.scara import (
    ALONG_X,
    ALONG_Y,
    OBLIQUE,
    OBSTACLES_KG,
    SHOWN_OBSTACLE_KG,
    Scara,
    density_peaks,
    equal_area_poses,
    joint_grid,
    matrix_masses,
    max_difference,
    relative_error,
    sampled_distribution,
    scara_max_lumped_mass,
    workspace_distribution,
)

ROUNDING_KG = 0.005
EQUAL = 1e-9
"""Largest relative rounding error between two ways to compute the same number."""
SEARCH_STEPS = 721
QUILL_M = (0.0, 0.236, 0.45)
MIN_CORRELATION = 0.99
"""Pearson's r of an agreement, chosen here: the paper shows curves and prints no number."""


class Basis(str, Enum):
    """What an agreement proves; the page explains it."""

    GIVEN = "given"
    FITTED = "fitted"
    RESULT = "result"


class Outcome(str, Enum):
    """Result of the comparison."""

    MATCH = "match"
    NO_MATCH = "no match"
    NOT_CHECKED = "not checked"


@dataclass(frozen=True, slots=True)
class Claim:
    """A statement `paper` at `where` in the paper, our result `ours`, and the `rule` for a match.

    A new claim is not checked; its methods return a copy that is compared with a result. NaN never matches. `value`
    [`unit`] is the number in `ours`, None without a finite one; `basis` is None if nothing was checked.
    """

    key: str
    where: str
    paper: str
    basis: Basis | None = Basis.RESULT
    ours: str = ""
    value: float | None = None
    unit: str = ""
    rule: str = ""
    outcome: Outcome = Outcome.NOT_CHECKED
    note: str = ""

    def near(self, value: float, expected: float, tolerance: float, unit: str = "", note: str = "") -> Claim:
        """Return the claim, which matches if `value` is within `tolerance` of `expected`."""
        rule = f"within {_quantity(tolerance, unit)} of {_quantity(expected, unit)}"
        return self._compared(value, unit, rule, note, met=abs(value - expected) <= tolerance)

    def at_most(self, value: float, bound: float, unit: str = "", note: str = "") -> Claim:
        """Return the claim, which matches if `value` does not exceed `bound`."""
        return self._compared(value, unit, f"at most {_quantity(bound, unit)}", note, met=value <= bound)

    def more_than(self, value: float, bound: float, unit: str = "", note: str = "") -> Claim:
        """Return the claim, which matches if `value` exceeds `bound`."""
        return self._compared(value, unit, f"more than {_quantity(bound, unit)}", note, met=value > bound)

    def holds(self, ours: str, rule: str, note: str = "", *, met: bool) -> Claim:
        """Return the claim with a result that is no single number; it matches if `met`."""
        return replace(self, ours=ours, rule=rule, note=note, outcome=Outcome.MATCH if met else Outcome.NO_MATCH)

    def not_checked(self, reason: str) -> Claim:
        """Return the claim as one that cannot be checked here."""
        return replace(self, basis=None, note=reason)

    def _compared(self, value: float, unit: str, rule: str, note: str, *, met: bool) -> Claim:
        claim = self.holds(_quantity(value, unit), rule, note, met=met)
        return replace(claim, value=value if math.isfinite(value) else None, unit=unit)


def _quantity(value: float, unit: str) -> str:
    number = f"{value:.0f}" if abs(value) >= 1e4 else f"{value:.4g}"
    return f"{number} {unit}".rstrip()


def all_claims(
    dynamics: RobotDynamics, scara: Scara, shown_run: RecordedRun, runs: Sequence[RecordedRun]
) -> Iterator[Claim]:
    """Yield all claims; claims about the motion are compared with `shown_run`."""
    yield from robot_claims(scara)
    yield from mass_claims(dynamics, scara)
    yield from reduced_mass_claims(scara)
    yield from run_claims(scara, shown_run, runs)


def robot_claims(scara: Scara) -> Iterator[Claim]:
    """Yield the claims of sections 3.1, 4.1, 4.2 and 5 about the robot and the force measurement."""
    for key, symbol, printed, value in (
        ("m2", "M₂", 2.38, scara.m2),
        ("m3", "M₃", 0.97, scara.m3),
        ("iso_mass", "m_R", 2.77, scara.iso_mass),
    ):
        claim = Claim(key, "§4.1", f"{symbol} = {printed} kg", Basis.FITTED)
        yield claim.near(value, printed, ROUNDING_KG, "kg")
    for obstacle, printed in zip(OBSTACLES_KG, (0.42, 1.28, 1.59, 2.01), strict=True):
        claim = Claim(f"mu_iso_{obstacle:g}", "§4.2", f"µ_ISO = {printed:g} kg for m_H = {obstacle:g} kg")
        mu = reduced_mass(scara.iso_mass, obstacle)
        yield claim.near(mu, printed, ROUNDING_KG, "kg", "follows from m_R and m_H")
    masses = ", ".join(f"{mass:.3f}" for mass in scara.aggregated)
    count = len(scara.aggregated)
    yield Claim("lumped_masses", "§3.1", "five aggregated masses, the first one at rest, four moving").holds(
        f"{count} masses, of which {count - 1} move: {masses} kg",
        "5 masses, none negative",
        "the count follows from the construction; the values of Table II are not in our copy of the paper",
        met=count == 5 and min(scara.aggregated) >= 0.0,
    )
    yield Claim("lumped_masses_tm5", "Fig. 1", "seven aggregated masses for a six-axis TM5-700").not_checked(
        "the construction here covers parallel axes only, so this robot is not lumped"
    )
    for key, symbol, printed, limit in (
        ("q1_range", "q₁", 136.0, scara.q1_max),
        ("q2_range", "q₂", 148.0, scara.q2_max),
    ):
        claim = Claim(key, "§4.1", f"{symbol} within ±{printed:g}°", Basis.GIVEN)
        yield claim.near(float(np.degrees(limit)), printed, 0.01, "deg")
    settings = DaqSettings()
    sensor, rate = settings.sensor, settings.ni9230.sample_rate
    claim = Claim("sensitivity", "§5", "sensitivity of the force sensor 208C03: 2.224 mV/kN", Basis.GIVEN)
    note = "nominal is 10 mV/lbf = 2.248 mV/N; 2.224 is the sensor's range in kN, and tolerance is the maker's 15 %"
    yield claim.near(1e3 * sensor.sensitivity, 2.224, 2.224 * sensor.sensitivity_uncertainty, "mV/kN", note)
    yield Claim("sample_rate", "§5", "12 800 samples per second", Basis.GIVEN).near(rate, 12_800.0, 0.5, "Hz")
    text = "10 000 samples per record (0.78125 s at 12 800 Hz)"
    yield Claim("record_length", "§5", text, Basis.GIVEN).near(10_000 / rate, 0.78125, 1e-5, "s")


def mass_claims(dynamics: RobotDynamics, scara: Scara) -> Iterator[Claim]:
    """Yield the claims of sections 3.2 and 4.1; extremes are searched over a full turn."""
    turn = np.radians(np.linspace(-180.0, 180.0, SEARCH_STEPS))
    step = float(np.degrees(turn[1] - turn[0]))
    q1, phi = np.meshgrid(np.radians(np.arange(-130.0, 131.0, 20.0)), (ALONG_X, OBLIQUE, ALONG_Y), indexing="ij")
    masses = scara.lumped(q1[..., None], turn, phi[..., None])
    lightest = turn[np.argmin(masses, axis=-1)]
    angle = float(np.degrees(np.abs(np.sin(lightest + q1 - phi - np.pi / 2.0))).max())
    note = f"found by search over q₂ in steps of {step:g}°, for {q1.size} pairs of q₁ and φ; the bound is one step"
    claim = Claim("minimum_at", "§4.1, Fig. 6", "smallest effective mass at q₂ = -q₁ + φ + π/2")
    yield claim.at_most(angle, step, "deg", note)
    at_minimum = scara.lumped(q1, -q1 + phi + np.pi / 2.0, phi)
    difference = max(max_difference(at_minimum, scara.m3), 1.0 - float(masses.min()) / scara.m3)
    note = "relative difference from M₃ there, or how far the search found less"
    yield Claim("minimum_is_m3", "§4.1", "there it is M₃, and nowhere smaller").at_most(difference, EQUAL, note=note)
    q2, phi = np.meshgrid(np.radians(np.arange(10.0, 150.0, 10.0)), (ALONG_X, OBLIQUE, ALONG_Y), indexing="ij")
    heaviest = turn[np.argmax(scara.lumped(turn, q2[..., None], phi[..., None]), axis=-1)]
    angle = float(np.degrees(np.abs(np.sin(heaviest + q2 - phi))).max())
    note = "holds at each q₂, with q₁ turning; along q₂ at fixed q₁ the largest value lies elsewhere"
    claim = Claim("maximum_at", "§4.1, Eq. 30", "largest effective mass at q₂ = -q₁ + φ")
    yield claim.at_most(angle, step, "deg", note)
    difference = max_difference(scara.lumped(phi - q2, q2, phi), scara_max_lumped_mass(q2, scara.m2, scara.m3))
    note = "relative difference of Eq. 28 from M₃ + M₂ / sin² q₂, which never is below M₂ + M₃"
    yield Claim("maximum_is_eq_30", "Eq. 30", "there it is a function of q₂ alone").at_most(
        difference, EQUAL, note=note
    )
    singular = float(scara.lumped(0.0, 0.0, ALONG_X))
    yield Claim("singularity", "§4.1", "infinite at φ = q₁ = q₂ = 0").holds(
        "infinite" if np.isinf(singular) else f"{singular:g} kg",
        "infinite",
        "maps are coloured up to the top of their scale; the 50 by 50 grid has no such pose on it",
        met=bool(np.isposinf(singular)),
    )
    poses = equal_area_poses(scara, count=8)
    by_quill = [np.concatenate(matrix_masses(dynamics, *poses, OBLIQUE, q3)) for q3 in QUILL_M]
    difference = max(max_difference(mass, by_quill[0]) for mass in by_quill)
    note = f"largest relative change over q₃ = {', '.join(f'{q3:g}' for q3 in QUILL_M)} m, by the mass matrices"
    claim = Claim("independent_of_q3", "§3.2", "independent of q₃ along a horizontal normal")
    yield claim.at_most(difference, EQUAL, note=note)
    yield from _density_claims(scara)
    full, simplified = scara.full(*joint_grid(scara)), scara.lumped(*joint_grid(scara))
    error = relative_error(full, simplified)
    sign = "larger" if np.all(simplified > full) else "smaller" if np.all(simplified < full) else "not on one side"
    note = f"on the 50 by 50 grid; the simplified mass is {sign} everywhere, a sign that the fit does not determine"
    claim = Claim("worst_error", "Fig. 9", "error in effective mass reaches 10 % in the worst case", Basis.FITTED)
    yield claim.near(float(error.max()), 10.0, 0.5, "%", note)
    note = f"75th percentile; {np.mean(error <= 6.0):.1%} of the grid lies within 6 %"
    claim = Claim("error_in_75_percent", "Fig. 9", "error at most 6 % in 75 % of the cases", Basis.FITTED)
    yield claim.at_most(float(np.percentile(error, 75.0)), 6.0, "%", note)


def _density_claims(scara: Scara) -> Iterator[Claim]:
    sampled, whole = sampled_distribution(scara), workspace_distribution(scara)
    below = whole.below(scara.iso_mass)
    note = f"over the whole workspace {below:.1%}; so {1.0 - below:.0%} lie above, where the standard's mass is not"
    claim = Claim("share_below_iso", "Fig. 8", "more than 70 % of 2500 positions below 2.77 kg")
    yield claim.more_than(100.0 * sampled.below(scara.iso_mass), 70.0, "%", f"{note} conservative")
    for name, value, exact in (("mean", sampled.mean, whole.mean), ("median", sampled.median, whole.median)):
        note = f"the paper prints no number for the {name}; over the whole workspace it is {exact:.3f} kg"
        claim = Claim(f"{name}_below_iso", "Fig. 8", f"the standard's mass lies above the {name}")
        yield claim.at_most(value, scara.iso_mass, "kg", note)
    peaks = density_peaks(whole)
    yield Claim("bimodal", "Fig. 8", "two peaks").holds(
        f"{len(peaks)} peaks: " + ", ".join(f"{peak:.2f}" for peak in peaks) + " kg",
        "2 peaks in a histogram of 0.1 kg",
        f"at M₃ = {scara.m3:.2f} and M₂ + M₃ = {scara.m2 + scara.m3:.2f} kg",
        met=len(peaks) == 2,
    )


def reduced_mass_claims(scara: Scara) -> Iterator[Claim]:
    """Yield the claims of section 4.2."""
    poses = joint_grid(scara)
    lumped, full = scara.lumped(*poses), scara.full(*poses)
    mu = [reduced_mass(lumped, obstacle) for obstacle in OBSTACLES_KG]
    singular = scara.lumped(0.0, 0.0, ALONG_X)
    limits = [float(reduced_mass(singular, obstacle)) for obstacle in OBSTACLES_KG]
    never_more = all(values.max() <= obstacle for values, obstacle in zip(mu, OBSTACLES_KG, strict=True))
    text = "µ tends to m_H where the effective mass tends to infinity, and never diverges"
    yield Claim("mu_limit", "§4.2", text).holds(
        ", ".join(f"{limit:g}" for limit in limits) + " kg in the singular pose",
        "exactly m_H there, and nowhere more",
        met=limits == list(OBSTACLES_KG) and never_more,
    )
    spans = [float(np.ptp(values)) for values in mu]
    ours = ", ".join(f"{span:.2f}" for span in spans) + " kg wide"
    claim = Claim("narrow_range", "Fig. 10", "the smaller the obstacle's mass, the narrower the range of µ")
    yield claim.holds(ours, "widths in the order of m_H", met=spans == sorted(spans))
    errors = [
        float(relative_error(reduced_mass(full, obstacle), values).max())
        for values, obstacle in zip(mu, OBSTACLES_KG, strict=True)
    ]
    note = f"largest for each m_H on the 50 by 50 grid: {', '.join(f'{error:.2f}' for error in errors)} %"
    claim = Claim("worst_reduced_error", "Fig. 11", "error in reduced mass at most 5 %", Basis.FITTED)
    yield claim.at_most(max(errors), 5.0, "%", note)
    difference = max(max_difference(scara.lumped(poses.q1 + phi, poses.q2, phi), lumped) for phi in (ALONG_Y, OBLIQUE))
    text = "turning the normal and q₁ by the same angle leaves the masses as they are"
    yield Claim("turned_values", "Figs. 12, 13", text).at_most(difference, EQUAL, note="largest relative difference")
    along_x, along_y = (workspace_distribution(scara, phi).below(scara.iso_mass) for phi in (ALONG_X, ALONG_Y))
    text = "the plots along y and obliquely equal the one along x, only turned"
    note = (
        "share of the workspace below the ISO standard's value, along y against along x: the values turn with the "
        "normal, the workspace does not, because q₁ ends at ±136°"
    )
    yield Claim("turned_plots", "Fig. 12", text).near(100.0 * along_y, 100.0 * along_x, 1.0, "%", note)
    left = scara.lumped(*joint_grid(scara, ElbowConfig.LEFT))
    note = f"largest relative difference at poses mirrored in the x axis; figure for m_H = {SHOWN_OBSTACLE_KG:g} kg"
    claim = Claim("left_arm", "Fig. 14", "the left arm's masses mirror the right arm's at the normal")
    yield claim.at_most(max_difference(left[::-1], lumped), EQUAL, note=note)


def run_claims(scara: Scara, shown_run: RecordedRun, runs: Sequence[RecordedRun]) -> Iterator[Claim]:
    """Yield the claims of section 5 about `shown_run` (Fig. 17) and all `runs` (Figs. 18 and 19)."""
    note = f"{shown_run.source}, which was generated with this value"
    speed = Claim("speed", "§5, Fig. 17", "250 mm/s at the impact", Basis.GIVEN)
    yield speed.near(1e3 * shown_run.speed, 1e3 * SPEED, 2.5, "mm/s", note)
    midpoint = Claim("midpoint", "§5, Fig. 17", "impact at mid-path", Basis.GIVEN)
    yield midpoint.near(shown_run.path_share, 0.5, 0.01, note=note)

    kind = f"{origin(runs)} impacts"
    peaks = mean_peaks(runs)
    points = points_by_mass(scara, runs)
    counts = [sum((run.point, run.obstacle_mass) == case for run in runs) for case in peaks]
    least, most = min(counts), max(counts)
    yield Claim("repetitions", "§5", "three tests per case", Basis.GIVEN).holds(
        f"{least} in each of {len(counts)} cases" if least == most else f"{least} to {most} in {len(counts)} cases",
        f"{REPETITIONS} in each",
        kind,
        met=set(counts) == {REPETITIONS},
    )
    by_point = [[peaks[point, mass] for mass in OBSTACLES_KG if (point, mass) in peaks] for point in points]
    by_mass = [[peaks[point, mass] for point in points if (point, mass) in peaks] for mass in OBSTACLES_KG]
    for key, text, series in (
        ("force_grows", "the force grows with m_H in every configuration", by_point),
        ("force_order", "the configurations are in the order of √µ", by_mass),
    ):
        steps = np.concatenate([np.diff(forces) for forces in series])
        rising = int(np.sum(steps > 0.0))
        ours, met = f"{rising} of {steps.size} steps rise", rising == steps.size > 0
        yield Claim(key, "Fig. 19", text).holds(ours, "every step rises", kind, met=met)
    proportional = Claim("force_proportional", "Fig. 19", "mean peak force proportional to √µ")
    roots = np.array([root_reduced_mass(scara, *case) for case in peaks])
    forces = np.array(list(peaks.values()))
    if len(forces) < 3 or np.ptp(roots) == 0.0:
        yield proportional.not_checked(f"{len(forces)} cases are too few")
        return
    slope = float(forces @ roots / (roots @ roots))
    note = (
        f"Pearson's r over {len(forces)} cases of {kind}; farthest from the line through the origin: "
        f"{max_difference(forces, slope * roots):.1%}; bound chosen here, the paper prints none"
    )
    yield proportional.more_than(float(np.corrcoef(roots, forces)[0, 1]), MIN_CORRELATION, note=note)
