"""Recordings that the rosbags library reads: SQLite and compressed rosbag2 recordings, and ROS 1 bags."""

from __future__ import annotations

import heapq
from contextlib import ExitStack
from functools import cached_property
from operator import itemgetter
from typing import TYPE_CHECKING

from rosbags.interfaces import ConnectionExtRosbag2, MessageDefinitionFormat
from rosbags.rosbag1 import Reader as Ros1Reader

from scara_effmass.bags.batches import Topic, batch_of
from scara_effmass.bags.definitions import types_of
from scara_effmass.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Sequence
    from pathlib import Path

    from rosbags.interfaces import Connection, MessageDefinition
    from rosbags.rosbag2 import Reader as Ros2Reader
    from rosbags.typesys.store import Typestore

    from scara_effmass.bags.batches import Losses, MessageBatch

BATCH_MESSAGES = 1000
BATCH_BYTES = 1 << 20


class RosbagsSource:
    """The files of one recording, each through a reader of rosbags, read as one."""

    def __init__(
        self, paths: Sequence[Path], losses: Losses, reader: Callable[[Path], Ros1Reader] | Callable[[Path], Ros2Reader]
    ) -> None:
        self._losses = losses
        self._readers: list[tuple[Path, Ros1Reader | Ros2Reader]] = []
        with ExitStack() as stack:
            for path in paths:
                opened = _opened(path, reader)
                stack.callback(opened.close)
                self._readers.append((path, opened))
            self._stack = stack.pop_all()
        self._definitions: dict[str, MessageDefinition] = {}
        counts: dict[tuple[str, str], int] = {}
        hashes: dict[tuple[str, str], str] = {}
        for path, connection in self._connections():
            if isinstance(connection.ext, ConnectionExtRosbag2) and connection.ext.serialization_format != "cdr":
                encoding = connection.ext.serialization_format
                losses.add(f"{path}: {connection.topic}: its encoding {encoding!r} is not read, only cdr is")
                continue
            key = connection.topic, connection.msgtype
            counts[key] = counts.get(key, 0) + connection.msgcount
            hashes.setdefault(key, connection.digest)
            if connection.msgdef.format != MessageDefinitionFormat.NONE:
                self._definitions.setdefault(connection.msgtype, connection.msgdef)
        self.topics = tuple(Topic(*key, count, hashes[key]) for key, count in sorted(counts.items()))
        self._number = {(topic.name, topic.type): number for number, topic in enumerate(self.topics)}
        full = [reader for _, reader in self._readers if reader.message_count]
        self.start_ns = min((reader.start_time for reader in full), default=0)
        self.end_ns = max((reader.end_time - 1 for reader in full), default=0)
        self._is_ros1 = any(isinstance(reader, Ros1Reader) for _, reader in self._readers)

    @cached_property
    def types(self) -> Typestore:
        """See `Source`."""
        return types_of(self._definitions, ros1=self._is_ros1)

    def batches(self, topics: Collection[int], start_ns: int, stop_ns: int) -> Iterator[MessageBatch]:
        """See `Source`."""
        streams = [self._messages(path, reader, topics, start_ns, stop_ns) for path, reader in self._readers]
        numbers: list[int] = []
        times: list[int] = []
        messages: list[bytes] = []
        size = 0
        for log_time_ns, number, data in heapq.merge(*streams, key=itemgetter(0)):
            numbers.append(number)
            times.append(log_time_ns)
            messages.append(data)
            size += len(data)
            if len(messages) == BATCH_MESSAGES or size > BATCH_BYTES:
                yield batch_of(numbers, times, messages)
                numbers, times, messages, size = [], [], [], 0
        if messages:
            yield batch_of(numbers, times, messages)

    def close(self) -> None:
        """See `Source`."""
        self._stack.close()

    def _connections(self) -> Iterator[tuple[Path, Connection]]:
        for path, reader in self._readers:
            for connection in reader.connections:
                yield path, connection

    def _messages(
        self, path: Path, reader: Ros1Reader | Ros2Reader, topics: Collection[int], start_ns: int, stop_ns: int
    ) -> Iterator[tuple[int, int, bytes]]:
        wanted = [c for c in reader.connections if self._number.get((c.topic, c.msgtype)) in topics]
        if not wanted:
            return
        try:
            for connection, log_time_ns, stored in reader.messages(wanted, start_ns, stop_ns):
                data = self._cdr(path, connection, stored)
                if data:
                    yield log_time_ns, self._number[connection.topic, connection.msgtype], data
        except Exception as error:  # noqa: BLE001 - a damaged file shows itself in every error its libraries know
            self._losses.add(f"{path}: damaged, what came later is lost: {_line(error)}")

    def _cdr(self, path: Path, connection: Connection, stored: bytes) -> bytes:
        """Return a message as CDR, nothing where a ROS 1 message does not let itself be converted."""
        if not self._is_ros1:
            return stored
        try:
            return bytes(self.types.ros1_to_cdr(stored, connection.msgtype))
        except Exception as error:  # noqa: BLE001 - the conversion is generated from definitions nobody checked
            self._losses.add(f"{path}: {connection.topic}: {connection.msgtype} cannot be converted: {_line(error)}")
            return b""


def _opened(path: Path, reader: Callable[[Path], Ros1Reader] | Callable[[Path], Ros2Reader]) -> Ros1Reader | Ros2Reader:
    try:
        opened = reader(path)
        opened.open()
    except OSError:
        raise
    except Exception as error:  # noqa: BLE001 - see above
        raise BagError(f"{path}: cannot be read: {_line(error)}") from None
    return opened


def _line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
