"""A subscriber to what the monitor publishes, in a ROS context of its own."""

from __future__ import annotations

import signal
import time
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, final

import rclpy
from rclpy.context import Context
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from scara_effmass_msgs.msg import ContactState, ImpactValidation
from std_msgs.msg import Float64

from scara_effmass.nodes.lifecycle import spin_for
from scara_effmass.nodes.qos import qos_profile
from scara_effmass.wire import topics
from scara_effmass.wire.contact_state import contact_from

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from types import FrameType, TracebackType

    from rclpy.event_handler import QoSSubscriptionMatchedInfo

    from scara_effmass.values import ContactAssessment

    OnCycle = Callable[[tuple[ContactAssessment, ...], int], None]

_SLICE_S = 0.05
"""Longest stay inside the executor; signals are acted upon between two stays."""
_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_TOPICS = 3


@final
class MonitorClient:
    """Hands on the monitor's cycles, one per joint state; to be used in a `with`, in the main thread.

    Counts `cycles`, `silences` (UNKNOWNs of the watchdog, which answer no joint state), and keeps the last
    `allowable_speed` [m/s] and `speed_scaling` [0-1].
    """

    def __init__(
        self,
        contact_points: Sequence[str],
        on_cycle: OnCycle,
        on_validation: Callable[[ImpactValidation], None] | None = None,
    ) -> None:
        """Call `on_cycle(contacts, at_ns)` per joint state, `at_ns` being the node's clock when it was assessed.

        `on_validation` is called with what a validator publishes.
        """
        self.cycles = 0
        self.silences = 0
        self.allowable_speed = 0.0
        self.speed_scaling = 0.0
        self._last_point = contact_points[-1]
        self._on_cycle = on_cycle
        self._pending: list[ContactAssessment] = []
        self._matched: set[str] = set()
        self._handlers: dict[int, Any] = {}
        self._signalled: list[int] = []
        self._kept = ExitStack()
        context = Context()
        # Python's own handlers stay: an interrupt shall end the whole command, not the context alone.
        rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
        self._kept.callback(context.try_shutdown)
        # On the time of the replay, or of the bench, as the monitor is.
        node = Node(
            "watch",
            context=context,
            start_parameter_services=False,
            enable_rosout=False,
            parameter_overrides=[Parameter("use_sim_time", value=True)],
        )
        self._node = node
        self._clock = node.get_clock()
        self._kept.callback(node.destroy_node)
        for kind, topic, callback in (
            (ContactState, topics.CONTACT_STATE, self._on_contact_state),
            (Float64, topics.ALLOWABLE_SPEED, self._on_allowable_speed),
            (Float64, topics.SPEED_SCALING, self._on_speed_scaling),
        ):
            events = SubscriptionEventCallbacks(matched=self._on_matched(topic))
            node.create_subscription(kind, topic, callback, qos_profile(topics.CLIENT_QOS), event_callbacks=events)
        if on_validation is not None:
            node.create_subscription(
                ImpactValidation, topics.IMPACT_VALIDATION, on_validation, qos_profile(topics.CLIENT_QOS)
            )
        self._executor = EventsExecutor(context=context)
        self._executor.add_node(node)
        self._kept.callback(self._executor.shutdown)

    @property
    def connected(self) -> bool:
        """Whether a monitor publishes on every topic."""
        return len(self._matched) == _TOPICS

    def has_ends(self, topic: str, publishers: int, subscribers: int) -> bool:
        """Whether at least so many publish on `topic` and subscribe to it, this one included."""
        node = self._node
        return node.count_publishers(topic) >= publishers and node.count_subscribers(topic) >= subscribers

    @property
    def now_ns(self) -> int:
        """The time on /clock; 0 before it has begun."""
        return int(self._clock.now().nanoseconds)

    def spin(self, seconds: float, done: Callable[[], bool] = bool) -> bool:
        """Receive for `seconds` or until `done`; return whether it is.

        SIGINT and SIGTERM take effect here, as they did before the `with`.
        """
        deadline = time.monotonic() + seconds
        while not (finished := done()) and (left := deadline - time.monotonic()) > 0.0:
            spin_for(self._executor, min(left, _SLICE_S))
            self._act_on_signals()
        return finished

    def __enter__(self) -> MonitorClient:
        # An exception out of a callback is logged by the executor as a fault of the node: signals wait for its end.
        self._handlers = {number: signal.signal(number, self._note_signal) for number in _SIGNALS}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        self._kept.close()
        self._act_on_signals()

    def _note_signal(self, number: int, _frame: FrameType | None) -> None:
        self._signalled.append(number)

    def _act_on_signals(self) -> None:
        if self._signalled:
            number = self._signalled[0]
            self._signalled.clear()
            handler = self._handlers[number]
            if callable(handler):
                handler(number, None)
            elif handler is signal.SIG_DFL:
                signal.signal(number, handler)
                signal.raise_signal(number)

    def _on_matched(self, topic: str) -> Callable[[QoSSubscriptionMatchedInfo], None]:
        def note(info: QoSSubscriptionMatchedInfo) -> None:
            (self._matched.add if info.current_count else self._matched.discard)(topic)

        return note

    def _on_contact_state(self, message: ContactState) -> None:
        contact = contact_from(message)
        if contact.watchdog:
            self.silences += contact.contact_point == self._last_point
            return
        pending = self._pending
        if pending and pending[0].stamp_ns != contact.stamp_ns:
            self._hand_on()
        pending.append(contact)
        if contact.contact_point == self._last_point:
            self._hand_on()

    def _hand_on(self) -> None:
        contacts = tuple(self._pending)
        self._pending.clear()
        self.cycles += 1
        first = contacts[0]
        # The age tells the monitor's clock exactly; a joint state without a stamp has none.
        told_ns = first.stamp_ns + round(first.input_age * 1e9) if first.stamp_ns else self._clock.now().nanoseconds
        self._on_cycle(contacts, told_ns)

    def _on_allowable_speed(self, message: Float64) -> None:
        self.allowable_speed = message.data

    def _on_speed_scaling(self, message: Float64) -> None:
        self.speed_scaling = message.data
