"""What `/diagnostics` says of the monitor: its input, its model, and each contact point."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus

from scara_effmass.iso15066 import EDITION, TABLE_HASH
from scara_effmass.nodes.diagnostics import status
from scara_effmass.values import Verdict

if TYPE_CHECKING:
    from collections.abc import Iterator

    from scara_effmass.model.dynamics import RobotDynamics
    from scara_effmass.safety import Monitor
    from scara_effmass.values import ContactAssessment, Decision

_LEVELS = {
    Verdict.OK: DiagnosticStatus.OK,
    Verdict.WARN: DiagnosticStatus.WARN,
    Verdict.VIOLATION: DiagnosticStatus.ERROR,
    Verdict.UNKNOWN: DiagnosticStatus.STALE,
}


class MonitorHealth:
    """Counts what the node receives, and what the middleware says was lost, and how long an answer takes."""

    def __init__(self, node: str) -> None:
        """Count for the node of that name."""
        self._node = node
        self.received = 0
        self.lost = 0
        self._took_ns: list[int] = []
        self._unmatched: set[str] = set()

    def answered(self, took_ns: int) -> None:
        """Note how long one joint state took, from the callback's start until all was published."""
        self._took_ns.append(took_ns)

    def incompatible(self, endpoint: str) -> None:
        """Note an endpoint that could not be connected for its QoS: who it is, and which policy."""
        self._unmatched.add(endpoint)

    @staticmethod
    def missing_models(arm: RobotDynamics) -> Iterator[str]:
        """Return a line for each effective mass that this robot has none of."""
        if arm.lumped_reason:
            yield f"lumped mass: {arm.lumped_reason}"
        if arm.full_reason:
            yield f"full mass: {arm.full_reason}"

    def statuses(self, monitor: Monitor | None, decision: Decision | None, publishers: int) -> list[DiagnosticStatus]:
        """Return the statuses for one report, and start the next interval."""
        hardware = monitor.dynamics.robot.name if monitor else ""
        statuses = [self._input(monitor, publishers)]
        if monitor is not None:
            statuses.append(self._model(monitor))
        if decision is not None:
            statuses += [self._contact(contact) for contact in decision.contacts]
        for each in statuses:
            each.hardware_id = hardware
        return statuses

    def _input(self, monitor: Monitor | None, publishers: int) -> DiagnosticStatus:
        took = np.array(self._took_ns or [0]) / 1e3
        self._took_ns = []
        level, message = DiagnosticStatus.OK, f"{self.received} joint states"
        if publishers == 0:
            level, message = DiagnosticStatus.WARN, "no publisher of joint states"
        elif publishers > 1:
            level, message = DiagnosticStatus.WARN, f"{publishers} publishers of joint states, taken as one stream"
        elif self.lost:
            level, message = DiagnosticStatus.WARN, f"{self.lost} joint states lost"
        elif self._unmatched:
            level, message = DiagnosticStatus.WARN, "; ".join(sorted(self._unmatched))
        return status(
            f"{self._node}: input",
            level,
            message,
            {
                "publishers": publishers,
                "received": self.received,
                "lost": self.lost,
                "refused": monitor.rejected if monitor else 0,
                "of other devices": monitor.ignored if monitor else 0,
                "incompatible QoS": "; ".join(sorted(self._unmatched)),
                "processing p50 [us]": f"{np.percentile(took, 50):.0f}",
                "processing p99 [us]": f"{np.percentile(took, 99):.0f}",
                "processing max [us]": f"{took.max():.0f}",
            },
        )

    def _model(self, monitor: Monitor) -> DiagnosticStatus:
        arm, settings = monitor.dynamics, monitor.settings
        robot = arm.robot
        missing = tuple(self.missing_models(arm))
        cause = monitor.first_cause
        return status(
            f"{self._node}: model",
            DiagnosticStatus.WARN if missing else DiagnosticStatus.OK,
            f"no {missing[0]}" if missing else "lumped and full model",
            {
                "robot": robot.origin,
                "joints": ", ".join(robot.joint_names),
                "effective_mass_model": settings.effective_mass_model.value,
                "lumped mass": arm.lumped_reason or "available",
                "full mass": arm.full_reason or "available",
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
