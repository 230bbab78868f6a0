# SPDX-License-Identifier: Apache-2.0
"""Pictures of a robot: the polytopes that `whole_arm` watches, the lumped masses, and the masses by motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D  # type: ignore[import-untyped]
from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]

from scara_effmass.analysis.report import CYCLE, INK, distinct_colors, figure_text, new_figure, styled
from scara_effmass.identification.regression import Z_95
from scara_effmass.model.hulls import triangles
from scara_effmass.model.lumping import LumpedModel
from scara_effmass.model.robot import Robot
from scara_effmass.values import FloatArray

if TYPE_CHECKING:
    from scara_effmass.analysis.identification import Identification

BALL_PT = 9.0
"""Diameter of the ball of a mass of 1 kg; its volume is in proportion to the mass."""
MIN_EXTENT = 0.4
"""Smallest extent of the axes, as a share of the largest."""
TICKS = 20
"""Approximate number of ticks over twice the size of the robot; all axes have the same."""


@styled
def draw_hulls(robot: Robot) -> Figure:
    """Return the picture of the hulls, the joints and the named contact points at the zero pose.

    A contact has the same colour in the maps of the workspace.
    """
    poses = _zero_poses(robot)
    parts = [poses[:, :3, 3]]
    figure = new_figure(9.5, 7.5, f"Hulls of {figure_text(robot.name)}: what whole_arm watches")
    axes = figure.add_subplot(projection="3d")
    shown: list[Artist] = axes.plot(*parts[0].T, "o-", color=INK, linewidth=1.0, markersize=3.0, label="joints")
    colors = distinct_colors(len(robot.contact_frames))
    for (name, index), color in zip(robot.contact_frames.items(), colors, strict=True):
        frame = robot.model.frames[index]
        if name in robot.hulls:
            faces = _placed(poses, frame.parentJoint, triangles(robot.hulls[name]))
            axes.add_collection(Poly3DCollection(faces, facecolors=color, shade=True, linewidth=0.0, alpha=0.35))
            shown.append(Patch(label=name, facecolor=color, alpha=0.35))
            parts.append(faces.reshape(-1, 3))
        else:
            parts.append(_placed(poses, frame.parentJoint, frame.placement.translation[None]))
            shown += axes.plot(*parts[-1].T, "D", color=color, markeredgecolor=INK, label=name)
    _set_equal_axes(axes, np.concatenate(parts))
    axes.legend(handles=shown, loc="center left", bbox_to_anchor=(1.12, 0.5))
    return figure


@styled
def draw_masses(robot: Robot, lumped: LumpedModel) -> Figure:
    """Return the picture of the masses on the robot at the zero pose, as in Figs. 1 and 3 of the paper."""
    poses = _zero_poses(robot)
    masses = [(mass.mass, _placed(poses, mass.joint, np.array(mass.point))) for mass in lumped.masses]
    origins = np.vstack([np.zeros(3), poses[:, :3, 3], _placed(poses, len(poses), robot.tip.translation)])
    everything = np.vstack([origins, *(at for _, at in masses)])
    reach = float(np.ptp(everything, axis=0).max()) / 8.0
    figure = new_figure(9.5, 7.5, f"Lumped masses of {figure_text(robot.name)}")
    axes = figure.add_subplot(projection="3d")
    axes.plot(*origins.T, color=CYCLE[0], linewidth=4.0, alpha=0.5, label="joint origins, base to tip")
    for joint in range(1, robot.model.njoints):
        ends = _placed(poses, joint, np.outer((-reach, reach), robot.axis_in_joint_frame(joint)))
        axes.plot(*ends.T, color=CYCLE[1], linestyle="--", linewidth=1.2, label="" if joint > 1 else "joint axes")
    labels: dict[tuple[float, ...], str] = {}  # by place: masses on the quill of a SCARA coincide
    for number, (mass, at) in enumerate(masses, start=1):
        key = tuple(np.round(at, 3).tolist())
        labels[key] = f"{labels.get(key, '')}   m_l{number} = {mass:.3g} kg"
        color = INK if mass > 0.0 else CYCLE[3]
        axes.plot(*at[:, None], "o", color=color, markersize=BALL_PT * abs(mass) ** (1.0 / 3.0), alpha=0.8)
    for key, label in labels.items():
        axes.text(*key, label.replace("kg   ", "kg\n   "), fontsize=8.5, va="center")
    _set_equal_axes(axes, everything)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return figure


@styled
def draw_identification(found: Identification) -> Figure:
    """Return the picture of one identification: masses beside those by the file, and torques beside those measured."""
    masses, torques, names = found.masses, found.torques, found.robot.joint_names
    title = figure_text(f"Masses of {found.robot.name} by {found.path.name}")
    figure = new_figure(12.0, max(4.5, 1.0 + 1.1 * len(names)), title)
    grid = figure.add_gridspec(len(names), 2, width_ratios=(1.0, 1.4))
    left = figure.add_subplot(grid[:, 0])
    kinds = np.array(masses.directions)
    for kind, color in zip(("worst", "vertical", "random"), distinct_colors(3), strict=True):
        rows = kinds == kind
        half = Z_95 * masses.deviations[rows]
        style: dict[str, Any] = {"fmt": ".", "color": color, "elinewidth": 0.5, "markersize": 3.0}
        left.errorbar(masses.stated[rows], masses.identified[rows], half, label=f"{kind} direction", **style)
    ends = np.percentile(np.concatenate((masses.stated, masses.identified)), [1.0, 98.0]) * [0.8, 1.25]
    left.plot(ends, ends, color=INK, linewidth=1.0, label="as by the file")
    left.set(xscale="log", yscale="log", xlim=ends, ylim=ends)
    left.set(xlabel="effective mass by the file [kg]", ylabel="identified, with 95 % [kg]")
    left.legend(loc="upper left")
    for i, (name, revolute) in enumerate(zip(names, found.robot.revolute, strict=True)):
        right, unit = figure.add_subplot(grid[i, 1]), "N m" if revolute else "N"
        right.plot(torques.seconds, torques.measured[:, i], color=CYCLE[0], linewidth=1.6, label="torque, recorded")
        right.plot(torques.seconds, torques.modelled[:, i], color=INK, linewidth=0.8, label="identified, in motion")
        right.set_title(f"{name} [{unit}]", fontsize="small", pad=2.0)
        right.tick_params(labelbottom=i == len(names) - 1)
        if i == 0:
            right.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
    right.set_xlabel("time [s], 0 at the end of the recording")
    return figure


def _zero_poses(robot: Robot) -> FloatArray:
    """Return the poses (n, 4, 4) of the joints at zero, or at the limit nearest to it."""
    model = robot.model
    return robot.joint_poses(np.clip(np.zeros(model.nv), model.lowerPositionLimit, model.upperPositionLimit))


def _placed(poses: FloatArray, joint: int, points: FloatArray) -> FloatArray:
    """Return `points` (..., 3) in the frame of joint number `joint`, from 1 on, in the base."""
    return np.asarray(points @ poses[joint - 1, :3, :3].T + poses[joint - 1, :3, 3])


def _set_equal_axes(axes: Axes3D, points: FloatArray) -> None:
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
