"""Import real impacts and detect them: the mass of a cart from impulse and change of velocity.

    python examples/cart_impacts.py test/recordings/cart_impacts

See docs/cart_impacts.md.
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
"""For so long before and after the contact, the velocity goes into a median, and into a line."""


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
            for after_start_s, impact in impacts_in(path, run):
                onset = motion.start_s + after_start_s
                changes = (change(motion, onset, onset + impact.duration) for change in (by_medians, by_lines))
                masses = ",".join(f"{impact.impulse / change:.3f}" for change in changes)
                measured = f"{impact.peak_force:.2f},{impact.duration:.3f},{impact.impulse:.4f}"
                print(f"{path.stem},{run},{measured},{masses}")  # noqa: T201


def impacts_in(path: Path, run: str) -> list[tuple[float, Impact]]:
    """Return the impacts of one run, each with its onset [s] after the first sample."""
    columns = {"topic": f"{run}: Force (N)", "time_column": f"{run}: Time (s)"}
    settings = checked(ImportSettings, {**columns, "sensor.invert": True}, "cart impacts")
    detector = Detector(DetectionSettings(threshold=0.5))
    blocks = list(import_force(path, settings).blocks)
    impacts = [impact for block in blocks for impact in detector.feed(block)] + detector.finish()
    return [((impact.stamp_ns - blocks[0].stamp_ns) / 1e9, impact) for impact in impacts]


def read_columns(path: Path) -> dict[str, tuple[str, ...]]:
    """Return the columns of a file by their names."""
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    return dict(zip(header, zip(*rows, strict=True), strict=True))


def motion_of(columns: dict[str, tuple[str, ...]], run: str) -> Motion:
    """Return the motion in one run; in some files it is in every fourth row only."""
    times, velocities = (
        np.array([float(cell or "nan") for cell in columns[f"{run}: {what}"]])
        for what in ("Time (s)", "Velocity (m/s)")
    )
    known = np.isfinite(velocities)
    return Motion(float(times[0]), times[known], velocities[known])


def by_medians(motion: Motion, onset: float, end: float) -> float:
    """Return how much slower the cart is after the contact than before [m/s]; a median stands an outlier."""
    before, after = around(motion, onset, end, MEDIAN_S)
    return float(np.median(motion.velocity_m_s[before]) - np.median(motion.velocity_m_s[after]))


def by_lines(motion: Motion, onset: float, end: float) -> float:
    """Do the same with lines through the velocity before and after, both continued to the middle of the contact.

    That takes out what else pulls at the cart during the contact, if it pulls alike before and after: the slope, and
    friction. The lines are those of Theil and Sen, which stand outliers.
    """
    middle = (onset + end) / 2.0
    reached = []
    for part in around(motion, onset, end, LINE_S):
        line = theilslopes(motion.velocity_m_s[part], motion.time_s[part])
        reached.append(float(line.intercept + line.slope * middle))
    before, after = reached
    return before - after


def around(motion: Motion, onset: float, end: float, span_s: float) -> tuple[slice, slice]:
    """Return which samples of the motion are up to `span_s` before the contact, and which after."""
    edges = np.searchsorted(motion.time_s, [onset - span_s, onset, end, end + span_s], side="right").tolist()
    return slice(edges[0], edges[1]), slice(edges[2], edges[3])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
