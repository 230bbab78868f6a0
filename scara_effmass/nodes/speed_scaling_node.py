# SPDX-License-Identifier: Apache-2.0
"""`speed_scaling_node`: slow a trajectory controller down to the allowable speed, and stop it without a valid verdict.

It runs in a process of its own: when the monitor ends, it still sends 0. A second one with `standby` sends 0 when the
first one is silent.
"""

import math
import threading
import time
from functools import partial
from typing import Any

from control_msgs.msg import SpeedScalingFactor
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.duration import Duration
from rclpy.event_handler import QoSLivelinessChangedInfo
from scara_effmass_msgs.msg import ContactStates

from scara_effmass.cell.speed_scaling import SpeedScaler
from scara_effmass.codes import Reason
from scara_effmass.errors import DecodeError
from scara_effmass.nodes.diagnostics import Diagnostics, status
from scara_effmass.nodes.lifecycle import LifecycleBase, run
from scara_effmass.nodes.parameters import NodeParameters
from scara_effmass.nodes.ros import is_late, newest_waiting, with_info
from scara_effmass.safety.reasons import plain_text
from scara_effmass.settings.loading import fixed
from scara_effmass.wire import topics
from scara_effmass.wire.cdr import header_stamp_ns
from scara_effmass.wire.contact_states import decode_contact_states

_ACK_TIMEOUT = Duration(seconds=0.5)
_STANDBY_FACTOR = -0.0
"""A zero by which the node on standby tells its own messages from those of the other one."""


class NodeSettings(NodeParameters):
    """Parameters of `speed_scaling_node`."""

    timeout: float = fixed(
        0.2, "`timeout` of the monitor; states older than it, and silence of twice as long, give 0 [s]", gt=0.0, le=60.0
    )
    latency: float = fixed(
        0.03, "longest time from sending a factor to its effect on the joint states [s]", ge=0.0, le=10.0
    )
    speed_ratio: float = fixed(0.95, "share of the allowable speed to use", gt=0.0, le=1.0)
    rise_rate: float = fixed(1.0, "largest increase of the factor [1/s]; it falls at once", gt=0.0, le=100.0)
    rate: float = fixed(50.0, "heartbeat: messages per second, besides those that lower the factor", ge=1.0, le=1000.0)
    standby: bool = fixed(
        default=False, description="send nothing but 0, and only while no other node has sent a factor for `timeout`"
    )


