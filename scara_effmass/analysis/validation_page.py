"""HTML page of the validation report."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

from scara_effmass import __version__
from scara_effmass.analysis.report import EmbeddedFigure, render
from scara_effmass.analysis.validation_scope import demands, limits, origin
from scara_effmass.impacts.result import ModelResult, Result
from scara_effmass.values import ValidatedImpact

if TYPE_CHECKING:
    from pydantic import BaseModel

    from scara_effmass.analysis.validation import ValidatedRecording, Validation, ValidationSettings
    from scara_effmass.impacts.agreement import Agreement
    from scara_effmass.model.robot import Robot

N_MM = 1e3
"""N/m in one N/mm."""
LINEAR = 1.0
"""Exponent of a linear spring."""


class Deviation(NamedTuple):
    """Estimate / true value - 1 of one quantity: mean over the `impacts`, and the value farthest from zero."""

    quantity: str
    impacts: int
    mean: float
    farthest: float


def page(validation: Validation, figures: Sequence[EmbeddedFigure], settings: ValidationSettings, robot: Robot) -> str:
    """Return the page as HTML."""
    result = validation.result
    stiffness = stated_stiffness(validation)
    return render(
        "validation.html",
        result=result,
        origin=origin(result),
        facts=list(_facts(validation, settings, robot)),
        limits=list(limits(validation, settings, robot)),
        models=[_model_row(model) for model in result.models],
        figures=figures,
        by_configuration=[
            (name or "not named", *_group_row(model, model.by_configuration[name]))
            for name in result.models[0].by_configuration
            for model in result.models
        ],
        by_obstacle_mass=[
            (f"{mass:g}", *_group_row(model, model.by_obstacle_mass[mass]))
            for mass in result.models[0].by_obstacle_mass
            for model in result.models
        ],
        deviations=[
            (row.quantity, f"{row.impacts}", _relative(row.mean), _relative(row.farthest))
            for row in deviations(validation)
        ],
        stated_stiffness=f"{stiffness / N_MM:g}" if stiffness else "",
        left_out=list(_left_out_rows(result)),
        impact_heads=_impact_heads(result),
        impacts=[list(row) for row in _impact_rows(validation)],
        recordings=[_recording_row(recording) for recording in validation.recordings],
        settings=list(_settings_rows(settings)),
    )


def _left_out_rows(result: Result) -> Iterator[tuple[str, ...]]:
    for category, counts in (("excluded", result.excluded), ("not paired", result.unpaired)):
        for reason, count in sorted(counts.items(), key=lambda item: -item[1]):
            yield category, reason, f"{count}", _details(result, reason)


def _facts(validation: Validation, settings: ValidationSettings, robot: Robot) -> Iterator[tuple[str, str]]:
    result = validation.result
    yield "validated", f"{result.model} model of {robot.name}, contact point {result.contact_point or 'none received'}"
    yield "against", origin(result)
    yield "impacts", f"{result.seen} found, {len(result.impacts)} in the series, {len(result.refused)} left out"
    yield "criterion", f"{'; '.join(demands(settings.validator.criterion))} (hash {result.criterion_hash})"
    if result.clock:
        yield "clocks", result.clock
    if result.force_sign:
        yield "sign of the force", result.force_sign
    if result.other_contact_points:
        yield "not validated", f"other contact points: {', '.join(result.other_contact_points)}"
    if result.late_states:
        yield "contact states", f"{result.late_states} arrived out of order and were dropped"
    yield "robot file", robot.origin
    count = len(validation.recordings)
    yield "recordings", f"{count}, listed below" if count else "none: the series was live"
    yield "software", f"scara_effmass {__version__}"


def _settings_rows(settings: ValidationSettings) -> Iterator[tuple[str, str]]:
    if settings.obstacle_mass is not None:
        yield "obstacle mass for all recordings", f"{settings.obstacle_mass:g} kg"
    yield from _rows("validator", settings.validator, only_changed=False)
    yield from _rows("daq: detection", settings.detection, only_changed=False)
    yield from _rows("monitor", settings.monitor, only_changed=True)


def _rows(section: str, settings: BaseModel, *, only_changed: bool) -> Iterator[tuple[str, str]]:
    defaults = type(settings)().model_dump(mode="json")
    for name, value in settings.model_dump(mode="json").items():
        if isinstance(value, dict):
            yield from ((f"{section}: {name}.{key}", f"{item}") for key, item in value.items())
        elif not only_changed or value != defaults[name]:
            yield f"{section}: {name}", "(empty)" if value == "" else f"{value}"


def _model_row(model: ModelResult) -> tuple[str, ...]:
    series = model.overall
    accepted = "yes" if model.accepted else f"no: {model.reason}"
    if not series.count:
        return (model.model, "0", *["-"] * 8, accepted)
    r = (
        f"undefined: {series.correlation_reason}"
        if series.correlation_reason
        else _interval(f"{series.correlation:.5f}", series.correlation_interval, ".5f")
    )
    stiffness = _interval(f"{series.fitted_stiffness / N_MM:.1f}", series.stiffness_interval, ".1f", 1.0 / N_MM)
    exponent = "-" if series.exponent is None else _interval(f"{series.exponent:.3f}", series.exponent_interval, ".3f")
    return (
        model.model,
        f"{series.count}",
        r,
        stiffness if series.count > 1 else "-",
        exponent,
        f"{series.bias:+.2f}",
        f"{series.rmse:.2f}",
        f"{series.relative_rmse:.2%}",
        "-" if series.limits is None else f"{series.limits.low:+.2f} to {series.limits.high:+.2f}",
        f"{series.non_conservative} (largest {series.largest_shortfall:.2%}; {series.shortfalls} beyond tolerance)",
        accepted,
    )


def _group_row(model: ModelResult, series: Agreement) -> tuple[str, ...]:
    k, whole = series.fitted_stiffness, model.overall.stiffness
    return (
        model.model,
        f"{series.count}",
        f"{series.mean_force:.1f}",
        f"{k / N_MM:.1f}" if k else "-",
        _relative(k / whole - 1.0) if k and whole else "-",
        f"{series.bias:+.2f}",
        f"{series.rmse:.2f}",
        f"{series.non_conservative}",
    )


def _details(result: Result, reason: str) -> str:
    return "; ".join(sorted({item.detail for item in result.refused if item.reason == reason and item.detail})[:5])


def _impact_heads(result: Result) -> tuple[str, ...]:
    masses = [f"m_n {model.model} [kg]" for model in result.models]
    errors = [f"error {model.model}" for model in result.models]
    heads = ("recording", "onset [s, ROS time]", "configuration", "m_H [kg]", "v [mm/s]", *masses, "μ [kg]")
    return (*heads, "measured [N]", "predicted [N]", *errors, "conservative")


def _impact_rows(validation: Validation) -> Iterator[tuple[str, ...]]:
    models = [model.model for model in validation.result.models]
    names = validation.names()
    for name, impact in zip(names, validation.result.impacts, strict=True):
        yield (name, *_impact_row(impact, models))


def _impact_row(impact: ValidatedImpact, models: Iterable[str]) -> Iterator[str]:
    predictions = {prediction.model: prediction for prediction in impact.predictions}
    by_model = [predictions.get(model) for model in models]
    yield f"{impact.stamp_ns / 1e9:.6f}"
    yield impact.configuration or "not named"
    yield f"{impact.obstacle_mass:g}"
    yield f"{1e3 * impact.speed:.1f}"
    yield from ("-" if prediction is None else f"{prediction.effective_mass:.3f}" for prediction in by_model)
    yield f"{impact.reduced_mass:.3f}"
    yield f"{impact.measured_force:.1f}"
    yield f"{impact.predicted_force:.1f}"
    yield from ("-" if prediction is None else _relative(prediction.relative_error) for prediction in by_model)
    yield "yes" if impact.conservative else "no"


def _recording_row(recording: ValidatedRecording) -> tuple[str, ...]:
    counters = ("dropouts", "drop-outs"), ("glitches", "glitches"), ("pushes", "contacts too long for impacts")
    remarks = [f"{count} {label}" for name, label in counters if (count := getattr(recording, name))]
    return (
        recording.path.name,
        f"{recording.joint_states}",
        f"{recording.force_blocks}" if recording.force_blocks else "none; recorded impacts were used",
        f"{recording.lost_samples}",
        f"{len(recording.impacts)}",
        f"{len(recording.refused)}",
        "; ".join([*(["simulated"] if recording.simulated else []), *remarks, *recording.losses]),
    )


def _relative(share: float) -> str:
    """Return a relative difference in percent; without sign if it rounds to zero."""
    text = f"{share:+.2%}"
    return text if text.strip("+-0.%") else "0.00%"


def _interval(text: str, interval: tuple[float, float] | None, form: str, scale: float = 1.0) -> str:
    return text if interval is None else f"{text} ({interval[0] * scale:{form}} to {interval[1] * scale:{form}})"


def deviations(validation: Validation) -> list[Deviation]:
    """Return the deviations over all recordings of a single impact that state the true values."""
    by_quantity: dict[str, list[float]] = {}
    for recording in validation.recordings:
        for quantity, deviation in _recording_deviations(recording):
            by_quantity.setdefault(quantity, []).append(deviation)
    return [
        Deviation(quantity, len(values), sum(values) / len(values), max(values, key=abs))
        for quantity, values in by_quantity.items()
    ]


def stated_stiffness(validation: Validation) -> float | None:
    """Return the stiffness [N/m] of the simulated contact; None if unknown, not unique, or not a linear spring."""
    infos = [info for recording in validation.recordings for info in recording.infos]
    contacts = {(info.contact_stiffness, info.contact_exponent) for info in infos}
    ((stiffness, exponent),) = contacts if len(contacts) == 1 else ((0.0, 0.0),)
    return stiffness if exponent == LINEAR and 0.0 < stiffness < math.inf else None


def _recording_deviations(recording: ValidatedRecording) -> Iterator[tuple[str, float]]:
    if len(recording.impacts) != 1 or len(recording.infos) != 1:
        return
    info = recording.infos[0]
    truth = (info.true_speed, info.true_effective_mass, info.true_peak_force)
    if all(0.0 < value < math.inf for value in truth):
        yield from _impact_deviations(recording.impacts[0], *truth)


def _impact_deviations(
    impact: ValidatedImpact, speed: float, effective_mass: float, peak_force: float
) -> Iterator[tuple[str, float]]:
    yield "speed at the onset", impact.speed / speed - 1.0
    yield "peak force", impact.measured_force / peak_force - 1.0
    for prediction in impact.predictions:
        yield f"effective mass, {prediction.model}", prediction.effective_mass / effective_mass - 1.0
