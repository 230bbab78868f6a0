# SPDX-License-Identifier: Apache-2.0
"""Inertial parameters of all moving links from motion and torques, and the effective masses that follow.

The prior is the robot file: the pseudo-inertia of a link is U (I + S) U^T with that of the file U U^T and a symmetric
S whose entries have a standard deviation, as in the metric of Lee, Wensing & Park 2020 (doi:10.1109/LRA.2019.2953661),
which has no units. The estimate is the point of the Gaussian of the regression nearest to its mean at which every
pseudo-inertia is positive definite (Wensing, Kim & Slotine 2018, doi:10.1109/LRA.2017.2729659), by the parameters of
its Cholesky factor (Rucker & Wensing 2022, doi:10.1109/LRA.2022.3144517).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.linalg import block_diag, qr
from scipy.optimize import least_squares

from scara_effmass.identification.regression import Solution, TorqueRegression, link_parameters
from scara_effmass.model.robot import Robot
from scara_effmass.values import FloatArray

PER_LINK = 10
"""Number of inertial parameters of a link, in Pinocchio's order: m, m c, and the inertia about the joint's origin."""
PARAMETERS = ("m", "m cx", "m cy", "m cz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
DEVIATION = 0.5
"""Relative standard deviation of the mass of a link by the file; its CoM has 0.35 of the link's radius of gyration."""
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
    """Which parameters decide the torques: `identifiable` in any motion, of which the recorded one shows `rank`.

    `columns` (r,) are those parameters, and `combinations` (r, 10 n) what is identifiable in place of each.
    `condition_number` is that of their columns in the recording, scaled to length 1; infinite below full rank.
    """

    identifiable: int
    rank: int
    condition_number: float
    columns: tuple[int, ...]
    combinations: FloatArray


class ArmEstimate(NamedTuple):
    """Inertial parameters (n, 10) of the links behind the joints: by the robot file, and as identified.

    `root` (10 n, 10 n) times its transpose is their covariance, `prior_root` likewise before anything was known.
    `is_projected`: the regression alone gave a link that no body can be. `unfit` says why the torques do not fit the
    model, empty if they do. `determined` is the number of directions that are twice as narrow as before.
    """

    stated: FloatArray
    parameters: FloatArray
    root: FloatArray
    prior_root: FloatArray
    solution: Solution
    base: BaseParameters
    determined: int
    is_projected: bool
    unfit: str

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

    `prior_deviations` are those before anything was known; `directions` (k,) is "worst", "vertical" or "random".
    """

    directions: tuple[str, ...]
    stated: FloatArray
    identified: FloatArray
    deviations: FloatArray
    prior_deviations: FloatArray


def identify_arm(robot: Robot, intervals: Iterable[FloatArray], effort_uncertainty: float) -> ArmEstimate | None:
    """Return the parameters of all links by the means (6, n) of `intervals`; None if no joint moves in any.

    `effort_uncertainty` is that of `TorqueRegression`.
    """
    stated = link_parameters(robot.model)
    factors = [_factor(parameters, stated[:, 0].mean()) for parameters in stated]
    units = block_diag(*(_units(factor) for factor in factors))
    regression = TorqueRegression(robot, units, effort_uncertainty)
    for means in intervals:
        regression.add(means)
    if not regression.counts.any():
        return None
    solution = regression.solve()
    values, vectors = np.linalg.eigh(solution.covariance)
    values = np.maximum(values, 1e-14)
    start = stated.ravel() - np.concatenate([_parameters(factor @ factor.T) for factor in factors])
    whitening = vectors.T / np.sqrt(values)[:, None]
    # The prior's links differ from those of the file where these have no extent.
    offset = np.linalg.solve(units, start)
    inside, is_projected = _project(solution.parameters + offset, whitening)
    found = stated.ravel() + units @ (inside - offset)
    worst = np.abs(inside - offset).reshape(-1, PER_LINK).max(axis=1)
    unfit = solution.unfit
    if not unfit and worst.max() > MAX_DEVIATIONS:
        joint = robot.joint_names[int(worst.argmax())]
        unfit = f"the link behind {joint} is {worst.max():.0f} standard deviations off the file"
    return ArmEstimate(
        stated,
        found.reshape(stated.shape),
        units @ (vectors * np.sqrt(values)),
        units,
        solution,
        _base_parameters(robot, np.linalg.solve(units.T, np.linalg.solve(units.T, regression.gram).T)),
        int(np.sum(values < 0.25)),
        is_projected,
        unfit,
    )


def with_parameters(model: pin.Model, parameters: FloatArray) -> pin.Model:
    """Return `model` with the inertial parameters (n, 10)."""
    changed = model.copy()
    for joint, values in enumerate(parameters, start=1):
        changed.inertias[joint] = pin.Inertia.FromDynamicParameters(values)
    return changed


def effective_mass(
    robot: Robot, model: pin.Model, data: pin.Data, q: FloatArray, normals: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the effective masses (k,) [kg] along `normals` (k, 3) of the first contact point at `q`, and gradients.

    The gradients (k, 10 n) are by the parameters of the links: d m_n / d pi = m_n^2 w^T (Y(q, 0, w) - Y(q, 0, 0)) with
    w = M^-1 J^T n and M w = (Y(q, 0, w) - Y(q, 0, 0)) pi, rotors aside.
    """
    w = np.linalg.solve(robot.mass_matrix(model, data, q), _jacobian(robot, q).T @ normals.T).T
    masses = 1.0 / np.einsum("ki,ki->k", w @ _jacobian(robot, q).T, normals)
    rest = np.zeros(model.nv)
    at_rest = pin.computeJointTorqueRegressor(model, data, q, rest, rest).copy()
    rows = [pin.computeJointTorqueRegressor(model, data, q, rest, row) - at_rest for row in w]
    return masses, masses[:, None] ** 2 * np.einsum("ki,kij->kj", w, np.array(rows))


