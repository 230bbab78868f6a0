# SPDX-License-Identifier: Apache-2.0
"""The load of the last link from motion and torques of the joints: linear regression with priors.

tau = Y(q, qd, qdd) pi + friction is linear in the inertial parameters pi of a link (Atkeson, An & Hollerbach 1986,
doi:10.1177/027836498600500306). Of the arm they count as known; those of the last link differ by what it carries beyond
the stated load. Per joint j, over an interval in which it moves one way,

    tau_j = (1 + e_j) (rnea_j + Y_j delta) + f_c sign(qd_j) + f_v qd_j,

with the ten differences `delta`, Coulomb and viscous friction, and the relative error e_j of the torque constant, by
Gauss-Newton steps. A joint at rest may hold by friction: it counts once per standstill, as accurately as the friction
is known.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from scara_effmass.kernel.intervals import HIGHEST, LOWEST, QD, QDD, TORQUE, Q
from scara_effmass.model.robot import Robot
from scara_effmass.values import FloatArray

INTERVALS_PER_ROW = 4
"""Number of intervals whose equations are averaged: the errors of qd at their common ends cancel, so that their effect
on qdd, which makes the arm look lighter, stays small."""
ROWS_PER_BLOCK = 12
"""Number of rows with motion after which the estimate is renewed, about 1 s."""
BLOCKS = 10
"""Number of blocks that count, about 10 s of motion."""
Z_95 = 1.959963984540054
"""Quantile of the normal distribution for an interval of 95 %."""
LEVER = 0.1
"""Standard deviation of the distance of the load from its joint before anything is known, as a share of the reach."""
FRICTION = 0.1
"""That of the friction of a joint, as a share of its effort limit."""
NOISE = 0.01
"""Noise of the torque of a joint that has not moved yet, as a share of its effort limit."""
TRIAL_SPEED, TRIAL_TIME_S = 0.2, 0.25
"""Speed of a motion that could tell the mass, as a share of the largest one, and time to reach it [s]."""
MAX_ERRORS = 4.0
"""Largest error of a torque constant, in its standard deviations, that the model explains."""
MIN_TORQUE = 1e-6
"""Smallest torque that is told from 0 [N m, N]."""
SINGULAR = 1e-6
"""Mobility [1/kg] below which an effective mass counts as infinite, with and without the load."""
UNKNOWN_UNIT = 10.0
"""Standard deviation of the relative error of a torque constant about which nothing is known."""
MIN_SIGNIFICANCE = 5.0
"""Standard deviations by which a contradiction to the model must differ from noise."""
_PAYLOAD, _OWN = 10, 3
"""Numbers of parameters: of the load, and of each joint."""
_SIZE = _PAYLOAD + _OWN
_ITERATIONS, _FREE_ITERATIONS = 8, 5


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
        """Interval of 95 % of the mass [kg]; a mass is not negative."""
        half = Z_95 * self.deviation
        return max(0.0, self.mass - half), max(0.0, self.mass + half)


class _Block:
    """Sums over intervals: Z^T Z (n, p + 1, p + 1), sum of Z (n, p + 1) and number (n,) of those in motion."""

    def __init__(self, joints: int) -> None:
        self.products = np.zeros((joints, _SIZE + 1, _SIZE + 1))
        self.sums = np.zeros((joints, _SIZE + 1))
        self.counts = np.zeros(joints)
        self.resting = np.zeros((joints, _SIZE + 1, _SIZE + 1))
        self.length = 0


class PayloadEstimator:
    """Estimates what the last link of `robot` carries beyond its stated load.

    `effort_uncertainty` is the standard deviation of the relative error of torque constants, `rest_speeds` (n,) the
    speeds [rad/s, m/s] below which a joint may rest, and `stated` [kg] the load that `robot` counts besides its file.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        rest_speeds: FloatArray,
        effort_uncertainty: float,
        mass_uncertainty: float,
        stated: float,
    ) -> None:
        self._robot, self._data = robot, robot.model.createData()
        self._rest_speeds, self._stated = rest_speeds, stated
        joints, mass, lever = robot.model.nv, max(robot.moving_mass, 0.0), LEVER * robot.reach
        self._observable = max(mass_uncertainty, 0.01) * mass
        self._prior = np.array([mass] + 3 * [mass * lever] + 6 * [mass * lever * lever])
        self._effort_uncertainty = effort_uncertainty
        self._limits = robot.effort_limits
        self._blocks = deque([_Block(joints)], BLOCKS)
        self._was_resting = np.zeros(joints, np.bool_)
        self._q = np.zeros(joints)
        self._intervals: list[tuple[FloatArray, FloatArray, FloatArray]] = []

    def add(self, end_ns: int, means: FloatArray) -> PayloadEstimate | None:
        """Take the `means` (6, n) of an interval that ended at `end_ns`; return a new estimate, None between them."""
        q, qd, qdd, torque = means[Q], means[QD], means[QDD], means[TORQUE]
        self._q = q
        self._intervals.append((self._rows(q, qd, qdd, torque), means[LOWEST], means[HIGHEST]))
        if len(self._intervals) < INTERVALS_PER_ROW:
            return None
        rows, lowest, highest = (np.array(values) for values in zip(*self._intervals, strict=True))
        self._intervals.clear()
        return self._add_rows(end_ns, rows.mean(axis=0), lowest.min(axis=0), highest.max(axis=0))

    def _rows(self, q: FloatArray, qd: FloatArray, qdd: FloatArray, torque: FloatArray) -> FloatArray:
        """Return Y, sign(qd), qd, rnea and tau (n, p + 1) of each joint."""
        model = self._robot.model
        known = pin.rnea(model, self._data, q, qd, qdd) + self._robot.rotors.coupling @ qdd
        y = pin.computeJointTorqueRegressor(model, self._data, q, qd, qdd)[:, -_PAYLOAD:]
        return np.column_stack((y, np.sign(qd), qd, known, torque))

    def _add_rows(
        self, end_ns: int, rows: FloatArray, lowest: FloatArray, highest: FloatArray
    ) -> PayloadEstimate | None:
        """Take the mean equation (n, p + 1) of intervals, and the extremes (n,) of qd in them."""
        rest = (np.abs(lowest) <= self._rest_speeds) & (np.abs(highest) <= self._rest_speeds)
        one_way = (lowest > self._rest_speeds) | (highest < -self._rest_speeds)
        begins, self._was_resting = rest & ~self._was_resting, rest
        block = self._blocks[-1]
        moving = rows[one_way]
        block.products[one_way] += moving[:, :, None] * moving[:, None, :]
        block.sums[one_way] += moving
        block.counts += one_way
        rows[:, _PAYLOAD : _PAYLOAD + 2] = 0.0
        resting = rows[begins]
        block.resting[begins] += resting[:, :, None] * resting[:, None, :]
        block.length += bool(one_way.any())
        if block.length < ROWS_PER_BLOCK:
            return None
        estimate = self._estimate(end_ns)
        self._blocks.append(_Block(len(rows)))
        return estimate

    def _estimate(self, stamp_ns: int) -> PayloadEstimate:
        products = np.sum([block.products for block in self._blocks], axis=0)
        counts = np.sum([block.counts for block in self._blocks], axis=0)
        resting = np.sum([block.resting for block in self._blocks], axis=0)
        joints = len(counts)
        torques = np.sqrt(products[:, -1, -1] / np.maximum(counts, 1.0))
        scales = np.maximum(np.where(np.isfinite(self._limits), self._limits, torques), MIN_TORQUE)
        least = (1e-6 * scales) ** 2
        friction, noise, inflation = FRICTION * scales, np.maximum(torques**2, least), np.ones(joints)
        solution, unfit = np.zeros(_PAYLOAD + _OWN * joints), ""
        for iteration in range(_ITERATIONS):
            # First as if the torque constants were unknown: else another unit passes for noise.
            uncertainty = self._effort_uncertainty if iteration >= _FREE_ITERATIONS else UNKNOWN_UNIT
            weighted = products / (noise * inflation)[:, None, None] + resting / (noise + friction**2)[:, None, None]
            columns = self._columns(solution)
            solution, covariance = self._solve(columns.transpose(0, 2, 1) @ weighted @ columns, scales, uncertainty)
            residual = self._residual(solution)
            squares = np.einsum("ji,jik,jk->j", residual, products, residual)
            noise = np.maximum(squares / np.maximum(counts - _OWN, 1.0), least)
            inflation = self._inflation(residual, noise)
            own = solution[_PAYLOAD:].reshape(joints, _OWN)
            deviations = np.sqrt(np.diag(covariance))
            friction = np.hypot(own[:, 0], deviations[_PAYLOAD::_OWN])
            if iteration == _FREE_ITERATIONS - 1:
                unfit = self._unfit(own[:, 2], deviations[_PAYLOAD + 2 :: _OWN])
        mass, deviation = float(self._stated + solution[0]), float(deviations[0])
        if mass + MIN_SIGNIFICANCE * deviation < 0.0:
            unfit = unfit or f"the torques are those of a load of {mass:.2f} kg"
        is_observable = Z_95 * deviation <= self._observable
        noise = np.where(counts > 0.0, noise * inflation, (NOISE * scales) ** 2)
        return PayloadEstimate(
            stamp_ns=stamp_ns,
            mass=mass,
            deviation=deviation,
            stated=self._stated,
            moment=solution[1:4],
            moment_deviations=deviations[1:4],
            is_observable=is_observable,
            telling_joint="" if is_observable else self._telling_joint(weighted, columns, noise, scales),
            unfit=unfit,
            friction=own[:, :2],
            scale_errors=own[:, 2],
        )

    def _unfit(self, errors: FloatArray, deviations: FloatArray) -> str:
        """Return which torque constant is further off than stated, by a fit that leaves it free; empty if none is."""
        excess = np.abs(errors) - MIN_SIGNIFICANCE * deviations - MAX_ERRORS * self._effort_uncertainty
        worst = int(np.argmax(excess))
        if not excess[worst] > 0.0:
            return ""
        name = self._robot.joint_names[worst]
        return f"the effort of {name} is {100 * errors[worst]:+.0f} % off the torque of the model"

    def _telling_joint(self, weighted: FloatArray, columns: FloatArray, noise: FloatArray, scales: FloatArray) -> str:
        """Return the joint whose motion for a second, to and fro at the present pose, tells the mass best."""
        speeds = np.asarray(self._robot.model.velocityLimit)
        speeds = TRIAL_SPEED * np.where((speeds > 0.0) & (speeds < np.inf), speeds, 1.0)
        deviations = []
        for j, speed in enumerate(speeds):
            products = weighted.copy()
            for v, a in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
                motion = speed * np.eye(len(speeds))[j]
                row = self._rows(self._q, v * motion, a * motion / TRIAL_TIME_S, np.zeros(len(speeds)))[j]
                products[j] += 0.25 * ROWS_PER_BLOCK / noise[j] * np.outer(row, row)
            deviations.append(
                self._solve(columns.transpose(0, 2, 1) @ products @ columns, scales, self._effort_uncertainty)[1][0, 0]
            )
        return self._robot.joint_names[int(np.argmin(deviations))]

    def _solve(self, products: FloatArray, scales: FloatArray, uncertainty: float) -> tuple[FloatArray, FloatArray]:
        """Return mean and covariance of the parameters by `products` (n, p + 1, p + 1), already weighted."""
        joints = len(products)
        own = np.column_stack((FRICTION * scales, FRICTION * scales, np.full(joints, uncertainty)))
        deviations = np.concatenate((self._prior, own.ravel()))
        information, right = np.zeros((len(deviations),) * 2), np.zeros(len(deviations))
        for j in range(joints):
            places = self._places(j)
            information[np.ix_(places, places)] += products[j, :-1, :-1]
            right[places] += products[j, :-1, -1]
        # In units of the prior, which all parameters have in common.
        scaled = deviations[:, None] * information * deviations + np.eye(len(deviations))
        inverse = np.linalg.inv(scaled)
        return deviations * (inverse @ (deviations * right)), deviations[:, None] * inverse * deviations

    def _places(self, joint: int) -> list[int]:
        return [*range(_PAYLOAD), *range(_PAYLOAD + _OWN * joint, _PAYLOAD + _OWN * (joint + 1))]

    def _columns(self, solution: FloatArray) -> FloatArray:
        """Return what makes the linearized equation out of Y, sign(qd), qd, rnea and tau (n, p + 1, p + 1)."""
        columns = np.tile(np.eye(_SIZE + 1), (len(self._limits), 1, 1))
        load, errors = solution[:_PAYLOAD], solution[_PAYLOAD + 2 :: _OWN]
        columns[:, :_PAYLOAD, :_PAYLOAD] *= (1.0 + errors)[:, None, None]
        columns[:, :_PAYLOAD, -2] = load
        columns[:, :_PAYLOAD, -1] = errors[:, None] * load
        columns[:, -2, -1] = -1.0
        return columns

    def _residual(self, solution: FloatArray) -> FloatArray:
        """Return the coefficients (n, p + 1) of the residual of each joint on Y, sign(qd), qd, rnea and tau."""
        own = solution[_PAYLOAD:].reshape(-1, _OWN)
        load = -(1.0 + own[:, 2:]) * solution[:_PAYLOAD]
        return np.column_stack((load, -own[:, :2], -1.0 - own[:, 2], np.ones(len(own))))

    def _inflation(self, residual: FloatArray, noise: FloatArray) -> FloatArray:
        """Return by how much residuals that persist over a block make the variances larger (n,), 1 if none do."""
        sums = np.array([np.einsum("ji,ji->j", block.sums, residual) for block in self._blocks])
        counts = np.sum([block.counts for block in self._blocks], axis=0)
        factors: FloatArray = np.maximum(1.0, np.sum(sums**2, axis=0) / (np.maximum(counts, 1.0) * noise))
        return factors


def mass_gain(robot: Robot, mass: float, moment: FloatArray) -> float:
    """Return by how much a further `mass` [kg] multiplies the largest effective mass of a contact point at any pose.

    `moment` (3,) [kg m] is `mass` times CoM in the frame of the last joint. The poses are the sampled ones.
    """
    heavier = robot.model.copy()
    load = pin.Inertia(mass, moment / mass, np.zeros((3, 3)))
    heavier.appendBodyToJoint(heavier.njoints - 1, load, pin.SE3.Identity())
    models = [(model, model.createData()) for model in (robot.model, heavier)]
    gain = 1.0
    for q in robot.sample_configurations():
        inverses = [np.linalg.inv(robot.mass_matrix(model, data, q)) for model, data in models]
        for frame in robot.contact_frames.values():
            jacobian = pin.computeFrameJacobian(*models[0], q, frame, pin.LOCAL_WORLD_ALIGNED)[:3]
            least = [float(np.linalg.eigvalsh(jacobian @ inverse @ jacobian.T)[0]) for inverse in inverses]
            if least[0] > SINGULAR:
                gain = max(gain, least[0] / least[1])
    return gain
