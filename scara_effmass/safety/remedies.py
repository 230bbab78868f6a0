# SPDX-License-Identifier: Apache-2.0
"""What to do about each reason of a verdict, by its code."""

from scara_effmass.codes import Reason

ROBOT_FILE = "correct the robot file; `scara-effmass doctor --robot FILE` names the joint and the value"
DRIVER = "correct the driver that publishes the joint states"
STAMPS = "let one node alone publish the joint states, with the time of each measurement as its stamp"
NO_STAMPS = f"{STAMPS}; offline, `--time log` takes the recorder's time"
OWN_CLOCK = "offline, `--time header` assesses a recording on its own clock"
LATE = (
    "synchronize the clocks of robot and monitor; if both run on one machine, free it of other load; for the stamps of "
    f"a simulation set `use_sim_time`; {OWN_CLOCK}"
)
EARLY = (
    "synchronize the clocks of robot and monitor; with `use_sim_time`, start what publishes /clock, without which time "
    f"stands at 0; {OWN_CLOCK}"
)
CONNECTION = "check the driver and the topic; raise `timeout` above the period of the joint states"
NAMES = "give the robot's names by `joint_map`, those of joint states without names by `joint_names`"
PARTIAL = (
    "let one node publish all joints of the robot in one joint state; hold one that no driver reports, as that of a "
    "gripper, by `locked_joints`; if only the names differ, give the robot's by `joint_map`"
)
VELOCITY = "give a driver's velocities; without any, set `--velocity from-positions` (`velocity_source`)"
COMMANDS = "publish the controller's commands on joint_commands, or set `command_tolerance` to 0"
LOAD = "free the machine of other load, or assess fewer contact points"
MODEL = "choose effective_mass_model auto, or complete the inertial data of the robot file"
SLOWER = "lower the speed to the allowable one, or the moving mass; state the body regions that can be hit"

