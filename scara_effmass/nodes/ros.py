# SPDX-License-Identifier: Apache-2.0
"""What a process with ROS has: start, signals, priority, QoS, a plain node, spinning, and messages that wait."""

import ctypes
import math
import os
import re
import resource
import signal
import threading
import time
import traceback
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import wraps
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

import rclpy
from rclpy import event_handler
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.exceptions import InvalidHandle, ParameterException
from rclpy.executors import Executor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from typing_extensions import Self

from scara_effmass.errors import SettingsError
from scara_effmass.wire.topics import Qos

END_SIGNALS = (
    *(signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT),
    *(signal.SIGUSR1, signal.SIGUSR2, signal.SIGXCPU),
)
"""Those of terminals, service managers and operators that would end the process at once: all but faults and SIGKILL."""
_MAX_DOMAIN = 232
"""Above it, the UDP ports of DDS exceed 65535."""
_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
"""Flags of mlockall(2). Without the last one each thread would lock its whole stack of 8 MB."""
_SPIN_SLICE_S = 0.1
_SPIN_LIMIT_S = 1e9
Message = TypeVar("Message")
_MAX_WAIT = 0.5
"""Share of the timeout that a message may wait; later, only the newest ones are taken."""


def catch(number: int, handler: Callable[[int, FrameType | None], Any]) -> Any:  # noqa: ANN401 - as signal.signal
    """Call `handler` at the signal `number` and return the handler before; leave SIGHUP ignored, as nohup does."""
    before = signal.getsignal(number)
    if number == signal.SIGHUP and before == signal.SIG_IGN:
        return before
    return signal.signal(number, handler)


def one_line(error: Exception) -> str:
    """Return the text of an error of ROS in one line, without the place in its sources."""
    return " ".join(str(error).split()).partition(", at /")[0].removesuffix(" ^")


def start_ros(arguments: Sequence[str], context: Context | None = None) -> None:
    """Initialise ROS, without its handlers of signals. Raises SettingsError."""
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not re.fullmatch("0*[0-9]{1,3}", domain) or int(domain) > _MAX_DOMAIN:
        raise SettingsError(f"ROS_DOMAIN_ID = {domain!r}: must be a whole number from 0 to {_MAX_DOMAIN}")
    try:
        rclpy.init(args=list(arguments), context=context, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        raise start_refusal(error) from None


def start_refusal(error: RuntimeError) -> SettingsError:
    """Return why ROS does not start: its arguments, or no folder for its log."""
    text = one_line(error)
    subject, remedy = "ROS arguments", ""
    if "initialize logging" in text:
        subject, remedy = "ROS_LOG_DIR", ": must be a folder that can be written; without it, ~/.ros/log must be one"
    return SettingsError(f"{subject}: {text.removesuffix(' >>>').removesuffix(' <<<')}{remedy}")


def use_realtime(priority: int) -> str:
    """Run all threads of this process under SCHED_FIFO at `priority` (1-99), later ones too, and lock its memory.

    Return why part of it is refused, or "".
    """
    refused = []
    try:
        for thread in Path("/proc/self/task").iterdir():
            os.sched_setscheduler(int(thread.name), os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError:
        refused.append(f"SCHED_FIFO needs rtprio {priority}")
    _, limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (limit, limit))
    if ctypes.CDLL(None).mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT):
        refused.append("locked memory needs memlock unlimited")
    return f"{', '.join(refused)} in /etc/security/limits.conf" if refused else ""


def qos_profile(qos: Qos) -> QoSProfile:
    """Return a new profile, which rclpy may modify when a parameter overrides it."""
    durations = {
        "deadline": qos.deadline_s,
        "lifespan": qos.lifespan_s,
        "liveliness_lease_duration": qos.lease_s,
    }
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=qos.depth,
        reliability=ReliabilityPolicy.RELIABLE if qos.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if qos.latched else DurabilityPolicy.VOLATILE,
        **{policy: Duration(seconds=seconds) for policy, seconds in durations.items() if seconds < math.inf},
    )


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


def with_info(callback: Callable[[bytes, dict[str, Any]], None]) -> Callable[..., None]:
    """Return `callback` for any executor: the EventsExecutor of rclpy 7.1 passes message and info as one tuple."""

    @wraps(callback)
    def receive(*received: Any) -> None:  # noqa: ANN401
        callback(*(received if len(received) > 1 else received[0]))

    return receive


def received_ns(info: Mapping[str, Any]) -> int:
    """Return when the middleware received a message [ns]; now, where it does not say so, as some do by a 0."""
    return int(info["received_timestamp"]) or time.time_ns()


def is_late(info: Mapping[str, Any], age_ns: float, timeout_s: float) -> bool:
    """Return whether a message with a state of this age has waited too long to be worth its turn."""
    return time.time_ns() - received_ns(info) > _MAX_WAIT * timeout_s * 1e9 or age_ns > timeout_s * 1e9


def newest_waiting(
    first: Message, take: Callable[[], Message | None], key: Callable[[Message], Hashable], limit: int
) -> tuple[list[Message], int]:
    """Return the newest message of each `key` in the order of arrival, and how many older ones were skipped.

    `take` gives the next message that waits behind `first`, None without one; at most `limit` are taken.
    """
    newest = {key(first): first}
    count = 1
    while count <= limit and (message := take()) is not None:
        newest.pop(key(message), None)  # keeps the order of arrival
        newest[key(message)] = message
        count += 1
    return list(newest.values()), count - len(newest)


class SequenceGaps:
    """Counts what is missing between the messages of one topic, by their sequence numbers.

    The middleware also has an event for them, but no node may take it: `rcl_take_event` holds Python's lock and waits
    for a lock of the middleware, whose thread may hold that one and wait for Python's
    (https://github.com/ros2/rmw_fastrtps/pull/890). Under load the process then stands still for ever.

    Each publisher numbers its messages from 1, but a message does not name its publisher. With several, a message that
    continues none of them is assigned to the one with the closest number, so their count is approximate. A publisher
    that starts again, with smaller numbers, loses nothing.
    """

    def __init__(self, count_publishers: Callable[[], int]) -> None:
        """`count_publishers` returns how many publishers the topic has; it is called only where a number is missing."""
        self._count_publishers = count_publishers
        self._last: list[int] = []
        """Last number of each publisher, the one that sent last at the end."""

    def lost_before(self, number: int | None) -> int:
        """Return how many messages are missing before the message with this number, None if it has none."""
        if number is None:
            return 0
        last, lost = self._last, 0
        closest = max((value for value in last if value < number), default=None)
        # Otherwise it is the first message of another publisher.
        if closest == number - 1 or len(last) >= max(self._count_publishers(), 1):
            before = last[0] if closest is None else closest
            last.remove(before)
            lost = max(number - before - 1, 0)
        last.append(number)
        return lost
