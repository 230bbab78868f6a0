"""Figs. 17, 18 and 19: the impact tests."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from scara_effmass.analysis.plot_style import CYCLE, ISO_RED, MARKERS, new_figure
from scara_effmass.paper.protocol import OBSTACLES_KG, POINTS, SHOWN_OBSTACLE_KG, point_name
from scara_effmass.paper.recorded_impact import mass_at, mean_peaks, origin, points_by_mass, root_reduced_mass
from scara_effmass.paper.scara import Scara

if TYPE_CHECKING:
    from scara_effmass.paper.figure_specs import FigureInputs


def figure_17(inputs: FigureInputs) -> Figure:
    """Draw position and velocity of the tool along x, and the instant of impact."""
    motion = inputs.motion
    figure = new_figure(10.5, 4.2, f"Fig. 17  Tool along x, {motion.source}")
    position, velocity = figure.subplots(1, 2)
    for axes, values, name, label in (
        (position, motion.x_m, "(a) position", "x [mm]"),
        (velocity, motion.speed_m_s, "(b) velocity", "velocity along x [mm/s]"),
    ):
        axes.plot(motion.time_s, 1e3 * values, color=CYCLE[0], linewidth=1.6)
        axes.axvline(motion.contact_s, color=ISO_RED, linestyle="--", zorder=1.5, label=motion.contact_label)
        axes.set(xlabel="time [s]", ylabel=label, title=name, xlim=(0.0, motion.time_s[-1]))
        axes.grid(alpha=0.3)
    figure.legend(*position.get_legend_handles_labels(), loc="outside lower left")
    return figure


def figure_18(inputs: FigureInputs) -> Figure:
    """Draw force over time for each configuration with one obstacle mass, one line per repetition."""
    scara = inputs.scara
    runs = [run for run in inputs.runs if run.obstacle_mass_kg == SHOWN_OBSTACLE_KG]
    title = f"Fig. 18  Impact force, {origin(runs)}, $m_H$ = {SHOWN_OBSTACLE_KG:g} kg"
    figure = new_figure(8.5, 4.8, title)
    axes = figure.subplots()
    for point, color in zip(points_by_mass(scara, runs), CYCLE, strict=False):
        label = f"{point_name(point)} mm, $m_{{n,s}}$ = {mass_at(scara, point):.2f} kg"
        for run in (run for run in runs if run.point == point):
            axes.plot(1e3 * run.time_s, run.force_n, color=color, linewidth=1.2, label=label)
            label = ""
    axes.set(xlabel="time since the onset [ms]", ylabel="force [N]")
    axes.grid(alpha=0.3)
    axes.legend(title="tool at the impact")
    return figure


def figure_19(inputs: FigureInputs) -> Figure:
    """Draw mean peak forces, if there are runs, and sqrt(mu) of the simplified model, by configuration."""
    scara, runs = inputs.scara, inputs.runs
    points = points_by_mass(scara, runs) if runs else sorted(POINTS, key=lambda point: mass_at(scara, point))
    title = "Fig. 19  Peak force and $\\sqrt{\\mu}$" if runs else "Fig. 19 (b)  $\\sqrt{\\mu}$, simplified model"
    figure = new_figure(10.5 if runs else 6.5, 4.8, title)
    panels = list(figure.subplots(1, 2 if runs else 1, squeeze=False)[0])
    root = "$\\sqrt{\\mu}$ [$\\sqrt{\\mathrm{kg}}$]"
    if runs:
        peaks = mean_peaks(runs)
        _draw_curves(panels[0], scara, points, lambda point, mass: peaks.get((point, mass)))
        panels[0].set(ylabel="mean peak force [N]", title=f"(a) {origin(runs)}")
    _draw_curves(panels[-1], scara, points, lambda point, mass: root_reduced_mass(scara, point, mass))
    panels[-1].set(ylabel=root, title="(b) simplified model")
    panels[-1].legend(title="$m_H$ [kg]", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _draw_curves(
    axes: Axes,
    scara: Scara,
    points: Sequence[tuple[float, float]],
    quantity: Callable[[tuple[float, float], float], float | None],
) -> None:
    """Draw `quantity`(point, mass) over the configurations, one curve per obstacle mass; None is left out."""
    for mass, color, marker in reversed(list(zip(OBSTACLES_KG, CYCLE, MARKERS, strict=True))):
        values = [(i, value) for i, point in enumerate(points) if (value := quantity(point, mass)) is not None]
        if values:
            axes.plot(*zip(*values, strict=True), marker=marker, color=color, linewidth=1.8, label=f"{mass:.2f}")
    names = [f"{point_name(point)} mm\n{mass_at(scara, point):.2f} kg" for point in points]
    axes.set_xticks(range(len(points)), names)
    axes.set(xlabel="tool at the impact, its effective mass $m_{n,s}$", xlim=(-0.3, len(points) - 0.7))
    axes.set_ylim(bottom=0.0)
    axes.grid(alpha=0.3)
