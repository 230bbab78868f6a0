"""`sensor_msgs/JointState` out of CDR bytes, as they come from a subscription or from a recording."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

from scara_effmass.values import JointState
from scara_effmass.wire.cdr import FRAME_AT, NS, Cursor


@dataclass(frozen=True, slots=True)
class JointStateLayout:
    """Where everything stands in a JointState; it stays the same while a publisher keeps its names.

    Offsets (`..._at`) and `size` are in bytes from the start of the message, counts in float64. `fixed` are the
    byte ranges, as (first, last + 1), that decide the layout and the names: messages of equal size that agree
    there are laid out alike.
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
    fixed: tuple[tuple[int, int], ...]


def joint_state_layout(data: bytes) -> JointStateLayout:
    """Return the layout of the JointState in `data`, every length checked against the bytes there are.

    Raises DecodeError.
    """
    cursor = Cursor(data, "JointState")
    cursor.skip_text("header.frame_id")
    names = tuple(cursor.text(f"name[{index}]") for index in range(cursor.count("name", 4)))
    position_count_at = cursor.aligned(4)
    position_at, position_count = cursor.numbers("position")
    velocity_count_at = cursor.at
    velocity_at, velocity_count = cursor.numbers("velocity")
    effort_count_at = cursor.at
    cursor.numbers("effort")
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
        fixed=((0, 2), *cursor.fixed),
    )


class JointStateDecoder:
    """Decodes JointState after JointState; the layout of the last one is tried first, which makes it fast.

    While the names stay equal, every JointState carries the same tuple object of them. Not for several threads.
    """

    __slots__ = (
        "_effort_count",
        "_first",
        "_last",
        "_names",
        "_native",
        "_number",
        "_order",
        "_position_count",
        "_prefix",
        "_size",
        "_unpack",
        "_velocity_count",
        "_velocity_first",
        "_velocity_last",
    )

    def __init__(self) -> None:
        self._size = -1
        self._names: tuple[str, ...] = ()

    def decode(self, data: bytes) -> JointState:
        """Return the JointState in `data`, CDR of either byte order.

        Its arrays are read-only, aligned float64 in native order. Effort is checked but not decoded.
        Raises DecodeError.
        """
        if len(data) != self._size:
            self._learn(data)
        order, sec, nanosec, prefix, velocity_count, effort_count = self._unpack(data)
        if (
            prefix != self._prefix
            or velocity_count != self._velocity_count
            or effort_count != self._effort_count
            or order != self._order
        ):
            self._learn(data)
            order, sec, nanosec, prefix, velocity_count, effort_count = self._unpack(data)
        # position and velocity in one array; cut out of the message, as numbers are not aligned in memory there
        numbers = np.frombuffer(data[self._first : self._last], self._number)
        if not self._native:
            numbers = numbers.astype(np.float64)
            numbers.flags.writeable = False
        return JointState(
            sec * NS + nanosec,
            self._names,
            numbers[: self._position_count],
            numbers[self._velocity_first : self._velocity_last],
        )

    def _learn(self, data: bytes) -> None:
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
        self._number = np.dtype(f"{layout.byte_order}f8")
        self._native = self._number.isnative
        self._first = layout.position_at if layout.position_count else layout.velocity_at
        self._last = (
            layout.velocity_at + 8 * layout.velocity_count
            if layout.velocity_count
            else self._first + 8 * layout.position_count
        )
        self._position_count = layout.position_count
        self._velocity_first = (layout.velocity_at - self._first) // 8 if layout.velocity_count else 0
        self._velocity_last = self._velocity_first + layout.velocity_count
        self._size = layout.size