REMEDIES = {
    Reason.UNDECODABLE: DRIVER,
    Reason.NO_NAMES: NAMES,
    Reason.EMPTY_NAME: NAMES,
    Reason.NAMED_TWICE: DRIVER,
    Reason.MISSING_JOINT: PARTIAL,
    Reason.SEVERAL_NAMES: "make the entries of `joint_map` fit each joint once",
    Reason.OTHER_ARM: (
        "give the robot file of this arm by `--robot`; if these are joints beside it, name them in `ignored_joints`"
    ),
    Reason.POSITION_COUNT: DRIVER,
    Reason.VELOCITY_COUNT: DRIVER,
    Reason.NO_VELOCITY: VELOCITY,
    Reason.LONE_POSITION: "wait for the next joint state; publish them without gaps above `timeout`",
    Reason.SECOND_PUBLISHER: STAMPS,
    Reason.ZERO_STAMP: NO_STAMPS,
    Reason.FUTURE_STAMP: EARLY,
    Reason.OLD_STAMP: LATE,
    Reason.REPEATED_STAMP: NO_STAMPS,
    Reason.BACKWARD_STAMP: STAMPS,
    Reason.COARSE_CLOCK: "publish /clock more often (`ros2 bag play --clock 100`), or raise `timeout`",
    Reason.TWO_PUBLISHERS: "let one node alone publish on the topic that the reason names",
    Reason.POSITION_NOT_FINITE: DRIVER,
    Reason.VELOCITY_NOT_FINITE: DRIVER,
    Reason.POSITION_LIMIT: (
        "correct the limits in the robot file, or the zero position and unit of the driver; declare a joint continuous "
        "that is off by whole turns"
    ),
    Reason.SPEED_LIMIT: "correct the maximum speed in the robot file, or the unit of the driver",
    Reason.VELOCITY_MISMATCH: (
        "check units, signs, order and filters of the velocities; raise `max_velocity_lag` or `position_tolerance` for "
        "a slow or coarse sensor; if the driver reports none, as zeros, set `--velocity from-positions`"
    ),
    Reason.UNCONFIRMED_ZERO: "wait until the joint has moved, or rested for 0.1 s",
    Reason.NO_COMMAND: COMMANDS,
    Reason.OLD_COMMAND: COMMANDS,
    Reason.COMMAND_MISMATCH: "find out why the robot does not follow; raise `command_tolerance` above the usual lag",
    Reason.PAYLOAD_UNKNOWN: (
        "let one node alone publish the payload on `payload_topic`, one that a robot can carry: mass, centre of mass "
        "and inertia; or leave the topic empty"
    ),
    Reason.GAP: f"{CONNECTION}; if a clock was set ahead, wait",
    Reason.SILENCE: CONNECTION,
    Reason.NO_JOINT_STATE: CONNECTION,
    Reason.ONLY_OTHER_JOINTS: NAMES,
    Reason.OTHER_JOINTS_SINCE: CONNECTION,
    Reason.UNMODELLED_MOTION: (
        "let the model move this joint by a robot file with it, contact points beyond it and no `locked_joints`; name "
        "it, or the parts of a gripper by a pattern, in `ignored_joints` only if it moves nothing that can hit a "
        "person; once its device is gone, call `~/reset` of the monitor"
    ),
    Reason.HELD_ELSEWHERE: (
        "let the model move this joint by contact points beyond it and no `locked_joints`, or fix it in the robot file "
        "where it is; name it in `ignored_joints` only if its position changes neither masses nor geometry"
    ),
    Reason.HELD_UNREPORTED: (
        "let a node publish these joints, too; name them in `locked_joints` if they stay at zero or their limit "
        "nearest to it, or in `ignored_joints` if their motion changes neither masses nor geometry and drives no base"
    ),
    Reason.NO_MASSES: ROBOT_FILE,
    Reason.NO_LUMPED_MASS: MODEL,
    Reason.NO_FULL_MASS: MODEL,
    Reason.NO_CLAMPING_FORCE: "state effort limits that carry the arm in the file, or `external_force_limit`",
    Reason.TOO_LIGHT: ROBOT_FILE,
    Reason.NO_WORST_MASS: MODEL,
    Reason.TOO_FAST: SLOWER,
    Reason.NEAR_LIMIT: SLOWER,
    Reason.PERSON_TOO_FAST: (
        "keep walking people away and lower `person_speed`, or state `person_direction`; keep that body region out of "
        "reach and state the others; or lower the moving mass"
    ),
    Reason.LIGHT_MODEL: "choose effective_mass_model auto, full or largest",
    Reason.ASSUMED: "state it by its option or in the robot file; or accept it by its name in `accept_assumptions`",
    Reason.CLAMPED: "lower the effort limits, or set `external_force_limit` of a safety function",
    Reason.UNSTATED_LOAD: "state what the robot carries: `payload_mass` and `payload_com`, or `payload_topic`",
    Reason.HEAVIER_LOAD: "state what the robot carries: `payload_mass` and `payload_com`, or `payload_topic`",
    Reason.TURNS: "lower the acceleration of that joint, or leave out soft body regions that it cannot reach",
    Reason.KERNEL_DISAGREES: "report it; the monitor goes on with the reference alone, or start it again",
    Reason.TOO_SLOW: LOAD,
    Reason.STUCK: LOAD,
    Reason.NO_ROBOT: f"start robot_state_publisher, or give the robot file by `--robot`; {ROBOT_FILE}",
    Reason.ROBOT_CHANGES: "wait until its model is computed; if that takes too long, give its meshes fewer triangles",
    Reason.DEACTIVATED: "activate the monitor",
    Reason.SHUTDOWN: "start the monitor again",
    Reason.NODE_ERROR: "report the error with the log of the node, and start the monitor again",
    Reason.STATED: "see the reasons in the table of the assessments",
    Reason.NO_MONITOR: "check that a monitor runs in this namespace and ROS domain",
    Reason.TWO_MONITORS: "let one monitor alone publish in a namespace",
    Reason.MONITOR_SILENT: "look at the log of the monitor, and start it again if it does not answer",
    Reason.NO_CONTACT_STATES: "start the monitor and the driver of the robot",
}
"""Remedy of each code but NONE."""


def remedy(reason: Reason) -> str:
    """Return what to do about `reason`; empty for none."""
    return REMEDIES.get(reason, "")
