"""`ContactState.msg` as a value."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scara_effmass.values import ContactAssessment, Verdict

if TYPE_CHECKING:
    from scara_effmass_msgs.msg import ContactState


def contact_from(message: ContactState) -> ContactAssessment:
    """Return what `message` says, as `safety` says it."""
    stamp, direction = message.header.stamp, message.direction
    special = {
        "stamp_ns": stamp.sec * 1_000_000_000 + stamp.nanosec,
        "direction": (direction.x, direction.y, direction.z),
        "verdict": Verdict(message.verdict),
    }
    fields = (special[name] if name in special else getattr(message, name) for name in ContactAssessment._fields)
    return ContactAssessment._make(fields)
