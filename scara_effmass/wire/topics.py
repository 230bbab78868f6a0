# SPDX-License-Identifier: Apache-2.0
"""Names and quality of service of the suite's topics. Relative names follow the node's namespace."""

import math
from typing import NamedTuple

CLOCK = "/clock"
"""Simulated time."""
DIAGNOSTICS = "/diagnostics"
"""State of every node, once a second."""
JOINT_STATES = "joint_states"
"""Positions and velocities of the joints, which the monitor assesses."""
JOINT_COMMANDS = "joint_commands"
"""Commands of the robot's controller."""
ROBOT_DESCRIPTION = "robot_description"
"""URDF of the robot."""
PAYLOAD = "payload"
"""Load that the robot carries; `payload_topic` states the name of the topic."""
CONTACT_STATES = "contact_states"
"""Verdict, masses, force and allowable speed of all contact points at each joint state."""
ALLOWABLE_SPEED = "allowable_speed"
"""Smallest allowable speed of the contact points [m/s], 0 under UNKNOWN."""
SPEED_SCALING = "speed_scaling"
"""Allowable speed over the present one, or over `reference_speed`, 0 to 1; 0 under UNKNOWN."""
PAYLOAD_ESTIMATE = "payload_estimate"
"""Load of the robot by the torques of its joints, with its interval, about once per second of motion."""
SPEED_SCALING_INPUT = "joint_trajectory_controller/speed_scaling_input"
"""Input of the joint trajectory controller, under its usual name; remap it for another."""
FORCE = "force"
"""Blocks of 0.1 s of samples; further channels of the converter follow one level below, as force/ai1."""
IMPACT = "impact"
"""Each impact that is found in the force."""
WRENCH = "wrench"
"""The force at `wrench_rate`, for ordinary tools."""
IMPACT_VALIDATION = "impact_validation"
"""Each measured impact against its prediction, and the statistics of the series."""
RUN_INFO = "run_info"
"""What the robot hits: mass and plate of the obstacle, name of the configuration."""
MARKERS = "effective_mass_markers"
"""Robot, masses and verdicts for RViz and Foxglove."""
READINESS = "/scara_effmass/readiness"
"""Topic on which every node reports to a replay whether it is ready."""

MONITOR_OUTPUTS = (CONTACT_STATES, ALLOWABLE_SPEED, SPEED_SCALING, PAYLOAD_ESTIMATE)
FORCE_OUTPUTS = (FORCE, IMPACT, WRENCH)
"""Outputs of `daq_node`; channels after the first publish one level below, as force/ai1."""
RECORDED = (
    JOINT_STATES,
    PAYLOAD,
    *MONITOR_OUTPUTS,
    *FORCE_OUTPUTS,
    IMPACT_VALIDATION,
    ROBOT_DESCRIPTION,
    DIAGNOSTICS,
    "/tf",
    "/tf_static",
    RUN_INFO,
    MARKERS,
)
"""Topics that `record` records by default."""


class Qos(NamedTuple):
    """Quality of service; history is always keep-last."""

    depth: int
    reliable: bool = True
    latched: bool = False
    """Transient local: late subscribers receive the last messages."""
    deadline_s: float = math.inf
    """Maximum time between two messages that the publisher offers [s]."""
    lifespan_s: float = math.inf
    """Age from which a message that was not yet read is discarded [s]."""
    lease_s: float = math.inf
    """Time after which a publisher without a sign of life counts as lost [s]."""


STREAM_QOS = Qos(5000)
"""5 s of messages at 1 kHz: Fast DDS notices a lost message by the heartbeat, which comes every 3 s."""
SCALAR_LIFESPAN_S = 2.0
"""For allowable_speed and speed_scaling, whose messages have no stamp that shows their age."""
_DEADLINE_PER_TIMEOUT = 2.0
_MIN_LEASE_S = 0.1
FORCE_QOS = Qos(100)
"""A slow subscriber loses blocks; the acquisition never waits."""
INFO_QOS = Qos(10, latched=True)
DESCRIPTION_QOS = Qos(1, latched=True)
CLOCK_QOS = Qos(10)
JOINT_STATES_INPUT_QOS = Qos(1000, reliable=False)
"""Best effort matches every publisher."""
VALIDATOR_INPUT_QOS = Qos(20_000)
"""Holds the messages that arrive while the validator writes a report."""
CLIENT_QOS = Qos(2000)


def verdict_qos(timeout_s: float) -> Qos:
    """Return the quality of service of `contact_states`, for a monitor that publishes after `timeout_s` of silence."""
    deadline_s = _DEADLINE_PER_TIMEOUT * timeout_s
    return STREAM_QOS._replace(deadline_s=deadline_s, lease_s=max(deadline_s, _MIN_LEASE_S))
