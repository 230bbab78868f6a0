# SPDX-License-Identifier: Apache-2.0
"""Robots for the tests of the kernel."""

import pytest

from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import MonitorSettings


@pytest.fixture(scope="session")
def scara() -> RobotDynamics:
    """The shipped SCARA, one contact point on the tool axis."""
    return RobotDynamics(load_robot(settings=MonitorSettings(contact_points=("tool",))))
