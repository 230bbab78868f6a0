# SPDX-License-Identifier: Apache-2.0
"""Inertial parameters of all moving links from motion and torques, and the effective masses that follow.

A robot whose inertia tensors are known has bodies for links. Otherwise the two point masses of each link of the lumped
model are estimated, at the places that it gives them. A mass may be negative only where that of the file is.

For bodies, the prior is the robot file: the pseudo-inertia of a link is U (I + S) U^T with that of the file U U^T and a
symmetric S whose entries have a standard deviation, as in the metric of Lee, Wensing & Park 2020
(doi:10.1109/LRA.2019.2953661), which has no units. The estimate is the point of the Gaussian of the regression nearest
to its mean at which every pseudo-inertia is positive definite (Wensing, Kim & Slotine 2018,
doi:10.1109/LRA.2017.2729659), by the parameters of its Cholesky factor (Rucker & Wensing 2022,
doi:10.1109/LRA.2022.3144517).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.linalg import block_diag, qr
from scipy.optimize import least_squares, lsq_linear

from scara_effmass.identification.regression import (
    LEVER,
    Solution,
    TorqueRegression,
    frame_jacobian,
    link_parameters,
    rest_speeds,
    torque_regressor,
)
from scara_effmass.kernel.intervals import HIGHEST, LOWEST, QD, QDD, Q
from scara_effmass.model.lumping import LumpedModel
from scara_effmass.model.robot import Robot
from scara_effmass.values import FloatArray, Vector3

PER_LINK = 10
"""Number of inertial parameters of a link, in Pinocchio's order: m, m c, and the inertia about the joint's origin."""
DEVIATION = 0.5
"""Relative standard deviation of the mass of a link by the file; its CoM has 0.35 of the link's radius of gyration."""
LOAD = 0.2
"""Load of the last link that counts for its standard deviations, as a share of the mass of the arm."""
MIN_KAPPA = 0.2
"""Smallest share of its link that counts for the standard deviation of a lumped mass: the file may state it as 0."""
MAX_DEVIATIONS = 10.0
"""Largest difference of a link from the file, in those standard deviations, that counts as a link."""
MIN_MASS_SHARE, MIN_RADIUS_M = 0.01, 0.01
"""Least mass of a link, as a share of the mean, and least radius of gyration in the prior, for links without extent."""
MIN_FACTOR = 0.05
"""Least diagonal entry of the Cholesky factor relative to the file's: a link keeps some mass and extent."""
RANK_TOLERANCE = 1e-6
"""Least pivot of a base parameter, as a share of the largest."""
KNOWN = 0.9
"""Largest standard deviation, as a share of that of the prior, of what the motion has identified."""
MIN_MOBILITY = 1e-3
"""Least mobility, as a share of the largest at the pose, of a direction in which the effective mass counts."""
RANDOM_SEED = 1
_ROW, _COLUMN = np.tril_indices(4)
_UNIT = DEVIATION * np.where(_ROW == _COLUMN, 1.0, np.sqrt(0.5))
"""Standard deviations of the entries of S, below its diagonal row by row."""


class BaseParameters(NamedTuple):
    """How many parameters decide the torques: `identifiable` in any motion, of which the recorded one shows `rank`.

    `condition_number` is that of their columns in the recording, scaled to length 1; infinite below full rank.
    """

    identifiable: int
    rank: int
    condition_number: float


class PointMasses(NamedTuple):
    """The two masses (n, 2) [kg] of each link of the lumped model: of the file, as identified, standard deviations.

    `on_axes` and `axes_deviations` (k,) [kg] are the identified sums on axes apart from each other, proximal first.
    """

    stated: FloatArray
    identified: FloatArray
    deviations: FloatArray
    on_axes: FloatArray
    axes_deviations: FloatArray


