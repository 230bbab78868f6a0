# SPDX-License-Identifier: Apache-2.0
"""Report of a validation: a page, figures, and all results as JSON, written completely or not at all."""

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.ticker
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from scara_effmass import __version__
from scara_effmass.analysis.forces import AFTER_S, ShownTrace
from scara_effmass.analysis.output import json_types
from scara_effmass.analysis.report import (
    ENGLISH_PAGE,
    INK,
    ISO_RED,
    PAGE,
    PageOptions,
    ReportFigure,
    figure_files,
    figure_text,
    file_hashes,
    new_figure,
    render,
    report_figure,
    setting_rows,
    styled,
    write_report_files,
)
from scara_effmass.analysis.validation import Validation, ValidationSettings
from scara_effmass.impacts.agreement import RegionForce, region_force
from scara_effmass.impacts.impact_matcher import REBOUND
from scara_effmass.impacts.load import READS_LOW, left_out_text
from scara_effmass.impacts.validator import ModelResult, Result
from scara_effmass.input_files import read_table
from scara_effmass.iso15066 import Limit, force_per_root_stiffness, limits_for
from scara_effmass.model.robot import Robot
from scara_effmass.values import LeftOut, ValidatedImpact, Verdict, at_least, at_most

RECORD = "report.json"
FIGURES = read_table(__file__, "validation_figures.yaml")
"""Titles and captions of the figures by name, in their order."""
FILES = (PAGE, RECORD, *figure_files(FIGURES))
"""Names of all files of a report."""
UNITS = {
    "force": "N",
    "mass": "kg",
    "speed": "m/s",
    "stiffness": "N/m",
    "bias": "N",
    "rmse": "N",
    "limits": "N",
    "impulse": "N s",
    "clock_offset": "s",
    "stamp_ns": "ns, ROS time",
}
NOT_CONVERTED = "as measured, because no impact could be paired with the robot"
NO_FORCE = "no force to compare"
NO_IMPACT = "no impact could be paired with the robot"
MARKERS = "os^Dv<>pX*"
"""Markers of the configurations; they repeat if there are more."""
DARK, LIGHT = 0.0, 0.88
"""Range of the colour map with enough contrast to white."""
GREY = "#777777"
EXPONENTS = {"0.5, linear spring": (0.5, "--", GREY), "0.6, Hertz": (0.6, ":", GREY)}
ROOT = r"$v\sqrt{\mu}$ [m/s $\sqrt{\mathrm{kg}}$]"


@styled
def write_report(
    validation: Validation,
    settings: ValidationSettings,
    robot: Robot,
    folder: Path,
    options: PageOptions = ENGLISH_PAGE,
    *,
    overwrite: bool,
) -> dict[str, Any]:
    """Write `FILES` into `folder`; return the content of `RECORD`. Raises OutputError and BagError."""
    drawings = (draw(validation.result) for draw in (draw_forces, draw_masses, draw_differences, draw_exponent))
    figures = [
        report_figure(name, texts["title"], texts["caption"], drawing, options.language)
        for (name, texts), drawing in zip(FIGURES.items(), drawings, strict=True)
    ]
    results = record(validation, settings, robot)
    page = _page(validation, figures, settings, robot, options.language)
    write_report_files(folder, {PAGE: page, RECORD: results}, figures, options, overwrite=overwrite)
    return results


