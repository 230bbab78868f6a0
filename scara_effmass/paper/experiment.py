# SPDX-License-Identifier: Apache-2.0
"""Figs. 17, 18 and 19: the impact tests."""

from collections.abc import Callable, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from scara_effmass.analysis.plot_style import CYCLE, ISO_RED, MARKERS, new_figure
from scara_effmass.paper.runs import FigureInputs, Point, mass_at, mean_peaks, origin, points_by_mass, root_reduced_mass
from scara_effmass.paper.scara import OBSTACLES_KG, SHOWN_OBSTACLE_KG, Scara


def figure_17(inputs: FigureInputs) -> Figure:
    """Draw position and velocity of the tool along x, and the instant of impact."""
    run = inputs.shown_run
    figure = new_figure(10.5, 4.2, f"Fig. 17  Tool along x, {run.source}")
    position, velocity = figure.subplots(1, 2)
    for axes, values, name, label in (
        (position, run.x, "(a) position", "x [mm]"),
        (velocity, run.velocity, "(b) velocity", "velocity along x [mm/s]"),
    ):
        axes.plot(run.time, 1e3 * values, color=CYCLE[0], linewidth=1.6)
        axes.axvline(run.onset, color=ISO_RED, linestyle="--", zorder=1.5, label="instant of impact")
        axes.set(xlabel="time [s]", ylabel=label, title=name, xlim=(0.0, run.time[-1]))
        axes.grid(alpha=0.3)
    figure.legend(*position.get_legend_handles_labels(), loc="outside lower left")
    return figure


def figure_18(inputs: FigureInputs) -> Figure:
    """Draw force over time for each configuration with one obstacle mass, one line per repetition."""
    scara = inputs.scara
    shown_mass = min((run.obstacle_mass for run in inputs.runs), key=lambda mass: abs(mass - SHOWN_OBSTACLE_KG))
    runs = [run for run in inputs.runs if run.obstacle_mass == shown_mass]
    figure = new_figure(8.5, 4.8, f"Fig. 18  Impact force, {origin(runs)}, $m_H$ = {shown_mass:g} kg")
    axes = figure.subplots()
    for point, color in zip(points_by_mass(scara, runs), CYCLE, strict=False):
        label = f"{_point_name(point)} mm, $m_{{n,s}}$ = {mass_at(scara, point):.2f} kg"
        for run in (run for run in runs if run.point == point):
            axes.plot(1e3 * run.force_time, run.force, color=color, linewidth=1.2, label=label)
            label = ""
    axes.set(xlabel="time since the onset [ms]", ylabel="force [N]")
    axes.grid(alpha=0.3)
    axes.legend(title="tool at the impact")
    return figure


def figure_19(inputs: FigureInputs) -> Figure:
    """Draw mean peak forces and sqrt(mu) of the simplified model by configuration."""
    scara, peaks = inputs.scara, mean_peaks(inputs.runs)
    points = points_by_mass(scara, inputs.runs)
    figure = new_figure(10.5, 4.8, "Fig. 19  Peak force and $\\sqrt{\\mu}$")
    forces, roots = figure.subplots(1, 2)
    _draw_curves(forces, scara, points, lambda point, mass: peaks.get((point, mass)))
    forces.set(ylabel="mean peak force [N]", title=f"(a) {origin(inputs.runs)}")
    _draw_curves(roots, scara, points, lambda point, mass: root_reduced_mass(scara, point, mass))
    roots.set(ylabel="$\\sqrt{\\mu}$ [$\\sqrt{\\mathrm{kg}}$]", title="(b) simplified model")
    roots.legend(title="$m_H$ [kg]", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _draw_curves(
    axes: Axes,
    scara: Scara,
    points: Sequence[Point],
    quantity: Callable[[Point, float], float | None],
) -> None:
    """Draw `quantity`(point, mass) over the configurations, one curve per obstacle mass; None is not drawn."""
    for mass, color, marker in reversed(list(zip(OBSTACLES_KG, CYCLE, MARKERS, strict=True))):
        values = [(i, value) for i, point in enumerate(points) if (value := quantity(point, mass)) is not None]
        if values:
            axes.plot(*zip(*values, strict=True), marker=marker, color=color, linewidth=1.8, label=f"{mass:.2f}")
    names = [f"{_point_name(point)} mm\n{mass_at(scara, point):.2f} kg" for point in points]
    axes.set_xticks(range(len(points)), names)
    axes.set(xlabel="tool at the impact, its effective mass $m_{n,s}$", xlim=(-0.3, len(points) - 0.7))
    axes.set_ylim(bottom=0.0)
    axes.grid(alpha=0.3)


def _point_name(point: Point) -> str:
    """Return the point as the paper writes it, in [mm]."""
    x, y = (round(1e3 * coordinate) for coordinate in point)
    return f"({x}, {y})".replace("-", "\N{MINUS SIGN}")
