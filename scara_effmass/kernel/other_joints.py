# SPDX-License-Identifier: Apache-2.0
"""Joints in the joint states that the model does not move: whether they move, as a rail does, or rest elsewhere."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from scara_effmass.kernel.admission import CONFIRMATION_NS, NANOSECONDS, displacement
from scara_effmass.kernel.compiled import FLAGS, INTEGER, INTEGERS, MATRIX, NUMBER, VECTOR, compiled, inlined
from scara_effmass.kernel.records import IntArray
from scara_effmass.values import BoolArray, FloatArray

MAX_NAMES = 10_000
"""Number of joints that are remembered; a joint beyond them counts as one that moves."""
TOO_MANY = "one of too many other joints"
MIN_SILENCE_NS = 3 * NANOSECONDS // 2
"""Shortest time without a joint after which it counts as SILENT: a gripper that reports at 1 Hz is none."""
RESTS, MOVES, UNSEEN, SILENT, ELSEWHERE, UNREPORTED = range(6)
"""State of a joint: UNSEEN has no finite position, SILENT is reported no more, so both may move; ELSEWHERE rests, but
not where the model holds it; UNREPORTED was in no joint state yet, though the model holds it somewhere."""
TEXTS = ("", "{} moves", "{} may move (it shows no position)", "{} may move (it is silent)", "{}", "{}")
"""What the reason says of a joint, by its state."""
_NEVER = -1


class Found(NamedTuple):
    """For each of N joint states the number of the first joint that does not rest, its state, and where it was last.

    `numbers` and `states` (N,) are RESTS without such a joint, `positions` (N,) [rad, m] where it last came to rest.
    """

    numbers: IntArray
    states: IntArray
    positions: FloatArray


class OtherJoints:
    """Remembers the joints outside the model by number, which of them move, and which rest elsewhere than in the model.

    A joint moves that is faster than a speed, or displaced by more than a tolerance since it last moved, until it has
    rested for CONFIRMATION_NS. One that moved in its last joint state still moves, however long ago that was.
    """

    def __init__(self, held: Mapping[str, float], expected: Sequence[str] = ()) -> None:
        """Expect joints where the model holds them, `held` [rad, m] by name; those `expected` must be seen."""
        self.names = [TOO_MANY]
        self.expected = [*expected]
        """Joints that had not been seen when the joints were last forgotten."""
        self._numbers: dict[str, int] = {}
        self._seen_ns: IntArray = np.empty(0, np.int64)
        self._held_at = held
        self.tolerance, self.max_speed = 0.0, 0.0
        """Displacement [rad, m] and speed [rad/s, m/s] up to which a joint rests."""
        self.held_tolerance, self.silence_ns = 0.0, MIN_SILENCE_NS
        """Distance [rad, m] up to which a joint is where the model holds it; time [ns] after which it is silent."""
        self.forget()

    def forget(self) -> None:
        """Forget which joints there were, and where. One that was seen need not be seen again: it may have gone."""
        seen = {name for name, number in self._numbers.items() if self._seen_ns[number] != _NEVER}
        self.expected = [name for name in self.expected if name not in seen]
        self._anchors = self.held = np.empty(0)
        self._moved_ns = self._seen_ns = self._states = np.empty(0, np.int64)
        self._has_moved = np.empty(0, np.bool_)
        self.has_seen = bool(self.expected)
        """Whether there was a joint, or must be one."""
        unreported = self.numbers(self.expected)
        self._states[unreported] = UNREPORTED

    def _extend(self) -> None:
        """Make room for joints that have no memory yet."""
        new = self.names[len(self._states) :]
        zeros = np.zeros(len(new), np.int64)
        self._anchors = np.append(self._anchors, np.full(len(new), math.nan))
        self.held = np.append(self.held, [self._held_at.get(name, math.nan) for name in new])
        self._moved_ns, self._states = np.append(self._moved_ns, zeros), np.append(self._states, zeros)
        self._seen_ns = np.append(self._seen_ns, zeros + _NEVER)
        self._has_moved = np.append(self._has_moved, zeros > 0)

    def numbers(self, names: Sequence[str]) -> IntArray:
        """Return the numbers of the joints with these names."""
        for name in names:
            if name not in self._numbers and len(self.names) < MAX_NAMES:
                self._numbers[name] = len(self.names)
                self.names.append(name)
        self._extend()
        return np.array([self._numbers.get(name, 0) for name in names], np.int64)

    @property
    def moved(self) -> tuple[str, ...]:
        """Names of the joints that have moved, or may have."""
        return tuple(self.names[number] for number in np.flatnonzero(self._has_moved).tolist())

    def text(self, number: int, state: int) -> str:
        """Return the name of a joint and what its `state` means; of one that is UNREPORTED, all of `expected`."""
        return TEXTS[state].format(", ".join(self.expected) if state == UNREPORTED else self.names[number])

    def watch(self, numbers: IntArray, clocks: IntArray, position: FloatArray, velocity: FloatArray) -> Found | None:
        """Return what is found in each of N joint states; None if every joint rests.

        `numbers` (m,) are those of the joints that the joint states have besides those of the robot, `clocks` (N,) [ns]
        the times of arrival, `position` and `velocity` (N, m) are NaN where unknown.
        """
        self.has_seen = self.has_seen or len(numbers) > 0
        count = len(clocks)
        found = Found(np.zeros(count, np.int64), np.zeros(count, np.int64), np.full(count, math.nan))
        memory = self._anchors, self.held, self._moved_ns, self._seen_ns, self._states, self._has_moved
        limits = self.tolerance, self.max_speed, self.held_tolerance, self.silence_ns
        return found if watch(clocks, position, velocity, numbers, *memory, *limits, *found) else None


@inlined
def _state_at(clock: int, state: int, seen_ns: int, silence_ns: int) -> int:
    """Return the state at `clock` of a joint that had a `state` at `seen_ns`."""
    is_silent = seen_ns != _NEVER and abs(clock - seen_ns) > silence_ns
    return SILENT if is_silent and state in (RESTS, ELSEWHERE) else state


@compiled(
    *(INTEGERS, MATRIX, MATRIX, INTEGERS),
    *(VECTOR, VECTOR, INTEGERS, INTEGERS, INTEGERS, FLAGS),
    *(NUMBER, NUMBER, NUMBER, INTEGER),
    *(INTEGERS, INTEGERS, VECTOR),
)
def watch(
    clocks: IntArray,
    position: FloatArray,
    velocity: FloatArray,
    numbers: IntArray,
    anchors: FloatArray,
    held: FloatArray,
    moved_ns: IntArray,
    seen_ns: IntArray,
    states: IntArray,
    has_moved: BoolArray,
    tolerance: float,
    max_speed: float,
    held_tolerance: float,
    silence_ns: int,
    found_numbers: IntArray,
    found_states: IntArray,
    found_positions: FloatArray,
) -> bool:
    """Write the fields of `Found` where a joint does not rest; return whether one did not.

    Positions are compared modulo 2 pi: a wheel may be wrapped, and no slide jumps by that much.
    """
    is_found = False
    for row in range(len(clocks)):
        clock = clocks[row]
        for column in range(len(numbers)):
            number, x, v = numbers[column], position[row, column], velocity[row, column]
            seen_ns[number] = clock
            has_position = math.isfinite(x)
            moves = number == 0 or (math.isfinite(v) and abs(v) > max_speed)
            if has_position:
                anchor = anchors[number]
                if math.isfinite(anchor) and abs(displacement(x, anchor, 2.0 * math.pi)) > tolerance:
                    moves = True
                if moves or not math.isfinite(anchor):
                    anchors[number] = x
            if moves or not has_position:
                states[number] = MOVES if moves else UNSEEN
                moved_ns[number] = clock
                has_moved[number] = True
            elif not 0 <= clock - moved_ns[number] < CONFIRMATION_NS:
                is_held = math.isfinite(held[number])
                is_away = is_held and abs(displacement(x, held[number], 2.0 * math.pi)) > held_tolerance
                states[number] = ELSEWHERE if is_away else RESTS
        for number in range(len(states)):
            state = _state_at(clock, states[number], seen_ns[number], silence_ns)
            if state != RESTS:
                is_found = True
                found_numbers[row], found_states[row], found_positions[row] = number, state, anchors[number]
                break
    return is_found
