"""Diagnostics of the monitor: its input, its model and each contact point."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus

from scara_effmass.iso15066 import EDITION, TABLE_HASH
from scara_effmass.nodes.diagnostics import status
from scara_effmass.safety import Monitor
from scara_effmass.values import ContactAssessment, Decision, Verdict

if TYPE_CHECKING:
    from scara_effmass.model.dynamics import RobotDynamics

_LEVELS = {
    Verdict.OK: DiagnosticStatus.OK,
    Verdict.WARN: DiagnosticStatus.WARN,
    Verdict.VIOLATION: DiagnosticStatus.ERROR,
    Verdict.UNKNOWN: DiagnosticStatus.STALE,
}


class MonitorHealth:
    """Counts received and lost joint states and measures processing times."""

    def __init__(self, node: str) -> None:
        """Create the counters; `node` is the node's name."""
        self._node = node
        self.received = 0
        self.lost = 0
        self._processing_ns: list[int] = []
        self._incompatible: set[str] = set()

    def add_processing_time(self, duration_ns: int) -> None:
        """Add the time from the start of a callback until all its outputs were published."""
        self._processing_ns.append(duration_ns)

    def incompatible(self, line: str) -> None:
        """Add a line about an endpoint with incompatible QoS."""
        self._incompatible.add(line)

    @staticmethod
    def missing_models(dynamics: RobotDynamics) -> Iterator[str]:
        """Yield a line for each effective mass that the robot model does not have."""
        if dynamics.lumped_reason:
            yield f"lumped mass: {dynamics.lumped_reason}"
        if dynamics.full_reason:
            yield f"full mass: {dynamics.full_reason}"

    def statuses(self, monitor: Monitor | None, decision: Decision | None, publishers: int) -> list[DiagnosticStatus]:
        """Return the statuses of one report and start the next interval."""
        statuses = [self._input(monitor, publishers)]
        if monitor is not None:
            statuses.append(self._model(monitor))
        if decision is not None:
            statuses += [self._contact(contact) for contact in decision.contacts]
        for entry in statuses:
            entry.hardware_id = monitor.dynamics.robot.name if monitor else ""
        return statuses

    def _input(self, monitor: Monitor | None, publishers: int) -> DiagnosticStatus:
        processing_us = np.array(self._processing_ns or [0]) / 1e3
        self._processing_ns = []
        incompatible = "; ".join(sorted(self._incompatible))
        warning = ""
        if publishers == 0:
            warning = "no publisher of joint states"
        elif publishers > 1:
            warning = f"{publishers} publishers of joint states, handled as one stream"
        elif self.lost:
            warning = f"{self.lost} joint states lost"
        return status(
            f"{self._node}: input",
            DiagnosticStatus.WARN if warning or incompatible else DiagnosticStatus.OK,
            warning or incompatible or f"{self.received} joint states",
            {
                "publishers": publishers,
                "received": self.received,
                "lost": self.lost,
                "refused": monitor.rejected if monitor else 0,
                "of other devices": monitor.ignored if monitor else 0,
                "incompatible QoS": incompatible,
                "processing p50 [us]": f"{np.percentile(processing_us, 50):.0f}",
                "processing p99 [us]": f"{np.percentile(processing_us, 99):.0f}",
                "processing max [us]": f"{processing_us.max():.0f}",
            },
        )

    def _model(self, monitor: Monitor) -> DiagnosticStatus:
        dynamics, robot = monitor.dynamics, monitor.dynamics.robot
        missing = tuple(self.missing_models(dynamics))
        cause = monitor.first_cause
        return status(
            f"{self._node}: model",
            DiagnosticStatus.WARN if missing else DiagnosticStatus.OK,
            f"no {missing[0]}" if missing else "lumped and full model",
            {
                "robot": robot.origin,
                "joints": ", ".join(robot.joint_names),
                "effective_mass_model": monitor.settings.effective_mass_model.value,
                "lumped mass": dynamics.lumped_reason or "available",
                "full mass": dynamics.full_reason or "available",
                "ISO mass [kg]": f"{robot.iso_mass:.4g}" if not robot.masses_reason else robot.masses_reason,
                "moving mass [kg]": f"{robot.moving_mass:.4g}",
                "payload [kg]": f"{robot.payload_mass:.4g}",
                "notes": "; ".join(robot.notes),
                "limits": EDITION,
                "limits hash": TABLE_HASH,
                "first cause": f"{cause.verdict.name} at {cause.stamp_ns / 1e9:.6f} s: {cause.reason}" if cause else "",
                **{f"decisions {verdict.name}": count for verdict, count in monitor.verdicts.items()},
            },
        )

    def _contact(self, contact: ContactAssessment) -> DiagnosticStatus:
        return status(
            f"{self._node}: contact {contact.contact_point}",
            _LEVELS[contact.verdict],
            contact.reason or contact.verdict.name,
            {
                "verdict": contact.verdict.name,
                "speed [m/s]": f"{contact.speed:.4f}",
                "allowable speed [m/s]": f"{contact.allowable_speed:.4f}",
                "margin [m/s]": f"{contact.margin:.4f}",
                "effective mass [kg]": f"{contact.effective_mass:.4g}",
                "mass capped": contact.mass_capped,
                "worst direction used": contact.worst_direction_used,
                "smallest singular value": f"{contact.smallest_singular_value:.4g}",
                "body region": contact.body_region,
                "criterion": contact.criterion,
                "input age [s]": f"{contact.input_age:.6f}",
            },
        )
