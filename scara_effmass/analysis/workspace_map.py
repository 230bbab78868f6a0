# SPDX-License-Identifier: Apache-2.0
"""Maps over the workspace of a contact point: masses, allowable speed and bound, for any arm and direction.

The monitor assesses a motion along the direction in many configurations of the joints. Each cell of a map holds the
worst of the sampled configurations that reach it; one between them may be worse. The motion moves other contacts, too:
the contact that decides reaches its limit first as the motion gets faster.
"""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

from scara_effmass.analysis.report import ISO_RED, distinct_colors, figure_text, new_figure, styled
from scara_effmass.analysis.summary import mass_model_counts
from scara_effmass.errors import RobotError
from scara_effmass.model.poses import ManyPoses
from scara_effmass.model.robot import Robot
from scara_effmass.safety import Assessments, Monitor
from scara_effmass.safety.assessments import Records, joined
from scara_effmass.values import BoolArray, ContactAssessment, FloatArray, Vector3, Verdict

CELLS = 40
"""Approximate number of cells along the longer side of a map."""
TOGETHER = 4_096
"""Configurations in one step: their Jacobians stay in the caches."""
SPEED_RATIO = 10.0
"""Speed of the motion over the `speed_threshold`. Only of slower contacts, which count as at rest, do masses and
allowable speed depend on it."""
DAMPING = 1e-14
"""Share of J J^T that is added to it: well above its rounding, and too little to matter where joints move slowly."""
PLANE_STEPS, PLANE_TOLERANCE_M = 19, 1e-4
"""Newton steps onto a plane, and the distance from it that is close enough."""
AS_SAMPLED: dict[str, Any] = {"velocity_source": "reported", "velocity_window": 0.0}
"""Settings of a monitor for single joint states, whose velocities no filter has seen before."""
MAX_DRAWS = 10
"""Configurations drawn per configuration wanted: those that do not reach the plane do not count."""
COLOUR_PERCENTILE = 95.0
"""Percentile of the cells at which the colours of a mass end."""
MASSES = {
    "effective_mass": "effective mass along n [kg]",
    "reduced_mass": "reduced mass along n [kg]",
    "worst_normal_reduced_mass": "reduced mass, worst contact normal [kg]",
}
"""Fields of the assessment of which a cell holds the largest value, and their labels."""
AXES = "xyz"


class Plane(NamedTuple):
    """Plane at `value` [m] of axis number `axis` of the base; the whole workspace seen along it if `value` is NaN."""

    axis: int = 2
    value: float = math.nan

    def __str__(self) -> str:
        """Return the plane in words."""
        axis = AXES[self.axis]
        return f"every {axis}, seen along {axis}" if math.isnan(self.value) else f"plane {axis} = {self.value:g} m"


class WorkspaceSample(NamedTuple):
    """Configurations `q` (m, n) [rad, m], positions (m, 3) [m], and the assessment of a motion along `direction`.

    `left_out` configurations cannot move along it.
    """

    plane: Plane
    direction: Vector3
    q: FloatArray
    positions: FloatArray
    assessed: Assessments
    left_out: int

    @property
    def unknown(self) -> BoolArray:
        """Whether there is no verdict (m,)."""
        return np.asarray(self.contacts["verdict"] == Verdict.UNKNOWN)

    @property
    def contacts(self) -> Records:
        """The assessments (m,) of the contact point, of dtype CONTACT."""
        return self.assessed.contacts[:, 0]

    @property
    def speed_of_all(self) -> FloatArray:
        """Speed of the contact point (m,) [m/s] at which the first of all contacts reaches its limit."""
        return np.asarray(self.contacts["speed"] / self.assessed.limit_shares.max(axis=1))

    def masses(self, field: str) -> FloatArray:
        """Return a mass of the assessments (m,) [kg], NaN without a verdict."""
        return np.where(self.unknown, np.nan, self.contacts[field])

    def assessments(self) -> list[ContactAssessment]:
        """Return the assessments one by one."""
        return [decision.contacts[0] for decision in self.assessed.decisions()]


