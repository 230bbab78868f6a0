# SPDX-License-Identifier: Apache-2.0
"""Convert sensor_msgs/JointState messages to and from `JointState`."""

import struct
from typing import NamedTuple

import numpy as np

from scara_effmass.values import NO_VALUES, FloatArray, JointState
from scara_effmass.wire.cdr import FRAME_AT, NS, STAMP_AT, Cursor, encode

MAX_NAMES = 1000
"""Maximum number of names in a JointState; decoding many more would delay the next messages."""


class Numbers(NamedTuple):
    """Sequence of float64 in a message: the offsets of its length and of its first number, and its length."""

    length_at: int
    at: int
    length: int


class JointStateLayout(NamedTuple):
    """Where the fields of a JointState are, which does not change while a publisher sends the same names.

    Offsets and `size` are in bytes from the start of the message. `fixed` are the byte ranges (start, stop) of lengths
    and names. Messages of equal size with equal bytes there have the same layout.
    """

    byte_order: str
    size: int
    names: tuple[str, ...]
    position: Numbers
    velocity: Numbers
    effort: Numbers
    fixed: tuple[tuple[int, int], ...]


def joint_state_layout(data: bytes) -> JointStateLayout:
    """Return the layout of the JointState in `data`. Raises DecodeError if a length is beyond message or MAX_NAMES."""
    cursor = Cursor(data, "JointState")
    cursor.at = FRAME_AT
    frame_size = cursor.count("header.frame_id", 1)
    cursor.at += frame_size
    name_count = cursor.count("name", 4)
    if name_count > MAX_NAMES:
        raise cursor.error(f"name has length {name_count}: must be <= {MAX_NAMES}")
    names = tuple(cursor.text(f"name[{index}]") for index in range(name_count))
    position, velocity, effort = (
        Numbers(cursor.aligned(4), *cursor.skip_numbers(name)) for name in ("position", "velocity", "effort")
    )
    cursor.end("effort")
    fixed = ((0, 2), *cursor.fixed)
    return JointStateLayout(cursor.byte_order, len(data), names, position, velocity, effort, fixed)


def joint_state_message(state: JointState, frame_id: str = "") -> bytes:
    """Return the CDR bytes of a JointState."""
    return encode("JointState", {**state._asdict(), "frame_id": frame_id})


class JointStateDecoder:
    """Decodes JointState messages; fast as long as the layout does not change. Not thread-safe.

    Consecutive states with equal names share one tuple of names.
    """

    def __init__(self) -> None:
        self._size = -1
        self._names: tuple[str, ...] = ()

    def decode(self, data: bytes) -> JointState:
        """Return the JointState in `data` (CDR of either byte order). Raises DecodeError.

        Its arrays are read-only, aligned float64 in native byte order.
        """
        if len(data) != self._size or self._fixed_bytes(data) != self._fixed:
            self._learn_layout(data)
        sec, nanosec = self._stamp(data, STAMP_AT)
        # One copy holds position and velocity; within the message they are not aligned.
        values = self._numbers(data[self._first : self._last])
        return JointState(
            sec * NS + nanosec,
            self._names,
            values[self._positions],
            values[self._velocities],
            self._numbers(data[self._efforts]) if self._has_effort else NO_VALUES,
        )

    def _fixed_bytes(self, data: bytes) -> bytes:
        """Return byte order, frame, names and lengths."""
        velocity_length, effort_length = self._lengths
        return data[:2] + data[self._head] + data[velocity_length] + data[effort_length]

    def _numbers(self, data: bytes) -> FloatArray:
        values = np.frombuffer(data, self._dtype)
        if not self._native:
            values = values.astype(np.float64)
            values.flags.writeable = False
        return values

    def _learn_layout(self, data: bytes) -> None:
        self._size = -1
        layout = joint_state_layout(data)
        position, velocity, effort = layout.position, layout.velocity, layout.effort
        self._head = slice(FRAME_AT, position.length_at + 4)
        self._lengths = [slice(numbers.length_at, numbers.length_at + 4) for numbers in (velocity, effort)]
        self._fixed, self._has_effort = self._fixed_bytes(data), effort.length > 0
        self._stamp = struct.Struct(f"{layout.byte_order}iI").unpack_from
        if layout.names != self._names:
            self._names = layout.names
        self._dtype = np.dtype(f"{layout.byte_order}f8")
        self._native = self._dtype.isnative
        self._first = position.at if position.length else velocity.at
        first = (velocity.at - self._first) // 8 if velocity.length else 0
        self._positions, self._velocities = slice(position.length), slice(first, first + velocity.length)
        self._last = self._first + 8 * (first + velocity.length if velocity.length else position.length)
        self._efforts = slice(effort.at, effort.at + 8 * effort.length)
        self._size = layout.size
