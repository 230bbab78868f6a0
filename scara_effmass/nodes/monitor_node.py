# SPDX-License-Identifier: Apache-2.0
"""`monitor_node`: decode joint states, call `safety.Monitor`, publish its verdicts.

The watchdog has a thread of its own, so it also publishes while a callback takes long.
"""

import threading
import time
from collections import Counter
from collections.abc import Iterable
from collections.abc import Set as AbstractSet
from contextlib import suppress
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Inertia
from rclpy.clock import ClockChange, JumpHandle, JumpThreshold, TimeJump
from rclpy.duration import Duration
from rclpy.event_handler import QoSSubscriptionMatchedInfo
from scara_effmass_msgs.msg import ContactStates, PayloadEstimate
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from scara_effmass.codes import Reason
from scara_effmass.errors import DecodeError
from scara_effmass.iso15066 import limits_for
from scara_effmass.kernel.state import CODE
from scara_effmass.model.robot import Robot
from scara_effmass.nodes.diagnostics import Diagnostics, no_publisher, several_publishers, status
from scara_effmass.nodes.latched_input import LatchedInput
from scara_effmass.nodes.lifecycle import RCLError, run
from scara_effmass.nodes.monitor_health import (
    Latencies,
    cause_text,
    contact_status,
    missing_models,
    model_status,
    worst_contacts,
)
from scara_effmass.nodes.robot_input import NO_DESCRIPTION, RobotNode, RobotParameters, label
from scara_effmass.nodes.ros import SequenceGaps, is_late, newest_waiting, received_ns, with_info
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Assessments, Cause, Monitor, unknown_assessments
from scara_effmass.safety.assumptions import RULES, deciding_mass, name_of
from scara_effmass.safety.load_watch import Doubt
from scara_effmass.safety.reasons import LOAD_ENTRY
from scara_effmass.settings.loading import fixed
from scara_effmass.values import Decision, Payload
from scara_effmass.wire import topics
from scara_effmass.wire.cdr import header_stamp_ns
from scara_effmass.wire.contact_states import ContactStatesEncoder, float64_message
from scara_effmass.wire.joint_state import JointStateDecoder
from scara_effmass.wire.payload import decode_payload, payload_estimate_message

_WATCHDOG_CHECKS_PER_TIMEOUT = 4
_MIN_WATCHDOG_PERIOD_S = 1e-3
_ACK_TIMEOUT = Duration(seconds=0.5)
_MIN_REPORT_INTERVAL_NS = 100_000_000
_CHECK_S = 0.1
_RESTART_NS = 500_000_000
"""Time for which the last joint state of a driver can come after the event of its end."""
_RIVALRY_NS = 10_000_000_000
"""Time without a joint state out of order after which several publishers do not all send the robot's joints."""


class NodeSettings(RobotParameters):
    """Settings of the monitor and of its node."""

    use_reference: bool = fixed(
        default=False, description="compute with the reference in plain Python in place of the compiled kernel: slow"
    )
    command_tolerance: float = fixed(
        0.0,
        "maximum distance of a joint from its command on joint_commands [rad; a quarter of it in m for a prismatic "
        "joint]; 0: no commands are expected",
        ge=0.0,
        le=10.0,
    )


