# SPDX-License-Identifier: Apache-2.0
"""What each assumption of an assessment is worth: the allowable speed if another value were true."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np

from scara_effmass.codes import Assumption
from scara_effmass.errors import EffmassError
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.safety.assumptions import RULES, Assumptions, name_of
from scara_effmass.settings import Drives, MonitorSettings
from scara_effmass.values import Verdict

POSES = 40
TYPICAL_SPEED = 0.25
"""Speed of the fastest contact point [m/s]: that of manual reduced speed (ISO 10218-1)."""

Change = Callable[[MonitorSettings, RobotDynamics], Mapping[str, Any]]
OTHERS: Mapping[Assumption, tuple[str, Change]] = {
    Assumption.PAYLOAD: ("1 kg more", lambda settings, _: {"payload_mass": settings.payload_mass + 1.0}),
    Assumption.ROTOR_INERTIA: (
        "0.1 kg m2 more at each joint",
        lambda _, dynamics: {
            "armature": tuple(
                f"{name}={value + 0.1}"
                for name, value in zip(
                    dynamics.robot.joint_names, np.diag(dynamics.robot.rotors.matrix).tolist(), strict=True
                )
            )
        },
    ),
    Assumption.DRIVES: ("joints that yield", lambda *_: {"drives": Drives.FREE}),
    Assumption.CONTACT_AREA: ("half the area", lambda settings, _: {"contact_area_m2": settings.contact_area_m2 / 2}),
    Assumption.CONTACT_SURFACE: ("normal along the velocity", lambda *_: {"contact_normal": "velocity"}),
    Assumption.PERSON_SPEED: ("a person who walks, 1.6 m/s", lambda *_: {"person_speed": 1.6}),
    Assumption.ACCELERATION: ("3 m/s2", lambda *_: {"max_acceleration": 3.0}),
    Assumption.CONTACT_DAMPING: ("ratio 0.6", lambda *_: {"contact_damping": 0.6}),
    Assumption.CONTACT_FRICTION: ("coefficient 0.5", lambda *_: {"contact_friction": 0.5}),
}
"""For each assumption another value, and the settings with it."""


class Worth(NamedTuple):
    """Row of the table: name of an assumption, whether it is stated, another value, and how that changes the speed.

    `change` [m/s] is that of the mean allowable speed, None where it cannot be computed.
    """

    name: str
    status: str
    other: str
    change: float | None


def worth_of(settings: MonitorSettings, dynamics: RobotDynamics, assumptions: Assumptions) -> tuple[float, list[Worth]]:
    """Return the mean allowable speed [m/s] of the fastest contact in POSES configurations, and a row per rule."""
    usual, rows = _mean_speed(settings, dynamics), []
    for code in RULES:
        status = "assumed" if code in assumptions.assumed else "accepted" if code in assumptions.accepted else "stated"
        other, change = OTHERS.get(code, ("", None))
        difference = None
        if change is not None:
            with suppress(EffmassError, ValueError):  # another statement of the settings rules this value out
                changed = MonitorSettings.model_validate({**settings.model_dump(), **change(settings, dynamics)})
                same_robot = (changed.armature, changed.payload) == (settings.armature, settings.payload)
                robot = dynamics if same_robot else RobotDynamics(load_robot(settings=changed))
                difference = _mean_speed(changed, robot) - usual
        rows.append(Worth(name_of(code), status, other, difference))
    return usual, rows


def _mean_speed(settings: MonitorSettings, dynamics: RobotDynamics) -> float:
    """Return the mean of the speed [m/s] of the fastest contact at which the first one reaches its limit.

    It is 0 where a verdict is UNKNOWN.
    """
    robot, monitor = dynamics.robot, Monitor(dynamics, settings)
    q = robot.sample_configurations(POSES)
    qd = np.cos(np.outer(np.arange(POSES), np.arange(1.0, q.shape[1] + 1.0)))
    speeds = monitor.assess_configurations(q, qd).contacts["speed"].max(axis=1)
    qd *= (TYPICAL_SPEED / np.maximum(speeds, math.ulp(1.0)))[:, None]
    contacts = monitor.assess_configurations(q, qd).contacts
    allowed = np.where(contacts["verdict"] == Verdict.UNKNOWN, 0.0, contacts["allowable_speed"])
    factors = allowed / np.maximum(contacts["speed"], math.ulp(1.0))
    return TYPICAL_SPEED * float(factors.min(axis=1).mean())
