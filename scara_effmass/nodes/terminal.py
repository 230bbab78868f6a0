# SPDX-License-Identifier: Apache-2.0
"""Log of a node on its terminal and /rosout: changes of its statuses, events, and a status line."""

import re
import time
from collections.abc import Iterable
from dataclasses import dataclass
from textwrap import shorten

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node

from scara_effmass.codes import Reason
from scara_effmass.safety.remedies import remedy

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
