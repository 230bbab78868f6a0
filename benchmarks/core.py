# SPDX-License-Identifier: Apache-2.0
"""(a) One cycle of the core against the direct computation of one effective mass with Pinocchio and numpy."""

from __future__ import annotations

import gc
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings
from scara_effmass.values import FloatArray, JointState, Verdict

if TYPE_CHECKING:
    from collections.abc import Callable

    from scara_effmass.model.robot import Robot

CYCLES_PER_BLOCK = 500
BLOCKS = 60
CONTACTS = {1: 1.0, 4: 1.5, 16: 3.0, 64: 10.0, 0: 2.0}
"""Numbers of contact points, 0 for the whole arm, and the largest time of a cycle with them over that with one."""


def new_monitor(robot: Robot, settings: MonitorSettings) -> Monitor:
    """Return a monitor as the node has it when it is configured."""
    monitor = Monitor(RobotDynamics(robot), settings)
    monitor.compile()
    return monitor


def kind() -> str:
    """Return what computes in a cycle."""
    settings = MonitorSettings()
    return new_monitor(load_robot(settings=settings), settings).core


def measure() -> tuple[float, float]:
    """Return the median CPU time per cycle [us] of the core and of the direct computation, timed in turn."""
    settings = MonitorSettings(contact_points=("tool",))
    return _beside_pinocchio(load_robot(settings=settings), settings, smooth_motion())


def measure_chain(joints: int, points: int = 1) -> tuple[float, float]:
    """Return the same of a chain of `joints` revolute joints whose axes turn by a right angle, with contact points."""
    points_at = tuple(f"point{i}=link{joints}: {0.1 + 0.01 * i} 0.02 0" for i in range(points))
    settings = MonitorSettings(contact_points=points_at)
    rows = [
        f"  - {{name: joint{i + 1}, type: revolute, a: 0.2, alpha: {(-1) ** i * np.pi / 2}, d: 0.1, theta: 0.0, "
        "lower: -3, upper: 3, max_speed: 3}\n"
        for i in range(joints)
    ]
    links = [
        f"  - {{name: link{i + 1}, mass: 1.0, com: [0.1, 0.0, 0.02], inertia: [0.01, 0.01, 0.01, 0, 0, 0]}}\n"
        for i in range(joints)
    ]
    with TemporaryDirectory() as folder:
        path = Path(folder, "chain.yaml")
        head = "robot: chain\nbase_frame: base\ncontact_points: {tip: [0, 0, 0]}\n"
        path.write_text(f"{head}joints:\n{''.join(rows)}links:\n{''.join(links)}", encoding="utf-8")
        robot = load_robot(path, settings)
    phases = np.outer(np.arange(CYCLES_PER_BLOCK * BLOCKS) / 1000.0, np.linspace(0.2, 0.5, joints))
    states = _joint_states(
        robot.joint_names, 0.5 + 0.3 * np.sin(phases), 0.3 * np.linspace(0.2, 0.5, joints) * np.cos(phases)
    )
    return _beside_pinocchio(robot, settings, states)


def _beside_pinocchio(robot: Robot, settings: MonitorSettings, states: list[JointState]) -> tuple[float, float]:
    monitor = new_monitor(robot, settings)
    data = robot.model.createData()

    def direct(state: JointState) -> list[float]:
        """Return m_n of the full model along each point's velocity from CRBA and the Jacobian, Eqs. 3-8."""
        mass_matrix, masses = pin.crba(robot.model, data, state.position), []
        for frame in robot.contact_frames.values():
            jacobian = pin.computeFrameJacobian(
                robot.model, data, state.position, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
            )[:3]
            velocity = jacobian @ state.velocity
            n = velocity / np.linalg.norm(velocity)
            masses.append(float(1.0 / (n @ jacobian @ np.linalg.solve(mass_matrix, jacobian.T) @ n)))
        return masses

    def core(state: JointState) -> object:
        return monitor.assess_one(state, state.stamp_ns)

    # As the node does after start-up: keep the garbage collector away from the prepared states.
    gc.collect()
    gc.freeze()
    ours, theirs = [], []
    for block in range(BLOCKS):
        chunk = states[block * CYCLES_PER_BLOCK : (block + 1) * CYCLES_PER_BLOCK]
        ours.append(_time(core, chunk))
        theirs.append(_time(direct, chunk))
    if monitor.verdicts[Verdict.UNKNOWN]:
        raise RuntimeError(f"the motion must be valid, but the monitor says {monitor.first_cause}")
    return float(np.median(ours)), float(np.median(theirs))


