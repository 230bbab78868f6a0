# SPDX-License-Identifier: Apache-2.0
"""Runs of the experiment, read from one bag each, and the quantities that figures and claims need of them."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scara_effmass.analysis.assessment import joint_state_topic
from scara_effmass.analysis.forces import detected_impacts, read_force
from scara_effmass.analysis.validation import run_infos
from scara_effmass.bags.bag import Bag
from scara_effmass.bags.files import find_bags, open_bag
from scara_effmass.errors import BagError
from scara_effmass.iso15066 import reduced_mass
from scara_effmass.reference import RobotDynamics
from scara_effmass.sim.motion import ElbowConfig, inverse_kinematics
from scara_effmass.studies.scara import ALONG_X, SHOWN_OBSTACLE_KG, Scara, scara_of
from scara_effmass.values import FloatArray, Impact
from scara_effmass.wire.message_types import FORCE_BLOCK

BEFORE_ONSET_S, AFTER_ONSET_S = 0.5e-3, 5e-3
"""Times before and after the onset between which the force is kept."""
NORMAL = (1.0, 0.0, 0.0)
"""Normal of the plate in the paper's experiment."""
POINT_OF_FIG_17 = (0.300, 0.200)
"""Impact point of Fig. 17, the only one in the paper's text."""
REPETITIONS = 3
"""Runs of each case in the paper."""

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class RecordedRun:
    """One run, measured or simulated: the right arm hits the cart along x with the tool at `point` (x, y) [m].

    `point` and `obstacle_mass` [kg] are nominal, equal in all repetitions. At `time` (n,) [s] since the first joint
    state the tool has position `x` (n,) [m] and `velocity` (n,) [m/s] along x. The impact begins at `onset` [s];
    `speed` [m/s] is the last velocity that is certainly before it. `force` (m,) [N] at `force_time` (m,) [s] since the
    onset is positive in compression, without tare and baseline.
    """

    name: str
    point: Point
    obstacle_mass: float
    simulated: bool
    time: FloatArray
    x: FloatArray
    velocity: FloatArray
    onset: float
    speed: float
    peak_force: float
    force_time: FloatArray
    force: FloatArray

    @property
    def source(self) -> str:
        """The recording, and whether it was measured."""
        return f"{'simulated' if self.simulated else 'recorded'} run {self.name}"

    @property
    def path_share(self) -> float:
        """Share of the path before the onset."""
        onset_x = float(np.interp(self.onset, self.time, self.x))
        return (onset_x - float(self.x[0])) / float(self.x[-1] - self.x[0])


@dataclass(frozen=True, slots=True)
class FigureInputs:
    """Robot and recorded runs, at least one."""

    dynamics: RobotDynamics
    scara: Scara
    runs: tuple[RecordedRun, ...]

    @property
    def shown_run(self) -> RecordedRun:
        """The run of Fig. 17: at its impact point with the usual obstacle mass, if there is one."""
        return min(self.runs, key=lambda run: (run.point != POINT_OF_FIG_17, run.obstacle_mass != SHOWN_OBSTACLE_KG))


def read_inputs(dynamics: RobotDynamics, campaign: Path) -> FigureInputs:
    """Return the inputs for the SCARA in `dynamics` with the runs in the folder `campaign`.

    Impacts are detected in the recorded force. Raises RobotError for a robot that is no SCARA, and BagError for a
    recording that lacks one complete impact along x, obstacle mass and impact point, or joint states around the impact.
    """
    scara, joints = scara_of(dynamics), dynamics.robot.joint_names[:2]
    return FigureInputs(dynamics, scara, tuple(_read_run(path, scara, joints) for path in find_bags(campaign)))


def _read_run(path: Path, scara: Scara, joints: tuple[str, ...]) -> RecordedRun:
    with open_bag(path) as bag:
        point, obstacle_mass = _point_and_mass(bag)
        forces = read_force(bag)
        if forces is None:
            raise BagError(f"{path}: no {FORCE_BLOCK}: must contain the force of an impact")
        impact = _impact(bag)
        stamps, angles = _joint_motion(bag, joints)
    q1, q2, rate1, rate2 = angles
    x, y = scara.tool(q1, q2)
    velocity = -rate1 * y - rate2 * scara.inertia.l2 * np.sin(q1 + q2)
    time = (stamps - stamps[0]) / 1e9
    onset = (impact.stamp_ns - int(stamps[0])) / 1e9
    if not time[0] <= onset <= time[-1]:
        raise BagError(f"{path}: impact {onset:.3f} s after the first joint state: must be within the recording")
    before = int(np.searchsorted(time, onset - impact.clock_residual, side="right")) - 1
    force_time = (forces.stamp_ns - impact.stamp_ns) / 1e9
    shown = (force_time >= -BEFORE_ONSET_S) & (force_time <= AFTER_ONSET_S)
    return RecordedRun(
        name=path.name,
        point=point,
        obstacle_mass=obstacle_mass,
        simulated=forces.simulated,
        time=time,
        x=x,
        velocity=velocity,
        onset=onset,
        speed=float(velocity[max(before, 0)]),
        peak_force=impact.peak_force,
        force_time=force_time[shown],
        force=forces.force[shown] - impact.baseline,
    )


