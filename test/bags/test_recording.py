"""Recording: received messages are in the files, lost ones are counted, and disks may fail."""

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
from itertools import groupby
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NamedTuple

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from scara_effmass.bags.disk_space import DiskSpace
from scara_effmass.bags.files import open_bag
from scara_effmass.bags.mcap_writer import CHUNK_BYTES
from scara_effmass.bags.recorder import BagRecorder, RecorderOptions
from scara_effmass.bags.recording_report import LOSSES_RECORD, LossCounts
from scara_effmass.bags.rosbag2 import qos_yaml
from scara_effmass.errors import BagError, OutputError, SettingsError

if TYPE_CHECKING:
    from collections.abc import Callable

STRING = "std_msgs/msg/String"
FLOAT64 = "std_msgs/msg/Float64"
T0 = 1_700_000_000_123_456_789
MS = 1_000_000
MB = 1_000_000
PATIENCE_S = 120.0
QUICK = RecorderOptions(flush_period_s=0.005)
BENCH = Path(__file__).parents[2] / "benchmarks" / "kill_recorder.py"


class Message(NamedTuple):
    topic: str
    log_time_ns: int
    data: bytes


def text(number: int, size: int = 10) -> bytes:
    """CDR of a std_msgs/String of that many characters, which do not compress well."""
    content = random.Random(number).randbytes((size + 1) // 2).hex().encode() + b"\0"  # noqa: S311 - no secret
    return b"\x00\x01\x00\x00" + len(content).to_bytes(4, "little") + content


def until(condition: Callable[[], Any]) -> Any:  # noqa: ANN401
    """Return what `condition` gives once it is true; another thread works on that."""
    began = time.monotonic()
    while not (result := condition()):
        assert time.monotonic() < began + PATIENCE_S, "nothing came of it"
        threading.Event().wait(0.002)
    return result


def read_bag(folder: Path) -> list[Message]:
    with open_bag(folder) as bag:
        return [Message(raw.topic, raw.log_time_ns, raw.data) for raw in bag.messages()]


def by_rosbags(folder: Path) -> list[Message]:
    with AnyReader([folder]) as reader:
        return [Message(connection.topic, time, data) for connection, time, data in reader.messages()]


def by_mcap(folder: Path) -> list[Message]:
    found = []
    for path in parts_of(folder):
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            assert reader.get_header().profile == "ros2"
            for schema, channel, message in reader.iter_messages():
                assert schema is not None
                assert schema.encoding == "ros2msg"
                found.append(Message(channel.topic, message.log_time, message.data))
    return found


def parts_of(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.mcap"), key=lambda path: int(path.stem.rpartition("_")[2]))


def metadata(folder: Path) -> dict[str, Any]:
    content = yaml.safe_load((folder / "metadata.yaml").read_text(encoding="utf-8"))
    information: dict[str, Any] = content["rosbag2_bagfile_information"]
    return information


def losses_in(path: Path) -> list[dict[str, Any]]:
    """Every record of losses in a file."""
    with path.open("rb") as file:
        records = [record for record in make_reader(file).iter_metadata() if record.name == LOSSES_RECORD]
    return [{topic: json.loads(counts) for topic, counts in record.metadata.items()} for record in records]


class FaultyFile(io.FileIO):
    """A file whose disk takes only so much, or nothing for a while."""

    def __init__(self, path: Path, disk: FaultyDisk) -> None:
        super().__init__(path, "xb")
        self._disk = disk

    def write(self, data: Any) -> int:  # noqa: ANN401 - as the base has it
        if not self._disk.free.is_set():
            self._disk.stuck.set()
            self._disk.free.wait()
        view = memoryview(data)
        if self._disk.room < len(view) and self._disk.room <= 0:
            raise OSError(self._disk.error, "it is full")
        taken = super().write(view[: self._disk.room])
        self._disk.room -= taken
        return taken


class FaultyDisk:
    """The disk under a recording; `room` is what it still takes, and it takes nothing while `free` is not set.

    `stuck` is set once somebody waits for that.
    """

    def __init__(self, room: int = 1 << 40, error: int = errno.ENOSPC) -> None:
        self.room = room
        self.error = error
        self.free = threading.Event()
        self.free.set()
        self.stuck = threading.Event()

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
    def test_comes_back_byte_by_byte_through_every_reader(
        self,
        tmp_path_factory: pytest.TempPathFactory,
        messages: list[tuple[str, int, int, bool]],
        compress: bool,  # noqa: FBT001 - drawn
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
        put: list[Message] = []
        with BagRecorder(folder, options) as recording:
            numbers = {topic: recording.add_topic(topic, STRING) for topic in ("/a", "/b")}
            for count, (topic, log_time_ns, size, pause) in enumerate(messages):
                put.append(Message(topic, log_time_ns, text(count, size)))
                assert recording.write(numbers[topic], log_time_ns, put[-1].data)
                if pause:
                    threading.Event().wait(0.002)  # lets chunks and parts end here and there
        report = recording.report()
        assert (report.recorded, report.saved, report.lost) == (len(put), len(put), 0)
        in_order = sorted(put, key=lambda message: message.log_time_ns)
        about = metadata(folder)
        assert about["message_count"] == len(put)
        assert about["relative_file_paths"] == [path.name for path in parts_of(folder)] == list(report.files)
        assert sorted(by_mcap(folder)) == sorted(put)
        assert sorted(by_rosbags(folder)) == sorted(put)
        if put:
            found = read_bag(folder)
            assert sorted(found) == sorted(put)
            assert [message.log_time_ns for message in found] == [message.log_time_ns for message in in_order]
            with open_bag(folder) as bag:
                assert bag.losses == ()

    def test_is_on_the_disk_soon_without_a_message_that_follows(self, tmp_path: Path) -> None:
        with BagRecorder(tmp_path / "bag", QUICK) as recording:
            number = recording.add_topic("/a", STRING)
            recording.write(number, T0, text(1))
            until(lambda: recording.report().saved)
            assert read_bag(tmp_path / "bag") == [Message("/a", T0, text(1))]

    def test_in_large_chunks_is_synced_as_well(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        synced: list[int] = []

        def note(descriptor: int) -> None:
            synced.append(os.fstat(descriptor).st_size)

        monkeypatch.setattr("os.fdatasync", note)
        path = tmp_path / "bag" / "bag_0.mcap"
        with BagRecorder(tmp_path / "bag", QUICK) as recording:
            number = recording.add_topic("/a", STRING)
            for i in range(3):
                recording.write(number, T0 + i, text(i, CHUNK_BYTES))
            until(lambda: recording.report().saved == 3)
            until(lambda: synced[-1] == path.stat().st_size)

    def test_is_described_as_rosbag2_does(self, tmp_path: Path) -> None:
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
        with BagRecorder(tmp_path / "bag", QUICK) as recording:
            recording.write(recording.add_topic("/a", STRING, offered_qos=qos_yaml([offered])), T0, text(1))
            recording.add_topic("/never", FLOAT64)
        (a, never) = metadata(tmp_path / "bag")["topics_with_message_count"]
        assert (a["message_count"], never["message_count"]) == (1, 0)
        assert never["topic_metadata"]["type"] == FLOAT64
        (qos,) = a["topic_metadata"]["offered_qos_profiles"]
        assert (qos["durability"], qos["deadline"]) == ("transient_local", infinite)
        with AnyReader([tmp_path / "bag"]) as reader:
            (read,) = (c.ext for c in reader.connections if c.topic == "/a")
        assert [qos.durability.name for qos in read.offered_qos_profiles] == ["TRANSIENT_LOCAL"]  # type: ignore[union-attr]
        # and in the file itself, for whoever has nothing but that
        with AnyReader([tmp_path / "bag" / "bag_0.mcap"]) as reader:
            (read,) = (c.ext for c in reader.connections if c.topic == "/a")
        assert [qos.depth for qos in read.offered_qos_profiles] == [5]  # type: ignore[union-attr]

    def test_of_an_unknown_type_is_refused_by_name(self, tmp_path: Path) -> None:
        recording = BagRecorder(tmp_path / "bag", QUICK)
        with pytest.raises(BagError, match="/x: type lab_msgs/msg/Nope is not defined"):
            recording.add_topic("/x", "lab_msgs/msg/Nope")
        recording.close()
        assert recording.report().topics == {}


class TestSplits:
    def test_end_by_time(self, tmp_path: Path) -> None:
        with BagRecorder(tmp_path / "bag", RecorderOptions(max_file_ns=100 * MS)) as recording:
            number = recording.add_topic("/a", STRING)
            for i in range(35):
                recording.write(number, T0 + i * 10 * MS, text(i))
        counts = [file["message_count"] for file in metadata(tmp_path / "bag")["files"]]
        assert counts == [10, 10, 10, 5]

    def test_end_by_size_and_are_complete_then(self, tmp_path: Path) -> None:
        folder = tmp_path / "bag"
        with BagRecorder(folder, RecorderOptions(max_file_bytes=1, flush_period_s=0.005)) as recording:
            number = recording.add_topic("/a", STRING)
            for i in range(3):
                recording.write(number, T0 + i, text(i))
                until(lambda: len(parts_of(folder)) == i + 2)  # noqa: B023 - called here and now
                names = metadata(folder)["relative_file_paths"]
                assert names == [f"bag_{n}.mcap" for n in range(i + 1)]
                assert len(by_rosbags(folder)) == i + 1
                assert len(read_bag(folder)) == i + 1
        assert len(by_mcap(folder)) == 3

    def test_each_describes_its_topics(self, tmp_path: Path) -> None:
        with BagRecorder(tmp_path / "bag", RecorderOptions(max_file_ns=1)) as recording:
            for i, topic in enumerate(("/a", "/b", "/c")):
                recording.write(recording.add_topic(topic, STRING), T0 + i, text(i))
        for path in parts_of(tmp_path / "bag"):
            with AnyReader([path]) as reader:
                assert len(list(reader.messages())) == 1


class TestQueue:
    def test_that_is_full_loses_and_counts_without_waiting(self, tmp_path: Path) -> None:
        disk = FaultyDisk()
        options = RecorderOptions(flush_period_s=0.005, queue_messages=50, queue_bytes=10_000)
        with BagRecorder(tmp_path / "bag", options, opener=disk.open) as recording:
            busy, idle = recording.add_topic("/busy", STRING), recording.add_topic("/idle", STRING)
            assert recording.write(idle, T0, text(0))
            until(lambda: recording.report().saved)
            disk.free.clear()
            taken = [recording.write(busy, T0, text(0))]
            assert disk.stuck.wait(PATIENCE_S)
            # If this waited for the disk, it would wait for ever.
            taken += [recording.write(busy, T0 + i, text(i)) for i in range(1, 5000)]
            assert taken.count(True) == 50
            assert not taken[-1]
            assert not recording.write(idle, T0, b"x" * 10_001)
            disk.free.set()
            until(lambda: recording.write(busy, T0 + 6000, text(6000)))
        report = recording.report()
        lost = report.topics["/busy"].lost.queue
        assert lost >= taken.count(False) > 4000
        assert report.topics["/idle"].lost == LossCounts(queue=1)
        assert {t.received for t in report.topics.values()} == {5001 + (lost - taken.count(False)), 2}
        found = read_bag(tmp_path / "bag")
        kept = [Message("/busy", T0 + i, text(i)) for i, was_taken in enumerate(taken) if was_taken]
        assert found == [Message("/idle", T0, text(0)), *kept, Message("/busy", T0 + 6000, text(6000))]
        counts = {topic: {"queue": n, "disk": 0, "middleware": 0} for topic, n in (("/busy", lost), ("/idle", 1))}
        assert losses_in(tmp_path / "bag" / "bag_0.mcap")[-1] == counts
        assert json.loads(metadata(tmp_path / "bag")["custom_data"][LOSSES_RECORD]) == counts

    def test_leaves_a_hole_in_the_sequence_numbers(self, tmp_path: Path) -> None:
        with BagRecorder(tmp_path / "bag", RecorderOptions(queue_bytes=100)) as recording:
            number = recording.add_topic("/a", STRING)
            taken = [recording.write(number, T0, b"x" * size) for size in (10, 101, 10)]
        assert taken == [True, False, True]
        with (tmp_path / "bag" / "bag_0.mcap").open("rb") as file:
            assert [message.sequence for _, _, message in make_reader(file).iter_messages()] == [0, 2]

    def test_takes_nothing_after_the_end(self, tmp_path: Path) -> None:
        with BagRecorder(tmp_path / "bag", QUICK) as recording:
            number = recording.add_topic("/a", STRING)
        assert not recording.write(number, T0, text(0))
        assert recording.close().topics["/a"].lost == LossCounts(queue=1)

    def test_what_the_middleware_lost_is_kept_in_the_file_before_the_end(self, tmp_path: Path) -> None:
        with BagRecorder(tmp_path / "bag", QUICK) as recording:
            number = recording.add_topic("/a", STRING)
            recording.write(number, T0, text(0))
            recording.count_lost_by_middleware(number, 3)
            until(lambda: b"middleware" in (tmp_path / "bag" / "bag_0.mcap").read_bytes())
            recording.count_lost_by_middleware(number, 4)
        assert recording.report().topics["/a"].lost == LossCounts(middleware=7)
        told = [counts["/a"]["middleware"] for counts in losses_in(tmp_path / "bag" / "bag_0.mcap")]
        assert [count for count, _ in groupby(told)] == [3, 7]  # the last also at the end, if it was told before


class TestFullDisk:
    def test_stops_at_the_reserve_and_goes_on_in_a_new_part(self, tmp_path: Path) -> None:
        warnings: list[str] = []
        free = [10_000 * MB]
        options = RecorderOptions(flush_period_s=0.005, reserve_bytes=100 * MB, warn_bytes=500 * MB)
        folder = tmp_path / "bag"
        with BagRecorder(folder, options, warn=warnings.append, free_space=lambda: free[0]) as recording:
            number = recording.add_topic("/a", STRING)
            recording.write(number, T0, text(0))
            until(lambda: recording.report().saved == 1)
            free[0] = 499 * MB
            until(lambda: warnings)
            assert recording.write(number, T0 + 1, text(1))
            until(lambda: recording.report().saved == 2)
            free[0] = 99 * MB
            until((folder / "metadata.yaml").exists)
            assert recording.report().stopped_by_disk
            assert len(by_rosbags(folder)) == len(read_bag(folder)) == 2
            recording.write(number, T0 + 2, text(2))
            until(lambda: recording.report().lost)
            free[0] = 150 * MB  # more than the reserve, but not enough to begin again
            recording.write(number, T0 + 3, text(3))
            until(lambda: recording.report().lost == 2)
            free[0] = 600 * MB
            until(lambda: not recording.report().stopped_by_disk)
            recording.write(number, T0 + 4, text(4))
        report = recording.report()
        assert report.topics["/a"].lost == LossCounts(disk=2)
        assert report.files == ("bag_0.mcap", "bag_1.mcap")
        assert [message.data for message in read_bag(folder)] == [text(0), text(1), text(4)]
        assert [line.partition(": ")[2] for line in warnings] == [
            "the disk has 499 MB left, of which 100 MB stay free" + warnings[0].partition("stay free")[2],
            "the disk has less than 100 MB left: recording stops, messages are lost and counted",
            "the disk has room again: recording resumes",
        ]
        assert losses_in(folder / "bag_1.mcap")[-1]["/a"]["disk"] == 2

    def test_without_a_word_beforehand_costs_what_comes_meanwhile_only(self, tmp_path: Path) -> None:
        warnings: list[str] = []
        disk = FaultyDisk()
        folder = tmp_path / "bag"

        def free_space() -> int:
            """Say nothing of it before it is known."""
            return disk.room if warnings else 1 << 40

        with BagRecorder(folder, QUICK, warn=warnings.append, free_space=free_space, opener=disk.open) as recording:
            number = recording.add_topic("/a", STRING)
            recording.write(number, T0, text(0))
            until(lambda: recording.report().saved == 1)
            disk.room = 20  # a torn record
            recording.write(number, T0 + 1, text(1, 5000))
            until(lambda: recording.report().stopped_by_disk)
            assert read_bag(folder) == [Message("/a", T0, text(0))]
            recording.write(number, T0 + 2, text(2))
            until(lambda: recording.report().lost)
            disk.room = 1 << 40
            until(lambda: not recording.report().stopped_by_disk)
            recording.write(number, T0 + 3, text(3))
        assert [message.data for message in read_bag(folder)] == [text(0), text(1, 5000), text(3)]
        assert sorted(by_rosbags(folder)) == read_bag(folder)
        report = recording.report()
        assert (report.topics["/a"].lost, report.unindexed) == (LossCounts(disk=1), ())
        assert warnings[0].endswith("cannot be written: it is full; messages are lost and counted")

    @pytest.mark.parametrize("room", [0, 20, 700])
    @pytest.mark.parametrize("error", [errno.ENOSPC, errno.EIO])
    def test_for_good_leaves_what_was_flushed(self, tmp_path: Path, room: int, error: int) -> None:
        disk = FaultyDisk(error=error)
        folder = tmp_path / "bag"
        with BagRecorder(folder, QUICK, opener=disk.open) as recording:
            number = recording.add_topic("/a", STRING)
            for i in range(5):
                recording.write(number, T0 + i, text(i))
            until(lambda: recording.report().saved == 5)
            disk.room = room
            for i in range(5, 10):
                recording.write(number, T0 + i, text(i, 5000))
            until(lambda: recording.report().stopped_by_disk)
        report = recording.report()
        assert read_bag(folder) == [Message("/a", T0 + i, text(i)) for i in range(5)]
        assert (report.recorded, report.saved, report.topics["/a"].lost.disk) == (5, 5, 5)
        assert report.unindexed == ("bag_0.mcap",)
        assert metadata(folder)["message_count"] == 5

    def test_that_cannot_sync_is_said(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        warnings: list[str] = []
        with BagRecorder(tmp_path / "bag", QUICK, warn=warnings.append) as recording:
            number = recording.add_topic("/a", STRING)

            def fail(_: int) -> None:
                raise OSError(errno.EIO, "it is broken")

            with monkeypatch.context() as broken:
                broken.setattr("os.fdatasync", fail)
                recording.write(number, T0, text(0))
                until(lambda: warnings)
            until(lambda: not recording.report().stopped_by_disk)
        assert "cannot be written: it is broken" in warnings[0]
        assert read_bag(tmp_path / "bag") == [Message("/a", T0, text(0))]

    def test_warns_by_the_rate_and_again_at_every_halving(self) -> None:
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
        # what was written long ago does not count any more
        free[0] = 900 * MB
        assert space.warning(100 * second, 80 * MB) == ""
        assert space.warning(101 * second, 81 * MB) == ""
        free[0] = 199 * MB
        assert space.warning(102 * second, 81 * MB)


class TestStart:
    def test_over_something_else_is_refused(self, tmp_path: Path) -> None:
        (tmp_path / "bag").mkdir()
        with pytest.raises(OutputError, match="bag: already exists"):
            BagRecorder(tmp_path / "bag")
        with pytest.raises(OutputError, match="is not such a bag and is not replaced"):
            BagRecorder(tmp_path / "bag", overwrite=True)
        with pytest.raises(OutputError, match=r"must be a folder name without \.mcap"):
            BagRecorder(tmp_path / "bag.mcap")
        assert [path.name for path in tmp_path.iterdir()] == ["bag"]

    def test_over_a_recording_replaces_it_when_asked(self, tmp_path: Path) -> None:
        for number in range(2):
            with BagRecorder(tmp_path / "bag", RecorderOptions(max_file_ns=1), overwrite=True) as recording:
                topic = recording.add_topic("/a", STRING)
                for i in range(3 - 2 * number):
                    recording.write(topic, T0 + i, text(number))
        assert read_bag(tmp_path / "bag") == [Message("/a", T0, text(1))]
        assert [path.name for path in tmp_path.iterdir()] == ["bag"]

    def test_over_what_a_killed_recorder_left_replaces_it_unless_there_is_more(self, tmp_path: Path) -> None:
        folder = tmp_path / "bag"
        for others in ([], ["notes.txt"]):
            BagRecorder(folder, overwrite=True).close()
            (folder / "metadata.yaml").unlink()
            for name in others:
                (folder / name).write_text("x")
        with pytest.raises(OutputError, match="is not such a bag and is not replaced"):
            BagRecorder(folder, overwrite=True)
        assert sorted(path.name for path in folder.iterdir()) == ["bag_0.mcap", "notes.txt"]

    def test_over_one_that_is_being_made_is_refused(self, tmp_path: Path) -> None:
        with BagRecorder(tmp_path / "bag", RecorderOptions(max_file_ns=1)) as recording:
            topic = recording.add_topic("/a", STRING)
            recording.write(topic, T0, text(0))
            recording.write(topic, T0 + 1, text(1))
            with pytest.raises(OutputError, match=r"bag: is being recorded; stop the recorder first"):
                BagRecorder(tmp_path / "bag", overwrite=True)
        assert len(read_bag(tmp_path / "bag")) == 2

    def test_without_room_is_refused_and_leaves_what_is_there(self, tmp_path: Path) -> None:
        BagRecorder(tmp_path / "bag").close()
        with pytest.raises(OutputError, match="bag: the disk has less than 67 MB left"):
            BagRecorder(tmp_path / "bag", overwrite=True, free_space=lambda: 66 * MB)
        with pytest.raises(OutputError, match="bag: cannot be written: it is full"):
            BagRecorder(tmp_path / "bag", overwrite=True, opener=FaultyDisk(room=5).open)
        assert sorted(path.name for path in (tmp_path / "bag").iterdir()) == ["bag_0.mcap", "metadata.yaml"]
        assert [path.name for path in tmp_path.iterdir()] == ["bag"]

    def test_where_nothing_can_be_written_is_refused(self, tmp_path: Path) -> None:
        (tmp_path / "file").write_text("x")
        with pytest.raises(OutputError, match=r"file/bag: cannot be written: "):
            BagRecorder(tmp_path / "file" / "bag")

    @pytest.mark.parametrize(
        ("key", "value"), [("max_file_bytes", -1), ("flush_period_s", 0.0), ("queue_bytes", 0), ("warn_before_s", -1.0)]
    )
    def test_with_a_wrong_option_is_refused(self, key: str, value: float) -> None:
        with pytest.raises(SettingsError, match=f"record: {key} = {value}: must be >= "):
            RecorderOptions(**{key: value})  # type: ignore[arg-type]


def test_failure_of_the_writing_thread_is_reported(tmp_path: Path) -> None:
    recording = BagRecorder(tmp_path / "bag", QUICK)
    number = recording.add_topic("/a", STRING)
    recording.write(number, -1, text(0))  # no time that the format knows
    until(lambda: not recording.is_running)
    assert not recording.write(number, T0, text(1))
    with pytest.raises(OutputError, match="bag: recording failed"):
        recording.close()


@pytest.mark.live
def test_killed_recorder_keeps_flushed_messages() -> None:
    """The first runs of what `benchmarks/kill_recorder.py` does a hundred times, which checks every one of them."""
    done = subprocess.run(
        [sys.executable, str(BENCH), "--runs", "10", "--seed", "7", "--json"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["runs"] == 10
    assert result["messages readable"] >= result["messages reported as saved"] > 0
