"""One MCAP file as rosbag2 writes it: profile, schemas, channels, messages. Every recording is made of these."""

from __future__ import annotations

from dataclasses import replace
from typing import IO, TYPE_CHECKING, cast, final

from mcap.writer import CompressionType, Writer
from rosbags.typesys import TypesysError

from scara_effmass.bags.batches import LATEST_NS
from scara_effmass.bags.rosbag2 import Part, metadata, yaml_text
from scara_effmass.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rosbags.typesys.store import Typestore

    from scara_effmass.bags.batches import Topic
    from scara_effmass.bags.disk_file import DiskFile

PROFILE = "ros2"
LIBRARY = "scara_effmass"
METADATA_RECORD = "rosbag2"
"""The MCAP metadata record in which rosbag2 repeats metadata.yaml."""
QOS_KEY = "offered_qos_profiles"
HASH_KEY = "topic_type_hash"
CHUNK_BYTES = 1 << 20


@final
class PartWriter:
    """Writes one MCAP file as rosbag2 does: chunks with checksums, an index, and the message definitions in it."""

    def __init__(
        self, name: str, stream: IO[bytes] | DiskFile, *, compress: bool = True, chunk_bytes: int | None = CHUNK_BYTES
    ) -> None:
        """Begin the file called `name`. A chunk ends at `chunk_bytes` [B], with None only where `flush` ends it."""
        self.start_ns, self.end_ns = LATEST_NS, 0
        """First and last log time so far."""
        self.count = 0
        """Messages so far."""
        self._name = name
        self._counts: list[int] = []
        self._topics: list[Topic] = []
        self._schemas: dict[str, int] = {}
        self._writer = Writer(
            cast("IO[bytes]", stream),  # it only writes and tells
            chunk_size=LATEST_NS if chunk_bytes is None else chunk_bytes,
            compression=CompressionType.ZSTD if compress else CompressionType.NONE,
        )
        self._writer.start(profile=PROFILE, library=LIBRARY)

    @property
    def part(self) -> Part:
        """What has been written so far."""
        topics = tuple(replace(topic, count=count) for topic, count in zip(self._topics, self._counts, strict=True))
        return Part(self._name, self.start_ns if self.count else 0, self.end_ns, topics)

    def add_topic(self, topic: Topic, definition: str) -> int:
        """Describe a topic, with the definition of its type as "ros2msg"; return the number to write it under."""
        if topic.type not in self._schemas:
            self._schemas[topic.type] = self._writer.register_schema(topic.type, "ros2msg", definition.encode())
        about = {QOS_KEY: topic.offered_qos, HASH_KEY: topic.type_hash}
        self._writer.register_channel(topic.name, "cdr", self._schemas[topic.type], about)
        self._topics.append(topic)
        self._counts.append(0)
        return len(self._topics) - 1

    def write(self, number: int, log_time_ns: int, data: bytes, sequence: int | None = None) -> None:
        """Add one message of the topic `number`; `sequence` is by default how many of it came before."""
        counted = self._counts[number]
        # channels of the library count from 1, in order; sequence numbers have 32 bits
        order = (counted if sequence is None else sequence) & 0xFFFFFFFF
        self._writer.add_message(number + 1, log_time_ns, data, log_time_ns, order)
        self._counts[number] = counted + 1
        self.count += 1
        self.start_ns = min(self.start_ns, log_time_ns)
        self.end_ns = max(self.end_ns, log_time_ns)

    def add_metadata(self, name: str, content: Mapping[str, str]) -> None:
        """Add a metadata record."""
        self._writer.add_metadata(name, dict(content))

    def flush(self) -> None:
        """End the chunk."""
        self._writer.flush()  # type: ignore[no-untyped-call]

    def finish(self, custom: Mapping[str, str] | None = None) -> Part:
        """End the file with index and summary, its metadata kept inside too; return what it holds."""
        self.flush()
        part = self.part
        self.add_metadata(METADATA_RECORD, {"serialized_metadata": yaml_text(metadata([part], custom))})
        self._writer.finish()  # type: ignore[no-untyped-call]
        return part


def definition_of(types: Typestore, kind: str, origin: str) -> tuple[str, str]:
    """Return the definition of type `kind`, with all it refers to, and its hash.

    Raises BagError, beginning with `origin`, when `types` has none.
    """
    try:
        definition, _ = types.generate_msgdef(kind, ros_version=2)
        return definition, types.hash_rihs01(kind)
    except (TypesysError, LookupError):
        raise BagError(f"{origin}: type {kind} has no definition here") from None
