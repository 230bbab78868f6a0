# SPDX-License-Identifier: Apache-2.0
"""Generate the reference recordings and one repetition of the campaign.

    python -m scara_effmass.studies.shipped_bags -o bags

The reference recordings hold motions as joint states, and synthetic force that is not computed from them.
"""

import argparse
import hashlib
import random
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from scara_effmass.errors import EffmassError, OutputError, writing
from scara_effmass.input_files import read_table
from scara_effmass.sim.measurement import FRAME_ID, ForceSensor, Pulse, SyntheticSignal, quantize
from scara_effmass.sim.motion import (
    ElbowConfig,
    JointMove,
    LinearMove,
    Move,
    QuinticScaling,
    TrapezoidalScaling,
    joint_positions_at,
    sample_moves,
)
from scara_effmass.sim.recordings import EPOCH_NS, JOINTS, SEED, write_recording
from scara_effmass.studies.campaign import Campaign, run_campaign
from scara_effmass.values import FloatArray, ForceBlock, JointState, RunInfo

CHECKSUMS = "SHA256SUMS"
CAMPAIGN = Campaign(repetitions=1)
CAMPAIGN_FOLDER = "campaign"
REVISION = 3
"""Increase it when a reference recording changes."""
BLOCK_SAMPLES = 1280
BLOCK_NS = 100_000_000
NOISE = 0.05
"""Standard deviation of the noise [N]."""
SOURCE = "simulated force: noise and half-sine impacts at chosen times, not computed from the motion"


@dataclass(frozen=True, slots=True)
class ReferenceRecording:
    """A recording to generate: name, description, and motion (m, 4) at `frequency` [Hz].

    With `pulses` it also has synthetic force, independent of the motion.
    """

    name: str
    description: str
    frequency: int
    motion: Callable[[], tuple[FloatArray, FloatArray]]
    pulses: tuple[Pulse, ...] = ()

    def write(self, folder: Path, *, overwrite: bool) -> Path:
        """Write the recording as a bag in `folder`, with its pulses in the note; return its path."""
        note = [
            self.description,
            f"generator = python -m scara_effmass.sim, revision = {REVISION}, seed = {SEED}",
            *(
                f"contact at {pulse.onset_s} s: peak {pulse.peak_force} N, duration {pulse.duration} s, "
                f"impulse {pulse.impulse} N s, rebound {pulse.rebound}"
                for pulse in self.pulses
            ),
        ]
        info = RunInfo(stamp_ns=EPOCH_NS, simulated=True, note="\n".join(note))
        rows = list(zip(*self.motion(), strict=True))
        period_ns = 1_000_000_000 // self.frequency
        states = (JointState(EPOCH_NS + number * period_ns, JOINTS, *row) for number, row in enumerate(rows))
        duration_s = len(rows) / self.frequency if self.pulses else 0.0
        blocks = synthetic_force(self.pulses, duration_s, EPOCH_NS, SEED)
        logged = ((block.stamp_ns + BLOCK_NS, block) for block in blocks)
        write_recording(folder / self.name, info, states, logged, overwrite=overwrite)
        return folder / self.name


def straight() -> tuple[FloatArray, FloatArray]:
    """Return the exact motion of the paper's impact test: along x through (300, 200) mm at 250 mm/s, right arm.

    Speed, point, elbow configuration and q3 are the paper's (section 5); the length of 200 mm and the acceleration
    of 2.5 m/s2 are chosen here.
    """
    start, end, q3 = (0.2, 0.2), (0.4, 0.2), 0.236
    return sample_moves(
        (
            LinearMove(start, start, ElbowConfig.RIGHT, q3, QuinticScaling(0.5)),
            LinearMove(start, end, ElbowConfig.RIGHT, q3, TrapezoidalScaling(length=0.2, speed=0.25, acceleration=2.5)),
            LinearMove(end, end, ElbowConfig.RIGHT, q3, QuinticScaling(0.5)),
        ),
        frequency=1000,
    )


def tour() -> tuple[FloatArray, FloatArray]:
    """Return a tour of the workspace, in encoder counts."""
    return quantize(*sample_moves(tour_moves(), frequency=250), random.Random(SEED))  # noqa: S311 - noise, no secret