def summary_lines(validation: Validation) -> Iterator[tuple[str, str]]:
    """Yield subject and text of each line of a summary."""
    result = validation.result
    yield "result", result.verdict
    yield "limit", limit_text(result)
    if held := held_text(result):
        yield "held", held
    if result.ac_coupled:
        yield "coupling", READS_LOW
    yield "impacts", impacts_text(result)
    for recording in validation.recordings:
        if recording.force_clock:
            yield "force", recording.force_clock
    for model in result.models:
        series = model.overall
        if not series.count:
            yield model.model, "no impact"
            continue
        r = "r undefined" if series.correlation_reason else f"r {series.correlation:.5f}"
        error = f"bias {series.bias:+.2f} N, RMSE {series.rmse:.2f} N ({series.relative_rmse:.2%})"
        safe = f"{series.non_conservative} of {series.count} not conservative"
        yield model.model, f"{r}, k {series.stiffness / 1e3:.4g} N/mm, {error}, {safe}"
        yield "", fit_text(model)
        if by_motion := validation.by_motion.get(model.model):
            yield "", f"mass scale by the torques in motion {by_motion.text}"
    yield "clocks", clock_text(result)
    yield "comparison", result.comparison.text
    for subject, counts in (("excluded", result.excluded), ("not paired", result.unpaired)):
        for reason in counts:
            refused = [impact for impact in result.refused if impact.reason == reason]
            largest = max(max(impact.total_peak, impact.total_held) for impact in refused)
            yield subject, left_out_text(LeftOut(reason, len(refused), largest, 0))
    yield from (("no impact", left_out_text(item)) for part in validation.recordings for item in part.left_out)
    yield from (("not read", loss) for part in validation.recordings for loss in part.losses)


def fit_text(model: ModelResult) -> str:
    """Return mass scale, gain, exponent and power of a model in one line."""
    fit = model.fit
    if not fit.detectable_mass_error < 1.0:
        return "mass scale and gain of the force cannot be told apart"
    values = (
        ("mass scale", fit.mass_scale, fit.mass_scale_interval),
        ("gain", fit.gain, fit.gain_interval),
        ("exponent", fit.exponent, fit.exponent_interval),
    )
    texts = [f"{name} {interval.around(value)}" for name, value, interval in values]
    return f"{', '.join(texts)}; would have found a mass error of {fit.detectable_mass_error:.1%}"


def clock_text(result: Result) -> str:
    """Return the offset of the clocks of force and joint states in one line."""
    clock = result.clock_offset
    if not clock.impacts:
        return "offset unknown: the velocity shows no impact"
    shown = f"{clock.extremes}; {clock.impacts} impacts, resolution {1e3 * clock.resolution:.1f} ms"
    if math.isnan(clock.offset):
        return f"offset unknown: single impacts disagree ({shown})"
    return f"joint states {1e3 * clock.offset:+.1f} ms behind the force ({shown})"


def worst_impact(result: Result) -> ValidatedImpact | None:
    """Return the impact with the largest force on a body region relative to its limit.

    None: a contact that was left out of the series has a larger one.
    """
    other = result.left_out.worst
    ratios = [impact.region_force / (impact.limit_force or math.inf) for impact in result.impacts]
    is_in_series = ratios and max(ratios) >= other.force / (other.limit or math.inf)
    return result.impacts[ratios.index(max(ratios))] if is_in_series else None


def limit_text(result: Result) -> str:
    """Return the largest force on a body region relative to its limit, and what is not known, in one line."""
    others, worst = result.left_out, worst_impact(result)
    count = len(result.impacts) + others.contacts
    unknown = (
        f"; {result.unmeasured} clipped, incomplete, stuck or without signal: force not known"
        if result.unmeasured
        else ""
    )
    if not count:
        return NO_FORCE + unknown
    if worst is None:
        force, origin = others.worst, "left out of the series" if result.impacts else NOT_CONVERTED
    else:
        force = RegionForce(worst.body_region, worst.region_force, worst.limit_force, "")
        origin = f"converted from a measured peak of {at_least(worst.measured_force, 0)} N"
    kind = "contacts" if others.contacts else "impacts"
    largest = f"largest {at_least(force.force, 0)} N of {at_most(force.limit, 0)} N ({force.region}), {origin}"
    held = f", {result.held_alone} only by the force that stayed" if result.held_alone else ""
    return f"{result.exceedances} of {count} {kind} above the limit{held}; {largest}{unknown}"


def held_text(result: Result) -> str:
    """Return the contacts whose force stayed and the largest one relative to its limit; empty without such contacts."""
    if not result.held.contacts:
        return ""
    above, worst = f"{result.held.exceedances} of {result.held.contacts} above the limit", result.held.worst
    return f"{above}; largest {at_least(worst.force, 0)} N of {at_most(worst.limit, 0)} N ({worst.region})"


