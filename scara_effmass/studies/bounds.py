# SPDX-License-Identifier: Apache-2.0
"""The force bounds of the verdict against an independent simulation; docs/validity.md joins its tables.

    python -m scara_effmass.studies.bounds [--poses 200] [--seed 1]

Each contact begins at exactly the speed that the monitor allows for that region, all margins 0. The simulation is that
of `scara-effmass evidence`.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table
from scipy.optimize import linprog

from scara_effmass.iso15066 import limits_for
from scara_effmass.settings import MonitorSettings
from scara_effmass.sim.plate_sim import JointServo
from scara_effmass.studies.random_impacts import NO_MARGINS, ROBOTS, MonitoredArm, arm_of
from scara_effmass.values import FloatArray

SMALL_TURN = 0.02
"""Turn of the joints [rad, m] until the peak that hardly changes the effective mass."""
HELD = 1e-4
"""Pace at which the arm stays in the pose of the first touch."""


def settings_for(region: str = "", **settings: object) -> MonitorSettings:
    """Return `settings` of the monitor without margins, with the full model and one `region`, all if empty."""
    regions = [region] if region else []
    return MonitorSettings.model_validate(
        {**NO_MARGINS, "effective_mass_model": "full", "body_regions": regions, **settings}
    )


def draw(arm: MonitoredArm, rng: np.random.Generator, settings: MonitorSettings) -> tuple[FloatArray, FloatArray]:
    """Return a random pose (n,) and the joint velocities (n,) of a random motion, at the allowed speed."""
    while True:
        q, creep = arm.draw_motion(rng)
        qd = arm.allowed(q, creep, settings)
        if qd is not None and qd.any():
            return q, qd


def contacts(
    arm: MonitoredArm,
    region: str,
    count: int,
    rng: np.random.Generator,
    *,
    pushing: JointServo | None = None,
    plate: str = "worst",
    pace: float = 1.0,
    **settings: object,
) -> FloatArray:
    """Return the peak force over the limit and the turn of the joints [rad, m] of contacts at the allowed speed.

    Shape (count, 2). The `plate` is at the worst angle for free joints, across the velocity, or at a random angle.
    """
    checked = settings_for(region, **settings)
    (limit,) = limits_for(checked)
    results = []
    for _ in range(count):
        q, qd = draw(arm, rng, checked)
        velocity = arm.sim.kinematics(q)[0] @ qd
        normal = arm.sim.worst_normal(q, qd, limit.body_mass_kg)
        if plate != "worst":
            normal = velocity if plate == "velocity" else rng.normal(size=3)
            normal *= np.sign(normal @ velocity) / np.linalg.norm(normal)
        peak = arm.sim.touch(q, qd, normal, limit, pushing, pace=pace)
        results.append((peak.force / limit.permissible_force_n, peak.turn))
    return np.array(results)


def clamping_force(arm: MonitoredArm, q: FloatArray, direction: FloatArray) -> float:
    """Return the largest F [N] with |g + J^T n F| <= tau_max, by linear programming; g and J by MuJoCo."""
    effort, gravity = arm.dynamics.robot.effort_limits, arm.sim.gravity(q)
    lever = direction @ arm.sim.kinematics(q)[0]
    solution = linprog(
        [-1.0],
        A_ub=np.concatenate((lever, -lever))[:, None],
        b_ub=np.concatenate((effort - gravity, effort + gravity)),
        bounds=[(None, None)],
    )
    return max(float(solution.x[0]), 0.0)


def main() -> None:
    """Run the sweeps and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--poses", type=int, default=200, help="contacts in each row")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    arms = {name: arm_of(name) for name in ROBOTS}
    console = Console(width=150)
    columns = ("n", "held: median", "held: max", "median", "max", "above 1.005", "max, turn < 0.02")

    def row(table: Table, labels: Sequence[str], arm: MonitoredArm, region: str, count: int, **options: Any) -> None:  # noqa: ANN401
        (held, _), (ratio, turn) = (
            contacts(arm, region, count, np.random.default_rng(args.seed), pace=pace, **options).T
            for pace in (HELD, 1.0)  # the same motions: only the change of pose differs
        )
        little = ratio[turn <= SMALL_TURN]
        table.add_row(
            *labels,
            str(count),
            f"{np.median(held):.3f}",
            f"{held.max():.4f}",
            f"{np.median(ratio):.3f}",
            f"{ratio.max():.3f}",
            f"{100.0 * np.mean(ratio > 1.005):.0f} %",
            f"{little.max():.4f}" if little.size else "-",
        )

    console.print("## Joints free")
    table = Table("arm", "region", "contact_normal", "plate", *columns, box=box.MARKDOWN)
    for name, arm in arms.items():
        for region in ("lower_leg", "chest", "hand_fingers"):
            for normal, plate in (("worst", "worst"), ("velocity", "worst"), ("worst", "random")):
                labels = (name, region, normal, plate)
                row(table, labels, arm, region, args.poses, plate=plate, contact_normal=normal)
    console.print(table)
    console.print("## Drives push on for 0.5 s")
    table = Table("arm", "bandwidth", "region", "drives", *columns, box=box.MARKDOWN)
    count = max(args.poses // 8, 1)
    for name, arm in arms.items():
        for bandwidth in (1.0, 5.0, 20.0):
            for region in ("abdomen", "chest", "lower_leg"):
                for drives in ("servo", "free"):
                    options = {"servo": {"bandwidth": bandwidth, "computed_torque": True}} if drives == "servo" else {}
                    row(
                        table,
                        (name, f"{bandwidth:g} Hz", region, drives),
                        arm,
                        region,
                        count,
                        pushing=JointServo(bandwidth),
                        drives=drives,
                        **options,
                    )
    console.print(table)
    ur5, forces = arms["UR5"], []
    for _ in range(args.poses):
        q, qd = draw(ur5, rng, settings_for())
        velocity = ur5.sim.kinematics(q)[0] @ qd
        forces.append(clamping_force(ur5, q, velocity / np.linalg.norm(velocity)))
    quartiles = ", ".join(f"{force:.0f}" for force in np.percentile(forces, (5, 50, 95)))
    console.print(f"UR5, clamping force along the velocity, percentiles 5, 50, 95: {quartiles} N")


if __name__ == "__main__":
    main()
