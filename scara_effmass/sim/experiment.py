# SPDX-License-Identifier: Apache-2.0
"""The paper's experiment: the robot hits the waiting cart in the middle of a straight path.

`run_impact` simulates one impact, `LiveSim` one after the other. The robot follows its planned path after an impact, so
it often catches up with the cart and hits it again, weaker. Its controller is a servo per joint along the path, with
feed-forward torques:

    tau = tau_plan + K (q_plan - q) + D (qd_plan - qd)        K = I w^2,  D = 2 zeta w I

I is the inertia that the joint's drive sees at the point of impact, w the bandwidth. The controller reads the encoders
once per control period and holds the torque until the next one.
"""

import math
import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import cycle, product
from typing import NamedTuple, final

import numpy as np

from scara_effmass.errors import SettingsError
from scara_effmass.iso15066 import reduced_mass
from scara_effmass.share import share
from scara_effmass.sim.collision_sim import (
    CONTROL_PERIOD_NS,
    FINE_STEP_NS,
    GRAVITY,
    GUIDE,
    POLYETHYLENE,
    Cart,
    CollisionSim,
    ContactSample,
    SpringContact,
    TrueContact,
    find_contacts,
)
from scara_effmass.sim.measurement import FORCE_SENSOR, Adc, ForceSensor, measure_force, quantize, read_torque
from scara_effmass.sim.motion import (
    ElbowConfig,
    LinearMove,
    QuinticScaling,
    TrapezoidalScaling,
    joint_positions_at,
    sample_moves,
)
from scara_effmass.sim.recordings import EPOCH_NS, JOINTS
from scara_effmass.values import FloatArray, ForceBlock, JointState, RunInfo, Vector3

CONTROL_RATE_HZ = 1e9 / CONTROL_PERIOD_NS
VELOCITY_TIME_CONSTANT_S = 1e-3
"""Time constant of the low-pass filter for the joint velocities."""
BANDWIDTH_HZ, DAMPING_RATIO = 5.0, 0.7
"""Servo of each joint; it has little effect during a contact of a few milliseconds."""
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
FORCE_PERIODS = 10
"""Control periods per portion of force samples."""
FIRST_DWELL_S = 2.0
"""Rest before the first impact: a force node needs one to two seconds to estimate the converter clock."""
QUINTIC_PEAK = 1.875
"""Peak speed of a quintic move over its mean speed."""


ControlPeriod = tuple[FloatArray, FloatArray, FloatArray, list[ContactSample]]
"""Joint positions, the controller's velocity estimates and torques (n,) at its start, before rounding; the contact."""


@final
class JointController:
    """Move the robot of a simulation along trajectories."""

    def __init__(self, sim: CollisionSim) -> None:
        """Start from the robot's current state, which sets the inertias I of the gains. The motors carry the weight."""
        sim.model.opt.gravity[2] = GRAVITY
        inertias = sim.joint_inertias()
        omega = 2.0 * math.pi * BANDWIDTH_HZ
        self._sim = sim
        self._stiffness = inertias * omega**2
        self._damping = inertias * 2.0 * DAMPING_RATIO * omega
        self._weight = 1.0 - math.exp(-1.0 / (CONTROL_RATE_HZ * VELOCITY_TIME_CONSTANT_S))
        self._velocity = sim.qd

    def follow(self, q: FloatArray, qd: FloatArray) -> Iterator[ControlPeriod]:
        """Follow positions and velocities (m, n), one row per control period; yield each period after it."""
        qdd = np.gradient(qd, 1.0 / CONTROL_RATE_HZ, axis=0)
        for q_plan, qd_plan, planned in zip(q, qd, self._sim.inverse_dynamics(q, qd, qdd), strict=True):
            position = self._sim.q
            self._velocity = self._velocity + self._weight * (self._sim.qd - self._velocity)
            torque = planned + self._stiffness * (q_plan - position) + self._damping * (qd_plan - self._velocity)
            yield position, self._velocity, torque, self._sim.advance(torque)


@dataclass(frozen=True, slots=True)
class Configuration:
    """Impact `point` x, y [m] of the right arm, on a path along x."""

    name: str
    point: tuple[float, float]

    def path_point(self, distance: float) -> tuple[float, float]:
        """Return x, y [m] of the path `distance` [m] behind the impact point."""
        return self.point[0] + distance, self.point[1]


