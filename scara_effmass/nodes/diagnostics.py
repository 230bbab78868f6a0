"""Diagnostics of a node on `/diagnostics`."""

from collections.abc import Callable, Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from scara_effmass.nodes.lifecycle import LifecycleBase
from scara_effmass.wire.topics import DIAGNOSTICS

_PERIOD_S = 1.0


class Diagnostics:
    """Publishes the statuses of a node every second and on request."""

    def __init__(self, node: LifecycleBase, statuses: Callable[[], list[DiagnosticStatus]]) -> None:
        """Publish what `statuses` returns, unless it is empty, while `node` is configured.

        The name of each status is preceded by that of the node with its namespace, so that it is unique.
        """
        self._node = node
        self._statuses = statuses
        self._publisher = node.own(
            node.create_lifecycle_publisher(DiagnosticArray, DIAGNOSTICS, 10), node.destroy_lifecycle_publisher
        )
        node.create_steady_timer(_PERIOD_S, self.report)

    def report(self) -> None:
        """Publish the statuses now."""
        if statuses := self._statuses():
            for entry in statuses:
                entry.name = f"{self._node.get_fully_qualified_name()}: {entry.name}"
            array = DiagnosticArray(status=statuses)
            array.header.stamp = self._node.get_clock().now().to_msg()
            self._publisher.publish(array)


def status(
    name: str,
    message: str,
    values: Mapping[str, object],
    *,
    problem: str = "",
    level: bytes | None = None,
    hardware_id: str = "",
) -> DiagnosticStatus:
    """Return a status with its values as text. A `problem` is a WARN and replaces the message; `level` overrides."""
    if level is None:
        level = DiagnosticStatus.WARN if problem else DiagnosticStatus.OK
    pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
    return DiagnosticStatus(name=name, level=level, message=problem or message, hardware_id=hardware_id, values=pairs)
