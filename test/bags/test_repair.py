# SPDX-License-Identifier: Apache-2.0
"""Repair: incomplete bags get an index, and no bag is made worse."""

import json
import os
import shutil
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader

from scara_effmass.bags.files import LOSSES_RECORD, open_bag
from scara_effmass.bags.recorder import BagRecorder, RecorderOptions
from scara_effmass.bags.repair import RepairReport, repair
from scara_effmass.errors import BagError, OutputError
from test.bags.messages import Message, write_mcap

STRING = "std_msgs/msg/String"
FLOAT64 = "std_msgs/msg/Float64"
T0 = 1_700_000_000_123_456_789
DEFINITIONS = {STRING: "string data\n", FLOAT64: "float64 data\n"}


def text(number: int) -> bytes:
    content = str(number).encode() * (1 + number % 7) + b"\0"
    return b"\x00\x01\x00\x00" + struct.pack("<I", len(content)) + content


MESSAGES = [
    Message("/text", STRING, T0 + i, text(i), T0 + i - 5, i)
    if i % 3
    else Message("/number", FLOAT64, T0 + i, b"\x00\x01\x00\x00" + struct.pack("<d", i), T0 + i - 9, 7 * i)
    for i in range(200)
]


def write(path: Path, **options: Any) -> Path:  # noqa: ANN401 - of write_mcap
    """Write the messages, and an attachment and metadata, which `BagRecorder` never writes."""

    def add_records(writer: Writer) -> None:
        writer.add_attachment(T0, T0 + 1, "photo", "image/png", b"pixels")
        writer.add_metadata("cell", {"operator": "Ada"})

    options = {"chunk_size": 600, "library": "somebody else", "definitions": DEFINITIONS, **options}
    return write_mcap(path, MESSAGES, channel_metadata={"mine": "yes"}, add_records=add_records, **options)


