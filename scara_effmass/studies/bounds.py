# SPDX-License-Identifier: Apache-2.0
"""The force bounds of the verdict against an independent simulation; docs/validity.md joins its tables.

    python -m scara_effmass.studies.bounds [--poses 200] [--seed 1]

Each of the --poses contacts in a row begins at exactly the speed that the monitor allows for that region, all margins
0. The simulation is that of `scara-effmass evidence`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache, lru_cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table
from scipy.optimize import brentq, linprog

from scara_effmass.codes import Reason
from scara_effmass.input_files import read_table
from scara_effmass.iso15066 import Limit, limits_for
from scara_effmass.iso15066.contact import MAX_TURN, turn_until_peak
from scara_effmass.kernel.state import CODE
from scara_effmass.model.load import load_robot
from scara_effmass.model.lumping import is_scara
from scara_effmass.reference import RobotDynamics
from scara_effmass.safety import Monitor
from scara_effmass.settings import WHOLE_ARM, MassModel, MonitorSettings, ServoSettings
from scara_effmass.share import share
from scara_effmass.sim.plate_sim import AT_REST, PlateSim, Surface
from scara_effmass.studies import arguments_of
from scara_effmass.values import FloatArray, Verdict

SMALL_TURN = 0.02
"""Turn of the joints [rad, m] until the peak that hardly changes the effective mass."""
HELD = 1e-4
"""Pace at which the arm stays in the pose of the first touch."""
CREEP_MPS = 0.006
"""Speed just above the default `speed_threshold`, below which a contact point has no direction."""
TINY = 1e-12
"""Offset of joint velocities, because the monitor takes a velocity of exactly 0 for a missing one."""
BELOW = 1.0 - 1e-9
"""Factor on the largest allowed motion that keeps rounding from exceeding it."""
MIN_LEVER = 1e-3
"""Ratio of contact point speed to joint speed [m] below which a motion is drawn again."""

CONCENTRATION = 0.2
"""Of the Dirichlet distribution of the weights of a link's vertices at a random place."""

