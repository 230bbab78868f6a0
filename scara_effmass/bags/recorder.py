# SPDX-License-Identifier: Apache-2.0
"""Recorder of live messages, and its message counts."""

import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, final

from rosbags.typesys.store import Typestore
from typing_extensions import Self

from scara_effmass.bags.batches import Topic
from scara_effmass.bags.definitions import definition_of, known_types
from scara_effmass.bags.files import check_output
from scara_effmass.bags.split_writer import DiskSpace, LossCounts, RecordedTopic, RecorderOptions, SplitWriter
from scara_effmass.bags.writer import FileOpener, open_unbuffered
from scara_effmass.errors import OutputError
from scara_effmass.wire.cdr import NS

POLL_S = 0.05
"""Maximum time for which a message waits in the queue."""
WAKE_BYTES = 1 << 20
"""Queue size that wakes the writing thread immediately."""


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


class MessageSink(Protocol):
    """Receiver of serialized messages from live topics; its methods are those of `BagRecorder`."""

    def add_topic(self, name: str, message_type: str, *, offered_qos: str = "", types: Typestore | None = None) -> int:
        """Add a topic and return its index. Raises BagError."""

    def write(self, topic: int, log_time_ns: int, data: bytes) -> object:
        """Take a message (CDR bytes) of the topic with this index."""


@final
class BagRecorder:
    """Records messages into a rosbag2 folder; use it in a `with`, or close it.

    A thread writes the files, so `write` never waits for the disk. At any moment, the files can be read up to the last
    flush. Lost messages are counted per topic; the counts are stored in the files and reported.
    """

    def __init__(
        self,
        folder: Path,
        options: RecorderOptions | None = None,
        *,
        overwrite: bool = False,
        warn: Callable[[str], None] = lambda _: None,
        free_space: Callable[[], int] | None = None,
        opener: FileOpener = open_unbuffered,
    ) -> None:
        """Start recording. The writing thread calls `warn`; tests replace the disk with `free_space` [B] and `opener`.

        Raises OutputError if `folder` exists and `overwrite` is false, or if it cannot be created.
        """
        self.folder = folder
        self._options = options or RecorderOptions()
        self._topics: list[RecordedTopic] = []
        self._queue: list[tuple[int, int, int, bytes]] = []
        self._queued_bytes = self._queued_messages = 0
        self._wake = threading.Condition()
        self._closing = False
        self._flush_due_ns = time.monotonic_ns() + round(self._options.flush_period_s * NS)
        self._failure: Exception | None = None
        if folder.suffix == ".mcap":
            raise OutputError(f"{folder}: must be a folder name without .mcap")
        check_output(folder, overwrite=overwrite)
        self._writer = self._start_writer(warn, free_space or (lambda: shutil.disk_usage(folder.parent).free), opener)
        self._thread = threading.Thread(target=self._run, name="recorder")
        self._thread.start()

    def add_topic(self, name: str, message_type: str, *, offered_qos: str = "", types: Typestore | None = None) -> int:
        """Add a topic and return its index for `write`.

        `offered_qos` is from `qos_yaml`; `types` (default: the known ones) must define the type. Raises BagError.
        """
        definition, type_hash = definition_of(types or known_types(), message_type, f"{self.folder}: {name}")
        self._topics.append(RecordedTopic(Topic(name, message_type, 0, type_hash, offered_qos), definition))
        return len(self._topics) - 1

    def write(self, topic: int, log_time_ns: int, data: bytes) -> bool:
        """Queue a message (CDR bytes) of the topic with this index; if it is lost, count it and return False.

        Never waits for the disk.
        """
        recorded = self._topics[topic]
        size = len(data)
        with self._wake:
            sequence = recorded.received
            recorded.received += 1
            if (
                self._closing
                or self._failure is not None
                or self._queued_bytes + size > self._options.queue_bytes
                or self._queued_messages >= self._options.queue_messages
            ):
                recorded.lost.queue += 1
                return False
            self._queue.append((topic, log_time_ns, sequence, data))
            self._queued_messages += 1
            self._queued_bytes += size
            if self._queued_bytes >= WAKE_BYTES:
                self._wake.notify()
        return True

    def count_lost_by_middleware(self, topic: int, count: int) -> None:
        """Count messages that the middleware reports as lost."""
        self._topics[topic].lost.middleware += count

    @property
    def is_running(self) -> bool:
        """Whether messages are accepted."""
        return not self._closing and self._failure is None

    def report(self) -> RecordingReport:
        """Return the message counts so far."""
        topics = {}
        for recorded in list(self._topics):
            lost = replace(recorded.lost)
            count = recorded.received - lost.queue - lost.disk
            topics[recorded.topic.name] = TopicReport(recorded.topic.type, recorded.received, count, lost)
        writer = self._writer
        return RecordingReport(
            folder=self.folder,
            topics=topics,
            files=tuple(file.name for file in writer.done),
            unindexed=tuple(writer.unindexed),
            saved=writer.saved,
            size_bytes=writer.size_bytes,
            stopped_by_disk=writer.stopped,
        )

    def close(self) -> RecordingReport:
        """Write the queue, complete the recording and return the report. May be called again.

        Raises OutputError if the writing thread has failed.
        """
        with self._wake:
            self._closing = True
            self._wake.notify()
        self._thread.join()
        if self._failure is not None:
            raise OutputError(f"{self.folder}: recording failed: {self._failure}") from self._failure
        return self.report()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _start_writer(
        self, warn: Callable[[str], None], free_space: Callable[[], int], opener: FileOpener
    ) -> SplitWriter:
        """Create the folder under a temporary name, so that a replaced bag is kept until the new one exists."""
        folder, options = self.folder, self._options
        space = DiskSpace(free_space, options.reserve_bytes, options.warn_bytes, options.warn_before_s)
        try:
            folder.parent.mkdir(parents=True, exist_ok=True)
            has_room = not space.is_exhausted()
            with tempfile.TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent) as temporary:
                if has_room:
                    unfinished = Path(temporary, folder.name)
                    unfinished.mkdir()
                    writer = SplitWriter(unfinished, self._topics, options, space, opener, warn)
                    if folder.exists():
                        folder.rename(Path(temporary, "replaced"))
                    writer.folder = unfinished.rename(folder)
                    return writer
        except OSError as error:
            raise OutputError(f"{folder}: cannot be written: {error.strerror}") from None
        reserve = f"{options.reserve_bytes / 1e6:.0f} MB"
        raise OutputError(f"{folder}: the disk has less than {reserve} left; free some space")

    def _run(self) -> None:
        try:
            self._write_until_closed()
            self._writer.close()
        except Exception as error:  # noqa: BLE001 - reported by `close`
            self._failure = error
            self._writer.abandon()

    def _write_until_closed(self) -> None:
        closing = False
        while not closing:
            with self._wake:
                if not self._closing and self._queued_bytes < WAKE_BYTES:
                    self._wake.wait(min(POLL_S, self._options.flush_period_s))
                closing = self._closing
                messages, self._queue = self._queue, []
            size = 0
            for topic, log_time_ns, sequence, data in messages:
                self._writer.write(topic, log_time_ns, sequence, data)
                size += len(data)
                self._flush_when_due()  # also within a long queue
            with self._wake:
                self._queued_bytes -= size
                self._queued_messages -= len(messages)
            self._flush_when_due()

    def _flush_when_due(self) -> None:
        now_ns = time.monotonic_ns()
        if now_ns >= self._flush_due_ns:
            self._writer.flush(now_ns)
            self._flush_due_ns = time.monotonic_ns() + round(self._options.flush_period_s * NS)