def indexed(path: Path) -> list[Message]:
    """Read by the index with `mcap`, which checks the checksums."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        messages = [
            Message(channel.topic, schema.name, message.log_time, message.data, message.publish_time, message.sequence)
            for schema, channel, message in reader.iter_messages()
            if schema is not None
        ]
        assert summary.statistics.message_count == len(messages)
    return messages


def readable(path: Path) -> Sequence[tuple[str, str, int, bytes]]:
    """Read without a repair; empty if nothing is readable."""
    try:
        with open_bag(path) as bag:
            return list(bag.messages())
    except BagError:
        return []


def recorded(folder: Path, files: int = 3) -> Path:
    """Record a complete bag of `files` files of four messages."""
    with BagRecorder(folder, RecorderOptions(max_file_ns=4, reserve_bytes=0)) as recording:
        number = recording.add_topic("/text", STRING)
        for i in range(4 * files):
            recording.write(number, T0 + i, text(i))
    return folder


def cut(path: Path, bytes_left: int) -> Path:
    os.truncate(path, bytes_left)
    return path


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def about(folder: Path) -> dict[str, Any]:
    information: dict[str, Any] = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    return information


COMPRESSIONS = list(CompressionType)


class TestFile:
    @pytest.mark.parametrize("compression", COMPRESSIONS)
    def test_that_is_complete_is_left_alone(self, tmp_path: Path, compression: CompressionType) -> None:
        path = write(tmp_path / "a.mcap", compression=compression)
        before = path.read_bytes(), path.stat()
        report = repair(path)
        assert report.intact
        assert report.files[0].messages == len(MESSAGES)
        assert (path.read_bytes(), path.stat()) == before
        assert names(tmp_path) == ["a.mcap"]

    @settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
    @given(data=st.data(), compression=st.sampled_from(COMPRESSIONS), chunked=st.booleans())
    def test_that_is_cut_anywhere_keeps_all_that_can_be_read(
        self, tmp_path: Path, data: st.DataObject, compression: CompressionType, *, chunked: bool
    ) -> None:
        path = write(tmp_path / "a.mcap", compression=compression, chunked=chunked)
        whole = path.stat().st_size
        left = data.draw(st.integers(60, whole - 1))
        before = readable(cut(path, left))
        report = repair(path)
        assert not report.intact
        after = indexed(path)
        assert [message[:4] for message in after] == before
        assert after == MESSAGES[: len(after)]
        assert report.files[0].messages == len(after)
        assert report.files[0].kept_original is None
        assert repair(path).intact
        if after:
            with AnyReader([path]) as reader:
                assert len(list(reader.messages())) == len(after)
        assert names(tmp_path) == ["a.mcap"]

    def test_loses_damaged_metadata_and_says_so(self, tmp_path: Path) -> None:
        folder = recorded(tmp_path / "bag", files=1)
        path = folder / "bag_0.mcap"
        whole = path.read_bytes()
        path.write_bytes(whole.replace(b"relative_file_paths", b"\x90elative_file_paths", 1))
        (folder / "metadata.yaml").unlink()
        (file,) = repair(folder).files
        assert file.lost == (f"{path}: a damaged record is lost",)
        assert (file.messages, file.kept_original) == (4, folder / "bag_0.mcap.damaged")
        assert repair(folder).intact

    def test_keeps_what_is_not_a_message_too(self, tmp_path: Path) -> None:
        path = write(tmp_path / "a.mcap")
        repair(cut(path, path.stat().st_size - 40))
        with path.open("rb") as file:
            reader = make_reader(file)
            header = reader.get_header()
            assert (header.profile, header.library) == ("ros2", "somebody else")
            (attachment,) = reader.iter_attachments()
            assert (attachment.name, attachment.data, attachment.create_time) == ("photo", b"pixels", T0)
            (metadata,) = reader.iter_metadata()
            assert (metadata.name, metadata.metadata) == ("cell", {"operator": "Ada"})
            summary = reader.get_summary()
        assert summary is not None
        assert {channel.topic: channel.metadata for channel in summary.channels.values()} == {
            "/text": {"mine": "yes"},
            "/number": {"mine": "yes"},
        }
        assert {schema.name: schema.data.decode() for schema in summary.schemas.values()} == DEFINITIONS
        assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}

    def test_without_an_index_gets_one(self, tmp_path: Path) -> None:
        path = write(tmp_path / "a.mcap", statistics=False)
        assert not repair(path).intact
        assert indexed(path) == MESSAGES

    def test_with_a_damaged_chunk_loses_that_alone_and_keeps_the_original(self, tmp_path: Path) -> None:
        path = write(tmp_path / "a.mcap")
        with path.open("rb") as file:
            summary = make_reader(file).get_summary()
        assert summary is not None
        chunk = summary.chunk_indexes[2]
        content = bytearray(path.read_bytes())
        content[chunk.chunk_start_offset + chunk.chunk_length - 20] ^= 0xFF
        path.write_bytes(content)
        (file_report,) = repair(path).files
        assert any(f"chunk at byte {chunk.chunk_start_offset + 9} is lost" in line for line in file_report.lost)
        gone = range(chunk.message_start_time - T0, chunk.message_end_time - T0 + 1)
        assert indexed(path) == [message for i, message in enumerate(MESSAGES) if i not in gone]
        assert file_report.kept_original == tmp_path / "a.mcap.damaged"
        assert (tmp_path / "a.mcap.damaged").read_bytes() == content
        assert repair(path).intact

        path.write_bytes(content)  # damaged again, but the place of the original is taken
        with pytest.raises(OutputError, match=r"a\.mcap\.damaged: already exists; move it away first"):
            repair(path)
        assert path.read_bytes() == content
        assert names(tmp_path) == ["a.mcap", "a.mcap.damaged"]

    def test_that_turns_into_zeros_is_kept_up_to_there(self, tmp_path: Path) -> None:
        path = write(tmp_path / "a.mcap")
        size = path.stat().st_size
        with path.open("r+b") as file:  # as after a power cut, where the size was written and the content was not
            file.seek(size // 2)
            file.write(bytes(size - size // 2))
        before = readable(path)
        (file_report,) = repair(path).files
        after = indexed(path)
        assert 0 < len(after) < len(MESSAGES)
        assert [message[:4] for message in after] == before
        assert file_report.lost
        assert file_report.kept_original is not None

    @pytest.mark.parametrize("step", ["os.fsync", "mcap.writer.Writer.finish"])
    def test_stays_as_it_is_when_the_repair_fails(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
    ) -> None:
        path = write(tmp_path / "a.mcap")
        before = cut(path, path.stat().st_size // 2).read_bytes()

        def fail(*_: object) -> None:
            raise OSError(28, "it is full")

        monkeypatch.setattr(step, fail)
        with pytest.raises(OutputError, match=r"a\.mcap: cannot be repaired: it is full"):
            repair(path)
        assert path.read_bytes() == before
        assert names(tmp_path) == ["a.mcap"]

    def test_that_is_none_is_refused_by_name(self, tmp_path: Path) -> None:
        (tmp_path / "a.mcap").write_text("hello, I am a text")
        with pytest.raises(BagError, match=r"a\.mcap: is not an MCAP file"):
            repair(tmp_path / "a.mcap")
        (tmp_path / "a.mcap").write_bytes(b"")
        with pytest.raises(BagError, match=r"a\.mcap: is empty"):
            repair(tmp_path / "a.mcap")
        with pytest.raises(BagError, match=r"b\.mcap: does not exist"):
            repair(tmp_path / "b.mcap")
        assert names(tmp_path) == ["a.mcap"]


class TestFolder:
    def test_that_is_complete_is_left_alone(self, tmp_path: Path) -> None:
        folder = recorded(tmp_path / "bag")
        before = {path: (path.read_bytes(), path.stat()) for path in folder.iterdir()}
        report = repair(folder)
        assert report == RepairReport(report.files, (), metadata_rewritten=False)
        assert report.intact
        assert {path: (path.read_bytes(), path.stat()) for path in folder.iterdir()} == before

    @pytest.mark.parametrize("by_file", [False, True], ids=["folder", "file"])
    def test_that_was_killed_in_its_last_part_is_completed(self, tmp_path: Path, *, by_file: bool) -> None:
        folder = recorded(tmp_path / "bag")
        whole = readable(folder)
        last = folder / "bag_2.mcap"
        information = about(folder)
        information["relative_file_paths"].pop()
        information["custom_data"] = {"cell": "7"}
        (folder / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": information}))
        with last.open("rb") as file:
            summary = make_reader(file).get_summary()
        assert summary is not None
        (chunk,) = summary.chunk_indexes
        cut(last, chunk.chunk_start_offset + chunk.chunk_length + 5)
        assert readable(folder) == whole
        report = repair(last if by_file else folder)
        assert [(file.path.name, file.intact, file.messages) for file in report.files] == [
            ("bag_0.mcap", True, 4),
            ("bag_1.mcap", True, 4),
            ("bag_2.mcap", False, 4),
        ]
        assert report.metadata_rewritten
        assert about(folder)["message_count"] == 12
        assert about(folder)["relative_file_paths"] == ["bag_0.mcap", "bag_1.mcap", "bag_2.mcap"]
        assert about(folder)["custom_data"]["cell"] == "7"
        with AnyReader([folder]) as reader:
            assert [(c.topic, c.msgtype, t, data) for c, t, data in reader.messages()] == whole
        assert repair(folder).intact
        assert names(folder) == ["bag_0.mcap", "bag_1.mcap", "bag_2.mcap", "metadata.yaml"]

    @pytest.mark.parametrize("content", [None, "", "[", "rosbag2_bagfile_information: 3", "a: 1"])
    def test_without_good_metadata_gets_them_as_they_were(self, tmp_path: Path, content: str | None) -> None:
        folder = recorded(tmp_path / "bag")
        right = about(folder)
        if content is None:
            (folder / "metadata.yaml").unlink()
        else:
            (folder / "metadata.yaml").write_text(content)
        report = repair(folder)
        assert all(file.intact for file in report.files)
        assert report.metadata_rewritten
        assert about(folder) == right

    def test_keeps_what_its_recorder_said_it_had_lost(self, tmp_path: Path) -> None:
        folder = tmp_path / "bag"
        with BagRecorder(folder, RecorderOptions(queue_bytes=20, reserve_bytes=0)) as recording:
            number = recording.add_topic("/text", STRING)
            recording.write(number, T0, text(1))
            recording.write(number, T0, b"x" * 30)
            recording.count_lost_by_middleware(number, 2)
        (folder / "metadata.yaml").unlink()
        cut(folder / "bag_0.mcap", (folder / "bag_0.mcap").stat().st_size - 1)
        repair(folder)
        warnings = json.loads(about(folder)["custom_data"][LOSSES_RECORD])
        assert warnings == {"/text": {"queue": 1, "disk": 0, "middleware": 2}}
        with open_bag(folder) as bag:
            assert f"{folder}/metadata.yaml: /text: 3 messages were lost in recording" in bag.losses

    @pytest.mark.parametrize("size", [8, 20, 36])
    def test_with_a_file_that_is_cut_in_its_header_is_completed(self, tmp_path: Path, size: int) -> None:
        folder = recorded(tmp_path / "bag")
        cut(folder / "bag_2.mcap", size)
        report = repair(folder)
        assert [(file.intact, file.messages) for file in report.files] == [(True, 4), (True, 4), (False, 0)]
        assert about(folder)["message_count"] == 8
        assert repair(folder).intact

    def test_with_a_file_that_is_none_completes_the_others(self, tmp_path: Path) -> None:
        folder = recorded(tmp_path / "bag")
        (folder / "bag_2.mcap").write_bytes(b"")
        report = repair(folder)
        assert [line.partition(": ")[2][:8] for line in report.failed] == ["is empty"]
        assert not report.intact
        assert about(folder)["relative_file_paths"] == ["bag_0.mcap", "bag_1.mcap"]

    @pytest.mark.parametrize(("number", "has_metadata"), [(0, True), (0, False), (1, True), (1, False), (2, True)])
    def test_without_one_of_its_files_says_so_ever_after(
        self, tmp_path: Path, number: int, *, has_metadata: bool
    ) -> None:
        folder = recorded(tmp_path / "bag")
        (folder / f"bag_{number}.mcap").unlink()
        if not has_metadata:
            (folder / "metadata.yaml").unlink()
        problem = f"bag_{number}.mcap, which does not exist" if has_metadata else "before number 2 that do not exist: 1"
        for _ in range(2):
            report = repair(folder)
            with open_bag(folder) as bag:
                assert any(line.endswith(problem) for line in bag.losses)
            assert not report.intact or number == 2  # then nothing shows it but what the first repair has noted

    def test_with_a_torn_file_says_ever_after_what_is_lost(self, tmp_path: Path) -> None:
        folder = recorded(tmp_path / "bag")
        cut(folder / "bag_1.mcap", 400)
        (line,) = repair(folder).files[1].lost
        assert repair(folder).intact
        with open_bag(folder) as bag:
            assert bag.losses == (f"{folder}/metadata.yaml: {line.removeprefix(f'{folder}/')}",)

    def test_of_another_format_is_refused(self, tmp_path: Path) -> None:
        (tmp_path / "bag").mkdir()
        (tmp_path / "bag" / "bag_0.db3").write_bytes(b"SQLite format 3\0")
        with pytest.raises(BagError, match=r"bag: contains no \.mcap file; only MCAP bags can be repaired"):
            repair(tmp_path / "bag")

    def test_that_is_being_recorded_is_refused(self, tmp_path: Path) -> None:
        folder = tmp_path / "bag"
        with BagRecorder(folder, RecorderOptions(reserve_bytes=0)) as recording:
            with pytest.raises(OutputError, match=r"bag_0\.mcap: is being recorded; stop the recorder first"):
                repair(folder)
            recording.write(recording.add_topic("/text", STRING), T0, text(1))
        assert repair(folder).intact


def test_a_folder_with_compressed_files_beside_the_last_one_is_left_alone(tmp_path: Path) -> None:
    folder = recorded(tmp_path / "bag", files=2)
    (folder / "metadata.yaml").unlink()
    first, last = folder / "bag_0.mcap", folder / "bag_1.mcap"
    first = first.rename(f"{first}.zstd")
    cut(last, 600)
    with pytest.raises(BagError, match=f"^{first}: must be decompressed or moved away first, as "):
        repair(folder)
    assert names(folder) == ["bag_0.mcap.zstd", "bag_1.mcap"]
    assert last.stat().st_size == 600


def test_a_pipe_is_refused_and_does_not_block(tmp_path: Path) -> None:
    pipe = tmp_path / "run_0.mcap"
    os.mkfifo(pipe)
    with pytest.raises(BagError, match="is a device or a pipe"):
        repair(pipe)


def test_a_folder_of_several_bags_is_not_joined_to_one(tmp_path: Path) -> None:
    for name in ("monday.mcap", "tuesday.mcap"):
        write(tmp_path / name)
    with pytest.raises(BagError, match=r"contains 2 bags: must be one of them \(monday.mcap, ...\)"):
        repair(tmp_path)
    assert names(tmp_path) == ["monday.mcap", "tuesday.mcap"]


@pytest.mark.parametrize("make", [Path.mkdir, os.mkfifo])
def test_metadata_that_are_no_file_are_read_over_and_not_repaired(
    tmp_path: Path, make: Callable[[Path], object]
) -> None:
    folder = recorded(tmp_path / "bag")
    (folder / "metadata.yaml").unlink()
    make(folder / "metadata.yaml")
    before = names(folder)
    with open_bag(folder) as bag:
        assert f"{folder / 'metadata.yaml'}: does not describe a bag; read without it" in bag.losses
    with pytest.raises(BagError, match=r"metadata.yaml: cannot be read: must be a regular file"):
        repair(folder)
    assert names(folder) == before


def test_a_file_elsewhere_is_repaired_by_itself(tmp_path: Path) -> None:
    folder = recorded(tmp_path / "bag")
    shutil.move(folder / "bag_1.mcap", tmp_path / "bag_1.mcap")
    cut(tmp_path / "bag_1.mcap", (tmp_path / "bag_1.mcap").stat().st_size - 10)
    report = repair(tmp_path / "bag_1.mcap")
    assert [file.path for file in report.files] == [tmp_path / "bag_1.mcap"]
    assert len(indexed(tmp_path / "bag_1.mcap")) == 4
    assert names(tmp_path) == ["bag", "bag_1.mcap"]
