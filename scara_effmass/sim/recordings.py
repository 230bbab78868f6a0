# SPDX-License-Identifier: Apache-2.0
"""The reference recordings: their motion as joint states, and their synthetic force."""

import random
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import pairwise
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple

from scara_effmass.bags.writer import BagWriter
from scara_effmass.input_files import read_table
from scara_effmass.sim.measurement import quantize
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
from scara_effmass.sim.synthetic_force import BLOCK_NS, Pulse, synthetic_force
from scara_effmass.values import FloatArray, ForceBlock, JointState, RunInfo
from scara_effmass.wire import topics
from scara_effmass.wire.force import force_block_message
from scara_effmass.wire.joint_state import joint_state_message
from scara_effmass.wire.message_types import FORCE_BLOCK, JOINT_STATE, RUN_INFO
from scara_effmass.wire.run_info import run_info_message

JOINTS = ("joint1", "joint2", "joint3", "joint4")
EPOCH_NS = 1_767_225_600_000_000_000
"""Fictitious start, 2026-01-01 00:00:00 UTC: recordings do not depend on the day they are generated."""
SEED = 550
REVISION = 3
"""Increase it when a recording changes."""
FORCE_TOPIC = f"/{topics.FORCE}"


def write_recording(
    path: Path,
    info: RunInfo,
    joint_states: Iterable[JointState],
    force_blocks: Iterable[tuple[int, ForceBlock]],
    *,
    overwrite: bool,
) -> None:
    """Write a bag with the live suite's topics; force blocks come with their log time [ns]. Raises OutputError."""
    states_topic = f"/{topics.JOINT_STATES}"
    messages = [(state.stamp_ns, states_topic, JOINT_STATE, joint_state_message(state)) for state in joint_states]
    messages += [(time_ns, FORCE_TOPIC, FORCE_BLOCK, force_block_message(block)) for time_ns, block in force_blocks]
    with BagWriter(path, overwrite=overwrite) as bag:
        bag.write(f"/{topics.RUN_INFO}", RUN_INFO, info.stamp_ns, run_info_message(info))
        for time_ns, topic, message_type, data in sorted(messages, key=itemgetter(0)):
            bag.write(topic, message_type, time_ns, data)


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

    @property
    def elbow_config(self) -> ElbowConfig:
        """Right or left arm."""
        return ElbowConfig[self.elbow]


_TOUR = read_table(__file__, "tour.yaml")
TOUR_PULSES = tuple(Pulse(*values) for values in _TOUR["pulses"])


def tour_moves() -> tuple[Move, ...]:
    """Return the moves between the waypoints of the tour."""
    moves: list[Move] = []
    for start, end in pairwise(Waypoint(**values) for values in _TOUR["waypoints"]):
        time_scaling = QuinticScaling(end.seconds)
        if end.linear:
            moves.append(LinearMove((start.x, start.y), (end.x, end.y), end.elbow_config, end.q3, time_scaling))
        else:
            q_start, q_end = (joint_positions_at((p.x, p.y), p.elbow_config, p.q3) for p in (start, end))
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
