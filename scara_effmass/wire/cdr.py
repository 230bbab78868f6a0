"""What CDR messages are made of: numbers, texts and sequences, packed and read.

CDR (OMG DDSI-RTPS 10, XCDR version 1): two bytes of byte order and two of options; then every number stands at a
multiple of its size, counted from byte 4; strings and sequences begin with their length as uint32. Senders leave
anything at all in the gaps between.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Literal, TypeVar

import numpy as np

from scara_effmass.errors import DecodeError

if TYPE_CHECKING:
    from numpy.typing import NDArray

LITTLE_ENDIAN = b"\x00\x01\x00\x00"
BYTE_ORDERS: dict[bytes, Literal["<", ">"]] = {b"\x00\x00": ">", b"\x00\x01": "<"}

ORIGIN = 4
"""Where alignment counts from: the byte behind the encapsulation header."""

STAMP_AT = 4
FRAME_AT = 12
"""Behind the stamp, in a message that begins with a std_msgs/Header."""

LARGEST_TAIL = 15
"""Bytes that may follow the last field: rclpy's serialize_message adds 4 for each empty sequence, others round up."""

NS = 1_000_000_000
LAST_SECOND = 2**31 - 1

Number = TypeVar("Number", np.float64, np.uint32)


def sec_and_nanosec(stamp_ns: int) -> tuple[int, int]:
    """Return the fields of a builtin_interfaces/Time, which ends in 2038."""
    sec, nanosec = divmod(stamp_ns, NS)
    return min(sec, LAST_SECOND), nanosec


def with_text(before: bytes, text: str) -> bytes:
    """Return `before` and a CDR string: its length, at a multiple of 4, and its bytes with a zero behind."""
    data = text.encode() + b"\x00"
    return before + b"\x00" * (-len(before) % 4) + struct.pack("<I", len(data)) + data


def padded(data: bytes) -> bytes:
    """Return `data` filled up to a multiple of 8 bytes, where any number can stand."""
    return data + b"\x00" * (-len(data) % 8)


class Cursor:
    """Reads a message that begins with a Header, from behind its stamp on, and never beyond its bytes.

    Every step raises DecodeError, which names the message's `kind`, where the bytes are not what it expects. `fixed`
    notes the lengths and texts, as ranges of bytes (first, last + 1): what decides the layout.
    """

    def __init__(self, data: bytes, kind: str) -> None:
        self.kind = kind
        if data[:2] not in BYTE_ORDERS:
            raise self.error(f"CDR begins with {data[:2].hex() or 'nothing'}; 0000 or 0001 would be right")
        self.byte_order = BYTE_ORDERS[data[:2]]
        self.at = FRAME_AT
        self.fixed: list[tuple[int, int]] = []
        self._data = data
        self._length = struct.Struct(f"{self.byte_order}I")

    def error(self, reason: str) -> DecodeError:
        """Return the error that says `reason` of this message."""
        return DecodeError(f"{self.kind}: {reason}")

    def aligned(self, size: int) -> int:
        """Return the next offset at which a number of `size` bytes can stand."""
        return self.at + (ORIGIN - self.at) % size

    def count(self, field: str, size: int) -> int:
        """Read the length of `field`, whose items take at least `size` bytes each."""
        start = self._taken(field, 4)
        (count,) = self._length.unpack_from(self._data, start)
        left = len(self._data) - self.at
        if count * size > left:
            raise self.error(f"{field} has length {count}, but only {left} bytes follow")
        self.fixed.append((start, self.at))
        return int(count)

    def numbers(self, field: str, size: int = 8) -> tuple[int, int]:
        """Step over a sequence of numbers of `size` bytes; return where it begins and how many there are."""
        count = self.count(field, size)
        start = self.aligned(size) if count else self.at
        self.at = start + size * count
        if self.at > len(self._data):
            raise self.error(f"the message ends at byte {len(self._data)}, inside {field}")
        return start, count

    def array(self, field: str, number: type[Number]) -> NDArray[Number]:
        """Read a sequence of numbers into a read-only array in native order."""
        kind = np.dtype(number).newbyteorder(self.byte_order)
        start, count = self.numbers(field, kind.itemsize)
        # cut out of the message, as numbers are not aligned in memory there
        array = np.frombuffer(self._data[start : start + count * kind.itemsize], kind).astype(number, copy=False)
        array.flags.writeable = False
        return array

    def integer(self, field: str, size: int) -> int:
        """Read an unsigned integer of `size` bytes."""
        start = self._taken(field, size)
        return int.from_bytes(self._data[start : self.at], "big" if self.byte_order == ">" else "little")

    def float64(self, field: str) -> float:
        """Read a float64."""
        (value,) = struct.unpack_from(f"{self.byte_order}d", self._data, self._taken(field, 8))
        return float(value)

    def flag(self, field: str) -> bool:
        """Read a bool."""
        value = self._data[self._taken(field, 1)]
        if value > 1:
            raise self.error(f"{field} = {value}; 0 or 1 would be right")
        return value == 1

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
            raise self.error(f"{field} is not UTF-8") from None
        if text and not text.endswith("\0"):
            raise self.error(f"{field} does not end in a zero byte")
        return text[:-1]

    def stamp_ns(self, field: str) -> int:
        """Read a builtin_interfaces/Time."""
        sec = self.integer(field, 4)
        return (sec - (sec >> 31 << 32)) * NS + self.integer(field, 4)

    def header(self) -> tuple[int, str]:
        """Read the std_msgs/Header, which every cursor begins in; return its stamp in [ns] and the frame."""
        frame_id = self.text("header.frame_id")
        sec, nanosec = struct.unpack_from(f"{self.byte_order}iI", self._data, STAMP_AT)
        return sec * NS + nanosec, frame_id

    def end(self, last_field: str) -> None:
        """Check that the message ends behind `last_field`."""
        tail = len(self._data) - self.at
        if tail > LARGEST_TAIL:
            raise self.error(f"{tail} bytes behind {last_field}, where at most {LARGEST_TAIL} may follow")

    def _taken(self, field: str, size: int) -> int:
        """Step over `size` bytes at their alignment; return where they begin."""
        start = self.aligned(size)
        self.at = start + size
        if self.at > len(self._data):
            raise self.error(f"the message ends at byte {len(self._data)}, before {field}")
        return start
