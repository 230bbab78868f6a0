# SPDX-License-Identifier: Apache-2.0
"""Run the simulation continuously: one impact after the other, with a fresh cart for each."""

import random
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import cycle, product
from typing import NamedTuple, final

import numpy as np

from scara_effmass.sim.collision_sim import CONTROL_PERIOD_NS, ContactSample
from scara_effmass.sim.controller import CONTROL_RATE_HZ, EncoderReading
from scara_effmass.sim.experiment import (
    CONFIGURATIONS,
    DWELL_S,
    OBSTACLE_MASSES,
    Configuration,
    ImpactSetup,
    build_sim,
)
from scara_effmass.sim.measurement import FORCE_SENSOR, Adc, ForceSensor, quantize
from scara_effmass.sim.motion import LinearMove, QuinticScaling, sample_moves
from scara_effmass.sim.recordings import JOINTS
from scara_effmass.values import FloatArray, JointState

FORCE_PERIODS = 10
"""Control periods per portion of force samples."""
FIRST_DWELL_S = 2.0
"""Rest before the first impact: a force node needs one to two seconds to estimate the converter clock."""
QUINTIC_PEAK = 1.875
"""Peak speed of a quintic move over its mean speed."""
IMPACTS = tuple(product(CONFIGURATIONS, OBSTACLE_MASSES))


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

        `impacts` are the configuration and obstacle mass [kg] of each impact, in an endless cycle; all must have the
        same elbow configuration. `seed` sets the noise of the encoders.
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
            reading, contact = next(self._periods)
            q, qd = quantize(reading.q, reading.qd, self._noise)
            states.append(JointState(self.start_ns + self._elapsed_ns, JOINTS, q, qd))
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

    def _run(self) -> Iterator[tuple[EncoderReading, list[ContactSample]]]:
        """Yield encoder reading and contact of each control period."""
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
