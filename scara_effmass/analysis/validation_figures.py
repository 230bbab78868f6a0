# SPDX-License-Identifier: Apache-2.0
"""Figures of the validation report."""

import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

import matplotlib as mpl
import matplotlib.ticker
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from scara_effmass.analysis.plot_style import INK, ISO_RED, new_figure
from scara_effmass.impacts.validator import ModelResult, Result
from scara_effmass.input_files import read_table
from scara_effmass.iso15066 import force_per_root_stiffness
from scara_effmass.values import ValidatedImpact

N_MM = 1e3
EMPTY = "no impact could be paired with the robot"
MARKERS = "os^Dv<>pX*"
"""Markers of the configurations; they repeat if there are more."""
DARK, LIGHT = 0.0, 0.88
"""Range of the colour map with enough contrast to white."""
GREY = "#777777"
EXPONENTS = {"0.5, linear spring": (0.5, "--", GREY), "0.6, Hertz": (0.6, ":", GREY)}
ROOT = r"$v\sqrt{\mu}$ [m/s $\sqrt{\mathrm{kg}}$]"


class Marks:
    """Marker style of each impact of a series.

    `configurations` are in the order of their mean effective mass, `obstacle_masses` [kg] ascending.
    """

    def __init__(self, impacts: Iterable[ValidatedImpact]) -> None:
        masses: dict[str, list[float]] = {}
        obstacle_masses = set()
        for impact in impacts:
            masses.setdefault(impact.configuration, []).append(impact.effective_mass)
            obstacle_masses.add(impact.obstacle_mass)
        self.configurations = sorted(masses, key=lambda name: (float(np.mean(masses[name])), name))
        self.obstacle_masses = sorted(obstacle_masses)

    def marker(self, configuration: str) -> str:
        """Return the marker of a configuration."""
        return MARKERS[self.configurations.index(configuration) % len(MARKERS)]

    def scatter(self, axes: Axes, impacts: Iterable[ValidatedImpact], points: Iterable[tuple[float, float]]) -> None:
        """Draw one point for each impact."""
        for impact, (x, y) in zip(impacts, points, strict=True):
            shade = color(self.obstacle_masses.index(impact.obstacle_mass), len(self.obstacle_masses))
            axes.plot(x, y, self.marker(impact.configuration), color=shade, markersize=6.0, alpha=0.85, zorder=2)
        axes.grid(alpha=0.3)

    def legend(self, figure: Figure, *lines: Line2D) -> None:
        """Draw the legend of the markers and `lines` beside the axes."""
        count = len(self.obstacle_masses)
        handles = [*lines, Line2D([], [], color="none", label="$m_H$ [kg]")]
        handles += [
            Line2D([], [], linestyle="none", marker="o", color=color(number, count), label=f"{mass:g}")
            for number, mass in enumerate(self.obstacle_masses)
        ]
        handles.append(Line2D([], [], color="none", label="configuration"))
        handles += [
            Line2D([], [], linestyle="none", marker=self.marker(name), color=GREY, label=configuration_label(name))
            for name in self.configurations
        ]
        figure.legend(handles=handles, loc="outside right upper")


def color(number: int, count: int) -> tuple[float, float, float, float]:
    """Return colour `number` of `count`."""
    return mpl.colormaps["plasma"](DARK + (LIGHT - DARK) * number / max(count - 1, 1))


def configuration_label(configuration: str) -> str:
    """Return the label of a configuration, with `$` escaped for Matplotlib."""
    return configuration.replace("$", r"\$") or "not named"


class Plot(NamedTuple):
    """A figure: file name, title, caption and drawing function."""

    name: str
    title: str
    caption: str
    draw: Callable[[Result], Figure]


