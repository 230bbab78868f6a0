# SPDX-License-Identifier: Apache-2.0
"""The encoded messages equal those of rclpy and rosbags, field by field; invalid ones are refused."""

import math
import re
from collections.abc import Callable
from typing import Any, NamedTuple, get_type_hints

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from scara_effmass_msgs import msg
from std_msgs.msg import Float64

from scara_effmass.bags.definitions import known_types
from scara_effmass.codes import Assumption, Reason
from scara_effmass.errors import DecodeError
from scara_effmass.safety import unknown_contact
from scara_effmass.safety.reasons import CRITERIA, MODELS
from scara_effmass.values import (
    ContactAssessment,
    Decision,
    ForceBlock,
    Impact,
    Mobility6,
    RunInfo,
    SeriesStatistics,
    ValidatedImpact,
    Vector3,
    Verdict,
)
from scara_effmass.wire.contact_states import ContactStatesEncoder, decode_contact_states, float64_message
from scara_effmass.wire.force import decode_force_block, decode_impact, force_block_message, impact_message
from scara_effmass.wire.impact_validation import impact_validation_message, series_from
from scara_effmass.wire.message_types import CONTACT_STATES, FORCE_BLOCK, IMPACT, RUN_INFO
from scara_effmass.wire.run_info import decode_run_info, run_info_message
from test.decisions import assessments_of, decision_on

NS = 10**9
NUMBER = st.floats(width=64)
TEXT = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=12)
STAMP_NS = st.integers(-(2**31) * NS, 2**31 * NS - 1)
UINT32 = st.integers(0, 2**32 - 1)
OF_TYPE: dict[object, st.SearchStrategy[Any]] = {
    float: NUMBER,
    str: TEXT,
    bool: st.booleans(),
    Vector3: st.tuples(NUMBER, NUMBER, NUMBER),
    Mobility6: st.tuples(*[NUMBER] * 6),
    Verdict: st.sampled_from(Verdict),
    Reason: st.just(Reason.STATED),
    int: UINT32,
}
WITH_NAME = {"stamp_ns": STAMP_NS, "tare_stamp_ns": STAMP_NS, "true_onset_ns": STAMP_NS}


def values_of(kind: Any, **fields: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:  # noqa: ANN401 - a named tuple
    """Return values with arbitrary content, except for `fields`."""
    fields = WITH_NAME | fields
    types = get_type_hints(kind).items()
    return st.builds(kind, **{name: fields[name] if name in fields else OF_TYPE[of] for name, of in types})


@st.composite
def blocks(draw: st.DrawFn) -> ForceBlock:
    force = np.array(draw(st.lists(NUMBER, max_size=9)), np.float64)
    saturated = draw(st.sets(st.integers(0, len(force) - 1))) if len(force) else set[int]()
    block: ForceBlock = draw(
        values_of(
            ForceBlock,
            first_sample=st.integers(0, 2**53),
            sample_rate=st.floats(1e-3, 1e9),
            relative_uncertainty=st.floats(0.0, 1.0),
            force=st.just(force),
            saturated_samples=st.just(np.array(sorted(saturated), np.uint32)),
        )
    )
    return block


FINITE = (
    *("peak_force", "duration", "impulse", "onset_sample", "baseline", "noise", "compression_impulse"),
    *("held_force", "load_force"),
)
IMPACTS = values_of(Impact, **dict.fromkeys(FINITE, st.floats(-(2.0**53), 2.0**53)))


class Kind(NamedTuple):
    """A message of this package: its class, type, conversion and values, and a value to damage."""

    ros_class: Any
    type: str
    encode: Callable[[Any], bytes]
    decode: Callable[[bytes], Any]
    values: st.SearchStrategy[Any]
    simple: Any

    @property
    def name(self) -> str:
        return type(self.simple).__name__


SIMPLE = ForceBlock(NS, "f", 5, 100.0, np.array([1.0, 2.0]), saturated_samples=np.array([1], np.uint32), source="s")
SIMPLE_IMPACT = Impact(NS, "f", 1.0, 2.0, 3.0, 4.0, *(False, False, 0, 0.0, 0.0, 0.0, "s", False))
KINDS = [
    Kind(msg.ForceBlock, FORCE_BLOCK, force_block_message, decode_force_block, blocks(), SIMPLE),
    Kind(msg.Impact, IMPACT, impact_message, decode_impact, IMPACTS, SIMPLE_IMPACT),
    Kind(msg.RunInfo, RUN_INFO, run_info_message, decode_run_info, values_of(RunInfo), RunInfo(note="n")),
]
every_kind = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)


