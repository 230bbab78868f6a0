"""Fig. 7: poses of smallest and of largest effective mass along the normal, seen from above."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from scara_effmass.analysis.plot_style import CYCLE, INK, ISO_RED, new_figure
from scara_effmass.model.scara_closed_form import scara_max_lumped_mass
from scara_effmass.paper.scara import Scara

if TYPE_CHECKING:
    from scara_effmass.paper.figure_specs import FigureInputs

LIGHT_Q1, HEAVY_Q1 = math.radians(25.0), math.radians(-50.0)
"""Chosen here: the text of the paper does not give the angles of its two poses."""


def figure_7(inputs: FigureInputs) -> Figure:
    """Draw a pose of smallest and one of largest effective mass, along x."""
    scara = inputs.scara
    figure = new_figure(10.0, 5.0, "Fig. 7  Poses of smallest and of largest effective mass, n = [1 0 0]")
    light, heavy = figure.subplots(1, 2)
    q2 = -LIGHT_Q1 + math.pi / 2.0
    _draw_arm(light, scara, LIGHT_Q1, q2)
    light.set_title(
        "(a) second link across n:  $q_2 = -q_1 + \\phi + \\pi/2$\n"
        f"$m_{{x,s}} = M_3$ = {scara.lumped(LIGHT_Q1, q2):.2f} kg"
    )
    q2 = -HEAVY_Q1
    _draw_arm(heavy, scara, HEAVY_Q1, q2)
    heavy.set_title(
        "(b) second link along n:  $q_2 = -q_1 + \\phi$\n"
        f"$m_{{x,s}} = M_3 + M_2 / \\sin^2 q_2$ = {scara_max_lumped_mass(q2, scara.m2, scara.m3):.2f} kg"
    )
    return figure


def _draw_arm(axes: Axes, scara: Scara, q1: float, q2: float) -> None:
    elbow = scara.inertia.l1 * np.array([math.cos(q1), math.sin(q1)])
    tool = np.array(scara.tool(np.float64(q1), np.float64(q2)))  # type: ignore[arg-type]
    axes.plot([0.0, elbow[0], tool[0]], [0.0, elbow[1], tool[1]], color="#9AA5B1", linewidth=9.0, zorder=1)
    axes.plot(*elbow, "o", color=CYCLE[0], markeredgecolor="white", markersize=14.0 * math.sqrt(scara.m2), zorder=2)
    axes.plot(*tool, "o", color=CYCLE[1], markeredgecolor="white", markersize=14.0 * math.sqrt(scara.m3), zorder=2)
    axes.plot(0.0, 0.0, "o", color="white", markeredgecolor=INK, markersize=11.0, zorder=2)
    axes.text(elbow[0] + 0.03, elbow[1] - 0.04, f"$M_2$ = {scara.m2:.2f} kg", va="center")
    axes.text(tool[0] - 0.025, tool[1] + 0.045, f"$M_3$ = {scara.m3:.2f} kg", va="center", ha="right")
    arrow = {"arrowstyle": "-|>", "color": ISO_RED, "linewidth": 2.0, "shrinkA": 7.0}
    axes.annotate("", (tool[0] + 0.12, tool[1]), (tool[0], tool[1]), arrowprops=arrow)
    axes.text(tool[0] + 0.125, tool[1], "n", color=ISO_RED, fontweight="bold", va="center")
    axes.text(-0.02, 0.035, "joint 1", ha="center")
    angles = f"$q_1$ = {math.degrees(q1):.0f}°,  $q_2$ = {math.degrees(q2):.0f}°"
    angles = angles.replace("-", "\N{MINUS SIGN}")
    axes.text(0.97, 0.04, angles, transform=axes.transAxes, ha="right")
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", xlim=(-0.1, 0.65), ylim=(-0.36, 0.46))
