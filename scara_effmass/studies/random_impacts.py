# SPDX-License-Identifier: Apache-2.0
"""Random impacts at the speed that the monitor allows: does the peak force keep the limit?

Pose, motion, contact point, region, plate normal, drives and the errors of the link masses are random. The same impact
is simulated once for each setting of the monitor, at the speed that this setting allows. The table of the impacts is a
CSV file that grows with each, so that an interrupted run can be resumed.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import brentq

from scara_effmass.errors import OutputError
from scara_effmass.input_files import read_table
from scara_effmass.iso15066 import Limit, limits_for
from scara_effmass.iso15066.contact import servo_reduced_masses
from scara_effmass.model.load import load_robot
from scara_effmass.model.lumping import is_scara
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import MonitorSettings, ServoSettings
from scara_effmass.share import share
from scara_effmass.sim.plate_sim import JointServo, Peak, PlateSim
from scara_effmass.sim.recordings import EPOCH_NS
from scara_effmass.values import ContactAssessment, FloatArray, JointState, Verdict

Row = dict[str, str | int | float]
Simulate = Callable[[int], list[Row]]

CREEP_MPS = 0.006
"""Speed just above the default `speed_threshold`, below which a contact point has no direction."""
TINY = 1e-12
"""Offset of joint velocities, because the monitor takes a velocity of exactly 0 for a missing one."""
BELOW = 1.0 - 1e-9
"""Factor on the largest allowed motion that keeps rounding from exceeding it."""
BANDWIDTHS_HZ = (1.0, 2.0, 5.0, 10.0, 20.0)
DAMPING_RATIOS = (0.5, 0.7, 1.0)
FREE, COMPUTED_TORQUE, PER_JOINT = "free", "computed_torque", "per_joint"
"""Drives: free joints, or a servo, by computed torque or by a controller per joint."""
NORMALS = 24
"""Number of plate normals among which the worst one for servo drives is searched."""
MIN_LEVER = 1e-3
"""Ratio of contact point speed to joint speed [m] below which a motion is drawn again."""

_TABLES = read_table(__file__, "random_impacts.yaml")
NO_MARGINS: Mapping[str, Any] = _TABLES["no_margins"]
SETTINGS: Mapping[str, Mapping[str, Any]] = _TABLES["settings"]
"""Settings of the monitor that are compared, as changes of its defaults."""


class RobotCase(NamedTuple):
    """A robot of the comparison: file in `config`, contact points, and armature of every joint [kg m2]."""

    file: tuple[str, ...]
    contact_points: tuple[str, ...]
    armature: float = 0.0


ROBOTS = {
    name: RobotCase(tuple(case["file"]), tuple(case["contact_points"]), case.get("armature", 0.0))
    for name, case in _TABLES["robots"].items()
}
"""The robots: a SCARA, two arms with six axes and one with seven."""


class Impact(NamedTuple):
    """One random impact, and the joint velocities `qd` (n,) that each setting allows.

    `mass_factors` (n,) are the true masses behind the joints over those of the robot file. `draws` counts the motions
    drawn until one for which every setting keeps all joints within their speed limits.
    """

    robot: str
    point: int
    limit: Limit
    plate: str
    normal: FloatArray
    servo: JointServo
    drives: str
    mass_factors: FloatArray
    q: FloatArray
    qd: Mapping[str, FloatArray]
    draws: int


class MonitoredArm:
    """One robot in the monitor (Pinocchio) and in the simulation (MuJoCo)."""

    def __init__(self, path: Path, settings: MonitorSettings | None = None, armature: float = 0.0) -> None:
        """Load the robot file `path` with the contact points of `settings`; `armature` [kg m2] of every joint."""
        settings = settings or MonitorSettings()
        if armature:
            names = load_robot(path, settings).joint_names
            settings = settings.model_copy(update={"armature": tuple(f"{name}={armature}" for name in names)})
        self.dynamics = RobotDynamics(load_robot(path, settings))
        self.sim = PlateSim(path, self.dynamics)
        limits = self.dynamics.robot.model
        self.lower = np.maximum(limits.lowerPositionLimit, -math.pi)
        self.upper = np.minimum(limits.upperPositionLimit, math.pi)
        self.max_speed = limits.velocityLimit
        self._monitors: dict[MonitorSettings, Monitor] = {}

    def draw_motion(
        self, rng: np.random.Generator, point: int = 0, *, straight: bool = True
    ) -> tuple[FloatArray, FloatArray]:
        """Return a random pose (n,), and joint velocities (n,) that move contact point `point` at CREEP_MPS.

        A `straight` motion has a random direction and the smallest joint velocities for it; otherwise the joint
        velocities are random.
        """
        while True:
            q = rng.uniform(self.lower, self.upper)
            jacobian, _ = self.sim.kinematics(q, point)
            qd = np.linalg.pinv(jacobian) @ rng.normal(size=3)
            if not straight:
                qd = rng.uniform(-self.max_speed, self.max_speed)
            speed = float(np.linalg.norm(jacobian @ qd))
            if speed > MIN_LEVER * np.linalg.norm(qd):
                return q, qd * (CREEP_MPS / speed) + TINY

    def assess(
        self, q: FloatArray, qd: FloatArray, settings: MonitorSettings, point: int = 0
    ) -> ContactAssessment | str:
        """Return the monitor's assessment of contact point `point`, or its reason for UNKNOWN."""
        monitor = self._monitors.get(settings) or self._monitors.setdefault(settings, Monitor(self.dynamics, settings))
        monitor.clear_history()
        state = JointState(EPOCH_NS, self.dynamics.robot.joint_names, q, qd)
        decision = monitor.assess(state, EPOCH_NS)
        if decision is None:
            raise ValueError(f"{self.dynamics.robot.name}: the monitor does not know the joints of its own robot")
        contact = decision.contacts[point]
        return contact.reason if contact.verdict is Verdict.UNKNOWN else contact

    def allowed(self, q: FloatArray, qd: FloatArray, settings: MonitorSettings, point: int = 0) -> FloatArray | None:
        """Return `qd` (n,) scaled to the speed that the monitor allows; zeros if it allows no motion.

        None if a joint would exceed its speed limit, or if the monitor has no verdict.
        """

        def margin(scale: float) -> float:
            contact = self.assess(q, scale * qd, settings, point)
            return math.nan if isinstance(contact, str) else contact.allowable_speed - contact.speed

        fastest = float(np.min(self.max_speed / np.maximum(np.abs(qd), TINY)))
        slow, fast = margin(1.0), margin(fastest) if fastest > 1.0 else math.nan
        if slow <= 0.0:
            return np.zeros_like(qd)
        if not (slow > 0.0 > fast):
            return None
        return qd * (BELOW * float(brentq(margin, 1.0, fastest, xtol=1e-12, rtol=1e-10)))