class ArmEstimate(NamedTuple):
    """Inertial parameters (n, 10) of the links behind the joints of `robot`: by the robot file, and as identified.

    `root` (10 n, 10 n) times its transpose is their covariance, `prior_root` likewise before anything was known.
    `is_projected`: the regression alone gave a link that no body can be. `unfit` says why the torques do not fit the
    model, empty if they do. `point_masses` are those of the lumped model, whose bodies `robot` has then.
    """

    robot: Robot
    stated: FloatArray
    parameters: FloatArray
    root: FloatArray
    prior_root: FloatArray
    solution: Solution
    base: BaseParameters
    is_projected: bool
    unfit: str
    point_masses: PointMasses | None

    @property
    def deviations(self) -> FloatArray:
        """Standard deviations (n, 10) of the parameters."""
        return np.asarray(np.linalg.norm(self.root, axis=1).reshape(self.parameters.shape))

    @property
    def is_known(self) -> FloatArray:
        """Whether each parameter (n, 10) is identified: its interval is narrower than that of the prior."""
        prior = np.linalg.norm(self.prior_root, axis=1).reshape(self.parameters.shape)
        return np.asarray(self.deviations < KNOWN * prior)


class EffectiveMasses(NamedTuple):
    """Effective masses (k,) [kg] by the file and as identified, and standard deviations of the latter.

    `directions` (k,) is "worst", "vertical" or "random".
    """

    directions: tuple[str, ...]
    stated: FloatArray
    identified: FloatArray
    deviations: FloatArray


class _Prior(NamedTuple):
    """What is known before the torques: `basis` (10 n, p) makes the links of `robot` of p parameters.

    `units` (p, p) are the standard deviations of the parameters, and `origin` (p,) those of the file in these units.
    `project` returns the point nearest to a mean at which every link is physically possible, and whether that is
    another one; distances are lengths of a matrix times the difference. `moved` is the robot whose torques count.
    """

    robot: Robot
    moved: Robot
    basis: FloatArray
    units: FloatArray
    origin: FloatArray
    project: Callable[[FloatArray, FloatArray], tuple[FloatArray, bool]]


def identify_arm(
    robot: Robot, intervals: Iterable[FloatArray], effort_uncertainty: float, lumped: LumpedModel | None = None
) -> ArmEstimate | None:
    """Return the parameters of all links by the means (6, n) of `intervals`; None if no joint moves in any.

    With `lumped`, the links are its point masses. `effort_uncertainty` is that of `TorqueRegression`.
    """
    prior = _bodies(robot) if lumped is None else _two_masses_each(robot, lumped)
    units = prior.basis @ prior.units
    regression = TorqueRegression(prior.moved, units, effort_uncertainty)
    for means in intervals:
        regression.add(means)
    if not regression.has_motion:
        return None
    solution = regression.solve()
    values, vectors = np.linalg.eigh(solution.covariance)
    values = np.maximum(values, 1e-14)
    whitening = vectors.T / np.sqrt(values)[:, None]
    inside, is_projected = prior.project(solution.parameters + prior.origin, whitening)
    change = inside - prior.origin
    worst = np.abs(change).reshape(robot.model.nv, -1).max(axis=1)
    unfit = solution.unfit
    if not unfit and worst.max() > MAX_DEVIATIONS:
        joint = robot.joint_names[int(worst.argmax())]
        unfit = f"the link behind {joint} is {worst.max():.0f} standard deviations off the file"
    root = vectors * np.sqrt(values)
    masses = None if lumped is None else _point_masses(lumped, prior.units @ inside, prior.units @ root)
    if masses is not None and not unfit and masses.on_axes.min() < 0.0:
        unfit = f"the lumped mass on axis {masses.on_axes.argmin() + 1} is {masses.on_axes.min():.3g} kg"
    stated = link_parameters(prior.robot.model)
    return ArmEstimate(
        prior.robot,
        stated,
        stated + (units @ change).reshape(stated.shape),
        units @ root,
        units,
        solution,
        _base_parameters(
            robot, prior.basis, np.linalg.solve(prior.units.T, np.linalg.solve(prior.units.T, regression.gram).T)
        ),
        is_projected,
        unfit,
        masses,
    )


def _bodies(robot: Robot) -> _Prior:
    """Return rigid bodies for links; the last one may carry a load that the file does not state."""
    stated = link_parameters(robot.model)
    likely, lever = stated.copy(), LEVER * robot.reach
    likely[-1] += LOAD * stated[:, 0].sum() * _parameters(np.diag([lever * lever] * 3 + [1.0]))
    factors = [_factor(parameters, stated[:, 0].mean()) for parameters in likely]
    units = block_diag(*(_units(factor) for factor in factors))
    # The prior's links differ from those of the file where these have no extent or carry a load.
    start = stated.ravel() - np.concatenate([_parameters(factor @ factor.T) for factor in factors])
    return _Prior(robot, robot, np.eye(stated.size), units, np.linalg.solve(units, start), _project)


