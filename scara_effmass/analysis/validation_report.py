# SPDX-License-Identifier: Apache-2.0
"""Report of a validation: a page, figures, and all results as JSON, written completely or not at all."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl

from scara_effmass import __version__
from scara_effmass.analysis.force_traces import AFTER_S, force_traces, shown
from scara_effmass.analysis.output import check_output_files
from scara_effmass.analysis.pages import PageOptions, file_hashes, render, setting_rows
from scara_effmass.analysis.plot_style import STYLE
from scara_effmass.analysis.report import ReportFigure, figure_files, report_figure, write_report_files
from scara_effmass.analysis.validation_figures import PLOTS
from scara_effmass.impacts.agreement import region_force
from scara_effmass.iso15066 import limits_for
from scara_effmass.values import ValidatedImpact, Verdict

if TYPE_CHECKING:
    from scara_effmass.analysis.validation import ValidatedRecording, Validation, ValidationSettings
    from scara_effmass.impacts.validator import ModelResult, Result
    from scara_effmass.iso15066 import Limit
    from scara_effmass.model.robot import Robot

PAGE, RECORD = "report.html", "report.json"
ENGLISH_PAGE = PageOptions()
FILES = (PAGE, RECORD, *figure_files(plot.name for plot in PLOTS))
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
LINEAR = 1.0
"""Exponent of a linear spring."""


def check_report_folder(folder: Path, options: PageOptions = ENGLISH_PAGE, *, overwrite: bool) -> None:
    """Raise OutputError if a file of the report cannot be written into `folder`."""
    check_output_files(folder, [*FILES, *options.files()], overwrite=overwrite)


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
    figures = []
    for plot in PLOTS:
        with mpl.rc_context(STYLE):
            drawing = plot.draw(validation.result)
            figures.append(report_figure(plot.name, plot.title, plot.caption, drawing, options.language))
    results = record(validation, settings, robot)
    page = _page(validation, figures, settings, robot, options.language)
    pdf_of = PAGE if options.pdf else None
    write_report_files(folder, {PAGE: page, RECORD: results}, figures, overwrite=overwrite, pdf_of=pdf_of)
    return results


def summary_lines(validation: Validation) -> Iterator[tuple[str, str]]:
    """Yield subject and text of each line of a summary."""
    result = validation.result
    yield "result", result.verdict
    yield "limit", limit_text(result)
    simulated = f", {result.simulated} of them simulated" if result.simulated else ""
    sustained = sum(recording.sustained_contacts for recording in validation.recordings)
    longer = f"; {sustained} sustained contacts" if sustained else ""
    yield "impacts", f"{result.seen} detected, {len(result.impacts)} in the series{simulated}{longer}"
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
    yield "clocks", clock_text(result)
    yield "comparison", result.comparison.text
    for subject, counts in (("excluded", result.excluded), ("not paired", result.unpaired)):
        for reason, count in counts.items():
            yield subject, f"{count}: {reason}"
    for recording in validation.recordings:
        for loss in recording.losses:
            yield "not read", loss


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
    extremes = f"{1e3 * clock.low:+.1f} to {1e3 * clock.high:+.1f} ms"
    shown = f"{clock.impacts} impacts, resolution {1e3 * clock.resolution:.1f} ms"
    return f"joint states {1e3 * clock.offset:+.1f} ms behind the force ({extremes}; {shown})"


def worst_impact(result: Result) -> ValidatedImpact | None:
    """Return the impact with the largest force on a body region relative to its limit."""
    ratios = [impact.region_force / (impact.limit_force or math.inf) for impact in result.impacts]
    return result.impacts[ratios.index(max(ratios))] if ratios else None


def limit_text(result: Result) -> str:
    """Return the largest force on a body region relative to its limit, in one line."""
    worst = worst_impact(result)
    if worst is None:
        return "no force to compare"
    above = f"{result.exceedances} of {len(result.impacts)} impacts above the limit"
    return f"{above}; largest {worst.region_force:.0f} N of {worst.limit_force:.0f} N ({worst.body_region})"


def record(validation: Validation, settings: ValidationSettings, robot: Robot) -> dict[str, Any]:
    """Return all results with settings and robot as JSON types, in SI units; numbers are finite or null."""
    result = _plain(validation.result)
    return {
        "models": [
            {"model": model.pop("model"), **model.pop("overall"), **model.pop("fit"), **model}
            for model in result.pop("models")
        ],
        "judged_model": result.pop("model"),
        **result,
        "impacts": [
            {"recording": name, **impact} for name, impact in zip(validation.names(), result["impacts"], strict=True)
        ],
        "recordings": [_plain(recording, without="impacts") for recording in validation.recordings],
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


def deviations(validation: Validation) -> list[tuple[str, int, float, float]]:
    """Return quantity, number of impacts, and mean and largest deviation of the estimates from the true values.

    A deviation is estimate / true value - 1, in a recording of a single impact that states the true values.
    """
    by_quantity: dict[str, list[float]] = {}
    for recording in validation.recordings:
        for quantity, deviation in _recording_deviations(recording):
            by_quantity.setdefault(quantity, []).append(deviation)
    return [
        (quantity, len(values), sum(values) / len(values), max(values, key=abs))
        for quantity, values in by_quantity.items()
    ]


def _recording_deviations(recording: ValidatedRecording) -> Iterator[tuple[str, float]]:
    if len(recording.impacts) != 1 or len(recording.infos) != 1:
        return
    impact, info = recording.impacts[0], recording.infos[0]
    if all(0.0 < value < math.inf for value in (info.true_speed, info.true_effective_mass, info.true_peak_force)):
        yield "speed at the onset", impact.speed / info.true_speed - 1.0
        yield "peak force", impact.measured_force / info.true_peak_force - 1.0
        for prediction in impact.predictions:
            deviation = prediction.effective_mass / info.true_effective_mass - 1.0
            yield f"effective mass, {prediction.model}", deviation


def stated_stiffness(validation: Validation) -> float | None:
    """Return the stiffness [N/m] of the simulated contact, None if it is unknown, not unique, or not linear."""
    infos = [info for recording in validation.recordings for info in recording.infos]
    contacts = {(info.contact_stiffness, info.contact_exponent) for info in infos}
    ((stiffness, exponent),) = contacts if len(contacts) == 1 else ((0.0, 0.0),)
    return stiffness if exponent == LINEAR and 0.0 < stiffness < math.inf else None


def _page(
    validation: Validation, figures: list[ReportFigure], settings: ValidationSettings, robot: Robot, language: str
) -> str:
    result = validation.result
    models = [model.model for model in result.models]
    predictions = [{item.model: item for item in impact.predictions} for impact in result.impacts]
    traces = [
        trace for recording in validation.recordings for trace in force_traces(recording, settings.force, AFTER_S)
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
        running=robot.name,
        simulated=result.simulated or any(recording.simulated for recording in validation.recordings),
        period=(stamps[0], stamps[-1]) if stamps else None,
        regions=list(_regions(validation, settings)),
        traces=[
            item
            for name, impact, trace in zip(validation.names(), result.impacts, traces, strict=False)
            for item in shown(
                name,
                impact.stamp_ns,
                trace,
                simulated=impact.simulated,
                peak=impact.measured_force,
                predicted=impact.predicted_force,
                speed=impact.speed,
            )
        ],
        sampling_loss=max(losses, default=None),
        mass_heads=tuple(f"m_n {model} [kg]" for model in models),
        error_heads=tuple(f"{model} [%]" for model in models),
        impacts=[
            (name, impact, [by_model.get(model) for model in models])
            for name, impact, by_model in zip(validation.names(), result.impacts, predictions, strict=True)
        ],
        deviations=deviations(validation),
        stated_stiffness=stated_stiffness(validation),
        clock_text=clock_text(result),
        worst=worst_impact(result),
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
    return Verdict.OK.name if result.accepted else Verdict.UNKNOWN.name


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


def _plain(value: Any, without: str = "") -> Any:  # noqa: ANN401 - any part of a result
    """Return `value` as JSON types; named tuples and dataclasses become objects, without the field `without`."""
    if is_dataclass(value):
        value = {field.name: getattr(value, field.name) for field in fields(value)}
    elif hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, dict):
        named = ((f"{key:g}" if isinstance(key, float) else str(key), item) for key, item in value.items())
        return {key: _plain(item) for key, item in named if key != without}
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int | str) else str(value)
