"""The live monitor and its input: every bad joint state is UNKNOWN, and the next good one is OK again."""

from __future__ import annotations

import struct
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from scara_effmass_msgs.msg import ContactState
from sensor_msgs.msg import JointState as JointStateMessage

from scara_effmass.model.dynamics import RobotDynamics
from scara_effmass.model.load import load_robot
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share
from scara_effmass.values import JointState

if TYPE_CHECKING:
    from collections.abc import Sequence

    from scara_effmass.values import ContactAssessment
    from test.nodes.conftest import NodeHarness

JOINTS = ("joint1", "joint2", "joint3", "joint4")
Q = (0.3, 1.2, 0.1, -0.4)
QD = (0.1, -0.2, 0.05, 0.3)
NAN, INF = float("nan"), float("inf")
S = 1_000_000_000
MS = 1_000_000


def message(
    stamp_ns: int | None = None,
    names: Sequence[str] = JOINTS,
    position: Sequence[float] = Q,
    velocity: Sequence[float] = QD,
) -> JointStateMessage:
    made = JointStateMessage(name=list(names), position=list(position), velocity=list(velocity))
    made.header.stamp.sec, made.header.stamp.nanosec = divmod(time.time_ns() if stamp_ns is None else stamp_ns, S)
    return made


def stamp_of(contact: ContactState) -> int:
    return int(contact.header.stamp.sec * S + contact.header.stamp.nanosec)


def assert_nothing_allowed(harness: NodeHarness, contact: ContactState, reason: str) -> None:
    assert contact.verdict == ContactState.UNKNOWN
    assert contact.reason.startswith(reason), contact.reason
    assert contact.allowable_speed == 0.0
    assert {topic: values[-1] for topic, values in harness.scalars.items()} == {
        "allowable_speed": 0.0,
        "speed_scaling": 0.0,
    }


BAD: dict[str, tuple[dict[str, Any], str]] = {
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
    "stamp zero": ({"stamp_ns": 0}, "the header stamp is zero"),
    "negative stamp": ({"stamp_ns": -3 * S}, "the header stamp is zero"),
    "last second of time": ({"stamp_ns": (2**31 - 1) * S}, "the header stamp is "),
}


@pytest.mark.parametrize(("fields", "reason"), BAD.values(), ids=BAD.keys())
def test_bad_input_is_unknown_until_good_input_returns(
    harness: NodeHarness, fields: dict[str, Any], reason: str
) -> None:
    assert_nothing_allowed(harness, harness.response_to(message(**fields)), reason)
    better = message()
    answer = harness.response_to(better)
    assert (answer.verdict, answer.reason) == (ContactState.OK, "")
    assert answer.header.stamp == better.header.stamp
    assert harness.scalars["allowable_speed"][-1] == answer.allowable_speed > 0.0
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
def test_a_stamp_out_of_order_is_unknown(harness: NodeHarness, shift_ns: int, reason: str) -> None:
    first = harness.response_to(message())
    assert_nothing_allowed(harness, harness.response_to(message(stamp_of(first) + shift_ns)), reason)
    assert harness.response_to(message()).verdict == ContactState.OK


