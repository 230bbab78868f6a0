# SPDX-License-Identifier: Apache-2.0
"""Position limits in the settings."""

import pytest

from scara_effmass.errors import SettingsError
from scara_effmass.settings import MonitorSettings, checked


def test_spaces_around_the_name_do_not_matter() -> None:
    settings = checked(MonitorSettings, {"joint_limits": [" joint1 = -1 1", "joint2=0 0.5"]}, "node")
    assert settings.position_limits == {"joint1": (-1.0, 1.0), "joint2": (0.0, 0.5)}


def test_two_limits_of_one_joint_are_refused() -> None:
    """The wider ones could win."""
    with pytest.raises(SettingsError, match="'joint1=-2 2': must state the limits of joint1 once"):
        checked(MonitorSettings, {"joint_limits": ["joint1=-1 1", "joint1=-2 2"]}, "node")
