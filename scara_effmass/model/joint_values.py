# SPDX-License-Identifier: Apache-2.0
"""Numbers that settings state per joint; largest accelerations also by a joint limits file as MoveIt writes it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from scara_effmass.errors import RobotError
from scara_effmass.input_files import read_yaml
from scara_effmass.values import FloatArray

_VALUE = 'must be "joint=value" with a value of at least 0'
_RULE = 'must be "joint=value" with a value of at least 0 rad/s2 or m/s2, or a joint limits file'


def max_joint_accelerations(entries: Sequence[str], joints: Sequence[str]) -> FloatArray | None:
    """Return the largest acceleration (n,) [rad/s2, m/s2] of each of the `joints`, None without `entries`.

    An entry is "joint=value", which wins, or a file with `joint_limits`, `has_acceleration_limits` and
    `max_acceleration` of each joint; scaling factors of the file do not count. Raises RobotError for a wrong entry, and
    for a joint that none states.
    """
    if not entries:
        return None
    stated: dict[str, float] = {}
    for entry in (entry for entry in entries if "=" not in entry):
        stated |= {name: value for name, value in _of_file(Path(entry)).items() if name in joints}
    stated |= _joint_values([entry for entry in entries if "=" in entry], joints, "max_joint_acceleration", _RULE)
    if missing := [name for name in joints if name not in stated]:
        raise RobotError(f"max_joint_acceleration: must be stated for every joint: it is missing for {missing[0]}")
    return np.array([stated[name] for name in joints])


def torque_constants(entries: Sequence[str], joints: Sequence[str], of_file: FloatArray) -> FloatArray:
    """Return the torque (n,) per unit of effort of each of the `joints`: of `entries` "joint=value", or `of_file`.

    Raises RobotError for a wrong entry.
    """
    stated = _joint_values(entries, joints, "torque_constants", _VALUE)
    return np.array([stated.get(name, constant) for name, constant in zip(joints, of_file, strict=True)])


def _joint_values(entries: Sequence[str], joints: Sequence[str], setting: str, rule: str) -> dict[str, float]:
    """Return the number of each joint that `entries` "joint=value" state. Raises RobotError for a wrong one."""
    stated: dict[str, float] = {}
    for entry in entries:
        name, _, text = (part.strip() for part in entry.partition("="))
        if name not in joints or name in stated:
            problem = f"must be one of {', '.join(joints)}" if name not in joints else "must be stated once"
            raise RobotError(f"{setting} = {entry!r}: joint {problem}")
        stated[name] = _number(text, f"{setting} = {entry!r}", rule)
    return stated


def _of_file(path: Path) -> dict[str, float]:
    """Return the accelerations that a joint limits file states."""
    content = read_yaml(path, RobotError)
    limits = content.get("joint_limits") if isinstance(content, dict) else None
    if not isinstance(limits, dict):
        raise RobotError(f"{path}: joint_limits: must be a mapping of joints, as in MoveIt's joint_limits.yaml")
    accelerations = {}
    for name, limit in limits.items():
        if isinstance(limit, dict) and limit.get("has_acceleration_limits"):
            where = f"{path}: joint_limits: {name}: max_acceleration = {limit.get('max_acceleration')!r}"
            accelerations[str(name)] = _number(limit.get("max_acceleration"), where, _RULE)
    return accelerations


def _number(value: object, where: str, rule: str) -> float:
    try:
        number = float(value) if isinstance(value, (str, int, float)) and not isinstance(value, bool) else math.nan
    except ValueError:
        number = math.nan
    if not 0.0 <= number < math.inf:
        raise RobotError(f"{where}: {rule}")
    return number
