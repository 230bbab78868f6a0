"""What a recording holds, and what it lacks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from scara_effmass.bags.recorded_topic import Lost


@dataclass(frozen=True, slots=True)
class TopicReport:
    """What became of one topic: `recorded` messages are in the files."""

    type: str
    received: int
    recorded: int
    lost: Lost


@dataclass(frozen=True, slots=True)
class RecordingReport:
    """What a recording holds. While it goes on, messages that are still on their way count as recorded."""

    folder: Path
    topics: Mapping[str, TopicReport]
    files: tuple[str, ...]
    """Completed ones."""
    unindexed: tuple[str, ...]
    """Those among them that have no index, because the disk was full; `repair` makes one."""
    saved: int
    """Messages of all topics that are in the files: they stay if the process dies now."""
    size_bytes: int
    stopped_by_disk: bool
    """Whether it is stopped, or ended, because the disk is full or refuses what is written."""

    @property
    def recorded(self) -> int:
        """Messages of all topics."""
        return sum(topic.recorded for topic in self.topics.values())

    @property
    def lost(self) -> int:
        """Messages of all topics."""
        return sum(topic.lost.total for topic in self.topics.values())
