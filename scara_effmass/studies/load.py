# SPDX-License-Identifier: Apache-2.0
"""How well the torques of a simulated robot show its load: coverage of the interval, time to find it, false alarms.

    python -m scara_effmass.studies.load [--runs 500] [--seed 1]

Joint states are simulated, at 100 Hz: point-to-point motion with pauses, torques by Pinocchio, friction of each joint
(Coulomb 1 to 4 %, viscous up to 2 % of its effort limit), errors of 1 to 4 % of each torque constant, noise of 0.5 %
and steps of 0.1 % of the effort limit, errors of 1 mrad/s of the velocities. The estimate knows the standard deviation
of the torque constants, 2.6 %. The shipped SCARA states no effort limits:
here they are 60, 30, 100 (N) and 5.
"""

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from scara_effmass.identification.payload import PayloadEstimator
from scara_effmass.kernel.intervals import Intervals
from scara_effmass.kernel.records import IntArray
from scara_effmass.model.load import load_robot
from scara_effmass.model.robot import Robot
from scara_effmass.safety.load_watch import ALARM
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share
from scara_effmass.studies import arguments_of
from scara_effmass.values import FloatArray

RATE_HZ = 100
SCARA_EFFORTS = (60.0, 30.0, 100.0, 5.0)
"""Effort limits of the i4-550L in the simulation [N m, N], which its file does not state."""
MAX_ACCELERATION = 20.0
"""Largest acceleration of a joint [rad/s2; a quarter of it in m/s2]."""
CONSTANT_ERRORS = (0.01, 0.04)
"""Least and largest relative error of a torque constant, of either sign."""
EFFORT_UNCERTAINTY = float(np.sqrt(np.mean(np.linspace(*CONSTANT_ERRORS, 10_001) ** 2)))
"""Standard deviation of these errors: what the estimate is told as `effort_uncertainty`."""
PAUSE_S = 0.3
RANGE_RAD = 2.0
"""Largest joint angle; a prismatic joint moves over its whole range."""


class Case(NamedTuple):
    """A robot with a `load` [kg] at 3 cm (standard deviation) from its tip.

    `stribeck` is the share by which Coulomb friction is larger at rest than above 0.1 rad/s, `masses` by how much
    each link is lighter or heavier than in the file; `assumed` is `link_uncertainty`.
    """

    name: str
    robot: str
    load: float
    stribeck: float = 0.0
    masses: float = 0.0
    assumed: float = 0.0


_RIGHT = (
    Case("i4-550L", "", 0.5),
    Case("UR10", "ur10_robot.urdf", 1.0),
    Case("Panda", "panda.urdf", 0.5),
)
_WRONG = tuple(case._replace(name=f"{case.name}, links 5 % lighter or heavier", masses=0.05) for case in _RIGHT)
CASES = (
    *_RIGHT,
    *_WRONG,
    *(case._replace(name=f"{case.name}, `link_uncertainty` 0.05", assumed=0.05) for case in _WRONG),
    _RIGHT[1]._replace(name="UR10, friction 50 % larger near rest", stribeck=0.5),
)


class States(NamedTuple):
    """Simulated joint states: stamps (N,) [ns], q, qd and effort (N, n)."""

    stamps: IntArray
    q: FloatArray
    qd: FloatArray
    effort: FloatArray


class Outcome(NamedTuple):
    """Error of the last estimate [kg], its standard deviation, and when the load was found [s], infinite if never.

    `unfit`: the torques do not fit the model at the end.
    """

    error: float
    deviation: float
    found_s: float
    unfit: bool


def robot_of(case: Case) -> Robot:
    """Return the robot of a case with effort limits."""
    path = share("config", "robots", case.robot) if case.robot else None
    robot = load_robot(path, MonitorSettings(contact_points=() if case.robot else ("tool",)))
    if not case.robot:
        robot.model.effortLimit = np.array(SCARA_EFFORTS)
    return robot


def simulated(robot: Robot, case: Case, load: float, seconds: float, rng: np.random.Generator) -> States:
    """Return joint states of `robot` with a `load` [kg], as the module describes them."""
    t = np.arange(0.0, seconds, 1.0 / RATE_HZ)
    q, qd, qdd = _motion(robot, len(t), rng)
    model, limits = robot.model.copy(), robot.effort_limits
    for joint in range(1, model.njoints):
        factor = 1.0 + rng.choice((-1.0, 1.0)) * case.masses
        stated = model.inertias[joint]
        model.inertias[joint] = pin.Inertia(factor * stated.mass, stated.lever, factor * stated.inertia)
    com = robot.tip.translation + rng.normal(0.0, 0.03, 3)
    if load:
        model.appendBodyToJoint(model.njoints - 1, pin.Inertia(load, com, 1e-3 * load * np.eye(3)), pin.SE3.Identity())
    data = model.createData()
    torque = np.array([pin.rnea(model, data, *row) for row in zip(q, qd, qdd, strict=True)])
    torque += qdd @ robot.rotors.coupling
    coulomb, viscous = (rng.uniform(low, high, len(limits)) * limits for low, high in ((0.01, 0.04), (0.0, 0.02)))
    held = rng.uniform(-1.0, 1.0, len(limits)) * coulomb
    moving = coulomb * np.sign(qd) * (1.0 + case.stribeck * (np.abs(qd) < 0.1)) + viscous * qd / _speeds(robot)
    torque += np.where(np.abs(qd) > 1e-3, moving, held)
    torque *= 1.0 + rng.uniform(*CONSTANT_ERRORS, len(limits)) * rng.choice((-1.0, 1.0), len(limits))
    torque += rng.normal(0.0, 0.005, torque.shape) * limits
    step = 1e-3 * limits
    stamps = 1_000_000_000 + np.round(1e9 * t).astype(np.int64)
    return States(stamps, q, qd + rng.normal(0.0, 1e-3, qd.shape) * _per_joint(robot), step * np.round(torque / step))


