"""MCAP recordings, one file or the parts of a split one; what a broken file still holds is read and the rest named."""

from __future__ import annotations

import struct
from contextlib import ExitStack
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Schema
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.typesys.msg import normalize_msgtype

from scara_effmass.bag_io.batches import LATEST_NS, MessageBatch, Topic, in_log_time_order
from scara_effmass.bag_io.definitions import types_of
from scara_effmass.bag_io.mcap_records import (
    DECOMPRESSORS,
    MAGIC,
    MessageTable,
    Record,
    Segment,
    chunk_segment,
    message_table,
    records,
    stream,
)
from scara_effmass.errors import BagError, DecodeError

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence
    from pathlib import Path

    from rosbags.typesys.store import Typestore

    from scara_effmass.bag_io.batches import Losses

LARGEST_RUN = 1 << 20
"""Bytes of message records outside chunks that are read at once."""

ENCODINGS = {"ros2msg": MessageDefinitionFormat.MSG, "ros2idl": MessageDefinitionFormat.IDL}


class McapSource:
    """The MCAP files of one recording, read as one."""

    def __init__(self, paths: Sequence[Path], losses: Losses) -> None:
        self._definitions: dict[str, MessageDefinition] = {}
        with ExitStack() as stack:
            self._files = [_McapFile(path, stack.enter_context(path.open("rb")), losses) for path in paths]
            self._stack = stack.pop_all()
        counts: dict[tuple[str, str], int] = {}
        hashes: dict[tuple[str, str], str] = {}
        for file in self._files:
            for channel in file.channels.values():
                key = file.topic_and_type(channel)
                if channel.message_encoding != "cdr":
                    losses.add(f"{file.path}: {key[0]}: its encoding {channel.message_encoding!r} is not read, only cdr is")
                    continue
                counts[key] = counts.get(key, 0) + file.counts.get(channel.id, 0)
                hashes.setdefault(key, channel.metadata.get("topic_type_hash", ""))
                schema = file.schemas.get(channel.schema_id)
                if schema is not None and schema.encoding in ENCODINGS and schema.data:
                    text = schema.data.decode("utf-8", "replace")
                    self._definitions.setdefault(key[1], MessageDefinition(ENCODINGS[schema.encoding], text))
        self.topics = tuple(Topic(*key, count, hashes[key]) for key, count in sorted(counts.items()))
        numbers = {(topic.name, topic.type): number for number, topic in enumerate(self.topics)}
        for file in self._files:
            file.number_topics(numbers)
        self._segments = sorted(
            ((segment, file) for file in self._files for segment in file.segments), key=lambda pair: pair[0].start_ns
        )
        self.start_ns = min((segment.start_ns for segment, _ in self._segments), default=0)
        self.end_ns = max((segment.end_ns for segment, _ in self._segments), default=0)

    @cached_property
    def types(self) -> Typestore:
        """See `Source`."""
        return types_of(self._definitions)

    def batches(self, topics: Collection[int], start_ns: int, stop_ns: int) -> Iterator[MessageBatch]:
        """See `Source`."""
        wanted = [(s, f) for s, f in self._segments if s.end_ns >= start_ns and s.start_ns < stop_ns]
        horizons = [segment.start_ns for segment, _ in wanted[1:]] + [stop_ns]
        chosen = np.array(sorted(topics), np.int64)

        def read() -> Iterator[tuple[MessageBatch, int]]:
            for (segment, file), horizon_ns in zip(wanted, horizons, strict=True):
                batch = file.read(segment)
                inside = (batch.log_time_ns >= start_ns) & (batch.log_time_ns < stop_ns)
                yield batch.pick(inside & np.isin(batch.topic, chosen)), horizon_ns

        return in_log_time_order(read())

    def close(self) -> None:
        """See `Source`."""
        self._stack.close()


class _McapFile:
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
        complete = self._find_segments(file.seek(0, 2))
        if not (complete and self._read_summary()):
            self._read_everything()

    def topic_and_type(self, channel: Channel) -> tuple[str, str]:
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
        if unknown := set(np.unique(table.channel).tolist()) - self.channels.keys():
            self._losses.add(f"{self.path}: messages of channel {min(unknown)}, which the file does not describe")
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

    def _find_segments(self, size: int) -> bool:
        """Find the segments; return whether the data of the file is complete."""
        run: list[Record] = []
        record = None
        for record in records(self._file, size):
            cut = record.present < record.size
            if run and (record.opcode != Opcode.MESSAGE or cut or record.at - run[0].at > LARGEST_RUN):
                self._add_run(run)
                run = []
            if record.opcode == Opcode.DATA_END and not cut:
                return True
            if record.opcode == Opcode.CHUNK:
                self._add_chunk(record)
            if cut:
                break
            if record.opcode == Opcode.MESSAGE:
                run.append(record)
            elif record.opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
                self._file.seek(record.at)
                self._define(record.opcode, self._file.read(record.size))
            elif record.opcode == 0:
                break
        if run:
            self._add_run(run)
        what = "is no MCAP record any more" if record and not record.opcode else "ends"
        self._losses.add(
            f"{self.path}: cut off: {what} at byte {record.at if record and not record.opcode else size}; "
            "read up to there, what came later is lost"
        )
        return False

    def _add_run(self, run: list[Record]) -> None:
        times = []
        for record in run:
            self._file.seek(record.at + 6)
            times.append(min(int.from_bytes(self._file.read(8), "little"), LATEST_NS))
        first = run[0].at - 9
        size = run[-1].at + run[-1].size - first
        self.segments.append(Segment(first, size, min(times), max(times), "", size, 0, cut=False))

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
            self._losses.add(f"{self.path}: its summary is damaged ({error or type(error).__name__}); read without it")
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
                times = {"start_ns": int(table.log_time_ns.min()), "end_ns": int(table.log_time_ns.max())}
                self.segments.append(replace(segment, **times))
            for opcode, first, last in table.others:
                if opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
                    self._define(opcode, data[first:last])
            for channel, count in zip(*np.unique(table.channel, return_counts=True), strict=True):
                self.counts[int(channel)] = self.counts.get(int(channel), 0) + int(count)