class MonitorNode(RobotNode[NodeSettings]):
    """Subscribes to `joint_states`; publishes `topics.MONITOR_OUTPUTS` and `/diagnostics`."""

    def __init__(self) -> None:
        """Declare the parameters. Raises SettingsError for an invalid one."""
        super().__init__("monitor", NodeSettings)
        self._outputs: dict[str, Any] = {}
        self._monitor: Monitor | None = None
        self.check_settings(self.settings)
        self._first_cause: Cause | None = None
        """What `latch` holds while there is no robot."""
        self._encoder = ContactStatesEncoder()
        self._last_answer_ns = 0
        self._monitor_lock = threading.Lock()
        self._output_lock = threading.Lock()
        """Held while the messages of one decision are published."""
        self._publishing = False
        self._watchdog: threading.Thread | None = None
        self._wake_watchdog = threading.Event()

    def configure(self) -> None:
        """Load the robot and create the endpoints. Raises EffmassError."""
        self.own(self, MonitorNode._forget_robot)
        self._decoder = JointStateDecoder()
        self._received = self._skipped = self._lost = 0
        self._gaps = SequenceGaps(lambda: self.count_publishers(self._joint_states.topic_name))
        self._told = (0, 0)
        """How many were skipped and lost at the last diagnostics."""
        self._departed = self._departed_ns = 0
        """Number of publishers of joint states that have gone, and when the last one did: monotonic time [ns]."""
        self._is_numbered = True
        """Whether the middleware numbers the messages of a publisher."""
        self._rivals = self._rivals_ns = 0
        """Number of publishers when two last sent the robot's joints, 0 if none do, and the monotonic time [ns]."""
        self._latencies = Latencies()
        self._latest: Assessments | None = None
        self._verdicts: list[float] = []
        self._changed: Decision | None = None
        self._changes: list[Decision] = []
        """Decisions since the last report that changed a verdict."""
        self._change_counts: Counter[str] = Counter()
        self._reported_ns = 0
        self._no_robot_reason, self._is_reading = "", False
        self._payload: Payload | str = ""
        self._load_estimate: Any = None
        self._load_doubt = Doubt()
        self.await_robot()
        qos = topics.verdict_qos(self.settings.timeout)
        scalar_qos = qos._replace(lifespan_s=topics.SCALAR_LIFESPAN_S)
        for message_type, topic, topic_qos in (
            (ContactStates, topics.CONTACT_STATES, qos),
            (Float64, topics.ALLOWABLE_SPEED, scalar_qos),
            (Float64, topics.SPEED_SCALING, scalar_qos),
        ):
            self._outputs[topic] = self.create_owned_publisher(message_type, topic, topic_qos)
        self._estimates = self.create_owned_publisher(PayloadEstimate, topics.PAYLOAD_ESTIMATE, topics.INFO_QOS)
        self._diagnostics = Diagnostics(self, self._statuses)
        self._joint_states = self.create_owned_subscription(
            JointState,
            topics.JOINT_STATES,
            with_info(self._on_joint_state),
            topics.JOINT_STATES_INPUT_QOS,
            raw=True,
            matched=self._on_matched,
        )
        if self.settings.command_tolerance:
            self._command_decoder = JointStateDecoder()
            self.create_owned_subscription(
                JointState, topics.JOINT_COMMANDS, with_info(self._on_command), topics.JOINT_STATES_INPUT_QOS, raw=True
            )
        if topic := self.settings.payload_topic:
            name, qos = f"the payload on {topic}", topics.DESCRIPTION_QOS
            take, state = self._on_payload, self._state_payload
            LatchedInput(self, Inertia, topic, qos, take, state, name=name, lost=state)
        self.create_owned_trigger("~/reset", self._reset)
        self.create_steady_timer(_CHECK_S, self._check_publishers)
        every_step = JumpThreshold(min_forward=Duration(nanoseconds=1), min_backward=Duration(nanoseconds=-1))
        jump = self.get_clock().create_jump_callback(every_step, post_callback=self._on_clock_jump)
        self.own(jump, JumpHandle.unregister)

    def activate(self) -> None:
        """Start to publish and to count silence."""
        self._last_answer_ns = time.monotonic_ns()
        self._publishing = True
        self._wake_watchdog.clear()
        self._watchdog = threading.Thread(target=self._watch, name="watchdog", daemon=True)
        self._watchdog.start()

    def deactivate(self) -> None:
        """End the watchdog and publish a last UNKNOWN."""
        watchdog, self._watchdog = self._watchdog, None
        if watchdog is not None:
            self._wake_watchdog.set()
            watchdog.join()
        self.publish_last(Reason.DEACTIVATED)

    def publish_last(self, reason: Reason, detail: str = "") -> None:
        """Publish UNKNOWN with a speed of 0 and nothing after it; wait a while for acknowledgements."""
        with self._output_lock:
            if not self._publishing or not self.context.ok():
                return
            self._publishing = False
            self._send(self._unknown(reason, detail))
        for publisher in self._outputs.values():
            publisher.wait_for_all_acked(_ACK_TIMEOUT)

    def _forget_robot(self) -> None:
        self._outputs.clear()
        self._drop_monitor()

    def _drop_monitor(self) -> None:
        if self._monitor is not None:
            self._first_cause = self._monitor.first_cause
        self._monitor = None
        self._encoder.frame_id = ""

    def use_robot(self, robot: Robot) -> None:
        """Monitor `robot`. Raises EffmassError."""
        dynamics = RobotDynamics(robot)
        monitor = Monitor(dynamics, self.settings, use_reference=self.settings.use_reference)
        monitor.compile()
        if self.settings.command_tolerance:
            monitor.expect_commands(self.settings.command_tolerance)
        with self._monitor_lock:
            doubt = "" if self._no_robot_reason == NO_DESCRIPTION else self._no_robot_reason
            if self._monitor is not None:
                doubt = f"the robot changed from {label(self._monitor.dynamics.robot)} to {label(robot)}"
                self.get_logger().warning(doubt)
                self._give_unknown(self._monitor, doubt)  # a cause for `latch`
            self._drop_monitor()
            monitor.first_cause = self._first_cause
            if doubt:
                self._give_unknown(monitor, doubt)  # which is held for the release time
            self._monitor = monitor
            self._distrust_rivals()
            self._pass_payload()
            self._encoder.frame_id = robot.base_frame
            self._no_robot_reason, self._is_reading = "", False
        self.get_logger().info(f"monitoring {label(robot)} at {', '.join(dynamics.contact_points)}")
        self._log_assumptions(monitor)
        mass = deciding_mass(dynamics, self.settings.effective_mass_model)
        self.get_logger().info(f"deciding mass: {mass}; payload: {monitor.payload_text}")
        for line in (*robot.notes, *missing_models(dynamics)):
            if line != robot.rotors.warning:  # which is in the status of the model
                self.get_logger().info(line)

    def _log_assumptions(self, monitor: Monitor) -> None:
        assumptions = monitor.assumptions
        if assumptions.assumed:
            effect = "no verdict is OK while these are assumed" if assumptions.limiting else "assumed"
            texts = "; ".join(RULES[code].text for code in assumptions.assumed)
            self.get_logger().warning(f"{effect}: {texts}")
        if assumptions.accepted:
            self.get_logger().info(f"accepted assumptions: {', '.join(map(name_of, assumptions.accepted))}")

    def _on_joint_state(self, data: bytes, info: dict[str, Any]) -> None:
        self._count(info)
        if self.active:
            for message in self._newest(data, info):
                self._answer(*message)

    def _count(self, info: dict[str, Any]) -> None:
        lost = self._gaps.lost_before(info["publication_sequence_number"])
        if self.active:
            self._received += 1
            self._lost += lost

    def _take_waiting(self) -> tuple[bytes, dict[str, Any]] | None:
        taken = self._joint_states.handle.take_message(self._joint_states.msg_type, self._joint_states.raw)
        if taken is not None:
            self._count(taken[1])
        return taken  # type: ignore[no-any-return]

    def _newest(self, data: bytes, info: dict[str, Any]) -> Iterable[tuple[bytes, dict[str, Any]]]:
        """Return the joint state, or where it comes late the newest ones that wait behind it, one of each device.

        An answer to a state of long ago helps nobody, and delays the next. In simulated time, every state is answered.
        """
        late = is_late(info, self.now_ns() - header_stamp_ns(data), self.settings.timeout)
        if not late or self.get_parameter("use_sim_time").value:
            return ((data, info),)
        newest, skipped = newest_waiting(
            (data, info),
            self._take_waiting,
            lambda message: self._names(message[0]),
            topics.JOINT_STATES_INPUT_QOS.depth,
        )
        self._skipped += skipped
        return newest

    def _names(self, data: bytes) -> tuple[str, ...]:
        with suppress(DecodeError):
            return self._decoder.decode(data).names
        return ()

    def _answer(self, data: bytes, info: dict[str, Any]) -> None:
        start_ns = time.monotonic_ns()
        with self._monitor_lock:
            monitor = self._monitor
            if monitor is None:
                self._publish(unknown_assessments(Reason.NO_ROBOT, self._no_robot_reason, self.now_ns()))
                return
            try:
                state, number = self._decoder.decode(data), info["publication_sequence_number"]
                self._is_numbered = number is not None
                assessments = monitor.assess_one(state, self.now_ns(), number)
            except DecodeError as error:
                assessments = monitor.settle(monitor.refuse(Reason.UNDECODABLE, str(error), self.now_ns()))
            if assessments is not None:
                if assessments.states["reason"][0, CODE] == Reason.SECOND_PUBLISHER:
                    self._watch_rivals()
                processing_ns = time.monotonic_ns() - start_ns
                if processing_ns > self.settings.timeout * 1e9:
                    state, seconds = assessments.states[0], processing_ns / 1e9
                    late = monitor.refuse(Reason.TOO_SLOW, "", int(state["stamp_ns"]), float(state["age"]), seconds)
                    assessments = monitor.settle(late)
                self._last_answer_ns = start_ns
                self._publish(assessments)
                latency_ns = time.time_ns() - received_ns(info)
                self._latencies.add(latency_ns, int(assessments.states["stamp_ns"][0]))
                self._publish_load(monitor)

    def _watch_rivals(self) -> None:
        """Note that several publishers send the robot's joints, unless one has gone: then the driver was restarted."""
        has_restarted = self._departed_ns > self._last_answer_ns - _RESTART_NS
        count = self.count_publishers(self._joint_states.topic_name)
        if count > 1 and not has_restarted:
            self._rivals, self._rivals_ns = count, time.monotonic_ns()
            self._distrust_rivals()

    def _distrust_rivals(self) -> None:
        """Distrust the joint states until a publisher has gone, or for 10 s: a second one may send seldom.

        Without numbers, as Cyclone DDS gives none, nothing tells whose joints several publishers send.
        """
        if not self._is_numbered:
            count = self.count_publishers(self._joint_states.topic_name)
            self._rivals = count if count > 1 else 0
        elif time.monotonic_ns() - self._rivals_ns > _RIVALRY_NS:
            self._rivals = 0
        reason = f"{self._rivals} publishers of joint states: only one may send the robot's joints"
        if self._monitor is not None:
            self._monitor.distrust(topics.JOINT_STATES, reason if self._rivals else "")

    def _publish_load(self, monitor: Monitor) -> None:
        """Publish the load by the torques where there is a new estimate, and log what it begins or ceases to doubt."""
        watch = monitor.load_watch
        if watch.doubt != self._load_doubt:
            self._load_doubt = watch.doubt
            self.get_logger().warning(watch.doubt.text or f"{LOAD_ENTRY}: {monitor.load_text}")
        if watch.estimate is self._load_estimate or watch.estimate is None:
            return
        self._load_estimate = watch.estimate
        message = payload_estimate_message(watch.estimate, monitor.load_text, monitor.dynamics.robot)
        with self._output_lock:
            if self._publishing:
                self._estimates.publish(message)

    def _on_command(self, data: bytes, info: dict[str, Any]) -> None:
        with self._monitor_lock:
            if self._monitor is not None:
                with suppress(DecodeError):
                    command, number = self._command_decoder.decode(data), info["publication_sequence_number"]
                    self._monitor.take_command(command, self.now_ns(), number)

    def _on_payload(self, data: bytes) -> None:
        self._state_payload(decode_payload(data))

    def _state_payload(self, payload: Payload | str) -> None:
        """Use the payload, or state why it is unknown."""
        self._payload = payload
        with self._monitor_lock:
            self._pass_payload()

    def _pass_payload(self) -> None:
        """Hand the payload, or why it is unknown, to the monitor."""
        if self._monitor is None or not self._payload:
            return
        before = self._monitor.payload_text
        self._monitor.take_payload(self._payload)
        if (text := self._monitor.payload_text) != before:
            self.get_logger().info(f"payload: {text}")

    def _watchdog_period_s(self) -> float:
        return max(self.settings.timeout / _WATCHDOG_CHECKS_PER_TIMEOUT, _MIN_WATCHDOG_PERIOD_S)

    def _watch(self) -> None:
        """Run the watchdog until the node is deactivated, in its own thread."""
        while self._watchdog is not None:
            self._wake_watchdog.wait(self._watchdog_period_s())
            self._wake_watchdog.clear()
            try:
                self._on_watchdog()
            except RCLError:
                if self.context.ok():
                    raise

    def _on_watchdog(self) -> None:
        if self._silence_ns() == 0:
            return
        if self._is_reading:
            self._publish(self._unknown(Reason.ROBOT_CHANGES))
            return
        # A callback that takes long holds the lock.
        if not self._monitor_lock.acquire(timeout=self._watchdog_period_s()):
            self._publish(self._unknown(Reason.STUCK))
            return
        try:
            if silence_ns := self._silence_ns():  # no answer since
                self._publish(
                    self._monitor.watchdog_decision(silence_ns, self.now_ns())
                    if self._monitor is not None
                    else self._unknown(Reason.NO_ROBOT, self._no_robot_reason)
                )
        finally:
            self._monitor_lock.release()

    def _silence_ns(self) -> int:
        """Return the time since the last answer, 0 if it is within the timeout or the node is not active."""
        silence_ns = time.monotonic_ns() - self._last_answer_ns
        return silence_ns if self.active and silence_ns > self.settings.timeout * 1e9 else 0

    def _unknown(self, reason: Reason, detail: str = "") -> Assessments:
        """Return UNKNOWN for `reason` and for every contact point, as the answer to no joint state."""
        monitor = self._monitor  # which another thread may drop
        points = monitor.dynamics.contact_points if monitor is not None else ("",)
        return unknown_assessments(reason, detail, self.now_ns(), points, watchdog=True)

    def _send(self, assessments: Assessments) -> None:
        # Without the wrappers of rclpy, which cost as much as the call: `_publishing` guards the handles.
        self._outputs[topics.CONTACT_STATES].handle.publish_raw(self._encoder.encode(assessments))
        allowed = assessments.states[0]
        self._outputs[topics.ALLOWABLE_SPEED].handle.publish_raw(float64_message(allowed["allowable_speed"]))
        self._outputs[topics.SPEED_SCALING].handle.publish_raw(float64_message(allowed["speed_scaling"]))
        verdicts = assessments.contacts["verdict"][0].tolist()
        if verdicts != self._verdicts:
            decision = assessments.decision(0)
            before = {c.contact_point: c.verdict for c in self._changed.contacts} if self._changed else {}
            self._change_counts.update(
                c.contact_point for c in decision.contacts if c.verdict is not before.get(c.contact_point)
            )
            self._verdicts = verdicts
            self._changes.append(decision)
            self._changed = decision
        self._latest = assessments

    def _publish(self, assessments: Assessments) -> None:
        with self._output_lock:
            if not self._publishing:
                return
            self._send(assessments)
        if self._changes and time.monotonic_ns() - self._reported_ns > _MIN_REPORT_INTERVAL_NS:
            self._diagnostics.report()

    def _statuses(self) -> list[DiagnosticStatus]:
        self._reported_ns = time.monotonic_ns()
        with self._output_lock:
            changes, self._changes = self._changes, []
        decision = self._latest.decision(0) if self._latest else None
        contacts = worst_contacts(decision, changes) if decision else ()
        has_conflict = bool(self._rivals) or any(contact.reason_code is Reason.SECOND_PUBLISHER for contact in contacts)
        statuses = [self._input_status(has_conflict=has_conflict)]
        statuses += [model_status(self._monitor)] if self._monitor else []
        input_age = decision.input_age if decision else 0.0
        statuses += [contact_status(one, self._change_counts[one.contact_point], input_age) for one in contacts]
        for entry in statuses:
            entry.hardware_id = (self._monitor.dynamics.robot.name if self._monitor else "") or "no robot"
        return statuses

    def _input_status(self, *, has_conflict: bool) -> DiagnosticStatus:
        """Return the status of the joint states. `has_conflict`: two publishers have sent the robot's joints.

        Without it, one that sends other joints is no problem.
        """
        monitor, latencies = self._monitor, self._latencies
        problem = no_publisher(self, topics.JOINT_STATES, "sensor_msgs/msg/JointState")
        told, self._told = self._told, (self._skipped, self._lost)
        skipped, lost = self._skipped - told[0], self._lost - told[1]
        if skipped and not problem:
            problem = f"overload: {skipped} joint states were skipped for newer ones"
        elif lost and not problem:
            problem = f"{lost} joint states were lost between publisher and monitor: overload or network"
        publishers = self.count_publishers(self._joint_states.topic_name)
        if has_conflict or (publishers > 1 and not (monitor and monitor.ignored)):
            problem = f"{publishers} publishers of joint states: only one may send the robot's joints"
        values = {
            "publishers": publishers,
            "received": self._received,
            "skipped": self._skipped,
            "lost": self._lost,
            "refused": monitor.rejected if monitor else 0,
            "of other devices": monitor.ignored if monitor else 0,
            "moved, but not in the model": ", ".join(monitor.unmodelled_joints) if monitor else "",
            **{f"latency {name} [us]": f"{latency_us:.0f}" for name, latency_us in latencies.report().items()},
            "latency histogram [us]": latencies.histogram,
            "missed deadlines": latencies.missed,
        }
        return status("input", f"{self._received} joint states", values, problem=problem)

    def await_model(self) -> None:
        """Give UNKNOWN at once: reading a large mesh can stop every thread of the node for seconds."""
        self._is_reading = True
        self._publish(self._unknown(Reason.ROBOT_CHANGES))

    def refuse_robot(self, reason: str) -> None:
        """Give UNKNOWN for `reason`."""
        with self._monitor_lock:
            self._no_robot_reason, self._is_reading = reason, False
            if self._monitor is not None:
                self._give_unknown(self._monitor, reason)  # a cause for `latch`
            self._drop_monitor()

    def _give_unknown(self, monitor: Monitor, reason: str) -> None:
        monitor.settle(monitor.refuse(Reason.NO_ROBOT, reason, self.now_ns()))

    def distrust_robot(self, reason: str) -> None:
        """Give UNKNOWN for `reason` while it is not empty."""
        with self._monitor_lock:
            if self._monitor is not None:
                self._monitor.distrust(topics.ROBOT_DESCRIPTION, reason)
            elif reason:
                self._no_robot_reason = reason

    def _check_publishers(self) -> None:
        """Trust /clock only while it has one publisher, and the joint states while one sends those of the robot."""
        reason = several_publishers(self, topics.CLOCK) if self.get_parameter("use_sim_time").value else ""
        with self._monitor_lock:
            if self._monitor is not None:
                self._monitor.distrust(topics.CLOCK, reason)
                self._distrust_rivals()

    def _reset(self) -> str:
        with self._monitor_lock:
            cause, self._first_cause = self._first_cause, None
            if self._monitor is not None:
                cause = self._monitor.first_cause
                self._monitor.reset()
        return f"cleared: {cause.verdict.name}: {cause_text(cause)}" if cause else "nothing was latched"

    def _on_clock_jump(self, jump: TimeJump) -> None:
        """Pass each step of /clock on; forget the joint states if the clock goes back or changes its source."""
        with self._monitor_lock:
            if self._monitor is None:
                return
            if jump.delta.nanoseconds > 0 and jump.clock_change == ClockChange.ROS_TIME_NO_CHANGE:
                self._monitor.take_clock_step(jump.delta.nanoseconds)
                return
            self._monitor.clear_history()
        self.get_logger().info("the clock went back or changed its source: the history of joint states is cleared")

    def _on_matched(self, matched: QoSSubscriptionMatchedInfo) -> None:
        departed = matched.total_count - matched.current_count
        if departed > self._departed:
            self._departed, self._departed_ns, self._rivals = departed, time.monotonic_ns(), 0
        if matched.current_count > 1:
            topic = self._joint_states.topic_name
            self.get_logger().warning(
                f"{matched.current_count} publishers on {topic}: only one may send the robot's joints"
            )

    def check_settings(self, settings: NodeSettings) -> None:
        """Raise EffmassError for settings that the monitor would refuse."""
        if self._monitor is None:
            limits_for(settings)
        else:
            self._monitor.check(settings)

    def apply_settings(self, changed: AbstractSet[str]) -> None:
        """Assess the next joint states with the settings."""
        with self._monitor_lock:
            if self._monitor is not None:
                before = self._monitor.assumptions
                self._monitor.apply(self.settings)
                if self._monitor.assumptions != before:
                    self._log_assumptions(self._monitor)
                if any(name.startswith("payload") for name in changed):
                    self.get_logger().info(f"payload: {self._monitor.payload_text}")
        self._wake_watchdog.set()  # else the new period starts after the old one


main = partial(run, "monitor", MonitorNode)
