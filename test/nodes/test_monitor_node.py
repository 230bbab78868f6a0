# SPDX-License-Identifier: Apache-2.0
"""Live monitor node: lifecycle, parameters, time, robot_description and a 1 kHz stream."""

import math
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import GetState
from rcl_interfaces.msg import Log, ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rosgraph_msgs.msg import Clock
from scara_effmass_msgs.msg import ContactState, ContactStates
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger

from scara_effmass.codes import Assumption, ModelCode, Reason
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import MonitorSettings
from scara_effmass.settings.loading import READ_ONLY, flat_fields
from scara_effmass.share import share
from test.nodes.conftest import Answer, NodeHarness, joint_state, stamp_ns

MS = 1_000_000
S = 1_000_000_000
INFO = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
VECTORS = {
    "payload_com": "list of 3 numbers from -2 to 2",
    "payload_inertia": "list of 6 numbers from -10000 to 10000",
    "test_direction": "list of 3 numbers from -1e+06 to 1e+06",
}
FREE_TEXT = {
    *("robot", "payload_topic", "contact_normal", "contact_normal_frame"),
    *("person_direction_frame", "test_direction_frame"),
}
READ_ONLY_NAMES = {name for name, field in flat_fields(MonitorSettings).items() if field.json_schema_extra == READ_ONLY}


def label(harness: NodeHarness) -> str:
    return str(harness.call_service(GetState, "get_state", GetState.Request()).current_state.label)


class TestLifecycle:
    def test_robot_payload_and_contact_points_can_change_while_unconfigured(
        self, new_harness: Callable[..., NodeHarness]
    ) -> None:
        harness = new_harness("--ros-args", "-p", "autostart:=false")
        logged: list[str] = []

        def on_log(message: Log) -> None:
            logged.append(message.msg)

        harness.node.create_subscription(Log, "/rosout", on_log, INFO)
        ur5 = str(share("config", "robots", "ur5_robot.urdf"))
        changes = {"robot": ur5, "contact_points": ["ee_link"], "payload_mass": 2.0}
        assert harness.set_parameters(**changes) == ""
        assert harness.set_parameters(timeout=-1.0) != ""
        assert harness.change_state(Transition.TRANSITION_CONFIGURE)
        harness.spin_until(lambda: any(line.startswith("monitoring ur5") and "ee_link" in line for line in logged))
        assert "read-only" in harness.set_parameters(robot="")
        assert "read-only" in harness.set_parameters(contact_points=["tool"])
        assert harness.change_state(Transition.TRANSITION_ACTIVATE, Transition.TRANSITION_DEACTIVATE)
        assert harness.change_state(Transition.TRANSITION_CLEANUP)
        assert harness.set_parameters(robot="", contact_points=["nose"]) == ""
        assert not harness.change_state(Transition.TRANSITION_CONFIGURE)  # and stays unconfigured
        assert harness.set_parameters(contact_points=["tool"]) == ""
        assert harness.change_state(Transition.TRANSITION_CONFIGURE)
        steps = ["unconfigured -> inactive", "inactive -> active", "active -> inactive", "inactive -> unconfigured"]
        harness.spin_until(lambda: [line for line in logged if " -> " in line] == [*steps, steps[0]])

    def test_node_passes_through_all_states(self, new_harness: Callable[..., NodeHarness]) -> None:
        harness = new_harness("--ros-args", "-p", "autostart:=false", "-p", "timeout:=60.0", "-p", "release_time:=0.0")
        harness.subscribe()
        assert label(harness) == "unconfigured"
        assert harness.change_state(Transition.TRANSITION_CONFIGURE)
        assert label(harness) == "inactive"
        harness.send(joint_state())
        harness.spin_until(lambda: harness.node.count_subscribers("joint_states") == 1)
        harness.send(joint_state())
        assert label(harness) == "inactive"  # the joint state has arrived by now
        assert harness.change_state(Transition.TRANSITION_ACTIVATE)
        assert harness.contact_states == []
        harness.send_until_ok()

        # A shorter timeout applies at once, although the watchdog had a period of 15 s.
        assert harness.set_parameters(timeout=0.05) == ""
        harness.spin_until(
            lambda: harness.contact_states[-1].reason.startswith("no valid joint state for "), timeout_s=14.0
        )

        assert harness.change_state(Transition.TRANSITION_DEACTIVATE)
        harness.discard_received()
        harness.send(joint_state())
        assert label(harness) == "inactive"
        assert harness.contact_states == []
        assert harness.set_parameters(timeout=60.0) == ""
        assert harness.contact_states == []
        assert harness.change_state(Transition.TRANSITION_CLEANUP)
        assert label(harness) == "unconfigured"
        for transition in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
            assert harness.change_state(transition)
        harness.send_until_ok()
        assert harness.change_state(Transition.TRANSITION_ACTIVE_SHUTDOWN)
        assert label(harness) == "finalized"
        harness.spin_until(lambda: harness.node.count_publishers("contact_states") == 0)

    def test_invalid_transition_is_refused_and_the_node_continues(self, harness: NodeHarness) -> None:
        for transition in (Transition.TRANSITION_ACTIVATE, Transition.TRANSITION_CONFIGURE, 99):
            assert not harness.change_state(transition)
        assert label(harness) == "active"
        harness.send_until_ok()

    def test_failed_configuration_can_be_repeated(
        self, new_harness: Callable[..., NodeHarness], tmp_path: Path
    ) -> None:
        robot = tmp_path / "robot.yaml"
        harness = new_harness("--ros-args", "-p", "autostart:=false", "-p", f"robot:={robot}")
        assert not harness.change_state(Transition.TRANSITION_CONFIGURE)
        assert label(harness) == "unconfigured"
        robot.write_bytes(share("config", "omron_i4_550l.yaml").read_bytes())
        assert harness.change_state(Transition.TRANSITION_CONFIGURE)
        assert harness.process is not None
        harness.process.send_signal(signal.SIGINT)
        output, errors = harness.process.communicate()
        assert f"{robot}: cannot be read" in output + errors


