# SPDX-License-Identifier: Apache-2.0
"""Convert ContactStates messages to and from `Decision`, and encode Float64 messages.

Packing with `struct` takes a fifth of the time that rclpy takes; this happens three times in each cycle. Tests compare
the layout with rclpy and rosbags.
"""

import math
import struct
from typing import Any

from scara_effmass.codes import Assumption, Reason
from scara_effmass.errors import DecodeError
from scara_effmass.kernel.records import FIELDS, PLACES
from scara_effmass.safety import Assessments, unknown_contact
from scara_effmass.values import ContactAssessment, Decision, Verdict, severity
from scara_effmass.wire.cdr import (
    BYTE_ORDERS,
    COUNT,
    LITTLE_ENDIAN,
    MAX_TAIL,
    NS,
    ORIGIN,
    STAMP_AT,
    padded,
    sec_and_nanosec,
    with_text,
)

_VERDICTS, _CODES = frozenset(map(int, Verdict)), frozenset(map(int, Reason))
_ASSUMPTIONS = frozenset(map(int, Assumption))
_FLOAT64 = struct.Struct("<4sd")
_STAMP = struct.Struct("<4siI")
_NUMBERS_LAYOUT = "Q?BH4x4d"
"""From sequence_number to velocity_delay."""
_VALUES_SIZE, _REASON = PLACES["worst_direction_used"], PLACES["reason"]
_MASSES = PLACES["lumped_mass"], PLACES["full_mass"]
"""Places in the numbers of a contact: the end of its values, its reason, and those that may be NaN."""
_PARTS = [
    slice(PLACES[name], PLACES[name] + shape[0]) if shape else PLACES[name]
    for name, shape in FIELDS.items()
    if PLACES[name] < _VALUES_SIZE
]
"""Places of the values by field."""
_VALUES_LAYOUT = f"{_VALUES_SIZE}d"
"""From direction to test_effective_mass of one contact."""
_NUMBERS, _VALUES = struct.Struct(f"<{_NUMBERS_LAYOUT}"), struct.Struct(f"<{_VALUES_LAYOUT}")
_FLAGS = struct.Struct("<??BxH")
_FLAG_PLACES = [PLACES[name] for name in ("worst_direction_used", "mass_capped", "verdict", "reason")]
"""worst_direction_used, mass_capped, verdict and reason_code of one contact."""
_FIRST_FLAG = ContactAssessment._fields.index("worst_direction_used")
_TEXTS = len(ContactAssessment._fields) - _FIRST_FLAG - 4


def float64_message(value: float) -> bytes:
    """Return the CDR bytes of a std_msgs/Float64."""
    return _FLOAT64.pack(LITTLE_ENDIAN, value)


class ContactStatesEncoder:
    """Encodes the assessments of one monitor, and numbers them; texts are encoded only when they change.

    `frame_id` is the frame of the directions.
    """

    __slots__ = ("_count", "_head", "_tails", "_texts", "_texts_of_state", "frame_id")

    def __init__(self, frame_id: str = "") -> None:
        self.frame_id = frame_id
        self._count = 0
        self._texts: tuple[object, ...] = ()
        self._head = self._texts_of_state = b""
        self._tails: list[bytes] = []

    def encode(self, assessments: Assessments, row: int = 0) -> bytes:
        """Return the CDR bytes of the next message, that of joint state number `row`."""
        state, contacts = assessments.states[row].tolist(), assessments.numbers[row]
        stamp_ns, _, _, _, is_admitted, _, watchdog, age, delay, verdict, worst, allowable_speed, scaling, _ = state
        # The bytes of verdicts, codes and reasons stand for their texts, which those of the settings complete.
        codes = contacts[:, _VALUES_SIZE:].tobytes()
        normal = assessments.normal if is_admitted else ""
        settings = assessments.points, assessments.texts, assessments.details, assessments.assumptions
        texts = self.frame_id, normal, worst, codes, settings
        if texts != self._texts:
            self._encode_texts(assessments, row, normal, worst)
            self._texts = texts
        self._count += 1
        code = int(contacts[worst, _REASON])
        parts = [
            _STAMP.pack(LITTLE_ENDIAN, *sec_and_nanosec(stamp_ns)),
            self._head,
            _NUMBERS.pack(self._count, watchdog, verdict, code, allowable_speed, scaling, age, delay),
            self._texts_of_state,
        ]
        for values, tail in zip(contacts[:, :_VALUES_SIZE], self._tails, strict=True):
            parts += (values.tobytes(), tail)
        return b"".join(parts)

    def _encode_texts(self, assessments: Assessments, row: int, normal: str, worst: int) -> None:
        # Doubles are aligned to 8 bytes from byte 4 on, as each part is; the stamp before the head is 8 bytes long.
        contacts = assessments.numbers[row].tolist()
        reasons = [assessments.texts.text(numbers[_REASON:], assessments.details) for numbers in contacts]
        self._head = padded(with_text(b"", self.frame_id))
        before = with_text(with_text(b"", normal), reasons[worst])
        for codes in (assessments.assumptions.assumed, assessments.assumptions.accepted):
            before = _with_count(before, len(codes)) + bytes(codes)
        before = with_text(before, assessments.texts.scope)
        self._texts_of_state = padded(_with_count(before, len(contacts)))
        self._tails = []
        for numbers, name, reason in zip(contacts, assessments.points, reasons, strict=True):
            tail = _FLAGS.pack(*(int(numbers[place]) for place in _FLAG_PLACES))
            labels = (texts[int(numbers[PLACES[field]])] for field, texts in assessments.labels.items())
            for text in (name, *labels, reason):
                tail = with_text(tail, text)
            self._tails.append(padded(tail))
        self._tails[-1] = tail  # nothing follows


