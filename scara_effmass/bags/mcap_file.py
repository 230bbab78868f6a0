"""One MCAP file: where its messages are, and what its channels are called."""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Schema
from rosbags.typesys.msg import normalize_msgtype

from scara_effmass.bags.batches import LATEST_NS, MessageBatch
from scara_effmass.bags.mcap_records import (
    DECOMPRESSORS,
    HEAD,
    MAGIC,
    Segment,
    chunk_segment,
    message_table,
    records,
    stream,
)
from scara_effmass.errors import BagError, DecodeError

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from scara_effmass.bags.batches import Losses
    from scara_effmass.bags.mcap_records import MessageTable, Record

LARGEST_RUN = 1 << 20
"""Bytes of message records outside chunks that are read at once."""


NO_TIMES = (LATEST_NS, 0)
"""First and last log time of a chunk without messages, as writers leave them."""


class McapFile:
    """One file: where its segments are, and what its channels are called."""

    def __init__(self, path: Path, file: BinaryIO, losses: Losses) -> None:
        self.path = path
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.counts: dict[int, int] = {}
        self.segments: list[Segment] = []
        self._file = file
        self._losses = losses
        self._topic_of_channel = np.full(1 << 16, -1, np.int64)
        magic = file.read(len(MAGIC))
        if magic != MAGIC:
            raise BagError(f"{path}: is {'empty' if not magic else 'no MCAP file'}; a recording in MCAP would be right")
        self._times_hold = True
        complete = self._find_segments(file.seek(0, 2))
        if not (complete and self._times_hold and self._read_summary()):
            self._read_everything()

    def topic_and_type(self, channel: Channel) -> tuple[str, str]:
        """Return topic and type of a channel; the type is empty where the file does not say."""
        schema = self.schemas.get(channel.schema_id)
        return channel.topic, normalize_msgtype(schema.name) if schema and "/" in schema.name else ""

    def number_topics(self, numbers: dict[tuple[str, str], int]) -> None:
        """Say which topic each channel belongs to; channels that are not read keep -1."""
        for channel in self.channels.values():
            if channel.message_encoding == "cdr":
                self._topic_of_channel[channel.id] = numbers[self.topic_and_type(channel)]

    def read(self, segment: Segment) -> MessageBatch:
        """Return the messages of a segment, in the order of the file."""
        data, table = self._table(segment)
        self._report_unknown(np.unique(table.channel).tolist())
        if len(table.log_time_ns) and int(table.log_time_ns.min()) < segment.start_ns:
            self._losses.add(f"{self.path}: at byte {segment.at}: log times before the chunk's own start, out of order")
        return MessageBatch(data, self._topic_of_channel[table.channel], table.log_time_ns, table.start, table.stop)

    def _table(self, segment: Segment) -> tuple[bytes, MessageTable]:
        try:
            data = segment.read(self._file)
        except (DecodeError, OSError) as error:
            seconds = max(segment.end_ns - segment.start_ns, 0) / 1e9
            self._losses.add(f"{self.path}: chunk at byte {segment.at}, {seconds:.3f} s, is lost: {error}")
            data = b""
        table = message_table(data)
        if table.left_over and not segment.cut:
            self._losses.add(f"{self.path}: chunk at byte {segment.at}: its last {table.left_over} bytes are no record")
        return data, table

    def _report_unknown(self, channels: Iterable[int]) -> None:
        for channel in sorted(set(channels) - self.channels.keys()):
            self._losses.add(f"{self.path}: messages of channel {channel}, which the file does not describe, are lost")

    def _find_segments(self, size: int) -> bool:
        """Find the segments; return whether the data of the file is complete."""
        run: list[Record] = []
        for record in records(self._file, size):
            whole = record.present == record.size
            if record.opcode == Opcode.MESSAGE and whole:
                run.append(record)
                if record.at - run[0].at > LARGEST_RUN:
                    self._add_run(run)
                continue
            self._add_run(run)
            if record.opcode == Opcode.DATA_END and whole:
                return True
            if record.opcode == 0:
                self._losses.add(f"{self.path}: byte {record.at} on is no MCAP any more; what came there is lost")
                return False
            if record.opcode == Opcode.CHUNK:
                self._add_chunk(record)
            elif record.opcode in {Opcode.SCHEMA, Opcode.CHANNEL} and whole:
                self._file.seek(record.at)
                self._define(record.opcode, self._file.read(record.size))
        self._add_run(run)
        self._losses.add(f"{self.path}: cut off at byte {size}, without its end; what came later is lost")
        return False

    def _add_run(self, run: list[Record]) -> None:
        """Make a segment of messages that stand one behind the other, and empty the list of them."""
        if not run:
            return
        times = []
        for record in run:
            self._file.seek(record.at + 6)
            times.append(min(int.from_bytes(self._file.read(8), "little"), LATEST_NS))
        first = run[0].at - HEAD.size
        size = run[-1].at + run[-1].size - first
        self.segments.append(Segment(first, size, min(times), max(times), "", size, 0, cut=False))
        run.clear()

    def _add_chunk(self, record: Record) -> None:
        try:
            segment = chunk_segment(self._file, record)
        except DecodeError as error:
            self._losses.add(f"{self.path}: chunk at byte {record.at} is lost: {error}")
            return
        if segment is None:
            return
        if segment.compression not in DECOMPRESSORS:
            known = ", ".join(name or "none" for name in DECOMPRESSORS)
            raise BagError(f"{self.path}: compression {segment.compression!r} is unknown; {known} can be read")
        if segment.start_ns <= segment.end_ns:
            self.segments.append(segment)
        elif (segment.start_ns, segment.end_ns) != NO_TIMES:
            self.segments.append(segment)
            self._times_hold = False

    def _define(self, opcode: int, content: bytes) -> None:
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream(content))
                self.schemas[schema.id] = schema
            else:
                channel = Channel.read(stream(content))
                self.channels[channel.id] = channel
        except (McapError, struct.error, ValueError):
            self._losses.add(f"{self.path}: a damaged description of a channel")

    def _read_summary(self) -> bool:
        """Take channels and counts from the end of the file; return whether they are there."""
        try:
            self._file.seek(0)
            summary = SeekingReader(self._file).get_summary()
        except (McapError, struct.error, ValueError, OSError, ArithmeticError, LookupError, TypeError) as error:
            reason = str(error) or type(error).__name__
            self._losses.add(f"{self.path}: its summary is damaged ({reason}); read without it")
            return False
        if summary is None or summary.statistics is None:
            return False
        counts = summary.statistics.channel_message_counts
        if not counts.keys() <= summary.channels.keys() or summary.statistics.message_count != sum(counts.values()):
            return False
        self.schemas.update(summary.schemas)
        self.channels.update(summary.channels)
        self.counts = dict(counts)
        return True

    def _read_everything(self) -> None:
        """Take channels, counts and times from the segments themselves, and drop those that hold nothing."""
        found, self.segments = self.segments, []
        for segment in found:
            data, table = self._table(segment)
            if len(table.log_time_ns):
                start_ns, end_ns = int(table.log_time_ns.min()), int(table.log_time_ns.max())
                self.segments.append(replace(segment, start_ns=start_ns, end_ns=end_ns))
            for opcode, first, last in table.others:
                if opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
                    self._define(opcode, data[first:last])
            for channel, count in zip(*np.unique(table.channel, return_counts=True), strict=True):
                self.counts[int(channel)] = self.counts.get(int(channel), 0) + int(count)
        self._report_unknown(self.counts)
