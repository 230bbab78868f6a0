# SPDX-License-Identifier: Apache-2.0
"""Client of the monitor's topics, with its own ROS context."""

import signal
from collections import deque
from collections.abc import Callable, Sequence
from typing import final

from rclpy.event_handler import QoSSubscriptionMatchedInfo, SubscriptionEventCallbacks
from rclpy.parameter import Parameter
from scara_effmass_msgs.msg import ContactState, ImpactValidation
from std_msgs.msg import Float64

from scara_effmass.nodes.client import ClientNode
from scara_effmass.nodes.qos import qos_profile
from scara_effmass.values import ContactAssessment
from scara_effmass.wire import topics
from scara_effmass.wire.contact_state import contact_from

OnCycle = Callable[[tuple[ContactAssessment, ...], int], None]

_TOPICS = 3


@final
class MonitorClient(ClientNode):
    """Collects the contact states of each joint state, a cycle. Use it in a `with`, in the main thread.

    Counts `cycles` and `watchdog_decisions` (which answer no joint state) and keeps the latest
    `allowable_speed` [m/s] and `speed_scaling` [0-1]. A joint state of which a message was lost is no cycle.
    """

    def __init__(
        self,
        contact_points: Sequence[str],
        on_cycle: OnCycle,
        on_validation: Callable[[ImpactValidation], None] | None = None,
        on_watchdog: Callable[[tuple[ContactAssessment, ...]], None] = lambda _: None,
    ) -> None:
        """Call `on_cycle(contacts, time_ns)` per joint state, with the monitor's clock at its assessment.

        `contacts` are those of `contact_points`, in that order. `on_watchdog` gets those that answer no joint state,
        `on_validation` every message of a validator.
        """
        self.cycles = 0
        self.watchdog_decisions = 0
        self.allowable_speed = 0.0
        self.speed_scaling = 0.0
        self._points = list(contact_points)
        self._on_cycle, self._on_watchdog = on_cycle, on_watchdog
        self._latest: deque[ContactAssessment] = deque(maxlen=len(self._points))
        self._matched: set[str] = set()
        super().__init__("monitor_client", [Parameter("use_sim_time", value=True)])
        node = self.node
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

    @property
    def connected(self) -> bool:
        """Whether every topic of the monitor has a publisher."""
        return len(self._matched) == _TOPICS

    def has_peers(self, topic: str, publishers: int, subscribers: int) -> bool:
        """Return whether `topic` has at least so many publishers and subscribers, this client included."""
        node = self.node
        return node.count_publishers(topic) >= publishers and node.count_subscribers(topic) >= subscribers

    def spin(self, seconds: float, done: Callable[[], bool] = bool) -> bool:
        """Receive for `seconds` or until `done`; return the result of `done`.

        The handlers of SIGINT and SIGTERM from before the `with` are called here or at its end.
        """
        self.spin_for(seconds, done)
        for number in self.signals[:1]:
            self.signals.clear()
            deferring = signal.signal(number, self.handlers[number])
            try:
                signal.raise_signal(number)
            finally:
                signal.signal(number, deferring)
        return done()

    def __exit__(self, *_: object) -> None:
        super().__exit__()
        for number in self.signals[:1]:
            signal.raise_signal(number)

    def _on_matched(self, topic: str) -> Callable[[QoSSubscriptionMatchedInfo], None]:
        def on_matched(info: QoSSubscriptionMatchedInfo) -> None:
            (self._matched.add if info.current_count else self._matched.discard)(topic)

        return on_matched

    def _on_contact_state(self, message: ContactState) -> None:
        self._latest.append(contact_from(message))
        contacts = tuple(self._latest)
        decisions = {(contact.stamp_ns, contact.watchdog) for contact in contacts}
        if [contact.contact_point for contact in contacts] != self._points or len(decisions) > 1:
            return
        first = contacts[0]
        if first.watchdog:
            self.watchdog_decisions += 1
            self._on_watchdog(contacts)
            return
        self.cycles += 1
        # Stamp plus age is exactly the monitor's clock; a joint state without a stamp has no age.
        time_ns = first.stamp_ns + round(first.input_age * 1e9) if first.stamp_ns else self.now_ns
        self._on_cycle(contacts, time_ns)

    def _on_allowable_speed(self, message: Float64) -> None:
        self.allowable_speed = message.data

    def _on_speed_scaling(self, message: Float64) -> None:
        self.speed_scaling = message.data
