"""`monitor_node`: joint states in, verdicts out. It converts, calls `safety.Monitor` and publishes."""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import Field
from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos_overriding_options import QoSOverridingOptions
from scara_effmass_msgs.msg import ContactState
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger

from scara_effmass.errors import DecodeError, EffmassError, SettingsError
from scara_effmass.iso15066 import limits_for
from scara_effmass.model.dynamics import RobotDynamics
from scara_effmass.model.load import load_robot
from scara_effmass.model.urdf import parse_urdf
from scara_effmass.nodes import parameters
from scara_effmass.nodes.diagnostics import Diagnostics
from scara_effmass.nodes.lifecycle import LifecycleBase, incompatible, run
from scara_effmass.nodes.monitor_health import MonitorHealth
from scara_effmass.nodes.qos import qos_profile
from scara_effmass.safety import Monitor, no_robot_decision
from scara_effmass.settings import READ_ONLY, MonitorSettings, checked
from scara_effmass.wire import topics
from scara_effmass.wire.contact_state import ContactStateEncoder, float64_message
from scara_effmass.wire.joint_state import JointStateDecoder

if TYPE_CHECKING:
    from collections.abc import Sequence
    from collections.abc import Set as AbstractSet

    from diagnostic_msgs.msg import DiagnosticStatus
    from rclpy.clock import TimeJump
    from rclpy.event_handler import QoSMessageLostInfo, QoSSubscriptionMatchedInfo
    from rclpy.timer import Timer

    from scara_effmass.model.robot import Robot
    from scara_effmass.values import Decision, Verdict

Endpoint = TypeVar("Endpoint")

_NO_ROBOT = ContactStateEncoder("", "")
_LOOKS_PER_TIMEOUT = 4
_MOST_LOOKS_HZ = 1000.0
_REPORTS_APART_NS = 100_000_000


class NodeSettings(MonitorSettings):
    """The monitor's settings and the node's own."""

    autostart: bool = Field(default=True, description="configure and activate at start", json_schema_extra=READ_ONLY)


