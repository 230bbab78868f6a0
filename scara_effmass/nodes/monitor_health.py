"""Diagnostics of the monitor: its input, its model and each contact point."""

from collections.abc import Collection, Sequence

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus

from scara_effmass.iso15066 import EDITION, TABLE_HASH
from scara_effmass.model.dynamics import RobotDynamics
from scara_effmass.nodes.diagnostics import status
from scara_effmass.safety import Monitor
from scara_effmass.settings import MassModel
from scara_effmass.values import ContactAssessment, Decision, Verdict

_NO_ROBOT = "no robot"
_LEVELS = {
    Verdict.OK: DiagnosticStatus.OK,
    Verdict.WARN: DiagnosticStatus.WARN,
    Verdict.VIOLATION: DiagnosticStatus.ERROR,
    Verdict.UNKNOWN: DiagnosticStatus.ERROR,  # STALE is the aggregator's word for a dead node
}


def missing_models(dynamics: RobotDynamics) -> list[str]:
    """Return a line for each effective mass that the robot model does not have."""
    reasons = {"lumped mass": dynamics.lumped_reason, "full mass": dynamics.full_reason}
    return [f"no {name}: {reason}" for name, reason in reasons.items() if reason]


def monitor_statuses(
    monitor: Monitor | None, decision: Decision | None, joint_states: DiagnosticStatus
) -> list[DiagnosticStatus]:
    """Return the statuses of one report; `joint_states` is that of the input."""
    statuses = [joint_states]
    if monitor is not None:
        statuses.append(_model_status(monitor))
    if decision is not None:
        statuses += [_contact_status(contact) for contact in decision.contacts]
    for entry in statuses:
        entry.hardware_id = (monitor.dynamics.robot.name if monitor else "") or _NO_ROBOT
    return statuses


def input_status(
    monitor: Monitor | None,
    *,
    publishers: int,
    received: int,
    lost: int,
    incompatible_qos: Collection[str],
    processing_ns: Sequence[int],
) -> DiagnosticStatus:
    """Return the status of the joint states.

    `processing_ns` are the times from the start of a callback until all its outputs were published.
    """
    processing_us = np.array(processing_ns or [0]) / 1e3
    incompatible = "; ".join(sorted(incompatible_qos))
    problem = incompatible
    if publishers == 0:
        problem = "no publisher of joint states"
    elif publishers > 1:
        problem = f"{publishers} publishers of joint states: only one may send the robot's joints"
    elif lost:
        problem = f"{lost} joint states lost"
    values = {
        "publishers": publishers,
        "received": received,
        "lost": lost,
        "refused": monitor.rejected if monitor else 0,
        "of other devices": monitor.ignored if monitor else 0,
        "incompatible QoS": incompatible,
        "processing p50 [us]": f"{np.percentile(processing_us, 50):.0f}",
        "processing p99 [us]": f"{np.percentile(processing_us, 99):.0f}",
        "processing max [us]": f"{processing_us.max():.0f}",
    }
    return status("input", f"{received} joint states", values, problem=problem)


def _model_status(monitor: Monitor) -> DiagnosticStatus:
    dynamics, robot, cause = monitor.dynamics, monitor.dynamics.robot, monitor.first_cause
    values = {
        "robot": robot.origin,
        "joints": ", ".join(robot.joint_names),
        "effective_mass_model": monitor.settings.effective_mass_model.value,
        "lumped mass": dynamics.lumped_reason or "available",
        "full mass": dynamics.full_reason or "available",
        "ISO mass [kg]": robot.masses_reason or f"{robot.iso_mass:.4g}",
        "moving mass [kg]": f"{robot.moving_mass:.4g}",
        "payload": monitor.payload_text,
        "notes": "; ".join(robot.notes),
        "limits": EDITION,
        "limits hash": TABLE_HASH,
        "first cause": f"{cause.verdict.name} at {cause.stamp_ns / 1e9:.6f} s: {cause.reason}" if cause else "",
        **{f"decisions {verdict.name}": count for verdict, count in monitor.verdicts.items()},
    }
    missing = missing_models(dynamics)
    if monitor.settings.effective_mass_model is MassModel.AUTO and not dynamics.full_reason:
        missing = []  # the full model decides where there is no lumped one
    problem = monitor.payload_reason or next(iter(missing), "") or robot.rotors.warning
    return status("model", "lumped and full model", values, problem=problem)


def _contact_status(contact: ContactAssessment) -> DiagnosticStatus:
    values = {
        "verdict": contact.verdict.name,
        "speed [m/s]": f"{contact.speed:.4f}",
        "allowable speed [m/s]": f"{contact.allowable_speed:.4f}",
        "margin [m/s]": f"{contact.margin:.4f}",
        "effective mass [kg]": f"{contact.effective_mass:.4g}",
        "mass model": contact.mass_model_text,
        "body region": contact.body_region,
        "criterion": contact.criterion,
        "input age [s]": f"{contact.input_age:.6f}",
    }
    message = contact.reason or contact.verdict.name
    return status(f"contact {contact.contact_point}", message, values, level=_LEVELS[contact.verdict])
