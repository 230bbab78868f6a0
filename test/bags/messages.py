"""Messages of any known type, encoded by rosbags."""

from collections.abc import Mapping
from typing import Any

from scara_effmass.bags.definitions import known_types
from scara_effmass.wire.cdr import NS
from scara_effmass.wire.message_types import HEADER, TIME


def serialized(message_type: str, fields: Mapping[str, Any]) -> bytes:
    """Return the CDR bytes of a message; fields that are messages come from `message`."""
    return bytes(known_types().serialize_cdr(message(message_type, fields), message_type))


def message(message_type: str, fields: Mapping[str, Any]) -> object:
    """Return a message of a known type; all fields must be given."""
    make: Any = known_types().types[message_type]
    return make(**fields)


def header(stamp_ns: int, frame_id: str) -> object:
    """Return a std_msgs/Header."""
    sec, nanosec = divmod(stamp_ns, NS)
    return message(HEADER, {"stamp": message(TIME, {"sec": sec, "nanosec": nanosec}), "frame_id": frame_id})