class MonitorNode(LifecycleBase):
    """Watches `joint_states`; publishes `contact_state`, `allowable_speed`, `speed_scaling`, `/diagnostics`."""

    def __init__(self) -> None:
        """Declare the parameters. Raises SettingsError for one that cannot be used."""
        super().__init__("monitor")
        self._settings = checked(NodeSettings, parameters.declare(self, NodeSettings), self.get_name())
        self.autostart = self._settings.autostart
        limits_for(self._settings)
        parameters.on_parameters_changed(self, lambda: self._settings, self._take, limits_for)
        self._outputs: dict[str, Any] = {}
        self._monitor: Monitor | None = None
        self._watchdog: Timer | None = None
        self._encoders: list[ContactStateEncoder] = []
        self._last_heard_ns = 0

    def set_up(self) -> None:
        """Load the robot and create the endpoints. Raises EffmassError."""
        self._kept.callback(self._forget)
        self._decoder = JointStateDecoder()
        self._health = MonitorHealth(self.get_name())
        self._decision: Decision | None = None
        self._shown: list[Verdict] = []
        self._reported_ns = 0
        self._waiting = ""
        if self._settings.await_robot_description:
            if self._settings.robot:
                robot = self._settings.robot
                raise SettingsError(f"{self.get_name()}: robot = {robot!r}: must be empty with await_robot_description")
            self._waiting = "no robot_description yet"
            self.own(
                self.create_subscription(
                    String,
                    topics.ROBOT_DESCRIPTION,
                    self._on_description,
                    qos_profile(topics.DESCRIPTION_QOS),
                    event_callbacks=SubscriptionEventCallbacks(
                        incompatible_qos=partial(
                            incompatible, "a publisher of robot_description", self._on_incompatible
                        )
                    ),
                ),
                self.destroy_subscription,
            )
        else:
            self._watch(load_robot(self._settings.robot_path, self._settings))
        for kind, topic in (
            (ContactState, topics.CONTACT_STATE),
            (Float64, topics.ALLOWABLE_SPEED),
            (Float64, topics.SPEED_SCALING),
        ):
            self._outputs[topic] = self.publisher(kind, topic, topics.STREAM_QOS, self._on_incompatible)
        self._diagnostics = Diagnostics(self, self._statuses)
        self._joint_states = self.own(
            self.create_subscription(
                JointState,
                topics.JOINT_STATES,
                self._on_joint_state,
                qos_profile(topics.JOINT_STATES_INPUT_QOS),
                raw=True,
                event_callbacks=SubscriptionEventCallbacks(
                    incompatible_qos=partial(incompatible, "a publisher of joint_states", self._on_incompatible),
                    matched=self._on_matched,
                    message_lost=self._on_lost,
                ),
                qos_overriding_options=QoSOverridingOptions.with_default_policies(),
            ),
            self.destroy_subscription,
        )
        self.own(self.create_service(Trigger, "~/reset", self._on_reset), self.destroy_service)
        self._watchdog = self.create_steady_timer(self._watchdog_period_s(), self._on_watchdog)
        backwards = JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=True)
        jump = self.get_clock().create_jump_callback(backwards, post_callback=self._on_clock_jump)
        self._kept.callback(jump.unregister)

    def start(self) -> None:
        """Start to publish; silence counts from here."""
        self._last_heard_ns = time.monotonic_ns()

    def _forget(self) -> None:
        """Forget the robot, and the endpoints, which are destroyed."""
        self._outputs.clear()
        self._monitor = self._watchdog = None
        self._encoders = []

    def _watch(self, robot: Robot) -> None:
        """Take over `robot`. Raises EffmassError."""
        arm = RobotDynamics(robot)
        self._monitor = Monitor(arm, self._settings)
        self._encoders = [ContactStateEncoder(name, robot.base_frame) for name in arm.contact_points]
        self._waiting = ""
        self.get_logger().info(f"watching {robot.name} ({robot.origin}) at {', '.join(arm.contact_points)}")
        for line in (*robot.notes, *(f"no {line}" for line in self._health.missing_models(arm))):
            self.get_logger().info(line)

    def _on_joint_state(self, data: bytes) -> None:
        if not self.active:
            return
        started_ns = time.monotonic_ns()
        self._health.received += 1
        monitor = self._monitor
        if monitor is None:
            self._publish(no_robot_decision(self._waiting))
            return
        try:
            decision = monitor.assess(self._decoder.decode(data), self._clock.now().nanoseconds)
        except DecodeError as error:
            decision = monitor.reject(str(error))
        if decision is not None:
            self._last_heard_ns = started_ns
            self._publish(decision)
            self._health.answered(time.monotonic_ns() - started_ns)

    def _watchdog_period_s(self) -> float:
        return max(self._settings.timeout / _LOOKS_PER_TIMEOUT, 1.0 / _MOST_LOOKS_HZ)

    def _on_watchdog(self) -> None:
        silent_ns = time.monotonic_ns() - self._last_heard_ns
        if not self.active or silent_ns <= self._settings.timeout * 1e9:
            return
        monitor, waiting = self._monitor, self._waiting
        self._publish(monitor.watchdog_decision(silent_ns) if monitor else no_robot_decision(waiting, watchdog=True))

    def _publish(self, decision: Decision) -> None:
        contact_state = self._outputs[topics.CONTACT_STATE]
        for encoder, contact in zip(self._encoders or [_NO_ROBOT], decision.contacts, strict=True):
            contact_state.publish(encoder.encode(contact))
        self._outputs[topics.ALLOWABLE_SPEED].publish(float64_message(decision.allowable_speed))
        self._outputs[topics.SPEED_SCALING].publish(float64_message(decision.speed_scaling))
        self._decision = decision
        shown = [contact.verdict for contact in decision.contacts]
        if shown != self._shown and time.monotonic_ns() - self._reported_ns > _REPORTS_APART_NS:
            self._shown = shown
            self._diagnostics.report()

    def _statuses(self) -> list[DiagnosticStatus]:
        self._reported_ns = time.monotonic_ns()
        publishers = self.count_publishers(self._joint_states.topic_name)
        return self._health.statuses(self._monitor, self._decision, publishers)

    def _on_description(self, message: String) -> None:
        try:
            self._watch(parse_urdf(message.data, "robot_description", self._settings))
        except EffmassError as error:
            self._monitor = None
            self._encoders = []
            self._waiting = str(error)
            self.get_logger().error(self._waiting)

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._monitor is None:
            response.message = self._waiting
        else:
            cause = self._monitor.first_cause
            self._monitor.reset()
            response.success = True
            response.message = f"cleared: {cause.verdict.name}: {cause.reason}" if cause else "nothing was latched"
        return response

    def _on_clock_jump(self, _: TimeJump) -> None:
        if self._monitor is not None:
            self._monitor.clear_history()
            self.get_logger().info("the clock went back: earlier joint states are forgotten")

    def _on_matched(self, matched: QoSSubscriptionMatchedInfo) -> None:
        if matched.current_count > 1:
            self.get_logger().warning(
                f"{matched.current_count} publishers on {self._joint_states.topic_name}: "
                "their joint states are taken as one stream"
            )

    def _on_lost(self, lost: QoSMessageLostInfo) -> None:
        self._health.lost = lost.total_count

    def _on_incompatible(self, line: str) -> None:
        self._health.incompatible(line)
        self.get_logger().warning(line)

    def _take(self, settings: NodeSettings, _: AbstractSet[str]) -> None:
        self._settings = settings
        if self._monitor is not None:
            self._monitor.apply(self._settings)
        if self._watchdog is not None:
            self._watchdog.timer_period_ns = self._watchdog_period_s() * 1e9
            self._watchdog.reset()  # it would wait for the end of the old period first


def main(args: Sequence[str] | None = None) -> int:
    """Run the node with ROS arguments `args`, or those of the process."""
    return run(MonitorNode, args)
