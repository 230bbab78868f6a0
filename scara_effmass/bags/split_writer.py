# SPDX-License-Identifier: Apache-2.0
"""Writer of a rosbag2 folder that is split into files; it survives a full or failing disk."""

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import final

from scara_effmass.bags.batches import Topic
from scara_effmass.bags.files import BagFile, sync_folder, write_metadata
from scara_effmass.bags.writer import CHUNK_BYTES, FileOpener, McapFileWriter
from scara_effmass.wire.cdr import NS

MIN_RATE_SPAN_NS = 2 * NS
RATE_SPAN_NS = 10 * NS
"""Period over which the write rate is averaged."""
RESUME_FACTOR = 2
"""Free space, as a multiple of the reserve, at which a stopped recording resumes."""
CLEAR_FACTOR = 1.25
"""Multiple of the limits at which a warning is cleared; a varying rate then does not repeat it."""
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
