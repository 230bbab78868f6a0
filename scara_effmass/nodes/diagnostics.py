# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of a node on `/diagnostics`."""

from collections.abc import Callable, Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from scara_effmass.nodes.lifecycle import AnyNode
from scara_effmass.nodes.terminal import NodeLog
from scara_effmass.wire.topics import DIAGNOSTICS

_PERIOD_S = 1.0


class Diagnostics:
    """Publishes the statuses of a node every second and on request, and logs their changes.

    `log` takes the events of the node.
    """

    def __init__(self, node: AnyNode, statuses: Callable[[], list[DiagnosticStatus]]) -> None:
        """Publish what `statuses` returns, unless it is empty, while `node` is configured.

        The first status also names the endpoints that cannot be connected. The full name of the node precedes the name
        of each status, which makes it unique. While the node is active, it logs a summary every `status_period`.
        """
        self._node = node
        self._statuses = statuses
        self._latest: list[DiagnosticStatus] = []
        self.log = NodeLog(node)
        node.create_status_timer(self._log_status)
        self._publisher = node.own(
            node.create_lifecycle_publisher(DiagnosticArray, DIAGNOSTICS, 10), node.destroy_lifecycle_publisher
        )
        node.create_steady_timer(_PERIOD_S, self.report)

    def report(self) -> None:
        """Publish the statuses now."""
        if statuses := self._statuses():
            first, unconnected = statuses[0], self._node.incompatible_qos
            first.values.append(KeyValue(key="incompatible QoS", value=unconnected))
            if unconnected and first.level == DiagnosticStatus.OK:
                first.level, first.message = DiagnosticStatus.WARN, unconnected
            elif unconnected:
                first.message += f"; {unconnected}"
            for entry in statuses:
                entry.name = f"{self._node.get_fully_qualified_name()}: {entry.name}"
            self._latest = statuses
            if self._node.active:
                self.log.update(statuses)
            array = DiagnosticArray(status=statuses)
            array.header.stamp = self._node.get_clock().now().to_msg()
            self._publisher.publish(array)

    def _log_status(self) -> None:
        if self._latest:
            self.log.status_line(self._latest)


def no_publisher(node: Node, topic: str, type_name: str) -> str:
    """Return a warning if `topic` has no publisher, with a remapping to a published topic of its type; else ""."""
    name = node.resolve_topic_name(topic)
    if node.count_publishers(name):
        return ""
    others = (other for other, types in node.get_topic_names_and_types() if type_name in types)
    heard = next(
        (f"; {other} has one: remap with -r {topic}:={other}" for other in others if node.count_publishers(other)), ""
    )
    return f"no publisher of {name}{heard}"


def several_publishers(node: Node, topic: str) -> str:
    """Return a warning if `topic` has several publishers, whose messages nothing tells apart; else ""."""
    name = node.resolve_topic_name(topic)
    count = node.count_publishers(name)
    return f"{count} publishers of {name}: must be one" if count > 1 else ""


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
