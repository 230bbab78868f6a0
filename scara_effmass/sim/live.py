"""Run the simulation continuously: one impact after the other, with a fresh cart for each."""

import random
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import cycle, product
from pathlib import Path
from typing import NamedTuple, final

import numpy as np

from scara_effmass.errors import SettingsError
from scara_effmass.sim.adc import FORCE_SENSOR, Adc, ForceSensor
from scara_effmass.sim.collision_sim import CONTROL_PERIOD_NS, CollisionSim, ContactSample
from scara_effmass.sim.controller import DEFAULT_GAINS, EncoderReading, JointTrajectory, ServoGains
from scara_effmass.sim.experiment import build_sim
from scara_effmass.sim.impact_setup import (
    CONFIGURATIONS,
    DWELL_S,
    OBSTACLE_MASSES,
    PATH_M,
    Q3,
    Configuration,
    ImpactSetup,
)
from scara_effmass.sim.motion import LinearMove, Move, QuinticScaling
from scara_effmass.sim.recordings import quantize
from scara_effmass.sim.spring_contact import POLYETHYLENE, SpringContact
from scara_effmass.values import FloatArray, JointState

FORCE_PERIODS = 10
"""Control periods per portion of force samples."""
FIRST_DWELL_S = 2.0
"""Before the first impact: a force node needs one to two seconds to estimate the converter clock."""
QUINTIC_PEAK = 1.875
"""Peak speed of a quintic move over its mean speed."""


@dataclass(frozen=True, slots=True)
class LiveSettings:
    """Impacts of the continuous simulation, repeated forever. All configurations must have one elbow configuration."""

    impacts: tuple[tuple[Configuration, float], ...] = field(
        default_factory=lambda: tuple(product(CONFIGURATIONS, OBSTACLE_MASSES))
    )
    """configuration and obstacle mass [kg] of each"""
    speed: float = 0.25
    """of the impact, and the peak speed between impacts [m/s]"""
    contact: SpringContact = POLYETHYLENE
    servo: ServoGains = DEFAULT_GAINS
    sensor: ForceSensor = FORCE_SENSOR
    seed: int = 0


class CartPlacement(NamedTuple):
    """The cart placed at `stamp_ns` for the impact of `setup`."""

    stamp_ns: int
    setup: ImpactSetup


class LiveOutput(NamedTuple):
    """New joint states, cart placements, and force samples (n,) [N] from number `first_sample` on."""

    joint_states: tuple[JointState, ...]
    first_sample: int
    force: FloatArray
    carts: tuple[CartPlacement, ...]


@final
class LiveSim:
    """The simulated cell, advanced by the caller's clock; the robot starts at rest.

    The output depends on settings and `start_ns` only, not on how the caller divides the time: one process can
    publish the joint states and another one the force of the same cell, each from its own LiveSim.
    """

    def __init__(self, settings: LiveSettings, start_ns: int, robot: Path | None = None) -> None:
        """Start at ROS time `start_ns`. Raises SettingsError for several elbow configurations or no impacts.

        `advance_to` raises as `build_sim`.
        """
        if len({configuration.elbow_config for configuration, _ in settings.impacts}) != 1:
            raise SettingsError("impacts: must have one elbow configuration")
        self.settings = settings
        self.start_ns = start_ns
        self._robot = robot
        self._elapsed_ns = 0
        self._adc = Adc(settings.sensor, 0)
        self._noise = random.Random(settings.seed)  # noqa: S311 - noise, no secret
        self._contact: list[ContactSample] = []
        self._periods = self._run()

    def advance_to(self, now_ns: int) -> LiveOutput:
        """Advance to ROS time `now_ns`, in whole control periods; return the new output."""
        states: list[JointState] = []
        carts: list[CartPlacement] = []
        first = self._adc.samples
        force = [np.empty(0)]
        while self.start_ns + self._elapsed_ns + CONTROL_PERIOD_NS <= now_ns:
            names, reading, contact, cart = next(self._periods)
            q, qd = quantize(reading.q, reading.qd, self._noise)
            q.flags.writeable = qd.flags.writeable = False
            states.append(JointState(self.start_ns + self._elapsed_ns, names, q, qd))
            if cart is not None:
                carts.append(cart)
            self._elapsed_ns += CONTROL_PERIOD_NS
            self._contact += contact
            if self._elapsed_ns % (FORCE_PERIODS * CONTROL_PERIOD_NS) == 0:
                # Contact after its last sample is known only in the next period.
                known_ns = contact[-1].time_ns if contact else self._elapsed_ns
                force.append(self._adc.push(self._contact, known_ns))
                self._contact.clear()
        samples = np.concatenate(force)
        samples.flags.writeable = False
        return LiveOutput(tuple(states), first, samples, tuple(carts))

    def _run(self) -> Iterator[tuple[tuple[str, ...], EncoderReading, list[ContactSample], CartPlacement | None]]:
        """Yield joint names, encoder reading, contact and placed cart of each control period."""
        previous: tuple[Configuration, CollisionSim] | None = None
        for configuration, mass in cycle(self.settings.impacts):
            settings = self.settings
            setup = ImpactSetup(
                configuration=configuration,
                obstacle_mass=mass,
                speed=settings.speed,
                contact=settings.contact,
                servo=settings.servo,
                dwell=FIRST_DWELL_S if previous is None else DWELL_S,
            )
            sim, controller = build_sim(setup, self._robot)
            dwell, *impact_moves = setup.moves
            approach_moves: list[Move] = [dwell]
            if previous is not None:
                approach_moves.insert(0, self._transfer(previous[0], configuration))
            approach, impact = JointTrajectory(sim, approach_moves), JointTrajectory(sim, impact_moves)
            sim.time_ns = self._elapsed_ns
            sim.set_state(*((approach.q[0], approach.qd[0]) if previous is None else (previous[1].q, previous[1].qd)))
            for index in range(len(approach)):
                yield (sim.joints, *controller.advance(approach, index), None)
            sim.place_cart()
            cart: CartPlacement | None = CartPlacement(self.start_ns + self._elapsed_ns, setup)
            for index in range(len(impact)):
                yield (sim.joints, *controller.advance(impact, index), cart)
                cart = None
            previous = configuration, sim

    def _transfer(self, previous: Configuration, configuration: Configuration) -> LinearMove:
        """Return the move from the end of one path to the start of the next; no cart is placed."""
        start, end = previous.path_point(PATH_M / 2.0), configuration.path_point(-PATH_M / 2.0)
        seconds = QUINTIC_PEAK * float(np.hypot(end[0] - start[0], end[1] - start[1])) / self.settings.speed
        return LinearMove(start, end, configuration.elbow_config, Q3, QuinticScaling(seconds))
