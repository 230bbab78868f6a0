# SPDX-License-Identifier: Apache-2.0
"""Last joints that move a light end, such as a jaw, count as locked in the mass matrix: free ones would decide.

The end is light beside the arm, the other joints move its contact point in all directions, and free it is much lighter
than locked. Of a jaw, whose link often has no frame but that of its joint, the farthest place counts. At other contact
points these joints count as they are: a tool may end beside the axis of a wrist.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from scara_effmass.model.robot import Robot
from scara_effmass.model.urdf import FINGER_RAD
from scara_effmass.values import FloatArray

LIGHT_SHARE = 0.1
"""Share of the moving mass, without the heaviest body, below which an end is light."""
MIN_RATIO = 2.0
"""Ratio of the masses, locked over free, from which on the free joint would decide."""
MIN_MOBILITY = 0.05
"""Smallest singular value, over the largest one, from which on the other joints move a point in all directions."""
LOCKING = 10.0
"""Rotor inertia of a locked joint over the largest one that the mass matrix has: 1 % of the mobility remains."""


def hold_light_end(robot: Robot, point: str) -> Robot:
    """Return `robot` with a rotor inertia that locks the joints of a light end, and a note; itself if it has none.

    `point` is the contact point at the end of the longest chain.
    """
    model = robot.model.copy()
    last = model.frames[robot.contact_frames[point]].parentJoint
    if robot.inertias_reason or last in set(model.parents):
        return robot
    end, held = _end(robot, point, last), list[int]()
    for joints, mass in _light_ends(robot, last):
        free, locked = _typical_masses(robot, last, end, held, joints)
        if locked >= MIN_RATIO * free and (not held or free <= mass):  # more of the arm moves with a wrist
            held = joints
    if not held:
        return robot
    free, locked = _typical_masses(robot, last, end, [], held)
    matrix, data = robot.rotors.matrix.copy(), model.createData()
    largest = max(float(np.diag(robot.mass_matrix(model, data, q)).max()) for q in robot.sample_configurations())
    columns = np.array(held) - 1
    matrix[columns, columns] += LOCKING * max(largest, robot.moving_mass)
    model.armature = np.diag(matrix)
    note = (
        f"counts as locked in the masses, not in the motion: {', '.join(model.names[joint] for joint in held)}: free, "
        f"{point} would be light, typically {free:.3g} in place of {locked:.3g} kg"
    )
    return replace(robot, model=model, rotors=replace(robot.rotors, matrix=matrix), notes=(*robot.notes, note))


def _end(robot: Robot, point: str, last: int) -> FloatArray:
    """Return the place (3,) [m], in the frame of the joint `last`, at which the end counts.

    That is the contact point `point`, or of a joint that turns no farther than a finger the vertex of a hull that is
    farthest from its axis.
    """
    places = [np.array([robot.model.frames[robot.contact_frames[point]].placement.translation])]
    width = robot.model.upperPositionLimit[last - 1] - robot.model.lowerPositionLimit[last - 1]
    if robot.revolute[last - 1] and width <= FINGER_RAD:
        frames = robot.model.frames
        places += [hull for name, hull in robot.hulls.items() if frames[robot.contact_frames[name]].parentJoint == last]
    candidates = np.vstack(places)
    distances = np.linalg.norm(np.cross(robot.axis_in_joint_frame(last), candidates), axis=1)
    return np.asarray(candidates[int(np.argmax(distances))])


def _light_ends(robot: Robot, last: int) -> Iterator[tuple[list[int], float]]:
    """Yield joints and mass [kg] of each light end of the chain to the joint `last`, the shortest end first."""
    model, joints = robot.model, list[int]()
    arm_mass = robot.moving_mass - max(float(body.mass) for body in model.inertias)
    while last:
        mass = sum(float(model.inertias[int(body)].mass) for body in model.subtrees[last])
        if mass >= LIGHT_SHARE * arm_mass:
            return
        joints = [last, *joints]
        yield joints, mass
        last = model.parents[last]


def _typical_masses(
    robot: Robot, last: int, end: FloatArray, held: Sequence[int], joints: Sequence[int]
) -> tuple[float, float]:
    """Return the median mass [kg] of the lightest direction with the joints `held` locked, and with `joints` locked.

    It is that at `end` (3,) [m] in the frame of the joint `last`. The second one is 0 if one of `joints` is needed
    there.
    """
    model, data = robot.model, robot.model.createData()
    some, others = ([i for i in range(model.nv) if i + 1 not in locked] for locked in (held, joints))
    poses = robot.sample_configurations()
    motions = np.array([pin.computeJointJacobian(model, data, q, last) for q in poses])
    jacobians = motions[:, :3] - pin.skew(end) @ motions[:, 3:]
    matrices = np.array([robot.mass_matrix(model, data, q) for q in poses])
    singular = np.linalg.svd(jacobians[:, :, others], compute_uv=False)
    if singular.shape[1] < 3:
        return 1.0, 0.0
    suffice = singular[:, 2] >= MIN_MOBILITY * singular[:, 0]
    masses = np.tile((1.0, 0.0), (len(poses), 1))
    for kind, columns in enumerate((some, others)):
        part = jacobians[suffice][:, :, columns]
        inertia = matrices[suffice][:, columns][:, :, columns]
        mobility = part @ np.linalg.solve(inertia, part.swapaxes(1, 2))
        masses[suffice, kind] = 1.0 / np.linalg.eigvalsh(mobility)[:, -1]
    free, locked = np.median(masses, axis=0).tolist()
    return free, locked
