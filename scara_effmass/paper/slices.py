"""Figs. 10 and 11: reduced mass and the simplified model's error in it, one slice per obstacle mass."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from scara_effmass.analysis.plot_style import ISO_RED, new_figure
from scara_effmass.iso15066 import reduced_mass
from scara_effmass.paper.maps import ColorScale, iso_handle
from scara_effmass.paper.protocol import OBSTACLES_KG
from scara_effmass.paper.scara import Scara, relative_error
from scara_effmass.paper.workspace import joint_grid
from scara_effmass.values import FloatArray

if TYPE_CHECKING:
    from mpl_toolkits.mplot3d.axes3d import Axes3D  # type: ignore[import-untyped]

    from scara_effmass.paper.figure_specs import FigureInputs

TICKS_M = (-0.4, 0.0, 0.4)
REDUCED = ColorScale(r"reduced mass $\mu_{n,s}$ [kg]", np.arange(0.3, 4.01, 0.1), np.arange(0.5, 4.01, 0.5), "max")
ERROR = ColorScale(
    r"relative error $|\mu_{n,f} - \mu_{n,s}|\,/\,\mu_{n,f}$ [%]",
    np.arange(0.0, 5.01, 0.25),
    np.arange(0.0, 5.01, 1.0),
    "max",
)


def figure_10(inputs: FigureInputs) -> Figure:
    """Draw the reduced mass of the simplified model for four obstacle masses, along x."""
    scara = inputs.scara
    lumped = scara.lumped(*joint_grid(scara))
    slices = [reduced_mass(lumped, obstacle) for obstacle in OBSTACLES_KG]
    iso = [reduced_mass(scara.iso_mass, obstacle) for obstacle in OBSTACLES_KG]
    figure = _draw_slices(
        scara, slices, REDUCED, "Fig. 10  Reduced mass, simplified model, right arm, n = [1 0 0]", iso
    )
    values = ", ".join(f"{mu:.2f}" for mu in iso)
    label = rf"$\mu_{{\mathrm{{ISO}}}}$ = {values} kg (ISO standard), from the bottom up"
    figure.legend(handles=[iso_handle(label)], loc="outside lower left")
    return figure


def figure_11(inputs: FigureInputs) -> Figure:
    """Draw the relative error in reduced mass for four obstacle masses, along x."""
    scara = inputs.scara
    poses = joint_grid(scara)
    lumped, full = scara.lumped(*poses), scara.full(*poses)
    slices = [relative_error(reduced_mass(full, m_h), reduced_mass(lumped, m_h)) for m_h in OBSTACLES_KG]
    title = "Fig. 11  Error in reduced mass, simplified against full model, right arm, n = [1 0 0]"
    return _draw_slices(scara, slices, ERROR, title, [None] * len(slices))


def _draw_slices(
    scara: Scara, slices: Sequence[FloatArray], scale: ColorScale, title: str, iso: Sequence[float | None]
) -> Figure:
    poses = joint_grid(scara)
    figure = new_figure(12.5, 7.2, title)
    workspace: Axes3D = figure.add_subplot(1, 2, 1, projection="3d", computed_zorder=False)
    angles: Axes3D = figure.add_subplot(1, 2, 2, projection="3d", computed_zorder=False)
    x, y = scara.tool(*poses)
    q1, q2 = np.degrees(poses.q1), np.degrees(poses.q2)
    for axes, across, up in ((workspace, x, y), (angles, q1, q2)):
        for level, (values, red) in enumerate(zip(slices, iso, strict=True)):
            _draw_slice(axes, across, up, scale.clip(values), scale, level, red)
        # Evenly spaced: in proportion to the masses, the two slices in the middle would hide each other.
        axes.set(zlim=(0.0, len(OBSTACLES_KG) - 1.0), zticks=range(len(OBSTACLES_KG)))
        axes.set_zticklabels([f"{obstacle:.2f}" for obstacle in OBSTACLES_KG])
        axes.set_zlabel("obstacle mass $m_H$ [kg]", labelpad=8.0)
        axes.view_init(elev=23.0, azim=-60.0)
        axes.set_box_aspect((1.0, 1.0, 1.5))
    workspace.set(xlabel="x [m]", ylabel="y [m]", xlim=(-0.6, 0.6), ylim=(-0.6, 0.6), xticks=TICKS_M, yticks=TICKS_M)
    workspace.set_title("(a) Cartesian space")
    angles.set(xlabel="$q_1$ [deg]", ylabel="$q_2$ [deg]", xlim=(q1.min(), q1.max()), ylim=(q2.min(), q2.max()))
    angles.set(xticks=(-120.0, -60.0, 0.0, 60.0), yticks=(0.0, 60.0, 120.0))
    angles.set_title("(b) joint space")
    scale.add_bar(figure, [workspace, angles], shrink=0.7, pad=0.06)
    return figure


def _draw_slice(
    axes: Axes3D, x: FloatArray, y: FloatArray, values: FloatArray, scale: ColorScale, level: int, iso: float | None
) -> None:
    place = {"zdir": "z", "offset": level}
    options = {"levels": scale.levels, "norm": scale.norm, "extend": scale.extend}
    axes.contourf(x, y, values, zorder=3 * level, **place, **options)
    if iso is not None:
        lines = axes.contour(x, y, values, levels=[iso], colors=ISO_RED, linewidths=1.8, zorder=3 * level + 1, **place)
        lines.set_path_effects([withStroke(linewidth=3.0, foreground="white")])
