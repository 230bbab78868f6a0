# SPDX-License-Identifier: Apache-2.0
"""The paper's statements in `claims.yaml`, compared with this project's results."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np

from scara_effmass.input_files import read_table
from scara_effmass.iso15066 import reduced_mass
from scara_effmass.reference import RobotDynamics
from scara_effmass.settings import DaqSettings
from scara_effmass.sim.motion import ElbowConfig
from scara_effmass.studies.runs import REPETITIONS, FigureInputs, mean_peaks, origin, points_by_mass, root_reduced_mass
from scara_effmass.studies.scara import (
    ALONG_X,
    ALONG_Y,
    OBLIQUE,
    OBSTACLES_KG,
    Scara,
    density_peaks,
    equal_area_poses,
    joint_grid,
    matrix_masses,
    max_difference,
    relative_error,
    sampled_distribution,
    scara_max_lumped_mass,
    workspace_distribution,
)

STATEMENTS: Mapping[str, Mapping[str, Any]] = read_table(__file__, "claims.yaml")
SEARCH_STEPS = 721
QUILL_M = (0.0, 0.236, 0.45)


class Outcome(str, Enum):
    """Result of the comparison."""

    MATCH = "match"
    NO_MATCH = "no match"
    NOT_CHECKED = "not checked"


@dataclass(frozen=True, slots=True)
class Claim:
    """A statement `paper` at `where` in the paper, our result `ours`, and the `rule` for a match.

    `value` [`unit`] is the number in `ours`, None without a finite one. `basis` is what an agreement proves, which the
    page explains; None if nothing was checked.
    """

    key: str
    where: str
    paper: str
    basis: str | None
    ours: str
    value: float | None
    unit: str
    rule: str
    outcome: Outcome
    note: str


def compared(key: str, ours: float | str | None, *, met: bool = False, **details: float | str) -> Claim:
    """Return statement `key` with our result; `details` fill in its note, and its missing tolerance or bound.

    A number matches by the rule of the statement, NaN never; a result that is no single number if it is `met`. None
    cannot be checked.
    """
    statement = {"basis": "result", "unit": "", "rule": "", "note": "", **STATEMENTS[key], **details}
    unit, rule, value = statement["unit"], statement["rule"], None
    if isinstance(ours, float):
        value = ours if math.isfinite(ours) else None
        if "near" in statement:
            near, within = statement["near"], statement["within"]
            rule, met = f"within {_quantity(within, unit)} of {_quantity(near, unit)}", abs(ours - near) <= within
        elif "at_most" in statement:
            rule, met = f"at most {_quantity(statement['at_most'], unit)}", ours <= statement["at_most"]
        else:
            rule, met = f"more than {_quantity(statement['more_than'], unit)}", ours > statement["more_than"]
        ours = _quantity(ours, unit)
    outcome, basis = Outcome.MATCH if met else Outcome.NO_MATCH, statement["basis"]
    if ours is None:
        ours, unit, rule, outcome, basis = "", "", "", Outcome.NOT_CHECKED, None
    note = statement["note"].format(**statement)
    return Claim(key, statement["where"], statement["paper"], basis, ours, value, unit, rule, outcome, note)


def _quantity(value: float, unit: str) -> str:
    number = f"{value:.0f}" if abs(value) >= 1e4 else f"{value:.4g}"
    return f"{number} {unit}".rstrip()


def all_claims(inputs: FigureInputs) -> Iterator[Claim]:
    """Yield all claims."""
    yield from robot_claims(inputs.scara)
    yield from mass_claims(inputs.dynamics, inputs.scara)
    yield from reduced_mass_claims(inputs.scara)
    yield from run_claims(inputs)


def robot_claims(scara: Scara) -> Iterator[Claim]:
    """Yield the claims of sections 3.1, 4.1, 4.2 and 5 about the robot and the force measurement."""
    yield compared("m2", scara.m2)
    yield compared("m3", scara.m3)
    yield compared("iso_mass", scara.iso_mass)
    for obstacle in OBSTACLES_KG:
        yield compared(f"mu_iso_{obstacle:g}", float(reduced_mass(scara.iso_mass, obstacle)))
    masses, count = ", ".join(f"{mass:.3f}" for mass in scara.aggregated), len(scara.aggregated)
    ours = f"{count} masses, of which {count - 1} move: {masses} kg"
    yield compared("lumped_masses", ours, met=count == 5 and min(scara.aggregated) >= 0.0)
    yield compared("lumped_masses_tm5", None)
    yield compared("q1_range", float(np.degrees(scara.q1_max)))
    yield compared("q2_range", float(np.degrees(scara.q2_max)))
    settings = DaqSettings()
    sensor, rate = settings.sensor, settings.ni9230.sample_rate
    yield compared("sensitivity", 1e3 * sensor.sensitivity, within=2.224 * sensor.sensitivity_uncertainty)
    yield compared("sample_rate", rate)
    yield compared("record_length", 10_000 / rate)


def mass_claims(dynamics: RobotDynamics, scara: Scara) -> Iterator[Claim]:
    """Yield the claims of sections 3.2 and 4.1; extremes are searched over a full turn."""
    turn = np.radians(np.linspace(-180.0, 180.0, SEARCH_STEPS))
    step = float(np.degrees(turn[1] - turn[0]))
    q1, phi = np.meshgrid(np.radians(np.arange(-130.0, 131.0, 20.0)), (ALONG_X, OBLIQUE, ALONG_Y), indexing="ij")
    masses = scara.lumped(q1[..., None], turn, phi[..., None])
    lightest = turn[np.argmin(masses, axis=-1)]
    angle = float(np.degrees(np.abs(np.sin(lightest + q1 - phi - np.pi / 2.0))).max())
    yield compared("minimum_at", angle, at_most=step, pairs=q1.size)
    at_minimum = scara.lumped(q1, -q1 + phi + np.pi / 2.0, phi)
    yield compared("minimum_is_m3", max(max_difference(at_minimum, scara.m3), 1.0 - float(masses.min()) / scara.m3))
    q2, phi = np.meshgrid(np.radians(np.arange(10.0, 150.0, 10.0)), (ALONG_X, OBLIQUE, ALONG_Y), indexing="ij")
    heaviest = turn[np.argmax(scara.lumped(turn, q2[..., None], phi[..., None]), axis=-1)]
    yield compared("maximum_at", float(np.degrees(np.abs(np.sin(heaviest + q2 - phi))).max()), at_most=step)
    largest = scara_max_lumped_mass(q2, scara.m2, scara.m3)
    yield compared("maximum_is_eq_30", max_difference(scara.lumped(phi - q2, q2, phi), largest))
    singular = float(scara.lumped(0.0, 0.0, ALONG_X))
    is_infinite = singular == math.inf
    yield compared("singularity", "infinite" if is_infinite else f"{singular:g} kg", met=is_infinite)
    poses = equal_area_poses(scara, count=8)
    by_quill = [np.concatenate(matrix_masses(dynamics, *poses, OBLIQUE, q3)) for q3 in QUILL_M]
    difference = max(max_difference(mass, by_quill[0]) for mass in by_quill)
    yield compared("independent_of_q3", difference, places=", ".join(f"{q3:g}" for q3 in QUILL_M))
    yield from _density_claims(scara)
    full, simplified = scara.full(*joint_grid(scara)), scara.lumped(*joint_grid(scara))
    error = relative_error(full, simplified)
    sign = "larger" if np.all(simplified > full) else "smaller" if np.all(simplified < full) else "not on one side"
    yield compared("worst_error", float(error.max()), sign=sign)
    yield compared("error_in_75_percent", float(np.percentile(error, 75.0)), within_6=float(np.mean(error <= 6.0)))


def _density_claims(scara: Scara) -> Iterator[Claim]:
    sampled, whole = sampled_distribution(scara), workspace_distribution(scara)
    below = whole.below(scara.iso_mass)
    yield compared("share_below_iso", 100.0 * sampled.below(scara.iso_mass), below=below, above=1.0 - below)
    yield compared("mean_below_iso", sampled.mean, at_most=scara.iso_mass, whole=whole.mean)
    yield compared("median_below_iso", sampled.median, at_most=scara.iso_mass, whole=whole.median)
    peaks = density_peaks(whole)
    ours = f"{len(peaks)} peaks: " + ", ".join(f"{peak:.2f}" for peak in peaks) + " kg"
    yield compared("bimodal", ours, met=len(peaks) == 2, m3=scara.m3, sum=scara.m2 + scara.m3)


def reduced_mass_claims(scara: Scara) -> Iterator[Claim]:
    """Yield the claims of section 4.2."""
    poses = joint_grid(scara)
    lumped, full = scara.lumped(*poses), scara.full(*poses)
    mu = [reduced_mass(lumped, obstacle) for obstacle in OBSTACLES_KG]
    singular = scara.lumped(0.0, 0.0, ALONG_X)
    limits = [float(reduced_mass(singular, obstacle)) for obstacle in OBSTACLES_KG]
    never_more = all(values.max() <= obstacle for values, obstacle in zip(mu, OBSTACLES_KG, strict=True))
    ours = ", ".join(f"{limit:g}" for limit in limits) + " kg in the singular pose"
    yield compared("mu_limit", ours, met=limits == list(OBSTACLES_KG) and never_more)
    spans = [float(np.ptp(values)) for values in mu]
    ours = ", ".join(f"{span:.2f}" for span in spans) + " kg wide"
    yield compared("narrow_range", ours, met=spans == sorted(spans))
    errors = [
        float(relative_error(reduced_mass(full, obstacle), values).max())
        for values, obstacle in zip(mu, OBSTACLES_KG, strict=True)
    ]
    yield compared("worst_reduced_error", max(errors), errors=", ".join(f"{error:.2f}" for error in errors))
    difference = max(max_difference(scara.lumped(poses.q1 + phi, poses.q2, phi), lumped) for phi in (ALONG_Y, OBLIQUE))
    yield compared("turned_values", difference)
    along_x, along_y = (workspace_distribution(scara, phi).below(scara.iso_mass) for phi in (ALONG_X, ALONG_Y))
    yield compared("turned_plots", 100.0 * along_y, near=100.0 * along_x)
    left = scara.lumped(*joint_grid(scara, ElbowConfig.LEFT))
    yield compared("left_arm", max_difference(left[::-1], lumped))


def run_claims(inputs: FigureInputs) -> Iterator[Claim]:
    """Yield the claims of section 5 about the run of Fig. 17 and all runs (Figs. 18 and 19)."""
    scara, runs, shown_run = inputs.scara, inputs.runs, inputs.shown_run
    yield compared("speed", 1e3 * shown_run.speed, source=shown_run.source)
    yield compared("midpoint", shown_run.path_share, source=shown_run.source)

    kind = f"{origin(runs)} impacts"
    peaks = mean_peaks(runs)
    points = points_by_mass(scara, runs)
    counts = [sum((run.point, run.obstacle_mass) == case for run in runs) for case in peaks]
    least, most = min(counts), max(counts)
    ours = f"{least} in each of {len(counts)} cases" if least == most else f"{least} to {most} in {len(counts)} cases"
    yield compared("repetitions", ours, met=set(counts) == {REPETITIONS}, kind=kind)
    by_point = [[peaks[point, mass] for mass in OBSTACLES_KG if (point, mass) in peaks] for point in points]
    by_mass = [[peaks[point, mass] for point in points if (point, mass) in peaks] for mass in OBSTACLES_KG]
    for key, series in (("force_grows", by_point), ("force_order", by_mass)):
        steps = np.concatenate([np.diff(forces) for forces in series])
        rising = int(np.sum(steps > 0.0))
        text = f"{rising} of {steps.size} steps rise" if steps.size else None
        yield compared(key, text, met=rising == steps.size, kind=kind)
    roots = np.array([root_reduced_mass(scara, *case) for case in peaks])
    forces = np.array(list(peaks.values()))
    if len(forces) < 3 or np.ptp(roots) == 0.0:
        yield compared("force_proportional", None, note=f"{len(forces)} cases are too few")
        return
    slope = float(forces @ roots / (roots @ roots))
    correlation, farthest = float(np.corrcoef(roots, forces)[0, 1]), max_difference(forces, slope * roots)
    yield compared("force_proportional", correlation, cases=len(forces), kind=kind, farthest=farthest)
