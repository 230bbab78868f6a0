# SPDX-License-Identifier: Apache-2.0
"""Each input that a verdict rests on has exactly one publisher: a second one gives UNKNOWN with a reason."""

import sys
import time
from collections.abc import Callable, Sequence

import pytest
from builtin_interfaces.msg import Time
from rcl_interfaces.msg import Log
from rclpy.duration import Duration
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from scara_effmass_msgs.msg import ContactState
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from scara_effmass.codes import Reason
from scara_effmass.nodes.latched_input import LatchedInput
from scara_effmass.nodes.lifecycle import LifecycleBase
from scara_effmass.nodes.parameters import NodeParameters
from scara_effmass.nodes.ros import spin_for
from scara_effmass.wire.topics import DESCRIPTION_QOS
from test.nodes.conftest import Answer, NodeHarness, joint_state, ros_node
from test.nodes.test_monitor_node import ACCEPT_ALL, INFO, TWO_LINKS

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
LIGHT = TWO_LINKS.replace('mass value="2.0"', 'mass value="1.0"')
AWAIT = ("-p", "await_robot_description:=true", "-p", "effective_mass_model:=full", "-p", "timeout:=60.0", *ACCEPT_ALL)
TWO = "2 publishers of robot_description: must be one"
UNNUMBERED = """
from scara_effmass.nodes import monitor_node
answer = monitor_node.MonitorNode._answer
def without_number(node, data, info):
    answer(node, data, {**info, "publication_sequence_number": None, "received_timestamp": 0})
monitor_node.MonitorNode._answer = without_number
raise SystemExit(monitor_node.main())
"""


def until(harness: NodeHarness, accept: Callable[[Answer], bool], send: Callable[[], object]) -> Answer:
    """Return the first new answer that `accept` accepts, while `send` is repeated."""
    harness.contact_states.clear()
    answer: Answer = harness.spin_until(lambda: next(filter(accept, harness.contact_states), None), repeat=send)
    return answer


def is_ok(answer: Answer) -> bool:
    return bool(answer.verdict == ContactState.OK)


def has(reason: str) -> Callable[[Answer], bool]:
    return lambda answer: reason in answer.reason


class Arm:
    """A monitor that takes its robot from robot_description, and an arm that moves it."""

    def __init__(self, harness: NodeHarness) -> None:
        self.harness = harness
        self.logged: list[str] = []
        harness.node.create_subscription(Log, "/rosout", self.on_log, INFO)
        harness.subscribe()

    def on_log(self, message: Log) -> None:
        self.logged.append(message.msg)

    def describe(self, text: str) -> Publisher:
        publisher = self.harness.node.create_publisher(String, "robot_description", LATCHED)
        publisher.publish(String(data=text))
        return publisher

    def send(self, velocity: Sequence[float] = (0.01, -0.01)) -> None:
        self.harness.send(joint_state(names=("shoulder", "elbow"), position=(0.3, 1.2), velocity=velocity))

    def until(self, accept: Callable[[Answer], bool]) -> Answer:
        return until(self.harness, accept, self.send)


@pytest.fixture
def start_arm(new_harness: Callable[..., NodeHarness]) -> Callable[..., Arm]:
    return lambda *options: Arm(new_harness("--ros-args", *AWAIT, *options))


def test_second_robot_description_gives_unknown_until_one_is_left(start_arm: Callable[..., Arm]) -> None:
    arm = start_arm("-p", "release_time:=0.0")
    heavy_publisher = arm.describe(TWO_LINKS)
    heavy = arm.until(is_ok)
    light_publisher = arm.describe(LIGHT)
    unknown = arm.until(has(TWO))
    assert (unknown.verdict, unknown.reason_code) == (ContactState.UNKNOWN, Reason.TWO_PUBLISHERS)
    assert (unknown.contact_point, unknown.allowable_speed, unknown.speed_scaling) == ("hand", 0.0, 0.0)
    heavy_publisher.publish(String(data=TWO_LINKS))  # identical, but whose is right?
    light_publisher.publish(String(data=LIGHT))
    for _ in range(3):
        arm.until(has(TWO))
    assert {answer.verdict for answer in arm.harness.contact_states} == {ContactState.UNKNOWN}
    arm.harness.node.destroy_publisher(light_publisher)
    again = arm.until(is_ok)  # without a new message of the first one
    assert (again.full_mass, again.scope) == (heavy.full_mass, heavy.scope)
    assert not any("the robot changed" in line for line in arm.logged)
    light_publisher = arm.describe(LIGHT)
    arm.until(has(TWO))
    arm.harness.node.destroy_publisher(heavy_publisher)
    light = arm.until(is_ok)
    assert light.full_mass < heavy.full_mass
    assert any("the robot changed" in line for line in arm.logged)


