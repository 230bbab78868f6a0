# SPDX-License-Identifier: Apache-2.0
"""Compile the kernel once, before several processes do so at the same time."""

from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings

settings = MonitorSettings()
Monitor(RobotDynamics(load_robot(settings=settings)), settings).compile()
