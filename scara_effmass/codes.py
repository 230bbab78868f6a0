# SPDX-License-Identifier: Apache-2.0
"""Codes of reasons, assumptions, models and criteria in arrays and messages; `safety.reasons` makes their texts."""

from enum import IntEnum


class Reason(IntEnum):
    """Why a verdict is not OK; each comment names what the reason holds besides its code.

    Codes below `POSITION_COUNT` lie in the names of a joint state and refuse it before its stamp is checked; those from
    there to `LONE_POSITION` lie in its lengths and count after the stamp.
    """

    NONE = 0
    UNDECODABLE = 1  # detail: what is wrong
    NO_NAMES = 2
    EMPTY_NAME = 3  # values: index
    NAMED_TWICE = 4  # detail: name
    MISSING_JOINT = 5  # joint; detail: suggested joint_map
    SEVERAL_NAMES = 6  # detail: reported and possible names
    OTHER_ARM = 7  # detail: names that continue those of the robot's joints
    POSITION_COUNT = 10  # values: positions, names
    VELOCITY_COUNT = 11  # values: velocities, names
    NO_VELOCITY = 12
    LONE_POSITION = 13
    SECOND_PUBLISHER = 20  # values: number, number before
    ZERO_STAMP = 21
    FUTURE_STAMP = 22  # values: lead [s]
    OLD_STAMP = 23  # values: age [s]
    REPEATED_STAMP = 24
    BACKWARD_STAMP = 25  # values: step back [s]
    COARSE_CLOCK = 26  # values: lead, step of /clock [s]
    TWO_PUBLISHERS = 27  # detail: of which topic
    POSITION_NOT_FINITE = 30  # joint; values: position
    VELOCITY_NOT_FINITE = 31  # joint; values: velocity
    POSITION_LIMIT = 32  # joint; values: position, lower, upper limit
    SPEED_LIMIT = 33  # joint; values: velocity, largest speed
    VELOCITY_MISMATCH = 34  # joint; values: excess
    UNCONFIRMED_ZERO = 35  # joint
    NO_COMMAND = 36
    OLD_COMMAND = 37  # values: age [s]
    COMMAND_MISMATCH = 38  # joint; values: difference
    PAYLOAD_UNKNOWN = 39  # detail: why
    GAP = 40  # values: duration [s]
    SILENCE = 41  # values: duration [s]
    NO_JOINT_STATE = 42
    ONLY_OTHER_JOINTS = 43  # values: duration [s], joint states of other devices; detail: their names
    OTHER_JOINTS_SINCE = 44  # the same, after joint states of the robot
    UNMODELLED_MOTION = 45  # detail: joint outside the model, and why it counts as moving
    UNSTATED_LOAD = 46  # detail: load by the torques, and the stated one
    HELD_ELSEWHERE = 47  # values: position, that in the model [rad, m]; detail: joint that the model holds
    HELD_UNREPORTED = 48  # detail: joints that the model holds, not all of which are reported
    NO_MASSES = 50
    NO_LUMPED_MASS = 51  # values: why there is none
    NO_FULL_MASS = 52
    NO_CLAMPING_FORCE = 53
    TOO_LIGHT = 54  # values: model, mass [kg]
    NO_WORST_MASS = 55  # values: model
    TOO_FAST = 60  # values: speed, allowable speed [m/s], criterion, body region, those of LIGHT_MODEL
    NEAR_LIMIT = 61  # the same
    LIGHT_MODEL = 62  # values: four zeros, mass, best mass [kg]
    ASSUMED = 63
    PERSON_TOO_FAST = 64  # values: as TOO_FAST, with the person's speed and the one that the limit allows at rest [m/s]
    CLAMPED = 65  # values: force [N]
    TURNS = 66  # joint; values: angle [rad] or path [m]
    HEAVIER_LOAD = 67  # detail: as UNSTATED_LOAD
    KERNEL_DISAGREES = 70  # detail: field
    TOO_SLOW = 71  # values: duration [s]
    STUCK = 72
    NO_ROBOT = 80  # detail: why
    ROBOT_CHANGES = 81
    DEACTIVATED = 82
    SHUTDOWN = 83
    NODE_ERROR = 84  # detail: error
    STATED = 90  # detail: the text
    # What displays conclude by themselves:
    NO_MONITOR = 100
    TWO_MONITORS = 101
    MONITOR_SILENT = 102  # values: duration [s]
    NO_CONTACT_STATES = 103


class Assumption(IntEnum):
    """What an assessment assumes unless it is stated; `safety.assumptions` has the table of them."""

    PAYLOAD = 1
    ROTOR_INERTIA = 2
    DRIVES = 3
    CONTACT_AREA = 4
    CONTACT_SURFACE = 5
    PERSON_SPEED = 6
    CONTACT_POINTS = 7
    MASSES = 8
    ACCELERATION = 9
    CONTACT_DAMPING = 10
    CONTACT_FRICTION = 11


class ModelCode(IntEnum):
    """Model of the effective mass."""

    NONE = 0
    LUMPED = 1
    FULL = 2
    ISO = 3


class CriterionCode(IntEnum):
    """Limit that governs a speed."""

    NONE = 0
    FORCE = 1
    PRESSURE = 2


class NoLumpedMass(IntEnum):
    """Why a contact point has no lumped mass along a direction, or along all of them (MASSLESS)."""

    NOT_THERE = 0
    NOT_DEFINITE = 1
    MASSLESS = 2
    MASSLESS_JOINT = 3
    """Plus the index of the joint that moves the contact point, but no lumped mass."""


class ModelReason(IntEnum):
    """Why a model decides."""

    NONE = 0
    SETTING = 1
    HEAVY_ENOUGH = 2
    LIGHTER = 3
    LARGEST = 4
    NO_LUMPED = 5
    """Plus `NoLumpedMass`: the full model decides alone. See `only_iso` for the case without a full model."""

    @classmethod
    def only_iso(cls, no_lumped: int, joints: int) -> int:
        """Return the code of ISO's mass that decides alone, of a robot with this number of `joints`."""
        return cls.NO_LUMPED + NoLumpedMass.MASSLESS_JOINT + joints + no_lumped
