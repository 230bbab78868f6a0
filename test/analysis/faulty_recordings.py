# SPDX-License-Identifier: Apache-2.0
"""Generated recordings of joint states with faults."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scara_effmass.bags.writer import BagWriter
from scara_effmass.reference import RobotDynamics
from scara_effmass.values import FloatArray, JointState
from scara_effmass.wire.joint_state import joint_state_message
from scara_effmass.wire.message_types import JOINT_STATE

MS, START_NS = 1_000_000, 10**12
Message = tuple[int, bytes]
"""Log time [ns] and serialized joint state."""


def motion(dynamics: RobotDynamics, count: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return positions and velocities (count, n) at 250 Hz of a smooth motion with a rest, within the limits."""
    model, rng = dynamics.robot.model, np.random.default_rng(seed)
    lower, upper = np.clip(model.lowerPositionLimit, -2.0, 2.0), np.clip(model.upperPositionLimit, -2.0, 2.0)
    rates = rng.uniform(0.5, 3.0, model.nv)
    speeds = np.where(model.velocityLimit > 0.0, np.minimum(model.velocityLimit, 3.0), 3.0)
    sizes = np.minimum(rng.uniform(0.1, 0.45, model.nv) * (upper - lower), 0.9 * speeds / rates)
    phases = np.outer(np.arange(count) * 0.004, rates)
    positions, velocities = 0.5 * (lower + upper) + sizes * np.sin(phases), sizes * rates * np.cos(phases)
    rest = slice(count // 2, count // 2 + count // 8)
    positions[rest], velocities[rest] = positions[rest.start], 0.0
    return positions, velocities


def messages(  # noqa: C901, PLR0912, PLR0915 - a case per fault
    dynamics: RobotDynamics, count: int, seed: int, faults: list[tuple[str, int]]
) -> list[Message]:
    """Return a recording with each fault of FAULTS at its place."""
    positions, velocities = motion(dynamics, count, seed)
    names, rng = dynamics.robot.joint_names, np.random.default_rng(seed)
    stamps = START_NS + 4 * MS * np.arange(count)
    logs = stamps + rng.integers(0, 2 * MS, count)
    raw: list[bytes | None] = [None] * count
    label = [names] * count
    keep = np.ones(count, bool)
    joint = seed % len(names)
    for fault, place in faults:
        at = place % count
        later = slice(at, at + 20)
        match fault:
            case "drop":
                keep[at : at + 60 * (1 + seed % 3)] = False
            case "nan":
                (positions if seed % 2 else velocities)[at, joint] = np.nan
            case "stamp":
                stamps[at] += [-5 * MS, -4 * MS, 10**9, -START_NS, -(10**9)][seed % 5]
            case "clock back":
                stamps[at:] -= 10**10
                logs[at:] -= 10**10
            case "jump":
                positions[at:, joint] += 0.3
            case "sign":
                velocities[later] *= -1.0
            case "lag":
                velocities[10:] = velocities[:-10].copy()
            case "limit":
                positions[at, joint] = 1e3
            case "fast":
                velocities[at, joint] = 1e3
            case "other":
                label[at] = tuple(f"other{i}" for i in range(len(names)))
            case "no names":
                label[at] = ()
            case "missing":
                label[at] = ("other", *names[1:])
            case "extra":
                label[at:] = [(*names, "gripper")] * (count - at)
            case "order":
                label[at:] = [names[::-1]] * (count - at)
            case "undecodable":
                raw[at] = b"\0\1\0\0"
    result = []
    for row in np.flatnonzero(keep).tolist():
        own, q, qd = label[row], positions[row], velocities[row]
        if len(own) > len(names):
            q, qd = np.append(q, 0.1), np.append(qd, 0.0)
        elif own == names[::-1]:
            q, qd = q[::-1], qd[::-1]
        state = JointState(max(int(stamps[row]), 0), own, q, qd)
        result.append((int(logs[row]), raw[row] or joint_state_message(state)))
    return result


FAULTS = ["drop", "nan", "stamp", "clock back", "jump", "sign", "lag", "limit", "fast", "other", "no names", "missing"]
FAULTS += ["extra", "order", "undecodable"]


def write(path: Path, recorded: list[Message]) -> Path:
    """Write messages in the order in which they are given: their log times may go back."""
    with BagWriter(path) as writer:
        for log_time_ns, data in recorded:
            writer.write("/joint_states", JOINT_STATE, log_time_ns, data)
    return path
