# SPDX-License-Identifier: Apache-2.0
"""CDR encoding and decoding of messages whose fields are numbers, strings and sequences.

CDR (OMG DDSI-RTPS 10, XCDR version 1) begins with two bytes for the byte order and two for options. Each number is
aligned to its size, counted from byte 4. Strings and sequences begin with their length as uint32. Padding bytes are
arbitrary.
"""

import struct
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from scara_effmass.errors import DecodeError
from scara_effmass.input_files import read_table

LITTLE_ENDIAN = b"\x00\x01\x00\x00"
BYTE_ORDERS: dict[bytes, Literal["<", ">"]] = {b"\x00\x00": ">", b"\x00\x01": "<"}

ORIGIN = 4
"""Offset from which alignment counts: the end of the encapsulation header."""

STAMP_AT = 4
FRAME_AT = 12
"""Offset of frame_id in a message that begins with a std_msgs/Header."""

MAX_TAIL = 15
"""Number of bytes that may follow the last field: rclpy adds 4 for each empty sequence, other libraries pad."""

NS = 1_000_000_000
COUNT = struct.Struct("<I")
MAX_SEC = 2**31 - 1


def sec_and_nanosec(stamp_ns: int) -> tuple[int, int]:
    """Return the fields of a builtin_interfaces/Time, which ends in 2038."""
    sec, nanosec = divmod(stamp_ns, NS)
    return min(sec, MAX_SEC), nanosec


def header_stamp_ns(data: bytes) -> int:
    """Return the stamp of a message that begins with a std_msgs/Header, 0 if it is truncated."""
    try:
        sec, nanosec = struct.unpack_from(f"{BYTE_ORDERS[data[:2]]}iI", data, STAMP_AT)
    except (KeyError, struct.error):
        return 0
    return int(sec) * NS + int(nanosec)


def with_text(before: bytes, text: str) -> bytes:
    """Append a CDR string to `before`: its aligned length and its zero-terminated bytes."""
    data = text.encode(errors="replace") + b"\x00"  # names of files may be bytes
    return before + b"\x00" * (-len(before) % 4) + COUNT.pack(len(data)) + data


def padded(data: bytes) -> bytes:
    """Pad `data` to a multiple of 8 bytes, the alignment of any number."""
    return data + b"\x00" * (-len(data) % 8)


FORMATS = {
    "bool": ("B", 1),
    "uint32": ("I", 4),
    "uint64": ("Q", 8),
    "float64": ("d", 8),
    "vector": ("3d", 8),
    "time": ("iI", 4),
}
"""Format of `struct`, and alignment, of the fields of fixed size; times are int [ns], vectors are (x, y, z)."""

_PACK = {kind: (struct.Struct(f"<{layout}").pack, size) for kind, (layout, size) in FORMATS.items()}
DTYPES = {"float64[]": "<f8", "uint32[]": "<u4"}

MESSAGES: Mapping[str, Mapping[str, str]] = read_table(__file__, "messages.yaml")
"""Kinds of the fields of each message, in the order of its definition."""


def encode(message_type: str, values: Mapping[str, Any]) -> bytes:
    """Return the CDR bytes of a message of `MESSAGES`.

    The kind of a field is a key of `FORMATS`, "text", "float64[]", "uint32[]" or "text[]".
    """
    data = bytearray()
    for name, kind in MESSAGES[message_type].items():
        _append(data, kind, values[name])
    return LITTLE_ENDIAN + bytes(data)


def _append(data: bytearray, kind: str, value: Any) -> None:  # noqa: ANN401 - a value of this kind
    """Append a field to the message in place, because copying a long message takes longer than its fields."""
    if kind in FORMATS:
        pack, size = _PACK[kind]
        numbers = sec_and_nanosec(value) if kind == "time" else value if kind == "vector" else (value,)
        data += bytes(-len(data) % size) + pack(*numbers)
    elif kind == "text":
        data += bytes(-len(data) % 4) + with_text(b"", value)
    else:
        _append(data, "uint32", len(value))
        if kind == "text[]":
            for text in value:
                _append(data, "text", text)
        elif len(value):  # an empty sequence has no padding after its length
            items = np.asarray(value, DTYPES[kind])
            data += bytes(-len(data) % items.itemsize)
            data += items.tobytes()