def value_in(message: Any, like: Any) -> Any:  # noqa: ANN401 - of rclpy or rosbags; a named tuple
    """Return a message as a value of the type of `like`."""

    def field(name: str) -> object:
        if name == "frame_id":
            return message.header.frame_id
        if name.endswith("_ns"):
            time = message.header.stamp if name == "stamp_ns" else getattr(message, name.removesuffix("_ns"))
            return time.sec * NS + time.nanosec
        content = getattr(message, name)
        if name == "verdict":
            return Verdict(content)
        if name == "reason_code":
            return Reason(content)
        if name.endswith("_mobility"):
            return tuple(map(float, content))
        return (content.x, content.y, content.z) if hasattr(content, "x") else content

    return type(like)(*map(field, like._fields))


def text(value: Any) -> str:  # noqa: ANN401 - a named tuple
    """Return all fields as text; different floats, also signed zeros, give different texts, NaNs equal ones."""
    return repr([field.tolist() if hasattr(field, "tolist") else field for field in value])


@every_kind
@given(data=st.data())
def test_message_is_read_by_rclpy_rosbags_and_this_package(kind: Kind, data: st.DataObject) -> None:
    """ROS does not clear the padding and appends bytes; rosbags writes either byte order."""
    value = data.draw(kind.values)
    encoded = kind.encode(value)
    of_ros = deserialize_message(encoded, kind.ros_class)
    of_rosbags: Any = known_types().deserialize_cdr(encoded, kind.type)
    for message in (of_ros, of_rosbags):
        assert text(value_in(message, value)) == text(value)
        if isinstance(value, ForceBlock):
            assert message.saturated == bool(len(value.saturated_samples))
    by_rosbags = [known_types().serialize_cdr(of_rosbags, kind.type, little_endian=order) for order in (True, False)]
    for data_of_any in (encoded, serialize_message(of_ros), *by_rosbags):
        decoded = kind.decode(bytes(data_of_any))
        assert text(decoded) == text(value)
        for array in (field for field in decoded if isinstance(field, np.ndarray)):
            assert array.dtype.isnative
            assert array.flags.aligned
            assert not array.flags.writeable


def assert_refused_or_within(kind: Kind, data: bytes) -> None:
    refusal = f"{kind.name}: "
    try:
        value = kind.decode(data)
    except DecodeError as error:
        refusal = str(error)
    else:
        if isinstance(value, ForceBlock):
            assert 8 * len(value.force) <= len(data)
            assert (value.saturated_samples < len(value.force)).all()
    assert refusal.startswith(f"{kind.name}: ")
    assert "\n" not in refusal


@every_kind
@settings(max_examples=300)
@given(data=st.data())
def test_damaged_messages_are_refused_or_decoded_within_the_buffer(kind: Kind, data: st.DataObject) -> None:
    intact = kind.encode(data.draw(kind.values))
    damaged = bytearray(intact[: data.draw(st.integers(0, len(intact)))])
    for _ in range(data.draw(st.integers(0, 4))):
        if damaged:
            damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    assert_refused_or_within(kind, bytes(damaged))


@every_kind
@given(data=st.binary(max_size=300))
def test_random_bytes_are_refused_or_decoded(kind: Kind, data: bytes) -> None:
    for encapsulation in (b"", b"\x00\x01\x00\x00"):
        assert_refused_or_within(kind, encapsulation + data)