def _two_masses_each(robot: Robot, lumped: LumpedModel) -> _Prior:
    """Return the point masses of the links, at their places."""
    without = lumped.model.copy()
    without.armature = robot.model.armature
    pairs = [np.column_stack([_unit_mass(link.point1), _unit_mass(link.point2)]) for link in lumped.links]
    stated = _stated_masses(lumped)
    links = stated.sum(axis=1, keepdims=True)
    links = np.maximum(links, MIN_MASS_SHARE * links.mean())
    deviations = DEVIATION * np.maximum(np.abs(stated), MIN_KAPPA * links).ravel()
    # As of a body, some mass is left of a link, and a mass is negative only where that of the file is.
    lowest = np.minimum(stated, MIN_MASS_SHARE * links).ravel() / deviations
    start = stated.ravel() / deviations

    def project(mean: FloatArray, whitening: FloatArray) -> tuple[FloatArray, bool]:
        if (mean >= lowest).all():
            return mean, False
        return np.asarray(lsq_linear(whitening, whitening @ mean, (lowest, np.inf)).x), True

    return _Prior(
        replace(robot, model=lumped.model),
        replace(robot, model=without),
        block_diag(*pairs),
        np.diag(deviations),
        start,
        project,
    )


def _unit_mass(point: Vector3) -> FloatArray:
    """Return the parameters (10,) of 1 kg at `point`."""
    return np.asarray(pin.Inertia(1.0, np.array(point), np.zeros((3, 3))).toDynamicParameters())


def _stated_masses(lumped: LumpedModel) -> FloatArray:
    return np.array([[link.kappa1 * link.mass, link.kappa2 * link.mass] for link in lumped.links])


def _point_masses(lumped: LumpedModel, masses: FloatArray, root: FloatArray) -> PointMasses:
    """Return point `masses` (2 n,) whose covariance is `root` (2 n, 2 n) times its transpose."""
    axis, axes = 0, list[int]()
    for link in lumped.links:
        axes.append(axis)
        axis += link.axes != "coincident"
        axes.append(axis)
    sums = np.equal.outer(np.arange(axis + 1), axes).astype(float)
    return PointMasses(
        _stated_masses(lumped),
        masses.reshape(-1, 2),
        np.linalg.norm(root, axis=1).reshape(-1, 2),
        sums @ masses,
        np.linalg.norm(sums @ root, axis=1),
    )


def with_parameters(model: pin.Model, parameters: FloatArray) -> pin.Model:
    """Return `model` with the inertial parameters (n, 10)."""
    changed = model.copy()
    for joint, values in enumerate(parameters, start=1):
        changed.inertias[joint] = pin.Inertia.FromDynamicParameters(values)
    return changed


def modelled_torques(robot: Robot, estimate: ArmEstimate, means: FloatArray) -> FloatArray:
    """Return the torques (k, n) [N m, N] by the estimate in intervals of `means` (k, 6, n), with friction and e_j.

    NaN where a joint does not move one way: its friction is not known.
    """
    model, solution = with_parameters(robot.model, estimate.parameters), estimate.solution
    data, coupling = model.createData(), robot.rotors.coupling
    rigid = [pin.rnea(model, data, *row) + coupling @ row[QDD] for row in means[:, [Q, QD, QDD]]]
    coulomb, viscous = solution.friction.T
    qd = means[:, QD]
    torques = (1.0 + solution.scale_errors) * np.array(rigid) + coulomb * np.sign(qd) + viscous * qd
    is_one_way = (means[:, LOWEST] > rest_speeds(robot)) | (means[:, HIGHEST] < -rest_speeds(robot))
    return np.where(is_one_way, torques, np.nan)


