"""The writer of a rosbag2 folder that is split into files; it survives a full or failing disk."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, final

from scara_effmass.bags.disk_space import DiskSpace
from scara_effmass.bags.mcap_writer import CHUNK_BYTES, FileOpener, McapFileWriter
from scara_effmass.bags.recording_report import LOSSES_RECORD, RecordedTopic, losses_custom_data, losses_record
from scara_effmass.bags.rosbag2 import BagFile, sync_folder, write_metadata

if TYPE_CHECKING:
    from scara_effmass.bags.recorder import RecorderOptions


@final
class SplitWriter:
    """Writes messages to the files `<name>_0.mcap`, `<name>_1.mcap`, ... of a folder; for one thread.

    Disk errors are not raised: messages that cannot be saved are counted in their topic and reported to `warn`.
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
        """Files without an index, because the disk refused it."""
        self.stopped = False
        """Whether messages are lost because of the disk."""
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
        self._failing = False
        self._stored_losses: dict[str, str] = {}
        self._file: McapFileWriter | None = None
        self._open_file()

    @property
    def size_bytes(self) -> int:
        """Size of all files."""
        return self._done_bytes + (self._file.saved_bytes if self._file else 0)

    @property
    def saved(self) -> int:
        """Messages in all files; another thread may read too few while a file is completed."""
        file = self._file
        return sum(done.count for done in tuple(self.done)) + (file.saved.count if file else 0)

    def write(self, topic: int, log_time_ns: int, sequence: int, data: bytes) -> None:
        """Add a message of the topic with this index, or count it as lost."""
        file = self._file
        if file is not None and file.message_count and log_time_ns - file.start_ns >= self._max_file_ns:
            self._split()
            file = self._file
        if file is None or self._failing:
            self._topics[topic].lost.disk += 1
            return
        if len(file.topics) <= topic:
            self._add_topics(file)
        file.add_message(topic, log_time_ns, data, sequence)
        self._topics[topic].pending += 1
        if file.pending_bytes >= CHUNK_BYTES:
            self._save(file, sync=False)
            self._split_by_size()

    def flush(self, now_ns: int) -> None:
        """Write everything to the disk and check its free space. `now_ns` is of a steady clock."""
        file = self._file
        if file is not None and not self._failing:
            losses = losses_record(self._topics)
            if losses != self._stored_losses:
                file.add_metadata(LOSSES_RECORD, losses)
                self._stored_losses = losses
            if not file.is_saved:
                self._save(file, sync=True)
            self._split_by_size()
        try:
            self._check_disk(now_ns)
        except OSError as error:
            self._warn_once(f"its free space cannot be read: {error.strerror}")

    def close(self) -> None:
        """Complete the recording as far as the disk permits."""
        if self._file is not None:
            self._finish(self._file)
        if self._file is not None:
            self._leave(self._file)
        self._write_metadata()

    def abandon(self) -> None:
        """Close the file without completing it."""
        if self._file is not None:
            self._file.close()

    def _open_file(self) -> None:
        """Create the next file. It gets its name once its first bytes are on the disk. Raises OSError."""
        path = self.folder / f"{self._name}_{self._file_count}.mcap"
        unfinished = path.with_name(f".{path.name}.new")
        unfinished.unlink(missing_ok=True)
        file = McapFileWriter(unfinished, path.name, compress=self._compress, opener=self._opener)
        try:
            file.save(sync=True)
            unfinished.rename(path)
            sync_folder(path.parent)
        except OSError:
            file.close()
            unfinished.unlink(missing_ok=True)
            raise
        self._file = file
        self._file_count += 1
        self._stored_losses = {}
        self._failing = self.stopped = False

    def _add_topics(self, file: McapFileWriter) -> None:
        for topic in self._topics[len(file.topics) :]:
            file.add_topic(topic.topic, topic.definition)

    def _split_by_size(self) -> None:
        file = self._file
        if file is not None and file.saved.count and not self._failing and file.saved_bytes >= self._max_file_bytes:
            self._split()

    def _split(self) -> None:
        """Complete the file and open the next one."""
        if self._file is not None:
            self._finish(self._file)
        if self._file is None:
            self._resume("")

    def _resume(self, message: str) -> None:
        try:
            self._open_file()
        except OSError as error:
            self.stopped = True
            self._warn_once(f"cannot create the next file: {error.strerror}; messages are lost and counted")
        else:
            if message:
                self._warn_once(message)

    def _save(self, file: McapFileWriter, *, sync: bool) -> None:
        try:
            file.save(sync=sync)
        except OSError as error:
            self._warn_once(f"cannot be written: {error.strerror}; messages are lost and counted")
            self._failing = self.stopped = True
            return
        self._failing = False
        for topic in self._topics:
            topic.pending = 0

    def _finish(self, file: McapFileWriter) -> None:
        """Complete the file; it stays open if the disk refuses."""
        if not file.finished:
            self._add_topics(file)
            losses = losses_record(self._topics)
            file.add_metadata(LOSSES_RECORD, losses)
            file.finish(losses_custom_data(losses))
        self._save(file, sync=True)
        if not self._failing:
            self._leave(file)
            self._write_metadata()

    def _leave(self, file: McapFileWriter) -> None:
        """Close the file as it is on the disk."""
        if self._failing:
            self.unindexed.append(file.saved.name)
            for topic in self._topics:
                topic.lost.disk += topic.pending
                topic.pending = 0
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
            if self._space.can_resume():
                if self._file is not None:
                    self._finish(self._file)
                if self._file is None:
                    self._resume("the disk has room again: recording resumes")
            return
        if self._space.is_exhausted():
            reserve = f"{self._space.reserve / 1e6:.0f} MB"
            self._warn_once(f"the disk has less than {reserve} left: recording stops, messages are lost and counted")
            self.stopped = True
            if self._file is not None:
                self._finish(self._file)
        elif warning := self._space.warning(now_ns, self.size_bytes):
            self._warn_once(warning)
