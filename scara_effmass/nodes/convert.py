"""From decisions to messages."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from scara_effmass_msgs.msg import ContactState

    from scara_effmass.values import ContactAssessment

_LAST_SECOND = 2**31 - 1


def fill_contact_state(message: ContactState, contact: ContactAssessment) -> None:
    """Write `contact` into `message`, whose frame is set already and which the caller reuses."""
    seconds, message.header.stamp.nanosec = divmod(contact.stamp_ns, 1_000_000_000)
    message.header.stamp.sec = min(seconds, _LAST_SECOND)
    direction = message.direction
    direction.x, direction.y, direction.z = contact.direction
    message.contact_point = contact.contact_point
    message.speed = contact.speed
    message.effective_mass = contact.effective_mass
    message.lumped_mass = contact.lumped_mass
    message.full_mass = contact.full_mass
    message.iso_mass = contact.iso_mass
    message.worst_direction_mass = contact.worst_direction_mass
    message.obstacle_mass = contact.obstacle_mass
    message.reduced_mass = contact.reduced_mass
    message.stiffness = contact.stiffness
    message.predicted_force = contact.predicted_force
    message.allowable_speed = contact.allowable_speed
    message.margin = contact.margin
    message.body_region = contact.body_region
    message.criterion = contact.criterion
    message.verdict = int(contact.verdict)
    message.reason = contact.reason
    message.input_age = contact.input_age
    message.worst_direction_used = contact.worst_direction_used
    message.mass_capped = contact.mass_capped
    message.smallest_singular_value = contact.smallest_singular_value
