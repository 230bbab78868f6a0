# SPDX-License-Identifier: Apache-2.0
"""Picture of the masses of the lumped model on the robot."""

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from scara_effmass.analysis.plot_style import CYCLE, INK, STYLE, new_figure
from scara_effmass.model.lumping import LumpedModel
from scara_effmass.model.robot import Robot
from scara_effmass.values import FloatArray

BALL_PT = 9.0
"""Diameter of the ball of a mass of 1 kg in the picture; its volume is in proportion to the mass."""


@mpl.rc_context(STYLE)
def draw_masses(robot: Robot, lumped: LumpedModel) -> Figure:
    """Return the picture of the masses on the robot at its zero pose, as in Figs. 1 and 3 of the paper."""
    model = robot.model
    poses = robot.joint_poses(np.clip(np.zeros(model.nv), model.lowerPositionLimit, model.upperPositionLimit))

    def place(joint: int, point: FloatArray) -> FloatArray:
        return np.asarray(poses[joint - 1, :3, 3] + poses[joint - 1, :3, :3] @ point)

    masses = [(mass.mass, place(mass.joint, np.array(mass.point))) for mass in lumped.masses]
    origins = np.vstack([np.zeros(3), poses[:, :3, 3], place(len(poses), robot.tip.translation)])
    everything = np.vstack([origins, *(at for _, at in masses)])
    size = float(np.ptp(everything, axis=0).max()) / 2.0
    figure = new_figure(8.0, 7.5, f"Lumped masses of {robot.name}")
    axes = figure.add_subplot(projection="3d")
    axes.plot(*origins.T, color=CYCLE[0], linewidth=4.0, alpha=0.5, label="joint origins, base to tip")
    for joint in range(1, model.njoints):
        reach = 0.25 * size * robot.axis_in_joint_frame(joint)
        ends = np.array([place(joint, -reach), place(joint, reach)])
        axes.plot(*ends.T, color=CYCLE[1], linestyle="--", linewidth=1.2, label="" if joint > 1 else "joint axes")
    labels: dict[tuple[float, ...], str] = {}  # by place: masses on the quill of a SCARA coincide
    for number, (mass, at) in enumerate(masses, start=1):
        key = tuple(np.round(at, 3).tolist())
        labels[key] = f"{labels.get(key, '')}   m_l{number} = {mass:.3g} kg"
        color = INK if mass > 0.0 else CYCLE[3]
        axes.plot(*at[:, None], "o", color=color, markersize=BALL_PT * abs(mass) ** (1.0 / 3.0), alpha=0.8)
    for key, label in labels.items():
        axes.text(*key, label.replace("kg   ", "kg\n   "), fontsize=8.5, va="center")
    centre = (everything.max(axis=0) + everything.min(axis=0)) / 2.0
    axes.set(**{f"{axis}lim": (c - size, c + size) for axis, c in zip("xyz", centre, strict=True)})
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]", box_aspect=(1.0, 1.0, 1.0))
    axes.legend(loc="upper right")
    return figure
