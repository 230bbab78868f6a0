"""The tables of a validation."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

from scara_effmass.analysis.page import table
from scara_effmass.analysis.validation_truth import deviations, stated_stiffness

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from scara_effmass.analysis.validation import ValidatedRecording, Validation
    from scara_effmass.impacts.agreement import Agreement
    from scara_effmass.impacts.result import ModelResult, Result
    from scara_effmass.values import ValidatedImpact

N_MM = 1e3
"""N/m in one N/mm."""
MODEL_HEADS = (
    "model",
    "impacts",
    "r (95 %)",
    "fitted k [N/mm] (95 %)",
    "exponent (95 %)",
    "bias [N]",
    "RMSE [N]",
    "RMSE / mean",
    "Bland-Altman limits [N]",
    "not conservative",
    "accepted",
)
GROUP_HEADS = (
    "model",
    "impacts",
    "mean force [N]",
    "own k [N/mm]",
    "own k / k - 1",
    "bias [N]",
    "RMSE [N]",
    "not conservative",
)
RECORDING_HEADS = ("recording", "joint states", "force blocks", "lost samples", "impacts", "left out", "remarks")
HOW_PREDICTED = (
    "Predictions are with the stiffness of the whole series; errors are predicted / measured - 1. μ and the predicted "
    "force are of the {} model."
)


def models(result: Result) -> str:
    """Return the table of the models over the whole series."""
    return table(MODEL_HEADS, map(_model_row, result.models))


def groups(result: Result) -> Iterator[str]:
    """Yield the tables by configuration and by mass of the obstacle."""
    models = result.models
    by_configuration = [
        (name or "not named", *_group_row(model, model.by_configuration[name]))
        for name in models[0].by_configuration
        for model in models
    ]
    by_obstacle_mass = [
        (f"{mass:g}", *_group_row(model, model.by_obstacle_mass[mass]))
        for mass in models[0].by_obstacle_mass
        for model in models
    ]
    if result.impacts:
        yield "<h2>By configuration</h2>"
        yield table(("configuration", *GROUP_HEADS), by_configuration)
        yield "<h2>By mass of the obstacle</h2>"
        yield table(("m_H [kg]", *GROUP_HEADS), by_obstacle_mass)


def truth(validation: Validation) -> Iterator[str]:
    """Yield what was found beside what simulated recordings know; nothing where they know nothing."""
    found = deviations(validation)
    if not found:
        return
    yield (
        "<h2>Against what the simulation knows</h2><p>Found / true - 1. The validator has no access to these values; "
        "the true effective mass comes from the simulator's own dynamics.</p>"
    )
    rows = [(each.quantity, f"{each.impacts}", _relative(each.mean), _relative(each.farthest)) for each in found]
    yield table(("quantity", "impacts", "mean", "farthest"), rows)
    if stiffness := stated_stiffness(validation):
        yield f"<p>The simulated contact has a stiffness of {stiffness / N_MM:g} N/mm.</p>"


def left_out(result: Result) -> str:
    """Return the table of the impacts that are not in the series, by reason."""
    rows = [
        (kind, reason, f"{count}", _details(result, reason))
        for kind, counts in (("excluded", result.excluded), ("not paired", result.unpaired))
        for reason, count in sorted(counts.items(), key=lambda each: -each[1])
    ]
    if not rows:
        return "<p>Every impact that was found is in the series.</p>"
    return table(("", "reason", "impacts", "details, each once"), rows)


def impacts(validation: Validation) -> Iterator[str]:
    """Yield the table of the impacts of the series, and how it is to be read."""
    result = validation.result
    yield f"<p>{escape(HOW_PREDICTED.format(result.model))}</p>"
    yield f'<div class="dense">{table(_impact_heads(result), _impact_rows(validation))}</div>'


def recordings(validation: Validation) -> str:
    """Return the table of the recordings."""
    return table(RECORDING_HEADS, map(_recording_row, validation.recordings))


def _model_row(model: ModelResult) -> tuple[str, ...]:
    found = model.overall
    accepted = "yes" if model.accepted else f"no: {model.reason}"
    if not found.count:
        return (model.model, "0", *["-"] * (len(MODEL_HEADS) - 3), accepted)
    r = (
        f"undefined: {found.correlation_reason}"
        if found.correlation_reason
        else _with(f"{found.correlation:.5f}", found.correlation_interval, ".5f")
    )
    stiffness = _with(f"{found.fitted_stiffness / N_MM:.1f}", found.stiffness_interval, ".1f", 1.0 / N_MM)
    exponent = "-" if found.exponent is None else _with(f"{found.exponent:.3f}", found.exponent_interval, ".3f")
    return (
        model.model,
        f"{found.count}",
        r,
        stiffness if found.count > 1 else "-",
        exponent,
        f"{found.bias:+.2f}",
        f"{found.rmse:.2f}",
        f"{found.relative_rmse:.2%}",
        "-" if found.limits is None else f"{found.limits.low:+.2f} to {found.limits.high:+.2f}",
        f"{found.non_conservative} (largest {found.largest_shortfall:.2%}; {found.shortfalls} beyond tolerance)",
        accepted,
    )


def _group_row(model: ModelResult, found: Agreement) -> tuple[str, ...]:
    k, whole = found.fitted_stiffness, model.overall.stiffness
    return (
        model.model,
        f"{found.count}",
        f"{found.mean_force:.1f}",
        f"{k / N_MM:.1f}" if k else "-",
        _relative(k / whole - 1.0) if k and whole else "-",
        f"{found.bias:+.2f}",
        f"{found.rmse:.2f}",
        f"{found.non_conservative}",
    )


def _details(result: Result, reason: str) -> str:
    return "; ".join(sorted({one.detail for one in result.refused if one.reason == reason and one.detail})[:5])


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
    known = [predictions.get(model) for model in models]
    yield f"{impact.stamp_ns / 1e9:.6f}"
    yield impact.configuration or "not named"
    yield f"{impact.obstacle_mass:g}"
    yield f"{1e3 * impact.speed:.1f}"
    yield from ("-" if each is None else f"{each.effective_mass:.3f}" for each in known)
    yield f"{impact.reduced_mass:.3f}"
    yield f"{impact.measured_force:.1f}"
    yield f"{impact.predicted_force:.1f}"
    yield from ("-" if each is None else _relative(each.relative_error) for each in known)
    yield "yes" if impact.conservative else "no"


def _recording_row(recording: ValidatedRecording) -> tuple[str, ...]:
    counted = ("dropouts", "drop-outs"), ("glitches", "glitches"), ("pushes", "pushes too long for impacts")
    remarks = [f"{count} {what}" for name, what in counted if (count := getattr(recording, name))]
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
    """Return a difference in percent, without a sign where it rounds to nothing."""
    text = f"{share:+.2%}"
    return text if text.strip("+-0.%") else "0.00%"


def _with(text: str, interval: tuple[float, float] | None, form: str, scale: float = 1.0) -> str:
    return text if interval is None else f"{text} ({interval[0] * scale:{form}} to {interval[1] * scale:{form}})"
