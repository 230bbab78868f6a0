# SPDX-License-Identifier: Apache-2.0
"""How well the effective mass that `identify` finds covers the true one, on simulated arms whose file is wrong.

    python -m scara_effmass.studies.arm [--runs 500] [--seed 1]

Joint states are those of `studies.load`, 40 s without a load. Of each link the mass is up to 30 % off the file
(uniform) and the centre of mass 2 cm in each axis (standard deviation); of point masses, each mass is up to 30 % off.
"""

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from scara_effmass.identification.arm import effective_masses, identify_arm
from scara_effmass.identification.regression import Z_95, link_parameters
from scara_effmass.kernel.intervals import Intervals
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import MonitorSettings
from scara_effmass.studies import arguments_of
from scara_effmass.studies.load import CASES, EFFORT_UNCERTAINTY, Case, robot_of, simulated

SECONDS = 40.0
CONFIGURATIONS = 50
ROWS = (*((case.name, case, False) for case in CASES[:3]), ("i4-550L of point masses, lumped", CASES[0], True))
"""Name, case, and whether the arm has two point masses for each link, which are fitted."""


class Outcome(NamedTuple):
    """Share of effective masses whose interval of 95 % has the true one, medians of half the interval and of errors.

    These are relative; the errors are of the identified masses and of those by the file. `unfit`: torques do not fit.
    """

    covered: float
    half: float
    error: float
    file_error: float
    unfit: bool


def run(case: Case, is_lumped: bool, seed: int) -> Outcome:  # noqa: FBT001 - of ROWS
    """Return the outcome of one arm."""
    rng = np.random.default_rng(seed)
    robot = robot_of(case)
    lumped = RobotDynamics(robot).lumped if is_lumped else None
    model = robot.model.copy() if lumped is None else lumped.model.copy()
    model.armature = robot.model.armature
    for joint in range(1, model.njoints):
        factor, stated = rng.uniform(0.7, 1.3), model.inertias[joint]
        com = stated.lever + (rng.normal(0.0, 0.02, 3) if lumped is None else 0.0)
        model.inertias[joint] = pin.Inertia(factor * stated.mass, com, factor * stated.inertia)
    states = simulated(replace(robot, model=model), case, 0.0, SECONDS, rng)
    _, means = Intervals(robot.periods, MonitorSettings().timeout).add(*states)
    found = identify_arm(robot, means, EFFORT_UNCERTAINTY, lumped)
    if found is None:
        raise RuntimeError("the simulated robot does not move")
    masses = effective_masses(found, CONFIGURATIONS)
    true = effective_masses(found._replace(parameters=link_parameters(model)), CONFIGURATIONS).identified
    return Outcome(
        float(np.mean(np.abs(masses.identified - true) < Z_95 * masses.deviations)),
        float(np.median(Z_95 * masses.deviations / masses.identified)),
        float(np.median(np.abs(masses.identified / true - 1.0))),
        float(np.median(np.abs(masses.stated / true - 1.0))),
        bool(found.unfit),
    )


def main() -> None:
    """Print the table of docs/validity.md."""
    arguments = arguments_of(__doc__, runs=500)
    print("| arm | covered | half the interval | error, identified | by the file | do not fit |")  # noqa: T201
    print("|---|---|---|---|---|---|")  # noqa: T201
    with ProcessPoolExecutor() as pool:
        for name, case, is_lumped in ROWS:
            seeds = range(arguments.seed * 100_000, arguments.seed * 100_000 + arguments.runs)
            outcomes = np.array(list(pool.map(partial(run, case, is_lumped), seeds, chunksize=5)))
            covered, *medians = 100.0 * np.append(outcomes[:, 0].mean(), np.median(outcomes[:, 1:4], axis=0))
            numbers = " | ".join(f"{value:.1f} %" for value in (covered, *medians))
            print(f"| {name} | {numbers} | {int(outcomes[:, 4].sum())} |")  # noqa: T201


if __name__ == "__main__":
    main()
