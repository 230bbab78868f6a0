# SPDX-License-Identifier: Apache-2.0
"""Random serial arms, as URDF."""

from __future__ import annotations

import numpy as np

from scara_effmass.values import FloatArray

MIN_AXES, MAX_AXES = 3, 7
MAX_SPEED = 3.0
"""Speed limit of each joint [rad/s]."""
SERIES = 7
"""Keeps these random numbers apart from those of impacts."""
GRAVITY = 9.81


def random_arm(seed: int) -> str:
    """Return the URDF of arm number `seed`: 3 to 7 revolute axes along x, y or z, no two in a row the same.

    Links are boxes, 0.1 to 0.4 m long, and weigh 6 kg at the base to 1 kg at the tip, each times 0.5 to 2. Gravity
    cannot exceed the effort limits.
    """
    rng = np.random.default_rng((SERIES, seed))
    axes = int(rng.integers(MIN_AXES, MAX_AXES + 1))
    lengths = rng.uniform(0.1, 0.4, axes + 1)
    masses = np.linspace(6.0, 1.0, axes) * rng.uniform(0.5, 2.0, axes)
    spans = [np.array([0.0, 0.0, lengths[0]])]
    for length in lengths[1:]:
        direction = rng.normal(size=3)
        spans.append(direction * (length / np.linalg.norm(direction)))
    text, axis, parent = '<robot name="random_arm">\n  <link name="base"/>\n', 2, "base"
    for i in range(axes):
        span, thickness = spans[i + 1], float(rng.uniform(0.04, 0.1))
        size = np.abs(span) + thickness
        squares = np.square(size)
        ixx, iyy, izz = (masses[i] / 12.0 * (squares.sum() - squares)).tolist()
        link, com = f"link{i + 1}", _xyz(0.5 * span)
        effort = GRAVITY * float(masses[i:].sum() * lengths[i + 1 :].sum())
        text += f"""  <link name="{link}"><inertial>
    <origin xyz="{com}"/><mass value="{masses[i]:.6f}"/>
    <inertia ixx="{ixx:.6f}" iyy="{iyy:.6f}" izz="{izz:.6f}" ixy="0" ixz="0" iyz="0"/>
  </inertial><collision><origin xyz="{com}"/><geometry><box size="{_xyz(size)}"/></geometry></collision></link>
  <joint name="joint{i + 1}" type="revolute">
    <parent link="{parent}"/><child link="{link}"/><origin xyz="{_xyz(spans[i])}"/><axis xyz="{_xyz(np.eye(3)[axis])}"/>
    <limit lower="-2.9" upper="2.9" velocity="{MAX_SPEED}" effort="{effort:.3f}"/>
    <dynamics armature="{rng.uniform(0.0, 0.1):.4f}"/>
  </joint>
"""
        axis, parent = (axis + int(rng.integers(1, 3))) % 3, link
    return f"""{text}  <link name="tip"/>
  <joint name="tip_joint" type="fixed">
    <parent link="{parent}"/><child link="tip"/><origin xyz="{_xyz(spans[-1])}"/>
  </joint>
</robot>
"""


def _xyz(vector: FloatArray) -> str:
    return " ".join(f"{number:.6f}" for number in vector)