def effective_mass(
    robot: Robot, model: pin.Model, data: pin.Data, q: FloatArray, normals: FloatArray, frame: int
) -> tuple[FloatArray, FloatArray]:
    """Return the effective masses (k,) [kg] along `normals` (k, 3) of a contact `frame` at `q`, and gradients.

    The gradients (k, 10 n) are by the parameters of the links: d m_n / d pi = m_n^2 w^T (Y(q, 0, w) - Y(q, 0, 0)) with
    w = M^-1 J^T n and M w = (Y(q, 0, w) - Y(q, 0, 0)) pi, rotors aside.
    """
    jacobian = frame_jacobian(model, data, q, frame)
    w = np.linalg.solve(robot.mass_matrix(model, data, q), jacobian.T @ normals.T).T
    masses = 1.0 / np.einsum("ki,ki->k", w @ jacobian.T, normals)
    rest = np.zeros(model.nv)
    at_rest = torque_regressor(model, data, q, rest, rest).copy()
    rows = [torque_regressor(model, data, q, rest, row) - at_rest for row in w]
    return masses, masses[:, None] ** 2 * np.einsum("ki,kij->kj", w, np.array(rows))


def effective_masses(estimate: ArmEstimate, samples: int) -> EffectiveMasses:
    """Return the effective masses of the first contact point at `samples` configurations over the joint ranges."""
    robot = estimate.robot
    rng, model = np.random.default_rng(RANDOM_SEED), robot.model
    changed = with_parameters(model, estimate.parameters)
    data, changed_data = model.createData(), changed.createData()
    kinds, rows, frame = list[str](), [], next(iter(robot.contact_frames.values()))
    for q in robot.sample_configurations(samples):
        jacobian = frame_jacobian(model, data, q, frame)
        mobility = jacobian @ np.linalg.solve(robot.mass_matrix(model, data, q), jacobian.T)
        values, vectors = np.linalg.eigh(mobility)
        worst = vectors[:, int(np.argmax(values > MIN_MOBILITY * values[-1]))]
        random = rng.normal(size=3)
        named = {"worst": worst, "vertical": np.array([0.0, 0.0, 1.0]), "random": random / np.linalg.norm(random)}
        counted = {name: n for name, n in named.items() if n @ mobility @ n > MIN_MOBILITY * values[-1]}
        normals = np.array(list(counted.values()))
        kinds += counted
        stated, _ = effective_mass(robot, model, data, q, normals, frame)
        found, gradients = effective_mass(robot, changed, changed_data, q, normals, frame)
        rows.append(np.column_stack((stated, found, np.linalg.norm(gradients @ estimate.root, axis=1))))
    return EffectiveMasses(tuple(kinds), *np.vstack(rows).T)


def _parameters(matrix: FloatArray) -> FloatArray:
    """Return the parameters (10,) of a pseudo-inertia (4, 4), or their change by one."""
    return np.asarray(pin.PseudoInertia.FromMatrix(matrix).toDynamicParameters())


def _factor(parameters: FloatArray, mean_mass: float) -> FloatArray:
    """Return U (4, 4) with U U^T the pseudo-inertia of a link of the file, of least mass and extent."""
    matrix = pin.PseudoInertia.FromDynamicParameters(parameters).toMatrix()
    mass = max(matrix[3, 3], MIN_MASS_SHARE * mean_mass)
    com = matrix[:3, 3] / mass
    values, vectors = np.linalg.eigh(matrix[:3, :3] / mass - np.outer(com, com))
    factor = np.zeros((4, 4))
    factor[:3, :3] = np.sqrt(mass) * vectors * np.sqrt(np.maximum(values, MIN_RADIUS_M**2))
    factor[:3, 3], factor[3, 3] = np.sqrt(mass) * com, np.sqrt(mass)
    return factor


def _units(factor: FloatArray) -> FloatArray:
    """Return the changes (10, 10) of a link's parameters for one standard deviation of each entry of S."""
    columns = []
    for row, column, unit in zip(_ROW, _COLUMN, _UNIT, strict=True):
        change = np.zeros((4, 4))
        change[row, column] = change[column, row] = unit
        columns.append(_parameters(factor @ change @ factor.T))
    return np.array(columns).T