def _point_and_mass(bag: Bag) -> tuple[Point, float]:
    """Return impact point [m] and obstacle mass [kg]."""
    for info in run_infos(bag):
        if not info.obstacle_mass or not any(info.plate_normal):
            continue
        if info.plate_normal != NORMAL:
            raise BagError(f"{bag.path}: plate_normal = {info.plate_normal}: must be {NORMAL}")
        x, y, _ = info.impact_position
        if not math.isfinite(x + y):
            raise BagError(f"{bag.path}: impact_position = {info.impact_position}: must be finite [m]")
        return (x, y), info.obstacle_mass
    raise BagError(f"{bag.path}: must state obstacle_mass, impact_position and plate_normal, as a campaign does")


def _impact(bag: Bag) -> Impact:
    topic = next(topic.name for topic in bag.topics if topic.type == FORCE_BLOCK)
    first = [impact for impact in detected_impacts(bag.force_blocks(topic)) if not impact.rebound]
    if len(first) != 1 or first[0].clipped or first[0].incomplete:
        raise BagError(f"{bag.path}: {topic}: {len(first)} impacts without rebounds: must be 1, complete, not clipped")
    return first[0]


def _joint_motion(bag: Bag, joints: tuple[str, ...]) -> tuple[NDArray[np.int64], FloatArray]:
    """Return the stamps (n,) [ns], and angles and rates of the two `joints` (4, n)."""
    stamps: list[NDArray[np.int64]] = []
    rows: list[FloatArray] = []
    for block in bag.joint_state_blocks(joint_state_topic(bag, None)):
        if not len(block):
            continue
        if not set(joints) <= set(block.names) or block.velocity.shape != block.position.shape:
            names = " and ".join(joints)
            raise BagError(f"{bag.path}: a joint state must have position and velocity of {names}")
        indices = [block.names.index(joint) for joint in joints]
        stamps.append(block.stamp_ns)
        rows.append(np.hstack((block.position[:, indices], block.velocity[:, indices])))
    if not rows:
        raise BagError(f"{bag.path}: must contain joint states")
    return np.concatenate(stamps), np.concatenate(rows).T


def mass_at(scara: Scara, point: Point) -> float:
    """Return m_n of the simplified model [kg], right arm, tool at `point`, along x (Eq. 28)."""
    q1, q2 = inverse_kinematics(np.array(point), ElbowConfig.RIGHT)
    return float(scara.lumped(q1, q2, ALONG_X))


def root_reduced_mass(scara: Scara, point: Point, obstacle_mass: float) -> float:
    """Return sqrt(mu) [sqrt(kg)] of the simplified model."""
    return float(np.sqrt(reduced_mass(mass_at(scara, point), obstacle_mass)))


def mean_peaks(runs: Iterable[RecordedRun]) -> dict[tuple[Point, float], float]:
    """Return the mean peak force [N] over the repetitions, by impact point and obstacle mass."""
    peaks: dict[tuple[Point, float], list[float]] = {}
    for run in runs:
        peaks.setdefault((run.point, run.obstacle_mass), []).append(run.peak_force)
    return {case: float(np.mean(forces)) for case, forces in peaks.items()}


def points_by_mass(scara: Scara, runs: Iterable[RecordedRun]) -> list[Point]:
    """Return the impact points of `runs` by increasing effective mass."""
    return sorted({run.point for run in runs}, key=lambda point: mass_at(scara, point))


def origin(runs: Iterable[RecordedRun]) -> str:
    """Return the origin of the forces: measured, simulated, or in part simulated."""
    simulated = {run.simulated for run in runs}
    return "measured" if simulated == {False} else "simulated" if simulated == {True} else "in part simulated"
