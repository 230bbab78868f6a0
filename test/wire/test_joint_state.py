# SPDX-License-Identifier: Apache-2.0
"""JointState messages of rosbags and rclpy are decoded."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import JointState as RosJointState

from scara_effmass.errors import DecodeError
from scara_effmass.values import JointState
from scara_effmass.wire.joint_state import JointStateDecoder, joint_state_message

TYPES = get_typestore(Stores.ROS2_JAZZY)
NS = 10**9

texts = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=12)
numbers = st.lists(st.floats(width=64), max_size=9)
messages = st.fixed_dictionaries(
    {
        "sec": st.integers(-(2**31), 2**31 - 1),
        "nanosec": st.integers(0, 2**32 - 1),
        "frame_id": texts,
        "names": st.lists(texts, max_size=9),
        "position": numbers,
        "velocity": numbers,
        "effort": numbers,
    }
)
Fields = dict[str, Any]


def by_rosbags(fields: Fields, *, little_endian: bool = True) -> bytes:
    types = TYPES.types
    stamp = types["builtin_interfaces/msg/Time"](fields["sec"], fields["nanosec"])
    message = types["sensor_msgs/msg/JointState"](
        types["std_msgs/msg/Header"](stamp, fields["frame_id"]),
        fields["names"],
        *(np.array(fields[name], np.float64) for name in ("position", "velocity", "effort")),
    )
    return bytes(TYPES.serialize_cdr(message, "sensor_msgs/msg/JointState", little_endian=little_endian))


def by_ros(fields: Fields) -> bytes:
    message = RosJointState()
    message.header.stamp.sec = fields["sec"]
    message.header.stamp.nanosec = fields["nanosec"]
    message.header.frame_id = fields["frame_id"]
    message.name = fields["names"]
    message.position, message.velocity, message.effort = fields["position"], fields["velocity"], fields["effort"]
    return bytes(serialize_message(message))


def assert_decoded(state: JointState, fields: Fields) -> None:
    assert state.stamp_ns == fields["sec"] * NS + fields["nanosec"]
    assert state.names == tuple(fields["names"])
    for array, expected in ((state.position, fields["position"]), (state.velocity, fields["velocity"])):
        assert array.dtype == np.float64
        assert array.dtype.isnative
        assert array.flags.aligned
        assert not array.flags.writeable
        assert array.tobytes() == np.array(expected, np.float64).tobytes()


@given(fields=messages, little_endian=st.booleans())
def test_messages_of_rosbags_are_decoded_in_either_byte_order(fields: Fields, *, little_endian: bool) -> None:
    assert_decoded(JointStateDecoder().decode(by_rosbags(fields, little_endian=little_endian)), fields)


@given(messages)
def test_messages_of_rclpy_are_decoded(fields: Fields) -> None:
    """ROS does not clear the padding and appends bytes."""
    assert_decoded(JointStateDecoder().decode(by_ros(fields)), fields)


@given(st.lists(messages, min_size=2, max_size=4), st.data())
def test_one_decoder_reads_changing_messages(several: list[Fields], data: st.DataObject) -> None:
    decoder = JointStateDecoder()
    for fields in data.draw(st.lists(st.sampled_from(several), max_size=10)):
        by = data.draw(st.sampled_from([by_rosbags, by_ros]))
        assert_decoded(decoder.decode(by(fields)), fields)


@given(messages, st.lists(st.tuples(st.floats(width=64), st.integers(0, 2**31 - 1)), min_size=1, max_size=5))
def test_names_stay_the_same_object_while_they_are_equal(fields: Fields, changes: list[tuple[float, int]]) -> None:
    decoder = JointStateDecoder()
    names = decoder.decode(by_rosbags(fields)).names
    for value, sec in changes:
        changed = fields | {"sec": sec, "position": [value] * len(fields["position"])}
        for data in (by_rosbags(changed), by_ros(changed)):
            state = decoder.decode(data)
            assert_decoded(state, changed)
            assert state.names is names


@pytest.mark.parametrize("swapped", [("position", "velocity"), ("velocity", "effort"), ("position", "effort")])
def test_arrays_of_other_lengths_in_a_message_of_the_same_size_are_noticed(swapped: tuple[str, str]) -> None:
    fields: Fields = {"sec": 1, "nanosec": 2, "frame_id": "", "names": ["a", "b"]}
    fields |= {"position": [1.0, 2.0], "velocity": [3.0, 4.0], "effort": [5.0, 6.0], swapped[0]: []}
    other = fields | {swapped[0]: fields[swapped[1]], swapped[1]: fields[swapped[0]]}
    decoder = JointStateDecoder()
    for layout in (fields, other, fields):
        assert_decoded(decoder.decode(by_ros(layout)), layout)


@settings(max_examples=300)
@given(messages, st.data())
def test_damaged_bytes_are_refused_in_one_line_or_read_within_the_buffer(fields: Fields, data: st.DataObject) -> None:
    right = by_rosbags(fields)
    damaged = bytearray(right[: data.draw(st.integers(0, len(right)))])
    for _ in range(data.draw(st.integers(0, 4))):
        if damaged:
            damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    for decoder in (JointStateDecoder(), experienced(right)):
        assert_refused_or_within(decoder, bytes(damaged))
        assert_decoded(decoder.decode(right), fields)


def assert_refused_or_within(decoder: JointStateDecoder, data: bytes) -> None:
    refusal = "JointState: "
    try:
        state = decoder.decode(data)
    except DecodeError as error:
        refusal = str(error)
    else:
        assert 8 * (len(state.position) + len(state.velocity)) <= len(data)
    assert refusal.startswith("JointState: ")
    assert "\n" not in refusal


def experienced(data: bytes) -> JointStateDecoder:
    decoder = JointStateDecoder()
    decoder.decode(data)
    return decoder


@given(st.binary(max_size=200))
def test_garbage_is_refused_or_decoded_but_nothing_else(data: bytes) -> None:
    assert_refused_or_within(JointStateDecoder(), data)


SIMPLE: Fields = {
    "sec": 1, "nanosec": 2, "frame_id": "f", "names": ["a"], "position": [1.0], "velocity": [2.0], "effort": [],
}  # fmt: skip


@pytest.mark.parametrize("end", range(len(by_rosbags(SIMPLE))))
def test_every_truncation_is_refused(end: int) -> None:
    with pytest.raises(DecodeError, match="JointState: "):
        JointStateDecoder().decode(by_rosbags(SIMPLE)[:end])


@pytest.mark.parametrize(
    ("at", "new", "message"),
    [
        (0, b"\x00\x07", r"CDR byte order = 0007: must be 0000 or 0001"),
        (12, b"\xff\xff\xff\xff", r"header.frame_id has length 4294967295, but only \d+ bytes follow"),
        (20, b"\xff\xff\xff\x7f", r"name has length 2147483647"),
        (24, b"\xff\xff\x00\x00", r"name\[0\] has length 65535"),
        (28, b"\xff", r"name\[0\]: must be UTF-8"),
        (29, b"b", r"name\[0\]: must end in a zero byte"),
        (32, b"\xff\xff\xff\xff", r"position has length 4294967295"),
    ],
)
def test_invalid_bytes_name_the_field(at: int, new: bytes, message: str) -> None:
    data = bytearray(by_rosbags(SIMPLE))
    data[at : at + len(new)] = new
    with pytest.raises(DecodeError, match=message):
        JointStateDecoder().decode(bytes(data))


@pytest.mark.parametrize(("count", "decoded"), [(1000, True), (1001, False), (40_002, False)])
def test_names_beyond_the_maximum_are_refused_before_any_is_decoded(count: int, *, decoded: bool) -> None:
    """The names are not UTF-8; decoding one of them would report this error instead."""
    data = by_rosbags(SIMPLE | {"names": ["n"] * count, "position": [], "velocity": []})
    damaged = data.replace(b"n\0", b"\xff\0")
    reason = r"name\[0\]: must be UTF-8" if decoded else rf"JointState: name has length {count}: must be <= 1000"
    with pytest.raises(DecodeError, match=reason):
        JointStateDecoder().decode(damaged)
    if decoded:
        assert JointStateDecoder().decode(data).names == ("n",) * count


def test_trailing_bytes_are_refused() -> None:
    with pytest.raises(DecodeError, match="16 bytes follow effort: must be <= 15"):
        JointStateDecoder().decode(by_rosbags(SIMPLE) + bytes(16))


@pytest.mark.parametrize("velocity", [[], [2.0, 3.0]])
def test_encoded_state_is_read_by_rosbags(velocity: list[float]) -> None:
    data = joint_state_message(JointState(NS, ("a", "b"), np.array([1.0, 2.0]), np.array(velocity)), "base")
    message: Any = TYPES.deserialize_cdr(data, "sensor_msgs/msg/JointState")
    assert (message.header.stamp.sec, message.header.frame_id, message.name) == (1, "base", ["a", "b"])
    assert [array.tolist() for array in (message.position, message.velocity, message.effort)] == [
        [1.0, 2.0],
        velocity,
        [],
    ]