TABLES = read_table(__file__, "bounds.yaml")
ROBOTS: Mapping[str, Mapping[str, Any]] = TABLES["robots"]
"""A SCARA, two arms with six axes and one with seven."""
RANDOM_ARM = "random arm "
RANDOM_CASE: Mapping[str, Any] = {"contact_points": ("tip", "wrist=link2")}
RANDOM_ARMS = 40
MIN_AXES, MAX_AXES = 3, 7
MAX_SPEED = 3.0
"""Speed limit of each joint of a random arm [rad/s]."""
SERIES = 7
"""Keeps the random numbers of arms apart from those of impacts."""
GRAVITY = 9.81
MAX_MONITORS = 50
"""Number of monitors with different settings that an arm keeps."""
NO_MARGINS: Mapping[str, Any] = TABLES["no_margins"]


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
        self.monitor = lru_cache(MAX_MONITORS)(partial(Monitor, self.dynamics))
        """Return a monitor of this robot with the settings."""

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

    def accelerations(
        self, rng: np.random.Generator, q: FloatArray, point: int = 0, acceleration: float = 0.0
    ) -> FloatArray:
        """Return joint accelerations (n,) that give the contact point `acceleration` [m/s2] in a random direction.

        Near singular poses it is less, so that no joint accelerates beyond all bounds.
        """
        direction = rng.normal(size=3)
        jacobian, _ = self.sim.kinematics(q, point)
        wanted = direction * (acceleration / float(np.linalg.norm(direction)))
        return np.asarray(np.linalg.pinv(jacobian, rcond=0.1) @ wanted)

    def plate_normal(
        self,
        plate: str,
        q: FloatArray,
        qd: FloatArray,
        limit: Limit,
        rng: np.random.Generator,
        servo: ServoSettings | None = None,
        point: int = 0,
        person: FloatArray = AT_REST,
    ) -> FloatArray:
        """Return the unit normal (3,) of a `plate` at the worst angle, across the velocity, or at a random angle.

        The velocity is that relative to a `person` (3,) [m/s].
        """
        if plate == "worst":
            return self.sim.worst_normal(q, qd, limit, servo, point, person)
        velocity = self.sim.kinematics(q, point)[0] @ qd - person
        normal = velocity if plate == "velocity" else rng.normal(size=3)
        return np.asarray(normal * (np.sign(normal @ velocity) / np.linalg.norm(normal)))

    def links(self) -> list[int]:
        """Return the numbers of the contact points that are links as a whole."""
        return [number for number, contact in enumerate(self.dynamics.contacts) if len(contact.vertices)]

    def random_place(self, rng: np.random.Generator, link: int) -> FloatArray:
        """Return a random place (3,) [m] in the hull of contact point number `link`, in its frame.

        It is the mean of the vertices with random weights, often near a corner or an edge.
        """
        contact = self.dynamics.contacts[link]
        weights = rng.dirichlet(np.full(len(contact.vertices), CONCENTRATION))
        return np.asarray(self.dynamics.robot.model.frames[contact.frame].placement.actInv(weights @ contact.vertices))

    def allowed(
        self,
        q: FloatArray,
        qd: FloatArray,
        settings: MonitorSettings,
        point: int = 0,
        qdd: FloatArray | None = None,
    ) -> FloatArray | None:
        """Return `qd` (n,) scaled to the speed that the monitor allows; zeros if it allows no motion.

        The joints accelerate with `qdd` (n,), None for not at all. None if a joint would exceed its speed limit, if the
        monitor has no verdict, or if it says that the force is not computed for such an acceleration.
        """
        monitor = self.monitor(settings)

        def margin(scale: float) -> float:
            """Return allowed minus actual speed [m/s]; NaN without a verdict."""
            contact = monitor.assess_configurations(q[None], scale * qd[None], qdd).contacts[0, point]
            is_not_covered = contact["verdict"] == Verdict.UNKNOWN or contact["reason"][CODE] == Reason.TURNS
            return math.nan if is_not_covered else float(contact["allowable_speed"] - contact["speed"])

        fastest = float(np.min(self.max_speed / np.maximum(np.abs(qd), TINY)))
        slow, fast = margin(1.0), margin(fastest) if fastest > 1.0 else math.nan
        if slow <= 0.0:
            return np.zeros_like(qd)
        if not (slow > 0.0 > fast):
            return None
        return qd * (BELOW * float(brentq(margin, 1.0, fastest, xtol=1e-12, rtol=1e-10)))


@cache
def arm_of(robot: str, *, is_whole: bool = False) -> MonitoredArm:
    """Return the arm of ROBOTS named `robot`, or "random arm N", with a few contact points.

    `is_whole`: each moving link is watched as a whole, and boxes stand for its meshes.
    """
    case = ROBOTS.get(robot, RANDOM_CASE)
    settings = MonitorSettings(contact_points=(WHOLE_ARM,) if is_whole else tuple(case["contact_points"]))
    armature = case.get("armature", 0.0)
    if robot in ROBOTS and not (is_whole and "boxes" in case):
        return MonitoredArm(share("config", *case["file"]), settings, armature)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        text = _with_boxes(case) if robot in ROBOTS else random_arm(int(robot.removeprefix(RANDOM_ARM)))
        path.write_text(text, encoding="utf-8")
        return MonitoredArm(path, settings, armature)


