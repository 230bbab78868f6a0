"""One impact of the experiment, measured or simulated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from scara_effmass.iso15066 import reduced_mass
from scara_effmass.paper.protocol import ALONG_X
from scara_effmass.sim.scara_kinematics import ElbowConfig, inverse_kinematics

if TYPE_CHECKING:
    from collections.abc import Iterable

    from scara_effmass.paper.scara import Scara
    from scara_effmass.values import FloatArray


@dataclass(frozen=True, slots=True)
class RecordedImpact:
    """The right arm hits the cart along x, the tool at `point` (x, y) [m].

    `point` and `obstacle_mass_kg` are the nominal ones, alike in all repetitions. `time_s` (n,) is 0 at the onset;
    `force_n` (n,) is positive in compression, without tare and baseline.
    """

    point: tuple[float, float]
    obstacle_mass_kg: float
    speed_m_s: float
    peak_force_n: float
    time_s: FloatArray
    force_n: FloatArray
    simulated: bool


def mass_at(scara: Scara, point: tuple[float, float]) -> float:
    """Return m_n of the simplified model [kg], right arm, tool at `point`, along x (Eq. 28)."""
    q1, q2 = inverse_kinematics(np.array(point), ElbowConfig.RIGHT)
    return float(scara.lumped(q1, q2, ALONG_X))


def root_reduced_mass(scara: Scara, point: tuple[float, float], obstacle_mass: float) -> float:
    """Return sqrt(mu) [sqrt(kg)] of the simplified model."""
    return float(np.sqrt(reduced_mass(mass_at(scara, point), obstacle_mass)))


def mean_peaks(runs: Iterable[RecordedImpact]) -> dict[tuple[tuple[float, float], float], float]:
    """Return the mean peak force [N] over the repetitions, by impact point and obstacle mass."""
    found: dict[tuple[tuple[float, float], float], list[float]] = {}
    for run in runs:
        found.setdefault((run.point, run.obstacle_mass_kg), []).append(run.peak_force_n)
    return {cell: float(np.mean(forces)) for cell, forces in found.items()}


def points_by_mass(scara: Scara, runs: Iterable[RecordedImpact]) -> list[tuple[float, float]]:
    """Return the impact points of `runs`, the one with the smallest effective mass first."""
    return sorted({run.point for run in runs}, key=lambda point: mass_at(scara, point))


def origin(runs: Iterable[RecordedImpact]) -> str:
    """Return in a word where the forces come from."""
    kinds = {run.simulated for run in runs}
    return "measured" if kinds == {False} else "simulated" if kinds == {True} else "in part simulated"
