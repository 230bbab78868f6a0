"""A run as the suite records it: joint states from encoders, force in blocks, each with its own clock's stamps."""

from __future__ import annotations

import math
import random
from typing import TYPE_CHECKING

import numpy as np

from scara_effmass.sim.collision_sim import TICK_NS
from scara_effmass.sim.converter import Converter
from scara_effmass.sim.recordings import measured
from scara_effmass.sim.rng import uniform
from scara_effmass.sim.synthetic_force import FRAME_ID
from scara_effmass.values import ForceBlock, JointState

if TYPE_CHECKING:
    from collections.abc import Sequence

    from scara_effmass.sim.collision_sim import ContactSample
    from scara_effmass.sim.drive import Encoders
    from scara_effmass.sim.impact_setup import ImpactSetup

SOURCE = "simulated force: virtual test bench, sensor 208C03 on NI-9230, AC coupled"
TARE_S = 0.5
BLOCK_S = 0.1
LATENESS_S = 0.3e-3
"""The imagined fit of the converter's clock to ROS time is late by up to so much, the same for a whole run,"""
JITTER_S = 20e-6
"""and by up to so much more from block to block."""
_STAMPS, _ENCODERS = 4, 5  # streams of the seed


def joint_states(names: tuple[str, ...], readings: Sequence[Encoders], setup: ImpactSetup) -> tuple[JointState, ...]:
    """Return what the encoders gave in the ticks of a run, in whole counts, at stamps a tick apart."""
    noise = random.Random(f"{setup.seed} {_ENCODERS}")  # noqa: S311 - noise, no secret
    q, qd = (np.array(column) for column in zip(*readings, strict=True))
    q, qd = measured(q, qd, noise)
    for column in (q, qd):
        column.flags.writeable = False
    rows = zip(q, qd, strict=True)
    return tuple(JointState(setup.start_ns + i * TICK_NS, names, *row) for i, row in enumerate(rows))


def force_blocks(touches: Sequence[ContactSample], end_ns: int, setup: ImpactSetup) -> tuple[ForceBlock, ...]:
    """Return whole blocks of the samples from the beginning of the run on; the tare was before."""
    sensor = setup.sensor
    phase, lateness, *jitter = uniform((setup.seed, _STAMPS), 2 + math.ceil(end_ns / 1e9 / BLOCK_S)).tolist()
    length = round(BLOCK_S * sensor.sample_rate)
    tare_samples = round(TARE_S * sensor.sample_rate)
    # The first block begins within a block's time of the run: where exactly is nobody's choice.
    started_ns: int = -round((TARE_S + BLOCK_S + sensor.filter_delay - phase * BLOCK_S) * 1e9)
    converter = Converter(sensor, started_ns)
    samples = converter.push(touches, end_ns)
    tare = float(samples[:tare_samples].mean())

    def stamp_ns(sample: int, late_s: float) -> int:
        after_ns = round((sample / sensor.true_rate - sensor.filter_delay + late_s) * 1e9)
        return setup.start_ns + started_ns + after_ns

    blocks = []
    for number, late in enumerate(jitter):
        first = tare_samples + (number + 1) * length
        force = samples[first : first + length] - tare
        if len(force) < length:
            break
        force.flags.writeable = False
        saturated = np.flatnonzero(np.abs(force + tare) >= sensor.saturation).astype(np.uint32)
        saturated.flags.writeable = False
        blocks.append(
            ForceBlock(
                stamp_ns=stamp_ns(first, lateness * LATENESS_S + late * JITTER_S),
                frame_id=FRAME_ID,
                first_sample=first,
                sample_rate=sensor.true_rate,
                force=force,
                lost_samples=0,
                saturated_samples=saturated,
                clock_residual=LATENESS_S + JITTER_S,
                filter_delay=sensor.filter_delay,
                source=SOURCE,
                simulated=True,
                tare=tare,
                tare_stamp_ns=stamp_ns(tare_samples, lateness * LATENESS_S),
                relative_uncertainty=0.0,
            )
        )
    return tuple(blocks)
