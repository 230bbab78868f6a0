# SPDX-License-Identifier: Apache-2.0
"""(h) A workspace map of the shipped SCARA, with limits and verdicts, against its closed form in numpy."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np

from scara_effmass.analysis.workspace_map import AS_SAMPLED, Cells, Plane, map_table, sample_workspace
from scara_effmass.cli.options import load_dynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings
from scara_effmass.studies.scara import scara_of

ROUNDS, COUNT = 5, 200_000


def measure() -> tuple[float, float]:
    """Return the median times of a pose [ns]: of the map, and of positions and masses by the closed form, in turn.

    The map is of one contact point: configurations, positions, masses, reduced masses, limits, verdicts and cells.
    """
    settings = MonitorSettings(contact_points=("tool",), **AS_SAMPLED)
    dynamics = load_dynamics(settings)
    monitor, scara = Monitor(dynamics, settings), scara_of(dynamics)
    monitor.compile()
    q1, q2 = np.ascontiguousarray(dynamics.robot.sample_configurations(COUNT)[:, :2].T)

    def map_workspace() -> None:
        sample = sample_workspace(monitor, (1.0, 0.0, 0.0), "", Plane(2, math.nan), COUNT, lambda _: None)
        map_table(Cells(sample), dynamics.robot.joint_names)

    def closed_form() -> None:
        scara.tool(q1, q2)
        scara.lumped(q1, q2)
        scara.full(q1, q2)

    times = [(_ns(map_workspace), _ns(closed_form)) for _ in range(ROUNDS)]
    ours, theirs = np.median(times, axis=0)
    return float(ours), float(theirs)


def _ns(function: Callable[[], None]) -> float:
    started = time.perf_counter()
    function()
    return (time.perf_counter() - started) / COUNT * 1e9


if __name__ == "__main__":
    map_ns, closed_form_ns = measure()
    print(f"{map_ns:.0f} ns a pose, closed form {closed_form_ns:.0f} ns, ratio {map_ns / closed_form_ns:.1f}")  # noqa: T201
