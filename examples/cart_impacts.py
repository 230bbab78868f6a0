# SPDX-License-Identifier: Apache-2.0
"""Detect measured impacts and compute the mass of a cart from impulse and change of velocity.

    python examples/cart_impacts.py test/recordings/cart_impacts

See docs/cell.md.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.stats import theilslopes

from scara_effmass.impacts.detector import Detector
from scara_effmass.importers.force import import_force
from scara_effmass.settings import DetectionSettings, ImportSettings, checked

if TYPE_CHECKING:
    from scara_effmass.values import FloatArray, Impact

MEDIAN_S, LINE_S = 0.25, 0.5
"""Durations before and after the contact over which the median and the line are taken."""


class Motion(NamedTuple):
    """Velocity (n,) [m/s] at the times (n,) [s]; the recording starts at `start_s`."""

    start_s: float
    time_s: FloatArray
    velocity_m_s: FloatArray


def main(folder: Path) -> None:
    """Print a line for each run in the CSV files of `folder`."""
    print("file,run,peak_n,duration_s,impulse_n_s,mass_median_kg,mass_extrapolated_kg")  # noqa: T201 - a table
    for path in sorted(folder.glob("*.csv")):
        columns = read_columns(path)
        for run in sorted({name.partition(":")[0] for name in columns}):
            motion = motion_of(columns, run)
            for since_start_s, impact in impacts_in(path, run):
                onset = motion.start_s + since_start_s
                changes_m_s = (
                    change(motion, onset, onset + impact.duration) for change in (change_by_medians, change_by_lines)
                )
                masses = ",".join(f"{impact.impulse / change_m_s:.3f}" for change_m_s in changes_m_s)
                measured = f"{impact.peak_force:.2f},{impact.duration:.3f},{impact.impulse:.4f}"
                print(f"{path.stem},{run},{measured},{masses}")  # noqa: T201


def impacts_in(path: Path, run: str) -> list[tuple[float, Impact]]:
    """Return for each impact of one run its onset [s] after the first sample, and the impact."""
    columns = {"topic": f"{run}: Force (N)", "time_column": f"{run}: Time (s)"}
    settings = checked(ImportSettings, {**columns, "sensor.invert": True}, "cart impacts")
    detector = Detector(DetectionSettings(threshold=0.5))
    blocks = list(import_force(path, settings)[1])
    impacts = [impact for block in blocks for impact in detector.feed(block)] + detector.finish()
    return [((impact.stamp_ns - blocks[0].stamp_ns) / 1e9, impact) for impact in impacts]


def read_columns(path: Path) -> dict[str, tuple[str, ...]]:
    """Return the columns of a file by name."""
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    return dict(zip(header, zip(*rows, strict=True), strict=True))


def motion_of(columns: dict[str, tuple[str, ...]], run: str) -> Motion:
    """Return the motion of one run. Some files have it in every fourth row only."""
    times, velocities = (
        np.array([float(cell or "nan") for cell in columns[f"{run}: {what}"]])
        for what in ("Time (s)", "Velocity (m/s)")
    )
    known = np.isfinite(velocities)
    return Motion(float(times[0]), times[known], velocities[known])


def change_by_medians(motion: Motion, onset: float, end: float) -> float:
    """Return by how much the contact slows the cart [m/s], from medians, which tolerate outliers."""
    before, after = adjacent(motion, onset, end, MEDIAN_S)
    return float(np.median(motion.velocity_m_s[before]) - np.median(motion.velocity_m_s[after]))


def change_by_lines(motion: Motion, onset: float, end: float) -> float:
    """Return by how much the contact slows the cart [m/s], from lines extrapolated to the middle of the contact.

    This removes the effect of slope and friction if it is equal before and after. Theil-Sen lines tolerate outliers.
    """
    middle = (onset + end) / 2.0
    speeds_m_s = []
    for part in adjacent(motion, onset, end, LINE_S):
        line = theilslopes(motion.velocity_m_s[part], motion.time_s[part])
        speeds_m_s.append(float(line.intercept + line.slope * middle))
    before, after = speeds_m_s
    return before - after


def adjacent(motion: Motion, onset: float, end: float, span_s: float) -> tuple[slice, slice]:
    """Return the samples of the motion up to `span_s` before and after the contact."""
    edges = np.searchsorted(motion.time_s, [onset - span_s, onset, end, end + span_s], side="right").tolist()
    return slice(edges[0], edges[1]), slice(edges[2], edges[3])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
