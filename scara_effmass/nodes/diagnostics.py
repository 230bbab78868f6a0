# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of a node on `/diagnostics`, and its log on the terminal and /rosout: changes, events, a status line."""

import re
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from textwrap import shorten

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from scara_effmass.codes import Reason
from scara_effmass.nodes.lifecycle import AnyNode
from scara_effmass.safety.remedies import remedy
from scara_effmass.wire.topics import DIAGNOSTICS

_PERIOD_S = 1.0
CHANGES = "changes of the verdict"
"""Key of the number of changes in a status. The log shows the first change and counts those that it leaves out."""
REASON_CODE = "reason code"
"""Key of the code of the reason in a status; reasons with the same remedy are one kind of problem."""
REMEDY = "; remedy: "
"""Separates the message of a status from its remedy, which the status line leaves out."""
_STATUS_WIDTH = 80
_MIN_INTERVAL_S = 1.0
_MAX_EVENTS = 10
"""Events logged per second."""
_NUMBER = re.compile(r"\d+(\.\d+)?")


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


@dataclass(slots=True)
class _Logged:
    """Last logged state of one status; it starts as OK, so that an initial OK is not logged."""

    time_s: float
    key: tuple[bytes, str] = (DiagnosticStatus.OK, "")
    changes: int = 0


class NodeLog:
    """Logs changes of the statuses of `node` and its events, in any thread, at a bounded rate."""

    def __init__(self, node: Node) -> None:
        """Log with the logger of `node`."""
        self._logger = node.get_logger()
        self._logged: dict[str, _Logged] = {}
        self._events = self._left_out = 0
        self._second = 0

    def update(self, statuses: Iterable[DiagnosticStatus]) -> None:
        """Log each status whose level or kind of problem changed: at most one line per second, a worse verdict at once.

        Their names are those on /diagnostics, "/node: name".
        """
        now_s = time.monotonic()
        lines: dict[tuple[bytes, str], list[str]] = {}
        for status in statuses:
            logged = self._logged.setdefault(status.name, _Logged(now_s))
            is_ok = status.level == DiagnosticStatus.OK
            numbers = {pair.key: int(pair.value) for pair in status.values if pair.key in {CHANGES, REASON_CODE}}
            advice, changes = remedy(Reason(numbers.get(REASON_CODE, 0))), numbers.get(CHANGES, 0)
            key = (status.level, "" if is_ok else advice or _NUMBER.sub("", status.message))
            new_changes, waited = changes - logged.changes, now_s - logged.time_s >= _MIN_INTERVAL_S
            if key == logged.key and not new_changes:
                continue
            if waited or (new_changes and (logged.changes == 0 or status.level > logged.key[0])):
                count = f" ({new_changes} changes of the verdict since the last line)" if new_changes > 1 else ""
                lines.setdefault((status.level, f"{status.message}{count}"), []).append(_short(status.name))
                self._logged[status.name] = _Logged(now_s, key, changes)
        for (level, text), names in lines.items():
            self._log(level, f"{', '.join(names)}: {text}")
        self._begin_second()

    def status_line(self, statuses: Iterable[DiagnosticStatus]) -> None:
        """Log the messages of all `statuses` in one line."""
        texts: dict[str, list[str]] = {}
        for status in statuses:
            text = shorten(status.message.partition(REMEDY)[0], _STATUS_WIDTH, placeholder=" ...")
            texts.setdefault(text, []).append(_short(status.name))
        self._logger.info("; ".join(f"{', '.join(names)}: {text}" for text, names in texts.items()))

    def event(self, text: str, level: bytes = DiagnosticStatus.OK) -> None:
        """Log an event, unless this second already had ten, which are counted."""
        self._begin_second()
        self._events += 1
        if self._events <= _MAX_EVENTS:
            self._log(level, text)
        else:
            self._left_out += 1

    def _begin_second(self) -> None:
        """Log how many events were left out in an earlier second."""
        if self._second != (second := int(time.monotonic())):
            left_out, self._second, self._events, self._left_out = self._left_out, second, 0, 0
            if left_out:
                self._log(DiagnosticStatus.WARN, f"{left_out} more events were left out")

    def _log(self, level: bytes, text: str) -> None:
        # rclpy allows one severity per line of code.
        if level == DiagnosticStatus.OK:
            self._logger.info(text)
        elif level == DiagnosticStatus.WARN:
            self._logger.warning(text)
        else:
            self._logger.error(text)


def _short(name: str) -> str:
    """Return the name of a status without that of its node, which the log states."""
    return name.partition(": ")[2]
