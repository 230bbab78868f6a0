# SPDX-License-Identifier: Apache-2.0
"""Robots for the tests of the model: the shipped file, variants of it, and URDF files."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import ArrayLike

from scara_effmass.errors import RobotError
from scara_effmass.model.load import load_robot
from scara_effmass.model.robot import Robot
from scara_effmass.reference import ContactState, RobotDynamics
from scara_effmass.settings import MonitorSettings

REPOSITORY = Path(__file__).resolve().parents[2]
OMRON = REPOSITORY / "config" / "omron_i4_550l.yaml"
ROBOT_FOLDERS = (REPOSITORY / "test" / "robots", REPOSITORY / "config" / "robots")


@pytest.fixture(scope="session")
def omron_file() -> Path:
    return OMRON


@pytest.fixture(scope="session")
def omron() -> Robot:
    """Return the shipped robot with the contact point at its tool alone."""
    return load_robot(OMRON, MonitorSettings(contact_points=("tool",)))


@pytest.fixture(scope="session")
def omron_dynamics(omron: Robot) -> RobotDynamics:
    return RobotDynamics(omron)


@pytest.fixture
def omron_rows() -> dict[str, Any]:
    """Return the shipped file's content with the tool alone and without boxes, to be varied."""
    rows: dict[str, Any] = yaml.safe_load(OMRON.read_text())
    del rows["contact_points"]["elbow"]
    for link in rows["links"]:
        link.pop("boxes", None)
    return rows


@pytest.fixture
def load_rows(tmp_path: Path) -> Callable[[object], Robot]:
    """Write a DH file and load it."""

    def load(rows: object) -> Robot:
        path = tmp_path / "robot.yaml"
        path.write_text(yaml.safe_dump(rows, sort_keys=False), encoding="utf-8")
        return load_robot(path)

    return load


@pytest.fixture(scope="session")
def along() -> Callable[..., ContactState]:
    """Return the function that gives the first contact point, moving along `n`."""

    def contact_along(dynamics: RobotDynamics, q: ArrayLike, n: ArrayLike) -> ContactState:
        q = np.asarray(q, dtype=float)
        qd = np.linalg.pinv(dynamics.at(q).contacts[0].jacobian) @ np.asarray(n, dtype=float)
        (contact,) = dynamics.at(q, qd).contacts
        assert contact.direction is not None
        assert np.allclose(contact.direction, np.asarray(n) / np.linalg.norm(n), atol=1e-6)
        return contact

    return contact_along


@pytest.fixture(scope="session")
def load_urdf_file() -> Callable[..., Robot]:
    """Load a URDF of `test/robots` or `config/robots` with the monitor settings given by keyword."""

    def load(name: str, **options: object) -> Robot:
        (path,) = (folder / name for folder in ROBOT_FOLDERS if (folder / name).exists())
        return load_robot(path, MonitorSettings.model_validate(options))

    return load


@pytest.fixture(scope="session")
def assert_raises_or_finite() -> Callable[[Callable[[], Robot]], None]:
    """Require that a spoilt robot is refused in one line, or else gives masses or says why it has none."""

    def require(load: Callable[[], Robot]) -> None:
        try:
            dynamics = RobotDynamics(load())
        except RobotError as error:
            message = str(error)
            assert "\n" not in message
            return
        for masses in dynamics.at(dynamics.robot.sample_configurations()[0], np.ones(dynamics.robot.model.nv)).contacts:
            assert np.isfinite(masses.speed)
            assert masses.full > 0.0 or dynamics.full_reason
            assert masses.lumped > 0.0 or masses.no_lumped_mass(masses.direction) is not None

    return require
