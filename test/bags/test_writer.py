# SPDX-License-Identifier: Apache-2.0
"""Written bags are read back by this package and others, never replace other files and are never incomplete."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from scara_effmass.bags.definitions import known_types, own_types
from scara_effmass.bags.files import open_bag
from scara_effmass.bags.writer import BagWriter
from scara_effmass.errors import BagError, OutputError
from scara_effmass.values import ContactAssessment, JointState
from scara_effmass.wire.message_types import JOINT_STATE, STRING
from test.bags.messages import serialized

T0 = 1_700_000_000_123_456_789
STATES = [
    JointState(T0 + i * 1_000_000, ("joint1", "joint2"), np.array([0.1 * i, math.nan]), np.array([-0.0, 2.0]))
    for i in range(500)
]


def write(path: Path) -> Path:
    with BagWriter(path) as writer:
        writer.write_joint_states("/joint_states", STATES, "base_link")
        writer.write("/notes", STRING, T0 + 5, serialized(STRING, {"data": "hello"}))
    return path


def interrupted(path: Path, *, overwrite: bool = False) -> None:
    with BagWriter(path, overwrite=overwrite) as writer:
        writer.write_joint_states("/other", STATES)
        raise ZeroDivisionError


def names_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture(params=["bag", "bag.mcap"])
def written(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    return write(tmp_path / "new" / request.param)


def test_joint_states_are_read_back_bit_identical(written: Path) -> None:
    with open_bag(written) as bag:
        states = [state for block in bag.joint_state_blocks() for state in block.states()]
        assert [(s.stamp_ns, s.names) for s in states] == [(s.stamp_ns, s.names) for s in STATES]
        for state, expected in zip(states, STATES, strict=True):
            assert state.position.tobytes() == expected.position.tobytes()
            assert state.velocity.tobytes() == expected.velocity.tobytes()
        assert bag.losses == ()
    assert names_in(written.parent) == [written.name]


def test_rosbags_reads_the_bag_with_equal_type_hashes(written: Path) -> None:
    """`AnyReader` compares each hash with that of the embedded definition."""
    with AnyReader([written]) as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
        assert counts == {"/joint_states": 500, "/notes": 1}
        for connection, time, raw in reader.messages():
            message: Any = reader.deserialize(raw, connection.msgtype)
            stamp_ns = (
                message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
                if connection.msgtype == JOINT_STATE
                else T0 + 5
            )
            assert time == stamp_ns
    if written.is_dir():
        assert all(connection.digest.startswith("RIHS01_") for connection in reader.connections)


def test_mcap_reads_the_file_with_valid_checksums(written: Path) -> None:
    path = written / "bag_0.mcap" if written.is_dir() else written
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        assert sum(1 for _ in reader.iter_messages()) == 501
        summary = reader.get_summary()
    assert summary is not None
    assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}
    assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}


def test_metadata_is_that_of_rosbag2(tmp_path: Path) -> None:
    folder = write(tmp_path / "bag")
    assert names_in(folder) == ["bag_0.mcap", "metadata.yaml"]
    information = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["storage_identifier"] == "mcap"
    assert information["relative_file_paths"] == ["bag_0.mcap"]
    assert information["message_count"] == 501
    assert information["starting_time"] == {"nanoseconds_since_epoch": T0}
    assert information["duration"] == {"nanoseconds": 499_000_000}
    assert [t["topic_metadata"]["name"] for t in information["topics_with_message_count"]] == [
        "/joint_states",
        "/notes",
    ]


class TestExistingPath:
    @pytest.mark.parametrize("name", ["bag", "bag.mcap"])
    def test_is_kept(self, tmp_path: Path, name: str) -> None:
        path = write(tmp_path / name)
        with pytest.raises(OutputError, match=f"{name}: already exists"):
            BagWriter(path)
        assert names_in(tmp_path) == [name]

    def test_is_replaced_with_overwrite(self, written: Path) -> None:
        with BagWriter(written, overwrite=True) as writer:
            writer.write_joint_states("/other", STATES[:3])
        with open_bag(written) as bag:
            assert [(topic.name, topic.count) for topic in bag.topics] == [("/other", 3)]
        assert names_in(written.parent) == [written.name]

    def test_is_kept_if_writing_fails(self, written: Path) -> None:
        with pytest.raises(ZeroDivisionError):
            interrupted(written, overwrite=True)
        with open_bag(written) as bag:
            assert len(bag.topics) == 2
        assert names_in(written.parent) == [written.name]

    def test_is_kept_if_it_is_not_a_bag(self, tmp_path: Path) -> None:
        folder = tmp_path / "thesis"
        folder.mkdir()
        (folder / "chapter1").write_text("x")
        with pytest.raises(OutputError, match="is not a bag of this kind and is not replaced"):
            BagWriter(folder, overwrite=True)
        (tmp_path / "folder.mcap").mkdir()
        with pytest.raises(OutputError, match="is not a bag of this kind and is not replaced"):
            BagWriter(tmp_path / "folder.mcap", overwrite=True)
        assert names_in(folder) == ["chapter1"]

    def test_is_kept_if_created_meanwhile(self, tmp_path: Path) -> None:
        writer = BagWriter(tmp_path / "bag.mcap")
        writer.write_joint_states("/joint_states", STATES)
        (tmp_path / "bag.mcap").write_text("mine")
        with pytest.raises(OutputError, match="already exists"):
            writer.close()
        assert (tmp_path / "bag.mcap").read_text() == "mine"
        assert names_in(tmp_path) == ["bag.mcap"]


def test_failed_bag_is_deleted(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError):
        interrupted(tmp_path / "bag")
    assert names_in(tmp_path) == []


def test_unknown_type_is_refused(tmp_path: Path) -> None:
    with (
        pytest.raises(BagError, match="/x: type lab_msgs/msg/Nope is not defined"),
        BagWriter(tmp_path / "bag") as writer,
    ):
        writer.write("/x", "lab_msgs/msg/Nope", T0, b"")
    assert names_in(tmp_path) == []


def test_unwritable_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(OutputError, match=r"file/bag: cannot be written: "):
        BagWriter(tmp_path / "file" / "bag")


@pytest.mark.parametrize("name", ["bag", "bag.mcap"])
def test_interrupt_at_the_start_leaves_no_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("scara_effmass.bags.writer.McapFileWriter", interrupted)
    with pytest.raises(KeyboardInterrupt):
        BagWriter(tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_empty_bag_is_complete(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag"):
        pass
    with AnyReader([tmp_path / "bag" / "bag_0.mcap"]) as reader:
        assert reader.message_count == 0


def test_package_types_are_known() -> None:
    files = Path(__file__).parents[2].glob("msg_schemas/msg/*.msg")
    assert {name.rpartition("/")[2] for name in own_types()} == {path.stem for path in files}
    assert own_types().keys() <= known_types().fielddefs.keys()


def test_contact_state_has_the_fields_of_the_values() -> None:
    fields = [name for name, _ in known_types().fielddefs["scara_effmass_msgs/msg/ContactState"][1]]
    assert fields == list(ContactAssessment._fields)
