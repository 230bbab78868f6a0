"""The CDR of ForceBlock and Impact equals that of rosbags and rclpy."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from scara_effmass_msgs.msg import ForceBlock as RosForceBlock
from scara_effmass_msgs.msg import Impact as RosImpact

from scara_effmass.bags.definitions import known_types
from scara_effmass.errors import DecodeError
from scara_effmass.values import ForceBlock, Impact
from scara_effmass.wire.force import decode_force_block, decode_impact, force_block_message, impact_message
from scara_effmass.wire.message_types import FORCE_BLOCK, IMPACT

NS = 10**9
NUMBER = st.floats(width=64)
TEXT = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=12)
STAMP_NS = st.integers(-(2**31) * NS, 2**31 * NS - 1)
UINT32 = st.integers(0, 2**32 - 1)
FLAG = st.booleans()


@st.composite
def blocks(draw: st.DrawFn) -> ForceBlock:
    force = np.array(draw(st.lists(NUMBER, max_size=9)), np.float64)
    saturated = draw(st.sets(st.integers(0, len(force) - 1))) if len(force) else set[int]()
    return ForceBlock(
        stamp_ns=draw(STAMP_NS),
        frame_id=draw(TEXT),
        first_sample=draw(st.integers(0, 2**64 - 1)),
        sample_rate=draw(NUMBER),
        force=force,
        lost_samples=draw(UINT32),
        saturated_samples=np.array(sorted(saturated), np.uint32),
        clock_residual=draw(NUMBER),
        filter_delay=draw(NUMBER),
        source=draw(TEXT),
        simulated=draw(FLAG),
        tare=draw(NUMBER),
        tare_stamp_ns=draw(STAMP_NS),
        relative_uncertainty=draw(NUMBER),
    )


IMPACTS = st.builds(
    Impact,
    stamp_ns=STAMP_NS,
    frame_id=TEXT,
    clipped=FLAG,
    incomplete=FLAG,
    rebound=UINT32,
    source=TEXT,
    simulated=FLAG,
    **dict.fromkeys(
        ("peak_force", "duration", "impulse", "onset_sample", "baseline", "noise", "clock_residual"), NUMBER
    ),
)


def fields_text(value: ForceBlock | Impact) -> str:
    """Return all fields as text; different floats, also signed zeros, give different texts, NaNs equal ones."""
    return repr([field.tolist() if isinstance(field, np.ndarray) else field for field in value])


def converted_fields(message: Any) -> dict[str, Any]:  # noqa: ANN401 - of rclpy or rosbags
    """Return the fields of a message whose form differs from that of the value."""

    def stamp_ns(time: Any) -> int:  # noqa: ANN401
        return int(time.sec * NS + time.nanosec)

    converted = {"stamp_ns": stamp_ns(message.header.stamp), "frame_id": message.header.frame_id}
    if hasattr(message, "force"):
        converted["tare_stamp_ns"] = stamp_ns(message.tare_stamp)
        converted["force"] = np.array(message.force, np.float64)
        converted["saturated_samples"] = np.array(message.saturated_samples, np.uint32)
    return converted


def read(message: Any, value_type: type[ForceBlock | Impact]) -> ForceBlock | Impact:  # noqa: ANN401 - of rclpy or rosbags
    converted = converted_fields(message)
    return value_type(**{n: converted[n] if n in converted else getattr(message, n) for n in value_type._fields})


def by_rosbags(value: ForceBlock | Impact, *, little_endian: bool = True) -> bytes:
    types = known_types().types
    make: dict[str, Callable[..., object]] = {name.rpartition("/")[2]: message for name, message in types.items()}

    def time(stamp_ns: int) -> object:
        return make["Time"](*divmod(stamp_ns, NS))

    fields = value._asdict()
    fields["header"] = make["Header"](time(fields.pop("stamp_ns")), fields.pop("frame_id"))
    if isinstance(value, ForceBlock):
        fields["tare_stamp"] = time(fields.pop("tare_stamp_ns"))
        fields["saturated"] = bool(len(value.saturated_samples))
    message_type = FORCE_BLOCK if isinstance(value, ForceBlock) else IMPACT
    message: Any = types[message_type]
    return bytes(known_types().serialize_cdr(message(**fields), message_type, little_endian=little_endian))


@given(blocks())
def test_block_is_decoded_by_rclpy_rosbags_and_this_package(block: ForceBlock) -> None:
    data = force_block_message(block)
    by_ros = deserialize_message(data, RosForceBlock)
    by_rosbags: Any = known_types().deserialize_cdr(data, FORCE_BLOCK)
    by_others = (by_ros, by_rosbags)
    assert {fields_text(read(message, ForceBlock)) for message in by_others} == {fields_text(block)}
    assert {message.saturated for message in by_others} == {bool(len(block.saturated_samples))}
    assert fields_text(decode_force_block(data)) == fields_text(block)


@given(IMPACTS)
def test_impact_is_decoded_by_rclpy_rosbags_and_this_package(impact: Impact) -> None:
    data = impact_message(impact)
    assert fields_text(read(deserialize_message(data, RosImpact), Impact)) == fields_text(impact)
    assert fields_text(read(known_types().deserialize_cdr(data, IMPACT), Impact)) == fields_text(impact)
    assert fields_text(decode_impact(data)) == fields_text(impact)


@given(block=blocks(), impact=IMPACTS, little_endian=FLAG)
def test_messages_of_rclpy_and_rosbags_are_decoded(block: ForceBlock, impact: Impact, *, little_endian: bool) -> None:
    """ROS does not clear the padding and appends bytes."""
    for data in (
        by_rosbags(block, little_endian=little_endian),
        bytes(serialize_message(deserialize_message(force_block_message(block), RosForceBlock))),
    ):
        decoded = decode_force_block(data)
        assert fields_text(decoded) == fields_text(block)
        for array in (decoded.force, decoded.saturated_samples):
            assert array.dtype.isnative
            assert array.flags.aligned
            assert not array.flags.writeable
    for data in (
        by_rosbags(impact, little_endian=little_endian),
        bytes(serialize_message(deserialize_message(impact_message(impact), RosImpact))),
    ):
        assert fields_text(decode_impact(data)) == fields_text(impact)


@settings(max_examples=300)
@given(blocks(), IMPACTS, st.data())
def test_damaged_messages_are_refused_or_decoded_within_the_buffer(
    block: ForceBlock, impact: Impact, data: st.DataObject
) -> None:
    for intact in (force_block_message(block), impact_message(impact)):
        damaged = bytearray(intact[: data.draw(st.integers(0, len(intact)))])
        for _ in range(data.draw(st.integers(0, 4))):
            if damaged:
                damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
        assert_refused_or_within(bytes(damaged))


@given(st.binary(max_size=200))
def test_random_bytes_are_refused_or_decoded(data: bytes) -> None:
    for encapsulation in (b"", b"\x00\x01\x00\x00"):
        assert_refused_or_within(encapsulation + data)


def assert_refused_or_within(data: bytes) -> None:
    for name, decode in (("ForceBlock: ", decode_force_block), ("Impact: ", decode_impact)):
        refusal = name
        try:
            value = decode(data)
        except DecodeError as error:
            refusal = str(error)
        else:
            if isinstance(value, ForceBlock):
                assert 8 * len(value.force) <= len(data)
                assert (value.saturated_samples < len(value.force)).all()
        assert refusal.startswith(name)
        assert "\n" not in refusal


SIMPLE = ForceBlock(
    NS, "f", 5, 100.0, np.array([1.0, 2.0]), 0, np.array([1], np.uint32), 0.0, 0.0, "s", simulated=False, tare=0.0,
    tare_stamp_ns=0, relative_uncertainty=0.0,
)  # fmt: skip
SIMPLE_IMPACT = Impact(
    NS, "f", 1.0, 2.0, 3.0, 4.0, clipped=False, incomplete=False, rebound=0, baseline=0.0, noise=0.0,
    clock_residual=0.0, source="s", simulated=False,
)  # fmt: skip


def test_every_truncation_is_refused() -> None:
    block, impact = force_block_message(SIMPLE), impact_message(SIMPLE_IMPACT)
    for end in range(len(block)):
        with pytest.raises(DecodeError, match="ForceBlock: "):
            decode_force_block(block[:end])
    for end in range(len(impact)):
        with pytest.raises(DecodeError, match="Impact: "):
            decode_impact(impact[:end])


@pytest.mark.parametrize(
    ("at", "new", "message"),
    [
        (0, b"\x00\x07", "CDR byte order = 0007: must be 0000 or 0001"),
        (12, b"\xff\xff\xff\xff", r"frame_id has length 4294967295, but only \d+ bytes follow"),
        (36, b"\xff", r"force has length 255, but only \d+ bytes follow"),
        (64, b"\x02", "saturated = 2: must be 0 or 1"),
        (64, b"\x00", "saturated = false: must be true with 1 saturated_samples"),
        (68, b"\x0f", r"saturated_samples has length 15, but only \d+ bytes follow|ends at byte"),
        (72, b"\x02", "saturated_samples = 2: must be < 2, the number of samples"),
    ],
)
def test_invalid_bytes_name_the_field(at: int, new: bytes, message: str) -> None:
    data = bytearray(force_block_message(SIMPLE))
    data[at : at + len(new)] = new
    with pytest.raises(DecodeError, match=message):
        decode_force_block(bytes(data))


def test_trailing_bytes_are_refused() -> None:
    with pytest.raises(DecodeError, match="16 bytes follow relative_uncertainty: must be <= 15"):
        decode_force_block(force_block_message(SIMPLE) + bytes(16))


def test_lost_samples_are_limited_to_the_range_of_the_field() -> None:
    assert decode_force_block(force_block_message(SIMPLE._replace(lost_samples=2**40))).lost_samples == 2**32 - 1


def test_saturated_block_without_samples_is_saturated_everywhere() -> None:
    message = deserialize_message(force_block_message(SIMPLE), RosForceBlock)
    message.saturated_samples = []
    assert decode_force_block(bytes(serialize_message(message))).saturated_samples.tolist() == [0, 1]