def test_identical_description_changes_nothing_and_another_one_shows(start_arm: Callable[..., Arm]) -> None:
    arm = start_arm("-p", "release_time:=60.0")
    publisher = arm.describe(TWO_LINKS)
    arm.harness.spin_until(lambda: any("monitoring two_link" in line for line in arm.logged))
    arm.until(is_ok)
    arm.send((2.9, 2.9))
    held = until(arm.harness, has("held after: "), arm.send)
    assert held.verdict == ContactState.VIOLATION
    for _ in range(3):
        publisher.publish(String(data=TWO_LINKS))
    end = time.monotonic() + 1.0
    arm.until(lambda _: time.monotonic() > end)
    assert {answer.verdict for answer in arm.harness.contact_states} == {ContactState.VIOLATION}
    assert sum("monitoring two_link" in line for line in arm.logged) == 1

    publisher.publish(String(data=LIGHT))
    reading = arm.until(lambda answer: answer.reason_code == Reason.ROBOT_CHANGES)  # long before the watchdog
    assert (reading.verdict, reading.contact_point) == (ContactState.UNKNOWN, "hand")
    assert (reading.allowable_speed, reading.speed_scaling) == (0.0, 0.0)
    changed = arm.until(has("the robot changed"))
    before, after = (answer.scope.rpartition("; robot ")[2] for answer in (held, changed))
    assert before != after
    assert changed.reason == f"held after: the robot changed from {before} to {after}"
    assert changed.verdict == ContactState.UNKNOWN
    assert arm.harness.diagnostic("model", "robot", after.__eq__)
    assert any(f"the robot changed from {before} to {after}" in line for line in arm.logged)


def test_description_that_is_not_latched_says_so(start_arm: Callable[..., Arm]) -> None:
    arm = start_arm("-p", "release_time:=0.0")
    volatile = arm.harness.node.create_publisher(String, "robot_description", 1)
    misfit = "no publisher of robot_description fits: must be reliable and latched (durability transient_local)"
    assert arm.until(has(misfit)).verdict == ContactState.UNKNOWN
    arm.harness.node.destroy_publisher(volatile)
    arm.until(has("no publishers of robot_description: must be one"))
    arm.describe(TWO_LINKS)
    arm.until(is_ok)


def test_changed_robot_is_latched(start_arm: Callable[..., Arm]) -> None:
    arm = start_arm("-p", "release_time:=0.0", "-p", "latch:=true")
    publisher = arm.describe(TWO_LINKS)
    arm.until(is_ok)
    publisher.publish(String(data=LIGHT))
    assert arm.until(has("latched until reset: hand: the robot changed")).verdict == ContactState.UNKNOWN


def test_second_publisher_of_commands_gives_unknown(new_harness: Callable[..., NodeHarness]) -> None:
    harness = new_harness("--ros-args", "-p", "command_tolerance:=0.1", "-p", "timeout:=0.5", "-p", "release_time:=0.0")
    harness.subscribe()
    first, second = (harness.node.create_publisher(JointState, "joint_commands", 10) for _ in range(2))

    def send(*publishers: Publisher) -> None:
        for publisher in publishers:
            publisher.publish(joint_state(velocity=()))
        harness.send(joint_state())

    until(harness, is_ok, lambda: send(first))
    unknown = until(harness, has("a second publisher of joint commands"), lambda: send(first, second))
    assert (unknown.verdict, unknown.reason_code) == (ContactState.UNKNOWN, Reason.TWO_PUBLISHERS)
    assert unknown.allowable_speed == 0.0
    until(harness, is_ok, lambda: send(first))
    gripper = harness.node.create_publisher(JointState, "joint_commands", 10)

    def send_beside_gripper() -> None:
        gripper.publish(joint_state(names=("finger",), position=(0.0,), velocity=()))
        send(first)

    for _ in range(3):
        until(harness, is_ok, send_beside_gripper)
    assert {answer.verdict for answer in harness.contact_states} == {ContactState.OK}