class Waypoint(NamedTuple):
    """Tool position of the tour [m], duration of the move to it [s], and whether that move is a straight line."""

    seconds: float
    x: float
    y: float
    elbow: str = "RIGHT"
    q3: float = 0.236
    linear: bool = True


_TOUR = read_table(__file__, "tour.yaml")
TOUR_PULSES = tuple(Pulse(*values) for values in _TOUR["pulses"])


def tour_moves() -> tuple[Move, ...]:
    """Return the moves between the waypoints of the tour."""
    moves: list[Move] = []
    for start, end in pairwise(Waypoint(**values) for values in _TOUR["waypoints"]):
        time_scaling = QuinticScaling(end.seconds)
        if end.linear:
            moves.append(LinearMove((start.x, start.y), (end.x, end.y), ElbowConfig[end.elbow], end.q3, time_scaling))
        else:
            q_start, q_end = (joint_positions_at((p.x, p.y), ElbowConfig[p.elbow], p.q3) for p in (start, end))
            moves.append(JointMove(q_start, q_end, time_scaling))
    return tuple(moves)


RECORDINGS = (
    ReferenceRecording(
        "straight_300_200",
        "straight line along x through (300, 200) mm at 250 mm/s, right arm, trapezoidal speed, q3 = 236 mm; exact",
        1000,
        straight,
    ),
    ReferenceRecording(
        "tour",
        "tour of the workspace with both arms, slow and too fast, past stretched and folded poses; encoder noise; "
        "force: half-sine impacts at chosen times, not computed from the motion",
        250,
        tour,
        TOUR_PULSES,
    ),
)


def synthetic_force(pulses: Sequence[Pulse], duration_s: float, start_ns: int, seed: int) -> Iterator[ForceBlock]:
    """Yield the whole blocks of 0.1 s that fit into `duration_s` [s], from `start_ns` on."""
    sensor = ForceSensor(noise=NOISE, seed=seed)
    signal = SyntheticSignal(1, sensor, lambda _channel, _first, _end: pulses)
    for number in range(int(duration_s * sensor.sample_rate) // BLOCK_SAMPLES):
        first = number * BLOCK_SAMPLES
        yield ForceBlock(
            stamp_ns=start_ns + number * BLOCK_NS,
            frame_id=FRAME_ID,
            first_sample=first,
            sample_rate=sensor.sample_rate,
            force=signal.samples(first, BLOCK_SAMPLES)[0],
            source=SOURCE,
            simulated=True,
        )


def generate(folder: Path, *, overwrite: bool = False) -> tuple[Path, ...]:
    """Write all shipped recordings into `folder`, with checksums; return the paths.

    The same versions of the libraries give the same bytes. Raises OutputError.
    """
    checksums = folder / CHECKSUMS
    if checksums.exists() and not overwrite:
        raise OutputError(f"{checksums}: already exists; use --force to replace it")
    bags = [recording.write(folder, overwrite=overwrite) for recording in RECORDINGS]
    bags += [step.path for step in run_campaign(folder / CAMPAIGN_FOLDER, CAMPAIGN, overwrite=overwrite)]
    files = sorted(file for bag in bags for file in bag.iterdir())
    lines = [f"{hashlib.sha256(f.read_bytes()).hexdigest()}  {f.relative_to(folder).as_posix()}\n" for f in files]
    with writing(checksums):
        checksums.write_text("".join(lines), encoding="utf-8")
    return (*bags, checksums)


def main() -> int:
    """Generate the recordings; return 0, or 2 with one line on stderr."""
    parser = argparse.ArgumentParser(description="Generate the shipped recordings.")
    parser.add_argument("-o", dest="folder", type=Path, required=True, help="output folder")
    parser.add_argument("--force", action="store_true", help="replace existing recordings")
    options = parser.parse_args()
    try:
        for path in generate(options.folder, overwrite=options.force):
            print(path)  # noqa: T201 - a command prints
    except EffmassError as error:
        print(error, file=sys.stderr)  # noqa: T201
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