def random_arm(seed: int) -> str:
    """Return the URDF of arm number `seed`: 3 to 7 revolute axes along x, y or z, no two in a row the same.

    Links are boxes, 0.1 to 0.4 m long, and weigh 6 kg at the base to 1 kg at the tip, each times 0.5 to 2. Gravity
    cannot exceed the effort limits.
    """
    rng = np.random.default_rng((SERIES, seed))
    axes = int(rng.integers(MIN_AXES, MAX_AXES + 1))
    lengths = rng.uniform(0.1, 0.4, axes + 1)
    masses = np.linspace(6.0, 1.0, axes) * rng.uniform(0.5, 2.0, axes)
    spans = [np.array([0.0, 0.0, lengths[0]])]
    for length in lengths[1:]:
        direction = rng.normal(size=3)
        spans.append(direction * (length / np.linalg.norm(direction)))
    text, axis, parent = '<robot name="random_arm">\n  <link name="base"/>\n', 2, "base"
    for i in range(axes):
        span, thickness = spans[i + 1], float(rng.uniform(0.04, 0.1))
        size = np.abs(span) + thickness
        squares = np.square(size)
        ixx, iyy, izz = (masses[i] / 12.0 * (squares.sum() - squares)).tolist()
        link, com = f"link{i + 1}", _xyz(0.5 * span)
        effort = GRAVITY * float(masses[i:].sum() * lengths[i + 1 :].sum())
        text += f"""  <link name="{link}"><inertial>
    <origin xyz="{com}"/><mass value="{masses[i]:.6f}"/>
    <inertia ixx="{ixx:.6f}" iyy="{iyy:.6f}" izz="{izz:.6f}" ixy="0" ixz="0" iyz="0"/>
  </inertial><collision><origin xyz="{com}"/><geometry><box size="{_xyz(size)}"/></geometry></collision></link>
  <joint name="joint{i + 1}" type="revolute">
    <parent link="{parent}"/><child link="{link}"/><origin xyz="{_xyz(spans[i])}"/><axis xyz="{_xyz(np.eye(3)[axis])}"/>
    <limit lower="-2.9" upper="2.9" velocity="{MAX_SPEED}" effort="{effort:.3f}"/>
    <dynamics armature="{rng.uniform(0.0, 0.1):.4f}"/>
  </joint>
"""
        axis, parent = (axis + int(rng.integers(1, 3))) % 3, link
    return f"""{text}  <link name="tip"/>
  <joint name="tip_joint" type="fixed">
    <parent link="{parent}"/><child link="tip"/><origin xyz="{_xyz(spans[-1])}"/>
  </joint>
</robot>
"""


def _xyz(vector: FloatArray) -> str:
    return " ".join(f"{number:.6f}" for number in vector)


def _with_boxes(case: Mapping[str, Any]) -> str:
    """Return the URDF of one of ROBOTS with boxes in place of its meshes."""
    root = ET.parse(share("config", *case["file"])).getroot()  # noqa: S314 - a shipped file
    for link in root.findall("link"):
        if link.get("name") in case["boxes"]:
            for mesh in [*link.findall("visual"), *link.findall("collision")]:
                link.remove(mesh)
            center, size = (" ".join(map(str, vector)) for vector in case["boxes"][link.get("name")])
            collision = ET.SubElement(link, "collision")
            ET.SubElement(collision, "origin", xyz=center)
            ET.SubElement(ET.SubElement(collision, "geometry"), "box", size=size)
    return ET.tostring(root, encoding="unicode")


def settings_for(region: str = "", **settings: object) -> MonitorSettings:
    """Return `settings` of the monitor without margins, with the full model and one `region`, all if empty."""
    regions = [region] if region else []
    return MonitorSettings.model_validate(
        {**NO_MARGINS, "effective_mass_model": "full", "body_regions": regions, **settings}
    )


