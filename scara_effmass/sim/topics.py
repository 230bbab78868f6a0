"""What the bench's recordings are made of."""

from __future__ import annotations

from scara_effmass.wire.topics import FORCE, JOINT_STATES

JOINT_STATES_TOPIC = f"/{JOINT_STATES}"
FORCE_TOPIC = f"/{FORCE}"
