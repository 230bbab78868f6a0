# SPDX-License-Identifier: Apache-2.0
"""Whether the torques of the joints show another load than the stated one. It never makes the robot lighter."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

from scara_effmass.codes import Reason
from scara_effmass.identification.payload import PayloadEstimate, PayloadEstimator, mass_gain
from scara_effmass.identification.regression import LEVER, link_parameters
from scara_effmass.kernel.intervals import Intervals
from scara_effmass.kernel.records import IntArray
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import FloatArray, at_least, at_most

ALARM = 5.0
"""Standard deviations by which mass or moment of the load must differ from the stated one to contradict it."""
WITHDRAWN = 2.5
"""Standard deviations within which the moment must be, and by which the load in doubt must differ, to end a doubt."""
MIN_SHARE = 0.01
"""Smallest share of the mass of the arm, and of an effective mass, that counts: no model of friction is better."""


class Doubt(NamedTuple):
    """A load that makes the robot heavier than the stated one: HEAVIER_LOAD or UNSTATED_LOAD and the text, or NONE."""

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
    lower, upper = estimate.interval
    return f"{max(0.0, estimate.mass):.2f} kg ({at_most(lower, 2)} to {at_least(upper, 2)})"


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

    def of(self, dynamics: RobotDynamics, settings: MonitorSettings) -> LoadWatch:
        """Return the watch with these: this one, or a new one, which keeps the doubt unless another load is stated."""
        if dynamics is self._dynamics and _used(settings) == self._settings:
            return self
        watch = LoadWatch(dynamics, settings)
        before, after = (link_parameters(one.robot.model)[:, :4].sum(axis=0) for one in (self._dynamics, dynamics))
        # In shares of what counts: less is the same load.
        mass, *moment = (after - before) / MIN_SHARE
        if abs(mass) <= self._smallest and not self._is_large(np.array(moment)):
            watch.doubt, watch._doubted = self.doubt, self._doubted
        return watch

    def forget(self) -> None:
        """Discard the joint states so far."""
        self._intervals, self._estimator = self._new_intervals(), self._new_estimator()
        self.estimate: PayloadEstimate | None = None
        self.doubt = Doubt()
        self._doubted: PayloadEstimate | None = None
        self._told_mass = 0.0
        self._judged: tuple[PayloadEstimate, float] | None = None

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
            needs = "it needs joint states with finite effort of all joints, and about a second of motion"
            return f"unknown: {self.why_not or needs}"
        if estimate.unfit:
            return f"unknown: {estimate.unfit}: check torque_constants, masses and mounting of the robot file, payload"
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
        """Return what is in doubt. Only an estimate that shows the stated load ends a doubt: ignorance does not."""
        before = self.doubt
        if estimate.unfit:
            return before
        lower, upper = estimate.interval
        moment = np.abs(estimate.moment)
        if not self._contradicts(estimate, moment):
            is_close = (moment <= WITHDRAWN * estimate.moment_deviations).all() or not self._is_large(moment)
            is_stated = lower <= estimate.stated + self._smallest and is_close
            return Doubt() if is_stated and self._excludes_doubted(estimate) else before
        # The text stays the same while it is true, so that it does not change with each estimate.
        is_true = not estimate.is_observable or lower <= self._told_mass <= upper
        if is_true and before.reason is Reason.UNSTATED_LOAD:
            return before
        gain = self._gain(estimate)
        if gain <= 1.0 + MIN_SHARE and not self._is_heavier(estimate):  # the robot is lighter
            return Doubt() if self._excludes_doubted(estimate) else before
        reason = Reason.UNSTATED_LOAD if gain > self._margin else Reason.HEAVIER_LOAD
        if is_true and reason is before.reason:
            return before
        self._doubted, self._told_mass = estimate, estimate.mass
        text = f"the torques show a load of {_interval(estimate)}, not the stated {estimate.stated:.2f} kg"
        if not self._is_heavier(estimate):
            text = f"{text} at its centre of mass: the moment is {np.linalg.norm(moment):.3f} kg m off"
        return Doubt(reason, text)

    def _excludes_doubted(self, estimate: PayloadEstimate) -> bool:
        """Return whether an estimate rules out the load in doubt, which a poor one does not."""
        doubted = self._doubted
        if doubted is None or not estimate.is_observable:
            return False
        if self._is_heavier(doubted):
            return doubted.mass - estimate.mass > WITHDRAWN * math.hypot(estimate.deviation, doubted.deviation)
        changes = np.abs(estimate.moment - doubted.moment)
        deviations = np.hypot(estimate.moment_deviations, doubted.moment_deviations)
        return bool((changes > WITHDRAWN * deviations).any())

    def _gain(self, estimate: PayloadEstimate) -> float:
        """Return `mass_gain`, the last one while the estimate is the same within its deviations: it takes 9 ms."""
        if self._judged is not None:
            before, gain = self._judged
            changes = np.append(estimate.moment - before.moment, estimate.mass - before.mass)
            if (np.abs(changes) <= np.append(estimate.moment_deviations, estimate.deviation)).all():
                return gain
        gain = mass_gain(self._dynamics.robot, estimate.mass - estimate.stated, estimate.moment)
        self._judged = estimate, gain
        return gain

    @property
    def _smallest(self) -> float:
        """Smallest mass [kg] that counts."""
        return MIN_SHARE * self._dynamics.robot.moving_mass

    def _is_heavier(self, estimate: PayloadEstimate) -> bool:
        return estimate.mass - estimate.stated > max(ALARM * estimate.deviation, self._smallest)

    def _is_large(self, moment: FloatArray) -> bool:
        return float(np.linalg.norm(moment)) > self._smallest * LEVER * self._dynamics.robot.reach

    def _contradicts(self, estimate: PayloadEstimate, moment: FloatArray) -> bool:
        """Return whether mass or `moment` (3,) [kg m], without signs, contradict the stated load."""
        is_moved = self._is_large(moment) and bool((moment > ALARM * estimate.moment_deviations).any())
        return self._is_heavier(estimate) or is_moved
