# SPDX-License-Identifier: Apache-2.0
"""Picture of identified masses: effective mass beside that by the file, and residuals of the torques."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from scara_effmass.analysis.identification import Identification
from scara_effmass.analysis.report import INK, STYLE, distinct_colors, new_figure
from scara_effmass.identification.regression import Z_95


def draw_identification(found: Identification) -> Figure:
    """Return the picture of one identification."""
    masses, solution, names = found.masses, found.estimate.solution, found.robot.joint_names
    with mpl.rc_context(STYLE):
        figure = new_figure(10.0, 4.5, f"Masses of {found.robot.name} by {found.path.name}")
        left, right = figure.subplots(1, 2)
        kinds = np.array(masses.directions)
        for kind, color in zip(("worst", "vertical", "random"), distinct_colors(3), strict=True):
            rows = kinds == kind
            half = Z_95 * masses.deviations[rows]
            style = {"fmt": ".", "color": color, "elinewidth": 0.5, "markersize": 3.0, "label": f"{kind} direction"}
            left.errorbar(masses.stated[rows], masses.identified[rows], half, **style)
        ends = np.percentile(np.concatenate((masses.stated, masses.identified)), [1.0, 98.0]) * [0.8, 1.25]
        left.plot(ends, ends, color=INK, linewidth=1.0, label="as by the file")
        left.set(xscale="log", yscale="log", xlim=ends, ylim=ends)
        left.set(xlabel="effective mass by the file [kg]", ylabel="identified, with 95 % [kg]")
        left.legend(loc="upper left")
        places = np.arange(len(names))
        right.bar(places - 0.2, solution.torques, 0.4, label="torque in motion")
        right.bar(places + 0.2, solution.residuals, 0.4, label="residual")
        right.set_xticks(places, names, rotation=30, ha="right")
        right.set(yscale="log", ylabel="root mean square [N m, N]")
        right.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return figure
