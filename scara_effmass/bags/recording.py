"""A recording made while messages come: nothing waits for the disk, and a crash costs what the last second brought."""

from __future__ import annotations

import shutil
import tempfile
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, final

from scara_effmass.bags.batches import Topic
from scara_effmass.bags.definitions import known_types
from scara_effmass.bags.disk_file import open_raw
from scara_effmass.bags.disk_space import DiskSpace
from scara_effmass.bags.part_series import PartSeries
from scara_effmass.bags.part_writer import definition_of
from scara_effmass.bags.recorded_topic import RecordedTopic
from scara_effmass.bags.recording_options import RecordingOptions
from scara_effmass.bags.recording_report import RecordingReport, TopicReport
from scara_effmass.bags.rosbag2 import refuse_existing
from scara_effmass.errors import OutputError

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import TracebackType

    from rosbags.typesys.store import Typestore

    from scara_effmass.bags.disk_file import OpenRaw

NS = 1_000_000_000
POLL_S = 0.05
"""How long messages may lie in the queue; the writing thread does not wake up for each of them."""
WAKE_BYTES = 1 << 20
"""As many bytes in the queue wake it earlier."""


@final
class BagRecorder:
    """A rosbag2 recording in the making, a folder of MCAP files; to be used in a `with`, or closed.

    A thread of its own writes, so `put` never waits for the disk. At any moment the files on the disk can be read
    up to the last flush. Losses are counted per topic, kept in the files, and reported.
    """

    def __init__(
        self,
        folder: Path,
        options: RecordingOptions | None = None,
        *,
        overwrite: bool = False,
        say: Callable[[str], None] = lambda _: None,
        free_space: Callable[[], int] | None = None,
        opener: OpenRaw = open_raw,
    ) -> None:
        """Begin. `say` is called with what a person should know, by the writing thread.

        `free_space` [B] and `opener` stand for the disk in tests. Raises OutputError when `folder` exists, unless
        `overwrite` allows to replace a recording, or when it cannot be made.
        """
        self.folder = folder
        self._options = options or RecordingOptions()
        self._topics: list[RecordedTopic] = []
        self._queue: list[tuple[int, int, int, bytes]] = []
        self._held_bytes = self._held_messages = 0
        self._wake = threading.Condition()
        self._closing = False
        self._failure: Exception | None = None
        if folder.suffix == ".mcap":
            raise OutputError(f"{folder}: a recording is a folder; a name without .mcap would be right")
        refuse_existing(folder, overwrite=overwrite)
        self._series = self._begin(say, free_space or (lambda: shutil.disk_usage(folder.parent).free), opener)
        self._thread = threading.Thread(target=self._run, name="recording")
        self._thread.start()

    def add_topic(self, name: str, kind: str, *, offered_qos: str = "", types: Typestore | None = None) -> int:
        """Add a topic of type `kind` such as "sensor_msgs/msg/JointState"; return its number for `put`.

        `offered_qos` is from `qos_text`; `types` (default: the known ones) must define the type.
        Raises BagError when they do not.
        """
        definition, type_hash = definition_of(types or known_types(), kind, f"{self.folder}: {name}")
        self._topics.append(RecordedTopic(Topic(name, kind, 0, type_hash, offered_qos), definition))
        return len(self._topics) - 1

    def put(self, number: int, log_time_ns: int, data: bytes) -> bool:
        """Hand over one message of the topic `number`, CDR bytes; return whether there was room for it.

        It never waits for the disk. A message that finds no room is lost, and counted.
        """
        topic = self._topics[number]
        size = len(data)
        with self._wake:
            sequence = topic.received
            topic.received += 1
            if (
                self._closing
                or self._failure is not None
                or self._held_bytes + size > self._options.queue_bytes
                or self._held_messages >= self._options.queue_messages
            ):
                topic.lost_in_queue += 1
                return False
            self._queue.append((number, log_time_ns, sequence, data))
            self._held_messages += 1
            self._held_bytes += size
            if self._held_bytes >= WAKE_BYTES:
                self._wake.notify()
        return True

    def add_lost_by_middleware(self, number: int, count: int) -> None:
        """Count messages of the topic `number` that the middleware says it has lost."""
        self._topics[number].lost_in_middleware += count

    @property
    def running(self) -> bool:
        """Whether messages are still taken."""
        return not self._closing and self._failure is None

    def report(self) -> RecordingReport:
        """Return what became of the messages so far."""
        topics = {}
        for each in list(self._topics):
            lost = each.lost
            recorded = each.received - lost.queue - lost.disk
            topics[each.topic.name] = TopicReport(each.topic.type, each.received, recorded, lost)
        series = self._series
        files = tuple(part.name for part in series.done)
        return RecordingReport(
            self.folder, topics, files, tuple(series.unindexed), series.saved, series.size, series.stopped
        )

    def close(self) -> RecordingReport:
        """Write what is left, complete the recording, and return the report; a second time only that.

        Raises OutputError when the writing thread had to give up.
        """
        with self._wake:
            self._closing = True
            self._wake.notify()
        self._thread.join()
        if self._failure is not None:
            raise OutputError(f"{self.folder}: recording broke off: {self._failure}") from self._failure
        return self.report()

    def __enter__(self) -> BagRecorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def _begin(self, say: Callable[[str], None], free_space: Callable[[], int], opener: OpenRaw) -> PartSeries:
        """Make the folder, at first under another name, so that a recording it replaces is there until it is."""
        folder, options = self.folder, self._options
        space = DiskSpace(free_space, options.reserve_bytes, options.warn_bytes, options.warn_before_s)
        try:
            folder.parent.mkdir(parents=True, exist_ok=True)
            room = not space.is_used_up()
            with tempfile.TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent) as unfinished:
                if room:
                    fresh = Path(unfinished, folder.name)
                    fresh.mkdir()
                    series = PartSeries(fresh, self._topics, options, space, opener, say)
                    if folder.exists():
                        folder.rename(Path(unfinished, "replaced"))
                    series.folder = fresh.rename(folder)
                    return series
        except OSError as error:
            raise OutputError(f"{folder}: cannot be written: {error.strerror}") from None
        reserve = f"{options.reserve_bytes / 1e6:.0f} MB"
        raise OutputError(f"{folder}: the disk has less than {reserve} left; make room for a recording")

    def _run(self) -> None:
        try:
            self._write_until_closed()
            self._series.close()
        except Exception as error:  # noqa: BLE001 - the thread has nobody else to tell
            self._failure = error
            self._series.abandon()

    def _write_until_closed(self) -> None:
        period_ns = round(self._options.flush_period_s * NS)
        due_ns = time.monotonic_ns() + period_ns
        closing = False
        while not closing:
            with self._wake:
                if not self._closing and self._held_bytes < WAKE_BYTES:
                    self._wake.wait(min(POLL_S, self._options.flush_period_s))
                closing = self._closing
                batch, self._queue = self._queue, []
            size = 0
            for number, log_time_ns, sequence, data in batch:
                self._series.write(number, log_time_ns, sequence, data)
                size += len(data)
                if time.monotonic_ns() >= due_ns:  # a long batch must not hold it up
                    self._series.flush(time.monotonic_ns())
                    due_ns = time.monotonic_ns() + period_ns
            with self._wake:
                self._held_bytes -= size
                self._held_messages -= len(batch)
            if time.monotonic_ns() >= due_ns:
                self._series.flush(time.monotonic_ns())
                due_ns = time.monotonic_ns() + period_ns
