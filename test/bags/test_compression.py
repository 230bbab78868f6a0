# SPDX-License-Identifier: Apache-2.0
"""Compressed bags are read alone too, and decompress at most to what they state."""

import bz2
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]
import pytest
import zstandard
from mcap.writer import CompressionType
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from scara_effmass.bags import compression
from scara_effmass.bags.compression import inflate, inflate_message
from scara_effmass.bags.files import find_bags, open_bag
from scara_effmass.errors import BagError, DecodeError
from test.bags.messages import write_mcap
from test.bags.test_reading import MIXED, write_rosbag2

COMPRESS: dict[str, Callable[[bytes], bytes]] = {
    "zstd": lambda data: zstandard.ZstdCompressor(write_content_size=False).compress(data),
    "lz4": lz4.frame.compress,
    "bz2": bz2.compress,
}
ZEROS = bytes(200_000_000)
MAX_BYTES = 20_000_000


@pytest.mark.parametrize("kind", COMPRESS)
def test_data_that_is_longer_than_stated_takes_no_memory(kind: str) -> None:
    bomb = COMPRESS[kind](ZEROS)
    tracemalloc.start()
    with pytest.raises(DecodeError, match="more than 1000 bytes"):
        inflate(bomb, kind, 1000)
    assert tracemalloc.get_traced_memory()[1] < MAX_BYTES
    tracemalloc.stop()


@pytest.mark.parametrize("kind", COMPRESS)
def test_data_of_the_stated_size_and_the_intact_part_of_cut_data(kind: str) -> None:
    data = struct.pack("<300000I", *range(300_000))
    packed = COMPRESS[kind](data)
    assert inflate(packed, kind, len(data)) == data
    cut = inflate(packed[: len(packed) * 9 // 10], kind, len(data))
    assert data.startswith(cut)


def test_size_beyond_the_limit_is_refused() -> None:
    with pytest.raises(DecodeError, match="must be <="):
        inflate(b"", "zstd", 1 << 31)


def test_message_bomb_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compression, "MAX_CHUNK_BYTES", 1000)
    for content_size in (False, True):
        bomb = zstandard.ZstdCompressor(write_content_size=content_size).compress(ZEROS)
        with pytest.raises(DecodeError):
            inflate_message(bomb)


@pytest.mark.parametrize("kind", [CompressionType.ZSTD, CompressionType.LZ4])
def test_chunk_that_states_too_little_is_lost_and_said(tmp_path: Path, kind: CompressionType) -> None:
    path = write_mcap(tmp_path / "a.mcap", MIXED, compression=kind, indexed=False)
    with open_bag(path) as bag:
        count = len(list(bag.messages()))
    content = path.read_bytes()
    start = content.rindex(b"\x04\x00\x00\x00zstd" if kind == CompressionType.ZSTD else b"\x03\x00\x00\x00lz4")
    path.write_bytes(content[: start - 12] + struct.pack("<Q", 50) + content[start - 4 :])
    with open_bag(path) as bag:
        assert len(list(bag.messages())) < count
        assert any("more than 50 bytes" in loss for loss in bag.losses)


@pytest.mark.parametrize("suffix", [".zstd", ".zst"])
@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_compressed_file_alone(tmp_path: Path, storage: StoragePlugin, suffix: str) -> None:
    folder = write_rosbag2(tmp_path / "b", MIXED, storage, CompressionMode.FILE)
    (packed,) = folder.glob("*.zstd")
    alone = tmp_path / packed.with_suffix(suffix).name
    with open_bag(folder) as bag:
        expected = list(bag.messages())
    assert len(expected) == len(MIXED)
    packed.rename(alone)
    assert find_bags(alone) == [alone]
    with open_bag(alone) as bag:
        assert list(bag.messages()) == expected
    (folder / "metadata.yaml").unlink()
    assert find_bags(tmp_path) == [alone]


@pytest.mark.parametrize("metadata", ["", "compression_format: zstd\n  compression_mode: message\n"])
@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_messages_are_decompressed_whatever_the_metadata_say(
    tmp_path: Path, storage: StoragePlugin, metadata: str
) -> None:
    messages = [m._replace(data=COMPRESS["zstd"](m.data)) if i % 2 else m for i, m in enumerate(MIXED)]
    folder = write_rosbag2(tmp_path / "bag", messages, storage)
    (folder / "metadata.yaml").write_text(metadata and f"rosbag2_bagfile_information:\n  {metadata}")
    with open_bag(folder) as bag:
        assert [message.data for message in bag.messages()] == [message.data for message in MIXED]


@pytest.mark.parametrize("damage", [b"", bytes(5), b"\xff" * 20])
@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_damaged_compressed_messages_are_counted(tmp_path: Path, storage: StoragePlugin, damage: bytes) -> None:
    damaged = [message._replace(data=b"\x28\xb5\x2f\xfd" + damage) for message in MIXED[:3]]
    with open_bag(write_rosbag2(tmp_path / "bag", [*damaged, *MIXED[3:]], storage)) as bag:
        for _ in range(2):
            assert len(list(bag.messages())) == len(MIXED) - 3
        (loss,) = bag.losses
    assert "a compressed message is lost" in loss
    assert loss.endswith("(3 times)")


def test_compressed_file_without_a_whole_block_is_cut_off(tmp_path: Path) -> None:
    plain = write_mcap(tmp_path / "a.mcap", MIXED).read_bytes()[:100_000]
    path = tmp_path / "b.mcap.zstd"
    path.write_bytes(COMPRESS["zstd"](plain)[:1000])
    with pytest.raises(BagError, match="is cut off before anything that can be decompressed"):
        open_bag(path)


def test_loss_in_a_compressed_file_names_that_file(tmp_path: Path) -> None:
    plain = write_mcap(tmp_path / "a.mcap", MIXED).read_bytes()
    path = tmp_path / "b.mcap.zstd"
    path.write_bytes(COMPRESS["zstd"](plain[: len(plain) // 2]))
    with open_bag(path) as bag:
        list(bag.messages())
        assert bag.losses
        assert all(loss.startswith(f"{path}: ") for loss in bag.losses)


def test_file_bomb_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compression, "MAX_UNSTATED_BYTES", 1000)
    path = tmp_path / "a.mcap.zstd"
    path.write_bytes(COMPRESS["zstd"](write_mcap(tmp_path / "a.mcap", MIXED).read_bytes()))
    with pytest.raises(BagError, match="must not be longer than 1000 bytes"):
        open_bag(path)
    path.write_bytes(b"\x28\xb5\x2f\xfd" + bytes(100))
    with pytest.raises(BagError, match=r"a\.mcap\.zstd"):
        open_bag(path)
