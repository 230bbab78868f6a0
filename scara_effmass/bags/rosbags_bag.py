# SPDX-License-Identifier: Apache-2.0
"""Bags read with the rosbags library: SQLite, compressed rosbag2 and ROS 1."""

import heapq
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack
from operator import itemgetter
from pathlib import Path
from typing import Any

from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinitionFormat
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2 import Reader as Ros2Reader

from scara_effmass.bags.bag import Bag, StoredTopic, one_line
from scara_effmass.bags.batches import LossLog, MessageBatch, Topic, batch_of
from scara_effmass.errors import BagError

Reader = Ros1Reader | Ros2Reader

BATCH_MESSAGES = 1000
BATCH_BYTES = 1 << 20


class RosbagsBag(Bag):
    """A bag of files that are each read by rosbags."""

    def __init__(
        self, path: Path, paths: Sequence[Path], losses: LossLog, make_reader: type[Ros1Reader | Ros2Reader]
    ) -> None:
        self._readers: list[tuple[Path, Reader]] = []
        with ExitStack() as stack:
            for file in paths:
                reader = _open(file, make_reader)
                stack.callback(reader.close)
                self._readers.append((file, reader))
            self._stack = stack.pop_all()
        super().__init__(path, list(self._stored_topics()), losses, is_ros1=make_reader is Ros1Reader)
        nonempty = [reader for _, reader in self._readers if reader.message_count]
        self.start_ns = min((reader.start_time for reader in nonempty), default=0)
        self.end_ns = max((reader.end_time - 1 for reader in nonempty), default=0)

    def batches(self, topics: Collection[int], start_ns: int, stop_ns: int) -> Iterator[MessageBatch]:
        """See `Bag`."""
        streams = [self._messages(path, reader, topics, start_ns, stop_ns) for path, reader in self._readers]
        merged = heapq.merge(*streams, key=itemgetter(0))
        messages: list[tuple[int, int, bytes]] = []
        size = 0
        for message in merged:
            messages.append(message)
            size += len(message[2])
            if len(messages) == BATCH_MESSAGES or size > BATCH_BYTES:
                yield _batch(messages)
                messages, size = [], 0
        if messages:
            yield _batch(messages)

    def close(self) -> None:
        """See `Bag`."""
        self._stack.close()

    def _stored_topics(self) -> Iterator[StoredTopic]:
        for path, connection in ((path, c) for path, reader in self._readers for c in reader.connections):
            topic = Topic(connection.topic, connection.msgtype, connection.msgcount, connection.digest)
            ext = connection.ext
            encoding = ext.serialization_format if isinstance(ext, ConnectionExtRosbag2) else "cdr"
            has_definition = connection.msgdef.format != MessageDefinitionFormat.NONE
            yield StoredTopic(path, topic, encoding, connection.msgdef if has_definition else None)

    def _messages(
        self, path: Path, reader: Reader, topics: Collection[int], start_ns: int, stop_ns: int
    ) -> Iterator[tuple[int, int, bytes]]:
        connections = [c for c in reader.connections if self._topic_indices.get((c.topic, c.msgtype)) in topics]
        if not connections:
            return
        try:
            rows: Iterator[tuple[Connection, Any, Any]] = reader.messages(connections, start_ns, stop_ns)
            for connection, log_time_ns, stored in rows:
                if not isinstance(log_time_ns, int) or not isinstance(stored, bytes):  # SQLite checks no types
                    self._losses.add(f"{path}: {connection.topic}: left out messages without a time or data")
                    continue
                data = self._cdr(path, connection, stored)
                if data:
                    yield log_time_ns, self._topic_indices[connection.topic, connection.msgtype], data
        except Exception as error:  # noqa: BLE001 - rosbags raises many types for a damaged file
            self._losses.add(f"{path}: damaged, the rest is lost: {one_line(error)}")

    def _cdr(self, path: Path, connection: Connection, stored: bytes) -> bytes:
        """Return a message in CDR; empty if a ROS 1 message cannot be converted."""
        if not self._is_ros1:
            return stored
        try:
            return bytes(self.types.ros1_to_cdr(stored, connection.msgtype))
        except Exception as error:  # noqa: BLE001 - code generated from unchecked definitions
            origin = f"{path}: {connection.topic}: {connection.msgtype}"
            self._losses.add(f"{origin} cannot be converted: {one_line(error)}")
            return b""


def _batch(messages: list[tuple[int, int, bytes]]) -> MessageBatch:
    times, indices, data = zip(*messages, strict=True)
    return batch_of(indices, times, list(data))


def _open(path: Path, make_reader: Callable[[Path], Reader]) -> Reader:
    try:
        reader = make_reader(path)
        reader.open()
    except OSError:
        raise
    except Exception as error:  # noqa: BLE001 - rosbags raises many types for a damaged file
        raise BagError(f"{path}: cannot be read: {one_line(error)}") from None
    return reader
