# SPDX-License-Identifier: Apache-2.0
"""Regression of joint torques on inertial parameters, friction and errors of torque constants, with priors.

tau = Y(q, qd, qdd) pi + friction is linear in the inertial parameters pi of the links (Atkeson, An & Hollerbach 1986,
doi:10.1177/027836498600500306). Per joint j, over an interval in which it moves one way,

    tau_j = (1 + e_j) (rnea_j + Y_j delta) + f_c sign(qd_j) + f_v qd_j,

with rnea by the robot file, the differences `delta` from it, Coulomb and viscous friction, and the relative error e_j
of the torque constant, by Gauss-Newton steps. A joint at rest may hold by friction: it counts once per standstill, as
accurately as the friction is known.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from scara_effmass.kernel.admission import METRES_PER_RADIAN
from scara_effmass.kernel.intervals import HIGHEST, LOWEST, QD, QDD, TORQUE, Q
from scara_effmass.model.robot import Robot
from scara_effmass.values import FloatArray

INTERVALS_PER_ROW = 4
"""Number of intervals whose equations are averaged: the errors of qd at their common ends cancel, so that their effect
on qdd, which makes the arm look lighter, stays small."""
REST_SPEED = 0.01
"""Speed below which a joint may rest [rad/s; a quarter of it in m/s]."""
ROWS_PER_BLOCK = 12
"""Number of rows with motion of a block, about 1 s."""
Z_95 = 1.959963984540054
"""Quantile of the normal distribution for an interval of 95 %."""
FRICTION = 0.1
"""Standard deviation of the friction of a joint, as a share of its effort limit."""
MAX_ERRORS = 4.0
"""Largest error of a torque constant, in its standard deviations, that the model explains."""
MIN_TORQUE = 1e-6
"""Smallest torque that is told from 0 [N m, N]."""
UNKNOWN_UNIT = 10.0
"""Standard deviation of the relative error of a torque constant about which nothing is known."""
MIN_SIGNIFICANCE = 5.0
"""Standard deviations by which a contradiction to the model must differ from noise."""
NOISE = 0.01
"""Noise of the torque of a joint that has not moved yet, as a share of its effort limit."""
TRIAL_SPEED, TRIAL_TIME_S = 0.2, 0.25
"""Speed of a motion that could tell a parameter, as a share of the largest one, and time to reach it [s]."""
_OWN = 3
"""Number of parameters of each joint: f_c, f_v and e."""
_ITERATIONS, _FREE_ITERATIONS = 8, 5


def link_parameters(model: pin.Model) -> FloatArray:
    """Return the inertial parameters (n, 10) of the moving links of `model`."""
    return np.array([inertia.toDynamicParameters() for inertia in list(model.inertias)[1:]])


class Solution(NamedTuple):
    """What the torques say. `parameters` (p,) and their `covariance` (p, p) are in units of the prior.

    `friction` (n, 2) are f_c [N m, N] and f_v [N m s, N s/m]; `scale_errors` (n,) the e_j. `torques` and `residuals`
    (n,) [N m, N] are root mean squares in motion. `unfit` says why the torques do not fit the model, empty if they do.
    """

    parameters: FloatArray
    covariance: FloatArray
    friction: FloatArray
    scale_errors: FloatArray
    torques: FloatArray
    residuals: FloatArray
    unfit: str


class _System(NamedTuple):
    """The last linearized equations: weighted products and what linearizes them (n, p + 4, p + 4).

    `noise` (n,) are the variances of the rows, `scales` (n,) those of the torques [N m, N].
    """

    weighted: FloatArray
    columns: FloatArray
    noise: FloatArray
    scales: FloatArray


class _Block:
    """Sums over intervals: Z^T Z (n, p + 4, p + 4), sum of Z (n, p + 4) and number (n,) of those in motion.

    Z are the rows Y, sign(qd), qd, rnea and tau.
    """

    def __init__(self, joints: int, size: int) -> None:
        self.products = np.zeros((joints, size, size))
        self.sums = np.zeros((joints, size))
        self.counts = np.zeros(joints)
        self.resting = np.zeros((joints, size, size))
        self.length = 0


class TorqueRegression:
    """Estimates p inertial parameters of `robot` over the last `blocks` blocks of motion, or over all if None.

    `units` (10 n, p) are the changes of the links' parameters for one standard deviation of each parameter before
    anything is known. `effort_uncertainty` is the standard deviation of the relative error of torque constants.
    """

    def __init__(
        self, robot: Robot, units: FloatArray, effort_uncertainty: float, *, blocks: int | None = None
    ) -> None:
        self._robot, self._data, self._units = robot, robot.model.createData(), units
        self._joints, self._parameters = robot.model.nv, units.shape[1]
        self._rest_speeds = REST_SPEED * np.where(robot.revolute, 1.0, METRES_PER_RADIAN)
        self._effort_uncertainty = effort_uncertainty
        self._limits = robot.effort_limits
        self._past, self._past_sums = self._empty(), list[FloatArray]()
        self._blocks, self._keeps_all = deque([self._empty()], blocks), blocks is None
        self._q = np.zeros(self._joints)
        self._was_resting = np.zeros(self._joints, np.bool_)
        self._intervals: list[tuple[FloatArray, FloatArray, FloatArray]] = []

    def add(self, means: FloatArray) -> bool:
        """Take the `means` (6, n) of an interval; return whether they complete a block."""
        self._q = means[Q]
        self._intervals.append((self._rows(*means[[Q, QD, QDD, TORQUE]]), means[LOWEST], means[HIGHEST]))
        if len(self._intervals) < INTERVALS_PER_ROW:
            return False
        rows, lowest, highest = (np.array(values) for values in zip(*self._intervals, strict=True))
        self._intervals.clear()
        return self._add_rows(rows.mean(axis=0), lowest.min(axis=0), highest.max(axis=0))

    def _rows(self, q: FloatArray, qd: FloatArray, qdd: FloatArray, torque: FloatArray) -> FloatArray:
        """Return Y, sign(qd), qd, rnea and tau (n, p + 4) of each joint."""
        model = self._robot.model
        known = pin.rnea(model, self._data, q, qd, qdd) + self._robot.rotors.coupling @ qdd
        y = pin.computeJointTorqueRegressor(model, self._data, q, qd, qdd) @ self._units
        rows: FloatArray = np.column_stack((y, np.sign(qd), qd, known, torque))
        return rows

    @property
    def counts(self) -> FloatArray:
        """Number (n,) of rows in motion of each joint."""
        return np.asarray(np.sum([block.counts for block in self._all()], axis=0))

    @property
    def gram(self) -> FloatArray:
        """Y^T Y (p, p) of the rows in motion, whose torques count in units of the joint's scale."""
        products = np.sum([block.products for block in self._all()], axis=0)
        _, scales = self._torques(products, self.counts)
        weighted = products[:, : self._parameters, : self._parameters] / (scales**2)[:, None, None]
        return np.asarray(weighted.sum(axis=0))

    def solve(self) -> Solution:
        """Return the estimate."""
        blocks = list(self._all())
        products = np.sum([block.products for block in blocks], axis=0)
        resting = np.sum([block.resting for block in blocks], axis=0)
        sums = np.array([*self._past_sums, *(block.sums for block in self._blocks)])
        joints, counts, p = self._joints, self.counts, self._parameters
        torques, scales = self._torques(products, counts)
        least = (1e-6 * scales) ** 2
        friction, noise, inflation = FRICTION * scales, np.maximum(torques**2, least), np.ones(joints)
        solution, unfit = np.zeros(p + _OWN * joints), ""
        for iteration in range(_ITERATIONS):
            # First as if the torque constants were unknown: else another unit passes for noise.
            uncertainty = self._effort_uncertainty if iteration >= _FREE_ITERATIONS else UNKNOWN_UNIT
            weighted = products / (noise * inflation)[:, None, None] + resting / (noise + friction**2)[:, None, None]
            columns = self._columns(solution)
            solution, covariance = self._solve(columns.transpose(0, 2, 1) @ weighted @ columns, scales, uncertainty)
            residual = self._residual(solution)
            squares = np.einsum("ji,jik,jk->j", residual, products, residual)
            noise = np.maximum(squares / np.maximum(counts - _OWN, 1.0), least)
            # Residuals that persist over a block make the variance larger.
            persistent = np.sum(np.einsum("bji,ji->bj", sums, residual) ** 2, axis=0)
            inflation = np.maximum(1.0, persistent / (np.maximum(counts, 1.0) * noise))
            own = solution[p:].reshape(joints, _OWN)
            deviations = np.sqrt(np.diag(covariance))
            friction = np.hypot(own[:, 0], deviations[p::_OWN])
            if iteration == _FREE_ITERATIONS - 1:
                unfit = self._unfit(own[:, 2], deviations[p + 2 :: _OWN])
        noise_of_rows = np.where(counts > 0.0, noise * inflation, (NOISE * scales) ** 2)
        self._solved = _System(weighted, columns, noise_of_rows, scales)
        return Solution(solution[:p], covariance[:p, :p], own[:, :2], own[:, 2], torques, np.sqrt(noise), unfit)

    def telling_joint(self, parameter: int) -> str:
        """Return the joint whose motion for a second, to and fro at the present pose, would tell a parameter best.

        After `solve`.
        """
        joints, speeds = self._joints, np.asarray(self._robot.model.velocityLimit)
        speeds = TRIAL_SPEED * np.where((speeds > 0.0) & (speeds < np.inf), speeds, 1.0)
        weighted, columns, noise, scales = self._solved
        deviations = []
        for j, speed in enumerate(speeds):
            products = weighted.copy()
            for v, a in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
                motion = speed * np.eye(joints)[j]
                row = self._rows(self._q, v * motion, a * motion / TRIAL_TIME_S, np.zeros(joints))[j]
                products[j] += 0.25 * ROWS_PER_BLOCK / noise[j] * np.outer(row, row)
            linearized = columns.transpose(0, 2, 1) @ products @ columns
            _, covariance = self._solve(linearized, scales, self._effort_uncertainty)
            deviations.append(covariance[parameter, parameter])
        return str(self._robot.joint_names[int(np.argmin(deviations))])

    def _empty(self) -> _Block:
        return _Block(self._joints, self._parameters + _OWN + 1)

    def _all(self) -> Iterator[_Block]:
        yield self._past
        yield from self._blocks

    def _add_rows(self, rows: FloatArray, lowest: FloatArray, highest: FloatArray) -> bool:
        """Take the mean equation (n, p + 4) of intervals, and the extremes (n,) of qd in them."""
        if self._blocks[-1].length == ROWS_PER_BLOCK:
            self._begin_block()
        rest = (np.abs(lowest) <= self._rest_speeds) & (np.abs(highest) <= self._rest_speeds)
        one_way = (lowest > self._rest_speeds) | (highest < -self._rest_speeds)
        begins, self._was_resting = rest & ~self._was_resting, rest
        block = self._blocks[-1]
        moving = rows[one_way]
        block.products[one_way] += moving[:, :, None] * moving[:, None, :]
        block.sums[one_way] += moving
        block.counts += one_way
        rows[:, self._parameters : self._parameters + 2] = 0.0
        resting = rows[begins]
        block.resting[begins] += resting[:, :, None] * resting[:, None, :]
        block.length += bool(one_way.any())
        return bool(one_way.any()) and block.length == ROWS_PER_BLOCK

    def _begin_block(self) -> None:
        if self._keeps_all:  # as sums: the products of an hour would take gigabytes
            block = self._blocks.pop()
            self._past.products += block.products
            self._past.resting += block.resting
            self._past.counts += block.counts
            self._past_sums.append(block.sums)
        self._blocks.append(self._empty())

    def _torques(self, products: FloatArray, counts: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return root mean square and scale (n,) of the torque of each joint; its limit, or what was measured."""
        torques = np.sqrt(products[:, -1, -1] / np.maximum(counts, 1.0))
        return torques, np.maximum(np.where(np.isfinite(self._limits), self._limits, torques), MIN_TORQUE)

    def _solve(self, products: FloatArray, scales: FloatArray, uncertainty: float) -> tuple[FloatArray, FloatArray]:
        """Return mean and covariance of the parameters by `products` (n, p + 4, p + 4), already weighted."""
        joints, p = self._joints, self._parameters
        own = np.column_stack((FRICTION * scales, FRICTION * scales, np.full(joints, uncertainty)))
        deviations = np.concatenate((np.ones(p), own.ravel()))
        information, right = np.zeros((len(deviations),) * 2), np.zeros(len(deviations))
        for j in range(joints):
            places = [*range(p), *range(p + _OWN * j, p + _OWN * (j + 1))]
            information[np.ix_(places, places)] += products[j, :-1, :-1]
            right[places] += products[j, :-1, -1]
        # In units of the prior, which all parameters have in common.
        scaled = deviations[:, None] * information * deviations + np.eye(len(deviations))
        inverse = np.linalg.inv(scaled)
        return deviations * (inverse @ (deviations * right)), deviations[:, None] * inverse * deviations

    def _columns(self, solution: FloatArray) -> FloatArray:
        """Return what makes the linearized equation out of Y, sign(qd), qd, rnea and tau (n, p + 4, p + 4)."""
        p = self._parameters
        columns = np.tile(np.eye(p + _OWN + 1), (self._joints, 1, 1))
        load, errors = solution[:p], solution[p + 2 :: _OWN]
        columns[:, :p, :p] *= (1.0 + errors)[:, None, None]
        columns[:, :p, -2] = load
        columns[:, :p, -1] = errors[:, None] * load
        columns[:, -2, -1] = -1.0
        return columns

    def _residual(self, solution: FloatArray) -> FloatArray:
        """Return the coefficients (n, p + 4) of the residual of each joint on Y, sign(qd), qd, rnea and tau."""
        own = solution[self._parameters :].reshape(-1, _OWN)
        load = -(1.0 + own[:, 2:]) * solution[: self._parameters]
        return np.column_stack((load, -own[:, :2], -1.0 - own[:, 2], np.ones(len(own))))

    def _unfit(self, errors: FloatArray, deviations: FloatArray) -> str:
        """Return which torque constant is further off than stated, by a fit that leaves it free; empty if none is."""
        excess = np.abs(errors) - MIN_SIGNIFICANCE * deviations - MAX_ERRORS * self._effort_uncertainty
        worst = int(np.argmax(excess))
        if not excess[worst] > 0.0:
            return ""
        name = self._robot.joint_names[worst]
        return f"the effort of {name} is {100 * errors[worst]:+.0f} % off the torque of the model"