def decode(data: bytes, message_type: str, lacking: int = 0) -> dict[str, Any]:
    """Return the fields of a message in CDR of either byte order; see `encode`. Raises DecodeError.

    Messages of earlier versions are `lacking` this number of fields at the end.
    """
    cursor = Cursor(data, message_type)
    fields = dict(list(MESSAGES[message_type].items())[: -lacking or None])
    values = {name: cursor.read(name, kind) for name, kind in fields.items()}
    cursor.end(list(fields)[-1])
    return values


class Cursor:
    """Reads the fields of a message one after the other.

    If the bytes are invalid, methods raise a DecodeError that names the `message_type`. `fixed` collects the byte
    ranges (start, stop) of lengths and texts, which determine the layout.
    """

    def __init__(self, data: bytes, message_type: str) -> None:
        self.message_type = message_type
        if data[:2] not in BYTE_ORDERS:
            raise self.error(f"CDR byte order = {data[:2].hex() or 'missing'}: must be 0000 or 0001")
        self.byte_order = BYTE_ORDERS[data[:2]]
        self.at = ORIGIN
        self.fixed: list[tuple[int, int]] = []
        self._data = data
        self._length = struct.Struct(f"{self.byte_order}I")

    def error(self, reason: str) -> DecodeError:
        """Return a DecodeError with this reason."""
        return DecodeError(f"{self.message_type}: {reason}")

    def aligned(self, size: int) -> int:
        """Return the next offset at which a number of `size` bytes is aligned."""
        return self.at + (ORIGIN - self.at) % size

    def count(self, field: str, size: int) -> int:
        """Read the length of `field`, whose items have at least `size` bytes each."""
        start = self._skip(field, 4, 4)
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

    def read(self, field: str, kind: str) -> Any:  # noqa: ANN401 - a value of this kind
        """Read a field of a kind that `encode` lists; arrays are read-only and in native byte order."""
        if kind == "text":
            return self.text(field)
        if kind in DTYPES:
            return self._array(field, np.dtype(DTYPES[kind]).newbyteorder(self.byte_order))
        layout, alignment = FORMATS[kind]
        layout = f"{self.byte_order}{layout}"
        numbers = struct.unpack_from(layout, self._data, self._skip(field, struct.calcsize(layout), alignment))
        if kind == "time":
            return numbers[0] * NS + numbers[1]
        if kind == "bool" and numbers[0] > 1:
            raise self.error(f"{field} = {numbers[0]}: must be 0 or 1")
        return numbers if kind == "vector" else bool(numbers[0]) if kind == "bool" else numbers[0]

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

    def end(self, last_field: str) -> None:
        """Check that the message ends after `last_field`."""
        tail = len(self._data) - self.at
        if tail > MAX_TAIL:
            raise self.error(f"{tail} bytes follow {last_field}: must be <= {MAX_TAIL}")

    def _array(self, field: str, dtype: np.dtype[Any]) -> NDArray[Any]:
        start, count = self.skip_numbers(field, dtype.itemsize)
        # Slicing copies the bytes: within the message, numbers are not aligned in memory.
        items = np.frombuffer(self._data[start : start + count * dtype.itemsize], dtype)
        items = items.astype(dtype.newbyteorder("="), copy=False)
        items.flags.writeable = False
        return items

    def _skip(self, field: str, size: int, alignment: int) -> int:
        """Skip an aligned field of `size` bytes; return its offset."""
        start = self.aligned(alignment)
        self.at = start + size
        if self.at > len(self._data):
            raise self.error(f"the message ends at byte {len(self._data)}, before {field}")
        return start
