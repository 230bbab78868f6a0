"""The writer of MCAP files: profile, schemas, channels and messages as rosbag2 writes them."""

import fcntl
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import IO, cast, final

from mcap.writer import CompressionType, Writer

from scara_effmass.bags.batches import MAX_TIME_NS, Topic
from scara_effmass.bags.mcap_bag import HASH_KEY, QOS_KEY
from scara_effmass.bags.rosbag2 import BagFile, metadata, yaml_text

FileOpener = Callable[[Path], IO[bytes]]

PROFILE = "ros2"
LIBRARY = "scara_effmass"
METADATA_RECORD = "rosbag2"
"""The MCAP metadata record in which rosbag2 repeats metadata.yaml."""
CHUNK_BYTES = 1 << 20
"""Message bytes after which the caller should save."""


def open_unbuffered(path: Path) -> IO[bytes]:
    """Create a file without a buffer, which would report errors later and elsewhere."""
    return path.open("xb", buffering=0)


@final
class McapFileWriter:
    """Writes one MCAP file with checksums, an index and message definitions. The file is locked while open.

    `mcap.writer.Writer` writes to memory and `save` writes to the file, so the state of the writer never depends on the
    disk, and the file ends in whole chunks.
    """

    def __init__(
        self, path: Path, name: str = "", *, compress: bool = True, opener: FileOpener = open_unbuffered
    ) -> None:
        """Create the file; `name` is its final name, if different. Raises OSError."""
        self.start_ns, self.end_ns = MAX_TIME_NS, 0
        """First and last log time so far."""
        self.message_count = 0
        self.topics: list[Topic] = []
        self.saved_bytes = 0
        self.pending_bytes = 0
        """Message bytes that are not saved."""
        self.finished = False
        self._name = name or path.name
        self._counts: list[int] = []
        self._schemas: dict[str, int] = {}
        self._buffer: list[bytes] = []
        self._buffered_bytes = 0
        self._is_synced = True
        self._file = opener(path)
        with suppress(OSError):  # some network file systems have no locks
            fcntl.flock(self._file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._writer = Writer(
            cast("IO[bytes]", self),
            chunk_size=MAX_TIME_NS,  # `save` ends the chunks
            compression=CompressionType.ZSTD if compress else CompressionType.NONE,
        )
        self._writer.start(profile=PROFILE, library=LIBRARY)
        self.saved = self._bag_file()
        """The content that is saved."""

    @property
    def is_saved(self) -> bool:
        """Whether everything is in the file and synchronised to the disk."""
        return not self.pending_bytes and not self._buffer and self._is_synced

    def add_topic(self, topic: Topic, definition: str) -> None:
        """Add a topic, with the definition of its type as "ros2msg"; topics are numbered from 0."""
        if topic.type not in self._schemas:
            self._schemas[topic.type] = self._writer.register_schema(topic.type, "ros2msg", definition.encode())
        channel_metadata = {QOS_KEY: topic.offered_qos, HASH_KEY: topic.type_hash}
        self._writer.register_channel(topic.name, "cdr", self._schemas[topic.type], channel_metadata)
        self.topics.append(topic)
        self._counts.append(0)

    def add_message(self, topic: int, log_time_ns: int, data: bytes, sequence: int | None = None) -> None:
        """Add a message of a topic; `sequence` defaults to the number of its previous messages."""
        count = self._counts[topic]
        # Writer numbers channels from 1; sequence numbers have 32 bits.
        number = (count if sequence is None else sequence) & 0xFFFFFFFF
        self._writer.add_message(topic + 1, log_time_ns, data, log_time_ns, number)
        self._counts[topic] = count + 1
        self.message_count += 1
        self.pending_bytes += len(data)
        self.start_ns = min(self.start_ns, log_time_ns)
        self.end_ns = max(self.end_ns, log_time_ns)

    def add_metadata(self, name: str, content: Mapping[str, str]) -> None:
        """Add a metadata record."""
        self._writer.add_metadata(name, dict(content))

    def finish(self, custom_data: Mapping[str, str] | None = None) -> None:
        """Add index and summary, and metadata.yaml as rosbag2 does; `save` must follow."""
        self._writer.flush()  # type: ignore[no-untyped-call]
        text = yaml_text(metadata([self._bag_file()], custom_data))
        self.add_metadata(METADATA_RECORD, {"serialized_metadata": text})
        self._writer.finish()  # type: ignore[no-untyped-call]
        self.finished = True

    def save(self, *, sync: bool = False) -> None:
        """End the chunk and write everything to the file or nothing of it. Raises OSError.

        With `sync`, the data survives a power failure.
        """
        if not self.finished:
            self._writer.flush()  # type: ignore[no-untyped-call]
        data = memoryview(b"".join(self._buffer))
        written = 0
        try:
            while written < len(data):
                written += self._file.write(data[written:])
        except OSError:
            with suppress(OSError):  # otherwise the file ends in a torn record, which all readers here skip
                self._file.truncate(self.saved_bytes)
            self._file.seek(self.saved_bytes)
            raise
        self.saved_bytes += written
        self._buffer.clear()
        self._buffered_bytes = 0
        self._is_synced = self._is_synced and not written
        if sync:
            os.fdatasync(self._file.fileno())
            self._is_synced = True
        self.pending_bytes = 0
        self.saved = self._bag_file()

    def close(self) -> None:
        """Close the file; unsaved messages are lost."""
        self._file.close()

    def write(self, data: bytes) -> int:
        """Buffer the output of `mcap.writer.Writer`."""
        self._buffer.append(bytes(data))
        self._buffered_bytes += len(data)
        return len(data)

    def tell(self) -> int:
        """Return the offset of the next byte."""
        return self.saved_bytes + self._buffered_bytes

    def flush(self) -> None:
        """No-op: `save` writes."""

    def _bag_file(self) -> BagFile:
        topics = tuple(replace(topic, count=count) for topic, count in zip(self.topics, self._counts, strict=True))
        return BagFile(self._name, self.start_ns if self.message_count else 0, self.end_ns, topics)
