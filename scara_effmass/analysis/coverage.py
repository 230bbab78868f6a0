# SPDX-License-Identifier: Apache-2.0
"""Coverage of recordings: counts of joint positions, poses, directions and speeds, which can be merged."""

from __future__ import annotations

import json
import math
from bisect import bisect_right
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from pydantic import BaseModel, NonNegativeInt

from scara_effmass.analysis.report import CYCLE, figure_text, new_figure, styled
from scara_effmass.analysis.summary import NUMBER
from scara_effmass.errors import SettingsError
from scara_effmass.input_files import read_text
from scara_effmass.model.robot import Robot
from scara_effmass.settings import checked
from scara_effmass.values import ContactAssessment, FloatArray, JointState

POSITIONS = 24
"""Bins of each joint's range."""
POSE_BINS = 4
"""Bins of each joint's range for poses; a pose is a combination of bins."""
AZIMUTHS, ELEVATIONS = 12, 7
"""Bins of the directions, of equal area on the sphere; horizontal ones are in the middle of a bin."""
SPEEDS = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
"""Lower ends [m/s] of the bins of the speed."""
MAX_COUNTS_BYTES = 50_000_000
"""Largest coverage.json that is read."""


class Coverage(BaseModel):
    """Number of joint states in each bin of "position JOINT", "direction POINT" and "speed POINT".

    `ranges` are those of the joints [rad, m] by name; that of a `continuous` one is a full turn. `poses` are the
    visited combinations of POSE_BINS bins per joint, as numbers to that base.
    """

    robot: str
    ranges: dict[str, tuple[float, float]]
    continuous: set[str] = set()
    recordings: list[str] = []
    joint_states: NonNegativeInt = 0
    counts: dict[str, list[NonNegativeInt]]
    poses: set[NonNegativeInt] = set()
    invalid: Counter[str] = Counter()
    """Number of joint states that are left out, by reason, in which "…" stands for each number."""
    losses: list[str] = []
    """Parts of the recordings that could not be read."""

    @classmethod
    def of_robot(cls, robot: Robot) -> Coverage:
        """Return an empty coverage."""
        limits = zip(robot.model.lowerPositionLimit.tolist(), robot.model.upperPositionLimit.tolist(), strict=True)
        ranges = dict(zip(robot.joint_names, limits, strict=True))
        ranges |= {name: (-turn / 2.0, turn / 2.0) for name, turn in robot.turns.items()}
        counts = {f"position {name}": [0] * POSITIONS for name in ranges}
        for point in robot.contact_frames:
            counts |= {f"direction {point}": [0] * (AZIMUTHS * ELEVATIONS), f"speed {point}": [0] * len(SPEEDS)}
        return cls(robot=robot.name, ranges=ranges, continuous=set(robot.turns), counts=counts)

    def begin(self, recording: str) -> None:
        """Start a recording. Raises SettingsError if it has been counted already."""
        if recording in self.recordings:
            raise SettingsError(f"{recording}: must not be counted twice")
        self.recordings.append(recording)

    def add(self, state: JointState, contacts: Sequence[ContactAssessment]) -> None:
        """Count a joint state with its assessments; an invalid one is left out."""
        for contact in contacts:
            if not contact.effective_mass > 0.0:
                self.invalid[NUMBER.sub("…", contact.reason)] += 1
                return
        self.joint_states += 1
        position_of = dict(zip(state.names, state.position.tolist(), strict=True))
        pose = 0
        for name, (lower, upper) in self.ranges.items():
            share = (position_of[name] - lower) / (upper - lower)
            # The monitor's tolerance admits positions slightly outside of the limits.
            share = share % 1.0 if name in self.continuous else min(max(share, 0.0), 1.0 - 1e-12)
            self.counts[f"position {name}"][int(share * POSITIONS)] += 1
            pose = pose * POSE_BINS + int(share * POSE_BINS)
        self.poses.add(pose)
        for contact in contacts:
            x, y, z = contact.direction
            self.counts[f"speed {contact.contact_point}"][bisect_right(SPEEDS, contact.speed) - 1] += 1
            if x or y or z:
                azimuth = int((math.atan2(y, x) / (2.0 * math.pi) + 0.5) * AZIMUTHS) % AZIMUTHS
                elevation = min(int((z + 1.0) / 2.0 * ELEVATIONS), ELEVATIONS - 1)
                self.counts[f"direction {contact.contact_point}"][elevation * AZIMUTHS + azimuth] += 1

    def merge(self, path: Path) -> None:
        """Add the coverage in the file `path`. Raises SettingsError for another robot, or a recording counted twice."""
        text = read_text(path, SettingsError, MAX_COUNTS_BYTES)
        try:
            values = json.loads(text)["coverage"]
        except (ValueError, KeyError, TypeError, RecursionError):
            raise SettingsError(f"{path}: cannot be read: must be a coverage.json") from None
        self.extend(checked(Coverage, values, str(path)), path)

    def extend(self, other: Coverage, path: Path) -> None:
        """Add the coverage `other`, which belongs to `path`. Raises SettingsError as `merge` does."""
        expected, value = (
            (coverage.robot, coverage.ranges, {name: len(bins) for name, bins in coverage.counts.items()})
            for coverage in (self, other)
        )
        if value != expected:
            raise SettingsError(f"{path}: robot, ranges and bins = {value}: must be {expected}")
        for recording in other.recordings:
            self.begin(recording)
        for name, bins in self.counts.items():
            self.counts[name] = [sum(counts) for counts in zip(bins, other.counts[name], strict=True)]
        self.joint_states += other.joint_states
        self.poses |= other.poses
        self.invalid += other.invalid
        self.losses += other.losses

    def shares(self) -> dict[str, Any]:
        """Return the covered share of each quantity, of the poses, and the lower end of the fastest bins [m/s]."""
        shares: dict[str, Any] = {}
        fastest = {}
        for name, bins in self.counts.items():
            visited = np.flatnonzero(bins)
            if name.startswith("speed "):
                fastest[name] = SPEEDS[max(visited, default=0)]
            else:
                shares[name] = len(visited) / len(bins)
        return {**shares, "poses": len(self.poses) / POSE_BINS ** len(self.ranges), "fastest_bin_from_m_s": fastest}

    @styled
    def figure(self) -> Figure:
        """Draw the bins of the joints, and of direction and speed of each contact point."""
        points = [name.partition(" ")[2] for name in self.counts if name.startswith("direction ")]
        height = 0.32 * len(self.ranges) + 1.4
        title = f"{self.robot}: coverage, recordings: {len(self.recordings)}, joint states: {self.joint_states}"
        figure = new_figure(11.0, height + 3.3 * len(points), figure_text(title))
        grid = figure.add_gridspec(1 + len(points), 2, height_ratios=[height, *[3.0] * len(points)])
        joints = figure.add_subplot(grid[0, :])
        rows = np.array([self.counts[f"position {name}"] for name in self.ranges], float)
        _draw_bins(joints, rows, (0.0, 100.0), (0.0, len(rows)))
        names = [f"{name}, {lower:.2f} to {upper:.2f}" for name, (lower, upper) in self.ranges.items()]
        joints.set_yticks(np.arange(len(names)) + 0.5, names)
        joints.invert_yaxis()
        joints.set(xlabel="position within the range of the joint [%]")
        for row, point in enumerate(points, start=1):
            directions = figure.add_subplot(grid[row, 0])
            table = np.reshape(self.counts[f"direction {point}"], (ELEVATIONS, AZIMUTHS)).astype(float)
            _draw_bins(directions, table, (-180.0, 180.0), (-1.0, 1.0))
            directions.set(xlabel="azimuth of the velocity [deg]", ylabel="its z component", title=point)
            speeds = figure.add_subplot(grid[row, 1])
            speeds.bar(range(len(SPEEDS)), self.counts[f"speed {point}"], width=0.9, color=CYCLE[0])
            speeds.set_xticks(range(len(SPEEDS)), [f"{speed:g}" for speed in SPEEDS], rotation=90.0)
            speeds.set(
                xlabel="speed, from [m/s]",
                ylabel="joint states",
                title=point,
                yscale=_log_scale(self.joint_states > 0),
            )
        return figure


def _log_scale(is_visited: object) -> str:
    """Return the scale of counts: Matplotlib has no logarithmic one for zeros alone."""
    return "log" if is_visited else "linear"


def _draw_bins(axes: Axes, bins: FloatArray, x: tuple[float, float], y: tuple[float, float]) -> None:
    """Draw the visited `bins` (n, m) over x and y; the others stay white."""
    edges = (np.linspace(*ends, count + 1) for ends, count in ((x, bins.shape[1]), (y, bins.shape[0])))
    mesh = axes.pcolormesh(
        *edges, np.where(bins > 0, bins, np.nan), norm=_log_scale(bins.any()), edgecolor="#EEEEEE", linewidth=0.3
    )
    axes.figure.colorbar(mesh, ax=axes, label="joint states")
