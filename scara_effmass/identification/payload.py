# SPDX-License-Identifier: Apache-2.0
"""The load of the last link from motion and torques of the joints.

The inertial parameters of the arm count as known, or known up to `link_uncertainty`; those of the last link differ by
what it carries beyond the stated load. `regression` estimates the ten differences.
"""

from __future__ import annotations

import math
from statistics import NormalDist  # importing scipy would make the start of the monitor a fifth longer
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from scara_effmass.identification.regression import (
    LEVER,
    MIN_SIGNIFICANCE,
    Z_95,
    TorqueRegression,
    frame_jacobian,
    link_parameters,
)
from scara_effmass.model.robot import Robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.reference.mobility import worst_mass
from scara_effmass.values import FloatArray

BLOCKS = 10
"""Number of blocks that count, about 10 s of motion; the estimate is renewed after each."""
MAX_MASS = 1e6
"""Effective mass [kg] from which on it counts as infinite, with and without the load."""
MAX_LOAD = 1.0
"""Largest load, as a share of the mass of the arm: no arm carries more than itself."""
MIN_LEFT = 0.1
"""Least share of the mass of the last link and its stated load that is left where the load is lighter."""


class PayloadEstimate(NamedTuple):
    """What the last link carries, by the last seconds of motion up to `stamp_ns`.

    `mass` [kg] and `deviation` [kg], its standard deviation, are of tool and load, with what nobody stated; `stated`
    [kg] is what the model counts as such. `moment` (3,) [kg m] is mass times CoM in the frame of the last joint, of
    what nobody stated, with its `moment_deviations`. `is_observable`: half the interval is within the uncertainty of
    the mass of the arm; otherwise the motion of `telling_joint` would narrow it most. `unfit` says why the torques do
    not fit the model, empty if they do: then nothing is known. `friction` (n, 2) are f_c [N m, N] and f_v [N m s,
    N s/m], `scale_errors` (n,) the e_j.
    """

    stamp_ns: int
    mass: float
    deviation: float
    stated: float
    moment: FloatArray
    moment_deviations: FloatArray
    is_observable: bool
    telling_joint: str
    unfit: str
    friction: FloatArray
    scale_errors: FloatArray

    @property
    def interval(self) -> tuple[float, float]:
        """Shortest interval of 95 % of the mass [kg], which is not negative: of the normal distribution above 0."""
        normal = NormalDist()
        positive = normal.cdf(self.mass / self.deviation)
        half = self.deviation * normal.inv_cdf(0.5 + 0.475 * positive)
        if self.mass >= half:
            return self.mass - half, self.mass + half
        # Far below 0, no probability is left to tell the quantile from.
        return 0.0, self.mass - self.deviation * normal.inv_cdf(0.05 * positive) if positive > 0.0 else math.inf


class PayloadEstimator:
    """Estimates what the last link of `robot` carries beyond its stated load.

    `effort_uncertainty` is the standard deviation of the relative error of torque constants, and `stated` [kg] the load
    that `robot` counts. `link_uncertainty` is the standard deviation of mass and inertia of each link, relative to
    those of the file; 0: they are known.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        effort_uncertainty: float,
        mass_uncertainty: float,
        stated: float,
        link_uncertainty: float = 0.0,
    ) -> None:
        mass, lever = max(robot.moving_mass, 0.0), LEVER * robot.reach
        self._stated, self._arm_mass = stated, mass
        self._observable = max(mass_uncertainty, 0.01) * mass
        self._prior = np.array([mass] + 3 * [mass * lever] + 6 * [mass * lever * lever])
        load = np.zeros((10 * robot.model.nv, 10))
        load[-10:] = np.diag(self._prior)
        links = link_uncertainty * link_parameters(robot.model)
        links = (links[:, :, None] * np.eye(len(links))[:, None]).reshape(-1, len(links))
        units = np.hstack((load, links)) if link_uncertainty else load
        self._regression = TorqueRegression(robot, units, effort_uncertainty, blocks=BLOCKS)

    def add(self, end_ns: int, means: FloatArray) -> PayloadEstimate | None:
        """Take the `means` (6, n) of an interval that ended at `end_ns`; return a new estimate, None between them."""
        if not self._regression.add(means):
            return None
        found = self._regression.solve()
        count = len(self._prior)
        load = self._prior * found.parameters[:count]
        deviations = self._prior * np.sqrt(np.diag(found.covariance)[:count])
        mass, deviation, unfit = self._stated + float(load[0]), float(deviations[0]), found.unfit
        lower, upper = mass - MIN_SIGNIFICANCE * deviation, mass + MIN_SIGNIFICANCE * deviation
        if upper < 0.0 or lower > MAX_LOAD * self._arm_mass:
            unfit = unfit or f"the torques are those of a load of {mass:.2f} kg"
        is_observable = Z_95 * deviation <= self._observable
        return PayloadEstimate(
            stamp_ns=end_ns,
            mass=mass,
            deviation=deviation,
            stated=self._stated,
            moment=load[1:4],
            moment_deviations=deviations[1:4],
            is_observable=is_observable,
            telling_joint="" if is_observable else self._regression.telling_joint(0),
            unfit=unfit,
            friction=found.friction,
            scale_errors=found.scale_errors,
        )


def mass_gain(robot: Robot, load: float, moment: FloatArray) -> float:
    """Return by how much another load multiplies the largest effective mass of a contact point at any pose.

    Its mass differs by `load` [kg], and mass times CoM in the frame of the last joint by `moment` (3,) [kg m]. More
    mass is a point; where none within reach has this moment, the centre of mass is another one. The poses are the
    sampled ones; at singular ones the mass is infinite with and without the load, and does not count.
    """
    other, stated = robot.model.copy(), robot.model.inertias[robot.model.njoints - 1]
    if load > 0.0 and float(np.linalg.norm(moment)) <= load * robot.reach:
        point = pin.Inertia(load, moment / load, np.zeros((3, 3)))
        other.appendBodyToJoint(other.njoints - 1, point, pin.SE3.Identity())
    else:
        mass = max(stated.mass + load, MIN_LEFT * stated.mass)
        com = (stated.mass * stated.lever + moment) / mass
        other.inertias[other.njoints - 1] = pin.Inertia(mass, com, stated.inertia)
    models = [(model, model.createData()) for model in (robot.model, other)]
    contacts = RobotDynamics(robot).contacts
    gain = 0.0
    for q in robot.sample_configurations():
        inverses = [np.linalg.inv(robot.mass_matrix(model, data, q)) for model, data in models]
        for contact in contacts:
            jacobian = frame_jacobian(*models[0], q, contact.frame)
            without, loaded = (worst_mass(jacobian @ inverse @ jacobian.T, contact.rank) for inverse in inverses)
            if without < MAX_MASS:
                gain = max(gain, loaded / without)
    return gain
