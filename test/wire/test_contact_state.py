"""The encoded messages of the monitor equal those of rclpy and rosbags."""

from typing import Any

from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from scara_effmass_msgs.msg import ContactState
from std_msgs.msg import Float64

from scara_effmass.bags.definitions import known_types
from scara_effmass.values import ContactAssessment, Verdict
from scara_effmass.wire.contact_state import ContactStateEncoder, float64_message
from scara_effmass.wire.message_types import CONTACT_STATE

NUMBER = st.floats(allow_nan=True, allow_infinity=True)
TEXT = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=20)
STRATEGIES = {
    "stamp_ns": st.integers(0, 2**31 * 10**9 - 1),
    "contact_point": TEXT,
    "direction": st.tuples(NUMBER, NUMBER, NUMBER),
    "body_region": TEXT,
    "criterion": TEXT,
    "verdict": st.sampled_from(Verdict),
    "reason": TEXT,
    "worst_direction_used": st.booleans(),
    "mass_capped": st.booleans(),
    "watchdog": st.booleans(),
    "contact_normal": TEXT,
    "mass_model": TEXT,
}
CONTACTS = st.builds(ContactAssessment, **{name: STRATEGIES.get(name, NUMBER) for name in ContactAssessment._fields})


def fields_text(message: Any, frame_id: str) -> str:  # noqa: ANN401 - of rclpy or rosbags
    """Return all fields as text; different floats, also signed zeros, give different texts, NaNs equal ones."""
    stamp_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
    assert message.header.frame_id == frame_id
    direction = (message.direction.x, message.direction.y, message.direction.z)
    converted = {"stamp_ns": stamp_ns, "direction": direction, "verdict": Verdict(message.verdict)}
    return repr(
        ContactAssessment(
            **{n: converted[n] if n in converted else getattr(message, n) for n in ContactAssessment._fields}
        )
    )


@given(st.lists(CONTACTS, min_size=1, max_size=3), TEXT)
def test_contact_state_is_decoded_field_by_field(contacts: list[ContactAssessment], frame_id: str) -> None:
    point = contacts[0].contact_point
    encoder = ContactStateEncoder(point, frame_id)
    for contact in (contact._replace(contact_point=point) for contact in contacts):
        data = encoder.encode(contact)
        assert fields_text(deserialize_message(data, ContactState), frame_id) == repr(contact)
        assert fields_text(known_types().deserialize_cdr(data, CONTACT_STATE), frame_id) == repr(contact)


@given(CONTACTS, TEXT)
def test_size_equals_that_of_rclpy(contact: ContactAssessment, frame_id: str) -> None:
    data = ContactStateEncoder(contact.contact_point, frame_id).encode(contact)
    assert len(data) == len(serialize_message(deserialize_message(data, ContactState)))


@given(NUMBER)
def test_number_is_decoded(value: float) -> None:
    assert repr(deserialize_message(float64_message(value), Float64).data) == repr(value)
