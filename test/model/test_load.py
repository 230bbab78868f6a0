# SPDX-License-Identifier: Apache-2.0
"""Settings that robot files accept."""

from pathlib import Path

import pytest

from scara_effmass.errors import RobotError
from scara_effmass.model.description import contact_point
from scara_effmass.model.load import load_robot
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share


def test_urdf_settings_raise_for_a_dh_file(omron_file: Path) -> None:
    with pytest.raises(RobotError, match=r"locked_joints = .*: must be unset for a DH file"):
        load_robot(omron_file, MonitorSettings(locked_joints=("joint1",)))


def test_payload_of_a_topic_is_named_before_it_is_known() -> None:
    robot = load_robot(settings=MonitorSettings(payload_topic="load"))
    assert robot.payload_text == "0.25 kg (robot file) + 0 kg (topic load)"


def test_a_stated_load_of_zero_is_not_called_unstated() -> None:
    ur5 = share("config", "robots", "ur5_robot.urdf")
    assert load_robot(ur5, MonitorSettings()).payload_text == "0 kg (not stated)"
    assert load_robot(ur5, MonitorSettings(payload_mass=0.0)).payload_text == "0 kg (parameter payload_mass)"


def test_link_of_a_contact_point_may_hold_a_colon() -> None:
    assert contact_point("rim=left:tool: 0 0.5 -1") == ("rim", "left:tool", (0.0, 0.5, -1.0))