class SpeedScalingNode(LifecycleBase[NodeSettings]):
    """Subscribes to `contact_states`; publishes `joint_trajectory_controller/speed_scaling_input`, `/diagnostics`."""

    def __init__(self) -> None:
        """Declare the parameters. Raises SettingsError for an invalid one."""
        super().__init__("speed_scaling", NodeSettings)
        self._lock = threading.Lock()
        """Held while the factor is changed and published."""
        self._publishing = False

    def configure(self) -> None:
        """Create the endpoints."""
        settings = self.settings
        self._factor, self._reason = 0.0, ""
        self._stops, self._unreported = 0, ""
        """Number of stops, and the reason of one since the last report."""
        self._last_number = self._refused_until_ns = self._lost = self._skipped = 0
        qos = topics.Qos(1, latched=True, deadline_s=2.0 / settings.rate)
        self._publisher = self.create_owned_publisher(SpeedScalingFactor, topics.SPEED_SCALING_INPUT, qos)
        if settings.standby:
            self.create_owned_subscription(
                SpeedScalingFactor, topics.SPEED_SCALING_INPUT, self._on_factor, topics.Qos(10)
            )
        else:
            self._subscribe_to_contact_states()
        self._diagnostics = Diagnostics(self, self._statuses)
        self.create_steady_timer(1.0 / settings.rate, self._publish)

    def _subscribe_to_contact_states(self) -> None:
        self._contact_states = self.create_owned_subscription(
            ContactStates,
            topics.CONTACT_STATES,
            with_info(self._on_contact_states),
            topics.verdict_qos(self.settings.timeout),
            raw=True,
            deadline=lambda _: self._stop("deadline of contact_states missed"),
            liveliness=self._on_liveliness,
        )

    def activate(self) -> None:
        """Start at 0."""
        settings = self.settings
        self._scaler = SpeedScaler(round(settings.timeout * 1e9), time.monotonic_ns())
        self._scaler.latency_ns = round(settings.latency * 1e9)
        self._scaler.rise_rate, self._scaler.speed_ratio = settings.rise_rate, settings.speed_ratio
        self._heard_ns = time.monotonic_ns()
        self._publishing = True

    def deactivate(self) -> None:
        """Publish a last 0."""
        self.publish_last(Reason.STATED, "the node was deactivated")

    def publish_last(self, reason: Reason, detail: str = "") -> None:
        """Publish 0, wait until subscribers have it, and publish nothing after it."""
        with self._lock:
            if not self._publishing or not self.context.ok():
                return
            if not self.settings.standby:  # whose end must not stop the robot
                self._scaler.stop(plain_text(reason, detail=detail))
                self._send()
            self._publishing = False
        self._publisher.wait_for_all_acked(_ACK_TIMEOUT)

    def _on_contact_states(self, data: bytes, info: dict[str, Any]) -> None:
        """Take the contact states, or where they come late the newest that wait behind them.

        Else no timer would get a turn on a busy machine.
        """
        skipped = 0
        if is_late(info, self.now_ns() - header_stamp_ns(data), self.settings.timeout):
            waiting = self._contact_states
            take = partial(waiting.handle.take_message, waiting.msg_type, waiting.raw)
            ((data, _),), skipped = newest_waiting((data, info), take, lambda _: None, topics.STREAM_QOS.depth)
            self._skipped += skipped
        try:
            decision = decode_contact_states(data)
        except DecodeError as error:
            self._stop(str(error))
            return
        now_ns, number = time.monotonic_ns(), decision.sequence_number
        if number <= self._last_number:  # those of one monitor increase
            self._refused_until_ns = now_ns + round(2e9 * self.settings.timeout)
            self._stop("a second monitor publishes contact_states, or a new one")
        elif self._last_number and now_ns >= self._refused_until_ns:
            self._lost += max(0, number - self._last_number - 1 - skipped)
        self._last_number = number
        with self._lock:
            if not self._publishing or now_ns < self._refused_until_ns:
                return
            if self._scaler.take(decision, now_ns, self.now_ns() - decision.stamp_ns):
                self._send()

    def _on_liveliness(self, event: QoSLivelinessChangedInfo) -> None:
        if event.alive_count == 0:
            self._stop("liveliness of the monitor lost")

    def _stop(self, reason: str) -> None:
        """Publish 0."""
        with self._lock:
            if self._publishing:
                self._scaler.stop(reason)
                self._send()

    def _on_factor(self, message: SpeedScalingFactor) -> None:
        if math.copysign(1.0, message.factor) != math.copysign(1.0, _STANDBY_FACTOR):
            self._heard_ns = time.monotonic_ns()

    def _publish(self) -> None:
        with self._lock:
            if self._publishing and self.settings.standby:
                self._stand_in()
            elif self._publishing:
                self._send()

    def _stand_in(self) -> None:
        """Send 0 while no other node sends a factor."""
        silence_ns = time.monotonic_ns() - self._heard_ns
        is_silent = silence_ns > 1e9 * self.settings.timeout
        if is_silent:
            self._publisher.publish(SpeedScalingFactor(factor=_STANDBY_FACTOR))
        self._note(f"no factor of another node for {silence_ns / 1e9:.1f} s" if is_silent else "")

    def _send(self) -> None:
        self._factor = self._scaler.factor(time.monotonic_ns())
        self._publisher.publish(SpeedScalingFactor(factor=self._factor))
        self._note(self._scaler.reason)

    def _note(self, reason: str) -> None:
        if reason and not self._reason:
            self._stops, self._unreported = self._stops + 1, reason
        self._reason = reason

    def _statuses(self) -> list[DiagnosticStatus]:
        with self._lock:
            reason, unreported, self._unreported = self._reason, self._unreported, ""
            disobedience = self._scaler.disobedience if self._publishing else ""
        controllers, senders = self._count_others()
        topic = self._publisher.topic_name
        problem = disobedience or (f"stopped: {reason}" if reason else "")
        if not problem and unreported:
            problem = f"was stopped for a moment: {unreported}"
        others = f"{senders} nodes send factors on {topic}: must be one, the controller obeys the last message"
        unheard = f"no controller subscribes to {topic}: remap it to that of the controller"
        problems = (problem, others if senders > 1 else "", "" if controllers else unheard)
        values = {
            "factor": self._factor,
            "controllers": controllers,
            "senders": senders,
            "stops": self._stops,
            "lost contact states": self._lost,
            "skipped contact states": self._skipped,
        }
        message = "standby" if self.settings.standby else "scaling"
        return [status("speed scaling", message, values, problem="; ".join(filter(None, problems)))]

    def _count_others(self) -> tuple[int, int]:
        """Return how many controllers subscribe to the factor, and how many nodes send it; one on standby does both."""
        topic = self._publisher.topic_name
        senders, subscribers = (
            [(info.node_namespace, info.node_name) for info in infos]
            for infos in (self.get_publishers_info_by_topic(topic), self.get_subscriptions_info_by_topic(topic))
        )
        return sum(name not in senders for name in subscribers), sum(name not in subscribers for name in senders)


main = partial(run, "speed_scaling", SpeedScalingNode)
