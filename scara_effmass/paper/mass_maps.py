"""Figs. 6, 9, 12, 14 and 15: effective and reduced mass, and the lumped model's error, as flat maps."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from scara_effmass.analysis.plot_style import new_figure
from scara_effmass.iso15066 import reduced_mass
from scara_effmass.paper.maps import Scale, draw_iso, draw_map, dress_angles, dress_workspace, iso_handle
from scara_effmass.paper.protocol import ALONG_X, ALONG_Y, OBLIQUE, SHOWN_OBSTACLE_KG
from scara_effmass.paper.workspace import both_arms, joint_grid
from scara_effmass.sim.scara_kinematics import ElbowConfig

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from scara_effmass.paper.scara import Scara
    from scara_effmass.paper.workspace import Poses
    from scara_effmass.values import FloatArray

EFFECTIVE = Scale("effective mass $m_{x,s}$ [kg]", np.arange(0.75, 6.01, 0.25), np.arange(1.0, 6.1, 1.0), "max")
REDUCED = Scale(r"reduced mass $\mu_{n,s}$ [kg]", np.arange(0.6, 2.41, 0.1), np.arange(0.6, 2.41, 0.2))
ERROR = Scale(
    r"relative error $|m_{n,f} - m_{n,s}|\,/\,m_{n,f}$ [%]",
    np.arange(2.0, 10.1, 0.5),
    np.arange(2.0, 10.1, 1.0),
    "both",
)
FINE = (200, 721)
"""Circles and rays of Fig. 15, fine enough for the sharp edge where one arm's reach ends."""


class Quantity(NamedTuple):
    """Values at poses, how they are coloured, and where the red line goes (None: nowhere)."""

    values: FloatArray
    scale: Scale
    iso: float | None
    iso_label: str


def figure_6(scara: Scara) -> Figure:
    """Effective mass of the simplified model, along x."""
    poses = joint_grid(scara)
    quantity = Quantity(
        scara.lumped(*poses), EFFECTIVE, scara.iso_mass, f"$m_R$ = {scara.iso_mass:.2f} kg (ISO standard)"
    )
    return _both_spaces(scara, poses, quantity, "Fig. 6  Effective mass, simplified model, right arm, n = [1 0 0]")


def figure_9(scara: Scara) -> Figure:
    """Relative error in effective mass between full and simplified model, along x."""
    poses = joint_grid(scara)
    quantity = Quantity(relative_error(scara.full(*poses), scara.lumped(*poses)), ERROR, None, "")
    title = "Fig. 9  Error in effective mass, simplified against full model, right arm, n = [1 0 0]"
    return _both_spaces(scara, poses, quantity, title)


def figure_12(scara: Scara) -> Figure:
    """Reduced mass along y, and along (0.6, 0.8, 0)."""
    poses = joint_grid(scara)
    title = f"Fig. 12  Reduced mass, simplified model, right arm, $m_H$ = {SHOWN_OBSTACLE_KG:g} kg"
    figure = new_figure(11.0, 5.4, title)
    panels = figure.subplots(1, 2)
    for axes, phi, name in zip(panels, (ALONG_Y, OBLIQUE), ("(a) n = [0 1 0]", "(b) n = [0.6 0.8 0]"), strict=True):
        quantity = _reduced(scara, scara.lumped(*poses, phi))
        _draw(axes, scara.tool(*poses), quantity)
        dress_workspace(axes)
        axes.set_title(name)
        _draw_normal(axes, phi)
    REDUCED.add_bar(figure, panels)
    _add_legend(figure, quantity)
    return figure


def figure_14(scara: Scara) -> Figure:
    """Reduced mass of the left arm, along x."""
    poses = joint_grid(scara, ElbowConfig.LEFT)
    quantity = _reduced(scara, scara.lumped(*poses, ALONG_X))
    title = f"Fig. 14  Reduced mass, simplified model, left arm, n = [1 0 0], $m_H$ = {SHOWN_OBSTACLE_KG:g} kg"
    return _both_spaces(scara, poses, quantity, title)


def figure_15(scara: Scara) -> Figure:
    """The smaller one of both arms' reduced masses, along x; where one arm alone reaches, that one's."""
    places = both_arms(scara, *FINE)
    smaller = np.fmin(*(scara.lumped(*poses) for poses in (places.right, places.left)))
    quantity = _reduced(scara, smaller)
    figure = new_figure(7.4, 6.2, f"Fig. 15  Smaller reduced mass of both arms, $m_H$ = {SHOWN_OBSTACLE_KG:g} kg")
    axes = figure.subplots()
    _draw(axes, (places.x, places.y), quantity)
    dress_workspace(axes)
    axes.set_title("simplified model, n = [1 0 0]")
    _draw_normal(axes, ALONG_X)
    REDUCED.add_bar(figure, [axes])
    _add_legend(figure, quantity)
    return figure


def relative_error(full: FloatArray, simplified: FloatArray) -> FloatArray:
    """Return |full - simplified| / full [%]."""
    return np.asarray(100.0 * np.abs(full - simplified) / full)


def _reduced(scara: Scara, mass: FloatArray) -> Quantity:
    iso = reduced_mass(scara.iso_mass, SHOWN_OBSTACLE_KG)
    label = rf"$\mu_{{\mathrm{{ISO}}}}$ = {iso:.2f} kg (ISO standard)"
    return Quantity(reduced_mass(mass, SHOWN_OBSTACLE_KG), REDUCED, iso, label)


def _both_spaces(scara: Scara, poses: Poses, quantity: Quantity, title: str) -> Figure:
    figure = new_figure(11.5, 5.2, title)
    workspace, angles = figure.subplots(1, 2, width_ratios=(1.0, 1.05))
    _draw(workspace, scara.tool(*poses), quantity)
    dress_workspace(workspace)
    workspace.set_title("(a) Cartesian space")
    _draw_normal(workspace, ALONG_X)
    _draw(angles, (np.degrees(poses.q1), np.degrees(poses.q2)), quantity)
    dress_angles(angles, scara, poses)
    angles.set_title("(b) joint space")
    quantity.scale.add_bar(figure, [workspace, angles])
    _add_legend(figure, quantity)
    return figure


def _draw(axes: Axes, at: tuple[FloatArray, FloatArray], quantity: Quantity) -> None:
    draw_map(axes, *at, quantity.values, quantity.scale)
    if quantity.iso is not None:
        draw_iso(axes, *at, quantity.values, quantity.scale, quantity.iso)


def _draw_normal(axes: Axes, phi: float) -> None:
    """Draw the impact direction from the robot's first axis, in the hole of the workspace."""
    axes.plot(0.0, 0.0, "o", color="black", markersize=4.0)
    tip = (0.11 * np.cos(phi), 0.11 * np.sin(phi))
    axes.annotate("", tip, (0.0, 0.0), arrowprops={"arrowstyle": "-|>", "color": "black", "linewidth": 1.4})
    axes.text(-0.03 * np.cos(phi), -0.03 * np.sin(phi), "n", ha="center", va="center", fontweight="bold")


def _add_legend(figure: Figure, quantity: Quantity) -> None:
    if quantity.iso is not None:
        figure.legend(handles=[iso_handle(quantity.iso_label)], loc="outside lower left")
