# SPDX-License-Identifier: Apache-2.0
"""Recording: received messages are in the files, lost ones are counted, also if the disk fails."""

from __future__ import annotations

import errno
import io
import json
import os
import random
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from itertools import groupby
from pathlib import Path
from typing import IO, Any, NamedTuple

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from scara_effmass.bags.files import LOSSES_RECORD, open_bag
from scara_effmass.bags.recorder import BagRecorder, DiskSpace, LossCounts, RecorderOptions
from scara_effmass.bags.writer import CHUNK_BYTES, qos_yaml
from scara_effmass.errors import BagError, OutputError

STRING = "std_msgs/msg/String"
FLOAT64 = "std_msgs/msg/Float64"
T0 = 1_700_000_000_123_456_789
MS = 1_000_000
MB = 1_000_000
TIMEOUT_S = 120.0
FAST_FLUSH = RecorderOptions(flush_period_s=0.005)
KILL_BENCHMARK = Path(__file__).parents[1] / "endurance" / "kill_recorder.py"


class Message(NamedTuple):
    topic: str
    log_time_ns: int
    data: bytes


def text(number: int, size: int = 10) -> bytes:
    """Return the CDR of a std_msgs/String of `size` random characters."""
    content = random.Random(number).randbytes((size + 1) // 2).hex().encode() + b"\0"  # noqa: S311 - no secret
    return b"\x00\x01\x00\x00" + len(content).to_bytes(4, "little") + content


def wait_until(condition: Callable[[], Any]) -> Any:  # noqa: ANN401
    """Return the result of `condition` once it is true; another thread makes it so."""
    deadline = time.monotonic() + TIMEOUT_S
    while not (result := condition()):
        assert time.monotonic() < deadline
        threading.Event().wait(0.002)
    return result


def read(folder: Path) -> list[Message]:
    with open_bag(folder) as bag:
        return [Message(raw.topic, raw.log_time_ns, raw.data) for raw in bag.messages()]


def read_by_rosbags(folder: Path) -> list[Message]:
    with AnyReader([folder]) as reader:
        return [Message(connection.topic, time, data) for connection, time, data in reader.messages()]


def read_by_mcap(folder: Path) -> list[Message]:
    messages = []
    for path in mcap_files(folder):
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            assert reader.get_header().profile == "ros2"
            for schema, channel, message in reader.iter_messages():
                assert schema is not None
                assert schema.encoding == "ros2msg"
                messages.append(Message(channel.topic, message.log_time, message.data))
    return messages


def mcap_files(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.mcap"), key=lambda path: int(path.stem.rpartition("_")[2]))


def metadata(folder: Path) -> dict[str, Any]:
    content = yaml.safe_load((folder / "metadata.yaml").read_text(encoding="utf-8"))
    information: dict[str, Any] = content["rosbag2_bagfile_information"]
    return information


def losses_in(path: Path) -> list[dict[str, Any]]:
    """Return the records of losses in a file."""
    with path.open("rb") as file:
        records = [record for record in make_reader(file).iter_metadata() if record.name == LOSSES_RECORD]
    return [{topic: json.loads(counts) for topic, counts in record.metadata.items()} for record in records]


class FaultyFile(io.FileIO):
    """A file on a `FaultyDisk`."""

    def __init__(self, path: Path, disk: FaultyDisk) -> None:
        super().__init__(path, "xb")
        self._disk = disk

    def write(self, data: Any) -> int:  # noqa: ANN401 - as in FileIO
        self._disk.writes += 1
        if not self._disk.responds.is_set():
            self._disk.blocks.set()
            self._disk.responds.wait()
        view = memoryview(data)
        if self._disk.room < len(view) and self._disk.room <= 0:
            raise OSError(self._disk.error, "it is full")
        written = super().write(view[: self._disk.room])
        self._disk.room -= written
        return written


class FaultyDisk:
    """A disk with `room` bytes left. Writing blocks while `responds` is not set; `blocks` is set once it does."""

    def __init__(self, room: int = 1 << 40, error: int = errno.ENOSPC) -> None:
        self.room = room
        self.writes = 0
        self.error = error
        self.responds = threading.Event()
        self.responds.set()
        self.blocks = threading.Event()

    def open(self, path: Path) -> IO[bytes]:
        return FaultyFile(path, self)


class TestRecordedMessages:
    @settings(max_examples=20)
    @given(
        messages=st.lists(
            st.tuples(
                st.sampled_from(["/a", "/b"]), st.integers(T0, T0 + 1000 * MS), st.integers(0, 3000), st.booleans()
            ),
            max_size=60,
        ),
        compress=st.booleans(),
        max_file_bytes=st.sampled_from([0, 1, 5000]),
        max_file_ns=st.sampled_from([0, 1, 100 * MS]),
    )
    def test_every_reader_gives_the_recorded_bytes(
        self,
        tmp_path_factory: pytest.TempPathFactory,
        messages: list[tuple[str, int, int, bool]],
        compress: bool,  # noqa: FBT001 - from hypothesis
        max_file_bytes: int,
        max_file_ns: int,
    ) -> None:
        folder = tmp_path_factory.mktemp("recordings") / "bag"
        options = RecorderOptions(
            compress=compress,
            max_file_bytes=max_file_bytes,
            max_file_ns=max_file_ns,
            flush_period_s=0.001,
            reserve_bytes=0,
        )
        written: list[Message] = []
        with BagRecorder(folder, options) as recorder:
            numbers = {topic: recorder.add_topic(topic, STRING) for topic in ("/a", "/b")}
            for count, (topic, log_time_ns, size, pause) in enumerate(messages):
                written.append(Message(topic, log_time_ns, text(count, size)))
                assert recorder.write(numbers[topic], log_time_ns, written[-1].data)
                if pause:
                    threading.Event().wait(0.002)  # chunks and files end at different messages
        report = recorder.report()
        assert (report.recorded, report.saved, report.lost) == (len(written), len(written), 0)
        information = metadata(folder)
        assert information["message_count"] == len(written)
        assert information["relative_file_paths"] == [path.name for path in mcap_files(folder)] == list(report.files)
        assert sorted(read_by_mcap(folder)) == sorted(written)
        assert sorted(read_by_rosbags(folder)) == sorted(written)
        if written:
            messages_read = read(folder)
            assert sorted(messages_read) == sorted(written)
            assert [m.log_time_ns for m in messages_read] == sorted(m.log_time_ns for m in written)
            with open_bag(folder) as bag:
                assert bag.losses == ()

    def test_message_is_flushed_without_a_next_message(self, tmp_path: Path) -> None:
        with BagRecorder(tmp_path / "bag", FAST_FLUSH) as recorder:
            topic = recorder.add_topic("/a", STRING)
            recorder.write(topic, T0, text(1))
            wait_until(lambda: recorder.report().saved)
            assert read(tmp_path / "bag") == [Message("/a", T0, text(1))]

    def test_large_chunks_are_synced(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        synced: list[int] = []
        monkeypatch.setattr("os.fdatasync", lambda descriptor: synced.append(os.fstat(descriptor).st_size))
        path = tmp_path / "bag" / "bag_0.mcap"
        with BagRecorder(tmp_path / "bag", FAST_FLUSH) as recorder:
            topic = recorder.add_topic("/a", STRING)
            for i in range(3):
                recorder.write(topic, T0 + i, text(i, CHUNK_BYTES))
            wait_until(lambda: recorder.report().saved == 3)
            wait_until(lambda: synced[-1] == path.stat().st_size)

    def test_slow_sync_delays_no_message(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """A recorder that is killed meanwhile loses nothing that is in the file."""
        synced = threading.Event()
        with BagRecorder(tmp_path / "bag", FAST_FLUSH) as recorder:

            def sync(_: int) -> None:
                synced.wait()

            monkeypatch.setattr("os.fdatasync", sync)
            topic = recorder.add_topic("/a", STRING)
            try:
                for i in range(3):
                    recorder.write(topic, T0 + i, text(i))
                    wait_until(lambda: recorder.report().saved == i + 1)  # noqa: B023
                assert [message.data for message in read(tmp_path / "bag")] == [text(i) for i in range(3)]
            finally:
                synced.set()

    def test_metadata_describes_topics_and_qos(self, tmp_path: Path) -> None:
        infinite = {"sec": 9223372036, "nsec": 854775807}
        offered = {
            "history": "keep_last",
            "depth": 5,
            "reliability": "reliable",
            "durability": "transient_local",
            "deadline": infinite,
            "lifespan": infinite,
            "liveliness": "automatic",
            "liveliness_lease_duration": {"sec": 1, "nsec": 0},
            "avoid_ros_namespace_conventions": False,
        }
        with BagRecorder(tmp_path / "bag", FAST_FLUSH) as recorder:
            recorder.write(recorder.add_topic("/a", STRING, offered_qos=qos_yaml([offered])), T0, text(1))
            recorder.add_topic("/never", FLOAT64)
        (a, never) = metadata(tmp_path / "bag")["topics_with_message_count"]
        assert (a["message_count"], never["message_count"]) == (1, 0)
        assert never["topic_metadata"]["type"] == FLOAT64
        (qos,) = a["topic_metadata"]["offered_qos_profiles"]
        assert (qos["durability"], qos["deadline"]) == ("transient_local", infinite)
        with AnyReader([tmp_path / "bag"]) as reader:
            (read,) = (c.ext for c in reader.connections if c.topic == "/a")
        assert [qos.durability.name for qos in read.offered_qos_profiles] == ["TRANSIENT_LOCAL"]  # type: ignore[union-attr]
        # The file alone states the same.
        with AnyReader([tmp_path / "bag" / "bag_0.mcap"]) as reader:
            (read,) = (c.ext for c in reader.connections if c.topic == "/a")
        assert [qos.depth for qos in read.offered_qos_profiles] == [5]  # type: ignore[union-attr]

    def test_unknown_type_is_refused(self, tmp_path: Path) -> None:
        recorder = BagRecorder(tmp_path / "bag", FAST_FLUSH)
        with pytest.raises(BagError, match="/x: type lab_msgs/msg/Nope is not defined"):
            recorder.add_topic("/x", "lab_msgs/msg/Nope")
        recorder.close()
        assert recorder.report().topics == {}


class TestSplitting:
    def test_file_ends_by_duration(self, tmp_path: Path) -> None:
        with BagRecorder(tmp_path / "bag", RecorderOptions(max_file_ns=100 * MS)) as recorder:
            topic = recorder.add_topic("/a", STRING)
            for i in range(35):
                recorder.write(topic, T0 + i * 10 * MS, text(i))
        counts = [file["message_count"] for file in metadata(tmp_path / "bag")["files"]]
        assert counts == [10, 10, 10, 5]

    def test_file_ends_by_size_and_is_complete(self, tmp_path: Path) -> None:
        folder = tmp_path / "bag"
        with BagRecorder(folder, RecorderOptions(max_file_bytes=1, flush_period_s=0.005)) as recorder:
            topic = recorder.add_topic("/a", STRING)
            for i in range(3):
                recorder.write(topic, T0 + i, text(i))
                wait_until(lambda: len(mcap_files(folder)) == i + 2)  # noqa: B023 - called at once
                names = metadata(folder)["relative_file_paths"]
                assert names == [f"bag_{n}.mcap" for n in range(i + 1)]
                assert len(read_by_rosbags(folder)) == i + 1
                assert len(read(folder)) == i + 1
        assert len(read_by_mcap(folder)) == 3

    def test_each_file_defines_its_topics(self, tmp_path: Path) -> None:
        with BagRecorder(tmp_path / "bag", RecorderOptions(max_file_ns=1)) as recorder:
            for i, topic in enumerate(("/a", "/b", "/c")):
                recorder.write(recorder.add_topic(topic, STRING), T0 + i, text(i))
        for path in mcap_files(tmp_path / "bag"):
            with AnyReader([path]) as reader:
                assert len(list(reader.messages())) == 1


class TestQueue:
    def test_full_queue_counts_losses_without_waiting(self, tmp_path: Path) -> None:
        disk = FaultyDisk()
        options = RecorderOptions(flush_period_s=0.005, queue_messages=50, queue_bytes=10_000)
        with BagRecorder(tmp_path / "bag", options, opener=disk.open) as recorder:
            busy, idle = recorder.add_topic("/busy", STRING), recorder.add_topic("/idle", STRING)
            assert recorder.write(idle, T0, text(0))
            wait_until(lambda: recorder.report().saved)
            disk.responds.clear()
            accepted = [recorder.write(busy, T0, text(0))]
            assert disk.blocks.wait(TIMEOUT_S)
            # The disk is blocked: a write that waits for it would never return.
            accepted += [recorder.write(busy, T0 + i, text(i)) for i in range(1, 5000)]
            assert accepted.count(True) == 50
            assert not accepted[-1]
            assert not recorder.write(idle, T0, b"x" * 10_001)
            disk.responds.set()
            wait_until(lambda: recorder.write(busy, T0 + 6000, text(6000)))
        report = recorder.report()
        lost = report.topics["/busy"].lost.queue
        assert lost >= accepted.count(False) > 4000
        assert report.topics["/idle"].lost == LossCounts(queue=1)
        assert {t.received for t in report.topics.values()} == {5001 + (lost - accepted.count(False)), 2}
        kept = [Message("/busy", T0 + i, text(i)) for i, is_accepted in enumerate(accepted) if is_accepted]
        assert read(tmp_path / "bag") == [Message("/idle", T0, text(0)), *kept, Message("/busy", T0 + 6000, text(6000))]
        counts = {topic: {"queue": n, "disk": 0, "middleware": 0} for topic, n in (("/busy", lost), ("/idle", 1))}
        assert losses_in(tmp_path / "bag" / "bag_0.mcap")[-1] == counts
        assert json.loads(metadata(tmp_path / "bag")["custom_data"][LOSSES_RECORD]) == counts

    def test_loss_leaves_a_gap_in_the_sequence_numbers(self, tmp_path: Path) -> None:
        with BagRecorder(tmp_path / "bag", RecorderOptions(queue_bytes=100)) as recorder:
            topic = recorder.add_topic("/a", STRING)
            accepted = [recorder.write(topic, T0, b"x" * size) for size in (10, 101, 10)]
        assert accepted == [True, False, True]
        with (tmp_path / "bag" / "bag_0.mcap").open("rb") as file:
            assert [message.sequence for _, _, message in make_reader(file).iter_messages()] == [0, 2]

    def test_message_after_the_end_is_lost(self, tmp_path: Path) -> None:
        with BagRecorder(tmp_path / "bag", FAST_FLUSH) as recorder:
            topic = recorder.add_topic("/a", STRING)
        assert not recorder.write(topic, T0, text(0))
        assert recorder.close().topics["/a"].lost == LossCounts(queue=1)

    def test_losses_of_the_middleware_are_stored_at_once(self, tmp_path: Path) -> None:
        with BagRecorder(tmp_path / "bag", FAST_FLUSH) as recorder:
            topic = recorder.add_topic("/a", STRING)
            recorder.write(topic, T0, text(0))
            recorder.count_lost_by_middleware(topic, 3)
            wait_until(lambda: b"middleware" in (tmp_path / "bag" / "bag_0.mcap").read_bytes())
            recorder.count_lost_by_middleware(topic, 4)
        assert recorder.report().topics["/a"].lost == LossCounts(middleware=7)
        stored = [counts["/a"]["middleware"] for counts in losses_in(tmp_path / "bag" / "bag_0.mcap")]
        assert [count for count, _ in groupby(stored)] == [3, 7]  # the end may repeat the last


class TestFullDisk:
    def test_recording_stops_at_the_reserve_and_resumes_in_a_new_file(self, tmp_path: Path) -> None:
        warnings: list[str] = []
        free = [10_000 * MB]
        options = RecorderOptions(flush_period_s=0.005, reserve_bytes=100 * MB, warn_bytes=500 * MB)
        folder = tmp_path / "bag"
        with BagRecorder(folder, options, warn=warnings.append, free_space=lambda: free[0]) as recorder:
            topic = recorder.add_topic("/a", STRING)
            recorder.write(topic, T0, text(0))
            wait_until(lambda: recorder.report().saved == 1)
            free[0] = 499 * MB
            wait_until(lambda: warnings)
            assert recorder.write(topic, T0 + 1, text(1))
            wait_until(lambda: recorder.report().saved == 2)
            free[0] = 99 * MB
            wait_until((folder / "metadata.yaml").exists)
            assert recorder.report().stopped_by_disk
            assert len(read_by_rosbags(folder)) == len(read(folder)) == 2
            recorder.write(topic, T0 + 2, text(2))
            wait_until(lambda: recorder.report().lost)
            free[0] = 150 * MB  # above the reserve, below the limit for resuming
            recorder.write(topic, T0 + 3, text(3))
            wait_until(lambda: recorder.report().lost == 2)
            free[0] = 600 * MB
            wait_until(lambda: not recorder.report().stopped_by_disk)
            recorder.write(topic, T0 + 4, text(4))
        report = recorder.report()
        assert report.topics["/a"].lost == LossCounts(disk=2)
        assert report.files == ("bag_0.mcap", "bag_1.mcap")
        assert [message.data for message in read(folder)] == [text(0), text(1), text(4)]
        assert [line.partition(": ")[2] for line in warnings] == [
            "the disk has 499 MB left, of which 100 MB stay free" + warnings[0].partition("stay free")[2],
            "the disk has less than 100 MB left: recording stops, messages are lost and counted",
            "the disk has room again: recording resumes",
        ]
        assert losses_in(folder / "bag_1.mcap")[-1]["/a"]["disk"] == 2

    def test_sudden_full_disk_loses_only_messages_received_meanwhile(self, tmp_path: Path) -> None:
        warnings: list[str] = []
        disk = FaultyDisk()
        folder = tmp_path / "bag"

        def free_space() -> int:
            """Report the full disk only after the first failed write."""
            return disk.room if warnings else 1 << 40

        with BagRecorder(folder, FAST_FLUSH, warn=warnings.append, free_space=free_space, opener=disk.open) as recorder:
            topic = recorder.add_topic("/a", STRING)
            recorder.write(topic, T0, text(0))
            wait_until(lambda: recorder.report().saved == 1)
            disk.room = 20  # a torn record
            recorder.write(topic, T0 + 1, text(1, 5000))
            wait_until(lambda: recorder.report().stopped_by_disk)
            assert read(folder) == [Message("/a", T0, text(0))]
            recorder.write(topic, T0 + 2, text(2))
            wait_until(lambda: recorder.report().lost)
            disk.room = 1 << 40
            wait_until(lambda: not recorder.report().stopped_by_disk)
            recorder.write(topic, T0 + 3, text(3))
        assert [message.data for message in read(folder)] == [text(0), text(1, 5000), text(3)]
        assert sorted(read_by_rosbags(folder)) == read(folder)
        report = recorder.report()
        assert (report.topics["/a"].lost, report.unindexed) == (LossCounts(disk=1), ())
        assert warnings[0].endswith("cannot be written: it is full; messages are lost and counted")

    @pytest.mark.parametrize("room", [0, 20, 700])
    @pytest.mark.parametrize("error", [errno.ENOSPC, errno.EIO])
    def test_disk_that_stays_full_keeps_flushed_messages(self, tmp_path: Path, room: int, error: int) -> None:
        disk = FaultyDisk(error=error)
        folder = tmp_path / "bag"
        with BagRecorder(folder, FAST_FLUSH, opener=disk.open) as recorder:
            topic = recorder.add_topic("/a", STRING)
            for i in range(5):
                recorder.write(topic, T0 + i, text(i))
            wait_until(lambda: recorder.report().saved == 5)
            disk.room = room
            for i in range(5, 10):
                recorder.write(topic, T0 + i, text(i, 5000))
            wait_until(lambda: recorder.report().stopped_by_disk)
        report = recorder.report()
        assert read(folder) == [Message("/a", T0 + i, text(i)) for i in range(5)]
        assert (report.recorded, report.saved, report.topics["/a"].lost.disk) == (5, 5, 5)
        assert report.unindexed == ("bag_0.mcap",)
        assert metadata(folder)["message_count"] == 5

    def test_full_disk_is_not_tried_again_for_each_message(self, tmp_path: Path) -> None:
        disk = FaultyDisk()
        options = RecorderOptions(flush_period_s=3600.0, max_file_ns=1)
        with BagRecorder(tmp_path / "bag", options, opener=disk.open) as recorder:
            topic = recorder.add_topic("/a", STRING)
            disk.room, before = 0, disk.writes
            for i in range(200):
                recorder.write(topic, T0 + i, text(i))
        assert recorder.report().topics["/a"].lost.disk == 200
        assert disk.writes - before <= 2  # at the end of the first file, and at the end of the recording

    def test_failed_sync_is_reported(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        warnings: list[str] = []
        with BagRecorder(tmp_path / "bag", FAST_FLUSH, warn=warnings.append) as recorder:
            topic = recorder.add_topic("/a", STRING)

            def fail(_: int) -> None:
                raise OSError(errno.EIO, "it is broken")

            with monkeypatch.context() as broken:
                broken.setattr("os.fdatasync", fail)
                recorder.write(topic, T0, text(0))
                wait_until(lambda: warnings)
            wait_until(lambda: not recorder.report().stopped_by_disk)
        assert "cannot be written: it is broken" in warnings[0]
        assert read(tmp_path / "bag") == [Message("/a", T0, text(0))]

    def test_warning_depends_on_the_rate_and_repeats_at_each_halving(self) -> None:
        free = [1000 * MB]
        space = DiskSpace(lambda: free[0], reserve=100 * MB, warn_below=200 * MB, warn_before_s=60.0)
        second = 1_000_000_000
        assert space.warning(0, 0) == ""
        assert space.warning(second, 10 * MB) == ""  # 900 MB at 10 MB/s: 90 s
        warning = space.warning(2 * second, 40 * MB)  # at 20 MB/s: 45 s
        assert warning.endswith("at 20.00 MB/s recording stops in 45 s")
        assert space.warning(3 * second, 60 * MB) == ""
        free[0] = 500 * MB
        assert space.warning(4 * second, 80 * MB).startswith("the disk has 500 MB left, of which 100 MB stay free")
        # Earlier writes no longer count.
        free[0] = 900 * MB
        assert space.warning(100 * second, 80 * MB) == ""
        assert space.warning(101 * second, 81 * MB) == ""
        free[0] = 199 * MB
        assert space.warning(102 * second, 81 * MB)


class TestStarting:
    def test_existing_path_is_refused(self, tmp_path: Path) -> None:
        (tmp_path / "bag").mkdir()
        with pytest.raises(OutputError, match="bag: already exists"):
            BagRecorder(tmp_path / "bag")
        with pytest.raises(OutputError, match="is not a bag of this kind and is not replaced"):
            BagRecorder(tmp_path / "bag", overwrite=True)
        with pytest.raises(OutputError, match=r"must be a folder name without \.mcap"):
            BagRecorder(tmp_path / "bag.mcap")
        assert [path.name for path in tmp_path.iterdir()] == ["bag"]

    def test_overwrite_replaces_a_bag(self, tmp_path: Path) -> None:
        for number in range(2):
            with BagRecorder(tmp_path / "bag", RecorderOptions(max_file_ns=1), overwrite=True) as recorder:
                topic = recorder.add_topic("/a", STRING)
                for i in range(3 - 2 * number):
                    recorder.write(topic, T0 + i, text(number))
        assert read(tmp_path / "bag") == [Message("/a", T0, text(1))]
        assert [path.name for path in tmp_path.iterdir()] == ["bag"]

    def test_overwrite_replaces_an_incomplete_bag_without_other_files(self, tmp_path: Path) -> None:
        folder = tmp_path / "bag"
        for others in ([], ["notes.txt"]):
            BagRecorder(folder, overwrite=True).close()
            (folder / "metadata.yaml").unlink()
            for name in others:
                (folder / name).write_text("x")
        with pytest.raises(OutputError, match="is not a bag of this kind and is not replaced"):
            BagRecorder(folder, overwrite=True)
        assert sorted(path.name for path in folder.iterdir()) == ["bag_0.mcap", "notes.txt"]

    def test_overwriting_a_running_recording_is_refused(self, tmp_path: Path) -> None:
        with BagRecorder(tmp_path / "bag", RecorderOptions(max_file_ns=1)) as recorder:
            topic = recorder.add_topic("/a", STRING)
            recorder.write(topic, T0, text(0))
            recorder.write(topic, T0 + 1, text(1))
            with pytest.raises(OutputError, match=r"bag: is being recorded; stop the recorder first"):
                BagRecorder(tmp_path / "bag", overwrite=True)
        assert len(read(tmp_path / "bag")) == 2

    def test_full_disk_at_the_start_keeps_the_existing_bag(self, tmp_path: Path) -> None:
        BagRecorder(tmp_path / "bag").close()
        with pytest.raises(OutputError, match="bag: the disk has less than 67 MB left"):
            BagRecorder(tmp_path / "bag", overwrite=True, free_space=lambda: 66 * MB)
        with pytest.raises(OutputError, match="bag: cannot be written: it is full"):
            BagRecorder(tmp_path / "bag", overwrite=True, opener=FaultyDisk(room=5).open)
        assert sorted(path.name for path in (tmp_path / "bag").iterdir()) == ["bag_0.mcap", "metadata.yaml"]
        assert [path.name for path in tmp_path.iterdir()] == ["bag"]

    def test_unwritable_folder_is_refused(self, tmp_path: Path) -> None:
        (tmp_path / "file").write_text("x")
        with pytest.raises(OutputError, match=r"file/bag: cannot be written: "):
            BagRecorder(tmp_path / "file" / "bag")


def test_failure_of_the_writing_thread_is_reported(tmp_path: Path) -> None:
    recorder = BagRecorder(tmp_path / "bag", FAST_FLUSH)
    topic = recorder.add_topic("/a", STRING)
    recorder.write(topic, -1, text(0))  # MCAP times are unsigned
    wait_until(lambda: not recorder.is_running)
    assert not recorder.write(topic, T0, text(1))
    with pytest.raises(OutputError, match="bag: recording failed"):
        recorder.close()


@pytest.mark.live
def test_killed_recorder_keeps_flushed_messages() -> None:
    """Do ten of the runs of `test/endurance/kill_recorder.py`, which checks each."""
    process = subprocess.run(
        [sys.executable, str(KILL_BENCHMARK), "--runs", "10", "--seed", "7", "--json"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 0, process.stderr
    result = json.loads(process.stdout)
    assert result["runs"] == 10
    assert result["messages readable"] >= result["messages reported as saved"] > 0
