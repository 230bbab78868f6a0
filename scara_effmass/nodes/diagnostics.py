"""Diagnostics of a node on `/diagnostics`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

if TYPE_CHECKING:
    from scara_effmass.nodes.lifecycle import LifecycleBase

_PERIOD_S = 1.0


class Diagnostics:
    """Publishes the statuses of a node every second and on request."""

    def __init__(self, node: LifecycleBase, statuses: Callable[[], list[DiagnosticStatus]]) -> None:
        """Publish what `statuses` returns, unless it is empty, while `node` is configured."""
        self._clock = node.get_clock()
        self._statuses = statuses
        self._publisher = node.own(
            node.create_lifecycle_publisher(DiagnosticArray, "/diagnostics", 10), node.destroy_lifecycle_publisher
        )
        node.create_steady_timer(_PERIOD_S, self.report)

    def report(self) -> None:
        """Publish the statuses now."""
        if statuses := self._statuses():
            array = DiagnosticArray(status=statuses)
            array.header.stamp = self._clock.now().to_msg()
            self._publisher.publish(array)


def status(name: str, level: bytes, message: str, values: Mapping[str, object]) -> DiagnosticStatus:
    """Return a status with its values as text."""
    pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
    return DiagnosticStatus(name=name, level=level, message=message, values=pairs)
