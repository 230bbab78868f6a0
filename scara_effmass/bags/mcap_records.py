"""The bytes of an MCAP file: its records, its chunks, and the messages in them, found without decoding one by one.

Format: https://mcap.dev/spec. Every record is an opcode (1 byte), a length (8 bytes) and as many bytes of content.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode

from scara_effmass.bags.batches import LATEST_NS
from scara_effmass.errors import DecodeError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from typing import BinaryIO

    from numpy.typing import NDArray

    from scara_effmass.bags.batches import IntArray

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
MESSAGE_HEAD = 22
"""Bytes of a message record before the message: channel (2), sequence (4), log time (8), publish time (8)."""
CHUNK_HEAD = struct.Struct("<QQQII")
LARGEST_CHUNK = 1 << 30
RUN_GROWTH = 4


class Record(NamedTuple):
    """A record: where its content begins, how long it should be, and how much of it the file has."""

    opcode: int
    at: int
    size: int
    present: int


def records(file: BinaryIO, size: int) -> Iterator[Record]:
    """Yield the records of a file of `size` bytes from behind the magic on; the last one may be incomplete."""
    at = len(MAGIC)
    while at + HEAD.size <= size:
        file.seek(at)
        opcode, length = HEAD.unpack(file.read(HEAD.size))
        at += HEAD.size
        yield Record(opcode, at, length, min(length, size - at))
        at += length


@dataclass(frozen=True, slots=True)
class Segment:
    """A stretch of records that is read at once: the content of a chunk, or message records that are in none.

    `start_ns` and `end_ns` are the first and last log time in it. `whole_size` and `crc` are those of the
    uncompressed records; `crc` 0 means none was stored. `cut` says that the file ends inside.
    """

    at: int
    size: int
    start_ns: int
    end_ns: int
    compression: str
    whole_size: int
    crc: int
    cut: bool

    def read(self, file: BinaryIO) -> bytes:
        """Return the uncompressed records, of a cut segment those before the cut.

        Raises DecodeError when they are damaged.
        """
        file.seek(self.at)
        stored = file.read(self.size)
        try:
            data = DECOMPRESSORS[self.compression](stored)
        except (zstandard.ZstdError, RuntimeError, MemoryError) as error:
            raise DecodeError(f"its {self.compression} data is damaged: {error}") from None
        if not self.cut and len(data) != self.whole_size:
            raise DecodeError(f"it unpacks to {len(data)} bytes instead of {self.whole_size}")
        if not self.cut and self.crc and zlib.crc32(data) != self.crc:
            raise DecodeError("its checksum is wrong")
        return data


# The incremental interfaces give what can be had of a stream that is cut off.
DECOMPRESSORS: dict[str, Callable[[bytes], bytes]] = {
    "": bytes,
    "zstd": lambda stored: zstandard.ZstdDecompressor().decompressobj().decompress(stored),
    "lz4": lambda stored: bytes(lz4.frame.LZ4FrameDecompressor().decompress(stored)),
}


def chunk_segment(file: BinaryIO, record: Record) -> Segment | None:
    """Return the segment in a chunk record, None where the file ends before its data.

    Raises DecodeError when the record contradicts itself.
    """
    file.seek(record.at)
    head = BytesIO(file.read(min(record.present, 256)))
    fixed = head.read(CHUNK_HEAD.size)
    if len(fixed) < CHUNK_HEAD.size:
        return None
    start_ns, end_ns, whole_size, crc, name_size = CHUNK_HEAD.unpack(fixed)
    name = head.read(min(name_size, 64)).decode("ascii", "replace")
    stored_size = head.read(8)
    if len(stored_size) < 8:
        return None
    size = int.from_bytes(stored_size, "little")
    at = record.at + head.tell()
    if at + size > record.at + record.size or whole_size > LARGEST_CHUNK or size > LARGEST_CHUNK:
        raise DecodeError(f"it claims {size} bytes that unpack to {whole_size} in a record of {record.size}")
    present = min(size, record.at + record.present - at)
    times = min(start_ns, LATEST_NS), min(end_ns, LATEST_NS)
    return Segment(at, present, *times, name, whole_size, crc, cut=present < size)


class MessageTable(NamedTuple):
    """The message records (m,) in a segment, and the other records as (opcode, first byte, last byte + 1)."""

    channel: IntArray
    log_time_ns: IntArray
    start: IntArray
    stop: IntArray
    others: list[tuple[int, int, int]]
    left_over: int


def message_table(data: bytes) -> MessageTable:
    """Find the messages in the records `data`. `left_over` bytes at the end are no complete record.

    Message records of equal length in a row are recognised together, in numpy.
    """
    octets = np.frombuffer(data, np.uint8)
    runs: list[tuple[int, int, int]] = []
    others: list[tuple[int, int, int]] = []
    at, window = 0, 1
    while at + HEAD.size <= len(data):
        opcode, length = HEAD.unpack_from(data, at)
        size = HEAD.size + length
        if at + size > len(data):
            break
        if opcode != Opcode.MESSAGE or length < MESSAGE_HEAD:
            others.append((opcode, at + HEAD.size, at + size))
            at += size
            continue
        count = min(window, (len(data) - at) // size)
        if count > 1:
            heads = octets[at : at + count * size].reshape(count, size)[:, : HEAD.size]
            alike = (heads == heads[0]).all(axis=1)
            count = count if alike.all() else int(alike.argmin())
        window = window * RUN_GROWTH if count == window else 1
        runs.append((at, size, count))
        at += count * size
    first, size, count = np.array(runs, np.int64).reshape(-1, 3).T
    within_run = np.arange(count.sum()) - np.repeat(count.cumsum() - count, count)
    record = np.repeat(first, count) + np.repeat(size, count) * within_run
    return MessageTable(
        _field(octets, record + HEAD.size, "<u2"),
        _field(octets, record + HEAD.size + 6, "<i8"),
        record + HEAD.size + MESSAGE_HEAD,
        record + np.repeat(size, count),
        others,
        len(data) - at,
    )


def _field(octets: NDArray[np.uint8], at: IntArray, number: str) -> IntArray:
    width = np.dtype(number).itemsize
    column: IntArray = octets[at[:, None] + np.arange(width)].view(number)[:, 0].astype(np.int64)
    return column


def stream(content: bytes) -> ReadDataStream:
    """Return `content` in the form from which the record classes of `mcap` read."""
    return ReadDataStream(BytesIO(content))