def effective_masses(robot: Robot, estimate: ArmEstimate, samples: int) -> EffectiveMasses:
    """Return the effective masses of the first contact point at `samples` configurations over the joint ranges."""
    rng, model = np.random.default_rng(RANDOM_SEED), robot.model
    changed = with_parameters(model, estimate.parameters)
    data, changed_data = model.createData(), changed.createData()
    kinds, rows = list[str](), []
    for q in robot.sample_configurations(samples):
        jacobian = _jacobian(robot, q)
        mobility = jacobian @ np.linalg.solve(robot.mass_matrix(model, data, q), jacobian.T)
        values, vectors = np.linalg.eigh(mobility)
        worst = vectors[:, int(np.argmax(values > MIN_MOBILITY * values[-1]))]
        random = rng.normal(size=3)
        named = {"worst": worst, "vertical": np.array([0.0, 0.0, 1.0]), "random": random / np.linalg.norm(random)}
        counted = {name: n for name, n in named.items() if n @ mobility @ n > MIN_MOBILITY * values[-1]}
        normals = np.array(list(counted.values()))
        kinds += counted
        stated, _ = effective_mass(robot, model, data, q, normals)
        found, gradients = effective_mass(robot, changed, changed_data, q, normals)
        deviations = (np.linalg.norm(gradients @ root, axis=1) for root in (estimate.root, estimate.prior_root))
        rows.append(np.column_stack((stated, found, *deviations)))
    return EffectiveMasses(tuple(kinds), *np.vstack(rows).T)


def _jacobian(robot: Robot, q: FloatArray) -> FloatArray:
    """Return the Jacobian (3, n) of the first contact point."""
    frame, data = next(iter(robot.contact_frames.values())), robot.model.createData()
    jacobian = pin.computeFrameJacobian(robot.model, data, q, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    return np.reshape(jacobian, (6, robot.model.nv))[:3]


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


def _base_parameters(robot: Robot, gram: FloatArray) -> BaseParameters:
    """Return the base parameters of `robot`, and what the Gram matrix (10 n, 10 n) of a recording says about them."""
    rng, model, data = np.random.default_rng(RANDOM_SEED), robot.model, robot.model.createData()
    rows = [
        pin.computeJointTorqueRegressor(model, data, q, *rng.normal(size=(2, model.nv))).copy()
        for q in robot.sample_configurations(2 * PER_LINK * model.nv)
    ]
    triangle, order, identifiable = _pivoted(np.vstack(rows))
    # Y = Y_b K: every other column is a sum of those of the base parameters.
    combinations = np.zeros((identifiable, len(order)))
    combinations[:, order] = np.linalg.solve(triangle[:identifiable, :identifiable], triangle[:identifiable])
    combinations[np.abs(combinations) < RANK_TOLERANCE] = 0.0
    columns = order[:identifiable]
    values, vectors = np.linalg.eigh(gram[np.ix_(columns, columns)])
    recorded = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    rank = _pivoted(recorded)[2]
    singular = np.linalg.svd(recorded / np.maximum(np.linalg.norm(recorded, axis=0), 1e-300), compute_uv=False)
    condition = float(singular[0] / singular[-1]) if rank == identifiable else np.inf
    return BaseParameters(identifiable, rank, condition, tuple(columns.tolist()), combinations)


def _pivoted(columns: FloatArray) -> tuple[FloatArray, FloatArray, int]:
    """Return R, in the scales of `columns`, the order of columns and their rank by QR with pivoting of scaled ones."""
    norms = np.linalg.norm(columns, axis=0)
    lengths = np.where(norms > RANK_TOLERANCE * norms.max(), norms, np.inf)
    triangle, order = qr(columns / lengths, mode="r", pivoting=True)
    pivots = np.abs(np.diag(triangle))
    rank = int(np.sum(pivots > RANK_TOLERANCE * pivots.max()))
    return triangle * np.where(np.isfinite(lengths), lengths, 0.0)[order], order, rank
