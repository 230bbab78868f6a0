"""CDR encoding and decoding of numbers, strings and sequences.

CDR (OMG DDSI-RTPS 10, XCDR version 1): two bytes of byte order and two of options; then each number is aligned to its
size, counted from byte 4; strings and sequences begin with their length as uint32. Padding bytes are arbitrary.
"""

import struct
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from scara_effmass.errors import DecodeError

LITTLE_ENDIAN = b"\x00\x01\x00\x00"
BYTE_ORDERS: dict[bytes, Literal["<", ">"]] = {b"\x00\x00": ">", b"\x00\x01": "<"}

ORIGIN = 4
"""Origin of the alignment: the end of the encapsulation header."""

STAMP_AT = 4
FRAME_AT = 12
"""Offset of frame_id in a message that begins with a std_msgs/Header."""

MAX_TAIL = 15
"""Bytes that may follow the last field: rclpy adds 4 for each empty sequence, other libraries pad."""

NS = 1_000_000_000
STAMP = struct.Struct("<iI")
COUNT = struct.Struct("<I")
MAX_SEC = 2**31 - 1

Number = TypeVar("Number", np.float64, np.uint32)


def sec_and_nanosec(stamp_ns: int) -> tuple[int, int]:
    """Return the fields of a builtin_interfaces/Time, limited to the year 2038."""
    sec, nanosec = divmod(stamp_ns, NS)
    return min(sec, MAX_SEC), nanosec


def with_text(before: bytes, text: str) -> bytes:
    """Append a CDR string to `before`: its aligned length and its zero-terminated bytes."""
    data = text.encode() + b"\x00"
    return before + b"\x00" * (-len(before) % 4) + COUNT.pack(len(data)) + data


def padded(data: bytes) -> bytes:
    """Pad `data` to a multiple of 8 bytes, the alignment of any number."""
    return data + b"\x00" * (-len(data) % 8)


class Cursor:
    """Reads a message that begins with a Header, starting after its stamp.

    Every method raises DecodeError, which names the `message_type`, if the bytes are invalid. `fixed` collects the byte
    ranges (start, stop) of lengths and texts, which determine the layout.
    """

    def __init__(self, data: bytes, message_type: str) -> None:
        self.message_type = message_type
        if data[:2] not in BYTE_ORDERS:
            raise self.error(f"CDR byte order = {data[:2].hex() or 'missing'}: must be 0000 or 0001")
        self.byte_order = BYTE_ORDERS[data[:2]]
        self.at = FRAME_AT
        self.fixed: list[tuple[int, int]] = []
        self._data = data
        self._length = struct.Struct(f"{self.byte_order}I")

    def error(self, reason: str) -> DecodeError:
        """Return a DecodeError with this reason."""
        return DecodeError(f"{self.message_type}: {reason}")

    def aligned(self, size: int) -> int:
        """Return the next offset that is aligned for a number of `size` bytes."""
        return self.at + (ORIGIN - self.at) % size

    def count(self, field: str, size: int) -> int:
        """Read the length of `field`, whose items have at least `size` bytes each."""
        start = self._skip(field, 4)
        (count,) = self._length.unpack_from(self._data, start)
        available = len(self._data) - self.at
        if count * size > available:
            raise self.error(f"{field} has length {count}, but only {available} bytes follow")
        self.fixed.append((start, self.at))
        return int(count)

    def skip_numbers(self, field: str, size: int = 8) -> tuple[int, int]:
        """Skip a sequence of numbers of `size` bytes; return its offset and length."""
        count = self.count(field, size)
        start = self.aligned(size) if count else self.at
        self.at = start + size * count
        if self.at > len(self._data):
            raise self.error(f"the message ends at byte {len(self._data)}, inside {field}")
        return start, count

    def array(self, field: str, number: type[Number]) -> NDArray[Number]:
        """Read a sequence of numbers into a read-only array in native order."""
        dtype = np.dtype(number).newbyteorder(self.byte_order)
        start, count = self.skip_numbers(field, dtype.itemsize)
        # A copy, because numbers in the message are not aligned in memory.
        array = np.frombuffer(self._data[start : start + count * dtype.itemsize], dtype).astype(number, copy=False)
        array.flags.writeable = False
        return array

    def integer(self, field: str, size: int) -> int:
        """Read an unsigned integer of `size` bytes."""
        start = self._skip(field, size)
        return int.from_bytes(self._data[start : self.at], "big" if self.byte_order == ">" else "little")

    def float64(self, field: str) -> float:
        """Read a float64."""
        (value,) = struct.unpack_from(f"{self.byte_order}d", self._data, self._skip(field, 8))
        return float(value)

    def flag(self, field: str) -> bool:
        """Read a bool."""
        value = self._data[self._skip(field, 1)]
        if value > 1:
            raise self.error(f"{field} = {value}: must be 0 or 1")
        return value == 1

    def skip_text(self, field: str) -> None:
        """Skip a string."""
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
            raise self.error(f"{field}: must be UTF-8") from None
        if text and not text.endswith("\0"):
            raise self.error(f"{field}: must end in a zero byte")
        return text[:-1]

    def stamp_ns(self, field: str) -> int:
        """Read a builtin_interfaces/Time."""
        sec = self.integer(field, 4)
        return (sec - (sec >> 31 << 32)) * NS + self.integer(field, 4)

    def header(self) -> tuple[int, str]:
        """Read the std_msgs/Header at the start; return its stamp [ns] and frame."""
        frame_id = self.text("header.frame_id")
        sec, nanosec = struct.unpack_from(f"{self.byte_order}iI", self._data, STAMP_AT)
        return sec * NS + nanosec, frame_id

    def end(self, last_field: str) -> None:
        """Check that the message ends after `last_field`."""
        tail = len(self._data) - self.at
        if tail > MAX_TAIL:
            raise self.error(f"{tail} bytes follow {last_field}: must be <= {MAX_TAIL}")

    def _skip(self, field: str, size: int) -> int:
        """Skip an aligned number of `size` bytes; return its offset."""
        start = self.aligned(size)
        self.at = start + size
        if self.at > len(self._data):
            raise self.error(f"the message ends at byte {len(self._data)}, before {field}")
        return start
