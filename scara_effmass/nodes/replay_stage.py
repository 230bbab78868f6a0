"""The node of a replay: made, connected, spun and ended, without touching the rest of the process."""

from __future__ import annotations

import signal
import threading
import time
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, final

import rclpy
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions, get_current_signal_handlers_options

if TYPE_CHECKING:
    from collections.abc import Callable, Collection
    from types import FrameType, TracebackType

    from scara_effmass.nodes.replay_outlets import Outlet

_SLICE_NS = 100_000_000
"""Longest stay inside the executor, which does not notice signals; Python acts on them between two stays."""
SETTLE_NS = 300_000_000
"""DDS tells when a publisher knows a reader, not when that reader knows the publisher, and best-effort readers
confirm nothing: both get this long."""
_ACKNOWLEDGED_NS = 10_000_000_000


@final
class Stage:
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
        """Give the other side the time that no event tells."""
        self.spin_until(time.monotonic_ns() + SETTLE_NS)

    def wait_acknowledged(self, outlets: Collection[Outlet]) -> list[str]:
        """Wait until all reliable readers have everything; return the topics of which some have not after 10 s."""
        deadline_ns = time.monotonic_ns() + _ACKNOWLEDGED_NS
        waiting = list(outlets)
        while waiting and time.monotonic_ns() < deadline_ns:
            if waiting[0].publisher.wait_for_all_acked(Duration(nanoseconds=_SLICE_NS)):
                del waiting[0]
        return [outlet.name for outlet in waiting]

    def __enter__(self) -> Stage:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._kept.close()


@final
class Interruptible:
    """Turns SIGTERM into the KeyboardInterrupt that SIGINT is, and lets neither break into the end of the `with`.

    It stays out of the way in other threads than the main one, and where rclpy handles the signals of the process.
    """

    def __init__(self) -> None:
        """Note what handles the signals now."""
        self._before: dict[signal.Signals, Any] = {}
        if threading.current_thread() is not threading.main_thread():
            return
        if get_current_signal_handlers_options() == SignalHandlerOptions.NO:
            self._before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def __enter__(self) -> Interruptible:
        for number in self._before:
            signal.signal(number, _interrupt)
        return self

    def ending(self) -> None:
        """From now on ignore them: a launcher sends SIGINT twice."""
        for number in self._before:
            signal.signal(number, signal.SIG_IGN)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt
