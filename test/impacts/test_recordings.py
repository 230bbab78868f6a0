# SPDX-License-Identifier: Apache-2.0
"""Real impacts: a cart against a force sensor behind a pad. Impulse over change of velocity is the mass of the cart."""

import csv
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from scara_effmass.settings import DetectionSettings
from scara_effmass.values import FloatArray, Impact
from test.impacts.conftest import Detect

EXAMPLE = Path(__file__).parents[2] / "examples" / "cart_impacts.py"
FOLDER = Path(__file__).parents[1] / "recordings" / "cart_impacts"
AROUND = 0.25
"""Time before and after the contact over which the velocity is evaluated [s]."""


class Run(NamedTuple):
    name: str
    rate: float
    start: float
    force: FloatArray
    motion_time: FloatArray
    velocity: FloatArray


def runs_of(path: Path) -> list[Run]:
    """Read all runs of a file; their columns are side by side in any order, and those of the motion have blanks."""
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    columns = dict(zip(header, zip(*rows, strict=True), strict=True))
    runs = []
    for name in sorted({key.partition(":")[0] for key in columns}):
        time, force, velocity = (
            np.array([float(cell or "nan") for cell in columns[f"{name}: {quantity}"]])
            for quantity in ("Time (s)", "Force (N)", "Velocity (m/s)")
        )
        moved = np.isfinite(velocity)
        rate = float((time.size - 1) / (time[-1] - time[0]))
        runs.append(Run(f"{path.stem} {name}", rate, float(time[0]), -force, time[moved], velocity[moved]))
    return runs


RUNS = [run for path in sorted(FOLDER.glob("*.csv")) for run in runs_of(path)]


def impact_in(run: Run, detect: Detect) -> Impact:
    (impact,), detector = detect(run.force, run.rate, settings=DetectionSettings(threshold=0.5))
    assert (detector.dropouts, detector.glitches, detector.sustained_contacts) == (0, 0, 0)
    return impact


def velocities(run: Run, impact: Impact) -> tuple[float, float]:
    """Return the velocity before and after `impact` [m/s]; medians, because the motion sensor has outliers."""
    onset = run.start + impact.onset_sample / run.rate
    end = onset + impact.duration
    before = (run.motion_time > onset - AROUND) & (run.motion_time <= onset)
    after = (run.motion_time >= end) & (run.motion_time < end + AROUND)
    return float(np.median(run.velocity[before])), float(np.median(run.velocity[after]))


def test_there_are_fifteen() -> None:
    assert len(RUNS) == 15


@pytest.mark.parametrize("run", RUNS, ids=lambda run: run.name)
def test_one_whole_impact_in_each(run: Run, detect: Detect) -> None:
    impact = impact_in(run, detect)
    assert not impact.incomplete
    assert not impact.clipped
    assert impact.rebound == 0
    assert 4.5 < impact.peak_force < 5.6
    assert 0.25 < impact.duration < 0.3
    assert impact.baseline == pytest.approx(np.median(run.force[: run.force.size // 2]), abs=0.3)
    # Nothing is cut off: what the whole second around it holds above the baseline is hardly more.
    time = np.arange(run.force.size) - impact.onset_sample
    near = (time > -0.1 * run.rate) & (time < (impact.duration + 0.1) * run.rate)
    assert impact.impulse == pytest.approx((run.force[near] - impact.baseline).sum() / run.rate, rel=0.03)


def test_the_mass_of_the_cart(detect: Detect) -> None:
    masses = []
    for run in RUNS:
        impact = impact_in(run, detect)
        before, after = velocities(run, impact)
        assert 0.8 < before < 0.95
        assert -0.75 < after < -0.55
        masses.append(impact.impulse / (before - after))
    assert all(0.51 < mass < 0.61 for mass in masses)
    assert np.std(masses) < 0.05 * np.mean(masses)


@pytest.mark.live
def test_import_signal_and_detection_give_the_same(detect: Detect) -> None:
    """The example processes the files as `daq_node` does, by its settings alone, and has its own tables."""
    done = subprocess.run([sys.executable, str(EXAMPLE), str(FOLDER)], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    rows = list(csv.DictReader(done.stdout.splitlines()))
    assert [f"{row['file']} {row['run']}" for row in rows] == [run.name for run in RUNS]
    by_medians, by_lines = [], []
    for row, run in zip(rows, RUNS, strict=True):
        impact = impact_in(run, detect)
        assert float(row["peak_n"]) == pytest.approx(impact.peak_force, abs=0.006)
        assert float(row["duration_s"]) == pytest.approx(impact.duration, abs=0.001)
        assert float(row["impulse_n_s"]) == pytest.approx(impact.impulse, rel=2e-3)
        before, after = velocities(run, impact)
        by_medians.append(float(row["mass_median_kg"]))
        assert by_medians[-1] == pytest.approx(impact.impulse / (before - after), rel=0.01)
        by_lines.append(float(row["mass_extrapolated_kg"]))
    # One cart, so the mass is one: less what the slope does to it during the contact, it scatters no more and is less.
    assert all(0.47 < mass < 0.54 for mass in by_lines)
    assert 0.03 < np.mean(by_medians) - np.mean(by_lines) < 0.06
