"""Settings that robot files accept."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from scara_effmass.errors import RobotError
from scara_effmass.model.load import load_robot
from scara_effmass.settings import MonitorSettings

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize("extra", [{"payload_mass": 1.0}, {"locked_joints": ("joint1",)}])
def test_urdf_settings_raise_for_a_dh_file(omron_file: Path, extra: dict[str, object]) -> None:
    with pytest.raises(RobotError, match="must be unset for a DH file"):
        load_robot(omron_file, MonitorSettings.model_validate(extra))
