# SPDX-License-Identifier: Apache-2.0
"""`identify`: masses of an arm from a recording with effort; simulated joint states of a UR10 with wrong masses."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from scara_effmass.bags.writer import BagWriter
from scara_effmass.model.load import load_robot
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share
from scara_effmass.studies.load import CASES, robot_of, simulated
from scara_effmass.values import JointState
from test.cli.conftest import Cli, Refused

UR10 = CASES[1]
ROBOT = share("config", "robots", "ur10_robot.urdf")


def recording(path: Path, names: tuple[str, ...], stamps: NDArray[Any], *columns: NDArray[Any]) -> Path:
    with BagWriter(path) as bag:
        rows = zip(stamps.tolist(), *columns, strict=True)
        bag.write_joint_states("/joint_states", (JointState(stamp_ns, names, *row) for stamp_ns, *row in rows))
    return path


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording of a UR10 whose masses are 0.8 of those of the file."""
    robot = robot_of(UR10)
    light = robot.model.copy()
    for joint in range(1, light.njoints):
        stated = light.inertias[joint]
        light.inertias[joint] = pin.Inertia(0.8 * stated.mass, stated.lever, 0.8 * stated.inertia)
    states = simulated(replace(robot, model=light), UR10, 0.0, 30.0, np.random.default_rng(7))
    return recording(tmp_path_factory.mktemp("bag") / "simulated.mcap", robot.joint_names, *states)


def test_report_and_files(cli: Cli, bag: Path, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    done = cli("identify", bag, "--robot", ROBOT, "--contact-point", "ee_link", "-o", folder)
    assert (done.returncode, done.stderr) == (0, "")
    lines = {line[:16].strip(): line[16:].strip() for line in done.stdout.splitlines()}
    assert lines["motion"].startswith("36 of 36 base parameters move the torques")
    result = json.loads((folder / "identify.json").read_text())
    ratio = result["effective_mass"]["identified_over_file"]["median"]
    half = result["effective_mass"]["half_interval"]["median"]
    assert ratio - half * ratio < 0.8 < ratio + half * ratio
    assert result["mass_uncertainty"]["of_the_corrected_file"] > 0.0
    assert len(result["links"]) == len(result["joints"]) == 6
    assert {path.name for path in folder.iterdir()} == {
        *("identify.json", "identification.png", "identification.svg", "ur10_robot.urdf")
    }
    settings = MonitorSettings(contact_points=("ee_link",))
    corrected = load_robot(folder / "ur10_robot.urdf", settings)
    identified = np.array([link["identified"] for link in result["links"]])
    found = np.array([inertia.toDynamicParameters() for inertia in list(corrected.model.inertias)[1:]])
    np.testing.assert_allclose(found, identified, rtol=1e-6, atol=1e-8)
    text = (folder / "ur10_robot.urdf").read_text()
    assert "identified by scara-effmass from simulated.mcap (SHA-256 " in text
    again = cli("identify", bag, "--robot", ROBOT, "--contact-point", "ee_link", "-o", folder)
    assert (again.returncode, "already exists; use --force" in again.stderr) == (2, True)


def test_dh_file_gets_no_corrected_file(cli: Cli, tmp_path: Path) -> None:
    robot = robot_of(CASES[0])
    states = simulated(robot, CASES[0], 0.0, 10.0, np.random.default_rng(3))
    path = recording(tmp_path / "scara.mcap", robot.joint_names, *states)
    done = cli("identify", path, "-o", tmp_path / "out")
    assert done.returncode == 0
    assert "the robot is no URDF" in done.stdout
    assert not list((tmp_path / "out").glob("*.urdf"))


def test_effort_in_another_unit_does_not_fit(cli: Cli, tmp_path: Path) -> None:
    robot = robot_of(UR10)
    stamps, q, qd, effort = simulated(robot, UR10, 0.0, 10.0, np.random.default_rng(7))
    path = recording(tmp_path / "current.mcap", robot.joint_names, stamps, q, qd, 0.1 * effort)
    done = cli("identify", path, "--robot", ROBOT, "--json")
    assert done.returncode == 1
    assert "off the torque of the model" in json.loads(done.stdout)["unfit"]
    constants = [part for name in robot.joint_names for part in ("--torque-constants", f"{name}=10")]
    assert cli("identify", path, "--robot", ROBOT, *constants, "--json").returncode == 0


def test_recordings_without_torques_or_motion_are_refused(refused: Refused, bag: Path, tmp_path: Path) -> None:
    robot = robot_of(UR10)
    stamps, q, qd, effort = (values[:100] for values in simulated(robot, UR10, 0.0, 2.0, np.random.default_rng(7)))
    names, nothing = robot.joint_names, np.empty((100, 0))
    without = recording(tmp_path / "without.mcap", names, stamps, q, qd, nothing)
    assert "none of 100 joint states of the robot has velocity and effort" in refused(
        "identify", without, "--robot", ROBOT
    )
    zero = recording(tmp_path / "zero.mcap", names, stamps, q, qd, 0.0 * effort)
    assert "the effort is 0 throughout" in refused("identify", zero, "--robot", ROBOT)
    still = recording(tmp_path / "still.mcap", names, stamps, 0.0 * q, 0.0 * qd, effort)
    assert "no joint moves for long enough" in refused("identify", still, "--robot", ROBOT)
    assert "torque_constants = 'nose=1'" in refused("identify", bag, "--robot", ROBOT, "--torque-constants", "nose=1")
