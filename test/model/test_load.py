"""One door for all robot files."""

from __future__ import annotations

from pathlib import Path

import pytest

from scara_effmass.errors import RobotError
from scara_effmass.model.load import load_robot, robot_from_urdf
from scara_effmass.settings import MonitorSettings

OMRON = Path(__file__).resolve().parents[2] / "config" / "omron_i4_550l.yaml"
URDF = """<robot name="pendulum"><link name="base"/>
<link name="rod"><inertial><origin xyz="0.2 0 0"/><mass value="1.5"/>
<inertia ixx="0.001" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="hinge" type="continuous"><parent link="base"/><child link="rod"/><origin xyz="0 0 0.3"/>
<axis xyz="0 0 1"/></joint>
<link name="end"/>
<joint name="weld" type="fixed"><parent link="rod"/><child link="end"/><origin xyz="0.4 0 0"/></joint>
</robot>"""


def test_suffix_chooses_the_format(tmp_path: Path) -> None:
    urdf = tmp_path / "pendulum.urdf"
    urdf.write_text(URDF)
    upper = tmp_path / "OMRON.YML"
    upper.write_text(OMRON.read_text())
    assert load_robot(OMRON, MonitorSettings()).name == "omron_i4_550l"
    assert load_robot(upper, MonitorSettings()).name == "omron_i4_550l"
    assert load_robot(urdf, MonitorSettings()).name == "pendulum"


def test_settings_reach_a_urdf() -> None:
    robot = robot_from_urdf(URDF, "topic", MonitorSettings(contact_points=("rod",), payload_mass=2.0, locked_joints=()))
    assert list(robot.contact_frames) == ["rod"]
    assert robot.payload_mass == 2.0


def test_payload_of_a_dh_file_is_stated_there() -> None:
    with pytest.raises(RobotError, match=r"payload_mass = 1\.0: .*omron_i4_550l\.yaml states its payload itself"):
        load_robot(OMRON, MonitorSettings(payload_mass=1.0))


@pytest.mark.parametrize("name", ["none.urdf", "none.yaml", "none"])
def test_missing_file(tmp_path: Path, name: str) -> None:
    with pytest.raises(RobotError, match="cannot be read"):
        load_robot(tmp_path / name, MonitorSettings())


def test_neither_text_nor_yaml(tmp_path: Path) -> None:
    path = tmp_path / "robot.stl"
    path.write_bytes(b"\x80\x81\xff")
    with pytest.raises(RobotError, match=r"robot\.stl: neither a URDF nor a DH YAML file"):
        load_robot(path, MonitorSettings())
