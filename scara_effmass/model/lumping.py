# SPDX-License-Identifier: Apache-2.0
"""Lumped ("simplified") model: two point masses per link, on the axes of its two joints, with its mass and CoM.

For link i with unit axes u_a (proximal) and u_b (distal), and feet f_a and f_b of their common normal:

    kappa1 (f_a + L1 u_a) + kappa2 (f_b + L2 u_b) = CoM,    kappa1 + kappa2 = 1

Skew axes determine the masses. Intersecting axes leave kappa2 free, parallel ones L2 - L1: `lumping.free_parameters`
says how these are chosen. A prismatic axis has a direction but no place, and so has the axis behind the last joint:
where such an axis as drawn gives no masses, it is shifted through the CoM. `lumping.policy` says what to do about a
link without such masses.
Masses of neighbouring links on the same axis add up, so n joints leave n + 1 masses (Table II of the paper, cited in
`scara_effmass.model`).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from scara_effmass.errors import RobotError
from scara_effmass.model.description import PARALLEL
from scara_effmass.model.robot import Robot
from scara_effmass.settings import FreeParameters, LumpingPolicy
from scara_effmass.values import FloatArray, Vector3

ON_AXIS_M = 1e-4
"""Distance [m] below which axes coincide, or a centre of mass lies in their plane: finer than CAD data."""
RUNAWAY = 10.0
"""Distance of a mass from the common normal, over the size of the link, above which it counts as infinite."""
FIT_REACH = 3.0
"""Largest distance, beyond the axes, of a mass that fits the inertia, in radii of gyration of the link."""
SINGULAR = 1e-9
"""Smallest ratio at which M is regular: of the inertia that a joint moves to its largest one, and of eigenvalues."""
TURNS = (0.0, np.pi / 2.0, -np.pi / 2.0)
"""Joint positions [rad, m] at which axes align, so that a lumped mass matrix can be singular."""


@dataclass(frozen=True, slots=True)
class LumpedLink:
    """One link as two point masses `kappa1 * mass` and `kappa2 * mass` at `point1` and `point2` in its joint frame [m].

    `height1` and `height2` are L1 and L2 [m], from the feet of the common normal of its two axes. `axes` is parallel,
    coincident, intersecting or skew. `on_axes` is False if a mass is beside the axes as drawn. `problem` states, with
    a figure, why two masses on the axes cannot reproduce the link, `answer` what `lumping.policy` did about it.
    """

    joint: str
    mass: float
    axes: str
    kappa1: float
    kappa2: float
    height1: float
    height2: float
    point1: Vector3
    point2: Vector3
    on_axes: bool = True
    problem: str = ""
    answer: str = ""


class _DrawnLink(NamedTuple):
    """A link as drawn: its body, proximal axis, and a point and the unit direction of its distal axis (3,).

    `fit` chooses free parameters by the inertia; `within_slab` refuses a negative mass.
    """

    joint: str
    body: pin.Inertia
    axis: FloatArray
    point: FloatArray
    distal: FloatArray
    fit: bool
    within_slab: bool


class LumpedMass(NamedTuple):
    """A point `mass` [kg] at `point` [m] in the frame of `joint` (1-based)."""

    mass: float
    joint: int
    point: Vector3


@dataclass(frozen=True, slots=True)
class LumpedModel:
    """Lumped links of a robot and their Pinocchio model, whose mass matrix is Eq. 14.

    `aggregated` are the n + 1 masses [kg] by axis, proximal first; a revolute joint does not move the first. `masses`
    are those left after adding up what lies at one place: n + 1 as well where the heights agree or do not matter.
    `massless_joints` are the joints (0-based) that move no lumped mass: `model` gives them an armature of 1 to keep its
    mass matrix regular. The mass along a direction in which such a joint does not move the contact point is unaffected.
    `is_regular` tells whether that matrix is positive definite at every pose by its form.
    """

    links: tuple[LumpedLink, ...]
    aggregated: tuple[float, ...]
    masses: tuple[LumpedMass, ...]
    model: pin.Model
    massless_joints: tuple[int, ...]
    is_regular: bool

    def planar_masses(self, robot: Robot) -> tuple[float, float]:
        """Return M2 (elbow) and M3 (end-effector) of the equivalent planar mechanism [kg], after Eq. 25.

        Raises RobotError if the robot is not a SCARA, has rotor inertia, or some mass off its axes.
        """
        if not is_scara(robot):
            raise RobotError(f"{robot.origin}: {robot.name} is not a SCARA: it has no equivalent planar masses")
        if robot.rotors.matrix.any():
            raise RobotError(f"{robot.origin}: the equivalent planar masses do not cover rotor inertia")
        for link in self.links:
            if not link.on_axes:
                raise RobotError(
                    f"{robot.origin}: link behind {link.joint}: its centre of mass lies off the plane of its two axes"
                )
        return self.aggregated[1], sum(self.aggregated[2:])


@lru_cache(maxsize=16)
def is_scara(robot: Robot) -> bool:
    """Return whether the robot is a chain R-R-P-R with parallel axes, of which the last two coincide."""
    if robot.revolute != (True, True, False, True):
        return False
    axes = [_distal_axis(robot, joint) for joint in range(1, 5)]
    point, axis = axes[2]
    parallel = all(_are_parallel(robot.axis_in_joint_frame(joint), axes[joint - 1][1]) for joint in range(1, 5))
    return parallel and float(np.linalg.norm(point - (point @ axis) * axis)) < ON_AXIS_M


@lru_cache(maxsize=16)
def lumped_suffices(robot: Robot) -> bool:
    """Return whether the lumped masses of `robot` suffice without inertia tensors to compare them with.

    They do for a SCARA, the arm of the paper, unless its joint 4 moves a contact point, because then the inertia of
    tool and load about that joint counts, which is far more than that of their lumped masses.
    """
    if not is_scara(robot):
        return False
    frames = [robot.model.frames[frame] for frame in robot.contact_frames.values()]
    axis = robot.axis_in_joint_frame(4)
    last = robot.model.njoints - 1
    beside = [np.cross(axis, frame.placement.translation) for frame in frames if frame.parentJoint == last]
    return all(float(np.linalg.norm(offset)) <= ON_AXIS_M for offset in beside)


class IndefiniteError(RobotError):
    """The lumped mass matrix is not positive definite."""


def lump(robot: Robot) -> LumpedModel:
    """Return the lumped model of `robot` by the settings `robot.lumping`.

    Raises IndefiniteError, and, if the policy is to refuse, RobotError that names every link without such masses. Any
    other policy is applied to those links alone, and if M is then indefinite, also to the links whose centre of mass is
    outside the slab between their axes.
    """
    if robot.masses_reason or robot.coms_reason:
        raise RobotError(robot.masses_reason or robot.coms_reason)
    if list(robot.model.parents)[1:] != list(range(robot.model.njoints - 1)):
        raise RobotError("the joints must form a single chain")
    try:
        return _lumped_model(robot, within_slab=False)
    except IndefiniteError:
        if robot.lumping.policy is LumpingPolicy.REFUSE:
            raise
    return _lumped_model(robot, within_slab=True)


def lumped_links(robot: Robot, *, within_slab: bool = False) -> tuple[LumpedLink, ...]:
    """Return the masses of each link, also of those with a `problem` but no `answer`, which `lump` refuses."""
    return tuple(_lumped_link(robot, joint, within_slab=within_slab) for joint in range(1, robot.model.njoints))


def _lumped_model(robot: Robot, *, within_slab: bool) -> LumpedModel:
    links = lumped_links(robot, within_slab=within_slab)
    problems = [f"link behind {link.joint}: {link.problem}" for link in links if link.problem and not link.answer]
    if problems:
        raise RobotError(f"{'; '.join(problems)} (lumping.policy project_com and mass_at_com approximate)")
    model = robot.model.copy()
    for joint, link in enumerate(links, start=1):
        model.inertias[joint] = _two_masses(link)
    massless_joints = _massless_joints(robot, model)
    armature = robot.model.armature.copy()
    armature[list(massless_joints)] = 1.0
    model.armature = armature
    _require_positive_definite(robot, model, links)
    aggregated = [0.0] * robot.model.njoints
    for index, link in enumerate(links):
        aggregated[index] += link.kappa1 * link.mass
        aggregated[index + 1] += link.kappa2 * link.mass
    masses = _at_one_place(robot, links)
    is_regular = all(link.axes in {"parallel", "coincident"} for link in links) and min(masses).mass >= 0.0
    return LumpedModel(links, tuple(aggregated), masses, model, massless_joints, is_regular)


def _distal_axis(robot: Robot, joint: int) -> tuple[FloatArray, FloatArray]:
    """Return a point and the unit direction of the axis after `joint`, in the frame of `joint`."""
    if joint == robot.model.njoints - 1:
        return robot.tip.translation.copy(), robot.axis_in_joint_frame(joint)
    placement = robot.model.jointPlacements[joint + 1]
    return placement.translation.copy(), placement.rotation @ robot.axis_in_joint_frame(joint + 1)


def _are_parallel(axis: FloatArray, distal: FloatArray) -> bool:
    return float(np.linalg.norm(np.cross(axis, distal))) <= PARALLEL


def _lumped_link(robot: Robot, joint: int, *, within_slab: bool) -> LumpedLink:
    """Return the masses of the link behind `joint`, by the policy if its axes as drawn have none."""
    name, body, axis = robot.joint_names[joint - 1], robot.model.inertias[joint], robot.axis_in_joint_frame(joint)
    point, distal = _distal_axis(robot, joint)
    fit = robot.lumping.free_parameters is FreeParameters.FIT_INERTIA and not robot.inertias_reason
    parallel = _are_parallel(axis, distal)
    drawn = _DrawnLink(name, body, axis, point, distal, fit, within_slab)
    link = _parallel_axes(drawn) if parallel else _crossed_axes(drawn)
    com, height = np.array(body.lever), float(body.lever @ axis)
    near, far = height * axis, com - height * axis
    at_com = {
        "height1": height if parallel else 0.0,
        "height2": height * float(np.sign(axis @ distal)) if parallel else 0.0,
    }
    if not link.problem:
        if link.axes != "coincident" or robot.revolute[joint - 1]:
            return replace(link, problem="")
        # The whole mass lies on the distal axis, which slides: M33 = m_l4 + m_l5 of the paper.
        return _with_masses(link, 1.0, near, near, problem="", **at_com)
    # A prismatic axis, and the distal axis of the last link, have no place: shift such an axis through the CoM.
    if not robot.revolute[joint - 1]:
        return _with_masses(link, 0.0, com, com, on_axes=False, problem="", **at_com)
    if not (*robot.revolute, False)[joint]:
        reach = 1.0
        if fit and parallel:  # reproduces the moment about the proximal axis
            reach += float(axis @ body.inertia @ axis / (body.mass * far @ far))
        return _with_masses(link, 1.0 / reach, near, near + reach * far, on_axes=False, problem="", **at_com)
    return _answered(link, com, robot.lumping.policy)


def _answered(link: LumpedLink, com: FloatArray, policy: LumpingPolicy) -> LumpedLink:
    """Return the masses that `policy` gives a link with a problem and its centre of mass at `com` (3,)."""
    if policy is LumpingPolicy.MASS_AT_COM:
        return _with_masses(link, 0.5, com, com, on_axes=False, answer="one mass at its centre of mass")
    if policy is LumpingPolicy.PROJECT_COM:
        moved = np.linalg.norm(link.kappa1 * np.array(link.point1) + link.kappa2 * np.array(link.point2) - com)
        return replace(link, answer=f"its centre of mass moved by {1e3 * moved:.1f} mm")
    return link


def _with_masses(link: LumpedLink, kappa2: float, point1: ArrayLike, point2: ArrayLike, **changes: Any) -> LumpedLink:  # noqa: ANN401 - fields of LumpedLink
    """Return `link` with other masses and `changes`."""
    points = {"point1": _vector(point1), "point2": _vector(point2)}
    return replace(link, **{"kappa1": 1.0 - kappa2, "kappa2": kappa2, **points, **changes})


def _parallel_axes(drawn: _DrawnLink) -> LumpedLink:
    """Return the masses of a link with parallel axes; with a `problem`, those of the nearest possible CoM."""
    name, body, axis, point, distal, fit, within_slab = drawn
    height = float(body.lever @ axis)
    across = body.lever - height * axis
    normal = point - (point @ axis) * axis
    length = float(np.linalg.norm(normal))
    axes, spread, problem = "parallel", 0.0, ""
    if length < ON_AXIS_M:
        axes, normal = "coincident", np.zeros(3)
        kappa2, distance = 0.5, float(np.linalg.norm(across))  # any kappa is exact
    else:
        kappa2 = float(across @ normal) / length**2
        distance = float(np.linalg.norm(across - kappa2 * normal))
    if distance > ON_AXIS_M:
        problem = f"its centre of mass lies {distance * 1e3:.1f} mm off the plane of its two axes"
    elif within_slab and not 0.0 <= kappa2 <= 1.0:
        problem = _outside(kappa2)
        kappa2 = min(max(kappa2, 0.0), 1.0)
    share = body.mass * (1.0 - kappa2) * kappa2
    if fit and share > 0.0:
        # Two masses at distance r have the tensor share (r^2 1 - r r^T), here with r = normal + spread axis.
        square, linear = share * _unit_inertia(axis), -share * (np.outer(normal, axis) + np.outer(axis, normal))
        rest = share * _unit_inertia(normal) - body.inertia
        middle = _dot(linear, linear) + 2.0 * _dot(rest, square)
        slope = 2.0 * _dot(square, square), 3.0 * _dot(square, linear), middle, _dot(rest, linear)
        size = length + FIT_REACH * _gyration(body)
        spread = _minimum(slope, lambda d: np.linalg.norm((square * d + linear) * d + rest), -size, size)
    height1, height2 = height - kappa2 * spread, height + (1.0 - kappa2) * spread
    signed = height2 * float(np.sign(axis @ distal))
    points = _vector(height1 * axis), _vector(normal + height2 * axis)
    return LumpedLink(name, float(body.mass), axes, 1.0 - kappa2, kappa2, height1, signed, *points, problem=problem)


def _crossed_axes(drawn: _DrawnLink) -> LumpedLink:
    """Return the masses of a link whose axes intersect or are skew; with a `problem`, those of a nearby CoM."""
    name, body, axis, point, distal, fit, within_slab = drawn
    across = np.cross(axis, distal)
    across /= np.linalg.norm(across)
    gap = float(point @ across)
    foot1 = _along(point, axis, distal)[0] * axis
    foot2 = foot1 + gap * across
    offset, mass, axes, problem = float((body.lever - foot1) @ across), float(body.mass), "intersecting", ""
    if abs(gap) > ON_AXIS_M:
        axes = "skew"
    elif abs(offset) > ON_AXIS_M:
        problem = f"its centre of mass lies {1e3 * abs(offset):.1f} mm off the plane of its two axes"
    first, second = _along(body.lever - foot1, axis, distal)  # kappa1 L1 and kappa2 L2
    total = abs(first) + abs(second)
    kappa2 = least = abs(second) / total if total > 0.0 else 0.5  # of least spread: |L1| = |L2|
    if axes == "skew":
        kappa2 = offset / gap
        far = max(_distance(first, 1.0 - kappa2), _distance(second, kappa2))
        if far > RUNAWAY * (total + abs(gap)):
            problem = f"a mass lies {far:.3g} m from the common normal: kappa2 = {kappa2:.2g}"
        elif within_slab and not 0.0 <= kappa2 <= 1.0:
            problem = _outside(kappa2)
        kappa2 = least if problem else kappa2
    elif fit and total > 0.0:
        # sqrt(kappa1 kappa2) r = second / s distal - first s axis with s^2 = kappa2 / kappa1 = t.
        linear, inverse = mass * first**2 * _unit_inertia(axis), mass * second**2 * _unit_inertia(distal)
        mixed = np.outer(axis, distal) + np.outer(distal, axis)
        rest = -mass * first * second * (2.0 * (axis @ distal) * np.eye(3) - mixed) - body.inertia
        slope = _dot(linear, linear), _dot(rest, linear), 0.0, -_dot(rest, inverse), -_dot(inverse, inverse)
        reach = total + FIT_REACH * _gyration(body)
        high, low = reach / max(abs(first), 1e-9 * reach), max(abs(second), 1e-9 * reach) / reach
        ratio = _minimum(slope, lambda t: np.linalg.norm(linear * t + inverse / t + rest), low, high)
        kappa2 = ratio / (1.0 + ratio)
    height1 = first / (1.0 - kappa2) if kappa2 < 1.0 else 0.0
    height2 = second / kappa2 if kappa2 > 0.0 else 0.0
    points = _vector(foot1 + height1 * axis), _vector(foot2 + height2 * distal)
    return LumpedLink(name, mass, axes, 1.0 - kappa2, kappa2, height1, height2, *points, problem=problem)


def _along(vector: FloatArray, axis: FloatArray, distal: FloatArray) -> tuple[float, float]:
    """Return the components of `vector` along two unit vectors that are not parallel; that across both is dropped."""
    cosine, along, along_distal = float(axis @ distal), float(vector @ axis), float(vector @ distal)
    square = 1.0 - cosine * cosine
    return (along - cosine * along_distal) / square, (along_distal - cosine * along) / square


def _minimum(slope: Sequence[float], error: Callable[[float], np.floating[Any]], low: float, high: float) -> float:
    """Return where `error` is smallest from `low` to `high`: at an end, or at a real root of the polynomial `slope`."""
    roots = [float(root.real) for root in np.roots(slope) if abs(root.imag) <= 1e-9 * (1.0 + abs(root))]
    return min([min(max(root, low), high) for root in (*roots, low, high)], key=error)


def _gyration(body: pin.Inertia) -> float:
    """Return the radius of gyration [m] of the mean moment of inertia."""
    return float(np.sqrt(np.trace(body.inertia) / (3.0 * body.mass)))


def _dot(left: FloatArray, right: FloatArray) -> float:
    return float(np.sum(left * right))


def _outside(kappa2: float) -> str:
    return f"its centre of mass lies outside the slab between its axes: kappa2 = {kappa2:.3g} makes M indefinite"


def _at_one_place(robot: Robot, links: tuple[LumpedLink, ...]) -> tuple[LumpedMass, ...]:
    """Return the masses, those at one place on a common revolute axis added up, and none of 0 but on the first axis."""
    masses: list[LumpedMass] = []
    flat = True
    for joint, link in enumerate(links, start=1):
        near = LumpedMass(link.kappa1 * link.mass, joint, link.point1)
        if masses:
            flat = flat and links[joint - 2].axes in {"parallel", "coincident"}
            last, placement = masses[-1], robot.model.jointPlacements[joint]
            place, axis = placement.act(np.array(near.point)), placement.rotation @ robot.axis_in_joint_frame(joint)
            apart = place - np.array(last.point)
            if flat:  # between parallel axes the height does not matter
                apart -= (apart @ axis) * axis
            total = last.mass + near.mass
            if robot.revolute[joint - 1] and total and float(np.linalg.norm(apart)) <= ON_AXIS_M:
                mean = (last.mass * np.array(last.point) + near.mass * place) / total
                masses[-1], near = LumpedMass(total, joint - 1, _vector(mean)), near._replace(mass=0.0)
        masses += [near] if near.mass or joint == 1 else []
        masses += [LumpedMass(link.kappa2 * link.mass, joint, link.point2)]
    return tuple(mass for index, mass in enumerate(masses) if mass.mass or not index)


def _two_masses(link: LumpedLink) -> pin.Inertia:
    """Return the two point masses as one rigid body."""
    points = np.array([link.point1, link.point2])
    kappas = np.array([link.kappa1, link.kappa2])
    body = pin.Inertia.Zero()
    # Set attribute by attribute: the constructor rejects the negative moments of kappa < 0.
    body.mass = link.mass
    body.lever = kappas @ points
    body.inertia = sum(
        kappa * link.mass * _unit_inertia(point - body.lever) for kappa, point in zip(kappas, points, strict=True)
    )
    return body


def _distance(moment: float, kappa: float) -> float:
    """Return the distance [m] at which the share `kappa` of the mass has the first `moment` [m] of the whole."""
    if kappa != 0.0:
        return abs(moment / kappa)
    return math.inf if abs(moment) > ON_AXIS_M else 0.0


def _unit_inertia(r: FloatArray) -> FloatArray:
    """Return the inertia tensor (3, 3) of a unit mass at `r` (3,) about the origin."""
    return np.asarray((r @ r) * np.eye(3) - np.outer(r, r))


def _massless_joints(robot: Robot, model: pin.Model) -> tuple[int, ...]:
    """Return the joints (0-based) whose rows of the mass matrix vanish at every sample."""
    data = model.createData()
    row_max = np.zeros(model.nv)
    scale = 0.0
    for q in robot.sample_configurations():
        matrix = robot.mass_matrix(model, data, q)
        row_max = np.maximum(row_max, np.abs(matrix).max(axis=1))
        scale = max(scale, float(np.abs(matrix).max()))
    return tuple(int(joint) for joint in np.flatnonzero(row_max < 1e-12 * scale))


def _require_positive_definite(robot: Robot, model: pin.Model, links: tuple[LumpedLink, ...]) -> None:
    outside = [link.joint for link in links if not 0.0 <= link.kappa2 <= 1.0]
    cause = (
        f": the centre of mass lies outside the slab between the axes behind {', '.join(outside)}" if outside else ""
    )
    # A negative mass makes M(q) indefinite near stretched poses, which the samples may miss.
    for axis, mass in enumerate(_masses_by_axis(links)[1:], start=1):
        if mass < 0.0:
            raise IndefiniteError(f"the lumped mass on axis {axis + 1} is {mass:.3g} kg: must not be negative{cause}")
    lower, upper = model.lowerPositionLimit, model.upperPositionLimit
    # Joint 1 does not change the eigenvalues; the first six others turn to where axes align.
    aligned = [
        (0.0, *turns, *[0.0] * (model.nv - 1 - len(turns))) for turns in product(TURNS, repeat=min(model.nv - 1, 6))
    ]
    poses = np.concatenate([robot.sample_configurations(), np.clip(aligned, lower, upper)])
    data = model.createData()
    matrices = np.array([robot.mass_matrix(model, data, q) for q in poses])
    inertia = np.diagonal(matrices, axis1=1, axis2=2)
    lacking = inertia <= SINGULAR * inertia.max(axis=0)
    if lacking.any():
        pose, joint = np.argwhere(lacking)[0].tolist()
        where = f"{robot.joint_names[joint]} moves no lumped mass at q = {np.round(poses[pose], 3).tolist()}"
        raise IndefiniteError(f"the lumped mass matrix is singular: {where}{cause}")
    scale = np.sqrt(inertia)
    lowest = np.linalg.eigvalsh(matrices / (scale[:, :, None] * scale[:, None, :]))[:, 0]
    if (lowest < SINGULAR).any():
        q = np.round(poses[int(np.argmin(lowest))], 3).tolist()
        raise IndefiniteError(f"the lumped mass matrix is not positive definite at q = {q}{cause}")


def _masses_by_axis(links: tuple[LumpedLink, ...]) -> list[float]:
    """Return the masses [kg] on distinct axes, proximal first; those on coincident axes add up."""
    masses = [0.0]
    for link in links:
        masses[-1] += link.kappa1 * link.mass
        if np.linalg.norm(np.subtract(link.point2, link.point1)) > ON_AXIS_M:
            masses.append(0.0)
        masses[-1] += link.kappa2 * link.mass
    return masses


def _vector(point: ArrayLike) -> Vector3:
    x, y, z = np.asarray(point).tolist()
    return x, y, z