def test_velocity_of_zero_while_moving_is_unknown(harness: NodeHarness) -> None:
    """As a sender does that never fills the velocity in: it stands, and then moves at 1 rad/s."""
    start = time.time_ns()
    standing = [harness.response_to(message(start + i * MS // 100, velocity=(0.0,) * 4)) for i in range(3)]
    assert {answer.verdict for answer in standing} == {ContactState.OK}
    moving = [
        harness.response_to(message(start + i * MS, position=(Q[0] + 1e-3 * i, *Q[1:]), velocity=(0.0,) * 4))
        for i in range(1, 15)
    ]
    assert moving[-1].verdict == ContactState.UNKNOWN
    assert any(answer.reason.startswith("joint1 moved 0.0") for answer in moving)
    harness.send_until_ok()


def test_bytes_that_are_no_joint_state_are_unknown(harness: NodeHarness) -> None:
    whole = serialize_message(message())
    broken = bytearray(whole)
    broken[12:16] = struct.pack("<I", 1_000_000)  # a frame id of a million bytes
    assert_nothing_allowed(harness, harness.response_to(bytes(broken)), "JointState: ")
    assert harness.response_to(message()).verdict == ContactState.OK


def test_silence_is_unknown_after_the_timeout(harness: NodeHarness) -> None:
    assert harness.set_parameters(timeout=0.05) == ""
    try:
        last = harness.send_until_ok()
        silent = harness.watchdog_response()
        assert_nothing_allowed(harness, silent, "no joint state for 0.")
        assert stamp_of(silent) >= stamp_of(last)
        assert silent.input_age >= 0.05
    finally:
        assert harness.set_parameters(timeout=60.0) == ""
    harness.send_until_ok()


def test_names_decide_and_never_the_order(harness: NodeHarness) -> None:
    stamp = time.time_ns()
    plain = harness.response_to(message(stamp))
    mixed = harness.response_to(
        message(
            stamp + 1,
            ("gripper", "joint4", "joint2", "rail", "joint1", "joint3"),
            (NAN, Q[3], Q[1], 9e9, Q[0], Q[2]),
            (INF, QD[3], QD[1], -7.0, QD[0], QD[2]),
        )
    )
    assert mixed.verdict == ContactState.OK
    assert bits(mixed, without=("header", "input_age")) == bits(plain, without=("header", "input_age"))


def test_another_device_on_the_topic_is_counted_and_left_alone(harness: NodeHarness) -> None:
    last = harness.response_to(message())
    for _ in range(3):
        harness.send(message(names=("left_finger", "right_finger"), position=(0.0, 0.0), velocity=()))
    after = harness.response_to(message())
    assert (last.verdict, after.verdict) == (ContactState.OK, ContactState.OK)
    assert [contact.verdict for contact in harness.contact_states] == [ContactState.OK]
    assert harness.diagnostic("input", "of other devices", lambda value: value == "3")


@pytest.mark.parametrize("reliability", [ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE])
def test_second_publisher_of_either_reliability_is_heard_and_reported(
    harness: NodeHarness, reliability: ReliabilityPolicy
) -> None:
    second = harness.node.create_publisher(
        JointStateMessage, "joint_states", QoSProfile(depth=10, reliability=reliability)
    )
    sent = []

    def send() -> None:
        sent.append(message())
        second.publish(sent[-1])

    try:
        harness.spin_until(
            lambda: sent and any(c.header.stamp == sent[-1].header.stamp for c in harness.contact_states), repeat=send
        )
        assert harness.diagnostic("input", "publishers", lambda value: value == "2").startswith(
            "2 publishers of joint states, handled as one stream"
        )
    finally:
        harness.node.destroy_publisher(second)
    harness.diagnostic("input", "publishers", lambda value: value == "1")


def test_empty_velocity_may_be_allowed(harness: NodeHarness) -> None:
    assert harness.set_parameters(differentiate_velocity=True) == ""
    try:
        stamp = time.time_ns()
        harness.response_to(message(stamp, velocity=()))
        step = 10 * MS
        moved = tuple(q + qd * step / S for q, qd in zip(Q, QD, strict=True))
        answer = harness.response_to(message(stamp + step, position=moved, velocity=()))
        assert answer.verdict == ContactState.OK
        assert answer.speed == pytest.approx(
            harness.response_to(message(stamp + step + 1, position=moved)).speed, rel=1e-9
        )
    finally:
        assert harness.set_parameters(differentiate_velocity=False) == ""


def test_a_subscriber_that_cannot_be_connected_is_named(harness: NodeHarness) -> None:
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    wanting = harness.node.create_subscription(ContactState, "contact_state", lambda _: None, latched)
    found = harness.diagnostic("input", "incompatible QoS", bool)
    harness.node.destroy_subscription(wanting)
    assert found.endswith("a subscriber of contact_state cannot be connected: its DURABILITY does not fit")


def bits(contact: ContactState | ContactAssessment, without: tuple[str, ...] = ("input_age",)) -> dict[str, object]:
    """Return every field, floats as the bytes they are."""
    if isinstance(contact, ContactState):
        fields: dict[str, Any] = {name: getattr(contact, name) for name in contact.get_fields_and_field_types()}
        fields["direction"] = (contact.direction.x, contact.direction.y, contact.direction.z)
        if "header" not in without:
            fields["stamp_ns"] = stamp_of(contact)
        del fields["header"]
    else:
        fields = contact._asdict()
        fields["verdict"] = int(fields["verdict"])
    return {
        name: struct.pack(f"{np.size(value)}d", *np.ravel(value))
        if isinstance(value, float) or name == "direction"
        else value
        for name, value in fields.items()
        if name not in without
    }


def test_live_equals_offline_bit_for_bit(harness: NodeHarness) -> None:
    """A random walk with every kind of bad joint state in between, through DDS and through the core alone."""
    random = np.random.default_rng(20_250_411)
    # Stamps 10 ms apart, whatever the time between the messages: they run ahead of the clock.
    changed = {"release_time": 0.05, "reference_speed": 0.4, "timeout": 60.0, "future_tolerance": 10.0}
    settings = MonitorSettings.model_validate(changed)
    offline = Monitor(RobotDynamics(load_robot(share("config", "omron_i4_550l.yaml"), settings)), settings)
    q = np.array(Q)
    bad = [fields for fields, _ in BAD.values() if "stamp_ns" not in fields]
    verdicts = set()
    assert harness.set_parameters(**changed) == ""
    try:
        begun = time.time_ns()
        for i in range(500):
            stamp = begun + (i - (i % 17 == 16)) * 10 * MS
            velocity = random.normal(0.0, 0.8, 4) * (random.random() < 0.9)
            q = np.clip(q + 0.02 * velocity, (-2.0, -2.4, 0.01, -3.0), (2.0, 2.4, 0.44, 3.0))
            fields = {"position": q.tolist(), "velocity": velocity.tolist()}
            sent = message(stamp, **{**fields, **(bad[i // 11 % len(bad)] if i % 11 == 10 else {})})
            live = harness.response_to(sent)
            decision = offline.assess(
                JointState(stamp, tuple(sent.name), np.array(sent.position), np.array(sent.velocity)), stamp
            )
            assert decision is not None
            if i >= 10:  # what the shared node was sent before is forgotten by then
                assert bits(live) == bits(decision.contacts[0])
                assert harness.scalars["allowable_speed"] == [decision.allowable_speed]
                assert harness.scalars["speed_scaling"] == [decision.speed_scaling]
                verdicts.add(int(live.verdict))
    finally:
        assert harness.set_parameters(release_time=0.0, reference_speed=0.0, timeout=60.0, future_tolerance=0.02) == ""
    assert verdicts == {ContactState.UNKNOWN, ContactState.OK, ContactState.WARN, ContactState.VIOLATION}
