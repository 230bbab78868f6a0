"""An MCAP file written anew from whatever of another one can be read."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, BinaryIO, final

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema
from mcap.writer import CompressionType, Writer

from scara_effmass.bags.batches import LATEST_NS, Losses
from scara_effmass.bags.mcap_records import HEAD, MESSAGE_HEAD, chunk_segment, records, stream
from scara_effmass.errors import DecodeError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from scara_effmass.bags.mcap_records import Record

_MESSAGE = struct.Struct("<HIQQ")
_COMPRESSION = {"": CompressionType.NONE, "zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4}


@dataclass(slots=True)
class Copied:
    """What a copy holds, and what could not be copied, a line each."""

    messages: int = 0
    lost: Losses = field(default_factory=Losses)
    gaps: bool = False
    """More is lost than the torn end: the original has bytes that somebody else may make sense of."""


def copy_records(path: Path, file: BinaryIO, out: BinaryIO) -> Copied:
    """Write to `out` all that can be read of the MCAP file `file` called `path`, with index and summary.

    Chunks stay as they are cut; messages keep their bytes, times and sequence numbers.
    """
    copied = Copied()
    size = file.seek(0, 2)
    profile, library, compression = _begin(file, size)
    writer = Writer(out, chunk_size=LATEST_NS, compression=compression)
    writer.start(profile, library)
    copy = _Copy(path, writer, copied)
    for record in records(file, size):
        if record.opcode == Opcode.DATA_END:
            break
        if record.opcode == 0:
            copied.lost.add(f"{path}: byte {record.at} on is no MCAP any more; what came there is lost")
            copied.gaps = True
            break
        if record.opcode == Opcode.CHUNK:
            copy.chunk(file, record)
        elif record.present == record.size:
            file.seek(record.at)
            copy.record(record.opcode, file.read(record.size))
    writer.finish()  # type: ignore[no-untyped-call]
    return copied


def _begin(file: BinaryIO, size: int) -> tuple[str, str, CompressionType]:
    """Return profile and library of a file, and how its first chunk is compressed."""
    profile, library = "", ""
    for record in records(file, size):
        file.seek(record.at)
        try:
            if record.opcode == Opcode.HEADER:
                header = Header.read(stream(file.read(record.present)))
                profile, library = header.profile, header.library
            elif record.opcode == Opcode.CHUNK and (segment := chunk_segment(file, record)):
                return profile, library, _COMPRESSION[segment.compression]
        except (DecodeError, McapError, struct.error, ValueError, LookupError):
            continue
    return profile, library, CompressionType.ZSTD


@final
class _Copy:
    """Takes records over; schemas and channels get the numbers that the new file gives them."""

    def __init__(self, path: Path, writer: Writer, copied: Copied) -> None:
        self._path = path
        self._writer = writer
        self._copied = copied
        self._schemas: dict[int, tuple[Schema | None, int]] = {0: (None, 0)}
        self._channels: dict[int, tuple[Channel, int]] = {}
        self._unknown = 0

    def chunk(self, file: BinaryIO, record: Record) -> None:
        """Take over a chunk, of a cut one what comes before the cut."""
        before = self._copied.messages
        try:
            segment = chunk_segment(file, record)
            data = segment.read(file) if segment else b""
        except DecodeError as error:
            self._lose(f"chunk at byte {record.at} is lost: {error}")
            self._copied.gaps |= record.present == record.size
            return
        for opcode, content in _records_in(data):
            self.record(opcode, content)
        self._writer.flush()  # type: ignore[no-untyped-call]
        if segment is None or segment.cut:
            kept = self._copied.messages - before
            self._lose(f"cut off within the chunk at byte {record.at}: {kept} messages of it are saved, not the rest")

    def record(self, opcode: int, content: bytes) -> None:
        """Take over one record of the data section; what belongs to the index is made anew."""
        try:
            if opcode == Opcode.MESSAGE:
                self._message(content)
            elif opcode == Opcode.SCHEMA:
                self._schema(Schema.read(stream(content)))
            elif opcode == Opcode.CHANNEL:
                self._channel(Channel.read(stream(content)))
            elif opcode == Opcode.METADATA:
                metadata = Metadata.read(stream(content))
                self._writer.add_metadata(metadata.name, metadata.metadata)
            elif opcode == Opcode.ATTACHMENT:
                attachment: Any = Attachment.read(stream(content))
                times = attachment.create_time, attachment.log_time
                self._writer.add_attachment(*times, attachment.name, attachment.media_type, attachment.data)
        except (McapError, struct.error, ValueError):
            self._lose(f"a damaged record of kind {opcode}")
            self._copied.gaps = True

    def _message(self, content: bytes) -> None:
        channel, sequence, log_time_ns, publish_time_ns = _MESSAGE.unpack_from(content)
        if channel not in self._channels:
            self._unknown += 1
            line = f"{self._path}: messages of channel {channel}, which the file does not describe, are lost"
            self._copied.lost.add(line, self._unknown)
            self._copied.gaps = True
            return
        number = self._channels[channel][1]
        self._writer.add_message(number, log_time_ns, content[MESSAGE_HEAD:], publish_time_ns, sequence)
        self._copied.messages += 1

    def _schema(self, schema: Schema) -> None:
        if schema.id and self._schemas.get(schema.id, (None, 0))[0] != schema:
            number = self._writer.register_schema(schema.name, schema.encoding, schema.data)
            self._schemas[schema.id] = schema, number

    def _channel(self, channel: Channel) -> None:
        known = self._channels.get(channel.id)
        if known is None or known[0] != channel:
            schema = self._schemas.get(channel.schema_id, (None, 0))[1]
            number = self._writer.register_channel(channel.topic, channel.message_encoding, schema, channel.metadata)
            self._channels[channel.id] = channel, number

    def _lose(self, what: str) -> None:
        self._copied.lost.add(f"{self._path}: {what}")


def _records_in(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the complete records in the content of a chunk."""
    at = 0
    while at + HEAD.size <= len(data):
        opcode, length = HEAD.unpack_from(data, at)
        at += HEAD.size
        if not opcode or at + length > len(data):
            return
        yield opcode, data[at : at + length]
        at += length
