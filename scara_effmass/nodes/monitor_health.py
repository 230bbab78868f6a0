# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of the monitor: its input and latency, its model and each contact point."""

from bisect import bisect_right
from collections import deque
from collections.abc import Iterable
from itertools import pairwise

from diagnostic_msgs.msg import DiagnosticStatus

from scara_effmass.iso15066 import EDITION, TABLE_HASH
from scara_effmass.nodes.diagnostics import CHANGES, REASON_CODE, REMEDY, status
from scara_effmass.nodes.robot_input import label
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Cause, Monitor
from scara_effmass.safety.assumptions import RULES, deciding_mass, name_of, scope
from scara_effmass.safety.reasons import LOAD_ENTRY
from scara_effmass.safety.remedies import remedy
from scara_effmass.settings import MassModel
from scara_effmass.values import ContactAssessment, Decision, Verdict, at_least, at_most, severity

EDGES_US = (125, 250, 500, 1000, 2000, 4000, 8000, 16000)
_MAX_RECENT = 10_000
"""Bounds the memory where joint states come faster than reports."""
_LEVELS = {
    Verdict.OK: DiagnosticStatus.OK,
    Verdict.WARN: DiagnosticStatus.WARN,
    Verdict.VIOLATION: DiagnosticStatus.ERROR,
    Verdict.UNKNOWN: DiagnosticStatus.ERROR,  # STALE is the aggregator's word for a dead node
}


class Latencies:
    """Times from the arrival of a joint state until its answer is published; the histogram counts since the start."""

    def __init__(self) -> None:
        self._recent: deque[int] = deque(maxlen=_MAX_RECENT)
        self._counts = [0] * (len(EDGES_US) + 1)
        self.missed = 0
        self._stamp_ns = 0

    def add(self, latency_ns: int, stamp_ns: int) -> None:
        """Count an answer; one that took longer than the time since the stamp before missed its deadline."""
        self._recent.append(latency_ns)
        if latency_ns > stamp_ns - self._stamp_ns > 0:
            self.missed += 1
        self._stamp_ns = stamp_ns

    def report(self) -> dict[str, float]:
        """Return percentiles since the last call [us]; none without answers. Update `histogram`."""
        recent, self._recent = sorted(self._recent), deque(maxlen=_MAX_RECENT)
        below = [0, *(bisect_right(recent, 1000 * edge) for edge in EDGES_US), len(recent)]
        self._counts = [count + b - a for count, (a, b) in zip(self._counts, pairwise(below), strict=True)]
        shares = {"p50": 0.5, "p99": 0.99, "p99.9": 0.999, "max": 1.0} if recent else {}
        return {name: recent[round(share * (len(recent) - 1))] / 1e3 for name, share in shares.items()}

    @property
    def histogram(self) -> str:
        """Number of answers by latency [us] until the last report."""
        labels = (*(f"<={edge}" for edge in EDGES_US), f">{EDGES_US[-1]}")
        return ", ".join(f"{label}: {count}" for label, count in zip(labels, self._counts, strict=True))


def missing_models(dynamics: RobotDynamics) -> list[str]:
    """Return a line for each effective mass that the robot model does not have."""
    reasons = {"lumped mass": dynamics.lumped_reason, "full mass": dynamics.full_reason}
    return [f"no {name}: {reason}" for name, reason in reasons.items() if reason]


def worst_contacts(decision: Decision, changes: Iterable[Decision]) -> tuple[ContactAssessment, ...]:
    """Return for each contact point the worst of its assessments in `decision`, the latest one, and in `changes`."""
    worst = {contact.contact_point: contact for contact in decision.contacts}
    for contact in (contact for change in changes for contact in change.contacts):
        latest = worst.get(contact.contact_point)
        if latest and severity(contact.verdict) > severity(latest.verdict):
            worst[contact.contact_point] = contact
    return tuple(worst.values())


def cause_text(cause: Cause) -> str:
    """Return the contact point and its reason."""
    return f"{cause.contact_point}: {cause.reason}".removeprefix(": ")


def model_status(monitor: Monitor) -> DiagnosticStatus:
    """Return the status of the robot, its models and the settings."""
    dynamics, robot, cause = monitor.dynamics, monitor.dynamics.robot, monitor.first_cause
    values = {
        "robot": label(robot),
        "joints": ", ".join(robot.joint_names),
        "effective_mass_model": monitor.settings.effective_mass_model.value,
        "lumped mass": dynamics.lumped_reason or "available",
        "full mass": dynamics.full_reason or "available",
        "ISO mass [kg]": robot.masses_reason or f"{robot.iso_mass:.4g}",
        "moving mass [kg]": f"{robot.moving_mass:.4g}",
        "deciding mass": deciding_mass(dynamics, monitor.settings.effective_mass_model),
        "payload": monitor.payload_text,
        LOAD_ENTRY: monitor.load_text,
        "an OK covers": scope(robot, monitor.settings),
        "assumed": "; ".join(RULES[code].text for code in monitor.assumptions.assumed),
        "accepted assumptions": ", ".join(map(name_of, monitor.assumptions.accepted)),
        "notes": "; ".join(robot.notes),
        "core": monitor.core,
        "kernel disagreements": int(bool(monitor.kernel_fault)),  # the first one is the last
        "limits": EDITION,
        "limits hash": TABLE_HASH,
        "first cause": f"{cause.verdict.name} at {cause.stamp_ns / 1e9:.6f} s: {cause_text(cause)}" if cause else "",
        **{f"decisions {verdict.name}": count for verdict, count in monitor.verdicts.items()},
    }
    missing = missing_models(dynamics)
    if monitor.settings.effective_mass_model is MassModel.AUTO and not dynamics.full_reason:
        missing = []  # the full model decides where there is no lumped one
    problem = monitor.payload_reason or next(iter(missing), "") or monitor.kernel_fault or robot.rotors.warning
    return status("model", "lumped and full model", values, problem=problem)


def contact_text(contact: ContactAssessment) -> str:
    """Return the assessment in one line: verdict, speed of allowable speed, body region, reason, remedy if UNKNOWN."""
    is_unknown = contact.verdict is Verdict.UNKNOWN
    numbers = "" if is_unknown else f", {contact.speed_text}, {contact.body_region}"
    advice = f"{REMEDY}{remedy(contact.reason_code)}" * is_unknown
    return f"{contact.verdict.name}{numbers}{': ' * bool(contact.reason)}{contact.reason}{advice}"


def contact_status(contact: ContactAssessment, changes: int, input_age: float) -> DiagnosticStatus:
    """Return the status of a contact point; `changes` counts those of its verdict."""
    numbers = at_least(contact.speed, 4), at_most(contact.margin, 4), f"{contact.effective_mass:.4g}"
    speed, margin, mass = numbers if contact.verdict is not Verdict.UNKNOWN else ("unknown",) * 3
    values = {
        "verdict": contact.verdict.name,
        "speed [m/s]": speed,
        "allowable speed [m/s]": at_most(contact.allowable_speed, 4),
        "margin [m/s]": margin,
        "effective mass [kg]": mass,
        "mass model": contact.mass_model_text,
        "body region": contact.body_region,
        "criterion": contact.criterion,
        "input age [s]": f"{input_age:.6f}",
        REASON_CODE: contact.reason_code.value,
        CHANGES: changes,
    }
    name = f"contact {contact.contact_point}".rstrip()
    return status(name, contact_text(contact), values, level=_LEVELS[contact.verdict])
