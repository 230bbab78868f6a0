# SPDX-License-Identifier: Apache-2.0
"""Recorder of live messages into a rosbag2 folder that is split into files; it survives a full or failing disk."""

import json
import math
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Protocol, final

from rosbags.typesys.store import Typestore
from typing_extensions import Self

from scara_effmass.bags.batches import Topic
from scara_effmass.bags.definitions import definition_of, known_types
from scara_effmass.bags.files import LOSSES_RECORD
from scara_effmass.bags.writer import (
    CHUNK_BYTES,
    BagFile,
    FileOpener,
    McapFileWriter,
    check_output,
    open_unbuffered,
    sync_folder,
    write_metadata,
)
from scara_effmass.errors import OutputError, writing
from scara_effmass.wire.cdr import NS

POLL_S = 0.05
"""Maximum time for which a message waits in the queue."""
WAKE_BYTES = 1 << 20
"""Queue size that wakes the writing thread immediately."""
MIN_RATE_SPAN_NS = 2 * NS
RATE_SPAN_NS = 10 * NS
"""Period over which the write rate is averaged."""
RESUME_FACTOR = 2
"""Free space, as a multiple of the reserve, at which a stopped recording resumes."""
CLEAR_FACTOR = 1.25
"""Multiple of the limits at which a warning is cleared; a varying rate then does not repeat it."""


@dataclass(slots=True)
class LossCounts:
    """Messages of one topic that are not in the recording, by cause."""

    queue: int = 0
    """The queue was full."""
    disk: int = 0
    """The disk was full or refused to write."""
    middleware: int = 0
    """The middleware has not delivered them."""

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


def losses_record(topics: Iterable[RecordedTopic]) -> dict[str, str]:
    """Return the content of the metadata record: for each topic with losses, the counts by cause as JSON."""
    return {topic.topic.name: json.dumps(asdict(topic.lost)) for topic in topics if topic.lost.total}


def losses_custom_data(record: Mapping[str, str]) -> dict[str, str]:
    """Convert the content of the metadata record to custom_data of metadata.yaml."""
    return {LOSSES_RECORD: json.dumps({topic: json.loads(counts) for topic, counts in record.items()})}


@dataclass(frozen=True, slots=True)
class RecorderOptions:
    """Options of a recording."""

    compress: bool = True
    """Compress chunks with zstd."""
    max_file_bytes: int = 0
    """Size at which a new file begins; 0: never."""
    max_file_ns: int = 0
    """Duration [ns] in log time at which a new file begins; 0: never."""
    flush_period_s: float = 0.5
    """Maximum age of a message that is not yet in the file, which is then synchronised to the disk; the writing thread
    adds up to 0.1 s."""
    queue_bytes: int = 64 << 20
    """Maximum size of the queue; further messages are lost and counted."""
    queue_messages: int = 100_000
    reserve_bytes: int = 64 << 20
    """Free space at which the recording stops, so that it can still be completed."""
    warn_bytes: int = 1 << 30
    """Free space below which the recorder warns."""
    warn_before_s: float = 600.0
    """The recorder also warns if the disk will be full within this time at the present rate."""


@final
class DiskSpace:
    """Watches free space while a recording grows. Times are of a steady clock [ns], sizes in bytes."""

    def __init__(self, free: Callable[[], int], reserve: int, warn_below: int, warn_before_s: float) -> None:
        """Keep `reserve` free; warn below `warn_below`, or if the reserve is reached within `warn_before_s`."""
        self.reserve = reserve
        self._free = free
        self._warn_below = warn_below
        self._warn_before_s = warn_before_s
        self._sizes: list[tuple[int, int]] = []
        self._last_warning_left = math.inf

    def is_exhausted(self) -> bool:
        """Whether the recording must stop. Raises OSError."""
        return self._free() < self.reserve

    def can_resume(self) -> bool:
        """Whether a stopped recording may resume. Raises OSError."""
        return self._free() >= RESUME_FACTOR * self.reserve

    def warning(self, now_ns: int, written: int) -> str:
        """Return a warning about the space left after `written` bytes; empty if none is due.

        A warning is repeated whenever the space left has halved. Raises OSError.
        """
        self._sizes = [size for size in self._sizes if now_ns - size[0] <= RATE_SPAN_NS] + [(now_ns, written)]
        start_ns, start_bytes = self._sizes[0]
        span_ns = now_ns - start_ns
        bytes_per_s = (written - start_bytes) * NS / span_ns if span_ns >= MIN_RATE_SPAN_NS else 0.0
        free = self._free()
        left = max(free - self.reserve, 0)
        left_s = left / bytes_per_s if bytes_per_s > 0.0 else math.inf
        if free >= CLEAR_FACTOR * self._warn_below and left_s >= CLEAR_FACTOR * self._warn_before_s:
            self._last_warning_left = math.inf
        is_low = free < self._warn_below or left_s < self._warn_before_s
        if not is_low or left > self._last_warning_left / 2:
            return ""
        self._last_warning_left = left
        end = f"; at {bytes_per_s / 1e6:.2f} MB/s recording stops in {left_s:.0f} s" if bytes_per_s > 0.0 else ""
        return f"the disk has {free / 1e6:.0f} MB left, of which {self.reserve / 1e6:.0f} MB stay free{end}"