@every_kind
def test_every_truncation_is_refused(kind: Kind) -> None:
    encoded = kind.encode(kind.simple)
    for end in range(len(encoded)):
        with pytest.raises(DecodeError, match=f"{kind.name}: "):
            kind.decode(encoded[:end])


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


@pytest.mark.parametrize("rate", [0.0, -1.0, 0.9e-3, 1.1e9, math.nan, math.inf])
def test_sample_rate_of_which_no_time_follows_is_refused(rate: float) -> None:
    with pytest.raises(DecodeError, match=r"^ForceBlock: sample_rate = [^ ]+: must be from 0.001 to 1e\+09$"):
        decode_force_block(force_block_message(SIMPLE._replace(sample_rate=rate)))


@pytest.mark.parametrize("uncertainty", [-0.1, 1.01, math.nan, math.inf])
def test_uncertainty_that_would_tolerate_any_force_is_refused(uncertainty: float) -> None:
    with pytest.raises(DecodeError, match=r"^ForceBlock: relative_uncertainty = [^ ]+: must be 0 to 1$"):
        decode_force_block(force_block_message(SIMPLE._replace(relative_uncertainty=uncertainty)))


def test_index_beyond_the_integers_of_a_float_is_refused() -> None:
    with pytest.raises(DecodeError, match="first_sample = 9007199254740993: must be at most 9007199254740992"):
        decode_force_block(force_block_message(SIMPLE._replace(first_sample=2**53 + 1)))


@pytest.mark.parametrize("name", FINITE)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300])
def test_impact_with_a_number_of_which_no_time_follows_is_refused(name: str, value: float) -> None:
    with pytest.raises(DecodeError, match=rf"^Impact: {name} = {re.escape(str(value))}: must be finite and at most"):
        decode_impact(impact_message(Impact(**{**SIMPLE_IMPACT._asdict(), name: value})))


def test_trailing_bytes_are_refused() -> None:
    with pytest.raises(DecodeError, match="16 bytes follow relative_uncertainty: must be <= 15"):
        decode_force_block(force_block_message(SIMPLE) + bytes(16))


def test_lost_samples_are_limited_to_the_range_of_the_field() -> None:
    assert decode_force_block(force_block_message(SIMPLE._replace(lost_samples=2**40))).lost_samples == 2**32 - 1


def test_saturated_block_without_samples_is_saturated_everywhere() -> None:
    message = deserialize_message(force_block_message(SIMPLE), msg.ForceBlock)
    message.saturated_samples = []
    assert decode_force_block(bytes(serialize_message(message))).saturated_samples.tolist() == [0, 1]


FINITE_NUMBER = st.floats(-1e300, 1e300)
FINITE_VECTORS = {
    Vector3: st.tuples(*[FINITE_NUMBER] * 3),
    Mobility6: st.tuples(*[FINITE_NUMBER] * 6),
    float: FINITE_NUMBER,
}
CONTACTS = values_of(
    ContactAssessment,
    criterion=st.sampled_from(CRITERIA),
    mass_model=st.sampled_from(MODELS),
    **{
        name: FINITE_VECTORS[of]
        for name, of in get_type_hints(ContactAssessment).items()
        if of in FINITE_VECTORS and name not in {"lumped_mass", "full_mass"}
    },
    reason_code=st.just(Reason.NONE),
).map(lambda contact: contact._replace(reason_code=Reason.STATED if contact.reason else Reason.NONE))
ASSUMPTIONS = st.lists(st.sampled_from(Assumption), unique=True).map(tuple)
DECISIONS = st.builds(
    Decision,
    stamp_ns=st.integers(0, 2**31 * NS - 1),
    input_age=NUMBER,
    velocity_delay=NUMBER,
    contact_normal=TEXT,
    watchdog=st.booleans(),
    contacts=st.lists(CONTACTS, min_size=1, max_size=4).map(tuple),
    allowable_speed=st.floats(0.0, 1e300),
    speed_scaling=st.floats(0.0, 1.0),
    assumptions=ASSUMPTIONS,
    accepted_assumptions=ASSUMPTIONS,
    scope=TEXT,
)


