"""One MCAP file: its chunks, and the messages in them located with numpy.

Format: https://mcap.dev/spec. A record is an opcode (1 byte), the length of its content (8 bytes) and the content.
`mcap.stream_reader.StreamReader` drops the chunk in which a file is cut off and stops at the first damaged record,
so records are stepped through here; `mcap` decodes them.
"""

import struct
import zlib
from collections.abc import Callable, Iterable, Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, Footer, Schema, Statistics
from mcap.summary import Summary
from numpy.typing import NDArray
from rosbags.typesys.msg import normalize_msgtype

from scara_effmass.bags.batches import MAX_TIME_NS, IntArray, LossLog, MessageBatch
from scara_effmass.errors import BagError, DecodeError

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEAD = struct.Struct("<BQ")
MESSAGE_HEAD_BYTES = 22
"""Channel (2), sequence (4), log time (8) and publish time (8) in front of the message."""
MESSAGE_INDEX_HEAD_BYTES = RECORD_HEAD.size + 6
"""Record head, channel (2) and size of the entries (4) in front of the entries of a message index."""
MESSAGE_INDEX_ENTRY_BYTES = 16
FOOTER_BYTES = RECORD_HEAD.size + 20
MAX_CHUNK_BYTES = 1 << 30
MAX_RUN_BYTES = 1 << 20
"""Size of message records outside chunks that are read at once."""
WINDOW_GROWTH = 4
DAMAGE = (McapError, struct.error, ValueError, ArithmeticError, LookupError, TypeError)
"""Errors that mcap raises for damaged records."""

# The incremental interfaces return the intact part of a truncated stream.
DECOMPRESSORS: dict[str, Callable[[bytes], bytes]] = {
    "": bytes,
    "zstd": lambda data: zstandard.ZstdDecompressor().decompressobj().decompress(data),
    "lz4": lambda data: bytes(lz4.frame.LZ4FrameDecompressor().decompress(data)),
}


class Record(NamedTuple):
    """A record, or a run of message records outside chunks with their heads. Offsets and sizes are in bytes.

    `available` is smaller than `size` if the file is cut off inside. Log times are known for chunks and runs.
    """

    opcode: int
    start: int
    size: int
    available: int
    start_ns: int = 0
    end_ns: int = 0

    @property
    def is_cut(self) -> bool:
        """Whether the file ends inside the record."""
        return self.available < self.size


def records(file: BinaryIO, size: int) -> Iterator[Record]:
    """Yield the records of a file of `size` bytes, without reading their content."""
    start = len(MAGIC)
    while start + RECORD_HEAD.size <= size:
        file.seek(start)
        opcode, length = RECORD_HEAD.unpack(file.read(RECORD_HEAD.size))
        start += RECORD_HEAD.size
        yield Record(opcode, start, length, min(length, size - start))
        start += length


def chunk_content(file: BinaryIO, record: Record) -> tuple[bytes, str]:
    """Return the uncompressed records of a chunk and its compression; of a cut chunk, the records before the cut.

    Raises DecodeError if the chunk is damaged.
    """
    file.seek(record.start)
    try:
        chunk = Chunk.read(ReadDataStream(BytesIO(file.read(record.available))))
    except DAMAGE:
        if record.is_cut:
            return b"", ""
        raise DecodeError("its header is damaged") from None
    if chunk.compression not in DECOMPRESSORS:
        raise DecodeError(f"compression {chunk.compression!r}: must be one of {', '.join(filter(None, DECOMPRESSORS))}")
    if chunk.uncompressed_size > MAX_CHUNK_BYTES:
        raise DecodeError(f"uncompressed size {chunk.uncompressed_size}: must be <= {MAX_CHUNK_BYTES}")
    try:
        data = DECOMPRESSORS[chunk.compression](chunk.data)
    except (zstandard.ZstdError, RuntimeError, MemoryError) as error:
        raise DecodeError(f"its {chunk.compression} data is damaged: {error}") from None
    if not record.is_cut and len(data) != chunk.uncompressed_size:
        raise DecodeError(f"it decompresses to {len(data)} bytes; expected {chunk.uncompressed_size}")
    if not record.is_cut and chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise DecodeError("its checksum is wrong")
    return data, chunk.compression


def read_summary(file: BinaryIO) -> Summary | None:
    """Return the summary of a file, None if there is none. Raises one of `DAMAGE` or OSError if it is damaged."""
    file.seek(0)
    summary = SeekingReader(file).get_summary()
    if summary is None or summary.statistics is None:
        return None
    file.seek(-FOOTER_BYTES - len(MAGIC), 2)
    tail = file.read(FOOTER_BYTES)
    footer = Footer.read(ReadDataStream(BytesIO(tail[RECORD_HEAD.size :])))
    file.seek(footer.summary_start)
    content = file.read()[: -len(MAGIC) - 4]
    if footer.summary_crc and zlib.crc32(content) != footer.summary_crc:
        raise McapError("its checksum is wrong")
    return summary


