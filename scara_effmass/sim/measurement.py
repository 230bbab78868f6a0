"""What the suite would record of a simulated run: joint states from encoders, and force blocks."""

import math
import random
from collections.abc import Sequence

import numpy as np

from scara_effmass.sim.adc import Adc
from scara_effmass.sim.collision_sim import CONTROL_PERIOD_NS, ContactSample
from scara_effmass.sim.controller import EncoderReading
from scara_effmass.sim.impact_setup import ImpactSetup
from scara_effmass.sim.recordings import quantize
from scara_effmass.sim.rng import uniform
from scara_effmass.sim.synthetic_force import FRAME_ID
from scara_effmass.values import ForceBlock, JointState

SOURCE = "simulated force: MuJoCo cell, sensor 208C03 on NI-9230, AC coupled"
TARE_S = 0.5
BLOCK_S = 0.1
STAMP_DELAY_S = 0.3e-3
"""Largest delay of the stamps, constant for a run: the error of the estimated converter clock."""
STAMP_JITTER_S = 20e-6
"""Largest additional delay of one block."""
_STAMP_STREAM, _ENCODER_STREAM = 4, 5


def measure_joint_states(
    names: tuple[str, ...], readings: Sequence[EncoderReading], setup: ImpactSetup
) -> tuple[JointState, ...]:
    """Return one joint state per control period, in whole encoder counts."""
    noise = random.Random(f"{setup.seed} {_ENCODER_STREAM}")  # noqa: S311 - noise, no secret
    q, qd = (np.array(column) for column in zip(*readings, strict=True))
    q, qd = quantize(q, qd, noise)
    for column in (q, qd):
        column.flags.writeable = False
    rows = zip(q, qd, strict=True)
    return tuple(JointState(setup.start_ns + i * CONTROL_PERIOD_NS, names, *row) for i, row in enumerate(rows))


def measure_force(contact: Sequence[ContactSample], end_ns: int, setup: ImpactSetup) -> tuple[ForceBlock, ...]:
    """Return whole force blocks from the start of the run to `end_ns`; the tare precedes the run."""
    sensor = setup.sensor
    phase, delay, *jitter = uniform((setup.seed, _STAMP_STREAM), 2 + math.ceil(end_ns / 1e9 / BLOCK_S)).tolist()
    length = round(BLOCK_S * sensor.sample_rate)
    tare_samples = round(TARE_S * sensor.sample_rate)
    # The first block starts at a random time within the first 0.1 s of the run.
    adc_start_ns = -round((TARE_S + BLOCK_S + sensor.filter_delay - phase * BLOCK_S) * 1e9)
    samples = Adc(sensor, adc_start_ns).push(contact, end_ns)
    tare = float(samples[:tare_samples].mean())

    def stamp_ns(sample: int, late_s: float) -> int:
        elapsed_ns = round((sample / sensor.true_rate - sensor.filter_delay + late_s) * 1e9)
        return int(setup.start_ns + adc_start_ns + elapsed_ns)

    blocks = []
    for number, block_jitter in enumerate(jitter):
        first = tare_samples + (number + 1) * length
        force = samples[first : first + length] - tare
        if len(force) < length:
            break
        force.flags.writeable = False
        saturated = np.flatnonzero(np.abs(force + tare) >= sensor.saturation).astype(np.uint32)
        saturated.flags.writeable = False
        blocks.append(
            ForceBlock(
                stamp_ns=stamp_ns(first, delay * STAMP_DELAY_S + block_jitter * STAMP_JITTER_S),
                frame_id=FRAME_ID,
                first_sample=first,
                sample_rate=sensor.true_rate,
                force=force,
                lost_samples=0,
                saturated_samples=saturated,
                clock_residual=STAMP_DELAY_S + STAMP_JITTER_S,
                filter_delay=sensor.filter_delay,
                source=SOURCE,
                simulated=True,
                tare=tare,
                tare_stamp_ns=stamp_ns(tare_samples, delay * STAMP_DELAY_S),
                relative_uncertainty=0.0,
            )
        )
    return tuple(blocks)
