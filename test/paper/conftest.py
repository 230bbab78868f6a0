"""The paper's robot, its shipped recording, and synthetic impacts."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from scara_effmass.model.dynamics import RobotDynamics
from scara_effmass.model.load import load_robot
from scara_effmass.paper.figure_specs import FigureInputs
from scara_effmass.paper.motion import tool_motion
from scara_effmass.paper.protocol import OBSTACLES_KG, POINTS, REPETITIONS, SPEED
from scara_effmass.paper.recorded_impact import RecordedImpact, root_reduced_mass
from scara_effmass.paper.scara import scara_of
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share

if TYPE_CHECKING:
    from scara_effmass.paper.motion import ToolMotion
    from scara_effmass.paper.scara import Scara

STIFFNESS = 1e6


@pytest.fixture(scope="session")
def dynamics() -> RobotDynamics:
    return RobotDynamics(load_robot(share("config", "omron_i4_550l.yaml"), MonitorSettings()))


@pytest.fixture(scope="session")
def scara(dynamics: RobotDynamics) -> Scara:
    return scara_of(dynamics)


@pytest.fixture(scope="session")
def motion(scara: Scara) -> ToolMotion:
    return tool_motion(share("bags", "straight_300_200"), scara, ("joint1", "joint2"), "generated", contact_x=0.3)


@pytest.fixture(scope="session")
def inputs(dynamics: RobotDynamics, scara: Scara, motion: ToolMotion) -> FigureInputs:
    return FigureInputs(dynamics, scara, motion)


@pytest.fixture(scope="session")
def runs(scara: Scara) -> tuple[RecordedImpact, ...]:
    """Half-sine impacts of two masses and a linear spring, for every case of the paper."""
    time = np.arange(0.0, 0.006, 1.0 / 12_800.0)
    impacts = []
    for point in POINTS:
        for mass in OBSTACLES_KG:
            root = root_reduced_mass(scara, point, mass)
            peak, duration = SPEED * root * STIFFNESS**0.5, np.pi * root / STIFFNESS**0.5
            force = np.where(time < duration, peak * np.sin(np.pi * time / duration), 0.0)
            for repetition in range(REPETITIONS):
                scatter = 1.0 + 0.01 * (repetition - 1)
                impacts.append(
                    RecordedImpact(point, mass, SPEED, scatter * peak, time, scatter * force, simulated=True)
                )
    return tuple(impacts)