def _project(mean: FloatArray, whitening: FloatArray) -> tuple[FloatArray, bool]:
    """Return the point nearest to `mean` (10 n,), entries of S in units of the prior, with bodies for links.

    Distances are lengths of `whitening` times the difference. Also return whether `mean` has no such links.
    """
    links = len(mean) // PER_LINK
    low = np.where(_ROW == _COLUMN, np.log(MIN_FACTOR), -np.inf)
    start, is_inside = [], True
    for entries in mean.reshape(links, PER_LINK):
        matrix = np.eye(4)
        matrix[_ROW, _COLUMN] += _UNIT * entries
        values, vectors = np.linalg.eigh(matrix, UPLO="L")
        factor = np.linalg.cholesky((vectors * np.maximum(values, 4.0 * MIN_FACTOR**2)) @ vectors.T)
        is_inside = is_inside and bool(values[0] >= 4.0 * MIN_FACTOR**2)
        logarithms = factor - np.diag(np.diag(factor)) + np.diag(np.log(np.diag(factor)))
        start.append(np.maximum(logarithms[_ROW, _COLUMN], low + 1e-6))
    if is_inside:
        return mean, False

    def entries_at(theta: FloatArray) -> FloatArray:
        return np.concatenate([_entries(part) for part in theta.reshape(links, PER_LINK)])

    found = least_squares(
        lambda theta: whitening @ (entries_at(theta) - mean),
        np.concatenate(start),
        lambda theta: whitening @ block_diag(*(_slopes(part) for part in theta.reshape(links, PER_LINK))),
        bounds=(np.tile(low, links), np.inf),
        x_scale="jac",
    )
    return entries_at(found.x), True


def _cholesky(theta: FloatArray) -> FloatArray:
    """Return the factor (4, 4) of I + S with the logarithms of its diagonal in `theta` (10,)."""
    factor = np.zeros((4, 4))
    factor[_ROW, _COLUMN] = np.where(_ROW == _COLUMN, np.exp(theta), theta)
    return factor


def _entries(theta: FloatArray) -> FloatArray:
    factor = _cholesky(theta)
    return np.asarray((factor @ factor.T - np.eye(4))[_ROW, _COLUMN] / _UNIT)


def _slopes(theta: FloatArray) -> FloatArray:
    """Return the derivatives (10, 10) of `_entries`."""
    factor, columns = _cholesky(theta), []
    for row, column in zip(_ROW, _COLUMN, strict=True):
        change = np.zeros((4, 4))
        change[row] = factor[:, column] * (factor[row, row] if row == column else 1.0)
        columns.append((change + change.T)[_ROW, _COLUMN] / _UNIT)
    return np.array(columns).T


def _base_parameters(robot: Robot, basis: FloatArray, gram: FloatArray) -> BaseParameters:
    """Return what the Gram matrix (p, p) of a recording says about the parameters `basis` (10 n, p) of `robot`."""
    rng, model, data = np.random.default_rng(RANDOM_SEED), robot.model, robot.model.createData()
    rows = [
        torque_regressor(model, data, q, *rng.normal(size=(2, model.nv))) @ basis
        for q in robot.sample_configurations(2 * PER_LINK * model.nv)
    ]
    order, identifiable = _pivoted(np.vstack(rows))
    # The other columns are sums of these.
    columns = order[:identifiable]
    values, vectors = np.linalg.eigh(gram[np.ix_(columns, columns)])
    recorded = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    _, rank = _pivoted(recorded)
    singular = np.linalg.svd(recorded / np.maximum(np.linalg.norm(recorded, axis=0), 1e-300), compute_uv=False)
    condition = float(singular[0] / singular[-1]) if rank == identifiable else np.inf
    return BaseParameters(identifiable, rank, condition)


def _pivoted(columns: FloatArray) -> tuple[FloatArray, int]:
    """Return the order of columns and their rank by QR with pivoting of those scaled to length 1."""
    norms = np.linalg.norm(columns, axis=0)
    lengths = np.where(norms > RANK_TOLERANCE * norms.max(), norms, np.inf)
    triangle, order = qr(columns / lengths, mode="r", pivoting=True)
    pivots = np.abs(np.diag(triangle))
    return order, int(np.sum(pivots > RANK_TOLERANCE * pivots.max()))
