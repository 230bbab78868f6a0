"""What the monitor says, as CDR bytes: published live and recorded offline by the same few lines.

Packing costs a fifth of filling in a message and having rclpy convert it, three times per cycle. The layout is
that of `ContactState.msg`; a test holds it against rclpy's own and against rosbags.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from scara_effmass.wire.primitives import LITTLE_ENDIAN, padded, sec_and_nanosec, with_text

if TYPE_CHECKING:
    from scara_effmass.values import ContactAssessment

_DOUBLES = 15
"""From direction.x to margin."""
_FLOAT64 = struct.Struct("<4sd")
_END = struct.Struct("<d??6xd?")
"""From input_age to watchdog."""


def float64_message(value: float) -> bytes:
    """Return a std_msgs/Float64."""
    return _FLOAT64.pack(LITTLE_ENDIAN, value)


class ContactStateEncoder:
    """Makes ContactState messages of one contact point; texts that stay the same are encoded once."""

    __slots__ = ("_head", "_start", "_texts", "_texts_of")

    def __init__(self, contact_point: str, frame_id: str) -> None:
        """Encode for `contact_point`; `frame_id` is the frame of its direction."""
        # Numbers stand at multiples of 8 bytes counted from behind the first 4; the stamp before it is 8 long.
        self._head = padded(with_text(with_text(b"", frame_id), contact_point))
        self._start = struct.Struct(f"<4siI{len(self._head)}s{_DOUBLES}d")
        self._texts_of: tuple[object, ...] = ()
        self._texts = b""

    def encode(self, contact: ContactAssessment) -> bytes:
        """Return the message."""
        (
            stamp_ns,
            _,
            direction,
            *numbers,
            body_region,
            criterion,
            verdict,
            reason,
            input_age,
            worst_direction_used,
            mass_capped,
            smallest_singular_value,
            watchdog,
        ) = contact
        texts_of = (body_region, criterion, verdict, reason)
        if texts_of != self._texts_of:
            texts = with_text(with_text(b"", body_region), criterion) + bytes((verdict,))
            self._texts = padded(with_text(texts, reason))
            self._texts_of = texts_of
        return (
            self._start.pack(LITTLE_ENDIAN, *sec_and_nanosec(stamp_ns), self._head, *direction, *numbers)
            + self._texts
            + _END.pack(input_age, worst_direction_used, mass_capped, smallest_singular_value, watchdog)
        )
