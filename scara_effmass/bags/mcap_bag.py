# SPDX-License-Identifier: Apache-2.0
"""MCAP files, read by their index; the messages of a chunk are located with numpy.

A file without a usable index is copied to a temporary file with one.
"""

import zlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, ChunkIndex, Footer
from mcap.summary import Summary
from numpy.typing import NDArray
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.typesys.msg import normalize_msgtype

from scara_effmass.bags.bag import Bag, StoredTopic
from scara_effmass.bags.batches import (
    MAX_TIME_NS,
    NO_MESSAGES,
    IntArray,
    LossLog,
    MessageBatch,
    Topic,
    in_log_time_order,
)
from scara_effmass.bags.mcap_copy import (
    DAMAGE,
    MAGIC,
    MESSAGE_HEAD,
    RECORD_HEAD,
    chunk_records,
    copy_records,
    open_mcap,
)
from scara_effmass.errors import DecodeError

MESSAGE_INDEX_HEAD_BYTES = RECORD_HEAD.size + 6
"""Record head, channel (2 bytes) and size of the entries (4 bytes), which precede the entries of a message index."""
MESSAGE_INDEX_ENTRY_BYTES = 16
FOOTER_BYTES = RECORD_HEAD.size + 20
WINDOW_GROWTH = 4
HASH_KEY = "topic_type_hash"
QOS_KEY = "offered_qos_profiles"
ENCODINGS = {"ros2msg": MessageDefinitionFormat.MSG, "ros2idl": MessageDefinitionFormat.IDL}


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
            equal = (heads == heads[0]).all(axis=1)
            count = count if equal.all() else int(equal.argmin())
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

    def __init__(self, path: Path, losses: LossLog) -> None:
        """Open the file. Raises BagError if it is not MCAP, or OSError."""
        self.path = path
        self._losses = losses
        self._topic_of_channel = np.full(1 << 16, -1, np.int64)
        self._file = open_mcap(path)
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
            result = copy_records(self.path, original, self._file, self._losses)
        if result.cut_off:
            self._losses.add(result.cut_off)
        if damage and result.is_complete:
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

    def __init__(self, path: Path, paths: Sequence[Path], losses: LossLog) -> None:
        with ExitStack() as stack:
            files = [stack.enter_context(closing(McapFile(file, losses))) for file in paths]
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

        def read() -> Iterator[tuple[MessageBatch, int]]:
            for (chunk, file), horizon_ns in zip(chunks, horizons_ns, strict=True):
                batch = file.read(chunk)
                inside = (batch.log_time_ns >= start_ns) & (batch.log_time_ns < stop_ns) & is_wanted[batch.topic]
                yield batch if inside.all() else batch.select(inside), horizon_ns

        return in_log_time_order(read())

    def close(self) -> None:
        """See `Bag`."""
        self._stack.close()
