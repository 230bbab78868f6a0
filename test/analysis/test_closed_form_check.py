"""The check accepts the published lumped masses of any SCARA and detects a wrong one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
import yaml

from scara_effmass.analysis.closed_form_check import ClosedFormCheck
from scara_effmass.errors import RobotError
from scara_effmass.model.dynamics import RobotDynamics
from scara_effmass.model.load import load_robot
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share
from scara_effmass.values import JointState

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from scara_effmass.values import ContactAssessment

SETTINGS = MonitorSettings()
SHIPPED = share("config", "omron_i4_550l.yaml")


def random_contacts(
    dynamics: RobotDynamics, count: int = 400
) -> Iterator[tuple[JointState, tuple[ContactAssessment, ...]]]:
    """Yield joint states over the joint ranges, every tenth at rest, and their assessments.

    They are 1 s apart, so that the monitor treats none of them as a continued motion.
    """
    monitor = Monitor(dynamics, SETTINGS)
    rng = np.random.default_rng(28)
    lower, upper = dynamics.robot.model.lowerPositionLimit, dynamics.robot.model.upperPositionLimit
    for number in range(1, count + 1):
        q = rng.uniform(lower, upper)
        qd = rng.uniform(-1.0, 1.0, len(q)) * (1e-4 if number % 10 == 0 else 1.0)
        state = JointState(number * 10**9, dynamics.robot.joint_names, q, qd)
        decision = monitor.assess(state, state.stamp_ns)
        assert decision is not None
        yield state, decision.contacts


def variant(path: Path, **changes: float) -> RobotDynamics:
    """Return the shipped robot with changed DH parameters, named like `theta_1`."""
    file = yaml.safe_load(SHIPPED.read_text(encoding="utf-8"))
    for key, value in changes.items():
        name, _, joint = key.rpartition("_")
        file["joints"][int(joint) - 1][name] = value
    path.write_text(yaml.safe_dump(file, sort_keys=False), encoding="utf-8")
    return RobotDynamics(load_robot(path, SETTINGS))


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"theta_1": 0.4, "theta_2": -0.9},
        {"alpha_1": np.pi, "alpha_2": 0.0},
        {"alpha_1": np.pi, "theta_1": 1.0, "theta_2": 0.5, "d_1": 0.3},
    ],
    ids=["shipped", "rotated joints", "elbow axis reversed", "all"],
)
def test_published_masses_match_the_closed_forms(changes: dict[str, float], tmp_path: Path) -> None:
    dynamics = variant(tmp_path / "robot.yaml", **changes)
    check = ClosedFormCheck(dynamics, SETTINGS.mass_cap)
    with_direction = at_rest = vertical = 0
    for state, contacts in random_contacts(dynamics):
        check.add(state, contacts)
        with_direction += contacts[0].direction != (0.0, 0.0, 0.0)
        at_rest += contacts[0].worst_direction_used
        vertical += abs(contacts[0].direction[2]) > 0.5
    rows, worst = check.result()
    assert rows == with_direction + at_rest == 400
    assert at_rest >= 30
    assert vertical >= 50
    assert worst < 1e-9


def test_wrong_mass_is_detected() -> None:
    dynamics = RobotDynamics(load_robot(SHIPPED, SETTINGS))
    check = ClosedFormCheck(dynamics, SETTINGS.mass_cap)
    for number, (state, contacts) in enumerate(random_contacts(dynamics, 50)):
        changed = contacts[0]._replace(lumped_mass=contacts[0].lumped_mass * (1.001 if number == 25 else 1.0))
        check.add(state, (changed,))
    assert check.result()[1] == pytest.approx(1e-3, rel=1e-3)


def test_joints_are_matched_by_name() -> None:
    dynamics = RobotDynamics(load_robot(SHIPPED, SETTINGS))
    check = ClosedFormCheck(dynamics, SETTINGS.mass_cap)
    for state, contacts in random_contacts(dynamics, 50):
        shuffled = state._replace(
            names=("gripper", *reversed(state.names)), position=np.append(9.0, state.position[::-1])
        )
        check.add(shuffled, contacts)
    assert check.result()[1] < 1e-9


def test_robot_other_than_a_scara_raises(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match="not a SCARA"):
        ClosedFormCheck(variant(tmp_path / "robot.yaml", a_3=0.05), SETTINGS.mass_cap)
