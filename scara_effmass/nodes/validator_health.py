# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of the validation: the series, and the impacts and messages left out of it."""

from collections import Counter
from collections.abc import Collection

from diagnostic_msgs.msg import DiagnosticStatus

from scara_effmass.cell.status import MAX_IMPACTS, left_out_entry
from scara_effmass.impacts.agreement import comparison_text
from scara_effmass.impacts.impact_matcher import DUPLICATE, REBOUND
from scara_effmass.impacts.validator import Validator
from scara_effmass.nodes.diagnostics import status
from scara_effmass.values import ValidatedImpact


def impact_text(impact: ValidatedImpact) -> str:
    """Return one line about an impact: measured and predicted peak, and the limit of the body region."""
    simulated = "simulated impact" if impact.simulated else "impact"
    force = (
        f"peak {impact.measured_force:.1f} N, predicted {impact.predicted_force:.1f} N ({impact.relative_error:+.1%})"
    )
    return f"{simulated}: {force}; {comparison_text(impact)}; {impact.series.count} in the series"


def series_status(
    validator: Validator,
    undecodable: Counter[str],
    *,
    contact_points: Collection[str],
    robot: str,
    unheard: str = "",
    example: str = "",
) -> DiagnosticStatus:
    """Return the status of the series.

    Its message has every problem, the most serious one first. `contact_points` are those assessed since the last
    report, not by the watchdog. `undecodable` counts messages by type since the last reset, and `example` is the error
    of the last one. `unheard` says that an input has no publisher, or several.
    """
    result = validator.result()
    selected, fit = next((model.overall, model.fit) for model in result.models if model.model == result.model)
    problems = []
    if result.held.exceedances:
        worst = result.held.worst
        problems.append(f"held force above a limit: {worst.force:.1f} N of {worst.limit:.1f} N on {worst.region}")
    if result.left_out.exceedances:
        worst = result.left_out.worst
        problems.append(
            f"left out of the series and above a limit: {worst.force:.1f} N of {worst.limit:.1f} N on {worst.region}"
        )
    if result.unmeasured:
        problems.append(f"{result.unmeasured} contacts clipped, incomplete or stuck: their force is not known")
    problems += [result.clock, result.force_sign, unheard]
    if unpaired := sum(result.unpaired.values()):
        problems.append(f"{unpaired} impacts could not be paired: {', '.join(result.unpaired)}")
    if result.contact_point not in contact_points:
        others = ", ".join(sorted(contact_points))
        problems.append(
            f"no contact states of {result.contact_point}, only of {others}" if others else "no contact states"
        )
    if result.waiting:
        problems.append(f"{result.waiting} impacts wait for contact states")
    if undecodable:
        problems.append(f"{undecodable.total()} undecodable messages, the last one: {example}")
    values: dict[str, object] = {
        "model": result.model,
        "contact point": result.contact_point,
        "obstacle mass [kg]": f"{validator.runs.latest.obstacle_mass:.6g}",
        "impacts seen": result.seen,
        "impacts in the series": len(result.impacts),
        "impacts waiting": result.waiting,
        "of these simulated": result.simulated,
        "accepted": result.accepted,
        "decidable": result.decidable,
        "reason": result.reason,
        "criterion hash": result.criterion_hash,
        "correlation": selected.correlation_reason or f"{selected.correlation:.5f}",
        "fitted stiffness [N/m]": f"{selected.fitted_stiffness:.6g}",
        "mass scale": f"{fit.mass_scale:.4g} ({fit.mass_scale_interval.low:.4g} to {fit.mass_scale_interval.high:.4g})",
        "gain of the force": f"{fit.gain:.4g} ({fit.gain_interval.low:.4g} to {fit.gain_interval.high:.4g})",
        "clock offset [s]": f"{result.clock_offset.offset:.4g}",
        "impacts above the limit": result.exceedances,
        "contacts of unknown force": result.unmeasured,
        "contacts that held": result.held.contacts,
        "contacts that held above the limit": result.held.exceedances,
        "bias [N]": f"{selected.bias:.4g}",
        "rmse [N]": f"{selected.rmse:.4g}",
        "non-conservative": selected.non_conservative,
        "clocks": result.clock,
        "sign of force": result.force_sign,
        "contact states too late": result.late_states,
        "undecodable messages": undecodable.total(),
    }
    groups = (("excluded", result.excluded), ("not paired", result.unpaired), ("undecodable", undecodable))
    for group, counts in groups:
        values |= {f"{group}: {name}": count for name, count in sorted(counts.items())}
    left_out = [impact for impact in result.refused if impact.reason not in {REBOUND, DUPLICATE}][-MAX_IMPACTS:]
    values |= {
        left_out_entry(impact.stamp_ns): ": ".join(filter(None, (impact.reason, impact.detail))) for impact in left_out
    }
    message = f"{len(result.impacts)} impacts, {result.verdict}"
    return status("series", message, values, problem="; ".join(filter(None, problems)), hardware_id=robot)
