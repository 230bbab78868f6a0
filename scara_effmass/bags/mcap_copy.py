# SPDX-License-Identifier: Apache-2.0
"""Copy the readable content of an MCAP file, which may be damaged, to a new file.

Format: https://mcap.dev/spec. A record is an opcode (1 byte), the length of its content (8 bytes) and the content.
`mcap` decodes the records, but this module steps through them itself: `mcap.stream_reader.StreamReader` would drop the
chunk in which a file is cut off, and would stop at the first damaged record.
"""

import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import IO, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Header, Metadata, Schema
from mcap.writer import Writer

from scara_effmass.bags.batches import MAX_TIME_NS, LossLog
from scara_effmass.errors import BagError, DecodeError

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEAD = struct.Struct("<BQ")
MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Channel, sequence number, log time and publish time, which precede the data of a message."""
MAX_CHUNK_BYTES = 1 << 30
MAX_LOOSE_BYTES = 1 << 20
"""Size [B] at which records outside chunks are put into a chunk of the copy."""
DAMAGE = (McapError, struct.error, ValueError, ArithmeticError, LookupError, TypeError)
"""Errors that mcap raises for damaged records."""

# Unlike the functions for whole buffers, these interfaces return the intact part of a truncated stream.
DECOMPRESSORS: dict[str, Callable[[bytes], bytes]] = {
    "": bytes,
    "zstd": lambda data: zstandard.ZstdDecompressor().decompressobj().decompress(data),
    "lz4": lambda data: bytes(lz4.frame.LZ4FrameDecompressor().decompress(data)),
}


def open_mcap(path: Path) -> IO[bytes]:
    """Open an MCAP file. Raises BagError if it is not MCAP, or OSError."""
    file = path.open("rb")
    magic = file.read(len(MAGIC))
    if magic == MAGIC:
        return file
    file.close()
    raise BagError(f"{path}: {'is not an MCAP file' if magic else 'is empty'}")


class Record(NamedTuple):
    """A record: offset and size [B] of its content. `is_cut`: the file ends before the content does."""

    opcode: int
    start: int
    size: int
    is_cut: bool

    def content(self, stream: IO[bytes]) -> bytes:
        """Return the content; of a cut record, the part before the cut."""
        stream.seek(self.start)
        return stream.read() if self.is_cut else stream.read(self.size)


def records(stream: IO[bytes], start: int = len(MAGIC)) -> Iterator[Record]:
    """Yield the records from offset `start` on, without reading their content."""
    end = stream.seek(0, 2)
    while start + RECORD_HEAD.size <= end:
        stream.seek(start)
        opcode, size = RECORD_HEAD.unpack(stream.read(RECORD_HEAD.size))
        start += RECORD_HEAD.size
        yield Record(opcode, start, size, is_cut=start + size > end)
        start += size


def chunk_records(content: bytes, *, is_cut: bool = False) -> bytes:
    """Return the uncompressed records of a chunk; of a cut chunk, the records before the cut.

    Raises DecodeError if the chunk is damaged.
    """
    try:
        chunk = Chunk.read(ReadDataStream(BytesIO(content)))
    except DAMAGE:
        if is_cut:
            return b""
        raise DecodeError("its header is damaged") from None
    if chunk.compression not in DECOMPRESSORS:
        raise DecodeError(f"compression {chunk.compression!r}: must be one of {', '.join(filter(None, DECOMPRESSORS))}")
    if chunk.uncompressed_size > MAX_CHUNK_BYTES:
        raise DecodeError(f"uncompressed size {chunk.uncompressed_size}: must be <= {MAX_CHUNK_BYTES}")
    try:
        data = DECOMPRESSORS[chunk.compression](chunk.data)
    except (zstandard.ZstdError, RuntimeError, MemoryError) as error:
        raise DecodeError(f"its {chunk.compression} data is damaged: {error}") from None
    if not is_cut and len(data) != chunk.uncompressed_size:
        raise DecodeError(f"it decompresses to {len(data)} bytes; expected {chunk.uncompressed_size}")
    if not is_cut and chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise DecodeError("its checksum is wrong")
    return data


@dataclass(slots=True)
class CopyResult:
    """The size of a copy, and the state of the original."""

    messages: int = 0
    is_complete: bool = False
    """The original contains the record that ends the data."""
    cut_off: str = ""
    """Message if the original ends before that record; data is lost only if its last record is torn."""
    has_gaps: bool = False
    """More than the torn end is lost: another tool may be able to read more of the original."""


def copy_records(path: Path, source: IO[bytes], output: IO[bytes], losses: LossLog) -> CopyResult:
    """Copy everything readable in the MCAP file `source` from `path` to `output`, and add index and summary.

    Chunk boundaries, messages, times and sequence numbers stay the same. `losses` lists what cannot be copied.
    """
    header = Header(profile="", library="")
    first = next(records(source), None)
    if first is not None and first.opcode == Opcode.HEADER:
        with suppress(*DAMAGE):
            header = Header.read(ReadDataStream(BytesIO(first.content(source))))
    writer = Writer(output, chunk_size=MAX_TIME_NS)  # chunks end only where those of the original do
    writer.start(header.profile, header.library)
    copy = _Copy(path, writer, losses)
    copy.add_file(source)
    writer.finish()  # type: ignore[no-untyped-call]
    return copy.result


class _Copy:
    """Copies records to a writer, which assigns new ids to schemas and channels."""

    def __init__(self, path: Path, writer: Writer, losses: LossLog) -> None:
        self.result = CopyResult()
        self._path = path
        self._writer = writer
        self._losses = losses
        # For each id in the original: the definition, and its id in the copy.
        self._schemas: dict[int, tuple[Schema, int]] = {}
        self._channels: dict[int, tuple[Channel, int]] = {}
        self._undefined_messages: Counter[int] = Counter()

    def add_file(self, file: IO[bytes]) -> None:
        """Copy the records up to the end of the data."""
        loose_bytes = 0
        end = len(MAGIC)
        for record in records(file):
            end = record.start + record.size
            if record.opcode == Opcode.DATA_END and not record.is_cut:
                self.result.is_complete = True
                return
            if record.opcode == 0:
                self._lose(f"byte {record.start} on is not MCAP; the rest is lost")
                return
            if record.opcode == Opcode.CHUNK:
                self._add_chunk(file, record)
            elif not record.is_cut:
                self._add(record, file)
                loose_bytes += record.size
            if record.opcode == Opcode.CHUNK or loose_bytes > MAX_LOOSE_BYTES:
                self._writer.flush()  # type: ignore[no-untyped-call]
                loose_bytes = 0
        size = file.seek(0, 2)
        self.result.cut_off = f"{self._path}: cut off at byte {size}; the rest is lost"
        if end != size:
            self._losses.add(self.result.cut_off)

    def _lose(self, line: str, count: int = 1) -> None:
        self._losses.add(f"{self._path}: {line}", count)
        self.result.has_gaps = True

    def _add_chunk(self, file: IO[bytes], chunk: Record) -> None:
        """Copy a chunk; of a cut one, the records before the cut."""
        try:
            data = chunk_records(chunk.content(file), is_cut=chunk.is_cut)
        except DecodeError as error:
            self._losses.add(f"{self._path}: chunk at byte {chunk.start} is lost: {error}")
            self.result.has_gaps |= not chunk.is_cut
            return
        end = 0
        stream = BytesIO(data)
        for record in records(stream, start=0):
            if not record.is_cut:
                self._add(record, stream)
                end = record.start + record.size
        if end < len(data) and not chunk.is_cut:
            self._lose(f"chunk at byte {chunk.start}: its last {len(data) - end} bytes are not a record")

    def _add(self, record: Record, stream: IO[bytes]) -> None:
        """Copy a record; those of index and summary are left out, because the writer makes them anew."""
        content = record.content(stream)
        parsed = ReadDataStream(BytesIO(content))
        try:
            if record.opcode == Opcode.MESSAGE:
                self._add_message(content)
            elif record.opcode == Opcode.SCHEMA:
                self._add_schema(Schema.read(parsed))
            elif record.opcode == Opcode.CHANNEL:
                self._add_channel(Channel.read(parsed))
            elif record.opcode == Opcode.METADATA:
                metadata = Metadata.read(parsed)
                self._writer.add_metadata(metadata.name, metadata.metadata)
            elif record.opcode == Opcode.ATTACHMENT:
                file = Attachment.read(parsed)
                self._writer.add_attachment(file.create_time, file.log_time, file.name, file.media_type, file.data)
        except DAMAGE:
            self._lose("a damaged record is lost")

    def _add_schema(self, schema: Schema) -> None:
        if schema.id not in self._schemas or self._schemas[schema.id][0] != schema:
            copied = self._writer.register_schema(schema.name, schema.encoding, schema.data)
            self._schemas[schema.id] = schema, copied

    def _add_channel(self, channel: Channel) -> None:
        if channel.id not in self._channels or self._channels[channel.id][0] != channel:
            schema = self._schemas[channel.schema_id][1] if channel.schema_id in self._schemas else 0
            copied = self._writer.register_channel(channel.topic, channel.message_encoding, schema, channel.metadata)
            self._channels[channel.id] = channel, copied

    def _add_message(self, content: bytes) -> None:
        channel, sequence, log_time_ns, publish_time_ns = MESSAGE_HEAD.unpack_from(content)
        if channel not in self._channels:
            self._undefined_messages[channel] += 1
            line = f"messages of channel {channel}, which the file does not define, are lost"
            self._lose(line, self._undefined_messages[channel])
            return
        if log_time_ns > MAX_TIME_NS:
            raise ValueError(log_time_ns)
        data = content[MESSAGE_HEAD.size :]
        self._writer.add_message(self._channels[channel][1], log_time_ns, data, publish_time_ns, sequence)
        self.result.messages += 1