@given(st.lists(DECISIONS, min_size=1, max_size=3), TEXT)
def test_contact_states_are_read_by_rclpy_rosbags_and_this_package(decisions: list[Decision], frame_id: str) -> None:
    """One encoder writes all messages of a monitor, each of the size of rclpy's, and numbers them."""
    encoder = ContactStatesEncoder(frame_id)
    for index, decision in enumerate(decisions):
        data = encoder.encode(assessments_of(decision))
        of_ros = deserialize_message(data, msg.ContactStates)
        of_rosbags: Any = known_types().deserialize_cdr(data, CONTACT_STATES)
        for message in (of_ros, of_rosbags):
            assert message.header.frame_id == frame_id
            assert message.header.stamp.sec * NS + message.header.stamp.nanosec == decision.stamp_ns
            assert message.sequence_number == index + 1
            assert (message.verdict, message.reason) == (decision.verdict, decision.reason)
            assert message.reason_code == decision.reason_code
            for name in ("input_age", "velocity_delay", "contact_normal", "watchdog", "allowable_speed"):
                assert repr(getattr(message, name)) == repr(getattr(decision, name))
            assert message.speed_scaling == decision.speed_scaling
            for name in ("assumptions", "accepted_assumptions"):
                assert tuple(getattr(message, name)) == getattr(decision, name)
            for state, contact in zip(message.contacts, decision.contacts, strict=True):
                assert text(value_in(state, contact)) == text(contact)
        assert len(data) == len(serialize_message(of_ros))
        is_unknown = any(contact.verdict is Verdict.UNKNOWN for contact in decision.contacts)
        expected = decision._replace(allowable_speed=0.0, speed_scaling=0.0) if is_unknown else decision
        by_rosbags = (
            known_types().serialize_cdr(of_rosbags, CONTACT_STATES, little_endian=end) for end in (True, False)
        )
        for copy in (data, serialize_message(of_ros), *by_rosbags):
            decoded = decode_contact_states(bytes(copy))
            assert text(decoded) == text(expected._replace(sequence_number=index + 1))


def test_texts_follow_the_settings_where_the_codes_stay() -> None:
    """The encoder keeps texts while the codes of an assessment stay, which mean others under other settings."""
    contact = unknown_contact("tool", "")._replace(verdict=Verdict.OK, mass_model="full", criterion="force")
    decision = decision_on(contact._replace(body_region="chest"), contact_normal="worst")
    others = decision._replace(contact_normal="velocity", contacts=(contact._replace(body_region="neck"),))
    renamed = decision._replace(contacts=(contact._replace(body_region="chest", contact_point="elbow"),))
    encoder = ContactStatesEncoder("base_link")
    for sent in (decision, others, decision, renamed):
        decoded = decode_contact_states(encoder.encode(assessments_of(sent)))
        assert decoded.contact_normal == sent.contact_normal
        assert decoded.contacts[0].body_region == sent.contacts[0].body_region
        assert decoded.contacts[0].contact_point == sent.contacts[0].contact_point


def states_message(**fields: Any) -> bytes:  # noqa: ANN401
    state = msg.ContactState(contact_point="tool", verdict=Verdict.OK, allowable_speed=5.0, speed=1.0)
    for name, value in fields.items():
        setattr(state, name, value)
    whole = {"verdict": Verdict.OK, "allowable_speed": 5.0, "speed_scaling": 1.0}
    return bytes(serialize_message(msg.ContactStates(contacts=[state], **whole)))


