# SPDX-License-Identifier: Apache-2.0
"""Whether the torques of the joints show a heavier load than the stated one. It never makes the robot lighter."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

from scara_effmass.codes import Reason
from scara_effmass.identification.payload import PayloadEstimate, PayloadEstimator, mass_gain
from scara_effmass.kernel.intervals import Intervals
from scara_effmass.kernel.records import IntArray
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import FloatArray

ALARM = 5.0
"""Standard deviations by which the load must be above the stated one to count as heavier."""
MIN_SHARE = 0.01
"""Smallest share of the mass of the arm by which it must be: no model of friction and motors is better."""


class Doubt(NamedTuple):
    """A load above the stated one: HEAVIER_LOAD or UNSTATED_LOAD and the text, NONE without one."""

    reason: Reason = Reason.NONE
    text: str = ""


def _used(settings: MonitorSettings) -> tuple[object, ...]:
    return (
        settings.effort_uncertainty,
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
        """Compare with the load of `dynamics`."""
        robot = dynamics.robot
        self._dynamics, self._settings = dynamics, _used(settings)
        self._margin = 1.0 + settings.mass_uncertainty
        self._constants = robot.torque_constants
        self.why_not = ""
        if not settings.effort_uncertainty:
            self.why_not = "effort_uncertainty is 0"
        elif dynamics.full_reason:
            self.why_not = f"it needs the full mass: {dynamics.full_reason}"
        elif settings.filters_velocity:
            self.why_not = "it needs velocities as reported"
        self._new_intervals = partial(Intervals, robot.periods, settings.timeout)
        self._new_estimator = partial(
            PayloadEstimator,
            robot,
            effort_uncertainty=settings.effort_uncertainty,
            mass_uncertainty=settings.mass_uncertainty,
            stated=robot.payload_mass,
            link_uncertainty=settings.link_uncertainty,
        )
        self.forget()

    def is_of(self, dynamics: RobotDynamics, settings: MonitorSettings) -> bool:
        """Return whether the joint states so far count with these."""
        return dynamics is self._dynamics and _used(settings) == self._settings

    def forget(self) -> None:
        """Discard the joint states so far."""
        self._intervals, self._estimator = self._new_intervals(), self._new_estimator()
        self.estimate: PayloadEstimate | None = None
        self.doubt = Doubt()

    def wait(self, stamp_ns: int, q: FloatArray, qd: FloatArray, effort: FloatArray) -> bool:
        """Keep the next joint state (n,) for `watch` if it can wait; return whether it is kept."""
        return self._intervals.wait(stamp_ns, q, qd, effort * self._constants)

    def watch(self, stamps: IntArray, q: FloatArray, qd: FloatArray, effort: FloatArray) -> Iterator[tuple[int, Doubt]]:
        """Yield what is in doubt from which of the next N joint states on, unless `why_not`.

        `effort` (N, n) is as received.
        """
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

    @property
    def further_load(self) -> float | None:
        """Upper end of the interval of the load beyond the stated one [kg]; None where it is not observable."""
        estimate = self.estimate
        if estimate is None or estimate.unfit or not estimate.is_observable:
            return None
        return max(0.0, estimate.interval[1] - estimate.stated)

    def _doubt(self, estimate: PayloadEstimate) -> Doubt:
        if estimate.unfit:
            return Doubt()
        lower, _ = estimate.interval
        if self.doubt.reason:
            # The text stays the same, so that it does not change with each estimate.
            return self.doubt if lower > estimate.stated else Doubt()
        smallest = MIN_SHARE * self._dynamics.robot.moving_mass
        if estimate.mass - estimate.stated <= max(ALARM * estimate.deviation, smallest):
            return Doubt()
        text = f"the torques show a load of {_interval(estimate)}, not the stated {estimate.stated:.2f} kg"
        return Doubt(Reason.UNSTATED_LOAD if self._exceeds_margin(estimate) else Reason.HEAVIER_LOAD, text)

    def _exceeds_margin(self, estimate: PayloadEstimate) -> bool:
        """Return whether the load adds more than `mass_uncertainty` to the largest effective mass anywhere."""
        load = estimate.mass - estimate.stated
        return mass_gain(self._dynamics.robot, load, estimate.moment) > self._margin
