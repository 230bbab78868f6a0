"""Diagnostics of the validation: state of the series, and impacts and messages that are not part of it."""

from collections import Counter

from diagnostic_msgs.msg import DiagnosticStatus

from scara_effmass.impacts.result import Result
from scara_effmass.nodes.diagnostics import status


class ValidatorHealth:
    """Count lost and undecodable messages, and report them with the series."""

    def __init__(self, node: str) -> None:
        """`node`: name of the node in the status."""
        self._node = node
        self._incompatible: set[str] = set()
        self._lost: dict[str, int] = {}
        self._undecodable: Counter[str] = Counter()

    def incompatible(self, line: str) -> None:
        """Record an endpoint with incompatible QoS."""
        self._incompatible.add(line)

    def lose(self, topic: str, count: int) -> None:
        """Record the total number of messages of a topic that the middleware lost."""
        self._lost[topic] = count

    def undecodable(self, line: str) -> None:
        """Count an undecodable message."""
        self._undecodable[line] += 1

    def statuses(self, result: Result, obstacle_mass: float) -> list[DiagnosticStatus]:
        """Return the diagnostic status; `obstacle_mass` [kg] of the latest run, 0: unknown."""
        selected = next(model for model in result.models if model.model == result.model).overall
        problem = result.clock or result.force_sign or "; ".join((*sorted(self._incompatible), *self._undecodable))
        unpaired = sum(result.unpaired.values())
        if not problem and unpaired:
            problem = f"{unpaired} impacts could not be paired: {', '.join(result.unpaired)}"
        if not problem and self._lost:
            problem = ", ".join(f"{count} messages of {topic} lost" for topic, count in self._lost.items())
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
            "correlation": selected.correlation_reason or f"{selected.correlation:.5f}",
            "fitted stiffness [N/m]": f"{selected.fitted_stiffness:.6g}",
            "bias [N]": f"{selected.bias:.4g}",
            "rmse [N]": f"{selected.rmse:.4g}",
            "non-conservative": selected.non_conservative,
            "clocks": result.clock,
            "sign of force": result.force_sign,
            "contact states too late": result.late_states,
            "undecodable messages": sum(self._undecodable.values()),
            "incompatible QoS": "; ".join(sorted(self._incompatible)),
        }
        values |= {f"excluded: {reason}": count for reason, count in sorted(result.excluded.items())}
        values |= {f"not paired: {reason}": count for reason, count in sorted(result.unpaired.items())}
        values |= {f"lost of {topic}": count for topic, count in sorted(self._lost.items())}
        level = DiagnosticStatus.WARN if problem else DiagnosticStatus.OK
        message = problem or f"{len(result.impacts)} impacts, {'accepted' if result.accepted else result.reason}"
        return [status(f"{self._node}: series", level, message, values)]