def measure_contact_points() -> dict[int, float]:
    """Return the median CPU time per cycle [us] by the number of contact points, timed in turn."""
    states, monitors = smooth_motion(), {}
    for count in CONTACTS:
        points = "tool", *(f"p{i}=link2: {0.2 * i / count} 0 0" for i in range(1, count))
        settings = MonitorSettings(contact_points=points if count else ())
        monitors[count] = new_monitor(load_robot(settings=settings), settings)
    times: dict[int, list[float]] = {count: [] for count in CONTACTS}
    for block in range(BLOCKS):
        chunk = states[block * CYCLES_PER_BLOCK : (block + 1) * CYCLES_PER_BLOCK]
        for count, monitor in monitors.items():
            times[count].append(_time(lambda state, own=monitor: own.assess_one(state, state.stamp_ns), chunk))
    return {count: float(np.median(own)) for count, own in times.items()}


def measure_effort() -> tuple[float, float]:
    """Return the mean CPU time per cycle [us] with and without effort, from which the load is estimated, in turn."""
    settings = MonitorSettings(contact_points=("tool",))
    robot = load_robot(settings=settings)
    data, states = robot.model.createData(), smooth_motion()
    torques = [pin.rnea(robot.model, data, one.position, one.velocity, np.zeros(4)) for one in states]
    times: list[list[float]] = [[], []]
    monitors = [new_monitor(robot, settings) for _ in times]
    for start in range(0, len(states), CYCLES_PER_BLOCK):
        part = slice(start, start + CYCLES_PER_BLOCK)
        with_effort = [one._replace(effort=effort) for one, effort in zip(states[part], torques[part], strict=True)]
        for monitor, own, chunk in zip(monitors, times, (with_effort, states[part]), strict=True):
            own.append(_time(lambda state, own=monitor: own.assess_one(state, state.stamp_ns), chunk))
    return float(np.mean(times[0])), float(np.mean(times[1]))


def _time(function: Callable[[JointState], object], states: list[JointState]) -> float:
    started = time.thread_time()  # other programs do not count
    for state in states:
        function(state)
    return (time.thread_time() - started) / len(states) * 1e6


def smooth_motion() -> list[JointState]:
    """Return 1 kHz joint states of a smooth motion at collaborative speeds.

    The tool moves at 0.15 m/s on average and every verdict is OK. Other verdicts also format a reason, which makes a
    cycle about a tenth longer.
    """
    amplitudes, offsets = np.array([1.5, 1.2, 0.05, 1.0]), np.array([0.0, 0.8, 0.2, 0.0])
    frequencies = np.array([0.28, 0.36, 0.52, 0.44])
    phases = np.outer(np.arange(CYCLES_PER_BLOCK * BLOCKS) / 1000.0, frequencies)
    names = ("joint1", "joint2", "joint3", "joint4")
    return _joint_states(names, offsets + amplitudes * np.sin(phases), amplitudes * frequencies * np.cos(phases))


def _joint_states(names: tuple[str, ...], positions: FloatArray, velocities: FloatArray) -> list[JointState]:
    first_ns = 1_000_000_000
    return [
        JointState(first_ns + i * 1_000_000, names, q, qd)
        for i, (q, qd) in enumerate(zip(positions, velocities, strict=True))
    ]