def impacts_text(result: Result) -> str:
    """Return how many contacts are in the series, and what the others are."""
    simulated = f", {result.simulated} of them simulated" if result.simulated else ""
    rebounds = result.excluded.get(REBOUND, 0)
    others = len(result.refused) - rebounds
    parts = [f"{len(result.impacts)} in the series{simulated}"]
    parts += [f"{rebounds} rebounds of earlier impacts, which count with them"] if rebounds else []
    parts += [f"{others} left out, reasons below"] if others else []
    return "; ".join(parts)


def record(validation: Validation, settings: ValidationSettings, robot: Robot) -> dict[str, Any]:
    """Return all results with settings and robot as JSON types, in SI units; numbers are finite or null."""
    result = json_types(validation.result)
    return {
        "models": [
            {"model": model.pop("model"), **model.pop("overall"), **model.pop("fit"), **model}
            for model in result.pop("models")
        ],
        "mass_scale_by_motion": {model: scale._asdict() for model, scale in validation.by_motion.items()},
        "no_mass_scale_by_motion": validation.no_motion,
        "judged_model": result.pop("model"),
        **result,
        "impacts": [
            {"recording": name, **impact} for name, impact in zip(validation.names(), result["impacts"], strict=True)
        ],
        "recordings": [json_types(recording, without="impacts") for recording in validation.recordings],
        "criterion": settings.validator.criterion.model_dump(mode="json"),
        "settings": {
            "monitor": settings.monitor.model_dump(mode="json"),
            "validator": settings.validator.model_dump(mode="json"),
            "detection": settings.detection.model_dump(mode="json"),
            "obstacle_mass": settings.obstacle_mass,
            "force": settings.force.model_dump(mode="json"),
        },
        "robot": {"name": robot.name, "origin": robot.origin, "notes": list(robot.notes)},
        "units": UNITS,
        "scara_effmass": __version__,
    }


def _page(
    validation: Validation, figures: list[ReportFigure], settings: ValidationSettings, robot: Robot, language: str
) -> str:
    result = validation.result
    models = [model.model for model in result.models]
    predictions = [{item.model: item for item in impact.predictions} for impact in result.impacts]
    traces = [
        trace for item in validation.recordings for trace in item.force_traces(item.impacts, settings.force, AFTER_S)
    ]
    stamps = sorted(impact.stamp_ns for impact in result.impacts)
    losses = [loss for trace in traces if (loss := trace.sampling_loss) is not None]
    return render(
        "validation.html",
        language,
        validation=validation,
        settings=settings,
        robot=robot,
        figures=figures,
        verdict=_verdict(result),
        reads_low=READS_LOW,
        running=robot.name,
        simulated=result.simulated or any(recording.simulated for recording in validation.recordings),
        period=(stamps[0], stamps[-1]) if stamps else None,
        regions=list(_regions(validation, settings)),
        traces=[
            ShownTrace(
                *(name, impact.stamp_ns, trace, impact.simulated),
                *(impact.measured_force, impact.predicted_force, impact.speed),
            )
            for name, impact, trace in zip(validation.names(), result.impacts, traces, strict=False)
            if trace.reaches_onset
        ],
        sampling_loss=max(losses, default=None),
        mass_heads=tuple(f"m_n {model} [kg]" for model in models),
        error_heads=tuple(f"{model} [%]" for model in models),
        impacts=[
            (name, impact, [by_model.get(model) for model in models])
            for name, impact, by_model in zip(validation.names(), result.impacts, predictions, strict=True)
        ],
        clock_text=clock_text(result),
        worst=worst_impact(result),
        rebounds=result.excluded.get(REBOUND, 0),
        remainders=[(item.path.name, left_out) for item in validation.recordings for left_out in item.left_out],
        files=file_hashes(
            [*(path for item in validation.recordings for path in item.files), settings.monitor.robot_path]
        ),
        setting_rows=[
            *setting_rows("validator", settings.validator),
            *setting_rows("daq: detection", settings.detection),
            *setting_rows("monitor", settings.monitor, changed_only=True),
        ],
    )


