"""Claims about the impact tests: Figs. 17 to 19."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from scara_effmass.paper.claim import Basis, holds, more_than, near, not_checked
from scara_effmass.paper.protocol import OBSTACLES_KG, REPETITIONS, SPEED
from scara_effmass.paper.recorded_impact import mean_peaks, origin, points_by_mass, root_reduced_mass

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from scara_effmass.paper.claim import Claim
    from scara_effmass.paper.motion import ToolMotion
    from scara_effmass.paper.recorded_impact import RecordedImpact
    from scara_effmass.paper.scara import Scara

NO_RUNS = "needs recorded impacts, and there are none here"
AGREEMENT = 0.99
"""Pearson's r that counts as agreement; the paper shows curves and prints no number."""
TESTS = "three tests per case"
GROWS = "the force grows with m_H in every configuration"
ORDER = "the configurations are in the order of √µ"
PROPORTIONAL = "mean peak force proportional to √µ"


def motion_claims(motion: ToolMotion) -> Iterator[Claim]:
    """Yield what Fig. 17 says."""
    speed = 1e3 * motion.contact_speed_m_s
    about = f"{motion.about}, which was made so"
    yield near("speed", "§5, Fig. 17", "250 mm/s at the impact", 1e3 * SPEED, speed, 2.5, "mm/s", Basis.GIVEN, about)
    share = motion.share_of_path
    yield near("midpoint", "§5, Fig. 17", "impact at mid-path", 0.5, share, 0.01, "", Basis.GIVEN, about)


def run_claims(scara: Scara, runs: Sequence[RecordedImpact]) -> Iterator[Claim]:
    """Yield what Figs. 18 and 19 say; without runs, that it was not checked."""
    if not runs:
        for key, where, paper in (
            ("repetitions", "§5", TESTS),
            ("force_grows", "Fig. 19", GROWS),
            ("force_order", "Fig. 19", ORDER),
            ("force_proportional", "Fig. 19", PROPORTIONAL),
        ):
            yield not_checked(key, where, paper, NO_RUNS)
        return
    kind = f"{origin(runs)} impacts"
    peaks = mean_peaks(runs)
    points = points_by_mass(scara, runs)
    counts = {cell: sum((run.point, run.obstacle_mass_kg) == cell for run in runs) for cell in peaks}
    least, most = min(counts.values()), max(counts.values())
    yield holds(
        "repetitions",
        "§5",
        TESTS,
        f"{least} in each of {len(counts)} cases" if least == most else f"{least} to {most} in {len(counts)} cases",
        f"{REPETITIONS} in each",
        Basis.GIVEN,
        kind,
        met=set(counts.values()) == {REPETITIONS},
    )
    by_point = [[peaks[point, mass] for mass in OBSTACLES_KG if (point, mass) in peaks] for point in points]
    by_mass = [[peaks[point, mass] for point in points if (point, mass) in peaks] for mass in OBSTACLES_KG]
    for key, paper, series in (("force_grows", GROWS, by_point), ("force_order", ORDER, by_mass)):
        pairs = sum(max(len(each) - 1, 0) for each in series)
        rising = sum(int(np.sum(np.diff(each) > 0.0)) for each in series if each)
        yield holds(
            key,
            "Fig. 19",
            paper,
            f"{rising} of {pairs} steps rise",
            "every step rises",
            Basis.RESULT,
            kind,
            met=rising == pairs > 0,
        )
    roots = np.array([root_reduced_mass(scara, *cell) for cell in peaks])
    forces = np.array(list(peaks.values()))
    if len(forces) < 3 or np.ptp(roots) == 0.0:
        yield not_checked("force_proportional", "Fig. 19", PROPORTIONAL, f"{len(forces)} cases are too few")
        return
    slope = float(forces @ roots / (roots @ roots))
    worst = float(np.abs(forces / (slope * roots) - 1.0).max())
    yield more_than(
        "force_proportional",
        "Fig. 19",
        PROPORTIONAL,
        AGREEMENT,
        float(np.corrcoef(roots, forces)[0, 1]),
        "",
        Basis.RESULT,
        f"Pearson's r over {len(forces)} cases of {kind}; farthest from the line through the origin: {worst:.1%}; "
        f"bound chosen here, the paper prints none",
    )