class TestParameters:
    def test_every_parameter_has_a_description_and_a_range(self, shared_harness: NodeHarness) -> None:
        fields = flat_fields(MonitorSettings)
        names = [*fields, "autostart"]
        descriptors = shared_harness.call_service(
            DescribeParameters, "describe_parameters", DescribeParameters.Request(names=names)
        ).descriptors
        assert [descriptor.name for descriptor in descriptors] == names
        for descriptor in descriptors:
            assert descriptor.description
            assert descriptor.read_only == (descriptor.name in {*READ_ONLY_NAMES, "autostart"})
            if descriptor.type == ParameterType.PARAMETER_DOUBLE:
                (bounds,) = descriptor.floating_point_range
                assert 0.0 <= bounds.from_value < bounds.to_value
            elif descriptor.name in VECTORS:
                assert descriptor.type == ParameterType.PARAMETER_DOUBLE_ARRAY
                assert descriptor.additional_constraints == VECTORS[descriptor.name]
            elif descriptor.type != ParameterType.PARAMETER_BOOL and descriptor.name not in FREE_TEXT:
                assert descriptor.additional_constraints

    def test_every_parameter_is_listed_with_its_value(self, shared_harness: NodeHarness) -> None:
        names = shared_harness.call_service(ListParameters, "list_parameters", ListParameters.Request()).result.names
        assert set(flat_fields(MonitorSettings)) <= set(names)
        # `ros2 param dump` requests all at once and gets nothing if one has no value.
        values = shared_harness.call_service(GetParameters, "get_parameters", GetParameters.Request(names=names)).values
        assert len(values) == len(names)
        by_name = dict(zip(names, values, strict=True))
        assert by_name["contact_points"].type == ParameterType.PARAMETER_STRING_ARRAY
        assert by_name["locked_joints"].type == ParameterType.PARAMETER_STRING_ARRAY

    @pytest.mark.parametrize(
        ("name", "value", "reason"),
        [
            ("robot", "other.urdf", "read-only"),
            ("await_robot_description", True, "read-only"),
            ("contact_points", ["tool"], "read-only"),
            ("locked_joints", ["*"], "read-only"),
            ("autostart", False, "read-only"),
            ("body_regions", ["tail"], "body_regions = 'tail': must be one of skull_forehead"),
            ("body_regions", ["face"], "the standard permits no contact"),
            ("max_force", 1e5, "max_force = 100000 N: must be at most the standard's"),
            ("stiffness_n_m", 1e3, "stiffness_n_m = 1000 N/m: must be at least the standard's"),
            ("body_mass", 0.01, "body_mass = 0.01 kg: must be at least the standard's"),
            ("effective_mass_model", "light", "must be 'lumped', 'full', 'iso', 'largest' or 'auto'"),
            ("timeout", -1.0, "out of range"),
            ("timeout", math.nan, "out of range"),
            ("speed_threshold", 0.0, "speed_threshold = 0.0: must be greater than"),
            ("warn_ratio", "much", "Wrong parameter type"),
            ("timeout", 1, "Wrong parameter type"),
            ("nonsense", 1.0, "undeclared parameter"),
            ("payload_mass", -1.0, "out of range"),
            ("contact_normal", "up", "contact_normal = 'up': must be worst, velocity, or three numbers"),
            ("contact_normal_frame", "nowhere", "contact_normal_frame = 'nowhere': must be one of"),
            ("test_direction_frame", "nowhere", "test_direction_frame = 'nowhere': must be one of"),
            ("payload_com", [0.0, 0.0], "payload_com.2: must be present"),
            ("payload_com", [0.0, 0.0, math.inf], "payload_com.2 = inf"),
            ("payload_com", [0.0, 0.0, 120.0], "payload_com.2 = 120.0: must be less than or equal to 2"),
            ("payload_inertia", [0.1, 0.1, 0.1, 0.0, 0.0, 0.0], "must be 0 without payload_mass"),
        ],
    )
    def test_invalid_value_is_refused_with_the_reason(
        self,
        harness: NodeHarness,
        name: str,
        value: Any,  # noqa: ANN401
        reason: str,
    ) -> None:
        assert reason in harness.set_parameters(**{name: value})
        assert harness.response_to(joint_state()).verdict == ContactState.OK

    def test_payload_changes_live_and_keeps_the_counts(self, harness: NodeHarness) -> None:
        """The masses are those of a monitor started with the payload; its origin is in the diagnostics."""
        light = harness.response_to(joint_state())
        counted = int(harness.diagnostic("model", "decisions OK", lambda value: int(value) > 0).split(" | ")[1])
        try:
            assert harness.set_parameters(payload_mass=2.5, payload_com=[0.0, 0.0, 0.1]) == ""
            sent = joint_state()
            heavy = harness.response_to(sent)
            settings = MonitorSettings(payload_mass=2.5, payload_com=(0.0, 0.0, 0.1))
            dynamics = RobotDynamics(load_robot(settings=settings))
            q, qd = np.array(sent.position), np.array(sent.velocity)
            contact = dynamics.at(q, qd).contacts[0]
            # Below the speed threshold the worst direction decides.
            masses = [contact.effective_mass(code, None) for code in (ModelCode.LUMPED, ModelCode.FULL)]
            assert [heavy.lumped_mass, heavy.full_mass] == pytest.approx(masses, rel=1e-9)
            assert heavy.iso_mass == dynamics.robot.iso_mass == pytest.approx(light.iso_mass + 2.5)
            text = harness.diagnostic("model", "payload", lambda value: "2.5" in value)
            assert text.endswith("| 0.25 kg (robot file) + 2.5 kg (parameter payload_mass)")
            assert int(harness.diagnostic("model", "decisions OK", bool).split(" | ")[1]) >= counted
        finally:
            assert harness.set_parameters(payload_mass=0.0, payload_com=[0.0, 0.0, 0.0]) == ""
        assert harness.response_to(joint_state()).full_mass == light.full_mass

    def test_valid_value_applies_at_once(self, harness: NodeHarness) -> None:
        default = harness.response_to(joint_state())
        assert default.effective_mass == default.lumped_mass
        try:
            assert (
                harness.set_parameters(effective_mass_model="full", body_regions=["chest", "neck"], person_speed=0.1)
                == ""
            )
            changed = harness.response_to(joint_state())
            assert changed.effective_mass == changed.full_mass
            assert changed.body_region in {"chest", "neck"}
        finally:
            assert harness.set_parameters(effective_mass_model="auto", body_regions=[], person_speed=0.0) == ""
        restored = harness.response_to(joint_state())
        assert restored.body_region == default.body_region
        # The allowable speed also depends on the pause since the last joint state, whose positions are the same.
        assert (restored.effective_mass, restored.predicted_force) == (default.effective_mass, default.predicted_force)

    def test_reset_releases_the_latch_and_reports_the_cause(self, harness: NodeHarness) -> None:
        assert harness.call_service(Trigger, "reset", Trigger.Request()).success
        try:
            # A person who comes too fast: velocities that positions do not follow would be UNKNOWN after a pause.
            assert harness.set_parameters(latch=True, person_speed=10.0) == ""
            assert harness.response_to(joint_state()).verdict == ContactState.VIOLATION
            assert harness.set_parameters(person_speed=0.0) == ""
            latched = harness.response_to(joint_state())
            assert latched.verdict == ContactState.VIOLATION
            assert re.match(r"latched until reset: (tool|elbow|link\d): ", latched.reason)
            assert harness.scalars == {"allowable_speed": [0.0], "speed_scaling": [0.0]}
            response = harness.call_service(Trigger, "reset", Trigger.Request())
            assert response.success
            assert re.match(r"cleared: VIOLATION: (tool|elbow|link\d): ", response.message)
            answer = harness.response_to(joint_state())
            assert (answer.verdict, answer.reason) == (ContactState.OK, "")
        finally:
            assert harness.set_parameters(latch=False, person_speed=0.0) == ""

    def test_parameter_file_remapping_and_qos_overrides_apply(
        self, new_harness: Callable[..., NodeHarness], tmp_path: Path
    ) -> None:
        """Combine them as a launch file does: namespace, remapping, file, empty lists, QoS."""
        params = tmp_path / "cell.yaml"
        params.write_text(
            "/**:\n  ros__parameters:\n"
            "    release_time: 0.0\n    timeout: 60.0\n    contact_points: []\n    locked_joints: []\n"
            "    body_regions: [chest]\n"
            "    qos_overrides:\n"
            "      /arm/joint_states:\n        subscription:\n          reliability: reliable\n          depth: 17\n"
            "      /left/contact_states:\n        publisher:\n          reliability: best_effort\n",
            encoding="utf-8",
        )
        harness = new_harness(namespace="/left", name="watch")
        words = ("-r", "__ns:=/left", "-r", "__node:=watch", "-r", "joint_states:=/arm/joint_states")
        harness.start("--ros-args", "--params-file", str(params), *words)
        sender = harness.node.create_publisher(JointState, "/arm/joint_states", 10)
        received: list[Answer] = []
        best_effort = QoSProfile(depth=10, reliability=2)
        harness.node.create_subscription(
            ContactStates, "contact_states", lambda message: received.append(Answer(message)), best_effort
        )
        (contact,) = harness.spin_until(
            lambda: [c for c in received if c.verdict == ContactState.OK][:1],
            repeat=lambda: sender.publish(joint_state()),
        )
        assert (contact.contact_point, contact.body_region) == ("tool", "chest")

        def endpoint(infos: Callable[[str], list[TopicEndpointInfo]], topic: str) -> TopicEndpointInfo:
            """Return the endpoint of the node; discovery reports an endpoint and its node name separately."""
            (info,) = harness.spin_until(lambda: [i for i in infos(topic) if i.node_name == "watch"])
            assert isinstance(info, TopicEndpointInfo)
            return info

        subscription = endpoint(harness.node.get_subscriptions_info_by_topic, "/arm/joint_states")
        assert subscription.node_namespace == "/left"
        assert subscription.qos_profile.reliability.name == "RELIABLE"
        reliabilities = {
            topic: endpoint(harness.node.get_publishers_info_by_topic, f"/left/{topic}").qos_profile.reliability.name
            for topic in ("contact_states", "allowable_speed", "speed_scaling")
        }
        assert reliabilities == {
            "contact_states": "BEST_EFFORT",
            "allowable_speed": "RELIABLE",
            "speed_scaling": "RELIABLE",
        }


