"""The node of a replay: made, connected, spun and ended, without touching the rest of the process."""

from __future__ import annotations

import signal
import threading
import time
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any, final

import rclpy
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions, get_current_signal_handlers_options

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator
    from types import FrameType, TracebackType

    from scara_effmass.nodes.replay_publisher import ReplayPublisher

_SLICE_NS = 100_000_000
"""Longest stay inside the executor, which does not notice signals; Python acts on them between two stays."""
SETTLE_NS = 300_000_000
"""DDS tells when a publisher knows a reader, not when that reader knows the publisher, and best-effort readers
confirm nothing: both get this long."""
LONGEST_SETTLE_NS = 3_000_000_000
_ACKNOWLEDGED_NS = 10_000_000_000


def settling_time_ns(discovery_ns: int) -> int:
    """Return how long to wait for nodes that do not report their readiness, after a discovery that took so long."""
    return min(max(SETTLE_NS, discovery_ns), LONGEST_SETTLE_NS)


@final
class ReplayNode:
    """A node with its own ROS context and executor; all of it runs in the calling thread."""

    def __init__(self) -> None:
        """Make the node; the stage is to be used in a `with`, which ends it."""
        self._kept = ExitStack()
        context = Context()
        rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
        self._kept.callback(context.try_shutdown)
        # Its topics are those of the recording: no services, no log topic beside them.
        self.node = Node("replay", context=context, start_parameter_services=False, enable_rosout=False)
        self._kept.callback(self.node.destroy_node)
        self._executor = EventsExecutor(context=context)
        self._executor.add_node(self.node)
        self._kept.callback(self._executor.shutdown)

    def spin_until(self, deadline_ns: int, done: Callable[[], bool] = bool) -> None:
        """Handle events until `done`, or until the monotonic clock shows `deadline_ns`."""
        while not done():
            left_ns = deadline_ns - time.monotonic_ns()
            if left_ns <= 0:
                return
            self._executor.spin_once(timeout_sec=min(left_ns, _SLICE_NS) / 1e9)

    def settle(self) -> None:
        """Give best-effort subscribers, which confirm nothing, time to receive the last messages."""
        self.spin_until(time.monotonic_ns() + SETTLE_NS)

    def wait_acknowledged(self, outlets: Collection[ReplayPublisher]) -> list[str]:
        """Wait until all reliable readers have everything; return the topics of which some have not after 10 s.

        Fast DDS asks its readers every 3 s, so this may take that long.
        """
        deadline_ns = time.monotonic_ns() + _ACKNOWLEDGED_NS
        waiting = list(outlets)
        while waiting and time.monotonic_ns() < deadline_ns:
            if waiting[0].publisher.wait_for_all_acked(Duration(nanoseconds=_SLICE_NS)):
                del waiting[0]
        return [outlet.name for outlet in waiting]

    def __enter__(self) -> ReplayNode:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._kept.close()


@final
class Interruption:
    """SIGINT and SIGTERM, as a KeyboardInterrupt where that is convenient: once, and inside `allowed` only.

    It stays out of the way in other threads than the main one, and where rclpy handles the signals of the process.
    """

    def __init__(self) -> None:
        self._asked = False
        self._allowed = False
        self._before: dict[signal.Signals, Any] = {}
        in_main_thread = threading.current_thread() is threading.main_thread()
        if in_main_thread and get_current_signal_handlers_options() == SignalHandlerOptions.NO:
            self._before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    @contextmanager
    def allowed(self) -> Iterator[None]:
        """Let a signal, also one that came before, raise KeyboardInterrupt in this `with`."""
        self._allowed = True
        try:
            if self._asked:
                raise KeyboardInterrupt
            yield
        finally:
            self._allowed = False

    def __enter__(self) -> Interruption:
        for number in self._before:
            signal.signal(number, self._on_signal)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        self._asked = True
        if self._allowed:
            # A launcher sends SIGINT twice: the second one must not break into the clean-up.
            self._allowed = False
            raise KeyboardInterrupt
