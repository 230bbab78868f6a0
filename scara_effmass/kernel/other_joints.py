# SPDX-License-Identifier: Apache-2.0
"""Joints in the joint states that are not in the model: whether they move, as a rail or a second arm does."""

from __future__ import annotations

import math

import numpy as np

from scara_effmass.kernel.admission import CONFIRMATION_NS, displacement
from scara_effmass.kernel.jit import compiled
from scara_effmass.kernel.records import IntArray
from scara_effmass.values import BoolArray, FloatArray

NOT_MOVING = -1
MAX_NAMES = 10_000
"""Number of joints that are remembered; a joint beyond them counts as one that moves."""
TOO_MANY = "one of too many other joints"
RESTS, MOVES, UNSEEN = range(3)
"""State of a joint: UNSEEN has neither a position nor a velocity that are finite, and may move."""


class OtherJoints:
    """Remembers the joints outside the model by number, and which of them move.

    A joint moves that is faster than a speed, or displaced by more than a tolerance since it last moved, until it has
    rested for CONFIRMATION_NS. One that moved in its last joint state still moves, however long ago that was.
    """

    def __init__(self) -> None:
        self.names = [TOO_MANY]
        self._numbers: dict[str, int] = {}
        self.tolerance, self.max_speed = 0.0, 0.0
        """Displacement [rad, m] and speed [rad/s, m/s] up to which a joint rests."""
        self.forget()

    def compile(self) -> None:
        """Compile or load what `watch` calls."""
        self.watch(self.numbers(["joint"]), np.ones(1, np.int64), np.zeros((1, 1)), np.zeros((1, 1)))

    def forget(self) -> None:
        """Forget where the joints were and that they moved."""
        count = len(self.names)
        self._anchors, self._moved_ns = np.full(count, math.nan), np.zeros(count, np.int64)
        self._states, self.has_moved = np.zeros(count, np.int64), np.zeros(count, np.bool_)
        self.is_moving = False
        """Whether a joint moves, or moved in its last joint state."""

    def numbers(self, names: list[str]) -> IntArray:
        """Return the numbers of the joints with these names."""
        for name in names:
            if name not in self._numbers and len(self.names) < MAX_NAMES:
                self._numbers[name] = len(self.names)
                self.names.append(name)
        more = len(self.names) - len(self._anchors)
        self._anchors = np.append(self._anchors, np.full(more, math.nan))
        self._moved_ns, self._states = np.pad(self._moved_ns, (0, more)), np.pad(self._states, (0, more))
        self.has_moved = np.pad(self.has_moved, (0, more))
        return np.array([self._numbers.get(name, 0) for name in names], np.int64)

    @property
    def moved(self) -> tuple[str, ...]:
        """Names of the joints that have moved, or may have."""
        return tuple(self.names[number] for number in np.flatnonzero(self.has_moved).tolist())

    def text(self, number: int) -> str:
        """Return the name of the joint that moves, and why it counts as one if it shows no motion."""
        unseen = self._states[number] == UNSEEN
        return f"{self.names[number]} (which shows neither position nor velocity)" if unseen else self.names[number]

    def watch(self, numbers: IntArray, clocks: IntArray, position: FloatArray, velocity: FloatArray) -> IntArray | None:
        """Return for each of N joint states the number of a joint that moves, or NOT_MOVING; None if none moves.

        `numbers` (m,) are those of the joints that the joint states have besides those of the robot, `clocks` (N,) [ns]
        the times of arrival, `position` and `velocity` (N, m) are NaN where unknown.
        """
        beside = self._moving_beside(numbers) if self.is_moving else NOT_MOVING
        first = np.full(len(clocks), beside, np.int64)
        moved = False
        if len(numbers):
            limits, memory = (self.tolerance, self.max_speed), (self._anchors, self._moved_ns, self._states)
            moved = watch(clocks, position, velocity, numbers, *memory, self.has_moved, *limits, first)
            self.is_moving = beside != NOT_MOVING or bool(self._states[numbers].any())
        return first if moved or beside != NOT_MOVING else None

    def _moving_beside(self, numbers: IntArray) -> int:
        """Return the number of a joint that moves and is none of `numbers`, NOT_MOVING if there is none."""
        beside = np.setdiff1d(np.flatnonzero(self._states), numbers)
        return int(beside[0]) if len(beside) else NOT_MOVING


@compiled
def watch(
    clocks: IntArray,
    position: FloatArray,
    velocity: FloatArray,
    numbers: IntArray,
    anchors: FloatArray,
    moved_ns: IntArray,
    states: IntArray,
    has_moved: BoolArray,
    tolerance: float,
    max_speed: float,
    first: IntArray,
) -> bool:
    """Write in `first` (N,) the number of the first joint that moves, if one does; return whether one did.

    Positions are compared modulo 2 pi: a wheel may be wrapped, and no slide jumps by that much.
    """
    moved = False
    for row in range(len(clocks)):
        is_found = False
        for column in range(len(numbers)):
            number, x, v = numbers[column], position[row, column], velocity[row, column]
            has_position, has_velocity = math.isfinite(x), math.isfinite(v)
            moves = number == 0 or (has_velocity and abs(v) > max_speed)
            if has_position:
                anchor = anchors[number]
                if math.isfinite(anchor) and abs(displacement(x, anchor, 2.0 * math.pi)) > tolerance:
                    moves = True
                if moves or not math.isfinite(anchor):
                    anchors[number] = x
            if moves or not (has_position or has_velocity):
                states[number] = MOVES if moves else UNSEEN
                moved_ns[number] = clocks[row]
                has_moved[number] = True
            elif not 0 <= clocks[row] - moved_ns[number] < CONFIRMATION_NS:
                states[number] = RESTS
            if not is_found and states[number] != RESTS:
                is_found = moved = True
                first[row] = number
    return moved