class MessageTable(NamedTuple):
    """The message records (m,) in a buffer, and its other records as (opcode, start, stop) of their content."""

    channel: IntArray
    log_time_ns: IntArray
    start: IntArray
    stop: IntArray
    others: list[tuple[int, int, int]]
    trailing_bytes: int
    """Bytes at the end that are not a complete record."""


def message_table(data: bytes) -> MessageTable:
    """Locate the messages in a buffer of records; runs of equally long message records are found in numpy."""
    octets = np.frombuffer(data, np.uint8)
    runs: list[tuple[int, int, int]] = []
    others: list[tuple[int, int, int]] = []
    start, window = 0, 1
    while start + RECORD_HEAD.size <= len(data):
        opcode, length = RECORD_HEAD.unpack_from(data, start)
        size = RECORD_HEAD.size + length
        if start + size > len(data):
            break
        if opcode != Opcode.MESSAGE or length < MESSAGE_HEAD_BYTES:
            others.append((opcode, start + RECORD_HEAD.size, start + size))
            start += size
            continue
        count = min(window, (len(data) - start) // size)
        if count > 1:
            heads = octets[start : start + count * size].reshape(count, size)[:, : RECORD_HEAD.size]
            equal = (heads == heads[0]).all(axis=1)
            count = count if equal.all() else int(equal.argmin())
        window = window * WINDOW_GROWTH if count == window else 1
        runs.append((start, size, count))
        start += count * size
    first, size, count = np.array(runs, np.int64).reshape(-1, 3).T
    index_in_run = np.arange(count.sum()) - np.repeat(count.cumsum() - count, count)
    record = np.repeat(first, count) + np.repeat(size, count) * index_in_run
    return MessageTable(
        channel=_column(octets, record + RECORD_HEAD.size, "<u2"),
        log_time_ns=_column(octets, record + RECORD_HEAD.size + 6, "<i8"),
        start=record + RECORD_HEAD.size + MESSAGE_HEAD_BYTES,
        stop=record + np.repeat(size, count),
        others=others,
        trailing_bytes=len(data) - start,
    )


def _column(octets: NDArray[np.uint8], offset: IntArray, dtype: str) -> IntArray:
    width = np.dtype(dtype).itemsize
    column: IntArray = octets[offset[:, None] + np.arange(width)].view(dtype)[:, 0].astype(np.int64)
    return column


class McapFile:
    """An open MCAP file. The index comes from its summary, or from reading all of it if the summary is unusable."""

    def __init__(self, path: Path, file: BinaryIO, losses: LossLog) -> None:
        """Index the file. Raises BagError if it is not MCAP."""
        self.path = path
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.counts: dict[int, int] = {}
        """Messages of each channel."""
        self.chunks: list[Record] = []
        """Chunks, and runs of message records outside chunks."""
        self.is_indexed = False
        self.statistics: Statistics | None = None
        """The statistics of a readable summary."""
        self._file = file
        self._losses = losses
        self._topic_of_channel = np.full(1 << 16, -1, np.int64)
        magic = file.read(len(MAGIC))
        if magic != MAGIC:
            raise BagError(f"{path}: {'is empty' if not magic else 'is not an MCAP file'}")
        self._size = file.seek(0, 2)
        damage = ""
        try:
            self.is_indexed = self._index_by_summary()
        except BagError:
            raise
        except (*DAMAGE, OSError) as error:
            damage = str(error) or type(error).__name__
        if not self.is_indexed and self._index_by_scan() and damage:
            losses.add(f"{path}: its summary is damaged ({damage}); read without it")

    def topic_and_type(self, channel: Channel) -> tuple[str, str]:
        """Return the topic and type of a channel; the type is empty if the file does not define it."""
        schema = self.schemas.get(channel.schema_id)
        return channel.topic, normalize_msgtype(schema.name) if schema and "/" in schema.name else ""

    def assign_topics(self, topic_indices: dict[tuple[str, str], int]) -> None:
        """Map the channels to topic indices; channels that are not CDR keep -1."""
        for channel in self.channels.values():
            if channel.message_encoding == "cdr":
                self._topic_of_channel[channel.id] = topic_indices[self.topic_and_type(channel)]

    def read(self, chunk: Record) -> MessageBatch:
        """Return the messages of a chunk, in file order."""
        data, table = self._load(chunk)
        self._report_undefined(np.unique(table.channel).tolist())
        if len(table.log_time_ns) and int(table.log_time_ns.min()) < chunk.start_ns:
            self._losses.add(f"{self.path}: chunk at byte {chunk.start}: log times before the start of the chunk")
        return MessageBatch(data, self._topic_of_channel[table.channel], table.log_time_ns, table.start, table.stop)

    def _load(self, chunk: Record) -> tuple[bytes, MessageTable]:
        data = b""
        try:
            if chunk.opcode == Opcode.CHUNK:
                data, _ = chunk_content(self._file, chunk)
            else:
                self._file.seek(chunk.start)
                data = self._file.read(chunk.size)
        except (DecodeError, OSError) as error:
            seconds = max(chunk.end_ns - chunk.start_ns, 0) / 1e9
            self._losses.add(f"{self.path}: chunk at byte {chunk.start}, {seconds:.3f} s, is lost: {error}")
        table = message_table(data)
        if table.trailing_bytes and not chunk.is_cut:
            self._losses.add(
                f"{self.path}: chunk at byte {chunk.start}: its last {table.trailing_bytes} bytes are not a record"
            )
        return data, table

    def _report_undefined(self, channels: Iterable[int]) -> None:
        for channel in sorted(set(channels) - self.channels.keys()):
            self._losses.add(f"{self.path}: messages of channel {channel}, which the file does not define, are lost")

    def _index_by_summary(self) -> bool:
        """Take chunks, channels and counts from the summary; return whether they are consistent.

        They are not if a message is outside the chunks: the sizes of the message indexes give the messages in chunks.
        """
        summary = read_summary(self._file)
        if summary is None or summary.statistics is None:
            return False
        self.schemas, self.channels = dict(summary.schemas), dict(summary.channels)
        self.statistics = statistics = summary.statistics
        indexes = summary.chunk_indexes
        counts = statistics.channel_message_counts
        index_bytes = sum(
            index.message_index_length - MESSAGE_INDEX_HEAD_BYTES * len(index.message_index_offsets)
            for index in indexes
        )
        if (
            not counts.keys() <= summary.channels.keys()
            or statistics.message_count != sum(counts.values())
            or statistics.chunk_count != len(indexes)
            or statistics.message_count * MESSAGE_INDEX_ENTRY_BYTES != index_bytes
            or any(not index.message_start_time <= index.message_end_time <= MAX_TIME_NS for index in indexes)
        ):
            return False
        self.counts = dict(counts)
        for index in indexes:
            if index.compression not in DECOMPRESSORS:
                known = ", ".join(name or "none" for name in DECOMPRESSORS)
                raise BagError(f"{self.path}: compression = {index.compression!r}: must be one of {known}")
            size = index.chunk_length - RECORD_HEAD.size
            start = index.chunk_start_offset + RECORD_HEAD.size
            times = index.message_start_time, index.message_end_time
            self.chunks.append(Record(Opcode.CHUNK, start, size, size, *times))
        return True

    def _index_by_scan(self) -> bool:
        """Read the file once for chunks, channels, counts and times; return whether it has its end."""
        is_complete = False
        run: list[Record] = []
        for record in records(self._file, self._size):
            if record.opcode == Opcode.MESSAGE and not record.is_cut:
                run.append(record)
                if record.start - run[0].start > MAX_RUN_BYTES:
                    self._scan_run(run)
                continue
            self._scan_run(run)
            if record.opcode == Opcode.DATA_END and not record.is_cut:
                is_complete = True
                break
            if record.opcode == 0:
                self._losses.add(f"{self.path}: byte {record.start} on is not MCAP; the rest is lost")
                break
            if record.opcode == Opcode.CHUNK:
                self._scan_chunk(record)
            elif not record.is_cut:
                self._file.seek(record.start)
                self._define(record.opcode, self._file.read(min(record.size, MAX_RUN_BYTES)))
        else:
            self._scan_run(run)
            self._losses.add(f"{self.path}: cut off at byte {self._size}; the rest is lost")
        self._report_undefined(self.counts)
        return is_complete

    def _scan_run(self, run: list[Record]) -> None:
        if run:
            start = run[0].start - RECORD_HEAD.size
            size = run[-1].start + run[-1].size - start
            self._scan_chunk(Record(Opcode.MESSAGE, start, size, size))
            run.clear()

    def _scan_chunk(self, chunk: Record) -> None:
        data, table = self._load(chunk)
        for opcode, start, stop in table.others:
            self._define(opcode, data[start:stop])
        if len(table.channel):
            start_ns, end_ns = int(table.log_time_ns.min()), int(table.log_time_ns.max())
            self.chunks.append(chunk._replace(start_ns=start_ns, end_ns=end_ns))
        for channel, count in zip(*np.unique(table.channel, return_counts=True), strict=True):
            self.counts[int(channel)] = self.counts.get(int(channel), 0) + int(count)

    def _define(self, opcode: int, content: bytes) -> None:
        """Take over the definition of a schema or channel."""
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(ReadDataStream(BytesIO(content)))
                self.schemas.setdefault(schema.id, schema)
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(ReadDataStream(BytesIO(content)))
                self.channels.setdefault(channel.id, channel)
        except DAMAGE:
            self._losses.add(f"{self.path}: a definition of a channel is damaged")
