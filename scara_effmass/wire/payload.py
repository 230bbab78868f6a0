# SPDX-License-Identifier: Apache-2.0
"""Decode geometry_msgs/Inertia messages to `Payload`, and convert PayloadEstimate messages from `PayloadEstimate`."""

from geometry_msgs.msg import Vector3
from scara_effmass_msgs import msg

from scara_effmass.errors import DecodeError
from scara_effmass.identification.payload import PayloadEstimate
from scara_effmass.model.robot import Robot
from scara_effmass.values import FloatArray, Payload
from scara_effmass.wire.cdr import decode, sec_and_nanosec


def decode_payload(data: bytes) -> Payload | str:
    """Return the payload in `data` (Inertia in CDR of either byte order), unchecked, or why it is unknown."""
    try:
        m, com, ixx, ixy, ixz, iyy, iyz, izz = decode(data, "Inertia").values()
    except DecodeError as error:
        return f"the payload is unknown: {error}"
    return Payload(m, com, (ixx, iyy, izz, ixy, ixz, iyz))


def payload_estimate_message(estimate: PayloadEstimate, text: str, robot: Robot) -> msg.PayloadEstimate:
    """Return the message of an estimate of the load of `robot`; `text` says what its numbers mean."""
    lower, upper = estimate.interval
    message = msg.PayloadEstimate(
        mass=estimate.mass,
        mass_lower=lower,
        mass_upper=upper,
        stated_mass=estimate.stated,
        moment=_vector(estimate.moment),
        moment_deviation=_vector(estimate.moment_deviations),
        is_observable=estimate.is_observable and not estimate.unfit,
        text=text,
        joint_names=robot.joint_names,
        coulomb_friction=estimate.friction[:, 0].tolist(),
        viscous_friction=estimate.friction[:, 1].tolist(),
        effort_error=estimate.scale_errors.tolist(),
    )
    message.header.stamp.sec, message.header.stamp.nanosec = sec_and_nanosec(estimate.stamp_ns)
    message.header.frame_id = robot.last_link
    return message


def _vector(values: FloatArray) -> Vector3:
    x, y, z = values.tolist()
    return Vector3(x=x, y=y, z=z)
