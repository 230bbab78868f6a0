"""Client of ROS topics: a plain node with its own context and executor, which handles events only when told to."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack

import rclpy
from rclpy.context import Context
from rclpy.executors import Executor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

_SPIN_SLICE_S = 0.1


def spin_for(executor: Executor, seconds: float, done: Callable[[], bool] = bool) -> None:
    """Handle events for `seconds` or until `done`, which is called after each event.

    EventsExecutor applies its timeout to each wait for an event, so spinning it under constant load has no end in
    rclpy 7.1. It does not notice signals; Python handles them between two slices.
    """
    end_ns = time.monotonic_ns() + round(seconds * 1e9)
    while not done() and (left_ns := end_ns - time.monotonic_ns()) > 0:
        executor.spin_once(timeout_sec=min(left_ns / 1e9, _SPIN_SLICE_S))


class ClientNode:
    """Plain node with its own ROS context and executor, all in the calling thread; call `close` at the end.

    It has no services and no log topic, and rclpy does not handle signals for it.
    """

    def __init__(self, name: str, parameters: list[Parameter] | None = None) -> None:
        """Create the node; `parameters` override its defaults."""
        self._stack = ExitStack()
        context = Context()
        rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
        self._stack.callback(context.try_shutdown)
        self.node = Node(
            name,
            context=context,
            start_parameter_services=False,
            enable_rosout=False,
            parameter_overrides=parameters,
        )
        self._stack.callback(self.node.destroy_node)
        self._executor = EventsExecutor(context=context)
        self._executor.add_node(self.node)
        self._stack.callback(self._executor.shutdown)

    def spin_for(self, seconds: float, done: Callable[[], bool] = bool) -> None:
        """Handle events for `seconds` or until `done`."""
        spin_for(self._executor, seconds, done)

    def close(self) -> None:
        """Destroy the node and its context."""
        self._stack.close()
