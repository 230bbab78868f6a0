# SPDX-License-Identifier: Apache-2.0
"""`identify`: masses of an arm from a recording with effort; simulated joint states of a UR10 with wrong masses."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from numpy.typing import NDArray

from scara_effmass.bags.writer import BagWriter
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share
from scara_effmass.studies.load import CASES, robot_of, simulated
from scara_effmass.values import JointState
from test.cli.conftest import Cli, Refused

SCARA, UR10 = CASES[:2]
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
    corrected_file = result["mass_uncertainty"]["of_the_corrected_file"]
    assert 0.0 <= corrected_file - result["effective_mass"]["half_interval"]["p95"] < 0.001
    assert f"{corrected_file} for the corrected one; above 1 it cannot be stated" in lines["mass_uncertainty"]
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


def scara_recording(path: Path, load: float) -> Path:
    """Write a recording of an i4-550L with a `load` [kg] whose link 2 is 1.3 times as heavy as in the file."""
    robot = robot_of(SCARA)
    heavy = robot.model.copy()
    stated = heavy.inertias[2]
    heavy.inertias[2] = pin.Inertia(1.3 * stated.mass, stated.lever, 1.3 * stated.inertia)
    states = simulated(replace(robot, model=heavy), SCARA, load, 30.0, np.random.default_rng(2))
    return recording(path, robot.joint_names, *states)


@pytest.fixture(scope="module")
def scara_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return scara_recording(tmp_path_factory.mktemp("bag") / "scara.mcap", 0.0)


def test_corrected_dh_file_has_the_identified_bodies(cli: Cli, tmp_path: Path) -> None:
    bag = scara_recording(tmp_path / "scara.mcap", 0.1)
    done = cli("identify", bag, "--payload", "0.1", "-o", tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    result = json.loads((tmp_path / "identify.json").read_text())
    assert result["point_masses"] is None
    corrected = load_robot(tmp_path / "omron_i4_550l.yaml", MonitorSettings(payload_mass=0.1))
    found = np.array([inertia.toDynamicParameters() for inertia in list(corrected.model.inertias)[1:]])
    np.testing.assert_allclose(found, [link["identified"] for link in result["links"]], rtol=1e-6, atol=1e-8)
    assert corrected.payload_mass == pytest.approx(0.35)
    text = (tmp_path / "omron_i4_550l.yaml").read_text()
    assert f", for mass_uncertainty {result['mass_uncertainty']['of_the_corrected_file']:.3f}. " in text
    assert text.startswith("# Masses identified by scara-effmass from scara.mcap (SHA-256 ")


def test_lumped_masses_are_fitted_directly(cli: Cli, scara_bag: Path, tmp_path: Path) -> None:
    """The case of the paper: no inertia tensors are known. M2 and M3 are those of the heavier link 2."""
    rows = yaml.safe_load(share("config", "omron_i4_550l.yaml").read_text())
    for link in (*rows["links"], rows["payload"]):
        del link["inertia"]
    robot = tmp_path / "arm.yaml"
    robot.write_text(yaml.safe_dump(rows))
    done = cli("identify", scara_bag, "--robot", robot, "-o", tmp_path / "out")
    assert (done.returncode, done.stderr) == (0, "")
    assert "by axis, from the base: " in done.stdout
    result = json.loads((tmp_path / "out" / "identify.json").read_text())
    masses = result["point_masses"]
    np.testing.assert_allclose(masses["stated"][:2], [[1.94, 0.8], [1.58, 0.42]], rtol=1e-3)
    assert abs(masses["on_axes"][2] - (1.3 * 0.42 + 0.55)) < 1.96 * masses["axes_deviations"][2]
    assert masses["axes_deviations"][2] < 0.05
    corrected = RobotDynamics(load_robot(tmp_path / "out" / "arm.yaml"))
    assert corrected.full_reason
    assert corrected.lumped is not None
    pairs = [[link.kappa1 * link.mass, link.kappa2 * link.mass] for link in corrected.lumped.links]
    np.testing.assert_allclose(pairs[:2], masses["identified"][:2], rtol=1e-6)
    assert [sum(pair) for pair in pairs] == pytest.approx([sum(pair) for pair in masses["identified"]])


def test_model_lumped_fits_the_lumped_masses_of_a_robot_with_inertias(cli: Cli, scara_bag: Path) -> None:
    done = cli("identify", scara_bag, "--model", "lumped", "--json")
    assert done.returncode == 0
    assert json.loads(done.stdout)["point_masses"]["on_axes"][2] == pytest.approx(1.3 * 0.42 + 0.55, rel=0.1)


def test_a_load_that_is_not_there_gives_no_robot_file(cli: Cli, scara_bag: Path, tmp_path: Path) -> None:
    assert cli("identify", scara_bag, "-o", tmp_path).returncode == 0  # an earlier run leaves a robot file
    done = cli("identify", scara_bag, "--payload", "2", "-o", tmp_path, "--force")
    assert done.returncode == 0
    assert "is not physically possible without its stated load: check the payload" in " ".join(done.stdout.split())
    assert {path.suffix for path in tmp_path.iterdir()} == {".json", ".png", ".svg"}


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
    filtered = refused("identify", bag, "--robot", ROBOT, "--velocity", "from-positions")
    assert "velocity_source = from_positions, velocity_window = 0: must be reported and 0" in filtered
    robot = robot_of(UR10)
    stamps, q, qd, effort = (values[:100] for values in simulated(robot, UR10, 0.0, 2.0, np.random.default_rng(7)))
    names, nothing = robot.joint_names, np.empty((100, 0))
    without = recording(tmp_path / "without.mcap", names, stamps, q, qd, nothing)
    assert "100 of 100 joint states: no velocity or no effort" in refused("identify", without, "--robot", ROBOT)
    long = simulated(robot, UR10, 0.0, 30.0, np.random.default_rng(7))
    zero = recording(tmp_path / "zero.mcap", names, *long[:3], 0.0 * long.effort)
    assert "the effort is 0 throughout" in refused("identify", zero, "--robot", ROBOT)
    still = recording(tmp_path / "still.mcap", names, stamps, 0.0 * q, 0.0 * qd, effort)
    assert "no joint moves for long enough" in refused("identify", still, "--robot", ROBOT)
    assert "torque_constants = 'nose=1'" in refused("identify", bag, "--robot", ROBOT, "--torque-constants", "nose=1")
