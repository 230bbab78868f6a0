# SPDX-License-Identifier: Apache-2.0
"""Last joints that move a light end, such as a jaw, count as locked in the mass matrix: free ones would decide.

The end is light beside the arm, the other joints move its contact point in all directions, and free it is much lighter
than locked. At other contact points these joints count as they are: a tool may end beside the axis of a wrist.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from scara_effmass.model.robot import Robot

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
    model, frame = robot.model.copy(), robot.contact_frames[point]
    last = model.frames[frame].parentJoint
    if robot.inertias_reason or last in set(model.parents):
        return robot
    held = list[int]()
    for joints, mass in _light_ends(robot, last):
        free, locked = _typical_masses(robot, frame, held, joints)
        if locked >= MIN_RATIO * free and (not held or free <= mass):  # more of the arm moves with a wrist
            held = joints
    if not held:
        return robot
    free, locked = _typical_masses(robot, frame, [], held)
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


def _typical_masses(robot: Robot, frame: int, held: Sequence[int], joints: Sequence[int]) -> tuple[float, float]:
    """Return the median mass [kg] of the lightest direction with the joints `held` locked, and with `joints` locked.

    The second one is 0 if one of `joints` is needed there.
    """
    model, data = robot.model, robot.model.createData()
    some, others = ([i for i in range(model.nv) if i + 1 not in locked] for locked in (held, joints))
    poses = robot.sample_configurations()
    jacobians = np.array([pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)[:3] for q in poses])
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
