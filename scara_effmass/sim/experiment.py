"""The paper's experiment: the robot runs into the waiting cart in the middle of a straight path at 250 mm/s.

The robot moves on as planned, so it often comes after the cart and hits it again, weaker. `ImpactRun` is what the
suite would have recorded of it, beside what truly happened.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from scara_effmass.errors import RobotError, SettingsError
from scara_effmass.iso15066 import reduced_mass
from scara_effmass.share import share
from scara_effmass.sim.as_recorded import force_blocks, joint_states
from scara_effmass.sim.collision_sim import NEAR_NS, TICK_NS, CollisionSim
from scara_effmass.sim.drive import Drive, Plan
from scara_effmass.sim.ground_truth import true_contacts
from scara_effmass.sim.impact_setup import Q3

if TYPE_CHECKING:
    from pathlib import Path

    from scara_effmass.sim.collision_sim import ContactSample
    from scara_effmass.sim.drive import Encoders
    from scara_effmass.sim.ground_truth import TrueContact
    from scara_effmass.sim.impact_setup import ImpactSetup
    from scara_effmass.values import ForceBlock, JointState

LEAST_STEPS = 40
"""A contact of fewer steps than this is not followed well: at 40 the peak is 0.1 % off."""
MOST_DAMPED = 0.1
"""Damping may take no more than this share of the closing speed in a step."""
ROBOT = ("config", "omron_i4_550l.yaml")
PLACED_M = 1e-6
"""The tool has to be where the bench's own kinematics put it."""


class ImpactTruth(NamedTuple):
    """What truly happened: the contacts, the impact first, and the masses [kg] that met in it.

    `effective_mass` is the robot's along the normal of the plate at onset, from MuJoCo; `reduced_mass` that of robot
    and cart.
    """

    contacts: tuple[TrueContact, ...]
    effective_mass: float
    reduced_mass: float

    @property
    def impact(self) -> TrueContact:
        """The first contact."""
        return self.contacts[0]


class ImpactRun(NamedTuple):
    """A run, as it would have been recorded; all stamps are ROS time."""

    setup: ImpactSetup
    joint_states: tuple[JointState, ...]
    force_blocks: tuple[ForceBlock, ...]
    truth: ImpactTruth


def cell_for(setup: ImpactSetup, robot: Path | None = None) -> tuple[CollisionSim, Drive]:
    """Return the cell of a run, the robot in the pose of impact and at rest, and its drive; the cart is away.

    Raises RobotError when `robot`, a Denavit-Hartenberg file, is not the robot whose kinematics the bench knows,
    SettingsError for a contact too short or too damped for the steps of the simulation.
    """
    path = robot or share(*ROBOT)
    cell = CollisionSim(path, setup.cart, setup.contact)
    cell.put(np.array(setup.configuration.pose), np.zeros(len(cell.joints)))
    missed = float(np.linalg.norm(cell.tool - np.array([*setup.configuration.point, -Q3])))
    if missed > PLACED_M:
        raise RobotError(f"{path}: its tool misses the point of impact by {missed * 1e3:.3f} mm; the i4-550L is needed")
    masses = _masses(cell, setup)
    seconds = setup.contact.duration(setup.speed, masses.reduced)
    if not seconds > (least := LEAST_STEPS * NEAR_NS / 1e9):
        raise SettingsError(
            f"stiffness = {setup.contact.stiffness:g}: the contact would last {seconds * 1e3:.2f} ms;"
            f" {least * 1e3:g} ms or more, that is less stiffness, would be right"
        )
    if not setup.contact.damping <= (most := MOST_DAMPED * masses.reduced * 1e9 / NEAR_NS):
        raise SettingsError(f"damping = {setup.contact.damping:g}: {most:.0f} N s/m or less would be right")
    return cell, Drive(cell, setup.servo, cell.joint_inertias())


def run_impact(setup: ImpactSetup, robot: Path | None = None) -> ImpactRun:
    """Do one run with the robot in `robot`, the shipped one by default.

    Raises RobotError, SettingsError as `cell_for`, and SettingsError where the cart is not hit.
    """
    cell, drive = cell_for(setup, robot)
    plan = Plan(cell, setup.moves)
    cell.put(plan.q[0], np.zeros_like(plan.q[0]))
    cell.place_cart()
    readings: list[Encoders] = []
    touches: list[ContactSample] = []
    for number in range(len(plan)):
        reading, near = drive.tick(plan, number)
        readings.append(reading)
        touches += near
    contacts = true_contacts(touches)
    if not contacts:
        raise SettingsError(f"offset = {setup.offset}: the cart is not hit; a tip within the path would be right")
    return ImpactRun(
        setup,
        joint_states(cell.joints, readings, setup),
        force_blocks(touches, cell.time_ns, setup),
        _truth(cell, readings, contacts, setup),
    )


def _truth(
    cell: CollisionSim, readings: list[Encoders], contacts: tuple[TrueContact, ...], setup: ImpactSetup
) -> ImpactTruth:
    onset_ns = contacts[0].onset_ns
    before = readings[onset_ns // TICK_NS]
    cell.put(before.q + before.qd * (onset_ns % TICK_NS) / 1e9, before.qd)
    masses = _masses(cell, setup)
    shifted = tuple(contact._replace(onset_ns=contact.onset_ns + setup.start_ns) for contact in contacts)
    return ImpactTruth(shifted, masses.effective, masses.reduced)


class _Masses(NamedTuple):
    effective: float
    reduced: float


def _masses(cell: CollisionSim, setup: ImpactSetup) -> _Masses:
    """Return the masses [kg] that meet where the robot stands; the cart has to be moved along its guide."""
    direction = np.array(setup.configuration.direction)
    normal = direction if setup.surface is None else np.array(setup.surface)
    effective = cell.effective_mass(normal)
    cart_mass = setup.obstacle_mass / float(normal @ direction) ** 2  # along the normal
    return _Masses(effective, reduced_mass(effective, cart_mass))
