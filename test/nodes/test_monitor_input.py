# SPDX-License-Identifier: Apache-2.0
"""Invalid joint states give UNKNOWN in the live monitor, and the next valid one gives OK."""

import os
import signal
import struct
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from scara_effmass_msgs.msg import ContactState, ContactStates
from sensor_msgs.msg import JointState as JointStateMessage
from std_srvs.srv import Trigger

from scara_effmass.codes import Reason
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share
from scara_effmass.values import ContactAssessment, JointState
from scara_effmass.wire.contact_states import decode_contact_states
from test.nodes.conftest import JOINTS, QD, Answer, NodeHarness, Q, joint_state, stamp_ns

NAN, INF = float("nan"), float("inf")
S = 1_000_000_000
MS = 1_000_000


def assert_unknown_at_zero_speed(harness: NodeHarness, contact: Answer, reason: str) -> None:
    assert contact.verdict == ContactState.UNKNOWN
    assert contact.reason.startswith(reason), contact.reason
    assert contact.allowable_speed == 0.0
    assert {topic: values[-1] for topic, values in harness.scalars.items()} == {
        "allowable_speed": 0.0,
        "speed_scaling": 0.0,
    }


INVALID: dict[str, tuple[dict[str, Any], str]] = {
    "missing joint": ({"names": JOINTS[1:], "position": Q[1:], "velocity": QD[1:]}, "joint joint1 is missing"),
    "duplicate names": ({"names": ("joint1", "joint2", "joint3", "joint3")}, "joint joint3 is named twice"),
    "no names": ({"names": ()}, "the joint state has no names"),
    "nothing at all": ({"names": (), "position": (), "velocity": ()}, "the joint state has no names"),
    "empty name": ({"names": ("joint1", "joint2", "", "joint4")}, "name 2 of the joint state is empty"),
    "short position": ({"position": Q[:2]}, "2 positions for 4 names"),
    "long position": ({"position": (*Q, 0.0)}, "5 positions for 4 names"),
    "no position": ({"position": ()}, "0 positions for 4 names"),
    "short velocity": ({"velocity": QD[:3]}, "3 velocities for 4 names"),
    "long velocity": ({"velocity": (*QD, 0.0)}, "5 velocities for 4 names"),
    "no velocity": ({"velocity": ()}, "the velocity is empty"),
    "NaN velocity": ({"velocity": (NAN, *QD[1:])}, "the velocity of joint1 is nan"),
    "infinite velocity": ({"velocity": (*QD[:3], -INF)}, "the velocity of joint4 is -inf"),
    "NaN position": ({"position": (*Q[:2], NAN, Q[3])}, "the position of joint3 is nan"),
    "infinite position": ({"position": (INF, *Q[1:])}, "the position of joint1 is inf"),
    "beyond a limit": ({"position": (2.5, *Q[1:])}, "joint1 at 2.5000 rad lies outside its limits"),
    "impossible speed": ({"velocity": (0.1, 20.0, 0.1, 0.1)}, "joint2 at 20.0000 rad/s exceeds its maximum speed"),
    "stamp zero": ({"stamp_ns": 0}, "the header stamp is zero or negative"),
    "negative stamp": ({"stamp_ns": -3 * S}, "the header stamp is zero or negative"),
    "last second of time": ({"stamp_ns": (2**31 - 1) * S}, "the header stamp is "),
}


@pytest.mark.parametrize(("fields", "reason"), INVALID.values(), ids=INVALID.keys())
def test_invalid_joint_state_gives_unknown_until_the_next_valid_one(
    harness: NodeHarness, fields: dict[str, Any], reason: str
) -> None:
    assert_unknown_at_zero_speed(harness, harness.response_to(joint_state(**fields)), reason)
    valid = joint_state()
    answer = harness.response_to(valid)
    assert (answer.verdict, answer.reason) == (ContactState.OK, "")
    assert answer.header.stamp == valid.header.stamp
    assert harness.scalars["allowable_speed"][-1] == answer.message.allowable_speed > 0.0
    assert harness.scalars["speed_scaling"][-1] == 1.0


