# SPDX-License-Identifier: Apache-2.0
"""The paper's robot, the shipped campaign, and synthetic impacts."""

from dataclasses import replace

import numpy as np
import pytest

from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share
from scara_effmass.studies.runs import (
    REPETITIONS,
    FigureInputs,
    RecordedRun,
    points_by_mass,
    read_inputs,
    root_reduced_mass,
)
from scara_effmass.studies.scara import OBSTACLES_KG, Scara

STIFFNESS = 1e6


@pytest.fixture(scope="session")
def dynamics() -> RobotDynamics:
    return RobotDynamics(
        load_robot(share("config", "omron_i4_550l.yaml"), MonitorSettings(contact_points=("tool", "elbow")))
    )


@pytest.fixture(scope="session")
def shipped(dynamics: RobotDynamics) -> FigureInputs:
    return read_inputs(dynamics, share("bags", "campaign"))


@pytest.fixture(scope="session")
def scara(shipped: FigureInputs) -> Scara:
    return shipped.scara


@pytest.fixture(scope="session")
def runs(shipped: FigureInputs) -> tuple[RecordedRun, ...]:
    """Half-sine impacts of two masses and a linear spring, for every case of the paper."""
    time = np.arange(0.0, 0.006, 1.0 / 12_800.0)
    runs = []
    for point in points_by_mass(shipped.scara, shipped.runs):
        for mass in OBSTACLES_KG:
            root = root_reduced_mass(shipped.scara, point, mass)
            peak, duration = 0.25 * root * STIFFNESS**0.5, np.pi * root / STIFFNESS**0.5
            force = np.where(time < duration, peak * np.sin(np.pi * time / duration), 0.0)
            for scatter in np.linspace(0.99, 1.01, REPETITIONS).tolist():
                run = replace(shipped.shown_run, point=point, obstacle_mass=mass, peak_force=scatter * peak)
                runs.append(replace(run, force_time=time, force=scatter * force))
    return tuple(runs)


@pytest.fixture(scope="session")
def inputs(shipped: FigureInputs, runs: tuple[RecordedRun, ...]) -> FigureInputs:
    return replace(shipped, runs=runs)