def draw_forces(result: Result) -> Figure:
    """Draw force over v sqrt(mu), one panel per model, with shared axes."""
    models, marks = result.models, Marks(result.impacts)
    figure = new_figure(3.7 * len(models) + 1.6, 4.9, f"{_origin(result)} force over $v\\sqrt{{\\mu}}$")
    panels = figure.subplots(1, len(models), sharex=True, sharey=True, squeeze=False)[0]
    panels[0].set_ylabel(f"{_origin(result).lower()} peak force [N]")
    points = {model.model: _points(model.model, result) for model in models}
    x_limit = 1.08 * max((x for model_points in points.values() for _, x in model_points), default=1.0)
    for axes, model in zip(panels, models, strict=True):
        data, overall = points[model.model], model.overall
        selected = ", selected" if model.model == result.model else ""
        axes.set(xlabel=ROOT, title=f"{model.model}{selected}")
        if not data:
            _annotate(axes, EMPTY if not result.impacts else "the robot has no such mass")
            continue
        marks.scatter(axes, [impact for impact, _ in data], [(x, impact.measured_force) for impact, x in data])
        axes.plot((0.0, x_limit), (0.0, math.sqrt(overall.stiffness) * x_limit), color=ISO_RED, linewidth=1.4, zorder=1)
        r = "undefined" if overall.correlation_reason else f"{overall.correlation:.5f}"
        lines = (f"r = {r}", f"k = {overall.stiffness / N_MM:.4g} N/mm", f"RMSE = {overall.relative_rmse:.2%}")
        axes.text(0.05, 0.95, "\n".join(lines), transform=axes.transAxes, va="top")
    panels[0].set(xlim=(0.0, x_limit))
    panels[0].set_ylim(bottom=0.0)
    marks.legend(figure, Line2D([], [], color=ISO_RED, linewidth=1.4, label=r"$F = v\sqrt{\mu k}$"))
    return figure


def draw_differences(result: Result) -> Figure:
    """Draw the Bland-Altman plot of the selected model."""
    origin = _origin(result).lower()
    title = f"Predicted minus {origin} force, {result.model} model"
    figure, axes, marks = _single(title, f"mean of predicted and {origin} force [N]", "difference [N]", result)
    if not result.impacts:
        return figure
    overall = _selected(result).overall
    points = [
        ((impact.predicted_force + impact.measured_force) / 2.0, impact.predicted_force - impact.measured_force)
        for impact in result.impacts
    ]
    marks.scatter(axes, result.impacts, points)
    axes.axhline(0.0, color=INK, linewidth=0.8)
    lines = [(overall.bias, "-", f"bias {overall.bias:+.2f} N")]
    if overall.limits:
        low, high = overall.limits
        lines += [(high, "--", f"upper limit {high:+.2f} N"), (low, "--", f"lower limit {low:+.2f} N")]
    handles = [axes.axhline(y, color=ISO_RED, linestyle=style, label=label) for y, style, label in lines]
    below = Line2D([], [], color="none", label="below 0: not conservative")
    marks.legend(figure, *sorted(handles, key=lambda line: -float(np.asarray(line.get_ydata())[0])), below)
    return figure