@pytest.mark.usefixtures("default_context")
def test_publisher_that_comes_and_goes_while_the_node_is_busy_does_not_count() -> None:
    node, heard = LifecycleBase("receiver", NodeParameters), list[str]()
    LatchedInput(node, String, "text", DESCRIPTION_QOS, lambda m: heard.append(m.data), heard.append, raw=False)
    executor = EventsExecutor()
    executor.add_node(node)
    with ros_node("sender") as sender:

        def await_publishers(count: int) -> None:
            while node.count_publishers("text") != count:
                time.sleep(0.01)

        def publish(text: str) -> Publisher:
            publisher = sender.create_publisher(String, "text", LATCHED)
            publisher.publish(String(data=text))
            while not publisher.get_subscription_count():
                time.sleep(0.01)
            assert publisher.wait_for_all_acked(Duration(seconds=60))
            return publisher

        def heard_until(last: str) -> list[str]:
            heard.clear()
            spin_for(executor, 60.0, lambda: heard[-1:] == [last])
            return heard

        first = publish("first")
        assert heard_until("first") == ["first"]
        sender.destroy_publisher(publish("second"))
        await_publishers(1)
        reasons = "2 publishers of text: must be one", "no text since it had several publishers"
        *before, last = heard_until("first")
        assert last == "first"
        # The new subscription may still meet the second publisher, which then counts once more.
        assert before == [*reasons] * (len(before) // 2) != []
        sender.destroy_publisher(first)  # one after the other is a restart
        await_publishers(0)
        spin_for(executor, 0.5)
        publish("restarted")
        assert heard_until("restarted") == ["restarted"]
    executor.shutdown()
    node.destroy_node()


def test_slow_second_publisher_of_joint_states_gives_unknown_between_its_messages(harness: NodeHarness) -> None:
    second = harness.node.create_publisher(JointState, "joint_states", 10)

    def send() -> None:
        harness.send(joint_state())
        second.publish(joint_state())

    try:
        until(harness, has("2 publishers of joint states"), send)
        for _ in range(3):  # the second one is silent meanwhile
            reason = "2 publishers of joint states: only one may send the robot's joints"
            between = until(harness, has(reason), lambda: harness.send(joint_state()))
            assert (between.reason_code, between.allowable_speed) == (Reason.TWO_PUBLISHERS, 0.0)
            assert {answer.verdict for answer in harness.contact_states} == {ContactState.UNKNOWN}
    finally:
        harness.node.destroy_publisher(second)
    harness.send_until_ok()


def test_several_publishers_of_joint_states_give_unknown_where_messages_have_no_numbers(
    new_harness: Callable[..., NodeHarness],
) -> None:
    """As with Cyclone DDS, for which rclpy gives None."""
    harness = new_harness()
    arguments = ("--ros-args", "-p", "release_time:=0.0", "-p", "timeout:=60.0")
    harness.start(*arguments, command=(sys.executable, "-c", UNNUMBERED))
    harness.subscribe_until_ok()
    second = harness.node.create_publisher(JointState, "joint_states", 10)
    unknown = until(harness, has("2 publishers of joint states"), lambda: harness.send(joint_state()))
    assert (unknown.reason_code, unknown.allowable_speed) == (Reason.TWO_PUBLISHERS, 0.0)
    harness.node.destroy_publisher(second)
    until(harness, is_ok, lambda: harness.send(joint_state()))


def test_restarted_driver_beside_a_gripper_is_no_second_publisher(new_harness: Callable[..., NodeHarness]) -> None:
    harness = new_harness("--ros-args", "-p", "release_time:=0.0", "-p", "timeout:=60.0")
    harness.subscribe()
    gripper, driver = (harness.node.create_publisher(JointState, "joint_states", 10) for _ in range(2))

    def send() -> None:
        gripper.publish(joint_state(names=("finger",), position=(0.0,), velocity=()))
        driver.publish(joint_state())

    for _ in range(3):
        until(harness, is_ok, send)
    harness.node.destroy_publisher(driver)
    driver, restart = harness.node.create_publisher(JointState, "joint_states", 10), time.monotonic()
    until(harness, has("a second publisher, or a restarted one"), send)
    until(harness, is_ok, send)
    assert time.monotonic() < restart + 9.0  # not after the 10 s of a second publisher


def test_second_clock_gives_unknown(new_harness: Callable[..., NodeHarness]) -> None:
    harness = new_harness("--ros-args", "-p", "use_sim_time:=true", "-p", "release_time:=0.0", "-p", "timeout:=60.0")
    harness.subscribe()
    clock = harness.node.create_publisher(Clock, "/clock", 10)

    def send() -> None:
        seconds, nanoseconds = divmod(time.time_ns(), 10**9)
        clock.publish(Clock(clock=Time(sec=seconds, nanosec=nanoseconds)))
        harness.send(joint_state())

    until(harness, is_ok, send)
    second = harness.node.create_publisher(Clock, "/clock", 10)
    unknown = until(harness, has("2 publishers of /clock: must be one"), send)
    assert (unknown.verdict, unknown.allowable_speed) == (ContactState.UNKNOWN, 0.0)
    harness.node.destroy_publisher(second)
    until(harness, is_ok, send)