def test_every_truncation_of_contact_states_is_refused() -> None:
    data = ContactStatesEncoder("base_link").encode(assessments_of(decode_contact_states(states_message(reason="why"))))
    for end in range(len(data)):
        with pytest.raises(DecodeError, match=r"^ContactStates: "):
            decode_contact_states(data[:end])


@settings(max_examples=300)
@given(st.data())
def test_damaged_contact_states_are_refused_or_decoded(data: st.DataObject) -> None:
    damaged = bytearray(states_message(reason="why"))
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    try:
        decision = decode_contact_states(bytes(damaged))
    except DecodeError:
        return
    assert decision.contacts
    assert 0.0 <= decision.allowable_speed < math.inf
    assert 0.0 <= decision.speed_scaling <= 1.0


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"verdict": 99}, "verdict = 99: must be 0 to 3"),
        ({"speed": math.nan}, "the contact state has a value that is not a number"),
        ({"allowable_speed": math.inf}, "the contact state has a value that is not a number"),
        ({"full_mobility": [math.nan] * 6}, "the contact state has a value that is not a number"),
    ],
)
def test_contact_state_with_an_invalid_value_is_unknown_without_numbers(fields: dict[str, Any], reason: str) -> None:
    decision = decode_contact_states(states_message(**fields))
    (contact,) = decision.contacts
    assert (contact.verdict, contact.reason, contact.contact_point) == (Verdict.UNKNOWN, reason, "tool")
    assert (contact.speed, contact.allowable_speed) == (0.0, 0.0)
    assert (decision.verdict, decision.allowable_speed, decision.speed_scaling) == (Verdict.UNKNOWN, 0.0, 0.0)


@pytest.mark.parametrize("verdict", [Verdict.UNKNOWN, Verdict.WARN, Verdict.VIOLATION, 77])
def test_message_that_is_worse_than_its_contacts_is_unknown(verdict: int) -> None:
    contact = msg.ContactState(contact_point="tool", verdict=Verdict.OK, allowable_speed=5.0)
    message = msg.ContactStates(verdict=verdict, contacts=[contact], allowable_speed=5.0, speed_scaling=1.0)
    decision = decode_contact_states(bytes(serialize_message(message)))
    reason = f"verdict = {int(verdict)}: must be that of the worst contact, OK"
    assert [(one.contact_point, one.verdict, one.reason) for one in decision.contacts] == [
        ("tool", Verdict.UNKNOWN, reason)
    ]
    assert (decision.allowable_speed, decision.speed_scaling) == (0.0, 0.0)


def test_message_without_contacts_is_unknown() -> None:
    decision = decode_contact_states(bytes(serialize_message(msg.ContactStates(reason="no robot"))))
    assert (decision.verdict, decision.reason, decision.worst.contact_point) == (Verdict.UNKNOWN, "no robot", "")


def test_validation_of_an_impact_has_the_fields_of_its_value() -> None:
    pair = (0.9, 1.1)
    series = SeriesStatistics(
        *(3, 0.99, 1e5, -1.0, 2.0, 1, 1.01, pair, 0.98, pair, 0.07, 0.5, pair, math.nan, 2),
        *(True, False, "why"),
    )
    numbers = {name: float(index) for index, name in enumerate(ValidatedImpact.__slots__)}
    values: dict[str, Any] = numbers | {"stamp_ns": 5 * NS + 7, "frame_id": "sensor", "body_region": "hand"}
    impact = ValidatedImpact(**values | {"conservative": True, "exceeds_limit": False, "series": series})
    message = impact_validation_message(impact)
    assert (message.header.stamp.sec, message.header.stamp.nanosec, message.header.frame_id) == (5, 7, "sensor")
    for name in set(message.get_fields_and_field_types()) - {"header", "series"}:
        assert getattr(message, name) == getattr(impact, name)
    assert repr(series_from(message.series)) == repr(series)


@given(NUMBER)
def test_number_is_decoded(value: float) -> None:
    assert repr(deserialize_message(float64_message(value), Float64).data) == repr(value)