def _per_joint(robot: Robot) -> FloatArray:
    return np.where(robot.revolute, 1.0, 0.25)


def _speeds(robot: Robot) -> FloatArray:
    limits = np.asarray(robot.model.velocityLimit)
    return np.where((limits > 0.0) & (limits < np.inf), limits, _per_joint(robot))


def _motion(robot: Robot, count: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return q, qd and qdd (count, n) between random poses, of the fifth degree, at up to half the joint speeds."""
    model = robot.model
    lower, upper = np.maximum(model.lowerPositionLimit, -RANGE_RAD), np.minimum(model.upperPositionLimit, RANGE_RAD)
    q, qd, qdd = np.zeros((3, count, model.nv))
    row, pose, pause = 0, rng.uniform(lower, upper), round(PAUSE_S * RATE_HZ)
    while row < count:
        way = rng.uniform(lower, upper) - pose
        slow = 1.875 * np.abs(way) / (0.5 * _speeds(robot))
        gentle = np.sqrt(5.774 * np.abs(way) / (MAX_ACCELERATION * _per_joint(robot)))
        duration = max(float(slow.max()), float(gentle.max()), 0.3)
        s = np.arange(min(round(duration * RATE_HZ), count - row)) / (duration * RATE_HZ)
        rows = slice(row, row + len(s))
        q[rows] = pose + np.outer(10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5, way)
        qd[rows] = np.outer(30.0 * s**2 - 60.0 * s**3 + 30.0 * s**4, way) / duration
        qdd[rows] = np.outer(60.0 * s - 180.0 * s**2 + 120.0 * s**3, way) / duration**2
        pose, row = pose + way, rows.stop + pause
        q[rows.stop : row] = pose
    return q, qd, qdd


def estimated(robot: Robot, states: States, load: float, link_uncertainty: float) -> Outcome:
    """Estimate the load of simulated joint states that state none."""
    estimator = PayloadEstimator(
        robot,
        effort_uncertainty=EFFORT_UNCERTAINTY,
        mass_uncertainty=MonitorSettings().mass_uncertainty,
        stated=0.0,
        link_uncertainty=link_uncertainty,
    )
    rows, means = Intervals(robot.periods, 0.1).add(*states)
    outcome = Outcome(np.nan, np.nan, np.inf, unfit=False)
    for row, mean in zip(rows.tolist(), means, strict=True):
        if found := estimator.add(int(states.stamps[row]), mean):
            is_found = found.mass > ALARM * found.deviation and not found.unfit
            seconds = 1e-9 * float(states.stamps[row] - states.stamps[0]) if is_found else np.inf
            outcome = Outcome(found.mass - load, found.deviation, min(outcome.found_s, seconds), bool(found.unfit))
    return outcome


def run(case: Case, seconds: float, seed: int) -> tuple[Outcome, Outcome]:
    """Return the outcomes with and without the load of `case`."""
    robot = robot_of(case)
    rngs = np.random.default_rng(seed).spawn(2)
    loads = (case.load, rngs[0]), (0.0, rngs[1])
    return tuple(
        estimated(robot, simulated(robot, case, load, seconds, rng), load, case.assumed) for load, rng in loads
    )  # type: ignore[return-value]


def line(case: Case, outcomes: Sequence[tuple[Outcome, Outcome]]) -> str:
    """Return a row of the table of docs/validity.md."""
    loaded, empty = (np.array(part) for part in zip(*outcomes, strict=True))
    covers = [100.0 * np.mean(np.abs(part[:, 0]) < 1.96 * part[:, 1]) for part in (loaded, empty)]
    half, found, alarms = 1.96 * loaded[:, 1], loaded[:, 2], int(np.isfinite(empty[:, 2]).sum())
    share = 100.0 * np.mean(np.isfinite(found))
    return (
        f"| {case.name} | {case.load:g} kg | {covers[0]:.1f} % | {covers[1]:.1f} % | {np.median(half):.3f} / "
        f"{half.max():.3f} kg | {share:.1f} % | {np.median(found):.1f} / {found.max():.1f} s | {alarms} | "
        f"{int(loaded[:, 3].sum() + empty[:, 3].sum())} |"
    )


def main() -> None:
    """Print the table."""
    arguments = arguments_of(__doc__, runs=500, seconds=10.0)
    head = "| robot | load | covered, with load | without | half the interval | found | after | false | unfit |"
    print(head)  # noqa: T201
    print("|---|---|---|---|---|---|---|---|---|")  # noqa: T201
    with ProcessPoolExecutor() as pool:
        for case in CASES:
            seeds = range(arguments.seed * 100_000, arguments.seed * 100_000 + arguments.runs)
            print(line(case, list(pool.map(partial(run, case, arguments.seconds), seeds, chunksize=10))))  # noqa: T201


if __name__ == "__main__":
    main()
