# SPDX-License-Identifier: Apache-2.0
"""A robot whose point moves in a plane alone."""

from dataclasses import replace

import numpy as np
import pinocchio as pin

from scara_effmass.model.robot import Robot
from scara_effmass.studies.load import CASES, robot_of


def planar_arm() -> Robot:
    """Return two links of 0.4 m that turn about parallel horizontal axes."""
    model = pin.Model()
    arm = robot_of(CASES[0])
    axis = pin.JointModelRY()
    for number, place in enumerate((pin.SE3.Identity(), pin.SE3(np.eye(3), np.array([0.4, 0.0, 0.0])))):
        joint = model.addJoint(number, axis, place, f"joint{number + 1}")
        model.appendBodyToJoint(
            joint, pin.Inertia(2.0, np.array([0.2, 0.0, 0.02]), 0.02 * np.eye(3)), pin.SE3.Identity()
        )
    model.lowerPositionLimit, model.upperPositionLimit = np.full(2, -3.0), np.full(2, 3.0)
    model.effortLimit, model.velocityLimit = np.full(2, 50.0), np.full(2, 3.0)
    model.armature = np.zeros(2)
    tool = model.addFrame(
        pin.Frame("tool", 2, 0, pin.SE3(np.eye(3), np.array([0.4, 0.0, 0.0])), pin.FrameType.OP_FRAME)
    )
    rotors = replace(robot_of(CASES[1]).rotors, matrix=np.zeros((2, 2)))
    return replace(arm, model=model, contact_frames={"tool": tool}, rotors=rotors, hulls={})
