"""The files of a recording while it is written: one after the other, each complete when it is left."""

from __future__ import annotations

import math
from contextlib import suppress
from typing import TYPE_CHECKING, final

from scara_effmass.bags.disk_file import DiskFile
from scara_effmass.bags.part_writer import CHUNK_BYTES, PartWriter
from scara_effmass.bags.recorded_topic import LOSSES_RECORD, custom_data, losses_record
from scara_effmass.bags.rosbag2 import sync_folder, write_metadata

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from scara_effmass.bags.disk_file import OpenRaw
    from scara_effmass.bags.disk_space import DiskSpace
    from scara_effmass.bags.recorded_topic import RecordedTopic
    from scara_effmass.bags.recording_options import RecordingOptions
    from scara_effmass.bags.rosbag2 import Part


@final
class _OpenPart:
    """The part that is being written."""

    def __init__(self, path: Path, opener: OpenRaw, *, compress: bool) -> None:
        """Begin the file; it has its name once its first bytes are on the disk. Raises OSError."""
        fresh = path.with_name(f".{path.name}.new")
        fresh.unlink(missing_ok=True)
        self.file = DiskFile(fresh, opener)
        try:
            # chunks end where they are saved, so that what is known to be saved are whole chunks
            self.writer = PartWriter(path.name, self.file, compress=compress, chunk_bytes=None)
            self.file.save()
            self.file.sync()
            fresh.rename(path)
            sync_folder(path.parent)
        except OSError:
            self.file.close()
            fresh.unlink(missing_ok=True)
            raise
        self.on_disk = self.writer.part
        self.described = 0
        self.unsaved_bytes = 0
        self.synced = True
        self.losses: dict[str, str] = {}
        self.finished = False
        self.failing = False

    def describe(self, topics: Sequence[RecordedTopic]) -> None:
        """Put the topics that have come up since the last time into the file; the numbers stay."""
        for each in topics[self.described :]:
            self.writer.add_topic(each.topic, each.definition)
            self.described += 1