def _verdict(result: Result) -> str:
    """Return the verdict that the page shows: a force above a limit is a violation, however good the model is."""
    if result.exceedances or (result.decidable and not result.accepted):
        return Verdict.VIOLATION.name
    return Verdict.OK.name if result.accepted and result.within_limits else Verdict.UNKNOWN.name


def _regions(validation: Validation, settings: ValidationSettings) -> Iterator[tuple[Limit, float | None]]:
    """Yield each limit with the largest force [N] of the impacts on its region, None without impacts."""
    for limit in limits_for(settings.validator.limit_settings):
        forces = [
            region_force(
                [limit],
                impact.measured_force / impact.force_share,
                (impact.effective_mass, impact.measured_effective_mass),
                math.inf if settings.validator.obstacle_fixed else impact.obstacle_mass / impact.force_share**2,
                impact.stiffness,
            ).force
            for impact in validation.result.impacts
        ]
        yield limit, max(forces, default=None)


class Marks:
    """Marks of the impacts of a series.

    `markers` are those of the configurations, in the order of their mean effective mass, `shades` the colours of the
    obstacle masses [kg], ascending.
    """

    def __init__(self, impacts: Sequence[ValidatedImpact]) -> None:
        by_configuration = defaultdict[str, list[float]](list)
        for impact in impacts:
            by_configuration[impact.configuration].append(impact.effective_mass)
        order = sorted(by_configuration, key=lambda name: (_mean(by_configuration[name]), name))
        self.markers = dict(zip(order, cycle(MARKERS), strict=False))
        masses = sorted({impact.obstacle_mass for impact in impacts})
        self.shades = {mass: color(number, len(masses)) for number, mass in enumerate(masses)}

    def scatter(self, axes: Axes, impacts: Iterable[ValidatedImpact], points: Iterable[tuple[float, float]]) -> None:
        """Draw one point for each impact."""
        for impact, (x, y) in zip(impacts, points, strict=True):
            marker, shade = self.markers[impact.configuration], self.shades[impact.obstacle_mass]
            axes.plot(x, y, marker, color=shade, markersize=6.0, alpha=0.85, zorder=2)
        axes.grid(alpha=0.3)

    def legend(self, figure: Figure, *lines: Line2D) -> None:
        """Draw the legend of the markers and `lines` beside the axes."""
        marks: list[tuple[str, str, Any]] = [("$m_H$ [kg]", "", "none")]
        marks += [(f"{mass:g}", "o", shade) for mass, shade in self.shades.items()]
        marks.append(("configuration", "", "none"))
        marks += [(configuration_label(name), marker, GREY) for name, marker in self.markers.items()]
        handles = [Line2D([], [], linestyle="none", marker=m, color=shade, label=label) for label, m, shade in marks]
        figure.legend(handles=[*lines, *handles], loc="outside right upper")


def color(number: int, count: int) -> tuple[float, float, float, float]:
    """Return colour `number` of `count`."""
    return mpl.colormaps["plasma"](DARK + (LIGHT - DARK) * number / max(count - 1, 1))


def configuration_label(configuration: str) -> str:
    """Return the label of a configuration for Matplotlib."""
    return figure_text(configuration) or "not named"


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
            _annotate(axes, NO_IMPACT if not result.impacts else "the robot has no such mass")
            continue
        marks.scatter(axes, [impact for impact, _ in data], [(x, impact.measured_force) for impact, x in data])
        axes.plot((0.0, x_limit), (0.0, math.sqrt(overall.stiffness) * x_limit), color=ISO_RED, linewidth=1.4, zorder=1)
        r = "undefined" if overall.correlation_reason else f"{overall.correlation:.5f}"
        lines = (f"r = {r}", f"k = {overall.stiffness / 1e3:.4g} N/mm", f"RMSE = {overall.relative_rmse:.2%}")
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
    for number, (name, marker) in enumerate(marks.markers.items()):
        impacts = [impact for impact in result.impacts if impact.configuration == name]
        masses = sorted({impact.obstacle_mass for impact in impacts})
        shade = color(number, len(marks.markers))
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
        _annotate(axes, NO_IMPACT)
    return figure, axes, Marks(result.impacts)


def _annotate(axes: Axes, text: str) -> None:
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center")
