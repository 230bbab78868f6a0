# SPDX-License-Identifier: Apache-2.0
"""The worth of assumptions: signs by physics, and the same speeds as a monitor with the other value."""

import numpy as np
import pytest

from scara_effmass.analysis.assumption_worth import OTHERS, worth_of
from scara_effmass.codes import Assumption
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety.assumptions import assumptions_of, name_of
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share


@pytest.mark.parametrize("robot", ["", str(share("config", "robots", "ur5_robot.urdf"))])
def test_worth_has_a_row_for_each_assumption_and_the_signs_of_physics(robot: str) -> None:
    settings = MonitorSettings(robot=robot, person_speed=0.05)
    dynamics = RobotDynamics(load_robot(settings=settings))
    assumptions = assumptions_of(dynamics.robot, settings)
    usual, rows = worth_of(settings, dynamics, assumptions)
    assert usual > 0.0
    assert [row.name for row in rows] == list(map(name_of, Assumption))
    assert {row.name for row in rows if row.status == "assumed"} == set(map(name_of, assumptions.assumed))
    changes = {row.name: row.change for row in rows}
    rising = {name_of(Assumption.DRIVES), name_of(Assumption.CONTACT_SURFACE)}
    for code in OTHERS:
        change = changes[name_of(code)]
        if code is Assumption.CONTACT_SURFACE and dynamics.robot.hulls:
            assert change is None  # no bound holds for a known normal
            continue
        assert change is not None
        assert np.sign(change) == (1.0 if name_of(code) in rising else -1.0)
        assert change >= -usual
    assert changes[name_of(Assumption.MASSES)] is None


def test_a_value_that_other_settings_rule_out_has_no_worth() -> None:
    settings = MonitorSettings(contact_friction=0.3)
    dynamics = RobotDynamics(load_robot(settings=settings))
    _, rows = worth_of(settings, dynamics, assumptions_of(dynamics.robot, settings))
    assert {row.name: row.change for row in rows}[name_of(Assumption.CONTACT_SURFACE)] is None