@final
class PartSeries:
    """Writes messages into parts `<name>_0.mcap`, `<name>_1.mcap`, ... of a folder; for one thread.

    No error of the disk leaves it: messages that cannot be kept are counted in their topic, and `say` is told why.
    """

    def __init__(
        self,
        folder: Path,
        topics: Sequence[RecordedTopic],
        options: RecordingOptions,
        space: DiskSpace,
        opener: OpenRaw,
        say: Callable[[str], None],
    ) -> None:
        """Begin the first part in `folder`. `topics` may grow while it goes on. Raises OSError."""
        self.folder = folder
        self.done: list[Part] = []
        self.unindexed: list[str] = []
        """Parts without an index, because the disk did not take it."""
        self.stopped = False
        """Whether messages are lost because of the disk."""
        self._name = folder.name
        self._topics = topics
        self._compress = options.compress
        self._part_bytes = options.part_bytes or math.inf
        self._part_ns = options.part_ns or math.inf
        self._space = space
        self._opener = opener
        self._say = say
        self._told = ""
        self._begun = 0
        self._earlier_bytes = 0
        self._open: _OpenPart | None = None
        self._begin()

    @property
    def size(self) -> int:
        """Bytes in all files."""
        return self._earlier_bytes + (self._open.file.saved if self._open else 0)

    @property
    def saved(self) -> int:
        """Messages in all files; asked from another thread while a file is being left, it may count too few."""
        done = sum(part.count for part in tuple(self.done))
        part = self._open
        return done + (part.on_disk.count if part else 0)

    def write(self, number: int, log_time_ns: int, sequence: int, data: bytes) -> None:
        """Add one message of the topic `number`, or count it as lost."""
        part = self._open
        if part is not None and part.writer.count and log_time_ns - part.writer.start_ns >= self._part_ns:
            self._next()
            part = self._open
        if part is None or part.failing:
            self._topics[number].lost_on_disk += 1
            return
        if part.described <= number:
            part.describe(self._topics)
        part.writer.write(number, log_time_ns, data, sequence)
        self._topics[number].waiting += 1
        part.unsaved_bytes += len(data)
        if part.unsaved_bytes >= CHUNK_BYTES:
            self._save(part, sync=False)
            self._split(part)

    def flush(self, now_ns: int) -> None:
        """Bring everything to the disk, and see how much room it has left. `now_ns` is of a steady clock."""
        part = self._open
        if part is not None and not part.failing:
            losses = losses_record(self._topics)
            if losses != part.losses:
                part.writer.add_metadata(LOSSES_RECORD, losses)
                part.losses = losses
            if part.unsaved_bytes or part.file.waiting or not part.synced:
                self._save(part, sync=True)
            self._split(part)
        try:
            self._look_at_disk(now_ns)
        except OSError as error:
            self._tell(f"its free space cannot be read: {error.strerror}")

    def close(self) -> None:
        """Complete the recording, as far as the disk lets it."""
        part = self._open
        if part is not None:
            self._finish(part)
            if self._open is not None:  # it never got its end
                self._leave(part)
        self._write_metadata()

    def abandon(self) -> None:
        """Leave everything as it is on the disk."""
        if self._open is not None:
            self._open.file.close()

    def _begin(self) -> None:
        path = self.folder / f"{self._name}_{self._begun}.mcap"
        self._open = _OpenPart(path, self._opener, compress=self._compress)
        self._begun += 1
        self.stopped = False

    def _split(self, part: _OpenPart) -> None:
        if part.on_disk.count and not part.failing and part.file.saved >= self._part_bytes:
            self._next()

    def _next(self) -> None:
        """Complete this part and begin another."""
        if self._open is not None:
            self._finish(self._open)
        if self._open is None:
            self._resume("")

    def _resume(self, news: str) -> None:
        try:
            self._begin()
        except OSError as error:
            self.stopped = True
            self._tell(f"no further file can be made: {error.strerror}; messages are lost and counted")
        else:
            if news:
                self._tell(news)

    def _save(self, part: _OpenPart, *, sync: bool) -> None:
        """Bring the chunk to the file, and the file to the disk."""
        try:
            part.writer.flush()
            part.file.save()
            if sync:
                part.file.sync()
        except OSError as error:
            self._tell(f"cannot be written: {error.strerror}; messages are lost and counted")
            part.failing = self.stopped = True
            return
        part.failing = False
        part.synced = sync
        part.on_disk = part.writer.part
        part.unsaved_bytes = 0
        for each in self._topics:
            each.waiting = 0

    def _finish(self, part: _OpenPart) -> None:
        """End a part; if the disk lets it, none is open afterwards."""
        if not part.finished:
            part.describe(self._topics)
            losses = losses_record(self._topics)
            part.writer.add_metadata(LOSSES_RECORD, losses)
            part.writer.finish(custom_data(losses))
            part.finished = True
        self._save(part, sync=True)
        if part.failing:
            return
        self._leave(part)
        self._write_metadata()

    def _leave(self, part: _OpenPart) -> None:
        """Give a part up as it is on the disk."""
        if part.failing:
            self.unindexed.append(part.on_disk.name)
            for each in self._topics:
                each.lost_on_disk += each.waiting
                each.waiting = 0
        self._open = None
        self.done.append(part.on_disk)
        self._earlier_bytes += part.file.saved
        part.file.close()

    def _write_metadata(self) -> None:
        try:
            write_metadata(self.folder, self.done, custom_data(losses_record(self._topics)))
        except OSError as error:
            with suppress(OSError):
                (self.folder / ".metadata.yaml.new").unlink()
            self._tell(f"metadata.yaml cannot be written: {error.strerror}; --repair makes it")

    def _tell(self, line: str) -> None:
        """Say what has not just been said."""
        if line != self._told:
            self._told = line
            self._say(f"{self.folder}: {line}")

    def _look_at_disk(self, now_ns: int) -> None:
        if self.stopped:
            if self._space.has_room_again():
                if self._open is not None:
                    self._finish(self._open)
                if self._open is None:
                    self._resume("the disk has room again: recording goes on")
            return
        if self._space.is_used_up():
            left = f"{self._space.reserve / 1e6:.0f} MB"
            self._tell(f"the disk has less than {left} left: recording stops, messages are lost")
            self.stopped = True
            if self._open is not None:
                self._finish(self._open)
        elif warning := self._space.warning(now_ns, self.size):
            self._tell(warning)
