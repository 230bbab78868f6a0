"""What the bench's recordings are made of."""

from __future__ import annotations

JOINT_STATES_TOPIC = "/joint_states"
FORCE_TOPIC = "/force"
TEXT = "std_msgs/msg/String"
"""What a recording says of itself, as JSON, is of this type."""