@pytest.mark.parametrize(
    ("shift_ns", "reason"),
    [
        (0, "the header stamp is repeated"),
        (-MS, "the header stamp goes back by 0.001000 s"),
        (3600 * S, "the header stamp is "),
        (-200 * S, "the joint state is 20"),
    ],
    ids=["repeated", "backwards", "in the future", "old"],
)
def test_invalid_stamp_gives_unknown(harness: NodeHarness, shift_ns: int, reason: str) -> None:
    first = harness.response_to(joint_state())
    assert_unknown_at_zero_speed(harness, harness.response_to(joint_state(stamp_ns(first) + shift_ns)), reason)
    assert harness.response_to(joint_state()).verdict == ContactState.OK


def test_zero_velocity_while_moving_gives_unknown(new_harness: Callable[..., NodeHarness]) -> None:
    """A driver that never sets the velocity: the robot stands still, then moves at 1 rad/s.

    A node of its own: what the joint states of other tests left of the error would add to it.
    """
    overrides = ("release_time:=0.0", "timeout:=60.0", "future_tolerance:=10.0")
    harness = new_harness("--ros-args", *(word for override in overrides for word in ("-p", override)))
    harness.subscribe_until_ok()
    start = time.time_ns()
    for _ in range(20):
        start += 100 * MS
        harness.response_to(joint_state(start, velocity=(0.0,) * 4))
    start += MS
    standing = [harness.response_to(joint_state(start + i * MS // 100, velocity=(0.0,) * 4)) for i in range(3)]
    assert {answer.verdict for answer in standing} == {ContactState.OK}
    moving = [
        harness.response_to(joint_state(start + i * MS, position=(Q[0] + 1e-3 * i, *Q[1:]), velocity=(0.0,) * 4))
        for i in range(1, 15)
    ]
    assert moving[-1].verdict == ContactState.UNKNOWN
    assert any(answer.reason.startswith("the position of joint1 is +0.01") for answer in moving)
    still = [
        harness.response_to(joint_state(start + i * 100 * MS, position=(Q[0] + 0.014, *Q[1:]), velocity=(0.0,) * 4))
        for i in range(1, 21)
    ]
    assert still[-1].verdict == ContactState.OK


def test_corrupt_message_gives_unknown(harness: NodeHarness) -> None:
    whole = serialize_message(joint_state())
    broken = bytearray(whole)
    broken[12:16] = struct.pack("<I", 1_000_000)  # frame_id of 1 000 000 bytes
    sent_ns = time.time_ns()
    response = harness.response_to(bytes(broken))
    assert_unknown_at_zero_speed(harness, response, "JointState: ")
    assert stamp_ns(response) >= sent_ns
    assert harness.response_to(joint_state()).verdict == ContactState.OK


def test_missing_joint_states_give_unknown_after_the_timeout(harness: NodeHarness) -> None:
    assert harness.set_parameters(timeout=0.05) == ""
    try:
        last = harness.send_until_ok()
        silent = harness.watchdog_response()
        assert_unknown_at_zero_speed(harness, silent, "no valid joint state for 0.")
        assert stamp_ns(silent) >= stamp_ns(last)
        assert silent.input_age >= 0.05
    finally:
        assert harness.set_parameters(timeout=60.0) == ""
    harness.send_until_ok()


def test_joints_are_matched_by_name_in_any_order(harness: NodeHarness) -> None:
    stamp = time.time_ns()
    plain = harness.response_to(joint_state(stamp))
    mixed = harness.response_to(
        joint_state(
            stamp + 1,
            ("gripper", "joint4", "joint2", "rail", "joint1", "joint3"),
            (0.5, Q[3], Q[1], 9e9, Q[0], Q[2]),
            (0.0, QD[3], QD[1], NAN, QD[0], QD[2]),
        )
    )
    assert mixed.verdict == ContactState.OK
    # The tolerance of the velocities depends on the joint states before.
    depending: dict[str, Any] = {"allowable_speed": 0.0, "margin": 0.0, "force_bound": 0.0}
    assert bits(contact_of(mixed)._replace(**depending)) == bits(contact_of(plain)._replace(**depending))


def test_joint_states_of_another_device_are_counted_and_ignored(harness: NodeHarness) -> None:
    last = harness.response_to(joint_state())
    for _ in range(3):
        harness.send(joint_state(names=("left_finger", "right_finger"), position=(0.0, 0.0), velocity=()))
    after = harness.response_to(joint_state())
    assert (last.verdict, after.verdict) == (ContactState.OK, ContactState.OK)
    assert [contact.verdict for contact in harness.contact_states] == [ContactState.OK]
    assert harness.diagnostic("input", "of other devices", lambda value: value == "3")
    assert harness.call_service(Trigger, "reset", Trigger.Request()).success  # silent fingers would give UNKNOWN


def input_of(array: DiagnosticArray) -> tuple[str, dict[str, str]]:
    """Return message and values of the status of the joint states."""
    status = next(status for status in array.status if status.name.endswith(": input"))
    return status.message, {pair.key: pair.value for pair in status.values}


def test_joint_states_skipped_or_lost_under_overload_are_counted_and_told(
    new_harness: Callable[..., NodeHarness],
) -> None:
    """On a busy machine they may arrive one by one, so that none is skipped, and some not at all."""
    harness = new_harness("--ros-args", "-p", "timeout:=0.5")
    harness.subscribe_until_ok()
    sent = 0

    def send(age_ns: int = 0) -> None:
        nonlocal sent
        sent += 1
        harness.send(joint_state(time.time_ns() - age_ns))

    def counts() -> tuple[int, int]:
        """Return how many have arrived or were lost, and how many were skipped, from the next diagnostics."""
        since_ns = time.time_ns()
        array = harness.spin_until(lambda: next((a for a in harness.diagnostics if stamp_ns(a) > since_ns), None))
        _, values = input_of(array)
        return int(values["received"]) + int(values["lost"]), int(values["skipped"])

    before, skipped = counts()
    assert harness.process is not None
    while not skipped:
        os.kill(harness.process.pid, signal.SIGSTOP)
        for _ in range(50):
            send(age_ns=S)
        os.kill(harness.process.pid, signal.SIGCONT)
        _, skipped = counts()
    for _ in range(20):  # the next one that arrives shows what was lost before it
        send()
        if (now := counts()[0]) == before + sent:
            break
    assert now == before + sent
    statuses = [(text, values["skipped"]) for text, values in map(input_of, harness.diagnostics)]
    text, count = next((text, count) for text, count in statuses if int(count))
    assert text == f"overload: {count} joint states were skipped for newer ones"


def test_joint_that_moves_outside_the_model_gives_unknown(harness: NodeHarness) -> None:
    """In the joint states of the robot, or in those of another device until it rests."""
    harness.send_until_ok()
    moves = "moves, but is not in the model"
    rail = harness.response_to(joint_state(names=(*JOINTS, "rail"), position=(*Q, 0.0), velocity=(*QD, 1.0)))
    assert (rail.verdict, rail.reason_code) == (ContactState.UNKNOWN, Reason.UNMODELLED_MOTION)
    assert (rail.reason, rail.allowable_speed) == (f"joint rail {moves}", 0.0)
    rests: dict[str, Any] = {"names": (*JOINTS, "rail"), "position": (*Q, 0.0), "velocity": (*QD, 0.0)}
    assert harness.response_to(joint_state(**rests)).reason == f"joint rail {moves}"  # not yet for 0.1 s
    while harness.response_to(joint_state(**rests)).verdict != ContactState.OK:
        pass
    harness.send(joint_state(names=("swing",), position=(0.0,), velocity=(0.5,)))
    assert harness.response_to(joint_state()).reason == f"joint swing {moves}"
    assert harness.diagnostic("input", "moved, but not in the model", lambda value: value == "rail, swing")
    assert harness.call_service(Trigger, "reset", Trigger.Request()).success
    harness.send_until_ok()


@pytest.mark.parametrize("reliability", [ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE])
def test_second_publisher_of_either_reliability_is_received_and_reported(
    harness: NodeHarness, reliability: ReliabilityPolicy
) -> None:
    second = harness.node.create_publisher(
        JointStateMessage, "joint_states", QoSProfile(depth=10, reliability=reliability)
    )
    sent = []

    def send() -> None:
        sent.append(joint_state())
        second.publish(sent[-1])

    try:
        harness.spin_until(
            lambda: sent and any(c.header.stamp == sent[-1].header.stamp for c in harness.contact_states), repeat=send
        )
        assert harness.diagnostic("input", "publishers", lambda value: value == "2").startswith(
            "2 publishers of joint states: only one may send the robot's joints"
        )
    finally:
        harness.node.destroy_publisher(second)
    harness.diagnostic("input", "publishers", lambda value: value == "1")


def test_empty_velocity_is_differentiated_on_request(harness: NodeHarness) -> None:
    assert harness.set_parameters(velocity_source="from_positions") == ""
    try:
        stamp = time.time_ns()
        harness.response_to(joint_state(stamp, velocity=()))
        step = 10 * MS
        moved = tuple(q + qd * step / S for q, qd in zip(Q, QD, strict=True))
        answer = harness.response_to(joint_state(stamp + step, position=moved, velocity=()))
        assert answer.verdict == ContactState.OK
        assert answer.velocity_delay == pytest.approx(0.5 * step / S)
        assert harness.set_parameters(velocity_source="reported") == ""
        stated = harness.response_to(joint_state(stamp + step + 1, position=moved))
        assert answer.speed == pytest.approx(stated.speed, rel=1e-9)
        assert stated.velocity_delay == 0.0
    finally:
        assert harness.set_parameters(velocity_source="reported") == ""


def test_diagnostics_name_a_subscriber_with_incompatible_qos(harness: NodeHarness) -> None:
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    subscriber = harness.node.create_subscription(ContactStates, "contact_states", lambda _: None, latched)
    line = harness.diagnostic("input", "incompatible QoS", bool)
    harness.node.destroy_subscription(subscriber)
    assert line.endswith("a subscriber of contact_states cannot be connected: its DURABILITY does not fit")
    harness.diagnostic("input", "incompatible QoS", lambda value: not value)  # as after one `ros2 topic echo`


def test_gripper_with_a_publisher_of_its_own_is_no_warning(harness: NodeHarness) -> None:
    gripper = harness.node.create_publisher(JointStateMessage, "joint_states", 10)

    def send() -> None:
        gripper.publish(joint_state(names=("finger",), position=(0.0,), velocity=()))
        harness.send(joint_state())

    def both_are_received() -> bool:
        statuses = (s for array in harness.diagnostics for s in array.status if s.name.endswith(": input"))
        values = ({pair.key: pair.value for pair in status.values} | {"": status.message} for status in statuses)
        return any(v["publishers"] == "2" and v["of other devices"] != "0" and "2 pub" not in v[""] for v in values)

    try:
        harness.diagnostics.clear()
        harness.spin_until(both_are_received, repeat=send)
    finally:
        harness.node.destroy_publisher(gripper)


def contact_of(answer: Answer) -> ContactAssessment:
    """Return the first contact of an answer."""
    return decode_contact_states(bytes(serialize_message(answer.message))).contacts[0]


def bits(contact: ContactAssessment) -> list[object]:
    """Return every field, floats as bytes."""
    return [value if isinstance(value, str | int) else np.asarray(value, dtype=float).tobytes() for value in contact]


def test_live_equals_offline_bit_for_bit(new_harness: Callable[..., NodeHarness]) -> None:
    """Compare a random walk with every kind of invalid joint state, through DDS and through the core alone."""
    rng = np.random.default_rng(20_250_411)
    # Stamps are 10 ms apart, on a busy machine more: ahead of the clock, because the acceleration counts for an age.
    overrides = {"release_time": 0.05, "reference_speed": 0.4, "timeout": 60.0, "future_tolerance": 10.0}
    settings = MonitorSettings.model_validate(overrides)
    offline = Monitor(RobotDynamics(load_robot(share("config", "omron_i4_550l.yaml"), settings)), settings)
    q, velocity = np.array(Q), np.zeros(4)
    invalid = [fields for fields, _ in INVALID.values() if "stamp_ns" not in fields]
    verdicts = set()
    harness = new_harness("--ros-args", *(w for item in overrides.items() for w in ("-p", "{}:={}".format(*item))))
    harness.subscribe()
    harness.spin_until(lambda: harness.contact_states, repeat=lambda: harness.send(joint_state(names=())))
    harness.send(joint_state(names=("", *JOINTS[1:])))
    harness.spin_until(lambda: harness.contact_states[-1].reason.startswith("name 0 of"))
    stamp = end_ns = time.time_ns() + 1000 * MS
    for i in range(500):
        begin_ns, end_ns = end_ns, max(end_ns + 10 * MS, time.time_ns() + 1000 * MS)
        stamp = stamp if i % 17 == 16 else end_ns
        last, velocity = velocity, 0.95 * velocity + rng.normal(0.0, 0.25, 4) * (i % 100 < 80) * (1.0, 1.0, 0.1, 1.0)
        moved = (end_ns - begin_ns) / 2e9 * (last + velocity)
        q = np.clip(q + moved, (-2.0, -2.4, 0.01, -3.0), (2.0, 2.4, 0.44, 3.0))
        fields = {"position": q.tolist(), "velocity": velocity.tolist()}
        sent = joint_state(stamp, **{**fields, **(invalid[i // 11 % len(invalid)] if i % 11 == 10 else {})})
        live = harness.response_to(sent)
        now_ns = stamp + round(live.message.input_age * 1e9)  # the acceleration counts for the age
        decision = offline.assess(
            JointState(stamp, tuple(sent.name), np.array(sent.position), np.array(sent.velocity)), now_ns
        )
        assert decision is not None
        if i >= 10:  # the joint states that found the node no longer matter
            decoded = decode_contact_states(bytes(serialize_message(live.message)))
            assert [*map(bits, decoded.contacts)] == [*map(bits, decision.contacts)]
            for name in (
                "stamp_ns",
                "contact_normal",
                "watchdog",
                "velocity_delay",
                "allowable_speed",
                "speed_scaling",
            ):
                assert getattr(decoded, name) == getattr(decision, name)
            assert harness.scalars["allowable_speed"] == [decision.allowable_speed]
            assert harness.scalars["speed_scaling"] == [decision.speed_scaling]
            verdicts.add(int(live.verdict))
    assert verdicts == {ContactState.UNKNOWN, ContactState.OK, ContactState.WARN, ContactState.VIOLATION}


@pytest.mark.parametrize("pose", [Q, (Q[0] + 1.0, *Q[1:])], ids=["same pose", "other pose"])
def test_two_publishers_are_never_merged(harness: NodeHarness, pose: tuple[float, ...]) -> None:
    """They take turns, so each second joint state has a number that does not increase."""
    second = harness.node.create_publisher(JointStateMessage, "joint_states", 10)
    gripper = harness.node.create_publisher(JointStateMessage, "joint_states", 10)
    try:
        harness.spin_until(lambda: second.get_subscription_count() and gripper.get_subscription_count())
        for i in range(6):
            gripper.publish(joint_state(names=("finger",), position=(0.0,), velocity=()))
            harness.send_until_ok() if i == 0 else harness.response_to(joint_state())
            gripper.publish(joint_state(names=("finger",), position=(0.0,), velocity=()))
        assert harness.response_to(joint_state()).verdict == ContactState.OK
        refused = []
        for _ in range(5):
            harness.response_to(joint_state())
            message = joint_state(position=pose)
            second.publish(message)
            refused += harness.spin_until(
                lambda: [c for c in harness.contact_states if c.header.stamp == message.header.stamp]  # noqa: B023
            )
        assert {contact.verdict for contact in refused} == {ContactState.UNKNOWN}
        assert all(contact.reason.startswith("a second publisher, or a restarted one: ") for contact in refused)
    finally:
        harness.node.destroy_publisher(second)
        harness.node.destroy_publisher(gripper)
    harness.send_until_ok()


def test_commands_are_compared_on_request(new_harness: Callable[..., NodeHarness]) -> None:
    harness = new_harness(
        "--ros-args", "-p", "command_tolerance:=0.1", "-p", "timeout:=60.0", "-p", "release_time:=0.0"
    )
    harness.subscribe()
    commands = harness.node.create_publisher(JointStateMessage, "joint_commands", 10)

    def answered(reason: str) -> bool:
        return any(contact.reason.startswith(reason) for contact in harness.contact_states)

    harness.spin_until(lambda: answered("no joint command yet"), repeat=lambda: harness.send(joint_state()))
    commands.publish(b"damaged")
    for position, reason in (((Q[0] + 0.2, *Q[1:]), "joint1 is -0.2000 rad off its command"), (Q, "")):

        def send(position: tuple[float, ...] = position) -> None:
            commands.publish(joint_state(position=position, velocity=()))
            harness.send(joint_state())

        harness.contact_states.clear()
        harness.spin_until(lambda: harness.contact_states and answered(reason), repeat=send)  # noqa: B023
    harness.send_until_ok()


class TestOverload:
    def test_states_in_time_are_all_answered(self, harness: NodeHarness) -> None:
        harness.send_until_ok()
        harness.synchronize()
        sent = []
        for _ in range(60):  # ordinary jitter: they come together
            sent.append(joint_state())
            harness.send(sent[-1])
        harness.spin_until(lambda: any(stamp_ns(c) == stamp_ns(sent[-1]) for c in harness.contact_states))
        answered = [stamp_ns(c) for c in harness.contact_states if not c.watchdog]
        assert answered == [stamp_ns(message) for message in sent]
