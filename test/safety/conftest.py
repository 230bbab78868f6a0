# SPDX-License-Identifier: Apache-2.0
"""Robots for the tests of the monitor: the shipped SCARA and variants of it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share

SHIPPED = share("config", "omron_i4_550l.yaml")


def variant(directory: Path, change: Callable[[dict[str, Any]], object]) -> RobotDynamics:
    """Return the shipped SCARA, watched at its tool alone, with its file changed by `change`."""
    file = yaml.safe_load(SHIPPED.read_text(encoding="utf-8"))
    del file["contact_points"]["elbow"]
    change(file)
    path = directory / "robot.yaml"
    path.write_text(yaml.safe_dump(file, sort_keys=False), encoding="utf-8")
    return RobotDynamics(load_robot(path, MonitorSettings(contact_points=tuple(file["contact_points"]))))


@pytest.fixture
def scara_variant(tmp_path: Path) -> Callable[[Callable[[dict[str, Any]], object]], RobotDynamics]:
    """Return the function that gives the shipped SCARA with its file changed."""
    return lambda change: variant(tmp_path, change)


@pytest.fixture(scope="session")
def scara() -> RobotDynamics:
    """The shipped SCARA, one contact point on the tool axis."""
    return RobotDynamics(load_robot(SHIPPED, MonitorSettings(contact_points=("tool",))))


@pytest.fixture(scope="session")
def offset_scara(tmp_path_factory: pytest.TempPathFactory) -> RobotDynamics:
    """The SCARA with a second contact point beside the tool axis, which joint 4 moves."""
    return variant(tmp_path_factory.mktemp("offset"), lambda file: file["contact_points"].update(rim=[0.05, 0.0, 0.0]))


@pytest.fixture(scope="session")
def bare_scara(tmp_path_factory: pytest.TempPathFactory) -> RobotDynamics:
    """The SCARA of which no inertia is known: there is no full model of it."""

    def strip(file: dict[str, Any]) -> None:
        for body in (*file["links"], file["payload"]):
            body.pop("inertia", None)

    return variant(tmp_path_factory.mktemp("bare"), strip)


@pytest.fixture(scope="session")
def skew_scara(tmp_path_factory: pytest.TempPathFactory) -> RobotDynamics:
    """The SCARA with intersecting first axes and the first centre of mass beside their plane: it cannot be lumped."""

    def tilt(file: dict[str, Any]) -> None:
        file["joints"][0] |= {"a": 0.0, "alpha": 1.1}
        file["links"][0]["com"] = [0.08, 0.05, 0.0]
        for body in (*file["links"], file["payload"]):
            body["inertia"] = [body["inertia"]] * 3 + [0.0] * 3

    return variant(tmp_path_factory.mktemp("skew"), tilt)


@pytest.fixture(scope="session")
def light_scara(tmp_path_factory: pytest.TempPathFactory) -> RobotDynamics:
    """The SCARA with a forearm of more inertia than its lumped masses have, so that its lumped model is too light."""

    def widen(file: dict[str, Any]) -> None:
        file["links"][1]["inertia"] = 0.08

    return variant(tmp_path_factory.mktemp("light"), widen)
