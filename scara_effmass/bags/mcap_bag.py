# SPDX-License-Identifier: Apache-2.0
"""Bags of MCAP files, read by their index; the messages of a chunk are located with numpy.

A file without a usable index is copied to a temporary file with one. Format: https://mcap.dev/spec. A record is an
opcode (1 byte), the length of its content (8 bytes) and the content. `mcap` decodes the records, but this module steps
through them itself: `mcap.stream_reader.StreamReader` would drop the chunk in which a file is cut off, and would stop
at the first damaged record.
"""

import struct
import zlib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, suppress
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, NamedTuple

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Chunk, ChunkIndex, Footer, Header, Metadata, Schema
from mcap.summary import Summary
from mcap.writer import Writer
from numpy.typing import NDArray
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.typesys.msg import normalize_msgtype

from scara_effmass.bags.bag import Bag, StoredTopic, inflate_stored
from scara_effmass.bags.batches import (
    MAX_TIME_NS,
    NO_MESSAGES,
    WINDOW_GROWTH,
    IntArray,
    LossLog,
    MessageBatch,
    Topic,
    batch_of,
    in_log_time_order,
    leading,
)
from scara_effmass.bags.compression import MCAP_COMPRESSIONS, ZSTD_MAGIC, inflate
from scara_effmass.errors import BagError, DecodeError

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEAD = struct.Struct("<BQ")
MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Channel, sequence number, log time and publish time, which precede the data of a message."""
MESSAGE_INDEX_HEAD_BYTES = RECORD_HEAD.size + 6
"""Record head, channel (2 bytes) and size of the entries (4 bytes), which precede the entries of a message index."""
MESSAGE_INDEX_ENTRY_BYTES = 16
FOOTER_BYTES = RECORD_HEAD.size + 20
MAX_LOOSE_BYTES = 1 << 20
"""Size [B] at which records outside chunks are put into a chunk of the copy."""
HASH_KEY = "topic_type_hash"
QOS_KEY = "offered_qos_profiles"
ENCODINGS = {"ros2msg": MessageDefinitionFormat.MSG, "ros2idl": MessageDefinitionFormat.IDL}
DAMAGE = (McapError, struct.error, ValueError, ArithmeticError, LookupError, TypeError)
"""Errors that mcap raises for damaged records."""


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


def stored_metadata(file: IO[bytes]) -> Iterator[Metadata]:
    """Yield the metadata records of a file. Raises one of `DAMAGE` for a damaged one."""
    for record in records(file):
        if record.opcode == Opcode.METADATA:
            yield Metadata.read(ReadDataStream(BytesIO(record.content(file))))


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
    if chunk.compression not in ("", *MCAP_COMPRESSIONS):
        raise DecodeError(f"compression {chunk.compression!r}: must be one of {', '.join(MCAP_COMPRESSIONS)}")
    data = inflate(chunk.data, chunk.compression, chunk.uncompressed_size)
    if not is_cut and len(data) != chunk.uncompressed_size:
        raise DecodeError(f"it decompresses to {len(data)} bytes; expected {chunk.uncompressed_size}")
    if not is_cut and chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise DecodeError("its checksum is wrong")
    return data


class McapCopy:
    """Copies everything readable in an MCAP file to a new one with index and summary.

    Chunk boundaries, messages, times and sequence numbers stay the same; schemas and channels get new ids.
    """

    def __init__(self, path: Path, source: IO[bytes], output: IO[bytes], losses: LossLog) -> None:
        """Copy `source`, opened from `path`; `losses` lists what cannot be copied."""
        self.messages = 0
        self.is_complete = False
        """The original contains the record that ends the data."""
        self.cut_off = ""
        """Message if the original ends before that record; data is lost only if its last record is torn."""
        self.has_gaps = False
        """More than the torn end is lost: another tool may be able to read more of the original."""
        self._path = path
        self._losses = losses
        # For each id in the original: the definition, and its id in the copy.
        self._schemas: dict[int, tuple[Schema, int]] = {}
        self._channels: dict[int, tuple[Channel, int]] = {}
        self._add_loss = losses.counter()
        self._writer = Writer(output, chunk_size=MAX_TIME_NS)  # chunks end only where those of the original do
        header = Header(profile="", library="")
        first = next(records(source), None)
        if first is not None and first.opcode == Opcode.HEADER:
            with suppress(*DAMAGE):
                header = Header.read(ReadDataStream(BytesIO(first.content(source))))
        self._writer.start(header.profile, header.library)
        self._add_file(source)
        self._writer.finish()  # type: ignore[no-untyped-call]

    def _add_file(self, file: IO[bytes]) -> None:
        """Copy the records up to the end of the data."""
        loose_bytes = 0
        end = len(MAGIC)
        for record in records(file):
            end = record.start + record.size
            if record.opcode == Opcode.DATA_END and not record.is_cut:
                self.is_complete = True
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
        self.cut_off = f"{self._path}: cut off at byte {size}; the rest is lost"
        if end != size:
            self._losses.add(self.cut_off)

    def _lose(self, line: str) -> None:
        self._add_loss(f"{self._path}: {line}")
        self.has_gaps = True

    def _add_chunk(self, file: IO[bytes], chunk: Record) -> None:
        """Copy a chunk; of a cut one, the records before the cut."""
        try:
            data = chunk_records(chunk.content(file), is_cut=chunk.is_cut)
        except DecodeError as error:
            self._losses.add(f"{self._path}: chunk at byte {chunk.start} is lost: {error}")
            self.has_gaps |= not chunk.is_cut
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
            self._lose(f"messages of channel {channel}, which the file does not define, are lost")
            return
        if log_time_ns > MAX_TIME_NS:
            raise ValueError(log_time_ns)
        data = content[MESSAGE_HEAD.size :]
        self._writer.add_message(self._channels[channel][1], log_time_ns, data, publish_time_ns, sequence)
        self.messages += 1


def read_index(file: IO[bytes]) -> Summary | None:
    """Return the summary of a file; None if there is none, or if it does not cover all messages.

    Messages outside the chunks are not covered; the sizes of the message indexes give the number of those inside.
    Raises one of `DAMAGE` or OSError if the summary is damaged.
    """
    if file.seek(0, 2) < FOOTER_BYTES + len(MAGIC):
        return None
    file.seek(0)
    summary = SeekingReader(file).get_summary()
    if summary is None or summary.statistics is None:
        return None
    file.seek(-FOOTER_BYTES - len(MAGIC), 2)
    footer = Footer.read(ReadDataStream(BytesIO(file.read(FOOTER_BYTES)[RECORD_HEAD.size :])))
    file.seek(footer.summary_start)
    if footer.summary_crc and zlib.crc32(file.read()[: -len(MAGIC) - 4]) != footer.summary_crc:
        raise McapError("its checksum is wrong")
    count, counts = summary.statistics.message_count, summary.statistics.channel_message_counts
    indexes = summary.chunk_indexes
    entries = sum(i.message_index_length - MESSAGE_INDEX_HEAD_BYTES * len(i.message_index_offsets) for i in indexes)
    is_usable = (
        counts.keys() <= summary.channels.keys()
        and count == sum(counts.values())
        and count * MESSAGE_INDEX_ENTRY_BYTES == entries
        and summary.statistics.chunk_count == len(indexes)
        and all(index.message_start_time <= index.message_end_time <= MAX_TIME_NS for index in indexes)
    )
    return summary if is_usable else None


def locate_messages(data: bytes) -> tuple[MessageBatch, int]:
    """Return the messages in a buffer of records, with channels as topics, and the size [B] of the torn end.

    Consecutive message records of equal size are found with numpy.
    """
    octets = np.frombuffer(data, np.uint8)
    runs: list[tuple[int, int, int]] = []
    start, window = 0, 1
    while start + RECORD_HEAD.size <= len(data):
        opcode, length = RECORD_HEAD.unpack_from(data, start)
        size = RECORD_HEAD.size + length
        if start + size > len(data):
            break
        if opcode != Opcode.MESSAGE or length < MESSAGE_HEAD.size:
            start += size
            continue
        count = min(window, (len(data) - start) // size)
        if count > 1:
            heads = octets[start : start + count * size].reshape(count, size)[:, : RECORD_HEAD.size]
            count = leading((heads == heads[0]).all(axis=1))
        window = window * WINDOW_GROWTH if count == window else 1
        runs.append((start, size, count))
        start += count * size
    first, size, count = np.array(runs, np.int64).reshape(-1, 3).T
    index_in_run = np.arange(count.sum()) - np.repeat(count.cumsum() - count, count)
    record = np.repeat(first, count) + np.repeat(size, count) * index_in_run
    batch = MessageBatch(
        data,
        topic=_column(octets, record + RECORD_HEAD.size, "<u2"),
        log_time_ns=_column(octets, record + RECORD_HEAD.size + 6, "<i8"),
        start=record + RECORD_HEAD.size + MESSAGE_HEAD.size,
        stop=record + np.repeat(size, count),
    )
    return batch, len(data) - start


def _column(octets: NDArray[np.uint8], offset: IntArray, dtype: str) -> IntArray:
    width = np.dtype(dtype).itemsize
    column: IntArray = octets[offset[:, None] + np.arange(width)].view(dtype)[:, 0].astype(np.int64)
    return column


class McapFile:
    """An open MCAP file, or an indexed copy of it if it has no usable index."""

    def __init__(self, path: Path, losses: LossLog, uncompressed: Path | None = None) -> None:
        """Open the file at `path`, or its `uncompressed` copy. Raises BagError if it is not MCAP, or OSError."""
        self.path = path
        self._losses = losses
        self._topic_of_channel = np.full(1 << 16, -1, np.int64)
        self._file = open_mcap(uncompressed or path)
        try:
            self._summary = self._index()
        except BaseException:
            self._file.close()
            raise

    def _index(self) -> Summary:
        damage = ""
        try:
            if summary := read_index(self._file):
                return summary
        except (*DAMAGE, OSError) as error:
            damage = str(error) or type(error).__name__
        with self._file as original:
            self._file = TemporaryFile()  # noqa: SIM115 - `close` closes it
            copy = McapCopy(self.path, original, self._file, self._losses)
        if copy.cut_off:
            self._losses.add(copy.cut_off)
        if damage and copy.is_complete:
            self._losses.add(f"{self.path}: its summary is damaged ({damage}); read without it")
        return read_index(self._file) or Summary()

    @property
    def chunks(self) -> list[ChunkIndex]:
        """The chunks with messages, in the order of the file."""
        return [index for index in self._summary.chunk_indexes if index.message_index_length]

    def stored_topics(self) -> Iterator[StoredTopic]:
        """Yield the channels as topics."""
        counts = self._summary.statistics.channel_message_counts if self._summary.statistics else {}
        for channel in self._summary.channels.values():
            schema = self._summary.schemas.get(channel.schema_id)
            definition = None
            if schema is not None and schema.encoding in ENCODINGS and schema.data:
                definition = MessageDefinition(ENCODINGS[schema.encoding], schema.data.decode("utf-8", "replace"))
            topic = Topic(
                *self._topic_key(channel),
                count=counts.get(channel.id, 0),
                type_hash=channel.metadata.get(HASH_KEY, ""),
                offered_qos=channel.metadata.get(QOS_KEY, ""),
            )
            yield StoredTopic(self.path, topic, channel.message_encoding, definition)

    def assign_topics(self, topic_indices: Mapping[tuple[str, str], int]) -> None:
        """Map the channels to topic indices; channels with another encoding than CDR keep -1."""
        for channel in self._summary.channels.values():
            if channel.message_encoding == "cdr":
                self._topic_of_channel[channel.id] = topic_indices[self._topic_key(channel)]

    def read(self, chunk: ChunkIndex) -> MessageBatch:
        """Return the messages of a chunk, in file order."""
        start = chunk.chunk_start_offset + RECORD_HEAD.size
        origin = f"{self.path}: chunk at byte {start}"
        try:
            self._file.seek(start)
            data = chunk_records(self._file.read(chunk.chunk_length - RECORD_HEAD.size))
        except (DecodeError, OSError) as error:
            seconds = (chunk.message_end_time - chunk.message_start_time) / 1e9
            self._losses.add(f"{origin}, {seconds:.3f} s, is lost: {error}")
            return NO_MESSAGES
        batch, torn_bytes = locate_messages(data)
        if torn_bytes:
            self._losses.add(f"{origin}: its last {torn_bytes} bytes are not a record")
        for channel in sorted({*np.flatnonzero(np.bincount(batch.topic)).tolist()} - self._summary.channels.keys()):
            self._losses.add(f"{self.path}: messages of channel {channel}, which the file does not define, are lost")
        if np.any(batch.log_time_ns < chunk.message_start_time):
            self._losses.add(f"{origin}: log times before the start of the chunk")
        return batch._replace(topic=self._topic_of_channel[batch.topic])

    def close(self) -> None:
        """Close the file; this deletes a copy."""
        self._file.close()

    def _topic_key(self, channel: Channel) -> tuple[str, str]:
        """Return the topic and type of a channel; the type is empty if the file does not define it."""
        schema = self._summary.schemas.get(channel.schema_id)
        return channel.topic, normalize_msgtype(schema.name) if schema and "/" in schema.name else ""


class McapBag(Bag):
    """A bag of MCAP files."""

    def __init__(self, path: Path, paths: Sequence[tuple[Path, Path]], losses: LossLog) -> None:
        """Open the bag at `path`: `paths` are its files, each with its uncompressed copy, or the same path twice."""
        with ExitStack() as stack:
            files = [stack.enter_context(closing(McapFile(file, losses, copy))) for file, copy in paths]
            super().__init__(path, [topic for file in files for topic in file.stored_topics()], losses)
            self._stack = stack.pop_all()
        for file in files:
            file.assign_topics(self._topic_indices)
        chunks = ((chunk, file) for file in files for chunk in file.chunks)
        self._chunks = sorted(chunks, key=lambda pair: pair[0].message_start_time)
        self.start_ns = min((chunk.message_start_time for chunk, _ in self._chunks), default=0)
        self.end_ns = max((chunk.message_end_time for chunk, _ in self._chunks), default=0)

    def batches(self, topics: Collection[int], start_ns: int, stop_ns: int) -> Iterator[MessageBatch]:
        """See `Bag`."""
        chunks = [
            (chunk, file)
            for chunk, file in self._chunks
            if chunk.message_end_time >= start_ns and chunk.message_start_time < stop_ns
        ]
        horizons_ns = [*[chunk.message_start_time for chunk, _ in chunks], stop_ns][1:]
        is_wanted = np.zeros(len(self.topics) + 1, np.bool_)  # the last entry is for index -1, channels without a topic
        is_wanted[[*topics]] = True
        add_loss = self._losses.counter()

        def read() -> Iterator[tuple[MessageBatch, int]]:
            for (chunk, file), horizon_ns in zip(chunks, horizons_ns, strict=True):
                batch = file.read(chunk)
                inside = (batch.log_time_ns >= start_ns) & (batch.log_time_ns < stop_ns) & is_wanted[batch.topic]
                selected = batch if inside.all() else batch.select(inside)
                yield self._inflated(selected, add_loss), horizon_ns

        return in_log_time_order(read())

    def _inflated(self, batch: MessageBatch, add_loss: Callable[[str], None]) -> MessageBatch:
        """Return the batch with compressed messages decompressed; those that are damaged are left out."""
        starts = batch.start[batch.start < batch.stop]
        if not np.any(np.frombuffer(batch.data, np.uint8)[starts] == ZSTD_MAGIC[0]):
            return batch
        messages = [
            inflate_stored(self.path, batch.data[start:stop], add_loss)
            for start, stop in zip(batch.start.tolist(), batch.stop.tolist(), strict=True)
        ]
        sound = [i for i, message in enumerate(messages) if message]
        return batch_of(batch.topic[sound], batch.log_time_ns[sound], [messages[i] for i in sound])