def sample_workspace(
    monitor: Monitor, direction: Vector3, frame: str, plane: Plane, count: int, advance: Callable[[int], object]
) -> WorkspaceSample:
    """Return `count` configurations of the first contact point of `monitor`, or fewer if few reach `plane`.

    `direction` is a unit vector in `frame` of the robot; `advance` takes the number of configurations since the last
    call. Raises RobotError where no configuration reaches the plane, moves along the direction, or has a verdict.
    """
    dynamics = monitor.dynamics
    robot, point = dynamics.robot, dynamics.contact_points[0]
    drawn = robot.sample_configurations(count if math.isnan(plane.value) else MAX_DRAWS * count)
    parts: list[tuple[FloatArray, FloatArray, Future[Assessments]]] = []
    taken = left_out = 0
    # Pinocchio's buffers are for one thread; the kernel has none.
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        for first in range(0, len(drawn), TOGETHER):
            q, places, qd, moves = _motions(monitor, drawn[first : first + TOGETHER], direction, frame, plane)
            rows = np.flatnonzero(moves)[: count - taken]
            taken += len(rows)
            left_out += int(np.count_nonzero(~moves[: rows[-1]] if taken == count else ~moves))
            if len(rows):
                parts.append((q[rows], places[rows], pool.submit(monitor.assess_configurations, q[rows], qd[rows])))
            if taken == count:
                break
        computed = []
        for q, _, assessed in parts:
            computed.append(assessed.result())
            advance(len(q))
    if not parts:
        problem = f"cannot move along {direction}" if left_out else f"does not reach the {plane}"
        raise RobotError(f"{robot.origin}: contact point {point} {problem}")
    q, positions = (np.concatenate([part[column] for part in parts]) for column in range(2))
    sample = WorkspaceSample(plane, direction, q, positions, joined(computed), left_out)
    if sample.unknown.all():
        raise RobotError(f"{robot.origin}: {sample.assessed.reason(0, 0)}")
    return sample


