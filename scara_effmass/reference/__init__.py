# SPDX-License-Identifier: Apache-2.0
"""Effective mass and allowable speed at one joint state, as paper and standard have them, over Pinocchio.

Slow and plain: it defines what the kernel computes, and checks it. Start at `dynamics`.
"""

from scara_effmass.reference.assessment import ContactResult, JointAcceleration, assess
from scara_effmass.reference.dynamics import ContactPoint, ContactState, PoseState, RobotDynamics

__all__ = ["ContactPoint", "ContactResult", "ContactState", "JointAcceleration", "PoseState", "RobotDynamics", "assess"]
