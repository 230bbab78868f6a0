# SPDX-License-Identifier: Apache-2.0
"""Picture of the polytopes around the links that `whole_arm` watches."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]
from scipy.spatial import ConvexHull

from scara_effmass.analysis.report import INK, STYLE, distinct_colors, new_figure
from scara_effmass.model.robot import Robot
from scara_effmass.values import FloatArray

MIN_EXTENT = 0.4
"""Smallest extent of the axes, as a share of the largest."""
TICKS = 20
"""Approximate number of ticks over twice the size of the robot; all axes have the same."""


def faces(vertices: FloatArray) -> Iterator[FloatArray]:
    """Yield the faces (K, 3) of the convex polytope around `vertices` (V, 3), corners in order around each face."""
    hull = ConvexHull(vertices)
    # Qhull divides a face into triangles, which have the equation of the face.
    planes, face = np.unique(hull.equations.round(6), axis=0, return_inverse=True)
    for number, plane in enumerate(planes):
        corners = vertices[np.unique(hull.simplices[face.ravel() == number])]
        arms = corners - corners.mean(axis=0)
        angles = np.arctan2(arms @ np.cross(plane[:3], arms[0]), arms @ arms[0])
        yield corners[np.argsort(angles)]


def draw_hulls(robot: Robot) -> Figure:
    """Return the picture of the hulls, the joints and the named contact points at the zero pose.

    A contact has the same colour in the maps of the workspace.
    """
    model = robot.model
    poses = robot.joint_poses(np.clip(np.zeros(model.nv), model.lowerPositionLimit, model.upperPositionLimit))
    parts = [poses[:, :3, 3]]
    with mpl.rc_context(STYLE):
        figure = new_figure(9.5, 7.5, f"Hulls of {robot.name}: what whole_arm watches")
        axes = figure.add_subplot(projection="3d")
        shown: list[Artist] = axes.plot(*parts[0].T, "o-", color=INK, linewidth=1.0, markersize=3.0, label="joints")
        colors = distinct_colors(len(robot.contact_frames))
        for (name, index), color in zip(robot.contact_frames.items(), colors, strict=True):
            frame = model.frames[index]
            pose = poses[frame.parentJoint - 1]
            points = robot.hulls.get(name, frame.placement.translation[None]) @ pose[:3, :3].T + pose[:3, 3]
            parts.append(points)
            if name in robot.hulls:
                style: dict[str, Any] = {"facecolor": color, "edgecolor": INK, "linewidth": 0.5, "alpha": 0.35}
                axes.add_collection(Poly3DCollection([*faces(points)], **style))
                shown.append(Patch(label=name, **style))
            else:
                shown += axes.plot(*points.T, "D", color=color, markeredgecolor=INK, label=name)
        _set_equal_axes(axes, np.concatenate(parts))
        axes.legend(handles=shown, loc="center left", bbox_to_anchor=(1.12, 0.5))
    return figure


def _set_equal_axes(axes: Axes, points: FloatArray) -> None:
    """Show the box around `points` (N, 3) [m] on axes of equal scales and equal ticks."""
    low, high = points.min(axis=0), points.max(axis=0)
    size = float((high - low).max())
    ticks = MaxNLocator(TICKS, steps=[1, 2, 5, 10]).tick_values(-size, size)
    extent = np.maximum(high - low, MIN_EXTENT * size)
    for axis, centre, half in zip("xyz", (low + high) / 2.0, extent / 2.0, strict=True):
        axes.set(
            **{f"{axis}lim": (centre - half, centre + half), f"{axis}ticks": ticks[np.abs(ticks - centre) <= half]}
        )
        getattr(axes, f"set_{axis}label")(f"{axis} [m]", labelpad=10.0)
    axes.set(box_aspect=extent)
