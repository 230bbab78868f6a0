# SPDX-License-Identifier: Apache-2.0
"""Convert sensor_msgs/JointState messages to and from `JointState`."""

import struct
from dataclasses import dataclass

import numpy as np

from scara_effmass.values import NO_VALUES, FloatArray, JointState
from scara_effmass.wire.cdr import FRAME_AT, NS, Cursor, encode

MAX_NAMES = 1000
"""Maximum number of names in a JointState; decoding many more would delay the next messages."""


@dataclass(frozen=True, slots=True)
class JointStateLayout:
    """Byte offsets of the fields of a JointState, which do not change while a publisher sends the same names.

    Offsets (`..._at`) and `size` are in bytes from the start of the message; counts are numbers of float64. `fixed` are
    the byte ranges (start, stop) of lengths and names. Messages of equal size with equal bytes there have the same
    layout.
    """

    byte_order: str
    size: int
    names: tuple[str, ...]
    position_count_at: int
    position_at: int
    position_count: int
    velocity_count_at: int
    velocity_at: int
    velocity_count: int
    effort_count_at: int
    effort_at: int
    effort_count: int
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
    position_count_at = cursor.aligned(4)
    position_at, position_count = cursor.skip_numbers("position")
    velocity_count_at = cursor.at
    velocity_at, velocity_count = cursor.skip_numbers("velocity")
    effort_count_at = cursor.at
    effort_at, effort_count = cursor.skip_numbers("effort")
    cursor.end("effort")
    return JointStateLayout(
        byte_order=cursor.byte_order,
        size=len(data),
        names=names,
        position_count_at=position_count_at,
        position_at=position_at,
        position_count=position_count,
        velocity_count_at=velocity_count_at,
        velocity_at=velocity_at,
        velocity_count=velocity_count,
        effort_count_at=effort_count_at,
        effort_at=effort_at,
        effort_count=effort_count,
        fixed=((0, 2), *cursor.fixed),
    )


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
        if len(data) != self._size:
            self._learn_layout(data)
        order, sec, nanosec, prefix, velocity_count, effort_count = self._unpack(data)
        if (
            prefix != self._prefix
            or velocity_count != self._velocity_count
            or effort_count != self._effort_count
            or order != self._order
        ):
            self._learn_layout(data)
            order, sec, nanosec, prefix, velocity_count, effort_count = self._unpack(data)
        # One copy holds position and velocity; within the message they are not aligned.
        values = self._numbers(data[self._first : self._last])
        return JointState(
            sec * NS + nanosec,
            self._names,
            values[: self._position_count],
            values[self._velocity_first : self._velocity_last],
            self._numbers(data[self._efforts]) if effort_count else NO_VALUES,
        )

    def _numbers(self, data: bytes) -> FloatArray:
        values = np.frombuffer(data, self._dtype)
        if not self._native:
            values = values.astype(np.float64)
            values.flags.writeable = False
        return values

    def _learn_layout(self, data: bytes) -> None:
        self._size = -1
        layout = joint_state_layout(data)
        prefix = layout.position_count_at + 4 - FRAME_AT
        before_velocity = layout.velocity_count_at - layout.position_count_at - 4
        before_effort = layout.effort_count_at - layout.velocity_count_at - 4
        message = struct.Struct(f"{layout.byte_order}2s2xiI{prefix}s{before_velocity}xI{before_effort}xI")
        self._unpack = message.unpack_from
        self._order, _, _, self._prefix, self._velocity_count, self._effort_count = message.unpack_from(data)
        if layout.names != self._names:
            self._names = layout.names
        self._dtype = np.dtype(f"{layout.byte_order}f8")
        self._native = self._dtype.isnative
        self._first = layout.position_at if layout.position_count else layout.velocity_at
        self._last = (
            layout.velocity_at + 8 * layout.velocity_count
            if layout.velocity_count
            else self._first + 8 * layout.position_count
        )
        self._position_count = layout.position_count
        self._velocity_first = (layout.velocity_at - self._first) // 8 if layout.velocity_count else 0
        self._velocity_last = self._velocity_first + layout.velocity_count
        self._efforts = slice(layout.effort_at, layout.effort_at + 8 * layout.effort_count)
        self._size = layout.size
