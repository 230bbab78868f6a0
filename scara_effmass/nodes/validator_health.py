"""What `/diagnostics` says of the validation: how the series stands, and what is not in it."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticStatus

from scara_effmass.nodes.diagnostics import status

if TYPE_CHECKING:
    from scara_effmass.impacts.result import Result


class ValidatorHealth:
    """Counts what the middleware lost and what could not be decoded, and puts the series into a status."""

    def __init__(self, node: str) -> None:
        """Report for the node of that name."""
        self._node = node
        self._unmatched: set[str] = set()
        self._lost: dict[str, int] = {}
        self._undecodable: Counter[str] = Counter()

    def incompatible(self, line: str) -> None:
        """Note an endpoint that could not be connected for its QoS."""
        self._unmatched.add(line)

    def lose(self, topic: str, count: int) -> None:
        """Note how many messages of a topic the middleware has lost so far."""
        self._lost[topic] = count

    def undecodable(self, line: str) -> None:
        """Note a message that is not what its type says."""
        self._undecodable[line] += 1

    def statuses(self, result: Result, obstacle_mass: float) -> list[DiagnosticStatus]:
        """Return the statuses for one report; `obstacle_mass` [kg] is that of the latest run, 0 where not known."""
        judged = next(each for each in result.models if each.model == result.model).overall
        trouble = result.clock or result.force_sign or "; ".join((*sorted(self._unmatched), *self._undecodable))
        unpaired = sum(result.unpaired.values())
        if not trouble and unpaired:
            trouble = f"{unpaired} impacts could not be paired: {', '.join(result.unpaired)}"
        if not trouble and self._lost:
            trouble = ", ".join(f"{count} messages of {topic} lost" for topic, count in self._lost.items())
        values: dict[str, object] = {
            "model": result.model,
            "contact point": result.contact_point,
            "obstacle mass [kg]": f"{obstacle_mass:.6g}",
            "impacts seen": result.seen,
            "impacts in the series": len(result.impacts),
            "impacts waiting": result.waiting,
            "of these simulated": result.simulated,
            "accepted": result.accepted,
            "reason": result.reason,
            "criterion hash": result.criterion_hash,
            "correlation": judged.correlation_reason or f"{judged.correlation:.5f}",
            "fitted stiffness [N/m]": f"{judged.fitted_stiffness:.6g}",
            "bias [N]": f"{judged.bias:.4g}",
            "rmse [N]": f"{judged.rmse:.4g}",
            "non-conservative": judged.non_conservative,
            "clocks": result.clock,
            "sign of force": result.force_sign,
            "contact states too late": result.late_states,
            "undecodable messages": sum(self._undecodable.values()),
            "incompatible QoS": "; ".join(sorted(self._unmatched)),
        }
        values |= {f"excluded: {reason}": count for reason, count in sorted(result.excluded.items())}
        values |= {f"not paired: {reason}": count for reason, count in sorted(result.unpaired.items())}
        values |= {f"lost of {topic}": count for topic, count in sorted(self._lost.items())}
        level = DiagnosticStatus.WARN if trouble else DiagnosticStatus.OK
        message = trouble or f"{len(result.impacts)} impacts, {'accepted' if result.accepted else result.reason}"
        return [status(f"{self._node}: series", level, message, values)]