def _motions(
    monitor: Monitor, q: FloatArray, direction: Vector3, frame: str, plane: Plane
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Return the configurations near `q` (k, n) that reach `plane`, their positions (k, 3) and velocities (k, n).

    The last array tells which of them can move along the direction.
    """
    dynamics, speed = monitor.dynamics, SPEED_RATIO * monitor.settings.speed_threshold
    robot, index = dynamics.robot, dynamics.contacts[0][1]
    q, poses = _onto_plane(robot, q, index, plane)
    max_speeds, normal, jacobian = robot.model.velocityLimit, poses.in_base(direction, frame), poses.jacobian(index)
    square = jacobian @ jacobian.swapaxes(1, 2)
    # Some points move in a plane only, and perhaps one in no pose at all.
    square += (DAMPING * np.trace(square, axis1=1, axis2=2) + 1e-30)[:, None, None] * np.eye(3)
    qd = speed * (jacobian.swapaxes(1, 2) @ np.linalg.solve(square, normal[:, :, None]))[:, :, 0]
    too_fast = np.any((max_speeds > 0.0) & (np.abs(qd) > max_speeds), axis=1)
    error = (jacobian @ qd[:, :, None])[:, :, 0] - speed * normal
    return q, poses.position(index), qd, ~too_fast & (np.linalg.norm(error, axis=1) <= 1e-3 * speed)


def _onto_plane(robot: Robot, q: FloatArray, index: int, plane: Plane) -> tuple[FloatArray, ManyPoses]:
    """Return the configurations near `q` (k, n) with frame `index` in `plane`, without those that do not get there."""
    lower, upper = robot.model.lowerPositionLimit, robot.model.upperPositionLimit
    poses = ManyPoses(robot, q)
    for _ in range(0 if math.isnan(plane.value) else PLANE_STEPS):
        error = plane.value - poses.position(index)[:, plane.axis]
        row = poses.jacobian(index)[:, plane.axis]
        steps = np.where(np.abs(error) > PLANE_TOLERANCE_M, error, 0.0) / np.maximum(np.sum(row * row, axis=1), 1e-6)
        if not steps.any():
            break
        q = np.clip(q + row * steps[:, None], lower, upper)
        poses = ManyPoses(robot, q)
    away = np.abs(plane.value - poses.position(index)[:, plane.axis]) > PLANE_TOLERANCE_M  # never without a plane
    return (q[~away], ManyPoses(robot, q[~away])) if away.any() else (q, poses)


class Cells:
    """Square cells over the points of `sample`: `size` [m], `centres` (c, 2) [m], and the cell `of` each point (m,)."""

    def __init__(self, sample: WorkspaceSample) -> None:
        """Choose a size of one digit."""
        self.axes = [axis for axis in range(3) if axis != sample.plane.axis]
        points = sample.positions[:, self.axes]
        extent = max(float(np.ptp(points, axis=0).max()) / CELLS, 1e-3)
        digit = 10.0 ** math.floor(math.log10(extent))
        self.size = digit * math.ceil(extent / digit)
        self.sample = sample
        corners = np.floor(points / self.size).astype(int)
        first, shape = corners.min(axis=0), np.ptp(corners, axis=0) + 1
        # Of one number each, which sorts five times as fast as rows.
        numbers, self.of = np.unique(np.ravel_multi_index((corners - first).T, shape), return_inverse=True)
        self._corners = first + np.column_stack(np.unravel_index(numbers, shape))
        self.centres = np.round((self._corners + 0.5) * self.size, 9)

    def largest(self, values: FloatArray) -> FloatArray:
        """Return the largest of `values` (m,) in each cell (c,); NaN where all are NaN."""
        result = np.full(len(self.centres), np.nan)
        np.fmax.at(result, self.of, values)
        return result

    def smallest(self, values: FloatArray) -> NDArray[np.int64]:
        """Return the index of the smallest of `values` (m,) in each cell (c,)."""
        order = np.lexsort((values, self.of))
        indices: NDArray[np.int64] = order[np.unique(self.of[order], return_index=True)[1]]
        return indices

    @styled
    def draw(
        self,
        title: str,
        panels: Mapping[str, FloatArray],
        iso_mass: float | None = None,
        deciding: Sequence[str] = (),
    ) -> Figure:
        """Return a figure with a map of the values (c,) of each of `panels`, by label; bright is unfavourable.

        `iso_mass` [kg] is drawn on the first colour bar. `deciding` (c,) names contacts, for a panel of its own.
        """
        count = len(panels) + bool(deciding)
        columns = min(count, 2)
        rows = -(-count // columns)
        figure = new_figure(max(6.2 * columns, 8.5), 5.2 * rows + 0.3, title)
        for number, (label, values) in enumerate(panels.items()):
            axes = figure.add_subplot(rows, columns, number + 1)
            is_speed = label.endswith("[m/s]")
            top = np.nanpercentile(values, 100.0 if is_speed else COLOUR_PERCENTILE)
            mesh = self._draw_cells(axes, values, cmap="cividis_r" if is_speed else "cividis", vmax=top)
            bar = figure.colorbar(mesh, ax=axes, label=label, extend="neither" if is_speed else "max")
            axes.set_title(f"({'abcdefgh'[number]})")
            if iso_mass is not None and number == 0:
                bar.ax.axhline(iso_mass, color=ISO_RED, linewidth=2.5)
                axes.set_title(f"(a)  red on the scale: ISO, M/2 + m_L = {iso_mass:.2f} kg")
        if deciding:
            axes = figure.add_subplot(rows, columns, count)
            axes.set_title(f"({'abcdefgh'[count - 1]})")
            self._draw_contacts(axes, deciding)
        return figure

    def _draw_cells(self, axes: Axes, values: Sequence[float] | FloatArray, **style: Any) -> QuadMesh:  # noqa: ANN401
        """Draw the values (c,) of the cells and the base."""
        first, last = self._corners.min(axis=0), self._corners.max(axis=0)
        edges = [self.size * np.arange(low, high + 2) for low, high in zip(first, last, strict=True)]
        table = np.full(last - first + 1, np.nan)
        table[tuple((self._corners - first).T)] = values
        axes.plot(0.0, 0.0, "+", color=ISO_RED, markersize=10.0)
        x, y = (f"{AXES[axis]} [m]" for axis in self.axes)
        axes.set(xlabel=x, ylabel=y, aspect="equal")
        return axes.pcolormesh(*edges, table.T, rasterized=True, **style)

    def _draw_contacts(self, axes: Axes, deciding: Sequence[str]) -> None:
        """Draw which contact decides in each cell (c,); a contact has the same colour in every map of a robot."""
        points = self.sample.assessed.points
        colors = {
            name: color for name, color in zip(points, distinct_colors(len(points)), strict=True) if name in deciding
        }
        names = [*colors]
        codes, cmap = [names.index(name) for name in deciding], ListedColormap([*colors.values()])
        mesh = self._draw_cells(axes, codes, cmap=cmap, vmin=-0.5, vmax=len(names) - 0.5)
        bar = axes.figure.colorbar(mesh, ax=axes, label="deciding contact", ticks=range(len(names)))
        bar.ax.set_yticklabels(names)


def map_table(cells: Cells, joints: Sequence[str]) -> pa.Table:
    """Return a row for each cell: centre, worst values, and the configuration with the smallest allowable speed.

    The contact that decides is that of the configuration with the smallest `speed_of_all`.
    """
    sample, contacts = cells.sample, cells.sample.contacts
    speed, speed_of_all = np.ascontiguousarray(contacts["allowable_speed"]), sample.speed_of_all
    slowest, slowest_of_all = cells.smallest(speed), cells.smallest(speed_of_all)
    deciding = np.array(sample.assessed.points)[sample.assessed.deciding()[slowest_of_all]]
    labels = {name: np.array(sample.assessed.labels[name]) for name in ("body_region", "mass_model")}
    return pa.table(
        {
            **{f"{AXES[axis]}_m": column for axis, column in zip(cells.axes, cells.centres.T, strict=True)},
            "configurations": np.bincount(cells.of),
            "unknown": np.bincount(cells.of, sample.unknown).astype(int),
            **{f"{name}_kg": cells.largest(sample.masses(name)) for name in MASSES},
            "allowable_speed_m_s": speed[slowest],
            **{name: texts[contacts[name][slowest].astype(int)] for name, texts in labels.items()},
            "allowable_speed_all_contacts_m_s": speed_of_all[slowest_of_all],
            "deciding_contact": deciding,
            **{f"{joint}_position": sample.q[slowest, i] for i, joint in enumerate(joints)},
        }
    )


def draw_map(cells: Cells, table: pa.Table, title: str, iso_mass: float) -> Figure:
    """Return the maps of mass, reduced masses and allowable speed in `table`; of several contacts, which decides."""
    panels = {label: table[f"{name}_kg"].to_numpy() for name, label in MASSES.items()}
    speed = "allowable speed along n{} [m/s]"
    panels[speed.format("")] = table["allowable_speed_m_s"].to_numpy()
    if len(cells.sample.assessed.points) == 1:
        return cells.draw(figure_text(title), panels, iso_mass)
    panels[speed.format(", all contacts")] = table["allowable_speed_all_contacts_m_s"].to_numpy()
    return cells.draw(figure_text(title), panels, iso_mass, table["deciding_contact"].to_pylist())


def summarize(cells: Cells, table: pa.Table, iso_mass: float) -> dict[str, Any]:
    """Return the summary for JSON, units in the names: percentiles over the cells, and the slowest cell.

    `deciding_contacts` counts the cells in which each contact decides. `rise_by_second_half` tells by how much the
    second half of the sample raised the bound, as a share, of the `shared_cells` that the first half had reached, too:
    it shows how complete the sample is.
    """
    sample, bound = cells.sample, cells.sample.masses("worst_normal_reduced_mass")
    is_early = np.arange(len(bound)) < len(bound) // 2
    early, late = (cells.largest(np.where(half, bound, np.nan)) for half in (is_early, ~is_early))
    rise = np.maximum(late / early - 1.0, 0.0)  # NaN in a cell that one of them has not reached
    columns = [f"{name}_kg" for name in MASSES] + ["allowable_speed_m_s", "allowable_speed_all_contacts_m_s"]
    deciding = Counter(dict.fromkeys(sample.assessed.points, 0))
    deciding.update(table["deciding_contact"].to_pylist())
    return {
        "direction": list(sample.direction),
        "plane": str(sample.plane),
        "configurations": len(bound),
        "left_out": sample.left_out,
        "unknown": int(sample.unknown.sum()),
        "mass_models": mass_model_counts(sample.contacts, sample.assessed.labels).most_common(),
        "cells": table.num_rows,
        "cell_m": cells.size,
        **{name: _percentiles(table[name].to_numpy()) for name in columns},
        "deciding_contacts": dict(deciding.most_common()),
        "iso_mass_kg": iso_mass,
        "share_above_iso_mass": float(np.mean(table[columns[0]].to_numpy() > iso_mass)),
        "shared_cells": int(np.isfinite(rise).sum()),
        "rise_by_second_half": _percentiles(rise),
        "slowest": table.take([int(np.argmin(table["allowable_speed_m_s"].to_numpy()))]).to_pylist()[0],
    }


def _percentiles(values: FloatArray) -> dict[str, float]:
    known = values[np.isfinite(values)]
    names = ("min", "p5", "p50", "p95", "max")
    return dict(zip(names, np.percentile(known, (0, 5, 50, 95, 100)).tolist(), strict=True)) if len(known) else {}
