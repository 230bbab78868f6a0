# SPDX-License-Identifier: Apache-2.0
"""Maps over the workspace of a contact point: masses, allowable speed and bound, for any arm and direction.

The monitor assesses a motion along the direction in many configurations of the joints. Each cell of a map holds the
worst of the sampled configurations that reach it; one between them may be worse.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
import pyarrow as pa
from matplotlib.figure import Figure

from scara_effmass.analysis.plot_style import ISO_RED, STYLE, new_figure
from scara_effmass.errors import RobotError
from scara_effmass.safety import Monitor
from scara_effmass.values import BoolArray, ContactAssessment, FloatArray, JointState, Vector3, Verdict

CELLS = 40
"""Approximate number of cells along the longer side of a map."""
NOW_NS = 1_000_000_000
SPEED_RATIO = 2.0
"""Speed of the motion over the `speed_threshold`; masses and allowable speed do not depend on it."""
TINY = 1e-9
"""Velocity of joints at rest [rad/s, m/s]: one of exactly zero has to be confirmed first."""
PLANE_STEPS, PLANE_TOLERANCE_M = 20, 1e-4
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
    contacts: tuple[ContactAssessment, ...]
    left_out: int

    @property
    def unknown(self) -> BoolArray:
        """Whether there is no verdict (m,)."""
        return np.array([contact.verdict is Verdict.UNKNOWN for contact in self.contacts])

    def masses(self, field: str) -> FloatArray:
        """Return a mass of the assessments (m,) [kg], NaN without a verdict."""
        return np.where(self.unknown, np.nan, [getattr(contact, field) for contact in self.contacts])


def sample_workspace(
    monitor: Monitor, direction: Vector3, frame: str, plane: Plane, count: int, advance: Callable[[], object]
) -> WorkspaceSample:
    """Return `count` configurations of the first contact point of `monitor`, or fewer if few reach `plane`.

    `direction` is a unit vector in `frame` of the robot. Raises RobotError where no configuration reaches the plane,
    moves along the direction, or has a verdict.
    """
    dynamics, speed = monitor.dynamics, SPEED_RATIO * monitor.settings.speed_threshold
    robot, point = dynamics.robot, dynamics.contact_points[0]
    index, max_speeds = robot.contact_frames[point], robot.model.velocityLimit
    rows: list[tuple[FloatArray, FloatArray, ContactAssessment]] = []
    left_out = 0
    for drawn in robot.sample_configurations(count if math.isnan(plane.value) else MAX_DRAWS * count):
        q = _onto_plane(monitor, drawn, index, plane)
        if q is None:
            continue
        normal, jacobian = np.array(dynamics.in_base(q, direction, frame)), dynamics.jacobian(q, index)
        qd = speed * np.linalg.pinv(jacobian, rcond=1e-9) @ normal + TINY
        too_fast = np.any((max_speeds > 0.0) & (np.abs(qd) > max_speeds))
        if too_fast or np.linalg.norm(jacobian @ qd - speed * normal) > 1e-3 * speed:
            left_out += 1
            continue
        monitor.clear_history()
        decision = monitor.assess(JointState(NOW_NS, robot.joint_names, q, qd), NOW_NS)
        rows += [(q, dynamics.position(q, index), contact) for contact in (decision.contacts[:1] if decision else ())]
        advance()
        if len(rows) == count:
            break
    if not rows:
        problem = f"cannot move along {direction}" if left_out else f"does not reach the {plane}"
        raise RobotError(f"{robot.origin}: contact point {point} {problem}")
    q_all, positions, contacts = zip(*rows, strict=True)
    sample = WorkspaceSample(plane, direction, np.array(q_all), np.array(positions), contacts, left_out)
    if sample.unknown.all():
        raise RobotError(f"{robot.origin}: {contacts[0].reason}")
    return sample


def _onto_plane(monitor: Monitor, q: FloatArray, index: int, plane: Plane) -> FloatArray | None:
    """Return the configuration near `q` (n,) with frame `index` in `plane`, None where Newton's method finds none."""
    model = monitor.dynamics.robot.model
    for _ in range(PLANE_STEPS):
        error = plane.value - monitor.dynamics.position(q, index)[plane.axis]
        if not abs(error) > PLANE_TOLERANCE_M:  # also without a plane
            return q
        row = monitor.dynamics.jacobian(q, index)[plane.axis]
        q = np.clip(q + row * error / max(float(row @ row), 1e-6), model.lowerPositionLimit, model.upperPositionLimit)
    return None


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
        self._corners, inverse = np.unique(np.floor(points / self.size).astype(int), axis=0, return_inverse=True)
        self.of = inverse.reshape(-1)
        self.centres = np.round((self._corners + 0.5) * self.size, 9)

    def largest(self, values: FloatArray) -> FloatArray:
        """Return the largest of `values` (m,) in each cell (c,); NaN where all are NaN."""
        result = np.full(len(self.centres), np.nan)
        np.fmax.at(result, self.of, values)
        return result

    def draw(self, title: str, panels: Mapping[str, FloatArray], iso_mass: float | None = None) -> Figure:
        """Return a figure with a map of the values (c,) of each of `panels`, by label; bright is unfavourable.

        `iso_mass` [kg] is drawn on the first colour bar.
        """
        first, last = self._corners.min(axis=0), self._corners.max(axis=0)
        edges = [self.size * np.arange(low, high + 2) for low, high in zip(first, last, strict=True)]
        x, y = (f"{AXES[axis]} [m]" for axis in self.axes)
        with mpl.rc_context(STYLE):
            columns = min(len(panels), 2)
            rows = -(-len(panels) // columns)
            figure = new_figure(max(6.2 * columns, 8.5), 5.2 * rows + 0.3, title)
            for number, (label, values) in enumerate(panels.items()):
                axes = figure.add_subplot(rows, columns, number + 1)
                table = np.full(last - first + 1, np.nan)
                table[tuple((self._corners - first).T)] = values
                is_speed = label.endswith("[m/s]")
                top = np.nanpercentile(values, 100.0 if is_speed else COLOUR_PERCENTILE)
                mesh = axes.pcolormesh(*edges, table.T, cmap="cividis_r" if is_speed else "cividis", vmax=top)
                bar = figure.colorbar(mesh, ax=axes, label=label, extend="neither" if is_speed else "max")
                axes.plot(0.0, 0.0, "+", color=ISO_RED, markersize=10.0)
                axes.set(xlabel=x, ylabel=y, aspect="equal")
                axes.set_title(f"({'abcdefgh'[number]})")
                if iso_mass is not None and number == 0:
                    bar.ax.axhline(iso_mass, color=ISO_RED, linewidth=2.5)
                    axes.set_title(f"(a)  red on the scale: ISO, M/2 + m_L = {iso_mass:.2f} kg")
        return figure


def map_table(cells: Cells, joints: Sequence[str]) -> pa.Table:
    """Return a row for each cell: centre, worst values, and the configuration with the smallest allowable speed."""
    sample, speed = cells.sample, np.array([contact.allowable_speed for contact in cells.sample.contacts])
    order = np.lexsort((speed, cells.of))
    slowest = order[np.unique(cells.of[order], return_index=True)[1]]
    contacts = [sample.contacts[row] for row in slowest]
    return pa.table(
        {
            **{f"{AXES[axis]}_m": column for axis, column in zip(cells.axes, cells.centres.T, strict=True)},
            "configurations": np.bincount(cells.of),
            "unknown": np.bincount(cells.of, sample.unknown).astype(int),
            **{f"{name}_kg": cells.largest(sample.masses(name)) for name in MASSES},
            "allowable_speed_m_s": speed[slowest],
            **{name: [getattr(contact, name) for contact in contacts] for name in ("body_region", "mass_model")},
            **{f"{joint}_position": sample.q[slowest, i] for i, joint in enumerate(joints)},
        }
    )


def draw_map(cells: Cells, table: pa.Table, title: str, iso_mass: float) -> Figure:
    """Return the maps of mass, reduced masses and allowable speed in `table`."""
    panels = {label: table[f"{name}_kg"].to_numpy() for name, label in MASSES.items()}
    return cells.draw(
        title, panels | {"allowable speed along n [m/s]": table["allowable_speed_m_s"].to_numpy()}, iso_mass
    )


def summarize(cells: Cells, table: pa.Table, iso_mass: float) -> dict[str, Any]:
    """Return the summary for JSON, units in the names: percentiles over the cells, and the slowest cell.

    `rise_by_second_half` tells by how much the second half of the sample raised the bound, as a share, of cells that
    the first half had reached: it shows how complete the sample is.
    """
    sample, bound = cells.sample, cells.sample.masses("worst_normal_reduced_mass")
    early = cells.largest(np.where(np.arange(len(bound)) < len(bound) // 2, bound, np.nan))
    columns = [f"{name}_kg" for name in MASSES] + ["allowable_speed_m_s"]
    return {
        "direction": list(sample.direction),
        "plane": str(sample.plane),
        "configurations": len(bound),
        "left_out": sample.left_out,
        "unknown": int(sample.unknown.sum()),
        "mass_models": Counter(item.mass_model_text for item in sample.contacts if item.mass_model).most_common(),
        "cells": table.num_rows,
        "cell_m": cells.size,
        **{name: _percentiles(table[name].to_numpy()) for name in columns},
        "iso_mass_kg": iso_mass,
        "share_above_iso_mass": float(np.mean(table[columns[0]].to_numpy() > iso_mass)),
        "rise_by_second_half": _percentiles(cells.largest(bound) / early - 1.0),
        "slowest": table.take([int(np.argmin(table[columns[-1]].to_numpy()))]).to_pylist()[0],
    }


def _percentiles(values: FloatArray) -> dict[str, float]:
    known = values[np.isfinite(values)]
    names = ("min", "p5", "p50", "p95", "max")
    return dict(zip(names, np.percentile(known, (0, 5, 50, 95, 100)).tolist(), strict=True)) if len(known) else {}