@final
class SplitWriter:
    """Writes messages to the files `<name>_0.mcap`, `<name>_1.mcap`, ... of a folder; not thread-safe.

    Errors of the disk are reported to `warn` and not raised; messages that cannot be saved are counted in their topic.
    """

    def __init__(
        self,
        folder: Path,
        topics: Sequence[RecordedTopic],
        options: RecorderOptions,
        space: DiskSpace,
        opener: FileOpener,
        warn: Callable[[str], None],
    ) -> None:
        """Create the first file in `folder`. `topics` may grow later. Raises OSError."""
        self.folder = folder
        self.done: list[BagFile] = []
        self.unindexed: list[str] = []
        """Files to which the disk refused to write the index."""
        self.stopped = False
        """Whether messages are lost because of the disk: there is no file, or the file cannot be written."""
        self._name = folder.name
        self._topics = topics
        self._compress = options.compress
        self._max_file_bytes = options.max_file_bytes or math.inf
        self._max_file_ns = options.max_file_ns or math.inf
        self._space = space
        self._opener = opener
        self._warn = warn
        self._last_warning = ""
        self._file_count = 0
        self._done_bytes = 0
        self._stored_losses: dict[str, str] = {}
        self._file: McapFileWriter | None = None
        self._open_file()

    @property
    def size_bytes(self) -> int:
        """Size of all files."""
        return self._done_bytes + (self._file.saved_bytes if self._file else 0)

    @property
    def saved(self) -> int:
        """Messages in all files; another thread may see too few while a file is completed."""
        file = self._file
        return sum(done.count for done in tuple(self.done)) + (file.saved.count if file else 0)

    def write(self, topic: int, log_time_ns: int, sequence: int, data: bytes) -> None:
        """Add a message of the topic with this index, or count it as lost."""
        file = self._file
        if file is not None and not self.stopped and log_time_ns - file.start_ns >= self._max_file_ns:
            self._split()
            file = self._file
        if file is None or self.stopped:
            self._topics[topic].lost.disk += 1
            return
        if len(file.topics) <= topic:
            self._add_topics(file)
        file.add_message(topic, log_time_ns, data, sequence)
        if file.pending_bytes >= CHUNK_BYTES:
            self._save(file)
            self._split_by_size()

    def flush(self, now_ns: int) -> None:
        """Write everything to the file, start to synchronise it to the disk, and check the free space.

        `now_ns` is of a steady clock.
        """
        file = self._file
        if file is not None and not self.stopped:
            losses = losses_record(self._topics)
            if losses != self._stored_losses:
                file.add_metadata(LOSSES_RECORD, losses)
                self._stored_losses = losses
            if not file.is_saved:
                self._save(file, file.start_sync)
            self._split_by_size()
        try:
            self._check_disk(now_ns)
        except OSError as error:
            self._warn_once(f"its free space cannot be read: {error.strerror}")

    def close(self) -> None:
        """Complete the recording as far as the disk permits."""
        self._finish()
        if self._file is not None:  # the disk refuses the index
            self.unindexed.append(self._file.saved.name)
            for topic, lost in zip(self._topics, self._file.unsaved_counts, strict=False):
                topic.lost.disk += lost
            self._leave(self._file)
        self._write_metadata()

    def abandon(self) -> None:
        """Close the file without completing it."""
        if self._file is not None:
            self._file.close()

    def _open_file(self) -> None:
        """Create the next file. It gets its final name once its first bytes are on the disk. Raises OSError."""
        path = self.folder / f"{self._name}_{self._file_count}.mcap"
        unfinished = path.with_name(f".{path.name}.new")
        unfinished.unlink(missing_ok=True)
        file = McapFileWriter(unfinished, path.name, compress=self._compress, opener=self._opener)
        try:
            file.save()
            file.sync()
            unfinished.rename(path)
            sync_folder(path.parent)
        except OSError:
            file.close()
            unfinished.unlink(missing_ok=True)
            raise
        self._file = file
        self._file_count += 1
        self._stored_losses = {}
        self.stopped = False

    def _add_topics(self, file: McapFileWriter) -> None:
        for topic in self._topics[len(file.topics) :]:
            file.add_topic(topic.topic, topic.definition)

    def _split_by_size(self) -> None:
        file = self._file
        if file is not None and not self.stopped and file.saved.count and file.saved_bytes >= self._max_file_bytes:
            self._split()

    def _split(self) -> bool:
        """Complete the file and open the next one; return whether the disk permits both."""
        if not self._finish():
            return False
        try:
            self._open_file()
        except OSError as error:
            self.stopped = True
            self._warn_once(f"cannot create the next file: {error.strerror}; messages are lost and counted")
            return False
        return True

    def _save(self, file: McapFileWriter, sync: Callable[[], None] = lambda: None) -> bool:
        try:
            file.save()
            sync()
        except OSError as error:
            self._warn_once(f"cannot be written: {error.strerror}; messages are lost and counted")
            self.stopped = True
            return False
        return True

    def _finish(self) -> bool:
        """Complete the file, if there is one; return False if the disk refuses, which leaves the file open."""
        file = self._file
        if file is None:
            return True
        if not file.finished:
            self._add_topics(file)
            losses = losses_record(self._topics)
            file.add_metadata(LOSSES_RECORD, losses)
            file.finish(losses_custom_data(losses))
        if not self._save(file, file.sync):
            return False
        self._leave(file)
        self._write_metadata()
        return True

    def _leave(self, file: McapFileWriter) -> None:
        """Close the file as it is on the disk."""
        self._file = None
        self.done.append(file.saved)
        self._done_bytes += file.saved_bytes
        file.close()

    def _write_metadata(self) -> None:
        try:
            write_metadata(self.folder, self.done, losses_custom_data(losses_record(self._topics)))
        except OSError as error:
            with suppress(OSError):
                (self.folder / ".metadata.yaml.new").unlink()
            self._warn_once(f"metadata.yaml cannot be written: {error.strerror}; record --repair creates it")

    def _warn_once(self, line: str) -> None:
        """Report a line unless it was the last one."""
        if line != self._last_warning:
            self._last_warning = line
            self._warn(f"{self.folder}: {line}")

    def _check_disk(self, now_ns: int) -> None:
        if self.stopped:
            if self._space.can_resume() and self._split():
                self._warn_once("the disk has room again: recording resumes")
            return
        if self._space.is_exhausted():
            reserve = f"{self._space.reserve / 1e6:.0f} MB"
            self._warn_once(f"the disk has less than {reserve} left: recording stops, messages are lost and counted")
            self.stopped = True
            self._finish()
        elif warning := self._space.warning(now_ns, self.size_bytes):
            self._warn_once(warning)


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
        progress: Callable[[], None] = lambda: None,
        free_space: Callable[[], int] | None = None,
        opener: FileOpener = open_unbuffered,
    ) -> None:
        """Start recording. The writing thread calls `warn`, and `progress` some ten times a second while it is at work.

        Tests replace the disk with `free_space` [B] and `opener`.

        Raises OutputError if `folder` exists and `overwrite` is false, or if it cannot be created.
        """
        self.folder = folder
        self._options = options or RecorderOptions()
        self._progress = progress
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
        """Count messages that the middleware has not delivered."""
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
        with writing(folder):
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
            self._progress()
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
            self._progress()
            self._flush_due_ns = time.monotonic_ns() + round(self._options.flush_period_s * NS)
