# SPDX-License-Identifier: Apache-2.0
"""Joint states that lie: the share of true VIOLATIONs that the monitor shows as OK or WARN.

    python -m scara_effmass.studies.lies [--runs 60] [--seed 1]

Prints the tables of docs/consuming.md. Random motions, --runs each of the shipped SCARA and of a UR5, are reported with
the noise, resolution, lag and jitter of a random driver, and with a lie from a random moment on. A true VIOLATION is
one of the true positions and velocities, without tolerances. The second table counts UNKNOWN in recordings without a
lie; it needs a checkout of the source.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import closing
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from scara_effmass.analysis.assessment import assessed_rows, joint_state_topic
from scara_effmass.bags.files import find_bags, open_bag
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings
from scara_effmass.share import share
from scara_effmass.sim.motion import QuinticScaling, TrapezoidalScaling
from scara_effmass.studies import arguments_of
from scara_effmass.values import FloatArray, JointState, Verdict, severity

ROOT = share("bags").parent
ROBOTS = {
    "i4-550L": (share("config", "omron_i4_550l.yaml"), MonitorSettings()),
    "UR5": (share("config", "robots", "ur5_robot.urdf"), MonitorSettings(effective_mass_model="full")),
}
RECORDINGS = {
    "bags/tour": ROBOTS["i4-550L"],
    "bags/straight_300_200": ROBOTS["i4-550L"],
    "bags/campaign": ROBOTS["i4-550L"],
    "test/recordings/interbotix_wx200_waist.bag": (
        ROOT / "test/robots/wx200.urdf",
        MonitorSettings(effective_mass_model="full"),
    ),
}
EXACT = {"position_tolerance": 0.0, "velocity_tolerance": 0.0}
COMMAND_TOLERANCE = 0.05
"""Of the positions against the commands [rad]."""
NOW = 1_767_225_600_000_000_000
RATE_HZ = 10_000
DURATION_S = 4.0
MAX_LAG_S = 0.03
MAX_ANGLE, MAX_SPEED = 2.4, 3.14
REPEAT_S = 0.1
TRAPEZOIDAL, QUINTIC = TrapezoidalScaling(length=1.0, speed=1.25, acceleration=6.25), QuinticScaling(1.0)
"""Moves of 1 s; the trapezoidal one accelerates for 0.2 s."""
SETTLE_NS = 500_000_000
"""Time within which velocities of exactly 0 are confirmed."""

Lie = Callable[[FloatArray, FloatArray, int, int], tuple[FloatArray, FloatArray]]


def _scaled(qd: FloatArray, joint: int, factor: float) -> FloatArray:
    return qd * np.where(np.arange(qd.shape[1]) == joint, factor, 1.0)


def _swapped(values: FloatArray) -> FloatArray:
    return values[:, [1, 0, *range(2, values.shape[1])]]


def _repeated(values: FloatArray, count: int) -> FloatArray:
    return values[np.arange(len(values)) // count * count]


LIES: dict[str, Lie] = {
    "none": lambda q, qd, *_: (q, qd),
    "sign of one velocity flipped": lambda q, qd, joint, _: (q, _scaled(qd, joint, -1.0)),
    "velocities x 0.67": lambda q, qd, *_: (q, 0.67 * qd),
    "one velocity x 0.67": lambda q, qd, joint, _: (q, _scaled(qd, joint, 0.67)),
    "velocities x 1.5": lambda q, qd, *_: (q, 1.5 * qd),
    "positions frozen": lambda q, qd, *_: (0.0 * q + q[0], qd),
    "velocities frozen": lambda q, qd, *_: (q, 0.0 * qd + qd[0]),
    "velocities 0": lambda q, qd, *_: (q, 0.0 * qd),
    "positions of joints 1, 2 swapped": lambda q, qd, *_: (_swapped(q), qd),
    "velocities of joints 1, 2 swapped": lambda q, qd, *_: (q, _swapped(qd)),
    "states repeated for 0.1 s": lambda q, qd, _, count: (_repeated(q, count), _repeated(qd, count)),
    "both frozen": lambda q, qd, *_: (0.0 * q + q[0], 0.0 * qd + qd[0]),
    "joints 1, 2 swapped in both": lambda q, qd, *_: (_swapped(q), _swapped(qd)),
}
UNDETECTABLE = [*LIES][-2:]
"""Lies that contradict commands only."""


class Run(NamedTuple):
    """A motion and what an honest driver reports of it; positions and velocities (m, n) [rad, m, s]."""

    rate: int
    stamps_ns: list[int]
    true_q: FloatArray
    true_qd: FloatArray
    q: FloatArray
    qd: FloatArray


def motion(
    rng: np.random.Generator, lower: FloatArray, upper: FloatArray, speed: FloatArray, t: FloatArray
) -> FloatArray:
    """Return positions (m, n) at the times `t` (m,): sines, or moves with rests, of trapezoidal or quintic speed."""
    kind, n = rng.integers(3), lower.size
    if kind == 0:
        rates = 2.0 * math.pi * rng.uniform(0.1, 0.8, (2, n))
        amplitude = np.minimum((upper - lower) * rng.uniform(0.025, 0.11, n), speed / rates.sum(axis=0))
        phases = rng.uniform(0.0, 2.0 * math.pi, (2, n))
        return np.asarray((lower + upper) / 2.0 + amplitude * np.sin(t[:, None, None] * rates + phases).sum(axis=1))
    knots, points = [float(t[0])], [rng.uniform(lower, upper)]
    while knots[-1] <= t[-1]:
        rest = rng.uniform(0.05, 0.6) if rng.random() < 0.6 else 0.0
        goal = points[-1] + (rng.uniform(lower, upper) - points[-1]) * (1.0 if rng.random() < 0.6 else 0.25)
        duration = max(0.15, 1.9 * float(np.max(np.abs(goal - points[-1]) / speed)))
        knots += [knots[-1] + rest, knots[-1] + rest + duration]
        points += [points[-1], goal]
    index = np.searchsorted(knots, t, "right") - 1
    s = (t - np.array(knots)[index]) / np.diff(knots)[index]
    blend, _ = (TRAPEZOIDAL if kind == 1 else QUINTIC).at(s)
    return np.asarray(np.array(points)[index] + np.diff(points, axis=0)[index] * blend[:, None])


def draw(rng: np.random.Generator, dynamics: RobotDynamics) -> Run:
    """Return a random motion, reported by a random driver."""
    model, revolute = dynamics.robot.model, np.array(dynamics.robot.revolute)
    lower, upper = np.maximum(model.lowerPositionLimit, -MAX_ANGLE), np.minimum(model.upperPositionLimit, MAX_ANGLE)
    speed = np.minimum(model.velocityLimit, np.where(revolute, MAX_SPEED, 1.0)) * rng.uniform(0.1, 1.0)
    t = np.arange(-MAX_LAG_S, DURATION_S, 1.0 / RATE_HZ)
    dense_q = motion(rng, lower, upper, speed, t)
    dense_qd = np.gradient(dense_q, t, axis=0)
    rate = int(rng.choice([100, 125, 250, 500, 1000]))
    index = np.arange(round(MAX_LAG_S * RATE_HZ), t.size, RATE_HZ // rate)
    lag_s = rng.choice([0.0, 0.0, 0.5 / rate, *rng.uniform(0.0, (0.01, MAX_LAG_S))])
    late = index - round(lag_s * RATE_HZ)
    shape = (index.size, lower.size)
    q = dense_q[index] + rng.uniform(0.0, 3e-4) * rng.normal(size=shape)
    qd = dense_qd[late] + rng.uniform(0.0, 0.01) * (rng.random() < 0.7) * rng.normal(size=shape)
    steps = 2.0 * math.pi / 2.0 ** rng.integers(12, 21) * np.where(revolute, 1.0, 0.05)
    velocity_steps = rng.choice([1e-4, 1e-3, 0.024]) * np.where(revolute, 1.0, 0.1)
    jitter = np.clip(rng.random() * rng.normal(size=index.size), -2.0, 2.0) * min(0.2 / rate, 1e-3)
    stamps = NOW + np.round((t[index] + jitter) * 1e9).astype(np.int64)
    q, qd = np.round(q / steps) * steps, np.round(qd / velocity_steps) * velocity_steps
    return Run(rate, stamps.tolist(), dense_q[index], dense_qd[index], q, qd)


def true_violations(run: Run, dynamics: RobotDynamics, settings: MonitorSettings) -> np.ndarray:
    """Return which of the true states (m,) are a VIOLATION at any contact point."""
    monitor = Monitor(dynamics, settings.model_copy(update=EXACT))
    assessments = monitor.assess_configurations(run.true_q, run.true_qd)
    return np.asarray((assessments.contacts["verdict"] == Verdict.VIOLATION).any(axis=1))


def shown_severities(
    run: Run, lie: Lie, start: int, joint: int, dynamics: RobotDynamics, settings: MonitorSettings, *, commands: bool
) -> np.ndarray:
    """Return the severity (m,) of the verdict at the worst contact point, with `lie` from sample `start` on."""
    monitor = Monitor(dynamics, settings)
    if commands:
        monitor.expect_commands(COMMAND_TOLERANCE)
    q, qd = run.q.copy(), run.qd.copy()
    q[start:], qd[start:] = lie(run.q[start:], run.qd[start:], joint, round(REPEAT_S * run.rate))
    names, shown = dynamics.robot.joint_names, []
    for stamp_ns, command, *reported in zip(run.stamps_ns, run.true_q, q, qd, strict=True):
        if commands:
            monitor.take_command(JointState(stamp_ns, names, command, np.empty(0)), stamp_ns)
        decision = monitor.assess(JointState(stamp_ns, names, *reported), stamp_ns)
        shown.append(severity(decision.verdict) if decision else 0)
    return np.array(shown)


def study(name: str, runs: int, seed: int, table: Table) -> None:
    """Add a row for each lie to `table`: UNKNOWN, true VIOLATIONs, and their share shown as OK or WARN."""
    path, settings = ROBOTS[name]
    dynamics = RobotDynamics(load_robot(path, settings))
    rows = [(lie, False) for lie in LIES] + [(lie, True) for lie in UNDETECTABLE]
    counts = {row: np.zeros(4, dtype=int) for row in rows}
    for number in range(runs):
        rng = np.random.default_rng([seed, number])
        run = draw(rng, dynamics)
        start = int(rng.uniform(0.0, 0.3) * len(run.q)) if rng.random() < 0.5 else 0
        joint = int(rng.integers(2))
        lied = np.arange(len(run.q)) >= start
        violations = true_violations(run, dynamics, settings) & lied
        for lie, commands in rows:
            shown = shown_severities(run, LIES[lie], start, joint, dynamics, settings, commands=commands)
            missed = np.count_nonzero(violations & (shown < severity(Verdict.VIOLATION)))
            unknown = np.count_nonzero(lied & (shown == severity(Verdict.UNKNOWN)))
            counts[lie, commands] += (lied.sum(), unknown, violations.sum(), missed)
    for (lie, commands), (states, unknown, true, missed) in counts.items():
        text = f"{lie}, commands given" if commands else lie
        table.add_row(name, text, f"{unknown / states:.1%}", f"{true}", f"{missed / max(true, 1):.2%}")


def main() -> None:
    """Print both tables."""
    args = arguments_of(__doc__, runs=60)
    console = Console(width=150)
    table = Table("robot", "lie", "UNKNOWN", "true VIOLATIONs", "shown OK or WARN", title="lies")
    for name in ROBOTS:
        study(name, args.runs, args.seed, table)
    console.print(table)
    table = Table("recording", "joint states", "UNKNOWN", "after 0.5 s", title="recordings without a lie")
    for name, (robot, settings) in RECORDINGS.items():
        dynamics = RobotDynamics(load_robot(robot, settings))
        unknown: list[bool] = []
        late: list[bool] = []
        for path in find_bags(ROOT / name):
            with closing(open_bag(path)) as bag:
                states = list(assessed_rows(bag, joint_state_topic(bag, None), Monitor(dynamics, settings)))
            unknown += [state.decision.verdict is Verdict.UNKNOWN for state in states]
            late += [state.log_time_ns - states[0].log_time_ns > SETTLE_NS for state in states]
        counts = len(unknown), sum(unknown), sum(np.logical_and(unknown, late))
        table.add_row(name, *map(str, counts))
    console.print(table)


if __name__ == "__main__":
    main()