class TestTime:
    def test_clock_pauses_and_jumps_back(self, new_harness: Callable[..., NodeHarness]) -> None:
        harness = new_harness("--ros-args", "-p", "use_sim_time:=true", "-p", "release_time:=0.0", "-p", "timeout:=0.3")
        harness.subscribe()
        clock = harness.node.create_publisher(Clock, "/clock", 10)
        now = 1000 * S

        def tick() -> None:
            nonlocal now
            now += 10 * MS
            message = Clock()
            message.clock.sec, message.clock.nanosec = divmod(now, S)
            clock.publish(message)
            harness.send(joint_state(now))

        def verdicts() -> list[int]:
            return [contact.verdict for contact in harness.contact_states]

        harness.spin_until(lambda: ContactState.OK in verdicts(), repeat=tick)
        # The clock stands still and no joint state arrives: the watchdog runs in steady time.
        harness.spin_until(lambda: harness.contact_states[-1].reason.startswith("no valid joint state for"))
        assert harness.contact_states[-1].verdict == ContactState.UNKNOWN
        # A joint state that arrives meanwhile repeats its stamp.
        harness.contact_states.clear()
        harness.spin_until(
            lambda: any("repeated" in c.reason for c in harness.contact_states),
            repeat=lambda: harness.send(joint_state(now)),
        )
        harness.contact_states.clear()
        harness.spin_until(lambda: ContactState.OK in verdicts(), repeat=tick)
        # The clock jumps back by 400 s, as for a looped bag.
        now -= 400 * S
        harness.spin_until(
            lambda: (
                harness.contact_states[-1].verdict == ContactState.OK
                and harness.contact_states[-1].header.stamp.sec < 700
            ),
            repeat=tick,
        )

    def test_clock_of_40_hz_and_joint_states_of_250_hz_give_ok(self, new_harness: Callable[..., NodeHarness]) -> None:
        """As `ros2 bag play --clock` publishes at its default; the stamps lead the clock by up to 25 ms."""
        harness = new_harness("--ros-args", "-p", "use_sim_time:=true")
        harness.subscribe()
        publisher = harness.node.create_publisher(Clock, "/clock", 10)

        def tick() -> None:
            message = Clock()
            message.clock = joint_state().header.stamp
            publisher.publish(message)

        harness.node.create_timer(1 / 40, tick)
        harness.node.create_timer(1 / 250, lambda: harness.send(joint_state()))

        def verdicts() -> list[int]:
            return [contact.verdict for contact in harness.contact_states[-250:]]

        # A second in which the sender was not held up by a busy machine. Without the tolerance for the step of the
        # clock there never is an OK.
        harness.spin_until(lambda: len(verdicts()) == 250 and verdicts().count(ContactState.OK) > 0.9 * 250)

    def test_without_a_clock_every_stamp_lies_in_the_future(self, new_harness: Callable[..., NodeHarness]) -> None:
        harness = new_harness("--ros-args", "-p", "use_sim_time:=true")
        harness.subscribe()
        harness.spin_until(
            lambda: any("in the future" in c.reason for c in harness.contact_states),
            repeat=lambda: harness.send(joint_state()),
        )
        assert {contact.verdict for contact in harness.contact_states} == {ContactState.UNKNOWN}


