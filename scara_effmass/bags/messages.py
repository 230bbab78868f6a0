"""Messages of any known type in CDR, for recordings."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from scara_effmass.bags.definitions import known_types
from scara_effmass.wire.cdr import NS
from scara_effmass.wire.message_types import HEADER, JOINT_STATE, TIME

if TYPE_CHECKING:
    from collections.abc import Mapping

    from scara_effmass.values import JointState


def serialized(kind: str, fields: Mapping[str, Any]) -> bytes:
    """Return the CDR bytes of a message of type `kind`; fields that are messages come from `message`."""
    return bytes(known_types().serialize_cdr(message(kind, fields), kind))


def message(kind: str, fields: Mapping[str, Any]) -> object:
    """Return a message of a known type, all of whose fields are given."""
    make: Any = known_types().types[kind]
    return make(**fields)


def header(stamp_ns: int, frame_id: str) -> object:
    """Return a std_msgs/Header."""
    sec, nanosec = divmod(stamp_ns, NS)
    return message(HEADER, {"stamp": message(TIME, {"sec": sec, "nanosec": nanosec}), "frame_id": frame_id})


def joint_state_message(state: JointState, frame_id: str = "") -> bytes:
    """Return a sensor_msgs/JointState without effort."""
    return serialized(
        JOINT_STATE,
        {
            "header": header(state.stamp_ns, frame_id),
            "name": list(state.names),
            "position": np.asarray(state.position, np.float64),
            "velocity": np.asarray(state.velocity, np.float64),
            "effort": np.empty(0),
        },
    )
