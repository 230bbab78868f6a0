# SPDX-License-Identifier: Apache-2.0
"""Bags of all formats give the same messages; damaged bags give what can be read, and state what is lost."""

import os
import shutil
import sqlite3
import struct
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, suppress
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import yaml
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import DataEnd, Footer
from mcap.records import Message as McapMessage
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from scara_effmass.bags.bag import Bag, run_infos
from scara_effmass.bags.definitions import known_types
from scara_effmass.bags.files import bag_bytes, find_bags, open_bag
from scara_effmass.errors import BagError
from scara_effmass.values import ForceBlock, Impact, JointState, RunInfo
from scara_effmass.wire.force import force_block_message, impact_message
from scara_effmass.wire.joint_state import JointStateDecoder, joint_state_message
from scara_effmass.wire.message_types import FORCE_BLOCK, IMPACT, RUN_INFO
from scara_effmass.wire.run_info import run_info_message
from test.bags.messages import Message, serialized, write_mcap

JOINTS = "sensor_msgs/msg/JointState"
STRING = "std_msgs/msg/String"
T0 = 1_700_000_000_000_000_000
MS = 1_000_000
NOBODY_UID = 65534


def joint_state(index: int, names: Sequence[str] = ("joint1", "joint2"), *, log_time_ns: int | None = None) -> Message:
    position = np.linspace(0.1 * index, 1.0, len(names))
    state = JointState(T0 + index * MS, tuple(names), position, np.full(len(names), -0.2 * index))
    time = state.stamp_ns + 7 if log_time_ns is None else log_time_ns
    return Message("/joint_states", JOINTS, time, joint_state_message(state, "base_link"))


def text(index: int, value: str = "hello") -> Message:
    return Message("/notes", STRING, T0 + index * MS + 8, serialized(STRING, {"data": value}))


MIXED = [
    message
    for i in range(400)
    for message in ((joint_state(i), text(i, "x" * (i % 5))) if i % 3 else (joint_state(i),))
]


def write_rosbag2(
    folder: Path, messages: Iterable[Message], storage: StoragePlugin, mode: CompressionMode = CompressionMode.NONE
) -> Path:
    writer = Ros2Writer(folder, version=9, storage_plugin=storage)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for message in messages:
            if message.topic not in connections:
                connections[message.topic] = writer.add_connection(message.topic, message.type, typestore=known_types())
            writer.write(connections[message.topic], message.log_time_ns, message.data)
    return folder


def write_ros1(path: Path, messages: Iterable[Message]) -> Path:
    types = get_typestore(Stores.ROS1_NOETIC)
    ros2 = get_typestore(Stores.ROS2_JAZZY)
    with Ros1Writer(path) as writer:
        connections = {}
        for message in messages:
            if message.topic not in connections:
                connections[message.topic] = writer.add_connection(message.topic, message.type, typestore=types)
            raw = ros2.cdr_to_ros1(message.data, message.type)
            writer.write(connections[message.topic], message.log_time_ns, bytes(raw))
    return path


def single_db3(folder: Path, messages: Iterable[Message]) -> Path:
    (path,) = write_rosbag2(folder / "bag", messages, StoragePlugin.SQLITE3).glob("*.db3")
    return Path(shutil.move(path, folder / "single.db3"))


