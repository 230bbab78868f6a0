# SPDX-License-Identifier: Apache-2.0
"""Message counts of a recording: recorded and lost, by topic and cause."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

from scara_effmass.bags.batches import Topic

LOSSES_RECORD = "scara_effmass/losses"
"""Name of the MCAP metadata record, and key in custom_data of metadata.yaml, with the lost messages."""


@dataclass(slots=True)
class LossCounts:
    """Messages of one topic that are not in the recording, by cause."""

    queue: int = 0
    """The queue was full."""
    disk: int = 0
    """The disk was full or refused to write."""
    middleware: int = 0
    """The middleware reported them as lost."""

    @property
    def total(self) -> int:
        """The sum over all causes."""
        return self.queue + self.disk + self.middleware


@dataclass(slots=True)
class RecordedTopic:
    """A topic while it is recorded."""

    topic: Topic
    definition: str
    received: int = 0
    lost: LossCounts = field(default_factory=LossCounts)


@dataclass(frozen=True, slots=True)
class TopicReport:
    """Message counts of one topic."""

    type: str
    received: int
    recorded: int
    lost: LossCounts


@dataclass(frozen=True, slots=True)
class RecordingReport:
    """Message counts of a recording. Until it ends, `recorded` includes messages in the queue."""

    folder: Path
    topics: Mapping[str, TopicReport]
    files: tuple[str, ...]
    """Completed files."""
    unindexed: tuple[str, ...]
    """Files without an index, because the disk was full; `repair` adds the index."""
    saved: int
    """Messages in the files; they survive if the process is killed."""
    size_bytes: int
    stopped_by_disk: bool
    """Whether the recording has stopped because the disk is full or refuses to write."""

    @property
    def recorded(self) -> int:
        """Recorded messages of all topics."""
        return sum(topic.recorded for topic in self.topics.values())

    @property
    def lost(self) -> int:
        """Lost messages of all topics."""
        return sum(topic.lost.total for topic in self.topics.values())


def losses_record(topics: Iterable[RecordedTopic]) -> dict[str, str]:
    """Return the content of the metadata record: for each topic with losses, the counts by cause as JSON."""
    return {topic.topic.name: json.dumps(asdict(topic.lost)) for topic in topics if topic.lost.total}


def losses_custom_data(record: Mapping[str, str]) -> dict[str, str]:
    """Convert the content of the metadata record to custom_data of metadata.yaml."""
    return {LOSSES_RECORD: json.dumps({topic: json.loads(counts) for topic, counts in record.items()})}
