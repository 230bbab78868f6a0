"""RunInfo as CDR, against ROS and rosbags; run information in the JSON of older recordings."""

import json
import math
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from scara_effmass_msgs.msg import RunInfo as RosRunInfo

from scara_effmass.bags.definitions import known_types
from scara_effmass.errors import DecodeError, SettingsError
from scara_effmass.impacts.impact_matcher import check_run_info
from scara_effmass.values import RunInfo
from scara_effmass.wire.message_types import RUN_INFO
from scara_effmass.wire.run_info import decode_run_info, run_info_from_json, run_info_message

NS = 10**9
NUMBER = st.floats(width=64)
TEXT = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=12)
STAMP_NS = st.integers(-(2**31) * NS, 2**31 * NS - 1)
VECTOR = st.tuples(NUMBER, NUMBER, NUMBER)
INFOS = st.builds(
    RunInfo,
    stamp_ns=STAMP_NS,
    frame_id=TEXT,
    configuration=TEXT,
    obstacle_mass=NUMBER,
    impact_position=VECTOR,
    plate_normal=VECTOR,
    simulated=st.booleans(),
    note=TEXT,
    contact_stiffness=NUMBER,
    contact_exponent=NUMBER,
    true_onset_ns=STAMP_NS,
    **dict.fromkeys(("true_speed", "true_effective_mass", "true_peak_force", "true_duration", "true_impulse"), NUMBER),
)


def value_of(message: Any) -> RunInfo:  # noqa: ANN401 - of two libraries
    """Return a message of either library as our value."""
    special = {
        "stamp_ns": message.header.stamp.sec * NS + message.header.stamp.nanosec,
        "frame_id": message.header.frame_id,
        "true_onset_ns": message.true_onset.sec * NS + message.true_onset.nanosec,
        **{
            name: (getattr(message, name).x, getattr(message, name).y, getattr(message, name).z)
            for name in ("impact_position", "plate_normal")
        },
    }
    return RunInfo(**{name: special[name] if name in special else getattr(message, name) for name in RunInfo._fields})


@given(INFOS)
def test_ros_and_rosbags_read_what_is_encoded(info: RunInfo) -> None:
    data = run_info_message(info)
    messages = (deserialize_message(data, RosRunInfo), known_types().deserialize_cdr(data, RUN_INFO))
    # As text, in which NaN equals itself.
    assert {repr(value_of(message)) for message in messages} == {repr(info)}


@given(INFOS)
def test_messages_of_ros_and_rosbags_are_decoded(info: RunInfo) -> None:
    data = run_info_message(info)
    encoded = [serialize_message(deserialize_message(data, RosRunInfo))]
    message = known_types().deserialize_cdr(data, RUN_INFO)
    encoded += [bytes(known_types().serialize_cdr(message, RUN_INFO, little_endian=order)) for order in (True, False)]
    assert {repr(decode_run_info(one)) for one in encoded} == {repr(info)}


@given(INFOS, st.integers(0, 200))
def test_cut_message_is_refused(info: RunInfo, size: int) -> None:
    data = run_info_message(info)
    if size < len(data):
        with pytest.raises(DecodeError):
            decode_run_info(data[:size])


@given(st.binary(max_size=300))
def test_random_bytes_are_decoded_or_refused(data: bytes) -> None:
    with suppress(DecodeError):
        decode_run_info(b"\x00\x01\x00\x00" + data)


def test_json_of_the_campaign_is_read() -> None:
    fields = {
        "generated": True,
        "description": "impact on a cart",
        "configuration": "300_0",
        "obstacle_mass": 2,
        "point": [0.3, 0.0],
        "direction": [1.0, 0.0, 0.0],
        "stiffness": 2e6,
        "exponent": 1.0,
        "since_ns": 5,
        "truth": {
            "onset_ns": 7,
            "speed": 0.25,
            "effective_mass": 1.0,
            "peak_force": 200.0,
            "duration": 2e-3,
            "impulse": 0.4,
            "contacts": 2,
        },
    }
    assert run_info_from_json(json.dumps(fields)) == RunInfo(
        stamp_ns=5,
        configuration="300_0",
        obstacle_mass=2.0,
        impact_position=(0.3, 0.0, 0.0),
        plate_normal=(1.0, 0.0, 0.0),
        simulated=True,
        note="impact on a cart",
        contact_stiffness=2e6,
        contact_exponent=1.0,
        true_onset_ns=7,
        true_speed=0.25,
        true_effective_mass=1.0,
        true_peak_force=200.0,
        true_duration=2e-3,
        true_impulse=0.4,
    )


@pytest.mark.parametrize("fields", [{}, {"obstacle_mass": None, "configuration": None, "since_ns": None}])
def test_json_without_values_states_nothing(fields: dict[str, None]) -> None:
    assert run_info_from_json(json.dumps(fields)) == RunInfo()


@pytest.mark.parametrize(
    "fields",
    [
        {"truth": 1, "stiffness": "2000", "exponent": True},
        {"truth": {"speed": -1.0, "effective_mass": math.nan, "peak_force": "big", "duration": None}},
        {"point": [0.3, 0.0]},
    ],
)
def test_json_with_unusable_ground_truth_is_unknown(fields: dict[str, object]) -> None:
    assert run_info_from_json(json.dumps(fields)) == RunInfo()


def test_json_point_that_is_none_is_not_a_number() -> None:
    info = run_info_from_json('{"point": "somewhere", "direction": [1.0, 0.0, 0.0]}')
    assert info is not None
    assert math.isnan(info.impact_position[0])
    assert info.plate_normal == (1.0, 0.0, 0.0)


@pytest.mark.parametrize("text", ["", "no JSON", "[1]", "2.39", "[" * 100_000, '{"a": ' * 100_000])
def test_text_without_json_object_gives_none(text: str) -> None:
    assert run_info_from_json(text) is None


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *(("obstacle_mass", value) for value in ("NaN", "Infinity", "-1", "1001", "true", '"2.39"', "[2.39]")),
        *(("stamp", value) for value in ("1e999", "NaN", "1.5", "true", '"now"', "9" * 30)),
        *(("configuration", value) for value in (r'"\ud800"', r'"a\nb"')),
    ],
)
def test_json_values_that_cannot_be_used_are_refused(key: str, value: str) -> None:
    info = run_info_from_json(f'{{"{key if key != "stamp" else "since_ns"}": {value}}}')
    assert info is not None
    with pytest.raises(SettingsError, match=f"^{key}.*: must be "):
        check_run_info(info)