FORMATS: dict[str, Callable[[Path, Iterable[Message]], Path]] = {
    "mcap zstd": lambda folder, m: write_mcap(folder / "a.mcap", m),
    "mcap lz4": lambda folder, m: write_mcap(folder / "a.mcap", m, compression=CompressionType.LZ4),
    "mcap uncompressed": lambda folder, m: write_mcap(folder / "a.mcap", m, compression=CompressionType.NONE),
    "mcap without index": lambda folder, m: write_mcap(folder / "a.mcap", m, indexed=False),
    "mcap without chunks": lambda folder, m: write_mcap(folder / "a.mcap", m, chunked=False),
    "mcap without index and chunks": lambda folder, m: write_mcap(folder / "a.mcap", m, chunked=False, indexed=False),
    "mcap without profile": lambda folder, m: write_mcap(folder / "a.mcap", m, profile=""),
    "rosbag2 mcap": lambda folder, m: write_rosbag2(folder / "bag", m, StoragePlugin.MCAP),
    "rosbag2 mcap zstd": lambda folder, m: write_rosbag2(folder / "b", m, StoragePlugin.MCAP, CompressionMode.STORAGE),
    "rosbag2 sqlite": lambda folder, m: write_rosbag2(folder / "bag.db3", m, StoragePlugin.SQLITE3),
    "rosbag2 by message": lambda f, m: write_rosbag2(f / "b", m, StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
    "rosbag2 by file": lambda f, m: write_rosbag2(f / "b", m, StoragePlugin.MCAP, CompressionMode.FILE),
    "db3": single_db3,
    "ros1": lambda folder, m: write_ros1(folder / "a.bag", m),
}


@pytest.fixture(scope="module", params=FORMATS)
def mixed(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return FORMATS[request.param](tmp_path_factory.mktemp("bags"), MIXED)


def read(bag: Bag) -> list[Message]:
    return [Message(*message) for message in bag.messages()]


def assert_states(bag: Bag, expected: Iterable[Message], topic: str = "") -> None:
    """Check that the states in the blocks are bit-identical to those of the live decoder."""
    decoder = JointStateDecoder()
    blocks = list(bag.joint_state_blocks(topic))
    log_times = [time for block in blocks for time in block.log_time_ns.tolist()]
    states = [state for block in blocks for state in block.states()]
    expected = list(expected)
    assert log_times == [message.log_time_ns for message in expected]
    for state, message in zip(states, expected, strict=True):
        decoded = decoder.decode(message.data)
        assert (state.stamp_ns, state.names) == (decoded.stamp_ns, decoded.names)
        for array, decoded_array in zip(state[2:], decoded[2:], strict=True):
            assert array.tobytes() == decoded_array.tobytes()
            assert array.flags.aligned
            assert not array.flags.writeable


def readable(path: Path) -> tuple[list[Message], str]:
    """Return the readable messages and the warnings about the rest, which must be one line each."""
    try:
        with open_bag(path) as bag:
            messages = read(bag)
            for topic in bag.joint_state_topics:
                with suppress(BagError):
                    assert sum(map(len, bag.joint_state_blocks(topic))) <= len(messages)
            lines = list(bag.losses)
    except BagError as error:
        messages, lines = [], [str(error)]
    assert not any("\n" in line for line in lines)
    assert all(str(path) in line for line in lines)
    return messages, "; ".join(lines)


class TestEveryFormat:
    def test_all_messages_are_read_in_order(self, mixed: Path) -> None:
        with open_bag(mixed) as bag:
            assert read(bag) == MIXED
            assert bag.losses == ()

    def test_topics_and_times(self, mixed: Path) -> None:
        with open_bag(mixed) as bag:
            assert [(topic.name, topic.type, topic.count) for topic in bag.topics] == [
                ("/joint_states", JOINTS, 400),
                ("/notes", STRING, 266),
            ]
            assert bag.joint_state_topics == ("/joint_states",)
            assert (bag.start_ns, bag.end_ns) == (MIXED[0].log_time_ns, MIXED[-1].log_time_ns)
            assert bag.duration_ns == 399 * MS

    def test_selection_by_topic_and_time(self, mixed: Path) -> None:
        start, stop = T0 + 100 * MS + 7, T0 + 300 * MS + 7
        expected = [m for m in MIXED if start <= m.log_time_ns < stop]
        with open_bag(mixed) as bag:
            assert [Message(*m) for m in bag.messages(start_ns=start, stop_ns=stop)] == expected
            notes = [m for m in expected if m.topic == "/notes"]
            assert [Message(*m) for m in bag.messages(["/notes"], start, stop)] == notes

    def test_time_range_without_messages_is_empty(self, mixed: Path) -> None:
        with open_bag(mixed) as bag:
            assert list(bag.messages(stop_ns=bag.start_ns)) == []
            assert list(bag.messages(start_ns=bag.end_ns + 1)) == []

    def test_joint_states_equal_those_of_the_live_decoder(self, mixed: Path) -> None:
        with open_bag(mixed) as bag:
            assert_states(bag, (message for message in MIXED if message.type == JOINTS))

    def test_messages_are_decoded(self, mixed: Path) -> None:
        with open_bag(mixed) as bag:
            message = next(bag.messages(["/notes"]))
            assert bag.deserialize(message).data == "x"

    def test_unknown_topic_is_refused(self, mixed: Path) -> None:
        with open_bag(mixed) as bag:
            with pytest.raises(BagError, match="topic = /notes: must be one of /joint_states"):
                bag.joint_state_blocks("/notes")
            with pytest.raises(BagError, match="topic = /nope: must be one of /joint_states, /notes"):
                bag.messages(["/nope"])


def test_several_topics_of_joint_states_require_a_topic_unless_one_has_the_usual_name(tmp_path: Path) -> None:
    messages = [joint_state(number)._replace(topic=f"/{name}/joint_states") for number, name in enumerate(("a", "b"))]
    with open_bag(write_mcap(tmp_path / "two.mcap", messages)) as bag:
        with pytest.raises(BagError, match=r"topic is empty: must be one of /a/joint_states .*, /b/joint_states "):
            bag.joint_state_blocks()
        assert_states(bag, messages[1:], "/b/joint_states")
    with open_bag(write_mcap(tmp_path / "three.mcap", [*messages, joint_state(2)])) as bag:
        assert sum(len(block.stamp_ns) for block in bag.joint_state_blocks()) == 1


def test_joint_commands_are_no_joint_states_unless_the_topic_says_so(tmp_path: Path) -> None:
    commands, states = (
        joint_state(number)._replace(topic=f"/arm/{name}") for number, name in enumerate(("joint_commands", "js"))
    )
    with open_bag(write_mcap(tmp_path / "commands.mcap", [commands])) as bag:
        with pytest.raises(BagError, match=r"topic is empty: must be one of /arm/joint_commands "):
            bag.joint_state_blocks()
        assert_states(bag, [commands], "/arm/joint_commands")
    with open_bag(write_mcap(tmp_path / "both.mcap", [commands, states])) as bag:
        assert_states(bag, [states])


def test_bag_without_joint_states_is_refused(tmp_path: Path) -> None:
    with (
        open_bag(write_mcap(tmp_path / "a.mcap", [text(0)])) as bag,
        pytest.raises(BagError, match="has no topic of type sensor_msgs/msg/JointState"),
    ):
        bag.joint_state_blocks()


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(
    steps=st.lists(
        st.tuples(
            st.integers(0, 60),
            st.sampled_from([("a", "b"), ("b", "a"), ("gripper",), ()]),
            st.booleans(),
        ),
        min_size=1,
        max_size=60,
    ),
    chunk_size=st.sampled_from([1, 300, 1 << 20]),
    chunked=st.booleans(),
)
def test_out_of_order_messages_are_sorted_by_log_time(
    tmp_path: Path, steps: list[tuple[int, tuple[str, ...], bool]], chunk_size: int, *, chunked: bool
) -> None:
    """Times are out of order within and across chunks, joint names change, and another topic is in between."""
    messages: list[Message] = []
    for index, (time, names, other) in enumerate(steps):
        messages.append(joint_state(index, names, log_time_ns=T0 + time))
        messages += [text(0)._replace(log_time_ns=T0 + time)] if other else []
    path = write_mcap(tmp_path / "a.mcap", messages, chunk_size=chunk_size, chunked=chunked)
    with open_bag(path) as bag:
        actual = [Message(*message) for message in bag.messages(["/joint_states"])]
        assert [m.log_time_ns for m in actual] == sorted(m.log_time_ns for m in actual)
        assert sorted(actual) == sorted(m for m in messages if m.type == JOINTS)
        assert_states(bag, actual)
        assert bag.losses == ()


def test_arbitrary_padding_does_not_split_blocks(tmp_path: Path) -> None:
    """ROS does not clear the padding between fields."""
    padding = 26, 27, 43, 55, 80, 81, 82, 83
    messages = []
    for index in range(1000):
        message = joint_state(index, ("elbow1", "elbow2"))
        data = bytearray(message.data)
        for offset in padding:
            assert data[offset] == 0
            data[offset] = index % 256
        messages.append(message._replace(data=bytes(data)))
    with open_bag(write_mcap(tmp_path / "a.mcap", messages, chunk_size=1 << 20)) as bag:
        assert_states(bag, messages)
        assert len(list(bag.joint_state_blocks())) < 10


@pytest.mark.parametrize("invalid", [{0}, {5, 6}, {99}, {0, 50, 99}, set(range(100))])
def test_invalid_joint_states_are_skipped_counted_and_reported_in_order(tmp_path: Path, invalid: set[int]) -> None:
    valid = [joint_state(i) for i in range(100)]
    messages = [m._replace(data=m.data[:30]) if i in invalid else m for i, m in enumerate(valid)]
    results: list[tuple[int, bool]] = []
    with open_bag(write_mcap(tmp_path / "a.mcap", messages)) as bag:
        for block in bag.joint_state_blocks():
            results += [(log_time_ns, False) for log_time_ns, _ in block.decode_failures]
            results += [(log_time_ns, True) for log_time_ns in block.log_time_ns.tolist()]
        assert_states(bag, [m for i, m in enumerate(valid) if i not in invalid])
        (line,) = bag.losses
    assert results == [(m.log_time_ns, i not in invalid) for i, m in enumerate(valid)]
    assert "/joint_states: left out: JointState: " in line
    assert line.endswith(f"({len(invalid)} times)") == (len(invalid) > 1)


class TestTruncatedMcap:
    @pytest.mark.parametrize("compression", list(CompressionType))
    @pytest.mark.parametrize("chunked", [True, False])
    def test_any_cut_gives_the_messages_before_it(
        self, tmp_path: Path, compression: CompressionType, *, chunked: bool
    ) -> None:
        whole = write_mcap(tmp_path / "whole.mcap", MIXED, compression=compression, chunked=chunked).read_bytes()
        path = tmp_path / "cut.mcap"
        kept = []
        for size in range(len(whole) - 1, 0, -(len(whole) // 40)):
            path.write_bytes(whole[:size])
            messages, warnings = readable(path)
            assert messages == MIXED[: len(messages)]
            assert warnings
            assert messages or size < 5000
            kept.append(len(messages))
        assert kept == sorted(kept, reverse=True)
        assert kept[0] == len(MIXED)
        assert len(set(kept)) > 8

    def test_cut_inside_a_chunk_gives_the_messages_before_it(self, tmp_path: Path) -> None:
        path = write_mcap(tmp_path / "a.mcap", MIXED, compression=CompressionType.NONE, chunk_size=1 << 20)
        whole = path.read_bytes()
        path.write_bytes(whole[: whole.find(MIXED[300].data) + 10])
        with open_bag(path) as bag:
            assert read(bag) == MIXED[:300]
            assert bag.end_ns == MIXED[299].log_time_ns
            (line,) = bag.losses
            assert f"cut off at byte {path.stat().st_size}" in line


def first_chunk(data: bytes) -> int:
    """Return the offset of the content of the first chunk."""
    at = 8
    while data[at] != 0x06:
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    return at + 9


def patch_first_chunk(path: Path, at: int, new: bytes) -> None:
    """Replace bytes of the first chunk, `at` bytes after its start."""
    data = path.read_bytes()
    start = first_chunk(data) + at
    path.write_bytes(data[:start] + new + data[start + len(new) :])


@pytest.mark.parametrize("compression", list(CompressionType))
def test_damaged_chunk_is_reported_and_the_others_are_read(tmp_path: Path, compression: CompressionType) -> None:
    path = write_mcap(tmp_path / "a.mcap", MIXED, compression=compression)
    patch_first_chunk(path, 700, b"damage")
    with open_bag(path) as bag:
        messages = read(bag)
        assert read(bag) == messages == MIXED[-len(messages) :]
        assert 500 < len(messages) < len(MIXED)
        (line,) = bag.losses
        assert "chunk at byte" in line
        assert "is lost: its" in line


def test_channels_defined_in_a_damaged_chunk_are_reported(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap", MIXED, indexed=False)
    patch_first_chunk(path, 700, b"damage")
    with pytest.raises(BagError, match=r"chunk at byte .* is lost: .*messages of channel 1, which the file"):
        open_bag(path)


def test_message_outside_the_chunks_of_an_indexed_file_is_read(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap", MIXED[:-1])
    last = MIXED[-1]
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    (channel,) = (channel for channel in summary.channels.values() if channel.topic == last.topic)
    statistics = summary.statistics
    statistics.message_count += 1
    statistics.channel_message_counts[channel.id] += 1
    statistics.message_end_time = last.log_time_ns
    data = path.read_bytes()
    chunks = data[: data.rindex(bytes([Opcode.DATA_END, 4, 0, 0, 0, 0, 0, 0, 0]))]
    records = RecordBuilder()
    McapMessage(channel.id, last.log_time_ns, last.data, last.log_time_ns, 0).write(records)
    DataEnd(0).write(records)
    footer = Footer(summary_crc=0, summary_offset_start=0, summary_start=len(chunks) + records.count)
    definitions = (*summary.schemas.values(), *summary.channels.values())
    for record in (*definitions, statistics, *summary.chunk_indexes, footer):
        record.write(records)
    path.write_bytes(chunks + records.end() + data[:8])  # type: ignore[no-untyped-call]
    with open_bag(path) as bag:
        assert read(bag) == MIXED
        assert bag.losses == ()


def test_chunk_with_invalid_times_is_read(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap", MIXED)
    patch_first_chunk(path, 0, struct.pack("<QQ", 1 << 63, 5))
    with open_bag(path) as bag:
        assert read(bag) == MIXED
        assert (bag.start_ns, bag.end_ns) == (MIXED[0].log_time_ns, MIXED[-1].log_time_ns)


def test_zeros_after_a_cut_are_reported(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap", MIXED, compression=CompressionType.NONE, chunked=False)
    data = path.read_bytes()
    cut = data.find(MIXED[100].data) - 31
    path.write_bytes(data[:cut] + bytes(len(data) - cut))
    messages, warnings = readable(path)
    assert messages == MIXED[:100]
    assert f"byte {cut + 9} on is not MCAP" in warnings


def test_chunk_of_excessive_size_is_refused(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap", MIXED)
    patch_first_chunk(path, 16, struct.pack("<Q", 1 << 60))
    with open_bag(path) as bag:
        assert 0 < len(read(bag)) < len(MIXED)
        assert any("uncompressed size 1152921504606846976: must be <=" in line for line in bag.losses)


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(
    damage=st.lists(st.tuples(st.integers(0, 1 << 30), st.integers(0, 255)), min_size=1, max_size=6),
    chunked=st.booleans(),
)
def test_any_damage_gives_messages_or_a_warning(
    tmp_path: Path, damage: list[tuple[int, int]], *, chunked: bool
) -> None:
    path = write_mcap(tmp_path / "a.mcap", MIXED[:60], chunked=chunked, chunk_size=1000)
    data = bytearray(path.read_bytes())
    for at, value in damage:
        data[at % len(data)] = value
    path.write_bytes(data)
    messages, warnings = readable(path)
    assert messages or warnings


def test_unknown_compression_is_refused(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap", MIXED)
    path.write_bytes(path.read_bytes().replace(b"zstd", b"zzzz"))
    with pytest.raises(BagError, match=r"a\.mcap: .*compression 'zzzz': must be one of zstd, lz4"):
        open_bag(path)


@pytest.fixture
def not_root() -> Iterator[Path]:
    """Return a folder of an unprivileged user, and run the test as that user, because root may read everything."""
    was_root = os.geteuid() == 0
    with tempfile.TemporaryDirectory() as folder:
        if was_root:
            os.chown(folder, NOBODY_UID, NOBODY_UID)
            os.seteuid(NOBODY_UID)
        try:
            yield Path(folder)
        finally:
            if was_root:
                os.seteuid(0)


class TestUnreadableInput:
    @pytest.mark.parametrize("name", ["a.mcap", "a.db3", "a.bag"])
    @pytest.mark.parametrize(("content", "reason"), [(b"", "is empty"), (b"not a bag at all", "is not a bag")])
    def test_other_content_is_refused(self, tmp_path: Path, name: str, content: bytes, reason: str) -> None:
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(BagError, match=rf"{name}: {reason}"):
            open_bag(path)

    def test_missing_path_and_empty_folder_are_refused(self, tmp_path: Path) -> None:
        with pytest.raises(BagError, match="nope: does not exist"):
            open_bag(tmp_path / "nope")
        os.mkfifo(tmp_path / "pipe")
        with pytest.raises(BagError, match="pipe: cannot be read: must be a regular file"):
            find_bags(tmp_path / "pipe")
        with pytest.raises(BagError, match="contains no bag; expected"):
            open_bag(tmp_path)

    @pytest.mark.parametrize("name", [name for name in FORMATS if "by file" not in name])
    def test_bag_without_messages_is_refused(self, tmp_path: Path, name: str) -> None:
        with pytest.raises(BagError, match="contains no messages"):
            open_bag(FORMATS[name](tmp_path, []))

    @pytest.mark.parametrize("closed", ["bag/a.mcap", "bag"])
    def test_missing_permission_is_reported(self, not_root: Path, closed: str) -> None:
        (not_root / "bag").mkdir()
        path = write_mcap(not_root / "bag" / "a.mcap", MIXED)
        (not_root / closed).chmod(0)
        try:
            for bag_path in (path, path.parent):
                with pytest.raises(BagError, match=r"/bag.*: cannot be read: Permission denied"):
                    open_bag(bag_path)
        finally:
            (not_root / closed).chmod(0o700)

    @pytest.mark.parametrize("size", [20, 100, 3000, 9000])
    @pytest.mark.parametrize("name", ["db3", "ros1"])
    def test_truncated_sqlite_and_ros1_are_refused(self, tmp_path: Path, name: str, size: int) -> None:
        path = FORMATS[name](tmp_path, MIXED)
        with path.open("r+b") as file:
            file.truncate(size)
        messages, warnings = readable(path)
        assert messages == []
        assert "cannot be read" in warnings

    @pytest.mark.parametrize("data", [None, "text", 7, b""])
    def test_sqlite_message_without_data_is_left_out(self, tmp_path: Path, data: str | bytes | int | None) -> None:
        path = single_db3(tmp_path, MIXED)
        with closing(sqlite3.connect(path)) as database:
            (definition,) = database.execute("SELECT sql FROM sqlite_master WHERE name = 'messages'").fetchone()
            database.execute("ALTER TABLE messages RENAME TO before")
            database.execute(definition.replace("NOT NULL", ""))
            database.execute("INSERT INTO messages SELECT * FROM before")
            database.execute("UPDATE messages SET data = ? WHERE id = 5", (data,))
            database.commit()
        with open_bag(path) as bag:
            assert len(list(bag.messages())) == len(MIXED) - 1
            assert any("left out a message without a time or data" in loss for loss in bag.losses)

    def test_damaged_sqlite_is_refused(self, tmp_path: Path) -> None:
        path = single_db3(tmp_path, MIXED)
        data = bytearray(path.read_bytes())
        middle = data.find(MIXED[200].data)
        data[middle - 3000 : middle + 3000] = bytes(6000)
        path.write_bytes(data)
        messages, warnings = readable(path)
        assert messages == []
        assert warnings.startswith(f"{path}: cannot be read: ")

    def test_damaged_ros1_is_read_up_to_the_damage(self, tmp_path: Path) -> None:
        path = write_ros1(tmp_path / "a.bag", MIXED)
        data = path.read_bytes()
        half = data.find(b"op=", data.find(b"joint1", len(data) // 3))
        path.write_bytes(data[:half] + b"xx" + data[half + 2 :])
        messages, warnings = readable(path)
        assert messages == MIXED[: len(messages)]
        assert 0 < len(messages) < len(MIXED)
        assert "damaged, the rest is lost: Could not read uint8 field 'op'" in warnings


class TestFolder:
    @pytest.fixture
    def folder(self, tmp_path: Path) -> Path:
        return write_rosbag2(tmp_path / "walk", MIXED, StoragePlugin.MCAP)

    @pytest.mark.parametrize(
        ("change", "loss"),
        [
            (
                lambda folder: (folder / "walk.mcap").rename(folder / "renamed.mcap"),
                "names walk.mcap, which does not exist",
            ),
            (lambda folder: write_mcap(folder / "other.mcap", MIXED[:10]), "does not name other.mcap; not read"),
            *(
                (
                    lambda folder, text=text: (folder / "metadata.yaml").write_text(text),
                    "does not describe a bag; read without it",
                )
                for text in (
                    "",
                    "[",
                    "a: 1",
                    "rosbag2_bagfile_information: 3",
                    "\x00",
                    "!!int abc",
                    "!!bool x",
                    "[" * 5000,
                )
            ),
        ],
    )
    def test_metadata_that_do_not_match_are_reported(
        self, folder: Path, change: Callable[[Path], object], loss: str
    ) -> None:
        change(folder)
        with open_bag(folder) as bag:
            assert read(bag) == MIXED
            assert bag.losses[0] == f"{folder}/metadata.yaml: {loss}"

    def test_missing_metadata_is_reported(self, folder: Path) -> None:
        (folder / "walk.mcap").rename(folder / "walk_0.mcap")
        (folder / "metadata.yaml").unlink()
        with open_bag(folder) as bag:
            assert read(bag) == MIXED
            assert bag.losses == (f"{folder}/metadata.yaml: does not exist; read without it",)

    def test_folder_without_files_is_refused(self, folder: Path) -> None:
        (folder / "walk.mcap").unlink()
        with pytest.raises(BagError, match=r"contains no .mcap or .db3 file; .*names walk.mcap, which does not exist"):
            open_bag(folder)

    def test_missing_messages_are_reported(self, folder: Path) -> None:
        write_mcap(folder / "walk.mcap", MIXED[:10])
        with open_bag(folder) as bag:
            assert bag.losses == (f"{folder}/metadata.yaml: lists 666 messages, the files contain 10",)

    def test_sqlite_journal_is_reported(self, tmp_path: Path) -> None:
        folder = write_rosbag2(tmp_path / "walk", MIXED, StoragePlugin.SQLITE3)
        (folder / "walk.db3-wal").write_bytes(b"rest")
        with open_bag(folder) as bag:
            assert "walk.db3-wal: the recorder did not finish" in bag.losses[0]

    @pytest.mark.parametrize("suffix", ["mcap", "db3"])
    def test_split_bag_without_metadata_is_read_in_order(self, tmp_path: Path, suffix: str) -> None:
        folder = tmp_path / "split"
        folder.mkdir()
        cuts = [*range(0, len(MIXED), 60), len(MIXED)]
        for number, (first, last) in enumerate(pairwise(cuts)):
            path = folder / f"split_{number}.{suffix}"
            part = MIXED[first:last]
            if suffix == "mcap":
                write_mcap(path, part)
            else:
                (tmp_path / "parts").mkdir(exist_ok=True)
                shutil.move(single_db3(tmp_path / "parts", part), path)
                shutil.rmtree(tmp_path / "parts")
        assert find_bags(folder) == [folder]
        with open_bag(folder) as bag:
            assert read(bag) == MIXED
            assert_states(bag, (message for message in MIXED if message.type == JOINTS))

    @pytest.mark.parametrize("has_metadata", [True, False])
    @pytest.mark.parametrize(
        ("number", "content", "loss"),
        [
            (1, b"", "split/split_1.mcap: is empty"),
            (0, b"not a bag", "split/split_0.mcap: is not a bag"),
            (2, b"\x89MCAP", "split/split_2.mcap: is not a bag"),
            (1, None, "do not exist: 1"),
            (0, None, "do not exist: 1"),
        ],
    )
    def test_split_bag_with_an_unreadable_file_is_read_without_it(
        self, tmp_path: Path, number: int, content: bytes | None, loss: str, *, has_metadata: bool
    ) -> None:
        folder = tmp_path / "split"
        folder.mkdir()
        parts = [MIXED[:200], MIXED[200:400], MIXED[400:]]
        paths = [write_mcap(folder / f"split_{index}.mcap", part) for index, part in enumerate(parts)]
        if has_metadata:  # that names a file twice
            information = {"relative_file_paths": [path.name for path in (*paths, paths[0])]}
            (folder / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": information}))
        if content is None:
            paths[number].unlink()
            loss = f"names split_{number}.mcap, which does not exist" if has_metadata else loss
        else:
            paths[number].write_bytes(content)
        assert find_bags(folder) == [folder]
        with open_bag(folder) as bag:
            assert read(bag) == [message for index, part in enumerate(parts) if index != number for message in part]
            assert any(loss in line for line in bag.losses)

    def test_folder_of_bags_gives_each_bag(self, tmp_path: Path) -> None:
        several = tmp_path / "several"
        several.mkdir()
        (several / "notes.txt").write_text("x")
        (several / "empty").mkdir()
        names = [
            write_rosbag2(several / "a.db3", MIXED, StoragePlugin.SQLITE3),
            write_mcap(several / "b.mcap", MIXED),
            write_ros1(several / "c.bag", MIXED),
            write_rosbag2(several / "d", MIXED, StoragePlugin.MCAP),
        ]
        assert find_bags(several) == names
        with pytest.raises(BagError, match=r"contains 4 bags: must be one of them \(a\.db3"):
            open_bag(several)

    def test_bags_are_found_in_every_folder_and_with_suffixes_in_any_case(self, tmp_path: Path) -> None:
        def folder(*parts: str) -> Path:
            path = tmp_path.joinpath(*parts)
            path.mkdir(parents=True)
            return path

        names = [
            write_rosbag2(folder("a", "b") / "bag", MIXED, StoragePlugin.MCAP),
            write_mcap(folder("a", "lost") / "renamed.mcap", MIXED),
            write_mcap(tmp_path / "m.MCAP", MIXED),
            write_mcap(tmp_path / "n.mcap.active", MIXED),
            single_db3(folder(".parts"), MIXED).rename(tmp_path / "o.DB3"),
            write_ros1(tmp_path / "p.BAG", MIXED),
            tmp_path / "q.mcap.ZST",
            tmp_path / "r.mcap",
        ]
        names[-2].write_bytes(zstandard.compress(names[2].read_bytes()))
        names[-1].symlink_to(tmp_path / "nowhere")
        write_mcap(folder(".hidden") / "s.mcap", MIXED)
        (tmp_path / "a" / "again").symlink_to(tmp_path)
        assert find_bags(tmp_path) == names
        for path in names[:-1]:
            with open_bag(path) as bag:
                assert sum(topic.count for topic in bag.topics) == len(MIXED)
        assert sum(map(bag_bytes, names)) > 0
        with pytest.raises(BagError, match=r"r\.mcap: does not exist"):
            open_bag(names[-1])

    def test_number_in_the_name_of_a_bag_is_not_that_of_a_file(self, tmp_path: Path) -> None:
        with open_bag(write_rosbag2(tmp_path / "run_6", MIXED, StoragePlugin.MCAP)) as bag:
            assert not list(bag.losses)

    def test_bag_inside_of_a_bag_is_named(self, folder: Path) -> None:
        write_mcap(folder / "walk.mcap", MIXED)
        (folder / "old").mkdir()
        other = write_mcap(folder / "old" / "run.mcap", MIXED)
        assert find_bags(folder) == [folder]
        with open_bag(folder) as bag:
            assert f"{other}: lies in the bag {folder}; not read" in bag.losses


class TestDefinitions:
    def test_type_defined_only_in_the_bag_is_decoded(self, tmp_path: Path) -> None:
        types = get_typestore(Stores.ROS2_JAZZY)
        types.register(get_types_from_msg("float64 weight\nstring by\n", "lab_msgs/msg/Weighing"))
        data = bytes(types.serialize_cdr(types.types["lab_msgs/msg/Weighing"](2.5, "me"), "lab_msgs/msg/Weighing"))
        folder = tmp_path / "bag"
        with Ros2Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            connection = writer.add_connection("/scale", "lab_msgs/msg/Weighing", typestore=types)
            writer.write(connection, T0, data)
        with open_bag(folder) as bag:
            (message,) = bag.messages()
            assert bag.deserialize(message).weight == 2.5

    def test_invalid_definition_leaves_other_topics_readable(self, tmp_path: Path) -> None:
        messages = [joint_state(0), joint_state(0)._replace(topic="/odd", type="lab_msgs/msg/Odd")]
        definitions = {"lab_msgs/msg/Odd": "this is ( no definition"}
        with open_bag(write_mcap(tmp_path / "a.mcap", messages, definitions=definitions)) as bag:
            assert_states(bag, messages[:1])
            odd = next(bag.messages(["/odd"]))
            assert odd.data == joint_state(0).data

    def test_other_joint_state_definition_is_refused(self, tmp_path: Path) -> None:
        types = get_typestore(Stores.EMPTY)
        types.register(get_types_from_msg("string[] name\nfloat32[] position\n", JOINTS))
        types.register(get_types_from_msg("string frame_id\n", "std_msgs/msg/Header"))
        folder = tmp_path / "bag"
        with Ros2Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            writer.write(writer.add_connection("/joint_states", JOINTS, typestore=types), T0, joint_state(0).data)
        with (
            open_bag(folder) as bag,
            pytest.raises(BagError, match="definition of sensor_msgs/msg/JointState: must be that of ROS"),
        ):
            bag.joint_state_blocks()

    @pytest.mark.parametrize("joint_states_first", [True, False])
    def test_other_time_definition_is_refused(self, tmp_path: Path, *, joint_states_first: bool) -> None:
        """The definition that comes with another topic does not hide it."""
        ros_definition, _ = known_types().generate_msgdef(JOINTS, ros_version=2)
        definition = ros_definition.replace("int32 sec", "int64 sec")
        assert definition != ros_definition
        messages = [joint_state(0), joint_state(0)._replace(topic="/header", type="std_msgs/msg/Header")]
        ordered = messages if joint_states_first else messages[::-1]
        path = write_mcap(tmp_path / "a.mcap", ordered, definitions={JOINTS: definition})
        with (
            open_bag(path) as bag,
            pytest.raises(BagError, match="definition of builtin_interfaces/msg/Time: must be that of ROS"),
        ):
            bag.joint_state_blocks()

    def test_other_vector_definition_is_refused(self, tmp_path: Path) -> None:
        """Otherwise the plate would be read with another normal."""
        ros_definition, _ = known_types().generate_msgdef(RUN_INFO, ros_version=2)
        definition = ros_definition.replace("Vector3\nfloat64 x\nfloat64 y", "Vector3\nfloat64 y\nfloat64 x")
        assert definition != ros_definition
        message = Message("/run_info", RUN_INFO, T0, run_info_message(RunInfo(plate_normal=(1.0, 0.0, 0.0))))
        with (
            open_bag(write_mcap(tmp_path / "a.mcap", [message], definitions={RUN_INFO: definition})) as bag,
            pytest.raises(BagError, match="definition of geometry_msgs/msg/Vector3: must be that of ROS"),
        ):
            list(run_infos(bag))

    def test_old_sqlite_bag_without_definitions_is_read(self, tmp_path: Path) -> None:
        path = single_db3(tmp_path, MIXED)
        with sqlite3.connect(path) as database:
            database.execute("DROP TABLE message_definitions")
            database.execute("DROP TABLE schema")
        database.close()
        with open_bag(path) as bag:
            assert_states(bag, (message for message in MIXED if message.type == JOINTS))

    def test_other_encoding_is_reported(self, tmp_path: Path) -> None:
        path = tmp_path / "a.mcap"
        with path.open("wb") as file:
            writer = Writer(file)
            writer.start()
            for topic, encoding in (("/a", "cdr"), ("/b", "json")):
                channel = writer.register_channel(topic, encoding, 0)
                writer.add_message(channel, T0, b"{}", T0)
            writer.finish()  # type: ignore[no-untyped-call]
        with open_bag(path) as bag:
            assert [topic.name for topic in bag.topics] == ["/a"]
            assert bag.losses == (f"{path}: /b: encoding = 'json': must be cdr; not read",)
            assert [message.topic for message in bag.messages()] == ["/a"]


def test_messages_equal_those_of_rosbags(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "a.mcap", MIXED)
    with AnyReader([path]) as reader, open_bag(path) as bag:
        assert [Message(c.topic, c.msgtype, time, raw) for c, time, raw in reader.messages()] == read(bag)


def test_sqlite_rows_without_topic_or_time_are_counted(tmp_path: Path) -> None:
    path = single_db3(tmp_path, MIXED)
    with closing(sqlite3.connect(path)) as database:
        database.execute("UPDATE messages SET topic_id = 99 WHERE id IN (3, 5)")
        database.execute("UPDATE messages SET timestamp = -1 WHERE id = 7")
        database.execute("UPDATE messages SET timestamp = 'noon' WHERE id = 9")
        database.commit()
    with open_bag(path) as bag:
        assert len(list(bag.messages())) == len(MIXED) - 4
        assert f"{path}: 2 messages of topics that the file does not define are lost" in bag.losses
        assert f"{path}: 2 messages without a time, or before 1970, are lost" in bag.losses


@pytest.mark.parametrize("kind", [FORCE_BLOCK, IMPACT])
def test_force_and_impacts_that_were_recorded_twice_count_once(tmp_path: Path, kind: str) -> None:
    """Otherwise two recorders, or a copied file of a bag, double the impacts of a series."""
    blocks = [ForceBlock(T0 + i * 100 * MS, "sensor", 100 * i, 1000.0, np.zeros(100)) for i in range(5)]
    impacts = [
        Impact(block.stamp_ns, "sensor", 50.0, 0.01, 1.0, 1.0, *(False, False, 0, 0.0, 0.1, 0.0, "cell", True))
        for block in blocks
    ]
    data = [*map(force_block_message, blocks)] if kind == FORCE_BLOCK else [*map(impact_message, impacts)]
    messages = [Message("/force", kind, block.stamp_ns, text) for block, text in zip(blocks, data, strict=True)]
    later = [message._replace(log_time_ns=message.log_time_ns + 150 * MS) for message in messages]
    with open_bag(write_mcap(tmp_path / "a.mcap", [*messages, *later])) as bag:
        read_all = bag.timed_force_blocks if kind == FORCE_BLOCK else bag.timed_impacts
        assert [item.stamp_ns for _, item in read_all("/force")] == [block.stamp_ns for block in blocks]
        assert bag.losses == (f"{bag.path}: /force: left out: recorded twice (5 times)",)
