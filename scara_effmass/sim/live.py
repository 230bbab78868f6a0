"""The virtual cell as a going concern: one impact after the other, for as long as someone asks."""

from __future__ import annotations

import random
from dataclasses import dataclass, field
from itertools import cycle, product
from typing import TYPE_CHECKING, NamedTuple, final

import numpy as np

from scara_effmass.errors import SettingsError
from scara_effmass.sim.collision_sim import TICK_NS
from scara_effmass.sim.converter import FORCE_SENSOR, Converter
from scara_effmass.sim.drive import SERVO, Plan
from scara_effmass.sim.experiment import cell_for
from scara_effmass.sim.impact_setup import CONFIGURATIONS, OBSTACLE_MASSES, PATH_M, Q3, REST_S, ImpactSetup
from scara_effmass.sim.motion import LineMove, Quintic
from scara_effmass.sim.recordings import measured
from scara_effmass.sim.spring_contact import POLYETHYLENE
from scara_effmass.values import JointState

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from scara_effmass.sim.collision_sim import CollisionSim, ContactSample
    from scara_effmass.sim.converter import ForceSensor
    from scara_effmass.sim.drive import Encoders, Servo
    from scara_effmass.sim.impact_setup import Configuration
    from scara_effmass.sim.motion import Move
    from scara_effmass.sim.spring_contact import SpringContact
    from scara_effmass.values import FloatArray

FRAME = 10
"""Force comes in portions of so many ticks."""
FIRST_REST_S = 2.0
"""Before the first impact: a force node needs a second or two until it knows the converter's clock."""
QUINTIC_PEAK = 1.875
"""Greatest speed of a quintic move over its mean speed."""


@dataclass(frozen=True, slots=True)
class LiveSettings:
    """What the cell does, again and again. All configurations have to be of one arm."""

    impacts: tuple[tuple[Configuration, float], ...] = field(
        default_factory=lambda: tuple(product(CONFIGURATIONS, OBSTACLE_MASSES))
    )
    """configuration and obstacle mass [kg] of each"""
    speed: float = 0.25
    """of the impact, and the greatest on the way to the next [m/s]"""
    contact: SpringContact = POLYETHYLENE
    servo: Servo = SERVO
    sensor: ForceSensor = FORCE_SENSOR
    seed: int = 0


class PlacedCart(NamedTuple):
    """From `stamp_ns` on, the cart waits with this mass [kg], for an impact in this configuration."""

    stamp_ns: int
    configuration: str
    obstacle_mass: float


class LiveOutput(NamedTuple):
    """What came up since the last time: joint states, samples of force (n,) [N] from number `first_sample` on."""

    joint_states: tuple[JointState, ...]
    first_sample: int
    force: FloatArray
    carts: tuple[PlacedCart, ...]


@final
class LiveBench:
    """The cell, advanced by whoever has the clock. The robot starts at rest, with the first cart to come.

    What comes out depends on the settings and on `start_ns` alone, not on how time is portioned: two processes, one
    for the joint states and one for the force, can each have a bench of their own and see the same cell.
    """

    def __init__(self, settings: LiveSettings, start_ns: int, robot: Path | None = None) -> None:
        """Begin at the ROS time `start_ns`. Raises SettingsError for more than one arm.

        `advance_to` raises what `cell_for` does.
        """
        if len({configuration.arm for configuration, _ in settings.impacts}) != 1:
            raise SettingsError("impacts: all configurations with the same arm, and at least one, would be right")
        self.settings = settings
        self.start_ns = start_ns
        self._robot = robot
        self._now_ns = 0
        self._converter = Converter(settings.sensor, 0)
        self._noise = random.Random(settings.seed)  # noqa: S311 - noise, no secret
        self._touches: list[ContactSample] = []
        self._ticks = self._run()

    def advance_to(self, now_ns: int) -> LiveOutput:
        """Let the cell go on until the ROS time `now_ns`, in whole milliseconds; return what came up.

        Force comes in portions of FRAME ticks.
        """
        states: list[JointState] = []
        carts: list[PlacedCart] = []
        first = self._converter.samples
        force = [np.empty(0)]
        while self.start_ns + self._now_ns + TICK_NS <= now_ns:
            names, reading, touches, cart = next(self._ticks)
            q, qd = measured(reading.q, reading.qd, self._noise)
            q.flags.writeable = qd.flags.writeable = False
            states.append(JointState(self.start_ns + self._now_ns, names, q, qd))
            if cart is not None:
                carts.append(cart)
            self._now_ns += TICK_NS
            self._touches += touches
            if self._now_ns % (FRAME * TICK_NS) == 0:
                # What a near contact does until the end of the tick, only the next one tells.
                known_ns = touches[-1].time_ns if touches else self._now_ns
                force.append(self._converter.push(self._touches, known_ns))
                self._touches.clear()
        samples = np.concatenate(force)
        samples.flags.writeable = False
        return LiveOutput(tuple(states), first, samples, tuple(carts))

    def _run(self) -> Iterator[tuple[tuple[str, ...], Encoders, list[ContactSample], PlacedCart | None]]:
        before: tuple[Configuration, CollisionSim] | None = None
        for configuration, mass in cycle(self.settings.impacts):
            rest_s = FIRST_REST_S if before is None else REST_S
            setup = ImpactSetup(
                configuration, mass, self.settings.speed, self.settings.contact, self.settings.servo, rest=rest_s
            )
            cell, drive = cell_for(setup, self._robot)
            rest, *impact = setup.moves
            approach: list[Move] = [rest]
            if before is not None:
                approach.insert(0, self._transfer(before[0], configuration))
            there, here = Plan(cell, approach), Plan(cell, impact)
            cell.time_ns = self._now_ns
            cell.put(*((there.q[0], there.qd[0]) if before is None else (before[1].q, before[1].qd)))
            for number in range(len(there)):
                yield (cell.joints, *drive.tick(there, number), None)
            cell.place_cart()
            cart: PlacedCart | None = PlacedCart(self.start_ns + self._now_ns, configuration.name, mass)
            for number in range(len(here)):
                yield (cell.joints, *drive.tick(here, number), cart)
                cart = None
            before = configuration, cell

    def _transfer(self, last: Configuration, following: Configuration) -> LineMove:
        """Return the way from the end of one path to the start of the next; the cart is out of the way."""
        start, end = last.along(PATH_M / 2.0), following.along(-PATH_M / 2.0)
        seconds = QUINTIC_PEAK * float(np.hypot(end[0] - start[0], end[1] - start[1])) / self.settings.speed
        return LineMove(start, end, following.arm, Q3, Quintic(seconds))