@cache
def arm_of(robot: str) -> MonitoredArm:
    """Return the arm of ROBOTS named `robot`."""
    case = ROBOTS[robot]
    settings = MonitorSettings(contact_points=case.contact_points)
    return MonitoredArm(share("config", *case.file), settings, case.armature)


def draw_impact(seed: int, index: int) -> Impact:
    """Return random impact number `index` of the series `seed`.

    Robot, plate normal (the worst one of the pose, or a random one) and drives (free joints, or a servo) take turns. A
    motion is drawn again if a setting allows a joint to exceed its speed limit.
    """
    rng = np.random.default_rng((seed, index))
    turn, robot = divmod(index, len(ROBOTS))
    name = list(ROBOTS)[robot]
    arm = arm_of(name)
    limits = limits_for(MonitorSettings())
    bandwidth, damping = float(rng.choice(BANDWIDTHS_HZ)), float(rng.choice(DAMPING_RATIOS))
    servo = JointServo(bandwidth, damping, coupled=bool(rng.integers(2)))
    uncertainty = MonitorSettings().mass_uncertainty
    factors = rng.uniform(1.0 - uncertainty, 1.0 + uncertainty, arm.sim.n)
    drives = FREE if turn // 2 % 2 == 0 else COMPUTED_TORQUE if servo.coupled else PER_JOINT
    arm.sim.scale_masses(factors)
    draws = 0
    while True:
        draws += 1
        point = int(rng.integers(len(arm.dynamics.contact_points)))
        limit = limits[int(rng.integers(len(limits)))]
        q, creep = arm.draw_motion(rng, point, straight=bool(rng.integers(2)))
        settings = settings_of(arm.dynamics, limit.region, servo)
        qd: dict[str, FloatArray] = {}
        for setting, values in settings.items():
            motion = arm.allowed(q, creep, values, point)
            if motion is None:
                break
            qd[setting] = motion
        else:
            break
    if worst := turn % 2 == 0:
        normal = _worst_normal(arm.sim, q, creep, limit, None if drives == FREE else servo, point)
    else:
        normal = rng.normal(size=3)
        normal *= np.sign(normal @ arm.sim.kinematics(q, point)[0] @ creep) / np.linalg.norm(normal)
    plate = "worst" if worst else "random"
    return Impact(name, point, limit, plate, normal, servo, drives, factors, q, qd, draws)


def settings_of(dynamics: RobotDynamics, region: str, servo: JointServo) -> dict[str, MonitorSettings]:
    """Return SETTINGS for one body region and one servo; robots other than a SCARA have no setting `paper`."""
    values: dict[str, Any] = {
        "body_regions": (region,),
        "servo": ServoSettings(bandwidth=servo.bandwidth, damping=servo.damping, computed_torque=servo.coupled),
    }
    if not is_scara(dynamics.robot):
        values["effective_mass_model"] = "full"
    return {
        name: MonitorSettings.model_validate({**values, **changes})
        for name, changes in SETTINGS.items()
        if is_scara(dynamics.robot) or changes.get("effective_mass_model") != "lumped"
    }


