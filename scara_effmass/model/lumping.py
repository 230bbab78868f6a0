"""Lumped ("simplified") model: two point masses per link, on the axes of its two joints, with its mass and CoM.

For link i with unit axes u_a (proximal) and u_b (distal), and feet f_a and f_b of their common normal:

    kappa1 (f_a + L1 u_a) + kappa2 (f_b + L2 u_b) = CoM,    kappa1 + kappa2 = 1

Masses of neighbouring links on the same axis add up, so n joints leave n + 1 masses (Table II of the paper, cited in
`scara_effmass.model`). Supported: parallel and coincident axes, and prismatic axes, of which only the direction counts.
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from scara_effmass.errors import RobotError
from scara_effmass.model.robot import PARALLEL, Robot
from scara_effmass.values import FloatArray, Vector3

ON_AXIS_M = 1e-4
"""Distance [m] below which axes coincide, or a centre of mass lies in their plane: finer than CAD data."""


@dataclass(frozen=True, slots=True)
class LumpedLink:
    """One link as two point masses `kappa1 * mass` and `kappa2 * mass` at `point1` and `point2` in its joint frame [m].

    `height1` and `height2` are L1 and L2 [m]. `on_axes` is False if a prismatic axis was shifted through the CoM.
    """

    joint: str
    mass: float
    kappa1: float
    kappa2: float
    height1: float
    height2: float
    point1: Vector3
    point2: Vector3
    on_axes: bool


@dataclass(frozen=True, slots=True)
class LumpedModel:
    """Lumped links of a robot and their Pinocchio model, whose mass matrix is Eq. 14.

    `aggregated` are the n + 1 masses [kg] by axis, proximal first; the first does not move. `massless_joints` are the
    joints (0-based) that move no lumped mass: `model` gives them an armature of 1 to keep its mass matrix regular.
    The mass along a direction in which such a joint does not move the contact point is unaffected.
    """

    links: tuple[LumpedLink, ...]
    aggregated: tuple[float, ...]
    model: pin.Model
    massless_joints: tuple[int, ...]

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


def is_scara(robot: Robot) -> bool:
    """Return whether the robot is a chain R-R-P-R with parallel axes, of which the last two coincide."""
    if robot.revolute != (True, True, False, True):
        return False
    axes = [_distal_axis(robot, joint) for joint in range(1, 5)]
    parallel = all(
        np.linalg.norm(np.cross(robot.axis_in_joint_frame(joint), axes[joint - 1][1])) < PARALLEL
        for joint in range(1, 5)
    )
    point, axis = axes[2]
    return parallel and float(np.linalg.norm(point - (point @ axis) * axis)) < ON_AXIS_M


def lump(robot: Robot) -> LumpedModel:
    """Return the lumped model of `robot`. Raises RobotError, naming the link, if there is none."""
    if robot.masses_reason or robot.coms_reason:
        raise RobotError(robot.masses_reason or robot.coms_reason)
    source = robot.model
    if list(source.parents)[1:] != list(range(source.njoints - 1)):
        raise RobotError("the joints must form a single chain")
    links = tuple(_lumped_link(robot, joint) for joint in range(1, source.njoints))
    model = source.copy()
    for joint, link in enumerate(links, start=1):
        model.inertias[joint] = _two_masses(link)
    massless_joints = _massless_joints(robot, model)
    armature = source.armature.copy()
    armature[list(massless_joints)] = 1.0
    model.armature = armature
    _require_positive_definite(robot, model, links)
    masses = [0.0] * source.njoints
    for index, link in enumerate(links):
        masses[index] += link.kappa1 * link.mass
        masses[index + 1] += link.kappa2 * link.mass
    return LumpedModel(links=links, aggregated=tuple(masses), model=model, massless_joints=massless_joints)


def _distal_axis(robot: Robot, joint: int) -> tuple[FloatArray, FloatArray]:
    """Return a point and the unit direction of the axis after `joint`, in the frame of `joint`."""
    if joint == robot.model.njoints - 1:
        return robot.tip.translation.copy(), robot.axis_in_joint_frame(joint)
    placement = robot.model.jointPlacements[joint + 1]
    return placement.translation.copy(), placement.rotation @ robot.axis_in_joint_frame(joint + 1)


def _lumped_link(robot: Robot, joint: int) -> LumpedLink:
    name = robot.joint_names[joint - 1]
    body = robot.model.inertias[joint]
    axis = robot.axis_in_joint_frame(joint)
    point, distal = _distal_axis(robot, joint)
    if float(np.linalg.norm(np.cross(axis, distal))) > PARALLEL:
        raise RobotError(f"link behind {name}: its axes are not parallel, which the lumped model does not support")
    height = float(body.lever @ axis)
    across = body.lever - height * axis
    normal = point - (point @ axis) * axis
    length = float(np.linalg.norm(normal))
    if length < ON_AXIS_M:
        kappa2, distance = 0.5, float(np.linalg.norm(across))  # coincident axes: any kappa is exact
    else:
        kappa2 = float(across @ normal) / length**2
        distance = float(np.linalg.norm(across - kappa2 * normal))
    revolute = (*robot.revolute, True)
    foot1, foot2 = np.zeros(3), normal
    on_axes = distance <= ON_AXIS_M or body.mass == 0.0
    if not on_axes:
        # Only the direction of a prismatic axis counts: shift it through the centre of mass.
        if not revolute[joint - 1]:
            kappa2, foot1, foot2 = 0.0, across, across
        elif not revolute[joint]:
            kappa2, foot2 = 1.0, across
        else:
            raise RobotError(
                f"link behind {name}: its centre of mass lies {distance * 1e3:.1f} mm off the plane of its two axes, "
                "so two masses on the axes cannot reproduce it"
            )
    return LumpedLink(
        joint=name,
        mass=float(body.mass),
        kappa1=1.0 - kappa2,
        kappa2=kappa2,
        height1=height,
        height2=height * float(np.sign(axis @ distal)),
        point1=_vector(foot1 + height * axis),
        point2=_vector(foot2 + height * axis),
        on_axes=on_axes,
    )


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
            raise RobotError(f"the lumped mass on axis {axis + 1} is {mass:.3g} kg: must not be negative{cause}")
    data = model.createData()
    for q in robot.sample_configurations():
        matrix = robot.mass_matrix(model, data, q)
        scale = np.sqrt(np.diag(matrix).clip(min=0.0))
        if np.any(scale == 0.0) or np.linalg.eigvalsh(matrix / np.outer(scale, scale))[0] < 1e-9:
            raise RobotError(f"the lumped mass matrix is not positive definite at q = {np.round(q, 3).tolist()}{cause}")


def _masses_by_axis(links: tuple[LumpedLink, ...]) -> list[float]:
    """Return the masses [kg] on distinct axes, proximal first; those on coincident axes add up."""
    masses = [0.0]
    for link in links:
        masses[-1] += link.kappa1 * link.mass
        if np.linalg.norm(np.subtract(link.point2, link.point1)) > ON_AXIS_M:
            masses.append(0.0)
        masses[-1] += link.kappa2 * link.mass
    return masses


def _vector(point: FloatArray) -> Vector3:
    x, y, z = point.tolist()
    return x, y, z