def draw_exponent(result: Result) -> Figure:
    """Draw force over J v on logarithmic axes; J is the impulse up to the peak."""
    labels = r"$J\,v$ [J], twice the energy", f"{_origin(result).lower()} peak force [N]"
    figure, axes, marks = _single("Exponent of the contact law", *labels, result)
    impacts = [impact for impact in result.impacts if impact.measured_reduced_mass > 0.0]
    if not impacts:
        return figure
    fit = _selected(result).fit
    energy = np.array([impact.measured_reduced_mass * impact.speed**2 for impact in impacts])
    force = np.array([impact.measured_force / impact.force_share for impact in impacts])
    marks.scatter(axes, impacts, list(zip(energy.tolist(), force.tolist(), strict=True)))
    ends = np.array([0.9 * energy.min(), 1.1 * energy.max()])
    middle_energy, middle_force = float(np.exp(np.log(energy).mean())), float(np.exp(np.log(force).mean()))
    title, lines = "exponent undefined: the energy varies too little", dict(EXPONENTS)
    if not math.isnan(fit.exponent):
        low, high = fit.exponent_interval
        title = f"exponent {fit.exponent:.3f} (95 %: {low:.3f} to {high:.3f})"
        lines = {"fitted": (fit.exponent, "-", ISO_RED)} | lines
    handles = []
    for label, (exponent, style, shade) in lines.items():
        forces = middle_force * (ends / middle_energy) ** exponent
        handles += axes.plot(ends, forces, color=shade, linestyle=style, label=label)
    axes.set(title=title, xscale="log", yscale="log")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(mpl.ticker.LogLocator(subs=(1.0, 2.0, 3.0, 5.0)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(mpl.ticker.NullFormatter())
    marks.legend(figure, *handles)
    return figure


def draw_masses(result: Result) -> Figure:
    """Draw mean measured and predicted force over obstacle mass, by configuration."""
    title = f"{_origin(result)} force over the mass of the obstacle"
    figure, axes, marks = _single(title, "$m_H$ [kg]", "peak force [N]", result)
    if not result.impacts:
        return figure
    handles = []
    for number, name in enumerate(marks.configurations):
        impacts = [impact for impact in result.impacts if impact.configuration == name]
        masses = sorted({impact.obstacle_mass for impact in impacts})
        marker, shade = marks.marker(name), color(number, len(marks.configurations))
        measured, predicted = (
            [_mean(getattr(impact, field) for impact in impacts if impact.obstacle_mass == mass) for mass in masses]
            for field in ("measured_force", "predicted_force")
        )
        points = [(impact.obstacle_mass, impact.measured_force) for impact in impacts]
        axes.plot(*zip(*points, strict=True), marker, color=shade, alpha=0.35, markersize=4.0)
        label = f"{configuration_label(name)}, {_mean(impact.effective_mass for impact in impacts):.2f} kg"
        handles += axes.plot(masses, measured, marker=marker, color=shade, linewidth=1.8, label=label)
        axes.plot(masses, predicted, color=INK, linestyle=":", linewidth=1.4, zorder=3)
    axes.set_xlim(left=0.0)
    axes.set_ylim(bottom=0.0)
    axes.grid(alpha=0.3)
    handles.append(Line2D([], [], color=INK, linestyle=":", label=f"predicted, {result.model}"))
    figure.legend(handles=handles, title="configuration, $m_n$", loc="outside right upper", alignment="left")
    return figure


_DRAW = {
    "force_over_root_mu": draw_forces,
    "force_over_obstacle_mass": draw_masses,
    "bland_altman": draw_differences,
    "exponent": draw_exponent,
}
_TEXTS = read_table(__file__, "validation_figures.yaml")
PLOTS = tuple(Plot(name, **_TEXTS[name], draw=draw) for name, draw in _DRAW.items())


def _points(model: str, result: Result) -> list[tuple[ValidatedImpact, float]]:
    """Return the impacts for which `model` has a mass, each with v sqrt(mu)."""
    return [
        (impact, force_per_root_stiffness(impact.speed, prediction.reduced_mass) * impact.force_share)
        for impact in result.impacts
        for prediction in impact.predictions
        if prediction.model == model
    ]


def _selected(result: Result) -> ModelResult:
    return next(model for model in result.models if model.model == result.model)


def _origin(result: Result) -> str:
    if not result.impacts or not result.simulated:
        return "Measured"
    return "Simulated" if result.simulated == len(result.impacts) else "In part simulated"


def _mean(values: Iterable[float]) -> float:
    return float(np.mean(list(values)))


def _single(title: str, xlabel: str, ylabel: str, result: Result) -> tuple[Figure, Axes, Marks]:
    """Return a figure with one pair of axes, and the marks of the impacts; without impacts a text says so."""
    figure = new_figure(10.5, 4.9, title)
    axes = figure.subplots()
    axes.set(xlabel=xlabel, ylabel=ylabel)
    if not _points(result.model, result):
        _annotate(axes, EMPTY)
    return figure, axes, Marks(result.impacts)


def _annotate(axes: Axes, text: str) -> None:
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center")
