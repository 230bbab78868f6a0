"""What the bench's recordings are made of."""

from __future__ import annotations

from scara_effmass.wire.topics import FORCE, JOINT_STATES, RUN_INFO

JOINT_STATES_TOPIC = f"/{JOINT_STATES}"
FORCE_TOPIC = f"/{FORCE}"
RUN_INFO_TOPIC = f"/{RUN_INFO}"
