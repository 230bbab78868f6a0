# SPDX-License-Identifier: Apache-2.0
"""Accelerations of joints from settings and joint limits files."""

from pathlib import Path

import pytest

from scara_effmass.errors import RobotError
from scara_effmass.model.joint_values import max_joint_accelerations

JOINTS = ("a", "b")
MOVEIT = """\
default_acceleration_scaling_factor: 0.1
joint_limits:
  a: {has_velocity_limits: true, max_velocity: 2.0, has_acceleration_limits: true, max_acceleration: 3}
  b: {has_velocity_limits: true, max_velocity: 2.0, has_acceleration_limits: false, max_acceleration: 0.0}
  other: {has_acceleration_limits: true, max_acceleration: 9.0}
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "joint_limits.yaml"
    path.write_text(MOVEIT)
    return path


def test_an_entry_wins_over_the_joint_limits_file(file: Path) -> None:
    found = max_joint_accelerations([str(file), "b=2.5"], JOINTS)
    assert found is not None
    assert found.tolist() == [3.0, 2.5]
    found = max_joint_accelerations(["b=0", "a = 1", str(file)], JOINTS)
    assert found is not None
    assert found.tolist() == [1.0, 0.0]
    assert max_joint_accelerations([], JOINTS) is None


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        (["a=1"], "max_joint_acceleration: must be stated for every joint: it is missing for b"),
        (["a=1", "c=2"], "max_joint_acceleration = 'c=2': joint must be one of a, b"),
        (["a=1", "a=2", "b=1"], "max_joint_acceleration = 'a=2': joint must be stated once"),
        (["a=1", "b=-2"], "max_joint_acceleration = 'b=-2': must be"),
        (["a=1", "b=nan"], "max_joint_acceleration = 'b=nan': must be"),
        (["missing.yaml"], "missing.yaml: cannot be read"),
    ],
)
def test_wrong_entries_are_refused(entries: list[str], message: str) -> None:
    with pytest.raises(RobotError) as error:
        max_joint_accelerations(entries, JOINTS)
    assert str(error.value).startswith(message)


@pytest.mark.parametrize("value", ["true", "-1.0", ".inf", "fast", "[1]"])
def test_wrong_acceleration_in_a_joint_limits_file_is_refused(file: Path, value: str) -> None:
    file.write_text(MOVEIT.replace("max_acceleration: 3}", f"max_acceleration: {value}}}"))
    with pytest.raises(RobotError, match=r"joint_limits: a: max_acceleration = .*: must be"):
        max_joint_accelerations([str(file)], JOINTS)


def test_a_file_without_joint_limits_is_refused(file: Path) -> None:
    file.write_text("a: 1\n")
    with pytest.raises(RobotError, match="joint_limits: must be a mapping"):
        max_joint_accelerations([str(file)], JOINTS)
