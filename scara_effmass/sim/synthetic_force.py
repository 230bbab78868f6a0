"""Force for a recording: noise, and impacts at chosen times."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from scara_effmass.sim.force import HalfSine, SimulatedSignal
from scara_effmass.values import ForceBlock

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

SAMPLE_RATE = 12_800.0
"""Of a NI-9230 at its fastest [Hz]."""
BLOCK_SAMPLES = 1280
BLOCK_NS = 100_000_000
NOISE = 0.05
"""[N]"""
SENSITIVITY = 2.248
"""Nominal, of a PCB 208C03 [mV/N]."""
FRAME_ID = "force_sensor"
SOURCE = "simulated force: noise and half-sine impacts at chosen times, not computed from the motion"


class Pulse(NamedTuple):
    """A half-sine impact: when it begins [s], its peak [N], how long it lasts [s]."""

    seconds: float
    peak_force: float
    duration: float
    rebound: int = 0

    @property
    def impact(self) -> HalfSine:
        """It, in samples."""
        return HalfSine(self.seconds * SAMPLE_RATE, self.peak_force, self.duration, self.rebound)


def synthetic_force(hits: Sequence[Pulse], duration_s: float, start_ns: int, seed: int) -> Iterator[ForceBlock]:
    """Yield blocks of 0.1 s, from `start_ns` on until no whole one fits into `duration_s` [s]."""
    impacts = tuple(hit.impact for hit in hits)
    signal = SimulatedSignal(
        channels=1,
        sample_rate=SAMPLE_RATE,
        noise=NOISE,
        seed=seed,
        sensitivity=SENSITIVITY,
        impacts=lambda _channel, _first, _end: impacts,
    )
    none_saturated = np.empty(0, np.uint32)
    none_saturated.flags.writeable = False
    for number in range(int(duration_s * SAMPLE_RATE) // BLOCK_SAMPLES):
        first = number * BLOCK_SAMPLES
        yield ForceBlock(
            stamp_ns=start_ns + number * BLOCK_NS,
            frame_id=FRAME_ID,
            first_sample=first,
            sample_rate=SAMPLE_RATE,
            force=signal.samples(first, BLOCK_SAMPLES)[0],
            lost_samples=0,
            saturated_samples=none_saturated,
            clock_residual=0.0,
            filter_delay=0.0,
            source=SOURCE,
            simulated=True,
            tare=0.0,
            tare_stamp_ns=0,
            relative_uncertainty=0.0,
        )
