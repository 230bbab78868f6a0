# SPDX-License-Identifier: Apache-2.0
"""One impact of the paper's experiment: the robot hits the waiting cart in the middle of a straight path.

The robot follows its planned path after the impact, so it often catches up with the cart and hits it again, weaker.
"""

import math
import random
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from scara_effmass.errors import SettingsError
from scara_effmass.iso15066 import reduced_mass
from scara_effmass.share import share
from scara_effmass.sim.cart import POLYETHYLENE, Cart, SpringContact
from scara_effmass.sim.collision_sim import (
    CONTROL_PERIOD_NS,
    FINE_STEP_NS,
    CollisionSim,
    ContactSample,
    TrueContact,
    find_contacts,
)
from scara_effmass.sim.controller import CONTROL_RATE_HZ, DEFAULT_GAINS, EncoderReading, JointController, ServoGains
from scara_effmass.sim.measurement import FORCE_SENSOR, ForceSensor, measure_force, quantize
from scara_effmass.sim.motion import (
    ElbowConfig,
    LinearMove,
    QuinticScaling,
    TrapezoidalScaling,
    joint_positions_at,
    sample_moves,
)
from scara_effmass.sim.recordings import EPOCH_NS
from scara_effmass.values import ForceBlock, JointState, RunInfo, Vector3

ROBOT = ("config", "omron_i4_550l.yaml")
PATH_M = 0.2
ACCELERATION = 2.5
"""Length and acceleration [m/s2] of the path, chosen here, as in the reference recordings."""
Q3 = 0.236
"""Position of the quill [m], from the paper."""
SPEED = 0.25
"""Nominal speed of the impact [m/s], from the paper."""
DWELL_S = 0.3
"""Rest before and after the path."""
MIN_CONTACT_STEPS = 40
"""Fewest simulation steps in a contact; the peak is then 0.1 % off."""
MAX_SPEED_LOSS = 0.1
"""Largest share of the closing speed that damping may take in one step."""
_ENCODER_STREAM = 5


@dataclass(frozen=True, slots=True)
class Configuration:
    """Impact `point` x, y [m], elbow configuration, and `heading` of the path from the x axis [rad]."""

    name: str
    point: tuple[float, float]
    elbow_config: ElbowConfig = ElbowConfig.RIGHT
    heading: float = 0.0

    @property
    def direction(self) -> Vector3:
        """Unit vector along the path."""
        return (math.cos(self.heading), math.sin(self.heading), 0.0)

    def path_point(self, distance: float) -> tuple[float, float]:
        """Return x, y [m] of the path `distance` [m] behind the impact point."""
        x, y, _ = self.direction
        return self.point[0] + distance * x, self.point[1] + distance * y


CONFIGURATIONS = (
    Configuration("300_200", (0.3, 0.2)),
    Configuration("300_0", (0.3, 0.0)),
    Configuration("300_-200", (0.3, -0.2)),
)
"""Ordered from light to heavy. Only (300, 200) mm is in the text of the paper; the other two are chosen here."""
OBSTACLE_MASSES = (0.50, 2.39, 3.72, 7.35)
"""Masses of the paper's cart [kg]."""


@dataclass(frozen=True, slots=True)
class ImpactSetup:
    """All parameters of one run. Raises SettingsError if the path is too short for `speed` [m/s].

    The tip is `offset` [m] along the path behind the impact point; the robot rests for `dwell` [s] before and after
    the path. `surface` is the unit normal of the plate; None stands for the direction of the path. `seed` sets the
    noise of encoders and stamps; the sensor has a seed of its own.
    """

    configuration: Configuration
    obstacle_mass: float
    speed: float = SPEED
    contact: SpringContact = POLYETHYLENE
    servo: ServoGains = DEFAULT_GAINS
    sensor: ForceSensor = FORCE_SENSOR
    offset: float = 0.0
    dwell: float = DWELL_S
    surface: Vector3 | None = None
    seed: int = 0
    start_ns: int = EPOCH_NS

    def __post_init__(self) -> None:
        max_speed = math.sqrt(PATH_M * ACCELERATION)
        if not 0.0 < self.speed < max_speed:
            raise SettingsError(f"speed = {self.speed}: must be > 0 and < {max_speed:.3f} m/s")

    @property
    def cart(self) -> Cart:
        """The cart at rest."""
        configuration = self.configuration
        tip = (*configuration.path_point(self.offset), -Q3)
        return Cart(tip, configuration.direction, self.obstacle_mass, surface=self.surface)

    @property
    def moves(self) -> tuple[LinearMove, LinearMove, LinearMove]:
        """Dwell, path with the impact in its middle, dwell."""
        start, end = (self.configuration.path_point(side * PATH_M / 2.0) for side in (-1.0, 1.0))
        elbow_config, dwell = self.configuration.elbow_config, QuinticScaling(self.dwell)
        path = TrapezoidalScaling(length=PATH_M, speed=self.speed, acceleration=ACCELERATION)
        return (
            LinearMove(start, start, elbow_config, Q3, dwell),
            LinearMove(start, end, elbow_config, Q3, path),
            LinearMove(end, end, elbow_config, Q3, dwell),
        )

    def run_info(self, note: str) -> RunInfo:
        """Return the run information, without the ground truth."""
        return RunInfo(
            stamp_ns=self.start_ns,
            frame_id="base_link",
            configuration=self.configuration.name,
            obstacle_mass=self.obstacle_mass,
            impact_position=(*self.configuration.point, -Q3),
            plate_normal=self.cart.normal,
            guide_direction=self.configuration.direction,
            simulated=True,
            note=note,
            contact_stiffness=self.contact.stiffness,
            contact_exponent=self.contact.exponent,
        )


