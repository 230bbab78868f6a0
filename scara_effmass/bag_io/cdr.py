"""`sensor_msgs/JointState` out of CDR bytes, as they come from a subscription or from a recording.

CDR (OMG DDSI-RTPS 10, XCDR version 1): two bytes of byte order and two of options; then every number stands at a
multiple of its size, counted from byte 4; strings and sequences begin with their length as uint32. Senders leave
anything at all in the gaps between.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

from scara_effmass.errors import DecodeError
from scara_effmass.values import JointState

ORIGIN = 4
"""Where alignment counts from: the byte behind the encapsulation header."""

STAMP_AT = 4
FRAME_AT = 12

LARGEST_TAIL = 15
"""Bytes that may follow the last field: rclpy's serialize_message adds 4 for each empty sequence, others round up."""

BYTE_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<"}

NS = 1_000_000_000


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
    cursor = _Cursor(data)
    cursor.skip_text("header.frame_id")
    names = tuple(cursor.text(f"name[{index}]") for index in range(cursor.count("name", 4)))
    position_count_at = cursor.aligned(4)
    position_at, position_count = cursor.numbers("position")
    velocity_count_at = cursor.at
    velocity_at, velocity_count = cursor.numbers("velocity")
    effort_count_at = cursor.at
    cursor.numbers("effort")
    tail = len(data) - cursor.at
    if tail > LARGEST_TAIL:
        raise DecodeError(f"JointState: {tail} bytes behind effort, where at most {LARGEST_TAIL} may follow")
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


class _Cursor:
    """Reads CDR from the front and notes in `fixed` the bytes that decide the layout."""

    def __init__(self, data: bytes) -> None:
        if data[:2] not in BYTE_ORDERS:
            raise DecodeError(f"JointState: CDR begins with {data[:2].hex() or 'nothing'}; 0000 or 0001 would be right")
        self.byte_order = BYTE_ORDERS[data[:2]]
        self.at = FRAME_AT
        self.fixed: list[tuple[int, int]] = []
        self._data = data
        self._length = struct.Struct(f"{self.byte_order}I")

    def aligned(self, size: int) -> int:
        """Return the next offset at which a number of `size` bytes can stand."""
        return self.at + (ORIGIN - self.at) % size

    def count(self, field: str, size: int) -> int:
        """Read the length of `field`, whose items take at least `size` bytes each."""
        start = self.aligned(4)
        self.at = start + 4
        left = len(self._data) - self.at
        if left < 0:
            raise DecodeError(f"JointState: the message ends at byte {len(self._data)}, before {field}")
        (count,) = self._length.unpack_from(self._data, start)
        if count * size > left:
            raise DecodeError(f"JointState: {field} has length {count}, but only {left} bytes follow")
        self.fixed.append((start, self.at))
        return int(count)

    def numbers(self, field: str) -> tuple[int, int]:
        """Step over a float64[]; return where it begins and how many there are."""
        count = self.count(field, 8)
        start = self.aligned(8) if count else self.at
        self.at = start + 8 * count
        if self.at > len(self._data):
            raise DecodeError(f"JointState: the message ends at byte {len(self._data)}, inside {field}")
        return start, count

    def skip_text(self, field: str) -> None:
        """Step over a string whose content does not matter."""
        size = self.count(field, 1)
        self.at += size

    def text(self, field: str) -> str:
        """Read a string."""
        size = self.count(field, 1)
        start, self.at = self.at, self.at + size
        self.fixed.append((start, self.at))
        try:
            text = self._data[start : self.at].decode()
        except UnicodeDecodeError:
            raise DecodeError(f"JointState: {field} is not UTF-8") from None
        if text and not text.endswith("\0"):
            raise DecodeError(f"JointState: {field} does not end in a zero byte")
        return text[:-1]
