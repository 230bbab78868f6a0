"""Figs. 6, 9, 12, 14 and 15: effective mass, reduced mass and the simplified model's error as maps."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from scara_effmass.analysis.plot_style import new_figure
from scara_effmass.iso15066 import reduced_mass
from scara_effmass.paper.maps import ColorScale, draw_iso, draw_map, iso_handle, label_angles, label_workspace
from scara_effmass.paper.protocol import ALONG_X, ALONG_Y, OBLIQUE, SHOWN_OBSTACLE_KG
from scara_effmass.paper.scara import Scara, relative_error
from scara_effmass.paper.workspace import JointAngles, joint_grid, polar_grid
from scara_effmass.sim.motion import ElbowConfig
from scara_effmass.values import FloatArray

if TYPE_CHECKING:
    from scara_effmass.paper.figure_specs import FigureInputs

EFFECTIVE = ColorScale("effective mass $m_{x,s}$ [kg]", np.arange(0.75, 6.01, 0.25), np.arange(1.0, 6.1, 1.0), "max")
REDUCED = ColorScale(r"reduced mass $\mu_{n,s}$ [kg]", np.arange(0.6, 2.41, 0.1), np.arange(0.6, 2.41, 0.2))
ERROR = ColorScale(
    r"relative error $|m_{n,f} - m_{n,s}|\,/\,m_{n,f}$ [%]",
    np.arange(2.0, 10.1, 0.5),
    np.arange(2.0, 10.1, 1.0),
    "both",
)
CIRCLES, RAYS = 200, 721
"""Of Fig. 15: they resolve the edge where the reach of one arm ends."""


class Quantity(NamedTuple):
    """Values at poses, their colours, and the value and label of the red contour, if any."""

    values: FloatArray
    scale: ColorScale
    iso: float | None = None
    iso_label: str = ""


def figure_6(inputs: FigureInputs) -> Figure:
    """Draw the effective mass of the simplified model, along x."""
    scara, poses = inputs.scara, joint_grid(inputs.scara)
    label = f"$m_R$ = {scara.iso_mass:.2f} kg (ISO standard)"
    quantity = Quantity(scara.lumped(*poses), EFFECTIVE, scara.iso_mass, label)
    return _draw_both_spaces(scara, poses, quantity, "Fig. 6  Effective mass, simplified model, right arm, n = [1 0 0]")


def figure_9(inputs: FigureInputs) -> Figure:
    """Draw the relative error of the simplified model in effective mass, along x."""
    scara, poses = inputs.scara, joint_grid(inputs.scara)
    quantity = Quantity(relative_error(scara.full(*poses), scara.lumped(*poses)), ERROR)
    title = "Fig. 9  Error in effective mass, simplified against full model, right arm, n = [1 0 0]"
    return _draw_both_spaces(scara, poses, quantity, title)


def figure_12(inputs: FigureInputs) -> Figure:
    """Draw the reduced mass along y, and along (0.6, 0.8, 0)."""
    scara, poses = inputs.scara, joint_grid(inputs.scara)
    title = f"Fig. 12  Reduced mass, simplified model, right arm, $m_H$ = {SHOWN_OBSTACLE_KG:g} kg"
    figure = new_figure(11.0, 5.4, title)
    panels = figure.subplots(1, 2)
    for axes, phi, name in zip(panels, (ALONG_Y, OBLIQUE), ("(a) n = [0 1 0]", "(b) n = [0.6 0.8 0]"), strict=True):
        quantity = _reduced(scara, scara.lumped(*poses, phi))
        _draw_workspace(axes, scara.tool(*poses), quantity, phi, name)
    _add_scale_and_legend(figure, panels, quantity)
    return figure


def figure_14(inputs: FigureInputs) -> Figure:
    """Draw the reduced mass of the left arm, along x."""
    scara, poses = inputs.scara, joint_grid(inputs.scara, ElbowConfig.LEFT)
    quantity = _reduced(scara, scara.lumped(*poses, ALONG_X))
    title = f"Fig. 14  Reduced mass, simplified model, left arm, n = [1 0 0], $m_H$ = {SHOWN_OBSTACLE_KG:g} kg"
    return _draw_both_spaces(scara, poses, quantity, title)


def figure_15(inputs: FigureInputs) -> Figure:
    """Draw the smaller reduced mass of both arms, along x; where one arm reaches, that of this arm."""
    scara, grid = inputs.scara, polar_grid(inputs.scara, CIRCLES, RAYS)
    quantity = _reduced(scara, np.fmin(scara.lumped(*grid.right), scara.lumped(*grid.left)))
    figure = new_figure(7.4, 6.2, f"Fig. 15  Smaller reduced mass of both arms, $m_H$ = {SHOWN_OBSTACLE_KG:g} kg")
    axes = figure.subplots()
    _draw_workspace(axes, (grid.x, grid.y), quantity, ALONG_X, "simplified model, n = [1 0 0]")
    _add_scale_and_legend(figure, [axes], quantity)
    return figure


def _reduced(scara: Scara, mass: FloatArray) -> Quantity:
    iso = reduced_mass(scara.iso_mass, SHOWN_OBSTACLE_KG)
    label = rf"$\mu_{{\mathrm{{ISO}}}}$ = {iso:.2f} kg (ISO standard)"
    return Quantity(reduced_mass(mass, SHOWN_OBSTACLE_KG), REDUCED, iso, label)


def _draw_both_spaces(scara: Scara, poses: JointAngles, quantity: Quantity, title: str) -> Figure:
    figure = new_figure(11.5, 5.2, title)
    workspace, angles = figure.subplots(1, 2, width_ratios=(1.0, 1.05))
    _draw_workspace(workspace, scara.tool(*poses), quantity, ALONG_X, "(a) Cartesian space")
    _draw(angles, (np.degrees(poses.q1), np.degrees(poses.q2)), quantity)
    label_angles(angles, scara, poses)
    angles.set_title("(b) joint space")
    _add_scale_and_legend(figure, [workspace, angles], quantity)
    return figure


def _draw_workspace(axes: Axes, xy: tuple[FloatArray, FloatArray], quantity: Quantity, phi: float, title: str) -> None:
    """Draw the map, and the normal as an arrow from joint 1, in the hole of the workspace."""
    _draw(axes, xy, quantity)
    label_workspace(axes)
    axes.set_title(title)
    axes.plot(0.0, 0.0, "o", color="black", markersize=4.0)
    tip = (0.11 * np.cos(phi), 0.11 * np.sin(phi))
    axes.annotate("", tip, (0.0, 0.0), arrowprops={"arrowstyle": "-|>", "color": "black", "linewidth": 1.4})
    axes.text(-0.03 * np.cos(phi), -0.03 * np.sin(phi), "n", ha="center", va="center", fontweight="bold")


def _draw(axes: Axes, xy: tuple[FloatArray, FloatArray], quantity: Quantity) -> None:
    draw_map(axes, *xy, quantity.values, quantity.scale)
    if quantity.iso is not None:
        draw_iso(axes, *xy, quantity.values, quantity.scale, quantity.iso)


def _add_scale_and_legend(figure: Figure, panels: list[Axes], quantity: Quantity) -> None:
    quantity.scale.add_bar(figure, panels)
    if quantity.iso is not None:
        figure.legend(handles=[iso_handle(quantity.iso_label)], loc="outside lower left")
