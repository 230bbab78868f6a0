"""The suite's values as messages in CDR, for recordings."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from scara_effmass.bag_io.cdr import NS
from scara_effmass.bag_io.definitions import HEADER, JOINT_STATE, OWN_PACKAGE, known_types

if TYPE_CHECKING:
    from collections.abc import Mapping

    from scara_effmass.values import ContactAssessment, JointState

CONTACT_STATE = f"{OWN_PACKAGE}/msg/ContactState"
VECTOR3 = "geometry_msgs/msg/Vector3"
TIME = "builtin_interfaces/msg/Time"


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


def contact_state_message(contact: ContactAssessment, frame_id: str) -> bytes:
    """Return a scara_effmass_msgs/ContactState; `frame_id` is the frame of its direction."""
    fields: dict[str, Any] = contact._asdict()
    fields["header"] = header(fields.pop("stamp_ns"), frame_id)
    fields["direction"] = message(VECTOR3, dict(zip("xyz", contact.direction, strict=True)))
    return serialized(CONTACT_STATE, fields)