CONFIGURATIONS = (
    Configuration("300_200", (0.3, 0.2)),
    Configuration("300_0", (0.3, 0.0)),
    Configuration("300_-200", (0.3, -0.2)),
)
"""Ordered from light to heavy. Only (300, 200) mm is in the text of the paper; the other two are chosen here."""
OBSTACLE_MASSES = (0.50, 2.39, 3.72, 7.35)
"""Masses of the paper's cart [kg]."""
IMPACTS = tuple(product(CONFIGURATIONS, OBSTACLE_MASSES))


@dataclass(frozen=True, slots=True)
class ImpactSetup:
    """All parameters of one run.

    The tip is `offset` [m] along the path behind the impact point; the robot rests for `dwell` [s] before and after
    the path. `surface` is the unit normal of the plate. `seed` sets the noise of encoders and stamps; the sensor has a
    seed of its own.
    """

    configuration: Configuration
    obstacle_mass: float
    speed: float = SPEED
    contact: SpringContact = POLYETHYLENE
    sensor: ForceSensor = FORCE_SENSOR
    offset: float = 0.0
    dwell: float = DWELL_S
    surface: Vector3 = GUIDE
    seed: int = 0
    start_ns: int = EPOCH_NS

    @property
    def cart(self) -> Cart:
        """The cart at rest."""
        return Cart((*self.configuration.path_point(self.offset), -Q3), self.obstacle_mass, self.surface)

    @property
    def moves(self) -> tuple[LinearMove, LinearMove, LinearMove]:
        """Dwell, path with the impact in its middle, dwell."""
        start, end = (self.configuration.path_point(side * PATH_M / 2.0) for side in (-1.0, 1.0))
        dwell = QuinticScaling(self.dwell)
        path = TrapezoidalScaling(length=PATH_M, speed=self.speed, acceleration=ACCELERATION)
        return (
            LinearMove(start, start, ElbowConfig.RIGHT, Q3, dwell),
            LinearMove(start, end, ElbowConfig.RIGHT, Q3, path),
            LinearMove(end, end, ElbowConfig.RIGHT, Q3, dwell),
        )

    def run_info(self, note: str) -> RunInfo:
        """Return the run information, without the ground truth."""
        return RunInfo(
            stamp_ns=self.start_ns,
            frame_id="base_link",
            configuration=self.configuration.name,
            obstacle_mass=self.obstacle_mass,
            impact_position=(*self.configuration.point, -Q3),
            plate_normal=self.surface,
            guide_direction=GUIDE,
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
    q = joint_positions_at(setup.configuration.point, ElbowConfig.RIGHT, Q3)
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
    return sim, JointController(sim)


def run_impact(setup: ImpactSetup) -> ImpactRun:
    """Simulate one run. Raises SettingsError as `build_sim` does, and if the robot misses the cart."""
    sim, controller = build_sim(setup)
    q, qd = sample_moves(setup.moves, CONTROL_RATE_HZ)
    sim.set_state(q[0], np.zeros_like(q[0]))
    sim.place_cart()
    periods = list(controller.follow(q, qd))
    positions, velocities, torques = (np.array(column) for column in list(zip(*periods, strict=True))[:3])
    samples = [sample for *_, contact in periods for sample in contact]
    contacts = find_contacts(samples)
    if not contacts:
        raise SettingsError(f"offset = {setup.offset}: the cart is not hit: must be within the path")
    noise = random.Random(f"{setup.seed} {_ENCODER_STREAM}")  # noqa: S311 - noise, no secret
    rows = enumerate(zip(*quantize(positions, velocities, noise), read_torque(torques), strict=True))
    force_blocks = measure_force(samples, setup.start_ns, sim.time_ns, setup.sensor, setup.seed)
    # The masses are those at the onset of the impact.
    index, rest_ns = divmod(contacts[0].onset_ns, CONTROL_PERIOD_NS)
    sim.set_state(positions[index] + velocities[index] * rest_ns / 1e9, velocities[index])
    return ImpactRun(
        setup,
        tuple(JointState(setup.start_ns + i * CONTROL_PERIOD_NS, JOINTS, *row) for i, row in rows),
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
    cosine = float(normal @ GUIDE)
    obstacle_mass = sim.cart.mass / cosine**2 if cosine else math.inf
    return effective_mass, reduced_mass(effective_mass, obstacle_mass)


class LiveOutput(NamedTuple):
    """New joint states, force samples (n,) [N] from number `first_sample` on, and setups whose cart was placed."""

    joint_states: tuple[JointState, ...]
    first_sample: int
    force: FloatArray
    carts: tuple[ImpactSetup, ...]


@final
class LiveSim:
    """The simulated cell, advanced by the caller's clock; the robot starts at rest.

    The output depends on the arguments only, not on how the caller divides the time. One process can thus publish the
    joint states and another one the force of the same cell, each from its own LiveSim.
    """

    def __init__(
        self,
        start_ns: int,
        *,
        seed: int = 0,
        sensor: ForceSensor = FORCE_SENSOR,
        impacts: Sequence[tuple[Configuration, float]] = IMPACTS,
    ) -> None:
        """Start at ROS time `start_ns`.

        `impacts` are the configuration and obstacle mass [kg] of each impact, in an endless cycle. `seed` sets the
        noise of the encoders.
        """
        self.start_ns = start_ns
        self._impacts = impacts
        self._elapsed_ns = 0
        self._adc = Adc(sensor, 0)
        self._noise = random.Random(seed)  # noqa: S311 - noise, no secret
        self._contact: list[ContactSample] = []
        self._carts: list[ImpactSetup] = []
        self._periods = self._run()

    def advance_to(self, now_ns: int) -> LiveOutput:
        """Advance to ROS time `now_ns`, in whole control periods; return the new output."""
        states: list[JointState] = []
        first = self._adc.samples
        force = [np.empty(0)]
        while self.start_ns + self._elapsed_ns + CONTROL_PERIOD_NS <= now_ns:
            q, qd, torque, contact = next(self._periods)
            measured = *quantize(q, qd, self._noise), read_torque(torque)
            states.append(JointState(self.start_ns + self._elapsed_ns, JOINTS, *measured))
            self._elapsed_ns += CONTROL_PERIOD_NS
            self._contact += contact
            if self._elapsed_ns % (FORCE_PERIODS * CONTROL_PERIOD_NS) == 0:
                # Contact after its last sample is known only in the next period.
                known_ns = contact[-1].time_ns if contact else self._elapsed_ns
                force.append(self._adc.push(self._contact, known_ns))
                self._contact.clear()
        samples = np.concatenate(force)
        samples.flags.writeable = False
        carts, self._carts = self._carts, []
        return LiveOutput(tuple(states), first, samples, tuple(carts))

    def _run(self) -> Iterator[ControlPeriod]:
        previous_end: tuple[float, float] | None = None
        state: tuple[FloatArray, FloatArray] | None = None
        for configuration, mass in cycle(self._impacts):
            dwell_s = FIRST_DWELL_S if previous_end is None else DWELL_S
            setup = ImpactSetup(configuration, mass, dwell=dwell_s)
            sim, controller = build_sim(setup)
            dwell, *impact_moves = setup.moves
            approach_moves = [dwell]
            if previous_end is not None:
                distance = float(np.hypot(dwell.start[0] - previous_end[0], dwell.start[1] - previous_end[1]))
                scaling = QuinticScaling(QUINTIC_PEAK * distance / setup.speed)
                approach_moves.insert(0, LinearMove(previous_end, dwell.start, dwell.elbow_config, dwell.q3, scaling))
            q, qd = sample_moves(approach_moves, CONTROL_RATE_HZ)
            sim.time_ns = self._elapsed_ns
            sim.set_state(*(state or (q[0], qd[0])))
            yield from controller.follow(q, qd)
            sim.place_cart()
            self._carts.append(replace(setup, start_ns=self.start_ns + self._elapsed_ns))
            yield from controller.follow(*sample_moves(impact_moves, CONTROL_RATE_HZ))
            previous_end, state = impact_moves[-1].end, (sim.q, sim.qd)
