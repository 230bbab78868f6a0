# SPDX-License-Identifier: Apache-2.0
"""QoS profiles of rclpy."""

import math

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from scara_effmass.wire.topics import Qos


def qos_profile(qos: Qos) -> QoSProfile:
    """Return a new profile, which rclpy may modify when a parameter overrides it."""
    durations = {
        "deadline": qos.deadline_s,
        "lifespan": qos.lifespan_s,
        "liveliness_lease_duration": qos.lease_s,
    }
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=qos.depth,
        reliability=ReliabilityPolicy.RELIABLE if qos.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if qos.latched else DurabilityPolicy.VOLATILE,
        **{policy: Duration(seconds=seconds) for policy, seconds in durations.items() if seconds < math.inf},
    )
