"""How a node says on `/diagnostics` how it fares."""

from __future__ import annotations

from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from scara_effmass.nodes.lifecycle import LifecycleBase

_PERIOD_S = 1.0


class Diagnostics:
    """The statuses of a node, every second and when something has changed."""

    def __init__(self, node: LifecycleBase, statuses: Callable[[], list[DiagnosticStatus]]) -> None:
        """Publish for `node`, while it is configured, what `statuses` returns; nothing where that is nothing."""
        self._clock = node.get_clock()
        self._statuses = statuses
        self._publisher = node.own(
            node.create_lifecycle_publisher(DiagnosticArray, "/diagnostics", 10), node.destroy_lifecycle_publisher
        )
        node.create_steady_timer(_PERIOD_S, self.report)

    def report(self) -> None:
        """Publish now."""
        if statuses := self._statuses():
            array = DiagnosticArray(status=statuses)
            array.header.stamp = self._clock.now().to_msg()
            self._publisher.publish(array)


def status(name: str, level: bytes, message: str, values: Mapping[str, object]) -> DiagnosticStatus:
    """Return a status; every value becomes text."""
    pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
    return DiagnosticStatus(name=name, level=level, message=message, values=pairs)
