"""The figures of a validation."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import matplotlib as mpl
import matplotlib.ticker
import numpy as np
from matplotlib.lines import Line2D

from scara_effmass.analysis.plot_style import INK, ISO_RED, new_figure
from scara_effmass.analysis.validation_marks import GREY, Marks, color, shown
from scara_effmass.iso15066 import force_per_root_stiffness

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from scara_effmass.impacts.result import ModelResult, Result
    from scara_effmass.values import FloatArray, ValidatedImpact

N_MM = 1e3
EXPONENTS = {"0.5, linear spring": (0.5, "--"), "0.6, Hertz": (0.6, ":")}
EMPTY = "no impact could be paired with the robot"
ROOT = r"$v\sqrt{\mu}$ [m/s $\sqrt{\mathrm{kg}}$]"


class Plot(NamedTuple):
    """A figure: name of its files, what it is called, what it shows, and what draws it."""

    name: str
    title: str
    caption: str
    draw: Callable[[Result], Figure]


def draw_forces(result: Result) -> Figure:
    """Force over v sqrt(mu) of every model, on the same axes."""
    models, marks = result.models, Marks(result.impacts)
    figure = new_figure(3.7 * len(models) + 1.6, 4.9, f"{_origin(result)} force over $v\\sqrt{{\\mu}}$")
    panels = figure.subplots(1, len(models), sharex=True, sharey=True, squeeze=False)[0]
    panels[0].set_ylabel(f"{_origin(result).lower()} peak force [N]")
    points = {model.model: _with(model.model, result) for model in models}
    reach = 1.08 * max((x for found in points.values() for _, x in found), default=1.0)
    for axes, model in zip(panels, models, strict=True):
        found, overall = points[model.model], model.overall
        judged = ", judged" if model.model == result.model else ""
        axes.set(xlabel=ROOT, title=f"{model.model}{judged}")
        if not found:
            _say(axes, EMPTY if not result.impacts else "the robot has no such mass")
            continue
        marks.scatter(axes, [impact for impact, _ in found], [(x, impact.measured_force) for impact, x in found])
        axes.plot((0.0, reach), (0.0, math.sqrt(overall.stiffness) * reach), color=ISO_RED, linewidth=1.4, zorder=1)
        r = "undefined" if overall.correlation_reason else f"{overall.correlation:.5f}"
        lines = (f"r = {r}", f"k = {overall.stiffness / N_MM:.4g} N/mm", f"RMSE = {overall.relative_rmse:.2%}")
        axes.text(0.05, 0.95, "\n".join(lines), transform=axes.transAxes, va="top")
    panels[0].set(xlim=(0.0, reach))
    panels[0].set_ylim(bottom=0.0)
    marks.legend(figure, Line2D([], [], color=ISO_RED, linewidth=1.4, label=r"$F = v\sqrt{\mu k}$"))
    return figure


def draw_differences(result: Result) -> Figure:
    """Bland and Altman's plot of the judged model."""
    figure = new_figure(10.5, 4.9, f"Predicted minus {_origin(result).lower()} force, {result.model} model")
    axes = figure.subplots()
    marks = Marks(result.impacts)
    axes.set(xlabel=f"mean of predicted and {_origin(result).lower()} force [N]", ylabel="difference [N]")
    if not result.impacts:
        _say(axes, EMPTY)
        return figure
    overall = _judged(result).overall
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
    """Force over mu v^2 on logarithmic axes, for the judged model."""
    figure = new_figure(10.5, 4.9, f"Law of the contact, {result.model} model")
    axes = figure.subplots()
    marks = Marks(result.impacts)
    axes.set(xlabel=r"$\mu v^2$ [J], twice the energy", ylabel=f"{_origin(result).lower()} peak force [N]")
    found = _with(result.model, result)
    if not found:
        _say(axes, EMPTY)
        return figure
    overall = _judged(result).overall
    energy = np.array([x**2 for _, x in found])
    force = np.array([impact.measured_force for impact, _ in found])
    marks.scatter(axes, result.impacts, list(zip(energy.tolist(), force.tolist(), strict=True)))
    ends = np.array([0.9 * energy.min(), 1.1 * energy.max()])
    middle = float(np.exp(np.log(energy).mean())), float(np.exp(np.log(force).mean()))
    handles = []
    if overall.exponent is None:
        title = f"exponent undefined: {overall.correlation_reason}"
    else:
        title = f"exponent {_number(overall.exponent, overall.exponent_interval)}"
        handles += axes.plot(ends, _power(ends, middle, overall.exponent), color=ISO_RED, label="fitted")
    for label, (exponent, style) in EXPONENTS.items():
        handles += axes.plot(ends, _power(ends, middle, exponent), color=GREY, linestyle=style, label=label)
    axes.set(title=title, xscale="log", yscale="log")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(mpl.ticker.LogLocator(subs=(1.0, 2.0, 3.0, 5.0)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(mpl.ticker.NullFormatter())
    marks.legend(figure, *handles)
    return figure


def draw_masses(result: Result) -> Figure:
    """Force over the obstacle's mass, by configuration: mean of the impacts, and mean prediction."""
    figure = new_figure(10.5, 4.9, f"{_origin(result)} force over the mass of the obstacle")
    axes = figure.subplots()
    marks = Marks(result.impacts)
    axes.set(xlabel="$m_H$ [kg]", ylabel="peak force [N]")
    if not result.impacts:
        _say(axes, EMPTY)
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
        axes.plot(
            [impact.obstacle_mass for impact in impacts],
            [impact.measured_force for impact in impacts],
            linestyle="none",
            marker=marker,
            color=shade,
            alpha=0.35,
            markersize=4.0,
        )
        label = f"{shown(name)}, {_mean(impact.effective_mass for impact in impacts):.2f} kg"
        handles += axes.plot(masses, measured, marker=marker, color=shade, linewidth=1.8, label=label)
        axes.plot(masses, predicted, color=INK, linestyle=":", linewidth=1.4, zorder=3)
    axes.set_xlim(left=0.0)
    axes.set_ylim(bottom=0.0)
    axes.grid(alpha=0.3)
    handles.append(Line2D([], [], color=INK, linestyle=":", label=f"predicted, {result.model}"))
    title = "configuration, $m_n$"
    figure.legend(handles=handles, title=title, loc="outside right upper", alignment="left")
    return figure


PLOTS = (
    Plot(
        "force_over_root_mu",
        "Force over v√μ.",
        "Every model on the same impacts and axes; the line goes through the origin, its slope is √k. A model that "
        "explains the forces has its points on the line.",
        draw_forces,
    ),
    Plot(
        "force_over_obstacle_mass",
        "Force over the mass of the obstacle,",
        "by configuration, with the robot's mean effective mass in it: means as lines, single impacts as pale points.",
        draw_masses,
    ),
    Plot(
        "bland_altman",
        "Bland-Altman plot",
        "of the judged model; 95 % of normal differences lie between the limits.",
        draw_differences,
    ),
    Plot(
        "exponent",
        "Exponent of the law.",
        "Logarithms of force and energy, judged model. Damping, friction, a contact that is no linear spring, or "
        "masses that are off turn the line away from 0.5.",
        draw_exponent,
    ),
)


def _with(model: str, result: Result) -> list[tuple[ValidatedImpact, float]]:
    """Return the impacts for which `model` has a mass, with v sqrt(mu)."""
    return [
        (impact, force_per_root_stiffness(impact.speed, prediction.reduced_mass))
        for impact in result.impacts
        for prediction in impact.predictions
        if prediction.model == model
    ]


def _judged(result: Result) -> ModelResult:
    return next(model for model in result.models if model.model == result.model)


def _origin(result: Result) -> str:
    if not result.impacts or not result.simulated:
        return "Measured"
    return "Simulated" if result.simulated == len(result.impacts) else "In part simulated"


def _mean(values: Iterable[float]) -> float:
    return float(np.mean(list(values)))


def _power(x: FloatArray, through: tuple[float, float], exponent: float) -> FloatArray:
    return through[1] * (x / through[0]) ** exponent


def _number(value: float, interval: Sequence[float] | None) -> str:
    return f"{value:.3f}" + (f" (95 %: {interval[0]:.3f} to {interval[1]:.3f})" if interval else "")


def _say(axes: Axes, text: str) -> None:
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center")
