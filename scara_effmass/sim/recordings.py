"""The reference recordings: what the joints do in each, as joint states, and what force there is."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from scara_effmass.sim.motion import JointMove, LineMove, Quintic, Trapezoid, pose_at, sampled
from scara_effmass.sim.scara_kinematics import ElbowConfig
from scara_effmass.sim.synthetic_force import Pulse, synthetic_force
from scara_effmass.values import JointState

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from scara_effmass.sim.motion import Move
    from scara_effmass.values import FloatArray, ForceBlock

JOINTS = ("joint1", "joint2", "joint3", "joint4")
EPOCH_NS = 1_767_225_600_000_000_000
"""2026-01-01 00:00:00 UTC: a fictitious start, so that a recording does not depend on when it was made."""
SEED = 550
REVISION = 2
"""To be raised when a recording changes."""

POSITION_STEP = np.array([2.0 * math.pi / 2**20, 2.0 * math.pi / 2**20, 1e-6, 2.0 * math.pi / 2**20])
"""What one count of the imagined encoders is [rad, rad, m, rad]."""
VELOCITY_STEP = np.array([1e-4, 1e-4, 1e-5, 1e-4])
"""What one count of the imagined velocity estimates is [rad/s, rad/s, m/s, rad/s]."""


@dataclass(frozen=True, slots=True)
class ReferenceRecording:
    """A recording to be made: its name, what it shows, and the motion (m, 4) at `frequency` [Hz].

    With `hits`, it also has force, which knows nothing of the motion.
    """

    name: str
    description: str
    frequency: int
    motion: Callable[[], tuple[FloatArray, FloatArray]]
    hits: tuple[Pulse, ...] = ()

    def states(self) -> Iterator[JointState]:
        """Yield the joint states, at regular stamps from `EPOCH_NS` on."""
        period_ns = 1_000_000_000 // self.frequency
        for number, (q, qd) in enumerate(zip(*self.motion(), strict=True)):
            yield JointState(EPOCH_NS + number * period_ns, JOINTS, q, qd)

    def force_blocks(self) -> Iterator[ForceBlock]:
        """Yield the force, as long as the motion; none without hits."""
        if not self.hits:
            return iter(())
        q, _ = self.motion()
        return synthetic_force(self.hits, len(q) / self.frequency, EPOCH_NS, SEED)


def straight() -> tuple[FloatArray, FloatArray]:
    """Return the motion of the paper's impact test: along x through (300, 200) mm at 250 mm/s, right arm, exact.

    Speed, point, arm and q3 are the paper's (section 5); the length of 200 mm and 2.5 m/s2 are chosen here.
    """
    start, end, q3 = (0.2, 0.2), (0.4, 0.2), 0.236
    return sampled(
        (
            LineMove(start, start, ElbowConfig.RIGHT, q3, Quintic(0.5)),
            LineMove(start, end, ElbowConfig.RIGHT, q3, Trapezoid(length=0.2, speed=0.25, acceleration=2.5)),
            LineMove(end, end, ElbowConfig.RIGHT, q3, Quintic(0.5)),
        ),
        frequency=1000,
    )


def tour() -> tuple[FloatArray, FloatArray]:
    """Return a tour of the workspace, as encoders would have seen it."""
    return measured(*sampled(tour_moves(), frequency=250), random.Random(SEED))  # noqa: S311 - noise, no secret


class Stop(NamedTuple):
    """A pose of the tour [m], and how long it takes to get there [s], straight or joint by joint."""

    seconds: float
    x: float
    y: float
    arm: ElbowConfig = ElbowConfig.RIGHT
    q3: float = 0.236
    straight: bool = True


TOUR = (
    Stop(0.0, 0.30, 0.20),
    Stop(0.5, 0.30, 0.20),
    Stop(2.5, 0.30, -0.20),
    Stop(1.0, 0.45, -0.10),
    Stop(0.9, 0.45, 0.20),
    Stop(0.6, 0.25, 0.25),
    # Pick and place: quill, swing, quill.
    Stop(0.5, 0.25, 0.25, q3=0.05, straight=False),
    Stop(1.4, -0.20, 0.35, q3=0.05, straight=False),
    Stop(0.5, -0.20, 0.35, q3=0.20, straight=False),
    Stop(0.3, -0.20, 0.35, q3=0.20),
    Stop(0.5, -0.20, 0.35, q3=0.05, straight=False),
    Stop(2.2, 0.20, -0.30, q3=0.05, straight=False),
    Stop(1.0, 0.35, 0.00, q3=0.15, straight=False),
    # Out to the stretched arm and back, slowly and then fast: the mass along the arm grows without bound.
    Stop(2.5, 0.5495, 0.00, q3=0.15),
    Stop(1.6, 0.30, 0.00, q3=0.15),
    Stop(0.6, 0.545, 0.00, q3=0.15),
    Stop(0.8, 0.35, 0.00, q3=0.15),
    # The other arm, through the stretched pose, and its half of the workspace.
    Stop(1.5, 0.35, 0.00, ElbowConfig.LEFT, q3=0.15, straight=False),
    Stop(0.3, 0.35, 0.00, ElbowConfig.LEFT, q3=0.15),
    Stop(0.7, 0.30, 0.20, ElbowConfig.LEFT, q3=0.15),
    Stop(0.8, 0.30, -0.20, ElbowConfig.LEFT, q3=0.15),
    Stop(1.0, -0.05, -0.35, ElbowConfig.LEFT, q3=0.15),
    Stop(1.0, 0.35, -0.25, ElbowConfig.LEFT, q3=0.15),
    # Nearly folded, round with it, and a long swing of the stretched arm.
    Stop(1.2, 0.16, -0.05, ElbowConfig.LEFT, q3=0.15, straight=False),
    Stop(1.0, 0.11, 0.12, ElbowConfig.LEFT, q3=0.15, straight=False),
    Stop(1.2, 0.35, 0.42, ElbowConfig.LEFT, q3=0.236, straight=False),
    Stop(1.9, 0.40, -0.37, ElbowConfig.LEFT, q3=0.236, straight=False),
    # Home, through the stretched pose again.
    Stop(2.0, 0.30, 0.20, straight=False),
    Stop(0.5, 0.30, 0.20),
)

TOUR_HITS = (
    Pulse(1.75003, 120.0, 2.5e-3),
    Pulse(4.45001, 310.0, 1.8e-3),
    Pulse(9.80005, 85.0, 3.9e-3),
    Pulse(13.10002, 220.0, 2.2e-3),
    Pulse(16.30004, 540.0, 1.1e-3),
    Pulse(16.32506, 210.0, 1.1e-3, rebound=1),
    Pulse(20.30002, 700.0, 0.8e-3),
)
"""Chosen, at times when the tool moves; which force such an impact would really have, they do not say."""


def tour_moves() -> tuple[Move, ...]:
    """Return the moves from stop to stop of the tour."""
    moves: list[Move] = []
    for here, there in pairwise(TOUR):
        law = Quintic(there.seconds)
        if there.straight:
            moves.append(LineMove((here.x, here.y), (there.x, there.y), there.arm, there.q3, law))
        else:
            start, end = (pose_at((stop.x, stop.y), stop.arm, stop.q3) for stop in (here, there))
            moves.append(JointMove(start, end, law))
    return tuple(moves)


def measured(q: FloatArray, qd: FloatArray, noise: random.Random) -> tuple[FloatArray, FloatArray]:
    """Return `q` and `qd` in whole counts, with up to one count of triangular noise."""

    def counted(values: FloatArray, step: FloatArray) -> FloatArray:
        # random() is the one method whose numbers Python promises to keep from version to version.
        dither = np.array([noise.random() + noise.random() - 1.0 for _ in range(values.size)]).reshape(values.shape)
        counts = np.rint(values / step + dither)
        return np.asarray(counts * step + 0.0, np.float64)  # adding 0 makes -0 a plain one

    return counted(q, POSITION_STEP), counted(qd, VELOCITY_STEP)


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
        TOUR_HITS,
    ),
)
