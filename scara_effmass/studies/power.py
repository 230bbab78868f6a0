# SPDX-License-Identifier: Apache-2.0
"""Power of the validation: how often it accepts true and wrong simulated campaigns; the table of docs/validity.md.

    python -m scara_effmass.studies.power [--campaigns 100] [--seed 1] [--workers 2]

Each campaign is the paper's design, 3 poses and 4 carts, once each: MuJoCo moves the robot, the model of sensor and
converter measures, and detector, monitor and validator work as in `scara-effmass validate`. Within every campaign
speed, tip, gain, clock and carts deviate as far as a careful laboratory allows (`Nuisance`).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import cast

import numpy as np
import yaml
from rich.console import Console
from rich.progress import track
from rich.table import Table

from scara_effmass.impacts.detector import Detector
from scara_effmass.impacts.validator import Result, Validator
from scara_effmass.model.load import load_robot
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import DetectionSettings, MonitorSettings, ValidatorSettings
from scara_effmass.share import share
from scara_effmass.sim.collision_sim import SpringContact
from scara_effmass.sim.experiment import OBSTACLE_MASSES, ImpactRun, run_impact
from scara_effmass.studies import arguments_of
from scara_effmass.studies.campaign import Campaign
from scara_effmass.values import Decision, Mobility6

SCARA = share("config", "omron_i4_550l.yaml")
SETTINGS = MonitorSettings(contact_points=("tool",))
AFTER_NS = 150_000_000
TURN = math.radians(30.0)
MODELS = ("lumped", "full")


@dataclass(frozen=True)
class Nuisance:
    """Deviations of a correct campaign, relative unless said: gain, clock [s], stiffness [N/m], masses of the carts."""

    gain: float
    clock: float
    stiffness: float
    carts: tuple[float, ...]
    turn: float
    two_carts: tuple[int, int]

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Nuisance:
        """Return random deviations."""
        cart = int(rng.integers(len(OBSTACLE_MASSES)))
        other = (cart + int(rng.integers(1, len(OBSTACLE_MASSES)))) % len(OBSTACLE_MASSES)
        return cls(
            gain=1.0 + rng.uniform(-0.02, 0.02),
            clock=rng.uniform(-1e-3, 1e-3),
            stiffness=1e6 * 4.0 ** rng.uniform(0.0, 1.0),
            carts=tuple((1.0 + rng.uniform(-0.005, 0.005, len(OBSTACLE_MASSES))).tolist()),
            turn=TURN * float(rng.choice((-1.0, 1.0))),
            two_carts=(cart, other),
        )


@dataclass(frozen=True)
class Case:
    """What is wrong with a campaign: factors of masses and force, shift of the force clock [s], tool, carts.

    `declared` maps the number of a cart to that of the cart whose mass is declared, for the two of `Nuisance`.
    """

    masses: float = 1.0
    force: float = 1.0
    clock: float = 0.0
    tool: bool = True
    declared: tuple[int, int] = (0, 1)
    turned: bool = False
    accept: bool = False


CASES = {
    "true": Case(accept=True),
    "true, plates turned by 30 deg": Case(turned=True, accept=True),
    "masses of the robot file x 0.8": Case(masses=0.8),
    "masses of the robot file x 1.25": Case(masses=1.25),
    "tool forgotten (0.25 kg)": Case(tool=False),
    "force x 1.2": Case(force=1.2),
    "force 20 ms early": Case(clock=-0.02),
    "force 20 ms late": Case(clock=0.02),
    "force with the wrong sign": Case(force=-1.0),
    "one cart exchanged for another": Case(declared=(1, 1)),
    "two carts swapped": Case(declared=(1, 0)),
}
Outcomes = dict[tuple[str, str], str]


@cache
def dynamics(*, tool: bool) -> RobotDynamics:
    """Return the shipped robot at its tool, or the same without its payload."""
    document = yaml.safe_load(SCARA.read_text(encoding="utf-8"))
    if not tool:
        document["payload"]["mass"] -= 0.25
    with TemporaryDirectory() as folder:
        path = Path(folder) / "robot.yaml"
        path.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
        return RobotDynamics(load_robot(path, SETTINGS))


def simulate(seed: int, nuisance: Nuisance, *, turned: bool) -> list[ImpactRun]:
    """Return the runs of one campaign."""
    runs = []
    for run in Campaign(repetitions=1, seed=seed, contact=SpringContact(nuisance.stiffness)).runs:
        setup = run.setup
        cart = OBSTACLE_MASSES.index(setup.obstacle_mass)
        surface = (math.cos(nuisance.turn), math.sin(nuisance.turn), 0.0) if turned else setup.surface
        mass = setup.obstacle_mass * nuisance.carts[cart]
        runs.append(run_impact(replace(setup, obstacle_mass=mass, surface=surface)))
    return runs


def assess(run: ImpactRun, *, tool: bool) -> list[Decision]:
    """Return the decisions of a run until shortly after the impact."""
    monitor = Monitor(dynamics(tool=tool), SETTINGS)
    end_ns = run.impact.onset_ns + AFTER_NS
    states = (state for state in run.joint_states if state.stamp_ns <= end_ns)
    decisions = [monitor.assess(state, state.stamp_ns) for state in states]
    return [decision for decision in decisions if decision is not None]


def scaled(decision: Decision, factor: float) -> Decision:
    """Return `decision` as for a robot whose masses and inertias are `factor` times as large; one contact point."""
    (state,) = decision.contacts
    lumped, full = (
        cast("Mobility6", tuple(a / factor for a in mobility))
        for mobility in (state.lumped_mobility, state.full_mobility)
    )
    contact = state._replace(
        lumped_mass=factor * state.lumped_mass,
        full_mass=factor * state.full_mass,
        iso_mass=factor * state.iso_mass,
        lumped_mobility=lumped,
        full_mobility=full,
    )
    return decision._replace(contacts=(contact,))


def validate(
    runs: Sequence[ImpactRun],
    decisions: Sequence[Sequence[Decision]],
    nuisance: Nuisance,
    case: Case,
) -> Result:
    """Return the result of a campaign with the errors of `case`."""
    validator = Validator(ValidatorSettings())
    for run, assessed in zip(runs, decisions, strict=True):
        cart = min(range(len(OBSTACLE_MASSES)), key=lambda i: abs(OBSTACLE_MASSES[i] - run.setup.obstacle_mass))
        if cart in nuisance.two_carts:
            cart = nuisance.two_carts[case.declared[nuisance.two_carts.index(cart)]]
        validator.begin_recording()
        validator.runs.begin(run.setup.run_info("")._replace(obstacle_mass=OBSTACLE_MASSES[cart], stamp_ns=0), 0)
        for decision in assessed:
            validator.add_decision(scaled(decision, case.masses) if case.masses != 1.0 else decision, 0)
        detector = Detector(DetectionSettings())
        impacts = []
        for block in run.force_blocks:
            shift_ns = round((nuisance.clock + case.clock) * 1e9)
            force = nuisance.gain * case.force * block.force
            shifted = block._replace(force=force, stamp_ns=block.stamp_ns + shift_ns)
            validator.add_force(shifted, 0)
            impacts += detector.feed(shifted)
        for impact in impacts + detector.finish():
            validator.add_impact(impact, 0)
        validator.finish()
    return validator.result()


def outcomes(seed: int) -> Outcomes:
    """Return the outcome of each case and model for the campaign of `seed`."""
    nuisance = Nuisance.draw(np.random.default_rng(seed))
    square, turned = (simulate(seed, nuisance, turned=turned) for turned in (False, True))
    square_decisions = {tool: [assess(run, tool=tool) for run in square] for tool in (True, False)}
    turned_decisions = [assess(run, tool=True) for run in turned]
    found = {}
    for name, case in CASES.items():
        runs, decisions = (turned, turned_decisions) if case.turned else (square, square_decisions[case.tool])
        for model in validate(runs, decisions, nuisance, case).models:
            outcome = "accepted" if model.accepted else "rejected" if model.decidable else "not decidable"
            found[name, model.model] = outcome
    return found


def main() -> None:
    """Simulate the campaigns and print the table."""
    args = arguments_of(__doc__, campaigns=100, workers=2)
    seeds = range(args.seed, args.seed + args.campaigns)
    with ProcessPoolExecutor(args.workers) as pool:
        results = list(track(pool.map(outcomes, seeds), total=args.campaigns))
    print_table(results)


def print_table(results: Sequence[Outcomes]) -> None:
    """Print how many of the campaigns are accepted, rejected and not decidable."""
    table = Table("campaign", "wanted", *(f"{model}: accepted / rejected / not decidable" for model in MODELS))
    for name, case in CASES.items():
        cells = []
        for model in MODELS:
            counts = Counter(result[name, model] for result in results)
            cells.append(" / ".join(str(counts[key]) for key in ("accepted", "rejected", "not decidable")))
        table.add_row(name, "accepted" if case.accept else "not accepted", *cells)
    Console(width=140).print(table)


if __name__ == "__main__":
    main()
