"""Results as lines of subject and text, for the terminal and the reports."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from scara_effmass.analysis.forces import RecordedForce
from scara_effmass.values import Verdict

if TYPE_CHECKING:
    from scara_effmass.analysis.summary import Summary, TightestMargin
    from scara_effmass.analysis.validation import Validation

REASONS_SHOWN = 5


def summary_lines(summary: Summary) -> Iterator[tuple[str, str]]:
    """Yield subject and text of each line."""
    cycles = sum(summary.cycles.values())
    total_ns = sum(summary.time_ns.values())
    for verdict in (Verdict.OK, Verdict.WARN, Verdict.VIOLATION, Verdict.UNKNOWN):
        if count := summary.cycles[verdict]:
            seconds = summary.time_ns[verdict] / 1e9
            share = summary.time_ns[verdict] / total_ns if total_ns else count / cycles
            yield verdict.name, f"{count} cycles, {seconds:.2f} s ({share:.1%})"
    if summary.gaps:
        yield "gaps", f"{summary.gaps} longer than the timeout, the longest {summary.max_gap_ns / 1e9:.3f} s"
    if summary.tightest is not None:
        yield from _tightest(summary.tightest)
    reasons = summary.reasons.most_common()
    for reason, count in reasons[:REASONS_SHOWN]:
        yield "UNKNOWN because", f"{reason} ({count} cycles)"
    if reasons[REASONS_SHOWN:]:
        yield "UNKNOWN because", f"{len(reasons) - REASONS_SHOWN} other reasons (--json lists them)"


def validation_lines(validation: Validation) -> Iterator[tuple[str, str]]:
    """Yield subject and text of each line."""
    result = validation.result
    yield "result", "accepted" if result.accepted else f"not accepted: {result.reason}"
    simulated = f", {result.simulated} of them simulated" if result.simulated else ""
    yield "impacts", f"{result.seen} detected, {len(result.impacts)} in the series{simulated}"
    for model in result.models:
        series = model.overall
        if not series.count:
            yield model.model, "no impact"
            continue
        r = "r undefined" if series.correlation_reason else f"r {series.correlation:.5f}"
        exponent = "" if series.exponent is None else f", exponent {series.exponent:.3f}"
        error = f"bias {series.bias:+.2f} N, RMSE {series.rmse:.2f} N ({series.relative_rmse:.2%})"
        safe = f"{series.non_conservative} of {series.count} not conservative"
        yield model.model, f"{r}, k {series.stiffness / 1e3:.4g} N/mm{exponent}, {error}, {safe}"
    yield "comparison", result.comparison.text
    for subject, counts in (("excluded", result.excluded), ("not paired", result.unpaired)):
        for reason, count in counts.items():
            yield subject, f"{count}: {reason}"
    for recording in validation.recordings:
        for loss in recording.losses:
            yield "not read", loss


def force_lines(forces: RecordedForce | None) -> Iterator[tuple[str, str]]:
    """Yield subject and text of a recorded force and its impacts."""
    if forces is None:
        return
    origin = "simulated, not measured" if forces.simulated else "as recorded"
    yield "force", f"{forces.blocks} blocks, {forces.samples} samples, {forces.lost} lost; {origin}: {forces.source}"
    for impact in forces.impacts:
        marks = [f"rebound {impact.rebound}"] * bool(impact.rebound)
        marks += ["clipped"] * impact.clipped + ["incomplete"] * impact.incomplete
        text = f"{impact.peak_force:.1f} N, {1e3 * impact.duration:.2f} ms, {impact.impulse:.4f} N s"
        yield "  impact", f"at stamp {impact.stamp_ns / 1e9:.5f} s: {', '.join((text, *marks))}"


def force_record(forces: RecordedForce | None) -> dict[str, Any] | None:
    """Return a recorded force and its impacts for JSON."""
    if forces is None:
        return None
    return {
        "source": forces.source,
        "simulated": forces.simulated,
        "blocks": forces.blocks,
        "lost_samples": forces.lost,
        "impacts": [impact._asdict() for impact in forces.impacts],
    }


def _tightest(tightest: TightestMargin) -> Iterator[tuple[str, str]]:
    contact = tightest.contact
    speeds = f"{contact.speed:.3f} m/s where {contact.allowable_speed:.3f} m/s is allowable"
    yield "tightest margin", f"{contact.margin:+.3f} m/s ({contact.verdict.name}): {speeds}"
    where = f"{contact.contact_point} at stamp {contact.stamp_ns / 1e9:.3f} s"
    if tightest.source:
        where += f" in {tightest.source}"
    yield "  where", where
    if tightest.positions:
        yield "  pose", ", ".join(f"{name} {position:.3f}" for name, position in tightest.positions.items())
    components = ", ".join(f"{round(component, 2) + 0.0:.2f}" for component in contact.direction)
    direction_text = "in its worst direction" if contact.worst_direction_used else f"along ({components})"
    yield (
        "  why",
        f"{contact.criterion} limit of {contact.body_region}; {contact.effective_mass:.3g} kg {direction_text}",
    )
