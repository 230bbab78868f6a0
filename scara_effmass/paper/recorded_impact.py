"""One impact of the experiment, measured or simulated."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from scara_effmass.iso15066 import reduced_mass
from scara_effmass.paper.protocol import ALONG_X
from scara_effmass.paper.scara import Scara
from scara_effmass.sim.motion import ElbowConfig, inverse_kinematics
from scara_effmass.values import FloatArray

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class RecordedImpact:
    """An impact of the right arm on the cart along x, the tool at `point` (x, y) [m].

    `point` and `obstacle_mass_kg` are nominal, equal in all repetitions. `time_s` (n,) is 0 at the onset; `force_n`
    (n,) is positive in compression, without tare and baseline.
    """

    point: Point
    obstacle_mass_kg: float
    speed_m_s: float
    peak_force_n: float
    time_s: FloatArray
    force_n: FloatArray
    simulated: bool


def mass_at(scara: Scara, point: Point) -> float:
    """Return m_n of the simplified model [kg], right arm, tool at `point`, along x (Eq. 28)."""
    q1, q2 = inverse_kinematics(np.array(point), ElbowConfig.RIGHT)
    return float(scara.lumped(q1, q2, ALONG_X))


def root_reduced_mass(scara: Scara, point: Point, obstacle_mass: float) -> float:
    """Return sqrt(mu) [sqrt(kg)] of the simplified model."""
    return float(np.sqrt(reduced_mass(mass_at(scara, point), obstacle_mass)))


def mean_peaks(runs: Iterable[RecordedImpact]) -> dict[tuple[Point, float], float]:
    """Return the mean peak force [N] over the repetitions, by impact point and obstacle mass."""
    peaks: dict[tuple[Point, float], list[float]] = {}
    for run in runs:
        peaks.setdefault((run.point, run.obstacle_mass_kg), []).append(run.peak_force_n)
    return {case: float(np.mean(forces)) for case, forces in peaks.items()}


def points_by_mass(scara: Scara, runs: Iterable[RecordedImpact]) -> list[Point]:
    """Return the impact points of `runs` by increasing effective mass."""
    return sorted({run.point for run in runs}, key=lambda point: mass_at(scara, point))


def origin(runs: Iterable[RecordedImpact]) -> str:
    """Return where the forces come from: measured, simulated, or in part simulated."""
    simulated = {run.simulated for run in runs}
    return "measured" if simulated == {False} else "simulated" if simulated == {True} else "in part simulated"
