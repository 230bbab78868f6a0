# SPDX-License-Identifier: Apache-2.0
"""Whether the torques of the joints show a heavier load than the stated one. It never makes the robot lighter."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from scara_effmass.codes import Reason
from scara_effmass.identification.payload import PayloadEstimate, PayloadEstimator, mass_gain
from scara_effmass.kernel.admission import METRES_PER_RADIAN
from scara_effmass.kernel.intervals import Intervals
from scara_effmass.kernel.records import IntArray
from scara_effmass.model.joint_values import joint_values
from scara_effmass.model.robot import Robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import FloatArray

ALARM = 5.0
"""Standard deviations by which the load must be above the stated one to count as heavier."""
REST_SPEED = 0.01
"""Speed below which a joint may rest [rad/s; a quarter of it in m/s]."""


class Doubt(NamedTuple):
    """A load above the stated one: HEAVIER_LOAD or UNSTATED_LOAD and the text, NONE without one."""

    reason: Reason = Reason.NONE
    text: str = ""


def torque_constants_of(robot: Robot, settings: MonitorSettings) -> FloatArray:
    """Return the torque (n,) per unit of effort. Raises RobotError for `torque_constants` of no joint."""
    stated = joint_values(settings.torque_constants, robot.joint_names, "torque_constants")
    return np.array([stated.get(name, 1.0) for name in robot.joint_names])


def rest_speeds_of(robot: Robot) -> FloatArray:
    """Return the speeds (n,) below which the joints may rest [rad/s, m/s]."""
    return REST_SPEED * np.where(robot.revolute, 1.0, METRES_PER_RADIAN)


def _used(settings: MonitorSettings) -> tuple[object, ...]:
    return (
        settings.effort_uncertainty,
        settings.torque_constants,
        settings.link_uncertainty,
        settings.mass_uncertainty,
        settings.filters_velocity,
        settings.timeout,
    )


def _interval(estimate: PayloadEstimate) -> str:
    return "{:.2f} kg ({:.2f} to {:.2f})".format(estimate.mass, *estimate.interval)


class LoadWatch:
    """Estimates the load of the last link from joint states with effort. `why_not` says why it cannot."""

    def __init__(self, dynamics: RobotDynamics, settings: MonitorSettings) -> None:
        """Compare with the load of `dynamics`. Raises RobotError for `torque_constants` of no joint."""
        robot = dynamics.robot
        self._dynamics, self._settings = dynamics, _used(settings)
        self._robot, self._margin = robot, 1.0 + settings.mass_uncertainty
        self._constants = torque_constants_of(robot, settings)
        self.why_not = ""
        if not settings.effort_uncertainty:
            self.why_not = "effort_uncertainty is 0"
        elif dynamics.full_reason:
            self.why_not = f"it needs the full mass: {dynamics.full_reason}"
        elif settings.filters_velocity:
            self.why_not = "it needs velocities as reported"
        self._stated = robot.payload_mass
        self._rest_speeds = rest_speeds_of(robot)
        self._effort_uncertainty, self._mass_uncertainty = settings.effort_uncertainty, settings.mass_uncertainty
        self._timeout_s, self._link_uncertainty = settings.timeout, settings.link_uncertainty
        self.forget()

    def is_of(self, dynamics: RobotDynamics, settings: MonitorSettings) -> bool:
        """Return whether the joint states so far count with these."""
        return dynamics is self._dynamics and _used(settings) == self._settings

    def forget(self) -> None:
        """Discard the joint states so far."""
        self._intervals = Intervals(self._robot.periods, self._timeout_s)
        self._estimator = PayloadEstimator(
            self._robot,
            rest_speeds=self._rest_speeds,
            effort_uncertainty=self._effort_uncertainty,
            mass_uncertainty=self._mass_uncertainty,
            stated=self._stated,
            link_uncertainty=self._link_uncertainty,
        )
        self.estimate: PayloadEstimate | None = None
        self.doubt = Doubt()

    def watch(self, stamps: IntArray, q: FloatArray, qd: FloatArray, effort: FloatArray) -> Iterator[tuple[int, Doubt]]:
        """Yield what is in doubt from which of the next N joint states on; `effort` (N, n) as received."""
        if self.why_not:
            return
        rows, means = self._intervals.add(stamps, q, qd, effort * self._constants)
        for row, mean in zip(rows.tolist(), means, strict=True):
            estimate = self._estimator.add(int(stamps[row]), mean)
            if estimate is not None:
                self.estimate = estimate
                before, self.doubt = self.doubt, self._doubt(estimate)
                if self.doubt != before:
                    yield row, self.doubt

    @property
    def text(self) -> str:
        """The load by the torques, or why it is unknown."""
        estimate = self.estimate
        if self.why_not or estimate is None:
            return f"unknown: {self.why_not or 'it needs joint states with effort, and about a second of motion'}"
        if estimate.unfit:
            return f"unknown: {estimate.unfit}: state torque_constants, or set effort_uncertainty to 0"
        if not estimate.is_observable:
            return f"not observable by this motion ({_interval(estimate)}): move {estimate.telling_joint} to and fro"
        return _interval(estimate)

    def _doubt(self, estimate: PayloadEstimate) -> Doubt:
        if estimate.unfit:
            return Doubt()
        lower, _ = estimate.interval
        if self.doubt.reason:
            # The text stays the same, so that it does not change with each estimate.
            return self.doubt if lower > estimate.stated else Doubt()
        if estimate.mass - estimate.stated <= ALARM * estimate.deviation:
            return Doubt()
        text = f"the torques show a load of {_interval(estimate)}, not the stated {estimate.stated:.2f} kg"
        return Doubt(Reason.UNSTATED_LOAD if self._exceeds_margin(estimate) else Reason.HEAVIER_LOAD, text)

    def _exceeds_margin(self, estimate: PayloadEstimate) -> bool:
        """Return whether the load adds more than `mass_uncertainty` to the largest effective mass anywhere."""
        gain = mass_gain(self._robot, estimate.mass - estimate.stated, estimate.moment)
        return gain > self._margin
