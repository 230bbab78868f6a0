# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of the validation: the series, and the impacts and messages left out of it."""

from collections import Counter
from collections.abc import Collection

from diagnostic_msgs.msg import DiagnosticStatus

from scara_effmass.impacts.agreement import comparison_text
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
) -> DiagnosticStatus:
    """Return the status of the series.

    `contact_points` are those assessed since the last report, not by the watchdog. `undecodable` counts messages by
    error. `unheard` says that an input has no publisher.
    """
    result = validator.result()
    selected, fit = next((model.overall, model.fit) for model in result.models if model.model == result.model)
    problem = result.clock or result.force_sign or "; ".join(undecodable) or unheard
    unpaired = sum(result.unpaired.values())
    if not problem and result.held.exceedances:
        worst = result.held.worst
        problem = f"held force above a limit: {worst.force:.1f} N of {worst.limit:.1f} N on {worst.region}"
    if not problem and unpaired:
        problem = f"{unpaired} impacts could not be paired: {', '.join(result.unpaired)}"
    if not problem and result.contact_point not in contact_points:
        others = ", ".join(sorted(contact_points))
        problem = f"no contact states of {result.contact_point}, only of {others}" if others else "no contact states"
    if not problem and result.waiting:
        problem = f"{result.waiting} impacts wait for contact states"
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
    for group, counts in (("excluded:", result.excluded), ("not paired:", result.unpaired)):
        values |= {f"{group} {name}": count for name, count in sorted(counts.items())}
    message = f"{len(result.impacts)} impacts, {result.verdict}"
    return status("series", message, values, problem=problem, hardware_id=robot)
