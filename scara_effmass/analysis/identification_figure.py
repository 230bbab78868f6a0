# SPDX-License-Identifier: Apache-2.0
"""Picture of identified masses: effective mass beside that by the file, and torques beside the measured ones."""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from scara_effmass.analysis.identification import Identification
from scara_effmass.analysis.report import CYCLE, INK, STYLE, distinct_colors, figure_text, new_figure
from scara_effmass.identification.regression import Z_95


def draw_identification(found: Identification) -> Figure:
    """Return the picture of one identification."""
    masses, torques, names = found.masses, found.torques, found.robot.joint_names
    with mpl.rc_context(STYLE):
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