def _with_count(data: bytes, count: int) -> bytes:
    """Return `data` with the count of a sequence at the next multiple of 4."""
    return data + b"\x00" * (-len(data) % 4) + COUNT.pack(count)


class _Reader:
    """Formats of one byte order, compiled once."""

    def __init__(self, order: str) -> None:
        self.stamp = struct.Struct(f"{order}iI").unpack_from
        self.count = struct.Struct(f"{order}I").unpack_from
        self.numbers = struct.Struct(f"{order}{_NUMBERS_LAYOUT}").unpack_from
        self.contact = struct.Struct(f"{order}{_VALUES_LAYOUT}??BxH").unpack_from

    def text(self, data: bytes, at: int) -> tuple[str, int]:
        """Return the string at the next multiple of 4 from `at` on, and its end."""
        at += -at % 4
        start = at + 4
        end = start + self.count(data, at)[0]
        if end > len(data):
            raise IndexError
        return data[start : max(end - 1, start)].decode(), end

    def assumptions(self, data: bytes, at: int) -> tuple[tuple[Assumption, ...], int]:
        """Return the known codes of the sequence at the next multiple of 4 from `at` on, and its end."""
        start = at + -at % 4 + 4
        end = start + self.count(data, start - 4)[0]
        if end > len(data):
            raise IndexError
        return tuple(Assumption(code) for code in data[start:end] if code in _ASSUMPTIONS), end


_READERS = {encapsulation: _Reader(order) for encapsulation, order in BYTE_ORDERS.items()}


def decode_contact_states(data: bytes) -> Decision:
    """Return the decision in `data` (CDR of either byte order). Raises DecodeError.

    A contact with an invalid verdict or number is UNKNOWN without numbers, and so is a message without contacts, and
    every contact where the verdict of the message is worse.
    """
    reader = _READERS.get(data[:2])
    if reader is None:
        order = data[:2].hex() or "missing"
        raise DecodeError(f"ContactStates: CDR byte order = {order}: must be 0000 or 0001")
    try:
        decision, end = _decode(reader, data)
    except (struct.error, IndexError):
        raise DecodeError("ContactStates: must be complete") from None
    except UnicodeDecodeError:
        raise DecodeError("ContactStates: every text must be UTF-8") from None
    if len(data) - end > MAX_TAIL:
        raise DecodeError(f"ContactStates: {len(data) - end} bytes follow contacts: must be <= {MAX_TAIL}")
    return decision


def _decode(reader: _Reader, data: bytes) -> tuple[Decision, int]:
    sec, nanosec = reader.stamp(data, STAMP_AT)
    _, at = reader.text(data, STAMP_AT + 8)
    at += (ORIGIN - at) % 8
    number, watchdog, verdict, _, allowable_speed, speed_scaling, age, delay = reader.numbers(data, at)
    contact_normal, at = reader.text(data, at + _NUMBERS.size)
    reason, at = reader.text(data, at)
    assumptions, at = reader.assumptions(data, at)
    accepted, at = reader.assumptions(data, at)
    scope, at = reader.text(data, at)
    at += -at % 4
    (count,) = reader.count(data, at)
    at += 4
    if count * (_VALUES.size + _FLAGS.size + 4 * _TEXTS) > len(data) - at:
        raise IndexError
    contacts = []
    for _ in range(count):
        at += (ORIGIN - at) % 8
        values = reader.contact(data, at)
        at += _VALUES.size + _FLAGS.size
        texts = []
        for _ in range(_TEXTS):
            text, at = reader.text(data, at)
            texts.append(text)
        contacts.append(_contact(values, texts))
    if not contacts:
        contacts.append(unknown_contact("", reason or "the monitor has no contact points"))
    worst = max((contact.verdict for contact in contacts), key=severity)
    if verdict not in _VERDICTS or severity(verdict) > severity(worst):
        why = f"verdict = {verdict}: must be that of the worst contact, {worst.name}"
        contacts, worst = [unknown_contact(contact.contact_point, why) for contact in contacts], Verdict.UNKNOWN
    if not (worst is not Verdict.UNKNOWN and 0.0 <= allowable_speed < math.inf and 0.0 <= speed_scaling <= 1.0):
        allowable_speed = speed_scaling = 0.0
    stamp_ns = sec * NS + nanosec
    decision = Decision(
        *(stamp_ns, age, delay, contact_normal, watchdog, tuple(contacts), allowable_speed, speed_scaling, number),
        *(assumptions, accepted, scope),
    )
    return decision, at


def _contact(values: tuple[Any, ...], texts: list[str]) -> ContactAssessment:
    """Return the contact with these `values`, from direction to verdict, and `texts`, from contact_point on."""
    numbers, (*flags, verdict, code) = values[:_VALUES_SIZE], values[_VALUES_SIZE:]
    if verdict not in _VERDICTS:
        return unknown_contact(texts[0], f"verdict = {verdict}: must be 0 to 3")
    if not math.isfinite(sum(number for place, number in enumerate(numbers) if place not in _MASSES)):
        return unknown_contact(texts[0], "the contact state has a value that is not a number")
    fields = [numbers[part] for part in _PARTS]
    known = Reason(code) if code in _CODES else Reason.STATED
    return ContactAssessment._make((*fields, *flags, Verdict(verdict), known, *texts))
