# SPDX-License-Identifier: Apache-2.0
"""Messages of the payload are decoded as rclpy writes them; one of an estimate says whether it tells anything."""

import struct

import numpy as np
import pytest
from geometry_msgs.msg import Inertia, Vector3
from rclpy.serialization import serialize_message

from scara_effmass.identification.payload import PayloadEstimate
from scara_effmass.model.load import load_robot
from scara_effmass.values import Payload
from scara_effmass.wire.payload import decode_payload, payload_estimate_message

MESSAGE = Inertia(m=2.5, com=Vector3(x=0.01, y=-0.02, z=0.1), ixx=1.0, ixy=0.4, ixz=0.5, iyy=2.0, iyz=0.6, izz=3.0)
PAYLOAD = Payload(2.5, (0.01, -0.02, 0.1), (1.0, 2.0, 3.0, 0.4, 0.5, 0.6))


def test_payload_is_decoded_in_either_byte_order() -> None:
    data = bytes(serialize_message(MESSAGE))
    assert decode_payload(data) == PAYLOAD
    assert decode_payload(b"\0\0\0\0" + struct.pack(">10d", *struct.unpack_from("<10d", data, 4))) == PAYLOAD


def test_incomplete_message_gives_the_reason() -> None:
    data = bytes(serialize_message(MESSAGE))
    assert decode_payload(data[:-8]) == "the payload is unknown: Inertia: the message ends at byte 76, before izz"
    assert str(decode_payload(b"")).startswith("the payload is unknown: Inertia: CDR byte order")


@pytest.mark.parametrize("unfit", ["", "the effort of joint2 is 0 while it moves"])
def test_load_of_torques_that_do_not_fit_is_not_observable(unfit: str) -> None:
    moment, of_joints = np.zeros(3), np.zeros(4)
    estimate = PayloadEstimate(1, 2.0, 0.1, 0.0, moment, moment, True, "", unfit, np.zeros((4, 2)), of_joints)  # noqa: FBT003
    message = payload_estimate_message(estimate, "text", load_robot())
    assert message.is_observable == (not unfit)
    assert message.mass_lower < message.mass < message.mass_upper
