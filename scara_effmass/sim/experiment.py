"""One impact of the paper's experiment: the robot hits the waiting cart in the middle of a straight path.

The robot follows its planned path after the impact, so it often catches up with the cart and hits it again, weaker.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from scara_effmass.errors import RobotError, SettingsError
from scara_effmass.iso15066 import reduced_mass
from scara_effmass.share import share
from scara_effmass.sim.collision_sim import CONTROL_PERIOD_NS, FINE_STEP_NS, CollisionSim, ContactSample
from scara_effmass.sim.controller import EncoderReading, JointController, JointTrajectory
from scara_effmass.sim.ground_truth import TrueContact, find_contacts
from scara_effmass.sim.impact_setup import Q3, ImpactSetup
from scara_effmass.sim.measurement import measure_force, measure_joint_states
from scara_effmass.values import ForceBlock, JointState

MIN_CONTACT_STEPS = 40
"""Steps in the shortest contact; the peak is then 0.1 % off."""
MAX_SPEED_LOSS = 0.1
"""Largest share of the closing speed that damping may take in one step."""
ROBOT = ("config", "omron_i4_550l.yaml")
MAX_POSITION_ERROR_M = 1e-6
"""Between the robot file's kinematics and those of `scara_kinematics`."""


class ImpactTruth(NamedTuple):
    """Ground truth of a run: the contacts, the impact first, and the masses [kg] at its onset.

    `effective_mass` is MuJoCo's along the normal of the plate; `reduced_mass` is that of robot and cart.
    """

    contacts: tuple[TrueContact, ...]
    effective_mass: float
    reduced_mass: float

    @property
    def impact(self) -> TrueContact:
        """The first contact."""
        return self.contacts[0]


class ImpactRun(NamedTuple):
    """A run as the suite would record it, with its ground truth; all stamps are ROS time."""

    setup: ImpactSetup
    joint_states: tuple[JointState, ...]
    force_blocks: tuple[ForceBlock, ...]
    truth: ImpactTruth


def build_sim(setup: ImpactSetup, robot: Path | None = None) -> tuple[CollisionSim, JointController]:
    """Return simulation and controller of a run: the robot at rest at the impact point, the cart not yet placed.

    `robot` is a Denavit-Hartenberg file, by default the shipped one. Raises RobotError when its kinematics are not
    those of the i4-550L, SettingsError for a contact too short or too damped for the simulation step.
    """
    path = robot or share(*ROBOT)
    sim = CollisionSim(path, setup.cart, setup.contact)
    sim.set_state(np.array(setup.configuration.joint_positions), np.zeros(len(sim.joints)))
    error_m = float(np.linalg.norm(sim.tool_position - np.array([*setup.configuration.point, -Q3])))
    if error_m > MAX_POSITION_ERROR_M:
        raise RobotError(f"{path}: tool {error_m * 1e3:.3f} mm from the impact point: must be an i4-550L")
    _, mu = _masses(sim, setup)
    duration_s = setup.contact.duration(setup.speed, mu)
    if not duration_s > (min_s := MIN_CONTACT_STEPS * FINE_STEP_NS / 1e9):
        raise SettingsError(
            f"stiffness = {setup.contact.stiffness:g}: the contact lasts {duration_s * 1e3:.2f} ms:"
            f" must be > {min_s * 1e3:g} ms; reduce the stiffness"
        )
    if not setup.contact.damping <= (max_damping := MAX_SPEED_LOSS * mu * 1e9 / FINE_STEP_NS):
        raise SettingsError(f"damping = {setup.contact.damping:g}: must be <= {max_damping:.0f} N s/m")
    return sim, JointController(sim, setup.servo)


def run_impact(setup: ImpactSetup, robot: Path | None = None) -> ImpactRun:
    """Simulate one run with the robot in the file `robot`, by default the shipped one.

    Raises RobotError and SettingsError as `build_sim`, and SettingsError where the cart is not hit.
    """
    sim, controller = build_sim(setup, robot)
    trajectory = JointTrajectory(sim, setup.moves)
    sim.set_state(trajectory.q[0], np.zeros_like(trajectory.q[0]))
    sim.place_cart()
    readings: list[EncoderReading] = []
    samples: list[ContactSample] = []
    for index in range(len(trajectory)):
        reading, contact = controller.advance(trajectory, index)
        readings.append(reading)
        samples += contact
    contacts = find_contacts(samples)
    if not contacts:
        raise SettingsError(f"offset = {setup.offset}: the cart is not hit: must be within the path")
    end_ns = sim.time_ns
    return ImpactRun(
        setup,
        measure_joint_states(sim.joints, readings, setup),
        measure_force(samples, end_ns, setup),
        _truth(sim, readings, contacts, setup),
    )


def _truth(
    sim: CollisionSim, readings: list[EncoderReading], contacts: tuple[TrueContact, ...], setup: ImpactSetup
) -> ImpactTruth:
    onset_ns = contacts[0].onset_ns
    before = readings[onset_ns // CONTROL_PERIOD_NS]
    sim.set_state(before.q + before.qd * (onset_ns % CONTROL_PERIOD_NS) / 1e9, before.qd)
    effective_mass, mu = _masses(sim, setup)
    stamped = tuple(contact._replace(onset_ns=contact.onset_ns + setup.start_ns) for contact in contacts)
    return ImpactTruth(stamped, effective_mass, mu)


def _masses(sim: CollisionSim, setup: ImpactSetup) -> tuple[float, float]:
    """Return effective and reduced mass [kg] along the normal of the plate in the current state.

    The guide lets the cart move along the path only: along the normal, its mass is m_H / cos^2 of the angle between.
    """
    direction = np.array(setup.configuration.direction)
    normal = direction if setup.surface is None else np.array(setup.surface)
    effective_mass = sim.effective_mass(normal)
    cosine = float(normal @ direction)
    obstacle_mass = setup.obstacle_mass / cosine**2 if cosine else math.inf
    return effective_mass, reduced_mass(effective_mass, obstacle_mass)
