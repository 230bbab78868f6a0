"""Copy the readable content of a damaged MCAP file to a new one."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from scara_effmass.bags.batches import MAX_TIME_NS, LossLog
from scara_effmass.bags.mcap_file import DAMAGE, RECORD_HEAD, Record, chunk_content, records
from scara_effmass.errors import DecodeError

COMPRESSIONS = {"": CompressionType.NONE, "zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4}


@dataclass(slots=True)
class CopyResult:
    """The content of a copy, and lines about what could not be copied."""

    messages: int = 0
    losses: LossLog = field(default_factory=LossLog)
    has_gaps: bool = False
    """More is lost than the torn end: the original has bytes that another tool may be able to read."""


def copy_records(path: Path, file: BinaryIO, output: BinaryIO) -> CopyResult:
    """Write everything readable in the MCAP file `file`, called `path`, to `output`, with index and summary.

    Chunk boundaries, messages, times and sequence numbers are kept.
    """
    result = CopyResult()
    size = file.seek(0, 2)
    header, compression = _format(file, size)
    writer = Writer(output, chunk_size=MAX_TIME_NS, compression=compression)
    writer.start(header.profile, header.library)
    copy = _Copy(path, writer, result)
    for record in records(file, size):
        if record.opcode == Opcode.DATA_END:
            break
        if record.opcode == 0:
            result.losses.add(f"{path}: byte {record.start} on is not MCAP; the rest is lost")
            result.has_gaps = True
            break
        if record.opcode == Opcode.CHUNK:
            copy.add_chunk(file, record)
        elif not record.is_cut:
            file.seek(record.start - RECORD_HEAD.size)
            copy.add_records(file.read(RECORD_HEAD.size + record.size))
    writer.finish()  # type: ignore[no-untyped-call]
    return result


def _format(file: BinaryIO, size: int) -> tuple[Header, CompressionType]:
    """Return the header and the compression of the first readable chunk."""
    header = Header(profile="", library="")
    for record in records(file, size):
        try:
            if record.opcode == Opcode.HEADER:
                file.seek(record.start - RECORD_HEAD.size)
                content = file.read(RECORD_HEAD.size + record.available)
                header = next((r for r in _parse(content) if isinstance(r, Header)), header)
            elif record.opcode == Opcode.CHUNK:
                return header, COMPRESSIONS[chunk_content(file, record)[1]]
        except DAMAGE:  # noqa: PERF203 - once per file
            continue
    return header, CompressionType.ZSTD


def _parse(data: bytes) -> Iterator[McapRecord]:
    """Yield the complete records in `data`. Raises one of `DAMAGE`."""
    try:
        yield from StreamReader(BytesIO(data), skip_magic=True).records
    except EndOfFile:
        return


class _Copy:
    """Adds records to a writer, which assigns new ids to schemas and channels."""

    def __init__(self, path: Path, writer: Writer, result: CopyResult) -> None:
        self._path = path
        self._writer = writer
        self._result = result
        self._schemas: dict[int, tuple[Schema | None, int]] = {0: (None, 0)}
        self._channels: dict[int, tuple[Channel, int]] = {}
        self._undefined_messages = 0

    def add_chunk(self, file: BinaryIO, record: Record) -> None:
        """Copy a chunk; of a cut one, the records before the cut."""
        previous_messages = self._result.messages
        try:
            data, _ = chunk_content(file, record)
        except DecodeError as error:
            self._result.losses.add(f"{self._path}: chunk at byte {record.start} is lost: {error}")
            self._result.has_gaps |= not record.is_cut
            return
        self.add_records(data, is_cut=record.is_cut)
        self._writer.flush()  # type: ignore[no-untyped-call]
        if record.is_cut:
            count = self._result.messages - previous_messages
            line = f"cut off in the chunk at byte {record.start}: {count} messages of it are kept, the rest is lost"
            self._result.losses.add(f"{self._path}: {line}")

    def add_records(self, data: bytes, *, is_cut: bool = False) -> None:
        """Copy the complete records in `data`; the last one may be torn if `is_cut`."""
        try:
            for record in _parse(data):
                self._add(record)
        except DAMAGE:
            if is_cut:
                return
            self._result.losses.add(f"{self._path}: a damaged record is lost")
            self._result.has_gaps = True

    def _add(self, record: McapRecord) -> None:
        if isinstance(record, Message):
            self._add_message(record)
        elif isinstance(record, Schema):
            if record.id and self._schemas.get(record.id, (None, 0))[0] != record:
                schema_id = self._writer.register_schema(record.name, record.encoding, record.data)
                self._schemas[record.id] = record, schema_id
        elif isinstance(record, Channel):
            if record.id not in self._channels or self._channels[record.id][0] != record:
                _, schema_id = self._schemas.get(record.schema_id, (None, 0))
                channel_id = self._writer.register_channel(
                    record.topic, record.message_encoding, schema_id, record.metadata
                )
                self._channels[record.id] = record, channel_id
        elif isinstance(record, Metadata):
            self._writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Attachment):
            times = record.create_time, record.log_time
            self._writer.add_attachment(*times, record.name, record.media_type, record.data)

    def _add_message(self, message: Message) -> None:
        if message.channel_id not in self._channels:
            self._undefined_messages += 1
            line = f"messages of channel {message.channel_id}, which the file does not define, are lost"
            self._result.losses.add(f"{self._path}: {line}", self._undefined_messages)
            self._result.has_gaps = True
            return
        _, channel_id = self._channels[message.channel_id]
        self._writer.add_message(channel_id, message.log_time, message.data, message.publish_time, message.sequence)
        self._result.messages += 1