class ImpactRun(NamedTuple):
    """A run as the suite would record it, with its ground truth; all stamps are ROS time.

    The true `contacts` begin with the impact. `effective_mass` [kg] is that of the robot at the onset along the normal
    of the plate, by MuJoCo; `reduced_mass` [kg] is that of robot and cart.
    """

    setup: ImpactSetup
    joint_states: tuple[JointState, ...]
    force_blocks: tuple[ForceBlock, ...]
    contacts: tuple[TrueContact, ...]
    effective_mass: float
    reduced_mass: float

    @property
    def impact(self) -> TrueContact:
        """The first contact."""
        return self.contacts[0]


def build_sim(setup: ImpactSetup) -> tuple[CollisionSim, JointController]:
    """Return simulation and controller of a run: the robot at rest at the impact point, the cart not yet placed.

    Raises SettingsError if the contact is too short or too damped for the simulation step.
    """
    sim = CollisionSim(share(*ROBOT), setup.cart, setup.contact)
    q = joint_positions_at(setup.configuration.point, setup.configuration.elbow_config, Q3)
    sim.set_state(np.array(q), np.zeros(len(q)))
    _, mu = _masses(sim)
    _, duration_s = setup.contact.free_impact(setup.speed, mu)
    if not duration_s > (min_s := MIN_CONTACT_STEPS * FINE_STEP_NS / 1e9):
        raise SettingsError(
            f"stiffness = {setup.contact.stiffness:g}: the contact lasts {duration_s * 1e3:.2f} ms:"
            f" must be > {min_s * 1e3:g} ms; reduce the stiffness"
        )
    if not setup.contact.damping <= (max_damping := MAX_SPEED_LOSS * mu * 1e9 / FINE_STEP_NS):
        raise SettingsError(f"damping = {setup.contact.damping:g}: must be <= {max_damping:.0f} N s/m")
    return sim, JointController(sim, setup.servo)


def run_impact(setup: ImpactSetup) -> ImpactRun:
    """Simulate one run. Raises SettingsError as `build_sim` does, and if the robot misses the cart."""
    sim, controller = build_sim(setup)
    q, qd = sample_moves(setup.moves, CONTROL_RATE_HZ)
    sim.set_state(q[0], np.zeros_like(q[0]))
    sim.place_cart()
    readings: list[EncoderReading] = []
    samples: list[ContactSample] = []
    for reading, contact in controller.follow(q, qd):
        readings.append(reading)
        samples += contact
    contacts = find_contacts(samples)
    if not contacts:
        raise SettingsError(f"offset = {setup.offset}: the cart is not hit: must be within the path")
    noise = random.Random(f"{setup.seed} {_ENCODER_STREAM}")  # noqa: S311 - noise, no secret
    positions, velocities = map(np.array, zip(*readings, strict=True))
    rows = enumerate(zip(*quantize(positions, velocities, noise), strict=True))
    force_blocks = measure_force(samples, setup.start_ns, sim.time_ns, setup.sensor, setup.seed)
    # The masses are those at the onset of the impact.
    index, rest_ns = divmod(contacts[0].onset_ns, CONTROL_PERIOD_NS)
    sim.set_state(positions[index] + velocities[index] * rest_ns / 1e9, velocities[index])
    return ImpactRun(
        setup,
        tuple(JointState(setup.start_ns + i * CONTROL_PERIOD_NS, sim.joints, *row) for i, row in rows),
        force_blocks,
        tuple(contact._replace(onset_ns=contact.onset_ns + setup.start_ns) for contact in contacts),
        *_masses(sim),
    )


def _masses(sim: CollisionSim) -> tuple[float, float]:
    """Return effective and reduced mass [kg] along the normal of the plate in the current state.

    The guide lets the cart move along the path only: along the normal its mass is m_H / cos^2 of the angle between
    path and normal.
    """
    normal = np.array(sim.cart.normal)
    effective_mass = sim.effective_mass(normal)
    cosine = float(normal @ np.array(sim.cart.direction))
    obstacle_mass = sim.cart.mass / cosine**2 if cosine else math.inf
    return effective_mass, reduced_mass(effective_mass, obstacle_mass)
