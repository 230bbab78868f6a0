"""(a) One cycle of the core against the direct computation of one effective mass with Pinocchio and numpy."""

from __future__ import annotations

import gc
import time
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from scara_effmass.model.dynamics import RobotDynamics
from scara_effmass.model.load import load_robot
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share
from scara_effmass.values import JointState

if TYPE_CHECKING:
    from collections.abc import Callable

CYCLES_PER_BLOCK = 500
BLOCKS = 60


def measure() -> tuple[float, float]:
    """Return the median time per cycle [us] of the core and of the direct computation, timed in turn."""
    settings = MonitorSettings(contact_points=("tool",))
    robot = load_robot(share("config", "omron_i4_550l.yaml"), settings)
    monitor = Monitor(RobotDynamics(robot), settings)
    states = smooth_motion()
    frame = robot.contact_frames["tool"]
    data = robot.model.createData()

    def direct(state: JointState) -> float:
        """Return m_n of the full model along the velocity from CRBA and the Jacobian, Eqs. 3-8."""
        mass_matrix = pin.crba(robot.model, data, state.position)
        jacobian = pin.computeFrameJacobian(
            robot.model, data, state.position, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )[:3]
        velocity = jacobian @ state.velocity
        n = velocity / np.linalg.norm(velocity)
        return float(1.0 / (n @ jacobian @ np.linalg.solve(mass_matrix, jacobian.T) @ n))

    def core(state: JointState) -> object:
        return monitor.assess(state, state.stamp_ns)

    # As the node does after start-up: keep the garbage collector away from the prepared states.
    gc.collect()
    gc.freeze()
    ours, theirs = [], []
    for block in range(BLOCKS):
        chunk = states[block * CYCLES_PER_BLOCK : (block + 1) * CYCLES_PER_BLOCK]
        ours.append(_time(core, chunk))
        theirs.append(_time(direct, chunk))
    return float(np.median(ours)), float(np.median(theirs))


def measure_contact_points() -> tuple[float, float]:
    """Return the median time per cycle [us] with four contact points and with one, timed in turn."""
    states, times = smooth_motion(), []
    monitors = []
    for points in ("tool", "elbow", "rim=link4: 0.05 0 0", "fore=link2: 0.1 0 0"), ("tool",):
        settings = MonitorSettings(contact_points=points)
        monitors.append(Monitor(RobotDynamics(load_robot(settings=settings)), settings))
    for block in range(BLOCKS):
        chunk = states[block * CYCLES_PER_BLOCK : (block + 1) * CYCLES_PER_BLOCK]
        times.append(
            [_time(lambda state, monitor=monitor: monitor.assess(state, state.stamp_ns), chunk) for monitor in monitors]
        )
    four, one = np.median(times, axis=0).tolist()
    return four, one


def _time(function: Callable[[JointState], object], states: list[JointState]) -> float:
    started = time.perf_counter()
    for state in states:
        function(state)
    return (time.perf_counter() - started) / len(states) * 1e6


def smooth_motion() -> list[JointState]:
    """Return 1 kHz joint states of a smooth motion at collaborative speeds.

    The tool moves at 0.15 m/s on average and every verdict is OK. Other verdicts also format a reason, which makes a
    cycle about a tenth longer.
    """
    names = ("joint1", "joint2", "joint3", "joint4")
    amplitudes, offsets = np.array([1.5, 1.2, 0.05, 1.0]), np.array([0.0, 0.8, 0.2, 0.0])
    frequencies = np.array([0.28, 0.36, 0.52, 0.44])
    phases = np.outer(np.arange(CYCLES_PER_BLOCK * BLOCKS) / 1000.0, frequencies)
    positions = offsets + amplitudes * np.sin(phases)
    velocities = amplitudes * frequencies * np.cos(phases)
    first_ns = 1_000_000_000
    return [
        JointState(first_ns + i * 1_000_000, names, q, qd)
        for i, (q, qd) in enumerate(zip(positions, velocities, strict=True))
    ]
