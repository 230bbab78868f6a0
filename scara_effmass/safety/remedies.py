# SPDX-License-Identifier: Apache-2.0
"""What to do about each reason of a verdict."""

import re
from functools import cache

ROBOT_FILE = "correct the robot file; `scara-effmass doctor --robot FILE` names the joint and the value"
DRIVER = "correct the driver that publishes the joint states"
STAMPS = "let one node alone publish the joint states, with the time of each measurement as its stamp"
CLOCKS = "synchronize the clocks of robot and monitor; offline, `--time header` assesses a recording on its own clock"
CONNECTION = "check the driver and the topic; raise `timeout` above the period of the joint states"
NAMES = "give the robot's names by `joint_map`, those of joint states without names by `joint_names`"
VELOCITY = "give a driver's velocities; without any, set `--velocity from-positions` (`velocity_source`)"
MODEL = "choose effective_mass_model auto, or complete the inertial data of the robot file"
SLOWER = "lower the speed to the allowable one, or the moving mass; state the body regions that can be hit"

REMEDIES: dict[str, str] = {
    "named none of the robot's joints": NAMES,
    "no joint state": CONNECTION,
    "joint state number … follows number …": STAMPS,
    "no joint command": "publish the controller's commands on joint_commands, or set `command_tolerance` to 0",
    "off its command": "find out why the robot does not follow; raise `command_tolerance` above the usual lag",
    "the joint state has no names": NAMES,
    "name … of the joint state is empty": NAMES,
    "joint … is named twice": DRIVER,
    "joint … is missing": NAMES,
    "joint_map gives joint … several names": "make the entries of `joint_map` fit each joint once",
    "positions for … names": DRIVER,
    "velocities for … names": DRIVER,
    "the velocity is empty": VELOCITY,
    "the header stamp is zero": f"{STAMPS}; offline, `--time log` takes the recorder's time",
    "/clock moves in steps of": "publish /clock more often (`ros2 bag play --clock 100`), or raise `timeout`",
    "s in the future": CLOCKS,
    "the joint state is … s old": CLOCKS,
    "the header stamp is repeated": STAMPS,
    "the header stamp goes back by": STAMPS,
    "off the integral of its velocity": (
        "check units, signs, order and filters of the velocities; raise `max_velocity_lag` or `position_tolerance` for "
        "a slow or coarse sensor"
    ),
    "reads zero, not yet confirmed": "wait until the joint has moved, or rested for 0.1 s",
    "the position of … is …": DRIVER,
    "the velocity of … is …": DRIVER,
    "a position is not finite": DRIVER,
    "lies outside its limits": "correct the limits in the robot file, or the zero position and unit of the driver",
    "exceeds its maximum speed": "correct the maximum speed in the robot file, or the unit of the driver",
    "JointState: …": DRIVER,
    "the clamping force is unknown": "state effort limits that carry the arm in the file, or `external_force_limit`",
    "choose effective_mass_model": MODEL,
    "no lumped mass": MODEL,
    "mass = … kg: ": ROBOT_FILE,
    "placeholders, not data": ROBOT_FILE,
    "publishers of the payload": "let one node alone publish the payload",
    "no payload": "publish the payload on the `payload_topic`, or leave that empty",
    "the payload is unknown": "publish a payload that a robot can carry: mass, centre of mass and inertia",
    "no mass behind": ROBOT_FILE,
    "no robot_description": "start robot_state_publisher, or give the robot file by `--robot`",
    "robot_description: …": ROBOT_FILE,
    "the contact points change": "wait for the next joint state, which is assessed with the new robot",
    "the compiled kernel disagrees": "report it; the monitor goes on with Pinocchio alone, or start it again",
    "the assessment": "free the machine of other load, or assess fewer contact points",
    "the monitor was deactivated": "activate the monitor",
    "the node shuts down": "start the monitor again",
    "the node ends: …": "report the error with the log of the node, and start the monitor again",
    "no monitor": "check that a monitor runs in this namespace and ROS domain",
    "two monitors publish": "let one monitor alone publish in a namespace",
    "the monitor is silent": "look at the log of the monitor, and start it again if it does not answer",
    "no contact state yet": "start the monitor and the driver of the robot",
    "speed that is not a number": "install the same version of scara_effmass for monitor and display",
    "m/s is above": SLOWER,
    "m/s is close to": SLOWER,
    "mass of … kg is below the": "choose effective_mass_model auto, full or largest",
    "the drives can clamp with": "lower the effort limits, or set `external_force_limit` of a safety function",
    "other reasons": "see the reasons in the table of the assessments",
}
"""Remedies by a part of the reason, "…" standing for any text; the first one that fits counts."""


@cache
def _patterns() -> dict[re.Pattern[str], str]:
    return {re.compile(re.escape(part).replace("…", ".*")): remedy for part, remedy in REMEDIES.items()}


def remedy(reason: str) -> str:
    """Return what to do about `reason`; empty for one that is not the monitor's, or for none."""
    return next((remedy for pattern, remedy in _patterns().items() if pattern.search(reason)), "")
