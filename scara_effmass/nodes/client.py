# SPDX-License-Identifier: Apache-2.0
"""Client of ROS topics: a plain node with its own context and executor, which handles events only while it spins."""

import signal
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from types import FrameType
from typing import Any

from rclpy import event_handler
from rclpy.context import Context
from rclpy.exceptions import InvalidHandle, ParameterException
from rclpy.executors import Executor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from typing_extensions import Self

from scara_effmass.errors import SettingsError
from scara_effmass.nodes.process import END_SIGNALS, catch, start_ros

_SPIN_SLICE_S = 0.1
_SPIN_LIMIT_S = 1e9


@contextmanager
def ignoring_late_events() -> Iterator[None]:
    """Ignore an event of an entity that a callback has destroyed; the spin ends with it, so spin again.

    The EventsExecutor of rclpy 7.1 takes such an event, which raises InvalidHandle.
    """
    try:
        yield
    except InvalidHandle as error:
        if traceback.extract_tb(error.__traceback__)[-1].filename != event_handler.__file__:
            raise


def spin_for(executor: Executor, seconds: float, done: Callable[[], bool] = bool) -> None:
    """Handle events for `seconds` or until `done`, which is called after each event.

    EventsExecutor applies its timeout to each wait for an event, so spinning it under constant load has no end in
    rclpy 7.1. It does not notice signals; Python handles them between two slices.
    """
    end_ns = time.monotonic_ns() + round(min(seconds, _SPIN_LIMIT_S) * 1e9)
    while not done() and (left_ns := end_ns - time.monotonic_ns()) > 0:
        with ignoring_late_events():
            executor.spin_once(timeout_sec=min(left_ns / 1e9, _SPIN_SLICE_S))


class ClientNode:
    """Plain node with its own ROS context and executor, all in the calling thread. Use it in a `with`.

    In the main thread, END_SIGNALS are collected in `signals` and not handled: the executor would log an
    exception that a handler raises in a callback. The node has no services and no log topic.
    """

    def __init__(self, name: str, arguments: Sequence[str] = ()) -> None:
        """Create the node. Raises SettingsError for invalid ROS `arguments`."""
        self.signals: list[int] = []
        self.handlers: dict[int, Any] = {}
        """Handlers of the signals outside the `with`."""
        with ExitStack() as stack:
            if threading.current_thread() is threading.main_thread():
                for number in END_SIGNALS:
                    self.handlers[number] = catch(number, self._on_signal)
                    stack.callback(signal.signal, number, self.handlers[number])
            self.context = Context()
            stack.callback(self.context.try_shutdown)
            start_ros(arguments, self.context)
            try:
                self.node = Node(name, context=self.context, start_parameter_services=False, enable_rosout=False)
            except ParameterException as error:
                raise SettingsError(f"{name}: {error}") from None
            stack.callback(self.node.destroy_node)
            self.executor = EventsExecutor(context=self.context)
            self.executor.add_node(self.node)
            stack.callback(self.executor.shutdown)
            self._stack = stack.pop_all()

    @property
    def now_ns(self) -> int:
        """Time on the node's clock [ns], 0 before the first /clock in simulated time."""
        return int(self.node.get_clock().now().nanoseconds)

    def spin_for(self, seconds: float, done: Callable[[], bool] = bool) -> None:
        """Handle events for `seconds`, until `done` or until a signal arrives."""
        spin_for(self.executor, seconds, lambda: bool(self.signals) or done())

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _on_signal(self, number: int, _frame: FrameType | None) -> None:
        self.signals.append(number)
