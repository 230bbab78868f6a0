"""Figs. 10 and 11: reduced mass, and the lumped model's error in it, stacked over the four obstacle masses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.patheffects import withStroke

from scara_effmass.analysis.plot_style import ISO_RED, new_figure
from scara_effmass.iso15066 import reduced_mass
from scara_effmass.paper.maps import Scale, iso_handle
from scara_effmass.paper.mass_maps import relative_error
from scara_effmass.paper.protocol import OBSTACLES_KG
from scara_effmass.paper.workspace import joint_grid

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d.axes3d import Axes3D  # type: ignore[import-untyped]

    from scara_effmass.paper.scara import Scara
    from scara_effmass.values import FloatArray

CORNERS_M = (-0.4, 0.0, 0.4)
REDUCED = Scale(r"reduced mass $\mu_{n,s}$ [kg]", np.arange(0.3, 4.01, 0.1), np.arange(0.5, 4.01, 0.5), "max")
ERROR = Scale(
    r"relative error $|\mu_{n,f} - \mu_{n,s}|\,/\,\mu_{n,f}$ [%]",
    np.arange(0.0, 5.01, 0.25),
    np.arange(0.0, 5.01, 1.0),
    "max",
)


def figure_10(scara: Scara) -> Figure:
    """Reduced mass of the simplified model for four obstacle masses, along x."""
    lumped = scara.lumped(*joint_grid(scara))
    title = "Fig. 10  Reduced mass, simplified model, right arm, n = [1 0 0]"
    figure = _stacks(
        scara,
        lambda obstacle: reduced_mass(lumped, obstacle),
        REDUCED,
        title,
        lambda obstacle: reduced_mass(scara.iso_mass, obstacle),
    )
    values = ", ".join(f"{reduced_mass(scara.iso_mass, obstacle):.2f}" for obstacle in OBSTACLES_KG)
    label = rf"$\mu_{{\mathrm{{ISO}}}}$ = {values} kg (ISO standard), from the bottom up"
    figure.legend(handles=[iso_handle(label)], loc="outside lower left")
    return figure


def figure_11(scara: Scara) -> Figure:
    """Relative error in reduced mass for four obstacle masses, along x."""
    poses = joint_grid(scara)
    lumped, full = scara.lumped(*poses), scara.full(*poses)
    title = "Fig. 11  Error in reduced mass, simplified against full model, right arm, n = [1 0 0]"
    return _stacks(
        scara,
        lambda obstacle: relative_error(reduced_mass(full, obstacle), reduced_mass(lumped, obstacle)),
        ERROR,
        title,
    )


def _stacks(
    scara: Scara,
    law: Callable[[float], FloatArray],
    scale: Scale,
    title: str,
    iso: Callable[[float], float] | None = None,
) -> Figure:
    poses = joint_grid(scara)
    figure = new_figure(12.5, 7.2, title)
    workspace: Axes3D = figure.add_subplot(1, 2, 1, projection="3d", computed_zorder=False)
    angles: Axes3D = figure.add_subplot(1, 2, 2, projection="3d", computed_zorder=False)
    x, y = scara.tool(*poses)
    q1, q2 = np.degrees(poses.q1), np.degrees(poses.q2)
    for axes, across, up in ((workspace, x, y), (angles, q1, q2)):
        for level, obstacle in enumerate(OBSTACLES_KG):
            _draw_slice(axes, across, up, law(obstacle), scale, level, None if iso is None else iso(obstacle))
        # One height apart each: in proportion to the masses, the two in the middle would hide each other.
        axes.set(zlim=(0.0, len(OBSTACLES_KG) - 1.0), zticks=range(len(OBSTACLES_KG)))
        axes.set_zticklabels([f"{obstacle:.2f}" for obstacle in OBSTACLES_KG])
        axes.set_zlabel("obstacle mass $m_H$ [kg]", labelpad=8.0)
        axes.view_init(elev=23.0, azim=-60.0)
    workspace.set(
        xlabel="x [m]", ylabel="y [m]", xlim=(-0.6, 0.6), ylim=(-0.6, 0.6), xticks=CORNERS_M, yticks=CORNERS_M
    )
    workspace.set_title("(a) Cartesian space")
    workspace.set_box_aspect((1.0, 1.0, 1.5))
    angles.set(xlabel="$q_1$ [deg]", ylabel="$q_2$ [deg]", xlim=(q1.min(), q1.max()), ylim=(q2.min(), q2.max()))
    angles.set(xticks=(-120.0, -60.0, 0.0, 60.0), yticks=(0.0, 60.0, 120.0))
    angles.set_title("(b) joint space")
    angles.set_box_aspect((1.0, 1.0, 1.5))
    scale.add_bar(figure, [workspace, angles], shrink=0.7, pad=0.06)
    return figure


def _draw_slice(
    axes: Axes3D, across: FloatArray, up: FloatArray, values: FloatArray, scale: Scale, level: int, iso: float | None
) -> None:
    drawable = scale.drawable(values)
    axes.contourf(
        across,
        up,
        drawable,
        zdir="z",
        offset=level,
        levels=scale.levels,
        norm=scale.norm,
        extend=scale.extend,
        zorder=3 * level,
    )
    if iso is not None:
        lines = axes.contour(
            across,
            up,
            drawable,
            zdir="z",
            offset=level,
            levels=[iso],
            colors=ISO_RED,
            linewidths=1.8,
            zorder=3 * level + 1,
        )
        lines.set_path_effects([withStroke(linewidth=3.0, foreground="white")])
