"""Claims about the impact tests: Figs. 17 to 19."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from scara_effmass.paper.claim import Basis, Claim
from scara_effmass.paper.protocol import OBSTACLES_KG, REPETITIONS, SPEED
from scara_effmass.paper.recorded_impact import RecordedImpact, mean_peaks, origin, points_by_mass, root_reduced_mass
from scara_effmass.paper.scara import Scara

if TYPE_CHECKING:
    from scara_effmass.paper.motion import ToolMotion

MIN_CORRELATION = 0.99
"""Pearson's r of an agreement, chosen here: the paper shows curves and prints no number."""
REPEATED = Claim("repetitions", "§5", "three tests per case", Basis.GIVEN)
GROWS = Claim("force_grows", "Fig. 19", "the force grows with m_H in every configuration")
ORDERED = Claim("force_order", "Fig. 19", "the configurations are in the order of √µ")
PROPORTIONAL = Claim("force_proportional", "Fig. 19", "mean peak force proportional to √µ")


def motion_claims(motion: ToolMotion) -> Iterator[Claim]:
    """Yield the claims of Fig. 17."""
    note = f"{motion.source}, which was generated with this value"
    yield Claim("speed", "§5, Fig. 17", "250 mm/s at the impact", Basis.GIVEN).near(
        1e3 * motion.contact_speed_m_s, 1e3 * SPEED, 2.5, "mm/s", note
    )
    yield Claim("midpoint", "§5, Fig. 17", "impact at mid-path", Basis.GIVEN).near(
        motion.path_share, 0.5, 0.01, note=note
    )


def run_claims(scara: Scara, runs: Sequence[RecordedImpact]) -> Iterator[Claim]:
    """Yield the claims of Figs. 18 and 19; without `runs` they are not checked."""
    if not runs:
        for claim in (REPEATED, GROWS, ORDERED, PROPORTIONAL):
            yield claim.not_checked("needs recorded impacts, and there are none here")
        return
    kind = f"{origin(runs)} impacts"
    peaks = mean_peaks(runs)
    points = points_by_mass(scara, runs)
    counts = [sum((run.point, run.obstacle_mass_kg) == case for run in runs) for case in peaks]
    least, most = min(counts), max(counts)
    yield REPEATED.holds(
        f"{least} in each of {len(counts)} cases" if least == most else f"{least} to {most} in {len(counts)} cases",
        f"{REPETITIONS} in each",
        kind,
        met=set(counts) == {REPETITIONS},
    )
    by_point = [[peaks[point, mass] for mass in OBSTACLES_KG if (point, mass) in peaks] for point in points]
    by_mass = [[peaks[point, mass] for point in points if (point, mass) in peaks] for mass in OBSTACLES_KG]
    for claim, series in ((GROWS, by_point), (ORDERED, by_mass)):
        steps = np.concatenate([np.diff(forces) for forces in series])
        rising = int(np.sum(steps > 0.0))
        yield claim.holds(
            f"{rising} of {steps.size} steps rise", "every step rises", kind, met=rising == steps.size > 0
        )
    roots = np.array([root_reduced_mass(scara, *case) for case in peaks])
    forces = np.array(list(peaks.values()))
    if len(forces) < 3 or np.ptp(roots) == 0.0:
        yield PROPORTIONAL.not_checked(f"{len(forces)} cases are too few")
        return
    slope = float(forces @ roots / (roots @ roots))
    max_deviation = float(np.abs(forces / (slope * roots) - 1.0).max())
    yield PROPORTIONAL.more_than(
        float(np.corrcoef(roots, forces)[0, 1]),
        MIN_CORRELATION,
        note=f"Pearson's r over {len(forces)} cases of {kind}; farthest from the line through the origin: "
        f"{max_deviation:.1%}; bound chosen here, the paper prints none",
    )