def draw(
    arm: MonitoredArm, rng: np.random.Generator, settings: MonitorSettings, acceleration: float = 0.0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return a random pose (n,), the joint velocities (n,) of a random motion, at the allowed speed, and accelerations.

    Those (n,) accelerate the contact point at rest with `acceleration` [m/s2], in a random direction.
    """
    while True:
        q, creep = arm.draw_motion(rng)
        qdd = arm.accelerations(rng, q, acceleration=acceleration) if acceleration else np.zeros_like(q)
        qd = arm.allowed(q, creep, settings, qdd=qdd)
        if qd is not None and qd.any():
            return q, qd, qdd


def contacts(
    arm: MonitoredArm,
    region: str,
    count: int,
    rng: np.random.Generator,
    *,
    pushing: ServoSettings | None = None,
    plate: str = "worst",
    pace: float = 1.0,
    acceleration: float = 0.0,
    **settings: object,
) -> FloatArray:
    """Return the peak force over the limit and the turn of the joints [rad, m] of contacts at the allowed speed.

    Shape (count, 2). The contact point accelerates as in `draw`; damping and friction are those of the settings. The
    `plate` is at the worst angle for free joints, across the velocity, or at a random angle.
    """
    checked = settings_for(region, **settings)
    (limit,) = limits_for(checked)
    results = []
    for _ in range(count):
        q, qd, qdd = draw(arm, rng, checked, acceleration)
        normal = arm.plate_normal(plate, q, qd, limit, rng)
        surface = Surface(checked.contact_damping, checked.contact_friction)
        peak = arm.sim.touch(q, qd, normal, limit, pushing, pace=pace, qdd=qdd, surface=surface)
        results.append((peak.force / limit.permissible_force_n, peak.turn))
    return np.array(results)


def any_arm(rng: np.random.Generator) -> MonitoredArm:
    """Return an arm of ROBOTS or, as often, a random one, with the masses of its file."""
    name = f"{RANDOM_ARM}{rng.integers(RANDOM_ARMS)}" if rng.integers(2) else [*ROBOTS][rng.integers(len(ROBOTS))]
    arm = arm_of(name)
    arm.sim.scale_masses(np.ones(arm.sim.n))
    return arm


def random_contacts(count: int, rng: np.random.Generator) -> FloatArray:
    """Return the peak force over the limit (count,) with free joints, all margins 0, and the worst plates.

    Robot (every other one a random arm), contact point, region, pose and all joint velocities are random.
    """
    regions = [limit.region for limit in limits_for(settings_for())]
    ratios: list[float] = []
    while len(ratios) < count:
        arm, settings = any_arm(rng), settings_for(regions[rng.integers(len(regions))])
        point = int(rng.integers(len(arm.dynamics.contact_points)))
        q, creep = arm.draw_motion(rng, point, straight=False)
        qd = arm.allowed(q, creep, settings, point)
        if qd is not None and qd.any():
            (limit,) = limits_for(settings)
            normal = arm.sim.worst_normal(q, qd, limit, None, point)
            ratios.append(arm.sim.touch(q, qd, normal, limit, None, point).force / limit.permissible_force_n)
    return np.array(ratios)


def turning_contacts(count: int, rng: np.random.Generator) -> FloatArray:
    """Return the peak force over the limit (count,) of the abdomen where joints accelerate as far as MAX_TURN allows.

    Those with short levers accelerate most, because the others change the contact point's speed. Robot, pose, motion
    and drives (free, or a servo of 1 to 20 Hz) are random; the plate has the worst normal, and the margins are on.
    """
    ratios: list[float] = []
    while len(ratios) < count:
        arm, point = any_arm(rng), 0
        servo = ServoSettings(bandwidth=float(rng.choice((1.0, 5.0, 20.0))), computed_torque=bool(rng.integers(2)))
        model = MassModel.AUTO if is_scara(arm.dynamics.robot) else MassModel.FULL
        settings = MonitorSettings(body_regions=("abdomen",), servo=servo, effective_mass_model=model)
        (limit,) = limits_for(settings)
        q, creep = arm.draw_motion(rng, point, straight=bool(rng.integers(2)))
        levers = np.linalg.norm(arm.sim.kinematics(q, point)[0], axis=0)
        turns = rng.normal(size=arm.sim.n) / np.maximum(levers, 0.02 * levers.max()) * rng.integers(2, size=arm.sim.n)
        if not turns.any():
            continue
        turns *= rng.uniform(0.2, 1.0) * MAX_TURN / np.max(np.abs(turns))
        qdd = turns / turn_until_peak(1.0, limit.body_mass_kg, limit.stiffness_n_m)
        qd = arm.allowed(q, creep, settings, point, qdd)
        if qd is not None and qd.any():
            pushing = servo if rng.integers(2) else None
            normal = arm.sim.worst_normal(q, qd, limit, pushing, point)
            peak = arm.sim.touch(q, qd, normal, limit, pushing, point, qdd=qdd)
            ratios.append(peak.force / limit.permissible_force_n)
    return np.array(ratios)


def force_parts(
    arm: MonitoredArm, count: int, rng: np.random.Generator, servo: ServoSettings, **settings: object
) -> FloatArray:
    """Return (count, 4) [N] of contacts of the chest at the speed that the defaults allow with a `servo`.

    The simulated peak, and what is added by the bound of the servo and the change of pose, by `mass_uncertainty`, and
    by the tolerances of the velocities; the sum is the limit, or the force at which a joint saturates.
    """
    values = {"effective_mass_model": "full", "body_regions": ("chest",), "servo": servo, **settings}
    defaults = MonitorSettings.model_validate(values)
    margins = {name: value for name, value in NO_MARGINS.items() if name != "drives"}
    kinds = {**values, **margins}, {**values, **margins, "mass_uncertainty": defaults.mass_uncertainty}, values
    (limit,) = limits_for(defaults)
    parts: list[FloatArray] = []
    while len(parts) < count:
        q, qd, _ = draw(arm, rng, defaults)
        peak = arm.sim.touch(q, qd, arm.plate_normal("worst", q, qd, limit, rng, servo), limit, servo).force
        monitors = [arm.monitor(MonitorSettings.model_validate(kind)) for kind in kinds]
        bounds = [float(m.assess_configurations(q[None], qd[None]).contacts[0, 0]["force_bound"]) for m in monitors]
        parts.append(np.diff([0.0, peak, *bounds]))
    return np.array(parts)


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


def parts_table(arms: Mapping[str, MonitoredArm], count: int, seed: int) -> Table:
    """Return the table of `force_parts`, of `count` contacts each."""
    table = Table("arm", "servo", "limit", "simulated", "servo and pose", "mass", "velocity", box=box.MARKDOWN)
    for name, arm in arms.items():
        for is_coupled, label in ((False, "a controller per joint"), (True, "computed torque")):
            servo = ServoSettings(computed_torque=is_coupled)
            parts = force_parts(arm, count, np.random.default_rng(seed), servo)
            medians = (f"{part:.0f}" for part in np.median(parts, axis=0))
            table.add_row(name, label, f"{np.median(parts.sum(axis=1)):.0f}", *medians)
    return table


def main() -> None:
    """Run the sweeps and print the tables."""
    args = arguments_of(__doc__, poses=200)
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
    ratio = random_contacts(20 * args.poses, np.random.default_rng(args.seed))
    above = f"{100.0 * np.mean(ratio > 1.0):.2f} % above 1, {100.0 * np.mean(ratio > 1.002):.2f} % above 1.002"
    console.print(
        f"random arms, too, and random joint velocities: {len(ratio)} contacts, {above}, max {ratio.max():.4f}"
    )
    ratio = turning_contacts(5 * args.poses, np.random.default_rng(args.seed))
    above = f"{100.0 * np.mean(ratio > 1.0):.2f} % above 1"
    turning = f"joints turn up to {MAX_TURN:g} rad further by accelerating"
    console.print(f"{turning}: {len(ratio)} contacts, {above}, max {ratio.max():.4f}")
    console.print("## Drives push on for 0.5 s")
    table = Table("arm", "bandwidth", "region", "drives", *columns, box=box.MARKDOWN)
    count = max(args.poses // 8, 1)
    for name, arm in arms.items():
        for bandwidth in (1.0, 5.0, 20.0):
            for region in ("abdomen", "chest", "lower_leg"):
                for drives in ("servo", "free"):
                    servo = ServoSettings(bandwidth=bandwidth, computed_torque=True)
                    labels = (name, f"{bandwidth:g} Hz", region, drives)
                    row(table, labels, arm, region, count, pushing=servo, drives=drives, servo=servo)
    console.print(table)
    console.print("## Parts of the bound at the allowed speed, chest, servo of 5 Hz: medians [N]")
    console.print(parts_table(arms, count, args.seed))
    ur5, forces = arms["UR5"], []
    for _ in range(args.poses):
        q, qd, _ = draw(ur5, rng, settings_for())
        velocity = ur5.sim.kinematics(q)[0] @ qd
        forces.append(clamping_force(ur5, q, velocity / np.linalg.norm(velocity)))
    quartiles = ", ".join(f"{force:.0f}" for force in np.percentile(forces, (5, 50, 95)))
    console.print(f"UR5, clamping force along the velocity, percentiles 5, 50, 95: {quartiles} N")


if __name__ == "__main__":
    main()
