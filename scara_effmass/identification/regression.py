# SPDX-License-Identifier: Apache-2.0
"""Regression of joint torques on inertial parameters, friction and errors of torque constants, with priors.

tau = Y(q, qd, qdd) pi + friction is linear in the inertial parameters pi of the links (Atkeson, An & Hollerbach 1986,
doi:10.1177/027836498600500306). Per joint j, over an interval in which it moves one way,

    tau_j = (1 + e_j) (rnea_j + Y_j delta) + f_c sign(qd_j) + f_v qd_j,

with rnea by the robot file, the differences `delta` from it, Coulomb and viscous friction, and the relative error e_j
of the torque constant, by Gauss-Newton steps. A joint at rest may hold by friction: it counts once per standstill,
within the friction of the prior, because motion one way does not tell friction from a load. Rows whose residual stands
out, as at an impact, do not count.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
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
LEVER = 0.1
"""Standard deviation of the distance of the load from its joint before anything is known, as a share of the reach."""
MAX_ERRORS = 4.0
"""Largest error of a torque constant, in its standard deviations, that the model explains."""
MIN_TORQUE = 1e-6
"""Smallest torque that is told from 0 [N m, N]."""
UNEXPLAINED = 0.9
"""Share of the torque of a joint that a residual leaves if the model explains nothing of it."""
MIN_KNOWN = 0.01
"""Least torque by the model, as a share of the largest of all joints, that must show in the effort."""
UNKNOWN_UNIT = 10.0
"""Standard deviation of the relative error of a torque constant about which nothing is known."""
MIN_SIGNIFICANCE = 5.0
"""Standard deviations by which a contradiction to the model must differ from noise."""
MIN_NOISE = 0.01
"""Smallest standard deviation of the torque of a joint, as a share of its root mean square: no gear is known better."""
NOISE = 0.01
"""Noise of the torque of a joint that has not moved yet, as a share of its effort limit."""
TRIAL_SPEED, TRIAL_TIME_S = 0.2, 0.25
"""Speed of a motion that could tell a parameter, as a share of the largest one, and time to reach it [s]."""
STANDS_OUT = 4.0
"""Residual, in standard deviations by the median, from which on a row does not count."""
MIN_COUNTED = 0.7
"""Least share of the rows that count: if more stand out, that is how the robot moves."""
MEDIAN_DEVIATION = 1.4826
"""Standard deviation of a normal distribution over the median of the magnitude."""
BLOCKS_AT_ONCE = 10
"""Number of blocks in which rows that stand out are looked for."""
NEWEST_BLOCKS, MIN_NEWEST = 2, 0.6
"""Newest blocks, and least share of their rows that do not stand out, unless the load has changed."""
_OWN = 3
"""Number of parameters of each joint: f_c, f_v and e."""
_ITERATIONS, _FREE_ITERATIONS = 8, 5


def link_parameters(model: pin.Model) -> FloatArray:
    """Return the inertial parameters (n, 10) of the moving links of `model`."""
    return np.array([inertia.toDynamicParameters() for inertia in list(model.inertias)[1:]])


def torque_regressor(model: pin.Model, data: pin.Data, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray:
    """Return Y (n, 10 n) of the torques Y pi, rotors aside."""
    y = pin.computeJointTorqueRegressor(model, data, q, qd, qdd)
    return np.reshape(y, (model.nv, -1))  # Pinocchio returns (10,) for one joint


def frame_jacobian(model: pin.Model, data: pin.Data, q: FloatArray, frame: int) -> FloatArray:
    """Return the Jacobian (3, n) of the position of a frame at `q` (n,)."""
    jacobian = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
    return np.reshape(jacobian, (6, model.nv))[:3]  # Pinocchio returns (6,) for one joint


def rest_speeds(robot: Robot) -> FloatArray:
    """Return the speeds (n,) [rad/s, m/s] below which the joints of `robot` may rest."""
    return REST_SPEED * np.where(robot.revolute, 1.0, METRES_PER_RADIAN)


class Solution(NamedTuple):
    """What the torques say. `parameters` (p,) and their `covariance` (p, p) are in units of the prior.

    `friction` (n, 2) are f_c [N m, N] and f_v [N m s, N s/m]; `scale_errors` (n,) the e_j. `torques` and `residuals`
    (n,) [N m, N] are root mean squares in motion. `unfit` says why the torques do not fit the model, empty if they do.
    `rows` of them count, `left_out` stand out.
    """

    parameters: FloatArray
    covariance: FloatArray
    friction: FloatArray
    scale_errors: FloatArray
    torques: FloatArray
    residuals: FloatArray
    unfit: str
    rows: int
    left_out: int


class _System(NamedTuple):
    """The last linearized equations: weighted products and what linearizes them (n, p + 4, p + 4).

    `noise` (n,) are the variances of the rows, `scales` (n,) those of the torques [N m, N].
    """

    weighted: FloatArray
    columns: FloatArray
    noise: FloatArray
    scales: FloatArray


class _Block:
    """Rows Y, sign(qd), qd, rnea and tau (n, p + 4) with motion, and which joints (n,) move one way in each.

    `resting` (n, p + 4, p + 4) is the sum of Z^T Z over the rows Z that begin a standstill.
    """

    def __init__(self, joints: int, size: int) -> None:
        self.rows: list[FloatArray] = []
        self.moving: list[FloatArray] = []
        self.resting = np.zeros((joints, size, size))


class _Sums(NamedTuple):
    """Z^T Z (n, p + 4, p + 4) and number (n,) of rows Z of each joint in motion, and sums (b, n, p + 4) by block.

    `resting` is that of the blocks. `rows` of them count, `left_out` do not.
    """

    products: FloatArray
    counts: FloatArray
    by_block: FloatArray
    resting: FloatArray
    rows: int
    left_out: int

    def plus(self, other: _Sums) -> _Sums:
        """Return the sums over both."""
        return _Sums(
            self.products + other.products,
            self.counts + other.counts,
            np.concatenate((self.by_block, other.by_block)),
            self.resting + other.resting,
            self.rows + other.rows,
            self.left_out + other.left_out,
        )


class _Window:
    """The rows of some blocks, with the sums over those that count."""

    def __init__(self, blocks: Sequence[_Block], size: int) -> None:
        joints = len(blocks[0].resting)
        rows = [row for block in blocks for row in block.rows]
        self.moving = np.array([moving for block in blocks for moving in block.moving]).reshape(-1, joints)
        # Only joints that move one way in a row have an equation.
        self.equations = np.array(rows).reshape(-1, joints, size) * self.moving[:, :, None]
        self._starts = np.cumsum([0, *(len(block.rows) for block in blocks if block.rows)])[:-1]
        self._resting = np.sum([block.resting for block in blocks], axis=0)

    def sums(self, counted: FloatArray) -> _Sums:
        """Return the sums over the rows `counted` (N,)."""
        by_joint = (self.equations * counted[:, None, None]).transpose(1, 0, 2)
        by_block = np.add.reduceat(by_joint, self._starts, axis=1).transpose(1, 0, 2)
        rows = int(counted.sum())
        counts = np.sum(self.moving * counted[:, None], axis=0)
        products = by_joint.transpose(0, 2, 1) @ by_joint
        return _Sums(products, counts, by_block, self._resting, rows, len(counted) - rows)

    def counted(self, residual: FloatArray) -> FloatArray:
        """Return which rows (N,) do not stand out, with the coefficients (n, p + 4) of the residuals."""
        sizes = np.abs(np.einsum("tji,ji->tj", self.equations, residual))
        # The equations of joints at rest, of size 0, come first.
        middle = len(sizes) - 1 - (self.moving.sum(axis=0).astype(int) // 2)
        deviations = MEDIAN_DEVIATION * np.take_along_axis(np.sort(sizes, axis=0), middle[None], axis=0)[0]
        relative = (sizes / np.maximum(deviations, MIN_TORQUE)).max(axis=1)
        return np.asarray(relative <= max(STANDS_OUT, float(np.quantile(relative, MIN_COUNTED))), dtype=float)


def _squares(residual: FloatArray, products: FloatArray) -> FloatArray:
    """Return the sums (n,) of the squares of the residuals with these coefficients (n, p + 4)."""
    return np.asarray(np.einsum("ji,jik,jk->j", residual, products, residual))


def _variances(residual: FloatArray, sums: _Sums, floor: FloatArray) -> FloatArray:
    """Return the variances (n,) of the residuals with these coefficients (n, p + 4), at least `floor` (n,)."""
    return np.asarray(np.maximum(_squares(residual, sums.products) / np.maximum(sums.counts - _OWN, 1.0), floor))


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
        self._rest_speeds = rest_speeds(robot)
        self._effort_uncertainty = effort_uncertainty
        self._limits = robot.effort_limits
        self._size = self._parameters + _OWN + 1
        self._blocks, self._keeps_all = deque([_Block(self._joints, self._size)], blocks), blocks is None
        self._past = self._nothing = _Window(self._blocks, self._size).sums(np.zeros(0))
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
        y = torque_regressor(model, self._data, q, qd, qdd) @ self._units
        rows: FloatArray = np.column_stack((y, np.sign(qd), qd, known, torque))
        return rows

    @property
    def has_motion(self) -> bool:
        """Whether a joint has moved."""
        return bool(self._past.rows or any(block.rows for block in self._blocks))

    @property
    def gram(self) -> FloatArray:
        """Y^T Y (p, p) of the rows in motion, whose torques count in units of the joint's scale. After `solve`."""
        weighted = (
            self._sums.products[:, : self._parameters, : self._parameters] / (self._solved.scales**2)[:, None, None]
        )
        return np.asarray(weighted.sum(axis=0))

    def solve(self) -> Solution:
        """Return the estimate. If most of the newest rows stand out, the load has changed: older ones go."""
        found = self._fit(self._past)
        newest = self._counted[-NEWEST_BLOCKS * ROWS_PER_BLOCK :]
        if self._keeps_all or np.mean(newest) >= MIN_NEWEST:
            return found
        while len(self._blocks) > NEWEST_BLOCKS:
            self._blocks.popleft()
        return self._fit(self._past)

    def _fit(self, past: _Sums) -> Solution:
        """Return the estimate of `past` and the present blocks, whose rows that stand out do not count."""
        window = _Window(self._blocks, self._size)
        joints, p = self._joints, self._parameters
        counted = np.ones(len(window.moving))
        sums = past.plus(window.sums(counted))
        known, torques = (np.sqrt(sums.products[:, i, i] / np.maximum(sums.counts, 1.0)) for i in (-2, -1))
        # The scale of a torque is its limit, or what was measured.
        scales = np.maximum(np.where(np.isfinite(self._limits), self._limits, torques), MIN_TORQUE)
        floor = np.maximum(MIN_NOISE * np.maximum(torques, known), MIN_TORQUE) ** 2
        friction, noise, inflation = FRICTION * scales, np.maximum(torques**2, floor), np.ones(joints)
        solution, unfit = np.zeros(p + _OWN * joints), ""
        for iteration in range(_ITERATIONS):
            residual = self._residual(solution)
            before, counted = counted, window.counted(residual) if len(counted) else counted
            if not np.array_equal(before, counted):
                sums = past.plus(window.sums(counted))
            # First as if the torque constants were unknown: else another unit passes for noise.
            uncertainty = self._effort_uncertainty if iteration >= _FREE_ITERATIONS else UNKNOWN_UNIT
            of_rest = sums.resting / (noise + friction**2)[:, None, None]
            weighted = sums.products / (noise * inflation)[:, None, None] + of_rest
            columns = self._columns(solution)
            solution, covariance = self._solve(columns.transpose(0, 2, 1) @ weighted @ columns, scales, uncertainty)
            residual = self._residual(solution)
            noise = _variances(residual, sums, floor)
            # Residuals that persist over a block make the variance larger.
            persistent = np.sum(np.einsum("bji,ji->bj", sums.by_block, residual) ** 2, axis=0)
            inflation = np.maximum(1.0, persistent / (np.maximum(sums.counts, 1.0) * noise))
            own = solution[p:].reshape(joints, _OWN)
            deviations = np.sqrt(np.diag(covariance))
            if iteration == _FREE_ITERATIONS - 1:
                unfit, free = self._unfit(own[:, 2], deviations[p + 2 :: _OWN]), residual
                rows, of_standstill = sums, noise + friction**2
        # Twice the logarithm of the ratio of likelihoods on the rows of the free fit: whether it is better at all.
        gain = rows.counts * np.log(_variances(residual, rows, floor) / _variances(free, rows, floor))
        gain += (_squares(residual, rows.resting) - _squares(free, rows.resting)) / of_standstill
        if np.sum(gain) < MIN_SIGNIFICANCE**2:
            unfit = ""
        unfit = unfit or self._unlike_the_model(torques, known, np.sqrt(noise), sums)
        unfit = unfit or self._backward(own[:, 0] + MIN_SIGNIFICANCE * np.maximum(deviations[p::_OWN], np.sqrt(noise)))
        noise_of_rows = np.where(sums.counts > 0.0, noise * inflation, (NOISE * scales) ** 2)
        self._solved, self._sums = _System(weighted, columns, noise_of_rows, scales), sums
        self._counted = counted
        numbers = solution[:p], covariance[:p, :p], own[:, :2], own[:, 2], torques, np.sqrt(noise)
        return Solution(*numbers, unfit, sums.rows, sums.left_out)

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

    def _add_rows(self, rows: FloatArray, lowest: FloatArray, highest: FloatArray) -> bool:
        """Take the mean equation (n, p + 4) of intervals, and the extremes (n,) of qd in them."""
        if len(self._blocks[-1].rows) == ROWS_PER_BLOCK:
            self._begin_block()
        rest = (np.abs(lowest) <= self._rest_speeds) & (np.abs(highest) <= self._rest_speeds)
        one_way = (lowest > self._rest_speeds) | (highest < -self._rest_speeds)
        begins, self._was_resting = rest & ~self._was_resting, rest
        block = self._blocks[-1]
        resting = rows[begins]
        resting[:, self._parameters : self._parameters + 2] = 0.0
        block.resting[begins] += resting[:, :, None] * resting[:, None, :]
        if one_way.any():
            block.rows.append(rows)
            block.moving.append(one_way.astype(float))
        return bool(one_way.any()) and len(block.rows) == ROWS_PER_BLOCK

    def _begin_block(self) -> None:
        if self._keeps_all and len(self._blocks) == BLOCKS_AT_ONCE:  # as sums: rows of an hour would take gigabytes
            self._fit(self._nothing)
            self._past = self._past.plus(self._sums)
            self._blocks.clear()
        self._blocks.append(_Block(self._joints, self._size))

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
        half = np.linalg.inv(np.linalg.cholesky(scaled))
        inverse = half.T @ half  # no variance is negative
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

    def _unlike_the_model(self, torques: FloatArray, known: FloatArray, residuals: FloatArray, sums: _Sums) -> str:
        """Return which joint has torques unlike those of the model, root mean squares `known` (n,); empty if none has.

        A unit that is far off passes for noise: then known torque and friction alone explain the torque.
        """
        for j, name in enumerate(self._robot.joint_names):
            if not sums.counts[j] or known[j] <= MIN_TORQUE:
                continue
            if torques[j] <= MIN_TORQUE:
                return f"the effort of {name} is 0 while it moves"
            if residuals[j] < UNEXPLAINED * torques[j] or known[j] < MIN_KNOWN * known.max():
                continue
            products = sums.products[j, -4:, -4:]
            slopes = np.linalg.lstsq(products[:-1, :-1], products[:-1, -1], rcond=None)[0]
            left = products[-1, -1] - slopes @ products[:-1, -1]
            if left < 0.5 * products[-1, -1] or known[j] > 0.5 * torques[j]:
                return f"the effort of {name} is not the torque of the model"
        return ""

    def _backward(self, friction: FloatArray) -> str:
        """Return which joint friction pushes on, by upper ends (n,) of its Coulomb friction; empty if none."""
        worst = int(np.argmin(friction))
        if not friction[worst] < 0.0:
            return ""
        return f"the friction of {self._robot.joint_names[worst]} pushes, as if its effort had the wrong sign"