def _worst_normal(
    sim: PlateSim, q: FloatArray, qd: FloatArray, limit: Limit, servo: JointServo | None, point: int
) -> FloatArray:
    """Return the unit normal (3,) along which the force is largest, in the pose of the first touch.

    With a servo it follows from the two-mass model: it is one of (A + s I)^-1 v, where s ranges from 1 / m_H, for free
    joints, to infinity, for an immovable robot.
    """
    free = sim.worst_normal(q, qd, limit.obstacle_mass_kg, point)
    if servo is None:
        return free
    jacobian, mass_matrix = sim.kinematics(q, point)
    mobility, velocity = jacobian @ np.linalg.solve(mass_matrix, jacobian.T), jacobian @ qd
    shifts = np.geomspace(
        1.0 / limit.obstacle_mass_kg, 1e3 * (np.trace(mobility) + 1.0 / limit.obstacle_mass_kg), NORMALS
    )
    normals = np.linalg.solve(mobility + shifts[:, None, None] * np.eye(3), velocity[:, None])[:, :, 0]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    mu = servo_reduced_masses(
        np.einsum("ni,ij,nj->n", normals, mobility, normals),
        np.array([limit.stiffness_n_m]),
        np.array([limit.obstacle_mass_kg]),
        servo.bandwidth,
        servo.damping,
    )[0]
    return np.asarray(normals[np.argmax((normals @ velocity) ** 2 * mu)])


def simulate(seed: int, index: int) -> list[Row]:
    """Return a row for each setting of random impact number `index`; names hold the units, vectors are text."""
    impact = draw_impact(seed, index)
    arm, servo = arm_of(impact.robot), impact.servo
    jacobian, _ = arm.sim.kinematics(impact.q, impact.point)
    rows: list[Row] = []
    for setting, qd in impact.qd.items():
        peak = Peak(0.0, 0.0, 0.0)
        if qd.any():
            peak = arm.sim.touch(
                impact.q, qd, impact.normal, impact.limit, None if impact.drives == FREE else servo, impact.point
            )
        rows.append(
            {
                "index": index,
                "robot": impact.robot,
                "contact_point": arm.dynamics.contact_points[impact.point],
                "region": impact.limit.region,
                "plate": impact.plate,
                "drives": impact.drives,
                "bandwidth_hz": servo.bandwidth,
                "damping": servo.damping,
                "draws": impact.draws,
                "setting": setting,
                "allowable_speed_m_s": float(np.linalg.norm(jacobian @ qd)),
                "limit_n": impact.limit.permissible_force_n,
                "peak_n": peak.force,
                "ratio": peak.force / impact.limit.permissible_force_n,
                "time_to_peak_s": peak.time,
                "turn_to_peak": peak.turn,
                "normal": _text(impact.normal),
                "mass_factors": _text(impact.mass_factors),
                "q": _text(impact.q),
                "qd": _text(qd),
            }
        )
    return rows


def _text(vector: FloatArray) -> str:
    return " ".join(map(repr, vector.tolist()))


def extend_table(
    path: Path,
    seed: int,
    impacts: int,
    run: Callable[[Simulate, Sequence[int]], Iterable[list[Row]]] = map,
) -> Iterator[int]:
    """Append random impacts of the series `seed` to the CSV file `path` until it has `impacts`; yield their number.

    The last impact of an existing table is simulated again and must give the same rows, so that the result is that of a
    run without interruption. `run` simulates impacts by their numbers and yields their rows in that order. Raises
    OutputError if the table has another seed or version, or cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a+", encoding="utf-8", errors="replace", newline="\n") as file:
            file.seek(0)
            text = file.read()
            lines = [line for line in text.splitlines(keepends=True) if line.endswith("\n")]
            number = lines[-1].partition(",")[0] if lines else ""
            last = int(number) if number.isdecimal() else 0
            kept = [line for line in lines if not line.startswith(f"{last},")]
            rows = simulate(seed, last)
            header, again = ",".join(rows[0]) + "\n", _lines(rows)
            is_same = lines[:1] == [header] and again.startswith("".join(lines[len(kept) :]))
            if not (is_same or header.startswith(text)):
                raise OutputError(f"{path}: must be of this seed and version; choose another folder, or use --force")
            file.truncate(sum(map(len, kept)))
            file.write(again if kept else header + again)
            file.flush()
            yield last + 1
            for index, rows in enumerate(run(partial(simulate, seed), range(last + 1, impacts)), start=last + 1):
                file.write(_lines(rows))
                file.flush()
                yield index + 1
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from None


def _lines(rows: Iterable[Row]) -> str:
    return "".join(",".join(map(str, row.values())) + "\n" for row in rows)
