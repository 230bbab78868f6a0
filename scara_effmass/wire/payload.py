# SPDX-License-Identifier: Apache-2.0
"""Decode geometry_msgs/Inertia messages to `Payload`."""

from scara_effmass.errors import DecodeError
from scara_effmass.values import Payload
from scara_effmass.wire.cdr import decode


def decode_payload(data: bytes) -> Payload | str:
    """Return the payload in `data` (Inertia in CDR of either byte order), unchecked, or why it is unknown."""
    try:
        m, com, ixx, ixy, ixz, iyy, iyz, izz = decode(data, "Inertia").values()
    except DecodeError as error:
        return f"the payload is unknown: {error}"
    return Payload(m, com, (ixx, iyy, izz, ixy, ixz, iyz))
