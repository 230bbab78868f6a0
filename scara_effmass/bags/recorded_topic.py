"""What a recording knows of each of its topics: the description, and where the messages went."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

    from scara_effmass.bags.batches import Topic

LOSSES_RECORD = "scara_effmass/losses"
"""Name of the MCAP metadata record, and key in custom_data of metadata.yaml, that tells what was lost."""


@dataclass(frozen=True, slots=True)
class Lost:
    """Messages of one topic that are not in the recording, by what lost them."""

    queue: int = 0
    """They came faster than they could be written."""
    disk: int = 0
    """The disk was full, or refused them."""
    middleware: int = 0
    """They never came: the middleware says so itself."""

    @property
    def total(self) -> int:
        """All of them."""
        return self.queue + self.disk + self.middleware


@dataclass(slots=True)
class RecordedTopic:
    """A topic while it is recorded."""

    topic: Topic
    definition: str
    received: int = 0
    """Messages that came, whether or not they could be kept."""
    lost_in_queue: int = 0
    lost_on_disk: int = 0
    lost_in_middleware: int = 0
    waiting: int = 0
    """Messages handed to the file whose chunk is not saved yet."""

    @property
    def lost(self) -> Lost:
        """What it has lost so far."""
        return Lost(self.lost_in_queue, self.lost_on_disk, self.lost_in_middleware)


def losses_record(topics: Iterable[RecordedTopic]) -> dict[str, str]:
    """Return the content of the metadata record: per topic that lost any, JSON of the counts by cause."""
    return {each.topic.name: json.dumps(asdict(each.lost)) for each in topics if each.lost.total}


def custom_data(losses: dict[str, str]) -> dict[str, str]:
    """Return what `losses_record` gives as custom_data of metadata.yaml."""
    return {LOSSES_RECORD: json.dumps({topic: json.loads(counts) for topic, counts in losses.items()})}