TWO_LINKS = """<robot name="two_link">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0.2 0 0"/><mass value="2.0"/>
    <inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="fore"><inertial><origin xyz="0.15 0 0"/><mass value="1.0"/>
    <inertia ixx="0.005" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="hand"><inertial><mass value="0.3"/>
    <inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" velocity="3" effort="9"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0.4 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="3" effort="9"/></joint>
  <joint name="wrist" type="fixed"><parent link="fore"/><child link="hand"/><origin xyz="0.3 0 0"/></joint>
</robot>"""


SLOW_READER = """
import sys, time
from pathlib import Path
from scara_effmass.nodes import monitor_node, robot_input
parse = robot_input.parse_urdf
def parse_later(text, *arguments):
    while "LATE" in text and not Path("read").exists():
        time.sleep(0.01)
    return parse(text, *arguments)
robot_input.parse_urdf = parse_later
raise SystemExit(monitor_node.main())
"""
NAMES = ", ".join(assumption.name.lower() for assumption in Assumption)
ACCEPT_ALL = ("-p", f"accept_assumptions:=[{NAMES}]")


class TestRobotDescription:
    def test_watchdog_says_that_a_description_is_being_read(
        self, new_harness: Callable[..., NodeHarness], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.chdir(tmp_path)
        harness = new_harness()
        arguments = ("--ros-args", "-p", "await_robot_description:=true", "-p", "timeout:=0.5", *ACCEPT_ALL)
        harness.start(*arguments, "-p", "release_time:=0.0", command=(sys.executable, "-c", SLOW_READER))
        harness.subscribe()
        publisher = harness.node.create_publisher(String, "robot_description", INFO)

        def send() -> None:
            harness.send(joint_state(names=("shoulder", "elbow"), position=(0.3, 1.2), velocity=(0.01, -0.01)))

        def count(code: int) -> int:
            return sum(answer.reason_code == code for answer in harness.contact_states)

        publisher.publish(String(data=TWO_LINKS))
        harness.spin_until(lambda: count(Reason.NONE), repeat=send)
        harness.contact_states.clear()
        publisher.publish(String(data=TWO_LINKS.replace("two_link", "LATE")))
        harness.spin_until(lambda: count(Reason.ROBOT_CHANGES), repeat=send)
        harness.contact_states.clear()
        harness.spin_until(lambda: len(harness.contact_states) > 3, repeat=send)
        assert {answer.reason for answer in harness.contact_states} == {"a new robot_description is being read"}
        (tmp_path / "read").touch()
        harness.contact_states.clear()
        harness.spin_until(lambda: count(Reason.NONE), repeat=send)

    def test_robot_description_is_awaited_and_may_be_replaced(self, new_harness: Callable[..., NodeHarness]) -> None:
        harness = new_harness(
            "--ros-args",
            *("-p", "await_robot_description:=true"),
            *("-p", "effective_mass_model:=full"),
            *("-p", "release_time:=0.0"),
            *("-p", "timeout:=60.0"),
            *ACCEPT_ALL,
        )
        harness.subscribe()
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        descriptions = harness.node.create_publisher(String, "robot_description", latched)

        def contact_of(reason: str) -> Answer:
            def send() -> None:
                harness.send(joint_state(names=("shoulder", "elbow"), position=(0.3, 1.2), velocity=(0.1, -0.2)))

            def matching() -> Answer | None:
                return next(
                    (c for c in harness.contact_states if c.reason.startswith(reason) and (reason or not c.reason)),
                    None,
                )

            harness.contact_states.clear()
            contact: Answer = harness.spin_until(matching, repeat=send)
            return contact

        assert contact_of("no robot_description yet").verdict == ContactState.UNKNOWN
        descriptions.publish(String(data="<robot>"))
        assert contact_of("robot_description: ").verdict == ContactState.UNKNOWN
        descriptions.publish(String(data=TWO_LINKS))
        valid = contact_of("")
        assert (valid.verdict, valid.contact_point, valid.header.frame_id) == (ContactState.OK, "hand", "base")
        assert valid.effective_mass == valid.full_mass > 0.0
        descriptions.publish(String(data=TWO_LINKS.replace('mass value="2.0"', 'mass value="heavy"')))
        invalid = contact_of("robot_description: ")
        assert (invalid.verdict, invalid.contact_point, invalid.allowable_speed) == (ContactState.UNKNOWN, "", 0.0)
        descriptions.publish(String(data=TWO_LINKS))
        assert contact_of("").verdict == ContactState.OK
        descriptions.publish(String(data=TWO_LINKS.replace("hand", "flange")))
        harness.spin_until(lambda: contact_of("").contact_point == "flange")
        # A volatile publisher does not match a transient-local subscription.
        harness.node.create_publisher(String, "robot_description", 1)
        assert "a publisher of robot_description cannot be connected: its DURABILITY" in harness.diagnostic(
            "input", "incompatible QoS", bool
        )


SENDER = """
import os, sys, time
import rclpy
from sensor_msgs.msg import JointState
rclpy.init()
node = rclpy.create_node("sender")
publisher = node.create_publisher(JointState, "joint_states", 5000)
message = JointState(name=["joint1", "joint2", "joint3", "joint4"], position=[0.3, 1.2, 0.1, -0.4])
message.velocity = [0.01, -0.01, 0.003, 0.01]
def send():
    now = time.time_ns()
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(now, 10**9)
    publisher.publish(message)
    return now
os.set_blocking(0, False)
permits = 0
def permitted():  # each byte read permits one more message
    global permits
    data = sys.stdin.buffer.raw.read()
    if data == b"":
        sys.exit("the test has ended")
    permits += len(data or b"")
    return permits
while not permitted():
    send()  # until the test has received a response
    time.sleep(0.1)
due = time.monotonic()
stamps = []
for number in range(int(sys.argv[1])):
    due += 1e-3
    time.sleep(max(0.0, due - time.monotonic()))
    while number >= permitted():
        time.sleep(1e-3)
    stamps.append(send())
with open(sys.argv[2], "w") as file:
    print(*stamps, "end", file=file)
os.set_blocking(0, True)
sys.stdin.buffer.raw.read()  # exiting now would lose the last messages
rclpy.shutdown()
"""
MAX_PENDING = 500
"""Maximum number of unanswered joint states, half of the monitor's queue, so that a slow monitor drops none."""


def test_links_as_a_whole_are_in_the_message(new_harness: Callable[..., NodeHarness]) -> None:
    harness = new_harness("--ros-args", "-p", "contact_points:=[whole_arm]")
    harness.subscribe()
    contacts = harness.send_until_ok().message.contacts
    assert [contact.contact_point for contact in contacts] == ["tool", "elbow", "link1", "link2", "link3", "link4"]
    tool, link2 = contacts[0], contacts[3]
    corner = np.array([link2.position_in_link.x, link2.position_in_link.y, link2.position_in_link.z])
    assert np.abs(corner - [0.1375, 0.0, 0.1]) == pytest.approx([0.2125, 0.075, 0.1], abs=1e-3)
    assert tool.position_in_link.x == tool.position_in_link.y == 0.0
    assert link2.position.x != 0.0


def test_every_joint_state_of_a_1_khz_stream_is_answered(
    new_harness: Callable[..., NodeHarness], tmp_path: Path
) -> None:
    harness = new_harness("--ros-args", "-p", "timeout:=60.0")
    harness.node.create_subscription(
        ContactStates, "contact_states", harness.on_contact_states, QoSProfile(depth=20_000)
    )
    stamps = tmp_path / "stamps"
    stamps.touch()
    command = [sys.executable, "-c", SENDER, "5000", str(stamps)]
    environment = {**os.environ, "ROS_DOMAIN_ID": str(harness.domain)}
    with subprocess.Popen(command, stdin=subprocess.PIPE, bufsize=0, env=environment) as sender:
        permits = sender.stdin
        assert permits is not None
        harness.spin_until(lambda: any(contact.verdict == ContactState.OK for contact in harness.contact_states))
        answered = len(harness.contact_states) - MAX_PENDING

        def permit() -> None:
            nonlocal answered
            permits.write(b"." * (len(harness.contact_states) - answered))
            answered = len(harness.contact_states)

        harness.spin_until(lambda: stamps.read_text().endswith("end\n"), repeat=permit)
        sent = [int(stamp) for stamp in stamps.read_text().split()[:-1]]
        harness.spin_until(lambda: stamp_ns(harness.contact_states[-1]) >= sent[-1])
        permits.close()
        assert sender.wait() == 0
    assert len(sent) == 5000
    assert [stamp for stamp in map(stamp_ns, harness.contact_states) if stamp >= sent[0]] == sent
    assert harness.contact_states[-1].verdict == ContactState.OK
